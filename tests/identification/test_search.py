"""The choice among models: the right one wins, by errors on data that no candidate saw, and failures are told."""

import copy

import numpy as np
import pandas as pd
import pytest
from conftest import linear_system

import tras
from tras.fitting import hold_out
from tras.identification import search
from tras.identification.examples import example

TORQUES = ["u_phi", "u_psi"]


@pytest.fixture(scope="module")
def torque_data(experiment):
    return experiment.select(inputs=TORQUES)


@pytest.mark.slow
def test_a_mechanical_system_gets_the_mechanical_dictionary(torque_data):
    model, table = tras.choose(
        torque_data, [tras.KoopmanModel(d) for d in (tras.Monomials(1), tras.Monomials(2), tras.Mechanical(6))]
    )
    assert isinstance(model.dictionary, tras.Mechanical) and model.pairs_ == torque_data.pairs
    assert list(table["chosen"]) == [False, False, True] and table["error"].idxmin() == 2
    assert table["error"].iloc[2] < 0.1 * table["error"].iloc[0] and list(table["functions"]) == [7, 28, 63]


def test_the_error_is_that_of_the_held_out_roll_outs(torque_data):
    """By hand: fit without every fifth trajectory, predict those, root mean square in half-ranges."""
    _, table = tras.choose(torque_data, [tras.KoopmanModel(tras.Monomials(1), "one_step")])
    train, held = hold_out(torque_data)
    predicted = tras.KoopmanModel(tras.Monomials(1), "one_step").fit(train).predict(held)
    error = (predicted - held.states) / (np.ptp(held.states, axis=(0, 1)) / 2)
    assert table["error"].iloc[0] == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-9)
    assert not {x.tobytes() for x, _ in train} & {x.tobytes() for x, _ in held}


def test_delays_are_compared_from_the_same_instant():
    """With only the position recorded, one delay makes the oscillator predictable; the table says by how much."""
    full = linear_system([[0, 1], [-2, -0.1]], [[0], [1]], 0.1, trajectories=20, samples=80)[0]
    position = tras.Recording(full.states[..., :1], full.inputs, 0.1)
    models = [tras.KoopmanModel(tras.Monomials(1), "one_step", delays) for delays in (0, 1, 2)]
    model, table = tras.choose(position, models[:2])
    assert model.delays == 1 and table["error"].iloc[1] < 1e-9 < 0.1 < table["error"].iloc[0]
    assert list(table["candidate"]) == ["Monomials(degree=1)", "Monomials(degree=1), 1 delays"]
    again = tras.choose(position, models)[1]
    assert again["error"].iloc[1] < 1e-9
    # Without delays too the prediction begins at the third sample when another model needs two before it.
    train, held = hold_out(position)
    late = tras.Recording(held.states[:, 2:], held.inputs[:, 2:], 0.1)
    error = (models[0].fit(train).predict(late) - late.states) / (np.ptp(held.states) / 2)
    assert again["error"].iloc[0] == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-9)


def test_what_cannot_be_fitted_says_why_and_the_rest_compete(torque_data):
    few = torque_data[:8].cut(21)
    models = [
        tras.KoopmanModel(tras.Monomials(5), "one_step", regularization=None),
        tras.KoopmanModel(tras.Monomials(1), "one_step"),
    ]
    few = few[list(range(20))]
    model, table = tras.choose(few, models)
    assert (
        model.dictionary.degree == 1
        and "cannot determine 462 functions" in table["failure"].iloc[0]
        and np.isinf(table["error"].iloc[0])
    )


def test_candidates_fit_the_recording(torque_data):
    kinds = [type(model.dictionary).__name__ for model in tras.candidates(torque_data)]
    assert kinds == ["Monomials"] * 4 + ["GaussianRBF"] * 2 + ["Mechanical"]
    small = [model.dictionary for model in tras.candidates(torque_data[[0]].cut(31)[[0]])]
    assert [type(d).__name__ for d in small] == ["Monomials", "Mechanical"]
    wide = tras.Recording(np.random.default_rng(0).standard_normal((10, 500, 31)), dt=0.1)
    assert all(getattr(model.dictionary, "degree", 1) == 1 for model in tras.candidates(wide))
    assert not any(
        isinstance(m.dictionary, tras.Mechanical) for m in tras.candidates(torque_data, "one_step", delays=1)
    )


