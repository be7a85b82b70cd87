"""The experiment with motors under feedback."""

import numpy as np
import pytest

import tras
from tras.twin_rotor import rotors

MAKER, ROTONDO = tras.RotorParameters.maker, tras.RotorParameters.rotondo


@pytest.mark.parametrize("make", [MAKER, ROTONDO])
def test_the_rig_comes_to_the_reference(make):
    log = tras.simulate_motor_loop(np.tile([-0.2, 0.4], (3001, 1)), 0.01, make())
    x, u = log.states[0], log.inputs[0]
    assert np.abs(x[-1, [0, 2]] - [-0.2, 0.4]).max() < 0.01
    assert np.abs(x[-1, [1, 3]]).max() < 0.02 and np.abs(u[:, :2]).max() <= 1


def test_states_are_those_of_the_recorded_inputs():
    """With test signal and gusts: the recording is a simulation of its commands and torques."""
    rig = MAKER(dead_zone=(0.02, 0.02))
    reference, test = tras.multisine(5, 0.01, [2, 2], [0.2, 0.3], 0), tras.multisine(5, 0.01, [20, 20], [0.1, 0.1], 1)
    log = tras.simulate_motor_loop(
        reference, 0.01, rig, test_signal=test, gusts=tras.gusts(5, 0.01, (0.01, 0.005), 1, 2)
    )
    assert log.input_names == ("u_m", "u_t", "gust_phi", "gust_psi", "phi_ref", "psi_ref")
    assert log.state_names == rig.state_names and log.input_units[:3] == ("", "", "N m")
    u = log.inputs[0]
    again = tras.simulate_rotors(rotors.rest_point(rig), u[:, :2], 0.01, rig, gusts=u[:, 2:4])
    assert np.allclose(again, log.states[0], rtol=1e-12, atol=1e-12)
    assert np.array_equal(u[:, 4:], reference)
    assert log.attributes["plant_dead_zone"] == [0.02, 0.02]


def test_the_test_signal_is_added_to_the_commands():
    rig, reference = MAKER(), np.tile([-0.3, 0.1], (2, 1))
    silent = tras.simulate_motor_loop(reference, 0.01, rig).inputs[0]
    loud = tras.simulate_motor_loop(reference, 0.01, rig, test_signal=np.tile([-0.05, 0.02], (2, 1))).inputs[0]
    assert np.allclose((loud - silent)[0, :2], [-0.05, 0.02])
    limited = tras.simulate_motor_loop(reference, 0.01, rig, test_signal=np.full((2, 2), 9.0)).inputs[0]
    assert np.all(limited[:, :2] == 1)


def test_many_runs_equal_one_after_the_other():
    rig, rng = ROTONDO(), np.random.default_rng(0)
    reference = np.stack([tras.multisine(2, 0.01, [5, 5], [0.2, 0.3], seed) for seed in range(3)])
    test = rng.normal(0, 0.05, reference.shape)
    x0 = rotors.rest_point(rig) + np.column_stack([rng.uniform(-0.1, 0.1, (3, 4)), np.zeros((3, 2))])
    together = tras.simulate_motor_loop(reference, 0.01, rig, test_signal=test, x0=x0)
    assert len(together) == 3
    for run in range(3):
        alone = tras.simulate_motor_loop(reference[run], 0.01, rig, test_signal=test[run], x0=x0[run])
        assert np.allclose(alone.states[0], together.states[run], rtol=1e-10, atol=1e-10)
        assert np.allclose(alone.inputs[0], together.inputs[run], rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize(
    "options, words",
    [
        ({"reference": np.zeros((5, 3))}, "reference has shape .5, 3."),
        ({"reference": np.zeros((1, 2))}, "reference has shape .1, 2."),
        ({"test_signal": np.zeros((4, 2))}, "test_signal has shape .4, 2. but reference .5, 2."),
        ({"gusts": np.full((5, 2), np.nan)}, "gusts holds NaN"),
        ({"speed_gain": -1}, "speed_gain is -1"),
        ({"x0": [0, 0]}, "x0 has shape .2,."),
        ({"dt": 0}, "dt is 0"),
    ],
)
def test_mistakes_are_named(options, words):
    arguments = {"reference": np.zeros((5, 2)), "dt": 0.01, "parameters": MAKER(), **options}
    with pytest.raises(ValueError, match=words):
        tras.simulate_motor_loop(**arguments)
