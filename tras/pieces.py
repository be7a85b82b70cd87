"""Data larger than memory, piece by piece: files that are read in slices, and streams of recordings.

A piece is a stretch of one trajectory. Neighbours share as many samples as a snapshot pair reaches over, so no pair is lost, and none reaches from one
trajectory into the next.
"""

import functools
import itertools
from pathlib import Path
from typing import NamedTuple

import h5netcdf
import numpy as np

from tras.netcdf import FORMAT
from tras.recording import Recording, require_alike


class UnreadableError(ValueError):
    """A piece of a file cannot be read, or holds what is no number."""


class Piece(NamedTuple):
    """Samples (pairs + shared, n) and (pairs + shared, m) of one trajectory, in physical units."""

    x: np.ndarray
    u: np.ndarray
    pairs: int


class RecordingFile:
    """A file that `Recording.write` has written, of which nothing is loaded but names and lengths.

    Parameters
    ----------
    path : str or pathlib.Path

    Attributes
    ----------
    dt, state_names, state_units, input_names, input_units, lengths, pairs
        As of a `Recording`.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is not a NetCDF-4 file or not a recording.
    """

    def __init__(self, path):
        self.path = Path(path)
        if self.path.suffix != ".nc":
            raise ValueError(f"{self.path} ends in {self.path.suffix!r}; only .nc files are read piece by piece: write one with Recording.write.")
        if not self.path.is_file():
            raise FileNotFoundError(f"{self.path} does not exist; give the path of a file that Recording.write has written.")
        try:
            with h5netcdf.File(self.path, "r") as file:
                if file.attrs.get("format") != FORMAT:
                    raise ValueError(f"its attribute 'format' is {file.attrs.get('format')!r}, not {FORMAT!r}")
                self.dt = float(file.attrs["sampling_time"])
                self.lengths = np.array(file.variables["row_size"][:])
                samples = file.dimensions["sample"].size
                if self.lengths.sum() != samples:
                    raise ValueError(f"row_size sums to {self.lengths.sum()} but there are {samples} samples")
                for role in ("state", "input"):
                    names, units = _labels(file, role)
                    setattr(self, f"{role}_names", names)
                    setattr(self, f"{role}_units", units)
        except (OSError, KeyError, AttributeError, TypeError, ValueError, RuntimeError) as error:
            raise ValueError(f"{self.path} cannot be read as a recording ({error}); make it again with Recording.write.") from error

    @property
    def pairs(self):
        """Number of snapshot pairs."""
        return int(np.sum(self.lengths - 1))

    def __len__(self):
        return len(self.lengths)

    def __repr__(self):
        channels = f"states {', '.join(self.state_names)}; inputs {', '.join(self.input_names) or 'none'}"
        return f"RecordingFile: {self.path.name}, {len(self)} trajectories, {self.pairs} pairs at {self.dt:g} s; {channels}"

    def select(self, *, states=None, inputs=None):
        """The same file with only the named channels, in the order given."""
        new = object.__new__(RecordingFile)
        new.__dict__.update(self.__dict__)
        empty = self.nothing().select(states=states, inputs=inputs)
        for label in ("state_names", "state_units", "input_names", "input_units"):
            setattr(new, label, getattr(empty, label))
        return new

    def nothing(self):
        """A `Recording` with this file's labels and one sample of zeros."""
        labels = {label: getattr(self, label) for label in ("state_names", "state_units", "input_names", "input_units")}
        return Recording(np.zeros((1, 1, len(self.state_names))), np.zeros((1, 1, len(self.input_names))), self.dt, **labels)

    def pieces(self, size, shared=1, first=0, last=None):
        """Every `Piece` of at most ``size`` pairs, in order; or only those of the numbers ``first`` to ``last - 1``.

        Raises
        ------
        UnreadableError
            With file, trajectory and samples.
        """
        starts = np.cumsum(self.lengths) - self.lengths
        try:
            file = h5netcdf.File(self.path, "r")
        except OSError as error:
            raise UnreadableError(f"{self.path} cannot be opened any more ({error}); put it back.") from error
        with file:
            for i, a, b in itertools.islice(_spans(self.lengths, size, shared), first, last):
                both = (self.state_names, self.input_names)
                yield Piece(*(self._read(file, names, starts[i], i, a, b) for names in both), b - a - shared)  # and keep nothing of it

    def _read(self, file, names, start, i, first, last):
        values = np.empty((last - first, len(names)))
        for column, name in zip(values.T, names):
            try:
                column[:] = file.variables[name][start + first : start + last]
            except (OSError, RuntimeError, KeyError) as error:
                raise UnreadableError(
                    f"{self.path}: channel {name!r} of trajectory {i} cannot be read between its samples {first} and {last - 1} ({error}); "
                    "restore the file, or leave the trajectory out."
                ) from error
        if not np.isfinite(values).all():
            sample, channel = np.argwhere(~np.isfinite(values))[0]
            raise UnreadableError(
                f"{self.path}: channel {names[channel]!r} is {values[sample, channel]} in trajectory {i} at sample {first + sample}; "
                "repair it or cut the trajectory there."
            )
        return values


class Stream:
    """All pieces of a path, a file, a recording, an iterable of them, or a callable that returns one.

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
            count = sum(1 for _ in _spans(recording.lengths, self.size, self.shared)) if first or last is not None else 0
            if first < count or not count:
                read = recording.pieces if isinstance(recording, RecordingFile) else functools.partial(_in_memory, recording)
                yield from read(self.size, self.shared, first, last)
            first, last = max(0, first - count), None if last is None else last - count
            if last is not None and last <= 0:
                return

    def counts(self):
        """Pairs of each piece; nothing is read."""
        return [b - a - self.shared for recording in self.recordings() for _, a, b in _spans(recording.lengths, self.size, self.shared)]

    def opened(self):
        """The same stream, of files that are open to be read anywhere and of recordings."""
        new = Stream(list(self.recordings()), self.size, self.shared)
        new.template = self.template
        return new

    def recordings(self):
        """Each recording or file in turn, all with the same channels."""
        single = isinstance(self.source, (str, Path, Recording, RecordingFile))
        items = [self.source] if single else self.source() if callable(self.source) else self.source
        for k, item in enumerate([items] if isinstance(items, (Recording, RecordingFile)) else items):
            recording = RecordingFile(item) if isinstance(item, (str, Path)) else item
            if not isinstance(recording, (Recording, RecordingFile)):
                raise ValueError(f"recording {k} is {type(item).__name__}; give a tras.Recording or the path of a file.")
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
    for i, a, b in itertools.islice(_spans(recording.lengths, size, shared), first, last):
        x, u = trajectories[i]
        yield Piece(x[a:b], u[a:b], b - a - shared)


def _spans(lengths, size, shared):
    """(trajectory, first sample, last sample + 1) of every piece."""
    for i, length in enumerate(lengths):
        if length < shared:
            raise ValueError(f"trajectory {i} has {length} samples, too few for {shared - 1} delays; leave it out or use fewer delays.")
        for first in range(0, max(int(length) - shared, 1), size):
            yield i, first, int(min(first + size + shared, length))


def _labels(file, role):
    """Names and units of the channels that play a role, in order."""
    found = [(int(v.attrs["position"]), name, v.attrs["units"]) for name, v in file.variables.items() if v.attrs.get("role") == role]
    found.sort()
    return tuple(name for _, name, _ in found), tuple(unit for _, _, unit in found)
