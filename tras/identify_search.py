"""Which model: treatment of noise, delays, predictor, dictionary and regularisation, judged by multi-step errors on held-out pieces.

Two rounds, because all combinations would take too long: first treatments and delays, with a linear and a nonlinear model each; then every
dictionary and predictor at the best of these, and without delays. Truth is always what was measured.
"""

import math
from typing import NamedTuple

import numpy as np
import pandas as pd
from sklearn.base import clone
from tqdm import tqdm

from tras import preparation
from tras.dictionary import Monomials
from tras.mechanical import Mechanical
from tras.model import KoopmanModel
from tras.radial import GaussianRBF
from tras.selection import hold_out, multi_step_error

SEARCHED = 20_000  # snapshot pairs that the search looks at, at most
DELAYS = (0, 1, 2, 4, 8)  # tried if not told otherwise
_CHANNELS = 60  # with delays, at most
_CLOSE = 1.1  # errors within ten percent count as equal: then fewer functions win


class Treated(NamedTuple):
    """Pieces to learn from under one treatment of the noise, and held-out ones to start predictions from."""

    name: str
    train: object
    starts: object


def rolled(model, starts, latest):
    """Roll-outs (list of (samples_i, n)) that all begin at sample ``latest``, whatever the model needs to know before it."""
    first = latest - model.delays
    late = starts.with_data([x[first:] for x, _ in starts], [u[first:] for _, u in starts])
    with np.errstate(over="ignore", invalid="ignore"):  # what runs away is counted, not warned of
        return [x[model.delays :] for x in model.predict(late)]


def delays_to_try(recording, samples, asked=None, *, measured=False):
    """The delays that pieces of so many samples allow, with at most 60 channels; one at most if positions and velocities are all ``measured``."""
    if asked is not None:
        return tuple(asked)
    width = recording.n + recording.m
    return tuple(d for d in DELAYS if d == 0 or (4 * d < samples and (d + 1) * width <= _CHANNELS and (d <= 1 or not measured)))


def search(train, samples, pairs=(), *, predictor=None, delays=None, smoothing=None):
    """The best candidate, unfitted, and what was tried.

    Parameters
    ----------
    train : Recording
        Uncut.
    samples : int
        Of a piece.
    pairs : list of (str, str)
        Names of positions and their velocities, for the smoother and for `Mechanical`.
    predictor : str, optional
        The only one to try.
    delays : sequence of int, optional
        The only ones to try.
    smoothing : bool, optional
        Whether states are smoothed first; both are tried if there is noise.

    Returns
    -------
    table : pandas.DataFrame
        One row a candidate: ``round, states`` ("as measured" or "smoothed"), ``delays, predictor, dictionary, functions, strength, error`` (root mean
        square over roll-outs, in half-ranges; infinite without a model), ``chosen, failure, model`` (unfitted, the strength set to what was found).
    said : list of str
        How it went.

    Raises
    ------
    ValueError
        If the recording is too short, or nothing can be fitted.
    """
    tried = delays_to_try(train, samples, delays, measured=train.n == 2 * len(pairs))
    treated, truth, said = _treatments(train, samples, pairs, max(tried), smoothing)
    latest = max(tried)
    rows, seen = [], set()

    def attempt(number, treatment, model):
        key = (treatment.name, repr(model))
        if key not in seen:
            seen.add(key)
            rows.append({"round": number, "states": treatment.name, **_tried(treatment, model, truth, latest)})

    first = "one_step" if predictor is None else predictor
    todo = [(treatment, KoopmanModel(dictionary, first, d)) for treatment in treated for d in tried for dictionary in _two(treatment.train, d, first)]
    for treatment, model in tqdm(todo, desc="treatments and delays", leave=False, disable=None):
        attempt(1, treatment, model)
    best = _best(pd.DataFrame(rows))
    treatment = next(each for each in treated if each.name == best["states"])
    todo = [model for d in dict.fromkeys((int(best["delays"]), tried[0])) for model in _second_round(treatment.train, d, pairs, predictor)]
    for model in tqdm(todo, desc="dictionaries", leave=False, disable=None):
        attempt(2, treatment, model)
    table = pd.DataFrame(rows)
    table["chosen"] = table.index == _best(table).name
    return table, said


def _treatments(train, samples, pairs, latest, smoothing):
    """The recording cut, as measured and smoothed, the same pieces held out of both; truth is as measured."""
    sources = {"as measured": train}
    if smoothing or (smoothing is None and preparation.is_noisy(train)):
        sources["smoothed"] = None
        if smoothing:
            del sources["as measured"]
    chunks = preparation.thinned(train.cut_all(2001), 2 * SEARCHED)
    treated = []
    for name in sources:
        whole = preparation.smoothed(chunks, pairs) if name == "smoothed" else chunks
        pieces = preparation.thinned(preparation.in_pieces(whole, samples, latest + 10), SEARCHED)
        treated.append(Treated(name, *hold_out(pieces)))
    measured = hold_out(preparation.thinned(preparation.in_pieces(chunks, samples, latest + 10), SEARCHED))[1]
    if measured is None or measured.lengths.min() < latest + 5:
        raise ValueError(
            f"there are {train.pairs} snapshot pairs in {len(train)} trajectories to learn from, too few to hold out pieces of {latest + 10} samples "
            "for the choice of a model: record more, or try fewer delays."
        )
    pairs_searched = treated[0].train.pairs + measured.pairs
    said = [f"{treated[0].train.pairs} snapshot pairs for the fits, {len(measured)} held-out pieces of {int(measured.lengths[0])} samples for the errors"]
    if pairs_searched < 0.9 * train.pairs:
        said.append(f"the search looks at {pairs_searched} of {train.pairs} snapshot pairs, spread evenly; the chosen model is fitted to more")
    return treated, measured, said


