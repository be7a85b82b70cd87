"""Models against recordings that they have not seen: windows, horizons, divergence (paper, "Model comparison")."""

import contextlib

import numpy as np
import pandas as pd

from tras import metrics, rollout
from tras.dictionaries.base import Dictionary
from tras.model import KoopmanModel
from tras.recording import Recording, join

ANGLES = {"yaw": "psi", "pitch": "phi"}  # the order of the paper's table


def score(
    model: KoopmanModel, recordings: dict[str, Recording], seconds: float, *, range_over: str = "all"
) -> pd.DataFrame:
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
        Columns ``recording, horizon`` (s), ``angle, enr`` (fraction), ``bfr, nrmse`` (percent), ``windows, diverged``.
        Metrics are over the windows that did not diverge, NaN if all did; ``diverged`` counts the others. NRMSE and
        divergence refer to the range of all windows of the recording, so that losing windows does not change it.

    Raises
    ------
    ValueError
        If a recording is shorter than a window, lacks an angle, or an angle is constant; the sentence names it.
    """
    return score_together([model], [recordings], seconds, range_over=range_over)[0]


def score_together(
    models: list, recordings: list[dict[str, Recording]], seconds: float, *, range_over: str = "all"
) -> list[pd.DataFrame]:
    """`score` of several models, each on its own recordings. Models of one structure are rolled out together.

    ``recordings`` has one dict per model; with more than one model they are alike in number and length.
    """
    windows = [_windows(of_model, seconds) for of_model in recordings]
    predicted = {}
    for group in alike(models) if len(models) > 1 else [[0]]:
        joined = [join(windows[i].values()) for i in group]
        predicted |= dict(zip(group, _predict_together([models[i] for i in group], joined)))
    return [_table(pieces, predicted[i], seconds, range_over) for i, pieces in enumerate(windows)]


def _windows(recordings, seconds):
    windows = {}
    for name, recording in recordings.items():
        with _named(f"recording {name!r}"):
            windows[name] = recording.cut(round(seconds / recording.dt) + 1)
    return windows


def _table(windows, predicted, seconds, range_over):
    """The table of `score` for windows by recording and all predictions in their order."""
    rows, ends = [], np.cumsum([len(pieces) for pieces in windows.values()])
    for (name, pieces), prediction in zip(windows.items(), np.split(predicted, ends[:-1])):
        with _named(f"recording {name!r}"):
            judged = judge(pieces, prediction, range_over=range_over)
        rows += [{"recording": name, "horizon": seconds, **row} for row in judged]
    return pd.DataFrame(rows)


def judge(
    windows: Recording, predicted: np.ndarray, *, range_over: str = "all", samples: slice = slice(None)
) -> list[dict]:
    """Per angle ``angle, enr, bfr, nrmse, windows, diverged`` of one recording's windows; see `score`.

    ``predicted`` is (windows, samples, n). With ``samples`` these alone count; the range is that of the whole windows.
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


def error_growth(windows: Recording, predicted: np.ndarray, *, every: int = 1) -> pd.DataFrame:
    """Root mean square error at each instant after the start, in percent of the range; arguments as for `judge`.

    Returns
    -------
    pandas.DataFrame
        Columns ``time`` (s), ``angle, nrmse``; every ``every``-th sample, without the first, whose error is zero.
        Diverged windows are left out; NaN if all are. The range is that of all windows.
    """
    true = windows.states
    span = np.ptp(true, axis=(0, 1))
    bounded = ~metrics.diverged(true, predicted, span=span)
    times = np.arange(every, true.shape[1], every)
    parts = []
    for angle, i in _columns(windows, span).items():
        error = true[bounded][:, times, i] - predicted[bounded][:, times, i]
        rms = 100 * np.sqrt(np.mean(error**2, axis=0)) / span[i] if bounded.any() else np.full(len(times), np.nan)
        parts.append(pd.DataFrame({"time": times * windows.dt, "angle": angle, "nrmse": rms}))
    return pd.concat(parts, ignore_index=True)


