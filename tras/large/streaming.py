"""Fits of more data than memory holds: every piece is read, absorbed and forgotten.

What is kept is the solver's state, O(N^2), one chunk of pairs, and a sample: windows spread evenly over the data. From the sample come the
centres of a dictionary and the check of the integrator's step, and on it the strength is chosen, unfitted meanwhile.
"""

import contextlib
import copy
import time
import zlib
from collections import deque
from pathlib import Path
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from tras import koopman
from tras.estimator import checked
from tras.fitting import WINDOW, Fit, hold_out
from tras.large import checkpoint as store
from tras.large import distributed
from tras.large.slices import Piece, RecordingFile, Stream, UnreadableError, is_dataset, without
from tras.recording import Recording, join, whole_number
from tras.workflow import executors

_WINDOWS = 100  # windows of a sample at least, if there are so many; at most twice as many
_TOGETHER = 2**16  # pairs that are scaled at once


def needed(source):
    """Whether data are to be read in pieces: anything but a `Recording`, a list of them, or what is no data at all."""
    if isinstance(source, (str, Path, RecordingFile)) or is_dataset(source) or callable(source):
        return True
    if isinstance(source, (list, tuple)):
        return any(isinstance(item, (str, Path, RecordingFile)) or is_dataset(item) for item in source)
    return hasattr(source, "__iter__") and not isinstance(source, Recording) and not hasattr(source, "__array__")


def absorb(
    model,
    source,
    *,
    ranges=None,
    checkpoint=None,
    chunk=None,
    progress=None,
    every=60.0,
    scheduler=None,
    parts=None,
    threads=None,
):
    """Read data of any size into a `Fit`; `KoopmanModel.fit` calls this and solves it.

    A `Recording`, or a list of them, is fitted in memory unless a ``chunk`` is given; so are other data that are smaller than a chunk.
    Every pair is absorbed once. Before that the data are read through for the ranges of the channels, the number of pairs and the sample, which
    costs little beside the fit. With ``ranges``, and for an iterator, which can be read once only, there is no such reading: the first chunk
    stands for all then, in centres and strength and, without ``ranges``, in the scales.

    Parameters
    ----------
    model : KoopmanModel
        Its parameters are read and nothing else of it.
    source : path, RecordingFile, xarray.Dataset, Recording, an iterable of these, or a callable that returns such an iterable
        A dataset is one of a file that `Recording.write` has written, opened with or without ``chunks=``, and read in slices as a file is. A
        callable, or an iterable that is no iterator, begins anew each time and has to give the same data.
    ranges : dict, optional
        Channel name -> (lowest, highest) in the channel's units, which become -1 and 1.
    checkpoint : path, optional
        An .npz file to go on from if it exists; written ``every`` so many seconds, when the data have been read, and when reading fails or is
        interrupted. To go on, the data are read from the beginning and compared with those read before; the model has the same bits as without
        the interruption. The file stays at the end: for another strength or regularisation the data need only be read.
    chunk : int, optional
        Snapshot pairs in memory at a time; default 2^20, 50 MiB of samples of six channels.
    progress : bool, optional
        Show a progress bar. Default: in a terminal.
    every : float
        Seconds.
    scheduler : {None, "processes"} or str, optional
        Who absorbs: this process, local processes, or the workers of the Dask scheduler at an address such as "tcp://host:8786". See
        `tras.large.distributed.absorb`; not together with a checkpoint, and only for files, datasets and recordings.
    parts : int, optional
        Number of parts that workers take. The same number gives the same bits, whoever does the work.
    threads : int, optional
        Of this process, that lift and multiply; the bits do not depend on it. Default: one per processor, at most eight; one in a process among others.

    Returns
    -------
    Fit
        Of all pairs but those held out.
    Recording
        The data, or the sample, in scaled channels.
    Recording or None
        Scaled windows that are held out to choose the strength by, and are to be absorbed afterwards.

    Raises
    ------
    ValueError
        With ``field="least_squares"``, which needs all data at once; if a piece cannot be read or holds NaN or infinity (with file, trajectory and
        samples); if the checkpoint belongs to another model or other data; and as for `KoopmanModel.fit`.
    """
    spread = scheduler is not None or parts is not None
    if threads is not None and whole_number("threads", threads) < 1:
        raise ValueError(f"threads = {threads}; give the number of threads, 1 or more.")
    if spread:
        _require_shareable(source, checkpoint, scheduler, parts)
    if chunk is None and not needed(source) and not spread:
        recording = join(source)
        return more(Fit.begin(model, recording, checked(ranges, recording)), recording, threads)
    chunk = koopman.DEALT if chunk is None else whole_number("chunk", chunk)
    if chunk < 1:
        raise ValueError(f"chunk = {chunk}; give the number of snapshot pairs to hold in memory, 1 or more.")
    stream = Stream(source, chunk, model.delays + 1)
    saved = None if checkpoint is None else store.read(checkpoint, model, chunk=chunk)
    pieces = stream.pieces()
    head = _head(pieces, 1 if saved else chunk)
    if not (saved or spread) and sum(piece.pairs for piece in head) < chunk:
        whole = stream.recording(head)
        return more(Fit.begin(model, whole, checked(ranges, whole)), whole, threads)
    if model.field == "least_squares" and model.predictor == "vector_field":
        raise ValueError(
            "field is 'least_squares', which needs all data in memory at once; use field='coordinates', or fewer data."
        )
    if saved:
        survey = _Survey.restored(saved, stream, checkpoint)
    else:
        alone = stream.once or ranges is not None
        survey = _survey(stream, head, pieces, checked(ranges, stream.template), alone, progress)
        pieces = pieces if alone else stream.pieces()
    fit = Fit.begin(model, survey.sample, survey.ranges)
    held = survey.held if fit.chooses else {}
    with _bar("fit", survey.pairs, progress) as bar:
        if spread:
            distributed.absorb(fit, stream, held, survey.length, chunk, scheduler, parts, bar)
        else:
            log = _Log(checkpoint, model, fit, survey, stream, chunk, every, saved)
            _absorb(fit, _drained(head, pieces), held, survey, stream, log, bar, threads)
    scaled = fit.channels.scaled(survey.sample)
    return fit, scaled, scaled if held else None


