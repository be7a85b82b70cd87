"""Metrics against values worked out by hand."""

import numpy as np
import pytest

from tras import metrics

TRUE = np.array([[[3.0, 0.0], [4.0, 2.0]], [[0.0, 4.0], [0.0, 2.0]]])  # two trajectories, two samples, two channels
WRONG = np.array([[[3.0, 1.0], [3.0, 3.0]], [[0.0, 5.0], [0.0, 3.0]]])


def test_hand_values():
    assert np.allclose(metrics.enr(TRUE, WRONG), [1 / 5, 2 / np.sqrt(24)])
    # channel 1: mean 7/4, |x - mean|^2 = 51/4; channel 2: mean 2, |x - mean|^2 = 8
    assert np.allclose(metrics.bfr(TRUE, WRONG), [100 * (1 - 1 / np.sqrt(51 / 4)), 100 * (1 - 2 / np.sqrt(8))])
    assert np.allclose(metrics.nrmse(TRUE, WRONG), [100 * 0.5 / 4, 100 * 1 / 4])


def test_nrmse_per_trajectory():
    # channel 2: both have range 2 and error 1
    assert np.allclose(metrics.nrmse(TRUE[..., 1:], WRONG[..., 1:], range_over="trajectory"), 50)


def test_perfect_and_useless():
    assert (
        np.allclose(metrics.enr(TRUE, TRUE), 0)
        and np.allclose(metrics.bfr(TRUE, TRUE), 100)
        and np.allclose(metrics.nrmse(TRUE, TRUE), 0)
    )
    mean = np.broadcast_to(TRUE.mean(axis=(0, 1)), TRUE.shape)
    assert np.allclose(metrics.bfr(TRUE, mean), 0)  # no better than the mean
    assert np.allclose(metrics.bfr(TRUE, -10 * TRUE), 0)  # never below zero


def test_better_models_score_higher_on_the_repaired_bfr():
    errors = np.linspace(0.1, 0.9, 5)
    repaired = [metrics.bfr(TRUE, TRUE + e)[0] for e in errors]
    assert np.all(np.diff(repaired) < 0)


def test_lists_of_unequal_length_count_every_sample():
    true, wrong = (
        [np.zeros((2, 1)), np.array([[0.0], [4.0], [0.0]])],
        [np.ones((2, 1)), np.array([[0.0], [4.0], [0.0]])],
    )
    assert metrics.nrmse(true, wrong)[0] == pytest.approx(100 * np.sqrt(2 / 5) / 4)
    assert list(metrics.diverged(true, wrong)) == [False, False]


def test_divergence_is_noticed_and_not_averaged():
    wrong = WRONG.copy()
    assert list(metrics.diverged(TRUE, wrong)) == [False, False]
    wrong[1, 1, 0] = np.nan
    assert list(metrics.diverged(TRUE, wrong)) == [False, True]
    wrong[1, 1, 0] = 10 * 4.0 - 0.1  # ten times the range, 4, is the limit
    assert list(metrics.diverged(TRUE, wrong)) == [False, False]
    wrong[1, 1, 0] = 10 * 4.0 + 0.1
    assert list(metrics.diverged(TRUE, wrong)) == [False, True]
    wrong[0, 0, 1] = -np.inf
    assert list(metrics.diverged(TRUE, wrong)) == [True, True]


def test_a_span_of_the_whole_stands_in_for_that_of_a_part():
    assert np.allclose(metrics.nrmse(TRUE[:1], WRONG[:1], span=[4.0, 4.0]), [100 * np.sqrt(1 / 2) / 4, 100 / 4])
    wrong = TRUE + [0.0, 30.0]
    assert list(metrics.diverged(TRUE, wrong)) == [False, False]
    assert list(metrics.diverged(TRUE, wrong, span=[4.0, 2.0])) == [True, True]


def test_an_exact_prediction_of_a_constant_has_not_diverged():
    for level, limit in ((0.0, 10.0), (0.5, 5.0), (-3.0, 30.0)):
        true = np.dstack([np.full((2, 5), level), np.tile(np.arange(5.0), (2, 1))])
        assert list(metrics.diverged(true, true)) == [False, False]
        for error, lost in ((limit * 0.99, False), (limit * 1.01, True)):
            assert list(metrics.diverged(true, true + [error, 0])) == [lost, lost]
        assert list(metrics.diverged(true, true + [1.0, 0], span=[0.09, 4])) == [True, True]
        assert list(metrics.diverged(true, true + [limit * 0.99, 0], span=[0, 4])) == [False, False]


