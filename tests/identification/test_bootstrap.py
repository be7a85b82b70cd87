"""The bootstrap band: coverage on a system whose noise is known, the same bits from the same seed."""

import numpy as np
import pytest

import tras
from tras import KoopmanModel, Monomials, Recording

A, B = np.array([[0.95, 0.1], [-0.15, 0.9]]), np.array([[0.0], [0.1]])


def noisy(seed, trajectories=20, samples=40, noise=0.05):
    """x+ = A x + B u + noise: least squares is consistent here, so all error is the data's."""
    rng = np.random.default_rng(seed)
    u, x = rng.uniform(-1, 1, (trajectories, samples, 1)), np.zeros((trajectories, samples, 2))
    x[:, 0] = rng.uniform(-1, 1, (trajectories, 2))
    for k in range(samples - 1):
        x[:, k + 1] = x[:, k] @ A.T + u[:, k] @ B.T + noise * rng.standard_normal((trajectories, 2))
    return Recording(x, u, 0.1)


def fitted(recording):
    return KoopmanModel(Monomials(1), "one_step", regularization=None).fit(recording)


@pytest.mark.slow
def test_coverage_is_what_was_asked_for():
    """Of forty recordings of the same system, the bands hold the exact trajectory about as often as they say.

    One recording's coverage scatters by 0.2 (its errors are the same for all instants), so the mean of forty by 0.03;
    twenty trajectories make percentile intervals a few percent too narrow (Efron and Tibshirani, 1993, Ch. 14).
    """
    exact = noisy(99, 4, 30, noise=0.0)
    inside = {0.5: [], 0.9: []}
    for seed in range(40):
        recording = noisy(seed)
        ensemble = tras.bootstrap(fitted(recording), recording, 30, rng=seed)
        for level, found in inside.items():
            lower, median, upper = tras.prediction_band(ensemble, exact, level)
            assert (lower <= median).all() and (median <= upper).all()
            found.append(np.mean(((lower <= exact.states) & (exact.states <= upper))[:, 1:]))
    assert 0.80 <= np.mean(inside[0.9]) <= 0.95
    assert 0.38 <= np.mean(inside[0.5]) <= 0.56


def test_more_data_make_the_band_narrower_as_the_root_of_their_number():
    exact = noisy(99, 4, 30, noise=0.0)
    widths = []
    for trajectories in (20, 320):
        recording = noisy(1, trajectories)
        lower, _, upper = tras.prediction_band(tras.bootstrap(fitted(recording), recording, 40, rng=0), exact)
        widths.append(np.mean(upper - lower))
    assert widths[0] / widths[1] == pytest.approx(4, rel=0.35)


def test_the_same_seed_gives_the_same_bits_whatever_the_processes():
    recording = noisy(0)
    model, exact = fitted(recording), noisy(99, 2, 10, noise=0.0)
    bands = [
        tras.prediction_band(tras.bootstrap(model, recording, 12, rng=rng, processes=processes), exact)
        for rng, processes in ((3, 1), (np.random.default_rng(3), 2), (4, 1))
    ]
    assert all(np.array_equal(a, b) for a, b in zip(bands[0], bands[1]))
    assert not np.array_equal(bands[0][0], bands[2][0])


def test_members_keep_the_strength_and_the_model_stays():
    recording = noisy(0)
    model = KoopmanModel(Monomials(2), "one_step").fit(recording)
    before = model.koopman_matrix.copy()
    ensemble = tras.bootstrap(model, recording, 3)
    assert {member.strength_ for member in ensemble} == {model.strength_}
    assert np.array_equal(before, model.koopman_matrix) and model.strength == "auto"
    assert not any(np.array_equal(member.koopman_matrix, before) for member in ensemble)


def test_unequal_lengths_and_members_that_run_away():
    recording = noisy(0)
    model = fitted(recording)
    ensemble = tras.bootstrap(model, recording, 10)
    two = Recording(
        [x[:k] for (x, _), k in zip(recording[[0, 1]], (30, 20))],
        [u[:k] for (_, u), k in zip(recording[[0, 1]], (30, 20))],
        0.1,
    )
    lower, median, upper = tras.prediction_band(ensemble, two)
    assert [len(x) for x in median] == [30, 20]
    ensemble[0].koopman_matrix = 20.0 * ensemble[0].koopman_matrix
    lower, median, upper = tras.prediction_band(ensemble, two, 0.95)
    assert (
        np.isinf(np.concatenate(lower)).any()
        and np.isfinite(np.concatenate(median)).all()
        and not np.isnan(np.concatenate(upper)).any()
    )


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda m, r: tras.bootstrap(m, r[:9]), "recording has 9 trajectories"),
        (lambda m, r: tras.bootstrap(m, r, 1), "draws is 1"),
        (lambda m, r: tras.bootstrap(m, r, 2.5), "draws is 2.5"),
        (lambda m, r: tras.bootstrap(m, r, 5, rng="a"), "rng is 'a'"),
        (lambda m, r: tras.bootstrap(KoopmanModel(Monomials(1)), r), "not fitted"),
        (lambda m, r: tras.prediction_band([], r), "ensemble is empty"),
        (lambda m, r: tras.prediction_band([m], r, 1.0), "level is 1.0"),
    ],
)
def test_mistakes_are_named(call, words):
    recording = noisy(0)
    with pytest.raises(ValueError, match=words):
        call(fitted(recording), recording)


def test_a_recording_that_hangs_on_one_trajectory_is_said():
    recording = noisy(0, 10)
    states = [x.copy() for x, _ in recording]
    inputs = [u if k == 0 else np.zeros_like(u) for k, (_, u) in enumerate(recording)]
    hanging = Recording(states, inputs, 0.1)
    with pytest.raises(ValueError, match="of the bootstrap cannot be identified"):
        tras.bootstrap(fitted(hanging), hanging, 30)
