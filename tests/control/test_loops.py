"""Controllers on the true rig: what they reach, what disturbs them, and that a wrong sign is noticed."""

import numpy as np
import pytest
from rig import RATE_WEIGHTS, WEIGHTS

import tras
from tras.control.predictors import Equations, plant

LIMITS = tras.PlantParameters().input_limits


def mpc(model, **options):
    return tras.MPC(model, weights=WEIGHTS, rate_weights=RATE_WEIGHTS, limits=LIMITS, **options)


def rms(reference, **options):
    run = tras.simulate_closed_loop(reference, 0.01, **options)
    torques = run.inputs[0][:, 2:]
    low, high = np.transpose(LIMITS)
    assert np.all((torques >= low - 1e-9) & (torques <= high + 1e-9))
    return np.sqrt(np.mean((run.states[0][:, [0, 2]] - reference) ** 2, axis=0))


def multisine(seconds=4):
    return tras.multisine(20, 0.01, [3.0, 2.0], [0.6, 1.2], 5)[: round(seconds / 0.01) + 1]


def test_the_model_flies_the_rig_as_the_true_plant_does(mechanical, true_plant):
    reference = multisine()
    model, truth = (rms(reference, controllers=mpc(m), preview=True) for m in (mechanical, true_plant))
    pid = rms(reference)
    assert np.all(model <= 1.05 * truth) and np.all(10 * model <= pid)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["fast", "paper", "eight", "steps"])
def test_so_it_does_on_every_reference(kind, mechanical, true_plant):
    time = np.arange(801)[:, None] * 0.01
    reference = {
        "fast": lambda: multisine(8),
        "paper": lambda: tras.multisine(500, 0.01, [0.2, 0.8], [1.22173, np.pi], 1)[:801],
        "eight": lambda: np.hstack([0.4 * np.sin(1.6 * time), np.sin(0.8 * time)]),
        "steps": lambda: tras.steps(8, 0.01, [0.4, 1.0], 3, longest=5.0),
    }[kind]()
    for preview in (True, False):
        model, truth = (rms(reference, controllers=mpc(m), preview=preview) for m in (mechanical, true_plant))
        assert np.all(model <= 1.05 * truth)
    if kind == "fast":
        model = rms(reference, controllers=mpc(mechanical), preview=True)
        assert np.all(10 * model <= rms(reference))


def test_a_wrong_sign_is_noticed(parameters, true_plant):
    """The same test on a model whose pitch torque acts the other way: were it still passed, it would show nothing."""
    c, advance = true_plant.channels, true_plant._physical
    turned = Equations(lambda x, u: advance(x, u * [[-1.0], [1.0]]), 0.01, true_plant.limits, c.state_names,
                       c.input_names)  # fmt: skip
    reference = multisine(2)
    right, wrong = (rms(reference, controllers=mpc(m), preview=True) for m in (true_plant, turned))
    assert wrong[0] > 50 * right[0]


@pytest.mark.parametrize("height", [-1.0, 1.0])
def test_a_step_of_yaw_without_preview_settles_in_a_second(height, mechanical):
    reference = np.zeros((300, 2))
    reference[20:, 1] = height
    run = tras.simulate_closed_loop(reference, 0.01, controllers=mpc(mechanical))
    outside = np.flatnonzero(np.abs(run.states[0][:, 2] - reference[:, 1]) > 0.05)
    assert outside[-1] - 20 < 110
    before = run.states[0][:21, 2]
    assert np.abs(before).max() < 1e-6  # nobody told it


@pytest.mark.parametrize("disturbed", [None, ["phi", "phidot", "psi", "psidot"]])
def test_a_constant_torque_that_nobody_knows_leaves_no_steady_error(disturbed, mechanical):
    torque = 0.1 * np.array([LIMITS[0][1], LIMITS[1][1]])
    controller = mpc(mechanical, observer=tras.Observer(mechanical, disturbed=disturbed))
    reference = np.tile([0.3, 0.8], (601, 1))
    run = tras.simulate_closed_loop(reference, 0.01, controllers=controller, disturbances=torque)
    assert np.abs(run.states[0][-50:, [0, 2]] - [0.3, 0.8]).max() < 1e-4
    if not disturbed:
        assert np.allclose(controller.disturbance, torque, atol=1e-4)
    blind = tras.simulate_closed_loop(
        reference, 0.01, controllers=mpc(mechanical, offset_free=False), disturbances=torque
    )
    assert np.abs(blind.states[0][-50:, [0, 2]] - [0.3, 0.8]).max() > 1e-3


