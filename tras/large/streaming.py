"""Fits of more data than memory holds: every piece is read, absorbed and forgotten.

What is kept is the solver's state, O(N^2), one chunk of pairs, and a sample: windows spread evenly over the data. From
the sample come the centres of a dictionary and the check of the integrator's step, and on it the strength is chosen,
unfitted meanwhile.
"""

from collections import deque
from pathlib import Path
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from tras import koopman
from tras.estimator import checked
from tras.fitting import WINDOW, Fit, hold_out
from tras.large import distributed
from tras.large.checkpoint import Log, other_data, read_checkpoint
from tras.large.slices import Piece, RecordingFile, Stream, UnreadableError, is_dataset, several, without
from tras.recording import Recording, join, whole_number
from tras.workflow import executors

_WINDOWS = 100  # windows of a sample at least, if there are so many; at most twice as many


def needed(source) -> bool:
    """Whether data are to be read in pieces: anything but a `Recording`, a list of them, or what is no data at all."""
    if isinstance(source, (str, Path, RecordingFile)) or is_dataset(source) or callable(source):
        return True
    if isinstance(source, (list, tuple)):
        return any(isinstance(item, (str, Path, RecordingFile)) or is_dataset(item) for item in source)
    return hasattr(source, "__iter__") and not isinstance(source, Recording) and not hasattr(source, "__array__")


def absorb(
    model, source, *, ranges=None, checkpoint=None, chunk=None, progress=None, every=60.0, scheduler=None, parts=None,
    threads=None,
) -> tuple[Fit, Recording, Recording | None]:  # fmt: skip
    """Read data of any size into a `Fit`; `KoopmanModel.fit` calls this and solves it.

    A `Recording`, or a list of them, is fitted in memory unless a ``chunk`` is given; so are other data that are
    smaller than a chunk. A first reading finds the ranges of the channels, the number of pairs and the sample. With
    ``ranges``, and for an iterator, which can be read once only, there is none: the first chunk then stands for all,
    in centres and strength and, without ``ranges``, in the scales.

    Parameters
    ----------
    model : KoopmanModel
        Only its parameters are read.
    source : path, RecordingFile, xarray.Dataset, Recording, an iterable of these, or a callable that returns one
        A dataset is one of a file that `Recording.write` has written, opened with or without ``chunks=``. A callable,
        or an iterable that is no iterator, begins anew each time and has to give the same data.
    ranges : dict, optional
        Channel name -> (lowest, highest) in the channel's units, which become -1 and 1.
    checkpoint : path, optional
        An .npz file to go on from if it exists; written every ``every`` seconds, when the data have been read, and when
        reading fails or is interrupted. To go on, the data are read from the beginning and compared with those read
        before; the model has the same bits as without the interruption. The file stays: for another strength or
        regularization the data need only be read.
    chunk : int, optional
        Snapshot pairs in memory at a time; default 2^20, 50 MiB of samples of six channels.
    progress : bool, optional
        Show a progress bar. Default: in a terminal.
    scheduler : {None, "processes"} or str, optional
        Who absorbs: this process, local processes, or the workers of the Dask scheduler at an address such as
        "tcp://host:8786". See `tras.large.distributed.absorb`; not together with a checkpoint, and only for files,
        datasets and recordings.
    parts : int, optional
        Number of parts that workers take. The same number gives the same bits, whoever does the work.
    threads : int, optional
        Of this process; the bits do not depend on it. Default: `tras.solver.threads.processors`.

    Returns
    -------
    Fit
        Of all pairs but those held out.
    Recording
        The data, or the sample, in scaled channels.
    Recording or None
        Scaled windows that choose the strength, and are to be absorbed afterwards.

    Raises
    ------
    ValueError
        With ``field="least_squares"``; if a piece cannot be read or holds NaN or infinity (with file, trajectory and
        samples); if the checkpoint belongs to another model or other data; and as for `KoopmanModel.fit`.
    """
    spread = scheduler is not None or parts is not None
    if threads is not None:
        _count("threads", threads, "threads")
    if spread:
        _require_shareable(source, checkpoint, scheduler, parts)
    if chunk is None and not needed(source) and not spread:
        recording = join(source)
        return more(Fit.begin(model, recording, checked(ranges, recording)), recording, threads)
    chunk = koopman.DEALT if chunk is None else _count("chunk", chunk, "snapshot pairs to hold in memory")
    stream = Stream(source, chunk, model.delays + 1)
    saved = None if checkpoint is None else read_checkpoint(checkpoint, model, chunk)
    pieces = stream.pieces()
    head = deque(several(pieces, 1 if saved else chunk))
    if not head:
        raise ValueError("recording is empty; give a tras.Recording, a path, an xarray.Dataset, or several of them.")
    if not (saved or spread) and sum(piece.pairs for piece in head) < chunk:
        whole = stream.recording(head)
        return more(Fit.begin(model, whole, checked(ranges, whole)), whole, threads)
    if model.field == "least_squares" and model.predictor == "vector_field":
        raise ValueError("field is 'least_squares', which needs all data in memory; use 'coordinates', or fewer data.")
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
            log = Log(checkpoint, model, fit, survey, _labels(stream.template), chunk, every, saved)
            _absorb(fit, _drained(head, pieces), held, stream, log, bar, threads)
    scaled = fit.channels.scaled(survey.sample)
    return fit, scaled, scaled if held else None


