"""The closed loops of 11_control, small: what acts on the rig is what the case says, and the scores are those of it."""

import itertools

import numpy as np
import pandas as pd
import pytest

import tras
from tras.paper import control, plans
from tras.twin_rotor.plant import LUMPED

SMALL = control.Study(
    duration=2.0, paper_duration=1.0, skip=0.5, horizon=10, fast_frequencies=(3.5, 3.5), eight_period=2.0,
    gust_levels=(10.0,), slower=(10.0,), changed=("J_phi",), rigs=2, rig_duration=1.0,
    controllers=("PID", "LQR, mechanical", "MPC, linear", control.OURS, control.BOUND),
)  # fmt: skip
SPREAD = np.array([2.4, 0.4, 6.8, 3.7])


@pytest.fixture(scope="module")
def models(experiment):
    train = experiment.select(inputs=["u_phi", "u_psi"])
    dictionaries = {"linear": tras.Monomials(1), "mechanical": tras.Mechanical(4)}
    return {name: tras.KoopmanModel(dictionary).fit(train) for name, dictionary in dictionaries.items()}


@pytest.fixture(scope="module")
def paths(experiment):
    return control.references(SMALL, experiment.inputs[0][:, :2])


def case(name, condition="calm", *, reference="steps", preview=False, level=0.0, changed=""):
    about = {"reference": reference, "condition": condition, "level": level, "changed": changed}
    return {"controller": name, "preview": preview, **about}


# --- what is run ------------------------------------------------------------------------------------------------------


def test_in_calm_air_everybody_meets_every_reference_and_only_who_plans_has_a_preview():
    points = pd.DataFrame(control.points(control.Study()))
    calm = points[points["condition"] == "calm"]
    counts = calm.groupby(["controller", "preview"])["reference"].agg(["nunique", "size"])
    assert (counts == len(control.REFERENCES)).all(axis=None)
    seen = calm.groupby("controller")["preview"].agg(set)
    for name in control.CONTROLLERS:
        assert seen[name] == ({True, False} if name.startswith("MPC") else {False})
    assert not points.duplicated().any()
    single = points[(points["condition"] == "parameter") & (points["controller"] == control.OURS)]
    assert set(zip(single["changed"], single["level"])) == set(itertools.product(LUMPED, (-20.0, 20.0)))


def test_a_small_study_leaves_out_what_it_does_not_name():
    points = pd.DataFrame(control.points(SMALL))
    assert set(points["controller"]) == set(SMALL.controllers)
    assert set(points.loc[points["condition"] == "slower", "controller"]) == {"MPC, linear"}


@pytest.mark.parametrize(
    "options, words",
    [
        ({"controllers": ("PDI",)}, "controllers holds 'PDI'; choose among PID, LQR, mechanical"),
        ({"changed": ("J_x",)}, "changed holds 'J_x'; choose among J, J_psi0"),
        ({"skip": 9.0}, "skip is 9.0 s; give more than a sample and at most half of each run"),
    ],
)
def test_mistakes_are_named(options, words):
    with pytest.raises(ValueError, match=words):
        control.Study(**options)


def test_references_go_on_for_a_horizon(paths, experiment):
    assert set(paths) == set(control.REFERENCES)
    samples = {"paper": 101, "fast": 201, "steps": 201, "eight": 201}
    assert {name: len(path) - SMALL.horizon for name, path in paths.items()} == samples
    assert np.array_equal(paths["paper"], experiment.inputs[0][:111, :2])
    assert np.allclose(paths["fast"][200:], paths["fast"][: SMALL.horizon + 1])
    assert not paths["steps"][:100].any() and (paths["steps"][100:] == SMALL.step).all()
    assert np.allclose(np.abs(paths["eight"]).max(axis=0), SMALL.eight, rtol=1e-3)


