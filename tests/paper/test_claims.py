"""Verdicts can go either way: each claim on tables that support it, contradict it, or support it under one reading."""

import itertools
import math

import numpy as np
import pandas as pd
import pytest
import test_plans

import tras
from tras import generator
from tras.paper import claims, effects, larger, pages, readings

SEEDS = [(1, 0, 2), (1, 0, 3), (2, 0, 2)]  # train_seed, draw, validation_seed


def grid(numbers, *, spread=0.02):
    """A table like that of 06_readings; ``numbers(reading)`` is (yaw, pitch) in percent, or None without a model."""
    rows, fixed = [], {"frequency_unit": "rad/s", "velocity_term": "corrected", "state": "four_states"}
    fixed |= {name: readings.choices(name)[0] for name in ("start", *readings.SINGLE)}
    names = [name for name in effects.OPTIONS if name not in fixed]
    for combination in itertools.product(*(readings.choices(name) for name in names)):
        reading = {**fixed, **dict(zip(names, combination))}
        values = numbers(reading)
        about = {**reading, "outcome": "model" if values else "no model: logarithm", "windows": 83, "diverged": 0}
        for seed, factor in zip(SEEDS, (1 - spread, 1.0, 1 + spread)):
            for angle, value in zip(("yaw", "pitch"), values or (math.nan, math.nan)):
                rows.append({**about, **dict(zip(effects.SEEDS, seed)), "angle": angle, "nrmse": value * factor})
    return pd.DataFrame(rows)


def around(number=(9.0, 9.0)):
    """A table like that of readings round the nearest, with other gains."""
    table = grid(lambda reading: number).assign(gains="half_frequency")
    return table[(table["dictionary"] == "linear") & (table["nrmse_range"] == "validation_set")]


def comparison():
    """A table like that of 07_comparison; smaller errors at another horizon and on the chirp, which must not count."""
    errors = {
        "reference": {"DMDc": 1.0, claims.OWN: 2.0, "N4SID": 3.0},
        "torque": {"DMDc": 4.0, claims.OWN: 2.0, "N4SID": 1.0, claims.BOUND: 0.01},
    }
    rows = []
    for source, methods in errors.items():
        for (method, error), horizon, recording, angle in itertools.product(
            methods.items(), (1.0, 6.0, 500.0), ("multisine 2", "multisine 3", "chirp"), ("yaw", "pitch")
        ):
            counts = horizon == 6.0 and recording != "chirp"
            lost = 1 if (method, source) == ("N4SID", "torque") and counts else 0
            about = {"method": method, "input": source, "recording": recording, "horizon": horizon, "angle": angle}
            rows.append({**about, "nrmse": error if counts else 1e-3, "windows": 4, "diverged": lost, "parameters": 28})
    return pd.DataFrame(rows)


def metrics(enr=0.05, bfr=95.0, steps=None, diverged=0):
    """A table like that of 03_validation; ``steps`` is (enr, bfr) on the steps."""
    rows = []
    window, free = (
        {"kind": "window", "horizon": 6.0, "windows": 83},
        {"kind": "free run", "horizon": 500.0, "windows": 1},
    )
    for recording, kind in [("multisine 2", window), ("multisine 3", window), ("steps", window), ("multisine 2", free)]:
        values = dict(zip(("enr", "bfr"), steps if recording == "steps" and steps else (enr, bfr)))
        about = {"recording": recording, **kind, **values, "nrmse": 0.005, "diverged": diverged}
        for angle, source in itertools.product(("yaw", "pitch"), (("reference", "gaussian"), ("torque", "mechanical"))):
            rows.append({**about, "angle": angle, **dict(zip(("input", "model"), source))})
    return pd.DataFrame(rows)


# --- C1, C2 -----------------------------------------------------------------------------------------------------------


def by_default(reading):
    return (4.0, 5.6) if all(reading[n] == readings.choices(n)[0] for n in effects.OPTIONS) else (20.0, 30.0)


def with_torque(reading):
    return (4.1, 5.5) if reading["input"] == "torque" else (1.0, 0.4)


