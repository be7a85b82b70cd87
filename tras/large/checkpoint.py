"""Checkpoints of a fit that takes long: where it is in the data, and all that it has learnt of them."""

import contextlib
import copy
import json
import time
import zlib
from pathlib import Path

import numpy as np

from tras.dictionaries.base import spelled
from tras.fitting import rows_and_hull
from tras.io.npz import read_npz, require_numbers
from tras.workflow import arguments
from tras.workflow.files import replacing

_FORMAT = "tras checkpoint 2"
_REMEDY = "give another path, or delete it to begin anew"


class CheckpointError(ValueError):
    """The file is no checkpoint, or one of another model or other data."""


def read_checkpoint(path, model, chunk: int) -> tuple[dict, dict, dict] | None:
    """(header, survey's arrays, state of the fit); None if there is no file.

    Raises
    ------
    CheckpointError
        If it is damaged, or belongs to another model or another ``chunk``.
    """
    path = _npz_path(path)
    if not path.exists():
        return None
    try:
        header, arrays = read_npz(path, _FORMAT)
        _check_header(header)
        survey = {key.partition(".")[2]: value for key, value in arrays.items() if key.startswith("survey.")}
        state = {key: value for key, value in arrays.items() if not key.startswith("survey.")}
        if {key.partition(".")[0] for key in state} - {"solver", "hull"}:
            raise ValueError("it holds arrays that are no part of a fit")
        rows_and_hull(state)  # a damaged one is found here, not in the middle of a fit
        _check_survey(survey, *map(len, header["labels"][1:]))
        parameters = json.loads(json.dumps(_described(model)))
        for kind, name, before, now in (
            ("a fit with another option", "chunk", header["chunk"], chunk),
            *(("another model", name, header["model"].get(name), now) for name, now in parameters.items()),
        ):
            if before != now:
                raise CheckpointError(
                    f"checkpoint {path} belongs to {kind}: its {name} is {before!r}, here it is {now!r}; "
                    f"use what it was made with, {_REMEDY}."
                )
    except CheckpointError:
        raise
    except (ValueError, OSError, MemoryError) as error:
        reason = arguments.one_line(error) or "its arrays do not fit in memory"
        raise CheckpointError(f"checkpoint {path} cannot be read ({reason}); delete it to begin anew.") from error
    return header, survey, state


def _check_header(header):
    """A ValueError unless the fields are there and in range."""
    missing = [key for key in ("labels", "total", "chunk", "done", "crc", "finished", "model") if key not in header]
    if missing:
        raise ValueError(f"its header lacks {missing[0]!r}")
    for key, most in (("chunk", 2**62), ("done", 2**62), ("crc", 2**32 - 1)):
        arguments.whole_number(f"its {key}", header[key], 0, most)
    if header["total"] is not None:
        arguments.whole_number("its total", header["total"], 1, 2**62)
    labels = header["labels"]
    if (
        not isinstance(labels, list)
        or len(labels) != 3
        or not all(isinstance(names, list) and all(isinstance(name, str) for name in names) for names in labels[1:])
    ):
        raise ValueError("its labels are no sampling time and names of channels")
    if not isinstance(header["finished"], bool) or not isinstance(header["model"], dict):
        raise ValueError("its header is of another kind")


def _check_survey(survey, n, m):
    """A ValueError unless the arrays are those of a survey of n states and m inputs."""
    if set(survey) != {"ranges", "where", "length", "states", "inputs"}:
        raise ValueError("it lacks arrays of the survey, or has more")
    ranges = require_numbers("survey.ranges", survey["ranges"], (n + m, 2))
    states = require_numbers("survey.states", survey["states"], (None, None, n))
    require_numbers("survey.inputs", survey["inputs"], (*states.shape[:2], m))
    where = require_numbers("survey.where", survey["where"], (None, 2), 0)
    length = require_numbers("survey.length", survey["length"], (), 1)
    if not (ranges[:, 0] < ranges[:, 1]).all():
        raise ValueError("its survey.ranges is not (lowest, highest) for each channel")
    if (
        {where.dtype.kind, length.dtype.kind} - set("iu")
        or len(where) > len(states)
        or (len(where) and length >= states.shape[1])
    ):
        raise ValueError("its windows are not those of a survey")


def other_data(path, reason: str) -> CheckpointError:
    """The `CheckpointError` to raise."""
    return CheckpointError(
        f"checkpoint {path} belongs to other data ({reason}); use the data it was made of, {_REMEDY}."
    )


