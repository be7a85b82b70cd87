"""What predictions leave unexplained: tests of whiteness and of independence of the inputs, information criteria.

A residual is the measured state at an instant less the one predicted for it from the samples ``steps`` before, under
the measured inputs. No residual, and no product of two, reaches from one trajectory into the next. Inputs act from
their own sample to the next, so ``u`` at lag ``steps`` and later is what a prediction could have used; smaller lags and
negative ones tell of feedback, which is no fault of a model, and are drawn but not tested.

The tests are those of MATLAB's ``resid`` (L. Ljung, *System Identification*, 2nd ed., Sec. 16.6; T. Soederstroem and
P. Stoica, *System Identification*, 1989, Sec. 11.2), with the number of false alarms kept where few samples would raise
it. `benchmarks/residual_tests.py` counts false alarms and measures the power.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from scipy import linalg, stats

from tras.workflow import arguments

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from tras.estimator import Estimator
    from tras.recording import Recording

ROUNDING = 1e-10  # residuals below this share of a channel's half-range are rounding errors, and not tested
RUNS = 2**20  # samples of roll-outs that are predicted at a time
SAME = 1e-10  # directions of an input's past with less than this share of its energy hold nothing of their own


@dataclass(frozen=True, repr=False)
class Residuals:
    """Errors of predictions over ``steps`` samples, and tests of them; from `tras.KoopmanModel.residuals`.

    Attributes
    ----------
    errors : list of (samples_i - delays - steps, n) ndarray
        Measured less predicted, per trajectory, in the states' units.
    table : pandas.DataFrame
        A row per test: ``state``, ``against`` ("itself" or an input), ``statistic``, ``freedom`` (degrees of freedom of
        the chi-square distribution or, of two numbers, the first of the F distribution), ``p`` and ``alarm``. An alarm
        is a p below ``significance`` over the number of tests (Bonferroni), so that all tests together raise one in
        at most that share of the cases in which there is nothing to find. NaN where there is nothing to test.
    correlations : pandas.DataFrame
        A row per lag: ``state``, ``against``, ``lag`` (in samples; positive: the past of the other), ``correlation``,
        ``bound`` (of one lag alone, at ``significance``, two-sided) and ``tested``.
    samples, steps : int
        Number of residuals of each state, and samples that a prediction reaches.
    significance : float
    """

    errors: list[np.ndarray]
    table: pd.DataFrame
    correlations: pd.DataFrame
    samples: int
    steps: int
    significance: float

    @property
    def white(self) -> bool:
        """Whether no test raises an alarm."""
        return not bool(self.table["alarm"].any())

    @cached_property
    def verdict(self) -> str:
        """What the tests say, in a sentence or two."""
        reach, tests = "one-step" if self.steps == 1 else f"{self.steps}-step", self.table
        level = f"{100 * self.significance:g} %"
        own = "their own past" if self.steps == 1 else f"their own past {self.steps} samples ago and earlier"
        if np.isnan(tests["p"]).all():
            return f"The {reach} residuals are rounding errors: there is nothing to test."
        if self.white:
            count = int(np.sum(np.isfinite(tests["p"])))
            return (
                f"The {reach} residuals show nothing that the model has missed: "
                f"of {count} tests on {self.samples} samples none raises an alarm at {level}."
            )
        parts = []
        for state, rows in tests[tests["alarm"]].groupby("state", sort=False):
            others = [own if name == "itself" else arguments.short(str(name)) for name in rows["against"]]
            parts.append(f"those of {arguments.short(str(state))} with {' and '.join(others)}")
        words = f"The {reach} residuals are correlated, {'; '.join(parts)} (alarms at {level})."
        noisy = [arguments.short(str(name)) for name in self._noisy()]
        if noisy:
            words += (
                f" For {', '.join(noisy)} it is the negative correlation at lag 1, which noise in the measured states "
                "leaves in one-step residuals of a right model, too."
            )
        return words

    def _noisy(self):
        """States whose residuals are correlated with themselves at lag 1 alone, negatively."""
        if self.steps > 1:
            return []
        alarms = self.table[self.table["alarm"]]
        alone = [state for state, rows in alarms.groupby("state", sort=False) if list(rows["against"]) == ["itself"]]
        states = []
        for state in alone:
            own = self.correlations.query("state == @state and against == 'itself'")
            r, bound = np.asarray(own["correlation"]), np.asarray(own["bound"])  # from lag 1 on
            if r[0] < -bound[0] and np.mean(np.abs(r[2:]) > bound[2:]) <= 0.1:
                states.append(state)
        return states

    def __repr__(self):
        return f"Residuals: {self.verdict}"

    def plot(self) -> "Figure":
        """Correlations over the lags with their bounds: a row per state, a column for itself and each input."""
        from tras.display import plots

        return plots.residual_figure(self.correlations, self.significance)


def residuals(
    model: "Estimator", recording: "Recording", *, steps: int = 1, lags: int = 25, significance: float = 0.01
) -> Residuals:
    """See `tras.KoopmanModel.residuals`."""
    arguments.whole_number("steps", steps)
    arguments.whole_number("lags", lags)
    arguments.number("significance", significance, 0, 1, ends=False)
    recording, errors = prediction_errors(model, recording, steps)
    samples, furthest = sum(map(len, errors)), lags + steps - 1
    pairs = sum(max(len(part) - furthest, 0) for part in errors)
    if pairs < 2 * lags:
        raise ValueError(
            f"the recording gives {samples} residuals, {pairs} pairs of them {furthest} samples apart, too few for "
            f"{lags} lags; give longer trajectories or fewer lags."
        )
    starts = recording.lengths - [len(part) for part in errors]
    series = Series.of(errors, [u for _, u in recording], starts, furthest)
    tests, curves = [], []
    for i, state in enumerate(recording.state_names):
        rounding = np.sqrt(np.mean(series.e[series.valid, i] ** 2)) <= ROUNDING * model.x_scale_[i]
        for test, curve in correlation_tests(series, i, recording.input_names, steps, lags, significance):
            if rounding:
                test |= {"statistic": np.nan, "p": np.nan}
            tests.append({"state": state} | test)
            curves.append(pd.DataFrame(curve).assign(state=state, against=test["against"]))
    table = pd.DataFrame(tests)
    table["alarm"] = table["p"] < significance / len(table)
    order = ["state", "against", "lag", "correlation", "bound", "tested"]
    correlations = pd.DataFrame(pd.concat(curves, ignore_index=True), columns=order)
    return Residuals(errors, table, correlations, samples, steps, significance)


def prediction_errors(model: "Estimator", recording: "Recording", steps: int = 1):
    """The recording in the model's channels, without trajectories that are too short, and measured less predicted.

    Returns
    -------
    Recording
    list of (samples_i - delays - steps, n) ndarray

    Raises
    ------
    ValueError
        If all trajectories are too short, or a prediction runs away.
    """
    model.require_fitted()
    recording, d = model.channels_.matched(recording), model.delays
    needed = d + steps + 1
    if recording.lengths.max() < needed:
        raise ValueError(
            f"the longest trajectory has {recording.lengths.max()} samples; "
            f"{d} delays and {steps} steps need {needed} or more."
        )
    recording = recording[recording.lengths >= needed]
    errors = []
    for x, u in recording:
        runs = len(x) - needed + 1
        predicted = np.empty((runs, x.shape[1]))
        first = np.lib.stride_tricks.sliding_window_view(x, d + 1, axis=0).transpose(0, 2, 1)[:runs]
        held = np.lib.stride_tricks.sliding_window_view(u, needed, axis=0).transpose(0, 2, 1)
        for k in range(0, runs, max(1, RUNS // needed)):
            some = slice(k, k + max(1, RUNS // needed))
            predicted[some] = model.simulate(first[some] if d else first[some, 0], held[some])[:, -1]
        errors.append(x[needed - 1 :] - predicted)
    lost = sum(int((~np.isfinite(part)).any(axis=1).sum()) for part in errors)
    if lost:
        raise ValueError(
            f"{lost} of {sum(map(len, errors))} predictions over {steps} samples run away, so residuals cannot be "
            "tested; fit another model."
        )
    return recording, errors


@dataclass(frozen=True)
class Series:
    """Residuals and inputs of all trajectories behind one another, with ``gap`` zeros between any two.

    Sums of products at lags up to the gap then never join two trajectories. The inputs are less their mean.
    """

    e: np.ndarray
    u: np.ndarray
    valid: np.ndarray
    lengths: np.ndarray
    gap: int

    @classmethod
    def of(cls, errors, inputs, starts, gap):
        """From residuals and inputs per trajectory, the residuals of trajectory i beginning at sample ``starts[i]``."""
        ends = np.cumsum([len(u) + gap for u in inputs])
        e = np.zeros((ends[-1] + gap, errors[0].shape[1]))
        v = np.zeros((len(e), inputs[0].shape[1]))
        valid, mean = np.zeros(len(e), dtype=bool), np.concatenate(inputs).mean(axis=0)
        for end, error, u, start in zip(ends, errors, inputs, starts):
            first = end - len(u)
            v[first:end], e[first + start : end], valid[first + start : end] = u - mean, error, True
        return cls(e, v, valid, np.array([len(error) for error in errors]), gap)


def correlation_tests(series: Series, i: int, inputs, steps: int, lags: int, significance: float):
    """A test as a dict, and its correlations as another, of state ``i`` against itself and each of the inputs."""
    e, samples = series.e[:, i], int(series.valid.sum())
    energy = e @ e or 1.0  # all zero: no correlation
    z = stats.norm.isf(significance / 2)
    furthest = lags + steps - 1
    own = np.array([_product(e, e, lag) for lag in range(furthest + 1)]) / energy
    pairs = _pairs(series.lengths, np.arange(furthest + 1))
    tested = np.arange(steps, furthest + 1)
    if steps == 1:
        variance = pairs / (samples * (samples + 2.0))
        statistic = float(np.sum(own[tested] ** 2 / variance[tested]))
        freedom, scale = lags, variance_of_portmanteau(series.lengths, lags) / (2 * lags)
        p = stats.chi2.sf(statistic / scale, lags / scale)
    else:
        # The residuals are a moving average of steps - 1: beyond its reach Bartlett's formula gives the covariance.
        whole = np.concatenate([own[steps - 1 : 0 : -1], own[:steps]])
        spread = np.convolve(whole, whole[::-1])[len(whole) - 1 :]
        spread = np.pad(spread, (0, max(0, lags - len(spread))))[:lags]
        covariance = linalg.toeplitz(spread) / samples
        variance = np.full(furthest + 1, spread[0] / samples) * pairs / samples
        statistic = float(np.sum(own[tested] ** 2 * samples / pairs[tested]))
        statistic, freedom, p = _weighted(statistic, np.linalg.eigvalsh(covariance))
    test = {"against": "itself", "statistic": statistic, "freedom": freedom, "p": p}
    lag = np.arange(1, furthest + 1)
    curve = {"lag": lag, "correlation": own[1:], "bound": z * np.sqrt(variance[1:]), "tested": lag >= steps}
    yield test, curve
    # Of residuals that are not white the sum has another covariance (Ljung, (16.67)).
    if steps > 1:
        colour = own[:steps].copy()
    elif p < significance:
        colour = own * (1 - np.arange(lags + 1) / (lags + 1))
    else:
        colour = own[:1]
    for j, name in enumerate(inputs):
        yield _against_input(series, e, energy, series.u[:, j], name, colour, tested, lags, z)


def _against_input(series, e, energy, u, name, colour, tested, lags, z):
    """The test against one input, and the correlations; ``colour`` is the residuals' own correlation from lag 0."""
    valid = series.valid.astype(float)
    lag = np.arange(-lags, tested[-1] + 1)
    sums = np.array([_product(e, u, k) for k in lag])
    squares = np.array([_product(valid, u**2, k) for k in lag])
    size = np.sqrt(energy * (u @ u)) or 1.0
    itself = np.array([_product(u, u, k) for k in range(len(colour))]) / ((u @ u) or 1.0)
    factor = max(colour[0] + 2 * colour[1:] @ itself[1:], 0.0)
    samples = valid.sum()
    bound = z * np.sqrt(energy / samples * squares * factor) / size
    curve = {"lag": lag, "correlation": sums / size, "bound": bound, "tested": lag >= tested[0]}
    past = np.stack([_shifted(u, k) for k in tested], axis=1) * valid[:, None]
    gram = past.T @ past
    energies, axes = np.linalg.eigh(gram)
    apart = energies > SAME * max(energies[-1], 0.0)
    if not apart.any():  # the input does not move here
        return {"against": name, "statistic": np.nan, "freedom": 0, "p": np.nan}, curve
    axes = axes[:, apart] / np.sqrt(energies[apart])
    freedom = axes.shape[1]
    statistic = float(np.sum((axes.T @ sums[lag >= tested[0]]) ** 2) / (energy / samples))
    if len(colour) == 1:  # samples times the coefficient of determination: for Gaussian residuals F exactly
        rest = (samples - statistic) / (samples - freedom)
        p = stats.f.sf(statistic / freedom / rest, freedom, samples - freedom) if rest > 0 else 0.0
    else:
        covariance = gram.copy()
        for k in range(1, len(colour)):
            shifted = past[k:].T @ past[:-k]
            covariance += colour[k] * (shifted + shifted.T)
        statistic, freedom, p = _weighted(statistic, np.linalg.eigvalsh(axes.T @ covariance @ axes))
    return {"against": name, "statistic": statistic, "freedom": freedom, "p": p}, curve


