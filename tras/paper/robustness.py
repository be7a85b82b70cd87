"""How the identification stands up to noise, slow sampling and short data.

Each study takes recordings and returns a table, a row a case; the notebook ``05_robustness`` prints and draws them. Noise is white and
Gaussian on the states, its standard deviation in percent of each state's range; the torques are exact. No result depends on the number of
processes.
"""

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
from tras.paper.physics import lumped_parameters
from tras.recording import Recording
from tras.twin_rotor.closed_loop import PID, simulate_closed_loop
from tras.twin_rotor.excitation import multisine
from tras.twin_rotor.plant import STATE_PAIRS, TORQUE_NAMES, PlantParameters
from tras.workflow.study import each

DICTIONARIES = {
    "linear": Monomials(1),
    "monomials2": Monomials(2),
    "monomials3": Monomials(3),
    "mechanical": Mechanical(),
}
METHODS = ("plain", "default", "smoothed", "refined")


def noisy(recording, level, seed):
    """The recording with noise of ``level`` percent of the range on its states; 0 gives the recording itself."""
    return add_noise(recording, level / 100, seed) if level else recording


def identify(recording, samples, method, smoothed=None, segment=None):
    """A model of long trajectories with the dictionary ``Mechanical(6)``, by one of `METHODS`.

    ``"plain"``: EDMD by least squares, as in the paper. ``"default"``: this package's regularisation. ``"smoothed"``: the same on states that
    were smoothed first. ``"refined"``: that, then its vector field refined by multiple shooting on the recording as measured.

    Parameters
    ----------
    recording : Recording
        As measured, not cut: smoothing and refining want long trajectories.
    samples : int
        Length of the trajectories into which it is cut for the fit.
    method : str
    smoothed : Recording, optional
        ``smooth(recording, STATE_PAIRS)``, if it is at hand.
    segment : int, optional
        As for `tras.refine`.
    """
    if method == "plain":
        return KoopmanModel(Mechanical(6), regularization=None, extrapolation="functions").fit(recording.cut(samples))
    if method == "default":
        return KoopmanModel(Mechanical(6)).fit(recording.cut(samples))
    smoothed = smooth(recording, STATE_PAIRS) if smoothed is None else smoothed
    model = KoopmanModel(Mechanical(6)).fit(smoothed.cut(samples))
    return model if method == "smoothed" else refine(model, recording, segment=segment)


def noise_study(
    train, fresh, levels, seeds, samples, window, *, methods=METHODS, default_levels=None, segment=None, processes=1
):
    """Prediction error against measurement noise in the training data; validation is free of noise, from the true initial state.

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
        Samples that are followed in one piece to refine; as for `tras.refine`.

    Returns
    -------
    table : pandas.DataFrame
        Columns ``noise`` (%), ``seed, method, angle, nrmse`` (%; NaN without a model), ``windows, diverged, failure`` (empty, or why there
        is no model: "logarithm" or "data"), ``parameter_error`` (%: the worst of the plant's eight parameters, from the field on the smoothed
        states).
    models : dict
        (noise, seed, method) -> KoopmanModel, where there is one.
    recordings : dict
        (noise, seed) -> (as measured, smoothed), two recordings.
    """
    tried = [(level, seeds[0]) for level in (levels if default_levels is None else default_levels)]
    runs = [(level, seed) for level in levels for seed in (seeds if level else seeds[:1])]
    cases = [
        (*run, [m for m in methods if (run in tried if m == "default" else run[0] or m == "plain")]) for run in runs
    ]
    shared = train, fresh, samples, window, segment
    parts = each(
        _noise_case, cases, shared, cost=lambda level, seed, methods: (len(methods), level), processes=processes
    )
    models = {key: model for _, found, _ in parts for key, model in found.items()}
    recordings = {case[:2]: pair for case, (_, _, pair) in zip(cases, parts)}
    return pd.DataFrame([row for rows, _, _ in parts for row in rows]), models, recordings


