"""Roll-outs and what happens beyond the training data."""

import copy

import numpy as np
import pytest
from scipy.linalg import expm

import tras
from tras import koopman, metrics, rollout
from tras.hull import Hull, outward_rates, over_a_sample
from tras.identification.examples import example

BOUNDED = [tras.Monomials(3), tras.Exponentials(), tras.GaussianRBF(20)]


@pytest.fixture(scope="module")
def torque_data(experiment):
    return experiment.select(inputs=["u_phi", "u_psi"])


@pytest.fixture
def cloud():
    """1000 points in three channels, correlated."""
    rng = np.random.default_rng(0)
    return np.array([[1, 0, 0], [0.8, 0.3, 0], [0.1, 0.2, 0.05]]) @ rng.uniform(-1, 1, (3, 1000)) + 0.2


def test_inside_the_hull_nothing_changes(cloud):
    hull = Hull(cloud)
    assert hull.nearest(cloud) is cloud
    # A quarter of the half-range more is allowed on each side, no more than that, along the principal axes.
    t = hull.axes.T @ (cloud - hull.centre)
    middle, half = (t.max(axis=1) + t.min(axis=1)) / 2, np.ptp(t, axis=1) / 2
    for k in range(3):
        for sign in (1, -1):
            point = middle.copy()
            point[k] += sign * 1.249 * half[k]
            inside = hull.centre + hull.axes @ point[:, None]
            assert hull.nearest(inside) is inside
            point[k] = middle[k] + sign * 1.251 * half[k]
            outside = hull.centre + hull.axes @ point[:, None]
            assert np.allclose(np.linalg.norm(hull.nearest(outside) - outside), 0.001 * half[k], rtol=1e-6)


def test_outside_it_is_the_nearest_point_of_the_box(cloud):
    hull = Hull(cloud)
    assert np.allclose(hull.axes.T @ np.cov(cloud) @ hull.axes, np.diag(np.linalg.eigvalsh(np.cov(cloud))), atol=1e-12)
    rng = np.random.default_rng(1)
    z = rng.uniform(-4, 4, (3, 200))
    near = hull.nearest(z)
    assert np.allclose(hull.nearest(near), near, atol=1e-13)  # in the box
    t = hull.axes.T @ (cloud - hull.centre)
    low, high = t.min(axis=1, keepdims=True), t.max(axis=1, keepdims=True)
    room = (high - low) / 8
    box = hull.centre + hull.axes @ rng.uniform(low - room, high + room, (3, 5000))
    away = np.linalg.norm(z - near, axis=0)
    assert np.all(away <= np.linalg.norm(z[:, :, None] - box[:, None], axis=0).min(axis=1) + 1e-12)
    # A point inside is not moved although others of the batch are.
    both = np.column_stack([cloud[:, 0], z[:, 0]])
    assert np.allclose(hull.nearest(both)[:, 0], cloud[:, 0], atol=1e-15)


def test_a_box_far_from_the_origin_is_not_its_mirror_image(cloud):
    hull = Hull(cloud + 10)
    inside = cloud[:, :1] + 10
    assert hull.nearest(inside) is inside
    assert (
        np.abs(hull.nearest(-inside) - inside).max() < 3 and np.abs(hull.nearest(np.zeros((3, 1))) - inside).max() < 3
    )


def test_only_confined_channels_are_held(cloud):
    hull = Hull(cloud, confined=[1])
    z = np.array([[50.0], [50.0], [-50.0]])
    low, high = cloud[1].min(), cloud[1].max()
    assert np.allclose(hull.nearest(z)[:, 0], [50, high + (high - low) / 8, -50], atol=1e-13)
    inside = np.array([[50.0], [0.2], [-50.0]])
    assert hull.nearest(inside) is inside


@pytest.mark.parametrize("confined", [None, [0, 2]])
def test_widening_makes_room_for_new_data_and_gives_none_up(confined, cloud):
    hull = Hull(cloud, confined)
    far = np.array([[5.0], [-5.0], [3.0]])
    assert hull.nearest(far) is not far
    hull.widen(far)
    assert hull.nearest(far) is far and hull.nearest(cloud) is cloud
    before = hull.upper.copy()
    hull.widen(cloud[:, :1])
    assert np.array_equal(hull.upper, before)


