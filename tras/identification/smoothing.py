"""Smooth measurement noise away before the lifting: a Kalman smoother that knows which states are velocities."""

import itertools
import math
from collections.abc import Sequence

import numpy as np
from scipy import optimize

from tras.identification.noise import noise_level
from tras.recording import Recording, join

_LEAST = 1e-6  # noise in half-ranges, at least: exact data stay as they are, and nothing divides by zero
_FEWEST = 10  # samples; with fewer, noise and signal cannot be told apart


def smooth(recording: Recording, pairs: Sequence[tuple[str, str]] | None = None) -> Recording:
    """The recording with its states smoothed: their expected values given the whole trajectory, later samples included.

    The signal is modelled as white noise integrated three times (a state by itself: two or three times, whichever is
    likelier), the measurement noise as white with the deviation that `noise_level` finds. The intensity of the driving
    noise is the likeliest one. A Kalman filter runs forward and its estimates are corrected backward (H. E. Rauch, F.
    Tung, C. T. Striebel, AIAA J. 3, 1965, p. 1445); for one state that is a smoothing spline. Inputs stay as they are.
    The ends are known less well than the middle: smooth before `Recording.cut`.

    Parameters
    ----------
    recording : Recording
        Trajectories may have different lengths.
    pairs : sequence of (str, str), optional
        Names of a position and its velocity, as in ``[("phi", "phidot"), ("psi", "psidot")]``: they are smoothed
        together under ``q' = v``, so that each helps the other. The velocity's unit is the position's per second. All
        other states are smoothed one by one.

    Raises
    ------
    ValueError
        If a name is unknown or occurs twice, a pair does not hold two names, or no trajectory has ten samples.

    Examples
    --------
    >>> import numpy as np
    >>> swing = np.sin(0.02 * np.arange(500))[None, :, None]
    >>> noisy = swing + np.random.default_rng(0).normal(0, 0.05, swing.shape)
    >>> smoothed = smooth(Recording(noisy, dt=0.02)).states
    >>> bool(np.std(smoothed - swing) < 0.3 * np.std(noisy - swing))
    True
    """
    recording = join(recording)
    groups = _groups(recording.state_names, pairs)
    if recording.lengths.max() < _FEWEST:
        longest = recording.lengths.max()
        raise ValueError(f"the longest trajectory has {longest} samples; smoothing needs {_FEWEST} or more.")
    sigma, whole = noise_level(recording), np.concatenate([x for x, _ in recording])
    middle, half_range = (whole.max(axis=0) + whole.min(axis=0)) / 2, np.ptp(whole, axis=0) / 2
    smoothed = [x.copy() for x, _ in recording]
    for group in groups:
        if not half_range[group].all():
            continue  # constant: nothing to smooth
        # Lengths in half-ranges and times in samples: of order one whatever the units, and still q' = v.
        first, powers = group[0], np.arange(len(group))
        scale, offset = half_range[first] / recording.dt**powers, np.where(powers == 0, middle[first], 0.0)
        deviation = np.maximum(sigma[group], _LEAST * half_range[group]) / scale
        measured = [(x[:, group] - offset) / scale for x, _ in recording]
        orders = (2, 3) if len(group) == 1 else (3,)
        _, order, intensity = min(_likeliest(measured, deviation, order) for order in orders)
        for into, values in zip(smoothed, _smooth(measured, deviation, order, intensity)):
            into[:, group] = values * scale + offset
    return recording.with_data(smoothed, [u for _, u in recording])


def _groups(names, pairs):
    """The columns that are smoothed together: those of each pair, then every other one by itself."""
    groups = []
    for pair in pairs or ():
        if isinstance(pair, str) or len(pair) != 2:
            raise ValueError(f"pairs holds {pair!r}; give pairs of names (position, velocity): [('phi', 'phidot')].")
        for name in pair:
            if name not in names:
                raise ValueError(f"pairs: there is no state {name!r}; there are {', '.join(names)}.")
        groups.append([names.index(name) for name in pair])
    indices = list(itertools.chain(*groups))
    for i in indices:
        if indices.count(i) > 1:
            raise ValueError(f"pairs: the state {names[i]!r} stands twice; it can be part of one pair only.")
    return groups + [[i] for i in range(len(names)) if i not in indices]


def _integrated_noise(order):
    """White noise of intensity 1, integrated ``order`` times: transition A and covariance Q over a sample."""
    f, left = math.factorial, range(order - 1, -1, -1)  # left: the integrations that follow
    A = np.array([[1 / f(j - i) if j >= i else 0.0 for j in range(order)] for i in range(order)])
    return A, np.array([[1 / (f(i) * f(j) * (i + j + 1)) for j in left] for i in left])


