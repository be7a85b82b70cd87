"""From a recording of a rig to a model and an honest verdict, in one call."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pandas as pd
from sklearn.base import clone

from tras.dictionaries.base import label
from tras.identification import advice, preparation
from tras.identification.actuators import find_actuators
from tras.identification.advice import AdviceList, verdict
from tras.identification.bootstrap import bootstrap, prediction_band
from tras.identification.checks import Checks, check
from tras.identification.scores import compare, growth, typical_and_worst
from tras.identification.search import CLOSE, LINEAR_DICTIONARY, best, search, without_first
from tras.model import KoopmanModel
from tras.recording import Recording, join
from tras.solver.threads import one_blas_thread
from tras.workflow.arguments import short

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FITTED = 2_000_000  # snapshot pairs of the final fit, at most
TESTED = 60_000  # of the test, at most
_DRAWN = 8_000  # of each member of the ensemble, about
CHOSEN, LINEAR = "model", "linear model"


class Identification(NamedTuple):
    """The result of `identify`: a notebook shows its verdict, what to mind and the test."""

    recording: Recording  # as used: without idle channels
    train: Recording  # what the tested model was fitted to
    test: Recording  # windows, as measured
    whole_test: Recording  # uncut, for the free run
    checks: Checks
    search: pd.DataFrame  # every candidate
    model: KoopmanModel  # the one that was tested
    linear: KoopmanModel  # the best linear one, tested beside it
    delivered: KoopmanModel  # as the tested one, fitted to all of the recording: for use
    metrics: pd.DataFrame
    growth: pd.DataFrame
    overlay: pd.DataFrame
    eigenvalues: pd.DataFrame
    pairs: list[tuple[str, str]]  # (position, velocity), names
    ensemble: list[KoopmanModel]
    remarks: dict  # step -> sentences
    advice: AdviceList

    def __repr__(self):
        count = f"{len(self.advice)} remark{'' if len(self.advice) == 1 else 's'} in .advice"
        return f"Identification: {short(label(self.model.dictionary), 80)}. {verdict(self)} {count}"

    def _repr_html_(self):
        from tras.display.html import in_notebook
        from tras.identification import page

        return in_notebook(page.summary_html(self))

    def plot(self) -> "Figure":
        """The typical and the worst window of the test: measured, the model, a linear model, the bootstrap's band."""
        from tras.identification import figures

        return figures.prediction_figure(self.overlay, list(self.test.state_names), list(self.test.state_units))


