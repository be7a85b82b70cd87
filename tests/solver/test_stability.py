"""The stable least-squares problem against brute force, its own constraint, and closed-loop data."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import linalg, optimize

import tras
from tras.solver.stability import spectral_radius, stable_change, stable_least_squares


def problem(seed, *, N=None, m=None, constant=True):
    """(R, free, N) of an almost stable system: correlated regressors of unequal size, A near a rotation, plus noise."""
    rng = np.random.default_rng(seed)
    N = int(rng.integers(1, 13)) + constant if N is None else N
    m = int(rng.integers(0, 4)) if m is None else m
    regressors = rng.normal(size=(5 * (N + m), N + m)) @ (np.eye(N + m) + 0.5 * rng.normal(size=(N + m, N + m)))
    regressors *= 10.0 ** rng.uniform(-1, 1, N + m)
    if constant:
        regressors[:, 0] = 1
    free = np.vstack(
        [np.linalg.qr(rng.normal(size=(N, N)))[0] + 0.05 * rng.normal(size=(N, N)), rng.normal(size=(m, N))]
    )
    free[:N] *= rng.uniform(1.01, 1.1) / spectral_radius(inner(free, constant))
    if constant:
        free[:, 0] = np.arange(N + m) == 0
        free[1:, 0] = 1e-12  # as rounding leaves it
    return np.linalg.qr(regressors, mode="r"), free, N


def inner(coefficients, constant):
    """A without the constant's row and column."""
    c = int(constant)
    return coefficients[c : coefficients.shape[1], c:].T


def excess_cost(R, free, coefficients):
    """Each target's sum of squared residuals less that of the least-squares solution ``free``, (targets,)."""
    return np.sum((R @ (coefficients - free)) ** 2, axis=0)


def clipped_cost(R, free, constant, radius):
    """Excess cost of the free A with its eigenvalues drawn back to the circle, B refitted by least squares."""
    c, N = int(constant), free.shape[1]
    w, V = np.linalg.eig(inner(free, constant))
    A = np.real(V * (w * np.minimum(1, radius / np.maximum(np.abs(w), 1e-300))) @ np.linalg.inv(V))
    move = R[:, c:N] @ (A - inner(free, constant)).T
    rest = R[:, np.r_[:c, N : len(R)]]
    return np.sum((move - rest @ np.linalg.lstsq(rest, move, rcond=None)[0]) ** 2)


@pytest.mark.parametrize("constant", [True, False])
@pytest.mark.parametrize("radius", [1.0, 0.9])
@pytest.mark.slow
def test_constraint_holds_and_costs_less_than_clipping(constant, radius):
    ratios = []
    for seed in range(30):
        R, free, N = problem(seed, constant=constant)
        X = stable_least_squares(R, free, constant=constant, radius=radius)
        whole = X[:N].T
        assert max(spectral_radius(inner(X, constant)), spectral_radius(inner(X, constant).T)) <= radius
        limit = max(1.0, radius) if constant else radius
        assert max(spectral_radius(whole), spectral_radius(whole.T)) <= limit + 1e-10
        cost, clipped = excess_cost(R, free, X).sum(), clipped_cost(R, free, constant, radius)
        assert 0 < cost <= clipped * (1 + 1e-9)
        # Excess cost is indeed the sum of squares over that of the free solution: against targets off the range of the
        # regressors.
        Q = np.linalg.qr(np.random.default_rng(seed).normal(size=(3 * len(R), len(R) + N)))[0]
        regressors = Q[:, : len(R)] @ R
        targets = regressors @ free + Q[:, len(R) :]
        misfit = np.sum((targets - regressors @ X) ** 2) - np.sum((targets - regressors @ free) ** 2)
        assert misfit == pytest.approx(cost, rel=1e-6, abs=1e-9)
        if constant:
            assert np.array_equal(X[:, 0], np.arange(len(R)) == 0)
        ratios.append(cost / clipped)
    assert np.median(ratios) < 0.2


