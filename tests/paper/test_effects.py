"""Distances, effects and chances on tables whose answers are known."""

import itertools
import math

import numpy as np
import pandas as pd
import pytest

from tras.paper import effects, readings

DEFAULT = readings.Readings()
LABELS = ["option", "choice", "angle"]


def a_table(number, *, lost=lambda labels: False, seeds=(1, 2)):
    """A table as the grid gives it; ``number(labels)`` is NRMSE, ``lost(labels)`` whether the windows diverged."""
    names = (*effects.OPTIONS, "train_seed", "validation_seed", "angle")
    few = [readings.choices(option)[: 1 if option in readings.SINGLE else 3] for option in effects.OPTIONS]
    choices = [*few, seeds, (2, 3), ("yaw", "pitch")]
    rows = []
    for labels in (dict(zip(names, values)) for values in itertools.product(*choices)):
        gone = lost(labels)
        about = {"draw": 0, "windows": 10, "diverged": 10 * gone, "outcome": "model"}
        rows.append({**labels, **about, "nrmse": math.nan if gone else number(labels)})
    return pd.DataFrame(rows)


def known(labels):
    """Every option multiplies the error by a factor of its own; seeds and angles too."""
    factor = 3.0 if labels["input"] == "torque" else 1.0
    factor *= {"gaussian": 1.0, "gaussian28": 0.5, "monomials2": 2.0}[labels["dictionary"]]
    factor *= 4.0 if labels["nrmse_range"] == "trajectory" and labels["horizon"] != "free_run" else 1.0
    return factor * (1.0 + 0.1 * labels["train_seed"]) * (2.0 if labels["angle"] == "pitch" else 1.0)


def test_distance_counts_ratios_and_both_angles():
    assert effects.distance(4.0589, 5.5889) == 0 == effects.distance(5.5889, 4.0589, "symbols")
    for yaw, pitch in ((2, 2), (0.5, 0.5), (2, 0.5)):
        assert effects.distance(yaw * 4.0589, pitch * 5.5889) == pytest.approx(math.log(2))
    assert effects.distance(2 * 4.0589, 5.5889) == pytest.approx(math.log(2) / math.sqrt(2))
    both = effects.distance(np.array([4.0589, 8.1178]), np.array([5.5889, 5.5889]))
    assert np.allclose(both, [0, math.log(2) / math.sqrt(2)])
    with pytest.raises(readings.ReadingError, match="angle_names is 'word': did you mean 'words'"):
        effects.distance(1, 1, "word")


def test_known_effects_are_found():
    table = effects.effects(a_table(known), DEFAULT).set_index(LABELS)
    for (option, choice), ratio in {
        ("input", "torque"): 3, ("dictionary", "gaussian28"): 0.5, ("dictionary", "monomials2"): 2,
        ("nrmse_range", "trajectory"): 4, ("frequency_unit", "Hz"): 1, ("state", "delayed_angles"): 1,
        ("velocity_term", "as_printed"): 1, ("horizon", "trajectory"): 1,
    }.items():  # fmt: skip
        for angle in ("yaw", "pitch"):
            row = table.loc[(option, choice, angle)]
            assert np.allclose(row[["median", "q05", "q25", "q75", "q95"]].astype(float), ratio) and row["lost"] == 0
    pairs = 2 * 2 * 3 * 2 * 3 * 2 * 2 * 3 * 4  # all readings of `a_table`, four seeds
    assert table.loc[("input", "torque", "yaw"), "pairs"] == pairs / 2
    assert table.loc[("nrmse_range", "trajectory", "yaw"), "pairs"] == pairs / 2 * 2 / 3  # free runs left out


def test_the_effects_refer_to_the_chosen_default():
    table = effects.effects(a_table(known), DEFAULT.replaced(input="torque")).set_index(LABELS)
    assert table.loc[("input", "reference", "yaw"), "median"] == pytest.approx(1 / 3)


def test_what_ran_away_is_counted_and_not_averaged():
    gone = lambda labels: labels["dictionary"] == "monomials2" and labels["train_seed"] == 2  # noqa: E731
    table = a_table(known, lost=gone)
    row = effects.effects(table, DEFAULT).set_index(LABELS).loc[("dictionary", "monomials2", "yaw")]
    assert row["pairs"] == row["lost"] and row["median"] == pytest.approx(2)
    summary = effects.summary(table)
    assert list(summary[~summary["complete"]]["dictionary"].unique()) == ["monomials2"]
    assert summary["complete"].mean() == pytest.approx(2 / 3)
    assert (summary["diverged"] == np.where(summary["complete"], 0, 20)).all()
    assert (summary["windows"] == 40).all() and (summary["runs"] == 4).all()
    assert "monomials2" not in set(effects.nearest(table)["dictionary"])


