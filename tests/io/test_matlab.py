"""MATLAB's files: versions, layouts, objects, what is left out, the test set that a file brings, damage."""

import struct
import tracemalloc
import zlib

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.io import loadmat, savemat
from scipy.sparse import csc_matrix

import tras
from tras.io import columns, matfile5, matlab
from tras.io.roles import Roles

R = tras.Recording


def write(path, content):
    path.write_bytes(content)
    return path


def sentences(recording):
    return " ".join(tras.remarks(recording))


# --- layouts --------------------

K = 7
TIME = np.arange(K) * 0.25
X, U = np.random.default_rng(0).normal(size=(K, 2)), np.random.default_rng(1).normal(size=(K, 1))


def cell(*values):
    array = np.empty((1, len(values)), dtype=object)
    array[0, :] = values
    return array


def fields(trials):
    return np.array([tuple(trial.values()) for trial in trials], dtype=[(key, object) for key in trials[0]])


SHORT = slice(0, 4)
LAYOUTS = {
    "variables": {"t": TIME[:, None], "x": X, "u": U},
    "rows instead of columns": {"t": TIME[None], "x": X.T, "u": U.T},
    "one struct": {"log": {"t": TIME, "x": X, "u": U, "Info": "rig 3"}},
    "sampling time": {"x": X, "u": U, "Ts": 0.25},
    "sampling rate": {"log": {"x": X, "u": U, "fs": 4.0}},
    "timeseries-like": {"x": {"Time": TIME, "Data": X}, "u": {"Time": TIME, "Data": U.reshape(1, 1, K)}},
    "timeseries in a struct": {"out": {"x": {"Time": TIME, "Data": X}, "u": {"Time": TIME, "Data": U}}},
    "structure with time": {
        "out": {"time": TIME, "signals": fields([{"values": X, "label": "x"}, {"values": U, "label": "u"}])}
    },
}
TRIALS = {
    "cells of matrices": {"t": cell(TIME, TIME[SHORT]), "x": cell(X, X[SHORT]), "u": cell(U, U[SHORT])},
    "cells, sampling time": {"x": cell(X, X[SHORT]), "u": cell(U, U[SHORT]), "dt": 0.25},
    "a cell of structs": {"runs": cell({"t": TIME, "x": X, "u": U}, {"t": TIME[SHORT], "x": X[SHORT], "u": U[SHORT]})},
    "an array of structs": {
        "data": {"runs": fields([{"t": TIME, "x": X, "u": U}, {"t": TIME[SHORT], "x": X[SHORT], "u": U[SHORT]}])}
    },
}