def test_it_flies_by_the_angles_alone(mechanical):
    reference = multisine(3)
    sees = tras.Observer(mechanical, measured=["phi", "psi"])
    angles = rms(reference, controllers=mpc(mechanical, observer=sees), preview=True)
    everything = rms(reference, controllers=mpc(mechanical), preview=True)
    assert np.all(angles < 1.5 * everything)


def test_torques_from_outside_act_and_are_not_recorded(parameters):
    reference = np.tile([0.2, 0.5], (200, 1))
    torques = 0.01 * np.random.default_rng(0).normal(size=(200, 2))
    for disturbances in (torques, [0.01, -0.005]):
        run = tras.simulate_closed_loop(reference, 0.01, disturbances=disturbances)
        acting = run.inputs[0][:, 2:] + disturbances
        assert np.allclose(tras.simulate_plant(run.states[0][0], acting, 0.01, parameters), run.states[0], atol=1e-12)
    assert np.ptp(run.states[0][:, 2]) > 1e-3


def test_noise_reaches_the_controller_and_not_the_recording():
    read = []

    def controller(x, reference):
        read.append(x)
        return [0.05, 0.0]

    sizes = np.array([0.01, 0.02, 0.03, 0.04])
    runs = [
        tras.simulate_closed_loop(np.zeros((2000, 2)), 0.01, controllers=controller, noise=noise, seed=4)
        for noise in (sizes, None)
    ]
    assert np.array_equal(runs[0].states[0], runs[1].states[0])
    errors = np.array(read[:2000]) - np.array(read[2000:])
    assert np.allclose(errors.std(axis=0), sizes, rtol=0.1) and np.abs(errors.mean(axis=0)).max() < 0.005
    assert runs[0].attributes["measurement_noise"] == sizes.tolist() and runs[0].attributes["noise_seed"] == 4
    again = tras.simulate_closed_loop(np.zeros((50, 2)), 0.01, noise=0.01, seed=4)
    assert np.array_equal(
        again.states[0], tras.simulate_closed_loop(np.zeros((50, 2)), 0.01, noise=0.01, seed=4).states[0]
    )


def test_many_runs_are_those_of_a_loop_by_itself(true_plant):
    """Each run begins anew, with its own reference, rig, start, disturbance; the controller is reset in between."""
    rigs = [tras.PlantParameters(K_psi=k) for k in (0.002, 0.003, 0.005)]
    references = np.stack([np.tile([0.1 * k, 0.3], (40, 1)) for k in range(3)])
    starts = np.array([[0.1, 0, 0.2, 0], [0, 0, 0, 0.1], [0.2, 0, 0, 0]])
    torques = 0.01 * np.random.default_rng(0).normal(size=(3, 40, 2))
    controller = mpc(true_plant, horizon=10)
    together = tras.simulate_closed_loops(references, 0.01, rigs, controllers=controller, x0=starts,
                                          disturbances=torques, preview=True)  # fmt: skip
    for k in range(3):
        alone = tras.simulate_closed_loop(references[k], 0.01, rigs[k], controllers=controller, x0=starts[k],
                                          disturbances=torques[k], preview=True)  # fmt: skip
        assert np.array_equal(alone.states[0], together.states[k])
    assert together.attributes["plant_K_psi"] == [0.002, 0.003, 0.005] and together.attributes["preview"] is True
    assert together.attributes["controller"].startswith("MPC(")


