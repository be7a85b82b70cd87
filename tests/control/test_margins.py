"""Margins of the linearised loop: against python-control's, and against loops that are changed by as much."""

import numpy as np
import pytest
from conftest import linear_system

import tras
from tras.control.margins import _gains, _law, gain_and_phase, margins


@pytest.fixture(scope="module")
def model():
    """A linear system of two inputs, unstable by itself."""
    recording, _, _ = linear_system([[0, 1, 0], [0.5, -0.2, 0.3], [0.2, 0, -0.5]], [[0, 0], [1, 0.4], [0.1, 1]], 0.1)
    return tras.KoopmanModel(tras.Monomials(1), "one_step", regularization=None).fit(recording)


@pytest.fixture(scope="module")
def single():
    """One of one input."""
    recording, _, _ = linear_system([[0, 1], [0.5, -0.2]], [[0], [1]], 0.1)
    return tras.KoopmanModel(tras.Monomials(1), "one_step", regularization=None).fit(recording)


def at_rest(model, kind, **options):
    """A controller that has come to rest on its reference, and `margins`' arguments."""
    followed = model.state_names_[::2]
    limits = [(-99, 99)] * len(model.input_names_)
    controller = kind(model, weights=dict.fromkeys(followed, 1.0), limits=limits, **options)
    c, predictor, rows = controller.channels, controller.predictor, controller.rows
    z, goal = predictor.start([c.x_offset], [c.u_offset]), c.x_offset[rows] + 0.05
    for _ in range(400):
        u = (controller(z * c.x_scale + c.x_offset, goal) - c.u_offset) / c.u_scale
        z = predictor.advance(z[:, None], u[:, None])[:, 0]
    controller(z * c.x_scale + c.x_offset, goal)
    nothing = np.zeros(len(c.u_scale)), np.zeros(len(z))
    estimate = (z, *nothing) if controller.observer is None else controller.observer.estimate
    return controller, (*estimate, (goal - c.x_offset[rows]) / c.x_scale[rows])


CASES = [(tras.LQR, {"offset_free": False}), (tras.LQR, {}), (tras.MPC, {"horizon": 15}),
         (tras.MPC, {"horizon": 15, "offset_free": False})]  # fmt: skip


@pytest.mark.parametrize("kind, options", CASES, ids=str)
def test_the_linearised_loop_decays_as_the_loop_does(kind, options, model):
    controller, point = at_rest(model, kind, **options)
    result = margins(controller, *point)
    c, predictor = controller.channels, controller.predictor
    z, goal = point[0] + 1e-3 * np.array([1.0, -1.0, 0.5]), point[-1] * c.x_scale[[0, 2]] + c.x_offset[[0, 2]]
    distances = []
    for _ in range(200):
        u = (controller(z * c.x_scale + c.x_offset, goal) - c.u_offset) / c.u_scale
        z = predictor.advance(z[:, None], u[:, None])[:, 0]
        distances.append(np.abs(z - point[0]).max())
    slow = np.array(distances)[20:80]
    rate = np.exp(np.polyfit(np.arange(60), np.log(np.maximum(slow, 1e-300)), 1)[0])
    assert result.radius < 1 and rate <= result.radius + 0.05
    assert result.disk.shape == (2,) and (result.disk >= result.disk_of_all - 1e-9).all()


@pytest.mark.parametrize("kind, options", CASES, ids=str)
def test_disk_margins_are_those_of_python_control(kind, options, single):
    control = pytest.importorskip("control", reason="python-control is not installed")
    controller, point = at_rest(single, kind, **options)
    result = margins(controller, *point)
    c = controller.channels
    u = (controller.u - c.u_offset) / c.u_scale
    _, slopes = controller.predictor.advance_with_slopes(point[0][:, None], (u + point[1])[:, None])
    plant = slopes[0][:, :2], slopes[0][:, 2:]
    law = _law(controller, plant, _gains(controller, (*point[:3], u), point[3]))
    plant = control.ss(*plant, np.eye(2), np.zeros((2, 1)), 0.1)
    loop = -control.ss(*law, 0.1) * plant
    frequencies = np.geomspace(1e-4, 1, 600) * np.pi / 0.1
    disk, _, phase = control.disk_margins(loop, frequencies)
    assert disk == pytest.approx(result.disk_of_all, rel=1e-6) and result.disk == pytest.approx(disk, rel=1e-6)
    assert phase == pytest.approx(gain_and_phase(result.disk_of_all)[2], rel=1e-6)


@pytest.mark.parametrize("kind, options", CASES, ids=str)
def test_the_loop_bears_as_much_delay_as_it_says_and_no_more(kind, options, model):
    """The controller's own inputs, delayed on the way to the model."""
    controller, point = at_rest(model, kind, **options)
    delay = margins(controller, *point).delay
    assert 0 <= delay < 50
    c, predictor, rest = controller.channels, controller.predictor, controller.u
    goal = point[-1] * c.x_scale[[0, 2]] + c.x_offset[[0, 2]]

    def grows(samples):
        controller.reset()
        for _ in range(100):
            controller(point[0] * c.x_scale + c.x_offset, goal)
        z, line, sizes = point[0] + 1e-6, [rest] * samples, []
        for _ in range(400):
            line.append(controller(z * c.x_scale + c.x_offset, goal))
            held = (line.pop(0) - c.u_offset) / c.u_scale
            z = predictor.advance(z[:, None], held[:, None])[:, 0]
            sizes.append(np.abs(z - point[0]).max())
        return max(sizes[300:]) > 2 * max(sizes[50:150])

    assert grows(delay + 1) and not grows(delay)


def test_at_a_limit_the_loop_is_open(model):
    controller, point = at_rest(model, tras.LQR, offset_free=False)
    controller.limits[0, 1] = controller.u[0]
    assert margins(controller, *point) is None


def test_gains_and_phases():
    assert gain_and_phase(0.0) == (1.0, 1.0, 0.0)
    low, high, phase = gain_and_phase(2.0)
    assert (low, high) == (0.0, np.inf) and phase == pytest.approx(90)
    low, high, phase = gain_and_phase(2 / 3)  # a factor of two
    assert (low, high) == pytest.approx((0.5, 2.0)) and phase == pytest.approx(36.87, abs=0.01)