def hdf(path, variables):
    """As MATLAB -v7.3 saves: arrays transposed, cells and fields of struct arrays as references, texts as uint16."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in variables.items():
            _hdf_value(file, file, name, value)
    with open(path, "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(116) + b" " * 8 + b"\x00\x02IM")


def _hdf_value(file, group, name, value):
    if isinstance(value, dict):
        item = group.create_group(name)
        item.attrs["MATLAB_class"] = np.bytes_("struct")
        for key, inner in value.items():
            _hdf_value(file, item, key, inner)
    elif isinstance(value, np.ndarray) and value.dtype.names:
        item = group.create_group(name)
        item.attrs["MATLAB_class"] = np.bytes_("struct")
        for key in value.dtype.names:
            item.create_dataset(key, data=_references(file, value[key].ravel()), dtype=h5py.ref_dtype)
    else:
        if isinstance(value, np.ndarray) and value.dtype == object:
            kind, item = "cell", group.create_dataset(name, data=_references(file, value.ravel()), dtype=h5py.ref_dtype)
        elif isinstance(value, str):
            letters = np.array([[ord(letter)] for letter in value], dtype="u2")
            kind, item = "char", group.create_dataset(name, data=letters)
        else:
            array = np.atleast_2d(np.asarray(value, dtype=float)).T
            kind, item = "double", group.create_dataset(name, data=array)
        item.attrs["MATLAB_class"] = np.bytes_(kind)


def _references(file, values):
    store = file.require_group("#refs#")
    references = []
    for value in values:
        name = f"r{len(store)}"
        _hdf_value(file, store, name, value)
        references.append(store[name].ref)
    return np.array([references], dtype=h5py.ref_dtype).T


WRITERS = {
    "v5": savemat,
    "v5 compressed": lambda path, content: savemat(path, content, do_compression=True),
    "v7.3": hdf,
}


@pytest.mark.parametrize("writer", WRITERS)
@pytest.mark.parametrize("layout", [*LAYOUTS, *TRIALS])
def test_matlab_files(writer, layout, tmp_path):
    WRITERS[writer](tmp_path / "a.mat", LAYOUTS.get(layout) or TRIALS[layout])
    recording = R.read(tmp_path / "a.mat")
    assert recording.dt == 0.25 and recording.state_names == ("x1", "x2") and recording.input_names == ("u",)
    lengths = [K] if layout in LAYOUTS else [K, 4]
    assert list(recording.lengths) == lengths
    for (x, u), length in zip(recording, lengths):
        assert np.array_equal(x, X[:length]) and np.array_equal(u, U[:length])


@pytest.mark.parametrize(
    "content, words",
    [
        ({"x": X + 1j, "t": TIME}, "left out: x .complex numbers.; to have them, save real and imaginary part"),
        ({"x": csc_matrix(X), "t": TIME}, "left out: x .a sparse matrix.; to have them, save full"),
        ({"name": "nothing here"}, "no signals in it: of 'name' none is"),
        ({}, "no signals in it"),
        ({"x": np.zeros((3, 4, 5)), "t": TIME}, "left out: x, of the size 3 x 4 x 5: save a matrix per"),
        ({"x": cell(X, X), "u": cell(U)}, "different numbers of trials: x 2, u 1"),
        ({"r": cell({"t": TIME, "x": X}, {"t": TIME, "y": X})}, "trial 2 has t, y1, y2 but the first has t, x1, x2"),
        (
            {"x": {"Time": TIME, "Data": X}, "u": {"Time": TIME + 1, "Data": U}},
            "'x', 'u' have other times .*: 3 instants",
        ),
        ({"x": X, "dt": 0.1, "Ts": 0.2}, "the sampling times in it are"),
        ({"x": X}, "no column is plainly time"),
        ({"a": {"a": {"a": {"a": {"a": {"a": {"a": {"a": {"a": {"a": X}}}}}}}}}}, "nested more than 8 deep"),
        ({"x": {"Time": np.zeros((0, 1)), "Data": np.zeros((1, 1, 0))}}, "left out: x, of the size 1 x 1 x 0"),
        ({"t": TIME[::-1], "x": X}, "row 2: time goes backwards"),
        ({"t": cell(TIME, TIME[::-1]), "x": cell(X, X)}, "trial 2, row 2: time goes backwards"),
    ],
)
def test_what_matlab_files_cannot_hold(content, words, tmp_path):
    savemat(tmp_path / "a.mat", content)
    with pytest.raises(tras.RecordingError, match=f"(?s){tmp_path}/a.mat: .*{words}"):
        R.read(tmp_path / "a.mat")


def test_a_signal_of_another_length_is_left_out_and_said(tmp_path):
    savemat(tmp_path / "a.mat", {"t": TIME, "x": X, "ref": U[:3], "u": np.ones((5, 1))})
    assert "left out: u, of another length" in sentences(R.read(tmp_path / "a.mat"))


@pytest.mark.parametrize("kind, words", [
    ("link", "is a link to somewhere else"), ("objects", "'MCOS' is a link to somewhere else"),
    ("external", "lie in another file"), ("circle", "nested more than 8"),
])  # fmt: skip
def test_newer_files_that_lead_elsewhere_are_refused(kind, words, tmp_path):
    hdf(tmp_path / "a.mat", {"t": TIME, "x": X})
    with h5py.File(tmp_path / "a.mat", "r+") as file:
        if kind == "link":
            file["z"] = h5py.ExternalLink("/etc/passwd", "/")
        elif kind == "objects":
            file["#subsystem#/MCOS"] = h5py.ExternalLink("/etc/passwd", "/")
        elif kind == "external":
            file.create_dataset("z", (4, 1), "u1", external=[("/etc/passwd", 0, 4)])
        else:
            file.create_group("z").attrs["MATLAB_class"] = np.bytes_("struct")
            file["z/z"] = file["z"]
    with pytest.raises(tras.RecordingError, match=words):
        R.read(tmp_path / "a.mat")


# --- what is left out --------------------


def element(kind, content):
    return struct.pack("<II", kind, len(content)) + content + bytes(-len(content) % 8)


def variable(number, *elements, flags=0):
    """A variable of version 5 of the class ``number``, from its elements behind the flags."""
    return element(14, element(6, struct.pack("<II", number | flags, 0)) + b"".join(elements))


def sized(number, name, dims, *elements, **options):
    dims = element(5, struct.pack(f"<{len(dims)}i", *dims))
    return variable(number, dims, element(1, name.encode()), *elements, **options)


def matrix(array, name=""):
    array = np.asarray(array, dtype=float)
    return sized(6, name, array.shape, element(9, array.tobytes(order="F")))


def text(value):
    return sized(4, "", (1, len(value)), element(16, value.encode()))


def cells(*values):
    return sized(1, "", (len(values), 1), *values)


def instance(kind, name, fields):
    """An object of the old kind: a struct with the name of its class."""
    names = b"".join(key.encode().ljust(32, b"\0") for key in fields)
    length = element(5, struct.pack("<i", 32))
    return sized(3, name, (1, 1), element(1, kind.encode()), length, element(1, names), *fields.values())


def opaque(kind, name):
    """An object of the new kind: its numbers lie in a part of the file that only MATLAB reads."""
    return variable(17, element(1, name.encode()), element(1, b"MCOS"), element(1, kind.encode()), matrix([[1.0]]))


def version5(path, *variables):
    return write(path, b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + b"".join(variables))


HANDLE = sized(16, "z", (1, 1), matrix([[1.0]]))
COMPLEX = sized(6, "z", (2, 1), element(9, bytes(16)), element(9, bytes(16)), flags=0x800)
SPARSE = sized(5, "z", (2, 2), element(5, bytes(8)), element(5, bytes(12)), element(9, bytes(16)))


def newer(kind, **attributes):
    def add(file):
        numbers = np.zeros((3, 1), dtype=[("real", "f8"), ("imag", "f8")]) if kind == "" else np.zeros((3, 1))
        file.create_dataset("z", data=numbers).attrs.update({"MATLAB_class": np.bytes_(kind), **attributes})

    return add


@pytest.mark.parametrize("odd, words", [
    (HANDLE, "z .a function handle."), (COMPLEX, "z .complex numbers.; to have them, save real and imaginary part"),
    (SPARSE, "z .a sparse matrix.; to have them, save full"), (opaque("timeseries", "z"), "z .an object .timeseries.."),
    (instance("zpk", "z", {"gain": matrix(X)}), "z .an object .zpk.."), (newer("function_handle"), "z .a function"),
    (newer("timetable", MATLAB_object_decode=3), "z .an object .timetable.."), (newer(""), "z .complex numbers."),
    (newer("double", MATLAB_sparse=np.uint64(3)), "z .a sparse matrix."), (newer("string"), "z .of class string."),
])  # fmt: skip
def test_what_is_not_read_is_left_out_and_said(odd, words, tmp_path):
    if callable(odd):
        hdf(tmp_path / "a.mat", {"t": TIME, "x": X, "u": U})
        with h5py.File(tmp_path / "a.mat", "r+") as file:
            odd(file)
    else:
        version5(tmp_path / "a.mat", odd, matrix(TIME[:, None], "t"), matrix(X, "x"), matrix(U, "u"))
    for roles in (None, {"time": "t", "states": ["x1", "x2"], "inputs": ["u"]}):
        recording = R.read(tmp_path / "a.mat", roles)
        assert np.array_equal(recording.states[0], X) and np.array_equal(recording.inputs[0], U)
        assert not words or __import__("re").search(f"left out: {words}", sentences(recording))


def test_a_name_as_long_as_a_book_is_no_name(tmp_path):
    savemat(tmp_path / "a.mat", {"log": scope(TIME, X, labels=["q" * 10**6]), "u": U})
    with pytest.raises(
        tras.RecordingError, match="a signal has a name of 1000000 letters; up to 1000 are read"
    ) as error:
        R.read(tmp_path / "a.mat")
    assert len(str(error.value)) < 1000


def test_what_is_not_read_in_structs_and_cells(tmp_path):
    savemat(tmp_path / "a.mat", {"log": {"t": TIME, "x": X, "u": U, "G": X + 1j}, "z": cell(X + 1j, X)})
    recording = R.read(tmp_path / "a.mat", {"time": "t", "states": ["x1", "x2"], "inputs": ["u"]})
    assert np.array_equal(recording.states[0], X) and "left out: log.G (complex numbers), z{1} (" in sentences(
        recording
    )


@pytest.mark.parametrize("kind, lines", [
    ("timeseries", "time = ts.Time; data = squeeze(ts.Data);\n    save('plain.mat', 'time', 'data', '-v7')"),
    ("timetable", "rows = timetable2table(ts); rows.(1) = seconds("), ("table", "writetable(ts, 'p"),
    ("Simulink.SimulationData.Dataset", "signal = ts{1}.Values; time = "),
])  # fmt: skip
def test_of_an_object_two_lines_of_matlab_save_the_numbers(kind, lines, tmp_path):
    with pytest.raises(tras.RecordingError) as refusal:
        R.read(version5(tmp_path / "a.mat", opaque(kind, "ts")))
    words = f"left out: ts (an object ({kind})).\nIn MATLAB, for example:"
    assert words in str(refusal.value) and lines in str(refusal.value)
    with pytest.raises(tras.RecordingError) as refusal:  # a name that would be code is not written into them
        R.read(version5(tmp_path / "a.mat", opaque(kind, "ts');delete('*")))
    assert lines.replace("ts.", "x.").replace("(ts", "(x").replace("ts{", "x{") in str(refusal.value)


@pytest.mark.parametrize("suffix", [".mat", ".parquet", ".nc", ".csv"])
def test_pointers_of_git_lfs(suffix, tmp_path):
    pointer = b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 3\n"
    with pytest.raises(tras.RecordingError, match="a pointer of Git LFS .* `git lfs pull`"):
        R.read(write(tmp_path / f"a{suffix}", pointer))


# --- version 4 --------------------


def version4(path, variables, endian="<", text=()):
    """As MATLAB's save -v4 and Simulink of old write it."""
    content = b""
    for name, (array, kind) in variables.items():
        dtype = ("f8", "f4", "i4", "i2", "u2", "u1")[kind]
        code = 1000 * (endian == ">") + 10 * kind + (name in text)
        content += struct.pack(endian + "5i", code, *array.shape, 0, len(name) + 1) + name.encode() + b"\0"
        content += array.astype(endian + dtype).tobytes(order="F")
    return write(path, content)


