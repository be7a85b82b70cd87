"""What a user's editor, shell and type checker see of the package: names, signatures, the first page of help."""

import ast
import inspect
import json
import pydoc
import re
import subprocess
import sys

import pytest
from conftest import ROOT

import tras

# Modules that are checked line by line: those of the objects that users hold. In the others a checker mostly argues
# about NumPy, SciPy and pandas, so of them only what callers see is checked, by the scripts below.
CHECKED = [
    "__init__.py",
    "recording.py",
    "estimator.py",
    "model.py",
    "analysis/residuals.py",
    "plotting.py",
    "display",
    "twin_rotor",
]
PAGES = ["README.md", "docs/own_rig.md"]
SCRIPT = """
from pathlib import Path
from typing import Any, assert_type

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

import tras

recording = tras.Recording([np.zeros((3, 1))], [np.zeros((3, 1))], 0.1, state_names=["q"])
assert_type(tras.Recording.read(Path("log.csv"), {"states": ["q"]}, resample=0.1), tras.Recording)
assert_type(recording.cut(2).split(0.8, 0)[1][0], tras.Recording)
assert_type(recording.plot(["q"]), Figure)
assert_type(recording.to_frame(), pd.DataFrame)
model = tras.KoopmanModel(tras.Union(tras.Monomials(2), tras.GaussianRBF(10, width="auto")), delays=2)
for source in (recording, [recording], "log.nc", tras.open_recording("log.nc")):
    assert_type(model.fit(source), tras.KoopmanModel)
assert_type(model.score(recording), float)
assert_type(model.names_, list[str])
assert_type(model.report(recording), str)
assert_type(model.plot(recording), Figure)
assert_type(model.plot_spectrum(), Figure)
assert_type(tras.compare(recording, model, tras.load_model("model.npz"), names=["a", "b"]).figure, Figure)
assert_type(tras.compare(recording, model).table, pd.DataFrame)
assert_type(model.residuals(recording, steps=3).white, bool)
assert_type(model.residuals(recording).plot(), Figure)
assert_type(model.information_criteria(recording), pd.DataFrame)
assert_type(tras.choose(recording)[0], tras.KoopmanModel)
result = tras.identify(recording, delays=[0, 2])
assert_type(result.model, tras.KoopmanModel)
assert_type(result.plot(), Figure)
matrix: np.ndarray = model.koopman_matrix
states: np.ndarray = model.simulate([0.0], np.zeros((10, 1)))
tras.export.to_c(model, "model.c")
tras.metrics.nrmse(states, states)
log = tras.simulate_closed_loop(tras.multisine(20, 0.01, [0.5, 1.2], [1.0, 2.5], 0), 0.01)
assert_type(log, tras.Recording)
"""
# Script, and what the checker says about it.
MISTAKES = {
    "tras.Recordng": '"Recordng" is not a known attribute of module "tras"',
    "tras.KoopmanModel(degree=2)": 'No parameter named "degree"',
    "tras.KoopmanModel().simulate([0.0])": 'Argument missing for parameter "inputs"',
    "tras.Recording([[[0.0]]], dt=0.1).cut('2')": "cannot be assigned to parameter",
}


def public():
    """(name, function) of every public function and method."""
    for name in tras._ROOMS:
        thing = getattr(tras, name)
        if inspect.isfunction(thing):
            yield name, thing
        members = (
            vars(thing)
            if inspect.ismodule(thing)
            else {key: inspect.getattr_static(thing, key, None) for key in dir(thing)}
        )
        for key, member in members.items():
            function = getattr(member, "__func__", getattr(member, "fget", member))
            shown = not key.startswith("_") or key in ("__init__", "__call__", "__getitem__", "__iter__", "__len__")
            if shown and inspect.isfunction(function) and function.__module__.startswith("tras"):
                yield f"{name}.{key}", function


def test_editor_and_interpreter_know_the_same_names():
    tree = ast.parse((ROOT / "tras" / "__init__.py").read_text())
    (block,) = [node for node in tree.body if isinstance(node, ast.If) and isinstance(node.test, ast.Name)]
    rooms = {}
    for node in block.body:
        for alias in node.names:
            assert alias.asname == alias.name  # else it would not be public
            rooms[alias.name] = node.module.partition(".")[2] or alias.name
    assert rooms == tras._ROOMS


def test_dir_is_what_is_public():
    assert dir(tras) == sorted(tras.__all__)
    assert all(getattr(tras, name) is not None for name in tras.__all__)
    with pytest.raises(AttributeError, match="no attribute 'Recordng'"):
        tras.Recordng  # noqa: B018


def test_every_public_signature_is_annotated():
    lacking = []
    for name, function in public():
        signature = inspect.signature(function)
        named = [
            p
            for p in signature.parameters.values()
            if p.name != "self" and p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD)
        ]
        lacking += [f"{name}({p.name})" for p in named if p.annotation is p.empty and p.name != "cls"]
        if (
            signature.return_annotation is signature.empty
            and not name.endswith("__init__")
            and function.__name__ != "<lambda>"
        ):
            lacking.append(f"{name} ->")
    assert lacking == []


def test_help_says_where_to_start():
    first = pydoc.plain(pydoc.render_doc(tras)).partition("Start here:")[2].strip().partition("The public names")[0]
    lines = [line.strip() for line in first.splitlines() if line.strip()]
    assert len(lines) == 12
    ast.parse("\n".join(lines))
    names = {name for line in lines for name in re.findall(r"tras\.(\w+)", line)}
    assert names <= set(tras.__all__)


def check(folder, scripts, modules=()):
    """The checker's errors on scripts (name -> text) and modules of the package: (file, message)."""
    for name, text in scripts.items():
        (folder / name).write_text(text)
    settings = {
        "typeCheckingMode": "basic", "pythonVersion": "3.11", "extraPaths": [str(ROOT)],
        "include": [str(folder / name) for name in scripts] + [str(ROOT / "tras" / name) for name in modules],
    }  # fmt: skip
    (folder / "pyrightconfig.json").write_text(json.dumps(settings))
    command = [
        sys.executable,
        "-m",
        "basedpyright",
        "--project",
        folder,
        "--pythonpath",
        sys.executable,
        "--outputjson",
    ]
    done = subprocess.run(command, capture_output=True, text=True)
    report = json.loads(done.stdout)
    assert report["summary"]["filesAnalyzed"] >= len(scripts) + len(modules)
    errors = [entry for entry in report["generalDiagnostics"] if entry["severity"] == "error"]
    return [(entry["file"].rpartition("/")[2], entry["message"]) for entry in errors]


@pytest.mark.slow
def test_a_checker_finds_no_fault(tmp_path):
    blocks = re.compile(r"^```python\n(.*?)^```", flags=re.MULTILINE | re.DOTALL)
    pages = {f"page{i}.py": "\n".join(blocks.findall((ROOT / page).read_text())) for i, page in enumerate(PAGES)}
    assert any("import tras" in page for page in pages.values())
    every = "import tras\n" + "\n".join(f"print(tras.{name})" for name in tras.__all__)
    assert check(tmp_path, pages | {"use.py": SCRIPT, "every.py": every}, CHECKED) == []


@pytest.mark.slow
def test_a_checker_sees_mistakes(tmp_path):
    scripts = {f"mistake{i}.py": f"import tras\n\n{line}\n" for i, line in enumerate(MISTAKES)}
    errors = dict(check(tmp_path, scripts))
    for name, words in zip(scripts, MISTAKES.values()):
        assert words in errors.get(name, "nothing"), name
