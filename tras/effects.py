"""What the grid of readings tells: the effect of each option, the readings nearest to the paper's two numbers, and how much nearness means."""

import numpy as np
import pandas as pd

from tras import readings

OPTIONS = ("input", "frequency_unit", "dictionary", "state", "horizon", "nrmse_range", "velocity_term")  # that change numbers of ours
SEEDS = ("train_seed", "draw", "validation_seed")


def target(angle_names="words"):
    """The paper's NRMSE of our yaw and pitch, in percent, by the reading ``angle_names``: (yaw, pitch)."""
    if angle_names not in readings.choices("angle_names"):
        readings.Readings(angle_names=angle_names)  # says what is wrong
    values = tuple(readings.PAPER_NRMSE.values())
    # phi is "yaw" in the paper's words and pitch in its equations
    return values if angle_names == "words" else values[::-1]


def distance(yaw, pitch, angle_names="words"):
    """How far two NRMSE (percent) are from the paper's: root mean square of the two log ratios.

    Errors are positive and their grid spans decades, so 2 % and 8 % are equally far from 4 %; both angles count alike, whatever the unit.
    0.1 means that the two are off by 10 % typically, log 2 = 0.69 by a factor of two.

    Examples
    --------
    >>> round(distance(2 * 4.0589, 2 * 5.5889), 3), round(distance(5.5889, 4.0589, "symbols"), 3)
    (0.693, 0.0)
    """
    logs = [np.log(np.asarray(value) / wanted) for value, wanted in zip((yaw, pitch), target(angle_names))]
    result = np.sqrt(np.mean(np.square(logs), axis=0))
    return result if np.ndim(result) else float(result)


def pairs_of_angles(table):
    """One row a point, validation seed, horizon and range, the two angles side by side.

    Parameters
    ----------
    table : pandas.DataFrame
        From `tras.grid_run.run`.

    Returns
    -------
    pandas.DataFrame
        Options and seeds, ``yaw, pitch`` (NRMSE in percent; NaN unless there is a model and nothing diverged), ``windows, diverged``,
        ``has_model``. A free run is one window, whose own range is the recording's: its rows with ``nrmse_range`` "trajectory" repeat the others.
    """
    wide = table.set_index([*OPTIONS, *SEEDS, "angle"]).unstack("angle")
    result = pd.DataFrame({angle: wide["nrmse", angle] for angle in ("yaw", "pitch")})
    result["windows"], result["diverged"] = wide["windows", "yaw"].astype(int), wide["diverged", "yaw"].astype(int)
    result["has_model"] = wide["outcome", "yaw"] == "model"
    result.loc[~result["has_model"] | (result["diverged"] > 0), ["yaw", "pitch"]] = np.nan
    return result.reset_index()


def summary(table):
    """One row a reading, over all of its seeds.

    Returns
    -------
    pandas.DataFrame
        The seven options; ``yaw, pitch`` (median NRMSE in percent) with ``_lowest`` and ``_highest``; ``runs`` (fits times validation recordings),
        ``without_model, windows, diverged``; ``complete``: there is a model for every seed and nothing diverged. Numbers of the others are of
        what is left, or NaN.
    """
    groups = pairs_of_angles(table).groupby(list(OPTIONS), sort=False)
    parts = {}
    for angle in ("yaw", "pitch"):
        parts |= {angle: groups[angle].median(), f"{angle}_lowest": groups[angle].min(), f"{angle}_highest": groups[angle].max()}
    parts |= {"runs": groups.size(), "without_model": groups["has_model"].agg(lambda has: int((~has).sum()))}
    parts |= {name: groups[name].sum() for name in ("windows", "diverged")}
    result = pd.DataFrame(parts).reset_index()
    result["complete"] = (result["without_model"] == 0) & (result["diverged"] == 0)
    return result


