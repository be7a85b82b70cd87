"""Many closed loops at once against one after the other."""

import dataclasses

import numpy as np
import pytest

import tras
from tras import monte_carlo


def references(runs, seconds=6.0):
    rng = np.random.default_rng(0)
    time = np.arange(round(seconds / 0.01) + 1) * 0.01
    phases, sizes = rng.uniform(0, 6, (runs, 2)), rng.uniform(0.2, 1.2, (runs, 2)) * [1.0, 2.5]
    return np.stack([sizes[:, [k]] * np.sin(rate * time + phases[:, [k]]) for k, rate in enumerate((0.9, 0.7))], axis=2)


def rigs(runs):
    rng = np.random.default_rng(1)
    return [tras.PlantParameters(K_psi=k, C_phi=c) for k, c in zip(rng.uniform(0.001, 0.006, runs), rng.uniform(0.01, 0.02, runs))]


@pytest.mark.parametrize("x0", [None, [0.4, -1.0, 0.2, 1.5]])
@pytest.mark.parametrize("several", [False, True])
@pytest.mark.parametrize("together", [1, 40])
def test_each_run_is_that_of_a_loop_by_itself(several, x0, together, monkeypatch):
    """... with torques at their limits on the way, to the accuracy of the integration."""
    monkeypatch.setattr(monte_carlo, "TOGETHER", together)
    wanted, own = references(5), rigs(5)
    controllers = tras.PID.defaults(tras.PlantParameters())
    controllers = tuple(dataclasses.replace(c, limits=(-0.1, 0.1)) for c in controllers)
    made = tras.simulate_closed_loops(wanted, 0.01, own if several else own[0], controllers=controllers, x0=x0)
    assert made.states.shape == (5, 601, 4) and made.input_names == ("phi_ref", "psi_ref", "u_phi", "u_psi")
    at_limits = np.abs(made.inputs[..., 2:]) >= 0.1
    assert 0.01 < at_limits.mean() < 0.9
    for k in range(5):
        alone = tras.simulate_closed_loop(wanted[k], 0.01, own[k if several else 0], controllers=controllers, x0=x0)
        assert np.allclose(made.states[k], alone.states[0], rtol=0, atol=1e-8)
        assert np.allclose(made.inputs[k], alone.inputs[0], rtol=0, atol=1e-8)


def test_one_reference_for_many_rigs_and_what_is_recorded():
    own = rigs(3)
    made = tras.simulate_closed_loops(references(1)[0], 0.01, own, attributes={"study": "spring"})
    assert made.attributes["plant_K_psi"] == [rig.K_psi for rig in own] and made.attributes["study"] == "spring"
    assert made.attributes["plant_G_c"] == own[0].G_c
    assert np.ptp(made.states[:, -1, 2]) > 1e-4  # the rigs do differ
    assert np.array_equal(made.inputs[0, :, :2], made.inputs[2, :, :2])
    # The controllers are those of the mean rig, and all have them.
    assert made.attributes["pid_phi_P"] == tras.PID.defaults(own[0])[0].P
    starts = np.zeros((4, 4))
    starts[:, 0] = [0.1, 0.2, 0.3, 0.4]
    assert np.array_equal(tras.simulate_closed_loops(references(1)[0], 0.01, x0=starts).states[:, 0], starts)


def test_at_rest_on_its_reference_a_rig_stays():
    held = np.repeat(np.array([[0.7, 1.5], [-0.2, -1.0]])[:, None], 100, axis=1)
    made = tras.simulate_closed_loops(held, 0.01)
    assert np.allclose(made.states[..., [0, 2]], held, atol=1e-12) and np.allclose(made.states[..., [1, 3]], 0, atol=1e-12)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"references": np.zeros((3, 50))}, r"references has shape \(3, 50\); give \(runs, samples, 2\)"),
        ({"references": np.full((2, 50, 2), np.nan)}, "references holds NaN or infinity"),
        ({"references": np.zeros((2, 50, 2)), "parameters": rigs(3)}, "numbers of runs differ: references 2, parameters 3"),
        ({"references": np.zeros((2, 50, 2)), "x0": np.zeros((5, 4))}, "numbers of runs differ: references 2, parameters 1, x0 5"),
        ({"references": np.zeros((2, 50, 2)), "x0": [0, 0, 0]}, r"x0 has shape \(3,\)"),
        ({"references": np.zeros((2, 50, 2)), "parameters": ["rig", "rig"]}, "sequence of them, one a run"),
        ({"references": np.zeros((2, 50, 2)), "parameters": [tras.PlantParameters(), tras.PrintedPlant()]}, "simulate them apart"),
    ],
)
def test_mistakes_are_named(arguments, words):
    with pytest.raises(ValueError, match=words):
        tras.simulate_closed_loops(dt=0.01, **arguments)