@pytest.mark.parametrize("endian", "<>")
@pytest.mark.parametrize("kind", range(4))
def test_version_4(endian, kind, tmp_path):
    x = np.round(100 * X)
    note = np.array([[ord(letter) for letter in "rig 3"]])
    variables = {"t": (TIME[:, None], 0), "x": (x, kind), "u": (x[:, :1], kind), "note": (note, 5)}
    recording = R.read(version4(tmp_path / "a.mat", variables, endian, text=("note",)))
    assert np.array_equal(recording.states[0], x) and np.array_equal(recording.inputs[0], x[:, :1])
    assert recording.dt == 0.25 and "note" not in sentences(recording)


def test_version_4_as_scipy_writes_it(tmp_path):
    savemat(tmp_path / "a.mat", {"t": TIME, "x": X, "u": U, "G": U + 1j, "A": csc_matrix(np.eye(3))}, format="4")
    recording = R.read(tmp_path / "a.mat")
    assert np.array_equal(recording.states[0], X) and np.array_equal(recording.inputs[0], U)
    assert "G (complex numbers), A (a sparse matrix)" in sentences(recording)


@pytest.mark.parametrize("change, words", [
    (lambda content: content[:-3], "in the middle of a variable"), (lambda content: content + b"abc", "middle"),
    (lambda content: content * 2, "variable 'x' is there twice"), (lambda content: content + b"\7" * 30, "no variable"),
    (lambda content: content[:4] + b"\xff\xff\xff\x7f\xff\xff\xff\x7f" + content[12:], "more than 100000000 values"),
    (lambda content: content.replace(b"x\0", b"\1\0"), "which is no name"),
])  # fmt: skip
def test_damage_to_version_4(change, words, tmp_path):
    whole = version4(tmp_path / "a.mat", {"x": (X, 0)}).read_bytes()
    with pytest.raises(tras.RecordingError, match=words):
        R.read(write(tmp_path / "a.mat", change(whole)))


# --- iddata --------------------


