"""Models and checkpoints as files: arrays and a JSON header in one .npz, read with suspicion.

NumPy's own reader believes what a file says: an entry of a few kilobytes may inflate to gigabytes, and a shape of 10^12
is allocated before anything is read. Our files hold plain arrays without compression, so nothing is inflated here, what
is allocated is no larger than the file, and every size is compared before it is used.
"""

import json
import math
import re
import struct
import zipfile
from pathlib import Path

import numpy as np

from tras.io.limits import MAX_FILE
from tras.workflow.arguments import short

MAX_ENTRIES = 1000  # arrays of a file
MAX_HEADER = 2**22  # bytes of the JSON header: names of 10 000 functions
MAX_NUMBER = 1e100  # a larger one is damage, and its square would overflow
_DIRECTORY = 2**18  # bytes of the list of entries
_END = struct.Struct("<4s4H2LH")  # of a zip file: "ZIP File Format Specification", 4.3.16
_ARRAY = re.compile(
    rb"\{'descr': '([<|](?:f8|i[48]|b1|U[1-9]\d{0,7}))', 'fortran_order': (True|False), "
    rb"'shape': \(((?:\d{1,12},? ?)*)\), \} *\n"
)
# What zipfile raises on a damaged file.
_DAMAGE = (OSError, EOFError, ValueError, NotImplementedError, RuntimeError, zipfile.BadZipFile, struct.error)
_ZIP, _ENCRYPTED = b"PK\x05\x06", 0x1 | 0x40


def read_npz(path: Path, form: str) -> tuple[dict, dict[str, np.ndarray]]:
    """(header, arrays) of an .npz file of ours.

    Parameters
    ----------
    path : Path
    form : str
        The format that the JSON header must name.

    Raises
    ------
    ValueError
        With what is wrong, without the path: if it is no .npz file, is damaged, too large, compressed or encrypted,
        holds anything but plain arrays, or its header is of another format.
    """
    try:
        with open(path, "rb") as stream:
            _check_directory(stream)
            with zipfile.ZipFile(stream) as file:
                entries = _entries(file, stream.seek(0, 2))
                header = _header(file, entries.pop("header", None), form)
                return header, {name: _array(file, entry) for name, entry in entries.items()}
    except _DAMAGE as error:
        reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
        raise ValueError(short(reason, 120)) from error
    except MemoryError:
        raise ValueError("its arrays do not fit in memory") from None


def require_numbers(name: str, array: np.ndarray, shape: tuple, low: float = -MAX_NUMBER) -> np.ndarray:
    """The array, if it holds finite numbers from ``low`` to 1e100 and has this shape; None in it is any length."""
    array = np.asarray(array)
    if array.dtype.kind not in "fiu":
        raise ValueError(f"its {name} holds no numbers")
    if array.ndim != len(shape) or any(b is not None and a != b for a, b in zip(array.shape, shape)):
        needed = ", ".join("any" if length is None else str(length) for length in shape)
        raise ValueError(f"its {name} has the shape {array.shape} in place of ({needed})")
    if array.size and not (low <= array.min() and array.max() <= MAX_NUMBER):  # False for NaN
        raise ValueError(f"its {name} holds a number that is not finite or out of range")
    return array


def _check_directory(stream):
    """The list of entries is at the very end and of a size that we write, before zipfile reads it."""
    size = stream.seek(0, 2)
    if size > MAX_FILE:
        raise ValueError(f"it has {size} bytes, up to {MAX_FILE} are read")
    stream.seek(max(0, size - _END.size))
    end = stream.read(_END.size)
    if len(end) < _END.size or not end.startswith(_ZIP):
        raise ValueError("it is no .npz file, or its end is missing")
    _, disk, first, here, entries, length, start, comment = _END.unpack(end)
    if disk or first or here != entries or comment or start + length + _END.size != size:
        raise ValueError("its list of entries is damaged")
    if entries > MAX_ENTRIES or length > _DIRECTORY:
        raise ValueError(f"it has {entries} entries, up to {MAX_ENTRIES} are read")


def _entries(file, size):
    """Name of an array -> its entry; all of them together are no larger than the file."""
    entries = {}
    for entry in file.infolist():
        name = entry.filename.removesuffix(".npy")
        if name == entry.filename or name in entries:
            raise ValueError(f"its entry {entry.filename[:40]!r} is no array, or there twice")
        if entry.flag_bits & _ENCRYPTED:
            raise ValueError(f"its entry {name[:40]!r} is encrypted")
        if entry.compress_type != zipfile.ZIP_STORED or entry.file_size != entry.compress_size:
            raise ValueError(f"its entry {name[:40]!r} is compressed, which our files are not")
        entries[name] = entry
    if sum(entry.file_size for entry in entries.values()) > size:
        raise ValueError("its entries are larger than the file")
    return entries


def _array(file, entry):
    """What NumPy's format, version 1.0, holds; nothing is allocated but the entry itself."""
    with file.open(entry) as stream:
        content = stream.read(entry.file_size)
    start = 10 + int.from_bytes(content[8:10], "little")
    match = _ARRAY.fullmatch(content, 10, start) if content[:8] == b"\x93NUMPY\x01\x00" else None
    if not match:
        raise ValueError(f"its entry {entry.filename[:40]!r} is no plain array")
    kind, fortran, lengths = match.groups()
    dtype = np.dtype(kind.decode())
    shape = tuple(int(length) for length in re.findall(rb"\d+", lengths))
    if math.prod(shape) * dtype.itemsize != len(content) - start:
        raise ValueError(f"its entry {entry.filename[:40]!r} has another size than its shape {shape} needs")
    array = np.frombuffer(content, dtype, offset=start).copy()
    return array.reshape(shape, order="F" if fortran == b"True" else "C")


def _header(file, entry, form):
    if entry is None:
        raise ValueError("it holds no header")
    if entry.file_size > MAX_HEADER * 4:
        raise ValueError(f"its header has more than {MAX_HEADER} letters")
    array = _array(file, entry)
    if array.dtype.kind != "U" or array.ndim:
        raise ValueError("its header is no text")
    letters = array.reshape(1).view(np.uint32)
    if letters.max() > 0x10FFFF or ((letters >= 0xD800) & (letters <= 0xDFFF)).any():
        raise ValueError("its header is no text")
    try:
        header = json.loads(str(array), parse_constant=_constant)
    except RecursionError:
        raise ValueError("its header is nested too deep") from None
    if not isinstance(header, dict) or not isinstance(header.get("format"), str):
        raise ValueError("its header names no format")
    if header["format"] != form:
        raise ValueError(f"its format is {header['format'][:40]!r}, this release reads {form!r}")
    return header


def _constant(word):
    if word == "Infinity":  # the error of a strength that gave no model
        return math.inf
    raise ValueError(f"its header holds {word}")
