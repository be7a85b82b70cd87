"""Recordings larger than memory: files and xarray's datasets, of which only names and lengths are loaded, and streams.

A piece is a stretch of one trajectory. Neighbours share as many samples as a snapshot pair reaches over, so no pair is
lost, and none reaches from one trajectory into the next.
"""

import contextlib
import copy
import itertools
from pathlib import Path
from typing import NamedTuple

import h5netcdf
import numpy as np

from tras.io.limits import FORMAT
from tras.recording import Recording, require_alike

_LABELS = ("state_names", "state_units", "input_names", "input_units")
_TOGETHER = 2**16  # pairs that are scaled at once


class UnreadableError(ValueError):
    """A piece of a file cannot be read, or holds what is no number."""


class Piece(NamedTuple):
    """Samples (pairs + shared, n) and (pairs + shared, m) of one trajectory, in physical units."""

    x: np.ndarray
    u: np.ndarray
    pairs: int


class _Lazy:
    """What is known without reading: ``dt``, ``lengths``, names and units, and a ``name`` for messages.

    A subclass supplies ``_channels``: a context with a mapping from channels to what returns an array for a slice.
    """

    _unreadable = (OSError, RuntimeError, KeyError)  # what reading a slice may raise

    def _describe(self, source, sizes):
        """Names and lengths, from the open file or the dataset."""
        if source.attrs.get("format") != FORMAT:
            raise ValueError(f"its attribute 'format' is {source.attrs.get('format')!r}, not {FORMAT!r}")
        self.dt = float(source.attrs["sampling_time"])
        self.lengths = np.array(source.variables["row_size"][:])
        if self.lengths.sum() != sizes["sample"]:
            raise ValueError(f"row_size sums to {self.lengths.sum()} but there are {sizes['sample']} samples")
        for role in ("state", "input"):
            channels = [item for item in source.variables.items() if item[1].attrs.get("role") == role]
            channels.sort(key=lambda item: int(item[1].attrs["position"]))
            setattr(self, f"{role}_names", tuple(name for name, _ in channels))
            setattr(self, f"{role}_units", tuple(variable.attrs["units"] for _, variable in channels))

    @property
    def pairs(self) -> int:
        """Number of snapshot pairs."""
        return int(np.sum(self.lengths - 1))

    def __len__(self):
        return len(self.lengths)

    def __repr__(self):
        channels = f"states {', '.join(self.state_names)}; inputs {', '.join(self.input_names) or 'none'}"
        size = f"{len(self)} trajectories, {self.pairs} pairs at {self.dt:g} s"
        return f"{type(self).__name__}: {self.name}, {size}; {channels}"

    def select(self, *, states=None, inputs=None):
        """The same data with only the named channels, in the order given."""
        new, empty = copy.copy(self), self.nothing().select(states=states, inputs=inputs)
        vars(new).update({label: getattr(empty, label) for label in _LABELS})
        return new

    def nothing(self) -> Recording:
        """A `Recording` with these labels and one sample of zeros."""
        x, u = (np.zeros((1, 1, len(names))) for names in (self.state_names, self.input_names))
        return Recording(x, u, self.dt, **{label: getattr(self, label) for label in _LABELS})

    def pieces(self, size, shared=1, first=0, last=None):
        """Every `Piece` of at most ``size`` pairs, in order; or only those of the numbers ``first`` to ``last - 1``.

        Raises
        ------
        UnreadableError
            With name, trajectory and samples.
        """
        starts = np.cumsum(self.lengths) - self.lengths
        with self._channels() as channels:
            for i, a, b in itertools.islice(spans(self.lengths, size, shared), first, last):
                both = self.state_names, self.input_names
                # The arrays get no name here, so none is kept.
                yield Piece(*(self._read(channels, names, starts[i], i, a, b) for names in both), b - a - shared)

    def _read(self, channels, names, start, i, first, last):
        values = np.empty((last - first, len(names)))
        for column, name in zip(values.T, names):
            try:
                column[:] = channels[name][start + first : start + last]
            except self._unreadable as error:
                raise UnreadableError(
                    f"{self.name}: channel {name!r} of trajectory {i} cannot be read between its samples {first} and "
                    f"{last - 1} ({error}); restore it, or leave the trajectory out."
                ) from error
        if not np.isfinite(values).all():
            sample, channel = np.argwhere(~np.isfinite(values))[0]
            raise UnreadableError(
                f"{self.name}: channel {names[channel]!r} is {values[sample, channel]} in trajectory {i} at sample "
                f"{first + sample}; repair it or cut the trajectory there."
            )
        return values