def experiment_data(name, *experiments, step=0.25, **changes):
    """The bytes of an iddata object: (outputs, inputs) of each experiment."""
    count = len(experiments)
    fields = {
        "Domain": text("Time"), "OutputData": cells(*(matrix(y) for y, _ in experiments)),
        "OutputName": cells(text("Angular Velocity"), text("Voltage")), "OutputUnit": cells(text("rad/s"), text("V")),
        "InputData": cells(*(matrix(u) for _, u in experiments)), "InputName": cells(text("Position")),
        "InputUnit": cells(text("mm")), "InterSample": cells(*[text("foh")] * count),
        "Ts": cells(*[matrix([[step]])] * count), "SamplingInstants": cells(*[matrix(np.zeros((7, 0)))] * count),
        "TimeUnit": text("seconds"), "Notes": cells(), "UserData": matrix(np.zeros((0, 0))),
    } | changes  # fmt: skip
    return instance("iddata", name, fields)


def test_iddata(tmp_path):
    recording = R.read(version5(tmp_path / "a.mat", experiment_data("data", (X, U))))
    assert recording.state_names == ("Angular Velocity", "Voltage") and recording.state_units == ("rad/s", "V")
    assert recording.input_names == ("Position",) and recording.input_units == ("mm",) and recording.dt == 0.25
    assert np.array_equal(recording.states[0], X) and np.array_equal(recording.inputs[0], U)
    assert recording.attributes["intersample"] == {"Position": "foh"}
    assert "an iddata object says what they are: outputs Angular Velocity, Voltage" in sentences(recording)
    beside = version5(tmp_path / "b.mat", experiment_data("data", (X, U)), matrix(X, "x"))
    assert "left out: x, beside an iddata object" in sentences(R.read(beside))
    chosen = R.read(tmp_path / "a.mat", {"inputs": ["Voltage"]})  # what the user says goes before what the file says
    assert chosen.state_names == ("Angular Velocity",) and chosen.attributes["intersample"] == {}


def test_iddata_of_several_experiments_and_units_of_time(tmp_path):
    content = experiment_data("z", (X, U), (X[:4], U[:4]), TimeUnit=text("milliseconds"))
    recording = R.read(version5(tmp_path / "a.mat", content))
    assert list(recording.lengths) == [7, 4] and recording.dt == pytest.approx(0.25e-3, rel=1e-15)
    instants = {"Ts": cells(matrix(np.zeros((0, 0)))), "SamplingInstants": cells(matrix(TIME[:, None] + 3))}
    recording = R.read(version5(tmp_path / "a.mat", experiment_data("z", (X, U), **instants)))
    assert recording.dt == 0.25 and np.array_equal(recording.states[0], X)
    free = experiment_data("z", (X, np.zeros((7, 0))), InputName=cells(), InputUnit=cells(), InterSample=cells())
    assert R.read(version5(tmp_path / "a.mat", free)).m == 0


def test_iddata_for_estimation_and_validation(tmp_path):
    parts = experiment_data("zEst", (X, U)), experiment_data("zVal", (X[:4], U[:4]))
    recording = R.read(version5(tmp_path / "a.mat", *parts))
    assert list(recording.lengths) == [7, 4] and recording.attributes["test_trajectories"] == [1]
    other = experiment_data("zVal", (X, U), step=0.5)
    with pytest.raises(tras.RecordingError, match="iddata objects have other channels or sampling times"):
        R.read(version5(tmp_path / "a.mat", parts[0], other))


def test_iddata_of_version_7_3(tmp_path):
    fields = {"Domain": "Time", "OutputData": cell(X), "InputData": cell(U), "Ts": cell(np.array([[0.25]]))}
    hdf(tmp_path / "a.mat", {"data": {**fields, "InputName": cell("force"), "OutputName": cell("a", "b")}})
    with h5py.File(tmp_path / "a.mat", "r+") as file:
        file["data"].attrs.update({"MATLAB_class": np.bytes_("iddata"), "MATLAB_object_decode": 2})
    recording = R.read(tmp_path / "a.mat")
    assert (recording.state_names, recording.input_names, recording.dt) == (("a", "b"), ("force",), 0.25)


@pytest.mark.parametrize("changes, words", [
    ({"Domain": text("Frequency")}, "holds frequencies"), ({"InputData": cells()}, "1 experiments of outputs but 0 of"),
    ({"Ts": cells(matrix([[-1.0]]))}, "Ts of an iddata object is no positive number"),
    ({"Ts": cells(matrix(np.zeros((0, 0))))}, "neither Ts nor SamplingInstants"),
    ({"OutputData": cells(text("x"))}, "OutputData of an iddata object holds no matrices"),
    ({"InputData": cells(matrix(U[:3]))}, r"has outputs .7, 2. and inputs .3, 1., which do not fit"),
    ({"InputName": cells(text("Voltage"))}, "give each a name of its own"), ({"TimeUnit": text("moons")}, "'moons'"),
])  # fmt: skip
def test_iddata_that_do_not_fit_themselves(changes, words, tmp_path):
    with pytest.raises(tras.RecordingError, match=words):
        R.read(version5(tmp_path / "a.mat", experiment_data("data", (X, U), **changes)))


# --- Simulink --------------------


def scope(time, *values, labels=("",) * 9):
    signals = [{"values": v, "dimensions": 1.0, "label": label, "title": ""} for v, label in zip(values, labels)]
    return {"time": time, "signals": fields(signals), "blockName": "rig/Scope"}


def test_scopes_are_joined_by_their_own_times(tmp_path):
    """One has a sample more, at its start: by row it would be a sample early."""
    longer = np.r_[-0.25, TIME], np.vstack([[[9.0]], U])
    content = {"Ctrl": scope(longer[0], longer[1], labels=["Pitch Control"]), "Angle": scope(TIME, X)}
    savemat(tmp_path / "a.mat", content)
    roles = {"states": ["Angle.signals1_1", "Angle.signals1_2"], "inputs": ["Pitch Control"]}
    recording = R.read(tmp_path / "a.mat", roles)
    assert np.array_equal(recording.states[0], X) and np.array_equal(recording.inputs[0], U)
    assert recording.dt == 0.25
    assert "joined at the 7 instants that all have; rows left out: 1 of 'Ctrl'" in sentences(recording)
    for own in ("Angle.time", "Ctrl.time", "time"):
        assert R.read(tmp_path / "a.mat", {**roles, "time": own}).lengths.tolist() == [7]
    alone = R.read(tmp_path / "a.mat", {"states": ["Pitch Control"], "inputs": []})
    assert len(alone.states[0]) == 8


