"""Coefficients of a map whose predictions over many steps, not over one, miss least: Gauss-Newton from least squares.

Least squares of single steps trusts the states that it starts from, so their noise biases it, and it weighs errors that
die out like those that add up. Here the errors of whole predictions are minimised, as in L. Ljung, *System
Identification*, 2nd ed., Sec. 7.2 (prediction-error methods) and 10.2 (Gauss-Newton, damped after Levenberg).
"""

from collections.abc import Callable, Sequence

import numpy as np
from scipy import linalg

ITERATIONS = 6
_ENOUGH = 1e-2  # a step that lowers the cost by a smaller share is the last one
_PULL = 1e-3  # towards the usual coefficients, a square of theirs over one of an error, both in half-ranges
_FAR = 30.0  # half-ranges, from which on a prediction has run away
_DAMPING = 1e-4, 1e6  # at the start, and where no step is left
_WORK = 3e8  # products of sensitivities per iteration, at most; beyond, segments are left out
_AT_ONCE = 2**24  # sensitivities of predictions side by side, at most; there are three arrays of them


def improved(
    W: np.ndarray, usual: np.ndarray, segments: Sequence, lift: Callable, slopes: Callable, later: Callable, lags: int
) -> tuple[np.ndarray, list[float]]:
    """Coefficients near W, of smaller errors, and the errors before and after each step.

    Parameters
    ----------
    W, usual : (n, N) ndarray
        Of the next states, in scaled channels: where to begin, and what the predictions do not tell stays near.
    segments : list of (states, inputs)
        (samples, n', batch) and (samples, m, batch). A prediction starts from ``states[0]``; the first n rows of the
        others are what it is to meet.
    lift : callable
        ``(z, u) -> (psi, rest)``, (N, batch) and (n, batch): the next states are ``W psi + rest``.
    slopes : callable
        ``(z, u) -> `` derivatives (N, n', batch) of psi by z, where z is among the data.
    later : callable
        ``(states, z, u) -> z`` of the next sample, whose first n rows are ``states``.
    lags : int
        Samples of the states in z, the present one included: its first ``n * lags`` rows.

    Returns
    -------
    W : (n, N) ndarray
        The one that was given, if its own predictions run away.
    errors : list of float
        Root mean squares, in the units of the states.
    """
    numbers = sum(states[1:, : len(W)].size for states, _ in segments)
    batch = max(1, _AT_ONCE // (len(W) * lags * W.size))
    segments = [
        (states[..., k : k + batch], inputs[..., k : k + batch])
        for states, inputs in segments
        for k in range(0, states.shape[2], batch)
    ]
    problem = lift, slopes, later, lags

    def normal_equations(W):
        with np.errstate(over="ignore", invalid="ignore"):
            cost, H, g = _normal_equations(W, segments, *problem)
        moved = W - usual
        H[np.diag_indices_from(H)] += _PULL * numbers
        return cost, cost + _PULL * numbers * np.sum(moved**2), H, g - _PULL * numbers * moved.ravel()

    misses, cost, H, g = normal_equations(W)
    errors, damping = [np.sqrt(misses / numbers)], _DAMPING[0]
    for _ in range(ITERATIONS if np.isfinite(cost) else 0):
        before = cost
        while damping < _DAMPING[1]:
            damped = H.copy()
            damped[np.diag_indices_from(H)] *= 1 + damping
            onward = W + linalg.cho_solve(linalg.cho_factor(damped), g).reshape(W.shape)
            there = normal_equations(onward)
            if there[1] < cost:
                W, (misses, cost, H, g), damping = onward, there, damping / 10
                errors.append(np.sqrt(misses / numbers))
                break
            damping *= 10
        if cost > (1 - _ENOUGH) * before:
            break
    return W, [float(error) for error in errors]


def worth(states: int, functions: int) -> int:
    """How many samples to predict, at most, for as many coefficients."""
    return int(min(20_000, max(10 * functions, _WORK / (states * (states * functions) ** 2))))


def _normal_equations(W, segments, lift, slopes, later, lags):
    """Sum of squares, Gauss-Newton's matrix (n N, n N), minus half the gradient (n N,); infinite if one runs away."""
    n, N = W.shape
    H, g, cost = np.zeros((n * N, n * N)), np.zeros(n * N), 0.0
    for states, inputs in segments:
        z, batch = states[0], states.shape[2]
        S = np.zeros((batch, n * lags, n * N))  # derivatives of the states in z by W
        for x, u in zip(states[1:, :n], inputs):
            psi, rest = lift(z, u)
            onward = W @ psi + rest
            if not np.abs(onward).max() <= _FAR:
                return np.inf, H, g
            by_z = (W @ slopes(z, u)[:, : n * lags].reshape(N, -1)).reshape(n, n * lags, batch)
            by_W = np.ascontiguousarray(by_z.transpose(2, 0, 1)) @ S
            for i in range(n):
                by_W[:, i, i * N : (i + 1) * N] += psi.T
            flat, e = by_W.reshape(batch * n, n * N), (x - onward).T.ravel()
            H += flat.T @ flat
            g += flat.T @ e
            cost += e @ e
            S = np.concatenate([by_W, S[:, : n * (lags - 1)]], axis=1)
            z = later(onward, z, u)
    return cost if np.isfinite(H).all() else np.inf, H, g
