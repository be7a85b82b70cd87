"""The extended Kalman filter: against python-control and the textbook's recursion, disturbances, delays, mistakes."""

import control
import numpy as np
import pytest
from conftest import linear_system
from rig import pendulum

import tras
from tras.control.predictors import Equations


@pytest.fixture(scope="module")
def linear():
    recording, A, B = linear_system([[0, 1], [-1, -0.2]], [[0], [1]], 0.1)
    return tras.KoopmanModel(tras.Monomials(1), regularization=None).fit(recording), A, B


def physical(observer):
    """The process noise of state and disturbance in physical units, and the scales."""
    c = observer.channels
    scale = np.concatenate([c.x_scale, c.u_scale])
    return observer.predictor.accuracy * c.x_scale, scale


def test_its_gain_settles_at_that_of_python_control(linear):
    """The stationary filter of state and disturbance; dlqe has the prediction's covariance."""
    model, A, B = linear
    observer = tras.Observer(model, measured=["x1"], noise=0.02, process=0.1, drift=0.01)
    accuracy, scale = physical(observer)
    F = np.block([[A, B], [np.zeros((1, 2)), 1]])
    Q = np.zeros((3, 3))
    Q[:2, :2] = np.diag(accuracy**2) + 0.1**2 * B @ B.T
    Q[2, 2] = 0.01**2
    _, P, _ = control.dlqe(F, np.eye(3), np.array([[1.0, 0, 0]]), Q, [[0.02**2]])
    rng = np.random.default_rng(0)
    for _ in range(400):
        observer.update(rng.normal(size=1), [0.1])
    before = F @ (observer.covariance * np.outer(scale, scale)) @ F.T + Q
    assert np.allclose(before, P, rtol=1e-6, atol=1e-9)


def test_a_linear_run_is_the_textbooks_recursion(linear):
    """Information form, in physical units: another arithmetic of the same filter."""
    model, A, B = linear
    observer = tras.Observer(model, measured=["x1"], noise=0.05, process=0.1, drift=0.02)
    accuracy, scale = physical(observer)
    F, H = np.block([[A, B], [np.zeros((1, 2)), 1]]), np.array([[1.0, 0, 0]])
    Q = np.zeros((3, 3))
    Q[:2, :2] = np.diag(accuracy**2) + 0.1**2 * B @ B.T
    Q[2, 2] = 0.02**2
    rng = np.random.default_rng(1)
    u, state, P = None, None, None
    for _ in range(40):
        y = rng.normal(size=1)
        x = observer.update(y, u)
        if u is None:
            state, P = np.concatenate([x, observer.disturbance]), observer.covariance * np.outer(scale, scale)
        else:
            predicted, P = F @ state + np.concatenate([B[:, 0], [0]]) * u[0], F @ P @ F.T + Q
            before = np.linalg.inv(P)
            P = np.linalg.inv(before + H.T @ H / 0.05**2)
            state = P @ (before @ predicted + H[0] * y / 0.05**2)
        u = rng.normal(size=1)
        assert np.allclose(x, state[:2], rtol=1e-6, atol=1e-6)
        assert np.allclose(observer.disturbance, state[2:], rtol=1e-6, atol=1e-6)


def test_angles_alone_give_rates_and_the_torque_that_nobody_knows(parameters, true_plant):
    """... on a motion of the nonlinear rig under torques with an unknown constant part."""
    known = 0.05 + 0.03 * np.sin(np.arange(800)[:, None] * 0.01 * np.array([1.3, 0.7]))
    unknown = np.array([0.02, -0.01])
    x = tras.simulate_plant(tras.rest_point(parameters), known + unknown, 0.01, parameters)
    observer = tras.Observer(true_plant, measured=["phi", "psi"])
    estimates = [observer.update(x[k, [0, 2]], None if k == 0 else known[k - 1]) for k in range(800)]
    assert np.abs(estimates[-1] - x[-1]).max() < 2e-3
    assert np.allclose(observer.disturbance, unknown, atol=1e-3)
    assert np.abs(np.diff(x[:, 1])).max() > 1e-3  # and it did move