PITCH = ["Pitch & Reference1", "Pitch & Reference2"]  # which is which the label need not say


def test_labels_of_scopes_are_names_where_they_are_one_signal(tmp_path):
    longer, both = np.r_[-0.25, TIME], ["Pitch & Reference", ""]
    content = {
        "A": scope(TIME, X, X**2, labels=both), "B": scope(longer, np.r_[[[0.0, 0.0]], X], labels=both),
        "E": scope(longer, np.r_[[[0.0, 0.0]], X**2]),
        "C": scope(TIME, U, labels=["Speed"]), "D": scope(TIME, X[:, 1:], labels=["Speed"]),
    }  # fmt: skip
    savemat(tmp_path / "a.mat", content)
    source = matlab.open_table(tmp_path / "a.mat")
    assert source.names == ["time", *PITCH, "A.signals2_1", "A.signals2_2", "C.Speed", "D.Speed"]
    assert "left out: B.Pitch & Reference, the same as A.Pitch & Reference" in source.remarks
    assert "left out: E.signals1, the same as A.signals2" in source.remarks
    with pytest.raises(
        tras.RecordingError, match="Reference2, A.signals2_1, A.signals2_2 move and nothing says what they"
    ):
        R.read(tmp_path / "a.mat", {"inputs": ["C.Speed"]})
    assert R.read(tmp_path / "a.mat", {"states": PITCH, "inputs": ["C.Speed"]}).n == 2


def test_a_scope_with_decimation_gives_the_common_grid(tmp_path):
    savemat(tmp_path / "a.mat", {"x": {"Time": TIME, "Data": X}, "u": {"Time": TIME[::2] + 1e-12, "Data": U[::2]}})
    recording = R.read(tmp_path / "a.mat")
    assert recording.dt == 0.5 and np.array_equal(recording.states[0], X[::2])


def test_many_signals_with_times_of_their_own_are_no_burden(tmp_path):
    """Compared each with each, thousands of scopes of ten samples would take minutes."""
    times = np.add.outer(np.arange(5_000) / 7, TIME)
    scopes = [{"time": time, "signals": [{"values": X, "label": ""}]} for time in times]
    whole = columns.tables([{f"s{i}": each for i, each in enumerate(scopes)}], remarks := [])[0]
    assert len(whole.times) == 5_000 and len(whole.names) == 10_001 and remarks == []
    again = [{"time": TIME, "signals": [{"values": X, "label": "q"}]}] * 5_000
    whole = columns.tables([{f"s{i}": each for i, each in enumerate(again)}], remarks)[0]
    assert whole.names == ["time", "q1", "q2"] and len(remarks) == 4_999


def test_scopes_without_a_common_time(tmp_path):
    savemat(tmp_path / "a.mat", {"x": scope(TIME, X), "u": scope(TIME + 0.1, U), "r": scope(TIME[::-1], U)})
    names = {"states": ["x.signals1_1"], "inputs": ["u.signals1"]}
    with pytest.raises(tras.RecordingError, match="'x', 'u' have other times than each other: 0 instants are common"):
        R.read(tmp_path / "a.mat", names)
    with pytest.raises(tras.RecordingError, match="the time of 'r' does not rise"):
        R.read(tmp_path / "a.mat", {**names, "inputs": ["r.signals1"]})


def test_matrices_beside_scopes_have_the_time_of_the_scope_of_their_length(tmp_path):
    content = {"log": scope(TIME, X, labels=["x"]), "u": U, "t": TIME, "gain": np.eye(2)}
    savemat(tmp_path / "a.mat", content)
    recording = R.read(tmp_path / "a.mat", {"states": ["x1", "x2"], "inputs": ["u"]})
    assert np.array_equal(recording.inputs[0], U) and "left out: gain, of another length" in sentences(recording)


def test_rows_of_a_to_file_block(tmp_path):
    savemat(tmp_path / "a.mat", {"ans": np.vstack([TIME, U.T, X.T])}, format="4")
    recording = R.read(tmp_path / "a.mat", {"time": "ans1", "inputs": ["ans2"], "states": ["ans3", "ans4"]})
    assert np.array_equal(recording.states[0], X) and recording.dt == 0.25


# --- what is the time's axis, what is the test set --------------------


def test_matrices_of_a_model_beside_the_signals_do_not_turn_them(tmp_path):
    beside = {"A": np.eye(2), "B": np.ones((2, 1)), "Q": np.eye(2), "K": np.ones((1, 2)), "P": np.eye(3)}
    for signals in ({"x": X, "u": U}, {"x": X.T, "u": U.T}, {"x": X}):
        savemat(tmp_path / "a.mat", {**beside, **signals, "dt": 0.25})
        recording = R.read(tmp_path / "a.mat", {"states": ["x1", "x2"]} if "u" in signals else {"inputs": []})
        assert np.array_equal(recording.states[0], X) and recording.m == ("u" in signals)
        assert "left out: B, of another length than the rest" in sentences(recording)


def test_x_beside_y_without_u_is_a_question(tmp_path):
    """Sets for learning call the input x. As two states they would be a free motion."""
    savemat(tmp_path / "a.mat", {"X": U, "y": X[:, :1], "dt": 0.25})
    with pytest.raises(tras.RecordingError, match="(?s)X may be the input, as there is y and no u.*STATES=y INPUTS=X"):
        R.read(tmp_path / "a.mat")
    assert R.read(tmp_path / "a.mat", {"inputs": []}).state_names == ("X", "y")
    savemat(tmp_path / "a.mat", {"x": X, "y": U, "z": U, "dt": 0.25})
    assert R.read(tmp_path / "a.mat").n == 4


