"""Text tables as loggers, oscilloscopes and spreadsheets write them; what they say, and what is asked."""

import numpy as np
import pandas
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import tras

R = tras.Recording
N = 400
T = np.arange(N) * 0.02
U = np.repeat(np.random.default_rng(0).uniform(-1, 1, N // 20), 20)
Y = np.zeros(N)
for k in range(N - 1):
    Y[k + 1] = 0.95 * Y[k] + 0.05 * U[k]
ROLES = {"time": "time", "states": ["y"], "inputs": ["u"]}


def write(path, text):
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def lines(columns, form="{:.9g}", separator=","):
    return "".join(separator.join(form.format(value) for value in row) + "\n" for row in zip(*columns))


def sentences(recording):
    return " ".join(tras.remarks(recording))


def is_the_signal(recording, dt=0.02, digits=8):
    return (
        recording.dt == dt
        and np.allclose(recording.states[0][:, 0], Y, atol=10.0**-digits)
        and np.allclose(recording.inputs[0][:, 0], U, atol=10.0**-digits)
    )


BODY = lines([T, U, Y])
PLAIN = "time,u,y\n" + BODY


@pytest.mark.parametrize("suffix", [".CSV", ".txt", ".DAT", ".tsv", ".log", ".lvm"])
def test_suffixes_in_any_case(suffix, tmp_path):
    assert is_the_signal(R.read(write(tmp_path / f"log{suffix}", PLAIN.replace(",", "\t"))))


def test_other_suffixes_are_a_sentence(tmp_path):
    with pytest.raises(tras.RecordingError, match="log.npz ends in '.npz'; recordings are files of .nc, .csv"):
        R.read(tmp_path / "log.npz")


LABVIEW = "LabVIEW Measurement\nWriter_Version\t2\nSeparator\tTab\nSamples\t400\t400\n***End_of_Header***\n"
MATLAB = (
    "Time   Control Effort   Encoder 1 Pos\n\n[" + lines([T, U, Y], "{:12.9f}", "  ").replace("\n", ";\n")[:-2] + "]\n"
)
TABLES = {
    "Latin letters of Windows": ("t [s],u [µV],y [°]\n" + BODY).encode("cp1252"),
    "byte order mark": ("time,u,y\n" + BODY).encode("utf-8-sig"),
    "UTF-16": PLAIN.encode("utf-16"),
    "UTF-16 without a mark": PLAIN.encode("utf-16-le"),
    "Macintosh": PLAIN.replace("\n", "\r"),
    "blanks": "time u y\n" + lines([T, U, Y], "{:14.9f}", " "),
    "bars": "time | u | y |\n" + lines([T, U, Y], "{:.9f}", " | ").replace("\n", " |\n"),
    "trailing separators": PLAIN.replace("\n", ",,\n"),
    "decimal comma": "time;u;y\n" + BODY.replace(",", ";").replace(".", ","),
    "Fortran's exponents": "time,u,y\n" + lines([T, U, Y], "{:.12e}").replace("e", "D"),
    "a preamble": "Rig log 3\nOperator: N.N.\n\n" + PLAIN,
    "LabVIEW": LABVIEW + "X_Value\tu\ty\n" + BODY.replace(",", "\t"),
    "names and units in rows of their own": "time,u,y\ns,V,rad\n" + BODY,
    "a title above names and units": "rig,rig,rig\ntime,u,y\n[s],[V],[rad]\n" + BODY,
    "a title above the names": "rig,rig,rig\ntime,u,y\n" + BODY,
    "names in groups": ",left,\nt,torque,speed\ns,N m,rad/s\n" + BODY,
    "an index of the rows": ",time,u,y\n" + "".join(f"{k},{row}\n" for k, row in enumerate(BODY.split())),
    "a matrix as MATLAB prints it": MATLAB,
    "a comment with the names": "% time u y\n" + lines([T, U, Y], "{:.9f}", " "),
    "comments between the rows": PLAIN.replace("\n0.1,", "\n# pump on\n0.1,"),
    "the same column twice": "time,y,u,y\n" + lines([T, Y, U, Y]),
    "columns of notes beside": "time,u,y,,\n" + BODY.replace("\n", ",,\n").replace(",,\n", ',Mp,"two\nlines"\n', 2),
    "a logger's last words": PLAIN + "stopped by operator\n",
    "a German logger": "Zeit;Eingangsspannung;Winkel\n" + BODY.replace(",", ";").replace(".", ","),
    "a Spanish oscilloscope": "Tiempo ,ESTIMULO,ANGULO\n" + BODY,
    "Portuguese": "tempo,entrada,velocidade\n" + BODY,
    "French": "temps,commande,vitesse\n" + BODY,
}


@pytest.mark.parametrize("kind", TABLES)
def test_tables(kind, tmp_path):
    recording = R.read(write(tmp_path / "log.csv", TABLES[kind]))
    assert is_the_signal(recording, digits=7 if kind == "a matrix as MATLAB prints it" else 8)


def test_what_was_guessed_of_a_layout_is_said(tmp_path):
    said = sentences(R.read(write(tmp_path / "a.csv", "Rig 3\n" + TABLES["decimal comma"])))
    assert "a table with ';' between cells, a decimal comma, 1 line above the names or rows" in said
    said = sentences(R.read(write(tmp_path / "b.csv", TABLES["columns of notes beside"])))
    assert "left out: 4, 5, nearly empty" in said
    said = sentences(R.read(write(tmp_path / "c.csv", TABLES["a logger's last words"])))
    assert "left out: line 402, no numbers: 'stopped by operator'" in said
    said = sentences(R.read(write(tmp_path / "d.csv", TABLES["the same column twice"])))
    assert "left out: the second column y, the same as the first" in said
    units = R.read(write(tmp_path / "e.csv", TABLES["Latin letters of Windows"]))
    assert (units.state_units, units.input_units) == (("°",), ("µV",)) and "WINDOWS-1252" in sentences(units)


def test_a_last_line_that_breaks_off_is_left_out_and_said(tmp_path):
    recording = R.read(write(tmp_path / "a.csv", PLAIN + "8.00,0.1"))
    assert len(recording.states[0]) == N and "line 402, the last, which breaks off after 2 cells" in sentences(
        recording
    )


def test_columns_without_names_are_numbers(tmp_path):
    path = write(tmp_path / "a.dat", lines([T, U, Y], "   {:.9e}", "\t").replace("\n", "\t\n"))
    with pytest.raises(tras.RecordingError) as error:
        R.read(path)
    assert "  1  0 to 7.98 " in str(error.value) and "TIME=1 STATES=3 INPUTS=2" in str(error.value)
    recording = R.read(path, {"time": "1", "inputs": ["2"], "states": ["3"]})
    assert is_the_signal(recording) and "columns are 1, 2, 3" in sentences(recording)


def test_a_number_that_stands_twice_in_the_first_row_is_no_name(tmp_path):
    u, y = U.copy(), Y.copy()
    u[0] = y[0] = T[0]
    recording = R.read(write(tmp_path / "a.csv", lines([T, u, y])), {"time": "1", "inputs": ["2"], "states": ["3"]})
    assert np.allclose(recording.inputs[0][:, 0], u, atol=1e-8)


def test_numbers_of_columns_above_the_rows_are_asked_about(tmp_path):
    with pytest.raises(tras.RecordingError, match="its first row is 0, 1, 2: these are numbers of columns"):
        R.read(write(tmp_path / "a.csv", "0,1,2\n" + BODY))


def test_columns_may_be_called_by_number_beside_names(tmp_path):
    assert is_the_signal(R.read(write(tmp_path / "a.csv", PLAIN), {"inputs": ["2"], "states": ["3"]}))


def test_an_oscilloscope_with_its_settings_beside_the_rows(tmp_path):
    settings = 'Record Length,2.5e3,,,\nSample Interval,2e-2,,,\n"Trigger Point",1.25e3,,,\n'
    rows = (settings.replace(",,,\n", ",,,{}\n") + ",,,,{}\n" * (N - 3)).format(
        *(f"{t:.9g},{y:.9g}" for t, y in zip(T, Y))
    )
    recording = R.read(write(tmp_path / "tek.csv", rows), {"time": "5", "states": ["6"], "inputs": []})
    assert recording.dt == 0.02 and np.allclose(recording.states[0][:, 0], Y, atol=1e-8)


def test_names_and_units_of_a_scope_whose_channel_is_a_number(tmp_path):
    path = write(tmp_path / "print.csv", "x-axis,1\nsecond,Volt\n" + lines([T, Y], "{:+.9E}"))
    recording = R.read(path, {"states": ["1"], "inputs": []})
    assert recording.dt == 0.02 and recording.state_units == ("Volt",)


def test_bars_with_padded_names_and_units(tmp_path):
    rows = lines([T, U, Y, Y], " {:12.9f} ", "|")
    path = write(tmp_path / "Data.txt", "\n _real,_time | elev,yoke1 | pitch,__deg | _Vind,_kias \n" + rows)
    with pytest.raises(tras.RecordingError, match="no sampling time"):
        R.read(path, {"time": None})
    recording = R.read(path, {"states": ["pitch"], "inputs": ["elev"]})
    assert is_the_signal(recording) and recording.state_units == ("deg",)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (
            "version https://git-lfs.github.com/spec/v1\noid sha256:9b45\nsize 755523\n",
            "pointer of Git LFS.*git lfs pull",
        ),
        ("t;q\n0;1,234\n1;2,345\n2;3,456\n", "cells such as '1,234' could be thousands"),
        ("t\tq\n0\t12,345\n1\t13,456\n", "cells such as '12,345' could be thousands"),
        ("t;q;u\n0,5;1.234,5;1\n1,0;2.345,5;2\n", "line 2, column 'q': '1.234,5' is no number"),
        ("t;q;u\n0.5;1,234.5;1\n1.0;2,345.5;2\n", "'1,234.5' is no number; write it without separators of thousands"),
        ("t\tq\tu\n0.5\t1 234\t1\n1.0\t2 345\t2\n", "line 2: it has 4 cells but the header has 3"),
        ("t;q\n0,5;1\n1,0;2\n" * 2, "line 4: 't;q' stands between rows of numbers"),
        ("t,q\n0,1\n1,2,3\n2,3\n", "line 3: it has 3 cells but the header has 2"),
        ("a\nb\nc\n", "it has no rows of numbers"),
    ],
)
def test_what_is_not_plain_is_refused(content, words, tmp_path):
    with pytest.raises(tras.RecordingError, match=f"(?s){words}"):
        R.read(write(tmp_path / "log.csv", content))


