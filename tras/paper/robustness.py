"""How the identification stands up to noise, slow sampling and short data, and how far the plant's parameters scatter.

Each study returns a table for the notebook ``05_robustness``. Noise is white and Gaussian on the states, its standard
deviation in percent of each state's range; the torques are exact. No result depends on the number of processes.
"""

import itertools
from functools import partial

import numpy as np
import pandas as pd
from sklearn.base import clone

from tras.dictionaries.mechanical import Mechanical
from tras.dictionaries.monomials import Monomials
from tras.generator import LogarithmError
from tras.identification.noise import add_noise
from tras.identification.refinement import refine
from tras.identification.smoothing import smooth
from tras.model import KoopmanModel
from tras.paper import validation
from tras.paper.physics import lumped_parameters, parameter_intervals
from tras.recording import Recording
from tras.twin_rotor.closed_loop import PID, simulate_closed_loop
from tras.twin_rotor.excitation import multisine
from tras.twin_rotor.plant import STATE_PAIRS, TORQUE_NAMES, PlantParameters
from tras.workflow.study import each

DICTIONARIES = {
    "linear": Monomials(1), "monomials2": Monomials(2), "monomials3": Monomials(3), "mechanical": Mechanical(),
}  # fmt: skip
METHODS = ("plain", "default", "smoothed", "refined")
PREDICTORS = ("vector_field", "one_step", "lifted_linear")


def _noisy(recording, level, seed):
    return add_noise(recording, level / 100, seed) if level else recording


def _identify(recording, smoothed, samples, method, segment):
    """A model with the dictionary ``Mechanical(6)`` of long trajectories, cut to ``samples`` for the fit, by a method.

    "plain": EDMD by least squares, as in the paper. "default": our regularization. "smoothed": the same on smoothed
    states. "refined": that, then its field refined by multiple shooting on the states as measured.
    """
    if method == "plain":
        return KoopmanModel(Mechanical(6), regularization=None, extrapolation="functions").fit(recording.cut(samples))
    model = KoopmanModel(Mechanical(6)).fit((recording if method == "default" else smoothed).cut(samples))
    return refine(model, recording, segment=segment) if method == "refined" else model


def noise_study(
    train: Recording, fresh: Recording, levels: list[float], seeds: list[int], samples: int, window: float, *,
    methods=METHODS, default_levels: list[float] | None = None, segment: int | None = None, processes: int = 1,
) -> tuple[pd.DataFrame, dict, dict]:  # fmt: skip
    """Prediction error against noise in the training data; validation is free of noise, from the true initial state.

    Without noise there is one seed and nothing to smooth or to refine.

    Parameters
    ----------
    train, fresh : Recording
        Long trajectories, with the plant's torques; another realisation to validate on.
    levels : sequence of float
        Noise in percent of the range.
    seeds : sequence of int
    samples : int
        Length of the training trajectories.
    window : float
        Length of the validation windows in s.
    default_levels : sequence of float, optional
        Levels at which ``"default"``, the dearest on noisy data, is tried, with the first seed; default: all.
    segment : int, optional
        As for `tras.refine`.

    Returns
    -------
    table : pandas.DataFrame
        Columns ``noise`` (%), ``seed, method, angle, nrmse`` (%; NaN without a model), ``windows, diverged, failure``
        (empty, or why there is no model: "logarithm" or "data"), ``parameter_error`` (%: the worst of the plant's eight
        parameters, from the field on the smoothed states).
    models : dict
        (noise, seed, method) -> KoopmanModel, where there is one.
    recordings : dict
        (noise, seed) -> (as measured, smoothed), two recordings.
    """
    tried = [(level, seeds[0]) for level in (levels if default_levels is None else default_levels)]
    cases = []
    for run in [(level, seed) for level in levels for seed in (seeds if level else seeds[:1])]:
        cases.append((*run, [m for m in methods if (run in tried if m == "default" else run[0] or m == "plain")]))
    shared = train, fresh, samples, window, segment
    parts = each(_noise_case, cases, shared, cost=lambda *case: (len(case[2]), case[0]), processes=processes)
    rows, models, recordings = zip(*parts)
    models = {key: model for of_case in models for key, model in of_case.items()}
    return pd.DataFrame(sum(rows, [])), models, {case[:2]: pair for case, pair in zip(cases, recordings)}


