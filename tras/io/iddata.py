"""The iddata objects of MATLAB's System Identification Toolbox: experiments with names, units and sampling time."""

import numpy as np

from tras.io.roles import RecordingError
from tras.io.workspace import Instance

# In s; MATLAB calls them so.
_UNITS = {"nanoseconds": 1e-9, "microseconds": 1e-6, "milliseconds": 1e-3, "seconds": 1.0, "minutes": 60.0}
_UNITS |= {"hours": 3600.0, "days": 86400.0, "": 1.0}
_BETWEEN = ("zoh", "foh", "bl")  # held, joined by lines, band-limited: what the input does between two samples
_TIME = "time"


def is_iddata(value) -> bool:
    """Whether a value of a file is an iddata object."""
    return isinstance(value, Instance) and value.kind == "iddata"


def experiments(name: str, fields: Instance) -> tuple[list[dict], dict]:
    """The experiments of the iddata object ``name``, each as a dict of columns, and what it says of them.

    Returns
    -------
    trials : list of dict
        Name -> (samples, 1) array; with a column ``time`` in s where the sampling instants are uneven.
    says : dict
        ``states``, ``inputs`` (lists of names), ``units`` (name -> unit), ``dt`` (in s or None), ``intersample``
        (input -> "zoh", "foh" or "bl").

    Raises
    ------
    RecordingError
        When it holds frequencies, or lacks a field, or its fields do not fit each other.
    """
    if fields.get("Domain", "Time") not in ("Time", "time"):
        raise RecordingError(f"the iddata object {name!r} holds frequencies; save the recording in time.")
    outputs, inputs = _cells(fields, "OutputData"), _cells(fields, "InputData")
    if not outputs or len(outputs) != len(inputs):
        raise RecordingError(
            f"the iddata object {name!r} has {len(outputs)} experiments of outputs but {len(inputs)} of inputs; "
            "save u = data.InputData and y = data.OutputData."
        )
    labels = [_labels(fields, "Output", "y", outputs[0]), _labels(fields, "Input", "u", inputs[0])]
    states, held = list(labels[0]), list(labels[1])
    if len({_TIME, *states, *held}) != 1 + outputs[0].shape[1] + inputs[0].shape[1]:
        raise RecordingError(
            f"the iddata object {name!r} has channels {', '.join([*states, *held])}; give each a name of its own, not "
            f"{_TIME!r}, in its OutputName and InputName."
        )
    unit = fields.get("TimeUnit", "seconds")
    if not isinstance(unit, str) or unit not in _UNITS:
        raise RecordingError(f"the TimeUnit of the iddata object {name!r} is {str(unit)[:40]!r}; make it 'seconds'.")
    trials, steps = [], [_number(step) for step in _cells(fields, "Ts")]
    instants = _cells(fields, "SamplingInstants")
    for i, (y, u) in enumerate(zip(outputs, inputs)):
        if y.shape[1] != len(states) or u.shape[1] != len(held) or (held and len(u) != len(y)):
            raise RecordingError(
                f"experiment {i + 1} of the iddata object {name!r} has outputs {y.shape} and inputs {u.shape}, which "
                "do not fit its names or each other."
            )
        trial = {key: array[:, [k]] for names, array in ((states, y), (held, u)) for k, key in enumerate(names)}
        if i >= len(steps) or steps[i] is None:
            if i >= len(instants) or instants[i].size != len(y):
                raise RecordingError(f"the iddata object {name!r} has neither Ts nor SamplingInstants; set data.Ts.")
            trial = {_TIME: instants[i].reshape(-1, 1) * _UNITS[unit], **trial}
        trials.append(trial)
    known = {step * _UNITS[unit] for step in steps if step is not None}
    if len(known) > 1 or (known and any(_TIME in trial for trial in trials)):
        raise RecordingError(f"the experiments of the iddata object {name!r} have different sampling times: resample.")
    units = {key: mark for names in labels for key, mark in names.items() if mark}
    says = {"states": states, "inputs": held, "units": units, "dt": known.pop() if known else None}
    return trials, {**says, "intersample": _between(fields.get("InterSample"), held)}


def _cells(fields, key):
    """The arrays of a field, one per experiment."""
    value = fields.get(key, [])
    arrays = value if isinstance(value, list) else [value]
    if not all(isinstance(array, np.ndarray) and array.ndim == 2 for array in arrays):
        raise RecordingError(f"the field {key} of an iddata object holds no matrices of numbers; save them apart.")
    return arrays


def _number(array):
    """The sampling time in an array, None in an empty one."""
    if array.size == 0:
        return None
    if array.size > 1 or not 0 < array.item() < np.inf:
        raise RecordingError("the field Ts of an iddata object is no positive number; set data.Ts.")
    return array.item()


def _labels(fields, role, letter, data):
    """Name -> unit of the channels of the matrix ``data``."""
    count = data.shape[1]
    names, units = _texts(fields.get(f"{role}Name")), _texts(fields.get(f"{role}Unit"))
    names = [name or f"{letter}{i + 1}" for i, name in enumerate(names)]
    if len(names) != count:
        names = [f"{letter}{i + 1}" for i in range(count)]
    return dict(zip(names, units if len(units) == count else [""] * count))


def _texts(value):
    values = value if isinstance(value, list) else [value]
    return [each.strip() if isinstance(each, str) else "" for each in values]


def _between(value, inputs):
    """Input -> what it does between two samples, where all experiments say the same known word."""
    words = _texts(value)
    if not inputs or not words or len(words) % len(inputs):
        return {}
    columns = [{words[k] for k in range(i, len(words), len(inputs))} for i in range(len(inputs))]
    return {name: words.pop() for name, words in zip(inputs, columns) if len(words) == 1 and words <= set(_BETWEEN)}
