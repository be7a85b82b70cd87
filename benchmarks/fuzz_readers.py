"""Damaged files: what the readers make of valid ones with bytes flipped, cut off, doubled and mixed.

    .venv/bin/python benchmarks/fuzz_readers.py [--inputs 100000] [--seed 1] [--only csv nc npz yaml] [--csv counts.csv]

Each input is a valid file of one format, our own or as other tools write it, damaged in one to eight places. A child
process reads one after the other: ten seconds are a hang, a dead child is a crash, anything but a `RecordingError` is a
traceback. A recording read without complaint with other numbers, names, units or sampling time is "other content":
"silent", an error, where the file has a checksum (.nc, .parquet and .mat that we wrote), else what cannot be noticed (a
digit of a CSV, a number in another tool's .mat or .parquet). "unforeseen" counts damage that only the last net caught:
errors of a library or of ours that are no sentence about the file. Exit status 1 if something was wrong.

Models, checkpoints and YAML are read and used: a model reports and predicts, a fit goes on from its checkpoint,
parameters are checked and the grid of a sweep is made. Only a ValueError of one line that names the file is a refusal.
Of an .npz file every name comes twice: damaged as it is, where the zip file's checksums notice (so other content is
"silent"), and "inside", where an array or the header is damaged and stored again with the right checksums; a number
that is not finite is a traceback there. YAML also gets words that have hurt readers.
"""

import argparse
import collections
import csv
import io
import json
import multiprocessing
import os
import re
import resource
import struct
import sys
import tempfile
import time
import warnings
import zipfile
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import h5py  # noqa: E402
import numpy as np  # noqa: E402
import pandas  # noqa: E402
from scipy.io import savemat  # noqa: E402

import tras  # noqa: E402
from tras.io import roles as roles_of_files  # noqa: E402
from tras.sweeps import command as sweeps  # noqa: E402
from tras.sweeps.grid import points  # noqa: E402
from tras.workflow import parameters  # noqa: E402

ROOT = Path(__file__).resolve().parent.parent
TEXTS = ("dat", "log", "tsv", "lvm", "txt")
CHECKED = ("own.nc", "own.parquet", "own.mat")
WORDS = (
    b"&a ", b"*a", b"!!int ", b"!!float ", b"!!timestamp x", b"!!binary ", b"!!set {a, b}", b"!!omap [a: 1]",
    b"<<: {a: 1}", b"[" * 50, b"{a: " * 30, b"- " * 30, b".nan", b"-.inf", b"1.0e+400", b"1e400", b"9" * 30,
    b"9" * 5000, b"-1", b"0", b"0x" + b"f" * 40, b"0b_", b"1:" * 30 + b"1", b"2001-99-99", b"null", b"~", b"yes",
    b"\xff", b"\xe4", b"\x00", b"\t", b"? [a]\n: 1\n", b"%YAML 9.9\n", b"---\n", b"...\n", b"|\n", b">9\n", b"'",
    b'"', b"#", b": ", b"\r", b",",
)  # fmt: skip
NUMBERS = (
    0, -1, 1, 3000, 10**12, 2**63, -(2**63), 1e400, -1e400, float("nan"), 1e300, 1e-320, None, True, "", "x", [], {},
)  # fmt: skip
CHUNKS = {"few": 60, "many": 4000}  # pairs, of the fits with checkpoints
# Of files whose columns have no plain names.
ROLES = {
    "to_file.mat": {"time": "ans1", "inputs": "ans2", "states": ["ans3", "ans4"]},
    "blanks.dat": {"time": "1", "states": ["2", "3"], "inputs": "4"},
    "scopes.mat": {"states": ["x1", "x2"], "inputs": "u"},
}
PATIENCE = 10  # s
USED = (".npz", ".yaml")  # what is no recording
WRONG = ("crash", "hang", "traceback")


