"""docs/own_rig.md: its commands run as they stand there, in a copy of the checkout."""

import hashlib
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree

import numpy as np
import pandas as pd
import pytest
from conftest import HOSTILE, ROOT, checkout_in, code_blocks, for_make

import tras
from tras.identification import command
from tras.workflow.parameters import ParameterError
from tras.workflow.results import LISTING

PAGE = (ROOT / "docs" / "own_rig.md").read_text()
NAME = "{http://www.w3.org/1999/xhtml}"


@pytest.fixture(scope="module")
def checkout(tmp_path_factory):
    """What make needs, with this environment; the commands of the page have run in it."""
    folder = tmp_path_factory.mktemp("checkout")
    return checkout_in(folder, "tras", "notebooks", commands=code_blocks(PAGE, "sh"))


def make(folder, *arguments):
    """`make identify` with these arguments."""
    return subprocess.run(["make", "identify", *arguments], cwd=folder, env=for_make(), capture_output=True, text=True)


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
    assert len(images) == 10 and all(source.startswith("data:image/") for source in images)
    assert [h.text for h in tree.iter(f"{NAME}h2")][1:] == [
        "In short",
        "The recording",
        "How well it predicts",
        "Step and frequency response",
        "The operator",
        "Files",
        "How the model was chosen",
    ]
    assert "://" not in text.replace("http://www.w3.org/", "")


@pytest.mark.slow
def test_the_python_of_the_page(checkout, monkeypatch, capsys):
    monkeypatch.chdir(checkout)
    names = {}
    for block in code_blocks(PAGE, "python"):
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


def unnamed_log(path):
    """A first-order system under steps, its columns called foo and bar."""
    u = np.repeat(np.random.default_rng(0).uniform(-1, 1, 30), 20)
    y = np.zeros(600)
    for k in range(599):
        y[k + 1] = 0.95 * y[k] + 0.05 * u[k]
    pd.DataFrame({"stamp": np.arange(600) * 20, "foo": y, "bar": u}).to_csv(path, index=False)


@pytest.mark.slow
def test_the_command_of_the_question_can_be_pasted(checkout, tmp_path):
    for i in (1, 2, 3):
        unnamed_log(tmp_path / f"it's {i}.csv")
    out, options = tmp_path / "out", ["DRAWS=0", "DELAYS=0", "SMOOTHING=no", "PREDICTOR=one_step", "TEST=2", "FROM=1"]
    done = make(checkout, f"RECORDING={tmp_path}/it*.csv", f"OUT={out}", *options)
    assert done.returncode == 2 and "no column is plainly an input" in done.stderr and not out.exists()
    line = next(line for line in done.stderr.split("\n") if "make identify" in line)
    pasted = shlex.split(line)
    assert set(pasted) >= {"TIME=stamp", "STATES=foo", "INPUTS=bar", f"OUT={out}", "FROM=1.0", *options[:-1]}
    done = make(checkout, *pasted[2:])
    assert done.returncode == 0, done.stderr
    text = (out / "report.html").read_text(encoding="utf-8")
    assert "stamp is in ms" in text and "3 trajectories of 550 samples at 0.02 s" in text


