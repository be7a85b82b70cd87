"""Noise: added, measured, smoothed as the dense Gaussian posterior has it, a field refined as scipy would refine it."""

import numpy as np
import pytest
from conftest import ode_recording
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import integrate, linalg, optimize, stats

import tras
from tras.identification import refinement, smoothing

NAMES = {"state_names": ["q", "v"], "input_names": ["u"]}


def pendulum(samples=400, trajectories=4, dt=0.02, seed=0):
    """A driven pendulum with friction: position, velocity, torque held over each sample."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1, 1, (trajectories, samples // 40 + 1, 1)), 40, axis=1)[:, :samples]
    x = np.empty((trajectories, samples, 2))
    x[:, 0] = rng.uniform(-1, 1, (trajectories, 2))
    for k in range(samples - 1):

        def rates(t, s, held=u[:, k, 0]):
            q, v = np.split(s, 2)
            return np.concatenate([v, -3 * np.sin(q) - 0.3 * v + held])

        flow = integrate.solve_ivp(rates, (0, dt), x[:, k].T.ravel(), rtol=1e-9, atol=1e-10)
        x[:, k + 1] = flow.y[:, -1].reshape(2, -1).T
    return tras.Recording(x, u, dt, **NAMES)


@pytest.fixture(scope="module")
def swing():
    return pendulum()


def error(a, b):
    """Root mean square over all trajectories, (n,), in half-ranges of b."""
    a, b = (np.concatenate([x for x, _ in r]) for r in (a, b))
    return np.sqrt(np.mean((a - b) ** 2, axis=0)) / (np.ptp(b, axis=0) / 2)


# --- adding, measuring ---


def test_noise_has_the_size_that_was_asked_for_and_inputs_stay(swing):
    noisy = tras.add_noise(swing, [0.01, 0.05], np.random.default_rng(0))
    added = (noisy.states - swing.states).reshape(-1, 2)
    assert added.std(axis=0) == pytest.approx([0.01, 0.05] * np.ptp(swing.states, axis=(0, 1)), rel=0.05)
    assert np.abs(np.corrcoef(added.T)[0, 1]) < 0.1 and np.abs(added.mean(axis=0)).max() < 0.1 * added.std()
    assert np.array_equal(noisy.inputs, swing.inputs) and noisy.state_names == swing.state_names
    assert np.array_equal(
        tras.add_noise(swing, 0.01, 3).states, tras.add_noise(swing, 0.01, np.random.default_rng(3)).states
    )
    assert np.array_equal(tras.add_noise(swing, 0.0, 0).states, swing.states)


def test_noise_level_does_not_see_what_is_smooth():
    """Third differences of a parabola vanish: what is left is the noise, to the statistics of 20 000 samples."""
    t = 0.01 * np.arange(20_000)
    x = np.stack([3 - 2 * t + 0.1 * t**2, 1e3 * t], axis=-1)
    noise = np.random.default_rng(0).standard_normal(x.shape) * [0.2, 1e-3]
    assert tras.noise_level(tras.Recording([x + noise], dt=0.01)) == pytest.approx([0.2, 1e-3], rel=0.03)
    assert np.all(tras.noise_level(tras.Recording([x], dt=0.01)) < 1e-9 * np.ptp(x, axis=0))


@settings(max_examples=20, deadline=None)
@given(units=st.lists(st.floats(1e-4, 1e4), min_size=2, max_size=2), seed=st.integers(0, 99))
def test_noise_level_follows_the_units(units, seed):
    x = np.random.default_rng(seed).standard_normal((50, 2))
    level = tras.noise_level(tras.Recording([x], dt=0.1))
    assert tras.noise_level(tras.Recording([x * units], dt=0.1)) == pytest.approx(level * units, rel=1e-9)


# --- smoothing ---


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_integrated_noise_against_its_integral(order):
    """Transition exp(N), covariance the integral of exp(N s) e e^T exp(N s)^T: N the shift, e the last unit vector."""
    A, Q = smoothing._integrated_noise(order)
    shift = np.eye(order, k=1)
    assert np.allclose(A, linalg.expm(shift))
    points, weights = np.polynomial.legendre.leggauss(10)
    columns = [linalg.expm(shift * (s + 1) / 2)[:, -1] for s in points]
    assert np.allclose(Q, sum(w / 2 * np.outer(c, c) for w, c in zip(weights, columns)), rtol=1e-12)


def dense_covariance(samples, order, channels, deviation, intensity):
    """Covariance of all measurements of one trajectory."""
    A, Q = smoothing._integrated_noise(order)
    covariances = [np.eye(order)]
    for _ in range(samples - 1):
        covariances.append(A @ covariances[-1] @ A.T + intensity * Q)
    powers = [np.linalg.matrix_power(A, k) for k in range(samples)]
    blocks = [
        [
            (powers[max(i - j, 0)] @ covariances[min(i, j)] @ powers[max(j - i, 0)].T)[:channels, :channels]
            for j in range(samples)
        ]
        for i in range(samples)
    ]
    return np.block(blocks) + np.kron(np.eye(samples), np.diag(deviation**2))


def dense_posterior(y, order, deviation, intensity):
    """The likeliest states, by one QR decomposition: start, steps and measurements, each over its deviation."""
    samples, channels = y.shape
    A, Q = smoothing._integrated_noise(order)
    step = np.linalg.inv(np.linalg.cholesky(intensity * Q))
    rows, right = [np.eye(order, samples * order)], [np.zeros(order)]
    for k in range(samples):
        place = np.eye(order, samples * order, order * k)
        rows.append(place[:channels] / deviation[:, None])
        right.append(y[k] / deviation)
        if k:
            rows.append(step @ (place - A @ np.eye(order, samples * order, order * (k - 1))))
            right.append(np.zeros(order))
    states = np.linalg.lstsq(np.vstack(rows), np.concatenate(right), rcond=None)[0]
    return states.reshape(samples, order)[:, :channels]


CASES = [(2, 1, 1e-3), (3, 1, 1e-2), (3, 2, 1e-2), (3, 2, 1e-6)]  # order, measured channels, intensity


@pytest.mark.parametrize("order, channels, intensity", CASES)
def test_the_smoother_is_the_dense_posterior_mean(order, channels, intensity):
    rng = np.random.default_rng(order)
    deviation = np.array([0.1, 0.3])[:channels]
    measured = [np.cumsum(rng.standard_normal((samples, channels)), axis=0) for samples in (25, 12)]
    smoothed = smoothing._smooth(measured, deviation, order, intensity)
    for y, s in zip(measured, smoothed):
        assert np.abs(s - dense_posterior(y, order, deviation, intensity)).max() <= 1e-8 * np.abs(y).max()


@pytest.mark.parametrize("order, channels, intensity", CASES)
def test_the_likelihood_is_the_dense_gaussian_one(order, channels, intensity):
    deviation = np.array([0.1, 0.3])[:channels]
    y = np.random.default_rng(5).standard_normal((20, channels))
    total = dense_covariance(20, order, channels, deviation, intensity)
    first = 3 * channels
    density = [
        stats.multivariate_normal(np.zeros(k), total[:k, :k], allow_singular=True).logpdf(y.ravel()[:k])
        for k in (20 * channels, first)
    ]
    numbers = 17 * channels
    expected = -(density[0] - density[1]) - numbers / 2 * np.log(2 * np.pi)
    here = smoothing._surprise([y], deviation, order, intensity) * 17
    assert here == pytest.approx(expected, rel=1e-6, abs=1e-6)


@pytest.mark.slow
def test_smoothing_removes_noise_and_more_of_it_with_a_velocity(swing):
    noisy = tras.add_noise(swing, 0.03, 1)
    alone, paired = tras.smooth(noisy), tras.smooth(noisy, [("q", "v")])
    assert np.all(error(alone, swing) < 0.6 * error(noisy, swing))
    assert error(paired, swing)[0] < 0.7 * error(alone, swing)[0] and error(paired, swing)[1] < error(alone, swing)[1]
    assert np.array_equal(paired.inputs, swing.inputs)


def test_exact_data_stay_as_they_are():
    t = 0.02 * np.arange(400)
    free = tras.Recording(
        [np.stack([np.sin(w * t), w * np.cos(w * t)], axis=-1) for w in (1.0, 1.7)], dt=0.02, state_names=["q", "v"]
    )
    assert np.all(error(tras.smooth(free, [("q", "v")]), free) < 1e-5)


def test_smoothing_does_not_feel_rounding(swing):
    """A start far wider than the states leaves differences of large numbers in the first samples."""
    pairs = [(swing.state_names[0], swing.state_names[1])]
    noisy = tras.add_noise(swing, 1e-4, 0)
    nudged = noisy.with_data([np.nextafter(x, np.inf) for x, _ in noisy], [u for _, u in noisy])
    change = np.concatenate([b - a for (a, _), (b, _) in zip(tras.smooth(noisy, pairs), tras.smooth(nudged, pairs))])
    assert np.all(np.abs(change) < 2e-10 * np.ptp(noisy.states, axis=(0, 1)))


def test_smoothing_does_not_feel_units_and_takes_unequal_lengths_and_constants(swing):
    states = [np.column_stack([x[: 100 + 50 * i], np.full(100 + 50 * i, 7.0)]) for i, x in enumerate(swing.states)]
    inputs = [u[: len(x)] for x, u in zip(states, swing.inputs)]
    noisy = [x + np.random.default_rng(0).standard_normal(x.shape) * [0.02, 0.05, 0] for x in states]

    def smoothed(units):
        recording = tras.Recording([x * units for x in noisy], inputs, 0.02, state_names=["q", "v", "room"])
        return [x for x, _ in tras.smooth(recording, [("q", "v")])]

    one, other = smoothed(np.ones(3)), smoothed(np.array([1e3, 1e3, 1e-2]))
    for x, y in zip(one, other):
        assert np.allclose(x * [1e3, 1e3, 1e-2], y, rtol=0, atol=1e-6 * np.abs(y).max()) and np.all(x[:, 2] == 7)


# --- refinement ---


@pytest.fixture(scope="module")
def scalar():
    """x' = -x + u - x^3 / 4, twelve trajectories, 2 % noise: (exact, noisy, model of the noisy)."""
    exact = ode_recording(lambda x, u: -x + u - x**3 / 4, 0.05, n=1, m=1, trajectories=12, samples=61)
    noisy = tras.add_noise(exact, 0.02, 0)
    return exact, noisy, tras.KoopmanModel(tras.Monomials(3), regularization=None, extrapolation="functions").fit(noisy)


