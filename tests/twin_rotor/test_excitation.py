"""References: ranges, band, crest factor and correlation as the paper asks; what validation adds."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import tras
from tras.twin_rotor.excitation import multisine_lines


@pytest.fixture(scope="module")
def papers_pair():
    return tras.multisine(500, 0.01, [0.2, 0.8], [1.22173, np.pi], np.random.default_rng(1))


def test_the_papers_multisines(papers_pair):
    r = papers_pair
    assert r.shape == (50001, 2)
    assert np.array_equal(r[0], r[-1])
    assert np.allclose(np.abs(r).max(axis=0), [1.22173, np.pi], rtol=1e-12)
    assert np.abs(r[:-1].mean(axis=0)).max() < 1e-12
    assert abs(np.corrcoef(r[:-1].T)[0, 1]) <= 0.05


def test_flat_lines_inside_the_band_and_nothing_else(papers_pair):
    amplitude = np.abs(np.fft.rfft(papers_pair[:-1], axis=0)) / 25000
    for channel, lines in zip(amplitude.T, (15, 63)):
        assert np.allclose(channel[1 : lines + 1], channel[1], rtol=1e-9)
        assert np.abs(np.delete(channel, range(1, lines + 1))).max() < 1e-12
    assert (multisine_lines(500, 0.01, 0.2), multisine_lines(500, 0.01, 0.8)) == (15, 63)


def test_crest_factor_is_chosen_not_drawn(papers_pair):
    crest = np.abs(papers_pair).max(axis=0) / papers_pair.std(axis=0)
    single = tras.multisine(500, 0.01, [0.2, 0.8], [1, 1], np.random.default_rng(1), draws=1, max_correlation=1)
    assert np.all(crest < np.abs(single).max(axis=0) / single.std(axis=0))
    assert np.all(crest < [2.0, 2.6])


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.floats(1.0, 3.0), st.integers(1, 3))
def test_any_seed_keeps_the_promises(seed, top, channels):
    peak = np.linspace(0.5, 2, channels)
    r = tras.multisine(50, 0.05, [top] * channels, peak, np.random.default_rng(seed))
    assert r.shape == (1001, channels)
    assert np.allclose(np.abs(r).max(axis=0), peak, rtol=1e-12)
    correlation = np.atleast_2d(np.corrcoef(r[:-1].T)) - np.eye(channels)
    assert np.abs(correlation).max() <= 0.05 + 1e-9
    assert np.array_equal(r, tras.multisine(50, 0.05, [top] * channels, peak, np.random.default_rng(seed)))


def test_steps_hold_their_levels():
    r = tras.steps(100, 0.01, [0.9, 2.5], np.random.default_rng(3), shortest=4, longest=10)
    assert r.shape == (10001, 2) and np.all(np.abs(r).max(axis=0) <= [0.9, 2.5])
    for channel in r.T:
        changes = np.flatnonzero(np.diff(channel))
        assert 9 <= len(changes) <= 25
        assert np.all(np.diff(changes) >= 400 - 1) and np.all(np.diff(changes) <= 1000 + 1)


def test_chirp_sweeps_to_its_top_frequency():
    t = np.arange(10001) * 0.01
    r = tras.chirp(100, 0.01, [0.6, 1.6], [0.6, 2.0])
    assert np.allclose(r, np.column_stack([0.6 * np.sin(0.003 * t**2), 2.0 * np.cos(0.008 * t**2)]))


def test_a_seed_does_as_well_as_a_generator():
    for make in (lambda rng: tras.multisine(50, 0.05, [1.0], [1.0], rng), lambda rng: tras.steps(50, 0.05, [1.0], rng)):
        assert np.array_equal(make(7), make(np.random.default_rng(7)))


RNG = np.random.default_rng(0)


@pytest.mark.parametrize(
    "call, words",
    [
        (lambda: tras.multisine(500, 0.01, [0.01], [1], RNG), "below the first line"),
        (lambda: tras.multisine(500, 0.01, [400], [1], RNG), "not below pi / dt"),
        (lambda: tras.multisine(500, 0.03, [0.8], [1], RNG), "whole number of samples"),
        (lambda: tras.multisine(500, 0, [0.8], [1], RNG), "dt is 0"),
        (lambda: tras.multisine(1e300, 0.01, [0.8], [1], RNG), "duration = 1e.300 s at dt = 0.01 s is 1e.302 samples"),
        (lambda: tras.steps(1e9, 0.01, [1], RNG), "1e.11 samples, more than 1e.08; give a shorter duration, or"),
        (lambda: tras.chirp(500, 1e-300, [1], [1]), "5e.302 samples"),
        (lambda: tras.multisine(1e5, 0.01, [80], [1], RNG), "1000 draws of 1273239 lines are 1e.10 numbers"),
        (lambda: tras.example("duffing", duration=1e12), "duration = 1e.12 s at dt = .* samples, more than 1e.08"),
        (lambda: tras.multisine(500, 0.01, [0.8], [1, 2], RNG), "1 channels but peak has 2"),
        (
            lambda: tras.multisine(50, 0.01, [0.2, 0.2], [1, 1], RNG, max_correlation=1e-9, draws=3),
            "none of 3 draws of channel 1",
        ),
        (lambda: tras.multisine(500, 0.01, [0.8], [1], "one"), "rng is 'one'; give a numpy.random.Generator or a seed"),
        (lambda: tras.steps(100, 0.01, [1], -1), "rng is -1"),
        (lambda: tras.steps(100, 0.01, [1], RNG, shortest=5, longest=4), "shortest = 5"),
    ],
)
def test_mistakes_are_named(call, words):
    with pytest.raises(ValueError, match=words):
        call()