def test_a_short_trial_stands_as_the_first_one_does(tmp_path):
    x = np.random.default_rng(2).normal(size=(K, 4))
    savemat(tmp_path / "a.mat", {"x": cell(x, x[:3]), "u": cell(U, U[:3]), "dt": 0.25})
    recording = R.read(tmp_path / "a.mat")
    assert list(recording.lengths) == [7, 3] and np.array_equal(recording.states[1], x[:3])


TRAIN, TEST = {"t": TIME, "x": X, "u": U}, {"t": TIME[SHORT], "x": X[SHORT], "u": U[SHORT]}
SPLITS = {
    "cells": ({"train": cell(TRAIN, TRAIN), "val": cell(TEST)}, [7, 7, 4], [2]),
    "structs": ({"estimation": TRAIN, "validation": TEST}, [7, 4], [1]),
    "in a struct": ({"data": {"train": TRAIN, "test": TEST}}, [7, 4], [1]),
    "test first": ({"a_test": TEST, "a_train": TRAIN}, [7, 4], [1]),
    "camel": ({"uEst": U, "xEst": X, "uVal": U[SHORT], "xVal": X[SHORT], "Ts": 0.25}, [7, 4], [1]),
    "words in front": ({"trainU": U, "trainX": X, "testU": U[SHORT], "testX": X[SHORT], "Ts": 0.25}, [7, 4], [1]),
    "one word": ({"utrain": U, "xtrain": X, "utest": U[SHORT], "xtest": X[SHORT], "Ts": 0.25}, [7, 4], [1]),
    "cells of signals": (
        {"u_id": cell(U, U), "x_id": cell(X, X), "u_val": cell(U[SHORT]), "x_val": cell(X[SHORT]), "fs": 4.0},
        [7, 7, 4], [2],
    ),
}  # fmt: skip


@pytest.mark.parametrize("layout", SPLITS)
def test_a_file_with_a_test_set(layout, tmp_path):
    content, lengths, test = SPLITS[layout]
    savemat(tmp_path / "a.mat", content)
    recording = R.read(tmp_path / "a.mat", None if layout[0] != "w" else {"states": ["X1", "X2"], "inputs": ["U"]})
    assert list(recording.lengths) == lengths and recording.attributes["test_trajectories"] == test
    assert recording.dt == 0.25 and np.array_equal(recording.states[-1], X[SHORT])
    assert "are the test set" in sentences(recording)
    recording.write(path := tmp_path / "again.nc")
    assert R.read(path).attributes["test_trajectories"] == test


def test_the_test_set_stays_one_when_trajectories_are_chosen_cut_and_joined(tmp_path):
    savemat(tmp_path / "a.mat", {"train": cell(TRAIN, TRAIN), "val": cell(TEST)})
    recording = R.read(tmp_path / "a.mat")
    assert recording[[2, 0]].attributes["test_trajectories"] == [0]
    assert "test_trajectories" not in recording[:2].attributes
    assert recording.cut(4).attributes["test_trajectories"] == [4]  # pieces 2, 2, 1
    assert recording.cut_all(3).attributes["test_trajectories"] == [6, 7]
    assert recording.select(states=["x1"]).attributes["test_trajectories"] == [2]
    joined = tras.recording.join([recording, recording])
    assert joined.attributes["test_trajectories"] == [2, 5] and recording.attributes["test_trajectories"] == [2]


def test_what_looks_like_a_test_set_and_is_none(tmp_path):
    for names in (("uVal", "xVal"), ("u_test", "x"), ("interval", "x")):
        savemat(tmp_path / "a.mat", {"t": TIME, names[0]: U, names[1]: X})
        recording = R.read(tmp_path / "a.mat", {"states": [f"{names[1]}1"], "inputs": [names[0]]})
        assert len(recording) == 1 and "test_trajectories" not in recording.attributes


def test_single_numbers_are_said_where_the_sampling_time_is_asked_for(tmp_path):
    savemat(tmp_path / "a.mat", {"x": X, "u": U, "h": 0.005, "note": "rig"})
    with pytest.raises(tras.RecordingError, match="(?s)no sampling time.*Noticed: single numbers in it: h = 0.005"):
        R.read(tmp_path / "a.mat")


# --- sizes and damage --------------------


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    dtype=st.sampled_from("i1 u1 i2 u2 i4 u4 i8 u8 f4 f8 ?".split()),
    shape=st.tuples(st.integers(0, 4), st.integers(0, 4)),
    compressed=st.booleans(),
    text=st.text(st.characters(max_codepoint=0xD000, exclude_characters="\0"), min_size=1, max_size=6),
    seed=st.integers(0, 99),
)
def test_our_reader_of_version_5_agrees_with_scipy(dtype, shape, compressed, text, seed, tmp_path):
    array = np.random.default_rng(seed).integers(0, 100, shape).astype(dtype)
    savemat(tmp_path / "a.mat", {"a": array, "s": {"inner": cell(array, text)}}, do_compression=compressed)
    ours, theirs = matfile5.read_variables((tmp_path / "a.mat").read_bytes()), loadmat(tmp_path / "a.mat")
    assert np.array_equal(ours["a"], theirs["a"]) and np.array_equal(ours["s"]["inner"][0], array)
    assert ours["s"]["inner"][1] == theirs["s"]["inner"][0, 0][0, 1][0] == text


