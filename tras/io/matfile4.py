"""MATLAB's files of version 4 (-v4, and Simulink's "To File" of old): matrices and texts one behind the other.

Layout: MathWorks, "MAT-File Format", "Level 4 MAT-files". The format has no checksum and no mark of its own.
"""

import struct

import numpy as np

from tras.io.limits import MAX_PARTS, MAX_VALUES, TOO_NESTED
from tras.io.roles import RecordingError
from tras.io.workspace import Unread

_TYPES = ("f8", "f4", "i4", "i2", "u2", "u1")
_LONGEST_NAME = 64  # bytes with the zero at its end: MATLAB has had at most 63 letters
_DAMAGED = "the file is damaged."


def is_version_4(start: bytes) -> bool:
    """Whether a file that begins with ``start``, 20 bytes or more, is of version 4: a sound first header."""
    return any(_is_header(start, endian) for endian in "<>")


def _is_header(start, endian):
    if len(start) < 20:
        return False
    code, rows, columns, imaginary, length = struct.unpack_from(endian + "5i", start)
    order, reserved, kind, form = code // 1000, code // 100 % 10, code // 10 % 10, code % 10
    numbers = rows >= 0 and columns >= 0 and imaginary in (0, 1) and 2 <= length <= _LONGEST_NAME
    return numbers and order == "<>".index(endian) and reserved == 0 and kind < len(_TYPES) and form <= 2


def read_variables(content: bytes) -> dict:
    """Name -> matrix (rows, columns) or text of every variable, `Unread` for complex and sparse ones."""
    variables, position, values = {}, 0, 0
    endian = "<" if _is_header(content, "<") else ">"
    while position < len(content):
        if len(variables) >= MAX_PARTS:
            raise RecordingError(TOO_NESTED)
        header = content[position : position + 20]
        if len(header) < 20:
            raise RecordingError("it ends in the middle of a variable; the file is not whole.")
        if not _is_header(header, endian):
            raise RecordingError(f"no variable begins at byte {position}, where one should; {_DAMAGED}")
        code, rows, columns, is_complex, length = struct.unpack(endian + "5i", header)
        start = position + 20 + length
        name = content[position + 20 : start]
        dtype, form = np.dtype(endian + _TYPES[code // 10 % 10]), code % 10
        values += rows * columns
        if values > MAX_VALUES:
            raise RecordingError(f"it has more than {MAX_VALUES} values.")
        size = rows * columns * dtype.itemsize
        position = start + size * (1 + is_complex)
        if position > len(content):
            raise RecordingError("it ends in the middle of a variable; the file is not whole.")
        name = name.removesuffix(b"\0").decode("ascii", "replace")
        if not name.isidentifier() or not name.isascii():
            raise RecordingError(f"a variable is called {name!r}, which is no name; {_DAMAGED}")
        if name in variables:
            raise RecordingError(f"the variable {name!r} is there twice; {_DAMAGED}")
        array = np.frombuffer(content, dtype, rows * columns, start).astype(float).reshape(rows, columns, order="F")
        if form == 2:
            variables[name] = Unread("a sparse matrix")
        elif is_complex:
            variables[name] = Unread("complex numbers")
        else:
            variables[name] = _text(name, array) if form == 1 else array
    return variables


def _text(name, array):
    if not ((array >= 0) & (array < 0x110000)).all():
        raise RecordingError(f"the text {name!r} has letters that do not exist; {_DAMAGED}")
    return "".join(map(chr, array.astype(int).ravel().tolist()))
