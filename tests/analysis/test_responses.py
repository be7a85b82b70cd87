"""Step and frequency responses, of linear systems and of recordings, against scipy's, python-control's and formulas."""

import control
import numpy as np
import pytest
from conftest import linear_system
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

import tras
from tras.analysis import responses
from tras.analysis.linearization import StateSpace, matrices

HELD = StateSpace(np.array([[0.9, 0.1], [-0.2, 0.8]]), np.array([[0.0], [0.5]]), np.eye(2), np.zeros((2, 1)), 0.1)


def driven(system, samples, noise, seed=0, colour=None, trajectories=1):
    """Trajectories of a linear system under white inputs, or filtered ones, and noise on its outputs."""
    rng = np.random.default_rng(seed)
    states, inputs = [], []
    for _ in range(trajectories):
        u = rng.normal(size=(samples, system.B.shape[1]))
        u = u if colour is None else signal.lfilter(*colour, u, axis=0)
        x = control.forced_response(control.ss(*system), U=u.T).outputs.T.reshape(samples, -1)
        states.append(x + noise * rng.normal(size=x.shape))
        inputs.append(u)
    return states, inputs


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 6), st.integers(1, 3))
def test_the_frequency_response_is_that_of_control(seed, states, inputs):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(states, states))
    A *= 0.9 / max(np.abs(np.linalg.eigvals(A)).max(), 0.1)
    system = StateSpace(A, rng.normal(size=(states, inputs)), rng.normal(size=(2, states)), np.ones((2, inputs)), 0.02)
    frequency = np.geomspace(0.1, 25, 40)
    expected = control.ss(*system)(np.exp(2j * np.pi * frequency * 0.02), squeeze=False)
    assert np.allclose(responses.frequency_response(system, frequency), np.moveaxis(expected, -1, 0), rtol=1e-7)


def test_a_pole_on_the_circle_is_infinite_and_no_error():
    integrator = StateSpace(np.eye(1), np.eye(1), np.eye(1), np.zeros((1, 1)), 1.0)
    gain = np.abs(responses.frequency_response(integrator, [0.0, 0.25]))
    assert not np.isfinite(gain[0, 0, 0]) and np.isclose(gain[1, 0, 0], 1 / np.sqrt(2))


def test_the_step_response_is_that_of_scipy():
    _, expected = signal.dstep(HELD, n=50)
    assert np.allclose(responses.step_response(HELD, 50)[:, :, 0], expected[0])
    unstable = HELD._replace(A=2 * np.eye(2))
    assert not np.isfinite(responses.step_response(unstable, 2000)[-1]).any()  # and no warning


def test_the_recordings_response_is_welchs():
    """One input and one trajectory: cross-spectrum over spectrum, and the coherence, as scipy has them."""
    (x,), (u,) = driven(HELD, 3000, 0.3)
    measured = responses.measured_response([x], [u], 0.1, 256)
    options = {"fs": 10, "nperseg": 256, "detrend": "constant"}
    for i in range(2):
        f, across = signal.csd(u[:, 0], x[:, i], **options)
        own = signal.welch(u[:, 0], **options)[1]
        coherence = signal.coherence(u[:, 0], x[:, i], **options)[1]
        # At Nyquist's frequency and next to zero scipy's one-sided spectra count half; the ratio does not.
        assert np.allclose(measured.frequency, f[1:])
        assert np.allclose(measured.response[:, i, 0], (across / own)[1:], rtol=1e-9)
        assert np.allclose(measured.coherence[:, i], coherence[1:], rtol=1e-9)
    assert (measured.segments, measured.samples) == (22, 256)


def test_two_inputs_that_move_together_are_told_apart():
    """A state that follows the first input alone: a quotient of spectra would give the second one half of it."""
    rng = np.random.default_rng(0)
    u = rng.normal(size=(20000, 2))
    u[:, 1] += u[:, 0]
    x = np.zeros((20000, 1))
    for k in range(19999):
        x[k + 1] = 0.5 * x[k] + u[k, 0]
    measured = responses.measured_response([x], [u], 1.0, 128)
    z = np.exp(2j * np.pi * measured.frequency)
    assert np.abs(measured.response[:, 0, 0] * (z - 0.5) - 1).max() < 0.1
    assert np.abs(measured.response[:, 0, 1]).max() < 0.1


