"""Which files are read, what every reader of tables gives, and how large a file may be."""

from typing import Callable, NamedTuple

from tras.roles import RecordingError

FORMAT = "tras recording 2"  # what a file of ours says that it is
SUFFIXES = (".nc", ".csv", ".parquet", ".mat")
MAX_VALUES = 10**8  # numbers of a recording: 800 MB
MAX_COLUMNS = 10_000
MAX_TEXT = 2**28  # bytes of a text file
MAX_FILE = 2**32  # bytes of any other
MAX_DEPTH = 8  # structs and cells in one another
MAX_PARTS = 100_000  # structs, cells and arrays of a file


class Source(NamedTuple):
    """A file that is open: names and units of its columns, and how to read them once their roles are known.

    ``read(roles)`` gives a list of dicts, one a trial of the file: name -> (rows,) floats. ``place(trial, row)`` says where that is.
    ``header`` is what `tras.Recording.write` has put there, or None; ``dt`` a sampling time that the file has, ``remarks`` what was
    left aside.
    """

    names: list
    units: dict
    read: Callable
    place: Callable
    header: dict | None = None
    dt: float | None = None
    remarks: list = []


def said(error):
    """What a library said, in one line."""
    return " ".join(str(error).strip("'").split()) or type(error).__name__


def check_size(rows, columns):
    """Refuse a table before room is made for it."""
    if columns > MAX_COLUMNS:
        raise RecordingError(f"it has {columns} columns; up to {MAX_COLUMNS} are read.")
    if rows * max(columns, 1) > MAX_VALUES:
        raise RecordingError(f"it has {rows} rows of {columns} columns; up to {MAX_VALUES} values are read: cut it, or leave columns out.")