@pytest.mark.parametrize(
    "call, words",
    [
        (lambda r: tras.choose(r, []), "models holds no candidate"),
        (
            lambda r: tras.choose(r[[0]].cut(11)[[0]], [tras.KoopmanModel(tras.Monomials(1))]),
            "10 snapshot pairs, too few to hold",
        ),
        (
            lambda r: tras.choose(
                r[:6].cut(11)[list(range(20))], [tras.KoopmanModel(tras.Monomials(4), regularization=None)]
            ),
            "none of the 1 candidates could be fitted; the last one because",
        ),
    ],
)
def test_mistakes_are_named(call, words, torque_data):
    with pytest.raises(ValueError, match=words):
        call(torque_data)


def pendulum(noise, samples=3000):
    """A pendulum of which the angle alone is measured, every torque held for two seconds."""
    rng, x = np.random.default_rng(0), np.zeros((samples, 2))
    u = np.repeat(rng.uniform(-1, 1, (-(-samples // 10), 1)), 10, axis=0)[:samples]
    for k in range(samples - 1):
        q, v = x[k]
        v = v + 0.2 * (u[k, 0] - np.sin(q) - 0.5 * v)
        x[k + 1] = q + 0.2 * v, v
    return tras.Recording([x[:, :1] + rng.normal(0, noise, (samples, 1))], [u], 0.2, state_names=["q"])


def test_coefficients_fitted_to_predictions_are_a_candidate_where_they_predict_better():
    options = {"predictor": "one_step", "delays": [1], "smoothing": False, "lead": 0, "draws": 0}
    noisy = tras.identify(pendulum(0.03), **options)
    assert noisy.model.horizon > 1 and noisy.delivered.horizon == noisy.model.horizon
    row = noisy.search[noisy.search["chosen"]].iloc[0]
    same = noisy.search[noisy.search["dictionary"] == row["dictionary"]].query("every == @row.every")
    assert list(same["horizon"]) == [1, noisy.model.horizon] and same["error"].is_monotonic_decreasing
    assert any(f"predictions over {noisy.model.horizon} samples" in each for each in noisy.remarks["search"])


@pytest.mark.parametrize("ratios, stays", [([0.9, 0.8, 0.9, 0.85], True), ([1.1, 0.6, 1.2, 0.7], False)])
def test_they_are_none_where_the_windows_leave_that_open(ratios, stays):
    squares = np.array([1.0, 2.0, 1.5, 1.0])
    row = {"states": "as measured", "every": 1, "delays": 0, "lead": 0, "predictor": "one_step", "dictionary": "a"}
    after = squares * np.square(ratios)
    rows = [
        row | {"horizon": horizon, "error": np.sqrt(each.mean()), "free": np.nan, "squares": each}
        for horizon, each in ((1, squares), (25, after))
    ]
    assert rows[1]["error"] < rows[0]["error"]
    table = search._without_idle_horizons(pd.DataFrame(rows))
    assert list(table["horizon"]) == ([1, 25] if stays else [1])


def test_more_gaussians_are_not_tried_where_few_fail_beside_a_polynomial():
    def row(dictionary, error):
        setting = {"states": "as measured", "every": 1, "delays": 0, "lead": 0}
        return {**setting, "error": error, "model": tras.KoopmanModel(dictionary, "one_step")}

    few, many = tras.GaussianRBF(30), tras.KoopmanModel(tras.GaussianRBF(250), "one_step")
    rows = [row(tras.Monomials(3), 0.001), row(few, 0.1)]
    assert search._hopeless(rows, "as measured", 1, many)
    assert not search._hopeless(rows, "as measured", 2, many)  # another setting
    assert not search._hopeless([row(tras.Monomials(3), 0.001), row(few, 0.01)], "as measured", 1, many)
    assert not search._hopeless(rows, "as measured", 1, tras.KoopmanModel(tras.Monomials(4), "one_step"))


def test_a_candidate_that_loses_windows_by_few_steps_is_judged_by_all(monkeypatch):
    log = example("duffing", trials=6, noise=0.5)
    model, train, windows = tras.KoopmanModel(tras.Monomials(3)), log[:4], log[4:].cut(51)

    def wild(fitted):
        copied = copy.copy(fitted)
        copied.W_ = 1e3 * fitted.W_
        return copied

    exact = search.attempt(model, train, windows, 0)
    monkeypatch.setattr(search, "coarser", wild)
    scores = search.attempt(model, train, windows, 0, coarse=True)
    assert exact["lost"] == 0 and exact["error"] > search._COARSE
    assert {name: scores[name] for name in ("error", "lost")} == {name: exact[name] for name in ("error", "lost")}
