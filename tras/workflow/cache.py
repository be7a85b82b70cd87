"""Results in small files, each under the hash of what it depends on: its options and the code that computes it.

A result that is there is not computed again. A file that is damaged, or holds something else than its name says, is
computed again, with a sentence that says so.
"""

import functools
import json
import sys
import zipfile
from pathlib import Path

import numpy as np

from tras.workflow.files import replacing
from tras.workflow.provenance import versions
from tras.workflow.staleness import Package, digest

SHOWS = "tras.display"  # what objects show of themselves: no number that is kept depends on it


def _digest_of(value):
    return digest(json.dumps(value, sort_keys=True))


@functools.cache
def code_digest(*modules: str) -> str:
    """Digest of modules, of all that they need in turn, and of the versions of Python and the libraries.

    The modules count as `tras.workflow.staleness` reads them: without comments and docstrings.
    """
    package, parts = _package(), {}
    for module in package.closure(set(modules), without=SHOWS):
        parts |= package.fingerprint(module)
    return _digest_of([parts, versions()])


@functools.cache
def _package():
    return Package(Path(__file__).parent.parent)


def path_for(folder: str | Path, kind: str, options, code: str, suffix: str = ".json") -> Path:
    """Path of the file for a result: ``folder/kind-HASH.json``."""
    return Path(folder) / f"{kind}-{_digest_of([options, code])}{suffix}"


def clear_temporaries(folder: str | Path, kind: str) -> None:
    """Remove what a killed run was writing; only while nobody else writes results of this kind."""
    for path in Path(folder).glob(f".{kind}-*"):
        path.unlink(missing_ok=True)


def write(path: Path, options, value):
    """Store ``value``, anything that JSON holds (NaN as null), with the options it belongs to."""
    value = plain(value)
    content = {"options": options, "check": _digest_of(value), "value": value}
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(content, allow_nan=False), encoding="utf-8")
    return value


def read(path: Path, options):
    """What `write` has stored for these options; None if there is nothing, or nothing sound."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["options"] == options and content["check"] == _digest_of(content["value"]):
            return content["value"]
    except FileNotFoundError:
        return None
    except (ValueError, KeyError, TypeError):
        pass
    return _damaged(path)


def write_arrays(path: Path, **arrays: np.ndarray) -> None:
    """Store arrays in an .npz file, whose parts carry checksums."""
    with replacing(path) as temporary:
        np.savez(temporary, **arrays)


def read_arrays(path: Path) -> dict[str, np.ndarray] | None:
    """The dict that `write_arrays` has stored; None if there is nothing, or nothing sound."""
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except FileNotFoundError:
        return None
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile):
        return _damaged(path)


def _damaged(path):
    print(f"{path.name} in the cache is damaged: computed again.", file=sys.stderr)


def plain(value):
    """The value as JSON gives it back: tuples as lists, NaN as None."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not np.isfinite(value) else value
