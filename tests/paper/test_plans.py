"""What is asked of a controller: each criterion follows its own number, and what was not tried is not met."""

import itertools

import numpy as np
import pandas as pd
import pytest

from tras.paper import claims, plans
from tras.paper.control import BOUND, OURS, REFERENCES


def runs(**changed):
    """A table like that of 11_control in which everything is met, but for what is changed."""
    value = {
        "ours": 0.0101, "bound": 0.01, "pid": 0.2, "settling": 0.64, "outside": 0.0, "steady": 1e-5, "angles": 0.014,
        "lost": False,
    } | changed  # fmt: skip
    rows = []

    def row(controller, condition, error, preview=True, reference="fast", **more):
        about = {"controller": controller, "preview": preview, "reference": reference, "condition": condition}
        usual = {"settling_yaw": np.nan, "steady": np.nan, "outside": 0.0, "diverged": False}
        errors = dict.fromkeys(("yaw", "pitch", "yaw_whole", "pitch_whole"), error)
        rows.append({**about, "level": 0.0, **errors, **usual, **more})

    for reference, preview in itertools.product(REFERENCES, (True, False)):
        settled = reference == "steps" and not preview
        more = {"settling_yaw": value["settling"] if settled else np.nan, "outside": value["outside"]}
        row(OURS, "calm", value["ours"], preview, reference, **more)
        row(BOUND, "calm", value["bound"], preview, reference)
    for reference in REFERENCES:
        row("PID", "calm", value["pid"], False, reference, settling_yaw=3.3 if reference == "steps" else np.nan)
    row(OURS, "constant torque", 0.01, False, "steps", steady=value["steady"])
    row(OURS, "noise", 0.01)
    row(OURS, "noise, angles only", value["angles"])
    row(OURS, "rig", 0.02)
    row(OURS, "rig", 0.02, diverged=value["lost"])
    return pd.DataFrame(rows)


def flights(ours=0.05, gust=0.01):
    """A table like that of the motors."""
    cases = [("PID", 0.5), (OURS, ours)]
    return pd.DataFrame([{"controller": name, "gust": gust, "yaw": error, "pitch": error} for name, error in cases])


def test_all_is_met():
    asked = plans.judged(runs(), flights())
    assert asked["met"].all() and len(asked) == 8
    both = f"1.01 (without the start, as scored until {plans.CHANGED}: 1.01)"
    assert list(asked["ours"])[:3] == [both, "19.8", "0.64 s (PID 3.30 s)"]
    assert claims.customized(runs(), flights())["verdict"] == claims.SHOWN


@pytest.mark.parametrize(
    "number, changed",
    [
        (0, {"ours": 0.0106}), (1, {"pid": 0.1}), (2, {"settling": 1.2}), (2, {"settling": np.nan}),
        (3, {"outside": 2e-9}), (4, {"steady": 2e-3}), (5, {"angles": 0.016}), (6, {"lost": True}),
    ],
)  # fmt: skip
def test_each_criterion_follows_its_own_number(number, changed):
    judge_one(number, runs(**changed), flights())


def judge_one(number, table, motors):
    asked, row = plans.judged(table, motors), claims.customized(table, motors)
    assert list(asked.index[~asked["met"]]) == [number]
    assert row["verdict"] == claims.SHOWN_IN_PART and row["reading"] == f"not met: {asked['asked'][number]}"
    assert row["evidence"].count(", met") == 7 and row["evidence"].count(", not met") == 1


@pytest.mark.parametrize("motors", [flights(0.26), flights(gust=0.0), flights().iloc[:0]])
def test_motors_count_under_gusts(motors):
    judge_one(7, runs(), motors)


def test_what_was_not_tried_is_not_met():
    table = runs()
    without = plans.judged(table[~table["condition"].isin(["constant torque", "noise", "rig"])], flights())
    assert list(without.index[~without["met"]]) == [4, 5, 6]
    nothing = plans.judged(table[table["controller"] == "PID"], flights())
    assert list(nothing.index[nothing["met"]]) == [3, 7]
    assert claims.customized(table.iloc[:0], flights().iloc[:0])["verdict"] == claims.NOT_SHOWN
