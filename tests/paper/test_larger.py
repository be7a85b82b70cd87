"""The larger rigs: the study at a small size, its rules, and the estimate of a gust against a known one."""

import numpy as np
import pandas as pd
import pytest

import tras
from tras.paper import larger

SMALL = larger.Study(
    duration=60.0, test_duration=20.0, effect_duration=40.0, trajectory=2.0, window=2.0, monomials=(1, 2),
    gaussians=(10,), test_signals=(0.1,), test_seeds=(2,),
)  # fmt: skip


def test_a_recording_is_the_seeds_and_the_conditions():
    rig = tras.RotorParameters.maker()
    log, again = (larger.record(SMALL, rig) for _ in range(2))
    assert np.array_equal(log.states, again.states) and log.states.shape == (1, 5501, 6)
    test, windy = larger.record(SMALL, rig, test=True), larger.record(SMALL, rig, gust=True)
    assert test.states.shape == (1, 1501, 6) and windy.input_names[2:4] == ("gust_phi", "gust_psi")
    assert np.array_equal(log.inputs[0][:, 2:], windy.inputs[0][:, 4:])  # the same reference
    silent = larger.record(SMALL, rig, amplitude=0.0)
    assert np.abs(silent.inputs[0] - log.inputs[0])[:, :2].max() > 0.05


@pytest.mark.slow
@pytest.mark.parametrize("part, options", [("accuracy", {"rig": "Rotondo et al."}), ("effects", {"condition": "sag"})])
def test_every_model_of_a_part_has_both_angles(part, options, monkeypatch):
    monkeypatch.setitem(larger.EFFECTS, "sag", {"sag": 0.2})
    errors = pd.DataFrame(larger._PARTS[part](SMALL, **options)["errors"])
    counts = errors.groupby(["part", "condition", "model"]).size()
    assert (counts == 2).all() and len(counts) == (2 + 1 + 1 + 2 if part == "accuracy" else 3)
    assert set(errors["angle"]) == {"yaw", "pitch"} and (errors["windows"] == 7).all()
    own = errors[errors["model"] == larger.OWN]
    others = errors[(errors["part"] == part) & (errors["model"] != larger.OWN)]
    assert own["N"].max() <= 200
    if part == "accuracy":
        assert own["nrmse"].max() < others["nrmse"].min()


def test_a_gust_is_estimated_from_what_the_model_misses():
    rig = tras.RotorParameters.maker()
    train, test = (larger.record(SMALL, rig, test=is_test, gust=True) for is_test in (False, True))
    both = larger.COMMAND_NAMES + larger.GUST_NAMES
    model = tras.KoopmanModel(larger.Mechanical(actuators=[4, 5]), strength=0).fit(train.select(inputs=both).cut(201))
    u = test.select(inputs=both).inputs[0]
    estimate = larger.estimated_gust(model, test.states[0], u)
    assert np.sqrt(np.mean((estimate - u[:-1, 2:]) ** 2)) < 0.1 * np.sqrt(np.mean(u[:, 2:] ** 2))
    # What acts is found, not what is recorded: the same commands, another torque.
    other = u[500:600].copy()
    other[:, 2:] = [0.004, 0.0]
    states = tras.simulate_rotors(test.states[0][500], other[:, :2], 0.01, rig, gusts=other[:, 2:])
    assert np.allclose(larger.estimated_gust(model, states, u[500:600]), [0.004, 0.0], atol=0.0005)


def tables(own=0.02, effect=0.5, share=0.01, measured=0.03, lost=0):
    rows = [
        {"part": part, "rig": rig, "condition": condition, "model": model, "N": 196, "angle": angle, "nrmse": nrmse,
         "windows": 20, "diverged": lost}
        for part, rig, condition, model, nrmse in [
            ("accuracy", "maker", "", larger.OWN, own), ("accuracy", "Rotondo et al.", "", larger.OWN, own),
            ("accuracy", "maker", "", "monomials, degree 3", 0.5), ("effects", "maker", "none", larger.OWN, 0.1),
            ("effects", "maker", "cable", larger.OWN, effect), ("effects", "maker", "sag", larger.OWN, 0.2),
            ("gust", "maker", "not measured", larger.OWN, 9.0), ("gust", "maker", "measured", larger.OWN, measured),
        ]
        for angle in ("yaw", "pitch")
    ]  # fmt: skip
    gusts = [{"angle": angle, "rms": 0.005, "error": 0.005 * share, "share": share} for angle in ("yaw", "pitch")]
    return {"errors": pd.DataFrame(rows), "gusts": pd.DataFrame(gusts)}


@pytest.mark.parametrize(
    "changed, verdicts",
    [
        ({}, [larger.SHOWN] * 3),
        ({"own": 0.06}, [larger.NOT_SHOWN, larger.SHOWN, larger.SHOWN]),
        ({"lost": 1}, [larger.IN_PART, larger.SHOWN, larger.SHOWN]),
        ({"effect": 3.0}, [larger.SHOWN, larger.IN_PART, larger.SHOWN]),
        ({"share": 0.2}, [larger.SHOWN, larger.SHOWN, larger.IN_PART]),
        ({"share": 0.2, "measured": 0.05}, [larger.SHOWN, larger.SHOWN, larger.NOT_SHOWN]),
    ],
)
def test_the_rules_of_the_ledger(changed, verdicts):
    ledger = larger.future_work(tables(**changed))
    assert list(ledger["verdict"]) == verdicts and list(ledger["claim"]) == ["F1", "F2", "F3"]
    assert tuple(ledger.columns) == larger.COLUMNS and not ledger["evidence"].str.contains("nan").any()


@pytest.mark.slow
def test_the_whole_study_runs_twice_to_the_same_numbers(tmp_path):
    first = larger.run(SMALL, tmp_path, processes=1)
    again = larger.run(SMALL, tmp_path, processes=1)
    for name, table in first.items():
        pd.testing.assert_frame_equal(table, again[name])
    assert set(first["errors"]["part"]) == {"accuracy", "states", "effects", "gust", "feedback"}
    assert len(larger.future_work(first)) == 3
