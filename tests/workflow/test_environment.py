"""A hostile or merely odd environment: a build takes nothing from it, or says in one sentence what is wrong."""

import contextlib
import json
import os
import stat
import subprocess
import sys

import nbformat
import pytest
from conftest import ROOT, for_make
from test_runner import run, write_notebook

import tras
from tras.identification import command
from tras.workflow import environment, files, provenance, runner

KERNEL = '{"argv": ["/bin/false"], "display_name": "Python 3", "language": "python"}'
FAIL = "raise SystemExit('PWNED')"
# What a kernel has to show for itself, in the folder of the notebook.
WHO = """\
import json, os, random, sys
import matplotlib, numpy
import tras
names = [name for name in os.environ if name.startswith(("PYTHON", "JUPYTER", "IPYTHON", "MPL", "MATPLOTLIB"))]
print(json.dumps({"tras": tras.__file__, "font": matplotlib.rcParams["font.size"], "random": random.__file__,
                  "numpy": numpy.__file__, "python": sys.executable, "optimize": sys.flags.optimize, "names": names}))
"""


@pytest.fixture
def hostile(tmp_path):
    """Variables, each of which would change what a build does, and the files that they name."""
    folder = tmp_path / "hostile"
    texts = {
        "path/tras/__init__.py": FAIL, "path/numpy.py": FAIL, "startup.py": FAIL,
        "jupyter/kernels/python3/kernel.json": KERNEL, "home/.local/share/jupyter/kernels/python3/kernel.json": KERNEL,
        "home/.jupyter/jupyter_config.py": FAIL, "home/.jupyter/jupyter_config.json": "{",
        "home/.ipython/profile_default/startup/00.py": FAIL,
        "home/.ipython/profile_default/ipython_config.py": "c.InteractiveShellApp.exec_lines = ['tras = 1', '1 / 0']",
        "home/.config/matplotlib/matplotlibrc": "font.size: 33\nbackend: nonsense\n",
        "matplotlib/matplotlibrc": "font.size: 33\nlines.linewidth: x\n",
    }  # fmt: skip
    for name, text in texts.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    named = {"PYTHONPATH": "path", "PYTHONSTARTUP": "startup.py", "JUPYTER_PATH": "jupyter", "HOME": "home",
             "JUPYTER_CONFIG_DIR": "home/.jupyter", "IPYTHONDIR": "home/.ipython", "MPLCONFIGDIR": "matplotlib",
             "MATPLOTLIBRC": "matplotlib/matplotlibrc"}  # fmt: skip
    values = {"PYTHONOPTIMIZE": "2", "PYTHONWARNINGS": "error", "MPLBACKEND": "nonsense", "JUPYTER_PLATFORM_DIRS": "1"}
    return values | {name: str(folder / path) for name, path in named.items()}


@pytest.mark.slow
def test_a_kernel_takes_nothing_from_its_surroundings(tmp_path, hostile, monkeypatch):
    """Its Python, its tras and its packages are the runner's; IPython's and Matplotlib's settings are the defaults."""
    for name, value in hostile.items():
        monkeypatch.setenv(name, value)
    notebook = write_notebook(tmp_path / "notebooks" / "a.ipynb", "n = 1", WHO)
    for name in ("random", "numpy", "tras"):  # IPython looks where the notebook is, unless told otherwise
        (notebook.parent / f"{name}.py").write_text(FAIL)
    code, executed = run(notebook)
    assert code == 0
    (output,) = nbformat.read(executed, 4).cells[-1].outputs
    seen = json.loads(output.text)
    assert seen["tras"] == tras.__file__ and seen["python"] == sys.executable and seen["font"] == 10
    assert str(tmp_path) not in seen["random"] + seen["numpy"] and seen["optimize"] == 0
    ours = {"PYTHONPATH", "PYTHONSAFEPATH", "PYTHONHASHSEED", "MATPLOTLIBRC", "MPLCONFIGDIR", "IPYTHONDIR"}
    ours |= {"JUPYTER_CONFIG_DIR", "JUPYTER_DATA_DIR", "JUPYTER_RUNTIME_DIR"}
    assert set(seen["names"]) - {"MPLBACKEND"} <= ours  # ipykernel sets its own backend
    assert not list((tmp_path / "hostile" / "home" / ".local" / "share" / "jupyter").glob("runtime"))


