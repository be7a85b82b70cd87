"""The simulated experiment: sample and hold, limits, anti-windup, bumpless start, records; many runs at once."""

import dataclasses

import numpy as np
import pytest

import tras
from tras.twin_rotor import closed_loop
from tras.twin_rotor.closed_loop import saturated


def test_the_papers_recording_has_the_papers_size(parameters):
    reference = tras.multisine(500, 0.01, [0.2, 0.8], [1.22173, np.pi], np.random.default_rng(1))
    recording = tras.simulate_closed_loop(reference, 0.01, parameters)
    assert recording.states.shape == (1, 50001, 4)
    assert recording.input_names == ("phi_ref", "psi_ref", "u_phi", "u_psi")
    pieces = recording.cut(501)
    assert (len(pieces), pieces.pairs) == (100, 50000)
    assert np.array_equal(pieces.states[:-1, -1], pieces.states[1:, 0])
    # Full ranges are reached and, in rad/s, no torque is ever at its limit.
    angles = recording.states[0][:, [0, 2]]
    assert np.all(np.abs(angles).max(axis=0) >= [1.2, 3.1])
    assert np.array_equal(saturated(recording, parameters), [0, 0])


def test_recorded_torques_reproduce_the_recorded_states(experiment, parameters):
    """Torque k acts from sample k to k + 1: an open-loop run under the recorded torques gives the same states."""
    for x, u in experiment.select(inputs=["u_phi", "u_psi"])[[0, 7]]:
        assert np.allclose(tras.simulate_plant(x[0], u, 0.01, parameters), x, rtol=0, atol=1e-12)


def test_default_gains_place_the_documented_poles(parameters):
    pitch, yaw = tras.PID.defaults(parameters)
    for pid, inertia, rate in ((pitch, parameters.J_phi, 1.0), (yaw, parameters.J + parameters.J_psi0, 0.5)):
        poles = np.roots([inertia, pid.D, pid.P])  # double integrator J q'' = -P q - D q'
        assert np.allclose(np.abs(poles), 4.0) and np.allclose(-poles.real / np.abs(poles), 0.9)
        assert pid.I == pytest.approx(rate * pid.P)


def test_starts_at_rest_on_the_reference_and_stays(parameters):
    recording = tras.simulate_closed_loop(np.tile([0.7, 1.5], (200, 1)), 0.01, parameters)
    assert np.allclose(recording.states, [0.7, 0, 1.5, 0], atol=1e-12)


def test_torques_respect_the_limits_and_the_integral_does_not_wind_up(parameters):
    """A yaw command out of reach saturates; back in reach the loop must recover at once, not after unwinding."""
    reference = np.zeros((6001, 2))
    reference[500:3000, 1] = 200.0
    recording = tras.simulate_closed_loop(reference, 0.01, parameters)
    u = recording.inputs[0][:, 2:]
    assert np.all(u >= [-0.144, -0.241]) and np.all(u <= [0.207, 0.140])
    assert (u[500:3000, 1] == 0.140).mean() > 0.5
    back = recording.states[0][3000:, 2]
    assert np.abs(back[1500:]).max() < 1.0


def test_derivative_gives_no_kick_at_a_step(parameters):
    reference = np.zeros((3, 2))
    reference[1:, 0] = 0.1
    recording = tras.simulate_closed_loop(reference, 0.01, parameters)
    pitch, _ = tras.PID.defaults(parameters)
    u = recording.inputs[0][:, 2]
    assert u[1] - u[0] == pytest.approx(pitch.P * 0.1, rel=1e-9)


def test_everything_needed_to_repeat_it_is_inside(parameters):
    recording = tras.simulate_closed_loop(np.zeros((3, 2)), 0.01, parameters, attributes={"seed": 7})
    assert recording.attributes["seed"] == 7
    assert recording.attributes["plant_K_psi"] == 0.003
    assert recording.attributes["pid_psi_P"] == tras.PID.defaults(parameters)[1].P
    assert recording.attributes["pid_phi_limits"] == [-0.144, 0.207] and recording.attributes["pid_psi_limits"] == [
        -0.241,
        0.14,
    ]


def test_saturation_is_counted_at_the_controllers_own_limits(parameters):
    narrow = tuple(dataclasses.replace(pid, limits=(-0.02, 0.02)) for pid in tras.PID.defaults(parameters))
    reference = np.zeros((200, 2))
    reference[100:] = 1.0
    recording = tras.simulate_closed_loop(reference, 0.01, parameters, controllers=narrow)
    torques = recording.inputs[0][:, 2:]
    assert np.array_equal(saturated(recording, parameters), (np.abs(torques) == 0.02).mean(axis=0))
    assert saturated(recording, parameters).min() > 0.1
    bare = tras.Recording(recording.states, recording.inputs, 0.01, input_names=recording.input_names)
    assert np.array_equal(saturated(bare, parameters), [0, 0])


@pytest.mark.parametrize(
    "make, words",
    [
        (lambda: tras.PID(1, 1, 1, (1, -1)), "limits is .1, -1.; give .lowest, highest."),
        (lambda: tras.PID(1, 1, 1, 0.2), "limits is 0.2"),
        (lambda: tras.PID(1, np.nan, 1, (-1, 1)), "I is nan; give a finite gain"),
        (lambda: tras.PID("1", 1, 1, (-1, 1)), "P is '1'"),
    ],
)
def test_controllers_that_cannot_be_are_named(make, words):
    with pytest.raises(ValueError, match=words):
        make()