def nearest(table):
    """All complete readings, each under both namings of the angles, the nearest to the paper first.

    Returns
    -------
    pandas.DataFrame
        As `summary`, with ``angle_names, distance`` (of the medians) and ``distance_lowest, distance_highest`` over the single runs. Free runs stand
        once, under the range of the validation set.
    """
    kept = summary(table).query("complete")
    kept = kept[(kept["horizon"] != "free_run") | (kept["nrmse_range"] == "validation_set")]
    runs = pairs_of_angles(table)
    parts = []
    for names in readings.choices("angle_names"):
        spread = runs.assign(d=distance(runs["yaw"], runs["pitch"], names)).groupby(list(OPTIONS))["d"].agg(["min", "max"])
        spread = spread.rename(columns={"min": "distance_lowest", "max": "distance_highest"})
        own = kept.assign(angle_names=names, distance=distance(kept["yaw"], kept["pitch"], names))
        parts.append(own.join(spread, on=list(OPTIONS)))
    return pd.concat(parts).sort_values("distance", kind="stable", ignore_index=True)


def departures(ranking, default):
    """In how many options each row of `nearest` differs from the default reading: (rows,) int."""
    return sum((ranking[option] != getattr(default, option)).astype(int) for option in (*OPTIONS, "angle_names")).to_numpy()


def chance(ranking, within, rng, *, among=None, draws=2000):
    """Share of random pairs of numbers that have a reading as near as ``within``: how little it means that the paper's pair has one.

    Parameters
    ----------
    ranking : pandas.DataFrame
        From `nearest`.
    within : float
        A distance.
    rng : numpy.random.Generator
        Draws the pairs log-uniformly between the 5 % and 95 % quantiles of the readings' own yaw and pitch NRMSE.
    among : (rows,) bool array_like, optional
        The readings that may serve; default all.
    draws : int

    Returns
    -------
    float
    """
    logs, words = np.log(ranking[["yaw", "pitch"]].to_numpy()), (ranking["angle_names"] == "words").to_numpy()
    random = rng.uniform(*np.quantile(logs, [0.05, 0.95], axis=0), (draws, 2))
    among = np.ones(len(ranking), dtype=bool) if among is None else np.asarray(among)
    hit = np.zeros(draws, dtype=bool)
    for rows, pairs in ((words & among, random), (~words & among, random[:, ::-1])):  # by the symbols, a pair is the other way round
        hit |= (np.sqrt(np.mean((pairs[:, None] - logs[rows]) ** 2, axis=2)) <= within).any(axis=1)
    return float(hit.mean())


def effects(table, default):
    """What each choice does to the error, all else equal: ratios of NRMSE to that under the default choice, over all pairs of points.

    Parameters
    ----------
    table : pandas.DataFrame
        From `tras.grid_run.run`.
    default : tras.readings.Readings

    Returns
    -------
    pandas.DataFrame
        Columns ``option, choice, angle, pairs`` (with a number on both sides), ``lost`` (without), ``median, q05, q25, q75, q95`` of the ratio.
        Random centres are averaged over their draws (median) before; free runs are left out of ``nrmse_range``, which they do not know.
    """
    runs = pairs_of_angles(table)
    rows = []
    for option in OPTIONS:
        here = runs[runs["horizon"] != "free_run"] if option == "nrmse_range" else runs
        others = [name for name in (*OPTIONS, *SEEDS) if name not in (option, "draw")]
        for angle in ("yaw", "pitch"):
            wide = here.groupby([*others, option])[angle].agg(lambda v: v.median(skipna=False)).unstack(option)
            base = getattr(default, option)
            for choice in (c for c in readings.choices(option) if c != base and c in wide):
                ratio = (wide[choice] / wide[base]).dropna()
                quantiles = ratio.quantile([0.5, 0.05, 0.25, 0.75, 0.95]) if len(ratio) else [np.nan] * 5
                numbers = dict(zip(("median", "q05", "q25", "q75", "q95"), quantiles))
                rows.append({"option": option, "choice": choice, "angle": angle, "pairs": len(ratio), "lost": len(wide) - len(ratio), **numbers})
    return pd.DataFrame(rows)
