"""How certain a prediction is: the same model fitted anew to trajectories drawn with replacement.

B. Efron, Ann. Statist. 7, 1979, 1. Whole trajectories are drawn, because neighbouring samples are not independent.
"""

from collections.abc import Sequence

import numpy as np
from sklearn.base import clone

from tras import metrics
from tras.model import KoopmanModel
from tras.recording import Recording, join
from tras.rollout import predict_coarsely
from tras.workflow import arguments
from tras.workflow.study import each


def bootstrap(
    model: KoopmanModel, recording: Recording, draws: int = 100, rng: np.random.Generator | int = 0,
    *, processes: int = 1,
) -> list[KoopmanModel]:  # fmt: skip
    """The model fitted to resampled recordings: an ensemble whose spread is that of the fit.

    Parameters
    ----------
    model : KoopmanModel
        Fitted. Each member has its strength of regularization. The model is not changed.
    recording : Recording or sequence of them
        The data of that fit, in ten trajectories or more (`Recording.cut`).
    draws : int
        Members, 2 or more.
    rng : numpy.random.Generator or int
        Generator or seed; the same seed gives the same ensemble.
    processes : int
        Does not change the result.

    Returns
    -------
    list of KoopmanModel
        For `prediction_band`, or anything else that each member can be asked.

    Raises
    ------
    ValueError
        If there are fewer than ten trajectories, or a draw cannot be identified: the fit then depends on single
        trajectories.

    Examples
    --------
    >>> from tras import KoopmanModel, Monomials
    >>> from tras.identification.examples import example
    >>> log = example("duffing", noise=0)
    >>> pieces = log[[0, 1, 2]].cut(51)
    >>> model = KoopmanModel(Monomials(3)).fit(pieces)
    >>> lower, median, upper = prediction_band(bootstrap(model, pieces, draws=10), log[3].cut(51))
    >>> bool((lower <= median).all() and (median <= upper).all()), median.shape
    (True, (10, 51, 2))
    """
    recording = join(recording)
    model.require_fitted()
    if len(recording) < 10:
        raise ValueError(
            f"recording has {len(recording)} trajectories, and a bootstrap draws among ten or more; "
            "cut it into pieces with recording.cut(samples)."
        )
    arguments.whole_number("draws", draws, 2)
    arguments.seed("rng", rng, "the ensemble")
    indices = np.random.default_rng(rng).integers(len(recording), size=(draws, len(recording)))
    unfitted = clone(model).set_params(strength=float(model.strength_))
    return each(_member, enumerate(indices), (unfitted, recording), title="bootstrap", processes=processes)


def prediction_band(ensemble: Sequence[KoopmanModel], recording: Recording, level: float = 0.9) -> tuple:
    """The band of the ensemble's predictions: each trajectory rolled out from its first state under its inputs.

    It shows how uncertain the prediction is because the data were few or noisy. It contains neither the noise of a
    measurement nor the error of what the dictionary cannot express.

    Parameters
    ----------
    ensemble : list of KoopmanModel
        From `bootstrap`.
    recording : Recording or sequence of them
    level : float
        The share of members inside, at each instant and for each state by itself.

    Returns
    -------
    lower, median, upper : (trajectories, samples, n) ndarray
        Or lists of (samples_i, n) when lengths differ. Members that diverge lie infinitely far away, above and below in
        turn.

    Raises
    ------
    ValueError
        If the ensemble is empty, or the level is not a fraction between 0 and 1.

    Examples
    --------
    >>> import numpy as np
    >>> from tras import KoopmanModel, Monomials
    >>> from tras.identification.examples import example
    >>> pieces = example("duffing")[[0, 1]].cut(51)
    >>> model = KoopmanModel(Monomials(3), strength=0.01).fit(pieces)
    >>> lower, median, upper = prediction_band(bootstrap(model, pieces, draws=5), pieces[[0]])
    >>> lower.shape, bool(np.all(lower[:, 0] == upper[:, 0]))  # all start where the recording does
    ((1, 51, 2), True)
    """
    if not ensemble:
        raise ValueError("ensemble is empty; make one with tras.bootstrap(model, recording).")
    arguments.number("level", level, 0, 1, ends=False, give="a fraction between 0 and 1, for example 0.9")
    recording = join(recording)
    with np.errstate(over="ignore", invalid="ignore"):  # divergence is put at infinity below
        runs = [predict_coarsely(model, recording) for model in ensemble]
    lost = [metrics.diverged(recording.states, run) for run in runs]
    bands = []
    for i in range(len(recording)):
        values = np.stack([run[i] for run in runs])
        for k, side in zip(np.flatnonzero([member[i] for member in lost]), np.resize([-np.inf, np.inf], len(runs))):
            values[k, ~np.isfinite(values[k])] = side
        # By order statistics: an interpolation would mix infinite members with finite ones.
        bands.append(np.quantile(values, [(1 - level) / 2, 0.5, (1 + level) / 2], axis=0, method="inverted_cdf"))
    alike = len(set(recording.lengths)) == 1
    return tuple(np.stack(part) if alike else list(part) for part in zip(*bands))


def _member(model, recording, number, index):
    try:
        return clone(model).fit(recording[index])
    except ValueError as error:
        raise ValueError(
            f"draw {number} of the bootstrap cannot be identified ({error}) Record more, or fit a smaller dictionary."
        ) from error