def seeds(folder):
    """Valid files, small so that most damage hits something that matters: name -> bytes."""
    rng = np.random.default_rng(0)
    x, u = [rng.normal(size=(k, 2)) for k in (7, 4)], [rng.normal(size=(k, 1)) for k in (7, 4)]
    labels = {
        "state_names": ["phi", "phidot"],
        "state_units": ["rad", "rad/s"],
        "input_names": ["u1"],
        "input_units": ["N m"],
    }
    recording = tras.Recording(x, u, 0.25, **labels, attributes={"seed": 3})
    for suffix in ("nc", "csv", "parquet", "mat"):
        recording.write(folder / f"own.{suffix}")
    t = [np.arange(len(a)) * 0.25 for a in x]
    lines = [f"{s:.2f};{a[0]:.4f};{a[1]:.4f};{b[0]:.3f}".replace(".", ",") for s, a, b in zip(t[0], x[0], u[0])]
    (folder / "logger.csv").write_text(
        "\n".join(["\ufeffTime [s];phi [deg];phidot [deg/s];u1 [V]", *lines, ""]), encoding="utf-8"
    )
    pandas.DataFrame({"time": t[0], "phi": x[0][:, 0], "u1": u[0][:, 0], "run": ["a"] * 4 + ["b"] * 3}).to_parquet(
        folder / "pandas.parquet"
    )
    cells = {"t": _cell(t), "x": _cell(x), "u": _cell(u)}
    savemat(folder / "matlab5.mat", cells)
    savemat(folder / "matlab5z.mat", {"log": {"t": t[0], "x": x[0], "u": u[0], "name": "rig"}}, do_compression=True)
    _matlab73(folder / "matlab73.mat", cells)
    savemat(folder / "version4.mat", {"t": t[0], "x": x[0], "u": u[0]}, format="4")
    savemat(folder / "to_file.mat", {"ans": np.vstack([t[0], u[0].T, x[0].T])}, format="4")
    scopes = {"angle": _scope(t[0], x[0], "x"), "control": _scope(np.r_[t[0], 9.0], np.r_[u[0], [[0.0]]], "u")}
    savemat(folder / "scopes.mat", scopes)
    split = {"uEst": u[0], "xEst": x[0], "uVal": u[1], "xVal": x[1], "Ts": 0.25, "G": x[0] + 1j}
    savemat(folder / "split.mat", split)
    savemat(folder / "parts.mat", {"train": _cell([{"t": t[0], "x": x[0], "u": u[0]}] * 2), "val": cells})
    (folder / "iddata.mat").write_bytes(_iddata(x, u))
    (folder / "timetable.mat").write_bytes(_timetable(t[0], x[0], u[0]))
    _text_tables(folder, np.column_stack([t[0], x[0], u[0]]))
    _models(folder)
    _yaml(folder)
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def _cell(values):
    array = np.empty((1, len(values)), dtype=object)
    array[0, :] = values
    return array


def _scope(time, values, label):
    """Simulink's structure with time."""
    signal = np.array([(values, 2.0, label)], dtype=[("values", object), ("dimensions", object), ("label", object)])
    return {"time": time[:, None], "signals": signal, "blockName": "rig/Scope"}


def _text_tables(folder, table):
    """As loggers, oscilloscopes and spreadsheets write them."""
    rows = [[f"{value:.4f}" for value in row] for row in table]

    def write(name, separator, *above, encoding="utf-8", end=""):
        lines = [*above, *(separator.join(row) + end for row in rows), ""]
        (folder / name).write_text("\n".join(lines), encoding=encoding)

    write("blanks.dat", "  ", end="  ")
    write("preamble.log", "\t", "Rig 3", "Operator: N. N.", "", "time\tphi\tphidot\tu1")
    write("units.tsv", "\t", "time\tphi\tphidot\tu1", "s\trad\trad/s\tV")
    write(
        "labview.lvm",
        "\t",
        "LabVIEW Measurement",
        "Writer_Version\t2",
        "***End_of_Header***",
        "X_Value\tphi\tphidot\tu1",
    )
    write("bars.txt", " | ", "time | phi | phidot | u1", end=" | ", encoding="utf-16")


