"""Model predictive control: against closed forms and a general optimiser, its constraints, what happens on failure."""

import numpy as np
import pytest
from conftest import linear_system
from rig import RATE_WEIGHTS, WEIGHTS, pendulum
from scipy.optimize import minimize

import tras
from tras.control import qp
from tras.control.qp import Solution


@pytest.fixture(scope="module")
def linear():
    recording, A, B = linear_system([[0, 1], [-1, -0.2]], [[0], [1]], 0.1)
    return recording, A, B


@pytest.mark.parametrize("kind", ["vector_field", "one_step", "lifted_linear"])
def test_without_limits_a_linear_plan_is_the_closed_form(kind, linear):
    """Least squares over the whole horizon, built anew from the system's own matrices."""
    recording, A, B = linear
    model = tras.KoopmanModel(tras.Monomials(1), kind, regularization=None).fit(recording)
    N, weight, rate = 7, 3.0, 0.05
    controller = tras.MPC(model, horizon=N, weights={"x1": weight}, rate_weights=rate, limits=[(-99, 99)],
                          offset_free=False)  # fmt: skip
    rng = np.random.default_rng(2)
    powers = [np.linalg.matrix_power(A, k) for k in range(N + 1)]
    G = np.array([[(powers[i - j] @ B)[0, 0] if j <= i else 0.0 for j in range(N)] for i in range(N)])
    F = np.array([powers[i + 1][0] for i in range(N)])
    D = np.eye(N) - np.eye(N, k=-1)
    x, last = rng.normal(size=2), None
    for _ in range(4):
        reference = rng.normal(size=(N + 1, 1))
        changes, before = (D[1:], np.zeros(N - 1)) if last is None else (D, np.r_[last, np.zeros(N - 1)])
        rows = np.vstack([np.sqrt(weight) * G, np.sqrt(rate) * changes])
        target = np.concatenate([np.sqrt(weight) * (reference[1:, 0] - F @ x), np.sqrt(rate) * before])
        plan = np.linalg.lstsq(rows, target, rcond=None)[0]
        u = controller(x, reference)
        assert np.allclose(controller.plan[:, 0], plan, rtol=1e-5, atol=1e-5) and u[0] == controller.plan[0, 0]
        x, last = A @ x + B @ u, u[0]
        assert np.allclose(controller.states_planned[0], x, atol=1e-6)


@pytest.mark.parametrize("moves", [None, 3, [1, 2, 5]])
def test_the_plan_of_a_nonlinear_system_is_that_of_a_general_optimiser(moves):
    """Converged linearisations and SLSQP on the simulated cost reach the same plan, with inputs at their limits."""
    system, N, dt, rate, last = pendulum(), 8, 0.1, 0.02, 0.2
    controller = tras.MPC(system, horizon=N, weights={"q": 1.0}, rate_weights=rate, rates={"f": 8.0},
                          iterations=30, moves=moves, offset_free=False)  # fmt: skip
    lengths = {None: [1] * N, 3: [1, 1, 6]}.get(moves if moves is None or np.isscalar(moves) else "", moves)
    hold = np.repeat(np.eye(len(lengths)), lengths, axis=0)
    x, reference = np.array([0.4, -0.5]), np.linspace(0.35, 0.55, N + 1)[:, None]
    controller(x, [x[0]])
    controller.u = np.array([last])  # the input before

    def cost(moves):
        u, state, errors = hold @ moves, x[:, None], []
        for k in range(N):
            state = system._physical(state, u[None, k : k + 1])
            errors.append(state[0, 0] - reference[k + 1, 0])
        return np.sum(np.square(errors)) + rate * np.sum(np.diff(u, prepend=last) ** 2)

    size = len(lengths)
    change = np.eye(size) - np.eye(size, k=-1)
    first = np.r_[last, np.zeros(size - 1)]
    constraint = [
        {"type": "ineq", "fun": lambda v: 8.0 * dt - (change @ v - first)},
        {"type": "ineq", "fun": lambda v: 8.0 * dt + (change @ v - first)},
    ]
    options = {"ftol": 1e-14, "maxiter": 500}
    best = minimize(cost, np.zeros(size), method="SLSQP", bounds=[(-1.5, 1.5)] * size, constraints=constraint,
                    options=options)  # fmt: skip
    controller(x, reference)
    assert best.success and np.ptp(hold @ best.x) > 0.2
    assert np.allclose(controller.plan[:, 0], hold @ best.x, atol=2e-4)
    starts = np.r_[0, np.cumsum(lengths)[:-1]]
    assert cost(controller.plan[starts, 0]) == pytest.approx(best.fun, rel=1e-6)


