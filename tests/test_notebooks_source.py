"""The notebooks as they are stored: without results, runnable everywhere, and with the parameters that params/ says."""

import json
import re

import pytest
from conftest import ROOT

from tras.workflow import parameters

NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
STAGES = [path for path in NOTEBOOKS if path.stem[0].isdigit()]  # of make; the others have no section in params/
SET_BY_MAKE = {"data_dir": "data", "figures_dir": "figures"}  # the Makefile gives each profile its own folders
LONGEST = 25  # lines in a cell: longer code belongs into the package

each_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
each_stage = pytest.mark.parametrize("path", STAGES, ids=lambda path: path.stem)


def code_cells(path):
    return [cell for cell in json.loads(path.read_text())["cells"] if cell["cell_type"] == "code"]


def test_there_are_notebooks():
    assert NOTEBOOKS


@each_notebook
def test_stored_without_results(path):
    for cell in code_cells(path):
        assert cell["outputs"] == [] and cell["execution_count"] is None, (
            f"{path.name}: clear all outputs before saving"
        )


@each_notebook
def test_kernel_is_python3(path):
    assert json.loads(path.read_text())["metadata"]["kernelspec"]["name"] == "python3"


@each_notebook
def test_cells_are_short(path):
    for cell in code_cells(path):
        lines = "".join(cell["source"]).splitlines()
        assert len(lines) <= LONGEST, f"{path.name}: {len(lines)} lines in the cell that begins with {lines[0]!r}"


@each_stage
def test_defaults_are_the_papers(path):
    """params/paper.yaml and the `parameters` cell (exactly one, or notebook_defaults complains) say the same."""
    defaults = parameters.notebook_defaults(path)
    assert {name: defaults.pop(name, None) for name in SET_BY_MAKE} == SET_BY_MAKE
    paper = ROOT / "params" / "paper.yaml"
    section = parameters.check_parameters(parameters.read_params(paper, path), defaults, str(paper))
    assert section == defaults


@each_stage
@pytest.mark.parametrize("params", sorted((ROOT / "params").glob("*.yaml")), ids=lambda path: path.stem)
def test_every_profile_fits(path, params):
    parameters.check_parameters(parameters.read_params(params, path), parameters.notebook_defaults(path), str(params))


@each_notebook
def test_links_lead_somewhere(path):
    """Of the text, to files of this project, from the notebook's own folder."""
    text = "".join(
        "".join(cell["source"]) + "\n"
        for cell in json.loads(path.read_text())["cells"]
        if cell["cell_type"] == "markdown"
    )
    places = [place for place in re.findall(r"\]\(([^)#]+)", text) if "://" not in place]
    assert [place for place in places if not (path.parent / place).exists()] == []


@each_notebook
def test_every_notebook_says_what_it_does_and_links_paper_or_code(path):
    first = "".join(json.loads(path.read_text())["cells"][0]["source"])
    assert (
        first.startswith("# ") and "**What it does.**" in first and ("**Follows**" in first or path.stem == "explore")
    )
    assert "../tras/" in first, f"{path.name}: link the code that it stands on"
