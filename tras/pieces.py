"""Streams of recordings, files and datasets, piece by piece (`tras.lazy` says what a piece is)."""

import functools
import itertools
from pathlib import Path

from tras.lazy import Piece, RecordingDataset, RecordingFile, UnreadableError, spans
from tras.recording import Recording, require_alike

__all__ = ["Piece", "RecordingDataset", "RecordingFile", "Stream", "UnreadableError", "is_dataset", "without"]
_READABLE = (Recording, RecordingFile, RecordingDataset)


def is_dataset(source):
    """Whether it is an ``xarray.Dataset``; xarray is not imported to find out."""
    return hasattr(source, "data_vars") and hasattr(source, "sizes")


class Stream:
    """All pieces of a path, a file, a dataset, a recording, an iterable of them, or a callable that returns one.

    Attributes
    ----------
    once : bool
        Whether it can be read once only.
    template : Recording
        Its labels are those of all; known as soon as the first piece is.
    """

    def __init__(self, source, size, shared):
        self.source, self.size, self.shared, self.template = source, size, shared, None
        self.once = hasattr(source, "__next__")

    def pieces(self, first=0, last=None):
        """Each `Piece` in order, or those numbered ``first`` to ``last - 1``; from the beginning each time, unless it can be read once only."""
        for recording in self.recordings():
            count = sum(1 for _ in spans(recording.lengths, self.size, self.shared)) if first or last is not None else 0
            if first < count or not count:
                read = functools.partial(_in_memory, recording) if isinstance(recording, Recording) else recording.pieces
                yield from read(self.size, self.shared, first, last)
            first, last = max(0, first - count), None if last is None else last - count
            if last is not None and last <= 0:
                return

    def counts(self):
        """Pairs of each piece; nothing is read."""
        return [b - a - self.shared for recording in self.recordings() for _, a, b in spans(recording.lengths, self.size, self.shared)]

    def opened(self):
        """The same stream, of files that are open to be read anywhere and of recordings."""
        new = Stream(list(self.recordings()), self.size, self.shared)
        new.template = self.template
        return new

    def recordings(self):
        """Each recording, file or dataset in turn, all with the same channels."""
        source = self.source() if callable(self.source) else self.source
        for k, item in enumerate([source] if isinstance(source, (str, Path, *_READABLE)) or is_dataset(source) else source):
            recording = RecordingFile(item) if isinstance(item, (str, Path)) else RecordingDataset(item) if is_dataset(item) else item
            if not isinstance(recording, _READABLE):
                raise ValueError(f"recording {k} is {type(item).__name__}; give a tras.Recording, the path of a file or an xarray.Dataset.")
            if self.template is None:
                self.template = recording[:1] if isinstance(recording, Recording) else recording.nothing()
            require_alike(self.template, recording, k)
            yield recording

    def recording(self, pieces):
        """A `Recording` of some pieces."""
        x, u = zip(*((piece.x, piece.u) for piece in pieces))
        return self.template._with(list(x), list(u))


def without(piece, starts, length, shared):
    """What is left of a piece when the pairs ``start`` to ``start + length`` are taken out, for each start in order: a list of pieces."""
    left, begin = [], 0
    for start, after in [*((start, start + length) for start in starts), (piece.pairs, piece.pairs)]:
        if start > begin:
            left.append(Piece(piece.x[begin : start + shared], piece.u[begin : start + shared], start - begin))
        begin = after
    return left


def _in_memory(recording, size, shared, first=0, last=None):
    trajectories = list(recording)
    for i, a, b in itertools.islice(spans(recording.lengths, size, shared), first, last):
        x, u = trajectories[i]
        yield Piece(x[a:b], u[a:b], b - a - shared)
