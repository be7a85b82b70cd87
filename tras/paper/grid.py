"""The readings (`tras.paper.readings`) simulated, identified and judged, over several seeds.

A recording is simulated once for each choice of the options in `SIMULATION` and seed; ``input``, ``state`` and
``dictionary`` select from it and give a fit, a *point*; ``horizon``, ``nrmse_range`` and ``angle_names`` only look at
the fit in other ways. `points` is the full product of all options but those in `readings.SINGLE`, which `neighbours`
changes one at a time. As in the paper a fit is by plain least squares, its field by (18), and trusted beyond the data.
"""

import itertools
import json
import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from tras.dictionaries.monomials import Monomials
from tras.dictionaries.radial import GaussianRBF
from tras.dictionaries.waves import Exponentials
from tras.generator import LogarithmError
from tras.model import KoopmanModel

# Names one by one, never the package as a whole: the cache asks which modules these results depend on.
from tras.paper import readings, validation
from tras.recording import Recording, join
from tras.twin_rotor.closed_loop import INPUTS, PID, REFERENCE_NAMES, simulate_closed_loop
from tras.twin_rotor.excitation import multisine
from tras.twin_rotor.plant import STATE_NAMES, TORQUE_NAMES, PlantParameters, PrintedPlant, rest_point
from tras.workflow import cache
from tras.workflow.study import compute, each

STATES = {"four_states": (None, 0), "delayed_angles": (("phi", "psi"), 1)}  # channels, delays
PLANTS = {"corrected": PlantParameters, "as_printed": PrintedPlant}
FACTORS = {"half": 0.5, "double": 2.0, "zero": 0.0, "less": 0.8, "more": 1.2}  # of one lumped parameter
GAINS = {
    "default": {}, "half_frequency": {"frequency": 2.0}, "twice_frequency": {"frequency": 8.0},
    "less_damping": {"damping": 0.5},
}  # fmt: skip
FREQUENCY = {"rad/s": 1.0, "Hz": 2 * math.pi}  # factor to rad/s
RANGES = {"validation_set": "all", "trajectory": "trajectory"}
DRAWN = ("gaussian", "gaussian28")  # dictionaries with random centres
SIMULATION = ("frequency_unit", "velocity_term", "start", "gains", "plant")
FIT = (*SIMULATION, "input", "state", "dictionary")
EXPERIMENT = ("duration", "sampling_time", "max_frequency", "peak", "max_correlation")  # what recordings depend on


