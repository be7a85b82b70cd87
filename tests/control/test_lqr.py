"""The linear quadratic regulator, against python-control and at its targets."""

import control
import numpy as np
import pytest
from conftest import linear_system
from rig import WEIGHTS, pendulum

import tras


@pytest.fixture(scope="module")
def linear():
    recording, A, B = linear_system([[0, 1], [-1, -0.2]], [[0], [1]], 0.1)
    return tras.KoopmanModel(tras.Monomials(1), regularization=None).fit(recording), A, B


def test_the_gain_is_that_of_python_control(linear):
    model, A, B = linear
    controller = tras.LQR(model, weights=[3.0, 0.0], input_weights=0.2, state_weights={"x2": 0.5})
    gain, _, _ = control.dlqr(A, B, np.diag([3.0, 0.5]), [[0.2]])
    assert np.allclose(controller.gain, gain, rtol=1e-6)


def test_a_linear_loop_is_closed_by_that_gain(linear):
    """u = u_s - K (x - x_s), with the target of a reference: x1 there, x2 zero, the spring held."""
    model, A, B = linear
    controller = tras.LQR(model, weights=[3.0, 0.0], input_weights=0.2, limits=[(-50, 50)], offset_free=False)
    gain, _, _ = control.dlqr(A, B, np.diag([3.0, 0.0]), [[0.2]])
    x, state = np.array([0.3, -0.1]), np.array([0.3, -0.1])
    for _ in range(30):
        u = controller(x, [0.4])
        expected = 0.4 - gain @ (state - [0.4, 0.0])  # the spring has stiffness 1
        assert np.allclose(u, expected, atol=1e-6)
        x, state = A @ x + B @ u, A @ state + B @ expected
    assert x[0] == pytest.approx(0.4, abs=1e-2)


def test_the_target_of_a_nonlinear_plant_is_its_rest_point(parameters, true_plant):
    torques = np.array([0.06, 0.001])
    rest = tras.rest_point(parameters, torques)
    controller = tras.LQR(true_plant, weights=WEIGHTS, offset_free=False)
    assert np.allclose(controller(rest, rest[[0, 2]]), torques, atol=1e-7)


def test_it_has_no_steady_error_under_an_unknown_torque(parameters, true_plant):
    controller = tras.LQR(true_plant, weights=WEIGHTS, input_weights=0.1)
    run = tras.simulate_closed_loop(np.tile([0.3, 0.8], (1001, 1)), 0.01, parameters, controllers=controller,
                                    disturbances=[0.02, 0.014])  # fmt: skip
    assert np.abs(run.states[0][-50:, [0, 2]] - [0.3, 0.8]).max() < 1e-3
    assert np.allclose(controller.disturbance, [0.02, 0.014], atol=1e-4)


def test_what_cannot_be_regulated_is_said():
    from tras.control.predictors import Equations

    adrift = Equations(lambda x, u: np.stack([x[0] + 0.1 * u[0], 1.1 * x[1]]), 0.1, [[-1, 1]], ["q", "r"], ["f"])
    with pytest.raises(ValueError, match="weights leave the linear quadratic problem without a solution"):
        tras.LQR(adrift, weights={"q": 1})
    with pytest.raises(ValueError, match=r"x has shape \(3,\) and u \(1,\); give finite numbers, \(2,\) and \(1,\)"):
        tras.LQR(pendulum(), x=[0, 0, 0])