def shooting_residuals(model, recording, level):
    """The same problem for scipy: (W, initial states) -> weighted residuals, by the model's own Runge-Kutta steps."""
    N, scale = len(model.names_), model.x_scale_
    x = (recording.states - model.x_offset_) / scale
    u = (recording.inputs - model.u_offset_) / model.u_scale_

    def field(z, held, W):
        return W @ model.dictionary_.lift(np.vstack([z, held]))

    def residuals(unknown):
        W, z = unknown[:N][None], unknown[N:][None]
        h, rows = model.dt_ / model.substeps_, [x[:, 0].T - z]
        for k in range(x.shape[1] - 1):
            for _ in range(model.substeps_):
                held = u[:, k].T
                k1 = field(z, held, W)
                k2 = field(z + h / 2 * k1, held, W)
                k3 = field(z + h / 2 * k2, held, W)
                z = z + h / 6 * (k1 + 2 * k2 + 2 * k3 + field(z + h * k3, held, W))
            rows.append(x[:, k + 1].T - z)
        return np.concatenate(rows).ravel() * scale[0] / level[0]

    return residuals, np.concatenate([model.W_.ravel(), x[:, 0, 0]])


@pytest.mark.slow
def test_refining_reaches_what_scipy_reaches(scalar):
    _, noisy, model = scalar
    refined = tras.refine(model, noisy, iterations=20)
    residuals, start = shooting_residuals(model, noisy, tras.noise_level(noisy))
    found = optimize.least_squares(residuals, start, method="lm", xtol=1e-12, ftol=1e-12)
    assert refined.refinement_[-1] == pytest.approx(np.sqrt(2 * found.cost / noisy.states.size), rel=1e-5)
    N = len(model.names_)
    assert np.abs(refined.W_[0] - found.x[:N]).max() <= 2e-3 * np.abs(found.x[:N]).max()