@dataclass(frozen=True)
class Study:
    """The experiment and its seeds; times in s, frequencies in the unit that is read, peaks in rad.

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


def dictionary(name: str, draw: int = 0):
    """The dictionary that a choice of the reading ``dictionary`` means, its centres drawn by the seed ``draw``."""
    makers = {
        "gaussian": lambda: GaussianRBF(2, 1.0, draw), "gaussian28": lambda: GaussianRBF(28, 1.0, draw),
        "monomials2": lambda: Monomials(2), "monomials3": lambda: Monomials(3),
        "exponentials": lambda: Exponentials(1), "linear": lambda: Monomials(1),
    }  # fmt: skip
    return makers[readings.Readings(dictionary=name).dictionary]()


def points(study: Study, only: dict | None = None) -> list[dict]:
    """All fits of the full product, or those of some choices: dicts with the options in `FIT`, ``train_seed, draw``.

    ``only`` is a dict option -> choices, for example ``{"input": ["torque"]}``. The options in `readings.SINGLE` have
    their default unless they are in it.
    """
    choices = {option: readings.choices(option)[: 1 if option in readings.SINGLE else None] for option in FIT}
    for option, some in (only or {}).items():
        if option not in choices:
            known = ", ".join(FIT)
            raise readings.ReadingError(f"only names {option!r}, which makes no other fit: choose among {known}.")
        choices[option] = [getattr(readings.Readings(**{option: choice}), option) for choice in some]
    return [point for choice in itertools.product(*choices.values()) for point in _seeds(study, dict(zip(FIT, choice)))]


def neighbours(study: Study, bases: list[readings.Readings]) -> list[dict]:
    """The fits of readings that differ from one of ``bases`` in one option of `readings.SINGLE`; dicts, as `points`."""
    combinations = [
        base.replaced(**{option: choice}).model_dump(include=set(FIT))
        for base in bases
        for option in readings.SINGLE
        for choice in readings.choices(option)
        if choice != getattr(base, option)
    ]
    unique = list(dict.fromkeys(tuple(combination[option] for option in FIT) for combination in combinations))
    return [point for choice in unique for point in _seeds(study, dict(zip(FIT, choice)))]


def _seeds(study, options):
    draws = study.centre_draws if options["dictionary"] in DRAWN else study.centre_draws[:1]
    return [{**options, "train_seed": seed, "draw": draw} for seed in study.train_seeds for draw in draws]


def run(study: Study, cases: list[dict], folder, *, processes: int = 2, progress=None):
    """Fits and judges points of the grid.

    Parameters
    ----------
    study : Study
    cases : list of dict
        From `points` or `neighbours`.
    folder : str or Path
        Of the cache, for one run at a time. What is there is not computed again.
    processes : int
    progress : text stream, optional
        Where a progress bar goes, for example ``sys.stderr``; none without it.

    Returns
    -------
    pandas.DataFrame
        One row per point, validation seed, horizon, range and angle: the options of the reading (without
        ``angle_names``), ``train_seed, draw, validation_seed, angle, nrmse`` (percent; NaN without a model or if all
        windows diverged), ``windows, diverged``, ``outcome`` ("model" or why there is none), ``N, condition``.
    counts : dict
        ``computed, cached``: points whose fit was computed, or found in the cache.
    """
    code = cache.code_digest("tras.paper.grid")
    about = _about(study)
    shared, executor = (study, Path(folder), code), {"progress": progress or False, "processes": processes}
    options = {"folder": folder, "code": code, **executor}

    def simulated(missing):
        """Have all recordings in the cache first, so that each is simulated once."""
        seeds = [(point, seed) for point in missing for seed in (point["train_seed"], *study.validation_seeds)]
        jobs = {(*(point[name] for name in SIMULATION), seed) for point, seed in seeds}
        cache.clear_temporaries(folder, "recording")
        each(_simulated, sorted(jobs), shared, title="simulate", **executor)
        return shared

    keys = [{**about, **point} for point in cases]
    values, counts = compute(_fitted, cases, simulated, keys=keys, title="identify", **options)
    groups = {}  # of models that run freely together
    for point, value in zip(cases, values):
        if value["rows"]:
            label = tuple(point[name] for name in ("state", "dictionary", "draw"))
            groups.setdefault(label, []).append((point, value["field"]))
    groups = list(groups.values())
    keys = [{**about, "points": [_name(point) for point, _ in group]} for group in groups]
    names = {"title": "run freely", "unit": " groups", "kind": "free"}
    free, _ = compute(_run_freely, groups, shared, keys=keys, **names, **options)
    free = {name: rows for group in free for name, rows in group.items()}
    parts = [_table_rows(study, point, value, free.get(_name(point), [])) for point, value in zip(cases, values)]
    return pd.DataFrame([row for part in parts for row in part]), counts


def transient(study: Study, cases: list[dict], skip: float, folder, *, processes: int = 2, progress=None):
    """What the start of the experiment does to the errors over windows, through the fit and through the judgement.

    Parameters
    ----------
    study, cases, folder, processes, progress
        As for `run`.
    skip : float
        Seconds at the start of each recording that are left out.

    Returns
    -------
    pandas.DataFrame
        One row per point, validation seed, pair of parts and angle: the options of the point, ``fit_from, judged_from``
        (0 or ``skip``, in s), ``validation_seed, angle, nrmse`` (percent, range of the validation set), ``diverged``.

    Raises
    ------
    ValueError
        If less than a trajectory or a window would be left.
    """
    left = study.duration - skip
    if not 0 < skip or left < max(study.trajectory, study.window):
        raise ValueError(f"skip is {skip:g} s; give a part of the {study.duration:g} s that leaves a window.")
    code = cache.code_digest("tras.paper.grid")
    about = _about(study)
    options = {"processes": processes, "progress": progress or False, "folder": folder, "code": code}
    keys = [{**about, **point, "skip": skip} for point in cases]
    shared = (study, Path(folder), code, skip)
    values, _ = compute(_transient, cases, shared, keys=keys, title="start", kind="transient", **options)
    return pd.DataFrame([{**point, **row} for point, rows in zip(cases, values) for row in rows])


# --- the parts --------------------------------------------------------------------------------------------------------


def rig(reading: dict) -> PlantParameters:
    """The plant of a reading, from its ``velocity_term`` and ``plant``.

    Examples
    --------
    >>> rig({"velocity_term": "corrected", "plant": "K_psi_double"}).K_psi
    0.006
    """
    parameters = PLANTS[reading["velocity_term"]]()
    name, _, word = reading["plant"].rpartition("_")
    return replace(parameters, **{name: FACTORS[word] * getattr(parameters, name)}) if name else parameters


def simulate(study: Study, reading: dict, seed: int) -> Recording:
    """One recording of the experiment, all channels; of the reading the options in `SIMULATION` count."""
    band = [FREQUENCY[reading["frequency_unit"]] * f for f in study.max_frequency]
    rng, dt, plant = np.random.default_rng(seed), study.sampling_time, rig(reading)
    reference = multisine(study.duration, dt, band, study.peak, rng, max_correlation=study.max_correlation)
    x0 = {"on_reference": None, "hanging": rest_point(plant), "zero": np.zeros(4)}[reading["start"]]
    controllers = PID.defaults(plant, **GAINS[reading["gains"]])
    return simulate_closed_loop(reference, dt, plant, controllers=controllers, x0=x0)


def training(study: Study, recording: Recording, point: dict) -> Recording:
    """The part of a recording that a point is fitted to."""
    pieces = recording.cut(round(study.trajectory / recording.dt) + 1)
    return select(pieces.split(study.train_fraction, study.split_seed)[0], point)


def fit(point: dict, recording: Recording) -> tuple[KoopmanModel | None, str]:
    """The model of a point, from `training` data: (KoopmanModel, "model"), or (None, why there is none)."""
    functions, delays = dictionary(point["dictionary"], point["draw"]), STATES[point["state"]][1]
    model = KoopmanModel(functions, "vector_field", delays, **readings.PAPER_FIT)
    try:
        with np.errstate(all="ignore"):  # a fit that fails says so itself
            return model.fit(recording), "model"
    except LogarithmError:
        return None, "no model: logarithm"
    except np.linalg.LinAlgError:
        return None, "no model: equation (18) is singular"
    except ValueError as error:
        return None, "no model: dependent functions" if "linearly dependent" in str(error) else f"no model: {error}"


def judge_windows(study: Study, model: KoopmanModel, recordings: dict[int, Recording]) -> list[dict]:
    """Errors over windows and trajectories, all rolled out together.

    The rows have ``validation_seed, horizon, nrmse_range, angle, nrmse, windows, diverged``.
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
        rows += rows_of(windows, prediction, validation_seed=seed, horizon=horizon)
    return rows