def test_make_hands_none_of_it_on(hostile):
    """The threads, the hash seed and Matplotlib's file are make's own; the rest is not there."""
    odd = {"OPENBLAS_NUM_THREADS": "7", "OPENBLAS_CORETYPE": "Nehalem", "NPY_DISABLE_CPU_FEATURES": "AVX2",
           "PYTHONHASHSEED": "5", "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2", "OMP_THREAD_LIMIT": "1"}  # fmt: skip
    show = ["make", "--no-print-directory", "--eval=show-environment: ; @env", "show-environment"]
    done = subprocess.run(show, cwd=ROOT, env=for_make() | hostile | odd, capture_output=True, text=True, check=True)
    inside = dict(line.split("=", 1) for line in done.stdout.splitlines() if "=" in line)
    assert {name: inside.get(name) for name in environment.PINNED} == environment.PINNED
    assert inside["MATPLOTLIBRC"] == os.devnull
    own = {*environment.PINNED, "MATPLOTLIBRC", "HOME", "MPLCONFIGDIR"}
    assert not (set(hostile) | set(odd)) - own & set(inside)


def test_what_is_said_to_make_itself_stays():
    """``make OPENBLAS_CORETYPE=Haswell verify`` is how to verify with the kernels for another processor."""
    show = ["make", "--no-print-directory", "--eval=show-environment: ; @env", "show-environment"]
    done = subprocess.run(
        [*show, "OPENBLAS_CORETYPE=Haswell"], cwd=ROOT, env=for_make(), capture_output=True, text=True, check=True
    )
    assert "OPENBLAS_CORETYPE=Haswell" in done.stdout.splitlines()


def test_the_package_of_another_checkout_is_refused(tmp_path, capsys):
    other = tmp_path / "other"
    (other / "tras").mkdir(parents=True)
    (other / "pyproject.toml").touch()
    code, executed = run(write_notebook(other / "notebooks" / "a.ipynb", "n = 1", "n"))
    error = capsys.readouterr().err
    assert code == 1 and error.count("\n") == 1 and not executed.exists()
    assert f"the notebook is of the checkout {other}, but this is the tras of {ROOT}" in error


def test_a_kernel_that_would_import_another_package_is_not_started(tmp_path, capsys, monkeypatch):
    (tmp_path / "path" / "tras").mkdir(parents=True)
    (tmp_path / "path" / "tras" / "__init__.py").touch()
    surroundings = environment.of_a_kernel(tmp_path)
    assert environment.other_package(surroundings, tmp_path) == ""
    surroundings["PYTHONPATH"] = str(tmp_path / "path")
    assert environment.other_package(surroundings, tmp_path) == str(tmp_path / "path" / "tras" / "__init__.py")
    monkeypatch.setattr(environment, "of_a_kernel", lambda folder: surroundings)
    code, executed = run(write_notebook(tmp_path / "notebooks" / "a.ipynb", "n = 1", "n"))
    error = capsys.readouterr().err
    assert code == 1 and error.count("\n") == 1 and "a kernel would import tras from" in error
    assert not executed.exists()


def test_a_hook_of_git_does_not_mislead_the_provenance(tmp_path, monkeypatch):
    before = provenance.git_state(ROOT)
    for name in ("GIT_DIR", "GIT_WORK_TREE", "GIT_INDEX_FILE"):
        monkeypatch.setenv(name, str(tmp_path))
    assert provenance.git_state(ROOT) == before


@contextlib.contextmanager
def nobody():
    """Root may write everywhere, so it becomes somebody else for a while."""
    uid = os.geteuid()
    if uid == 0:
        os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(uid)


