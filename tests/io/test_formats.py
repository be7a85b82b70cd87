"""Recordings in files of other tools: columns and their roles, times, gaps, damage."""

import contextlib
import json
import re
import tracemalloc
import warnings

import h5py
import numpy as np
import pandas
import pyarrow
import pyarrow.parquet
import pytest
from conftest import matrices
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.io import loadmat, savemat

import tras
from tras.io import clock
from tras.io.formats import FORMATS
from tras.io.roles import assign, guess_role

R = tras.Recording
names = st.text(min_size=1, max_size=8).filter(
    lambda text: (
        text not in ("trajectory", "time", "sample", "row_size", ".")
        and not set(text) & set("/\0")
        and text.isprintable()
    )
)
LOGGER = "t [s];phi [deg];u1 [V]\n0,00;1,5;-1\n0,01;2,5;-1\n0,02;1e-3;2,25\n"


def same(a, b):
    labels = ("dt", "state_names", "input_names", "state_units", "input_units", "attributes")
    return all(repr(getattr(a, key)) == repr(getattr(b, key)) for key in labels) and all(
        x.tobytes() == y.tobytes() and u.tobytes() == v.tobytes() for (x, u), (y, v) in zip(a, b, strict=True)
    )


def write(path, text):
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def sentences(recording):
    return " ".join(tras.remarks(recording))


# --- round trips --------------------


@settings(max_examples=40, deadline=None)
@given(
    lengths=st.lists(st.integers(1, 6), min_size=1, max_size=4),
    n=st.integers(1, 3),
    m=st.integers(0, 2),
    data=st.data(),
)
def test_round_trips_are_exact(lengths, n, m, data, tmp_path_factory):
    labels = data.draw(st.lists(names, min_size=n + m, max_size=n + m, unique=True))
    unit = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=5)
    labels = {"state_names": labels[:n], "input_names": labels[n:], "state_units": [data.draw(unit) for _ in range(n)]}
    attributes, dt = {"seed": 3, "nested": [None, {"a": 0.1}]}, data.draw(st.floats(1e-6, 1e6))
    recording = R(
        [data.draw(matrices(k, n)) for k in lengths],
        [data.draw(matrices(k, m)) for k in lengths],
        dt,
        **labels,
        attributes=attributes,
    )
    folder = tmp_path_factory.mktemp("own")
    for suffix in FORMATS:
        path = folder / f"a{suffix}"
        recording.write(path)
        assert same(R.read(path), recording), suffix


@pytest.mark.parametrize("suffix", FORMATS)
def test_same_content_same_bytes(suffix, experiment, tmp_path):
    for name in "ab":
        experiment.write(tmp_path / f"{name}{suffix}")
    assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()
    assert same(R.read(tmp_path / f"a{suffix}"), experiment)


def test_other_tools_open_ours(experiment, tmp_path):
    for suffix in (".csv", ".parquet", ".mat"):
        experiment.write(tmp_path / f"a{suffix}")
    table = pandas.read_csv(tmp_path / "a.csv", comment="#")
    assert np.array_equal(table["phidot"], np.concatenate(experiment.states)[:, 1])
    assert pandas.read_parquet(tmp_path / "a.parquet").equals(experiment.to_frame())
    content = loadmat(tmp_path / "a.mat", simplify_cells=True)
    assert np.array_equal(np.stack(content["states"]), experiment.states)
    assert list(content["state_names"]) == list(experiment.state_names)


@pytest.mark.parametrize("suffix", FORMATS)
def test_roles_select_channels_of_our_own_files(suffix, experiment, tmp_path):
    experiment.write(path := tmp_path / f"a{suffix}")
    recording = R.read(path, {"states": ["psi"], "inputs": ["u_phi"]})
    assert recording.state_names == ("psi",) and recording.dt == experiment.dt
    assert np.array_equal(recording.inputs, experiment.select(inputs=["u_phi"]).inputs)


