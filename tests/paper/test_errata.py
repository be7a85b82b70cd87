"""Every error of the paper is shown by a computation, and the page holds what was computed."""

import pytest

from tras.paper import errata, pages
from tras.twin_rotor.plant import PlantParameters, PrintedPlant
from tras.workflow import files


@pytest.fixture(scope="module")
def table():
    return errata.table()


def test_every_error_is_shown(table):
    """None stands for the one entry that is about numbering, where there is nothing to compute."""
    assert list(table["shown"]).count(None) == 1
    assert all(shown is None or shown is True for shown in table["shown"])
    assert len(table) == len(errata.ERRORS) and table["evidence"].str.len().min() > 20


def test_the_page_holds_what_was_computed(table):
    page = (files.project_root() / "docs" / "paper.md").read_text(encoding="utf-8")
    assert errata.markdown(table) in page, "run make readme"


def test_energy_is_gained_by_the_printed_term_alone():
    (printed, whole), (ours, _) = (errata.energy_gained(plant, 5.0) for plant in (PrintedPlant(), PlantParameters()))
    assert printed > 0.1 * whole and ours < 1e-9 * whole


def test_a_repaired_error_would_be_noticed(monkeypatch):
    """The checks can fail: with the corrected plant in the printed one's place nothing is shown."""
    monkeypatch.setattr(errata, "PrintedPlant", PlantParameters)
    assert errata.velocity_term()[1] is False


def test_every_reference_names_a_later_equation_than_it_uses():
    assert all(meant < printed <= 18 for _, printed, meant in errata.REFERENCES)


def test_masses_in_the_wrong_places_would_be_noticed(monkeypatch):
    """The check can fail: a plant that gravity does not act on has neither energy."""
    monkeypatch.setattr(PlantParameters, "energy", lambda self, x: 0.0 * x[:, 0])
    assert errata.counterweights()[1] is False


def test_command_line_writes_between_the_markers(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(errata, "ERRORS", errata.ERRORS[9:11])
    page, (begin, end) = tmp_path / "docs" / "paper.md", pages.markers("errors")
    call = ["errors", "--write", f"--pages={tmp_path}"]
    page.parent.mkdir()
    page.write_text(f"before\n{begin}\nold\n{end}\nafter\n")
    assert pages.main(call) == 0
    assert "50001" in page.read_text() and "old" not in page.read_text() and page.read_text().startswith("before\n")
    page.write_text("no markers")
    assert pages.main(call) == 2 and "must hold" in capsys.readouterr().err
    assert pages.main([*call[:2], f"--pages={tmp_path / 'none'}"]) == 2
    assert "paper.md cannot be read" in capsys.readouterr().err
    assert [path.name for path in page.parent.iterdir()] == ["paper.md"]