@pytest.mark.parametrize("predictor", ["vector_field", "one_step"])
@pytest.mark.parametrize("dictionary", BOUNDED, ids=str)
@pytest.mark.slow
def test_predictions_stay_bounded_under_inputs_thrice_the_training_range(dictionary, predictor, torque_data):
    """50 s of square waves at three times the largest torque. Measured: at most 4.7 half-ranges."""
    model = tras.KoopmanModel(dictionary, predictor, strength=1e-2).fit(torque_data)
    wave = np.sign(np.sin(np.linspace(0, 200, 5000)[:, None] * [1, 1.3] + 1))
    states = model.simulate(torque_data.states[:4, 0], model.u_offset_ + 3 * model.u_scale_ * wave)
    assert np.abs((states - model.x_offset_) / model.x_scale_).max() <= 10


def test_that_bound_is_the_extrapolations_merit(torque_data):
    model = tras.KoopmanModel(tras.Monomials(3), strength=1e-2, extrapolation="functions").fit(torque_data)
    wave = np.sign(np.sin(np.linspace(0, 200, 5000)[:, None] * [1, 1.3] + 1))
    assert np.isnan(model.simulate(torque_data.states[0, 0], model.u_offset_ + 3 * model.u_scale_ * wave)).any()


@pytest.mark.parametrize("predictor", ["vector_field", "one_step"])
@pytest.mark.parametrize("dictionary", BOUNDED, ids=str)
def test_inside_the_data_both_extrapolations_are_the_same_bits(dictionary, predictor, torque_data):
    linear, functions = (
        tras.KoopmanModel(dictionary, predictor, strength=1e-2, extrapolation=e).fit(torque_data)
        for e in ("linear", "functions")
    )
    assert np.array_equal(linear.koopman_matrix, functions.koopman_matrix)
    windows = torque_data.cut(101)
    a, b = linear.predict(windows), functions.predict(windows)
    z = np.concatenate(
        [(a - linear.x_offset_) / linear.x_scale_, (windows.inputs - linear.u_offset_) / linear.u_scale_], axis=-1
    )
    hull = linear.hull_
    t = (z - hull.centre[:, 0]) @ hull.axes
    # Well inside, so that the points between the samples are too.
    room = 0.2 * (hull.high - hull.low)[:, 0] / 2
    inside = np.all((t > hull.low[:, 0] - room) & (t < hull.high[:, 0] + room), axis=(1, 2))
    # An abandoned neighbour changes nobody else; but wider products may round otherwise, so compare one by one.
    assert inside.sum() >= 80
    for i in np.flatnonzero(inside)[:5]:
        one = [m.simulate(windows.states[i, 0], windows.inputs[i]) for m in (linear, functions)]
        assert np.array_equal(*one)
    assert np.allclose(a[inside], b[inside], rtol=0, atol=1e-12)


def test_beyond_the_hull_the_field_is_continuous_and_points_back(torque_data):
    model = tras.KoopmanModel(tras.Monomials(3), strength=1e-2).fit(torque_data)
    eigenvalues = np.linalg.eigvals(model.outward_[:, :4])
    assert eigenvalues.real.max() < 0
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(6, 50))
    reach = np.linspace(0, 3, 3001)
    rates = np.stack([model.map()(r * direction) for r in reach])
    jumps = np.abs(np.diff(rates, axis=0)).max(axis=(1, 2))
    assert jumps.max() <= 50 * np.median(jumps)
    assert np.allclose(model.outward_step_, over_a_sample(model.outward_, 0.01))


def test_flow_over_a_sample_is_the_exponential():
    rng = np.random.default_rng(0)
    A, B, dt = rng.normal(size=(3, 3)), rng.normal(size=(3, 2)), 0.3
    step = over_a_sample(np.hstack([A, B]), dt)
    assert np.allclose(step[:, :3], expm(A * dt), atol=1e-14)
    assert np.allclose(step[:, 3:], np.linalg.solve(A, (expm(A * dt) - np.eye(3)) @ B), atol=1e-13)
    assert np.allclose(over_a_sample(A, dt), expm(A * dt), atol=1e-14)  # no inputs