def test_inputs_and_rates_stay_within_their_limits():
    system = pendulum()
    controller = tras.MPC(system, horizon=10, weights={"q": 1.0}, rate_weights=1e-4, rates={"f": 3.0})
    x, rng, inputs = np.array([0.0, 0.0]), np.random.default_rng(0), []
    for _ in range(60):
        u = controller(x, rng.uniform(-2, 2, (11, 1)))
        inputs.append(u[0])
        x = system._physical(x[:, None], u[:, None])[:, 0]
    assert np.abs(inputs).max() <= 1.5 and np.abs(inputs).max() > 1.49
    assert np.abs(np.diff(inputs)).max() <= 0.3 + 1e-9 and np.abs(np.diff(inputs)).max() > 0.29
    assert controller.failures == 0


def test_a_soft_limit_of_a_state_is_kept_where_it_can_be():
    system = pendulum()
    free, bound = (
        tras.MPC(system, horizon=12, weights={"q": 1.0}, rate_weights=1e-3, iterations=3, states=states)
        for states in (None, {"v": (-0.4, 0.4), "q": (-np.inf, 0.6)})
    )
    highest = []
    for controller in (free, bound):
        x, path = np.array([0.0, 0.0]), []
        for _ in range(60):
            u = controller(x, [0.62])
            x = system._physical(x[:, None], u[:, None])[:, 0]
            path.append(x)
        highest.append(np.max(path, axis=0))
    assert highest[0][1] > 0.6 and highest[1][1] <= 0.4 + 1e-6 and highest[1][0] <= 0.6 + 1e-6
    assert highest[1][0] > 0.59
    bound([0.9, 1.0], [0.6])  # outside already: no input helps at once
    assert bound.status == "solved" and bound.plan[0, 0] == pytest.approx(-1.5)


def test_held_inputs_are_held_in_the_plan(true_plant):
    controller = tras.MPC(true_plant, horizon=12, weights=WEIGHTS, moves=[1, 1, 2, 8])
    controller([0.1, 0, 0, 0], np.linspace([0.1, 0.0], [0.101, 0.003], 13))
    changes = np.abs(np.diff(controller.plan, axis=0)).max(axis=1) > 1e-9
    assert np.flatnonzero(changes).tolist() == [0, 1, 3]


def failing(monkeypatch, controller, status="time limit"):
    monkeypatch.setattr(controller.program, "solve", lambda *_, **__: Solution(None, status, np.empty(0), 0))


def test_a_program_that_does_not_solve_leaves_the_rest_of_the_last_plan(true_plant, monkeypatch):
    controller = tras.MPC(true_plant, horizon=6, weights=WEIGHTS, rate_weights=RATE_WEIGHTS)
    preview = np.linspace([0.1, 0.0], [0.102, 0.01], 20)
    x = np.array([0.1, 0, 0, 0])
    controller(x, preview)
    plan = controller.plan
    failing(monkeypatch, controller)
    for k in range(1, 9):
        u = controller(x, preview[k:])
        assert (
            np.allclose(u, plan[min(k, 5)], rtol=0, atol=1e-15)
            and controller.status == "time limit"
            and controller.failures == k
        )
    monkeypatch.undo()
    controller(x, preview)
    assert controller.status == "solved" and controller.failures == 8
    controller.reset()
    assert controller.failures == 0


def test_without_any_plan_it_stays_within_the_limits(true_plant, monkeypatch, parameters):
    controller = tras.MPC(true_plant, horizon=6, weights=WEIGHTS)
    failing(monkeypatch, controller, "infeasible")
    u = controller([0.1, 0, 0, 0], [0.1, 0.0])
    low, high = np.transpose(parameters.input_limits)
    assert np.all((low <= u) & (u <= high))
    assert controller.status == "infeasible" and controller.failures == 1


def test_a_real_limit_of_iterations_is_survived(true_plant, monkeypatch):
    controller = tras.MPC(true_plant, horizon=20, weights=WEIGHTS)
    controller.program = qp.Program(iterations=2)
    for _ in range(3):
        u = controller([0.1, 0, 0, 0], [0.8, 3.0])
    assert controller.status == "iteration limit" and controller.failures == 3 and np.isfinite(u).all()


