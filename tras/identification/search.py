"""Which dictionary, predictor, delays and treatment of noise: candidates judged by roll-outs of held-out trajectories.

`choose` compares the models that it is given. `search`, for `tras.identify`, has two rounds of its own, because all
combinations take too long: treatments and delays, with a linear and a nonlinear dictionary; then every dictionary and
predictor at the best of these, and without delays.
"""

import math
from collections.abc import Iterable, Sequence

import numpy as np
import pandas as pd
from sklearn.base import clone
from tqdm import tqdm

from tras.dictionaries.base import label
from tras.dictionaries.mechanical import Mechanical
from tras.dictionaries.monomials import Monomials
from tras.dictionaries.radial import GaussianRBF
from tras.fitting import hold_out
from tras.identification.preparation import Treatments, is_noisy
from tras.metrics import multi_step_error
from tras.model import KoopmanModel
from tras.recording import Recording, join

SEARCHED = 20_000  # snapshot pairs that `search` looks at, at most
DELAYS = (0, 1, 2, 4, 8)  # that `search` tries by default
_CHANNELS = 60  # at most, earlier samples included
_CLOSE = 1.1  # errors within ten percent count as equal: the model with fewer functions is then better


def candidates(recording: Recording, predictor: str = "vector_field", delays: int = 0) -> list[KoopmanModel]:
    """Models worth trying on a recording of which nothing else is known, the simplest first.

    Linear; monomials of degree 2 to 4 and Gaussians on 50 and 200 k-means centres, if they have at most 500 functions
    and at least two snapshot pairs per function; and, if the number of states is even and there are no delays,
    `Mechanical`, which takes the states for position, velocity, position, ...

    Examples
    --------
    >>> from tras.identification.examples import example
    >>> for model in candidates(example("duffing")[[0]]):
    ...     print(model.dictionary)
    Monomials(degree=1)
    Monomials()
    Monomials(degree=3)
    Monomials(degree=4)
    GaussianRBF(centres='kmeans', n_centres=50, width='auto')
    GaussianRBF(centres='kmeans', n_centres=200, width='auto')
    Mechanical()
    """
    dictionaries = _dictionaries(recording, delays, predictor, (1, 2, 3, 4), (50, 200), min(500, recording.pairs // 2))
    if recording.n % 2 == 0 and not delays and predictor != "lifted_linear":
        dictionaries.append(Mechanical())
    return [KoopmanModel(dictionary, predictor, delays) for dictionary in dictionaries]


def choose(recording: Recording, models: Iterable | None = None) -> tuple[KoopmanModel, pd.DataFrame]:
    """The best of several models, each fitted to four fifths of the trajectories and judged on the rest.

    The error is that of whole roll-outs of up to 501 samples; a candidate that diverges loses by it. Each candidate
    still chooses its own strength of regularization, on trajectories of its four fifths.

    Parameters
    ----------
    recording : Recording or sequence of them
    models : sequence of estimators, optional
        Anything with ``fit(recording)`` and ``predict(recording)`` that `sklearn.base.clone` can copy. Default:
        `candidates`.

    Returns
    -------
    model : KoopmanModel
        Fitted to the whole recording.
    table : pandas.DataFrame
        One row per candidate: ``candidate`` (its dictionary, and its delays if it has any), ``functions, strength,
        error, failure`` as in `attempt`, ``model`` (the estimator, unfitted), ``chosen``.

    Raises
    ------
    ValueError
        If the recording is too short to hold anything out, or no candidate could be fitted.

    Examples
    --------
    >>> from tras import multisine, simulate_closed_loop
    >>> recording = simulate_closed_loop(multisine(40, 0.01, [1.0, 2.0], [0.8, 2.0], 0), 0.01)
    >>> recording = recording.select(inputs=["u_phi", "u_psi"])
    >>> models = [KoopmanModel(Monomials(1)), KoopmanModel(Mechanical(5))]
    >>> model, table = choose(recording.cut(201), models)
    >>> model.dictionary
    Mechanical(degree=5)
    """
    recording = join(recording)
    models = candidates(recording) if models is None else list(models)
    if not models:
        raise ValueError("models holds no candidate; give one or more: [tras.KoopmanModel(tras.Monomials(2))].")
    train, windows = hold_out(recording)
    if windows is None:
        raise ValueError(
            f"the recording has {recording.pairs} snapshot pairs, too few to hold trajectories out for the choice; "
            "record more, or fit one model."
        )
    latest = max(getattr(model, "delays", 0) for model in models)
    table = pd.DataFrame([
        {"candidate": label(model), **attempt(model, train, windows, windows, latest), "model": model}
        for model in tqdm(models, desc="choose", leave=False, disable=None)
    ])  # fmt: skip
    table["chosen"] = table.index == best(table).name
    return clone(models[int(table["chosen"].argmax())]).fit(recording), table


def search(
    treatments: Treatments, samples: int, *, predictor: str | None = None, delays: Sequence[int] | None = None,
    smoothing: bool | None = None,
) -> tuple[pd.DataFrame, list[str]]:  # fmt: skip
    """Candidates for a recording of which nothing else is known, and their errors.

    Parameters
    ----------
    treatments : Treatments
        Of the training trajectories.
    samples : int
        Length of a piece.
    predictor, delays, smoothing
        As for `tras.identify`.

    Returns
    -------
    table : pandas.DataFrame
        One row per candidate: ``round, states`` ("as measured" or "smoothed"), ``delays, predictor, dictionary``,
        ``functions, strength, error, failure`` as in `attempt`, ``model`` (unfitted, with the strength that it chose),
        ``chosen``. The truth is always what was measured.
    remarks : list of str
        Sentences on the data that were used.

    Raises
    ------
    ValueError
        If the recording is too short, or no candidate can be fitted.
    """
    recording, pairs = treatments.recording, treatments.pairs
    if delays is None:  # that pieces of so many samples allow; at most one if all velocities are measured
        most = 1 if recording.n == 2 * len(pairs) else max(DELAYS)
        most = min((samples - 1) // 4, _CHANNELS // (recording.n + recording.m) - 1, most)
        delays = [d for d in DELAYS if d == 0 or d <= most]
    latest = max(delays)
    names = ["smoothed"] if smoothing else ["as measured"]
    if smoothing is None and is_noisy(recording):
        names.append("smoothed")
    parts, remarks = _parts(treatments, names, samples, latest)
    truth = parts["as measured"][1]
    rows, keys = [], set()

    def attempt_all(number, description, models):
        for name, model in tqdm(models, desc=description, leave=False, disable=None):
            if (name, repr(model)) not in keys:
                keys.add((name, repr(model)))
                scores = attempt(model, *parts[name], truth, latest)
                if not scores["failure"]:
                    model = clone(model).set_params(strength=float(scores["strength"]))
                options = {"delays": model.delays, "predictor": model.predictor, "dictionary": label(model.dictionary)}
                rows.append({"round": number, "states": name, **options, **scores, "model": model})
        return pd.DataFrame(rows)

    first = predictor or "one_step"
    models = [(name, model) for name in names for d in delays for model in _first_round(parts[name][0], d, first)]
    leader = best(attempt_all(1, "treatments and delays", models), _CLOSE)
    name = leader["states"]
    second_delays = dict.fromkeys((int(leader["delays"]), delays[0]))
    models = [(name, model) for d in second_delays for model in _second_round(parts[name][0], d, pairs, predictor)]
    table = attempt_all(2, "dictionaries", models)
    table["chosen"] = table.index == best(table, _CLOSE).name
    return table, remarks


def attempt(model, train: Recording, starts: Recording, truth: Recording, latest: int) -> dict:
    """Fit a copy of one candidate, and judge it by roll-outs over trajectories that it was not fitted to.

    Parameters
    ----------
    model : estimator
    train : Recording
        What it is fitted to.
    starts, truth : Recording
        Windows of one length, as the model sees them and as measured.
    latest : int
        The sample from which predictions begin.

    Returns
    -------
    dict
        ``functions``, ``strength`` (NaN if the estimator has none), ``error`` (root mean square in half-ranges of the
        states, each sample's at most 10; infinite without a model), ``failure`` (empty, or why there is no model).
    """
    model, error, failure = clone(model), math.inf, ""
    half_range = np.ptp(truth.states, axis=(0, 1)) / 2
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # divergence is part of the error, not a warning
            predicted = np.stack(roll_outs(model.fit(train), starts, latest))
            error = relative_error(truth.states[:, latest:], predicted, np.where(half_range > 0, half_range, 1.0))
    except (ValueError, MemoryError) as reason:
        failure = str(reason)
    functions = len(model.names_) if hasattr(model, "names_") else np.nan
    return {"functions": functions, "strength": getattr(model, "strength_", np.nan), "error": error, "failure": failure}


def roll_outs(model, starts: Recording, latest: int) -> list[np.ndarray]:
    """Predictions, (samples_i, n) per trajectory, from the sample ``latest`` on, whatever the model's delays."""
    delays = getattr(model, "delays", 0)
    with np.errstate(over="ignore", invalid="ignore"):
        return [x[delays:] for x in model.predict(without_first(starts, latest - delays))]


def without_first(recording: Recording, samples: int) -> Recording:
    """The recording without the first samples of each trajectory."""
    return recording.with_data([x[samples:] for x, _ in recording], [u[samples:] for _, u in recording])


def relative_error(true: np.ndarray, predicted: np.ndarray, half_range: np.ndarray) -> float:
    """`tras.metrics.multi_step_error` of roll-outs (trajectories, samples, n), in half-ranges of the states (n,)."""
    scaled = Recording(true / half_range, None, 1.0)
    return multi_step_error((predicted / half_range).transpose(1, 2, 0), scaled, true.shape[-1])


def best(table: pd.DataFrame, tolerance: float = 1.0) -> pd.Series:
    """The row with the fewest functions among those whose error is at most ``tolerance`` times the least."""
    least = table["error"].min()
    if not math.isfinite(least):
        reason = table["failure"].iloc[-1]
        raise ValueError(f"none of the {len(table)} candidates could be fitted; the last one because: {reason}")
    return table[table["error"] <= tolerance * least].sort_values(["functions", "error"], kind="stable").iloc[0]


def _parts(treatments, names, samples, latest):
    """Treatment, "as measured" among them -> (pieces to fit, windows held out); and remarks on these."""
    train, treatments = treatments.recording, treatments.at_most(2 * SEARCHED)
    names = dict.fromkeys(["as measured", *names])
    parts = {name: hold_out(treatments.pieces(name, samples, latest + 10, SEARCHED)) for name in names}
    pieces, windows = parts["as measured"]
    if windows is None or windows.lengths.min() < latest + 5:
        raise ValueError(
            f"there are {train.pairs} snapshot pairs in {len(train)} trajectories to learn from, too few to hold out "
            f"pieces of {latest + 10} samples for the choice of a model: record more, or try fewer delays."
        )
    judge = f"{len(windows)} held-out pieces of {int(windows.lengths[0])} samples"
    remarks = [f"{pieces.pairs} snapshot pairs for the fits, {judge} for the errors"]
    pairs = pieces.pairs + windows.pairs
    if pairs < 0.9 * train.pairs:
        amount = f"{pairs} of {train.pairs} snapshot pairs"
        remarks.append(f"the search looks at {amount}, spread evenly; the chosen model is fitted to more")
    return parts, remarks


def _first_round(train, delays, predictor):
    """Models with a linear and a nonlinear dictionary: cubic monomials while they are few, else Gaussians."""
    linear, cubic = (_monomials(train, delays, predictor, degree) for degree in (1, 3))
    most = _most(train)
    nonlinear = Monomials(3) if cubic <= min(150, most) else GaussianRBF(60, width="auto", centres="kmeans")
    dictionaries = [Monomials(1), nonlinear] if linear + 60 <= most or cubic <= most else [Monomials(1)]
    return [KoopmanModel(dictionary, predictor, delays) for dictionary in dictionaries]


def _second_round(train, delays, pairs, predictor):
    """Models with every dictionary and predictor worth trying, the smallest first."""
    models = []
    # With delays a vector field could not know the earlier inputs.
    predictors = ["one_step"] if delays and train.m else ["vector_field", "one_step"]
    for each in [predictor] if predictor else predictors:
        # A field is evaluated several times per sample.
        most = _most(train) if each != "vector_field" else min(150, _most(train))
        dictionaries = _dictionaries(train, delays, each, (1, 2, 3, 4, 5), (30, 100, 250), most)
        if not delays and each != "lifted_linear" and train.n == 2 * len(pairs):
            # Each position in turn as the one that inertia and gravity depend on.
            positions, velocities = ([train.state_names.index(name) for name in column] for column in zip(*pairs))
            shapes = [(degree, [shape]) for degree in (3, 8) for shape in positions[:4]]
            dictionaries += [Mechanical(degree, positions, velocities, shape) for degree, shape in shapes]
        models += [KoopmanModel(dictionary, each, delays) for dictionary in dictionaries]
    return models


def _dictionaries(recording, delays, predictor, degrees, centres, most):
    """Monomials and Gaussians with at most so many functions; linear ones in any case."""
    size = {degree: _monomials(recording, delays, predictor, degree) for degree in degrees}
    monomials = [Monomials(degree) for degree in degrees if degree == 1 or size[degree] <= most]
    counts = [count for count in centres if size[1] + count <= most]
    return monomials + [GaussianRBF(count, width="auto", centres="kmeans") for count in counts]


def _monomials(recording, delays, predictor, degree):
    """The number of monomials; a vector field knows no earlier inputs, a lifted linear model lifts no present ones."""
    channels = recording.n * (delays + 1) + recording.m * (0 if predictor == "lifted_linear" else 1)
    channels += recording.m * delays if predictor != "vector_field" else 0
    return math.comb(channels + degree, degree)


def _most(train):
    """The number of functions worth trying: five snapshot pairs for each, but not more than take too long."""
    return max(train.n + train.m + 1, min(300, train.pairs // 5))
