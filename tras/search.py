"""Which dictionary, how large, how many delays: candidates judged by multi-step error on trajectories that none of them was fitted to."""

import math

import numpy as np
import pandas as pd
from sklearn.base import clone
from tqdm import tqdm

from tras import dictionary, mechanical, radial
from tras.model import KoopmanModel
from tras.recording import Recording, join
from tras.selection import hold_out, multi_step_error


def candidates(recording, predictor="vector_field", delays=0):
    """Models worth trying on a recording of which nothing else is known, the simplest first.

    Linear; monomials of degree 2 to 4 and Gaussians on 50 and 200 k-means centres, as long as there are two snapshot pairs a function and at most 500
    functions; and, if the number of states is even and nothing is delayed, `Mechanical`, which takes the states for position, velocity, position, ...
    """
    channels = recording.n * (delays + 1) + recording.m * (delays + 1 if predictor != "vector_field" else 1)
    most = min(500, recording.pairs // 2)
    dictionaries = [dictionary.Monomials(degree) for degree in (1, 2, 3, 4) if degree == 1 or math.comb(channels + degree, degree) <= most]
    dictionaries += [radial.GaussianRBF(count, width="auto", centres="kmeans") for count in (50, 200) if 1 + channels + count <= most]
    if recording.n % 2 == 0 and not delays and predictor != "lifted_linear":
        dictionaries.append(mechanical.Mechanical())
    return [KoopmanModel(each, predictor, delays) for each in dictionaries]


def choose(recording, models=None):
    """The best of several models: those fitted to four fifths of the trajectories are compared on the last fifth, the winner is fitted to all.

    The error is that of whole roll-outs of up to 501 samples, which is what a user of the model sees; a candidate that runs away loses by it. Each candidate
    still chooses its own strength of regularisation, on trajectories of its four fifths.

    Parameters
    ----------
    recording : Recording or sequence of them
    models : sequence of estimators, optional
        Anything with ``fit(recording)`` and ``predict(recording)`` that `sklearn.base.clone` can copy. Default: `candidates`.

    Returns
    -------
    model : KoopmanModel
        Fitted to the whole recording.
    table : pandas.DataFrame
        One row a candidate: ``candidate`` (its dictionary, delays if any), ``functions, strength, error`` (root mean square in half-ranges of the states, a
        sample counts 10 at most; infinite without a model), ``chosen, failure`` (empty, or why there is no model), ``model`` (the estimator, unfitted).

    Raises
    ------
    ValueError
        If the recording is too short to hold anything out, or no candidate could be fitted.

    Examples
    --------
    >>> from tras import multisine, simulate_closed_loop
    >>> recording = simulate_closed_loop(multisine(40, 0.01, [1.0, 2.0], [0.8, 2.0], 0), 0.01).select(inputs=["u_phi", "u_psi"])
    >>> models = [KoopmanModel(dictionary.Monomials(1)), KoopmanModel(mechanical.Mechanical(5))]
    >>> model, table = choose(recording.cut(201), models)
    >>> model.dictionary
    Mechanical(degree=5)
    """
    recording = join(recording)
    models = candidates(recording) if models is None else list(models)
    if not models:
        raise ValueError("models holds no candidate; give one or more, for example [tras.KoopmanModel(tras.Monomials(2))].")
    train, held = hold_out(recording)
    if held is None:
        raise ValueError(f"the recording has {recording.pairs} snapshot pairs, too few to hold trajectories out for the choice; record more, or fit one model.")
    # All predictions begin at the same instant, whatever a model needs to know before it.
    latest = max(getattr(model, "delays", 0) for model in models)
    rows = []
    for model in tqdm(models, desc="choose", leave=False, disable=None):
        trial, error, failure = clone(model), math.inf, ""
        try:
            with np.errstate(over="ignore", invalid="ignore"):  # what runs away is counted, not warned of
                error = _error(trial.fit(train), held, latest)
        except ValueError as reason:
            failure = str(reason)
        functions = len(trial.names_) if hasattr(trial, "names_") else np.nan
        rows.append([_label(model), functions, getattr(trial, "strength_", np.nan), error, False, failure, model])
    table = pd.DataFrame(rows, columns=["candidate", "functions", "strength", "error", "chosen", "failure", "model"])
    if np.isinf(table["error"]).all():
        raise ValueError(f"none of the {len(models)} candidates could be fitted; the last one because: {table['failure'].iloc[-1]}")
    best = int(table["error"].to_numpy().argmin())
    table.loc[best, "chosen"] = True
    return clone(models[best]).fit(recording), table


def _label(model):
    """A candidate in one line."""
    delays = getattr(model, "delays", 0)
    return " ".join(repr(getattr(model, "dictionary", model)).split()) + (f", {delays} delays" if delays else "")


def _error(model, held, latest):
    """Multi-step error from the sample ``latest`` on, in half-ranges of the held-out states."""
    return relative_error(*roll_outs(model, held, latest), np.ptp(held.states, axis=(0, 1)) / 2)


def roll_outs(model, held, latest):
    """States and predictions (trajectories, samples, n) from the sample ``latest`` on: the same instant for all models, however many delays they have."""
    first = latest - getattr(model, "delays", 0)
    late = Recording(
        held.states[:, first:], held.inputs[:, first:], held.dt,
        state_names=held.state_names, input_names=held.input_names, state_units=held.state_units, input_units=held.input_units,
    )  # fmt: skip
    return late.states[:, latest - first :], np.asarray(model.predict(late))[:, latest - first :]


def relative_error(true, predicted, half_range):
    """`tras.selection.multi_step_error` of `roll_outs`, in half-ranges of the states (n,)."""
    scaled = Recording(true / half_range, None, 1.0)
    return multi_step_error((predicted / half_range).transpose(1, 2, 0), scaled, true.shape[-1])
