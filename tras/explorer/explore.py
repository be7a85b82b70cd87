"""From a choice to its outcome: simulate, identify, predict, judge. `tras.explorer.widgets` shows the outcome.

A cache holds the simulated recordings, so a change of the model costs a fit and two predictions.
"""

import functools
import math
from dataclasses import dataclass

import numpy as np
import pandas as pd

from tras.dictionaries.mechanical import Mechanical
from tras.dictionaries.monomials import Monomials
from tras.dictionaries.radial import GaussianRBF
from tras.dictionaries.waves import Exponentials, Fourier
from tras.explorer.choice import Choice, ChoiceError
from tras.identification.noise import add_noise
from tras.model import KoopmanModel
from tras.paper import grid, validation
from tras.paper.readings import PAPER_NRMSE, Readings
from tras.recording import Recording
from tras.twin_rotor.closed_loop import INPUTS

TRAJECTORY = 5.0  # s, pieces of the training recording
TRAIN_FRACTION, SPLIT_SEED = 0.8, 0  # as in 02_identification
MOST = 300  # functions; more take seconds


@dataclass(frozen=True)
class Outcome:
    """What a choice leads to.

    Attributes
    ----------
    choice : Choice
    model, linear : KoopmanModel
        The chosen model, and one of degree 1 by least squares from the same data (None if the data give none).
    metrics : pandas.DataFrame
        ``model`` ("Koopman", "linear", "paper"), ``angle, nrmse`` (%), ``enr, bfr`` (%), ``windows, diverged``.
    overlay : pandas.DataFrame
        The typical window: ``time`` (s) and in rad ``phi_true, phi_koopman, phi_linear`` and the same for ``psi``.
    growth : pandas.DataFrame
        ``model, angle, time`` (s), ``nrmse`` (%) of all windows at that time.
    spectrum : pandas.DataFrame
        ``model, real, imag`` of the eigenvalues of K.
    window : Recording
        The typical window itself.
    remarks : tuple of str
        Sentences that qualify the pictures.
    """

    choice: Choice
    model: KoopmanModel
    linear: KoopmanModel | None
    metrics: pd.DataFrame
    overlay: pd.DataFrame
    growth: pd.DataFrame
    spectrum: pd.DataFrame
    window: Recording
    remarks: tuple[str, ...]