def rows_of(windows: Recording, prediction: np.ndarray, **labels) -> list[dict]:
    """NRMSE of predictions of one recording's windows: a row for each range and angle, with these labels."""
    rows, scores = [], None
    for name, range_over in RANGES.items():
        if scores is None or len(windows) > 1:  # of a single window both ranges are the same
            scores = validation.judge(windows, prediction, range_over=range_over)
        keys = ("angle", "nrmse", "windows", "diverged")
        rows += [{**labels, "nrmse_range": name, **{key: row[key] for key in keys}} for row in scores]
    return rows


def select(recording: Recording, point: dict) -> Recording:
    """The channels of a recording that a point knows."""
    return recording.select(states=STATES[point["state"]][0], inputs=INPUTS[point["input"]])


def judge_free_runs(point: dict, fields: list[dict], truths: list[dict]) -> list[list[dict]]:
    """Errors of free runs: as `judge_windows`, one list of rows per model.

    Parameters
    ----------
    point : dict
        Of one of the models; all share its dictionary, draw and state.
    fields : list of dict
        From `tras.paper.validation.field_of`, one per model.
    truths : list of dict
        Validation seed -> recording, one dict per model.
    """
    channels, delays = STATES[point["state"]]
    lifted = dictionary(point["dictionary"], point["draw"])
    lifted.fit(np.zeros((1, (4 if channels is None else len(channels)) * (delays + 1))), np.zeros((1, 2)))
    inputs = np.stack([[r.inputs[0] for r in truth.values()] for truth in truths])
    starts = np.stack([[r.states[0, : delays + 1] for r in truth.values()] for truth in truths])
    rows = [[] for _ in fields]
    for substeps in sorted({field["substeps"] for field in fields}):
        alike = [i for i, field in enumerate(fields) if field["substeps"] == substeps]
        predicted = validation.free_runs(lifted, [fields[i] for i in alike], starts[alike], inputs[alike])
        for i, runs in zip(alike, predicted):
            for (seed, truth), run in zip(truths[i].items(), runs):
                rows[i] += rows_of(truth, run[None], validation_seed=seed, horizon="free_run")
    return rows


