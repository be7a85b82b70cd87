"""The comparison: the same rule for all, validation recordings unseen, every case counted."""

import numpy as np
import pandas as pd
import pytest
from sklearn.base import clone

import tras
from tras.paper import comparison
from tras.paper.figures import comparison as figures_comparison

FEW = ("DMDc", "Koopman, the paper's", "grey box")


@pytest.fixture(scope="module")
def recordings():
    train, multisine, chirp = [
        tras.simulate_closed_loop(tras.multisine(15, 0.01, [2.0, 4.0], [0.6, 1.2], np.random.default_rng(seed)), 0.01)
        for seed in (1, 2, 3)
    ]
    return train, {"multisine 2": multisine, "chirp": chirp}


@pytest.fixture(scope="module")
def study():
    return comparison.Study(trajectory=1.0, window=1.0, middle=0.5, fractions=(0.2,), methods=FEW)


@pytest.fixture(scope="module")
def results(study, recordings, tmp_path_factory):
    return comparison.run(study, *recordings, tmp_path_factory.mktemp("cache"), processes=1)


def test_every_method_has_as_many_settings_and_each_is_another():
    for name, models in comparison.METHODS.items():
        assert len(models) == comparison.TRIES == len({str(model) for model in models}), name
        assert all(clone(model).get_params().keys() == model.get_params().keys() for model in models)


@pytest.mark.slow
def test_every_case_is_there(results, study):
    cases = comparison.jobs(study)
    assert len(cases) == 2 * 3 - 1 + 3 * 3  # no grey box on references; noise twice and one fraction for the torque
    scores = results["scores"]
    of_one = scores.groupby(["method", "input"]).size()
    assert len(of_one) == 5 and (of_one == 2 * (2 * 3 + 1)).all()  # angles x (recordings x horizons and one free run)
    assert set(scores["horizon"]) == {0.01, 0.5, 1.0, 15.0} and ("grey box", "reference") not in of_one.index
    assert len(results["tuning"]) == len(cases) * comparison.TRIES
    assert (results["tuning"].groupby(["method", "input", "noise", "smoothed", "fraction"])["chosen"].sum() == 1).all()
    assert len(results["data"]) == len(cases) * 2 and len(results["times"]) == len(cases)


@pytest.mark.slow
def test_the_chosen_setting_is_the_best_one(results):
    for _, group in results["tuning"].groupby(["method", "input", "noise", "smoothed", "fraction"]):
        assert group.loc[group["chosen"], "error"].iloc[0] == group["error"].min()


@pytest.mark.slow
def test_the_bound_is_a_bound(results):
    scores = results["scores"].query("input == 'torque' and horizon == 1").groupby("method")["nrmse"].max()
    assert scores.idxmin() == "grey box" and scores["grey box"] < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("method", ["DMDc", "NARX", "Koopman, the paper's"])
def test_validation_is_not_seen(method, study, recordings):
    train, fresh = recordings
    job = {"method": method, "input": "torque", "noise": 0.0, "smoothed": False, "fraction": 1.0}
    other = {
        name: recording.with_data([recording.states[0, ::-1]], [recording.inputs[0, ::-1] * 2])
        for name, recording in fresh.items()
    }
    one, two = (comparison.case(study, train, unseen, None, job) for unseen in (fresh, other))
    assert one["tuning"] == two["tuning"] and one["parameters"] == two["parameters"] and one["scores"] != two["scores"]