def more(fit, recording, threads=None):
    """Absorb a recording in memory but for what is held out; returns as `absorb` does."""
    scaled = fit.channels.scaled(recording)
    train, held = hold_out(scaled) if fit.chooses else (scaled, None)
    fit.absorb(train, threads)
    return fit, scaled, held


# ------------------------------------------------------------------------------------------------------------------ the survey


class _Survey(NamedTuple):
    """What is known of the data before the first pair is absorbed."""

    ranges: dict  # channel -> (lowest, highest)
    pairs: int | None  # of all data, if it was counted
    sample: Recording  # windows of equal length
    held: dict  # number of a piece -> pairs at which windows begin that may be held out
    length: int  # pairs of a window

    def arrays(self):
        where = [(number, start) for number, starts in self.held.items() for start in starts]
        return {
            "ranges": np.array(list(self.ranges.values())), "where": np.array(where, dtype=int).reshape(-1, 2), "length": np.array(self.length),
            "states": self.sample.states, "inputs": self.sample.inputs,
        }  # fmt: skip

    @classmethod
    def restored(cls, saved, stream, path):
        header, arrays, _ = saved
        if header["labels"] != _labels(stream.template):
            raise store.CheckpointError(
                f"checkpoint {path} belongs to other data (sampling time and channels were {header['labels']}, here they are "
                f"{_labels(stream.template)}); use the data it was made of, give another path, or delete it to begin anew."
            )
        ranges = dict(zip((*stream.template.state_names, *stream.template.input_names), arrays["ranges"]))
        held = {}
        for number, start in arrays["where"].tolist():
            held.setdefault(number, []).append(start)
        return cls(
            ranges,
            header["total"],
            stream.template.with_data(list(arrays["states"]), list(arrays["inputs"])),
            held,
            int(arrays["length"]),
        )


