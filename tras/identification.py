"""From a recording of a rig to a model and an honest verdict, in one call; `tras.identify_command` makes files of it."""

from typing import NamedTuple

import numpy as np
import pandas as pd
from sklearn.base import clone

from tras import advice, datachecks, preparation
from tras.ensemble import bootstrap, prediction_band
from tras.identify_scores import compare, growth, typical_and_worst
from tras.identify_search import search
from tras.recording import join
from tras.threads import one_blas_thread

FITTED = 2_000_000  # snapshot pairs of the final fit, at most
TESTED = 60_000  # and of the test
_DRAWN = 8_000  # of one member of the ensemble
CHOSEN, LINEAR = "model", "linear model"


class Identification(NamedTuple):
    """What `identify` found.

    ``recording`` as used (idle channels left out), ``train`` (the pieces that the model was fitted to) and ``test`` (windows as measured);
    ``checks`` (`tras.datachecks.Checks`), ``search`` (every candidate), ``model``, ``linear``; the tables ``metrics, growth, overlay, eigenvalues``; ``pairs``
    of position and velocity; ``ensemble``; ``said``, how it went; ``advice``, what to mind.
    """

    recording: object
    train: object
    test: object
    checks: datachecks.Checks
    search: pd.DataFrame
    model: object
    linear: object
    metrics: pd.DataFrame
    growth: pd.DataFrame
    overlay: pd.DataFrame
    eigenvalues: pd.DataFrame
    pairs: list
    ensemble: list
    said: dict
    advice: list


def identify(recording, *, predictor=None, delays=None, smoothing=None, draws=30, seed=0):
    """Check, cut, search, fit, test: a model of a recording of which nothing else is known.

    Parameters
    ----------
    recording : Recording or sequence of them
        As read: uncut, in any units.
    predictor : {"vector_field", "one_step", "lifted_linear"}, optional
        The only one to try.
    delays : sequence of int, optional
        The only numbers of delays to try.
    smoothing : bool, optional
        Whether states are smoothed before the fit; both are tried if there is noise.
    draws : int
        Members of the bootstrap behind the band, 0 for none.
    seed : int
        Of the bootstrap.

    Returns
    -------
    Identification

    Raises
    ------
    ValueError
        If nothing moves, the recording is too short, or no model can be fitted; the sentence says what to do.

    Examples
    --------
    >>> from tras.examples import example
    >>> found = identify(example("duffing", trials=6), predictor="one_step", delays=[0], smoothing=False, draws=0)
    >>> found.model.dictionary
    Mechanical(degree=3, positions=[0], shape=[0], velocities=[1])
    """
    with one_blas_thread():  # small matrices: threads wait for each other; and the same bits everywhere
        return _identify(join(recording), predictor, delays, smoothing, draws, seed)