@pytest.mark.slow
def test_noise_and_fraction_reach_the_training_data(study, recordings):
    job = {"method": "DMDc", "input": "torque", "noise": 0.0, "smoothed": False, "fraction": 1.0}
    whole, few = (comparison.training(study, job | {"fraction": share}, recordings[0]) for share in (1.0, 0.2))
    noisy, smoothed = (
        comparison.training(study, job | {"noise": 1.0, "smoothed": some}, recordings[0]) for some in (False, True)
    )
    prepared = comparison.prepare(study, {"noise": 1.0, "smoothed": True}, recordings[0])
    again = comparison.training(study, job | {"noise": 1.0, "smoothed": True}, recordings[0], prepared)
    assert np.array_equal(np.stack(list(again.states)), np.stack(list(smoothed.states)))
    assert (len(whole), len(few)) == (12, 2) and whole.input_names == ("u_phi", "u_psi")
    clean = np.concatenate(list(whole.states))
    errors = [
        np.std(np.concatenate(list(each.states)) - clean, axis=0) / np.ptp(recordings[0].states[0], axis=0)
        for each in (noisy, smoothed)
    ]
    assert np.allclose(errors[0], 0.01, rtol=0.1) and (errors[1] < errors[0] / 2).all()


@pytest.mark.slow
def test_processes_and_the_cache_change_nothing(study, recordings, tmp_path, monkeypatch):
    small = comparison.Study(trajectory=1.0, window=1.0, middle=0.5, fractions=(), data_inputs=(), methods=("DMDc",))
    one = comparison.run(small, *recordings, tmp_path / "one", processes=1)
    two = comparison.run(small, *recordings, tmp_path / "two", processes=2)
    for name in ("scores", "tuning", "data"):
        pd.testing.assert_frame_equal(one[name], two[name])
    monkeypatch.setattr(comparison, "case", None)  # would fail if anything were computed
    again = comparison.run(small, *recordings, tmp_path / "one", processes=1)
    pd.testing.assert_frame_equal(one["scores"], again["scores"])


def test_scores_are_those_of_the_metrics(study, recordings):
    class Off:
        def predict(self, recording):
            return recording.states + [0.1, 0, 0.2, 0]

    rows = pd.DataFrame(comparison.score(study, Off(), recordings[1]))
    span = np.ptp(recordings[1]["chirp"].cut(101).states, axis=(0, 1))
    for row in rows[rows["recording"] == "chirp"].itertuples():
        assert row.nrmse == pytest.approx(100 * {"yaw": 0.2 / span[2], "pitch": 0.1 / span[0]}[row.angle])


def test_diverged_predictions_are_counted_at_their_horizon(study, recordings):
    class Lost:
        def predict(self, recording):
            states = recording.states.copy()
            states[0, 100:] = np.nan
            return states

    rows = pd.DataFrame(comparison.score(study, Lost(), recordings[1]))
    rows = rows.query("recording == 'multisine 2' and angle == 'yaw'").set_index("horizon")
    assert rows["diverged"].to_dict() == {0.01: 0, 0.5: 0, 1.0: 1, 15.0: 1}
    assert np.isnan(rows.loc[15.0, "nrmse"]) and rows.loc[1.0, "nrmse"] == 0 and rows.loc[1.0, "windows"] == 15


@pytest.mark.parametrize(
    "options, sentence",
    [({"methods": ("magic",)}, "methods holds 'magic'"), ({"data_inputs": ("x",)}, "data_inputs holds 'x'")],
)
def test_unknown_names_are_named(options, sentence):
    with pytest.raises(ValueError, match=sentence):
        comparison.jobs(comparison.Study(**options))


def test_a_method_that_cannot_be_fitted_says_why(study, recordings, monkeypatch):
    monkeypatch.setitem(comparison.METHODS, "DMDc", [comparison.DMDc(-1.0)])
    job = {"method": "DMDc", "input": "torque", "noise": 0.0, "smoothed": False, "fraction": 1.0}
    assert "alpha is -1.0" in comparison.case(study, *recordings, None, job)["failure"]