def test_b_is_the_best_for_its_a():
    R, free, N = problem(3, N=6, m=2)
    X = stable_least_squares(R, free)
    assert np.abs(X - free).max() > 1e-3
    rest = R[:, [0, 6, 7]]  # the constant and the inputs
    assert np.abs(rest.T @ R @ (X - free)).max() < 1e-9 * np.abs(rest.T @ R @ free).max()


def test_a_stable_problem_is_left_alone():
    R, free, N = problem(0, N=8, m=2)
    free[1:8, 1:] *= 0.9 / spectral_radius(inner(free, True))
    assert stable_least_squares(R, free) is free
    assert stable_least_squares(R, free, radius=0.8) is not free


def test_same_bytes_again_and_iterations_never_hurt():
    R, free, _ = problem(5, N=10, m=2)
    costs = [excess_cost(R, free, stable_least_squares(R, free, iterations=k)).sum() for k in (0, 20, 200)]
    assert costs[0] >= costs[1] >= costs[2]
    assert np.array_equal(stable_least_squares(R, free), stable_least_squares(R, free))


@pytest.mark.parametrize("seed", range(4))
def test_units_of_the_inputs_do_not_matter(seed):
    """Nor does it matter which R of the same Gram matrix is given."""
    R, free, N = problem(seed, N=7, m=3)
    X = stable_least_squares(R, free)
    units = np.r_[np.ones(N), 1e3, 1e-4, 7.0]
    Y = stable_least_squares(R * units, free / units[:, None])
    assert np.allclose(Y[:N], X[:N], atol=1e-6) and np.allclose(Y * units[:, None], X, atol=1e-5 * np.abs(X).max())
    turned = np.linalg.qr(np.random.default_rng(seed).normal(size=R.shape))[0] @ R
    assert np.allclose(stable_least_squares(turned, free), X, atol=1e-5 * np.abs(X).max())


def test_no_small_feasible_change_is_much_better():
    """Changes of S and of M, which reach every stable matrix around ``A = S^-1 M S``."""
    rng = np.random.default_rng(0)
    for seed in range(6):
        R, free, N = problem(seed, N=4, m=0, constant=False)
        A = inner(stable_least_squares(R, free, constant=False, iterations=2000), False)
        cost = np.sum((R @ (A.T - free)) ** 2)
        S = linalg.sqrtm(linalg.solve_discrete_lyapunov((A * (1 - 1e-9)).T, np.eye(N))).real
        S /= np.linalg.norm(S)
        M = S @ A @ np.linalg.inv(S)
        assert np.linalg.norm(M, 2) <= 1 + 1e-6
        for _ in range(400):
            size = 10.0 ** rng.uniform(-6, -1)
            U, s, V = np.linalg.svd(M + size * rng.normal(size=(N, N)))
            T = S + size * np.linalg.svd(S, compute_uv=False)[-1] * rng.normal(size=(N, N))
            other = np.linalg.solve(T, (U * np.minimum(s, 1)) @ V @ T)
            assert spectral_radius(other) <= 1 + 1e-9
            assert np.sum((R @ (other.T - free)) ** 2) >= 0.98 * cost


def test_regressors_too_dependent_for_their_own_coordinates():
    """Condition numbers of 1e5 to 1e12 with coefficients that no such data have: still no worse than clipping."""
    for seed in range(12):
        rng = np.random.default_rng(seed)
        R, free = np.triu(rng.normal(size=(12, 12))) * 10.0 ** rng.uniform(-3, 3, 12), rng.normal(size=(12, 12))
        X = stable_least_squares(R, free, constant=False)
        assert spectral_radius(X.T) <= 1
        assert excess_cost(R, free, X).sum() <= clipped_cost(R, free, False, 1.0) * (1 + 1e-6)