def test_the_states_that_are_not_measured_are_not_looked_at(true_plant):
    observers = [tras.Observer(true_plant, measured=["psi", "phi"]) for _ in range(2)]
    rng, u = np.random.default_rng(0), None
    for _ in range(5):
        phi, psi = rng.normal(size=2)
        one = observers[0].update([psi, phi], u)  # in the order of `measured`
        other = observers[1].update([phi, 99.0, psi, -99.0], u)
        assert np.array_equal(one, other)
        u = [0.01, 0.02]


def test_the_covariance_stays_symmetric_and_positive(true_plant):
    observer = tras.Observer(true_plant, measured=["phi"], noise=1e-6)
    rng = np.random.default_rng(0)
    for k in range(300):
        observer.update([0.3 * np.sin(0.05 * k)], rng.uniform(-0.1, 0.1, 2))
        assert np.allclose(observer.covariance, observer.covariance.T, rtol=0, atol=1e-14)
    assert np.linalg.eigvalsh(observer.covariance).min() > -1e-14


def test_delayed_samples_are_estimated_too(torques):
    """A model of the angles with delays: noise on them is filtered, and the past shifts."""
    angles = torques.select(states=["phi", "psi"])
    model = tras.KoopmanModel(tras.Monomials(1), "one_step", 3, regularization="truncated", strength=1e-9).fit(angles)
    noise = np.array([0.02, 0.05])
    observer = tras.Observer(model, noise=noise, process=1e-3)
    x, u = angles.states[3], angles.inputs[3]
    measured = x + np.random.default_rng(0).normal(size=x.shape) * noise
    estimates = np.array([observer.update(measured[k], None if k == 0 else u[k - 1]) for k in range(len(x))])
    error = np.sqrt(np.mean((estimates[100:] - x[100:]) ** 2, axis=0))
    assert np.all(error < noise / 2)
    assert observer.covariance.shape == (16, 16)  # 4 samples of 2 angles, 3 of 2 torques, 2 disturbances


def test_it_begins_anew_where_the_model_runs_away():
    """Nothing that is measured tells of v, and its cubes overflow after a few samples."""
    away = Equations(lambda x, u: np.stack([0.9 * x[0] + 0.1 * u[0], (x[1] + 2) ** 3]), 0.1, [[-1, 1]], ["q", "v"],
                     ["f"])  # fmt: skip
    observer = tras.Observer(away, measured=["q"])
    q, v = np.array([observer.update([0.3], [0.3]) for _ in range(30)]).T
    assert np.allclose(q, 0.3, atol=1e-3) and np.isfinite(v).all() and np.abs(v).max() > 1e9
    assert (v == 0).sum() > 1 and np.isfinite(observer.covariance).all()
    assert observer.restarts == (v == 0).sum() - 1
    observer.reset()
    assert observer.restarts == 0


def test_it_begins_anew_after_a_reset(true_plant):
    observer = tras.Observer(true_plant)
    first = observer.update([0.1, 0, 0.2, 0], None)
    observer.update([0.2, 0, 0.3, 0], [0.1, 0.1])
    observer.reset()
    assert np.array_equal(observer.disturbance, [0, 0])
    assert np.array_equal(observer.update([0.1, 0, 0.2, 0], [0.1, 0.1]), first)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"measured": ["angle"]}, "measured names 'angle', which the model does not have"),
        ({"measured": ["q", "q"]}, "measured is .'q', 'q'.; name one state or more, each once"),
        ({"measured": []}, "name one state or more"),
        ({"disturbed": ["w"]}, "disturbed names 'w', which the model does not have"),
        ({"noise": -1}, "noise is -1; give a finite number, 0 or more"),
        ({"measured": ["q"], "noise": {"v": 0.1}}, "noise names 'v'"),
        ({"process": [1, 2]}, r"process has shape \(2,\); give 1 numbers: f"),
        ({"drift": {"f": np.inf}}, r"drift\['f'\] is inf"),
    ],
)
def test_mistakes_are_named(options, words):
    with pytest.raises(ValueError, match=words):
        tras.Observer(pendulum(), **options)


def test_a_wrong_measurement_is_named():
    with pytest.raises(ValueError, match=r"y is \[0.0, 0.0, 0.0\]; give finite numbers: q"):
        tras.Observer(pendulum(), measured=["q"]).update([0, 0, 0], None)
