"""The kinds of faults that recordings of real rigs have shown, each with an input that the test makes."""

import numpy as np
import pandas as pd
import pytest
from scipy.signal import butter, cont2discrete, dlsim, lfilter

import tras
from tras.identification import advice, preparation, search
from tras.identification.scores import CONSTANT, HELD, compare


def one(y, u, dt, **labels):
    states, inputs = (np.asarray(part, dtype=float).reshape(len(part), -1) for part in (y, u))
    return tras.Recording([states], [inputs], dt=dt, **labels)


def of(identification, prediction="model"):
    return identification.metrics.set_index(["prediction", "state"]).loc[prediction]


@pytest.mark.slow
def test_a_fit_sees_what_happens_on_seams():
    """The base of a beam is stepped every 400 samples, just where pieces would have been cut."""
    rng, dt, n = np.random.default_rng(0), 0.005, 4000
    u = np.where((np.arange(n) // 400) % 2, 90.0, 0.0)
    w = 2 * np.pi * 4
    A, B = np.array([[0, 1], [-w * w, -0.04 * w]]), np.array([[0], [1.0]])
    system = cont2discrete((A, B, np.array([[0, 1.0]]), np.zeros((1, 1))), dt)
    y = dlsim((*system[:4], dt), u)[1]
    y = y * 80 / np.abs(y).max() + rng.normal(0, 0.3, (n, 1))
    identification = tras.identify(one(y, u, dt), draws=0, predictor="one_step", smoothing=False)
    assert of(identification)["nrmse"].max() < 1 and of(identification)["free"].max() < 1
    assert identification.remarks["every"] * identification.train.lengths.max() > 3000  # whole trajectories, not pieces
    assert identification.delivered.pairs_ > identification.model.pairs_


def same_instant(n=3000):
    """``y[k]`` depends on ``u[k]``."""
    rng = np.random.default_rng(0)
    u = lfilter(*butter(3, 0.3), rng.normal(0, 1, n))
    y = np.zeros(n)
    for k in range(2, n):
        y[k] = 1.5 * y[k - 1] - 0.8 * y[k - 2] - 0.03 * y[k - 1] ** 3 + 0.2 * u[k] + 0.1 * u[k - 1]
    return one(y + rng.normal(0, 0.001, n), u, 0.01)


@pytest.mark.slow
def test_the_timing_of_the_input_is_searched_and_can_be_said():
    log = same_instant()
    options = {"draws": 0, "predictor": "one_step", "delays": [1], "smoothing": False}
    identification = tras.identify(log, **options)
    assert identification.model.lead == 1 and of(identification)["nrmse"].max() < 0.1
    assert "inputs of the same instant" in [about for _, about, _ in identification.advice]
    held = tras.identify(log, lead=0, **options)
    assert held.model.lead == 0 and of(held)["nrmse"].max() > 5 * of(identification)["nrmse"].max()


@pytest.mark.parametrize("intersample, leads", [("zoh", [0]), ("foh", [1]), ("bl", [1]), (None, [0, 1])])
def test_the_recording_says_how_its_inputs_act(intersample, leads):
    attributes = {"intersample": intersample} if intersample else {}
    log = one(np.arange(20.0), np.arange(20.0), 0.1, attributes=attributes)
    assert search._leads(log, None) == leads and search._leads(log, 1) == [1]
    assert search._leads(log.select(inputs=[]), None) == [0]


@pytest.mark.parametrize(
    "predictor, delays", [("one_step", 0), ("one_step", 2), ("vector_field", 0), ("lifted_linear", 1)]
)
def test_a_lead_is_the_input_one_sample_earlier(predictor, delays, tmp_path):
    """The same numbers as a model without it, fitted to the shifted recording: fit, simulation, file."""
    log = same_instant(400)
    u = log.inputs[0]
    shifted = one(log.states[0], np.concatenate([u[1:], u[-1:]]), log.dt)
    model = tras.KoopmanModel(tras.Monomials(2), predictor, delays, strength=0, lead=1).fit(log)
    plain = tras.KoopmanModel(tras.Monomials(2), predictor, delays, strength=0).fit(shifted)
    whole, part = model.predict(log)[0], plain.predict(shifted)[0]
    assert np.allclose(whole, part, rtol=0, atol=1e-9 * np.ptp(part))
    model.save(tmp_path / "model.npz")
    assert np.array_equal(tras.load_model(tmp_path / "model.npz").predict(log)[0], whole)
    plain.save(tmp_path / "plain.npz")  # the bytes of a model without a lead are those of earlier releases
    with np.load(tmp_path / "plain.npz") as file:
        assert "lead" not in str(file["header"])
    tras.export.to_c(model, tmp_path / "model.c")
    assert "the input at the end of a sample" in (tmp_path / "model.h").read_text()
    if predictor == "lifted_linear":
        system, first = tras.export.to_statespace(model), log.states[0][delays::-1].ravel()
        z = model.lift(np.concatenate([first, u[1 : delays + 1][::-1].ravel()])) - model.B_ / model.u_scale_ @ u[delays]
        for k in range(delays, 60):
            assert np.allclose(system.C @ z + system.D @ u[k], whole[k], rtol=0, atol=1e-7 * np.ptp(part))
            z = system.A @ z + system.B @ u[k]
    with pytest.raises(ValueError, match="lead is 2"):
        tras.KoopmanModel(tras.Monomials(1), lead=2).fit(log)


@pytest.mark.slow
def test_predictions_start_from_what_was_measured_up_to_then():
    """A quiet plant and a noisy, coarse sensor: delays average, the future is not known."""
    rng, dt, n = np.random.default_rng(0), 0.025, 4800
    u = np.repeat(rng.uniform(-1, 1, n // 120), 120)
    x, v = np.zeros(n), np.zeros(n)
    for k in range(n - 1):
        v[k + 1] = v[k] + dt * (-0.6 * v[k] - 1.5 * x[k] + u[k])
        x[k + 1] = x[k] + dt * v[k + 1]
    log = one(np.round(x * 20 + rng.normal(0, 0.5, n)), u, dt)
    identification = tras.identify(log, draws=0, predictor="one_step")
    every = identification.remarks["every"]
    assert of(identification)["nrmse"].max() < 2.5 and every * identification.model.delays >= 16
    # The truth of a window is the recording's, sample by sample.
    y, window = log.states[0], identification.test.states[0]
    span = every * (len(window) - 1) + 1
    assert any(np.array_equal(y[k : k + span : every], window) for k in range(len(y) - span + 1))


def resting(n_moving=1600, n_rest=900):
    rng, dt = np.random.default_rng(0), 0.02
    u = np.r_[np.repeat(rng.uniform(0, 10, n_moving // 40), 40), np.zeros(n_rest)]
    x, v = np.zeros(len(u)), np.zeros(len(u))
    for k in range(len(u) - 1):
        v[k + 1] = v[k] + dt * (-1.2 * v[k] - 2.0 * np.sin(x[k]) + 0.2 * u[k])
        x[k + 1] = max(0, x[k] + dt * v[k + 1])
        v[k + 1] *= x[k + 1] > 0
    return one(np.round(x / 0.003) * 0.003, u, dt)


def test_the_test_lies_where_the_states_move():
    log = resting()
    train, test, remark = preparation.partition(log)
    assert test.states[0].std() > 0.2 * log.states[0].std() and "in which the states move" in remark
    assert sum(train.lengths) + sum(test.lengths) == log.lengths[0] + len(train) + len(test) - 1  # no pair is lost
    steady = one(np.sin(np.arange(1000)), np.cos(np.arange(1000)), 0.1)
    assert "the last fifth" in preparation.partition(steady)[2]


def test_a_test_at_rest_says_so_and_no_nan():
    log = resting()
    model = tras.KoopmanModel(tras.Monomials(1), "one_step", 1).fit(log)
    rest = one(np.zeros(300), np.zeros(300), log.dt)
    metrics, _ = compare({"model": model, "linear model": model}, preparation.windows(rest, 50, 1), rest, log, 1)
    table = metrics.set_index(["prediction", "state"])
    assert not table["moves"].any() and np.isfinite(table["nrmse"]).all()
    assert (table.loc[[HELD, CONSTANT], "diverged"] == 0).all()
    words = advice.verdict(Told(metrics, model))
    assert words.startswith("The test says nothing: no state moves in it.") and "nan" not in words


class Told:
    """What a verdict needs of an identification."""

    def __init__(self, metrics, model=None):
        self.metrics, self.model = metrics, model or tras.KoopmanModel(tras.Monomials(3))


def table_of(**errors):
    """Metrics of one state: prediction -> (windows, free run, windows lost)."""
    names = {"linear": "linear model", "held": HELD, "mean": CONSTANT}
    rows = [
        {
            "state": "q", "prediction": names.get(name, name), "nrmse": error, "free": free, "windows": 10,
            "diverged": lost, "moves": True, "horizon": 1.0, "free_horizon": 10.0,
        }
        for name, (error, free, lost) in errors.items()
    ]  # fmt: skip
    return pd.DataFrame(rows)


TRIVIAL = {"held": (30.0, 60.0, 0), "mean": (25.0, 25.0, 0)}


@pytest.mark.parametrize(
    "model, linear, words, worse",
    [
        ((1.0, 2.0, 0), (3.0, 6.0, 0), "The error of a linear model is 3 times as large", ""),
        ((3.0, 6.0, 0), (1.0, 2.0, 0), "A linear model is better: its error is 0.33 times", "3 times that of a linear"),
        ((1.0, 1.0, 0), (1.02, 1.02, 0), "A linear model is about as good", ""),
        ((1.0, 1.0, 3), (2.0, 2.0, 0), "A linear model ran away less often", "ran away in 3 of 10"),
        ((1.0, 1.0, 0), (2.0, 2.0, 2), "The linear model ran away", ""),
        ((1.0, np.inf, 0), (2.0, 3.0, 0), "The error of a linear model is 2 times", "free run over the test ran away"),
        ((28.0, 40.0, 0), (90.0, 90.0, 0), "Do not use it: to predict the mean of the training data is better", ""),
    ],
)
def test_the_verdict_is_true_in_both_directions(model, linear, words, worse):
    metrics = table_of(model=model, linear=linear, **TRIVIAL)
    sentence = advice.verdict(Told(metrics))
    assert words in sentence and (not worse or "free run" in worse or sentence.startswith(words))
    reason = advice.worse_than_linear(metrics)
    assert (worse in reason) if worse else not reason


def test_a_candidate_that_loses_a_window_loses_to_one_that_loses_none():
    squares = np.full(10, 1e-4)
    rows = [
        {"error": 0.01, "windows": 0.01, "free": 0.01, "lost": 1, "functions": 5, "squares": squares, "failure": ""},
        {
            "error": 0.30,
            "windows": 0.30,
            "free": 0.30,
            "lost": 0,
            "functions": 9,
            "squares": 900 * squares,
            "failure": "",
        },
    ]
    assert search.best(pd.DataFrame(rows), search.CLOSE).name == 1
    for row in rows:
        row["lost"] = 1
    assert search.best(pd.DataFrame(rows), search.CLOSE).name == 0


def test_ties_within_the_spread_over_windows_go_to_the_simpler_one():
    rng = np.random.default_rng(0)
    leader, apart = rng.uniform(0.5, 1.5, 40), rng.uniform(0.5, 1.5, 40)

    def chosen(of_simple):
        rows = [
            {"functions": count, "squares": squares, "windows": np.sqrt(squares.mean()), "lost": 0, "failure": ""}
            for count, squares in ((100, leader), (5, of_simple))
        ]
        for row in rows:
            row |= {"free": 1.0, "error": np.sqrt(row["windows"])}
        return search.best(pd.DataFrame(rows)).functions

    assert chosen(apart * leader.mean() / apart.mean() * 1.05) == 5  # varies from window to window: no difference
    assert chosen(leader * 1.05) == 100  # worse in each window, by as much


def test_a_trial_too_short_for_the_delays_is_left_out():
    log = same_instant(600)
    trials = (
        [log.states[0][k : k + 90] for k in range(0, 540, 90)],
        [log.inputs[0][k : k + 90] for k in range(0, 540, 90)],
    )
    states, inputs = ([*part[:-1], part[-1][:3]] for part in trials)
    broken = tras.Recording(states, inputs, log.dt)
    identification = tras.identify(broken, draws=0, predictor="one_step", delays=[4], lead=1, smoothing=False)
    assert identification.model.delays == 4 and np.isfinite(of(identification)["nrmse"]).all()


def test_a_linear_model_that_is_chosen_is_the_linear_one():
    rng, x = np.random.default_rng(0), np.zeros(800)
    u = np.repeat(rng.uniform(-1, 1, 80), 10)
    for k in range(799):
        x[k + 1] = 0.9 * x[k] + 0.1 * u[k]
    log = one(x + rng.normal(0, 0.003, 800), u, 0.1)
    identification = tras.identify(log, draws=0, predictor="one_step", delays=[0], lead=0, smoothing=False)
    assert identification.linear is identification.model  # one fit, one curve in the figure of the free run


@pytest.mark.parametrize("lengths", [[500], [400, 60], [90] * 6, [90, 90, 90, 90, 3], [90, 3, 3, 3, 90], [30] * 12])
@pytest.mark.parametrize("grid", [1, 4])
def test_what_is_held_out_and_what_is_learnt_from_are_all_pairs(lengths, grid):
    log = tras.Recording([np.sin(np.arange(length))[:, None] for length in lengths], dt=0.1)
    learn, judge = preparation.held_out(log, 10, grid)
    assert all(a % grid == 0 and (b % grid == 0 or b == lengths[i] - 1) for i, a, b in judge)
    pairs = [(i, k) for i, a, b in learn + judge for k in range(a, b)]
    assert sorted(pairs) == [(i, k) for i, length in enumerate(lengths) for k in range(length - 1)]
    assert judge and len(pairs) == len(set(pairs)) and sum(b - a for _, a, b in judge) < 0.3 * len(pairs)


@pytest.mark.parametrize(
    "moving, expected",
    [
        (range(10), [2, 7]),
        ([], [2, 7]),  # nothing is better than these
        ([3, 4, 5, 6], [3, 6]),
        ([0, 1, 4, 5], [1, 5]),
        ([2, 3, 4], [2, 4]),
        ([1, 2], [2, 7]),  # one of them would leave too little
        ([5], [2, 7]),  # without it nothing would be left to learn from
    ],
)
def test_what_is_held_out_moves_and_leaves_motion(moving, expected):
    x = np.zeros(1001)
    for k in moving:
        x[100 * k : 100 * (k + 1)] = np.sin(np.arange(100) / 3)
    learn, judge = preparation.held_out(tras.Recording(x[None, :, None], dt=0.1), 10)
    assert judge == [(0, 100 * k, 100 * (k + 1)) for k in expected]


def test_windows_have_their_start_before_them():
    log = one(np.arange(100.0), np.zeros(100), 0.1)
    cut = preparation.windows(log, 11, 5)
    assert cut.states.shape == (9, 16, 1) and np.array_equal(cut.states[:, 5, 0], 5 + 10 * np.arange(9))
    assert preparation.windows(log, 500, 5).states.shape == (1, 100, 1)  # as long as there is
    assert preparation.window_length(log, 10, horizon=2.0) == (21, "windows are 2 s long, as the horizon says")
    with pytest.raises(ValueError, match="horizon is -1"):
        preparation.window_length(log, 10, horizon=-1)


def pendulum(n=4000, dt=0.01, noise=0.003):
    """Sampled 200 times per swing, by a sensor with noise."""
    rng = np.random.default_rng(0)
    u, state = np.repeat(rng.uniform(-4, 4, n // 80), 80), np.zeros((n, 2))
    for k in range(n - 1):
        x, v = state[k]
        v = v + dt * (-9 * np.sin(x) - 0.6 * v + u[k])
        state[k + 1] = x + dt * v, v
    return one(state[:, 0] + rng.normal(0, noise, n), u, dt)


def test_longer_steps_are_tried_where_samples_are_finer_than_the_noise_allows():
    log, clean = pendulum(4800), pendulum(noise=0)
    assert preparation.steps(log, 200) == [1, 2, 8] and preparation.steps(clean, 200) == [1]
    assert preparation.steps(log, 33) == [1, 4]  # eight steps to a window
    assert preparation.steps(log.decimated(8), 200) == [1]


def test_longer_steps_tell_the_motion_from_the_noise():
    log = pendulum()
    options = {"draws": 0, "predictor": "one_step", "delays": [2], "smoothing": False, "lead": 0}
    chosen, single = tras.identify(log, **options), tras.identify(log, every=1, **options)
    every = chosen.remarks["every"]
    assert every > 1 and single.remarks["every"] == 1 and set(single.search["every"]) == {1}
    assert of(chosen)["free"].max() < 0.5 * of(single)["free"].max()
    assert chosen.delivered.dt_ == chosen.recording.dt == pytest.approx(every * log.dt)
    assert "longer steps" in [each.about for each in chosen.advice]
    assert "longer steps" not in [each.about for each in single.advice]
    with pytest.raises(ValueError, match=rf"take recording.decimated\({every}\)"):
        chosen.model.predict(log)
    assert chosen.model.predict(log.decimated(every))[0].shape == (-(-4000 // every), 1)


def test_a_lone_sample_far_from_both_neighbours_becomes_their_mean():
    swing = np.sin(np.arange(2000) * 0.05)
    broken = swing.copy()
    broken[[700, 1500]] = 40.0, -7.0
    mended, (remark,) = preparation.without_spikes(one(broken, np.cos(np.arange(2000)), 0.01))
    assert np.abs(mended.states[0][:, 0] - swing).max() < 0.01 and "x1 has 2 lone samples" in remark
    assert "the farthest is 40" in remark


@pytest.mark.parametrize(
    "states",
    [
        np.sin(np.arange(1000) * 0.05),
        np.random.default_rng(0).normal(size=1000),
        np.repeat([0.0, 1.0, 0.0, 5.0, 0.0], 200),
        np.where(np.arange(1000) % 20 == 0, 1.0, 0.0),  # too many to be lost bytes
        np.where(np.arange(1000) == 500, 1.0, 0.0),  # all that happens
        np.r_[np.zeros(500), 9.0, 9.0, np.zeros(498)],
        np.arange(2.0),
    ],
)
def test_what_moves_by_itself_is_no_lone_sample(states):
    log = one(states, np.zeros(len(states)), 0.01)
    same, remarks = preparation.without_spikes(log)
    assert same is log and not remarks


def test_a_field_takes_the_strength_of_one_step_in_the_search():
    treatments = preparation.Treatments(pendulum(1600, noise=0), [], 2000)
    table, _ = search.search(treatments, 60, delays=[0], smoothing=False, lead=0)
    both = table[table["failure"] == ""].pivot_table(index="dictionary", columns="predictor", values="strength")
    fields = both.dropna()
    assert len(fields) > 1 and (fields["one_step"] == fields["vector_field"]).all()