# --- what a process does of a run -------------------------------------------------------------------------------------


def _about(study):
    """What the results of every point depend on; training seed and draw are the point's own."""
    return cache.plain(
        {name: value for name, value in vars(study).items() if name not in ("train_seeds", "centre_draws")}
    )


def _simulated(study, folder, code, *choices):
    """Have a recording in the cache."""
    *simulation, seed = choices
    _recording(study, folder, code, dict(zip(SIMULATION, simulation)), seed)


def _recording(study, folder, code, point, seed):
    """`simulate`, from the cache if it is there."""
    simulation = {name: point[name] for name in SIMULATION}
    options = {**cache.plain({name: getattr(study, name) for name in EXPERIMENT}), **simulation, "seed": seed}
    path = cache.path_for(folder, "recording", options, code, ".npz")
    arrays = cache.read_arrays(path)
    if arrays is None:
        recording = simulate(study, simulation, seed)
        arrays = {"states": recording.states, "inputs": recording.inputs}
        cache.write_arrays(path, **arrays)
    names = {"state_names": STATE_NAMES, "input_names": REFERENCE_NAMES + TORQUE_NAMES}
    return Recording(arrays["states"], arrays["inputs"], study.sampling_time, **names)


def _validation(study, folder, code, point):
    return {seed: select(_recording(study, folder, code, point, seed), point) for seed in study.validation_seeds}


def _fitted(study, folder, code, point):
    """A point fitted and judged over windows."""
    model, outcome = fit(point, training(study, _recording(study, folder, code, point, point["train_seed"]), point))
    if not model:
        return {"outcome": outcome, "rows": []}
    rows = judge_windows(study, model, _validation(study, folder, code, point))
    about = {"N": len(model.names_), "condition": model.condition_number, "field": validation.field_of(model)}
    return {"outcome": outcome, "rows": rows, **about}


def _transient(study, folder, code, skip, point):
    """A point fitted to the whole training recording and to its rest, each judged on whole recordings and rests."""
    train = select(_recording(study, folder, code, point, point["train_seed"]), point)
    validation_set = _validation(study, folder, code, point)
    rows = []
    for fit_from in (0.0, skip):
        model, _ = fit(point, training(study, _from(train, fit_from), point))
        for judged_from in (0.0, skip) if model else ():
            judged = {seed: _from(recording, judged_from) for seed, recording in validation_set.items()}
            for row in judge_windows(study, model, judged):
                if (row["horizon"], row["nrmse_range"]) == ("window", "validation_set"):
                    labels = {"fit_from": fit_from, "judged_from": judged_from}
                    values = {name: row[name] for name in ("validation_seed", "angle", "nrmse", "diverged")}
                    rows.append(labels | values | {"nrmse": math.nan if row["nrmse"] is None else row["nrmse"]})
    return rows


def _from(recording, seconds):
    """The recording from a time on."""
    first = round(seconds / recording.dt)
    return recording.with_data([recording.states[0][first:]], [recording.inputs[0][first:]])


def _run_freely(study, folder, code, group):
    """Free runs of the models of one dictionary, draw and state on all validation recordings: point's name -> rows."""
    some, fields = zip(*group)
    rows = judge_free_runs(some[0], fields, [_validation(study, folder, code, point) for point in some])
    return dict(zip(map(_name, some), rows))


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