def _noise_case(train, fresh, samples, window, segment, level, seed, methods):
    """Rows, models, and the pair of recordings as measured and smoothed."""
    recording = _noisy(train, level, seed)
    smoothed = smooth(recording, STATE_PAIRS) if level else recording
    rows, models = [], {}
    for method in methods:
        case = {"noise": level, "seed": seed, "method": method}
        fit = partial(_identify, recording, smoothed, samples, method, segment)
        model, of_angles = _attempt(fit, fresh, window, **case)
        error = np.nan
        if model is not None:
            models[level, seed, method] = model
            value = lumped_parameters(model, smoothed)
            error = 100 * (value / _true_parameters(value.index) - 1).abs().max()
        rows += [{**row, "parameter_error": error} for row in of_angles]
    return rows, models, (recording, smoothed)


def _true_parameters(names):
    return pd.Series(PlantParameters().as_dict())[names].astype(float)


def _attempt(fit, fresh, window, **case):
    """The model that ``fit()`` returns, or None, and rows of both angles: its errors, or why there is none."""
    model, failure, counts = None, "", {"windows": 0, "diverged": 0}
    errors = dict.fromkeys(validation.ANGLES, np.nan)
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # of roll-outs that run away
            model = fit()
            table = validation.score(model, {"fresh": fresh}, window).set_index("angle")
        errors, counts = table["nrmse"].to_dict(), {name: int(table[name].iloc[0]) for name in counts}
    except ValueError as error:
        failure = "logarithm" if isinstance(error, LogarithmError) else "data"
    outcome = {**counts, "failure": failure}
    return model, [{**case, "angle": angle, "nrmse": error, **outcome} for angle, error in errors.items()]


def _slow_controllers(parameters):
    """PIDs stable at 0.2 s: poles at 2 rad/s for pitch, 1 rad/s for yaw, whose inertia falls to a fifth off level."""
    pitch = PID.pole_placement(parameters.J_phi, parameters.u_phi_limits, frequency=2.0, integral_rate=0.5)
    inertia = parameters.J + parameters.J_psi0
    return pitch, PID.pole_placement(inertia, parameters.u_psi_limits, frequency=1.0, damping=0.7, integral_rate=0.25)


def sampling_study(
    times: list[float], duration: float, band: list[float], peak: list[float], seeds: list[int], trajectory: float,
    window: float, *, predictors=PREDICTORS, processes: int = 1,
) -> pd.DataFrame:  # fmt: skip
    """Prediction error against the sampling time; the loop is simulated anew at each, its torques held over the sample.

    Parameters
    ----------
    times : sequence of float
        Sampling times in s.
    duration, band, peak
        Of the multisine references, as for `tras.multisine`.
    seeds : (int, int)
        Of the training and the validation realisation.
    trajectory, window : float
        Length in s of the training trajectories and of the validation windows.

    Returns
    -------
    pandas.DataFrame
        Columns ``sampling_time, dictionary, predictor, angle, nrmse`` (%), ``windows, diverged, failure`` (empty, or
        why there is no model), ``fastest`` (rad/s, the highest rate in the training data: an unstable loop shows here).
    """
    parameters = PlantParameters()

    def case(dt):
        references = [multisine(duration, dt, band, peak, seed) for seed in seeds]
        controllers = _slow_controllers(parameters)
        loops = [simulate_closed_loop(reference, dt, parameters, controllers=controllers) for reference in references]
        train, fresh = [loop.select(inputs=TORQUE_NAMES) for loop in loops]
        fastest = float(np.abs(train.states[..., [1, 3]]).max())
        pieces, rows = train.cut(round(trajectory / dt) + 1), []
        for name, predictor in itertools.product(("monomials3", "mechanical"), predictors):
            model = KoopmanModel(DICTIONARIES[name], predictor)
            about = {"sampling_time": dt, "dictionary": name, "predictor": predictor}
            rows += [
                row | {"fastest": fastest} for row in _attempt(partial(model.fit, pieces), fresh, window, **about)[1]
            ]
        return rows

    return pd.DataFrame(sum(each(case, [(dt,) for dt in times], processes=processes), []))


