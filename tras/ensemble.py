"""How sure is a prediction: the same model fitted anew to trajectories drawn with replacement (B. Efron, Ann. Statist. 7, 1979, 1).

Trajectories are what is drawn, because samples that follow each other are not independent.
"""

import numpy as np
from joblib import Parallel, delayed
from sklearn.base import clone
from tqdm import tqdm

from tras import arguments, metrics
from tras.recording import join


def bootstrap(model, recording, draws=100, rng=0, *, processes=1):
    """The model fitted to resampled recordings: an ensemble whose spread is that of the fit.

    Parameters
    ----------
    model : KoopmanModel
        Fitted: each member keeps its strength of regularisation and chooses nothing anew. It is not changed.
    recording : Recording or sequence of them
        What it was fitted to, in ten trajectories or more (`Recording.cut`).
    draws : int
        Members, 2 or more.
    rng : numpy.random.Generator or int
        Generator or seed; the same seed gives the same ensemble.
    processes : int
        Does not change the result.

    Returns
    -------
    list of KoopmanModel
        For `prediction_band`, or anything else that each member should say.

    Raises
    ------
    ValueError
        If there are fewer than ten trajectories, or a draw cannot be identified: the recording then hangs on single trajectories.

    Examples
    --------
    >>> from tras import KoopmanModel, Monomials
    >>> from tras.examples import example
    >>> log = example("duffing", noise=0)
    >>> pieces = log[[0, 1, 2]].cut(51)
    >>> model = KoopmanModel(Monomials(3)).fit(pieces)
    >>> lower, median, upper = prediction_band(bootstrap(model, pieces, draws=10), log[3].cut(51))
    >>> bool((lower <= median).all() and (median <= upper).all()), median.shape
    (True, (10, 51, 2))
    """
    recording = join(recording)
    model._fitted()
    if len(recording) < 10:
        raise ValueError(
            f"recording has {len(recording)} trajectories, and a bootstrap draws among ten or more; cut it into pieces with recording.cut(samples)."
        )
    arguments.whole_number("draws", draws, 2)
    arguments.seed("rng", rng, "the ensemble")
    chosen = np.random.default_rng(rng).integers(len(recording), size=(draws, len(recording)))
    again = clone(model).set_params(strength=float(model.strength_))
    jobs = Parallel(n_jobs=processes, return_as="generator")(delayed(_member)(again, recording, index, k) for k, index in enumerate(chosen))
    return list(tqdm(jobs, total=draws, desc="bootstrap", leave=False, disable=None))


def prediction_band(ensemble, recording, level=0.9):
    """Where the ensemble's predictions lie: each trajectory rolled out from its own first state under its own inputs.

    The band is that of the prediction, as far as it is uncertain because the data were few or noisy. Noise of a measurement comes on top, and what the
    dictionary cannot express at all is not in it.

    Parameters
    ----------
    ensemble : list of KoopmanModel
        From `bootstrap`.
    recording : Recording or sequence of them
    level : float
        Share of the members inside, at each instant and for each state by itself.

    Returns
    -------
    lower, median, upper : (trajectories, samples, n) ndarray
        Or lists of (samples_i, n) when lengths differ. A member that ran away lies beyond all others: infinitely far, to both sides in turn.

    Raises
    ------
    ValueError
        If the ensemble is empty or the level no fraction between 0 and 1.
    """
    if not ensemble:
        raise ValueError("ensemble is empty; make one with tras.bootstrap(model, recording).")
    arguments.number("level", level, 0, 1, ends=False, give="a fraction between 0 and 1, for example 0.9")
    recording = join(recording)
    with np.errstate(over="ignore", invalid="ignore"):  # what runs away is put at infinity below
        runs = [model.predict(recording) for model in ensemble]
    lost = [metrics.diverged(recording.states, run) for run in runs]
    bands = []
    for i in range(len(recording)):
        values = np.stack([run[i] for run in runs])
        for k, side in zip(np.flatnonzero([each[i] for each in lost]), np.resize([-np.inf, np.inf], len(runs))):
            values[k, ~np.isfinite(values[k])] = side
        # By order: infinite members must not spoil an interpolation between finite ones.
        bands.append(np.quantile(values, [(1 - level) / 2, 0.5, (1 + level) / 2], axis=0, method="inverted_cdf"))
    parts = list(zip(*bands))
    alike = len(set(recording.lengths)) == 1
    return tuple(np.stack(part) if alike else list(part) for part in parts)


def _member(model, recording, index, number):
    try:
        return clone(model).fit(recording[index])
    except ValueError as error:
        raise ValueError(f"draw {number} of the bootstrap cannot be identified ({error}) Record more, or fit a smaller dictionary.") from error