def test_files_of_the_command_line(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("a.csv", "b 1.csv", "b 2.csv"):
        (tmp_path / name).touch()
    names = lambda text, what="RECORDING": [str(path) for path in command._files(what, text)]  # noqa: E731
    assert names("b 1.csv") == ["b 1.csv"] and names("a.csv 'b 1.csv'") == ["a.csv", "b 1.csv"]
    assert names("b*.csv") == ["b 1.csv", "b 2.csv"] and names("it's") == ["it's"] and names("") == []
    assert command._files("TEST", "2,5") == ["2", "5"] and names("2 a.csv", "TEST") == ["2", "a.csv"]
    with pytest.raises(ParameterError, match="RECORDING: no file matches c"):
        names("c*.csv")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["a.csv b.csv"], "RECORDING: b.csv does not exist"),
        (["a.csv", "--test", "b.csv"], "TEST: b.csv does not exist"),
        (["a.csv a.xyz"], "RECORDING: a.xyz ends in '.xyz'; recordings are .nc"),
        (["a.csv", "--roles", "r.yaml"], "ROLES: r.yaml does not exist"),
        (["'*.xls'"], "does not exist|no file"),
    ],
)
def test_wrong_files_are_a_sentence_before_anything_runs(arguments, words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.csv").touch()
    (tmp_path / "a.xyz").touch()
    assert command.main(arguments) == 2
    assert re.search(words, capsys.readouterr().err)


def test_names_with_commas_and_none():
    assert command._names('a, "b,c" ,d e') == ["a", "b,c", "d e"] and command._names("") == []


@pytest.fixture
def alone(tmp_path):
    """A folder with the Makefile and, in place of Python, a script that prints its arguments; it stands for .venv."""
    for name in ("environment.txt", "environment-build.txt"):
        (tmp_path / name).write_text("a lock\n")
    shutil.copy(ROOT / "Makefile", tmp_path)
    python = tmp_path / ".venv" / "bin" / "python"
    python.parent.mkdir(parents=True)
    python.write_text("#!/bin/sh\nprintf '%s\\0' \"$@\"\n")
    python.chmod(0o755)
    locked = hashlib.sha256(b"a lock\na lock\n").hexdigest()[:12]
    (tmp_path / ".venv" / f".ready-{locked}").touch()
    return tmp_path


def arguments_of(folder, *words, **variables):
    """What `make identify` hands to the command."""
    command_line = ["make", "identify", *words]
    done = subprocess.run(command_line, cwd=folder, env=for_make() | variables, capture_output=True)
    assert done.returncode == 0 and not done.stderr, done.stderr
    return done.stdout.decode().split("\0")[2:-1]  # after -m and the module


def test_variables_of_the_environment_are_no_options(alone):
    everything = dict.fromkeys(command_variables(), "no.csv") | {"RECORDING": "no.csv"}
    assert arguments_of(alone, "RECORDING=a.csv", "TO=5", **everything) == ["--to=5", "--", "a.csv"]
    environment = {**os.environ, "RECORDING": "a.csv"}
    done = subprocess.run(["make", "identify"], cwd=alone, env=environment, capture_output=True, text=True)
    assert done.returncode == 2 and "say which recording" in done.stderr


def command_variables():
    return re.search(r"^IDENTIFY := (.*)", (ROOT / "Makefile").read_text(), re.MULTILINE)[1].split()


def test_every_variable_of_make_is_an_option(alone):
    words = arguments_of(alone, "RECORDING=a.csv", *(f"{name}=1" for name in command_variables()))
    options = {option for action in command._parser("")._actions for option in action.option_strings}
    assert words[-2:] == ["--", "a.csv"]
    assert sorted(words[:-2]) == sorted(f"--{name.lower()}=1" for name in command_variables())
    assert {word.removesuffix("=1") for word in words[:-2]} == options - {"-h", "--help"}


def test_make_takes_text_as_it_is_typed(alone):
    """`a$b.csv` is that file, $(shell ...) is not run, a line's end ends nothing."""
    before = sorted(alone.rglob("*"))
    for text in [*HOSTILE, "a$b.csv", "$$", "$(shell touch PWNED).csv", "${shell touch PWNED}", "$(eval X := 1)", "$"]:
        text = text.lstrip()  # make takes blanks at the beginning away
        if text.strip():
            words = arguments_of(alone, f"RECORDING={text}", f"STATES={text}", f"OUT={text}")
            assert words == [f"--out={text}", f"--states={text}", "--", text]
    assert sorted(alone.rglob("*")) == before


def test_an_interpreter_that_is_gone_is_not_ready(alone):
    python = alone / ".venv" / "bin" / "python"
    for replace in (python.unlink, lambda: python.symlink_to("/nonexistent/python")):
        replace()
        words = ["make", "-n", "identify", "RECORDING=a.csv"]
        done = subprocess.run(words, cwd=alone, capture_output=True, text=True)
        assert "Creating .venv" in done.stdout


@pytest.fixture
def started(monkeypatch):
    """Runs that got as far as the notebook: the folder of each."""
    folders = []
    monkeypatch.setattr(command, "_run", lambda out, parameters, root: folders.append(out) or (0.0, "q 1 %"))
    return folders


def leave_results(folder, recording, *, finished=True):
    """A folder as `make identify` leaves it."""
    folder.mkdir(parents=True)
    (folder / "report.html").touch()
    (folder / LISTING).write_text(f"file\nreport.html\n{LISTING}\n")
    if finished:
        (folder / "identify.json").write_text(json.dumps({"parameters": {"recording": recording}}))


def test_results_do_not_replace_files_of_others(tmp_path, monkeypatch, capsys, started):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command, "working_folder", lambda: tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    for name in (
        "run1/log.csv",
        "run2/log.csv",
        "home/.keep",
        "mine/report.html",
        "mine/notes.txt",
        "listed/contents.csv",
    ):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("file\nother.txt\n")
    (tmp_path / "empty").mkdir()
    leave_results(tmp_path / "build" / "identify" / "log", ["run1/log.csv"])
    leave_results(tmp_path / "killed", [], finished=False)
    (tmp_path / "killed" / "my notes.txt").touch()
    for folder, words in {
        "/": "no folder for results", "~": "no folder for results", "home": "no folder for results",
        "mine": "holds files of others, such as notes.txt; give a new folder, such as OUT=mine/results",
        "listed": "holds files of others, such as contents.csv", ".": "holds files of others",
        "run2/log.csv": "is a file",
    }.items():  # fmt: skip
        assert command.main(["run1/log.csv", "--out", folder]) == 2
        assert words in capsys.readouterr().err and not started
    for folder in ("new", "new/below", "empty", "killed"):
        assert command.main(["run1/log.csv", "--out", folder]) == 0
    assert (
        command.main(["run1/log.csv"]) == 0
        and command.main(["run2/log.csv run1/log.csv", "--out", str(started[-1])]) == 0
    )
    capsys.readouterr()
    count = len(started)
    assert command.main(["run2/log.csv"]) == 2 and len(started) == count == 6
    told = capsys.readouterr().err
    assert "holds the results of run1/log.csv; give another folder" in told
    assert f"OUT={tmp_path / 'build' / 'identify' / 'run2_log'}" in told
    assert (tmp_path / "mine" / "report.html").read_text() == "file\nother.txt\n"


def test_the_command_itself_starts_light():
    """The notebook's kernel loads what computes; the command beside it, which waits, loads it in vain."""
    code = (
        "import sys, tras.identification.command; print(sorted({'pandas', 'scipy', 'matplotlib'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