def test_the_judge_gives_the_metrics_of_what_did_not_diverge():
    true = np.concatenate([TRUE, TRUE[:1] + 100])
    wrong = np.concatenate([WRONG, TRUE[:1] + 100])
    wrong[2, 1, 0] = np.nan
    scores = metrics.judge(true, wrong)
    assert (scores.windows, scores.diverged) == (3, 1)
    assert np.array_equal(scores.enr, metrics.enr(TRUE, WRONG)) and np.array_equal(scores.bfr, metrics.bfr(TRUE, WRONG))
    span = np.ptp(true, axis=(0, 1))  # that of all
    assert np.array_equal(scores.nrmse, metrics.nrmse(TRUE, WRONG, span=span))
    span = [8.0, 8.0]
    assert np.array_equal(metrics.judge(TRUE, WRONG, span=span).nrmse, metrics.nrmse(TRUE, WRONG, span=span))
    one = metrics.judge(true, wrong, channels=[1], range_over="trajectory")  # it diverged in the other one
    per_trajectory = metrics.nrmse(TRUE[..., 1:], WRONG[..., 1:], range_over="trajectory")
    assert one.diverged == 1 and np.array_equal(one.nrmse, per_trajectory)
    assert np.array_equal(one.enr, metrics.enr(TRUE[..., 1:], WRONG[..., 1:]))
    unequal = [TRUE[0], np.concatenate([TRUE[1], TRUE[1]])], [WRONG[0], np.concatenate([WRONG[1], WRONG[1]])]
    assert np.array_equal(metrics.judge(*unequal).nrmse, metrics.nrmse(*unequal))


def test_the_judge_has_no_number_where_nothing_is_left_or_nothing_moves():
    gone = metrics.judge(TRUE, np.full_like(TRUE, np.nan))
    assert (gone.windows, gone.diverged) == (2, 2) and np.isnan([gone.enr, gone.bfr, gone.nrmse]).all()
    still = metrics.judge(TRUE * [1, 0], TRUE * [1, 0])
    numbers, expected = [still.enr, still.bfr, still.nrmse], [[0, np.nan], [100, np.nan], [0, np.nan]]
    assert still.diverged == 0 and np.array_equal(numbers, expected, equal_nan=True)
    level = metrics.judge(TRUE * [1, 0] + [0, 2], TRUE * [1, 0] + [0, 1])
    assert level.enr[1] == 0.5 and np.isnan([level.bfr[1], level.nrmse[1]]).all()


METRICS = [
    metrics.enr, metrics.bfr, metrics.nrmse, metrics.diverged, metrics.judge,
    lambda t, p: metrics.nrmse(t, p, range_over="trajectory"),
]  # fmt: skip


@pytest.mark.parametrize("metric", METRICS)
@pytest.mark.parametrize(
    "true, predicted, words",
    [
        (np.ones((2, 10, 3)), np.ones((2, 10, 1)), "different shapes .2 of .10, 3. and 2 of .10, 1.."),
        (np.ones((2, 10, 3)), np.ones((1, 10, 3)), "different shapes"),
        ([np.ones((4, 1))] * 2, [np.ones((4, 1))], "different shapes"),
        (
            [np.ones((4, 1)), np.ones((4, 2))],
            [np.ones((4, 1))] * 2,
            "true holds trajectories .* unequal numbers of channels",
        ),
        ([np.ones((4, 1))], [np.ones((4, 1)), np.ones(4)], "predicted is no set of trajectories"),
        ([], [], "true has shape .0,.: it holds no sample"),
        (np.ones((0, 10, 3)), np.ones((0, 10, 3)), "true has shape .0, 10, 3.: it holds no sample"),
        ([[[1.0], [np.nan]]], [[[1.0], [1.0]]], "true is nan in trajectory 0 at sample 1, channel 0"),
    ],
)
def test_shapes_are_checked_everywhere(metric, true, predicted, words):
    with pytest.raises(ValueError, match=words):
        metric(true, predicted)


@pytest.mark.parametrize(
    "call, words",
    [
        (lambda: metrics.nrmse(TRUE, TRUE[:1]), "different shapes"),
        (lambda: metrics.nrmse(np.zeros((3, 1)), np.zeros((3, 1))), "channel 0: the truth is constant"),
        (lambda: metrics.enr(np.zeros((3, 1)), np.zeros((3, 1))), "channel 0: the truth is zero"),
        (lambda: metrics.nrmse(np.zeros(3), np.zeros(3)), "no set of trajectories"),
        (lambda: metrics.nrmse(TRUE, TRUE, span=[1.0]), "span is .1.0.; give one finite range for each of the 2"),
        (lambda: metrics.nrmse(TRUE, TRUE, span=[1.0, 0.0]), "channel 1: the span is zero"),
        (lambda: metrics.diverged(TRUE, TRUE, span=[1.0, np.nan]), "span is .1.0, nan."),
        (lambda: metrics.nrmse(TRUE, TRUE, range_over="trajectory", span=[1.0, 1.0]), "give one of the two"),
        (
            lambda: metrics.nrmse(TRUE, TRUE, range_over="trajectory"),
            "channel 0: the truth of trajectory 1 is constant",
        ),
        (lambda: metrics.nrmse(TRUE, TRUE, range_over="window"), "range_over is 'window'"),
        (lambda: metrics.judge(TRUE, TRUE, range_over="window"), "range_over is 'window'"),
        (lambda: metrics.judge(TRUE, TRUE, span=[1.0]), "span is .1.0.; give one finite range for each of the 2"),
    ],
)
def test_mistakes_are_named(call, words):
    with pytest.raises(ValueError, match=words):
        call()
