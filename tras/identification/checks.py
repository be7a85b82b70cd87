"""Facts about a recording before any model: saturation, noise, excitation, feedback; `advice` judges them."""

from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy import ndimage, signal

from tras.identification.noise import noise_level
from tras.recording import Recording, join

_FEW_LEVELS = 10  # a channel with so few values is a switch, not at its limits
_ORDER = 20  # of persistent excitation, at most
_SMALL = 1e-3  # a direction whose singular value is below this fraction of the largest is not excited
_ROWS = 50_000  # samples of a regression, at most
_BRIEF = 3  # samples that a glitch lasts, at most
_RARE = 0.002  # share of the samples that are glitches, at most
_FAR = 4  # times as far from the median around it as the farthest of the other samples


class Checks(NamedTuple):
    """Tables, and single numbers in ``facts``."""

    channels: pd.DataFrame  # see `channels`
    correlation: pd.DataFrame  # between inputs
    spectrum: pd.DataFrame  # see `spectrum`
    facts: dict  # see `check`


def check(recording: Recording, lag: int = 1) -> Checks:
    """All checks of this module, for one recording.

    ``lag`` is in samples, about a quarter of the time within which the states move: see `excitation_order`. Of the
    ``facts``, ``rank`` and ``condition`` are those of constant, states and inputs, scaled; ``order`` (None without
    inputs) and ``feedback`` those of `excitation_order` and `feedback`.
    """
    recording = join(recording)
    x, u = (np.concatenate(part) for part in zip(*recording))
    every = max(1, len(x) // _ROWS)
    rank, condition = _rank(np.hstack([x, u])[::every])
    lengths, dt = recording.lengths, recording.dt
    facts = {
        "trajectories": len(recording), "samples": int(lengths.sum()), "pairs": recording.pairs, "dt": dt,
        "shortest": int(lengths.min()), "longest": int(lengths.max()), "seconds": float((lengths - 1).sum() * dt),
        "channels": 1 + recording.n + recording.m, "rank": rank, "condition": condition, "lag": lag,
        "order": excitation_order(recording, lag), "feedback": feedback(recording),
    }  # fmt: skip
    correlation = np.atleast_2d(np.corrcoef(u.T)) if recording.m else np.empty((0, 0))
    names = list(recording.input_names)
    return Checks(channels(recording), pd.DataFrame(correlation, names, names), spectrum(recording), facts)


def channels(recording: Recording) -> pd.DataFrame:
    """One row per channel: ``channel, role, unit, lowest, highest, mean, deviation``, and more.

    ``levels``, the number of different values, and ``step``, the usual distance between neighbouring ones (0 if there
    are too many to be levels); ``at_lowest, at_highest``, the share of samples that stand at a limit (0 where an
    extreme is just an extreme); ``noise``, a fraction of the range (NaN for inputs); ``jump``, the largest change over
    a sample as a fraction of the range, and ``usual``, the 99th percentile of the same; ``wraps``, how often it jumps
    by a full turn (360 or 2 pi); ``shift``, the difference of the means of first and second half in deviations;
    ``glitches``, how many samples leave their neighbours and come back within three samples as no others do, and
    ``glitch_at``, where the farthest of these is, in s since the beginning of its ``glitch_in``, a trajectory's number.
    """
    level = noise_level(recording) if recording.lengths.max() >= 4 else np.full(recording.n, np.nan)
    x, u = (np.concatenate(part) for part in zip(*recording))
    within = np.ones(len(x), dtype=bool)
    within[np.cumsum(recording.lengths)[:-1]] = False  # the step from one trajectory to the next is no change
    names = [*zip(recording.state_names, recording.state_units), *zip(recording.input_names, recording.input_units)]
    rows = []
    last = np.cumsum(recording.lengths)
    for i, ((name, unit), values) in enumerate(zip(names, np.hstack([x, u]).T)):
        low, high = values.min(), values.max()
        span = high - low if high > low else 1.0
        levels = np.unique(values)
        few = 1 < len(levels) <= len(values) / 5
        changes = np.abs(np.diff(values))[within[1:]] / span if len(values) > 1 else np.zeros(1)
        half = len(values) // 2
        glitches, at = _glitches(np.split(values, last[:-1]), span)
        trajectory = int(np.searchsorted(last, at, side="right"))
        rows.append({
            "channel": name, "role": "state" if i < recording.n else "input", "unit": unit,
            "lowest": low, "highest": high, "mean": values.mean(), "deviation": values.std(),
            "levels": len(levels), "step": float(np.median(np.diff(levels))) if few else 0.0,
            "at_lowest": _at_limit(-values, -levels[::-1]), "at_highest": _at_limit(values, levels),
            "noise": level[i] / span if i < recording.n else np.nan,
            "jump": changes.max(initial=0.0), "usual": float(np.quantile(changes, 0.99)) if len(changes) else 0.0,
            "wraps": _wraps(changes * span),
            "shift": abs(values[:half].mean() - values[half:].mean()) / (values.std() or 1.0) if half else 0.0,
            "glitches": glitches, "glitch_in": trajectory,
            "glitch_at": (at - last[trajectory] + recording.lengths[trajectory]) * recording.dt,
        })  # fmt: skip
    return pd.DataFrame(rows)


def excitation_order(recording: Recording, lag: int = 1) -> int | None:
    """The order, up to 20, of persistent excitation: the greatest depth of a Hankel matrix of inputs with full rank.

    J. C. Willems et al., Syst. Control Lett. 54, 2005, 325. Rows are ``lag`` samples apart, because neighbouring
    samples are nearly the same; the rank is full if the smallest singular value is at least a thousandth of the
    largest. None without inputs.
    """
    if not recording.m:
        return None
    every = max(1, int(recording.lengths.sum()) // 5_000)
    for order in range(1, _ORDER + 1):
        reach = (order - 1) * lag
        rows = [np.empty((0, order * recording.m))]
        for _, u in recording:
            if len(u) > reach:
                rows.append(np.hstack([u[k * lag : len(u) - reach + k * lag : every] for k in range(order)]))
        rows = np.concatenate(rows)
        if len(rows) <= order * recording.m:
            return order - 1
        rows = rows - rows.mean(axis=0)
        size = np.linalg.norm(rows, axis=0)
        singular = np.linalg.svd(rows / np.where(size > 0, size, 1.0), compute_uv=False)
        if not singular[-1] > _SMALL * singular[0]:
            return order - 1
    return _ORDER


def feedback(recording: Recording) -> dict[str, float]:
    """Input -> share of its variance that a linear function of the present states explains (R squared)."""
    x, u = (np.concatenate(part) for part in zip(*recording))
    every = max(1, len(x) // _ROWS)
    x, u = x[::every], u[::every]
    deviation = np.where(x.std(axis=0) > 0, x.std(axis=0), 1.0)
    regressors = np.hstack([np.ones((len(x), 1)), (x - x.mean(axis=0)) / deviation])
    shares = {}
    for name, values in zip(recording.input_names, u.T):
        values = values - values.mean()
        rest = values - regressors @ np.linalg.lstsq(regressors, values, rcond=None)[0]
        total = values @ values
        shares[name] = float(1 - rest @ rest / total) if total > 0 else 0.0
    return shares


def spectrum(recording: Recording) -> pd.DataFrame:
    """Share of variance per Hz, by Welch's method over all trajectories: ``frequency`` (Hz), one column per channel.

    Means are removed, so there is no row for zero frequency.
    """
    length = int(min(1024, np.median(recording.lengths)))
    names = [*recording.state_names, *recording.input_names]
    total, weight = 0.0, 0
    for x, u in recording:
        if len(x) >= length >= 8:
            frequency, density = signal.welch(np.hstack([x, u]), 1 / recording.dt, nperseg=length, axis=0)
            total, weight = total + len(x) * density, weight + len(x)
    if not weight:
        return pd.DataFrame(columns=["frequency", *names], dtype=float)
    variance = np.trapezoid(total, frequency, axis=0)
    table = pd.DataFrame((total / np.where(variance > 0, variance, 1.0))[1:], columns=names)
    table.insert(0, "frequency", frequency[1:])
    return table


def beyond(train: Recording, test: Recording) -> dict[str, float]:
    """Channel -> share of the test's samples outside the range of the training data."""
    shares = {}
    for a, b, names in zip(zip(*train), zip(*test), (train.state_names, train.input_names)):
        a, b = np.concatenate(a), np.concatenate(b)
        outside = (b < a.min(axis=0)) | (b > a.max(axis=0))
        shares |= dict(zip(names, outside.mean(axis=0).tolist()))
    return shares


def _at_limit(values, levels):
    """The share of samples at the highest value if it is a limit: 1 %, in three stays, far more than below it."""
    at = values == levels[-1]
    share = at.mean()
    if len(levels) <= _FEW_LEVELS or share < 0.01 or np.sum(np.diff(at.astype(int)) > 0) + at[0] < 3:
        return 0.0
    near = (values < levels[-1]) & (values >= min(levels[-2], levels[-1] - 0.01 * (levels[-1] - levels[0])))
    return float(share) if share > 5 * near.mean() else 0.0


def _glitches(trajectories, span):
    """How many samples stick out of their neighbours, and the number of the farthest: 0, 0 unless that is rare.

    What lasts three samples or less is lost in a median over seven; steps and slow motions are not, and a noisy channel
    has none that are so much farther from it than others.
    """
    away = [np.abs(x - ndimage.median_filter(x, 2 * _BRIEF + 1)) for x in trajectories]
    for distance in away:  # at the ends there is nothing to come back to
        distance[:_BRIEF] = distance[-_BRIEF:] = 0.0
    away = np.concatenate(away)
    most = max(_BRIEF, int(_RARE * len(away)))
    if len(away) < 10 * most:
        return 0, 0
    usual = np.partition(away, -most - 1)[-most - 1]  # the farthest of those that are no glitches
    out = away > max(0.1 * span, _FAR * usual)
    return int(out.sum()), int(np.argmax(away)) if out.any() else 0


def _wraps(changes):
    """How many changes over a sample are full turns, in degrees or radians; 0 unless the others are much smaller."""
    for turn in (360.0, 2 * np.pi):
        whole = np.abs(changes - turn) < 0.25 * turn
        if whole.any() and changes[~whole].max(initial=0.0) < 0.3 * turn and changes.max() < 1.001 * turn:
            return int(whole.sum())
    return 0


def _rank(channels):
    """The numerical rank and condition number of the constant and the channels, scaled to [-1, 1]."""
    low, high = channels.min(axis=0), channels.max(axis=0)
    half = np.where(high > low, (high - low) / 2, 1.0)
    scaled = np.hstack([np.ones((len(channels), 1)), (channels - (high + low) / 2) / half])
    singular = np.linalg.svd(scaled, compute_uv=False)
    condition = float(singular[0] / singular[-1]) if singular[-1] > 0 else float("inf")
    return int((singular > _SMALL * singular[0]).sum()), condition
