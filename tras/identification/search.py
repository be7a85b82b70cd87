"""Which dictionary, predictor, delays and treatment of noise: candidates judged by roll-outs of held-out trajectories.

`choose` compares the models that it is given. `search`, for `tras.identify`, has three rounds of its own, because all
combinations take too long: treatments, the length of a step, delays and the input's timing, with a linear and a
nonlinear dictionary; then every dictionary and predictor at the best of these, and without delays; then the best ones
with coefficients that are fitted to predictions over a window. Every prediction starts from samples as they were
measured up to that instant.
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
from tras.identification import preparation
from tras.identification.actuators import driven, find_actuators
from tras.identification.preparation import Treatments, is_noisy
from tras.metrics import capped, diverged, multi_step_error
from tras.model import KoopmanModel
from tras.recording import Recording, join
from tras.rollout import coarser
from tras.workflow import arguments
from tras.workflow.study import terminal

SEARCHED = 20_000  # snapshot pairs that `search` looks at, at most
DELAYS = (0, 1, 2, 4, 8, 16, 32)  # that `search` tries by default
_START = 50  # share of the longest trajectory that the delays of long steps may reach back
_CURVED = 8  # delays with a dictionary that is not linear, at most
_CHANNELS = 60  # at most, earlier samples included, with a dictionary that is not linear
_AVERAGED = 0.01  # noise, as a share of the range, from which on delays help though all velocities are measured
_LINEAR_CHANNELS = 300  # at most, earlier samples included, with a linear one
_FREE = 3000  # samples of a free run in the search, at most
LINEAR_DICTIONARY = label(Monomials(1))  # how tables call it
CLOSE = 1.1  # errors within ten percent count as equal: the model with fewer functions is then better
_ROUNDING = 1e-10  # half-ranges; smaller errors are all the same
_HOPEFUL = 1.3  # errors in one step, over the least, up to which a vector field with the same dictionary is tried
_SPREAD = 1.2  # errors beyond it never do, however much they vary from window to window
_BEST = 3  # candidates whose coefficients are also fitted to predictions over a window
_AHEAD = 100  # samples that these reach, at most
_FITTED_OVER = 150  # functions of them, at most
_DRAWS = 200  # of windows, for that spread
_COARSE = 1e-4  # half-ranges; smaller errors are those of fields that are integrated with all their steps
_HOPELESS = 20  # errors of few Gaussians, over the least, beyond which more of them are not tried


def candidates(recording: Recording, predictor: str = "vector_field", delays: int = 0) -> list[KoopmanModel]:
    """Models worth trying on a recording of which nothing else is known, the simplest first.

    Linear; monomials of degree 2 to 4 and Gaussians on 50 and 200 k-means centres, if they have at most 500 functions
    and at least two snapshot pairs per function; and, if the number of states is even and there are no delays,
    `Mechanical`, which takes the states for position, velocity, position, ... Where `find_actuators` finds some, it is
    told which states they are, and which the positions and velocities.

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
    if not delays and predictor != "lifted_linear":
        pairs = preparation.velocity_pairs(recording, preparation.memory(recording))
        if actuators := find_actuators(recording, pairs):
            dictionaries += filter(None, [driven(recording, pairs, actuators, 8)])
        elif recording.n % 2 == 0:
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
    rows = [
        {"candidate": label(model), **attempt(model, train, windows, latest), "model": model}
        for model in tqdm(models, desc="choose", leave=False, disable=None)
    ]
    table = pd.DataFrame(rows)[["candidate", "functions", "strength", "error", "failure", "model"]]
    table["chosen"] = table.index == best(table).name
    return clone(models[int(table["chosen"].argmax())]).fit(recording), table


