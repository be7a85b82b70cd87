"""Checkpoints of a fit that takes long: where it was in the data, and all that it had learnt of them."""

import json
from pathlib import Path

import numpy as np

from tras.dictionaries.base import spelled
from tras.fitting import rows_and_hull
from tras.model_file import UNREADABLE, read_npz
from tras.workflow.files import replacing

_FORMAT = "tras checkpoint 2"


class CheckpointError(ValueError):
    """The file is no checkpoint, or one of another model or other data."""


def write(path, model, state, header, survey):
    """Store ``header`` (what JSON holds), the state of a fit, and the arrays of the survey beside the model's parameters."""
    arrays = state | {f"survey.{key}": value for key, value in survey.items()}
    header = header | {"format": _FORMAT, "model": described(model)}
    with replacing(_npz_path(path)) as temporary:
        np.savez(temporary, header=np.array(json.dumps(header)), **arrays)


def read(path, model, **same):
    """(header, survey's arrays, state of the fit); None if there is no file.

    Raises
    ------
    CheckpointError
        If it is damaged, belongs to another model, or its header holds another value for a name in ``same``.
    """
    path = _npz_path(path)
    if not path.exists():
        return None
    try:
        header, arrays = read_npz(path, _FORMAT)
        survey = {key.partition(".")[2]: value for key, value in arrays.items() if key.startswith("survey.")}
        state = {key: value for key, value in arrays.items() if not key.startswith("survey.")}
        rows_and_hull(state)  # a damaged one is found here, not in the middle of a fit
        _require_same(path, header, same | {"model": described(model)})
    except CheckpointError:
        raise
    except UNREADABLE as error:
        raise CheckpointError(f"checkpoint {path} cannot be read ({error}); delete it to begin anew.") from error
    return header, survey, state


def _require_same(path, header, wanted):
    wanted = json.loads(json.dumps(wanted))
    for name, now in wanted.items():
        before = header[name]
        if before == now:
            continue
        if name == "model":
            name = next(key for key in now if before.get(key) != now[key])
            before, now = before.get(name), now[name]
        kind = "another model" if name in wanted["model"] else "a fit with another option"
        raise CheckpointError(
            f"checkpoint {path} belongs to {kind}: its {name} is {before!r}, here it is {now!r}; "
            "use what it was made with, give another path, or delete it to begin anew."
        )


def described(model):
    """What the rows of the least-squares problem depend on, as JSON holds it: the method and strength that solve it do not matter."""
    chooses = model.regularization is not None and model.strength == "auto"
    return {
        "dictionary": spelled(model.dictionary), "predictor": "lifted_linear" if model.predictor == "lifted_linear" else "vector_field or one_step",
        "delays": int(model.delays), "earlier inputs": bool(model.delays and model.predictor != "vector_field"),
        "extrapolation": model.extrapolation, "columns": model.columns, "strength": "auto" if chooses else "given",
    }  # fmt: skip


def _npz_path(path):
    path = Path(path)
    if path.suffix != ".npz":
        raise ValueError(f"checkpoint {path} ends in {path.suffix!r}; use the ending .npz.")
    return path