def identify(
    recording: Recording, *, predictor: str | None = None, delays: Sequence[int] | None = None,
    smoothing: bool | None = None, lead: int | None = None, every: int | None = None, horizon: float | None = None,
    draws: int = 30, seed: int = 0,
) -> Identification:  # fmt: skip
    """Check, search, fit, test: a model of a recording of which nothing else is known.

    A fifth of the recording is the test. Candidates, linear ones among them, are fitted to whole trajectories of the
    rest, less what is held out to choose by; the best ones also to predictions over a window. All predictions start
    from samples measured up to that instant.

    Parameters
    ----------
    recording : Recording or sequence of them
        As read: uncut, in any units. Its attribute ``actuators`` may name the states that follow the inputs and drive
        the body (`tras.Mechanical`); otherwise they are found by their numbers.
    predictor : {"vector_field", "one_step", "lifted_linear"}, optional
        The only one to try.
    delays : sequence of int, optional
        The only numbers of delays to try.
    smoothing : bool, optional
        Whether states are smoothed before the fit. Default: both are tried if the states are noisy.
    lead : {0, 1}, optional
        The only timing of the inputs to try (`KoopmanModel`). Default: as the recording says (``intersample``), or
        both.
    every : int, optional
        The only length of the model's step to try, in samples. Default: one sample, and longer steps where the states
        move little between samples, compared with their noise. The model then has the longer sampling time, and what it
        is used on is `Recording.decimated` by as much.
    horizon : float, optional
        How far ahead the model is to predict, in s: the length of the windows that it is chosen and tested on. Default:
        five times what the states remember.
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
        return _identify(join(recording), predictor, delays, smoothing, lead, every, horizon, draws, seed)


def _identify(log, predictor, delays, smoothing, lead, every, horizon, draws, seed):
    recording, spike_remarks = preparation.without_spikes(log)
    recording, idle_remarks = preparation.without_idle_channels(recording)
    train_log, test_log, partition_remark = preparation.partition(recording)
    lag = preparation.memory(train_log)
    samples, length_remark = preparation.window_length(train_log, lag, horizon)
    pairs = preparation.velocity_pairs(train_log, lag)
    pair_remarks = [f"the velocity of {position} is {velocity}, by their numbers" for position, velocity in pairs]
    if actuators := find_actuators(train_log, pairs):
        named, one = "actuators" in train_log.attributes, len(actuators) == 1
        kind = "an actuator, which follows" if one else "actuators, which follow"
        rule = "as the user says" if named else "by their numbers"
        verb, drive = ("is", "drives") if one else ("are", "drive")
        pair_remarks.append(f"{', '.join(actuators)} {verb} {kind} the inputs and {drive} the body, {rule}")
    training, everything = (preparation.Treatments(part, pairs, FITTED) for part in (train_log, recording))
    table, search_remarks = search(
        training, samples, predictor=predictor, delays=delays, smoothing=smoothing, lead=lead, every=every
    )
    row, model = _fitted(table, training)
    every, alike = int(row["every"]), _same_data(table, row)
    if every > 1:
        recording, train_log, test_log = (
            part.decimated(every, row["lead"]) for part in (recording, train_log, test_log)
        )
        samples, lag = -(-(samples - 1) // every) + 1, lag // every
        step_remark = (
            f"a step of the model is {every} samples ({recording.dt:.4g} s): between samples the states move little, "
            "compared with their noise; the inputs are means over a step"
        )
        search_remarks.append(step_remark)
    if model.horizon > 1:
        search_remarks.append(
            f"the model's coefficients are fitted to predictions over {model.horizon} samples, which is better in the "
            "held-out windows than a fit of single steps"
        )
    latest = int(table["delays"][alike].max())
    if test_log.lengths.max() <= latest + 5:
        raise ValueError(
            f"the trajectories kept for the test have {int(test_log.lengths.max())} samples, too few for {latest} "
            "delays: record longer, or try fewer delays."
        )
    test_log = test_log[test_log.lengths > latest + 5]
    windows = preparation.windows(test_log, samples, latest, TESTED)

    linear_row, linear = row, model
    if not (row["chosen"] and row["dictionary"] == LINEAR_DICTIONARY):
        linear_row, linear = _fitted(table[alike & (table["dictionary"] == LINEAR_DICTIONARY)], training)

    def tested():
        return compare({CHOSEN: model, LINEAR: linear}, windows, test_log, _data(training, row), latest)

    (metrics, runs), choice_remarks = tested(), []
    if remark := advice.worse_than_linear(metrics):
        choice_remarks.append(f"{short(label(model), 80)} was chosen, but {remark}; so the linear one is delivered")
        row, model = linear_row, linear
        metrics, runs = tested()
    table["chosen"] = table.index == row.name
    train = _data(training, row)
    delivered = _refitted(model, _data(everything, row))
    ensemble, no_band = [], "" if draws else "no band was asked for"
    if draws:
        pieces = train.cut_all(max(samples, 4 * (latest + 2)))
        pieces = preparation.thinned(pieces[pieces.lengths > latest + 2], _DRAWN)
        try:
            ensemble = bootstrap(model, pieces, draws, seed)
        except ValueError as error:
            no_band = str(error)
    remarks = {
        "idle": idle_remarks,
        "spikes": spike_remarks,
        "every": every,
        "partition": [partition_remark, length_remark],
        "pairs": pair_remarks,
    }
    remarks |= {"search": search_remarks, "treatment": row["states"], "band": no_band, "error": row["windows"]}
    remarks["choice"] = choice_remarks
    identification = Identification(
        recording, train, windows, test_log, check(recording, max(1, lag // 4)), table.drop(columns="squares"), model,
        linear, delivered, metrics, growth(runs, windows, latest), _overlay(runs, windows, model, ensemble, latest),
        _eigenvalues(model, linear), pairs, ensemble, remarks, AdviceList(),
    )  # fmt: skip
    return identification._replace(advice=advice.of(identification, log))


def _fitted(table, training):
    """The chosen candidate, or the best of these, fitted to whole trajectories; the next one if that cannot be."""
    table = table[np.isfinite(table["error"])].copy()
    if "chosen" not in table or not table["chosen"].any():
        table["chosen"] = table.index == best(table, CLOSE).name
    order = table.sort_values(["chosen", "error"], ascending=[False, True], kind="stable")
    reason = None
    for _, row in order.iterrows():
        try:
            recording = _long_enough(_data(training, row), row["model"])
            return row, _with_strength(row["model"], recording)
        except ValueError as error:
            reason = error
    raise ValueError(f"no candidate could be fitted to all of the training data{f': {reason}' if reason else ''}")


def _with_strength(model, recording):
    """A fit of the model with the strength that roll-outs choose for so many pairs, if there is a choice.

    A field and a fit over many steps take that of single steps, whose K is the same or the first: to roll them out for
    every strength takes longer than all the rest.
    """
    same = model.predictor == "vector_field" and not (model.delays and recording.m)
    options = {"horizon": 1} | ({"predictor": "one_step"} if same else {})
    plain = clone(model).set_params(**options).fit(recording)
    if not hasattr(plain, "errors_") and (plain.predictor, plain.horizon) == (model.predictor, model.horizon):
        return plain
    try:
        return clone(model).set_params(strength=float(plain.strength_)).fit(recording)
    except ValueError:  # without a logarithm a stronger one may do
        return _refitted(clone(model).fit(recording), recording)


def _data(treatments, row):
    """What a candidate is fitted to."""
    return treatments.whole(row["states"], int(row["every"]), int(row["lead"]))


def _same_data(table, row):
    """Which candidates predict the same samples of the same inputs as this one."""
    return (table["every"] == row["every"]) & ((row["every"] == 1) | (table["lead"] == row["lead"]))


def _refitted(model, recording):
    """The same model, with the strength that it chose, fitted to trajectories that no choice has cut.

    It stays as it is where the new data do not allow that.
    """
    try:
        return clone(model).set_params(strength=float(model.strength_)).fit(_long_enough(recording, model))
    except ValueError:
        return model


def _long_enough(recording, model):
    """The trajectories that have a snapshot pair behind the model's delays."""
    return recording[recording.lengths > model.delays + 1]