@pytest.mark.slow
def test_figures_hold_every_method(results):
    """One row per method, and a point (or, off the scale, a word) for each that has an error."""
    horizon = figures_comparison.horizon_table(results["scores"])
    amount = figures_comparison.data_table(results["data"]).query("input == 'torque'")
    window = horizon[horizon["horizon"] == 1.0]
    cases = [(figures_comparison.window_figure, window, 1), (figures_comparison.data_figure, amount, 2)]
    for draw, table, angles in cases:  # angles in a panel: there a word stands for both
        figure = draw(table)
        assert {text.get_text() for text in figure.axes[0].get_yticklabels()} == set(FEW)
        lines = [line for panel in figure.axes for line in panel.lines if line.get_marker() != "None"]
        drawn = sum(len(line.get_xdata()) for line in lines)
        words = sum(len(panel.texts) for panel in figure.axes)
        assert drawn + angles * words == len(table)
    panels = figures_comparison.horizon_figure(horizon).axes
    shown = {line.get_label() for panel in panels for line in panel.lines if not line.get_label().startswith("_")}
    assert len(panels) == 4 and shown == set(FEW[:2])


def a_table(**changed):
    """Three methods over one window: by torques the first is the best."""
    rows = [
        {"method": name, "input": channel, "angle": angle, "nrmse": error, "diverged": 0}
        for channel in ("reference", "torque")
        for angle in ("yaw", "pitch")
        for name, error in {"A": 0.5, "DMDc": 2.0, "B": 1.0}.items()
    ]
    return pd.DataFrame(rows).assign(**changed)


def test_methods_stand_in_the_order_of_their_errors():
    panel = figures_comparison.window_figure(a_table()).axes[0]
    assert [text.get_text() for text in panel.get_yticklabels()] == ["A", "B", "DMDc"]
    assert panel.get_ylim()[0] > panel.get_ylim()[1]  # the first one is on top


@pytest.mark.parametrize("share", [-5e-10, 5e-10])
def test_the_last_digits_do_not_decide_which_method_is_drawn_first(share):
    """Two methods with nearly one error keep the table's order, whichever is better by rounding."""
    table = a_table().replace({"nrmse": {1.0: 2.0}})
    table.loc[table["method"] == "B", "nrmse"] *= 1 + share
    panel = figures_comparison.window_figure(table).axes[0]
    assert [text.get_text() for text in panel.get_yticklabels()] == ["A", "DMDc", "B"]


def test_a_point_is_hollow_where_windows_were_lost_and_a_word_where_none_is_left():
    table = a_table()
    table.loc[(table["method"] == "B") & (table["input"] == "torque"), "diverged"] = 3
    table.loc[(table["method"] == "A") & (table["input"] == "torque"), "nrmse"] = np.nan
    figure = figures_comparison.window_figure(table)
    yaw = figure.axes[2]
    points = [line for line in yaw.lines if line.get_marker() != "None" and len(line.get_xdata())]
    hollow = [line for line in points if line.get_markerfacecolor() == "white"]
    assert [list(line.get_xdata()) for line in hollow] == [[1.0]] and len(points) == 2
    assert [text.get_text() for text in yaw.texts] == ["all lost"]
    assert "hollow" in figure.get_supxlabel()
    assert "hollow" not in figures_comparison.window_figure(a_table()).get_supxlabel()


def test_an_error_off_the_scale_is_said_in_words():
    table = a_table()
    table.loc[table["method"] == "A", "nrmse"] = 2e-9
    panel = figures_comparison.window_figure(table).axes[0]
    assert [text.get_text() for text in panel.texts] == ["\N{LEFTWARDS ARROW} 2e-9"] and panel.get_xlim()[0] > 0.1


def test_without_the_linear_model_there_is_nothing_to_relate_to():
    table = a_table(horizon=1.0)
    with pytest.raises(ValueError, match="table has no method 'DMDc'"):
        figures_comparison.horizon_figure(table[table["method"] != "DMDc"])


@pytest.mark.parametrize(
    "draw", [figures_comparison.horizon_figure, figures_comparison.data_figure, figures_comparison.window_figure]
)
def test_a_table_without_its_columns_is_refused(draw):
    with pytest.raises(ValueError, match="table lacks the columns"):
        draw(pd.DataFrame({"method": ["a"]}))


@pytest.mark.slow
def test_as_many_windows_as_metrics_count(results):
    assert (results["scores"]["diverged"] <= results["scores"]["windows"]).all()
