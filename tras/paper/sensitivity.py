"""How much the numbers of the sensitive classes scatter when the data change by one unit in the last place.

`make bless` repeats what `tras.paper.classes.SENSITIVE` names on `PERTURBATIONS` copies of the recordings, each number
of which is the next one above or below, by chance, and stores for each row the interval that every result takes. What
is in the cache is not computed again.
"""

import io
import json
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
from tqdm import tqdm

from tras.paper import classes, comparison, effects, grid, readings
from tras.paper.figures.comparison import data_table, horizon_table
from tras.recording import Recording
from tras.workflow import cache, provenance
from tras.workflow.study import compute

PERTURBATIONS = 20


def nudged(values: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Each number replaced by the next one above or below, by chance."""
    up = rng.random(np.shape(values)) < 0.5
    return np.nextafter(values, np.where(up, np.inf, -np.inf))


def nudged_recording(recording: Recording, seed: int) -> Recording:
    """A recording with every state and input moved by one unit in the last place."""
    rng = np.random.default_rng(seed)
    return recording.with_data(*zip(*[(nudged(x, rng), nudged(u, rng)) for x, u in recording]))


def spreads(
    tables: list[Path], *, count: int = PERTURBATIONS, processes: int = 2, progress=None
) -> dict[Path, pd.DataFrame]:
    """The intervals of all sensitive rows of some tables.

    Parameters
    ----------
    tables : list of Path
        As make builds them, from its folder; what no class in `SENSITIVE` names is left out.
    count : int
        Perturbations.
    processes : int
    progress : bool or text stream, optional
        As for `tras.workflow.study.compute`.

    Returns
    -------
    dict of Path to pandas.DataFrame
        Per table the frame of `interval`.
    """
    rules = {table: rule for table in tables if (rule := classes.sensitive(table))}
    copies = {table: [] for table in rules}
    for study in (_comparison, _readings):
        for perturbed in study(list(rules), count, processes, progress):
            for table in rules.keys() & perturbed.keys():
                copies[table].append(perturbed[table])
    return {table: interval(pd.read_csv(table), copies[table], rule) for table, rule in rules.items()}


def interval(reference: pd.DataFrame, perturbed: list[pd.DataFrame], rule: classes.Sensitive) -> pd.DataFrame:
    """Lowest and highest result of each sensitive row, over the reference and the perturbed tables.

    Returns
    -------
    pandas.DataFrame
        The keys; ``tables``, how many of the tables have the row; for each column of numbers ``NAME.low, NAME.high`` of
        the finite ones and ``NAME.lost``, how often it is none; for each column of text ``NAME``, all that stood there,
        with "|" between.
    """
    frames = [reference, *map(_as_written, perturbed)]
    frames = [frame[classes.selected(dict(frame.items()), rule)] for frame in frames]
    keys = [name for name in reference if name not in rule.values]
    groups = pd.concat(frames, ignore_index=True).groupby(keys, sort=False, dropna=False)
    result = {"tables": groups.size()}
    for name in (name for name in reference if name in rule.values):
        if all(pd.api.types.is_numeric_dtype(frame[name]) and frame[name].dtype != bool for frame in frames):
            finite = groups[name].agg(lambda values: list(values[np.isfinite(values)]))
            result[f"{name}.low"] = finite.map(lambda values: min(values, default=np.nan))
            result[f"{name}.high"] = finite.map(lambda values: max(values, default=np.nan))
            result[f"{name}.lost"] = groups.size() - finite.map(len)
        else:
            result[name] = groups[name].agg(lambda values: "|".join(sorted(set(values.fillna("").astype(str)))))
    return pd.DataFrame(result).reset_index()


def _as_written(frame):
    """A table as it comes back from its file: ten digits, and columns typed by their text."""
    return pd.read_csv(io.StringIO(frame.to_csv(index=False, float_format="%.10g")))


def _parameters(table):
    """The parameters of the stage that wrote a table."""
    return json.loads(provenance.beside(table).read_text(encoding="utf-8"))["parameters"]


def _options(of, parameters):
    """The parameters that a study has under the same name."""
    known = {name: parameters[name] for name in of.__dataclass_fields__ if name in parameters}
    return {name: tuple(value) if isinstance(value, list) else value for name, value in known.items()}


# --- 07_comparison ----------------------------------------------------------------------------------------------------


def _comparison(tables, count, processes, progress):
    """Per perturbation the sensitive methods' tables, and those of their figures."""
    scores = Path("data/comparison.csv")
    if scores not in tables:
        return
    study = comparison.Study(**_options(comparison.Study, _parameters(scores)))
    options = {"only": classes.RIVALS, "processes": processes}
    recordings = comparison.recordings(scores.parent)
    for seed in tqdm(range(count), "perturb the comparison", disable=not progress, file=progress or None):
        train, fresh = nudged_recording(recordings[0], seed), recordings[1]
        fresh = {name: nudged_recording(recording, seed) for name, recording in fresh.items()}
        results = comparison.run(study, train, fresh, scores.parent / "cache", **options)
        horizon, amounts = horizon_table(results["scores"]), results["data"]
        yield {
            scores: results["scores"],
            scores.with_name("comparison_tuning.csv"): results["tuning"],
            scores.with_name("comparison_data.csv"): amounts,
            Path("figures/comparison_horizon.csv"): horizon,
            Path("figures/comparison_window.csv"): horizon[horizon["horizon"] == study.window],
            Path("figures/comparison_data.csv"): data_table(amounts[amounts["input"].isin(study.data_inputs)]),
        }


# --- 06_readings ------------------------------------------------------------------------------------------------------


def _readings(tables, count, processes, progress):
    """Per perturbation the sensitive readings, and the tables of their figures with these in their place."""
    table = Path("data/readings.csv")
    if table not in tables:
        return
    parameters, rule = _parameters(table), classes.sensitive(table)
    (only,) = rule.rows
    options = _options(grid.Study, parameters)
    for name in ("max_frequency", "peak"):
        options[name] = tuple(parameters[f"{angle}_{name}"] for angle in ("pitch", "yaw"))
    study, reference = grid.Study(**options), pd.read_csv(table)
    around = pd.read_csv(table.with_name("readings_around.csv"))
    keys = [cache.plain({"parameters": parameters, "only": only, "seed": seed}) for seed in range(count)]
    results, _ = compute(
        _perturbed_grid, list(range(count)), (study, only, table.parent / "cache"), keys=keys,
        folder=table.parent / "cache", kind="perturbed", code=cache.code_digest("tras.paper.grid"),
        title="perturb the readings", unit=" perturbations", progress=progress, processes=processes,
    )  # fmt: skip
    default = readings.Readings(**parameters["default"])
    for columns in results:
        perturbed = pd.DataFrame(columns).astype({name: reference[name].dtype for name in columns})
        whole = _in_place(reference, perturbed, rule)
        yield {
            table: perturbed,
            Path("figures/readings_effects.csv"): effects.effects(pd.concat([whole, around]), default),
            Path("figures/readings_nearest.csv"): effects.nearest(pd.concat([whole, around])),
        }


def _perturbed_grid(study, only, folder, seed):
    """The columns of a part of the grid, from perturbed copies of the recordings that the stage left in its cache."""
    own = folder / f"perturbed-{seed}"
    own.mkdir(parents=True, exist_ok=True)
    names, rng = sorted(path.name for path in folder.glob("recording-*.npz")), np.random.default_rng(seed)
    for name in names:
        arrays = cache.read_arrays(folder / name) or {}
        cache.write_arrays(own / name, **{key: nudged(values, rng) for key, values in arrays.items()})
    table, _ = grid.run(study, grid.points(study, only), own, processes=1)
    if sorted(path.name for path in own.glob("recording-*.npz")) != names:
        raise RuntimeError("the grid has simulated recordings anew, so they were not perturbed: make clean, make all.")
    shutil.rmtree(own)
    return table.to_dict("list")


def _in_place(reference, perturbed, rule):
    """The reference table with its sensitive rows replaced, in its order."""
    keys = [name for name in reference if name not in rule.values]
    new = reference[keys].merge(perturbed, on=keys, how="left", indicator=True, validate="one_to_one")
    return new.drop(columns="_merge").where(new["_merge"] == "both", reference)[list(reference)]