def nearest_2x2(F, W, starts=8):
    """Local searches from many points: a real 2 x 2 matrix is stable iff ``|det| <= 1`` and ``|trace| <= 1 + det``."""
    rng = np.random.default_rng(0)
    limits = [lambda a: 1 - det(a), lambda a: 1 + det(a) - a[0] - a[3], lambda a: 1 + det(a) + a[0] + a[3]]
    costs = []
    for k in range(starts):
        search = optimize.minimize(
            lambda a: np.sum(((a.reshape(2, 2) - F) @ W) ** 2), F.ravel() + 0.5 * (k > 0) * rng.normal(size=4),
            method="SLSQP", constraints=[{"type": "ineq", "fun": limit} for limit in limits],
            options={"ftol": 1e-12, "maxiter": 300},
        )  # fmt: skip
        if search.success and spectral_radius(search.x.reshape(2, 2)) < 1 + 1e-5:
            costs.append(search.fun)
    return min(costs)


def det(a):
    return a[0] * a[3] - a[1] * a[2]


@pytest.mark.slow
def test_against_brute_force_over_all_2x2_matrices():
    ratios = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        W = np.linalg.qr(rng.normal(size=(6, 2)), mode="r").T if seed % 2 else np.eye(2)
        F = rng.normal(size=(2, 2))
        F *= rng.uniform(1.02, 1.5) / spectral_radius(F)
        X = stable_least_squares(W.T, F.T, constant=False)
        ratios.append(excess_cost(W.T, F.T, X).sum() / nearest_2x2(F, W))
    assert min(ratios) > 1 - 1e-4  # the search itself is good to that
    assert np.median(ratios) < 1 + 1e-4 and np.quantile(ratios, 0.9) < 1.05 and max(ratios) < 2


def test_symmetric_matrices_have_a_known_nearest_one():
    """In the Frobenius norm the nearest to a symmetric matrix is itself with its eigenvalues drawn back."""
    rng = np.random.default_rng(2)
    Q = np.linalg.qr(rng.normal(size=(5, 5)))[0]
    w = np.array([1.4, 1.1, 0.5, -0.2, -1.2])
    A = stable_least_squares(np.eye(5), (Q * w) @ Q.T, constant=False)
    assert np.allclose(A, (Q * np.clip(w, -1, 1)) @ Q.T, atol=1e-5)
    assert stable_least_squares(np.eye(1), [[-3.0]], constant=False) == pytest.approx(-1, abs=1e-6)


def test_defective_and_dependent_problems_stay_within_the_circle():
    jordan = 1.1 * np.eye(6) + np.diag(np.ones(5), 1)
    X = stable_least_squares(np.eye(6), jordan, constant=False)
    assert spectral_radius(X.T) <= 1 and np.sum((X - jordan) ** 2) <= np.sum((jordan / 11) ** 2) * (1 + 1e-9)
    R, free, N = problem(1, N=6, m=2)
    for dependent in (
        R[:, 4] + R[:, 3],
        np.zeros(8),
    ):  # a function that is the sum of two others, or nothing over the data
        R[:, 5] = dependent
        X = stable_least_squares(R, free)
        assert np.isfinite(X).all() and spectral_radius(X[:6].T) <= 1 + 1e-10


@pytest.fixture(scope="module")
def lifted(experiment):
    """Closed-loop data, torques as inputs, scaled to [-1, 1]: (first lifted state, all inputs, R, D of the fit)."""
    recording = experiment.select(inputs=["u_phi", "u_psi"])
    x, u = (np.concatenate(part) for part in zip(*recording))
    middle, half = [(a.max(0) + a.min(0)) / 2 for a in (x, u)], [(a.max(0) - a.min(0)) / 2 for a in (x, u)]
    parts = [((a - middle[0]) / half[0], (b - middle[1]) / half[1]) for a, b in recording]
    psi = tras.GaussianRBF(28).fit(np.concatenate([a for a, _ in parts]))
    z, v, target = (np.concatenate(c) for c in zip(*[(psi(a)[:-1], b[:-1], psi(a)[1:]) for a, b in parts]))
    regressors = np.hstack([z[:, :5], v, z[:, 5:]])
    Q, R = np.linalg.qr(regressors)
    D = linalg.solve_triangular(R, Q.T @ (target - z))
    D[:, 0] = 0
    return z[0], np.concatenate([b for _, b in parts]), SimpleNamespace(R=R), D