def _noise_case(train, fresh, samples, window, segment, level, seed, methods):
    """Rows, models, and the pair of recordings as measured and smoothed."""
    recording = noisy(train, level, seed)
    smoothed = smooth(recording, STATE_PAIRS) if level else recording
    rows, models = [], {}
    for method in methods:
        case = {"noise": level, "seed": seed, "method": method}
        model, found = _attempt(lambda: identify(recording, samples, method, smoothed, segment), fresh, window, **case)
        error = np.nan if model is None else _worst_parameter(model, smoothed)
        rows += [{**row, "parameter_error": error} for row in found]
        models |= {} if model is None else {(level, seed, method): model}
    return rows, models, (recording, smoothed)


def _worst_parameter(model, points):
    found = lumped_parameters(model, points)
    return 100 * (found / pd.Series(PlantParameters().as_dict())[found.index].astype(float) - 1).abs().max()


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
    return model, [
        {**case, "angle": angle, "nrmse": error, **counts, "failure": failure} for angle, error in errors.items()
    ]


def slow_controllers(parameters):
    """PIDs slow enough to be stable at 0.2 s: poles at 2 rad/s for pitch and 1 rad/s for yaw, whose inertia falls to a fifth away from level."""
    pitch = PID.pole_placement(parameters.J_phi, parameters.u_phi_limits, frequency=2.0, integral_rate=0.5)
    inertia = parameters.J + parameters.J_psi0
    return pitch, PID.pole_placement(inertia, parameters.u_psi_limits, frequency=1.0, damping=0.7, integral_rate=0.25)


def sampling_study(
    times,
    duration,
    band,
    peak,
    seeds,
    trajectory,
    window,
    *,
    predictors=("vector_field", "one_step", "lifted_linear"),
    processes=1,
):
    """Prediction error against the sampling time; the loop is simulated anew at each, its torques held over the longer sample.

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
        Columns ``sampling_time, dictionary, predictor, angle, nrmse`` (%), ``windows, diverged, failure`` (empty, or why there is no model),
        ``fastest`` (rad/s, the highest rate in the training data: a loop that is not stable shows here).
    """
    parameters = PlantParameters()

    def case(dt):
        references = [multisine(duration, dt, band, peak, seed) for seed in seeds]
        controllers = slow_controllers(parameters)
        train, fresh = [
            simulate_closed_loop(r, dt, parameters, controllers=controllers).select(inputs=TORQUE_NAMES)
            for r in references
        ]
        about = {"sampling_time": dt, "fastest": float(np.abs(train.states[..., [1, 3]]).max())}
        pieces = train.cut(round(trajectory / dt) + 1)
        return [
            row
            for name in ("monomials3", "mechanical")
            for predictor in predictors
            for row in _attempt(
                lambda: KoopmanModel(DICTIONARIES[name], predictor).fit(pieces),
                fresh,
                window,
                **about,
                dictionary=name,
                predictor=predictor,
            )[1]
        ]

    parts = each(case, [(dt,) for dt in times], processes=processes)
    columns = [
        "sampling_time",
        "dictionary",
        "predictor",
        "angle",
        "nrmse",
        "windows",
        "diverged",
        "failure",
        "fastest",
    ]
    return pd.DataFrame([row for part in parts for row in part])[columns]


def length_study(
    train,
    levels,
    ratios,
    stretches,
    *,
    fits=("plain", "default"),
    dictionaries=tuple(DICTIONARIES),
    seed=0,
    processes=1,
):
    """Where the logarithm fails: contiguous stretches of one recording, of ``ratio`` snapshot pairs a function.

    Parameters
    ----------
    train : Recording
        Its first trajectory is used.
    levels : sequence of float
        Noise in percent.
    ratios : sequence of float
        Pairs over the number of functions, N; lengths beyond the recording's are left out.
    stretches : int
        How many a length, their starts evenly spread over the recording.
    fits : sequence of {"plain", "default"}
        Least squares, as in the paper, or the model's own regularisation.

    Returns
    -------
    pandas.DataFrame
        Columns ``fit, dictionary, functions, noise`` (%), ``ratio, pairs, seconds, stretches``; shares (0 to 1) ``no_logarithm``,
        ``dependent`` (functions that depend on each other, to working precision, on these data: no K either) and their sum ``failed``.
    """
    parameters = {"plain": {"regularization": None}, "default": {}}
    recordings = {level: noisy(train[[0]], level, seed) for level in levels}
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
    return table.sort_values(
        ["fit", "noise", "functions", "dictionary", "ratio"],
        ascending=[False, True, True, True, True],
        ignore_index=True,
    )


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
