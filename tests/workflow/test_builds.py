"""Builds by make in surroundings that are odd, and builds that are killed: the same bytes, or nothing.

The checkout is a small one: this Makefile, this package, and two notebooks in place of the first two stages.
"""

import contextlib
import hashlib
import json
import os
import re
import signal
import subprocess
from pathlib import Path

import nbformat
import pytest
from conftest import ROOT, for_make, make_files
from test_runner import running, wait_for, write_notebook

STAGES = ("01_data_generation", "02_identification")
SETTINGS = 'data_dir = "data"\nfigures_dir = "figures"'
# Whatever depends on threads, hash seed, locale or order would be in these bytes; without the file `go` it waits.
BUSY = """\
import json, os, pathlib, time
import numpy as np
from tras.workflow.files import project_root, replacing
root = project_root()
(root / f"started.{os.getpid()}").touch()
while not (root / "go").exists():
    time.sleep(0.02)
a = np.random.default_rng(0).normal(size=(300, 300))
text = f"{(a @ a).sum()!r} {np.linalg.svd(a)[1].sum()!r} {list({'a', 'b', 'ü'})} ü {0.1!r}\\n"
for name in names:
    with replacing(root / data_dir / name) as temporary:
        temporary.write_text(text, encoding="utf-8")
"""


def outputs():
    """The outputs that make expects of the two stages, from its own list."""
    show = "show: ; @echo $(patsubst $(DATA)/%,%,$(OUT_01)) / $(patsubst $(DATA)/%,%,$(OUT_02))"
    done = subprocess.run(
        ["make", "--no-print-directory", f"--eval={show}", "show"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return [part.split() for part in done.stdout.split(" / ")]


def small(folder):
    """A checkout in a folder; its two stages wait until there is a file `go`."""
    if not list((ROOT / ".venv").glob(".ready-*")):
        pytest.skip("make setup has not run")
    (folder / "params").mkdir(parents=True)
    make_files(folder)
    for name in (".venv", "tras"):
        (folder / name).symlink_to(ROOT / name)
    (folder / "params" / "small.yaml").write_text("".join(f"{stage}:\n  figures_dir: figures\n" for stage in STAGES))
    for path in (ROOT / "notebooks").glob("[0-9]*.ipynb"):  # make wants to know of all of them
        write_notebook(folder / "notebooks" / path.name, SETTINGS)
    for stage, names in zip(STAGES, outputs()):
        path = write_notebook(folder / "notebooks" / f"{stage}.ipynb", SETTINGS, f"names = {names!r}", BUSY)
        notebook = nbformat.read(path, 4)
        for number, cell in enumerate(notebook.cells):
            cell["id"] = f"{stage}-{number}"
        nbformat.write(notebook, path)
    return folder


def make(folder, *options, stages=STAGES, **variables):
    """A process of make, in a session of its own, that builds the stages."""
    heed = lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)  # noqa: E731  a test run in the background ignores it
    targets = [f"build/small/{stage}.ipynb" for stage in stages]
    umask = variables.pop("umask", -1)
    return subprocess.Popen(
        ["make", "PROFILE=small", *options, *targets], cwd=folder, env=for_make() | variables, umask=umask,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True, preexec_fn=heed,
    )  # fmt: skip


def finished(process):
    text, _ = process.communicate(timeout=120)
    assert process.returncode == 0, text
    return text


def content(folder):
    """The bytes of all that was built, file by file, and nothing that a killed build has left."""
    data = folder / "build" / "small" / "data"
    paths = sorted(path for path in data.rglob("*") if path.is_file() and "provenance" not in path.parts)
    assert not list(data.rglob(".*"))
    return {path.relative_to(data).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in paths}


@pytest.fixture(scope="module")
def checkout(tmp_path_factory):
    """Built once, in plain surroundings; what it holds."""
    folder = small(tmp_path_factory.mktemp("plain") / "checkout")
    (folder / "go").touch()
    finished(make(folder))
    built = content(folder)
    assert sorted(built) == sorted(name for names in outputs() for name in names)
    return folder, built


def test_odd_surroundings_give_the_same_bytes(checkout, tmp_path):
    """Quotes, a dollar and letters beyond ASCII in the path; the C locale, a strict umask, a hash seed, two threads."""
    folder = small(tmp_path / "ü'\"$HOME`x`&;(→)")
    (folder / "go").touch()
    odd = {"LANG": "C", "LC_ALL": "C", "PYTHONHASHSEED": "77", "OPENBLAS_NUM_THREADS": "2", "OMP_NUM_THREADS": "2"}
    finished(make(folder, "-j2", umask=0o077, **odd))
    assert content(folder) == checkout[1]
    strict = [path for path in (folder / "build" / "small" / "data").glob("*.nc") if path.stat().st_mode & 0o077]
    assert strict == []
    assert "out of date" not in finished(make(folder))  # and the next one has nothing to do


def test_two_builds_at_once_give_the_same_bytes(checkout, tmp_path):
    folder = small(tmp_path / "checkout")
    both = [make(folder), make(folder, "-j2")]
    wait_for(lambda: len(list(folder.glob("started.*"))) == 2)
    (folder / "go").touch()
    texts = [process.communicate(timeout=120)[0] for process in both]
    assert all(process.returncode == 0 for process in both) or finished(make(folder)), texts
    assert content(folder) == checkout[1]
    assert not any("Traceback" in text for text in texts), texts


def family(number):
    """The numbers of a process and of all that it has started, by name: make, runner, kernel."""
    parents, names = {}, {}
    for path in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            status = (path / "stat").read_text().rpartition(")")[2].split()
            parents[int(path.name)] = int(status[1])
            names[int(path.name)] = (path / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
    members = {number}
    while more := {child for child, parent in parents.items() if parent in members} - members:
        members |= more
    return {child: names.get(child, "") for child in members}


def member(processes, who):
    (number,) = [child for child, name in processes.items() if re.search(who, name)]
    return number


PATTERNS = {"make": "^make ", "runner": "-m tras.workflow.runner", "kernel": "ipykernel_launcher"}
KILLS = [(who, number) for who in ("group", "runner", "kernel", "make") for number in (signal.SIGKILL, signal.SIGINT)]


def test_a_build_that_is_killed_leaves_nothing_and_the_next_one_the_same_bytes(checkout, tmp_path):
    """Killed in its second stage, each of them. Without make a runner goes on to its end, which is whole then."""
    folder = small(tmp_path / "checkout")
    (folder / "go").touch()
    finished(make(folder, stages=STAGES[:1]))
    first, stamp = content(folder), folder / "build" / "small" / f"{STAGES[1]}.ipynb"
    for who, number in KILLS:
        for file in [*folder.glob("started.*"), folder / "go", stamp]:
            file.unlink(missing_ok=True)
        process = make(folder)
        wait_for(lambda: list(folder.glob("started.*")))
        processes = family(process.pid)
        if who == "group":
            os.killpg(process.pid, number)
        else:
            os.kill(member(processes, PATTERNS[who]), number)
        if who == "make":
            (folder / "go").touch()
        text, _ = process.communicate(timeout=60)
        for each in processes:
            wait_for(lambda each=each: not running(each), 10)
        assert process.returncode and "Traceback (most recent" not in text, (who, number, text)
        if who == "make":
            assert content(folder) == checkout[1], (who, number)
        else:
            assert content(folder) == first and not stamp.exists(), (who, number)
    (folder / "go").touch()
    finished(make(folder))
    assert content(folder) == checkout[1] and stamp.exists()
    assert json.loads(stamp.with_suffix(".json").read_text())["outputs"]
