"""From a recording of a rig to a model and an honest verdict, in one call."""

from functools import partial
from typing import NamedTuple

import numpy as np
import pandas as pd
from sklearn.base import clone

from tras.identification import advice, preparation
from tras.identification import checks as datachecks
from tras.identification.bootstrap import bootstrap, prediction_band
from tras.identification.scores import compare, growth, typical_and_worst
from tras.identification.search import search, without_first
from tras.recording import join
from tras.solver.threads import one_blas_thread

FITTED = 2_000_000  # snapshot pairs of the final fit, at most
TESTED = 60_000  # of the test, at most
_DRAWN = 8_000  # of each member of the ensemble, about
CHOSEN, LINEAR = "model", "linear model"


class Identification(NamedTuple):
    """The result of `identify`.

    ``recording`` as used (without idle channels), ``train`` (the pieces that the model was fitted to) and ``test``
    (windows as measured); ``checks`` (`tras.identification.checks.Checks`), ``search`` (every candidate), ``model``, ``linear``;
    the tables ``metrics, growth, overlay, eigenvalues``; ``pairs`` of position and velocity; ``ensemble``; ``remarks``
    on each step, by its name; ``advice``.
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
    remarks: dict
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
        Whether states are smoothed before the fit. Default: both are tried if the states are noisy.
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
    >>> from tras.identification.examples import example
    >>> recording = example("duffing", trials=6)
    >>> identification = identify(recording, predictor="one_step", delays=[0], smoothing=False, draws=0)
    >>> identification.model.dictionary
    Mechanical(degree=3, positions=[0], shape=[0], velocities=[1])
    """
    with one_blas_thread():  # small matrices: threads wait for each other; and the same bits everywhere
        return _identify(join(recording), predictor, delays, smoothing, draws, seed)


def _identify(log, predictor, delays, smoothing, draws, seed):
    prepared = preparation.prepare(log)
    pairs, samples = prepared.pairs, prepared.samples
    checks = datachecks.check(prepared.recording, max(1, prepared.memory // 4))
    train_treatments = preparation.Treatments(prepared.train, pairs, FITTED)
    test_treatments = preparation.Treatments(prepared.test, pairs, 2 * TESTED)
    table, search_remarks = search(train_treatments, samples, predictor=predictor, delays=delays, smoothing=smoothing)
    latest = int(table["delays"].max())
    pieces = partial(train_treatments.pieces, samples=samples, fewest=latest + 5)
    windows = partial(test_treatments.pieces, samples=samples, fewest=latest + 5, most=TESTED)
    truth = windows("as measured")
    if truth.lengths.min() <= latest + 1:
        raise ValueError(
            f"the trajectories kept for the test have {int(truth.lengths.max())} samples, too few for {latest} delays: "
            "record longer, or try fewer delays."
        )

    row, model = _fitted(table, pieces)
    linear_row, linear = _fitted(table[table["dictionary"] == "Monomials(degree=1)"], pieces)
    table["chosen"] = table.index == row.name
    train, starts = pieces(row["states"]), windows(row["states"])
    models = {CHOSEN: (model, starts), LINEAR: (linear, windows(linear_row["states"]))}
    if row["states"] == "smoothed":
        models["model, started as measured"] = (model, truth)
    metrics, runs = compare(models, truth, train, latest)
    ensemble, no_band = _ensemble(model, train, draws, seed)
    remarks = {**prepared.remarks, "search": search_remarks, "treatment": row["states"], "band": no_band}
    identification = Identification(
        prepared.recording, train, truth, checks, table, model, linear, metrics, growth(runs, truth, latest),
        _overlay(runs, truth, starts, model, ensemble, latest), _eigenvalues(model, linear), pairs, ensemble, remarks, [],
    )  # fmt: skip
    return identification._replace(advice=advice.of(identification, log))


def _fitted(table, pieces):
    """The chosen candidate, or the best of these, fitted to all pieces; the next one if that has no logarithm, say."""
    order = table[np.isfinite(table["error"])].sort_values(["chosen", "error"], ascending=[False, True], kind="stable")
    reason = None
    for _, row in order.iterrows():
        try:
            return row, clone(row["model"]).fit(pieces(row["states"]))
        except ValueError as error:
            reason = error
    raise ValueError(f"no candidate could be fitted to all of the training data{f': {reason}' if reason else ''}")


def _ensemble(model, train, draws, seed):
    """The bootstrap, and why there is none."""
    if not draws:
        return [], "no band was asked for"
    try:
        return bootstrap(model, preparation.thinned(train, _DRAWN), draws, seed), ""
    except ValueError as error:
        return [], str(error)


def _overlay(runs, truth, starts, model, ensemble, latest):
    """Two windows: ``window`` ("typical", "worst"), ``time`` (s), ``STATE: true, model, linear model, lower, upper``."""
    windows, tables = typical_and_worst(runs[CHOSEN], truth, latest), []
    late = without_first(starts[list(windows)], latest - model.delays)
    band = prediction_band(ensemble, late) if ensemble else [np.full((2, len(late.states[0]), truth.n), np.nan)] * 3
    for j, (name, k) in enumerate(zip(("typical", "worst"), windows)):
        true, (lower, _, upper) = truth.states[k][latest:], [edge[j][model.delays :] for edge in band]
        table = {"window": name, "time": np.arange(len(true)) * truth.dt}
        for i, state in enumerate(truth.state_names):
            columns = (
                ("true", true),
                (CHOSEN, runs[CHOSEN][k]),
                (LINEAR, runs[LINEAR][k]),
                ("lower", lower),
                ("upper", upper),
            )
            table |= {f"{state}: {kind}": values[:, i] for kind, values in columns}
        tables.append(pd.DataFrame(table))
    return pd.concat(tables, ignore_index=True)


def _eigenvalues(model, linear):
    """Eigenvalues: ``model, real, imag, modulus``, and of their logarithms ``rate`` (1/s) and ``frequency`` (Hz)."""
    tables = []
    for name, fitted in ((CHOSEN, model), (LINEAR, linear)):
        values = fitted.eigenvalues
        with np.errstate(divide="ignore"):
            logarithm = np.log(values.astype(complex)) / fitted.dt_
        columns = {
            "real": values.real,
            "imag": values.imag,
            "modulus": np.abs(values),
            "rate": logarithm.real,
            "frequency": logarithm.imag / (2 * np.pi),
        }
        tables.append(pd.DataFrame({"model": name, **columns}))
    return pd.concat(tables, ignore_index=True)