def explore(choice: Choice) -> Outcome:
    """The `Outcome` of a choice: its model, judged on an independent recording beside the linear model and the paper.

    Raises
    ------
    ChoiceError
        (a ValueError) If the choice gives no model; the message says why and what to change.

    Examples
    --------
    >>> outcome = explore(Choice(input="torque", dictionary="mechanical", size=8, field="coordinates", duration=60.0))
    >>> outcome.metrics.pivot(index="angle", columns="model", values="nrmse").round(2)
    model  Koopman  linear  paper
    ...
    """
    train, fresh = training(choice), validation_windows(choice)
    model = identify(choice, train)
    models, absent = {"Koopman": model}, []
    try:
        models["linear"] = identify(choice.replaced(dictionary="linear", regularization="none"), train)
    except ChoiceError as error:
        absent = [f"There is no linear model to compare with: {error}"]
    with np.errstate(all="ignore"):  # the metrics count predictions that diverge
        predictions = {name: each.predict(fresh) for name, each in models.items()}
    metrics, growth, spectrum = [], [], []
    range_over, every = grid.RANGES[choice.nrmse_range], max(1, fresh.states.shape[1] // 120)
    for name, each in models.items():
        metrics += [{"model": name, **row} for row in validation.judge(fresh, predictions[name], range_over=range_over)]
        growth.append(validation.error_growth(fresh, predictions[name], every=every).assign(model=name))
        spectrum.append(pd.DataFrame({"model": name, "real": each.eigenvalues.real, "imag": each.eigenvalues.imag}))
    typical = validation.typical_window(fresh, predictions["Koopman"])
    absent_states = np.full_like(fresh.states, np.nan)
    runs = {name.lower(): predictions.get(name, absent_states)[typical] for name in ("Koopman", "linear")}
    papers = [{"model": "paper", "angle": angle, "nrmse": nrmse} for angle, nrmse in PAPER_NRMSE.items()]
    growth, spectrum = (pd.concat(tables, ignore_index=True) for tables in (growth, spectrum))
    table, overlay = pd.DataFrame(metrics + papers), validation.overlay(fresh[typical], runs)
    remarks = (*_remarks(model, metrics), *absent)
    return Outcome(choice, model, models.get("linear"), table, overlay, growth, spectrum, fresh[typical], remarks)


def numbers(outcome: Outcome) -> pd.DataFrame:
    """The metrics as a table of text for the reader.

    Rows: NRMSE, Enr, BFR of yaw and pitch, and predictions that ran away; columns ``Koopman, linear, paper``.
    """
    rows = {}
    for label, column in (("NRMSE (%)", "nrmse"), ("Enr", "enr"), ("BFR (%)", "bfr")):
        for angle in validation.ANGLES:
            cells = rows[f"{label}, {angle}"] = {}
            for _, row in outcome.metrics[outcome.metrics["angle"] == angle].iterrows():
                missing = "none left" if row["windows"] > 0 else ""
                cells[row["model"]] = f"{row[column]:.4g}" if np.isfinite(row[column]) else missing
    yaw = outcome.metrics.query("angle == 'yaw' and windows > 0")
    rows["ran away"] = {row["model"]: f"{row['diverged']:g} of {row['windows']:g}" for _, row in yaw.iterrows()}
    table = pd.DataFrame.from_dict(rows, orient="index").reindex(columns=["Koopman", "linear", "paper"]).fillna("")
    table.loc[["NRMSE (%), yaw", "NRMSE (%), pitch"], "paper"] = [f"{value}" for value in PAPER_NRMSE.values()]
    return table


# --- the steps ---


@functools.lru_cache(maxsize=8)
def recording(frequency_unit: str, duration: float, sampling_time: float, seed: int) -> Recording:
    """The experiment of 01_data_generation under these choices, with all channels."""
    _samples("duration", duration, sampling_time)
    study = grid.Study(duration=duration, sampling_time=sampling_time)
    try:
        return grid.simulate(study, Readings(frequency_unit=frequency_unit).model_dump(), seed)
    except ValueError as error:
        raise ChoiceError(f"This experiment cannot be simulated: {error}") from error


def training(choice: Choice) -> Recording:
    """The chosen channels of four fifths of the training trajectories, with noise."""
    whole = _channels(recording(choice.frequency_unit, choice.duration, choice.sampling_time, choice.seed), choice)
    if choice.noise:
        whole = add_noise(whole, choice.noise / 100, choice.seed)
    return _cut(whole, 3, "a trajectory", TRAJECTORY).split(TRAIN_FRACTION, SPLIT_SEED)[0]


def validation_windows(choice: Choice) -> Recording:
    """Windows of an independent realisation without noise, that of the next seed."""
    fresh = recording(choice.frequency_unit, choice.duration, choice.sampling_time, choice.seed + 1)
    return _cut(_channels(fresh, choice), 1, "horizon", choice.horizon)


def identify(choice: Choice, train: Recording) -> KoopmanModel:
    """The chosen model, fitted to a recording from `training`.

    Raises
    ------
    ChoiceError
        If there are too many functions, too few data, or no logarithm of K.
    """
    model = unfitted(choice)
    count = _functions(model, train)
    if count > MOST:
        remedy = f"choose a smaller size or fewer delays (at most {MOST} functions)"
        raise ChoiceError(f"These are {count} functions, which take seconds per change: {remedy}.")
    try:
        with np.errstate(all="ignore"):  # a fit that fails raises
            return model.fit(train)
    except np.linalg.LinAlgError as error:
        remedy = "Take F from the columns of A (field = coordinates), or fewer functions."
        raise ChoiceError(f"There is no model: equation (18) is singular for this dictionary. {remedy}") from error
    except ValueError as error:
        raise ChoiceError(f"There is no model: {error}") from error


def unfitted(choice: Choice) -> KoopmanModel:
    """The chosen `KoopmanModel` before any data."""
    size = choice.size
    dictionaries = {
        "gaussian": lambda: GaussianRBF(size, float(choice.width), choice.seed - 1),  # seed 1: centres 0, as in 02
        "linear": lambda: Monomials(1),
        "monomials": lambda: Monomials(size),
        "exponentials": lambda: Exponentials(size),
        "fourier": lambda: Fourier(size),
        "mechanical": lambda: Mechanical(size),
    }
    options = {"field": choice.field, "extrapolation": choice.extrapolation, "regularization": None, "strength": 0.0}
    if choice.regularization != "none":
        options |= {"regularization": choice.regularization, "strength": float(choice.strength)}
    return KoopmanModel(dictionaries[choice.dictionary](), choice.predictor, choice.delays, **options)


def _channels(whole, choice):
    return whole.select(states=grid.STATES[choice.state][0], inputs=INPUTS[choice.input])


def _cut(whole, least, name, seconds):
    """Pieces of ``seconds`` s each, at least ``least`` of them."""
    samples = _samples(name, seconds, whole.dt)
    total = (whole.lengths[0] - 1) * whole.dt
    if total < least * seconds * (1 - 1e-9):
        pieces = f"{least} trajectories" if least > 1 else f"one {name}"
        raise ChoiceError(f"duration is {total:g} s, too short for {pieces} of {seconds:g} s: choose a longer one.")
    return whole.cut(samples + 1)


def _samples(name, seconds, dt):
    samples = round(seconds / dt)
    if samples < 1 or abs(samples * dt - seconds) > 1e-9 * seconds:
        raise ChoiceError(f"{name} is {seconds:g} s, no whole number of samples of {dt:g} s: change either of them.")
    return samples


def _functions(model, train):
    """Number of functions that the dictionary will have; 0 if it is certainly small enough."""
    lifts_inputs = model.predictor != "lifted_linear"
    past_inputs = train.m * model.delays * (model.predictor != "vector_field")
    channels = train.n * (model.delays + 1) + past_inputs + train.m * lifts_inputs
    if isinstance(model.dictionary, Monomials):  # counted, not built: there may be a million
        return math.comb(channels + model.dictionary.degree, model.dictionary.degree)
    if isinstance(model.dictionary, (Exponentials, Fourier)):
        return 1 + channels + 2 * channels * (1 if model.dictionary.order == 1 else channels + 1)
    if isinstance(model.dictionary, GaussianRBF):
        return 1 + channels + model.dictionary.n_centres
    return 0  # mechanical: its degree limits it


def _remarks(model, rows):
    diverged = {row["model"]: row for row in rows if row["diverged"]}
    for name, row in diverged.items():
        count = f"{row['diverged']} of {row['windows']}"
        yield f"{count} predictions of the {name} model ran away; the errors are those of the others."
    radius = np.abs(model.eigenvalues).max()
    if radius > 1 + 1e-6:
        reason = "it belongs to a function whose motion the dictionary cannot express"
        yield f"K has an eigenvalue outside the unit circle ({radius:.6f}): {reason}."
    if model.condition_number > 1e8:
        yield f"On these data the functions are nearly dependent (condition number {model.condition_number:.0e})."
