"""Recordings as files: .nc, .csv, .parquet, .mat. The readers execute nothing in a file and read no pickle.

Limits (`tras.io.limits`): 1e8 values, 10 000 columns, 256 MiB of text, 4 GiB of other files, structs and cells 8 deep.

A file of `write` states the roles of its columns. All but .csv also hold a checksum of names, units, numbers and
sampling time, which reveals damage. A CSV has none, because people may edit it: nobody notices a changed digit there.
"""

import hashlib
import json
import math
from pathlib import Path

import numpy as np

from tras.io import matlab, netcdf, sampling
from tras.io import text as delimited
from tras.io.limits import FORMAT, SUFFIXES
from tras.io.roles import RecordingError, assign
from tras.workflow.files import replacing

_LABELS = ("state_names", "state_units", "input_names", "input_units")


def write(recording, path, attributes):
    """See `tras.Recording.write`; ``attributes`` are the recording's, in the types of JSON."""
    path = known(path)
    labels = {key: getattr(recording, key) for key in _LABELS}
    header = _header(recording.dt, labels, attributes)
    if path.suffix != ".csv":
        header["checksum"] = checksum(header, recording)
    if path.suffix == ".nc":
        dataset = netcdf.to_xarray(recording, attributes).assign_attrs(checksum=header["checksum"])
        content = dataset.to_netcdf(engine="h5netcdf")  # in memory: on a full disk HDF5 cannot close a file
        with replacing(path) as temporary:
            temporary.write_bytes(content)
        return
    with replacing(path) as temporary:
        if path.suffix == ".csv":
            delimited.write_table(recording.to_frame(), header, temporary)
        elif path.suffix == ".mat":
            matlab.write_recording(recording, header, temporary)
        else:
            from tras.io import parquet

            parquet.write_table(recording.to_frame(), header, temporary)


def read(path, roles=None, *, dt=None, resample=None, missing="cut", tolerance=sampling.TOLERANCE):
    """The arguments of the `tras.Recording` that ``path`` holds; see `tras.Recording.read`."""
    path = known(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path} does not exist; `make all` makes the project's own recordings.")
    if path.suffix == ".nc":
        if roles is not None or dt is not None or resample is not None:
            raise RecordingError(
                f"{path}: a .nc file has its own roles and sampling time; leave roles, dt and resample out."
            )
        content, expected = netcdf.content(path)
        header = _header(content["dt"], {key: content[key] for key in _LABELS}, content["attributes"])
        if expected is not None and checksum(header, zip(content["states"], content["inputs"])) != expected:
            raise RecordingError("its content does not fit its checksum")
        return content
    source = _open(path)
    if source.header is not None and roles is None and dt is None:
        return _own(source, resample, missing, tolerance)
    if dt is not None:
        roles = {**_mapping(roles), "dt": dt}
    names = [name for name in source.names]
    chosen, guessed = assign(names, roles, source.units, source.dt)
    x, u, step, remarks = sampling.trajectories(
        source.read(chosen), chosen, source.locate, resample=resample, missing=missing, tolerance=tolerance
    )
    if guessed and "dt" not in (roles or {}):
        guessed.append(f"the sampling time is {step:g} s")
    return {
        "states": x, "inputs": u, "dt": step, "state_names": chosen.states, "input_names": chosen.inputs,
        "state_units": [chosen.units.get(name, "") for name in chosen.states],
        "input_units": [chosen.units.get(name, "") for name in chosen.inputs],
        "attributes": {"source": path.name, "guessed": guessed, "noticed": [*source.remarks, *remarks]},
    }  # fmt: skip


def _open(path):
    if path.suffix == ".parquet":
        from tras.io import parquet  # pyarrow takes a while

        return parquet.open_table(path)
    return (delimited if path.suffix == ".csv" else matlab).open_table(path)


def remarks(recording):
    """Sentences on what the reader of a file guessed and noticed, or [].

    Examples
    --------
    >>> import tras
    >>> r = tras.Recording([[[1.0], [2.0]]], dt=1, attributes={"guessed": ["time is column t"]})
    >>> print(*remarks(r))
    Guessed: time is column t.
    """
    said = []
    for key, word in (("guessed", "Guessed"), ("noticed", "Noticed")):
        sentences = recording.attributes.get(key, [])
        said += [f"{word}: {sentence}." for sentence in sentences] if isinstance(sentences, list) else []
    return said


def checksum(header, trajectories):
    """SHA-256 of the header (without its own checksum) and all numbers."""
    total = hashlib.sha256(
        json.dumps({key: value for key, value in header.items() if key != "checksum"}, sort_keys=True).encode()
    )
    for x, u in trajectories:
        for array in (x, u):
            total.update(repr(array.shape).encode())
            total.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
    return total.hexdigest()


def known(path):
    """``path`` if its suffix is one of ours."""
    path = Path(path)
    if path.suffix not in SUFFIXES:
        raise RecordingError(
            f"path {path} ends in {path.suffix!r}; recordings are NetCDF-4 (.nc), .csv, .parquet or MATLAB's .mat files."
        )
    return path


def _mapping(roles):
    """Roles as a dict, to which another can be added."""
    from tras.io.roles import _read

    return _read(roles)


def _header(dt, labels, attributes):
    return {
        "format": FORMAT, "dt": dt, "states": list(labels["state_names"]), "state_units": list(labels["state_units"]),
        "inputs": list(labels["input_names"]), "input_units": list(labels["input_units"]), "attributes": attributes,
    }  # fmt: skip


def _checked(header):
    """The header of `_header`, or an error: another program may have changed it."""
    if header.get("format") != FORMAT:
        raise RecordingError(f"its format is {str(header.get('format'))[:40]!r}, this release reads {FORMAT!r}.")
    texts = ("states", "state_units", "inputs", "input_units")
    sound = all(
        isinstance(header.get(key), list) and all(isinstance(text, str) for text in header[key]) for key in texts
    )
    sound = (
        sound
        and isinstance(header.get("dt"), float)
        and 0 < header["dt"] < math.inf
        and isinstance(header.get("attributes"), dict)
    )
    if not sound:
        raise RecordingError("its own description of channels and sampling time is damaged; read it with roles.")
    return header


def _own(source, resample, missing, tolerance):
    """The content of a file of `write`."""
    header = _checked(source.header)
    given = {"states": header["states"], "inputs": header["inputs"], "dt": header["dt"], "time": None, "trial": None}
    if "time" in source.names:
        given |= {"time": "time", "trial": "trajectory"}
    chosen, _ = assign(source.names, given, {})
    x, u, dt, remarks = sampling.trajectories(
        source.read(chosen), chosen, source.locate, resample=resample, missing=missing, tolerance=tolerance
    )
    attributes = dict(header["attributes"])
    if resample is None and "checksum" in header and checksum(header, zip(x, u)) != header["checksum"]:
        raise RecordingError(
            "its numbers do not fit its checksum: it was damaged, or changed by another program; read it with roles if you trust it."
        )
    if resample is not None or any("missing" in remark for remark in remarks):
        attributes["noticed"] = remarks
    labels = {key: header[key] for key in ("state_units", "input_units")}
    return {
        "states": x,
        "inputs": u,
        "dt": dt,
        "state_names": header["states"],
        "input_names": header["inputs"],
        **labels,
        "attributes": attributes,
    }
