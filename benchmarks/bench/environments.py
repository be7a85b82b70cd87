"""An environment per peer, from its lock file: ``benchmarks/peers/NAME.txt`` -> ``build/bench/venvs/NAME``."""

import hashlib
import shutil
import subprocess
import sys
from pathlib import Path

PEERS = Path(__file__).resolve().parent.parent / "peers"


def names():
    """Peers that have a lock file."""
    return sorted(path.stem for path in PEERS.glob("*.txt"))


def interpreter(name, folder, run=subprocess.run):
    """Path of the peer's Python; its environment is made if there is none for this lock file.

    Packages are installed as locked, without asking what else they require: what is locked is complete (`lock`).

    Raises
    ------
    RuntimeError
        If it cannot be made; one sentence.
    """
    lock = PEERS / f"{name}.txt"
    if not lock.is_file():
        raise RuntimeError(f"there is no lock file {lock.name} for a peer {name!r}; known are {', '.join(names())}.")
    venv = Path(folder) / name
    stamp = venv / f".ready-{hashlib.sha256(lock.read_bytes()).hexdigest()[:12]}"
    python = venv / "bin" / "python"
    if stamp.is_file() and python.exists():
        return python
    shutil.rmtree(venv, ignore_errors=True)
    venv.parent.mkdir(parents=True, exist_ok=True)
    if shutil.which("uv"):
        _quietly(name, run, ["uv", "venv", "--quiet", "--no-project", "--python", sys.executable, venv])
        install = ["uv", "pip", "install", "--quiet", "--python", python]
    else:
        _quietly(name, run, [sys.executable, "-m", "venv", venv])
        install = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    _quietly(name, run, [*install, "--no-deps", "--require-hashes", "-r", lock])
    stamp.touch()
    return python


def lock(name, run=subprocess.run):
    """Resolve ``NAME.in`` anew; what stands in ``NAME.overrides`` with a marker that never holds is left out."""
    if not shutil.which("uv"):
        raise RuntimeError("locking needs uv, which was not found on PATH: python3 -m pip install uv.")
    overrides = PEERS / f"{name}.overrides"
    command = [
        "uv",
        "pip",
        "compile",
        "--quiet",
        "--universal",
        "--python-version",
        "3.11",
        "--generate-hashes",
        "--no-header",
        "--no-emit-index-url",
    ]
    command += ["--no-emit-find-links", f"{name}.in", "--output-file", f"{name}.txt"]
    _quietly(name, run, command + (["--override", overrides.name] if overrides.is_file() else []), cwd=PEERS)


def _quietly(name, run, command, **options):
    try:
        done = run([str(part) for part in command], capture_output=True, text=True, **options)
    except OSError as error:
        raise RuntimeError(f"{command[0]} could not be started for {name}: {error.strerror}.") from error
    if done.returncode:
        lines = [line.strip() for line in (done.stderr or done.stdout).splitlines() if line.strip()]
        what = "locked" if "compile" in command else "made"
        raise RuntimeError(f"the environment of {name} could not be {what}: {(lines or ['no message'])[0][:300]}")