@pytest.mark.parametrize(
    "numbers, verdict, reading",
    [
        (by_default, claims.REPRODUCED, "default"),
        (with_torque, claims.NAMED, "input torque"),
        (lambda r: (5.6, 4.05) if r["dictionary"] == "monomials3" else (9, 9), claims.NAMED, "dictionary monomials3"),
        (lambda r: (1.0, 0.4), claims.NOT, ""),
        # Each number under another reading: no model has both.
        (lambda r: {"linear": (4.06, 0.4), "monomials2": (1.0, 5.59)}.get(r["dictionary"], (1.0, 0.4)), claims.NOT, ""),
    ],
)
def test_the_two_numbers(numbers, verdict, reading):
    yaw, pitch = (claims.nrmse(grid(numbers), around(), angle) for angle in ("yaw", "pitch"))
    assert yaw["verdict"] == pitch["verdict"] == verdict
    assert yaw["reading"].startswith(reading) and (yaw["reading"] == "") == (reading == "")


def test_the_count_of_readings_is_explained():
    """Every combination is complete here; of those of a free run the second range repeats the first."""
    table = grid(with_torque)
    tried = len(effects.summary(table))
    once = len(effects.nearest(table)) // 2
    evidence = claims.nrmse(table, around(), "yaw")["evidence"]
    assert f"of {2 * once} readings meet" in evidence and once < tried and "; 0 with other gains" in evidence
    base = {name: readings.choices(name)[0] for name in ("input", "dictionary", "horizon", "nrmse_range")}
    of_default = grid(with_torque).assign(gains="half_frequency").merge(pd.DataFrame([base]))
    evidence = claims.nrmse(table, pd.concat([around(), of_default]), "yaw")["evidence"]
    assert f"of {2 * (once + 1)} readings meet" in evidence and "; 1 with other gains" in evidence
    assert (
        f"({tried} combinations of the options, of which {tried} have a number for every seed, {once} when" in evidence
    )


def scattered(reading):
    """Readings all over the plane, so that any pair of numbers has one near it; none with one departure meets both."""
    default = readings.Readings().model_dump()
    departures = [name for name in effects.OPTIONS if name in reading and reading[name] != default[name]]
    if len(departures) < 2:
        return 1.0, 1.0
    places = list(itertools.product(readings.choices("dictionary"), readings.choices("horizon"), ("a", "b")))
    place = places.index((reading["dictionary"], reading["horizon"], "ab"[reading["nrmse_range"] == "trajectory"]))
    return 4.4 * 1.2 ** (place % 6 - 3), 6.0 * 1.2 ** (place // 6 - 3)


def test_a_reading_that_random_numbers_meet_as_well_does_not_count():
    row = claims.nrmse(grid(scattered), around(), "yaw")
    assert row["verdict"] == claims.NOT and row["reading"] == ""
    assert "% of random pairs have a reading as near that departs as little" in row["evidence"]


def test_a_refinement_round_the_paper_numbers_is_told_and_does_not_count():
    """Readings that were placed beside the paper's numbers meet them; random numbers had no such help."""
    row = claims.nrmse(grid(lambda r: (1.0, 1.0)), around((4.0589, 5.5889)), "yaw")
    assert row["verdict"] == claims.NOT and "other gains or plants round the nearest come to 0.00" in row["evidence"]


def test_one_number_may_be_met_without_the_other():
    table = grid(lambda r: (4.0, 20.0))
    assert claims.nrmse(table, around(), "yaw")["verdict"] == claims.REPRODUCED
    assert claims.nrmse(table, around(), "pitch")["verdict"] == claims.NOT


@pytest.mark.parametrize("factor, met", [(1.09, True), (1.12, False), (0.92, True), (0.89, False)])
def test_a_number_is_met_within_the_range_and_a_tenth(factor, met):
    yaw, pitch = effects.target()
    row = claims.nrmse(grid(lambda r: (yaw * factor, pitch), spread=0), around(), "yaw")
    assert (row["verdict"] == claims.REPRODUCED) == met
    assert row["value"] == pytest.approx(yaw * factor) and row["low"] == row["high"] == row["value"]


def test_a_reading_that_loses_windows_meets_nothing():
    table = grid(with_torque)
    table.loc[table["input"] == "torque", "diverged"] = 1
    assert claims.nrmse(table, around(), "yaw")["verdict"] == claims.NOT


# --- C3, C4 -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name, table, verdict, value",
    [
        ("enr", metrics(enr=0.05), claims.REPRODUCED, 0.05),
        ("enr", metrics(enr=0.05, steps=(0.3, 70.0)), claims.PARTLY, 0.3),
        ("enr", metrics(enr=0.2), claims.NOT, 0.2),
        ("bfr", metrics(bfr=95), claims.REPRODUCED, 95),
        ("bfr", metrics(bfr=95, steps=(0.3, 70.0)), claims.PARTLY, 70),
        ("bfr", metrics(bfr=80), claims.NOT, 80),
    ],
)
def test_low_and_high_across_conditions(name, table, verdict, value):
    row = claims.across(table, name)
    assert row["verdict"] == verdict and row["value"] == value