def _identify(log, predictor, delays, smoothing, draws, seed):
    used, idle = preparation.without_idle_channels(log)
    whole, test, parted = preparation.partition(used)
    samples, length = preparation.piece_length(whole)
    pairs = preparation.velocity_pairs(whole)
    lag = max(1, preparation.memory(whole) // 4)
    checks = datachecks.check(used, lag)
    table, searched = search(whole, samples, pairs, predictor=predictor, delays=delays, smoothing=smoothing)
    latest = int(max(row for row in table["delays"]))
    truth, starts = _windows(test, samples, pairs, latest, set(table["states"]))
    pieces = {name: _pieces(whole, samples, pairs, latest, name) for name in set(table["states"])}
    row, model = _fitted(table, pieces)
    linear_row, linear = _fitted(table[table["dictionary"] == "Monomials(degree=1)"], pieces)
    table["chosen"] = table.index == row.name
    train = pieces[row["states"]]
    models = {CHOSEN: (model, starts[row["states"]]), LINEAR: (linear, starts[linear_row["states"]])}
    if row["states"] == "smoothed":
        models["model, started as measured"] = (model, truth)
    metrics, runs = compare(models, truth, train, latest)
    ensemble, no_band = _ensemble(model, train, draws, seed)
    said = {"idle": idle, "partition": [parted, length], "search": searched, "pairs": _paired(pairs), "treatment": row["states"], "band": no_band}
    found = Identification(
        used, train, truth, checks, table, model, linear, metrics, growth(runs, truth, latest),
        _overlay(runs, truth, starts[row["states"]], model, ensemble, latest), _eigenvalues(model, linear), pairs, ensemble, said, [],
    )  # fmt: skip
    return found._replace(advice=advice.of(found, log))


def _windows(test, samples, pairs, latest, treatments):
    """Test windows as measured, and what predictions start from under each treatment."""
    fewest = latest + 5
    chosen = preparation.thinned(test.cut_all(2001), 2 * TESTED)
    truth = preparation.in_pieces(chosen, samples, fewest)
    if truth.lengths.min() <= latest + 1:
        raise ValueError(
            f"the trajectories kept for the test have {int(truth.lengths.max())} samples, too few for {latest} delays: record longer, or try fewer delays."
        )
    starts = {name: truth if name == "as measured" else preparation.in_pieces(preparation.smoothed(chosen, pairs), samples, fewest) for name in treatments}
    thin = np.unique(np.linspace(0, len(truth) - 1, max(2, min(len(truth), int(len(truth) * TESTED / max(truth.pairs, 1))))).astype(int))
    return truth[thin], {name: each[thin] for name, each in starts.items()}


def _pieces(whole, samples, pairs, latest, name):
    """What a model is fitted to under one treatment."""
    chosen = preparation.thinned(whole.cut_all(2001), FITTED)
    return preparation.in_pieces(preparation.smoothed(chosen, pairs) if name == "smoothed" else chosen, samples, latest + 5)


def _fitted(table, pieces):
    """The chosen candidate, or the best of these, fitted to all pieces; the next one if that has no logarithm, say."""
    order = table[np.isfinite(table["error"])].sort_values(["chosen", "error"], ascending=[False, True], kind="stable")
    reason = None
    for _, row in order.iterrows():
        try:
            return row, clone(row["model"]).fit(pieces[row["states"]])
        except ValueError as error:
            reason = error
    raise ValueError(f"no candidate could be fitted to all of the training data{f': {reason}' if reason else ''}")


def _ensemble(model, train, draws, seed):
    """The bootstrap, and why there is none."""
    some = preparation.thinned(train, _DRAWN)
    if not draws:
        return [], "no band was asked for"
    try:
        return bootstrap(model, some, draws, seed), ""
    except ValueError as error:
        return [], str(error)


def _overlay(runs, truth, starts, model, ensemble, latest):
    """Two windows as one table: ``window`` ("typical", "worst"), ``time`` (s) and for each state ``STATE: true, model, linear model, lower, upper``."""
    chosen, first, parts = typical_and_worst(runs[CHOSEN], truth, latest), latest - model.delays, []
    late = starts.with_data([starts.states[k][first:] for k in chosen], [starts.inputs[k][first:] for k in chosen])
    band = prediction_band(ensemble, late) if ensemble else [np.full((2, len(late.states[0]), truth.n), np.nan)] * 3
    for j, (name, k) in enumerate(zip(("typical", "worst"), chosen)):
        true, bands = truth.states[k][latest:], [edge[j][model.delays :] for edge in band]
        table = {"window": name, "time": np.arange(len(true)) * truth.dt}
        for i, state in enumerate(truth.state_names):
            columns = (("true", true), (CHOSEN, runs[CHOSEN][k]), (LINEAR, runs[LINEAR][k]), ("lower", bands[0]), ("upper", bands[2]))
            table |= {f"{state}: {kind}": values[:, i] for kind, values in columns}
        parts.append(pd.DataFrame(table))
    return pd.concat(parts, ignore_index=True)


def _eigenvalues(model, linear):
    """Eigenvalues of both: ``model, real, imag, modulus``, and of their logarithms ``rate`` (1/s) and ``frequency`` (Hz)."""
    parts = []
    for name, each in ((CHOSEN, model), (LINEAR, linear)):
        values = each.eigenvalues
        with np.errstate(divide="ignore"):
            logarithm = np.log(values.astype(complex)) / each.dt_
        columns = {"real": values.real, "imag": values.imag, "modulus": np.abs(values), "rate": logarithm.real, "frequency": logarithm.imag / (2 * np.pi)}
        parts.append(pd.DataFrame({"model": name, **columns}))
    return pd.concat(parts, ignore_index=True)


def _paired(pairs):
    return [f"the velocity of {position} is {velocity}, by their numbers" for position, velocity in pairs]
