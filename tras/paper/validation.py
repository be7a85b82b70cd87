"""Models against recordings that they have not seen: windows, horizons, counts of divergence (paper, "Model comparison")."""

import contextlib

import numpy as np
import pandas as pd

from tras import metrics
from tras.paper import stacked
from tras.recording import join

ANGLES = {"yaw": "psi", "pitch": "phi"}  # the order of the paper's table


def score(model, recordings, seconds, *, range_over="all"):
    """Metrics of both angles over windows of the given length, each predicted from its own true initial state.

    Parameters
    ----------
    model : KoopmanModel
        Or anything with ``predict(recording)``.
    recordings : dict of str to Recording
        Each is cut into windows that share end points, and scored by itself. Channels as the model was fitted to.
    seconds : float
        Length of a window.
    range_over : {"all", "trajectory"}
        The range in NRMSE: of the whole recording, or of each window by itself (`tras.metrics.nrmse`).

    Returns
    -------
    pandas.DataFrame
        Columns ``recording, horizon`` (s), ``angle, enr`` (fraction), ``bfr, nrmse`` (percent), ``windows, diverged``. Metrics are
        over the windows that did not diverge, NaN if all did; ``diverged`` says how many were left out. The range that NRMSE and
        divergence refer to is that of all windows of the recording, so that losing windows does not change it.

    Raises
    ------
    ValueError
        If a recording is shorter than a window, lacks an angle, or an angle is constant; the sentence names it.
    """
    return score_together([model], [recordings], seconds, range_over=range_over)[0]


def score_together(models, recordings, seconds, *, range_over="all"):
    """`score` of several models, each on its own recordings: a list of tables. Those of one structure are rolled out together.

    Parameters
    ----------
    models : list of KoopmanModel
    recordings : list of dict of str to Recording
        One dict a model; with more than one model alike in number and length.
    seconds, range_over
        As for `score`.
    """
    windows = [_windows(own, seconds) for own in recordings]
    predicted = [None] * len(models)
    for group in stacked.alike(models) if len(models) > 1 else [[0]]:
        found = stacked.predict([models[i] for i in group], [join(windows[i].values()) for i in group])
        for i, prediction in zip(group, found):
            predicted[i] = prediction
    return [_table(*pair, seconds, range_over) for pair in zip(windows, predicted)]


def _windows(recordings, seconds):
    windows = {}
    for name, recording in recordings.items():
        with _named(f"recording {name!r}"):
            windows[name] = recording.cut(round(seconds / recording.dt) + 1)
    return windows


def _table(windows, predicted, seconds, range_over):
    """The table of `score` for windows by recording and all predictions in their order."""
    rows = []
    for (name, window), prediction in zip(
        windows.items(), np.split(predicted, np.cumsum([len(w) for w in windows.values()])[:-1])
    ):
        with _named(f"recording {name!r}"):
            judged = judge(window, prediction, range_over=range_over)
        rows += [{"recording": name, "horizon": seconds, **row} for row in judged]
    return pd.DataFrame(rows)


def judge(windows, predicted, *, range_over="all", samples=slice(None)):
    """The metrics of both angles over windows of one recording and their predictions (windows, samples, n); see `score`.

    With ``samples`` these alone count; the range is still that of the whole windows.

    Returns
    -------
    list of dict
        One per angle: ``angle, enr, bfr, nrmse, windows, diverged``.
    """
    true, predicted = windows.states[:, samples], predicted[:, samples]
    span = np.ptp(windows.states, axis=(0, 1))
    rows = []
    for angle, i in _columns(windows, span).items():
        with _named(angle):
            scores = metrics.judge(true, predicted, span=span, channels=[i], range_over=range_over)
        values = {name: float(getattr(scores, name)[0]) for name in ("enr", "bfr", "nrmse")}
        rows.append({"angle": angle, **values, "windows": scores.windows, "diverged": scores.diverged})
    return rows


def error_growth(windows, predicted, *, every=1):
    """Root mean square error at each instant after the start, in percent of the range; arguments as for `judge`.

    Returns
    -------
    pandas.DataFrame
        Columns ``time`` (s), ``angle, nrmse``; every ``every``-th sample, without the first, whose error is zero. Diverged windows
        are left out; NaN if all are. The range is that of all windows.
    """
    true = windows.states
    span = np.ptp(true, axis=(0, 1))
    kept = ~metrics.diverged(true, predicted, span=span)
    times = np.arange(every, true.shape[1], every)
    parts = []
    for angle, i in _columns(windows, span).items():
        error = true[kept][:, times, i] - predicted[kept][:, times, i]
        rms = 100 * np.sqrt(np.mean(error**2, axis=0)) / span[i] if kept.any() else np.full(len(times), np.nan)
        parts.append(pd.DataFrame({"time": times * windows.dt, "angle": angle, "nrmse": rms}))
    return pd.concat(parts, ignore_index=True)


def typical_window(windows, predicted):
    """Index of the window whose mean NRMSE of the two angles is the median one: neither the best picture nor the worst."""
    span = np.ptp(windows.states, axis=(0, 1))
    i = [*_columns(windows, span).values()]
    true, predicted = windows.states[..., i], predicted[..., i]
    error = np.sqrt(np.mean((true - predicted) ** 2, axis=1)) / span[i]
    error = np.nan_to_num(error.mean(axis=1), nan=np.inf)
    return int(np.argsort(error, kind="stable")[(len(error) - 1) // 2])


def overlay(window, predicted):
    """Truth and predictions over one window, as the table behind Fig. 3.

    Parameters
    ----------
    window : Recording
        Of one trajectory.
    predicted : dict of str to (samples, n) ndarray

    Returns
    -------
    pandas.DataFrame
        ``time`` (s) and, in rad, ``phi_true, psi_true`` and ``phi_NAME, psi_NAME`` for each prediction.
    """
    table = pd.DataFrame({"time": np.arange(window.lengths[0]) * window.dt})
    for channel in ANGLES.values():
        i = window.state_names.index(channel)
        for name, states in ({"true": window.states[0]} | predicted).items():
            table[f"{channel}_{name}"] = states[:, i]
    return table


@contextlib.contextmanager
def _named(place):
    """Errors inside say where: ``place`` stands before their sentence."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{place}: {error}") from error


def _columns(windows, span):
    """Angle -> number of its state, which must be there and move."""
    columns = {}
    for angle, channel in ANGLES.items():
        if channel not in windows.state_names:
            raise ValueError(f"{angle}: there is no state {channel!r}; there are {', '.join(windows.state_names)}.")
        i = columns[angle] = windows.state_names.index(channel)
        if span[i] == 0:
            reason = "so there is no range to relate the error to; use a recording in which it moves."
            raise ValueError(f"{angle}: the truth {channel} is constant, {reason}")
    return columns
