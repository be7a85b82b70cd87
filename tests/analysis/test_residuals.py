"""What predictions leave unexplained, and how often the tests of it raise an alarm."""

import sys

import numpy as np
import pytest
from conftest import ROOT
from matplotlib.figure import Figure
from scipy import stats
from scipy.signal import lfilter

import tras
from tras.analysis import residuals
from tras.analysis.residuals import Series, correlation_tests, variance_of_portmanteau
from tras.paper.baselines.linear import DMDc

sys.path.insert(0, str(ROOT / "benchmarks"))
import residual_tests as study  # noqa: E402


def simulated(samples=600, seed=0, trajectories=2, noise=0.1, term=lambda x, u: 0.0, measured=0.0, names=("x",)):
    """x+ = 0.8 x + 0.5 u + term + noise, the input held over three samples."""
    rng = np.random.default_rng(seed)
    x, u = np.zeros((trajectories, samples, 1)), rng.normal(size=(trajectories, samples // 3 + 1, 1))
    u = np.repeat(u, 3, axis=1)[:, :samples]
    for k in range(samples - 1):
        x[:, k + 1] = (
            0.8 * x[:, k] + 0.5 * u[:, k] + term(x[:, k], u[:, k]) + noise * rng.normal(size=(trajectories, 1))
        )
    x += measured * rng.normal(size=x.shape)
    return tras.Recording(x, u, 0.1, state_names=names, input_names=["u"])


def fitted(recording, degree=1, **options):
    return tras.KoopmanModel(tras.Monomials(degree), "one_step", **options).fit(recording[[0]])


@pytest.mark.parametrize("delays", [0, 2])
@pytest.mark.parametrize("steps", [1, 4])
def test_errors_are_measured_less_simulated_window_by_window(delays, steps):
    recording = simulated(60, trajectories=3)
    model = fitted(recording, delays=delays)
    errors = model.residuals(recording, steps=steps, lags=5).errors
    for (x, u), error in zip(recording, errors, strict=True):
        assert len(error) == 60 - delays - steps
        for k in range(len(error)):
            start, end = x[k : k + delays + 1], k + delays + steps
            run = model.simulate(start if delays else start[0], u[k : end + 1])
            assert np.allclose(error[k], x[end] - run[-1], rtol=0, atol=1e-14)


def test_many_windows_are_predicted_in_parts(monkeypatch):
    recording = simulated(300)
    model = fitted(recording)
    whole = model.residuals(recording).errors
    monkeypatch.setattr(residuals, "RUNS", 50)
    for a, b in zip(whole, model.residuals(recording).errors, strict=True):
        assert np.allclose(a, b, rtol=0, atol=1e-14)  # products of other shapes round otherwise


def test_correlations_are_those_of_a_loop_and_cross_no_border():
    recording = simulated(80, trajectories=3, noise=0.3)
    model = fitted(recording)
    found = model.residuals(recording, steps=2, lags=6)
    u = [inputs[:, 0] for _, inputs in recording]
    mean = np.concatenate(u).mean()
    energy = sum(float(e[:, 0] @ e[:, 0]) for e in found.errors)
    power = sum(float(((v - mean) ** 2).sum()) for v in u)
    for row in found.correlations.itertuples():
        total = 0.0
        for error, v in zip(found.errors, u, strict=True):
            for t in range(2, 80):
                earlier, e = t - row.lag, error[:, 0]
                if row.against == "itself" and 2 <= earlier < 80:
                    total += e[t - 2] * e[earlier - 2]
                elif row.against == "u" and 0 <= earlier < 80:
                    total += e[t - 2] * (v[earlier] - mean)
        size = energy if row.against == "itself" else np.sqrt(energy * power)
        assert row.correlation == pytest.approx(total / size, abs=1e-12)
        assert row.tested == (row.lag >= 2)
    assert list(found.correlations.query("against == 'itself'")["lag"]) == list(range(1, 8))
    assert list(found.correlations.query("against == 'u'")["lag"]) == list(range(-6, 8))


def test_against_an_input_is_the_f_test_of_a_regression():
    """Of the residuals on the input's past, without a constant, by an independent least-squares solver."""
    rng = np.random.default_rng(3)
    e, u = rng.normal(size=200), lfilter([1], [1, -0.7], rng.normal(size=201))
    series = Series.of([e[:, None]], [u[:, None]], [1], 5)
    (_, _), (test, _) = correlation_tests(series, 0, ["u"], 1, 5, 0.01)
    v = np.concatenate([np.zeros(10), u - u.mean()])
    past = np.stack([v[11 - lag : 211 - lag] for lag in range(1, 6)], axis=1)
    rest = np.linalg.lstsq(past, e, rcond=None)[1][0]
    f = ((e @ e - rest) / 5) / (rest / 195)
    assert test["p"] == pytest.approx(stats.f.sf(f, 5, 195), rel=1e-9) and test["freedom"] == 5


def test_whiteness_is_ljung_and_box():
    """For one long trajectory its statistic; the reference distribution comes close to theirs."""
    e = np.random.default_rng(0).normal(size=(20_000, 1))
    series = Series.of([e], [np.zeros((20_001, 0))], [1], 25)
    ((test, _),) = correlation_tests(series, 0, [], 1, 25, 0.01)
    r = np.array([e[k:, 0] @ e[:-k, 0] for k in range(1, 26)]) / (e[:, 0] @ e[:, 0])
    q = 20_000 * 20_002 * np.sum(r**2 / (20_000 - np.arange(1, 26)))
    assert test["statistic"] == pytest.approx(q, rel=1e-9)
    assert test["p"] == pytest.approx(stats.chi2.sf(q, 25), rel=0.02)


def test_the_variance_of_the_statistic_is_the_simulated_one():
    lengths, lags = [40, 40, 25, 10], 8
    rng, draws = np.random.default_rng(0), 100_000
    products, energy, pairs = np.zeros((draws, lags)), np.zeros(draws), np.zeros(lags)
    for length in lengths:
        e = rng.normal(size=(draws, length))
        energy += (e**2).sum(axis=1)
        for k in range(1, lags + 1):
            products[:, k - 1] += (e[:, k:] * e[:, :-k]).sum(axis=1)
            pairs[k - 1] += length - k
    q = (products / energy[:, None]) ** 2 @ (115 * 117 / pairs)
    assert q.mean() == pytest.approx(lags, rel=0.01)
    assert variance_of_portmanteau(np.array(lengths), lags) == pytest.approx(q.var(), rel=0.03)
    assert variance_of_portmanteau(np.array([10**7]), lags) == pytest.approx(2 * lags, rel=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("case", [(500, 1, "Gaussian", 1), (2000, 1, "Gaussian", 5)], ids=str)
def test_false_alarms_are_one_percent(case):
    """0.7 to 1.3 %, each test and all together (benchmarks/residual_tests.py has more cases)."""
    assert np.abs(study.alarms(10_000, *case) - 1).max() <= 0.3


def test_false_alarms_are_rare():
    """Fewer than 4 of 100: at 1 % more would come once in 55 seeds."""
    assert study.alarms(100, 500, 1, "Gaussian", 1).max() <= 3


@pytest.mark.parametrize("term", ["cubic in the state", "friction", "earlier input", "input squared"])
def test_a_missing_term_raises_an_alarm(term):
    assert study.power(10, study.TERMS[term])[0] >= 80


def test_feedback_is_drawn_and_raises_no_alarm():
    """u = -0.5 x + r: the input at lag 0 and before depends on the noise, its past does not."""
    rng = np.random.default_rng(1)
    x, u = np.zeros((2, 2000, 1)), np.zeros((2, 2000, 1))
    for k in range(2000):
        u[:, k] = -0.5 * x[:, k] + 0.3 * rng.normal(size=(2, 1))
        if k < 1999:
            x[:, k + 1] = 0.9 * x[:, k] + u[:, k] + 0.3 * rng.normal(size=(2, 1))
    recording = tras.Recording(x, u, 0.1)
    model = fitted(recording)
    for steps in (1, 5):
        result = model.residuals(recording[[1]], steps=steps)
        assert result.white
        across = result.correlations.query("against == 'u1'").set_index("lag")
        assert abs(across["correlation"][0]) > 5 * across["bound"][0] and not across["tested"][0]


def test_noise_of_the_measurement_is_named():
    recording = simulated(2000, noise=0.001, measured=0.1)
    result = fitted(recording).residuals(recording[[1]])
    assert not result.white and "negative correlation at lag 1, which noise" in result.verdict


def test_a_right_model_is_found_white_a_wrong_one_is_not():
    right = simulated()
    assert fitted(right).residuals(right[[1]]).verdict == (
        "The one-step residuals show nothing that the model has missed: "
        "of 2 tests on 599 samples none raises an alarm at 1 %."
    )
    wrong, _ = study.system(study.TERMS["earlier input"], np.random.default_rng(0), 2)
    result = fitted(wrong).residuals(wrong[[1]], steps=3)
    words = "Residuals: The 3-step residuals are correlated, those of x1 with"
    assert not result.white and repr(result).startswith(words)


def test_rounding_errors_are_not_tested():
    recording = simulated(noise=0)
    result = fitted(recording, regularization=None).residuals(recording)
    assert result.white and result.table["p"].isna().all() and "nothing to test" in result.verdict


def test_an_input_that_rests_and_none_at_all():
    recording = simulated()
    model = fitted(recording)
    still = recording.with_data([x for x, _ in recording], [0 * u for _, u in recording])
    table = model.residuals(still).table.set_index("against")
    assert np.isnan(table["p"]["u"]) and not table["alarm"]["u"]
    alone = tras.Recording(np.random.default_rng(0).normal(size=(1, 300, 1)), dt=0.1)
    assert list(fitted(alone).residuals(alone).table["against"]) == ["itself"]


def test_every_estimator_has_residuals():
    recording = simulated()
    model = DMDc().fit(recording[[0]])
    assert model.residuals(recording[[1]]).white
    assert model.information_criteria(recording)["parameters"].iloc[-1] == 3


@pytest.mark.parametrize(
    "options, message",
    [
        ({"steps": 0}, "steps is 0"),
        ({"lags": 1.5}, "lags is 1.5"),
        ({"significance": 1}, "significance is 1"),
        ({"lags": 300}, "too few for 300 lags"),
        ({"steps": 600}, "the longest trajectory has 600 samples; 0 delays and 600 steps need 601"),
    ],
)
def test_wrong_options_are_refused(options, message):
    recording = simulated()
    with pytest.raises(ValueError, match=message):
        fitted(recording).residuals(recording, **options)


def test_a_prediction_that_runs_away_is_refused():
    recording = simulated()
    model = fitted(recording)
    model.koopman_matrix = 1e9 * model.koopman_matrix
    with pytest.raises(ValueError, match="predictions over 1 samples run away"):
        model.residuals(recording)


def test_trajectories_that_are_too_short_are_left_out():
    recording = simulated()
    x, u = (list(part) for part in zip(*recording))
    more = tras.Recording([*x, x[0][:1]], [*u, u[0][:1]], 0.1, state_names=["x"], input_names=["u"])
    model = fitted(recording)
    assert model.residuals(more).table.equals(model.residuals(recording).table)


def test_the_figure_shows_every_lag_and_names_as_text():
    recording = simulated(names=["$\\frac{"])
    result = fitted(recording).residuals(recording)
    figure = result.plot()
    assert isinstance(figure, Figure)
    figure.draw_without_rendering()
    assert [panel.get_title(loc="left") for panel in figure.axes] == ["with itself", "with u"]
    lines = [segment for group in figure.axes[1].collections[1:] for segment in group.get_segments()]
    heights = sorted((line[1] for line in lines), key=lambda point: point[0])
    expected = result.correlations.query("against == 'u'")[["lag", "correlation"]]
    assert np.allclose(heights, expected, atol=1e-12)


# --- information criteria ---


def test_criteria_are_those_of_the_gaussian_likelihood():
    rng = np.random.default_rng(0)
    mix = np.array([[1.0, 0.5], [0.0, 0.3]])
    recording = tras.Recording(rng.normal(size=(2, 200, 2)) @ mix, dt=0.1)
    model = tras.KoopmanModel(tras.Monomials(1), "one_step", regularization=None).fit(recording)
    table = model.information_criteria(recording).set_index("state")
    e = np.concatenate(model.residuals(recording).errors)
    N, p = 398, 6  # a constant and two states, twice
    covariance = e.T @ e / N
    deviance = -2 * stats.multivariate_normal([0, 0], covariance).logpdf(e).sum()
    assert table["AIC"]["all"] == pytest.approx(deviance + 2 * p) and table["parameters"]["all"] == p
    assert table["BIC"]["all"] == pytest.approx(deviance + p * np.log(N))
    assert table["FPE"]["all"] == pytest.approx(np.linalg.det(covariance) * (1 + p / N) / (1 - p / N))
    for i, name in enumerate(recording.state_names):
        alone = -2 * stats.norm(0, np.sqrt(covariance[i, i])).logpdf(e[:, i]).sum()
        assert table["AIC"][name] == pytest.approx(alone + 2 * 3) and table["loss"][name] == pytest.approx(
            covariance[i, i]
        )


def test_bic_finds_the_right_degree():
    recording = simulated(2000, trajectories=1, term=lambda x, u: 0.1 * u**2)
    values = [fitted(recording, d).information_criteria(recording)["BIC"].iloc[-1] for d in (1, 2, 3, 4)]
    assert int(np.argmin(values)) == 1


@pytest.mark.parametrize("predictor, count", [("vector_field", 6), ("one_step", 6), ("lifted_linear", 8)])
def test_parameters_are_counted(predictor, count):
    recording = simulated(100)
    model = tras.KoopmanModel(tras.Monomials(2), predictor, regularization=None).fit(recording)
    assert model.information_criteria(recording)["parameters"].iloc[-1] == count
    assert model.information_criteria(recording, 3)["parameters"].iloc[-1] == 3


def test_criteria_need_samples_and_a_count():
    recording = simulated(100)
    with pytest.raises(ValueError, match="there are 198 residuals for 200 parameters"):
        fitted(recording).information_criteria(recording, 200)
