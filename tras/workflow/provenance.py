"""Where an artefact comes from: revision, parameters, seeds, versions, machine, times; as JSON beside it, never inside.

Beside `data/train.nc` lies `data/provenance/train.nc.json`; the folders `provenance/` are not in git.
`build/PROFILE/STAGE.json` holds the same for a whole stage.
"""

import hashlib
import json
import os
import platform
import re
import subprocess
import sys
from datetime import datetime
from importlib import metadata
from pathlib import Path

from tras.workflow.arguments import DISTRIBUTION
from tras.workflow.files import replacing

FOLDER = "provenance"
ROOT = Path(__file__).parents[2]
IN_CHECKOUT = (ROOT / "pyproject.toml").is_file()  # else installed, perhaps below a checkout of something else
_NO_GIT = {"revision": None, "dirty": None, "changed": None}
# What outside the code decides the last bits: threads, the kernels of BLAS, NumPy and libm, the order of sets.
VARIABLES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "PYTHONHASHSEED", "OPENBLAS_CORETYPE",
             "NPY_DISABLE_CPU_FEATURES", "NPY_ENABLE_CPU_FEATURES", "GLIBC_TUNABLES")  # fmt: skip
INSTRUCTIONS = ("sse4_2", "avx", "fma", "avx2", "avx512f", "asimd", "sve")  # BLAS and libm choose by these


def record(notebook: Path, parameters: dict, outputs: list[Path], started: datetime, seconds: float) -> dict:
    """A record of what ran and what it wrote, as JSON holds it; ``parameters`` with the defaults."""
    return {
        "notebook": str(notebook),
        "parameters": parameters,
        "seeds": {name: value for name, value in parameters.items() if "seed" in name},
        "git": git_state(notebook.resolve().parent, outputs) if IN_CHECKOUT else dict(_NO_GIT),
        "python": platform.python_version(),
        "packages": packages(),
        "environment": checksum(ROOT / "environment.txt"),
        "platform": platform.platform(),
        "processor": processor(),
        "instructions": instructions(),
        "variables": {name: os.environ[name] for name in VARIABLES if name in os.environ},
        "started": started.isoformat(timespec="seconds"),
        "seconds": round(seconds, 2),
        "outputs": {str(output): file_stamp(output) for output in outputs},
    }


def beside(artefact: Path) -> Path:
    """The path of an artefact's provenance: in the folder `provenance` beside it."""
    return artefact.parent / FOLDER / f"{artefact.name}.json"


def write_beside(record: dict) -> None:
    """Write a file for each output of a stage: the stage's record, with the checksum of this output alone."""
    shared = {key: value for key, value in record.items() if key != "outputs"}
    for name, stamp in record["outputs"].items():
        with replacing(beside(Path(name))) as temporary:
            temporary.write_text(json.dumps({"artefact": name, **stamp, **shared}, indent=1) + "\n", encoding="utf-8")


def file_stamp(path: Path) -> dict:
    """Size, times and SHA-256 of a file, by which `tras/workflow/staleness.py` knows it again."""
    status = path.stat()
    times = {"mtime_ns": status.st_mtime_ns, "ctime_ns": status.st_ctime_ns}
    return {"size": status.st_size, **times, "sha256": checksum(path)}


def checksum(path: Path) -> str | None:
    """SHA-256 of a file in hexadecimal digits, None if it is not there."""
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.exists() else None


def git_state(folder: Path, outputs=()) -> dict:
    """Revision, and the files other than ``outputs`` that differ from it; all None outside git or without commits."""
    try:
        revision = _git(folder, "rev-parse", "HEAD").strip()
        top = Path(_git(folder, "rev-parse", "--show-toplevel").strip())
        status = _git(folder, "status", "--porcelain", "-z", "--no-renames")
    except (OSError, subprocess.CalledProcessError):
        return dict(_NO_GIT)
    changed = {entry[3:] for entry in status.split("\0") if entry}
    changed = sorted(name for name in changed if (top / name).resolve() not in {output.resolve() for output in outputs})
    return {"revision": revision, "dirty": bool(changed), "changed": changed[:20]}


def _git(folder, *command):
    # Whoever starts a build from a hook of git has these set, to another folder.
    elsewhere = ("GIT_DIR", "GIT_WORK_TREE", "GIT_INDEX_FILE")
    outside = {name: value for name, value in os.environ.items() if name not in elsewhere}
    done = subprocess.run(["git", *command], cwd=folder, env=outside, capture_output=True, text=True, check=True)
    return done.stdout


def versions() -> dict[str, str]:
    """Versions that decide the numbers of a recording or a model, for its attributes."""
    import numpy
    import scipy

    import tras

    libraries = {"numpy": numpy.__version__, "scipy": scipy.__version__}
    return {"tras": tras.__version__, "python": platform.python_version(), **libraries}


def packages() -> dict[str, str | None]:
    """Versions of the direct dependencies, which `environment.in` lists, or the installed package's own metadata.

    None for one that is not installed.
    """
    requirements = ROOT / "environment.in"
    if requirements.exists():
        text = requirements.read_text(encoding="utf-8")
    else:
        text = "" if IN_CHECKOUT else "\n".join(metadata.requires(DISTRIBUTION) or [])
    installed = {}
    for name in re.findall(r"^[A-Za-z0-9_.-]+", text, re.MULTILINE):
        try:
            installed[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            installed[name] = None
    return installed


def processor() -> str:
    """The processor's name."""
    return _cpu("model name") or platform.processor() or platform.machine()


def instructions() -> list[str]:
    """Which of the vector instructions that decide last bits it has; empty where Linux does not say."""
    flags = (_cpu("flags") or _cpu("Features") or "").split()
    return [name for name in INSTRUCTIONS if name in flags]


def _cpu(entry):
    try:
        match = re.search(rf"^{entry}\s*: (.*)", Path("/proc/cpuinfo").read_text(), re.MULTILINE)
    except OSError:
        return ""
    return match[1] if match else ""


def summary() -> str:
    """This checkout and this machine in one line."""
    state, libraries = git_state(ROOT), versions()
    changes = " with changes" if state["dirty"] else ""
    revision = f"revision {state['revision'][:12]}{changes}" if state["revision"] else "no revision"
    machine = f"{processor()} ({' '.join(instructions()[-1:])})" if instructions() else processor()
    parts = ["Python {python}, numpy {numpy}, scipy {scipy}".format(**libraries), sys.platform, machine]
    return ", ".join([revision, *parts])
