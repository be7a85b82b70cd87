"""A model as a linear system about a point."""

import sys

import control
import numpy as np
import pytest
from conftest import linear_system
from scipy import linalg

import tras
from tras.analysis.linearization import StateSpace


def pendulum(predictor, delays=0, seed=0, dictionary=None, **options):
    """A model of a damped pendulum with a torque, angle in degrees, and its recording."""
    rng = np.random.default_rng(seed)
    x, u, dt = np.zeros((30, 60, 2)), np.repeat(rng.uniform(-1, 1, (30, 12, 1)), 5, axis=1), 0.05
    x[:, 0] = rng.uniform(-1, 1, (30, 2))
    for k in range(59):
        state = x[:, k]
        for _ in range(20):
            state = state + dt / 20 * np.stack([state[:, 1], u[:, k, 0] - np.sin(state[:, 0]) - 0.3 * state[:, 1]], 1)
        x[:, k + 1] = state
    x *= [180 / np.pi, 1.0]
    recording = tras.Recording(x, 5 + u, dt, state_names=["q", "q.rate"], input_names=["T"])
    dictionary = dictionary or tras.Monomials(3)
    return tras.KoopmanModel(dictionary, predictor, delays, strength=0.001, **options).fit(recording), recording


def deviations(model, start, u, h=1e-4):
    """A and B of the newest states by central differences of `simulate`, the starts (delays + 1, n)."""

    def later(start, u):
        return model.simulate(start if model.delays else start[0], u)[..., -1, :]

    columns = []
    for i in range(start.shape[1]):
        move = np.zeros_like(start)
        move[-1, i] = h * model.x_scale_[i]
        columns.append((later(start + move, u) - later(start - move, u)) / (2 * move[-1, i]))
    moves = np.zeros_like(u)
    moves[-2] = h * model.u_scale_
    return np.array(columns).T, (later(start, u + moves) - later(start, u - moves))[:, None] / (2 * moves[-2])


@pytest.mark.parametrize("predictor", ["vector_field", "one_step"])
@pytest.mark.parametrize("dictionary", [tras.Monomials(3), tras.Fourier(2), tras.GaussianRBF(30, 1.0)], ids=type)
def test_it_is_the_slope_of_the_prediction_over_a_sample(predictor, dictionary):
    model, _ = pendulum(predictor, dictionary=dictionary)
    x, u = np.array([40.0, 0.5]), np.array([5.3])
    system = model.linearize(x, u)
    A, B = deviations(model, x[None], np.tile(u, (2, 1)))
    assert np.allclose(system.A, A, rtol=1e-6, atol=1e-8) and np.allclose(system.B, B, rtol=1e-6, atol=1e-8)
    assert np.array_equal(system.C, np.eye(2)) and not system.D.any() and system.dt == model.dt_


def test_a_cubic_field_has_the_slope_of_its_flow():
    """x' = -x^3 has the solution x / sqrt(1 + 2 x^2 t), with the slope (1 + 2 x^2 t)^(-3/2)."""
    x0 = np.linspace(-1, 1, 41)
    t = 0.1 * np.arange(15)
    x = x0[:, None] / np.sqrt(1 + 2 * x0[:, None] ** 2 * t)
    recording = tras.Recording(x[..., None], dt=0.1)
    model = tras.KoopmanModel(tras.Monomials(3), regularization=None, extrapolation="functions").fit(recording)
    model.W_ = np.array([[0, 0, 0, -1.0]])  # the field itself, not its estimate
    model.substeps_ = 64
    assert model.channels_.x_scale[0] == 1 and model.names_ == ["1", "x1", "x1^2", "x1^3"]
    for point in (0.0, 0.3, -0.8):
        system = model.linearize([point])
        assert np.allclose(system.A, (1 + 2 * point**2 * 0.1) ** -1.5, rtol=1e-9)


@pytest.mark.parametrize("predictor", ["vector_field", "one_step", "lifted_linear"])
def test_a_linear_system_is_its_own(predictor):
    A, B = np.array([[0, 1], [-4, -0.4]]), np.array([[0], [1]])
    recording = linear_system(A, B, 0.05, trajectories=6, samples=80)[0]
    model = tras.KoopmanModel(tras.Monomials(1), predictor, regularization=None).fit(recording)
    system = model.linearize(np.zeros(2), np.zeros(1))
    held = linalg.expm(0.05 * np.block([[A, B], [np.zeros((1, 3))]]))[:2]
    assert np.allclose(control.dcgain(system)[:, 0], -np.linalg.solve(A, B)[:, 0], atol=1e-6)
    response = control.forced_response(system, U=np.ones((1, 4))).outputs[:, 1]
    assert np.allclose(response, held[:, 2], atol=1e-8)
    if predictor != "lifted_linear":
        assert np.allclose(np.hstack([system.A, system.B]), held, atol=1e-8)


@pytest.mark.parametrize("predictor, count", [("vector_field", 3), ("one_step", 5)])
def test_delayed_samples_are_states_that_shift(predictor, count):
    _, recording = pendulum("one_step")
    angle = recording.select(states=["q"])
    model = tras.KoopmanModel(tras.Monomials(1), predictor, 2, strength=0.01).fit(angle)
    z = np.array([40.0, 38.0, 36.0, 5.2, 5.1][:count])
    system = model.linearize(z, [5.3])
    assert system.A.shape == (count, count) and system.state_labels[1:3] == ["q[-1]", "q[-2]"]
    assert np.allclose(system.A[1:3], np.eye(2, count), atol=1e-9) and np.allclose(system.B[1:3], 0, atol=1e-9)
    if count == 5:
        assert np.allclose(system.B[3:, 0], [1, 0], atol=1e-9) and np.allclose(system.A[4], np.eye(5)[3], atol=1e-9)
    A, B = deviations(model, z[2::-1, None], np.array([[5.1], [5.2], [5.3], [0.0]]))
    assert np.allclose(system.A[:1, :1], A, rtol=1e-6) and np.allclose(system.B[:1], B, rtol=1e-6)