def length_study(
    train: Recording, levels: list[float], ratios: list[float], stretches: int, *, fits=("plain", "default"),
    dictionaries=tuple(DICTIONARIES), seed: int = 0, processes: int = 1,
) -> pd.DataFrame:  # fmt: skip
    """Where the logarithm fails: contiguous stretches of one recording, of ``ratio`` snapshot pairs per function.

    Parameters
    ----------
    train : Recording
        Its first trajectory is used.
    levels : sequence of float
        Noise in percent.
    ratios : sequence of float
        Pairs over the number of functions, N; lengths beyond the recording's are left out.
    stretches : int
        How many per length, their starts evenly spread over the recording.
    fits : sequence of {"plain", "default"}
        Least squares, as in the paper, or the model's own regularization.

    Returns
    -------
    pandas.DataFrame
        Columns ``fit, dictionary, functions, noise`` (%), ``ratio, pairs, seconds, stretches``; shares (0 to 1)
        ``no_logarithm``, ``dependent`` (functions linearly dependent on these data: no K) and their sum ``failed``.
    """
    parameters = {"plain": {"regularization": None}, "default": {}}
    recordings = {level: _noisy(train[[0]], level, seed) for level in levels}
    n, m = train.n, train.m
    cases = []
    for name in dictionaries:
        functions = len(clone(DICTIONARIES[name]).fit(np.zeros((2, n)), np.zeros((2, m))).names)
        for ratio in ratios:
            pairs = int(np.ceil(ratio * functions))
            if pairs < train.lengths[0]:
                cases += [(fit, name, functions, level, ratio, pairs) for fit in fits for level in levels]

    def case(fit, name, functions, level, ratio, pairs):
        model = KoopmanModel(DICTIONARIES[name], **parameters[fit])
        reasons = [_failure(model, piece) for piece in _stretches(recordings[level], pairs, stretches)]
        shares = {label: reasons.count(label) / stretches for label in ("no_logarithm", "dependent")}
        about = {"fit": fit, "dictionary": name, "functions": functions, "noise": level, "ratio": ratio, "pairs": pairs}
        return {**about, "seconds": pairs * train.dt, "stretches": stretches, **shares, "failed": sum(shares.values())}

    table = pd.DataFrame(each(case, cases, cost=lambda *options: options[5], processes=processes))
    by = ["fit", "noise", "functions", "dictionary", "ratio"]
    return table.sort_values(by, ascending=[False, True, True, True, True], ignore_index=True)


def _stretches(recording, pairs, count):
    starts = np.linspace(0, recording.lengths[0] - 1 - pairs, count).astype(int)
    x, u = recording.states[0], recording.inputs[0]
    labels = {name: getattr(recording, name) for name in ("state_names", "state_units", "input_names", "input_units")}
    return [Recording([x[k : k + pairs + 1]], [u[k : k + pairs + 1]], recording.dt, **labels) for k in starts]


def _failure(model, recording):
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # of roll-outs that run away while a strength is chosen
            model.fit(recording)
    except LogarithmError:
        return "no_logarithm"
    except ValueError:
        return "dependent"
    return ""


def parameter_study(cases: dict, samples: int, draws: int, *, seed: int = 0, processes: int = 1) -> pd.DataFrame:
    """The plant's parameters with 95 % intervals: 1.96 standard errors either way, by a bootstrap over trajectories.

    Without noise each draw is identified from the beginning, with the model's own strength. With noise it takes one
    Gauss-Newton step of `tras.refine` from the refined model, on the drawn trajectories, which leads to their own
    optimum up to second order in the distance; smoothing, which says only where fields are asked, is done once.

    Parameters
    ----------
    cases : dict
        Noise in percent -> (model, recording as measured, recording smoothed); the model refined where there is noise.
    samples : int
        Length of the trajectories, the units of the bootstrap.
    draws : int
        About 20 give a standard error good to a sixth, and too few quantiles for a percentile interval.

    Returns
    -------
    pandas.DataFrame
        Columns ``noise`` (%), ``parameter, true, value, standard_error, low, high`` (SI), ``error`` (% of the truth).
    """
    parts = []
    for level, (model, recording, smoothed) in sorted(cases.items()):
        again = partial(refine, model, iterations=1) if level else clone(model).set_params(strength=model.strength_).fit
        options = {"seed": seed, "pipeline": again, "points": smoothed.cut(samples), "processes": processes}
        intervals = parameter_intervals(model, recording.cut(samples), draws, **options)
        value, spread = intervals["value"], intervals["standard_error"]
        true, reach = _true_parameters(value.index), 1.96 * spread
        table = {"noise": level, "parameter": value.index, "true": true, "value": value, "standard_error": spread}
        table |= {"low": value - reach, "high": value + reach, "error": 100 * (value / true - 1)}
        parts.append(pd.DataFrame(table))
    return pd.concat(parts, ignore_index=True)