def test_rigs_are_drawn_within_the_change_and_the_same_each_time():
    rigs = [control.a_rig(SMALL, case("PID", "rig", level=20.0, changed=str(i))) for i in range(20)]
    usual = tras.PlantParameters()
    factors = np.array([[getattr(rig, name) / getattr(usual, name) for name in LUMPED] for rig in rigs])
    assert factors.min() >= 0.8 and factors.max() <= 1.2 and (np.ptp(factors, axis=0) > 0.2).all()
    assert rigs[3] == control.a_rig(SMALL, case("PID", "rig", level=20.0, changed="3"))
    single = control.a_rig(SMALL, case("PID", "parameter", level=-20.0, changed="J_phi"))
    assert single == tras.PlantParameters(
        **{name: getattr(usual, name) for name in LUMPED} | {"J_phi": usual.J_phi * 0.8}
    )
    assert control.a_rig(SMALL, case("PID")) == usual


# --- what acts --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("condition", ["square gusts", "Dryden gusts", "constant torque"])
def test_torques_from_outside_act_beside_those_recorded(models, paths, condition):
    """The plant, simulated under the recorded torques and those that the condition says, moves as it did."""
    log, _ = control.loop(SMALL, models, paths["steps"], SPREAD, case("PID", condition, level=10.0))
    alone = tras.simulate_plant(log.states[0][0], log.inputs[0][:, 2:], log.dt, tras.PlantParameters())
    assert np.abs(alone - log.states[0]).max() > 1e-3
    t = log.dt * np.arange(len(alone))
    halves = np.array([0.351, 0.381]) / 2
    acting = {
        "square gusts": np.where(t % 4.0 < 2.0 - 1e-9, -0.1, 0.1)[:, None] * halves,
        "constant torque": np.tile(0.1 * halves, (len(t), 1)),
        "Dryden gusts": tras.gusts(t[-1], log.dt, tuple(0.1 * halves), SMALL.gust_time, SMALL.gust_seed),
    }[condition]
    again = tras.simulate_plant(log.states[0][0], log.inputs[0][:, 2:] + acting, log.dt, tras.PlantParameters())
    assert np.allclose(again, log.states[0], rtol=1e-9, atol=1e-12)


def test_with_angles_alone_the_controller_has_no_rates(models):
    noise = 0.01 * SPREAD
    few = control.controller(SMALL, models, control.OURS, condition="noise, angles only", noise=noise)
    assert few.observer.measured == ("phi", "psi") and np.allclose(few.observer.noise, noise[[0, 2]])
    everything = control.controller(SMALL, models, control.OURS, condition="noise", noise=noise)
    assert everything.observer.measured == ("phi", "phidot", "psi", "psidot")
    assert np.allclose(everything.observer.noise, noise)
    assert control.controller(SMALL, models, control.OURS, condition="no disturbance model").observer is None


def test_controllers_of_one_kind_differ_in_their_model_alone(models):
    ours, bound = (control.controller(SMALL, models, name) for name in (control.OURS, control.BOUND))
    for name in ("horizon", "followed"):
        assert getattr(ours, name) == getattr(bound, name)
    for name in ("weights", "rate_weights", "limits"):
        assert np.allclose(getattr(ours, name), getattr(bound, name), rtol=1e-12)
    slow = control.controller(SMALL, models, "MPC, linear", slower=10.0)
    assert np.allclose(slow.rate_weights, 10 * ours.rate_weights)


# --- scores -----------------------------------------------------------------------------------------------------------


def a_log(errors, torques, reference):
    states = np.zeros((len(reference), 4))
    states[:, [0, 2]] = reference + errors
    return tras.Recording(
        [states], [torques], 0.01, state_names=["phi", "phidot", "psi", "psidot"], input_names=["u_phi", "u_psi"]
    )