def log(samples):
    """A pendulum-like recording to fit and predict: two states, one input."""
    rng = np.random.default_rng(1)
    u = rng.uniform(-1, 1, (samples, 1))
    x = np.zeros((samples, 2))
    for k in range(samples - 1):
        q, v = x[k]
        x[k + 1] = q + 0.1 * v, v + 0.1 * (u[k, 0] - np.sin(q) - 0.5 * v)
        x[k + 1] += 0.01 * rng.standard_normal(2)  # or delayed samples depend on each other
    return tras.Recording([x], [u], 0.1)


LOG = log(200)
LONG = log(6000)  # more than a panel, so that the checkpoint holds products
PARTS = {"few": LOG.cut_all(40), "many": LONG.cut_all(1000)}
MODELS = {
    "field": tras.KoopmanModel(tras.Mechanical(2)),
    "rbf": tras.KoopmanModel(tras.GaussianRBF(3), "one_step", 1),
    "linear": tras.KoopmanModel(tras.Union(tras.Monomials(2), tras.ThinPlate(2)), "lifted_linear"),
    "product": tras.KoopmanModel(tras.Product(tras.Fourier(), tras.Exponentials()), "one_step", columns="states"),
}


def fitter():
    return tras.KoopmanModel(tras.Monomials(1), "one_step", strength=1e-3)


def _models(folder):
    for name, model in MODELS.items():
        model.fit(LOG).save(folder / f"model_{name}.npz")
    for name, pieces in PARTS.items():
        try:
            fitter().fit(
                _cut_off(pieces), chunk=60 if name == "few" else 4000, checkpoint=folder / f"checkpoint_{name}.npz"
            )
        except KeyboardInterrupt:
            pass
    for path in list(folder.glob("*.npz")):
        (folder / f"{path.stem}_inside.npz").write_bytes(path.read_bytes())


def _cut_off(pieces):
    """Reads all for the survey, then stops before the last piece."""
    readings = []

    def read():
        readings.append(1)
        for k in range(len(pieces)):
            if len(readings) > 1 and k == len(pieces) - 1:
                raise KeyboardInterrupt
            yield pieces[k]

    return read


def _yaml(folder):
    (folder / "roles.yaml").write_text(
        "time: stamp\noutputs: [b, a]\ninputs: c\nunits: {stamp: ms, a: rad, c: N m}\n", encoding="utf-8"
    )
    for name in ("paper", "smoke"):
        stages = re.split(rb"\n(?=\S)", (ROOT / "params" / f"{name}.yaml").read_bytes()[:1500])[:-1]  # whole ones
        (folder / f"params_{name}.yaml").write_bytes(b"\n".join(stages) + b"\n")
    (folder / "sweep.yaml").write_text(
        "recording: a.nc\nwindow: 6.0\ntrain_fraction: 0.8\nmodels:\n  dictionary:\n    - Mechanical\n"
        "    - Monomials: {degree: [1, 2]}\n    - GaussianRBF: {n_centres: 5, seed: 3, width: 1.5}\n"
        "    - Union: [Monomials, {ThinPlate: {seed: 1}}]\n  strength: [auto, 0.01]\n  delays: [0, 1]\n",
        encoding="utf-8",
    )


def element(kind, content):
    """An element of a MATLAB file of version 5."""
    return struct.pack("<II", kind, len(content)) + content + bytes(-len(content) % 8)


def value(number, name, dims, *elements):
    """A variable of the class ``number``, or what stands in a cell or field."""
    head = element(6, struct.pack("<II", number, 0)) + element(5, struct.pack("<2i", *dims))
    return element(14, head + element(1, name) + b"".join(elements))


def matrix(array):
    array = np.atleast_2d(array).astype(float)
    return value(6, b"", array.shape, element(9, array.tobytes(order="F")))


def cells(*values):
    return value(1, b"", (len(values), 1), *values)


def text(content):
    return value(4, b"", (1, len(content)), element(16, content))


def structure(fields, number=2, name=b"", kind=()):
    names = element(1, b"".join(key.encode().ljust(32, b"\0") for key in fields))
    return value(number, name, (1, 1), *kind, element(5, struct.pack("<i", 32)), names, *fields.values())


def opaque(name, kind, content):
    head = element(6, struct.pack("<II", 17, 0)) + b"".join(element(1, word) for word in (name, b"MCOS", kind))
    return element(14, head + content)