def test_outward_rates_are_hurwitz_whatever_the_linear_model():
    rng = np.random.default_rng(0)
    for _ in range(20):
        change = rng.normal(size=(6, 6))
        S = outward_rates(change, 3, 0.01, 3)
        free = change[1:, 1:4].T / 0.01
        assert S.shape == (3, 5) and np.array_equal(S[:, 3:], free[:, 3:])
        moves = np.abs(np.linalg.eigvals(free[:, :3])).max()
        assert np.linalg.eigvals(S[:, :3]).real.max() <= -moves * (1 - 1e-9) or np.array_equal(S, free)


def pendulum(point):
    return np.array([point[1], -np.sin(point[0]) + point[2]])


def test_runge_kutta_has_order_four():
    z, u = np.array([[1.0, 0.3], [0.5, -2.0]]), np.array([[0.2, -0.1]])
    exact = rollout.runge_kutta(pendulum, z, u, 1.0, 4096)
    errors = [np.abs(rollout.runge_kutta(pendulum, z, u, 1.0, k) - exact).max() for k in (8, 16, 32, 64)]
    assert np.allclose(np.log2(np.divide(errors[:-1], errors[1:])), 4, atol=0.25)
    assert np.array_equal(z, [[1.0, 0.3], [0.5, -2.0]])  # not written to


