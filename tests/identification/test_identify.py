"""Identification of rigs of which nothing is known: checks, preparation, search, advice, files."""

import numpy as np
import pandas as pd
import pytest

import tras
from tras.identification import advice, checks, preparation, search
from tras.identification import folder as identify_files
from tras.identification.examples import cart_pole, duffing, example
from tras.identification.scores import compare, growth, typical_and_worst

R = tras.Recording
T = np.arange(2000) * 0.01


def one(states, inputs=None, dt=0.01, **labels):
    states = np.column_stack(states)
    return R([states], None if inputs is None else [np.column_stack(inputs)], dt, **labels)


def row(recording, name):
    return checks.channels(recording).set_index("channel").loc[name]


@pytest.fixture(scope="module")
def log():
    return example("duffing", trials=6)


@pytest.fixture(scope="module")
def identification(log):
    return tras.identify(log, predictor="one_step", delays=[0, 1], draws=5)


# --- examples ---


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "energy"), [("duffing", lambda q, v: v**2 / 2 + q**2 / 2 + q**4 / 2), ("cart_pole", None)]
)
def test_examples_obey_mechanics(name, energy):
    """Power put in less power lost is the rise of the energy, from the exact states."""
    r = example(name, trials=1, duration=20.0, noise=0)
    x, u = r.states[0], r.inputs[0][:, 0]
    if energy:
        E, speed, lost = energy(*x.T), x[:, 1], 0.4 * x[:, 1] ** 2
    else:
        s, v, theta, w = x.T
        E = 0.65 * v**2 + 0.15 * v * w * np.cos(theta) + 0.0375 * w**2 - 0.3 * 9.81 * 0.5 * np.cos(theta) + 2 * s**2
        speed, lost = v, 0.8 * v**2 + 0.02 * w**2
    middle = lambda a: (a[1:] + a[:-1]) / 2  # noqa: E731
    change = np.cumsum(u[:-1] * middle(speed) - middle(lost)) * r.dt
    assert np.abs(E[1:] - E[0] - change).max() < 0.01 * np.ptp(E)


def test_fields_are_batched_and_sensors_have_steps():
    points = np.random.default_rng(0).normal(size=(3, 5))
    assert np.allclose(duffing(points)[:, 2], duffing(points[:, 2:3])[:, 0]) and cart_pole(np.ones((5, 4))).shape == (
        4,
        4,
    )
    q = example("duffing", trials=1).states[0][:, 0]
    assert (
        np.allclose(q / 0.0005, np.round(q / 0.0005))
        and 0.0005 < tras.noise_level(example("duffing", trials=1))[0] < 0.002
    )
    with pytest.raises(ValueError, match="choose one of duffing, cart_pole"):
        example("pendulum")


# --- checks ---


def test_limits_are_told_from_extremes():
    wave = np.sin(3 * T + 0.001)
    at = {
        "free": wave, "clipped": np.clip(wave, -0.8, 2), "coarse": np.round(wave, 1), "switch": np.sign(wave),
        "very coarse": np.round(wave * 400) / 400, "at rest once": np.where(T < 15, np.abs(wave), 0),
        "levels": np.repeat(np.random.default_rng(0).uniform(-1, 1, 40), 50),
    }  # fmt: skip
    recording = one([T], list(at.values()), state_names=["q"], input_names=list(at))
    table = checks.channels(recording).set_index("channel")
    assert (
        table.loc["clipped", "at_lowest"] == pytest.approx(np.mean(wave <= -0.8))
        and table.loc["clipped", "at_highest"] == 0
    )
    assert (
        (
            table.loc[
                ["free", "coarse", "very coarse", "switch", "at rest once", "levels"], ["at_lowest", "at_highest"]
            ]
            == 0
        )
        .all()
        .all()
    )
    assert (
        table.loc["coarse", "step"] == pytest.approx(0.1)
        and table.loc["free", "step"] == 0
        and table.loc["switch", "levels"] == 2
    )