@pytest.mark.parametrize("suffix", [".nc", ".parquet", ".mat"])
def test_a_changed_number_is_noticed(suffix, tmp_path):
    R(np.arange(12.0).reshape(1, 6, 2), dt=0.1).write(path := tmp_path / f"a{suffix}")
    if suffix == ".nc":
        with h5py.File(path, "r+") as file:
            file["x2"][3] += 1e-12
    elif suffix == ".mat":
        content = {key: value for key, value in loadmat(path).items() if key[0] != "_"}
        content["states"][0, 0][3, 1] += 1e-12
        savemat(path, content)
    else:
        table = pyarrow.parquet.read_table(path)
        column = np.array(table["x1"]) + np.eye(6)[2] * 1e-12
        pyarrow.parquet.write_table(table.set_column(2, "x1", pyarrow.array(column)), path)
    with pytest.raises(tras.RecordingError, match="not fit its checksum"):
        R.read(path)


# --- text --------------------

PLAIN = np.array([[1.5], [2.5], [1e-3]]), np.array([[-1.0], [-1.0], [2.25]])


@pytest.mark.parametrize(
    "content",
    [
        LOGGER,
        LOGGER.replace("\n", "\r\n").encode("utf-8-sig"),
        LOGGER.encode("utf-16"),
        "sep=;\n" + LOGGER,
        "# logger 3, channel map 7\n\n" + LOGGER.replace(";\n", "\n"),
        LOGGER.replace(",", ".").replace(";", "\t"),
        LOGGER.replace(",", ".").replace(";", ","),
        LOGGER.replace(",", ".").replace(";", ",").replace("\n", ",\n"),
        "t,phi,u1\ns,deg,V\n0.00,1.5,-1\n0.01,2.5,-1\n0.02,1e-3,2.25\n",
        "t,phi,u1\n[s],[deg],[V]\n0.00,1.5,-1\n0.01,2.5,-1\n0.02,1e-3,2.25",
        "t (ms),phi (deg),u1 (V)\n0,1.5,-1\n10,2.5,-1\n20,0.001,2.25\n",
        'comment,t [s],phi [deg],u1 [V]\nstart,0.00,1.5,-1\n,0.01,2.5,-1\n"a, b",0.02,1e-3,2.25\n',
        't [s],phi [deg],u1 [V]\n"0,00","1,5",-1\n"0,01","2,5",-1\n"0,02","0,001","2,25"\n',
        "time,phi [deg],u1 [V]\n2026-02-28 23:59:59.990,1.5,-1\n2026-03-01 00:00:00.000,2.5,-1\n"
        "2026-03-01 00:00:00.010,1e-3,2.25\n",
    ],
)
def test_tables_as_loggers_and_spreadsheets_write_them(content, tmp_path):
    recording = R.read(write(tmp_path / "log.csv", content))
    assert np.array_equal(recording.states[0], PLAIN[0]) and np.array_equal(recording.inputs[0], PLAIN[1])
    assert recording.dt == 0.01
    assert (recording.state_names, recording.state_units) == (("phi",), ("deg",))
    assert (recording.input_names, recording.input_units) == (("u1",), ("V",))
    assert "states are phi." in sentences(recording) and "sampling time is 0.01 s" in sentences(recording)


def test_names_in_a_comment_and_blanks_between(tmp_path):
    np.savetxt(tmp_path / "a.csv", np.column_stack([np.arange(4) * 0.5, np.eye(4)[:, :2]]), header="t q qdot")
    recording = R.read(tmp_path / "a.csv")
    assert np.array_equal(recording.states[0], np.eye(4)[:, :2]) and recording.dt == 0.5


def test_western_spreadsheets_write_degrees_in_their_own_encoding(tmp_path):
    assert R.read(write(tmp_path / "a.csv", "t,phi [°]\n0,1\n1,2\n".encode("cp1252"))).state_units == ("°",)


def table(rows, header="t,q,u"):
    return header + "\n" + "".join(",".join(map(str, row)) + "\n" for row in rows)


EVEN = [(k / 10, k * k, -k) for k in range(8)]


def changed(row, column, value):
    rows = [list(cells) for cells in EVEN]
    rows[row][column] = value
    return table(rows)


