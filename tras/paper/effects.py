"""Effects of the options in the grid of readings, the readings nearest to the paper, and what nearness means."""

import numpy as np
import pandas as pd

from tras.paper import readings

# Options that change our numbers
OPTIONS = tuple(option for option in readings.OPTIONS if option != "angle_names")
SEEDS = ("train_seed", "draw", "validation_seed")
ONCE = "horizon != 'free_run' or nrmse_range == 'validation_set'"  # the range of a free run is the same twice


def target(angle_names: str = "words") -> tuple[float, float]:
    """The paper's NRMSE of our (yaw, pitch), in percent, by the reading ``angle_names``."""
    readings.Readings(angle_names=angle_names)  # raises on an unknown name
    values = tuple(readings.PAPER_NRMSE.values())
    return values if angle_names == "words" else values[::-1]  # phi is yaw in the paper's words, pitch in its equations


def distance(yaw, pitch, angle_names: str = "words"):
    """Distance of two NRMSE (percent) from the paper's: root mean square of the two log ratios.

    2 % and 8 % are equally far from 4 %, both angles have the same weight. A distance of 0.1 means typical deviations
    of 10 %, log 2 = 0.69 those by a factor of two.

    Examples
    --------
    >>> round(distance(2 * 4.0589, 2 * 5.5889), 3), round(distance(5.5889, 4.0589, "symbols"), 3)
    (0.693, 0.0)
    """
    logs = [np.log(np.asarray(value) / paper) for value, paper in zip((yaw, pitch), target(angle_names))]
    result = np.sqrt(np.mean(np.square(logs), axis=0))
    return result if np.ndim(result) else float(result)


def pairs_of_angles(table: pd.DataFrame) -> pd.DataFrame:
    """One row per point, validation seed, horizon and range, with the two angles side by side.

    Parameters
    ----------
    table : pandas.DataFrame
        From `tras.paper.grid.run`.

    Returns
    -------
    pandas.DataFrame
        Options and seeds, ``yaw, pitch`` (NRMSE in percent; NaN unless there is a model and nothing diverged),
        ``windows, diverged``, ``has_model``. A free run is one window and its range is the recording's, so its rows
        with ``nrmse_range`` "trajectory" repeat the others.
    """
    wide = table.set_index([*OPTIONS, *SEEDS, "angle"]).unstack("angle")
    result = pd.DataFrame({angle: wide["nrmse", angle] for angle in ("yaw", "pitch")})
    result["windows"], result["diverged"] = wide["windows", "yaw"].astype(int), wide["diverged", "yaw"].astype(int)
    result["has_model"] = wide["outcome", "yaw"] == "model"
    result.loc[~result["has_model"] | (result["diverged"] > 0), ["yaw", "pitch"]] = np.nan
    return result.reset_index()


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """One row per reading, over all of its seeds.

    Returns
    -------
    pandas.DataFrame
        The seven options; ``yaw, pitch`` (median NRMSE in percent) with ``_lowest`` and ``_highest``; ``runs`` (fits
        times validation recordings), ``without_model, windows, diverged``; ``complete``: every seed has a model and
        nothing diverged. The numbers of an incomplete reading are those of its complete runs, or NaN.
    """
    groups = pairs_of_angles(table).groupby(list(OPTIONS), sort=False)
    parts = {}
    for angle in ("yaw", "pitch"):
        values = groups[angle]
        parts |= {angle: values.median(), f"{angle}_lowest": values.min(), f"{angle}_highest": values.max()}
    parts |= {"runs": groups.size(), "without_model": groups.size() - groups["has_model"].sum()}
    parts |= {name: groups[name].sum() for name in ("windows", "diverged")}
    result = pd.DataFrame(parts).reset_index()
    result["complete"] = (result["without_model"] == 0) & (result["diverged"] == 0)
    return result


def nearest(table: pd.DataFrame) -> pd.DataFrame:
    """All complete readings, each under both namings of the angles, the nearest to the paper first.

    Returns
    -------
    pandas.DataFrame
        As `summary`, with ``angle_names, distance`` (of the medians) and ``distance_lowest, distance_highest`` over the
        single runs. Free runs appear once, under the range of the validation set.
    """
    complete = summary(table).query(f"complete and ({ONCE})")
    runs = pairs_of_angles(table)
    parts = []
    for names in readings.choices("angle_names"):
        distances = runs.assign(distance=distance(runs["yaw"], runs["pitch"], names)).groupby(list(OPTIONS))["distance"]
        spread = distances.agg(distance_lowest="min", distance_highest="max")
        medians = complete.assign(angle_names=names, distance=distance(complete["yaw"], complete["pitch"], names))
        parts.append(medians.join(spread, on=list(OPTIONS)))
    return pd.concat(parts).sort_values("distance", kind="stable", ignore_index=True)


