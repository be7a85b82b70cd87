"""Tables in memory as recordings."""

import numpy as np
import pandas
import pytest

import tras

R = tras.Recording
FRAME = pandas.DataFrame({"t": np.arange(6) * 0.1, "q": np.arange(6.0) ** 2, "u": -np.arange(6.0)})


def test_a_recording_and_its_table(experiment):
    roles = {"states": list(experiment.state_names), "inputs": list(experiment.input_names)}
    recording = R.from_frame(experiment.to_frame(), roles)
    assert recording.state_names == experiment.state_names and recording.dt == experiment.dt
    for (x, u), (y, v) in zip(recording, experiment, strict=True):
        assert np.array_equal(x, y) and np.array_equal(u, v)
    assert "Guessed: time is column time." in tras.remarks(recording)


def test_the_table_stays_as_it_was_and_so_does_the_recording():
    frame = FRAME.copy()
    recording = R.from_frame(frame)
    frame["q"] = 7.0
    assert recording.states[0, :, 0].tolist() == [0, 1, 4, 9, 16, 25]


@pytest.mark.parametrize(
    "frame",
    [
        FRAME.set_index("t"),
        FRAME.drop(columns="t").set_axis(pandas.to_timedelta(FRAME["t"], unit="s")),
        FRAME.drop(columns="t").set_axis(pandas.date_range("2026-02-28", periods=6, freq="100ms", tz="Asia/Seoul")),
        FRAME.assign(t=pandas.date_range("2026-02-28", periods=6, freq="100ms").astype(str)),
        FRAME.astype({"q": "Int64", "u": "float32"}),
        FRAME.astype({"q": "object", "t": "object"}),
        FRAME.set_axis(list("abcdef")),
    ],
    ids=["index", "timedelta", "dates", "texts of dates", "types", "objects", "labels of rows"],
)
def test_tables_as_they_are_in_memory(frame):
    recording = R.from_frame(frame)
    assert recording.states[0, :, 0].tolist() == [0, 1, 4, 9, 16, 25] and recording.dt == 0.1
    assert recording.inputs[0, :, 0].tolist() == [0, -1, -2, -3, -4, -5]


def test_units_roles_trials_and_gaps():
    frame = FRAME.rename(columns={"q": "a", "u": "b"})
    frame["run"] = pandas.Categorical(["x"] * 3 + ["y"] * 3)
    frame.attrs["units"] = {"a": "rad", "c": 3}
    recording = R.from_frame(frame, {"states": "a", "inputs": "b", "units": {"b": "N m"}})
    assert list(recording.lengths) == [3, 3]
    assert (recording.state_units, recording.input_units) == (("rad",), ("N m",))
    frame.loc[4, "a"] = np.nan
    with pytest.raises(tras.RecordingError, match=r"the first: a at row 4 \(4\); repair"):
        R.from_frame(frame, {"states": "a", "inputs": "b"}, missing="refuse")
    assert list(R.from_frame(frame.astype({"a": "Float64"}), {"states": "a", "inputs": "b"}).lengths) == [3]
    assert R.from_frame(FRAME, resample=0.05).dt == 0.05 and R.from_frame(FRAME[["q", "u"]], dt=0.5).dt == 0.5


@pytest.mark.parametrize(
    "frame, words",
    [
        (3, "dataframe is a int; give a pandas.DataFrame"),
        (FRAME["q"], "dataframe is a Series"),
        (pandas.concat([FRAME, FRAME["q"]], axis=1), "two columns of dataframe are called 'q'"),
        (FRAME.assign(q="high"), "column 'q' holds (str|object), not numbers"),
        (FRAME.assign(q=1j), "column 'q' holds complex128, not numbers"),
        (FRAME.assign(t="noon"), "column 't' holds (str|object), which is no time"),
        (FRAME.assign(t=pandas.NaT), "column 't' holds .*, which is no time"),
        (FRAME.assign(q=[[1]] * 6), "column 'q' holds object, not numbers"),
        (FRAME.iloc[:0], "no rows of numbers"),
        (pandas.DataFrame(), "no column is plainly"),
    ],
)
def test_what_is_wrong_with_a_table_in_memory_is_one_sentence(frame, words):
    with pytest.raises(tras.RecordingError, match=words):
        R.from_frame(frame)


def test_names_that_a_recording_cannot_have_are_changed_and_said():
    frame = FRAME.assign(**{"/imu/q": FRAME["q"] + 1, "imu.q": FRAME["q"] + 2, "sample": FRAME["q"] + 3, "/": 1.0})
    roles = {"states": ["/imu/q", "imu.q", "sample"], "inputs": ["u", "/"]}
    recording = R.from_frame(frame, roles)
    assert recording.state_names == ("imu.q_", "imu.q", "sample_") and recording.input_names == ("u", "channel")
    assert recording.states[0, 0].tolist() == [1, 2, 3]
    assert "Noticed: '/imu/q' is called imu.q_." in tras.remarks(recording)


@pytest.mark.parametrize("table", [FRAME, FRAME["q"]])
def test_read_of_an_open_table_says_what_reads_it(table):
    with pytest.raises(tras.RecordingError, match=r"path is an open (DataFrame|Series).*Recording.from_frame"):
        R.read(table)


def test_the_examples_are_recordings():
    assert repr(tras.example("duffing", trials=2)).startswith("Recording: 2 trajectories of 501 samples at 0.05 s")