def version5(*variables):
    return b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + b"".join(variables)


def _timetable(t, x, u):
    """A file of version 5 with a timetable: a reference, and the part for objects at the end."""
    data = {
        "data": cells(matrix(x), matrix(u)), "varNames": cells(text(b"x"), text(b"u")), "numRows": matrix(len(t)),
        "rowTimes": _words(0xDD000000, 2, 1, 1, 2, 2),
    }  # fmt: skip
    names = b"timetable\0any\0duration\0millis\0".ljust(40, b"\0")
    regions = [
        (0, 0, 0, 0, 0, 1, 0, 0, 0, 3, 0, 0), (0, 0), (*[0] * 6, 1, 0, 0, 0, 1, 1, 2, 0, 0, 0, 2, 2),
        (0, 0, 1, 2, 1, 0, 1, 4, 1, 1), (0, 0),
    ]  # fmt: skip
    ends = np.cumsum([40 + len(names), *(4 * len(region) for region in regions), 0, 0])
    index = np.array([4, 4, *ends], dtype="<u4").tobytes() + names
    index += b"".join(np.array(region, dtype="<u4").tobytes() for region in regions)
    index = value(9, b"", (len(index), 1), element(2, index))
    wrapper = cells(index, matrix(np.zeros((0, 0))), structure(data), matrix(1000 * t[:, None]), *[cells()] * 3)
    inner = b"\x00\x01IM" + bytes(4) + structure({"MCOS": opaque(b"MCOS", b"FileWrapper__", wrapper)})
    store = value(9, b"", (len(inner), 1), element(2, inner))
    return version5(opaque(b"log", b"timetable", _words(0xDD000000, 2, 1, 1, 1, 1)), store)


def _words(*numbers):
    return value(13, b"", (len(numbers), 1), element(6, np.array(numbers, dtype="<u4").tobytes()))


def _iddata(x, u):
    """A file of version 5 with an iddata object of two experiments, beside an opaque object and a function handle."""
    fields = {
        "Domain": text(b"Time"), "OutputData": cells(*map(matrix, x)), "OutputName": cells(text(b"q"), text(b"v")),
        "OutputUnit": cells(text(b"rad"), text(b"rad/s")), "InputData": cells(*map(matrix, u)),
        "InputName": cells(text(b"force")), "InputUnit": cells(text(b"N")),
        "InterSample": cells(text(b"zoh"), text(b"zoh")), "Ts": cells(matrix(0.25), matrix(0.25)),
        "SamplingInstants": cells(matrix(np.zeros((7, 0))), matrix(np.zeros((4, 0)))), "TimeUnit": text(b"seconds"),
    }  # fmt: skip
    data = structure(fields, 3, b"z", [element(1, b"iddata")])
    return version5(data, opaque(b"ts", b"timeseries", matrix(1.0)), value(16, b"f", (1, 1), matrix(1.0)))


def _matlab73(path, cells):
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in cells.items():
            references = []
            for value in values[0]:
                item = file.create_dataset(
                    f"#refs#/{name}{len(references)}", data=np.atleast_2d(value).T if value.ndim == 1 else value.T
                )
                item.attrs["MATLAB_class"] = np.bytes_("double")
                references.append(item.ref)
            file.create_dataset(name, data=np.array([references], dtype=h5py.ref_dtype)).attrs["MATLAB_class"] = (
                np.bytes_("cell")
            )


