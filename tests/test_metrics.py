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
    assert np.allclose(metrics.enr(TRUE, TRUE), 0) and np.allclose(metrics.bfr(TRUE, TRUE), 100) and np.allclose(metrics.nrmse(TRUE, TRUE), 0)
    mean = np.broadcast_to(TRUE.mean(axis=(0, 1)), TRUE.shape)
    assert np.allclose(metrics.bfr(TRUE, mean), 0)  # no better than the mean
    assert np.allclose(metrics.bfr(TRUE, -10 * TRUE), 0)  # never below zero


def test_better_models_score_higher_on_the_repaired_bfr():
    errors = np.linspace(0.1, 0.9, 5)
    repaired = [metrics.bfr(TRUE, TRUE + e)[0] for e in errors]
    assert np.all(np.diff(repaired) < 0)


def test_lists_of_unequal_length_count_every_sample():
    true, wrong = [np.zeros((2, 1)), np.array([[0.0], [4.0], [0.0]])], [np.ones((2, 1)), np.array([[0.0], [4.0], [0.0]])]
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


@pytest.mark.parametrize(
    "call, words",
    [
        (lambda: metrics.nrmse(TRUE, TRUE[:1]), "different shapes"),
        (lambda: metrics.nrmse(np.zeros((3, 1)), np.zeros((3, 1))), "channel 0: the truth is constant"),
        (lambda: metrics.enr(np.zeros((3, 1)), np.zeros((3, 1))), "channel 0: the truth is zero"),
        (lambda: metrics.nrmse(np.zeros(3), np.zeros(3)), "no set of trajectories"),
        (lambda: metrics.nrmse(TRUE, TRUE, range_over="window"), "range_over is 'window'"),
    ],
)
def test_mistakes_are_named(call, words):
    with pytest.raises(ValueError, match=words):
        call()
