"""The whole grid of readings (`tras.readings`): every combination simulated, identified and judged, over several seeds.

What can be shared is shared. A recording is simulated once for each ``frequency_unit``, ``velocity_term`` and seed; ``input``, ``state`` and
``dictionary`` select from it and give a fit, a *point*; ``horizon``, ``nrmse_range`` and ``angle_names`` only look at the fit in other ways. As in
the paper a fit is by plain least squares, its field by (18), and trusted beyond the data.

Every result is kept in a small file (`tras.cache`): a run that was killed goes on where it was.
"""

import itertools
import json
import math
import os
import sys
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from joblib import Parallel, delayed
from tqdm import tqdm

# Names one by one, never the package as a whole: the cache asks which modules these results depend on.
from tras import cache, readings, stacked, validation
from tras.closed_loop import REFERENCE_NAMES, simulate_closed_loop
from tras.dictionary import Exponentials, Monomials
from tras.excitation import multisine
from tras.generator import LogarithmError
from tras.model import KoopmanModel
from tras.plant import STATE_NAMES, TORQUE_NAMES, PlantParameters, PrintedPlant
from tras.radial import GaussianRBF
from tras.recording import Recording, join

MODEL = {"field": "least_squares", "regularization": None, "extrapolation": "functions"}  # as the paper does
CHANNELS = {"reference": REFERENCE_NAMES, "torque": TORQUE_NAMES}
STATES = {"four_states": (None, 0), "delayed_angles": (("phi", "psi"), 1)}  # channels, delays
PLANTS = {"corrected": PlantParameters, "as_printed": PrintedPlant}
FREQUENCY = {"rad/s": 1.0, "Hz": 2 * math.pi}  # factor to rad/s
RANGES = {"validation_set": "all", "trajectory": "trajectory"}
DRAWN = ("gaussian", "gaussian28")  # dictionaries with random centres
SIMULATION = ("frequency_unit", "velocity_term")
FIT = (*SIMULATION, "input", "state", "dictionary")


@dataclass(frozen=True)
class Study:
    """The experiment that the grid repeats, and over which seeds; times in s, frequencies in the unit that is read, peaks in rad.

    ``centre_draws`` are the seeds of the random centres: other dictionaries are fitted once for each training seed.
    """

    duration: float = 500.0
    sampling_time: float = 0.01
    max_frequency: tuple[float, float] = (0.2, 0.8)  # pitch, yaw
    peak: tuple[float, float] = (1.22173, math.pi)
    max_correlation: float = 0.05
    trajectory: float = 5.0
    window: float = 6.0
    train_fraction: float = 0.8
    split_seed: int = 0
    train_seeds: tuple[int, ...] = (1, 11, 12)
    validation_seeds: tuple[int, ...] = (2, 3)
    centre_draws: tuple[int, ...] = (0, 1, 2)

    def options(self, *names):
        """Some of the fields as JSON holds them."""
        return json.loads(json.dumps({name: getattr(self, name) for name in names}))


_EXPERIMENT = ("duration", "sampling_time", "max_frequency", "peak", "max_correlation")
_SCORING = (*_EXPERIMENT, "trajectory", "window", "train_fraction", "split_seed", "validation_seeds")


def dictionary(name, draw=0):
    """The dictionary that a choice of the reading ``dictionary`` means, its centres drawn by the seed ``draw``."""
    makers = {
        "gaussian": lambda: GaussianRBF(2, 1.0, draw), "gaussian28": lambda: GaussianRBF(28, 1.0, draw), "monomials2": lambda: Monomials(2),
        "monomials3": lambda: Monomials(3), "exponentials": lambda: Exponentials(1), "linear": lambda: Monomials(1),
    }  # fmt: skip
    if name not in makers:
        raise readings.ReadingError(f"dictionary is {name!r}: choose one of {', '.join(makers)}.")
    return makers[name]()


def points(study, only=None):
    """All fits of the grid, or those of some choices: a list of dicts with the options in `FIT`, ``train_seed`` and ``draw``.

    ``only`` is a dict option -> choices, for example ``{"input": ["torque"]}``.
    """
    kept = {option: readings.choices(option) for option in FIT}
    for option, some in (only or {}).items():
        if option not in kept:
            raise readings.ReadingError(f"only names {option!r}, which makes no other fit: choose among {', '.join(FIT)}.")
        kept[option] = [getattr(readings.Readings(**{option: choice}), option) for choice in some]
    found = []
    for combination in itertools.product(*kept.values()):
        options = dict(zip(FIT, combination))
        for seed, draw in itertools.product(study.train_seeds, study.centre_draws if options["dictionary"] in DRAWN else study.centre_draws[:1]):
            found.append({**options, "train_seed": seed, "draw": draw})
    return found


# ------------------------------------------------------------------------------------------------------------ the parts