@pytest.mark.parametrize(
    "content, words",
    [
        ("", "it has no rows"),
        ("\n\n", "it has no rows"),
        ("t,q,u\n", "a header but no row"),
        (
            "a,b,c\n1,2,3\n2,3,4\n",
            r"no column is plainly a state or an output; no column is plainly an input; no column is plainly time.*"
            r"\n  1  a  1 to 2  .*\n  2  b  2 to 3 .*\n  3  c .*\n  make identify RECORDING=\S*log.csv TIME=none STA",
        ),
        ("q,u\n1,2\n2,3\n", "no column is plainly time"),
        ("t,time,q\n1,1,3\n2,2,4\n", "t and time could each be the column of time"),
        (
            "0,1\n1,2\n",
            r"no column is plainly a state.*\n  1  1  0 to 1 .*\n  2  2  1 to 2 .*Noticed: .* no names: columns are 1",
        ),
        ("t,q,q\n0,1,2\n1,2,3\n", "name 'q' twice"),
        ("t,q,u\n0,1,2\n1,2\n", "line 3: it has 2 cells but the header has 3"),
        ("t,q,u\n0,0,1,5,2,0\n0,1,1,5,2,0\n", "line 2: it has 6 cells .* comma the decimal sign too.* ';'"),
        (changed(3, 1, "abc"), "line 5, column 'q': 'abc' is no number"),
        (changed(3, 1, "1_000"), "line 5, column 'q': '1_000' is no number"),
        (changed(3, 1, "\u0663"), "line 5, column 'q': '\u0663' is no number"),
        (changed(3, 1, '"1,000"'), "line 5, column 'q': '1,000' is no number"),
        ("t;q\n0,1;1,5\n0,2;1.5\n0,3;2\n", "line 3, column 'q': '1.5' is no number where others have a decimal comma"),
        (changed(3, 1, '"1'), "line 9: unexpected end of data; look for a quotation mark"),
        (changed(3, 0, 0.2), "line 5: the time 0.2 s in column 't' stands there twice"),
        (changed(3, 0, 0.1), "line 5: time goes backwards in column 't', from 0.2 to 0.1 s; .*`trial: t`"),
        (
            changed(7, 0, 0.75),
            "time is uneven in column 't': 1 of 7 steps differ from the median, 0.1 s, by more than 1 %, "
            "the first at line 9;.* between 0.1 and 0.15 s.*resample=0.1 ",
        ),
        (table([(0, 1, "")] * 3), "no two rows in succession are complete"),
        (
            table([(0, 1, 1, "a"), (1, 2, 2, "b"), (2, 1, 1, "a")], "t,q,u,run"),
            "line 4: trial a of column 'run' begins a second time",
        ),
        (table([(0, 1, 1, ""), (1, 2, 2, "b")], "t,q,u,run"), "line 2: the trial's column 'run' is empty"),
        (table(EVEN, "t [rpm],q,u"), "has the unit 'rpm'; give one of s"),
        (b"t,q\n0,\x00\x01\n", "zero byte near line 2"),
        (b"\xff\xfe\x00\xd8\x00", "it is no text"),
        ('# tras recording 2: {"format": \n', "line 1: its JSON is damaged"),
        ('# tras recording 2: {"format": "tras recording 9"}\na\n1\n', "its format is 'tras recording 9'"),
        ("t," * 20000 + "\n" + "1," * 20000 + "\n", "20001 columns; up to 10000"),
    ],
)
def test_what_is_wrong_with_a_table_is_one_sentence_with_its_place(content, words, tmp_path):
    with pytest.raises(tras.RecordingError, match=f"(?s)^{tmp_path}/log.csv: .*{words}"):
        R.read(write(tmp_path / "log.csv", content))


@pytest.mark.parametrize("cell", ["", "NaN", "inf", "#N/A", "-"])
def test_trajectories_are_cut_where_a_value_is_missing(cell, tmp_path):
    path = write(tmp_path / "a.csv", changed(3, 1, cell))
    recording = R.read(path)
    assert [x[:, 0].tolist() for x in recording.states] == [[0, 1, 4], [16, 25, 36, 49]]
    assert recording.inputs[1][0] == -4
    words = "missing (empty, NaN or infinite) in 1 rows, the first: q at line 5; cut the trajectories there: 2 are left"
    assert words in sentences(recording)
    with pytest.raises(tras.RecordingError, match="in 1 rows, the first: q at line 5; repair"):
        R.read(path, missing="refuse")