def test_scores_of_a_recording_that_is_known(paths):
    """Yaw is off by the whole step for half a second, then by 0.01 rad; pitch is always right."""
    reference = paths["steps"]
    errors, torques = np.zeros((len(reference), 2)), np.zeros((len(reference), 2))
    errors[100:150, 1] = -1.0
    errors[150:, 1] = 0.01
    torques[3, 1], torques[5, 0] = 0.15, 0.207
    row = control.score(SMALL, a_log(errors, torques, reference), reference, "steps")
    counted = errors[50 : -SMALL.horizon, 1]
    assert row["yaw"] == pytest.approx(np.sqrt((counted**2).mean())) and row["pitch"] == 0
    assert row["settling_yaw"] == pytest.approx(0.5) and row["settling_pitch"] == 0
    assert row["yaw_whole"] == pytest.approx(np.sqrt((errors[: -SMALL.horizon, 1] ** 2).mean()))
    assert row["steady"] == 1.0  # the last second of this short run
    assert row["outside"] == pytest.approx(0.01)
    assert row["diverged"] is False
    errors[-SMALL.horizon :] = 99.0  # behind the run: not counted
    assert control.score(SMALL, a_log(errors, torques, reference), reference, "steps")["yaw"] == row["yaw"]
    errors[120, 0] = 3.1
    assert control.score(SMALL, a_log(errors, torques, reference), reference, "eight")["diverged"] is True


def test_an_angle_that_never_settles_has_no_settling_time(paths):
    reference = paths["steps"]
    row = control.score(SMALL, a_log(0.2 + 0 * reference, 0 * reference, reference), reference, "steps")
    assert np.isnan(row["settling_yaw"]) and np.isnan(row["settling_pitch"])
    assert np.isnan(control.score(SMALL, a_log(0 * reference, 0 * reference, reference), reference, "fast")["steady"])


@pytest.mark.slow
def test_runs_that_a_rounding_unit_changes_are_in_no_file():
    names = ("MPC, cubic", "MPC, the paper's", "MPC, linear")
    runs = pd.DataFrame([case(n, reference=r, preview=p) for n in names for r in ("paper", "fast") for p in (0, 1)])
    rest = control.repeatable(runs.astype({"preview": bool}))
    assert list(runs.index.difference(rest.index)) == [0, 1, 2, 3, 4]
    flights = pd.DataFrame({"controller": names, "gust": 0.0})  # no reference, no preview
    assert list(control.repeatable(flights)["controller"]) == list(names[1:])


def test_a_good_model_flies_as_the_plant_does_and_the_study_repeats(models, paths, experiment, tmp_path):
    options = {"controllers": ("PID", control.OURS, control.BOUND), "rigs": 1, "changed": ()}
    study = control.Study(**{**vars(SMALL), **options})
    arguments = (study, models, {"models": "small"}, experiment.inputs[0][:, :2], SPREAD)
    runs = control.run(*arguments, tmp_path, processes=1)
    again = control.run(*arguments, tmp_path / "anew", processes=2)
    pd.testing.assert_frame_equal(runs, again, check_exact=True)
    assert list(runs[list(control.SCORES)]) == list(control.SCORES) and not runs["failures"].any()
    ratio = plans.ratios(runs)
    assert len(ratio) == 2 * len(control.REFERENCES) and (abs(ratio - 1) < 0.05).all(axis=None)
    assert runs["outside"].max() < 1e-9


def test_tracks_and_times_are_those_of_the_controllers(models, paths):
    study = control.Study(**{**vars(SMALL), "controllers": ("PID", "MPC, linear")})
    reference = paths["fast"][:40]
    tracks = control.tracks(study, models, reference, ("PID", "MPC, linear"))
    pid = tras.simulate_closed_loop(reference, 0.01)
    assert np.array_equal(tracks.loc[tracks["controller"] == "PID", "psi"], pid.states[0][:, 2])
    assert set(tracks["u_phi_high"]) == {0.207} and np.array_equal(tracks["phi_reference"][:40], reference[:, 0])
    times = control.solve_times(study, models, reference)
    assert set(times["controller"]) == {"MPC, linear"} and len(times) == 40 and (times["seconds"] > 0).all()