@pytest.mark.parametrize(
    "reference, keywords, words",
    [
        (np.zeros((10, 3)), {}, "reference has shape .10, 3."),
        (np.full((10, 2), np.nan), {}, "reference holds NaN"),
        (np.zeros((10, 2)), {"x0": [0, 0, 0]}, "x0 is .0.0, 0.0, 0.0."),
    ],
)
def test_mistakes_are_named(reference, keywords, words):
    with pytest.raises(ValueError, match=words):
        tras.simulate_closed_loop(reference, 0.01, **keywords)


# --- many runs at once ---


def references(runs, seconds=6.0):
    rng = np.random.default_rng(0)
    time = np.arange(round(seconds / 0.01) + 1) * 0.01
    phases, sizes = rng.uniform(0, 6, (runs, 2)), rng.uniform(0.2, 1.2, (runs, 2)) * [1.0, 2.5]
    return np.stack([sizes[:, [k]] * np.sin(rate * time + phases[:, [k]]) for k, rate in enumerate((0.9, 0.7))], axis=2)


def rigs(runs):
    rng = np.random.default_rng(1)
    return [
        tras.PlantParameters(K_psi=k, C_phi=c)
        for k, c in zip(rng.uniform(0.001, 0.006, runs), rng.uniform(0.01, 0.02, runs))
    ]


@pytest.mark.slow
@pytest.mark.parametrize("x0", [None, [0.4, -1.0, 0.2, 1.5]])
@pytest.mark.parametrize("several", [False, True])
@pytest.mark.parametrize("batch", [1, 40])
def test_each_run_is_that_of_a_loop_by_itself(several, x0, batch, monkeypatch):
    """... with torques at their limits on the way, to the accuracy of the integration."""
    monkeypatch.setattr(closed_loop, "BATCH", batch)
    signals, fleet = references(5), rigs(5)
    controllers = tras.PID.defaults(tras.PlantParameters())
    controllers = tuple(dataclasses.replace(c, limits=(-0.1, 0.1)) for c in controllers)
    recording = tras.simulate_closed_loops(
        signals, 0.01, fleet if several else fleet[0], controllers=controllers, x0=x0
    )
    assert recording.states.shape == (5, 601, 4) and recording.input_names == ("phi_ref", "psi_ref", "u_phi", "u_psi")
    at_limits = np.abs(recording.inputs[..., 2:]) >= 0.1
    assert 0.01 < at_limits.mean() < 0.9
    for k in range(5):
        alone = tras.simulate_closed_loop(signals[k], 0.01, fleet[k if several else 0], controllers=controllers, x0=x0)
        assert np.allclose(recording.states[k], alone.states[0], rtol=0, atol=1e-8)
        assert np.allclose(recording.inputs[k], alone.inputs[0], rtol=0, atol=1e-8)


def test_one_reference_for_many_rigs_and_what_is_recorded():
    three = rigs(3)
    recording = tras.simulate_closed_loops(references(1)[0], 0.01, three, attributes={"study": "spring"})
    assert (
        recording.attributes["plant_K_psi"] == [rig.K_psi for rig in three]
        and recording.attributes["study"] == "spring"
    )
    assert recording.attributes["plant_G_c"] == three[0].G_c
    assert np.ptp(recording.states[:, -1, 2]) > 1e-4  # the rigs do differ
    assert np.array_equal(recording.inputs[0, :, :2], recording.inputs[2, :, :2])
    # The controllers are those of the mean rig, and all have them.
    assert recording.attributes["pid_phi_P"] == tras.PID.defaults(three[0])[0].P
    starts = np.zeros((4, 4))
    starts[:, 0] = [0.1, 0.2, 0.3, 0.4]
    assert np.array_equal(tras.simulate_closed_loops(references(1)[0], 0.01, x0=starts).states[:, 0], starts)


def test_at_rest_on_its_reference_a_rig_stays():
    held = np.repeat(np.array([[0.7, 1.5], [-0.2, -1.0]])[:, None], 100, axis=1)
    recording = tras.simulate_closed_loops(held, 0.01)
    assert np.allclose(recording.states[..., [0, 2]], held, atol=1e-12) and np.allclose(
        recording.states[..., [1, 3]], 0, atol=1e-12
    )


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"references": np.zeros((3, 50))}, r"references has shape \(3, 50\); give \(runs, samples, 2\)"),
        ({"references": np.full((2, 50, 2), np.nan)}, "references holds NaN or infinity"),
        (
            {"references": np.zeros((2, 50, 2)), "parameters": rigs(3)},
            "numbers of runs differ: references 2, parameters 3",
        ),
        (
            {"references": np.zeros((2, 50, 2)), "x0": np.zeros((5, 4))},
            "numbers of runs differ: references 2, parameters 1, x0 5",
        ),
        ({"references": np.zeros((2, 50, 2)), "x0": [0, 0, 0]}, r"x0 has shape \(3,\)"),
        ({"references": np.zeros((2, 50, 2)), "parameters": ["rig", "rig"]}, "sequence of them, one per run"),
        (
            {"references": np.zeros((2, 50, 2)), "parameters": [tras.PlantParameters(), tras.PrintedPlant()]},
            "simulate them apart",
        ),
    ],
)
def test_mistakes_in_many_runs_are_named(arguments, words):
    with pytest.raises(ValueError, match=words):
        tras.simulate_closed_loops(dt=0.01, **arguments)
