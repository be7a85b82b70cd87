"""Gusts against the spectra and correlations of Dryden's model."""

import math

import numpy as np
import pytest
from scipy.signal import welch

import tras


def test_spectra():
    """One-sided, per Hz: about pitch 4 T s^2 / (1 + (w T)^2), about yaw 2 T s^2 (1 + 3 (w T)^2) / (1 + (w T)^2)^2."""
    T, rms = 0.5, (0.02, 0.01)
    torque = tras.gusts(1500, 0.01, rms, T, 0)
    frequency, density = welch(torque.T, fs=100, nperseg=2048)
    w = 2 * math.pi * frequency * T
    expected = np.array([4 * T / (1 + w**2), 2 * T * (1 + 3 * w**2) / (1 + w**2) ** 2]) * np.square(rms)[:, None]
    band = (frequency > 0.05) & (frequency < 3)
    assert np.allclose((density / expected)[:, band].mean(axis=1), 1, atol=0.05)
    assert np.abs(np.log(density / expected)[:, band]).max() < 0.6


def test_variance_from_the_first_sample():
    values = np.array([tras.gusts(0.02, 0.01, (2.0, 3.0), 1.0, seed) for seed in range(2000)])
    assert np.allclose(values.std(axis=0), [2.0, 3.0], rtol=0.08)
    lag = np.mean(values[:, 0] * values[:, 2], axis=0) / [4, 9]
    assert np.allclose(lag, [math.exp(-0.02), math.exp(-0.02) * (1 - 0.01)], atol=0.06)


def test_correlation():
    """exp(-t / T) about pitch and exp(-t / T) (1 - t / 2T) about yaw."""
    torque = tras.gusts(12000, 0.1, (1.0, 1.0), 1.0, 3)
    for lag in (5, 10, 20):
        measured = (torque[lag:] * torque[:-lag]).mean(axis=0)
        t = 0.1 * lag
        assert np.allclose(measured, [math.exp(-t), math.exp(-t) * (1 - t / 2)], atol=0.04)
    assert abs(np.corrcoef(torque.T)[0, 1]) < 0.03


def test_a_seed_gives_them_again():
    first, again = (tras.gusts(10, 0.01, (0.01, 0.01), 1.0, 5) for _ in range(2))
    assert np.array_equal(first, again) and first.shape == (1001, 2)
    assert not np.any(tras.gusts(1, 0.1, (0.0, 0.0), 1.0, 0))


@pytest.mark.parametrize(
    "arguments, words",
    [
        ((0, 0.01, (1, 1), 1.0, 0), "duration is 0"),
        ((1, 0.01, (1, -1), 1.0, 0), "rms is -1"),
        ((1, 0.01, (1, 1), 0.0, 0), "time_constant is 0.0"),
        ((1, 0.01, (1, 1), 1000.0, 0), "give at most 100 s"),
        ((0.001, 0.01, (1, 1), 1.0, 0), "duration is 0.001 s; give at least one"),
        ((1, 0.01, (1, 1), 1.0, "a"), "rng is 'a'"),
    ],
)
def test_mistakes_are_named(arguments, words):
    with pytest.raises(ValueError, match=words):
        tras.gusts(*arguments)