def test_claims_of_size_are_refused_before_room_is_made(tmp_path):
    savemat(tmp_path / "a.mat", {"c": cell(X, X)})
    content = bytearray((tmp_path / "a.mat").read_bytes())
    content[128 + 32 : 128 + 40] = b"\xff\xff\xff\x7f\xff\xff\xff\x7f"
    with pytest.raises(tras.RecordingError, match="more than there are bytes for"):
        R.read(write(tmp_path / "b.mat", bytes(content)))
    bomb = zlib.compress(bytes(10**7))
    bomb = (tmp_path / "a.mat").read_bytes()[:128] + (15).to_bytes(4, "little") + len(bomb).to_bytes(4, "little") + bomb
    with pytest.raises(tras.RecordingError):
        R.read(write(tmp_path / "b.mat", bomb))
    names = element(5, struct.pack("<i", 1)) + element(1, b"a" * 10**6)  # each a field's name
    with pytest.raises(tras.RecordingError, match="a struct has 1000000 fields; up to 10000 are read"):
        R.read(version5(tmp_path / "b.mat", sized(2, "s", (0, 1), names)))
    with h5py.File(tmp_path / "c.mat", "w") as file:
        file.create_dataset("x", (10**9, 10**3), "f8", chunks=(1000, 1000))
    with pytest.raises(tras.RecordingError, match="more than 100000000 values"):
        R.read(tmp_path / "c.mat")


# --- objects of the new kind --------------------


def index_of(objects, version=4):
    """The numbers that say which value is which property: (class, name -> place) of each object, numbered from 1."""
    names = list(dict.fromkeys(word for kind, properties in objects for word in (kind, *properties)))
    number = {name: i + 1 for i, name in enumerate(names)}
    kinds = list(dict.fromkeys(kind for kind, _ in objects))
    classes = [[0, 0, 0, 0], *([0, number[kind], 0, 0] for kind in kinds)]
    records, plain = [[0] * 6], [0, 0]
    for i, (kind, properties) in enumerate(objects):
        records.append([kinds.index(kind) + 1, 0, 0, 0, i + 1, i + 1])
        record = [len(properties), *(word for key, place in properties.items() for word in (number[key], 1, place))]
        plain += record + [0] * (len(record) % 2)
    regions = [np.array(words, dtype="<u4").tobytes() for words in (classes, [0, 0], records, plain, [0, 0])]
    text_of_names = "\0".join([*names, ""]).encode()
    text_of_names += bytes(-len(text_of_names) % 8)
    ends = np.cumsum([40 + len(text_of_names), *map(len, regions), 0, 0]).tolist()
    return np.array([version, len(names), *ends], dtype="<u4").tobytes() + text_of_names + b"".join(regions)


def store(*objects, values, version=4):
    """The part of a file for objects, with their ``values``."""
    words = index_of(objects, version)
    words = sized(9, "", (len(words), 1), element(2, words))
    wrapper = cells(words, matrix(np.zeros((0, 0))), *values, *[cells()] * 3)
    wrapper = variable(17, element(1, b"MCOS"), element(1, b"MCOS"), element(1, b"FileWrapper__"), wrapper)
    names = element(5, struct.pack("<i", 8)), element(1, b"MCOS".ljust(8, b"\0"))
    inner = sized(2, "", (1, 1), *names, wrapper)
    content = b"\x00\x01IM" + bytes(4) + inner
    return sized(9, "", (len(content), 1), element(2, content))


def reference(number, kind, name=None):
    """A variable that is the object ``number`` of the class number ``kind``, or a cell that refers to it."""
    numbers = np.array([0xDD000000, 2, 1, 1, number, kind], dtype="<u4")
    content = sized(13, "", (6, 1), element(6, numbers.tobytes()))
    if name is None:
        return content
    title, label = name
    return variable(17, element(1, label.encode()), element(1, b"MCOS"), element(1, title.encode()), content)


def structure(**fields):
    names = b"".join(key.encode().ljust(32, b"\0") for key in fields)
    return sized(2, "", (1, 1), element(5, struct.pack("<i", 32)), element(1, names), *fields.values())


def table_of(times, rows=K, **changes):
    content = {
        "data": cells(matrix(X), matrix(U)), "varNames": cells(text("x"), text("u")), "numRows": matrix([[rows]]),
        "rowTimes": times, "useVarNamesOrig": matrix([[0]]),
    } | changes  # fmt: skip
    return structure(**content)


DURATION = matrix(1000 * TIME[:, None])
DATES = 1.7e12 + 1000 * TIME
DATE = sized(6, "", (K, 1), element(9, DATES.tobytes()), element(9, (0.5 * (TIME > 0)).tobytes()), flags=0x800)
STEPS = structure(
    origin=reference(2, 2), specifiedAsRate=matrix([[0]]), stepSize=reference(2, 2), sampleRate=matrix([[np.nan]])
)
RATE = structure(
    origin=reference(2, 2), specifiedAsRate=matrix([[1]]), stepSize=matrix([[0]]), sampleRate=matrix([[4]])
)


@pytest.mark.parametrize(
    "kind, property_name, time, times",
    [
        ("duration", "millis", DURATION, reference(2, 2)),
        ("datetime", "data", matrix(DATES[:, None]), reference(2, 2)),
        ("duration", "millis", matrix([[250.0]]), STEPS),
        ("duration", "millis", matrix([[250.0]]), RATE),
    ],
    ids=["durations", "dates", "a step", "a rate"],
)
@pytest.mark.parametrize("version", [2, 3, 4])
def test_timetables(kind, property_name, time, times, version, tmp_path):
    objects = ("timetable", {"any": 0}), (kind, {property_name: 1})
    values = [table_of(times), time, *[cells()] * (4 - version)]
    whole = store(*objects, values=values, version=version)
    recording = R.read(version5(tmp_path / "a.mat", reference(1, 1, ("timetable", "log")), whole))
    assert np.array_equal(recording.states[0], X) and np.array_equal(recording.inputs[0], U) and recording.dt == 0.25


