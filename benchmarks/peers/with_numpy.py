"""A few lines of NumPy and SciPy: ``gram``, Gram matrix by chunks and scaled Cholesky; ``floor``, its 3 M N^2 alone."""

import warnings

import numpy as np
import problem as problems
from scipy import linalg

VERSION = f"NumPy {np.__version__}"
HOW = "re-lift, all runs at once, a plain loop"
ROWS = 4096


def NOTE(problem):
    return (
        "3 M N^2 operations in matrix products, no lifting"
        if problem.variant == "floor"
        else "lift + fit (Gram matrix, scaled Cholesky)"
    )


def load(problem):
    if problem.variant == "floor":
        return [problems.lift(problem, z[:ROWS]) for z in problems.pairs(problem)]
    return problems.pairs(problem)


def fit(problem, data):
    if problem.variant == "floor":
        return floor(problem, *data)
    G = C = 0.0
    for k in range(0, len(data[0]), ROWS):
        psi, later = (problems.lift(problem, z[k : k + ROWS]) for z in data)
        later -= psi
        G, C = G + psi.T @ psi, C + psi.T @ later
    scale = np.sqrt(np.diag(G))
    G /= np.outer(scale, scale)
    C /= scale[:, None]
    try:
        D = linalg.cho_solve(linalg.cho_factor(G, check_finite=False), C, check_finite=False)
    except linalg.LinAlgError:  # not positive definite to working precision
        warnings.simplefilter("ignore", linalg.LinAlgWarning)
        D = linalg.solve(G, C, assume_a="sym", check_finite=False)
    return np.eye(len(G)) + D / scale[:, None]


def floor(problem, psi, later):
    """The same panel again and again: 1.5 products X^T Y of all rows, 2 M N^2 operations each."""
    total = np.zeros((problem.functions, problem.functions))
    rows = 1.5 * problem.states.shape[0] * (problem.states.shape[1] - 1)
    while rows > 0:
        some = int(min(rows, len(psi))) or 1
        total += psi[:some].T @ later[:some]
        rows -= some
    return None


def features(problem, model, z):
    return problems.lift(problem, z)


def matrix(problem, model):
    return model


def roll_out(problem, model):
    if model is None:
        return None
    W = np.ascontiguousarray(model[:, 1 : 1 + problem.n])
    states = [problem.x0]
    for u in problem.u.transpose(1, 0, 2)[:-1]:
        states.append(problems.lift(problem, np.hstack([states[-1], u])) @ W)
    return np.stack(states, axis=1)
