"""The explorer without a browser: what comes of a choice, possible or not, and its parameter file."""

import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from conftest import ROOT, visible_texts
from hypothesis import given, settings
from hypothesis import strategies as st

from tras import plotting
from tras.explorer import choice, explore, figures
from tras.explorer.choice import Choice, ChoiceError
from tras.explorer.further import FURTHER
from tras.explorer.widgets import STALE, Explorer
from tras.paper import readings
from tras.workflow import parameters, yaml_file

SMALL = Choice(duration=60.0, input="torque", horizon=3.0)
PUBLISHED = ROOT / "reference" / "data" / "metrics.csv"


@pytest.fixture(scope="module")
def small():
    return explore.explore(SMALL)


@pytest.fixture(scope="module")
def panel(tmp_path_factory):
    return Explorer(SMALL, tmp_path_factory.mktemp("params"))


# --- choices ---

WRONG = {
    "an option": ({"input": "torques"}, "input is 'torques': choose one of reference, torque"),
    "a size": (
        {"dictionary": "monomials", "size": 9},
        "size is 9; give 1 to 5: with dictionary = monomials it is the ",
    ),
    "a broken size": ({"size": 2.0}, "size is 2.0"),
    "a number": ({"noise": -1.0}, "noise is -1.0; give a number from 0 to 20 % of each state's range"),
    "text for a number": ({"horizon": "6"}, "horizon is '6'; give a number"),
    "not finite": ({"strength": float("nan")}, "strength is nan"),
    "a broken seed": ({"seed": 1.5}, "seed is 1.5; give a whole number"),
    "true for a number": ({"delays": True}, "delays is True"),
}


@pytest.mark.parametrize("what", WRONG)
def test_a_wrong_value_is_refused_in_one_sentence(what):
    values, sentence = WRONG[what]
    with pytest.raises(ChoiceError) as caught:
        Choice(**values)
    assert sentence in str(caught.value) and "\n" not in str(caught.value)


def test_an_unknown_name_is_refused():
    with pytest.raises(ChoiceError, match="there is no 'dictionnary' to choose: there are input, frequency_unit"):
        choice.choice_of({"dictionnary": "gaussian"})


IMPOSSIBLE = {
    "too short for a line": ({"duration": 20.0}, "raise it or the duration"),
    "too short for trajectories": ({"duration": 10.0, "frequency_unit": "Hz"}, "too short for 3 trajectories of 5 s"),
    "too short for a window": ({"duration": 40.0, "horizon": 60.0}, "too short for one horizon of 60 s"),
    "sampling that does not divide": (
        {"duration": 100.0, "sampling_time": 0.03},
        "duration is 100 s, no whole number of",
    ),
    "a horizon between samples": (
        {"sampling_time": 0.02, "horizon": 1.01},
        "horizon is 1.01 s, no whole number of samples",
    ),
    "too many functions": ({"dictionary": "monomials", "size": 5}, "These are 462 functions"),
    "dependent channels": ({"delays": 4}, "linearly dependent"),
    "no logarithm": (
        {"dictionary": "mechanical", "size": 8, "noise": 1.0},
        "no principal logarithm.*predictor='one_step'",
    ),
}


@pytest.mark.parametrize("what", IMPOSSIBLE)
def test_an_impossible_choice_is_answered_in_one_sentence(what):
    changes, sentence = IMPOSSIBLE[what]
    with pytest.raises(ChoiceError, match=sentence) as caught:
        explore.explore(SMALL.replaced(**changes))
    assert "\n" not in str(caught.value)


# --- what comes of them ---


@pytest.mark.slow
def test_the_papers_choice_has_the_published_numbers():
    """Those of 03_validation, which the notebooks compute on their own way, for the first validation recording."""
    where = "kind == 'window' and input == 'reference' and recording == 'multisine 2'"
    published = pd.read_csv(PUBLISHED).query(where)
    metrics = explore.explore(Choice()).metrics
    for ours, theirs in (("Koopman", "gaussian"), ("linear", "linear")):
        for angle in ("yaw", "pitch"):
            a = metrics[(metrics["model"] == ours) & (metrics["angle"] == angle)].iloc[0]
            b = published[(published["model"] == theirs) & (published["angle"] == angle)].iloc[0]
            np.testing.assert_allclose([a["nrmse"], a["enr"], a["bfr"]], [b["nrmse"], b["enr"], b["bfr"]], rtol=1e-5)
            assert (a["windows"], a["diverged"]) == (b["windows"], b["diverged"])


