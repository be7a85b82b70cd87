"""The runner: what it refuses, what it leaves behind, and what it never leaves behind."""

import datetime
import hashlib
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import nbformat
import pytest
from conftest import ROOT

from tras.workflow import files, parameters, provenance, runner

DEFAULTS = """\
seed = 1
duration: float = 500.0
clip = True
kind = "torque"
lags = [1, 2]
gains = {"phi": 1.0, "psi": 2.0}
anything = None
seeds = [1]
"""


def write_notebook(path, *sources, tagged=(0,)):
    """A notebook of code cells; those whose number is in `tagged` are parameters cells."""
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    notebook = nbformat.v4.new_notebook(metadata={"kernelspec": kernel})
    for number, source in enumerate(sources):
        metadata = {"tags": ["parameters"]} if number in tagged else {}
        notebook.cells.append(nbformat.v4.new_code_cell(source, metadata=metadata))
    path.parent.mkdir(exist_ok=True)
    nbformat.write(notebook, path)
    return path


@pytest.fixture
def notebook(tmp_path):
    return write_notebook(tmp_path / "notebooks" / "01_stage.ipynb", DEFAULTS, "print(seed)")


def run(notebook, *arguments):
    """Run in this process; the executed notebook goes to build/."""
    executed = notebook.parent.parent / "build" / notebook.name
    return runner.main([str(notebook), str(executed), *map(str, arguments)]), executed


# --- parameters: nothing is started for a wrong one ---

MISTAKES = [
    ("durration: 3.0", r"no parameter `durration`: did you mean 'duration'\?"),
    ("zzz: 3.0", r"no parameter `zzz`: choose one of seed, duration, clip"),
    ("seed: 1.5", r"`seed` must be a whole number \(its default is 1\), found 1.5 \(number\)"),
    ("seed: true", r"`seed` must be a whole number .* found True \(true or false\)"),
    ("seed: -1", r"`seed` is -1: a seed must be 0 or more"),
    ("seeds: [1, -2]", r"`seeds` is \[1, -2\]: a seed must be 0 or more"),
    ("seed: null", r"`seed` must be a whole number .* found None"),
    ("duration: 1e-6", r"found '1e-6' \(text\): YAML takes 1e-6 for text, write 1.0e-6 without quotes"),
    ("duration: '12'", r"YAML takes 12 for text, write 12 without quotes"),
    ("duration: long", r"`duration` must be a number .* found 'long' \(text\)"),
    ("clip: 'false'", r"`clip` must be a true or false .* write true or false, without quotes"),
    ("clip: 1", r"`clip` must be a true or false"),
    ("kind: no", r"`kind` must be a text .* found False .* put it in quotes"),
    ("kind: 2020-01-01", r"`kind` must be a text .* put it in quotes"),
    ("lags: 3", r"`lags` must be a list"),
    ("lags: [1, two]", r"`lags`\[1\] must be a whole number"),
    ("gains: {phi: x}", r"`gains`\[phi\] must be a number"),
    ("seed: 1\n  seed: 2", r"`seed` stands twice"),
    ("seed: [1", r"not valid YAML at line"),
    ("- 1", r"section `01_stage` of .* is a list"),
]


@pytest.mark.parametrize("section, message", MISTAKES, ids=[section.split("\n")[0] for section, _ in MISTAKES])
def test_wrong_parameters_are_refused_in_one_sentence(notebook, section, message, capsys):
    params = notebook.parent / "params.yaml"
    params.write_text(f"01_stage:\n  {section}\n")
    code, executed = run(notebook, "--params", params)
    error = capsys.readouterr().err
    assert code == 2
    assert not executed.parent.exists()
    assert len(error.strip().splitlines()) == 1
    assert re.search(message, error), error