def damaged_inside(content, rng):
    """An .npz file of which the header or an array is damaged, its checksums made anew."""
    with zipfile.ZipFile(io.BytesIO(content)) as file:
        entries = {entry.filename: file.read(entry) for entry in file.infolist()}
    for _ in range(rng.choice((1, 1, 2))):
        name = list(entries)[int(rng.integers(len(entries)))] if rng.integers(3) else "header.npy"
        kind, entry = rng.integers(10), entries.get(name)
        if entry is None:
            continue
        if kind == 0:
            del entries[name]
        elif kind == 1:
            entries[list(entries)[int(rng.integers(len(entries)))]] = entry
        elif kind == 2:
            entries[name] = damaged(entry, list(entries.values()), rng)
        elif (array := _loaded(entry)) is None or (array.dtype.kind == "U") != (name == "header.npy"):
            continue  # damaged before, or another array by now
        elif name == "header.npy":
            try:
                header = json.loads(str(array))
            except (ValueError, RecursionError):
                header = None
            if not isinstance(header, dict):
                continue  # damaged before, or another array by now
            _spoil(header, rng)
            text = json.dumps(header)
            entries[name] = _npy(np.array("[" * 20_000 + text if rng.integers(50) == 0 else text))
        else:
            if kind == 3:
                array = array.reshape(-1)[: int(rng.integers(array.size + 1))]
            elif kind == 4:
                array = np.stack([array] * 2)
            elif kind == 5:
                array = array.T.astype(rng.choice((np.float32, np.int64, np.int8, complex, bool, ">f8")))
            elif array.size:
                number = NUMBERS[int(rng.integers(12))]
                array = array.astype(float) if isinstance(number, float) and rng.integers(4) else array.copy()
                try:
                    array.reshape(-1)[int(rng.integers(array.size))] = number
                except (OverflowError, ValueError):
                    pass
            entries[name] = _npy(array)
    method = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2)[max(0, int(rng.integers(30)) - 27)]
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", method) as file:
        for name, entry in entries.items():
            file.writestr(zipfile.ZipInfo(name), entry, method)
    return packed.getvalue() if rng.integers(10) else damaged(packed.getvalue(), [content], rng)


def _loaded(entry):
    try:
        return np.load(io.BytesIO(entry))
    except Exception:  # noqa: BLE001
        return None


def _npy(array):
    packed = io.BytesIO()
    np.save(packed, array)
    return packed.getvalue()


def _spoil(value, rng):
    """Change a random entry of nested dicts and lists."""
    while True:
        keys = list(value) if isinstance(value, dict) else range(len(value))
        if not keys:
            return
        key = list(keys)[int(rng.integers(len(keys)))]
        if isinstance(value[key], (dict, list)) and value[key] and rng.integers(4):
            value = value[key]
            continue
        kind = rng.integers(6)
        if kind == 0:
            del value[key]
        elif kind == 1 and isinstance(value[key], (dict, list)):
            inner = value[key]
            for _ in range(30):
                inner = {**inner, "parts": [inner]} if isinstance(inner, dict) else [inner]
            value[key] = inner
        elif kind == 2 and isinstance(value, list):
            value.extend(value * 3)
        else:
            value[key] = NUMBERS[int(rng.integers(len(NUMBERS)))]
        return


def worded(content, rng):
    """YAML with hostile words in it, and other damage."""
    for _ in range(int(rng.choice((1, 1, 2, 3)))):
        place, word = int(rng.integers(len(content) + 1)), WORDS[int(rng.integers(len(WORDS)))]
        if rng.integers(2):  # in place of a value
            place = content.find(b": ", place) + 2
            end = content.find(b"\n", place)
            content = content[:place] + word + content[end:]
        else:
            content = content[:place] + word + content[place:]
    return content


def damaged(content, others, rng):
    """The content with one to eight wounds: bits and bytes changed, cut off, left out, doubled, from another file."""
    content = bytearray(content)
    for _ in range(rng.choice((1, 1, 1, 2, 3, 8))):
        if not content:
            return b""
        position, length = int(rng.integers(len(content))), int(rng.integers(1, 65))
        kind = rng.integers(8)
        if kind <= 1:
            content[position] ^= 1 << int(rng.integers(8))
        elif kind == 2:
            content[position] = int(rng.integers(256))
        elif kind == 3:
            content[position : position + 4] = rng.choice(
                (b"\xff\xff\xff\xff", b"\x00\x00\x00\x00", b"\xff\xff\xff\x7f", b"\x00\x00\x00\x80")
            )
        elif kind == 4:
            del content[position:]
        elif kind == 5:
            del content[position : position + length]
        elif kind == 6:
            content[position:position] = content[position : position + length]
        else:
            other = others[int(rng.integers(len(others)))]
            start = int(rng.integers(len(other)))
            content[position : position + length] = other[start : start + length]
    return bytes(content)


