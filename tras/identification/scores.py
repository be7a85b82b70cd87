"""How well models predict trajectories by which nothing was chosen or fitted, beside two trivial predictions."""

from functools import cache

import numpy as np
import pandas as pd

from tras import metrics
from tras.identification.search import roll_outs
from tras.recording import Recording

CONSTANT, HELD = "mean of the training data", "stays where it is"
_ONE_STEP = 20_000  # predictions over one sample, at most
_STILL = 0.05  # range of a state in the test over that in training below which the test says nothing of it


def compare(
    models: dict, windows: Recording, whole: Recording, train: Recording, latest: int
) -> tuple[pd.DataFrame, dict]:
    """Metrics of every state over windows and free runs, one row per state and prediction.

    Parameters
    ----------
    models : dict of str to KoopmanModel
    windows, whole : Recording
        Windows of the test and the whole test, as measured: all predictions start from these.
    train : Recording
        For its mean, and its range where a state does not move in the test.
    latest : int
        The sample that all predictions begin at.

    Returns
    -------
    table : pandas.DataFrame
        ``state, prediction, one_step`` (NRMSE over one sample, %), ``nrmse, bfr`` (%), ``enr`` (fraction), ``windows,
        diverged`` over the windows, ``free, free_bfr`` (NRMSE and BFR in %) over free runs of the whole test, ``moves``
        (whether the state does, in the test), ``horizon, free_horizon`` (how long they are, in s). The metrics are over
        the windows in which no model ran away, the same ones for all; a free run that diverged has an infinite error.
    runs : dict of str to list of (samples_i, n)
        The predictions over the windows.
    """
    true, full = [x[latest:] for x, _ in windows], [x[latest:] for x, _ in whole]
    past = np.concatenate([x for x, _ in train])
    span, usual = np.ptp(np.concatenate(full), axis=0), np.ptp(past, axis=0)
    moves = span > _STILL * usual
    span = np.where(moves, span, usual)
    horizons = {
        name: (max(map(len, part)) - 1) * windows.dt for name, part in (("horizon", true), ("free_horizon", full))
    }

    @cache  # a model may stand there under two names
    def predicted(model):
        return roll_outs(model, windows, latest), roll_outs(model, whole, latest), _one_step(model, windows, span)

    runs, free = ({name: predicted(model)[i] for name, model in models.items()} for i in (0, 1))
    for into, truth in ((runs, true), (free, full)):
        into[HELD] = [np.repeat(x[:1], len(x), axis=0) for x in truth]
        into[CONSTANT] = [np.repeat(past.mean(axis=0)[None], len(x), axis=0) for x in truth]
    lost = {name: metrics.diverged(true, runs[name], span=span) for name in models}
    common = [k for k in range(len(true)) if not any(gone[k] for gone in lost.values())]
    parts = []
    for name, run in runs.items():
        # Where no window is left to all, each model is judged on those that it has.
        judged = common or [k for k in range(len(true)) if name not in lost or not lost[name][k]] or [0]
        scores = metrics.judge([true[k] for k in judged], [run[k] for k in judged], span=span)
        long = metrics.judge(full, free[name], span=span)
        one_step = predicted(models[name])[2] if name in models else np.nan
        values = {key: getattr(scores, key) for key in ("nrmse", "bfr", "enr")}
        values |= {"windows": len(true), "diverged": int(lost[name].sum()) if name in lost else 0}
        gone = long.diverged == long.windows or name in models and long.diverged
        values |= {"free": np.inf if gone else long.nrmse, "free_bfr": 0.0 if gone else long.bfr, "moves": moves}
        values |= horizons
        parts.append(pd.DataFrame({"state": windows.state_names, "prediction": name, "one_step": one_step, **values}))
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


def _one_step(model, windows, span):
    """NRMSE (%) of predictions over one sample."""
    count = model.delays + 2
    parts = []
    for x, u in windows:
        ends = range(count, len(x) + 1, count - 1)
        parts += [(x[end - count : end], u[end - count : end]) for end in ends]
    states, inputs = map(list, zip(*parts[:: max(1, len(parts) // _ONE_STEP)]))
    with np.errstate(over="ignore", invalid="ignore"):
        predicted = np.asarray(model.predict(windows.with_data(states, inputs)))[:, -1:]
    return metrics.judge(np.array([x[-1:] for x in states]), predicted, span=span).nrmse
