"""Several files, a test of one's own, parts of a recording."""

import numpy as np
import pandas as pd
import pytest

import tras
from tras.identification.preparation import partition

R = tras.Recording
N = 300
T = np.arange(N) * 0.02
Q, U = np.sin(T), np.repeat(np.random.default_rng(0).uniform(-1, 1, N // 20), 20)


def log(path, **columns):
    pd.DataFrame(columns).to_csv(path, index=False)
    return path


def sentences(recording):
    return " ".join(tras.remarks(recording))


@pytest.fixture
def runs(tmp_path):
    return [log(tmp_path / f"run{i}.csv", t=T + i, q=Q + i, u=U) for i in range(3)]


def test_files_with_the_same_columns_are_trials(runs, tmp_path):
    recording = R.read(runs)
    assert len(recording) == 3 and recording.dt == 0.02
    assert all(np.allclose(x[:, 0], Q + i) for i, (x, _) in enumerate(recording))
    assert "3 files are trials of one recording" in sentences(recording)
    log(runs[1], q=Q + 1, u=U, t=T)  # in another order
    assert np.allclose(R.read(runs).states[1][:, 0], Q + 1)
    runs[2].write_text(runs[2].read_text().replace("2.14,", "abc,"))
    with pytest.raises(tras.RecordingError, match="run2.csv, line 9, column 't': 'abc' is no number"):
        R.read(runs)


def test_errors_name_the_file(runs):
    log(runs[1], t=T[::-1], q=Q, u=U)
    with pytest.raises(tras.RecordingError, match="run1.csv, line 3: time goes backwards"):
        R.read(runs)
    log(runs[1], t=T, q=Q, v=U, w=U)
    with pytest.raises(tras.RecordingError, match="different columns: run0.csv has t, q, u; run1.csv has t, q, v, w"):
        R.read(runs)
    with pytest.raises(FileNotFoundError, match="gone.csv"):
        R.read([*runs, runs[0].with_name("gone.csv")])


def test_one_signal_a_file_is_merged_by_time(tmp_path):
    late = np.arange(10, 2 * N) * 0.01
    paths = [
        log(tmp_path / "theta.csv", t=T, value=Q), log(tmp_path / "torque.csv", Time=late * 1000, value=3 * late),
    ]  # fmt: skip
    recording = R.read(paths, {"states": ["theta"], "inputs": ["torque"]})
    kept = (T >= 0.1) & (T <= late[-1])
    assert recording.dt == 0.02 and np.allclose(recording.states[0][:, 0], Q[kept])
    assert np.allclose(recording.inputs[0][:, 0], 3 * T[kept])
    assert "signals of one recording, merged by time" in sentences(recording)
    log(paths[1], Time=late + 100, value=late)
    with pytest.raises(tras.RecordingError, match="no time in common"):
        R.read(paths, {"states": ["theta"], "inputs": ["torque"]})


def test_merging_holds_inputs_and_joins_states(tmp_path):
    slow = np.arange(0, 6, 0.1)
    paths = [log(tmp_path / "a.csv", t=T, q=Q), log(tmp_path / "b.csv", t=slow, u=np.arange(60.0), p=2 * slow)]
    recording = R.read(paths, {"states": ["q", "p"], "inputs": ["u"]})
    kept = T <= slow[-1]
    assert np.allclose(recording.states[0][:, 1], 2 * T[kept])
    assert np.array_equal(recording.inputs[0][:, 0], np.floor(T[kept] / 0.1 + 1e-9))


def test_a_file_for_the_test(runs):
    recording = R.read(runs[:2], test=runs[2])
    assert len(recording) == 3 and recording.attributes["test_trajectories"] == [2]
    assert "the test is run2.csv" in sentences(recording)
    train, test, remark = partition(recording)
    assert [len(train), len(test)] == [2, 1] and np.array_equal(test.states[0], recording.states[2])
    assert "1 of 3 trajectories are kept for the test, as the user or the file says" in remark
    with pytest.raises(tras.RecordingError, match="different columns"):
        R.read(runs[0], test=log(runs[1], t=T, q=Q, v=U))


def test_trials_for_the_test(runs):
    assert R.read(runs, test=[1, 3]).attributes["test_trajectories"] == [0, 2]
    assert R.read(runs, test=2).attributes["test_trajectories"] == [1]
    with pytest.raises(tras.RecordingError, match="test names trial 4; there are 3, counted from 1"):
        R.read(runs, test=4)
    with pytest.raises(ValueError, match="leave some to learn from"):
        partition(R.read(runs, test=[1, 2, 3]))


def test_a_trial_that_is_cut_stays_in_the_test_as_a_whole(runs):
    log(runs[1], t=T, q=np.where(np.arange(N) == 100, np.nan, Q), u=U)
    recording = R.read(runs, test=2)
    assert len(recording) == 4 and recording.attributes["test_trajectories"] == [1, 2]


def test_numbers_of_the_test_follow_their_trajectories(runs):
    recording = R.read(runs, test=2)
    assert recording[[2, 1]].attributes["test_trajectories"] == [1]
    assert "test_trajectories" not in recording[[0, 2]].attributes
    assert recording.cut(50).attributes["test_trajectories"] == [6, 7, 8, 9, 10, 11]  # six pieces of each
    assert recording.select(states=["q"]).attributes["test_trajectories"] == [1]
    joined = tras.recording.join([recording, recording])
    assert joined.attributes["test_trajectories"] == [1, 4] and recording.attributes["test_trajectories"] == [1]


def test_recordings_of_ours_join_too(runs, tmp_path):
    for i in range(2):
        R.read(runs[i]).write(tmp_path / f"a{i}.nc")
    recording = R.read([tmp_path / "a0.nc"], test=tmp_path / "a1.nc")
    assert len(recording) == 2 and recording.attributes["test_trajectories"] == [1]
    recording.write(tmp_path / "both.nc")
    assert R.read(tmp_path / "both.nc").attributes["test_trajectories"] == [1]


def test_a_part_of_every_trial(runs):
    recording = R.read(runs, start=1, end=2)
    assert all(np.allclose(x[:, 0], Q[50:101] + i) for i, (x, _) in enumerate(recording)) and recording.dt == 0.02
    with pytest.raises(tras.RecordingError, match="nothing lies between start and end"):
        R.read(runs, start=100)
    for wrong in ({"start": -1}, {"end": 0}, {"start": 2, "end": 1}, {"decimate": 0}, {"decimate": 1.5}):
        with pytest.raises(tras.RecordingError, match=f"{list(wrong)[-1]} is "):
            R.read(runs, **wrong)
    roles = {"time": None, "states": ["q"], "inputs": ["u"], "dt": 0.5}
    assert np.allclose(R.read(runs[0], roles, start=1, end=2).states[0][:, 0], Q[2:5])


def test_decimation_keeps_the_work_of_the_inputs(runs):
    u = np.random.default_rng(1).normal(size=N)
    recording = R.read(log(runs[0], t=T, q=Q, u=u), decimate=4)
    assert recording.dt == 0.08 and np.allclose(recording.states[0][:, 0], Q[::4])
    assert np.allclose(recording.inputs[0][:, 0], u.reshape(-1, 4).mean(axis=1))
    assert "of every 4 samples of the states the first is kept, of the inputs the mean" in sentences(recording)
    with pytest.raises(tras.RecordingError, match="more than a trajectory has samples"):
        R.read(runs[0], decimate=1000)


def test_odd_first_samples_and_rests_are_named(runs):
    q = np.r_[np.zeros(60), Q[:-60]]
    log(runs[0], t=T, q=np.r_[9.0, q[1:]], u=np.r_[np.zeros(60), U[60:]])
    assert "the first sample of q, 9 at line 2, lies far from the next, 0" in sentences(R.read(runs[0]))
    log(runs[0], t=T, q=q, u=np.r_[np.zeros(60), U[60:]])
    assert "nothing moves in the first 1.2 s (60 samples" in sentences(R.read(runs[0]))


@pytest.fixture
def drives(tmp_path):
    """Three experiments of one drive side by side, without time."""
    rng, columns = np.random.default_rng(0), {}
    for i in (1, 2, 3):
        u = rng.normal(size=N)
        columns |= {f"z{i}": np.convolve(u, 0.9 ** np.arange(N))[:N], f"u{i}": u}
    return log(tmp_path / "drive.csv", **columns)


def test_experiments_side_by_side_are_asked_about_and_read_as_trials(drives):
    with pytest.raises(tras.RecordingError) as error:
        R.read(drives)
    assert "z1 with u1, z2 with u2, z3 with u3 may be experiments side by side" in str(error.value)
    assert "STATES='z1;z2;z3' INPUTS='u1;u2;u3' DT=1\n" in str(error.value)
    recording = R.read(drives, {"states": ["z1;z2;z3"], "inputs": ["u1;u2;u3"]}, dt=0.02, test=3)
    table = pd.read_csv(drives)
    assert (recording.state_names, recording.input_names, recording.dt, len(recording)) == (("z",), ("u",), 0.02, 3)
    assert all(np.array_equal(x[:, 0], table[f"z{i}"]) for i, (x, _) in enumerate(recording, 1))
    assert all(np.array_equal(u[:, 0], table[f"u{i}"]) for i, (_, u) in enumerate(recording, 1))
    assert recording.attributes["test_trajectories"] == [2] and "3 experiments stand side by side" in sentences(
        recording
    )
    assert R.read(drives, {"states": ["1;3"], "inputs": ["2;4"]}, dt=1.0).state_names == ("z",)
    for states, words in ((["z1;z2"], "as many columns in each channel"), (["z1;z2;w"], "there is no column 'w'")):
        with pytest.raises(tras.RecordingError, match=words):
            R.read(drives, {"states": states, "inputs": ["u1;u2;u3"]}, dt=1.0)


def test_channels_that_act_on_each_other_are_one_system(tmp_path):
    u = np.random.default_rng(0).normal(size=(2, N))
    z = [np.convolve(part, 0.9 ** np.arange(N))[:N] for part in u]
    path = log(tmp_path / "a.csv", q1=z[0], q2=z[1] + np.roll(z[0], 3), u1=u[0], u2=u[1])
    with pytest.raises(tras.RecordingError, match="STATES=q1,q2 INPUTS=u1,u2"):
        R.read(path)
    assert R.read(path, dt=0.1).n == 2


def test_a_shared_time_of_experiments_side_by_side(drives):
    table = pd.read_csv(drives).assign(t=T)
    roles = {"time": "t", "states": ["z1;z2;z3"], "inputs": ["u1;u2;u3"]}
    assert R.read(log(drives, **table), roles).dt == 0.02


def test_repetitions_side_by_side(tmp_path):
    u = np.sign(np.random.default_rng(0).normal(size=N))
    rough = np.random.default_rng(1).normal(size=(2, N)) / 50
    z = np.convolve(np.abs(u), 0.9 ** np.arange(N))[:N]
    with pytest.raises(tras.RecordingError, match="STATES='z1;z2' INPUTS='u1;u2'"):
        R.read(log(tmp_path / "a.csv", z1=z + rough[0], z2=2 * z + rough[1], u1=u, u2=2 * u))
