"""Regularised coefficients against dense formulae, limits, and what they must not depend on."""

import numpy as np
import pytest
from scipy import linalg

import tras
from tras.regularization import METHODS, STRENGTHS, regularized
from tras.solver.least_squares import least_squares

HEAD = 4


@pytest.fixture(scope="module")
def problem():
    """1000 rows, 12 columns of condition 1e3, 3 targets with a little noise."""
    rng = np.random.default_rng(0)
    X = rng.normal(size=(1000, 12)) @ (np.eye(12) + 0.4 * rng.normal(size=(12, 12)))
    X[:, 11] = X[:, 10] + 1e-2 * X[:, 11]
    return X, X @ rng.normal(size=(12, 3)) + 0.1 * rng.normal(size=(1000, 3))


def solution(method, X, Y, strength):
    fit = least_squares([(X, Y)])
    return regularized(method, fit.R, fit.rotated, HEAD)(strength)


def close(a, b, tolerance=1e-10):
    return np.abs(a - b).max() <= tolerance * np.abs(b).max()


@pytest.mark.parametrize("method", METHODS)
def test_strength_zero_is_plain_least_squares(method, problem):
    X, Y = problem
    assert close(solution(method, X, Y, 0.0), np.linalg.lstsq(X, Y, rcond=None)[0])


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("strength", [s for s in STRENGTHS if s])
def test_neither_units_nor_the_number_of_samples_matter(method, strength, problem):
    X, Y = problem
    K = solution(method, X, Y, strength)
    columns, targets = np.geomspace(1e-6, 1e6, 12), np.array([1e-5, 1.0, 1e5])
    assert close(solution(method, X * columns, Y * targets, strength) * columns[:, None] / targets, K, 1e-8)
    assert close(solution(method, np.vstack([X, X]), np.vstack([Y, Y]), strength), K, 1e-8)
    assert close(solution(method, X[::-1], Y[::-1], strength), K, 1e-8)


def test_strong_shrinking_leaves_the_linear_model(problem):
    X, Y = problem
    K = solution("shrink", X, Y, 1e8)
    assert np.abs(K[HEAD:]).max() <= 1e-12
    assert close(K[:HEAD], np.linalg.lstsq(X[:, :HEAD], Y, rcond=None)[0])


@pytest.mark.parametrize("strength", [1e-3, 0.1, 1.0])
def test_shrink_is_tikhonov_on_what_the_head_does_not_explain(strength, problem):
    """By projection: the tail minus its part in the span of the head, its columns of length one, penalised."""
    X, Y = problem
    head, tail = X[:, :HEAD], X[:, HEAD:]
    Q = np.linalg.qr(head)[0]
    rest = tail - Q @ (Q.T @ tail)
    lengths = np.linalg.norm(rest, axis=0)
    unit = rest / lengths
    penalty = (strength * np.linalg.norm(unit, 2)) ** 2
    D2 = np.linalg.solve(unit.T @ unit + penalty * np.eye(8), unit.T @ Y) / lengths[:, None]
    D1 = np.linalg.lstsq(head, Y - tail @ D2, rcond=None)[0]
    assert close(solution("shrink", X, Y, strength), np.vstack([D1, D2]), 1e-9)


def test_shrink_with_nothing_but_a_head_is_plain(problem):
    X, Y = problem
    fit = least_squares([(X, Y)])
    assert close(regularized("shrink", fit.R, fit.rotated, 12)(1.0), fit.coefficients, 1e-12)


@pytest.mark.parametrize("strength", [1e-4, 1e-2, 1.0])
def test_tikhonov_against_the_stacked_problem(strength, problem):
    X, Y = problem
    lengths = np.linalg.norm(X, axis=0)
    weight = strength * np.linalg.norm(X / lengths, 2)
    stacked = np.vstack([X, weight * np.diag(lengths)])
    dense = np.linalg.lstsq(stacked, np.vstack([Y, np.zeros((12, 3))]), rcond=None)[0]
    assert close(solution("tikhonov", X, Y, strength), dense)


