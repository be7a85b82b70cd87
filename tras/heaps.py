"""A look at an HDF5 file before the library opens it: damage on which the library itself would go round for ever."""

import mmap
import struct

from tras.roles import RecordingError

_HEAP = b"GCOL\x01\x00\x00\x00"


def check(path):
    """Walk the global heaps (texts of variable length, references) as the library does; every step must lead on.

    An entry of index 0 and size 0 makes HDF5 (2.0 and before) walk on the spot, out of reach of any signal. Layout: "HDF5 File Format
    Specification", III.E.

    Raises
    ------
    RecordingError
        Where an entry does not lead to the next one.
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
        return  # the library sees that it is cut off
    end = min(start + struct.unpack_from("<Q", content, start + 8)[0], len(content))
    place = start + 16
    while place + 16 <= end:
        index, _, _, size = struct.unpack_from("<HHIQ", content, place)
        step = size if index == 0 else 16 + size + -size % 8
        if step < 16 or place + step > end:
            raise RecordingError(f"it is damaged: a heap of texts or references is broken at byte {place}")
        place += step
