"""Models against recordings that they have not seen: windows, horizons, counts of divergence (paper, "Model comparison")."""

import numpy as np
import pandas as pd

from tras import metrics
from tras.model import join

ANGLES = {"yaw": "psi", "pitch": "phi"}  # the order of the paper's table


def score(model, recordings, seconds):
    """Metrics of both angles over windows of the given length, each predicted from its own true initial state.

    Parameters
    ----------
    model : KoopmanModel
        Or anything with ``predict(recording)``.
    recordings : dict of str to Recording
        Each is cut into windows that share end points, and scored by itself. Channels as the model was fitted to.
    seconds : float
        Length of a window.

    Returns
    -------
    pandas.DataFrame
        Columns ``recording, horizon`` (s), ``angle, enr`` (fraction), ``bfr, nrmse`` (percent), ``windows, diverged``. Metrics are
        over the windows that did not diverge, NaN if all did; ``diverged`` says how many were left out.
    """
    windows = {name: recording.cut(round(seconds / recording.dt) + 1) for name, recording in recordings.items()}
    predicted = np.split(model.predict(join(windows.values())), np.cumsum([len(w) for w in windows.values()])[:-1])
    rows = []
    for (name, window), prediction in zip(windows.items(), predicted):
        true = window.states
        lost = metrics.diverged(true, prediction)
        for angle, channel in ANGLES.items():
            i = [window.state_names.index(channel)]
            t, p = true[~lost][..., i], prediction[~lost][..., i]
            values = {f.__name__: f(t, p)[0] if len(t) else np.nan for f in (metrics.enr, metrics.bfr, metrics.nrmse)}
            rows.append(
                {"recording": name, "horizon": seconds, "angle": angle, **values, "windows": len(window), "diverged": int(lost.sum())}
            )
    return pd.DataFrame(rows)


def error_growth(model, recording, seconds, *, every=1):
    """Root mean square error at each instant after the start of the windows, in percent of the truth's range.

    Returns
    -------
    pandas.DataFrame
        Columns ``time`` (s), ``angle, nrmse``; every ``every``-th sample, without the first, whose error is zero. Diverged windows
        are left out.
    """
    windows = recording.cut(round(seconds / recording.dt) + 1)
    true, predicted = windows.states, model.predict(windows)
    kept = ~metrics.diverged(true, predicted)
    times = np.arange(every, true.shape[1], every)
    parts = []
    for angle, channel in ANGLES.items():
        i = windows.state_names.index(channel)
        error = true[kept][:, times, i] - predicted[kept][:, times, i]
        rms = 100 * np.sqrt(np.mean(error**2, axis=0)) / np.ptp(true[..., i])
        parts.append(pd.DataFrame({"time": times * windows.dt, "angle": angle, "nrmse": rms}))
    return pd.concat(parts, ignore_index=True)


def typical_window(model, recording, seconds):
    """Index of the window whose mean NRMSE of the two angles is the median one: neither the best picture nor the worst."""
    windows = recording.cut(round(seconds / recording.dt) + 1)
    i = [windows.state_names.index(channel) for channel in ANGLES.values()]
    true, predicted = windows.states[..., i], model.predict(windows)[..., i]
    error = np.sqrt(np.mean((true - predicted) ** 2, axis=1)) / np.ptp(true, axis=(0, 1))
    error = np.nan_to_num(error.mean(axis=1), nan=np.inf)
    return int(np.argsort(error, kind="stable")[(len(error) - 1) // 2])


def overlay(models, recording, seconds, index):
    """Truth and predictions over one window, as the table behind Fig. 3.

    Parameters
    ----------
    models : dict of str to KoopmanModel
    recording : Recording
    seconds : float
    index : int
        Which window.

    Returns
    -------
    pandas.DataFrame
        ``time`` (s) and, in rad, ``phi_true, psi_true`` and ``phi_NAME, psi_NAME`` for each model.
    """
    window = recording.cut(round(seconds / recording.dt) + 1)[index]
    table = pd.DataFrame({"time": np.arange(window.lengths[0]) * window.dt})
    for channel in ANGLES.values():
        i = window.state_names.index(channel)
        table[f"{channel}_true"] = window.states[0, :, i]
        for name, model in models.items():
            table[f"{channel}_{name}"] = model.predict(window)[0, :, i]
    return table
