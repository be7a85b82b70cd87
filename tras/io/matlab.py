"""MATLAB's files (.mat): variables, structs, timeseries-like structs and cell arrays of trials as columns; a writer.

It reads vectors and matrices of numbers. The table calls a vector ``phi``, the columns of a matrix ``states1,
states2, ...``, a field of a struct inside the only struct ``motor.torque``. A pair ``Time``, ``Data`` is one signal.
"""

import collections
import io
import json
from pathlib import Path

import numpy as np
from scipy.io import savemat

from tras.io import matfile5, matlab73, roles
from tras.io.limits import Source, check_size
from tras.io.roles import RecordingError

_HDF = b"\x89HDF\r\n\x1a\n"
_STEP = {"dt", "ts", "tsample", "sampling_time", "sample_time", "sampletime", "samplingtime"}
_RATE = {"fs", "sampling_rate", "samplerate", "sample_rate", "samplingrate"}


def open_table(path: Path) -> Source:
    """The `Source` of a .mat file of version 5 to 7.3."""
    with open(path, "rb") as file:
        start = file.read(520)
    if start.startswith(_HDF) or start[512:520] == _HDF:
        variables = matlab73.read_variables(path)
    else:
        variables = matfile5.read_variables(path.read_bytes())
    is_ours = str(variables.get("header", "")).startswith('{"format": "tras')
    return (_source_of_recording if is_ours else _source)(variables)


def _source(variables):
    """The `Source` of variables: name -> array, text, list (cells) or dict (struct)."""
    trials, steps = _trials(variables)
    tables, odd = zip(*[_columns(trial) for trial in trials]) if trials else ((), ())
    if not tables or not tables[0]:
        listing = ", ".join(map(repr, variables)) or "no variables"
        raise RecordingError(f"no signals in it: of {listing} none is a vector or matrix of numbers.")
    names = list(tables[0])
    for number, table in enumerate(tables):
        if set(table) != set(names):
            raise RecordingError(
                f"trial {number + 1} has {', '.join(table)} but the first has {', '.join(names)}; make them alike."
            )
    check_size(sum(len(next(iter(table.values()))) for table in tables), len(names))
    remarks = [f"left out: {name}, of another length than the rest" for name in sorted(set().union(*odd))]
    locate = _locate if len(tables) > 1 else lambda _, row: f"row {row + 1}"
    return Source(names, {}, lambda _: list(tables), locate, dt=_only_step(steps), remarks=remarks)


def _locate(trial, row):
    return f"trial {trial + 1}, row {row + 1}"


def write_recording(recording, header: dict, path: Path) -> None:
    """Write states and inputs as cells (one matrix per trajectory), ``dt``, names, units, and the header as text."""
    content = {"header": json.dumps(header), "dt": recording.dt}
    for key in ("state_names", "state_units", "input_names", "input_units"):
        content[key] = cell(getattr(recording, key))
    # The data come last, so that a file that was cut off lacks them.
    content["inputs"], content["states"] = (cell(arrays) for arrays in zip(*((u, x) for x, u in recording)))
    save(content, "MATLAB 5.0 MAT-file, written by tras", path, do_compression=True)


def save(variables: dict, title: str, path: Path, **options) -> None:
    """Write variables with ``title`` in place of SciPy's, which states the time; ``options`` of `scipy.io.savemat`."""
    memory = io.BytesIO()
    savemat(memory, variables, **options)
    path.write_bytes(title.encode().ljust(116) + memory.getvalue()[116:])


def cell(values) -> np.ndarray:
    """A cell array, (values, 1), for `save`."""
    array = np.empty((len(values), 1), dtype=object)
    for i, value in enumerate(values):
        array[i, 0] = value
    return array


def _source_of_recording(variables):
    """The `Source` of a file of `write_recording`."""
    try:
        header = json.loads(variables["header"])
        names = [*header["states"], *header["inputs"]]
        pairs = list(zip(variables["states"], variables["inputs"], strict=True))
        tables = [dict(zip(names, np.hstack([x, u]).T, strict=True)) for x, u in pairs]
    except (KeyError, TypeError, AttributeError, ValueError, RecursionError) as error:
        raise RecordingError(
            f"its header does not fit its content ({error}); delete the variable 'header' to read it as any other file."
        ) from error
    return Source(names, {}, lambda _: tables, _locate, header, dt=_only_step(_steps(variables)))