def test_a_number_that_was_lost_is_not_low():
    table = metrics()
    table.loc[table["recording"] == "steps", "enr"] = np.nan
    assert claims.across(table, "enr")["verdict"] == claims.PARTLY


# --- C5 ---------------------------------------------------------------------------------------------------------------


def ratio_to_linear(ratio):
    """Every dictionary but the linear one has ``ratio(reading)`` times its error."""
    return grid(lambda r: (1.0, 1.0) if r["dictionary"] == "linear" else ratio(r))


@pytest.mark.parametrize(
    "ratio, verdict",
    [
        (lambda r: (0.5, 0.6), claims.REPRODUCED),
        (lambda r: (0.5, 0.6) if r["input"] == "torque" else (1.0, 1.0), claims.NAMED),
        (lambda r: (0.99, 0.5), claims.NOT),  # one angle is not enough
        # Another dictionary than the paper's, found by a search, is not the paper's.
        (lambda r: (0.5, 0.6) if r["dictionary"] == "monomials3" else (1.0, 1.0), claims.NOT),
        (lambda r: None if r["dictionary"] == "gaussian" else (1.2, 1.2), claims.NOT),
    ],
)
def test_superior_means_both_angles(ratio, verdict):
    row = claims.against_linear(ratio_to_linear(ratio), comparison())
    assert row["verdict"] == verdict
    if verdict == claims.REPRODUCED:
        assert row["value"] == pytest.approx(0.6)


def test_a_superior_dictionary_that_is_not_the_papers_is_told_and_does_not_count():
    only = ratio_to_linear(lambda r: (0.5, 0.6) if r["dictionary"] == "monomials3" else (1.0, 1.0))
    row = claims.against_linear(only, comparison())
    assert "found by the search and so no evidence for the paper's" in row["evidence"] and row["reading"] == ""
    assert "with the paper's dictionary 0 are superior" in row["evidence"]


def test_superior_means_every_seed():
    table = ratio_to_linear(lambda r: (0.5, 0.5))
    one = (table["train_seed"] == 2) & (table["dictionary"] != "linear")
    table.loc[one, "nrmse"] = 1.0
    assert claims.against_linear(table, comparison())["verdict"] == claims.NOT


# --- C6 to C9 ---------------------------------------------------------------------------------------------------------


def test_the_comparison_is_not_in_the_paper_but_ours_is_told():
    row = claims.other_methods(comparison())
    assert row["verdict"] == claims.UNCHECKABLE and math.isnan(row["value"])
    assert "reference: the best is DMDc (1 / 1), the paper's dictionary is 2 of 3 (2 / 2)" in row["evidence"]
    # The other one there loses windows.
    assert "torque: the best is Koopman, the paper's (2 / 2), the paper's dictionary is 1 of 3" in row["evidence"]


