"""Time by its values, roles by names and values, and the one question where these are not plain."""

import re
import shlex

import numpy as np
import pandas as pd
import pytest

import tras
from tras.io import clock, evidence
from tras.io.roles import Question, assign
from tras.io.words import guess_role

R = tras.Recording
N = 400
K = np.arange(N)
U = np.repeat(np.random.default_rng(0).uniform(-1, 1, N // 20), 20)
Y = np.zeros(N)
for k in range(N - 1):
    Y[k + 1] = 0.95 * Y[k] + 0.05 * U[k]


def log(path, **columns):
    pd.DataFrame(columns).to_csv(path, index=False)
    return path


def sentences(recording):
    return " ".join(tras.remarks(recording))


# --- time --------------------


@pytest.mark.parametrize(
    "name",
    "Tiempo temps tempo Zeit czas ts t_s Time_(s) time_sec stamp timestamp x-axis Second secs sample_time Elapsed_Time "
    "X sec epoch rostime Time_s_ %time .header.stamp.secs foo column7 Uhrzeit".split(),
)
def test_a_column_that_rises_evenly_is_the_time(name, tmp_path):
    recording = R.read(log(tmp_path / "a.csv", **{name.replace("_", " "): K * 0.02, "u": U, "y": Y}))
    assert (recording.dt, recording.state_names, recording.input_names) == (0.02, ("y",), ("u",))
    assert "time is column" in sentences(recording)


@pytest.mark.parametrize(
    ("name", "stamps", "dt", "why"),
    [
        ("Time", K * 20, 0.02, "steps by 20: milliseconds"),
        ("time", np.round(K * 12.5), 0.0125, "steps by 13: milliseconds"),
        ("timestamp", 10**8 + K * 20_000, 0.02, "steps by 20 000: microseconds"),
        ("timestamp", 17 * 10**17 + K * 10_000_000, 0.01, "steps by 10 000 000: nanoseconds"),
        ("timestamp", 17 * 10**14 + K * 100, 0.0001, "have 16 digits: microseconds"),
        ("timestamp", 17 * 10**8 + K * 60, 60, "have 10 digits: seconds"),
        ("t [us]", K * 500, 0.0005, None),
        ("Time_ms", K * 5, 0.005, None),
        ("t", K, 1, None),
        ("t", K * 2.5, 2.5, None),
    ],
)
def test_the_unit_of_stamps(name, stamps, dt, why, tmp_path):
    recording = R.read(log(tmp_path / "a.csv", **{name: stamps, "u": U, "y": Y}))
    assert recording.dt == dt
    assert (why in sentences(recording)) if why else ("because" not in sentences(recording))


def test_a_unit_that_is_given_is_not_guessed(tmp_path):
    path = log(tmp_path / "a.csv", t=K * 20, u=U, y=Y)
    assert R.read(path, {"units": {"t": "s"}}).dt == 20
    with pytest.raises(tras.RecordingError, match="has the unit 'rpm'; give one of s"):
        R.read(path, {"units": {"t": "rpm"}})


@pytest.mark.parametrize("rows", ["first", "all"])
@pytest.mark.parametrize(("name", "value"), [("Ts", 0.02), ("fs", 50), ("dt [s]", 0.02), ("sampling_rate", 50)])
def test_the_sampling_time_as_a_column(rows, name, value, tmp_path):
    column = np.where(K == 0, value, np.nan) if rows == "first" else np.full(N, value)
    recording = R.read(log(tmp_path / "a.csv", uEst=U, yEst=Y, **{name: column}))
    assert recording.dt == 0.02 and "the sampling time is 0.02 s, by column" in sentences(recording)
    assert recording.state_names == ("yEst",)


def test_two_sampling_times_are_an_error(tmp_path):
    with pytest.raises(tras.RecordingError, match="the sampling times in it are 0.02 and 0.01 s"):
        R.read(log(tmp_path / "a.csv", u=U, y=Y, Ts=np.full(N, 0.02), fs=np.full(N, 100)))
    with pytest.raises(tras.RecordingError, match="states a sampling time of 0.05 s, but column 't' says 0.02 s"):
        R.read(log(tmp_path / "a.csv", t=K * 0.02, u=U, y=Y, Ts=np.full(N, 0.05)))


@pytest.mark.parametrize(("dt", "place"), [(0.005, 2), (0.0125, 2), (1 / 30, 2), (0.0221354, 3)])
def test_rounded_stamps_are_an_even_grid(dt, place, tmp_path):
    recording = R.read(log(tmp_path / "a.csv", t=np.round(K * dt, place), u=U, y=Y))
    assert recording.dt == pytest.approx(dt, rel=2e-4)
    assert f"because they are rounded to {10.0**-place:g} s; taken as even" in sentences(recording)


@pytest.mark.parametrize("lost", [1, 100, 390])
def test_lost_samples_are_no_jitter(lost, tmp_path):
    """However finely the stamps are rounded: the grid that fits best lies far off, or a step is longer than all."""
    kept = K != lost
    for place in (1, 2, 3):
        with pytest.raises(tras.RecordingError, match="time is uneven"):
            R.read(log(tmp_path / "a.csv", t=np.round(K * 0.1, place)[kept], u=U[kept], y=Y[kept]))


def test_dt_always_wins(tmp_path):
    for stamps in (np.round(K * 0.005, 2), np.sort(np.random.default_rng(0).uniform(0, 2, N)), K * 20.0):
        recording = R.read(log(tmp_path / "a.csv", time=stamps, u=U, y=Y), dt=0.005)
        assert recording.dt == 0.005 and recording.state_names == ("y",)
    assert "the sampling time is 0.005 s, as given; column time says 0.02 s" in sentences(recording)


def test_dates_and_clocks(tmp_path):
    stamps = pd.Timestamp("2026-02-28 23:59:58") + pd.to_timedelta(K * 0.02, unit="s")
    assert R.read(log(tmp_path / "a.csv", stamp=stamps, u=U, y=Y)).dt == 0.02
    clocks = [f"11:59:{58 + 0.02 * k:05.2f}" if k < 100 else f"12:00:{0.02 * (k - 100):05.2f}" for k in K]
    assert R.read(log(tmp_path / "b.csv", Time=clocks, u=U, y=Y)).dt == 0.02
    german = [
        f"28.02.2026 23:59:{58 + 0.02 * k:05.2f}" if k < 100 else f"01.03.2026 00:00:{0.02 * k - 2:05.2f}" for k in K
    ]
    assert R.read(log(tmp_path / "d.csv", Zeit=german, u=U, y=Y)).dt == 0.02
    assert R.read(log(tmp_path / "e.csv", time=[f"01:{0.02 * k:06.3f}" for k in K], u=U, y=Y)).dt == 0.02
    with pytest.raises(
        tras.RecordingError, match="line 2, column 'time': '2/28/2026 1:00 PM' is no number; an instant is"
    ):
        R.read(log(tmp_path / "f.csv", time=["2/28/2026 1:00 PM"] * N, u=U, y=Y))
    days = pd.Timestamp("2026-02-01") + pd.to_timedelta(K, unit="D")
    assert R.read(log(tmp_path / "c.csv", time=days, u=U, y=Y)).dt == 86400  # no guess of milliseconds


def test_of_two_times_the_finer_one(tmp_path):
    path = log(tmp_path / "a.csv", **{"time": K * 0.02, "stamp.secs": np.floor(K * 0.02), "T": Y, "u": U, "y": Y})
    assert R.read(path, {"states": ["y"], "inputs": ["u"]}).dt == 0.02


def test_a_column_that_counts_the_rows_is_no_time(tmp_path):
    with pytest.raises(tras.RecordingError, match="(?s)no column is plainly time.*Sample +0 to 399 +left out.* DT=1\n"):
        R.read(log(tmp_path / "a.csv", Sample=K, u=U, y=Y))


@pytest.mark.parametrize("step", [0.01, 1 / 30, 1e-6, 7.0])
def test_the_grid_is_that_of_least_squares(step):
    rng = np.random.default_rng(3)
    times = [start + np.arange(n) * step + rng.normal(0, 0.03 * step, n) for start, n in ((0, 40), (1e4 * step, 90))]
    found, deviation, quantum = clock.grid(times)
    design = np.zeros((130, 3))
    design[:40, 0] = design[40:, 1] = 1
    design[:, 2] = np.r_[np.arange(40), np.arange(90)]
    slope = np.linalg.lstsq(design, np.concatenate(times), rcond=None)[0][2]
    assert found == pytest.approx(slope, rel=0.01) and quantum == 0
    assert (
        deviation
        <= 1.5 * np.abs(np.concatenate(times) - design @ np.linalg.lstsq(design, np.concatenate(times))[0]).max()
    )


# --- roles --------------------


@pytest.mark.parametrize(
    ("role", "names"),
    [
        ("inputs", "Entrada ESTIMULO Motorspannung Eingangsspannung Stellgröße commande voltaje u_yaw pwm_left cmd_vel "
         "actuator_outputs.output[0] Pitch_Control V_IN heater"),
        ("states", "ANGULO POSICION VELOCIDA Geschwindigkeit Drehzahl vitesse saída Motor_Rev_A attitude.pitch"),
        ("reference", "Sollgeschwindigkeit REFERENC consigna vehicle_attitude_setpoint.pitch Commanded_Pos"),
        ("time", "Tiempo Zeit .header.stamp.secs"),
        ("beside", "Battery sample frame_id"),
    ],
)  # fmt: skip
def test_names_of_other_languages_and_tools(role, names):
    assert {name: guess_role(name.replace("_", " ")) for name in names.split()} == dict.fromkeys(names.split(), role)


def test_names_beside_each_other():
    motors = ["m1", "m2", "m3", "m4"]
    assert guess_role("m1", motors) == "inputs" and guess_role("m1", ["m1"]) is None
    # Simulink's label of two signals in one: its order need not be that of the columns, the values tell.
    assert guess_role("Pitch Angle & Reference1") is None and guess_role("Pitch Angle & Reference2") is None
    roles, guesses = assign(["t", "pitch", "v", *motors], None, {}, values={"t": K * 0.02}.get)
    assert roles.inputs == motors and roles.states == ["pitch"] and "left out: v" in guesses[-1]


def question(path, roles=None, **options):
    """(sentence, roles that the question proposes) of a file."""
    with pytest.raises(tras.RecordingError) as error:
        R.read(path, roles, **options)
    return str(error.value), eval(str(error.value).partition("In Python, roles=")[2].partition("\n")[0])  # noqa: S307


def test_left_over_columns_without_an_input_are_a_question(tmp_path):
    path = log(tmp_path / "my log.csv", t=K * 0.02, angle=Y, foo=U, ref=np.sign(U))
    words, proposed = question(path)
    assert words.startswith(f"{path}: no column is plainly an input. Which are states and inputs? A guess:\n")
    assert re.search(
        r"\n  1  t +0 to 7.98 +time\n  2  angle +\S+ to \S+ +state \(name\)\n  3  foo .* input\? \(held", words
    )
    command = next(line for line in words.split("\n") if "make identify" in line)
    assert shlex.split(command)[2:] == [f"RECORDING={path}", "TIME=t", "STATES=angle", "INPUTS=foo"]
    assert len(words.split("\n")) < 25
    recording = R.read(path, proposed)
    assert (recording.state_names, recording.input_names, recording.dt) == (("angle",), ("foo",), 0.02)
    assert R.read(path, {"inputs": []}).m == 0
    assert R.read(log(tmp_path / "b.csv", t=K * 0.02, angle=Y)).m == 0  # nothing is left over


def test_what_was_said_already_is_not_asked_again(tmp_path):
    path = log(tmp_path / "a.csv", stamp=K * 0.02, foo=Y, bar=U)
    assert question(path, {"states": ["foo"]})[1] == {"time": "stamp", "states": ["foo"], "inputs": ["bar"]}
    assert "no column is plainly an input" not in question(path, {"inputs": ["bar"]})[0]
    assert R.read(path, {"states": ["foo"], "inputs": ["bar"]}).dt == 0.02


def test_without_time_the_command_has_a_place_for_it(tmp_path):
    words, proposed = question(log(tmp_path / "a.csv", y=Y, u=U))
    assert "TIME=none STATES=y INPUTS=u DT=1\n" in words and "put your sampling time in s in its place" in words
    assert proposed == {"time": None, "states": ["y"], "inputs": ["u"], "dt": 1.0}


def test_a_state_by_name_that_is_held_like_an_input_is_doubted(tmp_path):
    words, proposed = question(log(tmp_path / "a.csv", t=K * 0.02, yaw=Y, pitch=U))
    assert "pitch would be a state by name, but jumps and stays like an input" in words
    assert proposed["states"] == ["yaw"] and proposed["inputs"] == ["pitch"]


def test_a_hundred_columns_fit_on_a_screen(tmp_path):
    columns = {f"c{k}": np.random.default_rng(k).normal(size=N).cumsum() for k in range(100)}
    words, _ = question(log(tmp_path / "a.csv", t=K * 0.02, **columns, y=Y))
    assert len(words.split("\n")) < 40 and "and 74 more" in words and "  102  y " in words


def test_the_two_columns_of_a_closed_loop(tmp_path):
    """A reference that the state follows is not taken for the input while another column can be it."""
    r, y, u = np.repeat([0.0, 1.0, -1.0, 0.5], N // 4), np.zeros(N), np.zeros(N)
    for k in range(N - 1):
        u[k] = 4 * (r[k] - y[k]) + np.random.default_rng(k).normal(0, 0.3)
        y[k + 1] = 0.9 * y[k] + 0.09 * u[k]
    guesses = evidence.guesses({"a": y, "b": r, "c": u}, set(), [], has_inputs=False)
    assert {name: guess for name, (guess, _) in guesses.items()} == {"a": "state", "b": "reference", "c": "input"}


def test_ambiguous_names_are_asked():
    with pytest.raises(Question, match="t and time could each be the column of time"):
        assign(["t", "time", "q"], None, {})
    with pytest.raises(Question, match="run and trial could each be the column of trial"):
        assign(["t", "q", "run", "trial"], None, {})