def simulate(study, frequency_unit, velocity_term, seed):
    """One recording of the experiment under two readings, all channels."""
    band = [FREQUENCY[frequency_unit] * f for f in study.max_frequency]
    rng = np.random.default_rng(seed)
    reference = multisine(study.duration, study.sampling_time, band, study.peak, rng, max_correlation=study.max_correlation)
    return simulate_closed_loop(reference, study.sampling_time, PLANTS[velocity_term]())


def training(study, recording, point):
    """The part of a recording that a point is fitted to."""
    pieces = recording.cut(round(study.trajectory / recording.dt) + 1).split(study.train_fraction, study.split_seed)[0]
    return pieces.select(states=STATES[point["state"]][0], inputs=CHANNELS[point["input"]])


def fit(point, recording):
    """The model of a point, from `training` data: (KoopmanModel, "model"), or (None, why there is none)."""
    model = KoopmanModel(dictionary(point["dictionary"], point["draw"]), "vector_field", STATES[point["state"]][1], **MODEL)
    try:
        with np.errstate(all="ignore"):  # a fit that fails says so itself
            return model.fit(recording), "model"
    except LogarithmError:
        return None, "no model: logarithm"
    except np.linalg.LinAlgError:
        return None, "no model: equation (18) is singular"
    except ValueError as error:
        return None, "no model: dependent functions" if "linearly dependent" in str(error) else f"no model: {error}"


def judge_windows(study, model, recordings):
    """Errors over windows and trajectories: rows with ``validation_seed, horizon, nrmse_range, angle, nrmse, windows, diverged``.

    All windows of both lengths are rolled out together.
    """
    cut = {
        (seed, horizon): recording.cut(round(getattr(study, horizon) / recording.dt) + 1)
        for seed, recording in recordings.items()
        for horizon in ("window", "trajectory")
    }
    with np.errstate(all="ignore"):  # what runs away is counted
        predicted = iter(model.predict(join(cut.values())))
    rows = []
    for (seed, horizon), windows in cut.items():
        prediction = np.stack([next(predicted) for _ in range(len(windows))])
        rows += _rows(windows, prediction, validation_seed=seed, horizon=horizon)
    return rows


def _rows(windows, prediction, **labels):
    judged = {}
    for name, range_over in RANGES.items():  # of a single window both ranges are the same
        judged[name] = validation.judge(windows, prediction, range_over=range_over) if len(windows) > 1 or not judged else [*judged.values()][0]
    keys = ("angle", "nrmse", "windows", "diverged")
    return [{**labels, "nrmse_range": name, **{key: row[key] for key in keys}} for name, rows in judged.items() for row in rows]


# --------------------------------------------------------------------------------------------------- with the cache around


def _recording(folder, study, frequency_unit, velocity_term, seed):
    """`simulate`, from the cache if it is there."""
    options = {**study.options(*_EXPERIMENT), "frequency_unit": frequency_unit, "velocity_term": velocity_term, "seed": seed}
    path = cache.place(folder, "recording", options, cache.code_digest("tras.closed_loop", "tras.excitation"), ".npz")
    arrays = cache.read_arrays(path)
    if arrays is None:
        made = simulate(study, frequency_unit, velocity_term, seed)
        arrays = {"states": made.states, "inputs": made.inputs}
        cache.write_arrays(path, **arrays)
    names = {"state_names": STATE_NAMES, "input_names": REFERENCE_NAMES + TORQUE_NAMES}
    return Recording(arrays["states"], arrays["inputs"], study.sampling_time, **names)


def _validation(folder, study, point):
    recordings = {seed: _recording(folder, study, *(point[name] for name in SIMULATION), seed) for seed in study.validation_seeds}
    return {seed: r.select(states=STATES[point["state"]][0], inputs=CHANNELS[point["input"]]) for seed, r in recordings.items()}


def _place_of_point(folder, study, point):
    options = {**study.options(*_SCORING), **point}
    return cache.place(folder, "point", options, cache.code_digest("tras.grid")), options


def _fit_points(folder, study, some):
    """Fit and judge points of one training recording, input and state, and store each."""
    for point in some:
        recording = _recording(folder, study, *(point[name] for name in SIMULATION), point["train_seed"])
        path, options = _place_of_point(folder, study, point)
        model, outcome = fit(point, training(study, recording, point))
        value = {"outcome": outcome, "rows": []}
        if model:
            value |= {"N": len(model.names_), "condition": model.condition_number, "field": stacked.field_of(model)}
            value["rows"] = judge_windows(study, model, _validation(folder, study, point))
        cache.write(path, options, value)
    return len(some)


def _run_freely(folder, study, some, found, path, options):
    """Free runs of the models of one dictionary, draw and state, on all validation recordings, and store them."""
    first = some[0]
    lifted = dictionary(first["dictionary"], first["draw"])
    channels, delays = STATES[first["state"]]
    lifted.fit(np.zeros((1, (4 if channels is None else 2) * (delays + 1))), np.zeros((1, 2)))
    fields = [found[_name(point)]["field"] for point in some]
    truths = [_validation(folder, study, point) for point in some]
    inputs = np.stack([[r.inputs[0] for r in truth.values()] for truth in truths])
    starts = np.stack([[r.states[0, : delays + 1] for r in truth.values()] for truth in truths])
    rows = {}
    for substeps in sorted({field["substeps"] for field in fields}):
        chosen = [i for i, field in enumerate(fields) if field["substeps"] == substeps]
        predicted = stacked.free_runs(lifted, [fields[i] for i in chosen], starts[chosen], inputs[chosen])
        for i, runs in zip(chosen, predicted):
            rows[_name(some[i])] = [
                row
                for (seed, truth), run in zip(truths[i].items(), runs)
                for row in _rows(truth, run[None], validation_seed=seed, horizon="free_run")
            ]
    cache.write(path, options, rows)
    return len(some)