def test_each_run_may_have_a_controller_of_its_own():
    """They remember and cannot be reset: in a run of its own each does what it does in the sequence."""

    class Winds:
        def __init__(self, gain):
            self.gain, self.sum = gain, np.zeros(2)

        def __call__(self, x, reference):
            self.sum = self.sum + self.gain * (reference - x[[0, 2]])
            return self.sum

        def __repr__(self):
            return f"Winds({self.gain})"

    references, gains = np.stack([np.tile([0.1 * k, 0.3], (40, 1)) for k in range(3)]), (1e-3, 2e-3, 3e-3)
    together = tras.simulate_closed_loops(references, 0.01, controllers=[Winds(gain) for gain in gains])
    for k, gain in enumerate(gains):
        alone = tras.simulate_closed_loop(references[k], 0.01, controllers=Winds(gain))
        assert np.array_equal(alone.states[0], together.states[k])
    assert together.attributes["controller"] == ["Winds(0.001)", "Winds(0.002)", "Winds(0.003)"]
    for wrong in ([Winds(1e-3)] * 2, [Winds(1e-3), Winds(1e-3), tras.PID(1.0, 0.0, 0.0, (-1.0, 1.0))]):
        with pytest.raises(ValueError, match="controllers holds 2 callables for 3 runs; give one for all, or one per"):
            tras.simulate_closed_loops(references, 0.01, controllers=wrong)


def test_the_batch_of_pids_takes_noise_and_torques_too():
    """Forty runs at once, against one by itself."""
    references = np.tile([0.2, 0.5], (40, 60, 1))
    torques = 0.01 * np.random.default_rng(0).normal(size=(40, 60, 2))
    together = tras.simulate_closed_loops(references, 0.01, disturbances=torques, noise=0.01)
    few = tras.simulate_closed_loops(references[:5], 0.01, disturbances=torques[:5], noise=0.01)
    assert np.allclose(together.states[:5], few.states, atol=1e-8)  # the noise of a run is its own


def test_a_rig_with_motors_is_flown_by_its_commands():
    rig = tras.RotorParameters.maker()
    model = plant(rig, 0.05)
    observer = tras.Observer(model, disturbed=rig.state_names)  # the torques are none of the commands
    controller = tras.MPC(model, horizon=30, weights=WEIGHTS, rate_weights=0.01, observer=observer)
    reference = np.tile([0.1, 0.2], (161, 1))
    run = tras.simulate_closed_loop(reference, 0.05, rig, controllers=controller, disturbances=[0.002, 0.001])
    assert run.state_names[4:] == ("omega_m", "omega_t") and run.input_names[2:] == ("u_m", "u_t")
    assert np.abs(run.inputs[0][:, 2:]).max() <= 1
    assert np.abs(run.states[0][-10:, [0, 2]] - [0.1, 0.2]).max() < 0.01


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"noise": [0.1, 0.2]}, r"noise has shape \(2,\); give one standard deviation, or 4"),
        ({"noise": -0.1}, "noise is -0.1; give standard deviations, 0 or more"),
        ({"noise": np.nan}, "noise holds NaN or infinity"),
        ({"seed": "x"}, "seed is 'x'; give a numpy.random.Generator or a seed"),
        ({"disturbances": np.zeros((7, 2))}, r"disturbances has shape \(7, 2\); give \(2,\), \(10, 2\)"),
        ({"disturbances": [np.inf, 0]}, "disturbances holds NaN or infinity; give finite torques"),
        ({"controllers": lambda x, r: [1.0]}, r"controllers returned \[1.0\] at sample 0; it must return two finite"),
        ({"controllers": lambda x, r: [np.nan, 0]}, r"controllers returned \[nan, 0.0\] at sample 0"),
        ({"parameters": tras.RotorParameters.maker()}, "the rig has motor commands; give a controller of these"),
        ({"parameters": tras.RotorParameters.maker(), "x0": [0, 0, 0, 0]}, "give six finite numbers phi, .* omega_t"),
    ],
)
def test_mistakes_are_named(options, words):
    with pytest.raises(ValueError, match=words):
        tras.simulate_closed_loop(np.zeros((10, 2)), 0.01, **options)