def content_of(recording):
    """All that must not change unnoticed."""
    labels = (recording.dt, recording.state_names, recording.input_names, recording.state_units, recording.input_units)
    labels += tuple(recording.attributes.get(key) for key in ("intersample", "test_trajectories"))
    return repr(labels), [(x.tobytes(), u.tobytes()) for x, u in recording]


def used(path, name):
    """What comes of a file that is no recording: read, and used as a user does."""
    if name.startswith("model"):
        model = tras.load_model(path)
        arrays = [value for value in vars(model).values() if isinstance(value, np.ndarray)]
        if not all(np.isfinite(array).all() for array in arrays):
            raise ArithmeticError("numbers that are not finite were accepted")
        model.report()
        states, inputs = len(model.state_names_), len(model.input_names_)
        d = model.delays + 1
        x0 = np.zeros((d, states)) if d > 1 else np.zeros(states)
        model.simulate(x0, np.zeros((d + 20, inputs)))
        labels = repr((model.get_params(), model.names_, model.channels_.state_names, model.dt_, model.pairs_))
        return labels, [array.tobytes() for array in arrays]
    if name.startswith("checkpoint"):
        part = "few" if "few" in name else "many"
        pieces = PARTS[part]
        model = fitter().fit(
            lambda: (pieces[k] for k in range(len(pieces))), chunk=CHUNKS[part], checkpoint=path, threads=1
        )
        if not np.isfinite(model.koopman_matrix).all():
            raise ArithmeticError("numbers that are not finite were accepted")
        return "", [model.koopman_matrix.tobytes()]
    if name == "roles.yaml":
        return repr(roles_of_files.mapping(path)), []
    if name == "sweep.yaml":
        description = sweeps.read(path)
        try:
            return repr((description, [point.identity() for point in points(description.models)])), []
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None  # `sweep` is told the grid, not the file
    sections = []
    for notebook, defaults in DEFAULTS.items():
        values = parameters.read_params(path, notebook)
        sections.append(parameters.check_parameters(values, defaults, str(path)))
    return repr(sections), []


DEFAULTS = {path: parameters.notebook_defaults(path) for path in sorted((ROOT / "notebooks").glob("0[15]*.ipynb"))}


def verdict_on_use(path, name, truth):
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            content = used(path, name)
    except ValueError as error:
        sentence = str(error)
        if "\n" in sentence or len(sentence) > 600:
            return "traceback", f"no sentence: {sentence[:200]!r}"
        named = path.name in sentence or sentence.startswith("roles")
        foreseen = named and not isinstance(error, np.linalg.LinAlgError)
        return ("refused", "") if foreseen else ("unforeseen", f"{type(error).__name__}: {sentence}"[:160])
    except BaseException as error:  # noqa: BLE001
        return "traceback", f"{type(error).__name__}: {error}"[:200]
    return ("read, same content", "") if content == truth else ("other content", "")


def verdict(path, roles, truth):
    """What reading ``path`` with ``roles`` comes to."""
    try:
        recording = tras.Recording.read(path, roles)
    except tras.RecordingError as error:
        foreseen = isinstance(error.__cause__, ValueError) or path.suffix == ".nc" or error.__cause__ is None
        return (
            ("refused", "")
            if foreseen
            else ("unforeseen", f"{type(error.__cause__).__name__}: {error.__cause__}"[:120])
        )
    except BaseException as error:  # noqa: BLE001
        return "traceback", f"{type(error).__name__}: {error}"[:200]
    return ("read, same content", "") if content_of(recording) == truth else ("other content", "")


def work(jobs, answers, folder, names, contents, truths):
    """The child: reads one input after the other."""
    resource.setrlimit(resource.RLIMIT_AS, (6 * 2**30, 6 * 2**30))
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    for name, seed in iter(jobs.recv, None):
        path, rng = folder / f"damaged{Path(name).suffix}", np.random.default_rng(seed)
        path.write_bytes(spoiled(name, contents, rng))
        other = path.suffix in USED
        answers.send(
            verdict_on_use(path, name, truths[name]) if other else verdict(path, ROLES.get(name), truths[name])
        )


