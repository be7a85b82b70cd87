"""What an artefact holds, for comparison: columns of numbers, or a small grey picture; and its copy in `reference/`.

The committed file stands for a figure and its table. Of the rest `reference/` holds a copy as text: a table (.csv) as
it is, compressed if it is long; a recording (.nc) as a thinned table; a model (.npz) with one number per line.
"""

import collections
import contextlib
import csv
import hashlib
import json
import lzma
import subprocess
import tempfile
from pathlib import Path

from tras.workflow.files import replacing

# No NumPy at the top: with equal bytes there is nothing to read.

PLAIN = 100_000  # bytes; a longer table is compressed
PACKED = ".xz"
ROWS = 250  # rows of a recording, or elements of an array, that its thinned copy keeps
SMALLER = 4  # pixels of a picture to one, each way
PICTURES = (".png", ".gif")
DRAWINGS = (".pdf", ".svg")  # compared by their checksum only, and not in git
COMMITTED = "figures"  # the folder whose files, drawings aside, are in git
FRAMES = 5  # of an animation, from the first to the last


# --- artefacts as columns of numbers ----------------------------------------------------------------------------------


def read_columns(path: Path) -> dict:
    """The content of a table (.csv), a recording (.nc) or a model (.npz).

    Returns
    -------
    dict of str to ndarray
        Column -> (rows,) whole numbers, floats or text; the arrays of a model are flattened, so lengths differ.

    Raises
    ------
    ValueError
        If the file cannot be read.
    """
    reader = {".csv": _read_csv, ".nc": _read_recording, ".npz": _read_arrays}[path.suffix]
    try:
        return reader(path)
    except Exception as error:  # a damaged file makes its reader raise anything
        raise ValueError(f"{path} cannot be read ({error})") from error


def _read_csv(path):
    names, *rows = _fields(path)
    if not rows or any(len(row) != len(names) for row in rows):
        raise ValueError(f"its lines do not all have {len(names)} fields" if rows else "it has no rows")
    return {name: _typed(values) for name, values in zip(names, zip(*rows))}


def _fields(path):
    """The fields of each line, the heading first."""
    opened = lzma.open if path.suffix == PACKED else open
    with opened(path, "rt", encoding="utf-8", newline="") as file:
        return list(csv.reader(file, strict=True))


def _read_recording(path):
    from tras.recording import Recording

    frame = Recording.read(path).to_frame()
    return {name: frame[name].to_numpy() for name in frame}


def _read_arrays(path):
    """Arrays, their shapes, and the leaves of the JSON header; versions are no part of the result."""
    import numpy as np

    columns = {}
    with np.load(path, allow_pickle=False) as file:
        for name in file.files:
            array = file[name]
            if name == "header":
                header = {key: value for key, value in json.loads(str(array)).items() if key != "versions"}
                columns |= {f"header.{key}": _typed([text(leaf)]) for key, leaf in _leaves(header)}
                continue
            columns[f"{name}.shape"] = np.array([str(array.shape)])
            parts = {".real": array.real, ".imag": array.imag} if array.dtype.kind == "c" else {"": array}
            columns |= {name + part: values.ravel() for part, values in parts.items() if array.size}
    return columns


def _leaves(value, name=""):
    """(dotted name, leaf) of nested dicts and lists."""
    if not isinstance(value, (dict, list)):
        yield name, value
        return
    for key, item in value.items() if isinstance(value, dict) else enumerate(value):
        yield from _leaves(item, f"{name}.{key}".lstrip("."))


def _typed(values):
    """Strings as an array of the narrowest of: whole numbers, floats (an empty field is NaN), text."""
    import numpy as np

    for kind in (int, float):
        try:
            return np.array([kind(value or "nan") for value in values], dtype=kind)
        except (ValueError, OverflowError):
            pass
    return np.array(values, dtype=str)


def text(value) -> str:
    """A number as the copies hold it: twelve digits."""
    return f"{value:.12g}" if isinstance(value, float) else str(value)


# --- what stands for them in the reference ----------------------------------------------------------------------------


def copy_of(artefact: Path, reference: Path) -> Path | None:
    """The copy of an artefact in the folder ``reference``; None if git has it or only its checksum counts."""
    if artefact.parts[0] == COMMITTED or artefact.suffix in (*DRAWINGS, *PICTURES):
        return None
    return stored(reference / (artefact if artefact.suffix == ".csv" else artefact.with_name(artefact.name + ".csv")))


def stored(path: Path) -> Path:
    """The compressed form of a table, if that is what there is; else the path itself."""
    packed = path.with_name(path.name + PACKED)
    return packed if packed.is_file() else path