def _require_fit(path, fit):
    """A CheckpointError unless rows and hull are of the sizes that the fit goes on with."""
    solver, channels = fit.solver, len(fit.channels.z_names) + len(fit.channels.input_names)
    if solver is None or solver.shapes != fit.sizes:
        raise CheckpointError(f"checkpoint {path} cannot be read (its rows are not those of this model); {_REMEDY}.")
    if fit.confines != (fit.hull is not None) or fit.hull and len(fit.hull.low) != channels:
        raise CheckpointError(f"checkpoint {path} cannot be read (its hull is not that of this model); {_REMEDY}.")


class Log:
    """How far the pass over the data is, and the file that remembers it; without a ``path`` nothing is written.

    ``saved`` is what `read_checkpoint` returned: the fit and the count of pieces go on from there.
    """

    def __init__(self, path, model, fit, survey, labels, chunk, every, saved):
        self.path, self.fit, self.survey, self.every = path, fit, survey, every
        self.header = {"labels": labels, "total": survey.pairs, "chunk": chunk, "done": 0, "crc": 0, "finished": False}
        self.header |= {"format": _FORMAT, "model": _described(model)}
        if saved:
            header, _, state = saved
            fit.restore(state)
            _require_fit(path, fit)
            self.header |= {key: header[key] for key in ("done", "crc", "finished")}
        self.stored, self.resumed = self.header["done"], bool(saved)
        self.crc, self.written = 0, time.monotonic()

    def knows(self, number: int, piece) -> bool:
        """Whether the piece was absorbed before the file was written; a CheckpointError if earlier ones were others."""
        done = self.header["done"]
        if self.path is not None:
            for values in (piece.x, piece.u):
                self.crc = zlib.crc32(np.ascontiguousarray(values), self.crc)
        if self.header["finished"] and number >= done:
            raise other_data(self.path, "there are more of them now")
        if number == done - 1 and self.crc != self.header["crc"]:
            raise other_data(self.path, "numbers have changed")
        return number < done

    def require_end(self, count, pairs):
        """The data ended where they should."""
        if count < self.header["done"]:
            raise other_data(self.path, "there are fewer of them now")
        if self.survey.pairs not in (None, pairs):
            if self.resumed:
                raise other_data(self.path, f"there were {self.survey.pairs} snapshot pairs, now there are {pairs}")
            first = f"recording gave {self.survey.pairs} snapshot pairs when it was read first"
            raise ValueError(f"{first}, and {pairs} now; it has to give the same each time.")

    @contextlib.contextmanager
    def chunk_until(self, number, last=False):
        """Around the absorbing of a chunk that ends with a piece: counted when it is done, taken back when it fails."""
        before = copy.copy(self.fit)
        try:
            yield
        except BaseException:  # also when interrupted from the keyboard
            vars(self.fit).update(vars(before))
            raise
        due = not self.header["finished"] if last else time.monotonic() - self.written >= self.every
        self.header |= {"done": number + 1, "crc": self.crc, "finished": last}
        if self.path is not None and due:
            self.write()

    def rescue(self) -> bool:
        """Write what is not written yet; whether there is a checkpoint."""
        if self.path is None:
            return False
        if self.header["done"] > self.stored:
            self.write()
        return Path(self.path).exists()

    def write(self):
        """Store the header, the state of the fit, and the arrays of the survey."""
        arrays = self.fit.state() | {f"survey.{key}": value for key, value in self.survey.arrays().items()}
        with replacing(_npz_path(self.path)) as temporary:
            np.savez(temporary, header=np.array(json.dumps(self.header)), **arrays)
        self.written, self.stored = time.monotonic(), self.header["done"]


def _described(model):
    """What the rows of the least-squares problem depend on; the method and strength that solve it do not matter."""
    chooses = model.regularization is not None and model.strength == "auto"
    linear = model.predictor == "lifted_linear"
    return {
        "dictionary": spelled(model.dictionary),
        "predictor": "lifted_linear" if linear else "vector_field or one_step",
        "delays": int(model.delays),
        "earlier inputs": bool(model.delays and model.predictor != "vector_field"),
        "extrapolation": model.extrapolation,
        "columns": model.columns,
        "strength": "auto" if chooses else "given",
    }


def _npz_path(path):
    path = Path(path)
    if path.suffix != ".npz":
        raise ValueError(f"checkpoint {path} ends in {path.suffix!r}; use the ending .npz.")
    return path