@pytest.fixture
def locked(tmp_path):
    """A folder that only its owner could write, if it were not read-only."""
    passable = stat.S_IXOTH | stat.S_IROTH | stat.S_IXGRP | stat.S_IRGRP
    for folder in (tmp_path, *tmp_path.parents):
        if folder.stat().st_uid == os.geteuid() and not folder.stat().st_mode & stat.S_IXOTH:
            folder.chmod(folder.stat().st_mode | passable)  # pytest's folders are private
    path = tmp_path / "locked"
    path.mkdir()
    path.chmod(0o555)
    yield path
    path.chmod(0o755)


@pytest.mark.parametrize("which", ["executed", "outputs"])
def test_a_read_only_folder_is_one_sentence_before_anything_runs(tmp_path, locked, which, capsys):
    notebook = write_notebook(tmp_path / "notebooks" / "a.ipynb", "n = 1", "n")
    (tmp_path / "build").mkdir(mode=0o777)
    (tmp_path / "build").chmod(0o777)
    executed = (locked if which == "executed" else tmp_path / "build") / "a.ipynb"
    with nobody():
        code = runner.main([str(notebook), str(executed), "--outputs", str(locked / "data" / "a.csv")])
    error = capsys.readouterr().err
    assert code == 1, error
    assert error.count("\n") == 1 and f"{locked}" in error and "cannot be written (Permission" in error
    assert list(locked.iterdir()) == [] and not executed.exists()


def test_a_file_of_another_owner_is_one_sentence(tmp_path, locked, capsys):
    """In a folder such as /tmp, where everybody may write and nobody may remove what is another's."""
    if os.geteuid():
        pytest.skip("needs root, to make files of two owners")
    shared = tmp_path / "shared"
    shared.mkdir()
    (shared / "a.json").write_text("another's")
    shared.chmod(0o1777)
    notebook = write_notebook(tmp_path / "notebooks" / "a.ipynb", "n = 1", "n")
    with nobody():
        code = runner.main([str(notebook), str(shared / "a.ipynb")])
    error = capsys.readouterr().err
    assert code == 1 and error.count("\n") == 1 and f"{shared / 'a.json'}: Operation not permitted" in error
    assert [path.name for path in shared.iterdir()] == ["a.json"]


def test_identify_says_that_its_folder_is_read_only(tmp_path, locked, capsys):
    log = tmp_path / "log.csv"
    log.write_text("t,x\n0,1\n")
    log.chmod(0o644)
    (tmp_path / "build").mkdir()
    with nobody():
        code = command.main([str(log), "--out", str(locked / "results")])
    error = capsys.readouterr().err
    assert code == 1 and error.count("\n") == 1 and f"{locked} cannot be written (Permission denied)" in error


@pytest.mark.parametrize("place", ["/", "~"])
def test_root_and_home_are_no_folder_for_results(tmp_path, place, capsys):
    log = tmp_path / "log.csv"
    log.write_text("t,x\n0,1\n")
    assert command.main([str(log), "--out", place]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "is no folder for results" in error


def test_a_folder_of_others_is_not_touched(tmp_path, capsys):
    log, out = tmp_path / "log.csv", tmp_path / "out"
    log.write_text("t,x\n0,1\n")
    out.mkdir()
    (out / "thesis.tex").write_text("mine")
    assert command.main([str(log), "--out", str(out)]) == 2
    assert "holds files of others, such as thesis.tex" in capsys.readouterr().err
    assert (out / "thesis.tex").read_text() == "mine" and len(list(out.iterdir())) == 1


def test_require_writable_makes_the_folder(tmp_path):
    files.require_writable(tmp_path / "a" / "b")
    assert list((tmp_path / "a" / "b").iterdir()) == []
    (tmp_path / "file").touch()
    with pytest.raises(OSError, match="file cannot be written .*; give it back"):
        files.require_writable(tmp_path / "file")