def variance_of_portmanteau(lengths: np.ndarray, lags: int) -> float:
    """Variance of Ljung and Box's statistic over lags 1 to ``lags`` of Gaussian white trajectories of these lengths.

    Above that of a chi-square distribution, ``2 lags``, where samples are few: the squares of two correlations are not
    quite independent. The fourth moments of ``e^T A e``, A with 1/2 at one lag, are sums over closed walks of four
    steps in a trajectory; a walk as wide as w has ``length - w`` beginnings.
    """
    samples = float(np.sum(lengths))
    a, b = np.meshgrid(np.arange(1, lags + 1), np.arange(1, lags + 1))
    wide, apart = _pairs(lengths, a + b), _pairs(lengths, np.maximum(a, b))
    aabb, abab = (2 * apart + 2 * wide) / 16, 4 * wide / 16
    pairs = _pairs(lengths, np.arange(1, lags + 1))
    fourth = np.outer(pairs, pairs) + 8 * (4 * aabb + 2 * abab)
    same = np.arange(lags)
    fourth[same, same] = 3 * pairs**2 + 48 * (4 * np.diag(wide) + 2 * pairs) / 16
    moments = fourth / (samples * (samples + 2) * (samples + 4) * (samples + 6))
    weights = samples * (samples + 2) / pairs
    return float(weights @ moments @ weights - lags**2)


