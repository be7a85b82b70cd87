"""How well models predict trajectories by which nothing was chosen or fitted, beside two trivial predictions."""

import numpy as np
import pandas as pd

from tras import metrics
from tras.identification.search import roll_outs
from tras.recording import Recording

CONSTANT, HELD = "mean of the training data", "stays where it is"
_ONE_STEP = 20_000  # predictions over one sample, at most


def compare(models: dict, truth: Recording, train: Recording, latest: int) -> tuple[pd.DataFrame, dict]:
    """Metrics of every state over windows, one row per state and prediction.

    Parameters
    ----------
    models : dict of str to (KoopmanModel, Recording)
        With what each starts from: windows as ``truth``, treated as the model wants them.
    truth : Recording
        Windows as measured.
    train : Recording
        For its mean.
    latest : int
        The sample that all predictions begin at.

    Returns
    -------
    table : pandas.DataFrame
        ``state, prediction, one_step`` (NRMSE over one sample, %), ``nrmse, bfr`` (%), ``enr`` (fraction), ``windows,
        diverged``. Windows and single steps that diverged are left out of the metrics; NaN where a state does not move.
    runs : dict of str to list of (samples_i, n)
        The predictions.
    """
    true = [x[latest:] for x, _ in truth]
    mean = np.concatenate([x for x, _ in train]).mean(axis=0)
    runs = {name: roll_outs(model, starts, latest) for name, (model, starts) in models.items()}
    runs[HELD] = [np.repeat(x[:1], len(x), axis=0) for x in true]
    runs[CONSTANT] = [np.repeat(mean[None], len(x), axis=0) for x in true]
    parts = []
    for name, run in runs.items():
        scores = metrics.judge(true, run)
        one_step = _one_step(*models[name], truth) if name in models else np.nan
        values = {name: getattr(scores, name) for name in ("nrmse", "bfr", "enr", "windows", "diverged")}
        parts.append(pd.DataFrame({"state": truth.state_names, "prediction": name, "one_step": one_step, **values}))
    return pd.concat(parts, ignore_index=True), runs


def growth(runs: dict, truth: Recording, latest: int) -> pd.DataFrame:
    """Root mean square error against the time ahead: ``time`` (s), then one column per prediction.

    Over all states in percent of their ranges, and over the windows of full length that did not diverge.
    """
    true, full, span = _full(truth, latest)
    longest = len(true[full[0]])
    table = {"time": np.arange(1, longest) * truth.dt}
    for name, run in runs.items():
        lost = metrics.diverged(true, run)
        errors = [((run[k] - true[k]) / span)[1:, np.isfinite(span)] for k in full if not lost[k]]
        table[name] = 100 * np.sqrt(np.mean(np.square(errors), axis=(0, 2))) if errors else np.full(longest - 1, np.nan)
    return pd.DataFrame(table)


def typical_and_worst(run: list, truth: Recording, latest: int) -> tuple[int, int]:
    """Two windows of full length, by index: the one with the median error, and the worst, diverged ones included."""
    true, full, span = _full(truth, latest)
    moving = np.isfinite(span)
    error = np.array([np.nan_to_num(np.mean(((run[k] - true[k]) / span)[:, moving] ** 2), nan=np.inf) for k in full])
    order = np.argsort(error, kind="stable")
    return full[order[(len(order) - 1) // 2]], full[order[-1]]


def _full(truth, latest):
    """All windows from the sample ``latest`` on, the numbers of those of full length, the ranges of the states."""
    true = [x[latest:] for x, _ in truth]
    longest = max(map(len, true))
    full = [k for k, x in enumerate(true) if len(x) == longest]
    return true, full, metrics.divisor(np.ptp(np.concatenate(true), axis=0))


def _one_step(model, starts, truth):
    """NRMSE (%) of predictions over one sample."""
    count = model.delays + 2
    parts = []
    for (s, u), (x, _) in zip(starts, truth):
        ends = range(count, len(s) + 1, count - 1)
        parts += [(s[end - count : end], u[end - count : end], x[end - 1 : end]) for end in ends]
    states, inputs, true = map(list, zip(*parts[:: max(1, len(parts) // _ONE_STEP)]))
    with np.errstate(over="ignore", invalid="ignore"):
        predicted = np.asarray(model.predict(starts.with_data(states, inputs)))[:, -1:]
    span = np.ptp(np.concatenate([x for x, _ in truth]), axis=0)
    return metrics.judge(np.array(true), predicted, span=span).nrmse
