"""Gusts: torques from outside with the spectra of Dryden's model of turbulence."""

import math

import numpy as np
from scipy.linalg import expm, solve_continuous_lyapunov

from tras.workflow import arguments


def gusts(
    duration: float, dt: float, rms: tuple[float, float], time_constant: float, rng: np.random.Generator | int
) -> np.ndarray:
    """Torques (samples, 2) in N m about pitch and yaw on the grid 0, dt, ..., duration, from white noise.

    Their spectra are those of the Dryden model (MIL-F-8785C, Sec. 3.7): about pitch that of the wind along the path,
    ``1 / (1 + T s)``, about yaw that across it, ``(1 + sqrt(3) T s) / (1 + T s)^2``, with ``T`` the length of the
    eddies over the speed of the wind. Both are sampled exactly, stationary from the first sample, and independent.

    Parameters
    ----------
    duration, dt : float
        Length and sampling time in s.
    rms : (float, float)
        Standard deviations in N m.
    time_constant : float
        ``T`` in s.
    rng : numpy.random.Generator or int
        An integer is a seed.

    Returns
    -------
    (samples, 2) ndarray

    Raises
    ------
    ValueError
        If a time is not positive, ``duration`` is shorter than ``dt``, ``time_constant`` longer than 10 000 ``dt``, or
        an ``rms`` is negative.

    Examples
    --------
    >>> gusts(500.0, 0.01, (0.01, 0.005), 1.0, 0).shape
    (50001, 2)
    """
    for name, value in (("duration", duration), ("dt", dt), ("time_constant", time_constant)):
        arguments.number(name, value, 0, ends=False, give="a positive time in s")
    if time_constant > 1e4 * dt:  # what is new in a sample is lost in rounding
        raise ValueError(f"time_constant is {time_constant} s; give at most {1e4 * dt:g} s for a dt of {dt} s.")
    for value in rms:
        arguments.number("rms", value, 0, give="two torques in N m, 0 or more")
    arguments.seed("rng", rng, "the gusts")
    samples = round(duration / dt) + 1
    if samples < 2:
        raise ValueError(f"duration is {duration} s; give at least one sampling time, {dt} s.")
    rng, T = np.random.default_rng(rng), time_constant
    along = np.array([[-1 / T]]), np.array([1.0]), np.array([1.0])
    across = np.array([[0.0, 1.0], [-1 / T**2, -2 / T]]), np.array([0.0, 1.0]), np.array([1.0, math.sqrt(3) * T])
    return np.column_stack([size * _filtered(*shape, samples, dt, rng) for size, shape in zip(rms, (along, across))])


def _filtered(A, b, c, samples, dt, rng):
    """White noise through ``c (s - A)^-1 b``, with unit variance; exact at the samples.

    The covariance of the state is ``P`` with ``A P + P A' + b b' = 0``; over a sample ``P - F P F'`` of it is new.
    """
    P, F = solve_continuous_lyapunov(A, -np.outer(b, b)), expm(A * dt)
    new = np.linalg.cholesky(P - F @ P @ F.T)
    noise = rng.standard_normal((samples, len(A)))
    states = np.empty_like(noise)
    states[0] = np.linalg.cholesky(P) @ noise[0]
    for k in range(1, samples):
        states[k] = F @ states[k - 1] + new @ noise[k]
    return states @ c / math.sqrt(c @ P @ c)