def typical_window(windows: Recording, predicted: np.ndarray) -> int:
    """Index of the window whose mean NRMSE of the two angles is the median one: neither best nor worst."""
    span = np.ptp(windows.states, axis=(0, 1))
    i = [*_columns(windows, span).values()]
    true, predicted = windows.states[..., i], predicted[..., i]
    error = np.sqrt(np.mean((true - predicted) ** 2, axis=1)) / span[i]
    error = np.nan_to_num(error.mean(axis=1), nan=np.inf)
    return int(np.argsort(error, kind="stable")[(len(error) - 1) // 2])


def overlay(window: Recording, predicted: dict[str, np.ndarray], whole: Recording | None = None) -> pd.DataFrame:
    """Truth and predictions over one window, as the table behind Fig. 3.

    Parameters
    ----------
    window : Recording
        Of one trajectory.
    predicted : dict of str to (samples, n) ndarray
    whole : Recording, optional
        The recording that the window is part of.

    Returns
    -------
    pandas.DataFrame
        ``time`` (s) and, in rad, ``phi_true, psi_true`` and ``phi_NAME, psi_NAME`` for each prediction; with ``whole``
        also its range in every row, ``phi_low, phi_high, psi_low, psi_high``.
    """
    table = pd.DataFrame({"time": np.arange(window.lengths[0]) * window.dt})
    for channel in ANGLES.values():
        i = window.state_names.index(channel)
        for name, states in ({"true": window.states[0]} | predicted).items():
            table[f"{channel}_{name}"] = states[:, i]
        if whole is not None:
            values = np.concatenate(list(whole.states))[:, i]
            table[f"{channel}_low"], table[f"{channel}_high"] = values.min(), values.max()
    return table


@contextlib.contextmanager
def _named(what):
    """Errors inside begin with ``what`` they are of."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{what}: {error}") from error


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


# Free runs of many models at once. A free run is tens of thousands of steps one after the other, and Python's cost of a
# step hardly depends on how many models take it. Models of one structure have the same dictionary in scaled channels.


def field_of(model: KoopmanModel) -> dict:
    """What a roll-out of a model with ``vector_field`` needs beside its dictionary, as lists and numbers.

    Raises
    ------
    ValueError
        If the model predicts in another way, or is confined to its training data.
    """
    if not _stackable(model):
        needed = "predictor='vector_field' and extrapolation='functions'"
        raise ValueError(f"only models with {needed} can be stacked; fit one with these options.")
    scales = {name: getattr(model, f"{name}_").tolist() for name in ("x_offset", "x_scale", "u_offset", "u_scale")}
    return {"W": model.W_.tolist(), "substeps": model.substeps_, "delays": model.delays, "dt": model.dt_, **scales}


def _stackable(model):
    return model.predictor == "vector_field" and model.hull_ is None


def alike(models: list[KoopmanModel]) -> list[list[int]]:
    """Numbers of the models that can be rolled out together, in the order of first members; others stand alone."""
    groups = {}
    for i, model in enumerate(models):
        key = i
        if _stackable(model):
            channels = model.dictionary_.n_states_ + model.dictionary_.n_inputs_
            some = np.random.default_rng(0).uniform(-1, 1, (channels, 5))  # values there tell dictionaries apart
            values = model.dictionary_.lift(some).tobytes()
            key = model.delays, model.substeps_, model.dt_, len(model.state_names_), values
        groups.setdefault(key, []).append(i)
    return list(groups.values())


def _predict_together(models, recordings):
    """``model.predict(recording)`` for each model of a group of `alike`; trajectories equal in number and length."""
    if len(models) == 1:
        return [models[0].predict(recordings[0])]
    recordings = [model.channels_.matched(recording) for model, recording in zip(models, recordings)]
    starts = np.stack([recording.states[:, : model.delays + 1] for model, recording in zip(models, recordings)])
    inputs = np.stack([recording.inputs for recording in recordings])
    return list(free_runs(models[0].dictionary_, [field_of(model) for model in models], starts, inputs))


def free_runs(dictionary: Dictionary, fields: list[dict], starts: np.ndarray, inputs: np.ndarray) -> np.ndarray:
    """Every model's prediction of its own runs.

    Parameters
    ----------
    dictionary : Dictionary
        Fitted, of scaled channels; the same one for all models.
    fields : list of dict
        From `field_of`, one per model; delays, substeps and sampling time alike.
    starts : (models, runs, delays + 1, n) ndarray
        First samples, in physical units.
    inputs : (models, runs, samples, m) ndarray

    Returns
    -------
    (models, runs, samples, n) ndarray
        As `KoopmanModel.simulate` gives it: NaN from where a prediction is abandoned.
    """
    shared = {tuple(field[name] for name in ("delays", "substeps", "dt")) for field in fields}
    if len(shared) != 1:
        raise ValueError(f"fields differ in (delays, substeps, dt): {sorted(shared)}; stack only models that agree.")
    ((d, substeps, dt),) = shared
    W = np.array([field["W"] for field in fields])
    x_offset, x_scale, u_offset, u_scale = (  # (models, 1, 1, channels), for (models, runs, samples, channels)
        np.array([field[name] for field in fields])[:, None, None]
        for name in ("x_offset", "x_scale", "u_offset", "u_scale")
    )
    (models, runs, samples, m), n = inputs.shape, starts.shape[-1]
    z = (starts - x_offset) / x_scale
    z = z[:, :, ::-1].reshape(models * runs, -1).T.copy()  # newest first
    u = ((inputs - u_offset) / u_scale)[:, :, d:].transpose(2, 3, 0, 1).reshape(samples - d, m, -1)

    def field(point):
        psi = dictionary.lift(point).reshape(-1, models, runs)
        return np.matmul(W, psi.transpose(1, 0, 2)).transpose(1, 0, 2).reshape(-1, models * runs)

    def advance(z, held):
        later = rollout.runge_kutta(field, z, held, dt, substeps)
        later[n : n * (d + 1)] = z[: n * d]  # what is known of the earlier samples is shifted, not predicted
        return later

    rolled = rollout.roll_out(advance, z, u)[:, :n].reshape(samples - d, n, models, runs).transpose(2, 3, 0, 1)
    return np.concatenate([starts, (rolled * x_scale + x_offset)[:, :, 1:]], axis=2)
