"""Recordings as files, whose readers execute nothing in them and read no pickle.

Limits (`tras.io.limits`): 1e8 values, 10 000 columns, 256 MiB of text, 4 GiB of other files, structs and cells 8 deep.

A file of `write` states the roles of its columns. All but .csv also hold a checksum of names, units, numbers and
sampling time, which reveals damage. A CSV has none, because people may edit it: nobody notices a changed digit there.
"""

import hashlib
import json
import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tras.io import matlab, netcdf, parquet, sampling, text
from tras.io.limits import FORMAT, MAX_FILE
from tras.io.roles import RecordingError, assign, mapping
from tras.workflow.files import replacing

if TYPE_CHECKING:
    from tras.recording import Recording

# Suffix -> its module: open_table(path) returns a `tras.io.limits.Source`, write_recording(recording, header, path).
FORMATS = {".nc": netcdf, ".csv": text, ".parquet": parquet, ".mat": matlab}


def write(recording, path, attributes):
    """See `tras.Recording.write`; ``attributes`` are the recording's, in the types of JSON."""
    path = known(path)
    header = {"format": FORMAT, "dt": recording.dt}
    for role in ("state", "input"):
        header[f"{role}s"] = list(getattr(recording, f"{role}_names"))
        header[f"{role}_units"] = list(getattr(recording, f"{role}_units"))
    header["attributes"] = attributes
    if path.suffix != ".csv":
        header["checksum"] = checksum(header, recording)
    with replacing(path) as temporary:
        FORMATS[path.suffix].write_recording(recording, header, temporary)


def read(path, roles=None, *, dt=None, resample=None, missing="cut", tolerance=sampling.TOLERANCE) -> dict:
    """The arguments of the `tras.Recording` that ``path`` holds; see `tras.Recording.read`."""
    path = known(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path} does not exist; `make all` makes the project's own recordings.")
    if path.stat().st_size > MAX_FILE:
        raise RecordingError(f"it has {path.stat().st_size} bytes; up to {MAX_FILE} are read.")
    source = FORMATS[path.suffix].open_table(path)
    header = _checked(source.header) if source.header is not None and roles is None and dt is None else None
    if header:
        roles = {**{key: header[key] for key in ("states", "inputs", "dt")}, "time": None, "trial": None}
        if "time" in source.names:
            roles |= {"time": "time", "trial": "trajectory"}
    elif dt is not None:
        roles = {**mapping(roles), "dt": dt}
    columns, guesses = assign(source.names, roles, source.units, source.dt)
    x, u, step, noticed = sampling.trajectories(
        source.read(columns), columns, source.locate, resample=resample, missing=missing, tolerance=tolerance
    )
    content = {"states": x, "inputs": u, "dt": step, "state_names": columns.states, "input_names": columns.inputs}
    if header:
        if resample is None and "checksum" in header and checksum(header, zip(x, u)) != header["checksum"]:
            raise RecordingError(
                "its numbers do not fit its checksum: it was damaged, or changed by another program; "
                "read it with roles if you trust it."
            )
        changed = resample is not None or any("missing" in remark for remark in noticed)
        attributes = header["attributes"] | ({"noticed": noticed} if changed else {})
        units = {key: header[key] for key in ("state_units", "input_units")}
        return {**content, **units, "attributes": attributes}
    if guesses and "dt" not in (roles or {}):
        guesses.append(f"the sampling time is {step:g} s")
    units = [[columns.units.get(name, "") for name in names] for names in (columns.states, columns.inputs)]
    attributes = {"source": path.name, "guessed": guesses, "noticed": [*source.remarks, *noticed]}
    return {**content, "state_units": units[0], "input_units": units[1], "attributes": attributes}


def remarks(recording: "Recording") -> list[str]:
    """Sentences on what the reader of a file guessed and noticed, or [].

    Examples
    --------
    >>> import tras
    >>> r = tras.Recording([[[1.0], [2.0]]], dt=1, attributes={"guessed": ["time is column t"]})
    >>> print(*remarks(r))
    Guessed: time is column t.
    """
    lists = {key: recording.attributes.get(key) for key in ("guessed", "noticed")}
    return [f"{key.title()}: {remark}." for key, value in lists.items() if isinstance(value, list) for remark in value]


def checksum(header: dict, trajectories) -> str:
    """SHA-256 of the header (without its own checksum) and all numbers."""
    labels = {key: value for key, value in header.items() if key != "checksum"}
    total = hashlib.sha256(json.dumps(labels, sort_keys=True).encode())
    for x, u in trajectories:
        for array in (x, u):
            total.update(repr(array.shape).encode())
            total.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
    return total.hexdigest()


def known(path: str | Path) -> Path:
    """``path`` if its suffix is one of ours."""
    path = Path(path)
    if path.suffix not in FORMATS:
        raise RecordingError(f"path {path} ends in {path.suffix!r}; recordings are files of {', '.join(FORMATS)}.")
    return path


def _checked(header):
    """The header that `write` wrote, or an error: another program may have changed it."""
    if header.get("format") != FORMAT:
        raise RecordingError(f"its format is {str(header.get('format'))[:40]!r}, this release reads {FORMAT!r}.")
    labels = [header.get(key) for key in ("states", "state_units", "inputs", "input_units")]
    dt, attributes = header.get("dt"), header.get("attributes")
    sound = all(isinstance(label, list) and all(isinstance(entry, str) for entry in label) for label in labels)
    if not (sound and isinstance(dt, float) and 0 < dt < math.inf and isinstance(attributes, dict)):
        raise RecordingError("its own description of channels and sampling time is damaged; read it with roles.")
    return header
