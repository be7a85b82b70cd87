"""Roll-outs of many trajectories at once, in scaled channels."""

from collections.abc import Callable

import numpy as np

STRETCH = 32  # samples between two looks at which predictions have left
LIMIT = 1e3  # half-ranges of the training data; a prediction beyond is abandoned and NaN from there on


def roll_out(advance: Callable, z: np.ndarray, inputs: np.ndarray, read: Callable = lambda state: state) -> np.ndarray:
    """States (samples, n, batch) from the state ``z`` (..., batch) under inputs (samples, m, batch).

    Parameters
    ----------
    advance : callable
        ``(state, u) -> state`` one sample later.
    read : callable
        The n states in a state of ``advance``.
    """
    first = read(z)
    samples, batch = len(inputs), inputs.shape[2]
    states = np.empty((samples, *first.shape))
    states[0] = first
    ends = np.full(batch, samples)  # where each prediction is abandoned
    with np.errstate(over="ignore", invalid="ignore"):
        for start in range(1, samples, STRETCH):
            stretch = states[start : start + STRETCH]
            for k in range(len(stretch)):
                z = advance(z, inputs[start + k - 1])
                stretch[k] = read(z)
            inside = np.abs(stretch) <= LIMIT  # False for NaN
            if not inside.all():
                outside = ~inside.all(axis=1)
                gone = outside.any(axis=0)
                ends[gone] = np.minimum(ends[gone], start + outside[:, gone].argmax(axis=0))
                if (ends < samples).all():
                    break
                z = np.where(gone, 0.0, z)
    for i in np.flatnonzero(ends < samples):
        states[ends[i] :, :, i] = np.nan
    return states


def runge_kutta(field: Callable, z: np.ndarray, u: np.ndarray, dt: float, substeps: int) -> np.ndarray:
    """Classical steps of order 4 of ``z' = field(point)``, ``point`` (n + m, batch) holding z and the held input u."""
    h, n = dt / substeps, len(z)
    point, move = np.concatenate([z, u]), np.empty_like(z)
    inner = point[:n]
    for _ in range(substeps):
        k1 = field(point)
        np.add(z, np.multiply(k1, h / 2, out=move), out=inner)
        k2 = field(point)
        np.add(z, np.multiply(k2, h / 2, out=move), out=inner)
        k3 = field(point)
        np.add(z, np.multiply(k3, h, out=move), out=inner)
        k4 = field(point)
        np.add(k2, k3, out=move)
        move *= 2
        move += k1
        move += k4
        move *= h / 6
        z = z + move
        inner[:] = z
    return z


def enough_substeps(
    field: Callable, z: np.ndarray, u: np.ndarray, dt: float, tolerance: float = 1e-8, most: int = 64
) -> int:
    """Doubled until halving the step moves no prediction over one sample by more than ``tolerance`` of a half-range."""
    substeps, coarse = 1, runge_kutta(field, z, u, dt, 1)
    while substeps < most:
        fine = runge_kutta(field, z, u, dt, 2 * substeps)
        if np.abs(fine - coarse).max() <= tolerance:
            break
        substeps, coarse = 2 * substeps, fine
    return substeps