def test_the_slopes_of_the_shooting_are_those_of_its_cost(swing):
    noisy = tras.add_noise(swing, 0.02, 0).cut(50)
    model = tras.KoopmanModel(tras.Monomials(2), regularization=None).fit(noisy)
    shooting = refinement._Shooting(model, noisy, [0, 1], 50)
    starts = [states[0] for states, _ in shooting.blocks]
    blocks = shooting.linearise(model.W_, starts)
    by_W = -2 * sum(block[3] for block in blocks).reshape(2, -1)
    by_start = -2 * blocks[0][4].T
    h = 1e-6

    def differences(change_W, change_start):
        ends = [
            shooting.cost(model.W_ + s * h * change_W, [starts[0] + s * h * change_start, *starts[1:]]) for s in (1, -1)
        ]
        return (ends[0] - ends[1]) / (2 * h)

    for i, j in [(0, 0), (1, 3), (1, 7), (0, 9)]:
        change = np.zeros_like(model.W_)
        change[i, j] = 1
        assert differences(change, 0) == pytest.approx(by_W[i, j], rel=1e-4, abs=1e-4 * np.abs(by_W).max())
    change = np.zeros_like(starts[0])
    change[1, 2] = 1
    assert differences(0, change) == pytest.approx(by_start[1, 2], rel=1e-4)


