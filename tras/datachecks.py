"""What can be said of a recording before any model: channels, saturation, noise, excitation, feedback. Numbers only; `tras.advice` judges them."""

from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy import signal

from tras.noise import noise_level
from tras.recording import join

_FEW_LEVELS = 10  # a channel of so few values is a switch, not one at its limits
_ORDER = 20  # persistency of excitation is looked for up to here
_SMALL = 1e-3  # singular values below this fraction of the largest: that direction is not excited
_ROWS = 50_000  # samples that regressions look at


class Checks(NamedTuple):
    """Tables, and single numbers in ``facts``; see `check`."""

    channels: pd.DataFrame
    correlation: pd.DataFrame
    spectrum: pd.DataFrame
    facts: dict


def check(recording, lag=1):
    """Everything below, for one recording.

    Parameters
    ----------
    recording : Recording
    lag : int
        Samples between the rows of the Hankel matrix: about a quarter of the time within which the states move.

    Returns
    -------
    Checks
        ``channels``: see `channels`. ``correlation``: coefficients between inputs. ``spectrum``: ``frequency`` (Hz) and a column a channel, its
        share of variance per Hz. ``facts``: ``trajectories, samples, pairs, dt, seconds, rank, condition`` (of constant, states and inputs, scaled),
        ``order`` (persistency of excitation, None without inputs), ``feedback`` (input -> R squared of a linear function of the states).
    """
    recording = join(recording)
    x, u = (np.concatenate(part) for part in zip(*recording))
    every = max(1, len(x) // _ROWS)
    rank, condition = _rank(np.hstack([x, u])[::every])
    facts = {
        "trajectories": len(recording), "samples": int(recording.lengths.sum()), "pairs": recording.pairs, "dt": recording.dt,
        "shortest": int(recording.lengths.min()), "longest": int(recording.lengths.max()), "seconds": float((recording.lengths - 1).sum() * recording.dt),
        "channels": 1 + recording.n + recording.m, "rank": rank, "condition": condition, "lag": lag,
        "order": excitation_order(recording, lag), "feedback": feedback(recording),
    }  # fmt: skip
    correlation = np.atleast_2d(np.corrcoef(u.T)) if recording.m else np.empty((0, 0))
    names = list(recording.input_names)
    return Checks(channels(recording), pd.DataFrame(correlation, names, names), spectrum(recording), facts)


def channels(recording):
    """A row a channel.

    Returns
    -------
    pandas.DataFrame
        ``channel, role, unit, lowest, highest, mean, deviation``; ``levels``, the number of different values, and ``step``, the usual distance
        between neighbouring ones (0 if there are too many to be levels); ``at_lowest, at_highest``, the share of samples that stand at a limit (0
        where an extreme is just an extreme); ``noise``, a fraction of the range (NaN for inputs); ``jump``, the largest change over a sample as a
        fraction of the range, and ``usual``, the 99th percentile of the same; ``wraps``, how often it jumps by a full turn (360 or 2 pi);
        ``shift``, the difference of the means of first and second half in deviations.
    """
    level = noise_level(recording) if recording.lengths.max() >= 4 else np.full(recording.n, np.nan)
    x, u = (np.concatenate(part) for part in zip(*recording))
    within = np.ones(len(x), dtype=bool)
    within[np.cumsum(recording.lengths)[:-1]] = False  # a change from one trajectory to the next is none
    names = [*zip(recording.state_names, recording.state_units), *zip(recording.input_names, recording.input_units)]
    rows = []
    for i, ((name, unit), values) in enumerate(zip(names, np.hstack([x, u]).T)):
        low, high = values.min(), values.max()
        span = high - low if high > low else 1.0
        found = np.unique(values)
        few = len(found) <= len(values) / 5
        changes = np.abs(np.diff(values))[within[1:]] / span if len(values) > 1 else np.zeros(1)
        half = len(values) // 2
        rows.append({
            "channel": name, "role": "state" if i < recording.n else "input", "unit": unit, "lowest": low, "highest": high, "mean": values.mean(),
            "deviation": values.std(), "levels": len(found), "step": float(np.median(np.diff(found))) if few and len(found) > 1 else 0.0,
            "at_lowest": _at_limit(-values, -found[::-1]), "at_highest": _at_limit(values, found),
            "noise": level[i] / span if i < recording.n else np.nan,
            "jump": changes.max(initial=0.0), "usual": float(np.quantile(changes, 0.99)) if len(changes) else 0.0,
            "wraps": _wraps(changes * span),
            "shift": abs(values[:half].mean() - values[half:].mean()) / (values.std() or 1.0) if half else 0.0,
        })  # fmt: skip
    return pd.DataFrame(rows)


def excitation_order(recording, lag=1):
    """Order to which the inputs are persistently exciting, up to 20: the depth at which their Hankel matrix still has full rank.

    J. C. Willems et al., Syst. Control Lett. 54, 2005, 325. Rows are ``lag`` samples apart, for samples that follow each other closely are nearly
    the same; full rank is a smallest singular value of a thousandth of the largest. None without inputs.
    """
    if not recording.m:
        return None
    every = max(1, int(recording.lengths.sum()) // 5_000)
    for order in range(1, _ORDER + 1):
        reach = (order - 1) * lag
        blocks = [np.hstack([u[k * lag : len(u) - reach + k * lag : every] for k in range(order)]) for _, u in recording if len(u) > reach]
        rows = np.concatenate(blocks) if blocks else np.empty((0, order * recording.m))
        if len(rows) <= order * recording.m:
            return order - 1
        rows = rows - rows.mean(axis=0)
        size = np.linalg.norm(rows, axis=0)
        singular = np.linalg.svd(rows / np.where(size > 0, size, 1.0), compute_uv=False)
        if not singular[-1] > _SMALL * singular[0]:
            return order - 1
    return _ORDER


def feedback(recording):
    """Input -> share of its variance that a linear function of the present states explains (R squared)."""
    x, u = (np.concatenate(part) for part in zip(*recording))
    every = max(1, len(x) // _ROWS)
    x, u = x[::every], u[::every]
    regressors = np.hstack([np.ones((len(x), 1)), (x - x.mean(axis=0)) / np.where(x.std(axis=0) > 0, x.std(axis=0), 1.0)])
    found = {}
    for name, values in zip(recording.input_names, u.T):
        values = values - values.mean()
        rest = values - regressors @ np.linalg.lstsq(regressors, values, rcond=None)[0]
        total = values @ values
        found[name] = float(1 - rest @ rest / total) if total > 0 else 0.0
    return found


def spectrum(recording):
    """Share of variance per Hz of every channel, by Welch's method over all trajectories: ``frequency`` (Hz), then a column a channel.

    At zero frequency nothing is shown, for means are taken away.
    """
    length = int(min(1024, np.median(recording.lengths)))
    names = [*recording.state_names, *recording.input_names]
    total, weight = 0.0, 0
    for x, u in recording:
        if len(x) >= length >= 8:
            frequency, density = signal.welch(np.hstack([x, u]), 1 / recording.dt, nperseg=length, detrend="constant", axis=0)
            total, weight = total + len(x) * density, weight + len(x)
    if not weight:
        return pd.DataFrame(columns=["frequency", *names], dtype=float)
    variance = np.trapezoid(total, frequency, axis=0)
    table = pd.DataFrame((total / np.where(variance > 0, variance, 1.0))[1:], columns=names)
    table.insert(0, "frequency", frequency[1:])
    return table


def beyond(train, test):
    """Channel -> share of the test's samples outside the range of the training data."""
    found = {}
    for a, b, names in zip(zip(*train), zip(*test), (train.state_names, train.input_names)):
        a, b = np.concatenate(a), np.concatenate(b)
        outside = (b < a.min(axis=0)) | (b > a.max(axis=0))
        found |= dict(zip(names, outside.mean(axis=0).tolist()))
    return found


def _at_limit(values, found):
    """Share of samples at the highest value, if they stand there as at a stop: at least 1 %, in three stays or more, and far more than just below."""
    at = values == found[-1]
    share = at.mean()
    if len(found) <= _FEW_LEVELS or share < 0.01 or np.sum(np.diff(at.astype(int)) > 0) + at[0] < 3:
        return 0.0
    near = (values < found[-1]) & (values >= min(found[-2], found[-1] - 0.01 * (found[-1] - found[0])))
    return float(share) if share > 5 * near.mean() else 0.0


def _wraps(changes):
    """How many of the changes over a sample are full turns, in degrees or radians, if the others are much smaller; 0 if they are not."""
    for turn in (360.0, 2 * np.pi):
        whole = np.abs(changes - turn) < 0.25 * turn
        if whole.any() and changes[~whole].max(initial=0.0) < 0.3 * turn and changes.max() < 1.001 * turn:
            return int(whole.sum())
    return 0


def _rank(channels):
    """Numerical rank and condition number of constant and channels, these scaled to [-1, 1]."""
    low, high = channels.min(axis=0), channels.max(axis=0)
    half = np.where(high > low, (high - low) / 2, 1.0)
    scaled = np.hstack([np.ones((len(channels), 1)), (channels - (high + low) / 2) / half])
    singular = np.linalg.svd(scaled, compute_uv=False)
    return int((singular > _SMALL * singular[0]).sum()), float(singular[0] / singular[-1]) if singular[-1] > 0 else float("inf")