@pytest.mark.slow
@pytest.mark.parametrize("state", choice.OPTIONS["state"])
@pytest.mark.parametrize("predictor", choice.OPTIONS["predictor"])
@pytest.mark.parametrize("dictionary", choice.SIZES)
def test_every_dictionary_with_every_predictor(dictionary, predictor, state):
    """A model as large as was counted beforehand, or a sentence."""
    size, delays = choice.SIZES[dictionary][2], int(state == "delayed_angles")
    changes = {"size": size, "predictor": predictor, "state": state, "delays": delays, "field": "coordinates"}
    example = SMALL.replaced(dictionary=dictionary, **changes)
    try:
        model = explore.explore(example).model
    except ChoiceError as error:
        assert str(error).startswith("There is no model: ")
        return
    train = explore.training(example)
    assert explore._functions(explore.unfitted(example), train) in (len(model.names_), 0)
    assert (model.predictor, model.delays, model.state_names_) == (predictor, delays, train.state_names)


@pytest.mark.parametrize("dictionary, size", [("exponentials", 2), ("fourier", 2), ("monomials", 3), ("gaussian", 7)])
def test_functions_are_counted_before_they_are_made(dictionary, size):
    train = explore.training(SMALL)
    for delays, predictor in ((0, "vector_field"), (2, "one_step"), (1, "lifted_linear")):
        model = explore.unfitted(SMALL.replaced(dictionary=dictionary, size=size, delays=delays, predictor=predictor))
        count = explore._functions(model, train)
        channels = train.delayed(delays, inputs=predictor != "vector_field" and delays > 0)
        lift = model.dictionary.fit(channels.states[0], channels.inputs[0] if predictor != "lifted_linear" else None)
        assert count == len(lift.names)


def test_noise_is_on_the_training_states_alone():
    quiet, loud = explore.training(SMALL), explore.training(SMALL.replaced(noise=1.0))
    spread = (loud.states - quiet.states).std(axis=(0, 1)) / np.ptp(np.concatenate(quiet.states), axis=0)
    np.testing.assert_allclose(spread, 0.01, rtol=0.05)
    assert np.array_equal(quiet.inputs, loud.inputs)
    windows = [explore.validation_windows(SMALL.replaced(noise=noise)).states for noise in (0.0, 1.0)]
    assert np.array_equal(*windows)


def test_recordings_are_simulated_once():
    assert explore.recording("rad/s", 60.0, 0.01, 1) is explore.recording("rad/s", 60.0, 0.01, 1)
    assert explore.recording("Hz", 60.0, 0.01, 1) is not explore.recording("rad/s", 60.0, 0.01, 1)


def test_the_windows_are_of_another_realisation_than_the_training(small):
    whole = explore.recording("rad/s", 60.0, 0.01, SMALL.seed + 1).select(inputs=("u_phi", "u_psi"))
    assert [k for k in range(0, 6000, 300) if np.array_equal(whole.states[0, k : k + 301], small.window.states[0])]
    assert not np.array_equal(whole.states, explore.recording("rad/s", 60.0, 0.01, SMALL.seed).states)