def criteria(model: "Estimator", recording: "Recording", parameters: int | None = None) -> pd.DataFrame:
    """See `tras.KoopmanModel.information_criteria`."""
    if parameters is None:
        parameters = _parameters(model)
    arguments.whole_number("parameters", parameters, 0)
    recording, errors = prediction_errors(model, recording)
    e, names, n = np.concatenate(errors), recording.state_names, recording.n
    rows = []
    for name, part, count in [*zip(names, np.hsplit(e, n), [parameters / n] * n), ("all", e, parameters)]:
        N, width = part.shape
        if N <= max(width, count):
            raise ValueError(
                f"there are {N} residuals for {count:g} parameters; give a longer recording, or a smaller model."
            )
        with np.errstate(divide="ignore"):
            loss = np.linalg.slogdet(part.T @ part / N)[1]
        # With the covariance that makes the data likeliest: minus twice the log-likelihood.
        deviance = N * (width * (np.log(2 * np.pi) + 1) + loss)
        fpe = np.exp(loss) * (N + count) / (N - count)
        sizes = {"state": name, "samples": N, "parameters": count, "loss": np.exp(loss)}
        rows.append(sizes | {"AIC": deviance + 2 * count, "BIC": deviance + count * np.log(N), "FPE": fpe})
    return pd.DataFrame(rows)