def test_enough_substeps_are_enough_and_not_many_more():
    rng = np.random.default_rng(0)
    z, u = rng.uniform(-1, 1, (2, 100)), rng.uniform(-1, 1, (1, 100))
    counts = [rollout.enough_substeps(pendulum, z, u, dt).count for dt in (0.001, 0.1, 0.5, 1.0)]
    assert counts[0] == 1 and counts == sorted(counts) and counts[-1] > 1
    for dt, count in zip((0.1, 0.5, 1.0), counts[1:]):
        exact = rollout.runge_kutta(pendulum, z, u, dt, 1024)
        assert np.abs(rollout.runge_kutta(pendulum, z, u, dt, count) - exact).max() <= 2e-8
        if count > 1:
            assert np.abs(rollout.runge_kutta(pendulum, z, u, dt, count // 2) - exact).max() > 1e-9
    assert rollout.enough_substeps(lambda p: -1e3 * p[:2], z, u, 1.0, most=8).count == 8


def edge(point):
    """Drifts upwards, and bends at 0.5: what starts just below crosses the bend."""
    return 0.01 - np.maximum(point[:1] - 0.5, 0)


def test_a_few_predictions_across_a_kink_ask_for_no_more_steps():
    z, u = np.linspace(-1, 1, 2001)[None], np.empty((0, 2001))
    exact = rollout.enough_substeps(edge, z, u, 1.0)
    assert exact.count == 64 and not exact.enough and exact.moved < 1e-8  # the others are long settled
    counts = [rollout.enough_substeps(edge, z, u, 1.0, tolerable=share)[:2] for share in (1e-9, 1e-6, 1.0)]
    assert counts[1:] == [(8, True), (8, True)] and counts[0][0] > 8
    crossing = np.linspace(0.49, 0.5, 100)[None]
    assert rollout.enough_substeps(edge, crossing, u[:, :100], 1.0, tolerable=1e-7).count > 8


@pytest.mark.parametrize("rate", [-150.0, np.nan])
def test_one_prediction_that_runs_away_asks_for_all_steps(rate):
    z, rates = np.ones((1, 1000)), np.full((1, 1000), -1.0)
    assert rollout.enough_substeps(lambda p: p[1:] * p[:1], z, rates, 1.0, tolerable=1e-5)[:2] == (8, True)
    rates[0, 500] = rate  # 32 steps are not stable there, 64 are
    steps = rollout.enough_substeps(lambda p: p[1:] * p[:1], z, rates, 1.0, tolerable=1e-5)
    assert steps[:2] == (64, False)
    z[0, 500], rates[0, 500] = 1e-12, -50  # by 8 steps it grows to a few half-ranges, by 16 it does not
    assert rollout.enough_substeps(lambda p: p[1:] * p[:1], z, rates, 1.0, tolerable=1e-5)[:2] == (16, True)


def test_a_row_that_does_not_matter_asks_for_no_steps():
    z, u = np.ones((2, 50)), np.empty((0, 50))
    rates = np.array([[-1.0], [-20.0]])
    assert rollout.enough_substeps(lambda p: rates * p, z, u, 1.0).count == 32
    steps = rollout.enough_substeps(lambda p: rates * p, z, u, 1.0, tolerable=np.array([[1e-5], [np.inf]]))
    assert steps == (8, True, steps.moved) and steps.moved < 1e-3


def test_sixteen_steps_are_stable_for_whatever_a_logarithm_holds():
    decay, turn = np.log(np.finfo(float).eps), np.pi  # a mode as small as rounding, a turn by half a circle
    A = np.array([[decay, turn], [-turn, decay]])
    after = rollout.runge_kutta(lambda p: A @ p, np.eye(2), np.empty((0, 2)), 1.0, 16)
    assert np.linalg.norm(after, 2) < 1


def test_roll_out_abandons_only_what_left():
    z = np.array([[1.0, 1.0, -0.5]])
    growth = np.array([1.0, 3.0, 0.5])
    states = rollout.roll_out(lambda s, u: s * growth + u, z, np.zeros((30, 1, 3)))
    assert states.shape == (30, 1, 3) and np.all(states[:, 0, 0] == 1)
    lost = np.isnan(states[:, 0, 1])
    first = int(np.argmax(lost))
    assert first == 7 and lost[first:].all()  # 3^7 > 1000
    assert np.allclose(states[:, 0, 2], -0.5 * 0.5 ** np.arange(30))


@pytest.mark.parametrize("columns", ["all", "states"])
def test_beyond_the_hull_a_model_follows_the_linear_one_of_its_data(columns, torque_data):
    model = tras.KoopmanModel(tras.Monomials(2), "one_step", strength=1e-2, columns=columns).fit(torque_data)
    change = koopman.koopman_matrix(
        tras.Monomials(1).fit(np.zeros(4), np.zeros(2)), model.channels_.scaled(torque_data)
    )[0] - np.eye(7)
    exact = outward_rates(change, 4, model.dt_, 4)
    assert np.allclose(model.outward_, exact, rtol=1e-9, atol=1e-9 * np.abs(exact).max())
    assert np.array_equal(model.outward_step_, over_a_sample(model.outward_, model.dt_))


def test_a_coarser_model_predicts_the_same_within_what_a_figure_shows():
    log = example("duffing", trials=6, noise=0)
    model = tras.KoopmanModel(tras.Monomials(3)).fit(log)
    fast = rollout.coarser(model)
    assert model.substeps_ >= 4 and fast.substeps_ == model.substeps_ // 4
    difference = np.abs(np.asarray(fast.predict(log)) - np.asarray(model.predict(log))).max()
    assert 0 < difference < 1e-3
    stepping = tras.KoopmanModel(tras.Monomials(1), "one_step").fit(log)
    assert rollout.coarser(stepping) is stepping


def test_a_field_that_runs_away_by_few_steps_is_integrated_by_all(monkeypatch):
    """As a mode does that is stable with all of them alone."""
    log = example("duffing", trials=6, noise=0)
    model = tras.KoopmanModel(tras.Monomials(3)).fit(log)
    wild = copy.copy(model)
    wild.W_ = 1e3 * model.W_
    exact = model.predict(log)
    assert metrics.diverged(log.states, wild.predict(log)).any()
    assert not np.array_equal(rollout.predict_coarsely(model, log), exact)
    monkeypatch.setattr(rollout, "coarser", lambda _: wild)
    assert np.array_equal(rollout.predict_coarsely(model, log), exact)
