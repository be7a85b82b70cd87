"""One fit of a sweep (`tras.sweep`): its data made ready, the model fitted, judged on windows that it has not seen."""

import functools
import hashlib
import platform
from pathlib import Path
from typing import NamedTuple

import numpy as np
from sklearn.base import clone

from tras import metrics
from tras.identification import search
from tras.io import formats
from tras.large.slices import RecordingFile, UnreadableError
from tras.recording import Recording, join, require_alike
from tras.solver.threads import one_blas_thread
from tras.sweeps.grid import Point


class File(NamedTuple):
    """A file and what it held when the sweep began; every worker has to see the same under this path."""

    path: str
    digest: str


class Data(NamedTuple):
    """What all points are fitted to and judged on."""

    train: tuple  # of `File` or `Recording`
    held_out: tuple | None
    states: tuple | None
    inputs: tuple | None
    window: float  # s
    fraction: float


def file(path: str | Path) -> File:
    """The `File` at a path; a FileNotFoundError or ValueError if there is none, or it cannot be read."""
    path = formats.known(path).resolve()
    return File(str(path), _digest(path))


def evaluate(data: Data, latest: int, point: Point) -> dict:
    """Fit and judge a `Point`: a dict that JSON holds.

    Its ``outcome`` is "model" or begins with "no model" or "no result". Predictions begin at the sample ``latest``, the
    same for all points. BLAS has one thread, so that every worker gives the same bits.
    """
    train, windows = prepared(data, point.seconds, point.every, point.split_seed)
    model = clone(point.model)
    try:
        with np.errstate(all="ignore"), one_blas_thread():  # what runs away is counted, not warned of
            model.fit(train, progress=False)
            true, predicted = windows.states[:, latest:], np.stack(search.roll_outs(model, windows, latest))
    except UnreadableError:
        raise  # no other point will do better
    except MemoryError:
        return {"outcome": "no result: out of memory"}
    except (ValueError, np.linalg.LinAlgError) as error:
        return {"outcome": f"no model: {' '.join(str(error).split())}"}
    span = np.ptp(windows.states, axis=(0, 1))
    scores = metrics.judge(true, predicted, span=span)
    return {
        "outcome": "model", "functions": len(model.names_), "pairs": int(model.pairs_),
        "condition": float(model.condition_number), "strength_used": float(model.strength_),
        "error": search.relative_error(true, predicted, span / 2),
        "nrmse": scores.nrmse.tolist(), "windows": scores.windows, "diverged": scores.diverged,
    }  # fmt: skip


def prepared(data: Data, seconds: float | None, every: int, split_seed: int) -> tuple:
    """(what a model is fitted to, the windows it is judged on), as the options say.

    Files that are neither split nor changed are left to `KoopmanModel.fit`, which reads large ones in pieces.

    Raises
    ------
    ValueError
        If the data are too short for the options, differ in their channels, or a held-out state is constant.
    """
    channels = data.states, data.inputs
    windows = _thinned(_together(data.train if data.held_out is None else data.held_out, *channels), every)
    try:
        windows = windows.cut(round(data.window / windows.dt) + 1)
    except ValueError as error:
        raise ValueError(f"window = {data.window:g} s at {windows.dt:g} s per sample: {error}") from None
    if data.held_out is None:
        train, windows = windows.split(data.fraction, split_seed)
    else:
        if seconds is None and every == 1:
            train = [opened(source).select(states=data.states, inputs=data.inputs) for source in data.train]
        else:
            train = _thinned(_together(data.train, *channels), every)
        for i, other in enumerate(train if isinstance(train, list) else [train]):
            require_alike(windows, other, i)
    for name, span in zip(windows.state_names, np.ptp(windows.states, axis=(0, 1))):
        if span == 0:
            fault = f"the held-out state {name!r} is constant, so there is no range to relate errors to"
            raise ValueError(f"{fault}; leave it out.")
    return train if seconds is None else _first(train, seconds), windows


def opened(source: File | Recording) -> Recording | RecordingFile:
    """A recording, or a file of one that is read in pieces if it can be."""
    if isinstance(source, Recording):
        return source
    _require_unchanged(source)
    return RecordingFile(source.path) if source.path.endswith(".nc") else Recording.read(source.path)


@functools.lru_cache(maxsize=2)  # training data and held-out data
def _together(sources, states, inputs):
    """One recording of all sources, in memory."""
    recordings = []
    for source in sources:
        if isinstance(source, File):
            _require_unchanged(source)
            source = Recording.read(source.path)
        recordings.append(source.select(states=states, inputs=inputs))
    return join(recordings)


def forget() -> None:
    """Let go of the recordings that are kept from one point to the next."""
    _together.cache_clear()


@functools.lru_cache(maxsize=256)
def _require_unchanged(source):
    """A ValueError, with the machine's name, unless the file is there and holds what it held when the sweep began."""
    try:
        same = _digest(Path(source.path)) == source.digest
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        remedy = "put it where every worker sees it under this path, or give a Recording"
        raise ValueError(
            f"{source.path} cannot be read by a worker on {platform.node()} ({reason}); {remedy}."
        ) from None
    if not same:
        raise ValueError(
            f"{source.path} as seen by a worker on {platform.node()} is not what it was when the sweep began; "
            "make them the same, and sweep again."
        )


def _digest(path):
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _thinned(recording, every):
    """Every so many samples; the inputs are the means over the samples between, which acted in turn."""
    if every == 1:
        return recording
    states, inputs = [], []
    for x, u in recording:
        starts = np.arange(0, len(u), every)
        states.append(x[starts])
        inputs.append(np.add.reduceat(u, starts, axis=0) / np.diff(np.append(starts, len(u)))[:, None])
    labels = {name: getattr(recording, name) for name in ("state_names", "state_units", "input_names", "input_units")}
    return Recording(states, inputs, every * recording.dt, **labels)


def _first(recording, seconds):
    """The first so many seconds: whole trajectories, and the beginning of the next."""
    left, states, inputs = round(seconds / recording.dt), [], []
    if not 0 < left <= recording.pairs:
        there = f"there are {recording.pairs * recording.dt:g} s to train on, in steps of {recording.dt:g} s"
        raise ValueError(f"seconds = {seconds:g}, but {there}; give less, or None for all.")
    for x, u in recording:
        if left > 0:
            states.append(x[: left + 1])
            inputs.append(u[: left + 1])
            left -= len(states[-1]) - 1
    return recording.with_data(states, inputs)