def test_a_missing_time_and_a_single_row_between_two_gaps(tmp_path):
    rows = [list(row) for row in EVEN]
    rows[2][0], rows[4][2] = "", "nan"
    recording = R.read(write(tmp_path / "a.csv", table(rows)))
    assert list(recording.lengths) == [2, 3] and recording.dt == 0.1
    assert "t at line 4; u at line 6" in sentences(recording) and "left out 1 single samples" in sentences(recording)


def test_infinite_and_huge_numbers_raise_no_warning_of_numpy(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for rows in ("inf,t,0\ninf,t,t\n", "inf,1,2\ninf,2,1\n", "1e308,1,2\n-1e308,2,1\n", "1,1e308,1\n2,-1e308,2\n"):
            with contextlib.suppress(tras.RecordingError):
                R.read(write(tmp_path / "a.csv", "t,q,u\n" + rows))


def test_constant_columns_are_noticed(tmp_path):
    assert "u is constant (5)" in sentences(R.read(write(tmp_path / "a.csv", table([(k, k, 5) for k in range(4)]))))


def test_trials_by_column_and_by_time_that_starts_again(tmp_path):
    rows = [(k / 10, k + 10 * run, 0, f"run {run}") for run, length in enumerate((3, 5)) for k in range(length)]
    recording = R.read(write(tmp_path / "a.csv", table(rows, "t,q,u,run")))
    assert list(recording.lengths) == [3, 5] and recording.states[1][0, 0] == 10
    assert same(R.read(tmp_path / "a.csv", {"trial": "t"})[1], R.read(tmp_path / "a.csv", {"trial": "t"})[[1]])
    assert list(R.read(tmp_path / "a.csv", {"trial": "t"}).lengths) == [3, 5]
    with pytest.raises(tras.RecordingError, match="line 5: time goes backwards"):
        R.read(tmp_path / "a.csv", {"trial": None})


def test_jitter_is_tolerated_as_said_and_resampled_only_when_asked(tmp_path):
    rng = np.random.default_rng(0)
    even = np.arange(200) * 0.01
    t = even + rng.uniform(-1, 1, 200) * 0.001
    recording = R.read(write(tmp_path / "b.csv", table(zip(t, 3 * t + 1, np.floor(t * 10)))))
    assert recording.dt == pytest.approx(0.01, rel=1e-3)
    off = re.search(r"lie up to (\S+) s \(\S+ %\) off an even grid of (\S+) s; taken as even", sentences(recording))
    assert float(off[1]) == pytest.approx(np.ptp(t - even) / 2, rel=0.01) and off[2] == "0.01"
    t = even + rng.uniform(-1, 1, 200) * 0.003
    path = write(tmp_path / "a.csv", table(zip(t, 3 * t + 1, np.floor(t * 10))))
    with pytest.raises(tras.RecordingError, match="time is uneven"):
        R.read(path)
    assert R.read(path, tolerance=0.35).dt == pytest.approx(0.01, rel=1e-2)
    recording = R.read(path, resample=0.004)
    grid = t[0] + 0.004 * np.arange(len(recording.states[0]))
    assert np.allclose(recording.states[0, :, 0], 3 * grid + 1, atol=1e-12)  # linear: exact on a line
    assert grid[-1] <= t[-1] < grid[-1] + 0.004
    held = [np.floor(t * 10)[t <= instant + 1e-12][-1] for instant in grid]
    assert np.array_equal(recording.inputs[0, :, 0], held)
    assert recording.dt == 0.004 and "linear for states, the last value held for inputs" in sentences(recording)


def test_resampling_at_the_sampling_time_changes_nothing(tmp_path):
    t = np.arange(1000) * 0.01
    path = write(tmp_path / "a.csv", table(zip(t, np.sin(t), np.arange(1000))))
    recording = R.read(path, resample=0.01)
    assert np.array_equal(recording.inputs[0, :, 0], np.arange(1000))
    assert np.allclose(recording.states[0, :, 0], np.sin(t), atol=1e-15)


@pytest.mark.parametrize("dt", [0.01, 1 / 30, 0.1, 0.002, 1 / 3, 7.0])
@pytest.mark.parametrize("digits", [None, 6])
@pytest.mark.parametrize("start", [0.0, 1234.5, 1.7e9])
def test_the_sampling_time_is_the_plain_number_behind_the_stamps(dt, digits, start):
    t = start + np.arange(500) * dt
    t = t if digits is None else np.round(t, digits)
    step, _, _ = clock.grid([t])
    if len(repr(dt)) < 6:
        assert step == dt
    # Rounding of both ends, over the whole length.
    assert abs(step - dt) <= 3 * (1e-6 * (digits is not None) + 4 * np.spacing(t[-1])) / 499 + 1e-15


# --- roles --------------------


@pytest.mark.parametrize(
    "role, words",
    [
        ("time", "t T time Time_ms timestamp t_s time_stamp"),
        ("trial", "run trial_no Episode experimentId"),
        ("states", "q q1 qd dq2 x x_3 xdot y12 theta thetaDot theta_dot PHI yaw_rate motorAngle state position_x vel"),
        ("inputs", "u u1 U_2 u_phi input3 torque motorTorque tau_1 tau_yaw pwm left_voltage cmd"),
        ("reference", "ref theta_ref u_ref setpoint Sollwert REFERENC"),
        ("beside", "index sample_no Battery"),
        (None, "phi_u torque_angle quantity uptime column1 error xray"),
    ],
)
def test_plain_names(role, words):
    assert {name: guess_role(name) for name in words.split()} == dict.fromkeys(words.split(), role)


@pytest.mark.parametrize(
    "roles, words",
    [
        ({"state": ["q"]}, "the key 'state'; it knows time, states"),
        ({"states": ["Q"]}, r"no column 'Q'.*the columns t, q, u, foo"),
        ({"states": ["fo"]}, r"no column 'fo' \(did you mean 'foo'\?\)"),
        ({"states": ["q"], "inputs": ["q"]}, "column 'q' has two roles"),
        ({"states": 3}, "states is 3; give a list"),
        ({"time": ["t"]}, "time is .'t'.; give the name of one column"),
        ({"units": ["rad"]}, "units is .*; give name: unit"),
        ({"dt": -1}, "dt is -1; give the sampling time"),
        ({"time": None}, "no column is plainly time, and no sampling time is given"),
    ],
)
def test_mistakes_in_roles_are_named(roles, words):
    with pytest.raises(tras.RecordingError, match=words):
        assign(["t", "q", "u", "foo"], roles, {})


def test_roles_of_a_yaml_file(tmp_path):
    path = write(tmp_path / "a.csv", "stamp,a,b,c\n0,1,2,3\n20,4,5,6\n")
    roles = write(
        tmp_path / "roles.yaml", "time: stamp\noutputs: [b, a]\ninputs: c\nunits: {stamp: ms, a: rad, c: N m}\n"
    )
    recording = R.read(path, roles)
    assert recording.states.tolist() == [[[2, 1], [5, 4]]] and recording.inputs.tolist() == [[[3], [6]]]
    assert recording.dt == 0.02
    assert recording.state_units == ("", "rad") and recording.input_units == ("N m",)
    for content, words in (
        ("- a", "holds no mapping"),
        ("a: [", "is not valid YAML"),
        ("!!python/object/apply:os.system [ls]", "is not valid YAML"),
    ):
        with pytest.raises(tras.RecordingError, match=words):
            R.read(path, write(roles, content))
    with pytest.raises(tras.RecordingError, match="none.yaml cannot be read"):
        R.read(path, tmp_path / "none.yaml")


def test_without_time_dt_is_given(tmp_path):
    path = write(tmp_path / "a.csv", "q,u\n1,2\n3,4\n")
    assert R.read(path, dt=0.5).dt == R.read(path, {"dt": 0.5}).dt == 0.5
    with pytest.raises(tras.RecordingError, match="dt is -1"):
        R.read(path, dt=-1)
    recording = R.read(write(tmp_path / "b.csv", table(EVEN)), dt=0.2)
    assert recording.dt == 0.2 and "0.2 s, as given; column t says 0.1 s" in sentences(recording)


# --- Parquet --------------------


def test_parquet_of_other_tools(tmp_path):
    frame = pandas.DataFrame({
        "timestamp": pandas.date_range("2026-01-01", periods=6, freq="20ms"), "run": ["a"] * 3 + ["b"] * 3,
        "theta.x": np.float32([1, 2, 3, 4, np.nan, 6]),
        "u1": pandas.array([1, 2, 3, 4, 5, 6], dtype="Int64"), "on": [True] * 6, "note": ["x"] * 6,
    }, index=[5, 4, 3, 2, 1, 0])  # fmt: skip
    frame.to_parquet(tmp_path / "a.parquet")
    recording = R.read(tmp_path / "a.parquet", {"inputs": ["u1", "on"]}, missing="cut")
    assert list(recording.lengths) == [3] and recording.dt == 0.02 and recording.states[0, :, 0].tolist() == [1, 2, 3]
    assert recording.inputs[0].tolist() == [[1, 1], [2, 1], [3, 1]] and "theta.x at row 5" in sentences(recording)
    with pytest.raises(tras.RecordingError, match="column 'note' holds (large_)?string, not numbers"):
        R.read(tmp_path / "a.parquet", {"states": ["note"]})


@pytest.mark.parametrize("metadata", [None, {b"trbs": b"{}"}])
def test_a_parquet_of_ours_that_lost_its_description_is_refused(metadata, experiment, tmp_path):
    """Its columns have plain names: guessed, it would be read with other units and nothing to check it by."""
    experiment.write(tmp_path / "a.parquet")
    table = pyarrow.parquet.read_table(tmp_path / "a.parquet").replace_schema_metadata(metadata)
    pyarrow.parquet.write_table(table, tmp_path / "b.parquet")
    for roles in (None, {"states": ["phi"], "time": "time", "trial": "trajectory"}):
        with pytest.raises(tras.RecordingError, match="has lost its own description"):
            R.read(tmp_path / "b.parquet", roles)
    pandas.read_parquet(tmp_path / "a.parquet").to_parquet(tmp_path / "c.parquet")  # another tool's file by now
    assert R.read(tmp_path / "c.parquet", {"states": ["phi"], "inputs": []}).state_names == ("phi",)


def test_parquet_units_and_nested_columns(tmp_path):
    fields = [
        pyarrow.field(name, pyarrow.float64(), metadata={"unit": unit}) for name, unit in (("t", "ms"), ("q", "rad"))
    ]
    table = pyarrow.table([[0.0, 5.0], [1.0, 2.0]], schema=pyarrow.schema(fields)).append_column(
        "x", [[[1.0], [2.0, 3.0]]]
    )
    pyarrow.parquet.write_table(table, tmp_path / "a.parquet")
    assert R.read(tmp_path / "a.parquet", {"states": "q"}).dt == 0.005
    assert R.read(tmp_path / "a.parquet", {"states": "q"}).state_units == ("rad",)
    with pytest.raises(tras.RecordingError, match="column 'x' holds list"):
        R.read(tmp_path / "a.parquet")


def test_parquet_with_a_long_row_is_refused_before_it_is_read(tmp_path, monkeypatch):
    """A row of a list, or one text that all rows share, may be larger than memory in a file of some kB."""
    table = pyarrow.table({"t": [0.0], "q": [np.zeros(10**6)], "u": [0.0]})
    pyarrow.parquet.write_table(table, tmp_path / "a.parquet")
    monkeypatch.setattr(pyarrow.parquet.ParquetFile, "read", None)  # an error if it is called
    with pytest.raises(tras.RecordingError, match="column 'q' holds list"):
        R.read(tmp_path / "a.parquet")
    monkeypatch.undo()
    for plain in (True, False):
        runs = pyarrow.array(["a" * 10**6] * 100)
        runs = runs if plain else runs.dictionary_encode()
        table = pyarrow.table({"t": np.arange(100.0), "q": np.zeros(100), "run": runs})
        pyarrow.parquet.write_table(table, tmp_path / "a.parquet")
        assert (tmp_path / "a.parquet").stat().st_size < 10**5
        tracemalloc.start()
        with pytest.raises(tras.RecordingError, match="'run' has a trial's name of 1000000 bytes; up to 1000"):
            R.read(tmp_path / "a.parquet")
        assert tracemalloc.get_traced_memory()[1] < 10**7
        tracemalloc.stop()


@pytest.mark.parametrize("runs", [["a", "a", None, "b"], [1, 1, None, 2], [True, True, None, False]])
def test_labels_of_trials_in_parquet(runs, tmp_path):
    frame = pandas.DataFrame({"t": [0, 1, 0, 1], "q": np.arange(4.0), "run": pandas.array(runs)})
    frame.to_parquet(tmp_path / "a.parquet")
    with pytest.raises(tras.RecordingError, match="row 3: the trial's column 'run' is empty"):
        R.read(tmp_path / "a.parquet")
    frame.loc[2, "run"] = runs[3]
    for write in (frame, frame.astype({"run": "category"})):
        write.to_parquet(tmp_path / "a.parquet")
        assert list(R.read(tmp_path / "a.parquet").lengths) == [2, 2]


def test_tables_that_announce_absurd_sizes_are_refused_before_room_is_made(tmp_path):
    """Both files are small: HDF5 leaves out chunks that nobody wrote, and Parquet counts equal values."""
    recording = R([np.zeros((4, 1))], None, 0.1)
    recording.write(tmp_path / "a.nc")
    with h5py.File(tmp_path / "a.nc", "a") as file:
        file.create_dataset("huge", (10**12,), "f8", chunks=(1000,)).make_scale("huge")
    with pytest.raises(tras.RecordingError, match=r"\d{13} values; up to 100000000 are read"):
        R.read(tmp_path / "a.nc")
    nulls = pyarrow.table({name: pyarrow.nulls(3 * 10**7) for name in ("t", "q", "u", "v")})
    pyarrow.parquet.write_table(nulls, tmp_path / "a.parquet")
    assert (tmp_path / "a.parquet").stat().st_size < 10**6
    with pytest.raises(tras.RecordingError, match="30000000 rows of 4 columns; up to 100000000 values are read"):
        R.read(tmp_path / "a.parquet")


# --- damage --------------------


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    suffix=st.sampled_from(sorted(FORMATS)),
    content=st.binary(max_size=200) | st.text(max_size=200).map(lambda text: text.encode("utf-8", "replace")),
)
def test_arbitrary_content_is_a_recording_or_a_sentence(suffix, content, tmp_path):
    path = write(tmp_path / f"a{suffix}", content)
    try:
        R.read(path, {"dt": 1.0} if suffix != ".nc" else None)
    except tras.RecordingError as error:
        assert str(error).startswith(str(path)) and "Error:" not in str(error).partition("Parquet")[0]