@pytest.mark.slow
def test_refining_brings_the_field_near_the_truth(swing):
    noisy = tras.add_noise(swing, 0.02, 0)
    model = tras.KoopmanModel(tras.Mechanical(5)).fit(tras.smooth(noisy, [("q", "v")]))
    refined = tras.refine(model, noisy)
    x, u = swing.states.reshape(-1, 2), swing.inputs.reshape(-1, 1)
    true = -3 * np.sin(x[:, 0]) - 0.3 * x[:, 1] + u[:, 0]

    def miss(m):
        return np.sqrt(np.mean((m.vector_field(x, u)[:, 1] - true) ** 2)) / true.std()

    plain = tras.KoopmanModel(tras.Mechanical(5)).fit(noisy)
    assert miss(refined) < 0.03 < 3 * miss(refined) < miss(plain)
    assert refined.refinement_[-1] == pytest.approx(1, abs=0.1) and refined.refinement_[-1] <= refined.refinement_[0]
    assert np.array_equal(refined.W_[0], model.W_[0]) and not np.array_equal(
        refined.W_[1], model.W_[1]
    )  # q' = v is kinematics
    assert not hasattr(model, "refinement_") and "refined on whole trajectories" in refined.report()


@pytest.mark.slow
def test_a_bad_first_guess_is_followed_in_shorter_pieces(swing, monkeypatch):
    noisy = tras.add_noise(swing, 0.02, 0)
    model = tras.KoopmanModel(tras.Mechanical(5)).fit(tras.smooth(noisy, [("q", "v")]))
    model.W_ = model.W_ * [[1.0], [1.6]]
    tried, shooting = [], refinement._Shooting
    monkeypatch.setattr(
        refinement, "_Shooting", lambda m, r, rows, segment: tried.append(segment) or shooting(m, r, rows, segment)
    )
    refined = tras.refine(model, noisy, iterations=12)
    assert tried == [400, 251, 126, 63][: len(tried)] and len(tried) > 1
    assert refined.refinement_[0] <= 2 or tried[-1] == 63
    assert refined.refinement_[-1] == pytest.approx(1, abs=0.1)


def test_a_refined_model_is_kept_and_forgets_it_when_it_learns_more(scalar, tmp_path):
    _, noisy, model = scalar
    refined = tras.refine(model, noisy, iterations=1)
    refined.save(tmp_path / "model.npz")
    again = tras.load_model(tmp_path / "model.npz")
    assert np.array_equal(again.refinement_, refined.refinement_) and np.array_equal(again.W_, refined.W_)
    refined.partial_fit(noisy)
    assert not hasattr(refined, "refinement_")