def test_timetables_of_version_7_3(tmp_path):
    index = np.frombuffer(index_of([("timetable", {"any": 0}), ("duration", {"millis": 1})]), dtype="u1")
    times = np.array([[0xDD000000, 2, 1, 1, 2, 2]]).T
    table = {"data": cell(X, U), "varNames": cell("x", "u"), "numRows": np.array([[K]]), "rowTimes": times}
    values = cell(index[:, None], np.zeros((1, 1)), table, 1000 * TIME[:, None], *[np.zeros((1, 1))] * 3)
    hdf(tmp_path / "a.mat", {"log": np.array([[0xDD000000, 2, 1, 1, 1, 1]]).T, "objects": values})
    with h5py.File(tmp_path / "a.mat", "r+") as file:
        file.move("objects", "#subsystem#/MCOS")
        file["log"].attrs.update({"MATLAB_class": np.bytes_("timetable"), "MATLAB_object_decode": 3})
    recording = R.read(tmp_path / "a.mat")
    assert np.array_equal(recording.states[0], X) and np.array_equal(recording.inputs[0], U) and recording.dt == 0.25


def test_dates_keep_what_a_float_cannot_hold(tmp_path):
    """An instant is the sum of the real part and the imaginary part, in ms."""
    whole = store(("timetable", {"any": 0}), ("datetime", {"data": 1}), values=[table_of(reference(2, 2)), DATE])
    source = matlab.open_table(version5(tmp_path / "a.mat", reference(1, 1, ("timetable", "log")), whole))
    table = source.read(Roles("time", ["x1"], [], None, None, {}))[0]
    assert np.allclose(np.diff(table["time"]), [0.2505, *[0.25] * 5], rtol=1e-12)


def test_a_table_has_columns_and_a_timeseries_its_time(tmp_path):
    values = [cells(matrix(X), matrix(U)), cells(text("x"), text("u"))]
    whole = store(("table", {"data": 0, "varnames": 1}), values=values)
    recording = R.read(version5(tmp_path / "a.mat", reference(1, 1, ("table", "log")), whole), dt=0.25)
    assert np.array_equal(recording.states[0], X) and np.array_equal(recording.inputs[0], U)
    info = {"Start": 2, "Increment": 3, "Length": 4}
    values = [matrix(X), reference(2, 2), matrix([[1.0]]), matrix([[0.25]]), matrix([[K]]), matrix(U)]
    values.append(matrix(TIME[:, None] + 1))
    objects = ("timeseries", {"Data_": 0, "TimeInfo": 1}), ("tsdata.timemetadata", info)
    whole = store(*objects, ("timeseries", {"Data_": 5, "Time_": 6}), values=values)
    series = reference(1, 1, ("timeseries", "x")), reference(3, 1, ("timeseries", "u"))
    recording = R.read(version5(tmp_path / "a.mat", *series, whole))
    assert np.array_equal(recording.states[0], X) and np.array_equal(recording.inputs[0], U) and recording.dt == 0.25


HOLDS_ITSELF = [table_of(reference(1, 1)), DURATION]


@pytest.mark.parametrize(
    "values",
    [
        HOLDS_ITSELF,
        [table_of(reference(9, 2)), DURATION],
        [table_of(reference(2, 1)), DURATION],
        [table_of(STEPS, rows=1e12), matrix([[1.0]])],
        [table_of(STEPS, rows=np.inf), matrix([[1.0]])],
        [table_of(STEPS, rows=1e8, data=cells(), varNames=cells()), matrix([[1.0]])],
        [table_of(reference(2, 2), data=cells(matrix(X[:3]), matrix(U[:3]))), DURATION],
        [table_of(reference(2, 2), data=cells(matrix(X))), DURATION],
        [table_of(reference(2, 2), varNames=cells(matrix(X), matrix(U))), DURATION],
        [table_of(reference(2, 2)), text("noon")],
        [table_of(reference(2, 2))],
        [cells()] * 2,
        [],
    ],
)
def test_objects_that_do_not_fit_are_left_out_with_advice(values, tmp_path):
    whole = store(("timetable", {"any": 0}), ("duration", {"millis": 1}), values=values)
    path = version5(tmp_path / "a.mat", reference(1, 1, ("timetable", "log")), whole)
    with pytest.raises(tras.RecordingError, match=r"(?s)left out: log .an object .timetable.*timetable2table\(log\)"):
        R.read(path)


@pytest.mark.parametrize("place, number", [(0, 7), (1, 2**32 - 1), (1, 0), (2, 2), (4, 0), (4, 2**32 - 1), (5, 9)])
def test_references_that_lie_cost_nothing(place, number, tmp_path):
    label = bytearray(reference(1, 1, ("timetable", "log")))
    label[-24 + 4 * place : len(label) - 24 + 4 * place + 4] = number.to_bytes(4, "little")
    whole = store(("timetable", {"any": 0}), ("duration", {"millis": 1}), values=[table_of(reference(2, 2)), DURATION])
    tracemalloc.start()
    with pytest.raises(tras.RecordingError, match="left out: log .an object .timetable."):
        R.read(version5(tmp_path / "a.mat", bytes(label), whole))
    assert tracemalloc.get_traced_memory()[1] < 10**7
    tracemalloc.stop()


def test_many_variables_that_are_one_object_cost_one(tmp_path):
    """Each would be a time of its own: 20 000 times 100 000 numbers."""
    rows = 10**5
    content = table_of(STEPS, rows, data=cells(matrix(np.zeros((rows, 1))), matrix(np.zeros((rows, 1)))))
    whole = store(("timetable", {"any": 0}), ("duration", {"millis": 1}), values=[content, matrix([[250.0]])])
    labels = [reference(1, 1, ("timetable", f"log{i}")) for i in range(20_000)]
    tables = matfile5.read_variables(version5(tmp_path / "a.mat", *labels, whole).read_bytes())
    assert len(tables) == 20_000 and len({id(table["time"]) for table in tables.values()}) == 1
