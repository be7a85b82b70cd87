"""How far a prediction is from the truth: Enr (19), BFR (20), NRMSE (21), divergence; `judge` gives all of them.

Every function takes truth and prediction of shape (..., samples, n), or two lists of (samples_i, n) when lengths
differ, and returns one value per channel, over all trajectories and samples together. Only `judge` leaves diverged
predictions out, and counts them. Shapes that differ, no trajectory at all, and NaN or infinity in the truth are a
ValueError.

Examples
--------
>>> from tras import metrics
>>> truth, prediction = [[0.0], [1.0], [2.0]], [[0.0], [1.0], [1.0]]
>>> metrics.nrmse(truth, prediction), metrics.bfr(truth, prediction)
(array([28.87]), array([29.29]))
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

if TYPE_CHECKING:
    from tras.recording import Recording


@dataclass(frozen=True)
class Scores:
    """How well trajectories are predicted; from `judge`.

    Attributes
    ----------
    enr, bfr, nrmse : (channels,) ndarray
        Over the trajectories that did not diverge; NaN if all did, or where the truth is zero (``enr``) or constant.
    windows, diverged : int
        How many trajectories there are, and how many of them diverged.
    """

    enr: np.ndarray
    bfr: np.ndarray
    nrmse: np.ndarray
    windows: int
    diverged: int


_quietly = np.errstate(over="ignore", invalid="ignore")  # what is too large for a number is infinite, without a warning


@_quietly
def judge(
    true: ArrayLike,
    predicted: ArrayLike,
    *,
    span: ArrayLike | None = None,
    channels: list[int] | None = None,
    range_over: str = "all",
) -> Scores:
    """The `Scores` of predicted trajectories: diverged ones are counted and left out of the metrics.

    Parameters
    ----------
    true, predicted : array_like
    span : (n,) array_like, optional
        The range that NRMSE and divergence refer to. Default: that of all trajectories, diverged ones too, so that
        losing some does not change it.
    channels : list of int, optional
        Those to score; default all. A trajectory has diverged if it did so in any channel.
    range_over : {"all", "trajectory"}
        As for `nrmse`.
    """
    true, predicted = _pair(true, predicted)
    span = np.ptp(np.concatenate(true), axis=0) if span is None else _span(span, true)
    lost = diverged(true, predicted, span=span)
    channels = slice(None) if channels is None else channels
    pairs = [(t[:, channels], p[:, channels]) for t, p, gone in zip(true, predicted, lost) if not gone]
    if not pairs:
        none = np.full_like(span[channels], np.nan)
        return Scores(none, none, none, len(lost), len(lost))
    true, predicted = zip(*pairs)
    error, size, spread = _norms(true, predicted)
    if range_over == "all":
        normalized = _percent(np.concatenate(true) - np.concatenate(predicted), divisor(span[channels]))
    else:
        normalized = nrmse(true, predicted, range_over=range_over)
    fit = 100 * np.maximum(1 - error / divisor(spread), 0)
    return Scores(error / divisor(size), fit, normalized, len(lost), int(lost.sum()))


@_quietly
def enr(true: ArrayLike, predicted: ArrayLike) -> np.ndarray:
    """Error-to-norm ratio ``|x - xh| / |x|``, equation (19), a FRACTION: 0 is perfect. (..., samples, n) -> (n,)

    Examples
    --------
    >>> float(enr([[3.0], [4.0]], [[3.0], [3.0]])[0])
    0.2
    """
    error, size, _ = _norms(*_pair(true, predicted))
    return error / _positive(size, "the truth is zero throughout")


@_quietly
def bfr(true: ArrayLike, predicted: ArrayLike) -> np.ndarray:
    """Best-fit ratio ``100 max(1 - |x - xh| / |x - mean(x)|, 0)``, equation (20) repaired, in PERCENT: 100 is perfect.

    The paper prints it without "1 -"; as printed a worse model would score higher.
    """
    error, _, spread = _norms(*_pair(true, predicted))
    return 100 * np.maximum(1 - error / _positive(spread, "the truth is constant"), 0)


@_quietly
def nrmse(
    true: ArrayLike, predicted: ArrayLike, *, range_over: str = "all", span: ArrayLike | None = None
) -> np.ndarray:
    """Root mean square error over the range of the truth, equation (21), in PERCENT: 0 is perfect.

    Parameters
    ----------
    true, predicted : array_like
    range_over : {"all", "trajectory"}
        Where ``y_max - y_min`` is taken: over all trajectories (default), or over each by itself, the NRMSE of all then
        being the root mean square of the trajectories' own.
    span : (n,) array_like, optional
        The range itself, when ``true`` is only a part of the truth that it belongs to; with ``range_over="all"``.
    """
    true, predicted = _pair(true, predicted)
    if range_over == "all":
        if span is None:
            span = _positive(np.ptp(np.concatenate(true), axis=0), "the truth is constant")
        else:
            span = _positive(_span(span, true), "the span is zero")
        return _percent(np.concatenate(true) - np.concatenate(predicted), span)
    if range_over != "trajectory":
        raise ValueError(f"range_over is {range_over!r}; choose 'all' or 'trajectory'.")
    if span is not None:
        raise ValueError(
            "span is given and range_over is 'trajectory', which takes each trajectory's own; give one of the two."
        )
    spans = [_positive(np.ptp(t, axis=0), f"the truth of trajectory {i} is constant") for i, t in enumerate(true)]
    each = np.array([np.mean(((t - p) / width) ** 2, axis=0) for t, p, width in zip(true, predicted, spans)])
    return 100 * np.sqrt(np.mean(each, axis=0))


@_quietly
def diverged(
    true: ArrayLike, predicted: ArrayLike, *, factor: float = 10.0, span: ArrayLike | None = None
) -> np.ndarray:
    """Which predictions have left for good: (trajectories,) bool.

    A trajectory has diverged if its prediction holds NaN or infinity anywhere, or if its error somewhere exceeds
    ``factor`` times the range of the truth over all trajectories, in any channel. ``span`` (n,) is used as the range if
    given. A channel whose range is zero is compared with the largest absolute value of its truth instead, and one that
    is zero throughout with 1.
    """
    true, predicted = _pair(true, predicted)
    together = np.concatenate(true)
    span = np.ptp(together, axis=0) if span is None else _span(span, true)
    size = np.abs(together).max(axis=0)
    limit = factor * np.where(span > 0, span, np.where(size > 0, size, 1.0))
    inside = np.all(np.abs(together - np.concatenate(predicted)) <= limit, axis=1)  # False for NaN
    return ~np.logical_and.reduceat(inside, np.cumsum([0, *map(len, true[:-1])]))


def divisor(scale: ArrayLike) -> np.ndarray:
    """The scale itself, to divide by: NaN where it is zero, so that nothing is related to nothing."""
    return np.where(scale > 0, scale, np.nan)


def _norms(true, predicted):
    """Norms of the error, of the truth and of its distance from its mean, each (n,), over all samples."""
    true, predicted = np.concatenate(true), np.concatenate(predicted)
    return [np.linalg.norm(values, axis=0) for values in (true - predicted, true, true - true.mean(axis=0))]


def _percent(error, span):
    return 100 * np.sqrt(np.mean(error**2, axis=0)) / span


def _trajectories(name, values):
    """A list of (samples_i, n)."""
    if isinstance(values, (list, tuple)) and len(values) and all(np.ndim(value) == 2 for value in values):
        values = [np.asarray(value, dtype=float) for value in values]
    else:
        try:
            values = np.asarray(values, dtype=float)
        except (TypeError, ValueError) as error:
            raise ValueError(
                f"{name} is no set of trajectories ({error}); give (..., samples, n) or a list of (samples, n)."
            ) from error
        if values.size == 0:
            raise ValueError(f"{name} has shape {values.shape}: it holds no sample; give one trajectory or more.")
        if values.ndim < 2:
            raise ValueError(
                f"{name} has shape {values.shape}, no set of trajectories; "
                "give (..., samples, n) or a list of (samples, n)."
            )
        values = list(values.reshape(-1, *values.shape[-2:]))
    if len({value.shape[1] for value in values}) > 1 or min(value.size for value in values) == 0:
        raise ValueError(
            f"{name} holds trajectories without samples or with unequal numbers of channels; "
            "give a list of (samples, n)."
        )
    return values


def _pair(true, predicted):
    """Both as lists of (samples_i, n), of the same shapes, the truth finite."""
    true, predicted = _trajectories("true", true), _trajectories("predicted", predicted)
    shapes = [t.shape for t in true], [p.shape for p in predicted]
    if shapes[0] != shapes[1]:
        raise ValueError(
            f"true and predicted have different shapes ({_some(shapes[0])} and {_some(shapes[1])}); compare equal ones."
        )
    if not np.isfinite(np.concatenate(true)).all():
        i, t = next((i, t) for i, t in enumerate(true) if not np.isfinite(t).all())
        sample, channel = np.argwhere(~np.isfinite(t))[0]
        where = f"in trajectory {i} at sample {sample}, channel {channel}"
        raise ValueError(f"true is {t[sample, channel]} {where}; leave that out.")
    return true, predicted


def _span(span, true):
    span = np.asarray(span, dtype=float)
    if span.shape != true[0].shape[1:] or not np.all((span >= 0) & np.isfinite(span)):
        raise ValueError(f"span is {span.tolist()}; give one finite range for each of the {true[0].shape[1]} channels.")
    return span


def _some(shapes):
    return f"{len(shapes)} of {shapes[0]}" if len(set(shapes)) == 1 else f"{len(shapes)} of unequal lengths"


def _positive(scale, what):
    if np.any(scale == 0):
        raise ValueError(
            f"channel {int(np.argmin(scale))}: {what}, so the error has nothing to relate to; leave the channel out."
        )
    return scale


def multi_step_error(predicted: np.ndarray, held: "Recording", n: int) -> float:
    """Root mean square of roll-outs (samples, n', trajectories) in half-ranges; a sample counts 10 at most."""
    return float(np.sqrt(np.mean(capped(predicted[:, :n].transpose(2, 0, 1) - held.states[..., :n]) ** 2)))


def capped(error: np.ndarray) -> np.ndarray:
    """Absolute errors in half-ranges, a sample 10 at most; so much counts one that was lost (NaN), too."""
    return np.minimum(np.nan_to_num(np.abs(error), nan=10.0), 10.0)