def _overlay(runs, truth, model, ensemble, latest):
    """Two windows: ``window`` ("typical", "worst"), ``time``, ``STATE: true, model, linear model, lower, upper``."""
    windows, tables = typical_and_worst(runs[CHOSEN], truth, latest), []
    late = without_first(truth[list(windows)], latest - model.delays)
    band = prediction_band(ensemble, late) if ensemble else [np.full((2, len(late.states[0]), truth.n), np.nan)] * 3
    for j, (name, k) in enumerate(zip(("typical", "worst"), windows)):
        true, (lower, _, upper) = truth.states[k][latest:], [edge[j][model.delays :] for edge in band]
        curves = {"true": true, CHOSEN: runs[CHOSEN][k], LINEAR: runs[LINEAR][k], "lower": lower, "upper": upper}
        table = {"window": name, "time": np.arange(len(true)) * truth.dt}
        for i, state in enumerate(truth.state_names):
            table |= {f"{state}: {kind}": values[:, i] for kind, values in curves.items()}
        tables.append(pd.DataFrame(table))
    return pd.concat(tables, ignore_index=True)


def _eigenvalues(model, linear):
    """Eigenvalues: ``model, real, imag, modulus``, and of their logarithms ``rate`` (1/s) and ``frequency`` (Hz)."""
    tables = []
    for name, fitted in ((CHOSEN, model), (LINEAR, linear)):
        values = fitted.eigenvalues
        with np.errstate(divide="ignore"):
            logarithm = np.log(values.astype(complex)) / fitted.dt_
        columns = {"model": name, "real": values.real, "imag": values.imag, "modulus": np.abs(values)}
        columns |= {"rate": logarithm.real, "frequency": logarithm.imag / (2 * np.pi)}
        tables.append(pd.DataFrame(columns))
    return pd.concat(tables, ignore_index=True)
