"""Roll-outs of many trajectories at once, in scaled channels."""

import copy
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from tras import metrics

STRETCH = 32  # samples between two looks at which predictions have left
_MOST = 64  # substeps per sample
CHEAP = 128  # functions of a field whose substeps are chosen by 1e-8 alone
LIMIT = 1e3  # half-ranges of the training data; a prediction beyond is abandoned and NaN from there on
# Of `enough_substeps`: steps per sample that are few, the share of predictions that counts, half-ranges that are many.
_FEW, _MANY, _GROSS = 8, 0.99, 0.01


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


def runge_kutta_with_slopes(
    field: Callable, z: np.ndarray, u: np.ndarray, dt: float, substeps: int
) -> tuple[np.ndarray, np.ndarray]:
    """`runge_kutta`, and its exact derivatives by z and u: (n, batch) and (batch, n, n + m).

    ``field`` returns rates (n, batch) and their slopes (batch, n, n + m). The derivatives are those of the steps, not
    of the flow that these approximate: each stage's are carried along.
    """
    h, n = dt / substeps, len(z)
    slopes = np.zeros((z.shape[1], n, n + len(u)))
    slopes[:, range(n), range(n)] = 1

    def stage(k, K, share):
        rates, J = field(np.concatenate([z if k is None else z + share * k, u]))
        later = J[:, :, :n] @ (slopes if K is None else slopes + share * K)
        later[:, :, n:] += J[:, :, n:]
        return rates, later

    for _ in range(substeps):
        k1, K1 = stage(None, None, 0)
        k2, K2 = stage(k1, K1, h / 2)
        k3, K3 = stage(k2, K2, h / 2)
        k4, K4 = stage(k3, K3, h)
        z = z + h / 6 * (k1 + 2 * (k2 + k3) + k4)
        slopes = slopes + h / 6 * (K1 + 2 * (K2 + K3) + K4)
    return z, slopes


class Substeps(NamedTuple):
    """How many steps a sample takes, whether they are enough, and if not, what their last halving moved one prediction
    of a hundred by, at least."""

    count: int
    enough: bool
    moved: float


def enough_substeps(
    field: Callable,
    z: np.ndarray,
    u: np.ndarray,
    dt: float,
    tolerance: float = 1e-8,
    most: int = _MOST,
    tolerable: float | np.ndarray | None = None,
) -> Substeps:
    """Doubled until halving the step moves no prediction over one sample by more than ``tolerance`` of a half-range.

    With ``tolerable``, a number or one per state, (n, 1), 8 are enough if it moves 99 predictions of 100 by that much
    at most, and none by a hundredth of a half-range. A field has a kink at the hull's edge, where steps of any order
    converge slowly: the few predictions that cross it would ask for many steps in all. There are at most ``most``.
    """
    substeps, coarse = 1, runge_kutta(field, z, u, dt, 1)
    enough, moved = False, np.inf
    while not enough and 2 * substeps <= most:
        fine = runge_kutta(field, z, u, dt, 2 * substeps)
        change = np.abs(fine - coarse)
        enough = bool(change.max() <= tolerance)
        if tolerable is not None and substeps >= _FEW:
            # All of it is False for NaN: a prediction that runs away by coarse steps may stay by finer ones.
            many = (change <= tolerable).all(axis=0).mean() >= _MANY
            enough |= bool(many and (change <= np.maximum(tolerable, _GROSS)).all())
        if not enough:
            substeps, coarse = 2 * substeps, fine
            matters = change if tolerable is None else np.where(np.isfinite(tolerable), change, 0)
            moved = float(np.quantile(matters.max(axis=0), _MANY))
    return Substeps(substeps, enough, moved)


def coarser(model):
    """The model, its field integrated in a quarter of the steps: enough for a figure, or to tell candidates apart.

    The method is of order 4, so the error is 256 times what `enough_substeps` allows: 3e-6 of a half-range per sample.
    A field of many functions has no steps to spare.
    """
    if 1 < getattr(model, "substeps_", 1) < _MOST and len(model.names_) <= CHEAP:
        model = copy.copy(model)
        model.substeps_ = max(1, model.substeps_ // 4)
    return model


def predict_coarsely(model, recording):
    """``model.predict(recording)`` by `coarser`, or by all steps if a prediction runs away: a fast mode may, by few."""
    fast = coarser(model)
    runs = fast.predict(recording)
    if fast is not model and metrics.diverged(recording.states, runs).any():
        runs = model.predict(recording)
    return runs