def test_the_overlay_is_the_models_own_prediction(small):
    for model, name in ((small.model, "koopman"), (small.linear, "linear")):
        angles = model.predict(small.window)[0][:, [0, 2]]
        np.testing.assert_allclose(small.overlay[[f"phi_{name}", f"psi_{name}"]], angles, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(small.overlay[["phi_true", "psi_true"]], small.window.states[0][:, [0, 2]])


def test_error_growth_ends_where_the_windows_end(small):
    last = small.growth.groupby(["model", "angle"])["time"].max()
    assert len(last) == 4 and (np.abs(last - SMALL.horizon) < 0.05).all()


def test_what_ran_away_is_counted_and_said():
    outcome = explore.explore(choice.EXAMPLES["cubic terms, 100 s of data"])
    row = outcome.metrics[outcome.metrics["model"] == "Koopman"].iloc[0]
    count = f"{int(row['diverged'])} of {int(row['windows'])}"
    assert row["diverged"] > 0 and explore.numbers(outcome).loc["ran away", "Koopman"] == count
    assert any(remark.startswith(f"{count} predictions of the Koopman model ran away") for remark in outcome.remarks)


def test_numbers_stand_beside_the_papers(small):
    table = explore.numbers(small)
    assert list(table["paper"][["NRMSE (%), yaw", "NRMSE (%), pitch"]]) == ["4.0589", "5.5889"]
    assert set(table["paper"][2:]) == {""}
    shown = float(table.loc["NRMSE (%), pitch", "linear"])
    exact = small.metrics[(small.metrics["model"] == "linear") & (small.metrics["angle"] == "pitch")]["nrmse"].iloc[0]
    assert shown == pytest.approx(exact, rel=1e-3)


def test_the_range_changes_the_numbers_and_not_the_predictions(small):
    other = explore.explore(SMALL.replaced(nrmse_range="trajectory"))
    pd.testing.assert_frame_equal(other.overlay, small.overlay)
    assert (other.metrics["nrmse"][:4] > 1.5 * small.metrics["nrmse"][:4]).all()


@pytest.mark.parametrize("example", [SMALL, SMALL.replaced(dictionary="mechanical", size=8)], ids=["few", "many"])
def test_no_title_lies_on_a_label_of_the_panel_above(example):
    outcome = explore.explore(example)
    figure = figures.outcome_figure(outcome.overlay, outcome.growth, outcome.spectrum)
    renderer, texts = visible_texts(figure)
    titles = [axes.title for axes in figure.axes] + [axes._left_title for axes in figure.axes]
    boxes = {id(text): text.get_window_extent(renderer) for text in texts}
    for title in (text for text in titles if id(text) in boxes):
        over = [t.get_text() for t in texts if t is not title and boxes[id(t)].overlaps(boxes[id(title)])]
        assert not over, (title.get_text(), over)


def test_the_picture_shows_truth_models_and_circle(small):
    figure = figures.outcome_figure(small.overlay, small.growth, small.spectrum)
    yaw, error, pitch, plane = figure.axes
    assert [len(panel.lines) for panel in (yaw, pitch, error, plane)] == [3, 3, 4, 3]
    assert len({str(line.get_linestyle()) for line in yaw.lines}) == 3
    np.testing.assert_allclose(np.hypot(*plane.lines[0].get_data()), 1)
    assert plotting.png(figure)[:4] == b"\x89PNG"


# --- parameter files ---

any_choice = st.builds(
    dict,
    **{name: st.sampled_from(list(values)) for name, values in choice.OPTIONS.items()},
    duration=st.floats(20, 1000), sampling_time=st.sampled_from([0.01, 0.02, 0.1]), seed=st.integers(1, 9999),
    noise=st.floats(0, 20), width=st.floats(0.1, 10), delays=st.integers(0, 5), strength=st.floats(1e-12, 1),
    horizon=st.floats(1, 60), size=st.just(2),
).map(lambda values: Choice(**values))  # fmt: skip


@settings(max_examples=60, deadline=None)
@given(any_choice)
def test_a_file_holds_the_whole_choice_and_every_notebook_accepts_its_part(example):
    smoke = yaml.safe_load((ROOT / "params" / "smoke.yaml").read_text())
    small = {name: smoke[name] for name in ("05_robustness", "07_comparison")}
    content = yaml_file.parse_yaml(choice.parameter_text(example, "mine", small), "mine.yaml")
    assert choice.choice_of(content["09_pictures"]["choice"]) == example
    for name, section in content.items():
        parameters.check_parameters(section, DEFAULTS[name], name)
    reading = readings.Readings(**content["06_readings"]["default"])
    for name in ("input", "frequency_unit", "nrmse_range", "state"):
        assert getattr(reading, name) == getattr(example, name)
    assert content["01_data_generation"]["train_seed"] == example.seed


DEFAULTS = {path.stem: parameters.notebook_defaults(path) for path in (ROOT / "notebooks").glob("0*.ipynb")}


def test_the_papers_choice_changes_nothing_of_the_papers_parameters():
    for name, section in choice.parameter_sections(Choice(), {"05_robustness": {"swings": 1}}).items():
        if name != "09_pictures":
            assert section == {parameter: DEFAULTS[name][parameter] for parameter in section}
    assert "05_robustness" not in choice.parameter_sections(Choice(), {"05_robustness": {"swings": 1}})


def test_another_experiment_takes_the_small_studies():
    assert choice.parameter_sections(SMALL, {"05_robustness": {"swings": 1}})["05_robustness"] == {"swings": 1}
    section = choice.parameter_sections(Choice(frequency_unit="Hz"))["01_data_generation"]
    assert section["yaw_max_frequency"] == pytest.approx(1.6 * np.pi)


def test_a_reading_is_named_where_it_has_a_name():
    assert Choice(dictionary="monomials", size=3).reading().dictionary == "monomials3"
    assert Choice(dictionary="monomials", size=4).reading().dictionary == "gaussian"
    assert Choice(dictionary="gaussian", size=28).reading().dictionary == "gaussian28"
    assert Choice(dictionary="exponentials", size=2).reading().dictionary == "exponentials"
    assert Choice(state="delayed_angles", delays=1).reading().state == "delayed_angles"
    assert Choice(dictionary="gaussian", size=5).reading() == readings.Readings()


def test_a_file_with_the_explorers_former_word_is_still_read():
    assert choice.choice_of({"state": "angles", "delays": 2}) == Choice(state="delayed_angles", delays=2)


@pytest.mark.parametrize("name", ["paper", "smoke", "", "../mine", "a b", "mine.yaml"])
def test_names_that_no_profile_can_have(name, tmp_path):
    with pytest.raises(ChoiceError, match="NAME is"):
        choice.write_parameters(Choice(), name, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_file_of_somebody_else_is_kept_and_ones_own_replaced(tmp_path):
    (tmp_path / "mine.yaml").write_text("01_data_generation: {duration: 1.0}\n")
    with pytest.raises(ChoiceError, match="mine.yaml is not the explorer's"):
        choice.write_parameters(Choice(), "mine", tmp_path)
    assert "duration: 1.0}" in (tmp_path / "mine.yaml").read_text()
    choice.write_parameters(Choice(), "other", tmp_path)
    choice.write_parameters(SMALL, "other", tmp_path)
    assert "duration: 60.0" in (tmp_path / "other.yaml").read_text()


# --- controls ---


def words(widget):
    return re.sub("<[^>]+>", "", widget.value)


@pytest.mark.slow
def test_a_control_changes_picture_numbers_and_message(panel):
    panel.set(SMALL)
    before = panel.picture.value, panel.table.value
    panel.controls["input"].value = "reference"
    assert panel.outcome.choice == SMALL.replaced(input="reference")
    assert panel.picture.value != before[0] and panel.table.value != before[1]
    assert words(panel.message).startswith("N = 9 functions, 5000 snapshot pairs")


def test_a_wrong_choice_greys_the_picture_out_and_says_why(panel):
    panel.set(SMALL)
    before = panel.picture.value, panel.table.value, panel.outcome
    panel.controls["duration"].value = 20.0
    assert "cannot be simulated" in words(panel.message)
    assert (panel.picture.value, panel.table.value, panel.outcome) == before
    assert STALE in panel.result._dom_classes
    assert all(button.disabled for button in panel.further.values())
    panel.controls["duration"].value = 60.0
    assert words(panel.message).startswith("N = 9")
    assert STALE not in panel.result._dom_classes
    assert not any(button.disabled for button in panel.further.values())


def test_the_size_follows_the_dictionary_and_what_has_no_effect_is_grey(panel, monkeypatch):
    monkeypatch.setattr(panel, "redraw", panel._enable)
    panel.set(SMALL.replaced(size=150))
    panel.controls["dictionary"].value = "monomials"
    assert (panel.controls["size"].value, panel.controls["size"].max) == (2, 5)
    disabled = [panel.controls[name].disabled for name in ("width", "strength", "size")]
    assert disabled == [True, True, False]
    panel.controls["regularization"].value = "shrink"
    assert not panel.controls["strength"].disabled
    panel.controls["dictionary"].value = "gaussian"
    assert panel.controls["size"].max == 200 and not panel.controls["width"].disabled
    panel.controls["predictor"].value = "one_step"
    assert panel.controls["field"].disabled


def test_a_change_of_the_dictionary_is_drawn_once(panel, monkeypatch):
    panel.set(SMALL)
    choices = []
    monkeypatch.setattr(panel, "redraw", lambda: choices.append(panel.choice))
    panel.controls["dictionary"].value = "mechanical"
    assert choices == [SMALL.replaced(dictionary="mechanical", size=8)]


def test_examples_are_put_into_the_controls(panel, monkeypatch):
    monkeypatch.setattr(panel, "redraw", lambda: None)
    for _, example in panel.example.options[1:]:
        panel.example.value = example
        assert panel.choice == example
    panel.set(SMALL.replaced(sampling_time=0.025))
    assert panel.choice.sampling_time == 0.025


def test_sliders_act_when_they_are_let_go(panel):
    sliders = [control for control in panel.controls.values() if "Slider" in type(control).__name__]
    assert len(sliders) >= 7 and not any(slider.continuous_update for slider in sliders)


@pytest.mark.slow
@pytest.mark.parametrize("label", FURTHER)
def test_more_about_the_model_is_shown_on_demand_and_goes_with_the_choice(panel, label):
    panel.set(SMALL)
    panel.further[label].click()
    (widget,) = panel.extra.children
    pictures = [each.value for each in (widget, *getattr(widget, "children", ())) if hasattr(each, "format")]
    if label == "the model in words":
        assert "N = 9 functions" in words(widget)
    else:
        assert [picture[:4] for picture in pictures] == [b"GIF8" if "motion" in label else b"\x89PNG"]
    panel.controls["seed"].value = 2
    assert panel.extra.children == ()
    panel.controls["seed"].value = 1


def test_what_cannot_be_shown_says_why(panel, monkeypatch):
    def blind(_):
        raise ValueError("there is no <field>")

    panel.set(SMALL)
    monkeypatch.setitem(FURTHER, "the vector field", blind)
    panel.further["the vector field"].click()
    assert [words(widget) for widget in panel.extra.children] == ["there is no &lt;field&gt;"]


def test_the_button_writes_the_choice(panel):
    panel.set(SMALL)
    assert panel.button.description == "save as params/mine.yaml"
    panel.name.value = "paper"
    assert panel.button.description == "save as params/paper.yaml"
    panel.button.click()
    assert "choose another name" in words(panel.answer)
    panel.name.value = "own-1"
    panel.button.click()
    assert words(panel.answer) == "own-1.yaml is written: make all PROFILE=own-1"
    assert choice.choice_of(yaml.safe_load((panel.folder / "own-1.yaml").read_text())["09_pictures"]["choice"]) == SMALL


@pytest.mark.slow
def test_the_notebook_runs_from_its_own_folder(monkeypatch):
    """Its cells one after the other, without a kernel; test_browser.py does it in JupyterLab."""
    monkeypatch.chdir(ROOT / "notebooks")
    cells = json.loads(Path("explore.ipynb").read_text())["cells"]
    assert "Explorer()" in "".join(cells[-1]["source"])  # *Run All* leaves the reader at the panel
    names = {}
    for cell in cells:
        if cell["cell_type"] == "code":
            exec("".join(cell["source"]), names)
    assert names["explorer"].choice == Choice()