def search(
    treatments: Treatments, samples: int, *, predictor: str | None = None, delays: Sequence[int] | None = None,
    smoothing: bool | None = None, lead: int | None = None, every: int | None = None,
) -> tuple[pd.DataFrame, list[str]]:  # fmt: skip
    """Candidates for a recording of which nothing else is known, and their errors.

    Each is fitted to all trajectories less the stretches that are held out, and judged on these: over windows of
    ``samples``, and in one free run over each stretch.

    Parameters
    ----------
    treatments : Treatments
        Of the training trajectories.
    samples : int
        Length of a window.
    predictor, delays, smoothing, lead, every
        As for `tras.identify`.

    Returns
    -------
    table : pandas.DataFrame
        One row per candidate: ``round, states`` ("as measured" or "smoothed"), ``every`` (samples of a step), ``delays,
        lead, predictor, horizon, dictionary``, ``functions, strength, error, windows, free, lost, failure, squares`` as
        in `attempt`, ``model`` (unfitted), ``chosen``. The truth, and what predictions start from, is always what was
        measured.
    remarks : list of str
        Sentences on the data that were used.

    Raises
    ------
    ValueError
        If the recording is too short, or no candidate can be fitted.
    """
    recording, pairs = treatments.recording, treatments.pairs
    names = ["smoothed"] if smoothing else ["as measured"]
    if smoothing is None and is_noisy(recording):
        names.append("smoothed")
    arguments.whole_number("every", 1 if every is None else every)
    steps = preparation.steps(recording, samples) if every is None else [every]
    complete = recording.n == 2 * len(pairs) + len(find_actuators(recording, pairs))
    complete = complete and not is_noisy(recording, _AVERAGED)
    tried = {q: _delays(recording.decimated(q), complete) if delays is None else list(delays) for q in steps}
    if delays is None:  # what starts a prediction is not scored
        most = max(max(DELAYS), int(recording.lengths.max()) // _START)
        tried = {q: [d for d in tried[q] if q * d <= most] for q in steps}
    longest = max(steps)
    latest = max(-(-q * max(tried[q]) // longest) * longest for q in steps)  # a multiple of every step
    samples = -(-(samples - 1) // longest) * longest + 1
    parts, windows, blocks, remarks = _parts(treatments, names, samples, latest, longest)
    leads = _leads(recording, lead)
    rows, keys, cut = [], set(), {}

    def of(setting):
        """What is fitted and what it is judged by, at one length of a step."""
        name, q, d, k = setting
        key = (name, q, k) if q > 1 else name
        if key not in cut:
            cut[key] = [part and part.decimated(q, k) for part in (parts[name], windows, blocks, parts["as measured"])]
        return cut[key]

    def attempt_all(number, description, models):
        with terminal() as stream:  # behind the notebook of `make identify`, too
            for setting, dictionary, predictor in tqdm(
                models, desc=description, leave=False, disable=None, file=stream
            ):
                name, q, d, k = setting
                over = min(_AHEAD, (samples - 1) // q) if number == 3 else 1
                model = KoopmanModel(dictionary, predictor, d, lead=k, horizon=over)
                if (name, q, repr(model)) in keys or _hopeless(rows, name, q, model):
                    continue
                keys.add((name, q, repr(model)))
                options = {"every": q, "delays": d, "lead": k, "predictor": predictor, "horizon": over}
                options |= {"dictionary": label(dictionary)}
                train, starts, longer, measured = of(setting)
                # Without delays no pair is lost by a cut, and the choice of a strength needs no longer roll-outs.
                train = train if d else train.cut_all((samples - 1) // q + 1)
                scores = _settled(model, rows, name, q, train, starts, latest // q, longer, measured, half_range)
                rows.append({"round": number, "states": name, **options, **scores, "model": model})
        return pd.DataFrame(rows)

    half_range = np.ptp(windows.states, axis=(0, 1)) / 2
    first = predictor or "one_step"
    settings = [(name, q, d, k) for name in names for q in steps for d in tried[q] for k in leads]
    table = attempt_all(1, "treatments and delays", [(setting, Monomials(1), first) for setting in settings])
    # The timing of the input shows in a linear model too; so the slower dictionaries try what it leaves open.
    least = table.groupby(["every", "lead"])["error"].min()
    models = [
        (setting, dictionary, first)
        for setting in settings
        for _, q, d, k in [setting]
        if d <= _CURVED and least[q, k] <= CLOSE * least[q].min()
        for dictionary in _curved(of(setting)[0], d, first)
    ]
    table = attempt_all(1, "treatments and delays", models)
    leaders = [best(table, CLOSE)]
    curved = table[table["dictionary"] != LINEAR_DICTIONARY]
    if np.isfinite(curved["error"]).any():  # few delays may suit a dictionary that is not linear, many a linear one
        leaders.append(best(curved, CLOSE))
    finest = curved[curved["every"] == min(steps)]
    if leaders[0]["every"] > min(steps) and np.isfinite(finest["error"]).any():  # the right dictionary needs no average
        leaders.append(best(finest, CLOSE))
    settings = [(row["states"], *(int(row[key]) for key in ("every", "delays", "lead"))) for row in leaders]
    name, q, _, k = settings[0]
    settings = list(dict.fromkeys([*settings, (name, q, tried[q][0], k)]))
    models = [
        (setting, dictionary, first)
        for setting in settings
        for dictionary in _dictionaries_of(of(setting)[0], setting[2], pairs, first)
    ]
    table = attempt_all(2, "dictionaries", models)
    if predictor is None:  # a field is integrated: several evaluations per sample, so only where one step does well
        hopeful = table[table["error"] <= _HOPEFUL * table["error"].min()]
        good = set(zip(*(hopeful[key] for key in ("states", "every", "delays", "dictionary"))))
        models = [
            (setting, dictionary, "vector_field")
            for setting in settings
            for name, q, d, _ in [setting]
            if not d or not recording.m  # with delays a vector field could not know the earlier inputs
            for dictionary in _dictionaries_of(of(setting)[0], d, pairs, "vector_field")
            if isinstance(dictionary, Mechanical) or (name, q, d, label(dictionary)) in good
        ]
        table = attempt_all(2, "vector fields", models)
    models = _promising(table)
    attempt_all(2, "dictionaries", models)  # where only the smoothed states were tried
    table = _without_idle_horizons(attempt_all(3, "predictions over a window", models))
    table["chosen"] = table.index == best(table, CLOSE).name
    return table, remarks


def _promising(table):
    """Settings and models whose coefficients may gain by a fit of predictions over a window: the best, one linear.

    What is smoothed knows the future, so these fits are of what was measured.
    """
    steps = table[(table["predictor"] == "one_step") & np.isfinite(table["error"])].sort_values("error", kind="stable")
    steps = steps[steps["functions"] <= _FITTED_OVER].drop_duplicates(["every", "delays", "lead", "dictionary"])
    linear = steps["dictionary"] == LINEAR_DICTIONARY
    return [
        (("as measured", *(int(row[key]) for key in ("every", "delays", "lead"))), row["model"].dictionary, "one_step")
        for _, row in pd.concat([steps[:_BEST], steps[linear][:1]]).iterrows()
    ]


def _without_idle_horizons(table):
    """Without the fits of predictions over a window that do not predict better than those of single steps.

    Better is what is so in 95 of 100 draws of the windows: else, few data would be fitted too closely.
    """
    same, idle = ["states", "every", "delays", "lead", "predictor", "dictionary"], []
    for number, row in table[table["horizon"] > 1].iterrows():
        plain = table[(table["horizon"] == 1) & (table[same] == row[same]).all(axis=1)].iloc[0]
        if (
            not math.isfinite(row["error"])
            or math.isfinite(plain["error"])
            and np.quantile(_ratios(row, plain), 0.95) >= 1
        ):
            idle.append(number)
    return table.drop(index=idle)


def _delays(recording, complete):
    """Delays that the lengths of the trajectories and the number of channels allow.

    Where all velocities are measured (``complete``) and noise does not ask for averages, one at most.
    """
    lengths = recording.lengths
    shortest = int(np.median(lengths)) if len(lengths) >= 5 else int(lengths.max()) // 10
    most = min(shortest // 3, _LINEAR_CHANNELS // (recording.n + recording.m) - 1, max(DELAYS))
    most = min(most, recording.pairs // (5 * (recording.n + recording.m)) - 1)
    return [d for d in DELAYS if d <= max(0, min(most, 1 if complete else most))]


def _leads(recording, lead):
    """Timings of the input to try: as the recording says, by its `intersample`, or both."""
    if lead is not None:
        return [lead]
    intersample = recording.attributes.get("intersample")
    if not recording.m or intersample == "zoh":
        return [0]
    return [1] if intersample in ("foh", "bl") else [0, 1]


def _hopeless(rows, name, every, model):
    """Whether a model is of more Gaussians than others of the same setting that predict far worse than the best one.

    They take most of the time where a polynomial is right; eight times as many seldom gain more than a factor of ten.
    """
    if not isinstance(model.dictionary, GaussianRBF):
        return False
    setting = {"states": name, "every": every, "delays": model.delays, "lead": model.lead}
    fewer = [
        row["error"]
        for row in rows
        if isinstance(row["model"].dictionary, GaussianRBF) and all(row[key] == setting[key] for key in setting)
    ]
    return bool(fewer) and min(fewer) > _HOPELESS * min(row["error"] for row in rows)


def _settled(model, rows, name, every, *data):
    """`attempt` with the strength that was chosen for one step where its K is the same or the first; else of its own.

    A choice by roll-outs of a field takes longer than all the rest.
    """
    same = {"states": name, "every": every, "delays": model.delays, "lead": model.lead, "predictor": "one_step"}
    same |= {"horizon": 1, "dictionary": label(model.dictionary), "failure": ""}
    if model.predictor == "vector_field" or model.horizon > 1:
        for row in rows:
            if all(row[key] == value for key, value in same.items()):
                scores = attempt(clone(model).set_params(strength=float(row["strength"])), *data, coarse=True)
                if not scores["failure"]:  # without a logarithm a stronger one may do
                    return scores
    return attempt(model, *data, coarse=True)


def attempt(
    model, train: Recording, windows: Recording, latest: int, blocks: Recording | None = None,
    measured: Recording | None = None, half_range=None, *, coarse: bool = False,
) -> dict:  # fmt: skip
    """Fit a copy of one candidate, and judge it by roll-outs over trajectories that it was not fitted to.

    Parameters
    ----------
    model : estimator
    train : Recording
        What it is fitted to.
    windows : Recording
        Of one length, as measured.
    latest : int
        The sample from which predictions begin.
    blocks : Recording, optional
        Longer stretches, for free runs.
    measured : Recording, optional
        What was fitted, as measured: for information criteria of the same samples, whatever the treatment.
    half_range : (n,) ndarray, optional
        What errors refer to. Default: that of the states in the windows.
    coarse : bool
        Whether a field is integrated in a quarter of its steps, unless the error is so small that this matters, or a
        window is lost by it.

    Returns
    -------
    dict
        ``functions``, ``strength`` (NaN if the estimator has none), ``windows`` and ``free`` (root mean squares over
        windows and free runs, in half-ranges of the states, each sample's at most 10), ``error`` (their geometric mean;
        infinite without a model), ``lost`` (windows in which the prediction ran away), ``failure`` (empty, or why there
        is no model), ``squares`` (the mean square of each window), and with ``measured`` ``AIC, BIC, FPE`` (NaN where
        unknown).
    """
    model, failure = clone(model), ""
    apart, free, lost, squares, information = math.inf, math.nan, len(windows), None, {}
    half_range = np.ptp(windows.states, axis=(0, 1)) / 2 if half_range is None else half_range
    half_range = np.where(half_range > 0, half_range, 1.0)
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # divergence is part of the error, not a warning
            model.fit(train)
            for each in (coarser(model), model) if coarse else (model,):
                apart, free, lost, squares = _judged(each, windows, latest, blocks, half_range)
                if each is model or (apart > _COARSE and not lost):  # by few steps a fast mode may run away
                    break
        if measured is not None:
            information = _criteria(model, measured, latest)
    except (ValueError, MemoryError) as reason:
        apart, free, failure = math.inf, math.nan, str(reason)
    error = apart if math.isnan(free) else math.sqrt(apart * free)
    functions = len(model.names_) if hasattr(model, "names_") else np.nan
    size = {"functions": functions, "strength": getattr(model, "strength_", np.nan)}
    scores = {"error": error, "windows": apart, "free": free, "lost": lost, "failure": failure, "squares": squares}
    if measured is not None:
        scores |= {name: information.get(name, math.nan) for name in ("AIC", "BIC", "FPE")}
    return size | scores


def _judged(model, windows, latest, blocks, half_range):
    """``windows, free, lost, squares`` of `attempt`, for a fitted model."""
    truth, predicted = windows.states[:, latest:], np.stack(roll_outs(model, windows, latest))
    squares, free = np.mean(capped((predicted - truth) / half_range) ** 2, axis=(1, 2)), math.nan
    if blocks is not None:
        runs = zip(roll_outs(model, blocks, latest), blocks)
        misses = np.concatenate([(run - x[latest:]) / half_range for run, (x, _) in runs])
        free = float(np.sqrt(np.mean(capped(misses) ** 2)))
    return float(np.sqrt(np.mean(squares))), free, int(diverged(truth, predicted).sum()), squares


def _criteria(model, measured, latest):
    """AIC, BIC and FPE of all states together, of the same one-step predictions whatever the model's delays."""
    measured = measured[measured.lengths > latest + 1]
    try:
        return model.information_criteria(without_first(measured, latest - model.delays)).iloc[-1]
    except ValueError:  # as many parameters as samples, or a prediction that runs away
        return {}


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
    """The row with the fewest functions among those that are as good as the best one.

    A candidate that lost a window (``lost``) is no rival to those that lost none. As good is an error of at most
    ``tolerance`` times the least, or, where the table has ``squares``, one whose ratio to it is not above one in 95 of
    100 draws of the windows (paired bootstrap), and at most 1.2.
    """
    if not math.isfinite(table["error"].min()):
        reason = table["failure"].iloc[-1]
        raise ValueError(f"none of the {len(table)} candidates could be fitted; the last one because: {reason}")
    if "lost" in table and (table["lost"] == 0).any():
        table = table[table["lost"] == 0]
    leader = table.loc[table["error"].idxmin()]
    close = table["error"] <= max(tolerance * leader["error"], _ROUNDING)
    if "squares" in table and leader["squares"] is not None:
        close |= np.array([_within_spread(row, leader) for _, row in table.iterrows()])
    return table[close].sort_values(["functions", "error"], kind="stable").iloc[0]


def _within_spread(row, leader):
    """Whether a candidate's error is above the leader's by less than both vary together over draws of the windows."""
    if not row["error"] <= _SPREAD * leader["error"]:
        return False
    return bool(np.quantile(_ratios(row, leader), 0.05) <= 1)


def _ratios(row, other):
    """The ratio of two candidates' errors in draws of the windows (paired bootstrap)."""
    count = len(other["squares"])
    draws = np.random.default_rng(0).integers(count, size=(_DRAWS, count))
    windows = np.sqrt(row["squares"][draws].mean(axis=1) / other["squares"][draws].mean(axis=1))
    # The free runs are few; their ratio is taken as it is.
    free = row["free"] / other["free"] if row["free"] > 0 and other["free"] > 0 else 1.0
    return np.sqrt(windows * free)


def _parts(treatments, names, samples, latest, grid):
    """Treatment -> stretches to fit; windows and stretches held out, as measured; and remarks on these."""
    train, treatments = treatments.recording, treatments.at_most(2 * SEARCHED)
    measured = treatments.whole("as measured")
    learn, judge = preparation.held_out(measured, latest + 5 * grid, grid)
    if not judge:
        raise ValueError(
            f"there are {train.pairs} snapshot pairs in {len(train)} trajectories to learn from, too few to hold out "
            f"stretches of {latest + 5 * grid} samples for the choice of a model: record more, or try fewer delays."
        )
    learn = [(i, a, b) for i, a, b in learn if b - a > latest]
    treated = dict.fromkeys([*names, "as measured"])
    parts = {name: preparation.stretches(treatments.whole(name), learn) for name in treated}
    blocks = preparation.stretches(measured, judge)
    windows = preparation.windows(blocks, samples, latest, SEARCHED // 2)
    longest = [(i, a, min(b, a + latest + _FREE)) for i, a, b in sorted(judge, key=lambda span: span[1] - span[2])[:8]]
    blocks = preparation.stretches(measured, longest)
    seconds = (windows.lengths[0] - latest - 1) * train.dt
    runs = f"{len(blocks)} free run{'s' if len(blocks) > 1 else ''} of up to {blocks.lengths.max() - latest} samples"
    pairs = sum(b - a for _, a, b in learn)
    remarks = [
        f"{pairs} snapshot pairs for the fits; the errors are those over {len(windows)} held-out windows of "
        f"{seconds:.3g} s and {runs}"
    ]
    if measured.pairs < 0.9 * train.pairs:
        amount = f"{measured.pairs} of {train.pairs} snapshot pairs"
        remarks.append(f"the search looks at {amount}, spread evenly; the chosen model is fitted to more")
    return parts, windows, blocks if blocks.lengths.max() > 1.5 * windows.lengths[0] else None, remarks


def _curved(train, delays, predictor):
    """A dictionary that is not linear, if the data allow one: cubic monomials while they are few, else Gaussians."""
    linear, cubic = (_monomials(train, delays, predictor, degree) for degree in (1, 3))
    most = _most(train)
    if (train.n + train.m) * (delays + 1) > _CHANNELS or (linear + 60 > most and cubic > most):
        return []
    return [Monomials(3) if cubic <= min(150, most) else GaussianRBF(60, width="auto", centres="kmeans")]


def _dictionaries_of(train, delays, pairs, predictor):
    """Every dictionary worth trying, the smallest first."""
    # A field is evaluated several times per sample.
    most = _most(train) if predictor != "vector_field" else min(150, _most(train))
    dictionaries = _dictionaries(train, delays, predictor, (1, 2, 3, 4, 5), (30, 100, 250), most)
    if not delays and predictor != "lifted_linear":
        # Each position in turn as the one that inertia and gravity depend on.
        actuators = find_actuators(train, pairs)
        degrees = (8,) if actuators else (3, 8)  # with actuators there are many functions
        shapes = [(degree, position) for degree in degrees for position, _ in pairs[:4]]
        dictionaries += filter(None, (driven(train, pairs, actuators, degree, shape) for degree, shape in shapes))
    return dictionaries


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