cells = st.sampled_from(["t", "q", "u", "0", "1", "2.5", "1,5", "", "nan", '"', "#", "[s]", "-3e2", " ", "inf"])


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(rows=st.lists(st.lists(cells, max_size=4), max_size=6), separator=st.sampled_from([",", ";", "\t", " "]))
def test_tables_of_anything_are_recordings_or_sentences(rows, separator, tmp_path):
    path = write(tmp_path / "a.csv", "t;q\n".replace(";", separator) + "\n".join(separator.join(row) for row in rows))
    try:
        assert R.read(path).n >= 1
    except tras.RecordingError as error:
        assert "damaged" not in str(error)  # the word for what a reader had not foreseen


@pytest.mark.parametrize("suffix", FORMATS)
def test_every_truncation_is_noticed(suffix, tmp_path):
    R(np.arange(8.0).reshape(1, 4, 2) / 3, dt=0.1).write(path := tmp_path / f"a{suffix}")
    whole = path.read_bytes()
    for length in range(0, len(whole), max(len(whole) // 40, 1)):
        if suffix == ".csv" and whole[:length].count(b"\n") > 2 and whole[length - 1 : length] == b"\n":
            continue  # a table may end after any row
        with pytest.raises(tras.RecordingError):
            R.read(write(tmp_path / f"b{suffix}", whole[:length]))


def test_headers_of_our_own_that_lie(tmp_path):
    R(np.arange(8.0).reshape(1, 4, 2), dt=0.1).write(path := tmp_path / "a.csv")
    first, rest = path.read_text().split("\n", 1)
    header = json.loads(first.removeprefix("# tras recording 2: "))
    lies = {"states": (3, ["x1", "x9"]), "dt": ("fast", -1), "attributes": ([1],), "state_units": (["rad"],)}
    lies["inputs"] = (None,)
    for key, value in ((key, value) for key, values in lies.items() for value in values):
        write(path, f"# tras recording 2: {json.dumps({**header, key: value})}\n{rest}")
        with pytest.raises(tras.RecordingError):
            R.read(path)
