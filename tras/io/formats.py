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

from tras.io import matlab, netcdf, parquet, sampling, several, text
from tras.io.limits import FORMAT, MAX_FILE
from tras.io.question import screen
from tras.io.roles import Question, RecordingError, Roles, assign, mapping
from tras.workflow.arguments import one_line, well_formed
from tras.workflow.files import replacing

if TYPE_CHECKING:
    from tras.recording import Recording

# Suffix -> its module: open_table(path) returns a `tras.io.limits.Source`, write_recording(recording, header, path).
FORMATS = {".nc": netcdf, ".csv": text, ".parquet": parquet, ".mat": matlab}
FORMATS |= dict.fromkeys((".txt", ".dat", ".tsv", ".log", ".lvm"), text)  # in any case: .CSV
_POINTER = b"version https://git-lfs.github.com/spec/"


def write(recording, path, attributes):
    """See `tras.Recording.write`; ``attributes`` are the recording's, in the types of JSON."""
    path = known(path)
    header = {"format": FORMAT, "dt": recording.dt}
    for role in ("state", "input"):
        header[f"{role}s"] = list(getattr(recording, f"{role}_names"))
        header[f"{role}_units"] = list(getattr(recording, f"{role}_units"))
    header["attributes"] = attributes
    if module_of(path) is not text:
        header["checksum"] = checksum(header, recording)
    with replacing(path) as temporary:
        module_of(path).write_recording(recording, header, temporary)


# Infinite and huge numbers of a file pass through sums and differences on the way to being refused.
_QUIETLY = {"over": "ignore", "invalid": "ignore", "divide": "ignore"}


@np.errstate(**_QUIETLY)
def read(paths, roles=None, *, dt=None, test=None, wishes=sampling.AS_IT_IS) -> dict:
    """The arguments of the `tras.Recording` that files hold; see `tras.Recording.read`.

    Parameters
    ----------
    paths : list of path
        One file, or several that are trials or signals of one recording.
    roles, dt
        As there.
    test : list of path or of int, optional
        More files, or numbers of trials (from 1), for the test.
    wishes : tras.io.sampling.Wishes
    """
    held_back = [path for path in test or () if not isinstance(path, int)]
    paths, sources = [known(path) for path in paths], [_opened(path) for path in paths]
    source = sources[0] if len(sources) == 1 else several.joined(paths, sources)
    if held_back:
        source = several.with_test(paths, source, [known(path) for path in held_back], list(map(_opened, held_back)))
    trials = [number for number in test or () if isinstance(number, int)]
    return recording_of(
        source, paths, roles, dt=dt, trials=trials, wishes=wishes, alone=len(paths) == 1 and not held_back
    )


@np.errstate(**_QUIETLY)
def recording_of(source, paths, roles, *, dt=None, trials=None, wishes=sampling.AS_IT_IS, alone=True) -> dict:
    """As `read`, of an open ``source`` of the files ``paths``; ``trials`` are the test, ``alone``: a single file."""
    header = _checked(source.header) if source.header is not None and roles is None and dt is None else None
    source = source._replace(dt=header["dt"]) if header else source
    spec = mapping(roles) | ({} if dt is None else {"dt": dt})
    source, spec = several.side_by_side(source, spec) if spec else (source, spec)
    columns, guesses = _roles(source, header, spec, paths)
    x, u, step, noticed, origins = sampling.trajectories(source.read(columns), columns, source.locate, wishes=wishes)
    if header and wishes.resample is None:
        step = header["dt"] * wishes.decimate
    content = {"states": x, "inputs": u, "dt": step, "state_names": columns.states, "input_names": columns.inputs}
    of_test = _test(origins, source.test, trials or [])
    if header:
        changed = wishes != sampling.AS_IT_IS or not alone
        if not changed and "checksum" in header and checksum(header, zip(x, u)) != header["checksum"]:
            raise RecordingError(
                "its numbers do not fit its checksum: it was damaged, or changed by another program; "
                "read it with roles if you trust it."
            )
        attributes = dict(header["attributes"])
        if changed or any("missing" in remark for remark in noticed):
            attributes["noticed"] = [*source.remarks, *noticed]
        units = {key: header[key] for key in ("state_units", "input_units")}
    else:
        if guesses and columns.dt is None:
            guesses.append(f"the sampling time is {step:g} s")
        units = [[columns.units.get(name, "") for name in names] for names in (columns.states, columns.inputs)]
        units = dict(zip(("state_units", "input_units"), units))
        attributes = {"source": ", ".join(path.name for path in paths) or "dataframe", "guessed": guesses}
        attributes["noticed"] = [*source.remarks, *noticed]
        if between := source.attributes.get("intersample"):
            attributes["intersample"] = {name: between[name] for name in columns.inputs if name in between}
    if of_test:
        attributes["test_trajectories"] = of_test
    return {**content, **units, "attributes": attributes}


def _opened(path):
    """The `Source` of a file."""
    path = known(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path} does not exist; `make all` makes the project's own recordings.")
    if path.stat().st_size > MAX_FILE:
        raise RecordingError(f"it has {path.stat().st_size} bytes; up to {MAX_FILE} are read.")
    with open(path, "rb") as file:
        if file.read(len(_POINTER)) == _POINTER:
            raise RecordingError("it is a pointer of Git LFS in place of the file: get the file by `git lfs pull`.")
    return module_of(path).open_table(path)


def _roles(source, header, spec, paths):
    """The roles of a source's columns, as its own header has them, specified or guessed; and the guesses."""
    if header:
        spec = {key: header[key] for key in ("states", "inputs")}
        in_table = "time" in source.names
        spec |= (
            {"time": "time", "trial": "trajectory", "units": {"time": "s"}}
            if in_table
            else {"time": None, "trial": None, "dt": header["dt"]}
        )
    else:
        if isinstance(spec.get("time"), str):
            spec["time"] = source.aliases.get(spec["time"], spec["time"])
        spec = _with_those_of_the_file(spec, source)
    cache = {}

    def values(name):
        """The column's numbers in the first trial, or None."""
        if name not in cache:
            try:
                cache[name] = source.read(Roles(name, [], [], None, None, {}))[0][name]
            except RecordingError:
                cache[name] = None
        return cache[name]

    try:
        with np.errstate(over="ignore", invalid="ignore"):  # of columns that hold infinity
            return assign(source.names, spec, source.units, source.dt, values)
    except Question as question:
        remarks = "".join(f"\nNoticed: {one_line(remark)}." for remark in source.remarks)
        raise RecordingError(screen(question, paths) + remarks) from None


def _test(origins, tables, trials):
    """The numbers of the trajectories that the file or the user holds back."""
    count = max((trial for _, trial in origins), default=-1) + 1
    for number in trials:
        if not 1 <= number <= count:
            raise RecordingError(f"test names trial {number}; there are {count}, counted from 1.")
    return [i for i, (table, trial) in enumerate(origins) if table in tables or trial + 1 in trials]


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
    well_formed("path", str(path), RecordingError)
    if path.suffix.lower() not in FORMATS:
        raise RecordingError(f"path {path} ends in {path.suffix!r}; recordings are files of {', '.join(FORMATS)}.")
    return path


def module_of(path: Path):
    """The module that reads and writes files of this suffix."""
    return FORMATS[path.suffix.lower()]


def _with_those_of_the_file(spec, source):
    """The roles of ``spec``; those it leaves open as the file states them."""
    given = {*spec.get("states", ()), *spec.get("inputs", ())}
    stated = {role: [name for name in names if name not in given] for role, names in source.roles.items()}
    return {**stated, **spec}


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