def _tried(treatment, model, truth, latest):
    """A candidate's row."""
    trial, error, failure = clone(model), math.inf, ""
    half_range = np.ptp(np.concatenate([x for x, _ in truth]), axis=0) / 2
    half_range = np.where(half_range > 0, half_range, 1.0)
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            trial.fit(treatment.train)
            predicted = np.stack(rolled(trial, treatment.starts, latest)) / half_range
            scaled = truth.with_data([x[latest:] / half_range for x, _ in truth], [u[latest:] for _, u in truth])
            error = multi_step_error(predicted.transpose(1, 2, 0), scaled, truth.n)
    except (ValueError, np.linalg.LinAlgError, MemoryError) as reason:
        failure = str(reason)
    strength = getattr(trial, "strength_", np.nan)
    found = model if failure else clone(model).set_params(strength=float(strength))
    functions = len(trial.names_) if hasattr(trial, "names_") else np.nan
    about = {"delays": model.delays, "predictor": model.predictor, "dictionary": " ".join(repr(model.dictionary).split())}
    return {**about, "functions": functions, "strength": strength, "error": error, "failure": failure, "model": found}


def _best(table):
    """The row with the fewest functions among those whose error is as good as the least; delays count as functions do."""
    least = table["error"].min()
    if not math.isfinite(least):
        raise ValueError(f"none of {len(table)} candidates could be fitted; the last one because: {table['failure'].iloc[-1]}")
    close = table[table["error"] <= _CLOSE * least]
    return close.sort_values(["functions", "error"], kind="stable").iloc[0]


def label(dictionary, names=()):
    """A dictionary in a few words, its positions by the states' names."""
    if isinstance(dictionary, Monomials):
        return "linear" if dictionary.degree == 1 else f"monomials, degree {dictionary.degree}"
    if isinstance(dictionary, GaussianRBF):
        return f"{dictionary.n_centres} Gaussians"
    if isinstance(dictionary, Mechanical):
        shape = ", ".join(names[i] if i < len(names) else str(i) for i in dictionary.shape or [0])
        return f"mechanical, degree {dictionary.degree} in {shape}"
    return " ".join(repr(dictionary).split())


def _two(train, delays, predictor):
    """A linear and a nonlinear dictionary: cubic monomials while they are few, else Gaussians."""
    cubic = _monomials(train, delays, predictor, 3)
    many = Monomials(3) if cubic <= min(150, _most(train)) else GaussianRBF(60, width="auto", centres="kmeans")
    return [Monomials(1), many] if _monomials(train, delays, predictor, 1) + 60 <= _most(train) or cubic <= _most(train) else [Monomials(1)]


def _second_round(train, delays, pairs, predictor):
    """Dictionaries and predictors worth trying, the smallest first."""
    if predictor is not None:
        predictors = [predictor]
    else:  # with delays a vector field could not know the earlier inputs
        predictors = ["one_step"] if delays and train.m else ["vector_field", "one_step"]
    models = []
    for each in predictors:
        most = _most(train) if each != "vector_field" else min(150, _most(train))  # the field takes several evaluations a sample
        dictionaries = [Monomials(degree) for degree in (1, 2, 3, 4, 5) if degree == 1 or _monomials(train, delays, each, degree) <= most]
        head = _monomials(train, delays, each, 1)
        dictionaries += [GaussianRBF(count, width="auto", centres="kmeans") for count in (30, 100, 250) if head + count <= most]
        if not delays and each != "lifted_linear" and train.n == 2 * len(pairs):
            dictionaries += _mechanical(train, pairs)
        models += [KoopmanModel(dictionary, each, delays) for dictionary in dictionaries]
    return models


def _mechanical(train, pairs):
    """`Mechanical` with each position as the one that inertia and gravity depend on."""
    places = [(train.state_names.index(position), train.state_names.index(velocity)) for position, velocity in pairs]
    positions, velocities = (list(column) for column in zip(*places))
    return [Mechanical(degree, positions, velocities, [shape]) for degree in (3, 8) for shape in positions[:4]]


def _monomials(train, delays, predictor, degree):
    """How many functions monomials are."""
    channels = train.n * (delays + 1) + train.m * (0 if predictor == "lifted_linear" else 1)
    channels += train.m * delays if predictor != "vector_field" else 0
    return math.comb(channels + degree, degree)


def _most(train):
    """Functions worth trying: five snapshot pairs for each at least, and no more than a search can afford."""
    return max(train.n + train.m + 1, min(300, train.pairs // 5))
