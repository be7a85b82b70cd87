"""The plant's eight lumped parameters from identified vector fields, with and without noise, and how far they scatter."""

import numpy as np
import pandas as pd
from joblib import Parallel, delayed
from sklearn.base import clone

from tras.refinement import refine
from tras.physics import parameter_intervals
from tras.plant import PlantParameters

_BATCHES = 2  # of draws, which can be had at the same time


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
        Four or more. About 20 give a standard error good to a sixth, and too few quantiles for a percentile interval.
    seed : int
        Of the draws.

    Returns
    -------
    pandas.DataFrame
        Columns ``noise`` (%), ``parameter, true, value, standard_error, low, high`` (SI) and ``error`` (% of the true value).
    """
    levels = sorted(cases, reverse=True)  # with noise it takes longer: that begins first
    jobs = [(level, seed + k) for level in levels for k in range(_BATCHES)]
    batches = Parallel(n_jobs=processes)(delayed(_bootstrap)(level, *cases[level], samples, draws // _BATCHES, k) for level, k in jobs)
    parts = [_summary(level, batches[i * _BATCHES : (i + 1) * _BATCHES]) for i, level in enumerate(levels)]
    return pd.concat(parts[::-1], ignore_index=True)


def _bootstrap(level, model, recording, points, samples, draws, seed):
    def again(drawn):
        return refine(model, drawn, iterations=1) if level else clone(model).set_params(strength=model.strength_).fit(drawn)

    return parameter_intervals(model, recording.cut(samples), draws, seed=seed, pipeline=again, points=points.cut(samples))


def _summary(level, batches):
    """One table of all draws: batches of equal size, so their variances are averaged."""
    value = batches[0]["value"]
    spread = np.sqrt(np.mean([batch["standard_error"] ** 2 for batch in batches], axis=0))
    true = pd.Series(PlantParameters().as_dict())[value.index].astype(float)
    table = {"noise": level, "parameter": value.index, "true": true, "value": value, "standard_error": spread}
    return pd.DataFrame({**table, "low": value - 1.96 * spread, "high": value + 1.96 * spread, "error": 100 * (value / true - 1)})
