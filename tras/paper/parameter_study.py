"""The plant's eight lumped parameters from identified vector fields, with and without noise, and how far they scatter."""

import pandas as pd
from sklearn.base import clone

from tras.identification.refinement import refine
from tras.paper.physics import parameter_intervals
from tras.twin_rotor.plant import PlantParameters


def parameter_study(cases, samples, draws, *, seed=0, processes=1):
    """The parameters with 95 % intervals: 1.96 standard errors to either side, from a bootstrap over trajectories.

    Without noise each draw is identified from the beginning, with the model's own strength. With noise each draw takes one more Gauss-Newton
    step of `tras.refine`, from the refined model and on the drawn trajectories, which leads to their own optimum up to second order in
    the distance; smoothing, which enters only by the states at which fields are asked, is done once.

    Parameters
    ----------
    cases : dict
        Noise in percent -> (model, recording as measured, recording smoothed); the model refined where there is noise.
    samples : int
        Length of the trajectories, the units of the bootstrap.
    draws : int
        About 20 give a standard error good to a sixth, and too few quantiles for a percentile interval.
    seed : int
        Of the draws.

    Returns
    -------
    pandas.DataFrame
        Columns ``noise`` (%), ``parameter, true, value, standard_error, low, high`` (SI) and ``error`` (% of the true value).
    """
    parts = [_intervals(level, *cases[level], samples, draws, seed, processes) for level in sorted(cases)]
    return pd.concat(parts, ignore_index=True)


def _intervals(level, model, recording, points, samples, draws, seed, processes):
    def again(resample):
        return (
            refine(model, resample, iterations=1)
            if level
            else clone(model).set_params(strength=model.strength_).fit(resample)
        )

    intervals = parameter_intervals(
        model, recording.cut(samples), draws, seed=seed, pipeline=again, points=points.cut(samples), processes=processes
    )
    value, spread = intervals["value"], intervals["standard_error"]
    true = pd.Series(PlantParameters().as_dict())[value.index].astype(float)
    table = {"noise": level, "parameter": value.index, "true": true, "value": value, "standard_error": spread}
    return pd.DataFrame(
        {**table, "low": value - 1.96 * spread, "high": value + 1.96 * spread, "error": 100 * (value / true - 1)}
    )