def test_right_parameters_pass_with_the_defaults_types():
    defaults = {"x": 1.0, "seed": 1, "free": None, "lags": [1, 2.5], "gains": {"phi": 1.0}, "empty": []}
    values = {"x": 2, "free": "a", "lags": [3, 4, 5], "gains": {"phi": 3, "other": 4}, "empty": ["a", 1]}
    checked = parameters.check_parameters(values, defaults, "here")
    assert checked == values
    assert [type(value) for value in (checked["x"], checked["gains"]["phi"], checked["gains"]["other"])] == [float] * 3


CALLS = [
    (["--params", "none.yaml"], r"none.yaml cannot be read"),
    (["--set", "seed"], r"--set seed is not understood: write --set name=value"),
    (["--set", "sed=3"], r"no parameter `sed`: did you mean 'seed'"),
    (["--set", "duration=1e3"], r"write 1.0e\+3 without quotes"),
]


@pytest.mark.parametrize("arguments, message", CALLS)
def test_wrong_calls_are_refused(notebook, arguments, message, capsys):
    code, executed = run(notebook, *arguments)
    assert code == 2 and not executed.exists()
    assert re.search(message, capsys.readouterr().err)


def test_a_section_without_a_notebook_is_refused(notebook, capsys):
    params = notebook.parent / "params.yaml"
    params.write_text("01_stag:\n  seed: 1\n")
    assert run(notebook, "--params", params)[0] == 2
    assert "no such notebook: did you mean '01_stage'?" in capsys.readouterr().err


NOTEBOOKS = [
    (["seed = 1"], (), r"has no cell tagged `parameters`"),
    (["seed = 1", "dt = 2"], (0, 1), r"has 2 cells tagged `parameters`"),
    (["dt = 1 / 100"], (0,), r"holds `dt = 1 / 100`: only assignments"),
    (["import numpy"], (0,), r"holds `import numpy`"),
    (["a = b = 1"], (0,), r"holds `a = b = 1`"),
    (["a = (1, 2)"], (0,), r"holds `a = \(1, 2\)`"),
    (["a ="], (0,), r"is not Python \(line 1"),
]


@pytest.mark.parametrize("sources, tagged, message", NOTEBOOKS)
def test_wrong_parameters_cells_are_refused(tmp_path, sources, tagged, message):
    notebook = write_notebook(tmp_path / "a.ipynb", *sources, tagged=tagged)
    with pytest.raises(parameters.ParameterError, match=message):
        parameters.notebook_defaults(notebook)


def test_a_missing_or_broken_notebook_is_refused(tmp_path):
    with pytest.raises(parameters.ParameterError, match="cannot be read"):
        parameters.notebook_defaults(tmp_path / "none.ipynb")
    (tmp_path / "broken.ipynb").write_text("{")
    with pytest.raises(parameters.ParameterError, match="is not a notebook"):
        parameters.notebook_defaults(tmp_path / "broken.ipynb")


# --- runs ---


@pytest.mark.slow
def test_fail_repair_succeed(tmp_path, capsys):
    """One stage through its life: a cell fails, an output is not written, success, and nothing left of the failures."""
    path = tmp_path / "notebooks" / "01_stage.ipynb"
    output = tmp_path / "data" / "x.txt"
    build = tmp_path / "build"

    write_notebook(path, "n = 1.0", "before = 1", "1 / 0  # here", "print('never')")
    code, executed = run(path, "--outputs", output)
    error = capsys.readouterr().err
    assert code == 1 and "failed in cell [3]: ZeroDivisionError: division by zero" in error
    assert "    1 / 0  # here" in error
    assert str(build / "01_stage.failed.ipynb") in error
    assert [file.name for file in build.iterdir()] == ["01_stage.failed.ipynb"]

    write_notebook(path, "n = 1.0", "n")
    output.write_text("from before")
    os.utime(output, (1, 1))
    assert run(path, "--outputs", output)[0] == 1
    assert f"{output} is still the one from before" in capsys.readouterr().err
    assert not executed.exists()

    write_notebook(path, "n = 1.0", f"import os; open({str(output)!r}, 'w').write(str(n)); os.getcwd()")
    assert run(path, "--outputs", output, "--set", "n=3")[0] == 0
    first, last = capsys.readouterr().out.splitlines()
    assert first == "01_stage begins" and last.startswith("01_stage  ")
    assert output.read_text() == "3.0"  # an integer for a float is a float
    assert sorted(file.name for file in build.iterdir()) == ["01_stage.ipynb", "01_stage.json"]
    cell = nbformat.read(executed, 4).cells[-1]
    assert cell.outputs[0].data["text/plain"] == repr(str(path.parent))  # as in JupyterLab
    runner.run_notebook(path, executed, cwd=path.parent.parent)
    assert nbformat.read(executed, 4).cells[-1].outputs[0].data["text/plain"] == repr(str(path.parent.parent))
    assert run(path, "--outputs", output, "--set", "n=3")[0] == 0

    record = json.loads((build / "01_stage.json").read_text())
    assert record["parameters"] == {"n": 3.0}
    assert record["git"] == {"revision": None, "dirty": None, "changed": None}
    assert record["outputs"][str(output)]["size"] == 3
    assert record["packages"]["numpy"] and record["variables"]["OPENBLAS_NUM_THREADS"]