def test_draws_of_centres_are_one_and_fail_together():
    """The median over the draws stands for a dictionary; a draw that ran away is not left out of it."""
    one = a_table(known)
    other = one[one["dictionary"] == "gaussian"].assign(draw=1)
    table = effects.effects(pd.concat([one, other.assign(nrmse=3 * other["nrmse"])]), DEFAULT).set_index(LABELS)
    # The median of 1 and 3 is 2.
    assert table.loc[("dictionary", "monomials2", "yaw"), "median"] == pytest.approx(2 / 2)
    gone = other.assign(nrmse=math.nan, diverged=10)
    row = effects.effects(pd.concat([one, gone]), DEFAULT).set_index(LABELS).loc[("dictionary", "monomials2", "yaw")]
    assert row["pairs"] == 0 < row["lost"] and math.isnan(row["median"])


def test_a_fit_without_model_makes_its_reading_incomplete():
    table = a_table(known)
    failed = (table["dictionary"] == "gaussian28") & (table["train_seed"] == 1) & (table["state"] == "four_states")
    table.loc[failed, ["nrmse", "outcome", "windows"]] = math.nan, "no model: logarithm", 0
    summary = effects.summary(table).query("dictionary == 'gaussian28'")
    assert (summary["without_model"] == np.where(summary["state"] == "four_states", 2, 0)).all()
    assert (summary["complete"] == (summary["state"] != "four_states")).all()


def test_nearest_ranks_by_the_median_and_shows_the_spread():
    def planted(labels):
        changes = {"input": "torque", "dictionary": "gaussian28", "frequency_unit": "Hz"}
        reading = DEFAULT.replaced(**changes).model_dump(exclude={"angle_names"})
        exact = {"yaw": 5.5889, "pitch": 4.0589}[labels["angle"]] * {1: 0.9, 2: 1.0, 3: 1.1}[labels["train_seed"]]
        return exact if all(labels[name] == value for name, value in reading.items()) else 40.0

    ranking = effects.nearest(a_table(planted, seeds=(1, 2, 3)))
    first = ranking.iloc[0]
    assert (first["input"], first["dictionary"], first["angle_names"]) == ("torque", "gaussian28", "symbols")
    assert first["distance"] == pytest.approx(0, abs=1e-12) and first["distance_lowest"] == pytest.approx(0, abs=1e-12)
    assert first["distance_highest"] == pytest.approx(-math.log(0.9))
    assert ranking["distance"].is_monotonic_increasing
    assert not ((ranking["horizon"] == "free_run") & (ranking["nrmse_range"] == "trajectory")).any()
    assert effects.departures(ranking, DEFAULT)[0] == 4  # input, dictionary, unit, names


def test_chance_is_the_share_of_the_plane_that_readings_cover():
    """One reading in the middle of a square: a disc of radius sqrt(2) d in the square spanned by the others."""
    corners = [(math.exp(a), math.exp(b)) for a in (-1, 1) for b in (-1, 1)]
    ranking = pd.DataFrame([(1.0, 1.0)] + 100 * corners, columns=["yaw", "pitch"]).assign(angle_names="words")
    middle = np.arange(len(ranking)) == 0
    rng = np.random.default_rng(0)
    disc = lambda radius: math.pi * 2 * radius**2 / 4  # noqa: E731
    share = effects.chance(ranking, 0.3, rng, among=middle, draws=20000)
    assert share == pytest.approx(disc(0.3), abs=0.01)
    share = effects.chance(ranking, 0.3, rng, draws=20000)
    assert share == pytest.approx(2 * disc(0.3), abs=0.012)  # four quarters more
    aside = ranking.copy()
    aside.loc[middle, ["yaw", "pitch"]] = math.exp(0.5), math.exp(-0.5)
    # By the symbols it serves pairs on the other side of the diagonal.
    both = pd.concat([aside, aside.assign(angle_names="symbols")])
    for table, discs in ((aside, 1), (both, 2)):
        serving = np.tile(middle, len(table) // len(aside))
        share = effects.chance(table, 0.2, rng, among=serving, draws=20000)
        assert share == pytest.approx(discs * disc(0.2), abs=0.01)
