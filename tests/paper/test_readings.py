"""Every open point of the paper is an option with a default; what it does not know is refused in one sentence."""

import re

import pytest
import yaml
from conftest import ROOT

from tras.paper import pages, readings
from tras.paper.readings import OPTIONS, ReadingError, Readings

ALL = [(option, choice) for option in OPTIONS for choice in readings.choices(option)]


def test_the_defaults_are_the_first_choices():
    assert Readings().model_dump() == {option: next(iter(meanings)) for option, (_, meanings) in OPTIONS.items()}
    assert Readings().model_dump() == {
        "input": "reference", "frequency_unit": "rad/s", "dictionary": "gaussian", "state": "four_states",
        "horizon": "window", "nrmse_range": "validation_set", "velocity_term": "corrected", "start": "on_reference",
        "gains": "default", "plant": "TRAS-A", "angle_names": "words",
    }  # fmt: skip


@pytest.mark.parametrize("option, choice", ALL)
def test_every_choice_is_taken_and_remembered(option, choice):
    for reading in (Readings(**{option: choice}), Readings().replaced(**{option: choice})):
        assert getattr(reading, option) == choice


WRONG = [
    ({"input": "torques"}, "input is 'torques': did you mean 'torque'?"),
    ({"frequency_unit": "hertz"}, "frequency_unit is 'hertz': choose one of rad/s, Hz."),
    ({"dictionary": "monomial2"}, "dictionary is 'monomial2': did you mean 'monomials2'?"),
    ({"state": None}, "state is None: choose one of four_states, delayed_angles."),
    ({"horizon": 6}, "horizon is 6: choose one of window, trajectory, free_run."),
    ({"nrmse_range": "trajectories"}, "nrmse_range is 'trajectories': did you mean 'trajectory'?"),
    ({"velocity_term": "printed"}, "velocity_term is 'printed': did you mean 'as_printed'?"),
    ({"angle_names": ["words"]}, "angle_names is ['words']: did you mean 'words'?"),
    ({"inputs": "torque"}, "there is no reading 'inputs': did you mean 'input'?"),
    ({"colour": "red"}, "there is no reading 'colour': choose one of input, frequency_unit, "),
]


@pytest.mark.parametrize("choices, sentence", WRONG)
def test_what_does_not_exist_is_refused_in_one_sentence(choices, sentence):
    for call in (lambda: Readings(**choices), lambda: Readings().replaced(**choices)):
        with pytest.raises(ReadingError, match=re.escape(sentence)) as caught:
            call()
        assert isinstance(caught.value, ValueError) and "\n" not in str(caught.value)


def test_frozen():
    reading = Readings()
    with pytest.raises(ReadingError, match="input cannot be changed in place"):
        reading.input = "torque"
    assert reading.input == "reference" and hash(reading) == hash(Readings())


def test_yaml_there_and_back(tmp_path):
    reading = Readings(input="torque", frequency_unit="Hz", dictionary="monomials3", angle_names="symbols")
    (tmp_path / "readings.yaml").write_text(yaml.safe_dump(reading.model_dump()))
    assert readings.read_yaml(tmp_path / "readings.yaml") == reading


def test_yaml_by_section_and_with_defaults(tmp_path):
    path = tmp_path / "p.yaml"
    path.write_text("study:\n  default:\n    input: torque\nempty:\n")
    assert readings.read_yaml(path, "study", "default") == Readings(input="torque")
    assert readings.read_yaml(path, "empty") == Readings()
    assert readings.read_yaml(ROOT / "params" / "paper.yaml", "06_readings", "default") == Readings()


@pytest.mark.parametrize("content, sections, words", [
    ("input: torques\n", (), "input is 'torques': did you mean 'torque'"),
    ("inputs: torque\n", (), "there is no reading 'inputs'"),
    ("1: torque\n", (), "there is no reading '1'"),
    ("- input\n", (), "holds a list: write one `option: choice` per line"),
    ("input: torque\ninput: reference\n", (), "`input` stands twice"),
    ("input: [\n", (), "is not valid YAML"),
    ("readings:\n  input: torque\n", ("reading",), "has no section 'reading': did you mean 'readings'"),
])  # fmt: skip
def test_mistakes_in_yaml_name_the_file(tmp_path, content, sections, words):
    path = tmp_path / "mine.yaml"
    path.write_text(content)
    with pytest.raises(ReadingError, match="mine.yaml") as caught:
        readings.read_yaml(path, *sections)
    assert words in str(caught.value) and "\n" not in str(caught.value)
    with pytest.raises(ReadingError, match="none.yaml cannot be read"):
        readings.read_yaml(tmp_path / "none.yaml")


def test_the_table_holds_every_choice_with_the_papers_words():
    table = readings.table()
    assert list(zip(table["option"], table["choice"])) == ALL
    assert table.groupby("option")["default"].sum().eq(1).all() and table["meaning"].str.len().min() > 10
    assert table["paper"].nunique() == len(OPTIONS)
    text = readings.markdown()
    assert len(text.splitlines()) == 2 + len(OPTIONS) and all(f"`{choice}`" in text for _, choice in ALL)


def test_the_command_writes_the_table_and_names_what_is_missing(tmp_path, capsys):
    document, (begin, end) = tmp_path / "docs" / "paper.md", pages.markers("readings")
    document.parent.mkdir()
    document.write_text(f"before\n{begin}\nold\n{end}\nafter\n")
    call = ["readings", "--write", f"--pages={tmp_path}"]
    assert pages.main(call) == 0 == pages.main(call)
    assert document.read_text() == f"before\n{begin}\n{readings.markdown()}\n{end}\nafter\n"
    document.write_text("no markers")
    assert pages.main(call) == 2 == pages.main([*call[:2], f"--pages={tmp_path / 'none'}"])
    errors = capsys.readouterr().err
    assert "paper.md must hold '<!-- readings" in errors and "none/docs/paper.md cannot be read" in errors


def test_the_documentation_holds_the_table():
    """docs/paper.md, "What the text leaves open": written by `make readme`."""
    assert readings.markdown() in (ROOT / "docs" / "paper.md").read_text(encoding="utf-8")