def test_a_decimal_comma_that_only_a_later_row_shows(tmp_path):
    numbers = [f"{k}" for k in range(600)] + ["600,5"]
    path = write(tmp_path / "a.csv", "t;q\n" + "".join(f"{k};{number}\n" for k, number in enumerate(numbers)))
    assert R.read(path, dt=1.0).states[0][-1, 0] == 600.5


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    values=st.lists(
        st.tuples(*[st.floats(-1e9, 1e9).map(lambda v: v if abs(v) > 1e-5 else 0.25)] * 2), min_size=4, max_size=30
    ),
    separator=st.sampled_from([",", ";", "\t", "|", " "]),
    header=st.sampled_from(["", "t,q,u", "t [s],q [m],u [V]", "t,q,u\ns,m,V", "# t,q,u"]),
    preamble=st.sampled_from(["", "Rig 3\n", "\n\n", "Operator: N.N.\nDate: today\n"]),
    decimal=st.sampled_from([".", ","]),
    end=st.sampled_from(["\n", "\r\n", ";\n"]),
)
def test_the_numbers_of_any_layout_are_read_to_the_last_bit(
    values, separator, header, preamble, decimal, end, tmp_path
):
    if separator == "," and decimal == ",":
        decimal = "."
    end = end if separator == ";" or not end.startswith(";") else "\n"
    rows = [(k + 0.5, *row) for k, row in enumerate(values)]
    body = "".join(separator.join(map(repr, row)).replace(".", decimal) + end for row in rows)
    names = "".join(line.replace(",", separator) + end for line in header.split("\n") if line)
    if separator == " ":
        names = names.replace(" [", "[")
    path = write(tmp_path / "a.csv", preamble + names + body)
    roles = {"time": "1", "states": ["2"], "inputs": ["3"]}
    recording = R.read(path, roles)
    assert [tuple(row) for row in np.hstack([recording.states[0], recording.inputs[0]])] == [row[1:] for row in rows]
    assert recording.dt == 1


def test_pandas_and_we_read_the_same_numbers(tmp_path):
    frame = pandas.DataFrame(
        {"t": T, "q": np.random.default_rng(1).normal(size=N) * 10.0 ** np.arange(-N // 2, N // 2)}
    )
    frame.to_csv(tmp_path / "a.csv", index=False)
    assert np.array_equal(R.read(tmp_path / "a.csv").states[0][:, 0], frame["q"])


def test_groups_of_names(tmp_path):
    rows = lines([T, U, Y, U, Y])
    path = write(tmp_path / "a.csv", "rig,left,,right,\nt,torque,speed,torque,speed\n" + rows)
    recording = R.read(path)
    assert recording.state_names == ("left speed", "right speed") and recording.dt == 0.02