def free_run(D, z, inputs):
    """Largest scaled state while ``z+ = A z + B u``."""
    of_inputs = np.isin(np.arange(len(D)), [5, 6])
    A, B = np.eye(D.shape[1]) + D[~of_inputs].T, D[of_inputs].T
    most = 0.0
    for u in inputs:
        z = A @ z + B @ u
        most = max(most, np.abs(z[1:5]).max())
    return most, spectral_radius(A)


def test_closed_loop_data_run_freely_for_100_s(lifted):
    z, inputs, fit, D = lifted
    assert len(inputs) > 9000
    runaway, radius = free_run(D, z, inputs)
    assert radius > 1 + 1e-5 and runaway > 20
    most, radius = free_run(stable_change(fit, D, 4, 2), z, inputs)
    assert radius <= 1 + 1e-10 and most < 10
    damped = stable_change(fit, D, 4, 2, radius=0.999)
    most, _ = free_run(damped, z, inputs)
    assert most < 3
    assert stable_change(fit, damped, 4, 2) is damped


def test_change_is_the_same_model_in_other_terms(lifted):
    _, _, fit, D = lifted
    order = np.r_[:5, 7 : len(D), 5:7]
    expected = stable_least_squares(fit.R[:, order], D[order] + np.eye(*D.shape))
    assert np.allclose(stable_change(fit, D, 4, 2)[order] + np.eye(*D.shape), expected, atol=1e-12)


def test_cost_on_closed_loop_data_is_a_small_part_of_what_clipping_costs(lifted):
    _, _, fit, D = lifted
    order = np.r_[:5, 7 : len(D), 5:7]
    R, free = fit.R[:, order], D[order] + np.eye(*D.shape)
    clipped = clipped_cost(R, free, True, 1.0)
    cost = [excess_cost(R, free, stable_least_squares(R, free, iterations=k)).sum() / clipped for k in (0, 20, 100)]
    assert cost[0] < 1 and cost[1] < 0.02 and cost[2] < 0.95 * cost[1]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"R": np.eye(3)}, "R has shape"),
        ({"free": np.ones(4)}, "R has shape"),
        ({"free": np.eye(4)[:, :1]}, "N at least 2"),
        ({"free": np.full((4, 3), np.nan)}, "NaN or infinity"),
        ({"R": np.diag([1, 1, 1, np.inf])}, "NaN or infinity"),
        ({"free": np.eye(4, 3) * 2}, "constant"),
        ({"radius": 0}, "radius is 0"),
        ({"radius": True}, "radius is True"),
        ({"radius": "one"}, "radius is 'one'"),
        ({"iterations": -1}, "iterations is -1"),
        ({"iterations": 2.5}, "iterations is 2.5"),
    ],
)
def test_wrong_arguments_are_named(change, message):
    arguments = {"R": np.eye(4), "free": np.eye(4, 3)} | change
    with pytest.raises(ValueError, match=message):
        stable_least_squares(**arguments)


@pytest.mark.parametrize("stable, radius", [(True, 1.0), (0.999, 0.999), (0.9, 0.9)])
def test_a_model_keeps_the_radius_that_was_asked_for(stable, radius, experiment, tmp_path):
    recording = experiment.select(inputs=["u_phi", "u_psi"])
    model = tras.KoopmanModel(tras.Monomials(3), "lifted_linear", stable=stable, regularization=None).fit(recording)
    free = tras.KoopmanModel(tras.Monomials(3), "lifted_linear", regularization=None).fit(recording)
    others = np.sort(np.abs(model.eigenvalues))[::-1]
    assert others[0] == pytest.approx(1, abs=1e-9)  # the constant's own
    assert others[1] <= radius + 1e-9 and np.sort(np.abs(free.eigenvalues))[-1] > radius
    assert f"at most {radius:g} was asked for" in model.report()
    model.save(tmp_path / "model.npz")
    assert tras.load_model(tmp_path / "model.npz").report() == model.report()
