"""Runs the grid of readings (`tras.grid`): in processes, with every result kept in a small file, so that a killed run goes on where it was."""

import itertools
import json
import math
import os
import sys
from contextlib import closing, nullcontext
from pathlib import Path

import pandas as pd
from tqdm import tqdm

from tras import cache, executors, grid, readings, stacked, validation
from tras.closed_loop import REFERENCE_NAMES
from tras.grid import RANGES, SIMULATION
from tras.plant import STATE_NAMES, TORQUE_NAMES
from tras.recording import Recording

EXPERIMENT = ("duration", "sampling_time", "max_frequency", "peak", "max_correlation")
FIT = (*EXPERIMENT, "trajectory", "window", "train_fraction", "split_seed", "validation_seeds")


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
        One row a point, validation seed, horizon, range and angle: the options of the reading (without ``angle_names``), ``train_seed, draw,
        validation_seed, angle, nrmse`` (percent; NaN without a model or if all windows diverged), ``windows, diverged``, ``outcome`` ("model" or
        why there is none), ``N, condition``.
    counts : dict
        ``computed, cached``: points whose fit was computed, or found in the cache.
    """
    folder, wanted = Path(folder), grid.points(study, only)
    cache.clear_temporaries(folder)
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


def terminal():
    """The terminal behind a notebook's kernel, for a progress bar that shall not enter the notebook: a context with a stream, or with None."""
    number = getattr(sys.stderr, "_original_stdstream_copy", None)  # where ipykernel keeps it
    if number is not None and os.isatty(number):
        return os.fdopen(os.dup(number), "w")
    return nullcontext(sys.stderr if sys.stderr.isatty() else None)


def _recording(folder, study, frequency_unit, velocity_term, seed):
    """`simulate`, from the cache if it is there."""
    options = {**_options(study, EXPERIMENT), "frequency_unit": frequency_unit, "velocity_term": velocity_term, "seed": seed}
    path = cache.place(folder, "recording", options, cache.code_digest("tras.grid"), ".npz")
    arrays = cache.read_arrays(path)
    if arrays is None:
        made = grid.simulate(study, frequency_unit, velocity_term, seed)
        arrays = {"states": made.states, "inputs": made.inputs}
        cache.write_arrays(path, **arrays)
    names = {"state_names": STATE_NAMES, "input_names": REFERENCE_NAMES + TORQUE_NAMES}
    return Recording(arrays["states"], arrays["inputs"], study.sampling_time, **names)


def _validation(folder, study, point):
    recordings = {seed: _recording(folder, study, *(point[name] for name in SIMULATION), seed) for seed in study.validation_seeds}
    return {seed: grid.select(recording, point) for seed, recording in recordings.items()}


def _place_of_point(folder, study, point):
    options = {**_options(study, FIT), **point}
    return cache.place(folder, "point", options, cache.code_digest("tras.grid")), options


def _fit_points(folder, study, some):
    """Fit and judge points of one training recording, input and state, and store each."""
    for point in some:
        recording = _recording(folder, study, *(point[name] for name in SIMULATION), point["train_seed"])
        path, options = _place_of_point(folder, study, point)
        model, outcome = grid.fit(point, grid.training(study, recording, point))
        value = {"outcome": outcome, "rows": []}
        if model:
            value |= {"N": len(model.names_), "condition": model.condition_number, "field": stacked.field_of(model)}
            value["rows"] = grid.judge_windows(study, model, _validation(folder, study, point))
        cache.write(path, options, value)


def _run_freely(folder, study, some, fields, path, options):
    """Free runs of the models of one dictionary, draw and state, on all validation recordings, and store them."""
    rows = grid.judge_free_runs(some[0], fields, [_validation(folder, study, point) for point in some])
    cache.write(path, options, {_name(point): own for point, own in zip(some, rows)})


def _free_runs(folder, study, some, found, processes, progress):
    """Name of a point -> rows of its free runs."""
    groups, code = [], cache.code_digest("tras.grid")
    for group in _grouped(some, ("state", "dictionary", "draw")):
        options = {**_options(study, FIT), "points": [_name(point) for point in group]}
        groups.append((group, cache.place(folder, "free", options, code), options))
    missing = [group for group in groups if cache.read(*group[1:]) is None]
    jobs = [(folder, study, group, [found[_name(point)]["field"] for point in group], *rest) for group, *rest in missing]
    _each(_run_freely, jobs, "run freely", processes, progress)
    rows = {}
    for _, path, options in groups:
        rows |= cache.read(path, options)
    return rows


def _each(work, jobs, title, processes, progress):
    """Do all jobs, in processes, with a bar."""
    if not jobs:
        return
    results = executors.run(work, jobs, scheduler=None if processes == 1 else "processes", processes=processes)
    with closing(results), tqdm(total=len(jobs), desc=title, file=progress, disable=progress is None) as bar:
        for _, result in results:
            if isinstance(result, executors.Lost):
                raise executors.SchedulerError(f"a job of {title!r} was lost: {result.reason}; use fewer processes.")
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


def _options(study, names):
    """Some of the study's fields as JSON holds them."""
    return json.loads(json.dumps({name: getattr(study, name) for name in names}))