def _parameters(model):
    """Coefficients other than zero from which a model's predictions are made."""
    if hasattr(model, "n_parameters_"):
        return int(model.n_parameters_)
    if not hasattr(model, "koopman_matrix"):
        raise ValueError(f"how many parameters a {type(model).__name__} has is not known; give parameters=.")
    if model.predictor == "lifted_linear":
        return int(np.count_nonzero(model.koopman_matrix[:, 1:]) + np.count_nonzero(model.B_[1:]))
    n = len(model.state_names_)  # delayed states are shifted, not predicted
    matrix = model.W_[:n] if model.predictor == "vector_field" else model.state_columns[:, :n]
    return int(np.count_nonzero(matrix))


def _weighted(statistic, weights):
    """A sum of squares of independent normals with these variances, as a chi-square of the same mean and variance."""
    weights = np.maximum(weights, 0.0)
    scale = np.sum(weights**2) / np.sum(weights)
    freedom = np.sum(weights) / scale
    return statistic / scale, freedom, stats.chi2.sf(statistic / scale, freedom)


def _pairs(lengths, lags):
    """How many pairs of samples are so many apart, for an array of lags; trajectories of these lengths."""
    sizes, counts = np.unique(lengths, return_counts=True)
    return np.sum(counts * np.maximum(sizes - np.asarray(lags)[..., None], 0), axis=-1).astype(float)


def _product(a, b, lag):
    """The sum of ``a[t] b[t - lag]``."""
    return a[lag:] @ b[: len(b) - lag] if lag >= 0 else a[:lag] @ b[-lag:]


def _shifted(values, lag):
    """``values[t - lag]``, zero before the first one."""
    return np.concatenate([np.zeros(lag), values[: len(values) - lag]])