class RecordingFile(_Lazy):
    """A file that `Recording.write` has written, of which nothing is loaded but names and lengths.

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

    def __init__(self, path: str | Path):
        self.path = Path(path)
        if self.path.suffix != ".nc":
            kinds = "only .nc files are read piece by piece: write one with Recording.write"
            raise ValueError(f"{self.path} ends in {self.path.suffix!r}; {kinds}.")
        if not self.path.is_file():
            raise FileNotFoundError(f"{self.path} does not exist; give the path of a file that Recording.write made.")
        try:
            with h5netcdf.File(self.path, "r") as file:
                self._describe(file, {name: dimension.size for name, dimension in file.dimensions.items()})
        except (OSError, KeyError, AttributeError, TypeError, ValueError, RuntimeError) as error:
            remedy = "make it again with Recording.write"
            raise ValueError(f"{self.path} cannot be read as a recording ({error}); {remedy}.") from error

    @property
    def name(self):
        return str(self.path)

    @contextlib.contextmanager
    def _channels(self):
        try:
            file = h5netcdf.File(self.path, "r")
        except OSError as error:
            raise UnreadableError(f"{self.path} cannot be opened any more ({error}); put it back.") from error
        with file:
            yield file.variables


class RecordingDataset(_Lazy):
    """An ``xarray.Dataset`` as `Recording.to_xarray` makes it, opened with or without ``chunks=``.

    It is read in slices by the process that needs them. A chunk of Dask that is larger than a slice is read anew for
    each. It travels as xarray pickles it: the name of its file, a graph of Dask, or numbers that are in memory.

    Raises
    ------
    ValueError
        If it is not that of a recording.
    """

    name = "the dataset"
    _unreadable = (OSError, RuntimeError, KeyError, ValueError, TypeError)

    def __init__(self, dataset):
        self.dataset = dataset
        try:
            self._describe(dataset, dataset.sizes)
            for name in (*self.state_names, *self.input_names):
                values = dataset[name]
                if values.dims != ("sample",) or values.dtype.kind not in "fiu":
                    kind = f"{values.dtype} along {', '.join(values.dims)}"
                    raise ValueError(f"{name!r} is {kind}, not numbers along sample")
        except (KeyError, AttributeError, TypeError, ValueError) as error:
            remedy = "open a file that Recording.write has written"
            raise ValueError(f"the dataset cannot be read as a recording ({error}); {remedy}.") from error

    @contextlib.contextmanager
    def _channels(self):
        yield {name: _Slices(self.dataset.variables[name]) for name in (*self.state_names, *self.input_names)}


class _Slices(NamedTuple):
    variable: object

    def __getitem__(self, samples):
        # A worker's other threads have work of others.
        return self.variable[samples].compute(scheduler="synchronous").to_numpy()


def spans(lengths, size, shared):
    """(trajectory, first sample, last sample + 1) of every piece."""
    for i, length in enumerate(lengths):
        if length < shared:
            few = f"trajectory {i} has {length} samples, too few for {shared - 1} delays"
            raise ValueError(f"{few}; leave it out or use fewer delays.")
        for first in range(0, max(int(length) - shared, 1), size):
            yield i, first, int(min(first + size + shared, length))


def open_recording(path: str | Path) -> RecordingFile:
    """A `RecordingFile`, to be read piece by piece: for recordings larger than memory.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "long.nc"
    >>> Recording(np.zeros((2, 5, 1)), dt=0.1).write(path)
    >>> open_recording(path).pairs
    8
    """
    return RecordingFile(path)


_READABLE = (Recording, RecordingFile, RecordingDataset)


def is_dataset(source) -> bool:
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
        """Each `Piece` in order, or those numbered ``first`` to ``last - 1``; from the beginning, if it can be."""
        for recording in self.recordings():
            count = sum(1 for _ in spans(recording.lengths, self.size, self.shared)) if first or last is not None else 0
            if first < count or not count:
                read = _in_memory if isinstance(recording, Recording) else type(recording).pieces
                yield from read(recording, self.size, self.shared, first, last)
            first, last = max(0, first - count), None if last is None else last - count
            if last is not None and last <= 0:
                return

    def counts(self) -> list[int]:
        """Pairs of each piece; nothing is read."""
        lengths = (recording.lengths for recording in self.recordings())
        return [b - a - self.shared for some in lengths for _, a, b in spans(some, self.size, self.shared)]

    def opened(self) -> "Stream":
        """The same stream, of files that are open to be read anywhere and of recordings."""
        new = Stream(list(self.recordings()), self.size, self.shared)
        new.template = self.template
        return new

    def recordings(self):
        """Each recording, file or dataset in turn, all with the same channels."""
        source = self.source() if callable(self.source) else self.source
        single = isinstance(source, (str, Path, *_READABLE)) or is_dataset(source)
        for k, item in enumerate([source] if single else source):
            if isinstance(item, (str, Path)):
                item = RecordingFile(item)
            elif is_dataset(item):
                item = RecordingDataset(item)
            elif not isinstance(item, _READABLE):
                remedy = "give a tras.Recording, the path of a file or an xarray.Dataset"
                raise ValueError(f"recording {k} is {type(item).__name__}; {remedy}.")
            if self.template is None:
                self.template = item[:1] if isinstance(item, Recording) else item.nothing()
            require_alike(self.template, item, k)
            yield item

    def recording(self, pieces) -> Recording:
        """A `Recording` of some pieces."""
        x, u = zip(*((piece.x, piece.u) for piece in pieces))
        return self.template.with_data(list(x), list(u))

    def scaled(self, pieces, channels):
        """Scaled trajectories of an iterator of pieces, which are forgotten on the way."""
        while together := several(pieces, _TOGETHER):
            recording = channels.scaled(self.recording(together))
            del together
            yield from recording


def several(pieces, pairs: int) -> list[Piece]:
    """The next pieces of an iterator, of so many pairs together; fewer at its end."""
    group, count = [], 0
    for piece in pieces:
        group.append(piece)
        count += piece.pairs
        if count >= pairs:
            break
    return group


def without(piece: Piece, starts, length: int, shared: int) -> list[Piece]:
    """What is left of a piece without the pairs ``start`` to ``start + length`` for each start in order: a list."""
    pieces, begin = [], 0
    for start, after in [*((start, start + length) for start in starts), (piece.pairs, piece.pairs)]:
        if start > begin:
            pieces.append(Piece(piece.x[begin : start + shared], piece.u[begin : start + shared], start - begin))
        begin = after
    return pieces


def _in_memory(recording, size, shared, first=0, last=None):
    trajectories = list(recording)
    for i, a, b in itertools.islice(spans(recording.lengths, size, shared), first, last):
        x, u = trajectories[i]
        yield Piece(x[a:b], u[a:b], b - a - shared)