def _trials(variables):
    """Name -> arrays and dicts of each trial, and the sampling times beside them."""
    steps, content = [], dict(variables)
    while True:
        steps += _steps(content)
        content = {key: each for key, each in content.items() if isinstance(each, (list, dict)) or np.size(each) > 1}
        first = next(iter(content.values()), None)
        if len(content) != 1 or not isinstance(first, dict) or _is_signal(first):
            break
        content = dict(first)
    if _is_logged(content):
        return [content], steps
    lists = {key: value for key, value in content.items() if isinstance(value, list) and value}
    cells = {key: value for key, value in lists.items() if not any(isinstance(each, (str, list)) for each in value)}
    shared = {key: value for key, value in content.items() if not isinstance(value, list)}
    if not cells:
        return ([shared] if shared else []), steps
    counts = {key: len(value) for key, value in cells.items()}
    if len(set(counts.values())) != 1:
        listing = ", ".join(f"{key} {count}" for key, count in counts.items())
        raise RecordingError(f"the cell arrays have different numbers of trials: {listing}; make them alike.")
    trials = []
    for i in range(next(iter(counts.values()))):
        trial = dict(shared)
        for key, value in cells.items():
            is_trial = isinstance(value[i], dict) and len(cells) == 1 and not _is_signal(value[i])
            trial.update(value[i] if is_trial else {key: value[i]})
        steps += _steps(trial)
        trials.append(trial)
    return trials, steps


def _steps(content):
    """The sampling times among single numbers: dt, Ts, 1 / fs."""
    arrays = {key.lower(): value for key, value in content.items() if isinstance(value, np.ndarray)}
    numbers = {key: value.item() for key, value in arrays.items() if value.size == 1}
    steps = [value for key, value in numbers.items() if key in _STEP]
    return steps + [1 / value for key, value in numbers.items() if key in _RATE and value]


def _only_step(steps):
    if any(not 0 < step < np.inf or step != steps[0] for step in steps):
        listing = ", ".join(f"{step:g}" for step in steps[:5])
        raise RecordingError(f"the sampling times in it are {listing}; give one positive number, in s.")
    return steps[0] if steps else None


def _is_signal(value):
    """Whether a dict is one signal with its time."""
    return isinstance(value, dict) and {"time", "data"} <= {key.lower() for key in value}


def _is_logged(value):
    """Whether a dict is Simulink's "structure with time"."""
    return isinstance(value, dict) and "time" in value and isinstance(value.get("signals"), (list, dict))


def _columns(trial):
    """(name -> column, names of the arrays of another length) of one trial."""
    arrays = _flat(trial, "")
    for name, array in arrays.items():
        if array.ndim != 2:
            size = " x ".join(map(str, array.shape))
            raise RecordingError(f"{name!r} has the size {size}; save a matrix (samples x channels) per trial.")
    vectors = {name: array for name, array in arrays.items() if 1 in array.shape}
    times = [array for name, array in vectors.items() if roles.guess_role(name.rpartition(".")[2]) == "time"]
    sizes = collections.Counter(size for array in arrays.values() for size in set(array.shape) if size > 1)
    count = times[0].size if times else max(sizes, key=lambda size: (sizes[size], size), default=0)
    table, odd = {}, []
    for name, array in arrays.items():
        if count not in array.shape:
            odd.append(name)
            continue
        array = array if array.shape[0] == count else array.T
        check_size(len(array), array.shape[1])
        keys = [name] if array.shape[1] == 1 else [f"{name}{i + 1}" for i in range(array.shape[1])]
        new = dict(zip(keys, array.T))
        for key in new:
            if key in table:
                raise RecordingError(f"two signals would be called {key!r}; rename one.")
        table.update(new)
    return table, odd


def _flat(value, prefix):
    """Name -> matrix of all arrays in a dict and the dicts within."""
    arrays = {}
    for key, inner in value.items():
        if isinstance(inner, dict) and _is_signal(inner):
            fields = {name.lower(): each for name, each in inner.items()}
            _merge(arrays, "time", fields["time"], f"{prefix}{key}")
            _merge(arrays, f"{prefix}{key}", _data(**fields), key)
        elif key == "signals" and _is_logged(value):
            for i, signal in enumerate([inner] if isinstance(inner, dict) else inner):
                label = signal.get("label") if isinstance(signal, dict) else None
                name = label if isinstance(label, str) and label else f"signals{i + 1}"
                _merge(arrays, f"{prefix}{name}", signal.get("values") if isinstance(signal, dict) else None, key)
        elif isinstance(inner, dict):
            for name, array in _flat(inner, f"{prefix}{key}.").items():
                _merge(arrays, "time" if name == "time" else name, array, name)
        elif isinstance(inner, np.ndarray) and inner.size > 1:
            _merge(arrays, f"{prefix}{key}", inner, key)
    return arrays


def _data(time, data, **others):
    """A signal's data; (1, 1, samples), which Simulink logs too, as a column."""
    arrays = isinstance(data, np.ndarray) and isinstance(time, np.ndarray)
    return data.reshape(-1, 1) if arrays and data.ndim > 2 and data.size == time.size else data


def _merge(arrays, name, array, owner):
    """Add an array; a second column of time must be the first."""
    if not isinstance(array, np.ndarray):
        raise RecordingError(f"{owner!r} should hold numbers but holds {type(array).__name__}.")
    if name in arrays and not (name == "time" and np.array_equal(arrays[name].ravel(), array.ravel())):
        times = "has other times than the signal before it; resample them to the same times first"
        raise RecordingError(f"{owner!r} {times if name == 'time' else 'is there twice; rename one'}.")
    arrays[name] = array