WRITES = """\
import pathlib
for path in {paths!r}:
    pathlib.Path(path).write_text(str(seed))
"""


@pytest.mark.slow
def test_provenance_lies_beside_each_artefact(tmp_path, capsys):
    outputs = [tmp_path / "data" / "a.csv", tmp_path / "data" / "models" / "a.npz", tmp_path / "figures" / "a.csv"]
    writing = WRITES.format(paths=list(map(str, outputs)))
    path = write_notebook(tmp_path / "notebooks" / "a.ipynb", "seed = 1\nn = 2.0", writing)
    leftover = tmp_path / "data" / ".a.abcd1234.csv"  # by a run that was killed
    others = tmp_path / "data" / ".b.abcd1234.csv"
    for file in (leftover, others):
        file.parent.mkdir(exist_ok=True)
        file.touch()
    assert run(path, "--set", "seed=7", "--outputs", *outputs)[0] == 0
    assert not leftover.exists() and others.exists()
    for output in outputs:
        beside = json.loads((output.parent / "provenance" / f"{output.name}.json").read_text())
        assert beside["artefact"] == str(output) and beside["notebook"] == str(path)
        assert beside["sha256"] == hashlib.sha256(b"7").hexdigest() and output.read_text() == "7"
        assert beside["parameters"] == {"seed": 7, "n": 2.0} and beside["seeds"] == {"seed": 7}
        assert beside["packages"]["scipy"] and beside["python"] and beside["platform"] and beside["processor"]
        assert datetime.datetime.fromisoformat(beside["started"]).utcoffset() is not None and 0 < beside["seconds"] < 60
    first = (outputs[0].parent / "provenance" / "a.csv.json").read_text()
    assert run(path, "--outputs", *outputs)[0] == 0
    second = json.loads((outputs[0].parent / "provenance" / "a.csv.json").read_text())
    assert json.loads(first)["seeds"] == {"seed": 7} and second["seeds"] == {"seed": 1}
    write_notebook(path, "seed = 1", "1 / 0")
    assert run(path, "--outputs", *outputs)[0] == 1
    record = outputs[0].parent / "provenance" / "a.csv.json"
    assert not record.exists()  # it would speak of a run that was not this file's last