def _filter(measured, deviation, order, intensity):
    """Kalman filter of many trajectories (samples_i, channels) at once; the first channels of the state are measured.

    Returns predictions (samples, trajectories, order) before each measurement; innovations (samples, trajectories,
    channels), zero after a trajectory's end; whether a sample is within its trajectory (samples, trajectories, 1); and
    for each sample (P, S, K), the covariances of prediction and innovation and the gain, the same for all trajectories.
    """
    channels, lengths = len(deviation), np.array([len(y) for y in measured])
    inside = np.arange(lengths.max())[:, None, None] < lengths[:, None]
    Y = np.zeros((*inside.shape[:2], channels))
    for i, y in enumerate(measured):
        Y[: len(y), i] = y
    A, Q = _integrated_noise(order)
    one = np.eye(order)
    H, R = one[:channels], np.diag(deviation**2)
    # A state lies about a half-range from the middle: all that is known before the first sample. A wider start tells
    # the smoother no more, and leaves differences of large numbers in its first samples.
    x, P = np.zeros((len(measured), order)), one
    predicted, innovation, steps = np.empty((*inside.shape[:2], order)), np.empty_like(Y), []
    settled = False
    for k, y in enumerate(Y):
        if not settled:
            S = H @ P @ H.T + R
            K = np.linalg.solve(S, H @ P).T
            F = one - K @ H
            ahead = A @ (F @ P @ F.T + K @ R @ K.T) @ A.T + intensity * Q  # Joseph's form stays positive definite
            settled = (np.abs(ahead - P) <= 1e-11 * np.abs(P)).all()
        steps.append((P, S, K))
        predicted[k], innovation[k] = x, (y - x[:, :channels]) * inside[k]
        x = (x + innovation[k] @ K.T) @ A.T
        P = P if settled else ahead
    return predicted, innovation, inside, steps


def _surprise(measured, deviation, order, intensity):
    """-log likelihood per number, up to a constant, without the first samples: they only say where a motion begins."""
    _, *parts = _filter(measured, deviation, order, intensity)
    innovation, inside, steps = (part[3:] for part in parts)
    total, last = 0, None
    for e, here, (_, S, _) in zip(innovation, inside, steps):
        if S is not last:  # once the filter has settled it is the same
            last, volume = S, np.log(np.linalg.det(S))
        total += np.sum(e * np.linalg.solve(S, e.T).T) + np.sum(here) * volume
    return total / 2 / np.sum(inside)


def _likeliest(measured, deviation, order):
    """(-log likelihood, order, intensity) of the likeliest intensity, from about twenty pieces spread over the data."""
    pieces = [y[k : k + 500] for y in measured for k in range(0, len(y), 500)]
    pieces = [piece for piece in pieces if len(piece) >= _FEWEST]
    pieces = pieces[:: max(1, len(pieces) // 20)]

    def surprise(exponent):
        return _surprise(pieces, deviation, order, deviation[0] ** 2 * 10.0**exponent)

    grid = np.arange(-22.0, 7.0, 2.0)  # from almost straight lines to no smoothing at all
    best = min(grid, key=surprise)
    optimum = optimize.minimize_scalar(surprise, bounds=(best - 2, best + 2), method="bounded", options={"xatol": 0.02})
    return optimum.fun, order, deviation[0] ** 2 * 10.0**optimum.x


def _smooth(measured, deviation, order, intensity):
    """The smoothed measurements, list of (samples_i, channels).

    Backward as Bryson and Frazier (G. J. Bierman, *Factorization Methods for Discrete Sequential Estimation*, 1977, Ch.
    X): the estimate of Rauch, Tung and Striebel, without the inverse of a nearly singular covariance.
    """
    predicted, innovation, _, steps = _filter(measured, deviation, order, intensity)
    A, one = _integrated_noise(order)[0], np.eye(order)
    H = one[: len(deviation)]
    smoothed, adjoint = np.empty_like(innovation), np.zeros(predicted.shape[1:])
    for k in range(len(predicted) - 1, -1, -1):
        P, S, K = steps[k]
        adjoint = adjoint @ (one - K @ H) - np.linalg.solve(S, innovation[k].T).T @ H
        smoothed[k] = (predicted[k] - adjoint @ P) @ H.T
        adjoint = adjoint @ A
    return [smoothed[: len(y), i] for i, y in enumerate(measured)]