def test_linear_methods_stand_beside():
    row = claims.against_linear(ratio_to_linear(lambda r: (0.5, 0.6)), comparison())
    assert "reference: Koopman, the paper's 2 / 2, DMDc 1 / 1, N4SID 3 / 3; " in row["evidence"]
    assert "; torque: Koopman, the paper's 2 / 2, DMDc 4 / 4, N4SID 1 / 1" in row["evidence"]


def test_a_model_without_numbers_has_no_place():
    table = comparison()
    table.loc[table["method"] == claims.OWN, ["nrmse", "diverged"]] = [math.nan, 4]
    assert "without a place among 3 (– / –)" in claims.other_methods(table)["evidence"]


@pytest.mark.parametrize("diverged, verdict", [(0, claims.REPRODUCED), (1, claims.NOT)])
def test_starts_are_counted(diverged, verdict):
    row = claims.starts(metrics(diverged=diverged))
    assert row["verdict"] == verdict and "249 windows" in row["evidence"]
    assert row["value"] == pytest.approx(3 * diverged / (3 * 83))


def length(clean, noisy, dependent=0.0):
    """Shares without a logarithm on (short, long) stretches; ``dependent`` of them because K is singular."""
    rows = []
    for noise, (short, long) in ((0.0, clean), (1.0, noisy)):
        for ratio, share in ((1.5, short), (2.0, short), (200.0, long)):
            shares = {"failed": share, "no_logarithm": (1 - dependent) * share, "dependent": dependent * share}
            rows.append({"fit": "plain", "dictionary": "linear", "noise": noise, "ratio": ratio, **shares})
    return pd.DataFrame(rows)


@pytest.mark.parametrize("dependent", [0.0, 1.0])
@pytest.mark.parametrize(
    "clean, noisy, verdict",
    [
        ((0.5, 0.0), (0.9, 0.1), claims.REPRODUCED),
        ((0.0, 0.0), (0.9, 0.1), claims.NAMED),
        ((0.0, 0.0), (0.9, 0.8), claims.NOT),  # more data do not mend it
        ((0.0, 0.0), (0.0, 0.0), claims.NOT),  # it never fails
    ],
)
def test_the_logarithm_and_the_data(clean, noisy, verdict, dependent):
    """A singular K counts by the present rule alone: where the rules differ the claim holds in part, and both stand."""
    row = claims.few_data(length(clean, noisy, dependent))
    differ = dependent == 1.0 and verdict != claims.NOT
    assert row["verdict"] == (claims.PARTLY if differ else verdict)
    assert ("1 %" in row["reading"]) == (row["verdict"] == claims.NAMED)
    first = claims.NOT if dependent else verdict
    assert f"counts logarithms alone: {first}; " in row["evidence"] and claims.CHANGED in row["evidence"]
    assert row["evidence"].endswith(f"to count a singular K too: {verdict}")


def test_a_basis_that_fits_counts_when_it_is_ten_times_better():
    better = claims.cost(grid(lambda r: (1.0, 1.0)), metrics())
    assert better["verdict"] == claims.REPRODUCED and "165" in better["evidence"]
    assert better["value"] == pytest.approx(200)
    assert claims.cost(grid(lambda r: (0.04, 1.0)), metrics())["verdict"] == claims.NOT


# --- C10 --------------------------------------------------------------------------------------------------------------


class Known:
    def __init__(self, plant, sign=1.0):
        self.plant, self.sign = plant, sign

    def vector_field(self, x, u):
        return tras.vector_field(x, self.sign * u, self.plant)


def loops():
    """Closed loops of 11_control, as far as C10 tells of them."""
    rows = [("PID", False, 0.5, 0.3), ("MPC, the paper's", True, 0.06, 0.05), ("MPC, the paper's", False, 0.2, 0.2)]
    rows = [dict(zip(("controller", "preview", "yaw", "pitch"), row)) for row in rows]
    return pd.DataFrame([{"reference": "fast", "condition": "calm", **row} for row in rows])