def test_a_preview_is_held_after_its_end(true_plant):
    plans = []
    for reference in ([0.2, 0.3], [[0.2, 0.3]], np.tile([0.2, 0.3], (90, 1))):
        controller = tras.MPC(true_plant, horizon=8, weights=WEIGHTS)
        controller([0.1, 0, 0, 0], reference)
        plans.append(controller.plan)
    assert np.array_equal(plans[0], plans[1]) and np.array_equal(plans[0], plans[2])


def test_delays_are_remembered(torques):
    """A model of the angles alone, with delays: the controller keeps the past that the model asks for."""
    angles = torques.select(states=["phi", "psi"])
    model = tras.KoopmanModel(tras.Monomials(1), "one_step", 3, regularization="truncated", strength=1e-9).fit(angles)
    controller = tras.MPC(model, horizon=20, weights=WEIGHTS, offset_free=False)
    x = angles.states[0][:5]
    for sample in x:
        controller(sample, [0.1, 0.1])
        last = controller.u
    c = model.channels_
    z = controller.predictor.start(controller._states, controller._inputs_before) * c.z_scale + c.z_offset
    assert np.allclose(z[:8], x[:0:-1].ravel()) and np.allclose(z[8:10], last)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"horizon": 0}, "horizon is 0; give a whole number, 1 or more"),
        ({"weights": {"phi": 1, "psj": 1}}, "weights names 'psj', which the model does not have: did you mean 'psi'"),
        ({"weights": {"phi": -1}}, r"weights\['phi'\] is -1; give a finite number, 0 or more"),
        ({"weights": [1, 2]}, r"weights has shape \(2,\); give 4 numbers: phi, phidot, psi, psidot"),
        ({"weights": {"phi": 0}}, "give a positive weight to at least one state"),
        ({"rate_weights": 0}, "rate_weights is 0; give positive numbers"),
        ({"rate_weights": {"u_phi": np.nan}}, r"rate_weights\['u_phi'\] is nan"),
        ({"limits": [(0, 1)]}, "limits holds 1 pairs; give one for each of u_phi, u_psi"),
        ({"limits": {"u_phi": (1, 0)}}, r"limits\['u_phi'\] is \(1, 0\); give \(lowest, highest\)"),
        ({"states": {"phi": 3}}, r"states\['phi'\] is 3; give \(lowest, highest\)"),
        ({"moves": [1, 2]}, "moves holds 3 samples together but the horizon 40; make them equal"),
        ({"moves": 41}, "moves is 41; give a whole number from 1 to 40"),
        ({"iterations": 1.5}, "iterations is 1.5"),
        ({"time_limit": -1}, "time_limit is -1; give seconds, or 0 for no limit"),
        ({"observer": "kalman"}, "observer is 'kalman'; give a tras.Observer of the same model"),
        (
            {"observer": tras.Observer(pendulum())},
            "observer estimates q, v; make it of the model that the controller has",
        ),
    ],
)
def test_mistakes_in_options_are_named(options, words, true_plant):
    with pytest.raises(ValueError, match=words):
        tras.MPC(true_plant, **options)


@pytest.mark.parametrize(
    ("x", "reference", "words"),
    [
        ([0, 0, 0], [0, 0], r"y is \[0.0, 0.0, 0.0\]; give finite numbers: phi, phidot, psi, psidot"),
        ([0, 0, 0, np.nan], [0, 0], "give finite numbers"),
        ([0, 0, 0, 0], [0, 0, 0], r"reference has shape \(3,\); give \(2,\) or \(samples, 2\): phi, psi"),
        ([0, 0, 0, 0], [[0, np.inf]], "reference holds NaN or infinity"),
        ([0, 0, 0, 0], np.empty((0, 2)), r"reference has shape \(0, 2\)"),
    ],
)
def test_mistakes_at_a_sample_are_named(x, reference, words, true_plant):
    with pytest.raises(ValueError, match=words):
        tras.MPC(true_plant, weights=WEIGHTS)(x, reference)


def test_there_is_no_plan_before_the_first_sample(true_plant):
    with pytest.raises(ValueError, match="no plan yet; call it first"):
        _ = tras.MPC(true_plant).plan
