"""Regularized coefficients from one factorisation, no second look at the data.

What is regularized is the CHANGE over a sample, ``psi(y) - psi(x) = D^T psi(x)`` with K = I + D. A truncated K has zero
eigenvalues and so no logarithm; a truncated D only says "no change here".
"""

from collections.abc import Callable

import numpy as np
from scipy import linalg

METHODS = ("shrink", "tikhonov", "truncated", "sparse")
ROUNDS = 10  # of sequential thresholding, at most
STRENGTHS = (0.0, 1e-4, 1e-3, 1e-2, 3e-2, 1e-1, 1.0)  # what `strength="auto"` tries


def regularized(method: str, R: np.ndarray, rotated: np.ndarray, head: int) -> Callable[[float], np.ndarray]:
    """A function ``strength -> D`` (p, q) for the least-squares problem ``R D = rotated``.

    Strengths are relative: they depend neither on units nor on the number of samples; 0 is plain least squares for
    every method.

    Parameters
    ----------
    method : {"shrink", "tikhonov", "truncated", "sparse"}
        ``"shrink"``: Tikhonov on that part of the functions behind the head which the head (constant, states, inputs)
        does not explain. Strength 1 is close to the linear model, which is never penalised. ``"tikhonov"``: all
        functions alike (A. N. Tikhonov; P. C. Hansen, *Rank-Deficient and Discrete Ill-Posed Problems*, 1998).
        ``"truncated"``: singular values below ``strength`` times the largest are left out.
        ``"sparse"``: sequential thresholding (S. L. Brunton et al., PNAS 113, 2016, 3932): functions that contribute
        less than ``strength`` times the size of a target's change are dropped from it, and the rest is fitted anew, up
        to ten times (`unsettled` tells whether that was enough).
    R : (p, p) ndarray
        Upper triangular factor of the regressors, the head first.
    rotated : (p, q) ndarray
        Q^T targets.
    head : int
        Number of functions that are constant, states and inputs.
    """
    if method == "shrink":
        return _shrink(R, rotated, head)
    if method == "sparse":
        return lambda strength: _sequential_thresholding(R, rotated, strength)
    norms, U, s, Vt = _normalised_svd(R)
    turned = U.T @ rotated

    def filtered(strength):
        if method == "tikhonov":
            shares = s / (s**2 + (strength * s[0]) ** 2)
        else:
            shares = np.where(s > strength * s[0], 1 / s, 0.0)
        return (Vt.T * shares) @ turned / norms[:, None]

    return filtered


def _shrink(R, rotated, head):
    tail, before = R[head:, head:], R[:head, :head]
    if tail.size:
        norms, U, s, Vt = _normalised_svd(tail)
        turned = U.T @ rotated[head:]

    def shrunk(strength):
        D2 = np.empty((0, rotated.shape[1]))
        if tail.size:
            D2 = (Vt.T * (s / (s**2 + (strength * s[0]) ** 2))) @ turned / norms[:, None]
        D1 = linalg.solve_triangular(before, rotated[:head] - R[:head, head:] @ D2, check_finite=False)
        return np.vstack([D1, D2])

    return shrunk


def unsettled(R: np.ndarray, rotated: np.ndarray, strength: float, D: np.ndarray) -> int:
    """How many targets of a ``"sparse"`` D still hold a function below the threshold: their rounds were used up."""
    contributions = np.abs(D) * np.linalg.norm(R, axis=0)[:, None]
    below = (contributions > 0) & (contributions < strength * np.linalg.norm(rotated, axis=0))
    return int(below.any(axis=0).sum())


def _sequential_thresholding(R, rotated, strength, rounds=ROUNDS):
    D = linalg.solve_triangular(R, rotated, check_finite=False)
    norms = np.linalg.norm(R, axis=0)
    for j in range(rotated.shape[1]):
        size = np.linalg.norm(rotated[:, j])
        active = np.ones(len(R), dtype=bool)
        for _ in range(rounds):
            keep = np.abs(D[:, j]) * norms >= strength * size
            if np.array_equal(keep, active):
                break
            active = keep
            D[:, j] = 0.0
            if active.any():
                D[active, j] = (
                    linalg.lstsq(R[:, active] / norms[active], rotated[:, j], check_finite=False)[0] / norms[active]
                )
    return D


def _normalised_svd(R):
    """Norms of the columns of R, and the singular value decomposition with columns of length one."""
    norms = np.linalg.norm(R, axis=0)
    norms = np.where(norms > 0, norms, 1.0)
    return norms, *linalg.svd(R / norms, check_finite=False)