def test_a_state_alone_has_been_there_before():
    model, _ = pendulum("one_step", 1)
    assert np.array_equal(model.linearize([40, 0], [5]).A, model.linearize([40, 0, 40, 0, 5], [5]).A)


def test_small_deviations_of_a_lifted_model_are_predicted():
    model, recording = pendulum("lifted_linear")
    system = model.linearize()
    u = recording.inputs[0]
    x0, moved = recording.states[0, 0], np.zeros((len(u), 1))
    moved[3:] = 0.2
    change = model.simulate(x0, u + moved) - model.simulate(x0, u)
    response = control.forced_response(system, U=moved.T).outputs.T
    assert np.allclose(response, change, atol=1e-9 * np.abs(recording.states).max())
    assert np.abs(change[:, 0]).max() > 1


@pytest.mark.parametrize(
    "predictor, delays",
    [("vector_field", 0), ("one_step", 0), ("one_step", 2), ("lifted_linear", 0), ("lifted_linear", 2)],
)
def test_an_input_of_the_same_instant_is_in_D(predictor, delays):
    """What a linear model with a lead simulates, the linear system does too: no sample early, none late."""
    recording = pendulum("one_step")[1]
    later = recording.with_data(list(recording.states), [np.concatenate([u[:1], u[:-1]]) for u in recording.inputs])
    options = {"strength": 0.001, "extrapolation": "functions", "lead": 1}  # linear wherever it goes
    model = tras.KoopmanModel(tras.Monomials(1), predictor, delays, **options).fit(later)
    system, u = model.linearize(), later.inputs[0]
    x0, moved = later.states[0, : delays + 1], np.random.default_rng(1).normal(size=u.shape)
    moved[: delays + 1] = 0
    x0 = x0 if delays else x0[0]
    change = (model.simulate(x0, u + moved) - model.simulate(x0, u))[delays:]
    response = control.forced_response(system, U=moved[delays:].T).outputs.T
    assert np.allclose(response, change, atol=1e-7 * np.abs(change).max())
    assert np.allclose(system.D[:, 0], change[1] / moved[delays + 1]) and np.abs(system.D).max() > 0.01
    assert len(set(system.state_labels)) == len(system.A) and "q" not in system.state_labels


def test_feedback_of_a_model_with_a_lead_is_an_algebraic_loop():
    """The closed loop of python-control is the model's own, with the input solved for at each instant."""
    recording = pendulum("one_step")[1]
    later = recording.with_data(list(recording.states), [np.concatenate([u[:1], u[:-1]]) for u in recording.inputs])
    model = tras.KoopmanModel(tras.Monomials(1), "one_step", strength=0, lead=1).fit(later)
    gain, centre = np.array([[0.02, 0.3]]), np.array([30.0, 0.0])
    system = model.linearize()
    loop = control.feedback(system, control.ss([], [], [], gain, model.dt_), sign=-1)
    start = np.array([10.0, -0.2])  # deviations from a run that rests at the model's offset
    x, free = [start], model.simulate(centre, np.zeros((30, 1)))
    for _ in range(29):
        # u[k+1] = -gain x[k+1], x[k+1] = onward + D u[k+1]
        onward = model.simulate(centre + x[-1], np.zeros((2, 1)))[1] - model.simulate(centre, np.zeros((2, 1)))[1]
        u = -np.linalg.solve(np.eye(1) + gain @ system.D, gain @ onward)
        x.append(onward + system.D @ u)
    assert len(free) == len(x)
    # The loop's state is x - B u.
    first = start + system.D @ gain @ start
    run = control.initial_response(loop, np.arange(30) * model.dt_, first).outputs
    assert np.allclose(run.T, x, atol=1e-9 * np.abs(x).max())
    assert np.abs(x[-1]).max() < 0.9 * np.abs(x[0]).max()


def test_signals_have_the_channels_names():
    model, _ = pendulum("one_step")
    system = model.linearize()
    assert system.output_labels == ["q", "q_rate"] and system.input_labels == ["T"]


def test_without_python_control_it_is_a_named_tuple(monkeypatch):
    model, _ = pendulum("one_step")
    system = model.linearize([40.0, 0.5], [5.3])
    monkeypatch.setitem(sys.modules, "control", None)
    plain = model.linearize([40.0, 0.5], [5.3])
    assert isinstance(plain, StateSpace) and np.array_equal(plain.A, system.A) and np.array_equal(plain.B, system.B)


def test_an_autonomous_model_has_no_inputs():
    recording = tras.Recording([[[0.9**k] for k in range(30)]], dt=0.1)
    system = tras.KoopmanModel(tras.Monomials(1), "one_step").fit(recording).linearize([0.5])
    assert np.shape(system.B) == (1, 0) and np.allclose(system.A, 0.9)


@pytest.mark.parametrize(
    "x, u, message",
    [
        ([1.0], [5.0], r"x has shape \(1,\); give \(2,\): q, q.rate"),
        ([1.0, 0.0], [5.0, 1.0], r"u has shape \(2,\); give \(1,\): T"),
        ([np.nan, 0.0], [5.0], "holds NaN"),
    ],
)
def test_wrong_points_are_refused(x, u, message):
    with pytest.raises(ValueError, match=message):
        pendulum("one_step")[0].linearize(x, u)
