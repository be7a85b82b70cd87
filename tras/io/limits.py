"""What the readers of files share: how a file of columns is handed on, and limits of size."""

import mmap
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from tras.io.roles import RecordingError
from tras.workflow import arguments

FORMAT = "tras recording 2"  # what a file of ours says that it is
MAX_VALUES = 10**8  # numbers of a recording: 800 MB
MAX_COLUMNS = 10_000
MAX_TEXT = 2**28  # bytes of a text file
MAX_FILE = 2**32  # bytes of any other
MAX_DEPTH = 8  # structs and cells in one another
MAX_PARTS = 100_000  # structs, cells and arrays of a file
TOO_NESTED = f"it is nested more than {MAX_DEPTH} deep or has more than {MAX_PARTS} parts; save the arrays."
_HEAP = b"GCOL\x01\x00\x00\x00"


class Source(NamedTuple):
    """An open file: names and units of its columns, and how to read them once their roles are known.

    ``read(roles)`` returns a list of dicts, one per trial of the file: name -> (rows,) floats. ``locate(trial, row)``
    says where a row is in the file. ``header`` is what `tras.Recording.write` wrote, or None; ``dt`` is a sampling time
    that the file states; ``remarks`` tell what was left out. ``roles`` are ``states`` and ``inputs`` that the file
    itself states, ``test`` the numbers of the trials that it calls its test or validation set, ``attributes`` what else
    a recording should keep. ``aliases`` are other names of columns: a scope's own time is the common ``time``.
    """

    names: list
    units: dict
    read: Callable
    locate: Callable
    header: dict | None = None
    dt: float | None = None
    remarks: list = []
    roles: dict = {}
    test: Sequence = ()
    attributes: dict = {}
    aliases: dict = {}


def one_line(error: Exception) -> str:
    """The message of a library's error in one line."""
    return arguments.one_line(str(error).strip("'")) or type(error).__name__


def check_size(rows: int, columns: int) -> None:
    """Refuse a table before memory is allocated for it."""
    if columns > MAX_COLUMNS:
        raise RecordingError(f"it has {columns} columns; up to {MAX_COLUMNS} are read.")
    if rows * max(columns, 1) > MAX_VALUES:
        raise RecordingError(
            f"it has {rows} rows of {columns} columns; up to {MAX_VALUES} values are read: cut it or leave columns out."
        )


def check_heaps(path: Path) -> None:
    """Refuse an HDF5 file with a global heap (texts, references) of which an entry does not lead to the next.

    An entry of index 0 and size 0 sends HDF5 (2.0 and earlier) into an endless loop that no signal interrupts, so the
    file is checked before the library opens it. Layout: "HDF5 File Format Specification", III.E.
    """
    with open(path, "rb") as file:
        if not file.seek(0, 2):
            return
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            start = content.find(_HEAP)
            while start >= 0:
                _walk(content, start)
                start = content.find(_HEAP, start + 1)


def _walk(content, start):
    if start + 16 > len(content):
        return  # the library reports that the file is cut off
    end = min(start + struct.unpack_from("<Q", content, start + 8)[0], len(content))
    entry = start + 16
    while entry + 16 <= end:
        index, _, _, size = struct.unpack_from("<HHIQ", content, entry)
        step = size if index == 0 else 16 + size + -size % 8
        if step < 16 or entry + step > end:
            raise RecordingError(f"it is damaged: a heap of texts or references is broken at byte {entry}")
        entry += step
