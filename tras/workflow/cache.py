"""Results in small files, each under the hash of what it depends on: its options and the code that computes it.

A result that is there is not computed again; one whose options or code changed has another name. A file that is
damaged, or that holds something else than its name says, is computed again, with a sentence that says so.
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


@functools.cache
def code_digest(*modules):
    """Digest of modules, of all that they need in turn, and of the versions of Python and the libraries.

    The modules count as `tras.workflow.staleness` reads them: without comments and docstrings.
    """
    package, parts = _package(), {}
    for module in sorted(package.closure(set(modules))):
        parts.update(package.fingerprint(module))
    return digest(json.dumps([parts, versions()], sort_keys=True))


@functools.cache
def _package():
    return Package(Path(__file__).parent.parent)


def place(folder, kind, options, code, suffix=".json"):
    """Path of the file for a result: ``folder/kind-HASH.json``."""
    return Path(folder) / f"{kind}-{digest(json.dumps([options, code], sort_keys=True))}{suffix}"


def clear_temporaries(folder, kind):
    """Remove what a killed run was writing; only while nobody else writes results of this kind."""
    for path in Path(folder).glob(f".{kind}-*"):
        path.unlink(missing_ok=True)


def write(path, options, value):
    """Store ``value``, anything that JSON holds (NaN as null), with the options it belongs to."""
    value = plain(value)
    content = {"options": options, "check": digest(json.dumps(value, sort_keys=True)), "value": value}
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(content, allow_nan=False), encoding="utf-8")
    return value


def read(path, options, say=None):
    """What `write` has stored for these options; None if there is nothing, or nothing sound, which ``say`` is told."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        sound = content["options"] == options and content["check"] == digest(
            json.dumps(content["value"], sort_keys=True)
        )
    except FileNotFoundError:
        return None
    except (ValueError, KeyError, TypeError):
        sound = False
    return content["value"] if sound else _damaged(path, say)


def write_arrays(path, **arrays):
    """Store arrays in an .npz file, whose parts carry checksums."""
    with replacing(path) as temporary:
        np.savez(temporary, **arrays)


def read_arrays(path, say=None):
    """The dict that `write_arrays` has stored; None if there is nothing, or nothing sound, which ``say`` is told."""
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except FileNotFoundError:
        return None
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile):
        return _damaged(path, say)


def _damaged(path, say):
    (say or _to_stderr)(f"{path.name} in the cache is damaged: computed again.")


def _to_stderr(sentence):
    print(sentence, file=sys.stderr)


def plain(value):
    """The value as JSON gives it back: tuples as lists, NaN as None."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not np.isfinite(value) else value
