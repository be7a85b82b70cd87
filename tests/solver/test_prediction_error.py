"""Coefficients fitted to predictions over many steps: derivatives, the optimum, and what a noisy recording gains."""

import numpy as np
import pytest
from scipy import optimize

import tras
from tras.solver import prediction_error


def recording(trajectories=20, samples=60, noise=0.0, seed=0):
    """A damped pendulum of which the angle alone is measured, its torque held over each sample."""
    rng, x = np.random.default_rng(seed), np.zeros((trajectories, samples, 2))
    u = np.repeat(rng.uniform(-0.5, 0.5, (trajectories, -(-samples // 10), 1)), 10, axis=1)[:, :samples]
    x[:, 0] = rng.uniform(-0.5, 0.5, (trajectories, 2))
    for k in range(samples - 1):
        q, v = x[:, k].T
        v = v + 0.2 * (u[:, k, 0] - np.sin(q) - 0.5 * v)
        x[:, k + 1] = np.stack([q + 0.2 * v, v], axis=1)
    measured = x[:, :, :1] + rng.normal(0, noise, (trajectories, samples, 1))
    return tras.Recording(measured, u, 0.2, state_names=["q"], input_names=["u"])


def polynomial():
    """Two states with one lag and one input, functions 1, z, u and squares: segments, W, lift, slopes, later."""
    rng = np.random.default_rng(1)
    W = rng.uniform(-0.2, 0.2, (2, 10))

    def lift(z, u):
        return np.concatenate([np.ones((1, z.shape[1])), z, u, z**2]), 0.0

    def slopes(z, u):
        by_z = np.zeros((10, 4, z.shape[1]))
        by_z[range(1, 5), range(4)] = 1
        by_z[range(6, 10), range(4)] = 2 * z
        return by_z

    def later(states, z, u):
        return np.concatenate([states, z[:2]])

    true, segments = W + rng.uniform(-0.05, 0.05, W.shape), []
    for samples in (4, 7):
        z, inputs, states = rng.uniform(-1, 1, (4, 20)), rng.uniform(-1, 1, (samples, 1, 20)), []
        for u in inputs:
            states.append(z + rng.normal(0, 0.02, z.shape))
            z = later(true @ lift(z, u)[0], z, u)
        segments.append((np.array(states), inputs))
    return segments, W, lift, slopes, later


def misses(W, segments, lift, later):
    parts = []
    for states, inputs in segments:
        z = states[0]
        for x, u in zip(states[1:], inputs):
            onward = W @ lift(z, u)[0]
            parts.append((x[:2] - onward).ravel())
            z = later(onward, z, u)
    return np.concatenate(parts)


def test_the_normal_equations_are_those_of_finite_differences():
    segments, W, lift, slopes, later = polynomial()
    cost, H, g = prediction_error._normal_equations(W, segments, lift, slopes, later, 2)
    e = misses(W, segments, lift, later)
    columns = []
    for i in range(W.size):
        step = np.zeros(W.size)
        step[i] = 1e-6
        there, back = (misses(W + s * step.reshape(W.shape), segments, lift, later) for s in (1, -1))
        columns.append((there - back) / 2e-6)
    J = np.array(columns).T
    assert cost == pytest.approx(e @ e)
    assert np.allclose(H, J.T @ J, atol=1e-7) and np.allclose(g, -J.T @ e, atol=1e-7)


def test_the_optimum_is_that_of_a_general_solver():
    segments, W, lift, slopes, later = polynomial()
    numbers, pull = sum(s[1:, :2].size for s, _ in segments), prediction_error._PULL

    def residuals(w):
        towards = np.sqrt(pull * numbers) * (w - W.ravel())
        return np.concatenate([misses(w.reshape(W.shape), segments, lift, later), towards])

    best = optimize.least_squares(residuals, W.ravel(), xtol=1e-12, ftol=1e-12, gtol=1e-12)
    here = W
    for _ in range(8):  # each ends when a step gains less than a hundredth
        here, errors = prediction_error.improved(here, W, segments, lift, slopes, later, 2)
    assert np.sum(residuals(here.ravel()) ** 2) == pytest.approx(2 * best.cost, rel=1e-3)
    assert errors[-1] == pytest.approx(np.sqrt(np.mean(misses(here, segments, lift, later) ** 2)))


def test_what_runs_away_stays_as_it_is():
    segments, W, lift, slopes, later = polynomial()
    wild = W.copy()
    wild[:, 6:] = 50.0
    same, errors = prediction_error.improved(wild, wild, segments, lift, slopes, later, 2)
    assert same is wild and errors == [np.inf]


def test_a_horizon_takes_the_bias_of_noise_away():
    noisy, clean = recording(noise=0.05), recording(seed=1)
    miss = {}
    for horizon in (1, 30):
        model = tras.KoopmanModel(tras.Monomials(3), "one_step", 1, strength=1e-3, horizon=horizon).fit(noisy)
        miss[horizon] = np.sqrt(np.mean((model.predict(clean) - clean.states) ** 2))
    assert miss[30] < 0.7 * miss[1]


@pytest.mark.parametrize("columns", ["all", "states"])
@pytest.mark.parametrize("extrapolation", ["linear", "functions"])
def test_refinement_counts_the_predictions_of_the_model_itself(columns, extrapolation):
    log = recording(noise=0.02)
    options = {"columns": columns, "extrapolation": extrapolation, "strength": 1e-3, "delays": 1}
    pieces = log[:5]
    model = tras.KoopmanModel(tras.Monomials(2), "one_step", horizon=59, **options).fit(pieces)
    longest = np.asarray(model.predict(pieces))[:, 2:]  # from the second sample on, as 58 samples follow it
    miss = np.sqrt(np.mean(((longest - pieces.states[:, 2:]) / model.x_scale_) ** 2))
    assert model.refinement_[-1] == pytest.approx(miss, rel=1e-9) and model.refinement_[-1] <= model.refinement_[0]
    plain = tras.KoopmanModel(tras.Monomials(2), "one_step", **options).fit(pieces)
    if columns == "all":
        assert np.array_equal(plain.koopman_matrix[:, 2:], model.koopman_matrix[:, 2:])
    assert not np.array_equal(plain.koopman_matrix, model.koopman_matrix)


def test_it_is_kept_reported_and_forgotten(tmp_path):
    log = recording(noise=0.02)
    model = tras.KoopmanModel(tras.Monomials(2), "one_step", 1, horizon=20).fit(log)
    model.save(tmp_path / "model.npz")
    again = tras.load_model(tmp_path / "model.npz")
    assert np.array_equal(again.predict(log), model.predict(log)) and again.horizon == 20
    assert "fitted to predictions over 20 samples" in again.report()
    plain = model.set_params(horizon=1).fit(log)
    assert not hasattr(plain, "refinement_") and "predictions over" not in plain.report()


def test_what_cannot_be_is_refused():
    log = recording()
    with pytest.raises(ValueError, match="horizon=20 needs predictor='one_step', but it is 'vector_field'; use 1"):
        tras.KoopmanModel(tras.Monomials(1), horizon=20).fit(log)
    with pytest.raises(ValueError, match="horizon is 0; give a whole number, 1 or more"):
        tras.KoopmanModel(tras.Monomials(1), "one_step", horizon=0).fit(log)
    model = tras.KoopmanModel(tras.Monomials(1), "one_step", horizon=20).fit(log)
    with pytest.raises(ValueError, match="horizon is 20, which needs all data at once"):
        model.partial_fit(log)


def test_many_predictions_are_taken_a_few_at_a_time(monkeypatch):
    segments, W, lift, slopes, later = polynomial()
    whole, errors = prediction_error.improved(W, W, segments, lift, slopes, later, 2)
    widths = []

    def watched(z, u):
        widths.append(z.shape[1])
        return lift(z, u)

    monkeypatch.setattr(prediction_error, "_AT_ONCE", 7 * 4 * W.size)  # derivatives of the 4 states in z by W
    pieces, again = prediction_error.improved(W, W, segments, watched, slopes, later, 2)
    assert set(widths) == {7, 6}  # of 20
    assert np.allclose(pieces, whole, rtol=0, atol=1e-10) and np.allclose(again, errors, rtol=1e-10)


def test_too_many_coefficients_at_once_are_refused_before_anything_is_lifted(monkeypatch):
    log = tras.Recording(np.random.default_rng(0).uniform(-1, 1, (5, 50, 3)), dt=0.1)
    model = tras.KoopmanModel(tras.Monomials(2), "one_step", horizon=5, max_functions=15)
    assert model.fit(log).refinement_ is not None  # 3 x 10 coefficients, twice as many as functions
    monkeypatch.setattr(tras.Monomials, "lift", None)
    with pytest.raises(
        ValueError, match="horizon is 5, .* 3 x 10 coefficients at once, .* max_functions=14; use horiz"
    ):
        model.set_params(max_functions=14).fit(log)