def more(fit: Fit, recording: Recording, threads=None) -> tuple[Fit, Recording, Recording | None]:
    """Absorb a recording in memory but for what is held out; returns as `absorb` does."""
    scaled = fit.channels.scaled(recording)
    train, held = hold_out(scaled) if fit.chooses else (scaled, None)
    fit.absorb(train, threads)
    return fit, scaled, held


# ----------------------------------------------------------------------------------------------------------- the survey


class _Survey(NamedTuple):
    """What is known of the data before the first pair is absorbed."""

    ranges: dict  # channel -> (lowest, highest)
    pairs: int | None  # of all data, if it was counted
    sample: Recording  # windows of equal length
    where: np.ndarray  # (windows, 2): number of the piece and first pair of each window that may be held out
    length: int  # pairs of a window

    @property
    def held(self):
        """Number of a piece -> first pairs of its windows that may be held out."""
        held = {}
        for number, start in self.where.tolist():
            held.setdefault(number, []).append(start)
        return held

    def arrays(self):
        return {
            "ranges": np.array(list(self.ranges.values())), "where": self.where, "length": np.array(self.length),
            "states": self.sample.states, "inputs": self.sample.inputs,
        }  # fmt: skip

    @classmethod
    def restored(cls, saved, stream, path):
        header, arrays, _ = saved
        here, template = _labels(stream.template), stream.template
        if header["labels"] != here:
            raise other_data(path, f"sampling time and channels were {header['labels']}, here they are {here}")
        ranges = dict(zip((*template.state_names, *template.input_names), arrays["ranges"]))
        sample = template.with_data(list(arrays["states"]), list(arrays["inputs"]))
        return cls(ranges, header["total"], sample, arrays["where"], int(arrays["length"]))


def _survey(stream, head, rest, ranges, alone, progress):
    """Ranges, sample and number of pairs: of the ``head`` alone, or of all."""
    length = int(min(WINDOW - 1, np.median([piece.pairs for piece in head])))
    sampler, low, high = _Windows(max(length, 1), stream.shared), np.inf, -np.inf
    any_piece = head[0]
    with _bar("read", None, progress and not alone) as bar:
        for number, piece in enumerate(head if alone else _drained(head, rest)):
            bar.update(piece.pairs)
            sampler.look(number, piece)
            if ranges is None:
                lowest, highest = (np.concatenate([f(piece.x, axis=0), f(piece.u, axis=0)]) for f in (np.min, np.max))
                low, high = np.minimum(low, lowest), np.maximum(high, highest)
    if ranges is None:
        ranges = dict(zip((*stream.template.state_names, *stream.template.input_names), zip(low, high)))
    windows = list(sampler.windows.values())
    where = [(number, start) for number, start, _ in windows] if length >= 9 else []
    sample = stream.recording([piece for *_, piece in windows] or [any_piece])
    where = np.array(where, dtype=int).reshape(-1, 2)
    return _Survey(ranges, None if alone else sampler.seen, sample, where, sampler.length)


class _Windows:
    """Windows of ``length`` pairs, a fifth of all pairs at most, evenly spread over a stream whose end is not known.

    They stand on a grid of pairs. Whenever there are too many, every second one is dropped and the grid is twice as
    wide from there on.
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


# ------------------------------------------------------------------------------------------------------------- the pass


def _absorb(fit, pieces, held, stream, log, bar, threads):
    """All pieces, a chunk at a time, without the windows that are held out."""
    group, waiting, pairs = deque(), 0, 0
    try:
        for number, piece in enumerate(pieces):
            bar.update(piece.pairs)
            pairs += piece.pairs
            if log.knows(number, piece):
                continue
            group += without(piece, held.get(number, ()), log.survey.length, stream.shared)
            waiting += piece.pairs
            del piece
            if waiting >= log.header["chunk"]:
                with log.chunk_until(number):
                    fit.absorb(stream.scaled(_drained(group), fit.channels), threads)
                waiting = 0
        log.require_end(number + 1, pairs)
        with log.chunk_until(number, last=True):
            fit.absorb(stream.scaled(_drained(group), fit.channels), threads)
    except UnreadableError as error:
        if log.rescue():
            remedy = f"What was fitted so far is kept in {log.path}: repair, and fit again to go on."
            raise UnreadableError(f"{error} {remedy}") from error
        raise
    except BaseException:  # also when interrupted from the keyboard
        log.rescue()
        raise


def _require_shareable(source, checkpoint, scheduler, parts):
    if hasattr(source, "__next__") or callable(source):
        kind = "recording is an iterator or a callable, which workers cannot share"
        raise ValueError(f"{kind}; give paths of files, datasets, or recordings.")
    if checkpoint is not None:
        raise ValueError("checkpoint is for a fit by one process; leave it out, or leave out scheduler and parts.")
    if parts is not None:
        _count("parts", parts, "parts of the data")
    executors.require_scheduler(scheduler)


def _count(name, value, what):
    number = whole_number(name, value)
    if number < 1:
        raise ValueError(f"{name} = {value}; give the number of {what}, 1 or more.")
    return number


def _bar(what, pairs, progress):
    disable = None if progress is None else not progress
    return tqdm(total=pairs, desc=what, unit=" pairs", unit_scale=True, disable=disable)


def _drained(head, rest=()):
    """The pieces of a deque, which is emptied on the way, and of ``rest``."""
    while head:
        yield head.popleft()
    yield from rest


def _labels(recording):
    return [recording.dt, list(recording.state_names), list(recording.input_names)]