def test_the_state_of_git(tmp_path):
    assert provenance.git_state(tmp_path) == {"revision": None, "dirty": None, "changed": None}
    git = ["git", "-c", "user.name=a", "-c", "user.email=a@example.org", "-C", str(tmp_path)]
    (tmp_path / "figures").mkdir()
    for name in ("a.py", "figures/plot 1.png"):
        (tmp_path / name).write_text("1")
    for command in (["init", "-q"], ["add", "."], ["commit", "-qm", "first"]):
        subprocess.run([*git, *command], check=True)
    clean = provenance.git_state(tmp_path)
    assert re.fullmatch("[0-9a-f]{40}", clean["revision"]) and clean["dirty"] is False and clean["changed"] == []
    output = tmp_path / "figures" / "plot 1.png"
    output.write_text("2")
    assert provenance.git_state(tmp_path / "figures", [output]) == clean  # what the run itself writes
    assert provenance.git_state(tmp_path)["changed"] == ["figures/plot 1.png"]
    (tmp_path / "a.py").write_text("2")
    assert provenance.git_state(tmp_path, [output]) == clean | {"dirty": True, "changed": ["a.py"]}


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.slow
def test_an_interrupted_run_leaves_nothing_under_the_final_name(tmp_path, number):
    started, executed = tmp_path / "started", tmp_path / "build" / "a.ipynb"
    code = f"import os, pathlib\npathlib.Path({str(started)!r}).write_text(str(os.getpid()))\nwhile True: pass"
    notebook = write_notebook(tmp_path / "notebooks" / "a.ipynb", "n = 1", code)
    command = [sys.executable, "-m", "tras.workflow.runner", notebook, executed]
    heed = lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)  # noqa: E731  a test run in the background ignores it
    process = subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE, text=True, preexec_fn=heed)
    wait_for(lambda: started.exists() and started.read_text())
    process.send_signal(number)
    _, error = process.communicate(timeout=30)
    assert process.returncode == 128 + number
    assert error.count("\n") == 1 and "a was interrupted; nothing was left" in error
    assert list(executed.parent.iterdir()) == []
    kernel = int(started.read_text())
    wait_for(lambda: not Path(f"/proc/{kernel}").exists())


@pytest.mark.slow
def test_a_kernel_and_its_workers_end_with_a_runner_that_is_killed(tmp_path):
    started = tmp_path / "started"
    code = (
        f"import os, pathlib, subprocess\nfinal = pathlib.Path({str(started)!r})\npart = final.with_suffix('.part')\n"
    )
    code += "worker = subprocess.Popen(['sleep', '60'])\npart.write_text(f'{os.getpid()} {worker.pid}')\n"
    code += "part.rename(final)\nwhile True: pass"
    notebook = write_notebook(tmp_path / "notebooks" / "a.ipynb", "n = 1", code)
    command = [sys.executable, "-m", "tras.workflow.runner", notebook, tmp_path / "build" / "a.ipynb"]
    process = subprocess.Popen(command, cwd=ROOT)
    wait_for(started.exists)
    process.kill()
    process.wait()
    for number in started.read_text().split():
        wait_for(lambda number=number: not running(number), 5)


def running(number):
    """Whether there is such a process, other than as a zombie that nobody asks for."""
    try:
        return re.search(r"^State:\s+(\w)", Path(f"/proc/{number}/status").read_text(), re.MULTILINE)[1] != "Z"
    except OSError:
        return False


def wait_for(condition, seconds=30):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not happen in time"
        time.sleep(0.05)


# --- the project's root ---


def test_project_root_is_found_from_below(tmp_path):
    (tmp_path / "tras").mkdir()
    (tmp_path / "pyproject.toml").touch()
    (tmp_path / "build" / "smoke").mkdir(parents=True)
    assert files.project_root(tmp_path / "build" / "smoke") == tmp_path
    (tmp_path / "pyproject.toml").unlink()
    with pytest.raises(FileNotFoundError, match="start the notebook from inside the project"):
        files.project_root(tmp_path / "build")


def test_outside_a_checkout_results_go_below_the_working_folder(tmp_path, monkeypatch):
    (tmp_path / "tras").mkdir()
    (tmp_path / "deep").mkdir()
    monkeypatch.chdir(tmp_path / "deep")
    assert files.working_folder() == tmp_path / "deep"
    (tmp_path / "pyproject.toml").touch()
    assert files.working_folder() == tmp_path


def test_importing_the_runner_does_not_import_papermill():
    code = "import sys, tras.workflow.runner; sys.exit('papermill' in sys.modules or 'numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT).returncode == 0
