"""MATLAB's files (.mat): matrices, structs, iddata objects, Simulink's logs and cell arrays of trials; a writer.

It reads vectors and matrices of numbers. The table calls a vector ``phi``, the columns of a matrix ``states1,
states2, ...``, a field of a struct inside the only struct ``motor.torque``. A pair ``Time``, ``Data`` is one signal.
Variables ``train`` and ``val``, or ``uEst, yEst, uVal, yVal``, are the trials of one recording, the second the test.
"""

import io
import json
from pathlib import Path

import numpy as np

from tras.io import columns, iddata, matfile4, matfile5, matlab73, workspace
from tras.io.limits import Source, check_size
from tras.io.roles import RecordingError

_HDF = b"\x89HDF\r\n\x1a\n"
_STEP = {"dt", "ts", "tsample", "sampling_time", "sample_time", "sampletime", "samplingtime"}
_RATE = {"fs", "sampling_rate", "samplerate", "sample_rate", "samplingrate"}
_OURS = "written by tras"


def open_table(path: Path) -> Source:
    """The `Source` of a .mat file of version 4 to 7.3."""
    with open(path, "rb") as file:
        start = file.read(520)
    if start.startswith(_HDF) or start[512:520] == _HDF:
        variables = matlab73.read_variables(path)
    elif matfile4.is_version_4(start):
        variables = matfile4.read_variables(path.read_bytes())
    elif start.startswith(b"# Created by Octave"):
        raise RecordingError("it is in Octave's own format; save it there with save -v7.")
    else:
        variables = matfile5.read_variables(path.read_bytes())
    if str(variables.get("header", "")).startswith('{"format": "tras'):
        return _source_of_recording(variables)
    return _source(variables)


def _source(variables):
    """The `Source` of variables: name -> array, text, list (cells), dict (struct) or `Unread`."""
    unread = []
    content, steps = _opened(workspace.readable(variables, "", unread))
    parts, remarks = columns.parts(content)
    trials, test, says = [], [], {}
    for part, is_test in parts:
        part, more = _opened(part)
        new, claims, others = _trials(part)
        steps += more + others
        if says and claims and claims != says:
            raise RecordingError("its iddata objects have other channels or sampling times than each other.")
        says = says or claims
        beside = [key for key, value in part.items() if claims and not iddata.is_iddata(value)]
        remarks += [f"left out: {', '.join(beside[:8])}, beside an iddata object"] if beside else []
        test += range(len(trials), len(trials) + len(new)) if is_test else []
        trials += new
    remarks += workspace.left_out(unread)
    numbers = [
        f"{key} = {value.item():g}"
        for key, value in variables.items()
        if isinstance(value, np.ndarray) and value.size == 1
    ]
    if numbers and not steps:
        remarks.append(f"single numbers in it: {', '.join(numbers[:8])}")
    tables = columns.tables(trials, remarks)
    if not tables or not tables[0].names:
        listing = ", ".join(map(repr, list(variables)[:30])) or "no variables"
        raise RecordingError(
            f"no signals in it: of {listing} none is a vector or matrix of numbers"
            f"{''.join(f'; {remark}' for remark in remarks)}.{workspace.how_to_save(unread)}"
        )
    names = tables[0].names
    for number, table in enumerate(tables):
        if set(table.names) != set(names):
            raise RecordingError(
                f"trial {number + 1} has {', '.join(table.names)} but the first has {', '.join(names)}; make them "
                "alike."
            )
    check_size(sum(table.rows for table in tables), len(names))
    if says:
        channels = f"outputs {', '.join(says['states'])}; inputs {', '.join(says['inputs']) or 'none'}"
        remarks.append(f"an iddata object says what they are: {channels}")
        steps = [says["dt"]] if says["dt"] else steps
    return Source(
        names, says.get("units", {}), lambda roles: [table.read(roles, remarks) for table in tables],
        _locate if len(tables) > 1 else lambda _, row: f"row {row + 1}", dt=_only_step(steps), remarks=remarks,
        roles={key: says[key] for key in ("states", "inputs") if says}, test=test,
        aliases={f"{owner}.time": "time" for table in tables for owner in table.owners},
        attributes={"intersample": says["intersample"]} if says.get("intersample") else {},
    )  # fmt: skip


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
    from scipy.io import savemat

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


def _opened(content):
    """What is inside structs that hold nothing but one struct, and the sampling times on the way."""
    steps = []
    while True:
        steps += _steps(content)
        content = {key: each for key, each in content.items() if isinstance(each, (list, dict)) or _is_array(each)}
        first = next(iter(content.values()), None)
        if len(content) != 1 or not isinstance(first, dict) or columns.is_signal(first) or iddata.is_iddata(first):
            return content, steps
        content = dict(first)


def _is_array(value):
    return isinstance(value, np.ndarray) and value.size > 1


def _trials(content):
    """Name -> arrays and dicts of each trial, what an iddata object says, and the sampling times beside them."""
    objects = {key: value for key, value in content.items() if iddata.is_iddata(value)}
    if objects:
        contents = [iddata.experiments(key, value) for key, value in objects.items()]
        if any(says != contents[0][1] for _, says in contents):
            raise RecordingError(
                f"its iddata objects {', '.join(objects)} have other channels or sampling times than each other; save "
                "one of them."
            )
        return [trial for trials, _ in contents for trial in trials], contents[0][1], []
    if columns.is_logged(content):
        return [content], {}, []
    steps = []
    lists = {key: value for key, value in content.items() if isinstance(value, list) and value}
    cells = {key: value for key, value in lists.items() if not any(isinstance(each, (str, list)) for each in value)}
    shared = {key: value for key, value in content.items() if not isinstance(value, list)}
    if not cells:
        return ([shared] if shared else []), {}, steps
    counts = {key: len(value) for key, value in cells.items()}
    if len(set(counts.values())) != 1:
        listing = ", ".join(f"{key} {count}" for key, count in counts.items())
        raise RecordingError(f"the cell arrays have different numbers of trials: {listing}; make them alike.")
    trials = []
    for i in range(next(iter(counts.values()))):
        trial = dict(shared)
        for key, value in cells.items():
            is_trial = isinstance(value[i], dict) and len(cells) == 1 and not columns.is_signal(value[i])
            trial.update(value[i] if is_trial else {key: value[i]})
        steps += _steps(trial)
        trials.append(trial)
    return trials, {}, steps


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