@contextlib.contextmanager
def committed(artefact: Path, checksum: str):
    """A temporary path of the file that the last commit has; `FileNotFoundError` unless it has that SHA-256."""
    try:
        command = ["git", "show", f"HEAD:./{artefact.as_posix()}"]
        content = subprocess.run(command, capture_output=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError):
        advice = "clone the repository, or commit the file"
        raise FileNotFoundError(f"git has no {artefact} to compare with: {advice}") from None
    if hashlib.sha256(content).hexdigest() != checksum:
        advice = "commit it together with the reference"
        raise FileNotFoundError(f"git has another {artefact} than the reference names: {advice}")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / artefact.name
        path.write_bytes(content)
        yield path


def write_copy(artefact: Path, reference: Path) -> Path | None:
    """Write the copy of an artefact, if it has one: its path; `ValueError` if the artefact cannot be read."""
    copy = copy_of(artefact, reference)
    if copy is None:
        return None
    columns = read_columns(artefact)
    if artefact.suffix == ".csv":
        return write_packed(reference / artefact, artefact.read_bytes())
    with replacing(copy) as temporary:
        _write_thinned(columns, temporary)
    return copy


def write_packed(path: Path, content: bytes) -> Path:
    """Write a table, compressed if it is long, in place of its other form: the path with its suffix."""
    packed = path.with_name(path.name + PACKED)
    final, other = (packed, path) if len(content) > PLAIN else (path, packed)
    with replacing(final) as temporary:
        temporary.write_bytes(lzma.compress(content, preset=9) if final == packed else content)
    other.unlink(missing_ok=True)
    return final


def _write_thinned(columns, path):
    """Write some of the rows: their numbers beside the columns, or one line per number where lengths differ."""
    import numpy as np

    rows = {name: np.linspace(0, len(column) - 1, ROWS).round().astype(int) for name, column in columns.items()}
    rows = {name: np.unique(numbers) for name, numbers in rows.items()}
    texts = {name: [text(value) for value in column[rows[name]].tolist()] for name, column in columns.items()}
    if len({len(column) for column in columns.values()}) == 1:
        lines = [("#row", *columns), *zip(next(iter(rows.values())), *texts.values())]
    else:
        lines = [("#array", "#row", "#value")]
        lines += [(name, *pair) for name in columns for pair in zip(rows[name], texts[name])]
    with open(path, "w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(lines)


def read_copy(path: Path) -> dict:
    """A copy of columns, or a whole table: name -> (row numbers or None for all, values).

    Raises
    ------
    ValueError
        If it cannot be read.
    """
    try:
        names, *lines = _fields(path)
        if names != ["#array", "#row", "#value"]:
            columns = _read_csv(path)
            rows = columns.pop("#row", None)
            return {name: (rows, values) for name, values in columns.items()}
        groups = collections.defaultdict(lambda: ([], []))
        for name, row, value in lines:
            groups[name][0].append(int(row))
            groups[name][1].append(value)
        return {name: (rows, _typed(values)) for name, (rows, values) in groups.items()}
    except (OSError, EOFError, ValueError, csv.Error, lzma.LZMAError) as error:
        raise ValueError(f"{path} cannot be read ({error}): git checkout {path}") from error


def picture(path: Path):
    """A picture in small: float array (height, width) of grey levels, 0 to 255; `ValueError` if it cannot be read."""
    levels = _levels(path)
    height, width = (size // SMALLER * SMALLER for size in levels.shape)
    blocks = levels[:height, :width].reshape(height // SMALLER, SMALLER, width // SMALLER, SMALLER)
    return (255 * blocks.mean(axis=(1, 3))).round()


def _levels(path):
    """Grey, 0 to 1, of every pixel; transparent is white. Of an animation some frames, one below the other."""
    import matplotlib.image

    try:
        levels = _some_frames(path) if path.suffix == ".gif" else matplotlib.image.imread(path).astype(float)
    except Exception as error:  # a damaged file makes its reader raise anything
        raise ValueError(f"{path} cannot be read ({error})") from error
    if levels.ndim == 2:
        return levels
    opaque = levels[..., 3] if levels.shape[2] == 4 else 1.0
    return 1 - opaque * (1 - levels[..., :3].mean(axis=2))


def _some_frames(path):
    """(FRAMES * height, width, 3), 0 to 1."""
    import numpy as np
    from PIL import Image

    frames = []
    with Image.open(path) as film:
        for number in np.linspace(0, film.n_frames - 1, FRAMES).round().astype(int).tolist():
            film.seek(number)
            frames.append(np.asarray(film.convert("RGB")) / 255)
    return np.concatenate(frames)