def test_the_evidence_tells_of_the_closed_loops_with_preview():
    evidence = claims.control({"exact": Known(tras.PlantParameters())}, loops())["evidence"]
    assert evidence.endswith("yaw / pitch in rad: MPC, the paper's 0.06 / 0.05, PID 0.5 / 0.3")


def test_feedback_from_a_good_model_works_and_from_a_wrong_one_does_not():
    plant = tras.PlantParameters()
    good = claims.control({"exact": Known(plant)}, loops())
    assert good["verdict"] == claims.REPRODUCED and good["value"] < -0.2
    assert claims.control({"torques the wrong way": Known(plant, -1.0)}, loops())["verdict"] == claims.NOT
    # Where a linear model's feedback is as fast, the ground is not the paper's alone; a wrong one is no rival.
    assert claims.control({"exact": Known(plant), "linear": Known(plant)}, loops())["verdict"] == claims.PARTLY
    assert (
        claims.control({"exact": Known(plant), "linear": Known(plant, -1.0)}, loops())["verdict"] == claims.REPRODUCED
    )


def larger_rigs(own=0.02, other=0.02, effect=0.5, share=0.01, measured=0.03, lost=0):
    """What 10_larger_models found, as far as F1 to F3 tell of it."""
    rows = [
        {"part": part, "rig": rig, "condition": condition, "model": model, "N": 199, "angle": angle, "nrmse": nrmse,
         "windows": 20, "diverged": lost}
        for part, rig, condition, model, nrmse in [
            ("accuracy", "maker", "", larger.OWN, own), ("accuracy", "Rotondo et al.", "", larger.OWN, other),
            ("accuracy", "maker", "", "monomials, degree 3", 0.5), ("effects", "maker", "none", larger.OWN, 0.1),
            ("effects", "maker", "cable", larger.OWN, effect), ("effects", "maker", "sag", larger.OWN, 0.2),
            ("gust", "maker", "not measured", larger.OWN, 9.0), ("gust", "maker", "measured", larger.OWN, measured),
        ]
        for angle in ("yaw", "pitch")
    ]  # fmt: skip
    gusts = [{"angle": angle, "rms": 0.005, "error": 0.005 * share, "share": share} for angle in ("yaw", "pitch")]
    return {"larger": pd.DataFrame(rows), "gusts": pd.DataFrame(gusts)}


@pytest.mark.parametrize(
    "changed, verdicts, reading",
    [
        ({}, (claims.SHOWN,) * 3, ""),
        ({"own": 0.06}, (claims.SHOWN_IN_PART, claims.SHOWN, claims.SHOWN), "on one of two rigs, Rotondo et al."),
        ({"own": 0.06, "other": 0.06}, (claims.NOT_SHOWN, claims.SHOWN, claims.SHOWN), ""),
        ({"lost": 1}, (claims.NOT_SHOWN, claims.SHOWN, claims.SHOWN), ""),
        ({"effect": 3.0}, (claims.SHOWN, claims.SHOWN_IN_PART, claims.SHOWN), "below 1 % with sag"),
        ({"share": 0.2}, (claims.SHOWN, claims.SHOWN, claims.SHOWN_IN_PART), "as a measured input"),
        ({"measured": 0.05}, (claims.SHOWN, claims.SHOWN, claims.SHOWN_IN_PART), "estimated"),
        ({"share": 0.2, "measured": 0.05}, (claims.SHOWN, claims.SHOWN, claims.NOT_SHOWN), ""),
    ],
)
def test_future_work_is_shown_as_far_as_its_limits_are_met(changed, verdicts, reading):
    tables = larger_rigs(**changed)
    errors, gusts = tables["larger"], tables["gusts"]
    rows = [claims.higher_dimensional(errors), claims.non_polynomial(errors), claims.external_factors(errors, gusts)]
    assert tuple(row["verdict"] for row in rows) == verdicts
    assert "".join(row["reading"] for row in rows) == reading
    assert not any("nan" in row["evidence"] for row in rows)