def test_the_deviation_is_how_far_the_response_is_off():
    """Mean square of the error over the stated variance: 1, over many recordings and all frequencies but the ends."""
    ratios = []
    for seed in range(40):
        states, inputs = driven(HELD, 1000, 1.0, seed, trajectories=3)
        measured = responses.measured_response(states, inputs, 0.1, 100)
        truth = responses.frequency_response(HELD, measured.frequency)
        error = np.abs(measured.response - truth)[2:-2]
        ratios.append(error**2 / (measured.deviation * np.abs(measured.response))[2:-2] ** 2)
    assert 0.85 < np.mean(ratios) < 1.25


def test_nothing_is_trusted_where_the_input_has_no_power_or_noise_hides_the_rest():
    low = signal.butter(8, 0.2)
    states, inputs = driven(HELD, 4000, 0.01, colour=low)
    measured = responses.measured_response(states, inputs, 0.1, 256)
    assert measured.trusted[measured.frequency < 0.8].all()
    assert not measured.trusted[measured.frequency > 2.5].any() and not measured.excited[measured.frequency > 2.5].any()
    states, inputs = driven(HELD, 4000, 1000.0)
    noisy = responses.measured_response(states, inputs, 0.1, 256)
    assert noisy.excited.all() and noisy.trusted.mean() < 0.05


def test_too_little_has_no_response():
    (x,), (u,) = driven(HELD, 40, 0.0)
    assert responses.measured_response([x], [u], 0.1, 40) is None
    assert responses.segment_length(tras.Recording([x], [u], 0.1)) == 0
    assert responses.segment_length(tras.Recording([x] * 20, [u] * 20, 0.1)) == 40


@pytest.mark.parametrize("lead", [0, 1])
def test_the_model_and_the_recording_have_one_response(lead):
    """Also where the input of the same instant acts: gain and phase, to what the recording is sure of."""
    states, inputs = driven(HELD, 1500, 0.0, trajectories=4)
    if lead:
        states, inputs = [x[:-1] for x in states], [np.concatenate([u[:1], u[:-1]])[:-1] for u in inputs]
    recording = tras.Recording(states, inputs, 0.1)
    model = tras.KoopmanModel(tras.Monomials(1), "one_step", strength=0, lead=lead).fit(recording)
    measured = responses.measured_response(states, inputs, 0.1, 256)
    of_model = responses.frequency_response(matrices(model), measured.frequency)
    assert measured.trusted.mean() > 0.95
    assert np.abs(of_model / measured.response - 1)[5:].max() < 0.1


@pytest.mark.parametrize("delays", [0, 2])
def test_a_model_rests_where_its_equations_say(delays):
    A, B = np.array([[0, 1], [-4, -0.4]]), np.array([[0], [1]])
    recording = linear_system(A, B, 0.05, trajectories=6, samples=300)[0]
    moved = recording.with_data(list(recording.states), [u + 0.1 for u in recording.inputs])
    noisy = tras.add_noise(moved, 1e-3, 0)  # else a delay says nothing new
    model = tras.KoopmanModel(tras.Monomials(1), "one_step", delays, strength=0.001).fit(noisy)
    x, u, rests = responses.rest_point(model, moved)
    assert rests and np.allclose(u, np.concatenate(moved.inputs).mean(axis=0))
    onward = model.simulate(np.tile(x, (delays + 1, 1)) if delays else x, np.tile(u, (200, 1)))
    assert np.allclose(onward, x, atol=1e-5) and np.abs(x[0] - (u[0] - 0.1) / 4) < 0.02


def test_an_integrator_rests_nowhere():
    rng = np.random.default_rng(0)
    u = rng.uniform(0, 1, (5, 100, 1))
    recording = tras.Recording(np.cumsum(u, axis=1) - u, u, 0.1)
    model = tras.KoopmanModel(tras.Monomials(1), "one_step", strength=0).fit(recording)
    x, _, rests = responses.rest_point(model, recording)
    assert not rests and np.allclose(x, recording.states.mean(axis=(0, 1)))
