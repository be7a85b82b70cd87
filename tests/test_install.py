"""The package as others get it: a wheel, installed by pip into an environment that has nothing else."""

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
import venv
import zipfile

import pytest
from conftest import ROOT

import tras
from tras.workflow.arguments import DISTRIBUTION

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
IMPORT_ALL = """
import sys
import tras
assert "numpy" not in sys.modules
for name in tras.__all__:
    getattr(tras, name)
print(tras.__file__)
"""
WITHOUT_EXTRAS = """
import tras
log = tras.Recording([[[0.0], [1.0], [0.5]]], dt=0.1)
log.write("log.csv"), log.write("log.mat")
assert (tras.Recording.read("log.mat").states == log.states).all()
log.plot().savefig("log.png")
for attempt in (lambda: log.write("log.parquet"), lambda: log.write("log.nc"), lambda: tras.sweep(
    log.cut(2), {"dictionary": [tras.Monomials(1)]}, held_out=log, window=0.2, scheduler="tcp://localhost:1")):
    try:
        attempt()
    except ImportError as error:
        print(error)
"""


def run(*command, folder, code=0, **variables):
    """The output of a command, with nothing of this checkout or its environment in reach."""
    lean = {name: os.environ[name] for name in os.environ if name.startswith(("PIP_", "SSL_", "LANG", "HTTP", "http"))}
    lean |= {
        "PATH": os.defpath,
        "HOME": str(folder),
        "PIP_CACHE_DIR": cache(),
        "OPENBLAS_NUM_THREADS": "1",
        **variables,
    }
    done = subprocess.run(list(map(str, command)), cwd=folder, env=lean, capture_output=True, text=True)
    assert done.returncode == code, f"{done.stdout}\n{done.stderr}"
    return done.stdout + done.stderr


def cache():
    return os.environ.get("PIP_CACHE_DIR", os.path.expanduser("~/.cache/pip"))


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    build = [
        sys.executable,
        "-m",
        "pip",
        "wheel",
        "--quiet",
        "--no-deps",
        "--no-build-isolation",
        "--wheel-dir",
        folder,
    ]
    source = tmp_path_factory.mktemp("source")  # setuptools leaves build/ and *.egg-info where it builds
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    for name in ("tras", "notebooks"):
        shutil.copytree(ROOT / name, source / name, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
    subprocess.run(list(map(str, [*build, source])), check=True)
    (path,) = folder.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """The `bin` of an environment with the wheel and its core, at the versions of environment.txt."""
    folder = tmp_path_factory.mktemp("bare")
    venv.create(folder / "venv", with_pip=True)
    versions = re.findall(r"^[\w.-]+==[^\\\n]+", (ROOT / "environment.txt").read_text(), re.MULTILINE)
    (folder / "versions.txt").write_text("\n".join(versions))
    python = folder / "venv" / "bin" / "python"
    pip = [python, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    try:
        run(*pip, "download", "--no-deps", "--no-cache-dir", "--dest", folder / "probe", "threadpoolctl", folder=folder)
    except AssertionError as error:
        pytest.skip(f"pip reaches no package index here: {str(error).strip().splitlines()[-1]}")
    install = [*pip, "install", "--no-compile", "--constraint", folder / "versions.txt"]
    run(*install, wheel, folder=folder)
    return python.parent, lambda extra: run(*install, f"{wheel}[{extra}]", folder=folder)


def test_the_version_is_one():
    citation = (ROOT / "CITATION.cff").read_text()
    assert re.search(r"^version: (.*)$", citation, re.MULTILINE)[1] == tras.__version__
    assert PROJECT["name"] == DISTRIBUTION and "version" in PROJECT["dynamic"]


def test_every_dependency_is_locked_too():
    """environment.in is the lock of the checkout; what pip would bring is in it."""
    listed = set(re.findall(r"^[\w-]+", (ROOT / "environment.in").read_text(), re.MULTILINE))
    named = [*PROJECT["dependencies"], *(each for extra in PROJECT["optional-dependencies"].values() for each in extra)]
    names = {re.match(r"[\w-]+", requirement)[0] for requirement in named} - {DISTRIBUTION}
    brought = {"ipykernel"}  # by jupyter
    assert names - brought <= listed


@pytest.mark.slow
def test_the_wheel_holds_what_it_needs(wheel):
    with zipfile.ZipFile(wheel) as file:
        names = set(file.namelist())
        notebook = file.read("tras/identification/identify.ipynb")
    assert {"tras/py.typed", "tras/tras.mplstyle"} <= names and not any(name.startswith("tests") for name in names)
    assert notebook == (ROOT / "notebooks" / "identify.ipynb").read_bytes()
    assert {name for name in names if name.endswith(".py")} == {
        path.relative_to(ROOT).as_posix() for path in (ROOT / "tras").rglob("*.py")
    }


@pytest.mark.slow
def test_a_bare_environment(installed, tmp_path):
    """Core: every public name, files, a plot. Then `tras identify`, first without what it needs."""
    binaries, add = installed
    python, command = binaries / "python", binaries / "tras"
    assert str(binaries.parent) in run(python, "-c", IMPORT_ALL, folder=tmp_path)
    sentences = run(python, "-c", WITHOUT_EXTRAS, folder=tmp_path).splitlines()
    assert [re.sub(".*pip install", "pip install", line) for line in sentences] == [
        f"pip install '{DISTRIBUTION}[{extra}]'." for extra in ("parquet", "netcdf", "cluster")
    ]
    assert run(command, "version", folder=tmp_path).startswith(f"tras {tras.__version__}, python ")
    assert "usage: tras COMMAND" in run(command, folder=tmp_path)
    assert "did you mean 'identify'" in run(command, "identfy", folder=tmp_path, code=2)
    assert run(command, "example", folder=tmp_path).startswith("duffing.csv")
    fast = ["--predictor", "one_step", "--delays", "0", "--smoothing", "no", "--draws", "0"]
    refusal = run(command, "identify", "duffing.csv", *fast, folder=tmp_path, code=2)
    assert refusal.count("\n") == 1 and f"pip install '{DISTRIBUTION}[notebooks]'" in refusal
    assert not list(tmp_path.glob("build/identify/*"))

    add("notebooks")
    assert "report.html" in run(command, "identify", "duffing.csv", *fast, folder=tmp_path)
    folder = tmp_path / "build" / "identify" / "duffing"
    assert {"report.html", "identify.ipynb", "model.npz", "export", "figures"} <= {
        path.name for path in folder.iterdir()
    }
    record = json.loads((folder / "identify.json").read_text())
    assert record["git"]["revision"] is None and record["packages"]["numpy"] and record["packages"][DISTRIBUTION]
    assert tras.load_model(folder / "model.npz").predictor == "one_step"
    missing = run(command, "identify", "nothing.csv", folder=tmp_path, code=2)
    assert missing == "RECORDING: nothing.csv does not exist; give the path of a file.\n"