def test_the_linearisation_is_the_plants():
    plant = tras.PlantParameters()
    x, u = np.array([0.3, 0.5, -0.2, 0.4]), np.array([0.01, -0.02])
    for slopes, exact in zip(claims._linearised(Known(plant), x, u), tras.jacobian(x, u, plant)):
        assert np.allclose(slopes, exact, rtol=1e-6, atol=1e-6)


# --- the table --------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def judged():
    tables = {"comparison": comparison(), "readings": grid(with_torque), "around": around(), "metrics": metrics()}
    tables |= {"length": length((0.0, 0.0), (0.9, 0.1)), "control": test_plans.runs(), "motors": test_plans.flights()}
    tables |= larger_rigs()
    return claims.evaluate(tables, {"exact": Known(tras.PlantParameters())})


def test_all_ten_have_a_verdict_and_evidence(judged):
    assert list(judged["claim"]) == [*(f"C{i}" for i in range(1, 11)), *(f"F{i}" for i in range(1, 5))]
    assert list(judged) == list(claims.COLUMNS)
    assert set(judged["verdict"][:10]) <= set(claims.VERDICTS) and set(judged["verdict"][10:]) <= set(claims.FUTURE)
    assert judged["evidence"].str.len().min() > 40
    assert (judged.loc[judged["verdict"] == claims.NAMED, "reading"] != "").all()


def test_the_readme_holds_the_verdicts(judged, tmp_path, capsys):
    judged.to_csv(tmp_path / "claims.csv", index=False)
    readme = tmp_path / "README.md"
    begin, end = pages.markers("verdicts")
    readme.write_text(f"a\n{begin}\n{end}\nb\n")
    call = ["verdicts", f"--data={tmp_path}", f"--pages={tmp_path}"]
    assert pages.main([*call, "--write"]) == 0
    lines = readme.read_text().splitlines()
    assert len(lines) == 2 + 14 + 2
    for line, row in zip(lines[2:], judged.itertuples()):
        assert line.startswith(f"* {row.claim}: {row.statement}. **{row.verdict.capitalize()}**")
        assert line.endswith(f" ({row.reading}).") == (row.verdict in claims.NAMING)
    assert pages.main(call) == 0 and capsys.readouterr().out.count("\n") == 14
    readme.write_text("no markers")
    assert pages.main([*call, "--write"]) == 2 and "must hold" in capsys.readouterr().err
    assert pages.main([call[0], f"--data={tmp_path / 'none'}"]) == 2 and "make all" in capsys.readouterr().err


def test_the_findings_count_the_verdicts_and_say_what_the_nearest_is_worth(judged):
    ranking = effects.nearest(grid(with_torque))
    text = claims.findings(judged.to_dict("records"), ranking.astype(str).to_dict("records"))
    counts = judged["verdict"][:10].value_counts()
    assert text.startswith("Of the paper's 10 statements: ") and "future" not in text
    assert all(f"{counts[verdict]} {verdict.replace('holds in part', 'hold')}" in text for verdict in counts.index)
    assert "differs from the default in input (the torques in N m that act on the plant)" in text
    assert ": yaw 4.1 % (4.02 to 4.18), pitch 5.5 % (5.39 to 5.61) over the seeds" in text
    assert "cannot tell whether" in text  # the linear model has the same errors here
    apart = effects.nearest(grid(lambda r: (1.0, 1.0) if r["dictionary"] == "linear" else with_torque(r)))
    text = claims.findings(judged.to_dict("records"), apart.astype(str).to_dict("records"))
    assert "may tell whether" in text


def test_a_singular_K_has_the_eigenvalue_zero():
    """What C8 counts: functions that are dependent on the data give K an eigenvalue without a logarithm."""
    rng = np.random.default_rng(0)
    before = rng.standard_normal((6, 9))  # 6 pairs for 9 functions
    K = np.linalg.pinv(before) @ rng.standard_normal((6, 9))
    assert np.sort(np.abs(np.linalg.eigvals(K)))[2] < 1e-12
    with pytest.raises(generator.LogarithmError):
        generator.principal_logarithm(K)
