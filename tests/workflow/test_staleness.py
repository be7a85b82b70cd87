"""Staleness by content: what makes a stage out of date, and what does not."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tras.workflow import cache, provenance, staleness

INIT = """
import importlib
_ROOMS = {"simulate": "plant", "fit": "model", "draw": "figures", "metrics": "metrics"}
def __getattr__(name):
    return importlib.import_module(f"tras.{_ROOMS[name]}")
"""
MODULES = {
    "__init__": INIT,
    "plant": "def simulate():\n    return 1\n",
    "dictionary": "from .plant import simulate\n",
    "model": "def fit():\n    from tras.dictionary import simulate\n",
    "metrics": "import tras.plant as p\n",
    "figures": "STYLE = 'tras.mplstyle'\ndef draw():\n    return 1\n",
    "lonely": "",
}
PARAMS = "01_fit:\n  n: 1  # samples\n02_draw:\n  colour: grey\n"


@pytest.fixture
def project(tmp_path, monkeypatch):
    """Two stages: 01_fit uses model -> dictionary -> plant, 02_draw uses figures and its style."""
    for folder in ("tras", "notebooks"):
        (tmp_path / folder).mkdir()
    for name, source in MODULES.items():
        (tmp_path / "tras" / f"{name}.py").write_text(source)
    (tmp_path / "tras" / "tras.mplstyle").write_text("lines.linewidth: 1\n")
    (tmp_path / "params.yaml").write_text(PARAMS)
    (tmp_path / "environment.txt").write_text("numpy==2\n")
    write_notebook(tmp_path / "notebooks" / "01_fit.ipynb", "from tras import fit", "fit()")
    write_notebook(tmp_path / "notebooks" / "02_draw.ipynb", "import tras", "tras.draw()")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write_notebook(path, *sources, text="Some text."):
    cells = [{"cell_type": "markdown", "source": [text], "metadata": {}}]
    for source in sources:
        cells.append({"cell_type": "code", "source": source, "metadata": {}, "outputs": [], "execution_count": None})
    path.write_text(json.dumps({"cells": cells, "metadata": {}, "nbformat": 4, "nbformat_minor": 5}))


def stale():
    """Run; the names of the stages whose key file was rewritten."""
    notebooks = sorted(Path("notebooks").glob("*.ipynb"))
    keys = [Path("build", f"{notebook.stem}.key") for notebook in notebooks]
    for key in keys:
        if key.exists():
            os.utime(key, (1, 1))
    staleness.main(["--build", "build", "--params", "params.yaml", *map(str, notebooks)])
    return [key.stem for key in keys if key.stat().st_mtime != 1]


def change(path, old, new):
    text = Path(path).read_text()
    assert old in text
    Path(path).write_text(text.replace(old, new))


def test_first_time_all_then_none(project):
    assert stale() == ["01_fit", "02_draw"]
    assert stale() == []


HARMLESS = {
    "touch": lambda: [path.touch() for path in Path().rglob("*") if path.is_file()],
    "comment and blank lines": lambda: change("tras/plant.py", "def", "# a comment\n\n\ndef"),
    "a new docstring": lambda: change("tras/plant.py", "    return", '    """As tras.mplstyle has it."""\n    return'),
    "text of a notebook": lambda: change("notebooks/01_fit.ipynb", "Some text.", "Other text."),
    "outputs": lambda: change("notebooks/01_fit.ipynb", '"outputs": []', '"outputs": [{"output_type": "stream"}]'),
    "metadata": lambda: change("notebooks/01_fit.ipynb", '{}, "nbformat"', '{"a": 1}, "nbformat"'),
    "comment in the parameters": lambda: change("params.yaml", "# samples", "# number of samples"),
    "a module that nobody imports": lambda: change("tras/lonely.py", "", "x = 1"),
    "a new module": lambda: Path("tras/new.py").write_text("x = 1"),
    "a new public name": lambda: change("tras/__init__.py", '"fit": "model"', '"fit": "model", "x": "lonely"'),
    "the same for editors": lambda: change(
        "tras/__init__.py", "def __getattr__", "if TYPE_CHECKING:\n    from tras.lonely import x\ndef __getattr__"
    ),
}


@pytest.mark.parametrize("what", HARMLESS)
def test_what_cannot_change_a_result_reruns_nothing(project, what):
    stale()
    HARMLESS[what]()
    assert stale() == []


DOCUMENTED = '''"""The module."""
text = """no docstring"""


class Rig:
    """The class."""

    text = "no docstring"

    def turn(self):
        """The method."""
        "no docstring"
        return "no docstring"


async def wait():
    """The coroutine."""

    def inner():
        """The inner function."""
        f"no docstring"
'''


@pytest.mark.parametrize("digests", ["key of a stage", "cache"])
def test_a_docstring_does_not_count_and_any_other_string_does(project, digests, monkeypatch):
    def digest():
        if digests == "key of a stage":
            paths = map(Path, ("notebooks/01_fit.ipynb", "params.yaml", "environment.txt"))
            return staleness.key_of(*paths, package())
        monkeypatch.setattr(cache, "_package", package)
        return cache.code_digest.__wrapped__("tras.plant")

    def package():
        return staleness.Package(Path("tras"))

    plant = Path("tras/plant.py")
    plant.write_text(DOCUMENTED)
    before = digest()
    for documented in ("module", "class", "method", "coroutine", "inner function"):
        assert f"The {documented}." in DOCUMENTED
        plant.write_text(DOCUMENTED.replace(f"The {documented}.", "Another word."))
        assert digest() == before
    pieces = DOCUMENTED.split("no docstring")
    assert len(pieces) == 6
    for n in range(1, len(pieces)):
        plant.write_text("no docstring".join(pieces[:n]) + "another word" + "no docstring".join(pieces[n:]))
        assert digest() != before
    plant.write_text(DOCUMENTED.replace("turn", "roll"))
    assert digest() != before


HARMFUL = [
    ("notebooks/01_fit.ipynb", "fit()", "fit(2)", ["01_fit"]),
    ("tras/model.py", "fit", "fit2", ["01_fit"]),
    ("tras/plant.py", "return 1", "return 2", ["01_fit"]),  # through model and dictionary
    ("tras/figures.py", "return 1", "return 2", ["02_draw"]),
    ("tras/tras.mplstyle", "1", "2", ["02_draw"]),
    ("tras/metrics.py", "as p", "as q", []),
    ("tras/__init__.py", "def __getattr__", "x = 1\ndef __getattr__", ["01_fit", "02_draw"]),
    ("tras/__init__.py", '"draw": "figures"', '"draw": "metrics"', ["02_draw"]),
    ("params.yaml", "n: 1", "n: 2", ["01_fit"]),
    ("params.yaml", "grey", "blue", ["02_draw"]),
    ("params.yaml", "n: 1", "n: &here 1", ["01_fit", "02_draw"]),  # an anchor: sections cannot be cut
    ("environment.txt", "2", "3", ["01_fit", "02_draw"]),
]


@pytest.mark.parametrize("path, old, new, expected", HARMFUL)
def test_what_can_change_a_result_reruns_who_depends_on_it(project, path, old, new, expected, capsys):
    stale()
    change(path, old, new)
    assert stale() == expected
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == expected
    assert stale() == []


# Code -> the modules that it needs besides the package itself; None: not even the package.
IMPORTS = {
    "import tras": set(),
    "import tras\ntras.draw": {"figures"},
    "import tras as t\nt.fit()": {"model"},
    "import tras\ntras.metrics.enr(1, 2)": {"metrics"},
    "import tras\ntras.__version__": set(),
    "import tras.plant": {"plant"},
    "import tras.plant as p\np.simulate": {"plant"},
    "import tras.plant\ntras.fit": {"plant", "model"},
    "from tras import plant": {"plant"},
    "from tras.plant import simulate as s": {"plant"},
    "def f():\n    from tras.model import fit": {"model"},
    "from importlib import import_module\nimport_module('tras.plant')": {"plant"},
    "if TYPE_CHECKING:\n    import tras.plant": None,
    "import numpy.tras\nfrom trash import plant": None,
    "%matplotlib inline\nfrom tras import plant": {"plant"},
    "%%time\nfrom tras import plant": {"plant"},
    "x = (1\n     % 2)\nimport tras.plant": {"plant"},
}
ALL = set(MODULES) - {"__init__"}
IMPORTS |= {
    "import tras\ntras.unknown": ALL,
    "import tras\ngetattr(tras, name)": ALL,
    "from tras import *": ALL,
    "from tras import unknown": ALL,
    "from importlib import import_module\nimport_module(name)": ALL,
    "this is no Python": ALL,
}


@pytest.mark.parametrize("code", IMPORTS)
def test_imports_are_resolved(project, code):
    package = staleness.Package(Path("tras"))
    modules = package.needs(staleness.cells_tree([code]))
    expected = IMPORTS[code]
    assert modules == (set() if expected is None else {f"tras.{name}" for name in expected} | {"tras"})


RELATIVE = {
    "from .plant import simulate": {"plant"},
    "from . import plant, metrics": {"plant", "metrics"},
    "from . import fit": {"model"},
    "from .. import plant": set(),
}


@pytest.mark.parametrize("code", RELATIVE)
def test_relative_imports_are_resolved(project, code):
    package = staleness.Package(Path("tras"))
    modules = package.needs(staleness.cells_tree([code]), "tras.model")
    assert modules - {"tras"} == {f"tras.{name}" for name in RELATIVE[code]}


@pytest.fixture
def built(project):
    """The project after 01_fit has written four files, as the runner records it."""
    names = ["a.csv", "b.csv", "c.csv", "d.csv"]
    for name in names:
        Path(name).write_text("1")
    stale()
    outputs = {name: provenance.file_stamp(Path(name)) for name in names}
    Path("build/01_fit.json").write_text(json.dumps({"outputs": outputs}))
    Path("build/01_fit.ipynb").touch()
    assert stale() == []
    return project


def rewritten(name, text):
    """Another content, with the times put back."""
    times = Path(name).stat()
    Path(name).write_text(text)
    os.utime(name, ns=(times.st_atime_ns, times.st_mtime_ns))


DAMAGES = {
    "one byte": (lambda: Path("a.csv").write_text("2"), "a.csv was changed"),
    "one byte, times put back": (lambda: rewritten("a.csv", "2"), "a.csv was changed"),
    "longer": (lambda: Path("a.csv").write_text("12"), "a.csv was changed (2 bytes for 1)"),
    "emptied": (lambda: Path("a.csv").write_text(""), "a.csv was changed (0 bytes for 1)"),
    "deleted": (lambda: Path("a.csv").unlink(), "a.csv was deleted"),
    "a folder in its place": (lambda: (Path("a.csv").unlink(), Path("a.csv").mkdir()), "a.csv was "),
    "all of them": (lambda: [Path(f"{name}.csv").unlink() for name in "abcd"],
                    "a.csv was deleted, b.csv was deleted, c.csv was deleted, d.csv was deleted"),
    "the record deleted": (lambda: Path("build/01_fit.json").unlink(), "build/01_fit.json was deleted or damaged"),
    "the record damaged": (lambda: Path("build/01_fit.json").write_text("{"),
                           "build/01_fit.json was deleted or damaged"),
    "with a change of code": (lambda: (Path("a.csv").unlink(), change("tras/model.py", "fit", "fit2")),
                              "tras.model changed, a.csv was deleted"),
}  # fmt: skip


@pytest.mark.parametrize("what", DAMAGES)
def test_a_damaged_output_is_named_and_its_stage_out_of_date(built, what, capsys):
    damage, sentence = DAMAGES[what]
    damage()
    assert stale() == ["01_fit"]
    printed = capsys.readouterr().out
    assert printed.startswith(f"01_fit is out of date: {sentence}") and printed.count("\n") == 1


def test_touching_or_copying_an_output_is_no_damage(built, capsys):
    Path("a.csv").touch()
    shutil.copy("b.csv", "copy")
    os.replace("copy", "b.csv")
    assert stale() == [] and capsys.readouterr().out == ""


def test_a_clock_set_back_skips_nothing(built):
    os.utime("build/01_fit.ipynb", (4e9, 4e9))
    Path("a.csv").unlink()
    assert stale() == ["01_fit"]
    assert Path("build/01_fit.key").stat().st_mtime > 4e9


def test_without_a_stamp_there_is_nothing_to_say(built, capsys):
    Path("build/01_fit.ipynb").unlink()  # the runner's first act
    Path("a.csv").write_text("half")
    assert stale() == [] and capsys.readouterr().out == ""


def test_a_folder_that_cannot_be_written_is_named(project):
    Path("build").write_text("a file")
    with pytest.raises(SystemExit, match="build cannot be written"):
        staleness.main(["--build", "build", "--params", "params.yaml", "notebooks/01_fit.ipynb"])


def test_missing_files_are_named(project):
    with pytest.raises(SystemExit, match="none.yaml cannot be read"):
        staleness.main(["--build", "build", "--params", "none.yaml", "notebooks/01_fit.ipynb"])
    with pytest.raises(SystemExit, match="none.ipynb cannot be read"):
        staleness.main(["--build", "build", "--params", "params.yaml", "notebooks/none.ipynb"])
    Path("notebooks/01_fit.ipynb").write_text("{}")
    with pytest.raises(SystemExit, match="is not a notebook"):
        staleness.main(["--build", "build", "--params", "params.yaml", "notebooks/01_fit.ipynb"])


def test_it_runs_as_a_plain_script_without_packages(project):
    options = "--build build --params params.yaml notebooks/01_fit.ipynb".split()
    subprocess.run([sys.executable, "-I", "-S", staleness.__file__, *options], check=True)
    assert "tras.plant: " in Path("build/01_fit.key").read_text()