def run(study, folder, *, only=None, processes=2, progress=None):
    """The whole grid, or a part of it.

    Parameters
    ----------
    study : Study
    folder : str or Path
        Of the cache. What is found there is not computed again.
    only : dict, optional
        As in `points`.
    processes : int
    progress : text stream, optional
        Where a progress bar goes, for example ``sys.stderr``; none without it.

    Returns
    -------
    pandas.DataFrame
        One row a point, validation seed, horizon, range and angle: the options of the reading (without ``angle_names``), ``train_seed, draw,
        validation_seed, angle, nrmse`` (percent; NaN without a model or if all windows diverged), ``windows, diverged``, ``outcome`` ("model" or
        why there is none), ``N, condition``.
    counts : dict
        ``computed, cached``: points whose fit was computed, or found in the cache.
    """
    folder, wanted = Path(folder), points(study, only)
    places = [_place_of_point(folder, study, point) for point in wanted]
    found = {_name(point): cache.read(*place) for point, place in zip(wanted, places)}
    missing = [point for point in wanted if found[_name(point)] is None]
    jobs = _grouped(missing, (*SIMULATION, "train_seed", "input", "state"))
    needed = sorted({(*(p[n] for n in SIMULATION), seed) for p in missing for seed in (p["train_seed"], *study.validation_seeds)})
    _each(_recording, [(folder, study, *key) for key in needed], "simulate", processes, progress)
    _each(_fit_points, [(folder, study, some) for some in jobs], "identify", processes, progress)
    found |= {_name(point): cache.read(*_place_of_point(folder, study, point)) for point in missing}
    free = _free_runs(folder, study, [point for point in wanted if found[_name(point)]["rows"]], found, processes, progress)
    table = pd.DataFrame([row for point in wanted for row in _table_rows(study, point, found[_name(point)], free.get(_name(point), []))])
    return table, {"computed": len(missing), "cached": len(wanted) - len(missing)}


def _free_runs(folder, study, some, found, processes, progress):
    """Name of a point -> rows of its free runs."""
    groups, code = [], cache.code_digest("tras.grid")
    for group in _grouped(some, ("state", "dictionary", "draw")):
        options = {**study.options(*_SCORING), "points": [_name(point) for point in group]}
        groups.append((group, cache.place(folder, "free", options, code), options))
    missing = [group for group in groups if cache.read(*group[1:]) is None]
    jobs = [(folder, study, group, {_name(p): {"field": found[_name(p)]["field"]} for p in group}, *rest) for group, *rest in missing]
    _each(_run_freely, jobs, "run freely", processes, progress)
    rows = {}
    for _, path, options in groups:
        rows |= cache.read(path, options)
    return rows


def _each(work, jobs, title, processes, progress):
    """Do all jobs, in processes, with a bar."""
    if not jobs:
        return
    with tqdm(total=len(jobs), desc=title, file=progress, disable=progress is None) as bar:
        for _ in Parallel(n_jobs=processes, return_as="generator_unordered")(delayed(work)(*job) for job in jobs):
            bar.update()


def _grouped(some, names):
    """Lists of the points that agree in these options, in the order of the grid."""
    groups = {}
    for point in some:
        groups.setdefault(tuple(point[name] for name in names), []).append(point)
    return list(groups.values())


def _name(point):
    return json.dumps(list(point.values()))


def _table_rows(study, point, value, free):
    rows = [*value["rows"], *free]
    if not rows:  # no model: its rows say so, and keep their place
        labels = itertools.product(study.validation_seeds, readings.choices("horizon"), RANGES, validation.ANGLES)
        names = ("validation_seed", "horizon", "nrmse_range", "angle")
        rows = [{**dict(zip(names, label)), "nrmse": None, "windows": 0, "diverged": 0} for label in labels]
    about = {"outcome": value["outcome"], "N": value.get("N"), "condition": value.get("condition")}
    return [{**point, **row, "nrmse": math.nan if row["nrmse"] is None else row["nrmse"], **about} for row in rows]


def terminal():
    """The terminal behind a notebook's kernel, for a progress bar that shall not enter the notebook: a context with a stream, or with None."""
    number = getattr(sys.stderr, "_original_stdstream_copy", None)  # where ipykernel keeps it
    if number is not None and os.isatty(number):
        return os.fdopen(os.dup(number), "w")
    return nullcontext(sys.stderr if sys.stderr.isatty() else None)
