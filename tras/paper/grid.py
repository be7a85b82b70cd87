"""The whole grid of readings (`tras.paper.readings`): every combination simulated, identified and judged, over several seeds.

What can be shared is shared. A recording is simulated once for each ``frequency_unit``, ``velocity_term`` and seed; ``input``, ``state`` and
``dictionary`` select from it and give a fit, a *point*; ``horizon``, ``nrmse_range`` and ``angle_names`` only look at the fit in other ways. As in
the paper a fit is by plain least squares, its field by (18), and trusted beyond the data.

`run` does it all, in processes, with every result kept in a small file, so that a killed run goes on where it was.
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
            raise readings.ReadingError(
                f"only names {option!r}, which makes no other fit: choose among {', '.join(FIT)}."
            )
        kept[option] = [getattr(readings.Readings(**{option: choice}), option) for choice in some]
    found = []
    for combination in itertools.product(*kept.values()):
        options = dict(zip(FIT, combination))
        for seed, draw in itertools.product(
            study.train_seeds, study.centre_draws if options["dictionary"] in DRAWN else study.centre_draws[:1]
        ):
            found.append({**options, "train_seed": seed, "draw": draw})
    return found


def run(study, folder, *, only=None, processes=2, progress=None):
    """The whole grid, or a part of it.

    Parameters
    ----------
    study : Study
    folder : str or Path
        Of the cache, for one run at a time. What is found there is not computed again.
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
    folder, code, wanted = Path(folder), cache.code_digest("tras.paper.grid"), points(study, only)
    names = [name for name in vars(study) if name not in ("train_seeds", "centre_draws")]  # a point has its own
    about = cache.plain({name: getattr(study, name) for name in names})
    parts, place = (study, folder, code), {"progress": progress or False, "processes": processes}
    options = {"folder": folder, "code": code, **place}

    def simulated(missing):
        """Have all recordings in the cache first, so that each is simulated once."""
        seeds = [(point, seed) for point in missing for seed in (point["train_seed"], *study.validation_seeds)]
        jobs = {(*(point[name] for name in SIMULATION), seed) for point, seed in seeds}
        cache.clear_temporaries(folder, "recording")
        each(_simulated, sorted(jobs), parts, title="simulate", **place)
        return parts

    keys = [{**about, **point} for point in wanted]
    values, counts = compute(_fitted, wanted, simulated, keys=keys, title="identify", **options)
    groups = {}  # of models that run freely together
    for point, value in zip(wanted, values):
        if value["rows"]:
            label = tuple(point[name] for name in ("state", "dictionary", "draw"))
            groups.setdefault(label, []).append((point, value["field"]))
    groups, names = list(groups.values()), {"title": "run freely", "unit": " groups", "kind": "free"}
    keys = [{**about, "points": [_name(point) for point, _ in group]} for group in groups]
    free, _ = compute(_run_freely, groups, parts, keys=keys, **names, **options)
    rows = {name: rows for group in free for name, rows in group.items()}
    parts = [_table_rows(study, point, value, rows.get(_name(point), [])) for point, value in zip(wanted, values)]
    return pd.DataFrame([row for part in parts for row in part]), counts


# ------------------------------------------------------------------------------------------------------------ the parts


def simulate(study, frequency_unit, velocity_term, seed):
    """One recording of the experiment under two readings, all channels."""
    band = [FREQUENCY[frequency_unit] * f for f in study.max_frequency]
    rng = np.random.default_rng(seed)
    reference = multisine(
        study.duration, study.sampling_time, band, study.peak, rng, max_correlation=study.max_correlation
    )
    return simulate_closed_loop(reference, study.sampling_time, PLANTS[velocity_term]())


def training(study, recording, point):
    """The part of a recording that a point is fitted to."""
    return select(
        recording.cut(round(study.trajectory / recording.dt) + 1).split(study.train_fraction, study.split_seed)[0],
        point,
    )


def fit(point, recording):
    """The model of a point, from `training` data: (KoopmanModel, "model"), or (None, why there is none)."""
    model = KoopmanModel(
        dictionary(point["dictionary"], point["draw"]), "vector_field", STATES[point["state"]][1], **readings.PAPER_FIT
    )
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
        rows += rows_of(windows, prediction, validation_seed=seed, horizon=horizon)
    return rows


def rows_of(windows, prediction, **labels):
    """NRMSE of predictions of one recording's windows: a row for each range and angle, with these labels."""
    judged = {}
    for name, range_over in RANGES.items():  # of a single window both ranges are the same
        judged[name] = (
            validation.judge(windows, prediction, range_over=range_over)
            if len(windows) > 1 or not judged
            else [*judged.values()][0]
        )
    keys = ("angle", "nrmse", "windows", "diverged")
    return [
        {**labels, "nrmse_range": name, **{key: row[key] for key in keys}}
        for name, rows in judged.items()
        for row in rows
    ]


def select(recording, point):
    """The channels of a recording that a point knows."""
    return recording.select(states=STATES[point["state"]][0], inputs=INPUTS[point["input"]])


def judge_free_runs(point, fields, truths):
    """Errors of free runs: as `judge_windows`, one list of rows a model.

    Parameters
    ----------
    point : dict
        Of one of the models; all share its dictionary, draw and state.
    fields : list of dict
        From `tras.paper.validation.field_of`, one a model.
    truths : list of dict
        Validation seed -> recording, one dict a model.
    """
    channels, delays = STATES[point["state"]]
    lifted = dictionary(point["dictionary"], point["draw"])
    lifted.fit(np.zeros((1, (4 if channels is None else len(channels)) * (delays + 1))), np.zeros((1, 2)))
    inputs = np.stack([[r.inputs[0] for r in truth.values()] for truth in truths])
    starts = np.stack([[r.states[0, : delays + 1] for r in truth.values()] for truth in truths])
    rows = [[] for _ in fields]
    for substeps in sorted({field["substeps"] for field in fields}):
        chosen = [i for i, field in enumerate(fields) if field["substeps"] == substeps]
        predicted = validation.free_runs(lifted, [fields[i] for i in chosen], starts[chosen], inputs[chosen])
        for i, runs in zip(chosen, predicted):
            for (seed, truth), run in zip(truths[i].items(), runs):
                rows[i] += rows_of(truth, run[None], validation_seed=seed, horizon="free_run")
    return rows


# ------------------------------------------------------------------------------------- what a process does of a run


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
    """Free runs of the models of one dictionary, draw and state on all validation recordings: name of a point -> rows."""
    some, fields = zip(*group)
    rows = judge_free_runs(some[0], fields, [_validation(study, folder, code, point) for point in some])
    return {_name(point): own for point, own in zip(some, rows)}


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
