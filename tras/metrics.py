"""How far a prediction is from the truth: Enr (19), BFR (20), NRMSE (21), divergence.

Every function takes truth and prediction of shape (..., samples, n), or two lists of (samples_i, n) when lengths differ, and
returns one value a channel, over all trajectories and samples together. None averages over a diverged prediction without
a word: find those with `diverged` and count them.
"""

import numpy as np


def enr(true, predicted):
    """Error-to-norm ratio ``|x - xh| / |x|``, equation (19), a FRACTION: 0 is perfect. (..., samples, n) -> (n,)

    Examples
    --------
    >>> float(enr([[3.0], [4.0]], [[3.0], [3.0]])[0])
    0.2
    """
    true, predicted = _pair(true, predicted)
    return np.linalg.norm(true - predicted, axis=0) / _positive(np.linalg.norm(true, axis=0), "the truth is zero throughout")


def bfr(true, predicted):
    """Best-fit ratio ``100 max(1 - |x - xh| / |x - mean(x)|, 0)``, equation (20) repaired, in PERCENT: 100 is perfect.

    The paper prints it without "1 -"; as printed a worse model would score higher.
    """
    true, predicted = _pair(true, predicted)
    spread = _positive(np.linalg.norm(true - true.mean(axis=0), axis=0), "the truth is constant")
    return 100 * np.maximum(1 - np.linalg.norm(true - predicted, axis=0) / spread, 0)


def nrmse(true, predicted, *, range_over="all"):
    """Root mean square error over the range of the truth, equation (21), in PERCENT: 0 is perfect.

    Parameters
    ----------
    true, predicted : array_like
    range_over : {"all", "trajectory"}
        Where ``y_max - y_min`` is taken: over all trajectories (default), or over each by itself, the NRMSE of all then being
        the root mean square of the trajectories' own.
    """
    if range_over == "all":
        true, predicted = _pair(true, predicted)
        return 100 * np.sqrt(np.mean((true - predicted) ** 2, axis=0)) / _positive(np.ptp(true, axis=0), "the truth is constant")
    if range_over != "trajectory":
        raise ValueError(f"range_over is {range_over!r}; choose 'all' or 'trajectory'.")
    each = np.array([nrmse(t, p) for t, p in zip(_trajectories(true), _trajectories(predicted), strict=True)])
    return np.sqrt(np.mean(each**2, axis=0))


def diverged(true, predicted, *, factor=10.0):
    """Which predictions have left for good: (trajectories,) bool.

    A trajectory has diverged if its prediction holds NaN or infinity anywhere, or if its error somewhere exceeds ``factor`` times
    the range of the truth over all trajectories, in any channel.
    """
    true, predicted = _trajectories(true), _trajectories(predicted)
    limit = factor * np.ptp(np.concatenate(true), axis=0)
    # Written so that NaN counts as diverged.
    return np.array([not np.all(np.abs(t - p) <= limit) for t, p in zip(true, predicted, strict=True)])


def _trajectories(values):
    """A list of (samples_i, n)."""
    if isinstance(values, (list, tuple)) and np.ndim(values[0]) == 2:
        return [np.asarray(value, dtype=float) for value in values]
    values = np.asarray(values, dtype=float)
    if values.ndim < 2:
        raise ValueError(f"shape {values.shape} is no set of trajectories; give (..., samples, n) or a list of (samples, n).")
    return list(values.reshape(-1, *values.shape[-2:]))


def _pair(true, predicted):
    """Both as (all samples, n), of the same shapes."""
    true, predicted = _trajectories(true), _trajectories(predicted)
    shapes = [t.shape for t in true], [p.shape for p in predicted]
    if shapes[0] != shapes[1]:
        raise ValueError(f"true and predicted have different shapes ({_some(shapes[0])} and {_some(shapes[1])}); compare like with like.")
    return np.concatenate(true), np.concatenate(predicted)


def _some(shapes):
    return f"{len(shapes)} of {shapes[0]}" if len(set(shapes)) == 1 else f"{len(shapes)} of unequal lengths"


def _positive(scale, what):
    if np.any(scale == 0):
        raise ValueError(f"channel {int(np.argmin(scale))}: {what}, so there is nothing to relate the error to; leave the channel out.")
    return scale
