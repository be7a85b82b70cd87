"""CITATION.cff: this version, a day, and the paper as far as it is known."""

import datetime
import re
import tomllib

import yaml
from conftest import ROOT

import tras

CITATION = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def test_version_and_license_are_those_of_the_package():
    assert CITATION["version"] == tras.__version__
    assert CITATION["license"] == PROJECT["license"]
    assert [author["name"] for author in CITATION["authors"]] == [author["name"] for author in PROJECT["authors"]]


def test_the_day_is_that_of_the_changelog():
    """Once the version has a section there; until then a day."""
    day = CITATION["date-released"]
    assert isinstance(day, datetime.date)
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    days = re.findall(rf"^## \[?{re.escape(CITATION['version'])}\]? - (\S+)", changelog, re.MULTILINE)
    assert days in ([], [day.isoformat()])


def test_the_paper_is_the_one_that_the_readme_names():
    (paper,) = CITATION["references"]
    assert paper["type"] == "article"
    readme = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    assert f"*{paper['title']}*" in readme
    assert {"type", "title", "authors"} <= set(paper)  # what the format asks of a reference
