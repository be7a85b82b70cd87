"""Every combination of the readings (`tras.paper.readings`) simulated, identified and judged, over several seeds.

A recording is simulated once for each ``frequency_unit``, ``velocity_term`` and seed; ``input``, ``state`` and
``dictionary`` select from it and give a fit, a *point*; ``horizon``, ``nrmse_range`` and ``angle_names`` only look at
the fit in other ways. As in the paper a fit is by plain least squares, its field by (18), and trusted beyond the data.
"""

import itertools
import json
import math
from dataclasses import dataclass
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
from tras.twin_rotor.closed_loop import INPUTS, REFERENCE_NAMES, simulate_closed_loop
from tras.twin_rotor.excitation import multisine
from tras.twin_rotor.plant import STATE_NAMES, TORQUE_NAMES, PlantParameters, PrintedPlant
from tras.workflow import cache
from tras.workflow.study import compute, each

STATES = {"four_states": (None, 0), "delayed_angles": (("phi", "psi"), 1)}  # channels, delays
PLANTS = {"corrected": PlantParameters, "as_printed": PrintedPlant}
FREQUENCY = {"rad/s": 1.0, "Hz": 2 * math.pi}  # factor to rad/s
RANGES = {"validation_set": "all", "trajectory": "trajectory"}
DRAWN = ("gaussian", "gaussian28")  # dictionaries with random centres
SIMULATION = ("frequency_unit", "velocity_term")
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
    """All fits of the grid, or those of some choices: dicts with the options in `FIT`, ``train_seed`` and ``draw``.

    ``only`` is a dict option -> choices, for example ``{"input": ["torque"]}``.
    """
    choices = {option: readings.choices(option) for option in FIT}
    for option, some in (only or {}).items():
        if option not in choices:
            known = ", ".join(FIT)
            raise readings.ReadingError(f"only names {option!r}, which makes no other fit: choose among {known}.")
        choices[option] = [getattr(readings.Readings(**{option: choice}), option) for choice in some]
    result = []
    for combination in itertools.product(*choices.values()):
        options = dict(zip(FIT, combination))
        draws = study.centre_draws if options["dictionary"] in DRAWN else study.centre_draws[:1]
        result += [{**options, "train_seed": seed, "draw": draw} for seed in study.train_seeds for draw in draws]
    return result


def run(study: Study, folder, *, only: dict | None = None, processes: int = 2, progress=None):
    """The whole grid, or a part of it.

    Parameters
    ----------
    study : Study
    folder : str or Path
        Of the cache, for one run at a time. What is there is not computed again.
    only : dict, optional
        As in `points`.
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
    code, cases = cache.code_digest("tras.paper.grid"), points(study, only)
    names = [name for name in vars(study) if name not in ("train_seeds", "centre_draws")]  # a point has its own
    about = cache.plain({name: getattr(study, name) for name in names})
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


# --- the parts --------------------------------------------------------------------------------------------------------


def simulate(study: Study, frequency_unit: str, velocity_term: str, seed: int) -> Recording:
    """One recording of the experiment under two readings, all channels."""
    band = [FREQUENCY[frequency_unit] * f for f in study.max_frequency]
    rng, dt = np.random.default_rng(seed), study.sampling_time
    reference = multisine(study.duration, dt, band, study.peak, rng, max_correlation=study.max_correlation)
    return simulate_closed_loop(reference, dt, PLANTS[velocity_term]())


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


def _simulated(study, folder, code, frequency_unit, velocity_term, seed):
    """Have a recording in the cache."""
    _recording(study, folder, code, {"frequency_unit": frequency_unit, "velocity_term": velocity_term}, seed)


def _recording(study, folder, code, point, seed):
    """`simulate`, from the cache if it is there."""
    simulation = {name: point[name] for name in SIMULATION}
    options = {**cache.plain({name: getattr(study, name) for name in EXPERIMENT}), **simulation, "seed": seed}
    path = cache.path_for(folder, "recording", options, code, ".npz")
    arrays = cache.read_arrays(path)
    if arrays is None:
        recording = simulate(study, **simulation, seed=seed)
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