def _survey(stream, head, rest, ranges, alone, progress):
    """Ranges, sample and number of pairs: of the ``head`` alone, or of all."""
    length = int(min(WINDOW - 1, np.median([piece.pairs for piece in head])))
    windows, low, high = _Windows(max(length, 1), stream.shared), np.inf, -np.inf
    any_piece = head[0]
    with _bar("read", None, progress and not alone) as bar:
        for number, piece in enumerate(head if alone else _drained(head, rest)):
            bar.update(piece.pairs)
            windows.look(number, piece)
            if ranges is None:
                values = [np.concatenate([f(piece.x, axis=0), f(piece.u, axis=0)]) for f in (np.min, np.max)]
                low, high = np.minimum(low, values[0]), np.maximum(high, values[1])
    if ranges is None:
        ranges = dict(zip((*stream.template.state_names, *stream.template.input_names), zip(low, high)))
    held = {}
    for number, start, _ in windows.windows.values():
        held.setdefault(number, []).append(start)
    sample = stream.recording([piece for *_, piece in windows.windows.values()] or [any_piece])
    return _Survey(ranges, None if alone else windows.seen, sample, held if length >= 9 else {}, windows.length)


class _Windows:
    """Windows of ``length`` pairs, a fifth of all pairs at most, evenly spread over a stream whose end is not known.

    They stand on a grid of pairs. Whenever there are too many, every second one is dropped and the grid is twice as wide from there on.
    """

    def __init__(self, length, shared):
        self.length, self.shared, self.step = length, shared, 5 * length
        self.seen, self.windows = 0, {}  # number on the grid -> (number of the piece, first pair, piece)

    def look(self, number, piece):
        free = 0  # first pair of this piece that is in no window
        for k in range(-(-self.seen // self.step), -(-(self.seen + piece.pairs) // self.step)):
            start = min(k * self.step - self.seen, piece.pairs - self.length)
            if start >= free:
                free = start + self.length
                samples = slice(start, free + self.shared)
                self.windows[k] = number, start, Piece(piece.x[samples].copy(), piece.u[samples].copy(), self.length)
        self.seen += piece.pairs
        while len(self.windows) > 2 * _WINDOWS:
            self.step *= 2
            self.windows = {k // 2: window for k, window in self.windows.items() if k % 2 == 0}


# ------------------------------------------------------------------------------------------------------------------- the pass


def _absorb(fit, pieces, held, survey, stream, log, bar, threads):
    """All pieces, a chunk at a time, without the windows that are held out."""
    group, waiting, pairs = deque(), 0, 0
    try:
        for number, piece in enumerate(pieces):
            bar.update(piece.pairs)
            pairs += piece.pairs
            if log.knows(number, piece):
                continue
            group += without(piece, held.get(number, ()), survey.length, stream.shared)
            waiting += piece.pairs
            del piece
            if waiting >= log.chunk:
                with log.chunk_until(number):
                    fit.absorb(_scaled(fit, stream, group), threads)
                waiting = 0
        log.require_end(number + 1, pairs)
        with log.chunk_until(number, last=True):
            fit.absorb(_scaled(fit, stream, group), threads)
    except UnreadableError as error:
        if log.rescue():
            raise UnreadableError(
                f"{error} What was fitted so far is kept in {log.path}: repair, and fit again to go on."
            ) from error
        raise
    except BaseException:  # also when interrupted from the keyboard
        log.rescue()
        raise


class _Log:
    """How far the pass is, and the checkpoint that remembers it."""

    def __init__(self, path, model, fit, survey, stream, chunk, every, saved):
        self.path, self.model, self.fit, self.survey = path, model, fit, survey
        self.labels, self.chunk, self.every = _labels(stream.template), chunk, every
        self.done, self.crc, self.finished, self.stored = 0, 0, False, 0
        if saved:
            header, _, state = saved
            fit.restore(state)
            self.done, self.crc, self.finished, self.stored = (
                header["done"],
                header["crc"],
                header["finished"],
                header["done"],
            )
        self.read, self.written = 0, time.monotonic()

    def knows(self, number, piece):
        """Whether the piece was absorbed before the checkpoint was written; a CheckpointError if those before it were others."""
        if self.path is not None:
            for values in (piece.x, piece.u):
                self.read = zlib.crc32(np.ascontiguousarray(values), self.read)
        if self.finished and number >= self.done:
            raise self._other("there are more of them now")
        if number == self.done - 1 and self.read != self.crc:
            raise self._other("numbers have changed")
        return number < self.done

    def require_end(self, count, pairs):
        """The data ended where they should."""
        if count < self.done:
            raise self._other("there are fewer of them now")
        if self.survey.pairs not in (None, pairs):
            raise ValueError(
                f"recording gave {self.survey.pairs} snapshot pairs when it was read first, and {pairs} now; it has to give the same each time."
            )

    @contextlib.contextmanager
    def chunk_until(self, number, last=False):
        """Around the absorbing of a chunk that ends with a piece: counted when that is done, taken back when it fails or is interrupted."""
        before = copy.copy(self.fit)
        try:
            yield
        except BaseException:
            vars(self.fit).update(vars(before))
            raise
        self.done, self.crc, changed = number + 1, self.read, last != self.finished
        self.finished = last
        if self.path is not None and (changed if last else time.monotonic() - self.written >= self.every):
            self._write()

    def rescue(self):
        """Write what is not written yet; whether there is a checkpoint."""
        if self.path is None:
            return False
        if self.done > self.stored:
            self._write()
        return Path(self.path).exists()

    def _write(self):
        header = {
            "labels": self.labels,
            "total": self.survey.pairs,
            "chunk": self.chunk,
            "done": self.done,
            "crc": self.crc,
            "finished": self.finished,
        }
        store.write(self.path, self.model, self.fit.state(), header, self.survey.arrays())
        self.written, self.stored = time.monotonic(), self.done

    def _other(self, reason):
        return store.CheckpointError(
            f"checkpoint {self.path} belongs to other data ({reason}); use the data it was made of, give another path, or delete it to begin anew."
        )


def _scaled(fit, stream, group):
    """Scaled trajectories of some pieces, which are forgotten on the way."""
    while group:
        together, pairs = [], 0
        while group and pairs < _TOGETHER:
            together.append(group.popleft())
            pairs += together[-1].pairs
        scaled = fit.channels.scaled(stream.recording(together))
        del together
        yield from scaled


def _head(pieces, pairs):
    """The first pieces, of so many pairs together."""
    head, count = [], 0
    for piece in pieces:
        head.append(piece)
        count += piece.pairs
        if count >= pairs:
            break
    if not head:
        raise ValueError(
            "recording is empty; give a tras.Recording, the path of a file, an xarray.Dataset, or some of them."
        )
    return head


def _require_shareable(source, checkpoint, scheduler, parts):
    if hasattr(source, "__next__") or callable(source):
        raise ValueError(
            "recording is an iterator or a callable, which workers cannot share; give paths of files, datasets, or recordings."
        )
    if checkpoint is not None:
        raise ValueError("checkpoint is for a fit by one process; leave it out, or leave out scheduler and parts.")
    if parts is not None and whole_number("parts", parts) < 1:
        raise ValueError(f"parts = {parts}; give the number of parts of the data, 1 or more.")
    executors.require_scheduler(scheduler)


def _bar(what, pairs, progress):
    return tqdm(
        total=pairs, desc=what, unit=" pairs", unit_scale=True, disable=None if progress is None else not progress
    )


def _drained(head, rest):
    """The pieces of ``head``, which is emptied on the way, and of ``rest``."""
    while head:
        yield head.pop(0)
    yield from rest


def _labels(recording):
    return [recording.dt, list(recording.state_names), list(recording.input_names)]