@pytest.mark.parametrize("strength", [1e-4, 1e-2, 0.3, 1.0])
def test_truncated_against_the_pseudoinverse(strength, problem):
    X, Y = problem
    lengths = np.linalg.norm(X, axis=0)
    K = solution("truncated", X, Y, strength)
    if strength == 1.0:  # nothing is above the largest itself
        assert not K.any()
    else:
        assert close(K, linalg.pinv(X / lengths, rtol=strength) @ Y / lengths[:, None])


def test_more_strength_is_less_solution(problem):
    X, Y = problem
    lengths = np.linalg.norm(X, axis=0)[:, None]
    for method in ("tikhonov", "truncated"):
        sizes = [np.linalg.norm(lengths * solution(method, X, Y, s)) for s in (0, 1e-4, 1e-3, 1e-2, 0.1, 1.0)]
        assert sizes == sorted(sizes, reverse=True) and sizes[-1] < sizes[0] / 2
    counts = [np.count_nonzero(solution("sparse", X, Y, s)) for s in (0, 1e-3, 0.1, 0.5, 10.0)]
    assert counts == sorted(counts, reverse=True) and counts[0] == 36 and counts[-1] == 0


def test_sparse_finds_a_planted_sparse_matrix_exactly():
    rng = np.random.default_rng(2)
    X = rng.uniform(-1, 1, (2000, 20)) * np.geomspace(1, 1e4, 20)
    planted = (
        np.where(rng.random((20, 6)) < 0.2, rng.choice([-1.0, 1.0, 2.0], (20, 6)), 0.0)
        / np.geomspace(1, 1e4, 20)[:, None]
    )
    planted[:, 5] = 0
    noise = 1e-3 * rng.normal(size=(2000, 6))
    plain, sparse = solution("sparse", X, X @ planted + noise, 0.0), solution("sparse", X, X @ planted + noise, 0.05)
    assert np.all(plain[:, :5] != 0)
    assert np.array_equal(sparse[:, :5] != 0, planted[:, :5] != 0)
    # Without noise also to the last digits, since what is kept is fitted anew.
    assert (
        np.abs((solution("sparse", X, X @ planted, 0.05) - planted) * np.geomspace(1, 1e4, 20)[:, None]).max() <= 1e-12
    )


def test_sparse_model_is_the_system_that_made_the_data():
    """x+ = 0.9 x + 0.1 y^2, y+ = 0.7 y + u, from 10 monomials: K - I has 4 numbers in the states' columns."""
    rng = np.random.default_rng(0)
    u, x = rng.uniform(-1, 1, (20, 31, 1)), np.zeros((20, 31, 2))
    x[:, 0] = rng.uniform(-1, 1, (20, 2))
    for k in range(30):
        x[:, k + 1, 0] = 0.9 * x[:, k, 0] + 0.1 * x[:, k, 1] ** 2
        x[:, k + 1, 1] = 0.7 * x[:, k, 1] + u[:, k, 0]
    recording = tras.Recording(x, u, 1.0)
    model = tras.KoopmanModel(tras.Monomials(2), "one_step", regularization="sparse", strength=1e-3).fit(recording)
    change = (model.koopman_matrix - np.eye(10))[:, 1:3]
    nonzero = {(model.names_[i], j) for i, j in np.argwhere(change)}
    # Constants and y come with it: scaling moves the middle of each channel.
    assert {("x1", 0), ("x2^2", 0), ("x2", 1), ("u1", 1)} <= nonzero
    assert nonzero <= {("1", 0), ("x1", 0), ("x2", 0), ("x2^2", 0), ("1", 1), ("x2", 1), ("u1", 1)}
    assert np.abs(model.predict(recording) - x).max() <= 1e-10


@pytest.mark.parametrize("method", METHODS)
def test_every_method_serves_a_model(method, experiment):
    recording = experiment.select(inputs=["u_phi", "u_psi"])
    model = tras.KoopmanModel(tras.Monomials(2), "one_step", regularization=method).fit(recording)
    assert set(model.errors_) == set(STRENGTHS) and model.strength_ == min(model.errors_, key=model.errors_.get)
    assert f"regularization {method}, strength {model.strength_:g}, chosen among 7" in model.report()
    assert -13 < model.score(recording) < 0