def spoiled(name, contents, rng):
    """The file of this name, damaged."""
    content = contents[name]
    if "_inside" in name:
        return damaged_inside(content, rng)
    if name.endswith(".yaml") and rng.integers(3):
        return worded(content, rng)
    return damaged(content, contents_of_kind(contents, name), rng)


def contents_of_kind(contents, name):
    return [content for other, content in contents.items() if Path(other).suffix == Path(name).suffix]


class Child:
    """A process that reads until it dies; started anew then."""

    def __init__(self, *arguments):
        self.arguments = arguments
        self.start()

    def start(self):
        jobs, self.jobs = multiprocessing.Pipe(duplex=False)
        self.answers, answers = multiprocessing.Pipe(duplex=False)
        self.process = multiprocessing.get_context("fork").Process(
            target=work, args=(jobs, answers, *self.arguments), daemon=True
        )
        self.process.start()
        jobs.close()
        answers.close()

    def end(self):
        self.jobs.send(None)
        self.process.join()

    def ask(self, job):
        self.jobs.send(job)
        try:
            if self.answers.poll(PATIENCE):
                return self.answers.recv()
            verdict = "hang", ""
        except EOFError:
            self.process.join()
            verdict = "crash", f"exit status {self.process.exitcode}"
        self.process.kill()
        self.process.join()
        self.start()
        return verdict


def truth(folder, name, content):
    """What the undamaged file holds."""
    if Path(name).suffix not in USED:
        return content_of(tras.Recording.read(folder / name, ROLES.get(name)))
    (folder / name).write_bytes(content)
    return used(folder / name, name)


def silent(name):
    """Whether other content is an error: the file has checksums."""
    return name in CHECKED or name.endswith(".npz") and "_inside" not in name


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--inputs", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=float("inf"), help="stop after this time")
    parser.add_argument("--only", nargs="*", default=["csv", "nc", "parquet", "mat", *TEXTS, "npz", "yaml"])
    parser.add_argument("--csv", type=Path, help="write the table here")
    options = parser.parse_args()
    began, counts, kinds = time.monotonic(), collections.defaultdict(collections.Counter), collections.Counter()
    with tempfile.TemporaryDirectory() as folder:
        originals = Path(folder) / "whole"
        originals.mkdir()
        contents = seeds(originals)
        truths = {name: truth(originals, name, contents[name]) for name in contents}
        names = [name for name in contents if Path(name).suffix[1:] in options.only]
        child = Child(Path(folder), names, contents, truths)
        for number in range(options.inputs):
            name = names[number % len(names)]
            verdict, words = child.ask((name, (options.seed, number)))
            counts[name][verdict] += 1
            if words or (verdict == "other content" and silent(name)) or verdict in WRONG:
                kinds[f"{name}: {verdict} {words}"] += 1
                if verdict in WRONG or (verdict == "other content" and silent(name)):
                    print(f"{name}, seed {options.seed} {number}: {verdict} {words}", flush=True)
            if time.monotonic() - began > options.seconds:
                break
        child.end()
    table = report(counts)
    print(table.to_string(index=False))
    memory = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    print(
        f"{sum(table['inputs'])} inputs in {time.monotonic() - began:.0f} s, seed {options.seed}; "
        f"at most {memory:.0f} MiB of memory"
    )
    for words, times in kinds.most_common(40):
        print(f"{times:6d}  {words}")
    if options.csv:
        table.to_csv(options.csv, index=False, lineterminator="\n", quoting=csv.QUOTE_MINIMAL)
    return int(table[list(WRONG)].to_numpy().sum() > 0 or table["silent"].sum() > 0)


def report(counts):
    rows = []
    for name, found in sorted(counts.items()):
        row = {"file": name, "inputs": sum(found.values())}
        row |= {key: found[key] for key in ("refused", "unforeseen", "read, same content", "other content", *WRONG)}
        rows.append({**row, "silent": found["other content"] if silent(name) else 0})
    return pandas.DataFrame(rows)


if __name__ == "__main__":
    sys.exit(main())