def departures(ranking: pd.DataFrame, default: readings.Readings) -> np.ndarray:
    """Number of options in which each row of `nearest` differs from the default reading: (rows,) int."""
    options = [*OPTIONS, "angle_names"]
    return (ranking[options] != [getattr(default, option) for option in options]).sum(axis=1).to_numpy()


def without_refinement(ranking: pd.DataFrame, default: readings.Readings) -> pd.DataFrame:
    """The rows of `nearest` that were tried before any was known to be near, in their order.

    These are the full product and what differs from the default in one option. Gains and plants round a near reading
    were placed beside the paper's numbers: for them `chance` would be too small.
    """
    changed = ranking[list(OPTIONS)] != [getattr(default, option) for option in OPTIONS]
    return ranking[~changed[list(readings.SINGLE)].any(axis=1) | (changed.sum(axis=1) <= 1)].reset_index(drop=True)


def chance(ranking: pd.DataFrame, within: float, rng: np.random.Generator, *, among=None, draws: int = 2000) -> float:
    """Share of random pairs of numbers with a reading as near as ``within``: if it is large, nearness means little.

    Parameters
    ----------
    ranking : pandas.DataFrame
        From `nearest`, `without_refinement`.
    within : float
        A distance.
    rng : numpy.random.Generator
        Draws the pairs log-uniformly between the 5 % and 95 % quantiles of the readings' yaw and pitch NRMSE.
    among : (rows,) bool array_like, optional
        The readings that count; default all.
    draws : int
    """
    logs, words = np.log(ranking[["yaw", "pitch"]].to_numpy()), (ranking["angle_names"] == "words").to_numpy()
    random = rng.uniform(*np.quantile(logs, [0.05, 0.95], axis=0), (draws, 2))
    among = np.ones(len(ranking), dtype=bool) if among is None else np.asarray(among)
    near = np.zeros(draws, dtype=bool)
    for rows, pairs in ((words & among, random), (~words & among, random[:, ::-1])):  # the symbols exchange the angles
        near |= (np.sqrt(np.mean((pairs[:, None] - logs[rows]) ** 2, axis=2)) <= within).any(axis=1)
    return float(near.mean())


def effects(table: pd.DataFrame, default: readings.Readings) -> pd.DataFrame:
    """Effect of each choice on the error: ratios of the NRMSE to that of the default choice, all else equal.

    Parameters
    ----------
    table : pandas.DataFrame
        From `tras.paper.grid.run`; what was varied one at a time may stand below the full product.
    default : tras.paper.readings.Readings

    Returns
    -------
    pandas.DataFrame
        Columns ``option, choice, angle, pairs`` (of points with both numbers), ``lost`` (the other pairs), ``median``,
        ``q05, q25, q75, q95`` of the ratio. The median over the draws stands for random centres. ``nrmse_range`` leaves
        out free runs, for which its choices do not differ.
    """
    runs, rows = pairs_of_angles(table), []
    for option in OPTIONS:
        points = runs[runs["horizon"] != "free_run"] if option == "nrmse_range" else runs
        others = [name for name in (*OPTIONS, *SEEDS) if name not in (option, "draw")]
        base = getattr(default, option)
        is_base = points[option] == base
        sides = [points.loc[side, others].drop_duplicates() for side in (is_base, ~is_base)]
        points = points.merge(sides[0].merge(sides[1]))  # both sides of a comparison were tried
        for angle in ("yaw", "pitch"):
            wide = points.groupby([*others, option])[angle].agg(lambda v: v.median(skipna=False)).unstack(option)
            for choice in (name for name in readings.choices(option) if name != base and name in wide):
                ratio = (wide[choice] / wide[base]).dropna()
                quantiles = ratio.quantile([0.5, 0.05, 0.25, 0.75, 0.95])
                rows.append((option, choice, angle, len(ratio), len(wide) - len(ratio), *quantiles))
    return pd.DataFrame(rows, columns="option choice angle pairs lost median q05 q25 q75 q95".split())


def first(ranking: pd.DataFrame, angle_names: str) -> readings.Readings:
    """The nearest reading under one naming of the angles, from `nearest`."""
    row = ranking[ranking["angle_names"] == angle_names].iloc[0]
    return readings.Readings(**{option: row[option] for option in readings.OPTIONS})


def describe(reading, default: readings.Readings | None = None) -> str:
    """A reading, as a row or dict, by what is not the default in it.

    Examples
    --------
    >>> describe(readings.Readings(input="torque", start="hanging").model_dump())
    'input torque, start hanging'
    """
    usual = (default or readings.Readings()).model_dump()
    departures = [name for name in usual if name in reading and reading[name] != usual[name]]
    return ", ".join(f"{name} {reading[name]}" for name in departures) or "default"