@pytest.mark.slow
def test_a_chaotic_system_is_followed_in_short_pieces():
    def lorenz(x, u):
        return np.array([10 * (x[1] - x[0]), x[0] * (28 - x[2]) - x[1], x[0] * x[1] - 8 / 3 * x[2]])

    exact = ode_recording(lorenz, 0.01, n=3, trajectories=2, samples=400, size=10.0)
    noisy = tras.add_noise(exact, 0.005, 0)
    model = tras.KoopmanModel(tras.Monomials(2), regularization=None, extrapolation="functions").fit(tras.smooth(noisy))
    refined = tras.refine(model, noisy)
    x = exact.states.reshape(-1, 3)
    true = lorenz(x.T, None).T

    def miss(m):
        return np.linalg.norm(m.vector_field(x, np.empty((len(x), 0))) - true) / np.linalg.norm(true)

    assert (
        refined.refinement_[-1] == pytest.approx(1, abs=0.1)
        and miss(refined) < 0.8 * miss(model)
        and miss(refined) < 0.01
    )


# --- mistakes ---


@pytest.mark.parametrize(
    "call, words",
    [
        (lambda r, m: tras.add_noise(r, -0.1, 0), "level is -0.1; give a fraction of the range"),
        (lambda r, m: tras.add_noise(r, [0.1, 0.1, 0.1], 0), "or 2 of them"),
        (lambda r, m: tras.add_noise(r, np.nan, 0), "level is nan"),
        (lambda r, m: tras.add_noise(r, 0.1, None), "rng is None; give a numpy.random.Generator or a seed"),
        (
            lambda r, m: tras.noise_level(tras.Recording([np.arange(3.0)[:, None]], dt=1.0)),
            "longest trajectory has 3 samples",
        ),
        (lambda r, m: tras.smooth(r.cut(8)[[0]]), "longest trajectory has 8 samples; smoothing needs 10"),
        (lambda r, m: tras.smooth(r, ["qv"]), "pairs holds 'qv'; give pairs of names"),
        (lambda r, m: tras.smooth(r, [("q", "speed")]), "there is no state 'speed'; there are q, v"),
        (lambda r, m: tras.smooth(r, [("q", "v"), ("v", "q")]), "'q' stands twice|'v' stands twice"),
        (
            lambda r, m: tras.refine(tras.KoopmanModel(tras.Monomials(1)), r),
            "refine needs a model with a vector field; fit",
        ),
        (
            lambda r, m: tras.refine(tras.KoopmanModel(tras.Monomials(1), "one_step").fit(r), r),
            "refine needs a model with a vector field",
        ),
        (lambda r, m: tras.refine(m, r, rows=["a"]), "rows: there is no state 'a'; name one or more of q, v"),
        (lambda r, m: tras.refine(m, r, rows=[]), "rows: there is no state ''"),
        (lambda r, m: tras.refine(m, r, iterations=0), "iterations is 0; give a whole number, 1 or more"),
        (lambda r, m: tras.refine(m, r, segment=1), "segment is 1; give a whole number, 2 or more"),
    ],
)
def test_mistakes_are_named(call, words, swing):
    model = tras.KoopmanModel(tras.Monomials(1), regularization=None).fit(swing)
    with pytest.raises(ValueError, match=words):
        call(swing, model)


def test_a_model_that_runs_away_is_not_refined():
    """A field that grows without bound over the shortest segment: a clear sentence, no NaN."""
    t = 0.1 * np.arange(200)
    x = np.random.default_rng(0).uniform(0.5, 1, (5, 1, 1)) * np.cos(t)[None, :, None]
    recording = tras.Recording(x, dt=0.1)
    model = tras.KoopmanModel(tras.Monomials(2), regularization=None, extrapolation="functions").fit(recording)
    model.W_ = model.W_ + 50.0
    with pytest.raises(ValueError, match="predictions diverge within 63 samples; give a shorter segment"):
        tras.refine(model, recording)