def test_noise_wraps_and_shift():
    rng = np.random.default_rng(0)
    angle = 2 * np.pi * T / 5 + 0.3 * np.sin(T)
    for turn, values in ((360, np.degrees(angle)), (2 * np.pi, angle)):
        assert row(one([np.mod(values, turn)], state_names=["a"]), "a")["wraps"] == (values.max() // turn)
        assert row(one([values], state_names=["a"]), "a")["wraps"] == 0
    assert row(one([360 * np.sign(np.sin(60 * T))], state_names=["a"]), "a")["wraps"] == 0
    noisy = np.sin(T) + 0.05 * rng.standard_normal(len(T))
    assert row(one([noisy], state_names=["a"]), "a")["noise"] == pytest.approx(0.05 / np.ptp(noisy), rel=0.1)
    assert (
        row(one([np.sin(20 * T) + 0.1 * T], state_names=["a"]), "a")["shift"]
        > 1
        > row(one([np.sin(20 * T)], state_names=["a"]), "a")["shift"]
    )
    two = R([np.zeros((50, 1)) + 0.01 * rng.normal(size=(50, 1)), np.ones((50, 1))], None, 0.1)
    assert row(two, "x1")["jump"] < 0.1  # from one trajectory to the next is no jump


def test_feedback_is_told_from_a_signal_of_its_own():
    rng = np.random.default_rng(1)
    x = np.cumsum(rng.normal(size=(2000, 2)), axis=0)
    own = rng.normal(size=2000)
    loop = x @ [2.0, -0.5] + 0.1 * np.std(x @ [2.0, -0.5]) * rng.normal(size=2000) + 7
    shares = checks.feedback(R([x], [np.column_stack([own, loop])], 0.1))
    assert shares["u1"] < 0.02 and shares["u2"] == pytest.approx(1 / 1.01, abs=0.003)


@pytest.mark.parametrize("lines", [1, 2, 3])
def test_a_multisine_excites_twice_as_deep_as_it_has_lines(lines):
    """J. C. Willems et al. (2005): each sinusoid adds two to the order."""
    u = sum(np.sin((1.0 + 0.7 * k) * T + k) for k in range(lines))
    recording = one([T], [u + 5])  # an offset excites nothing
    assert checks.excitation_order(recording, lag=40) == 2 * lines
    white = np.random.default_rng(0).normal(size=(2000, 2))
    assert checks.excitation_order(R([white], [white], 0.01)) == 20
    assert checks.excitation_order(one([T])) is None


def test_spectrum_and_rank():
    recording = one([np.sin(2 * np.pi * 5 * T)], [np.sin(2 * np.pi * 2 * T) + 3])
    table = checks.spectrum(recording)
    assert table["frequency"][table["x1"].argmax()] == pytest.approx(5, abs=0.1) and table["frequency"][
        table["u1"].argmax()
    ] == pytest.approx(2, abs=0.1)
    assert np.trapezoid(table["x1"], table["frequency"]) == pytest.approx(1, abs=0.02)
    facts = checks.check(recording).facts
    assert facts["rank"] == facts["channels"] == 3 and facts["condition"] < 5
    assert checks.check(one([np.sin(T), np.sin(T) + 1e-6 * np.cos(9 * T)])).facts["rank"] == 2
    assert len(checks.spectrum(R([np.ones((5, 1))], None, 1.0))) == 0


def test_beyond():
    train, test = one([np.linspace(0, 1, 11)]), one([np.linspace(0.5, 1.5, 11)])
    assert checks.beyond(train, test) == {"x1": pytest.approx(5 / 11)}


# --- preparation ---


def test_idle_channels_are_left_out_and_said():
    rng = np.random.default_rng(0)
    x = rng.normal(size=(200, 2))
    states = np.column_stack([x[:, 0], np.full(200, 3.5), np.degrees(x[:, 0]) + 1, x[:, 1]])
    inputs = np.column_stack([x @ [1, 2], rng.normal(size=200), np.zeros(200)])
    used, remarks = preparation.without_idle_channels(
        R([states], [inputs], 0.1, state_names=["a", "still", "a_deg", "b"], input_names=["fed", "free", "off"])
    )
    assert used.state_names == ("a", "b") and used.input_names == ("free",)
    assert remarks == [
        "still is constant (3.5) and was left out",
        "a_deg is a linear combination of a at every sample and was left out",
        "fed is a linear combination of a and b at every sample and was left out",
        "off is constant (0) and was left out",
    ]
    with pytest.raises(ValueError, match="no state moves: x1 is constant"):
        preparation.without_idle_channels(one([np.ones(10)], [T[:10]]))


def paired(recording):
    return preparation.velocity_pairs(recording, preparation.memory(recording))


def window_length(recording):
    return preparation.window_length(recording, preparation.memory(recording))


@pytest.mark.slow
def test_velocities_are_known_by_their_numbers():
    r = example("cart_pole", trials=2)
    shuffled = r.select(states=["thetadot", "position", "theta", "velocity"])
    assert paired(shuffled) == [("position", "velocity"), ("theta", "thetadot")]
    degrees = R([x * [1, 1, 57.3, 1] for x, _ in shuffled], [u for _, u in shuffled], r.dt)
    assert paired(degrees) == [("x2", "x4")]  # degrees and rad/s do not fit
    assert paired(r.select(states=["position"])) == []


def test_memory_and_windows():
    rng = np.random.default_rng(0)
    x = np.zeros(20_000)
    for k in range(1, len(x)):
        x[k] = 0.95 * x[k - 1] + rng.normal()
    recording = one([x])
    assert preparation.memory(recording) == pytest.approx(1 / -np.log(0.95), rel=0.2)
    samples, why = window_length(recording)
    assert samples == 5 * preparation.memory(recording) + 1 and "five times" in why
    assert window_length(one([x[:200]]))[0] == 26
    assert window_length(one([np.cumsum(np.cumsum(x))]))[0] == 501
    assert window_length(one([x[:20]]))[0] == 20


@pytest.mark.parametrize("lengths", [[500], [300, 200], [60] * 8])
def test_the_test_is_apart_from_the_training(lengths):
    states = [np.arange(k)[:, None] + 1000.0 * i for i, k in enumerate(lengths)]
    train, test, _ = preparation.partition(R(states, None, 0.1))
    seen, kept = (set(np.concatenate([x for x, _ in part])[:, 0]) for part in (train, test))
    pairs = {(a, a + 1) for part in (train, test) for x, _ in part for a in x[:-1, 0]}
    assert len(pairs) == sum(lengths) - len(lengths)  # no snapshot pair lost
    assert len(seen & kept) <= (len(lengths) if len(lengths) < 5 else 0)  # at most the sample where both meet
    assert 0.1 < test.pairs / (train.pairs + test.pairs) < 0.3
    with pytest.raises(ValueError, match="it needs 50 in one trajectory"):
        preparation.partition(R([np.zeros((30, 1))], None, 0.1))


@pytest.mark.slow
def test_long_recordings_are_smoothed_in_chunks_and_keep_their_length(monkeypatch):
    monkeypatch.setattr(preparation, "_CHUNK", 201)
    r, exact = example("duffing", trials=2), example("duffing", trials=2, noise=0)
    smooth, whole = preparation.smoothed(r, [("q", "qdot")]), tras.smooth(r, [("q", "qdot")])
    assert smooth.lengths.tolist() == r.lengths.tolist()
    before, chunked, at_once = (np.std(x.states - exact.states, axis=(0, 1)) for x in (r, smooth, whole))
    assert (chunked < before).all() and (chunked < 1.05 * at_once).all()
    assert preparation.is_noisy(r) and not preparation.is_noisy(exact)


# --- search and scores ---


@pytest.mark.slow
def test_the_search_finds_what_made_the_data(identification, log):
    table = identification.search
    assert (
        table["chosen"].sum() == 1
        and set(table["states"]) == {"as measured", "smoothed"}
        and set(table["predictor"]) == {"one_step"}
    )
    assert (
        identification.model.dictionary.__class__.__name__ in ("Monomials", "Mechanical")
        and identification.model.delays == 0
    )
    chosen, least = table[table["chosen"]].iloc[0], table["error"].min()
    assert chosen["error"] <= 1.2 * least
    assert chosen["functions"] <= table[table["error"] <= 1.1 * least]["functions"].min()
    assert not table.duplicated(["states", "delays", "lead", "predictor", "horizon", "dictionary"]).any()
    numbers = identification.metrics.set_index(["prediction", "state"])["nrmse"]
    assert (numbers["model"] < 0.2).all() and (numbers["linear model"] > 5).all()  # the noise is 0.03 % of the range
    assert identification.model.pairs_ == 5 * 500 - 0 and len(identification.ensemble) == 5


def test_of_errors_that_are_alike_the_smallest_model_wins():
    table = pd.DataFrame({"functions": [100, 10, 10, 2], "error": [1.0, 1.08, 1.05, 1.3], "failure": ""})
    assert search.best(table, 1.1).name == 2
    with pytest.raises(ValueError, match="none of the 2 candidates .* because: no logarithm"):
        search.best(pd.DataFrame({"functions": [1, 1], "error": np.inf, "failure": "no logarithm"}), 1.1)


def test_a_free_system_has_no_inputs():
    t = np.arange(400) * 0.1
    swings = [np.column_stack([np.cos(t + p), -np.sin(t + p)]) * (1 + p) for p in np.linspace(0, 1, 6)]
    free = tras.identify(R(swings, None, 0.1), predictor="one_step", delays=[0], smoothing=False, draws=0)
    assert free.model.input_names_ == () and free.metrics["nrmse"].iloc[0] < 1e-3
    assert any(each.about == "no inputs" for each in free.advice)


def test_roll_outs_begin_at_one_instant(log):
    models = [tras.KoopmanModel(tras.Monomials(1), "one_step", d).fit(log) for d in (0, 2)]
    runs = [search.roll_outs(model, log, 4) for model in models]
    assert [len(x) for x in runs[0]] == [len(x) for x in runs[1]] == [497] * 6
    assert all(np.array_equal(a[0], x[4]) and np.array_equal(b[0], x[4]) for a, b, (x, _) in zip(*runs, log))
    assert np.allclose(runs[1][0], models[1].simulate(log.states[0, 2:5], log.inputs[0, 2:])[2:])


def test_scores_are_the_metrics(log):
    model = tras.KoopmanModel(tras.Monomials(1), "one_step").fit(log)
    windows = log.cut(51)
    table, runs = compare({"model": model}, windows, log, log, 0)
    mine = table.set_index(["prediction", "state"])
    predicted = model.predict(windows)
    for i, state in enumerate(log.state_names):
        assert mine.loc[("model", state), "nrmse"] == pytest.approx(tras.metrics.nrmse(windows.states, predicted)[i])
        assert mine.loc[("model", state), "bfr"] == pytest.approx(tras.metrics.bfr(windows.states, predicted)[i])
        assert mine.loc[("model", state), "enr"] == pytest.approx(tras.metrics.enr(windows.states, predicted)[i])
        pairs = log.cut(2)
        assert mine.loc[("model", state), "one_step"] == pytest.approx(
            tras.metrics.nrmse(
                pairs.states[:, 1:], model.predict(pairs)[:, 1:], span=np.ptp(windows.states, axis=(0, 1))
            )[i]
        )
    rise = growth(runs, windows, 0)
    error = (predicted - windows.states) / np.ptp(windows.states, axis=(0, 1))
    assert (
        np.allclose(rise["model"], 100 * np.sqrt(np.mean(error**2, axis=(0, 2)))[1:]) and rise["time"].iloc[0] == log.dt
    )
    of_windows = np.sqrt(np.mean(error**2, axis=(1, 2)))
    typical, worst = typical_and_worst(runs["model"], windows, 0)
    assert worst == of_windows.argmax() and of_windows[typical] == np.sort(of_windows)[(len(of_windows) - 1) // 2]
    runs["model"][7] = np.full_like(runs["model"][7], np.nan)
    assert typical_and_worst(runs["model"], windows, 0)[1] == 7


# --- advice ---


def abouts(recording, **options):
    return {
        each.about: each
        for each in tras.identify(
            recording, predictor="one_step", delays=[0], smoothing=False, draws=0, **options
        ).advice
    }


def test_a_good_recording_has_no_warning(identification):
    assert {each.weight for each in identification.advice} <= {"note"}
    assert advice.verdict(identification).startswith("Over ") and "times as large" in advice.verdict(identification)


def test_bad_recordings_are_told_what_is_wrong():
    rng = np.random.default_rng(0)
    u = np.repeat(rng.uniform(-1, 1, (300, 2)), 10, axis=0)
    x = np.zeros((3000, 2))
    for k in range(2999):
        x[k + 1] = x[k] + 0.1 * (-x[k] + u[k])
    noise, angle = rng.normal(size=3000), np.mod(np.cumsum(0.3 + 0.1 * u[:, 0]), 2 * np.pi)
    limited = np.clip(1.3 * u[:, 0], -0.9, 1)
    drifting = x[:, 0] + np.linspace(0, 3, 3000)
    loop, partly = -3 * x[:, 1] + 0.02 * rng.normal(size=3000), x[:, 1] + 0.5 * np.std(x[:, 1]) * rng.normal(size=3000)
    inputs = np.column_stack([limited, limited + 0.1 * u[:, 1], loop, np.sign(u[:, 1]), partly])
    given = R(
        [np.column_stack([x, noise, angle, drifting])], [inputs], 0.1,
        state_names=["a", "b", "loose", "angle", "slow"], input_names=["lim", "near", "loop", "switch", "partly"],
    )  # fmt: skip
    told = abouts(given)
    assert told["loose is not predicted"].weight == told["angle jumps by a full turn"].weight == "stop"
    expected = {
        "lim saturates",
        "loose is noisy",
        "loop follows the states",
        "lim and near move together",
        "slow drifts",
        "slow beyond the training data",
        "switch has few values",
    }
    assert expected <= set(told)
    assert not {
        "near saturates",
        "a is noisy",
        "a drifts",
        "switch follows the states",
        "partly follows the states",
    } & set(told)
    order = [each.weight for each in told.values()]
    assert order == sorted(order, key=["stop", "warning", "note"].index)


def test_too_little_excitation_short_and_unstable():
    t = np.arange(600) * 0.1
    u = np.sin(t)
    x = np.zeros((600, 3))
    for k in range(599):
        x[k + 1] = x[k] + 0.1 * (np.roll(x[k], 1) * 0.3 - x[k] + u[k] * np.array([1, 0.5, 0.2]))
    told = abouts(R([x], [u[:, None]], 0.1))
    assert "too little excitation" in told
    rng = np.random.default_rng(0)
    growing = np.zeros((10, 40, 1))
    growing[:, 0] = rng.uniform(-1, 1, (10, 1))
    u = rng.uniform(-1, 1, (10, 40, 1))
    for k in range(39):
        growing[:, k + 1] = 1.1 * growing[:, k] + u[:, k]
    log = R(growing, u, 0.1)
    result = tras.identify(log, predictor="one_step", delays=[0], smoothing=False, draws=0)
    # An operator that grows is said where it costs the user something: here the test is predicted, then it is not.
    assert "an unstable operator" not in [each.about for each in result.advice]
    lost = result.metrics.assign(free=np.where(result.metrics["prediction"] == "model", np.inf, result.metrics["free"]))
    told = {each.about: each for each in advice.of(result._replace(metrics=lost), log)}
    assert "doubles every 0.727 s" in told["an unstable operator"].text


# --- files ---


@pytest.mark.slow
def test_files_are_replaced_and_those_of_others_left(identification, log, tmp_path, monkeypatch):
    folder = tmp_path / "out"
    identify_files.write(identification, log, "<script>&.csv", folder)
    text = (folder / "report.html").read_text(encoding="utf-8")
    assert "<script" not in text and "&lt;script&gt;&amp;.csv" in text
    first = {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    (folder / "mine.txt").write_text("mine")
    (folder / "tables" / "old.csv").write_text("old")
    (tmp_path / "outside.txt").write_text("outside")
    listed = pd.read_csv(folder / "contents.csv")
    more = pd.DataFrame({"file": ["tables/old.csv", "../outside.txt", str(tmp_path / "outside.txt")]})
    pd.concat([listed, more]).to_csv(folder / "contents.csv", index=False)
    monkeypatch.setattr(identify_files, "_figures", lambda *_: {})
    identify_files.write(identification, log, "<script>&.csv", folder)
    again = {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    left = {
        path.as_posix(): content
        for path, content in first.items()
        if path.parts[0] != "figures" and path.suffix not in (".html",)
    }
    assert again.keys() == left.keys() | {"mine.txt", "report.html"}
    assert all(again[path] == content for path, content in left.items() if path != "contents.csv")  # the same bytes
    assert (tmp_path / "outside.txt").exists() and not list(tmp_path.glob(".*"))

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(identify_files, "write_page", full)
    with pytest.raises(OSError, match="No space left"):
        identify_files.write(identification, log, "log.csv", tmp_path / "new")
    assert not (tmp_path / "new").exists() and not list(tmp_path.glob(".*"))


def test_roles_by_name_or_by_file(tmp_path, log):
    log.write(tmp_path / "a.nc")
    assert identify_files.open_log(tmp_path / "a.nc", states=["q"]).state_names == ("q",)
    (tmp_path / "b.csv").write_text("stamp,a,b\n0,1,2\n1,2,3\n2,1,5\n")
    opened = identify_files.open_log(tmp_path / "b.csv", states=["b"], inputs=["a"], time="stamp")
    assert opened.state_names == ("b",) and opened.input_names == ("a",)
    with pytest.raises(ValueError, match="give them in one way"):
        identify_files.open_log(tmp_path / "b.csv", states=["b"], roles="roles.yaml")
    assert identify_files.open_log().state_names == ("q", "qdot")
