"""docs/own_rig.md: its commands run as they stand there, in a copy of the checkout."""

import os
import re
import shutil
import subprocess
import xml.etree.ElementTree as ElementTree

import pandas as pd
import pytest
from conftest import ROOT

import tras

PAGE = (ROOT / "docs" / "own_rig.md").read_text()
NAME = "{http://www.w3.org/1999/xhtml}"


def blocks(language):
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE, flags=re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def checkout(tmp_path_factory):
    """What make needs, with this environment; the commands of the page have run in it."""
    if not list((ROOT / ".venv").glob(".ready-*")):
        pytest.skip("make setup has not run")
    folder = tmp_path_factory.mktemp("checkout")
    for name in ("Makefile", "pyproject.toml", "environment.txt", "environment-build.txt"):
        shutil.copy(ROOT / name, folder)
    for name in ("tras", "notebooks"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    (folder / ".venv").symlink_to(ROOT / ".venv")
    environment = {key: value for key, value in os.environ.items() if not key.startswith(("MAKE", "MFLAGS"))}
    for block in blocks("sh"):
        done = subprocess.run(["bash", "-e", "-c", block], cwd=folder, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
    return folder


def make(folder, *arguments):
    """`make identify` with these arguments."""
    environment = {key: value for key, value in os.environ.items() if not key.startswith(("MAKE", "MFLAGS"))}
    return subprocess.run(["make", "identify", *arguments], cwd=folder, env=environment, capture_output=True, text=True)


@pytest.mark.slow
def test_everything_is_there(checkout):
    for name, n in (("duffing", 2), ("position", 1)):
        folder = checkout / "build" / "identify" / name
        listed = pd.read_csv(folder / "contents.csv")["file"]
        assert all((folder / path).is_file() for path in listed)
        assert {
            "report.html",
            "model.npz",
            "export/model.c",
            "export/model.mat",
            "export/model_step.m",
            "export/formulas.txt",
            "tables/metrics.csv",
        } <= set(listed)
        assert (folder / "identify.ipynb").is_file() and (folder / "identify.json").is_file()
        metrics = pd.read_csv(folder / "tables" / "metrics.csv").set_index(["prediction", "state"])["nrmse"]
        assert len(metrics["model"]) == n
        assert (metrics["model"] < 0.25 * metrics["linear model"]).all() and (metrics["model"] < 1).all()
    assert not list((checkout / "build" / "identify").glob(".*"))  # nothing temporary


def test_the_page_is_whole_and_needs_no_network(checkout):
    text = (checkout / "build" / "identify" / "duffing" / "report.html").read_text(encoding="utf-8")
    tree = ElementTree.fromstring(text.removeprefix("<!DOCTYPE html>\n"))
    images = [image.get("src") for image in tree.iter(f"{NAME}img")]
    assert len(images) == 5 and all(source.startswith("data:image/") for source in images)
    assert [h.text for h in tree.iter(f"{NAME}h2")][1:] == [
        "In short",
        "The recording",
        "How the model was chosen",
        "How well it predicts",
        "The operator",
        "Files",
    ]
    assert "://" not in text.replace("http://www.w3.org/", "")


@pytest.mark.slow
def test_the_python_of_the_page(checkout, monkeypatch, capsys):
    monkeypatch.chdir(checkout)
    names = {}
    for block in blocks("python"):
        exec(block, names)  # noqa: S102
    assert names["states"].shape == (501, 2) and (names["lower"] <= names["upper"]).all()
    assert "Advice" in capsys.readouterr().out


def test_the_commands_result_is_that_of_the_function(checkout):
    """The notebook adds nothing and loses nothing."""
    model = tras.load_model(checkout / "build" / "identify" / "duffing" / "model.npz")
    log = tras.Recording.read(checkout / "build" / "example" / "duffing.csv")
    assert model.state_names_ == ("q", "qdot") and model.input_names_ == ("force",) and model.dt_ == log.dt


@pytest.mark.parametrize(
    ("content", "arguments", "words"),
    [
        (None, [], "RECORDING: .*a.csv does not exist"),
        ("t,q,u\n0,1,0\n1,1,0\n2.5,1,1\n", [], "steps differ .* With make: RESAMPLE="),
        ("t,q,u\n0,1,0\n1,2,0\n2,1,1\n", ["DELAYS=1;x"], "holds no whole numbers"),
    ],
)
@pytest.mark.slow
def test_a_wrong_recording_is_a_sentence_and_leaves_nothing(content, arguments, words, checkout, tmp_path):
    path = tmp_path / "it's" / "a.csv"
    path.parent.mkdir()
    if content:
        path.write_text(content)
    done = make(checkout, f"RECORDING={path}", f"OUT={tmp_path / 'out'}", *arguments)
    assert done.returncode == 2 and re.search(words, done.stderr), done.stderr
    assert "Traceback" not in done.stderr and done.stdout == ""
    assert [each.name for each in tmp_path.iterdir()] == ["it's"]


def test_without_a_recording(checkout):
    done = make(checkout)
    assert done.returncode == 2 and "say which recording" in done.stderr
