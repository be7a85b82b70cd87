"""Add measurement noise, and measure it (paper, sigma_k in (12)).

Noise on the states biases the fit: it enters both sides of every snapshot pair, and functions of a noisy state are
wrong on average. `tras.smooth` takes most of it out before the lifting; `tras.refine` then fits whole trajectories.
"""

import numpy as np
from numpy.typing import ArrayLike

from tras.recording import Recording, join
from tras.workflow import arguments


def add_noise(recording: Recording, level: ArrayLike, rng: np.random.Generator | int) -> Recording:
    """The recording with white Gaussian noise on its states, sigma_k of equation (12); inputs stay exact.

    Add it before `Recording.cut`, so that a sample that two pieces share has one value.

    Parameters
    ----------
    recording : Recording
    level : float or (n,) array_like
        Standard deviation as a fraction of each state's range over the recording: 0.01 is 1 %.
    rng : numpy.random.Generator or int
        Generator or seed; the same seed gives the same noise.

    Raises
    ------
    ValueError
        If ``level`` is negative, not finite, or neither one number nor one per state, or ``rng`` is no seed.

    Examples
    --------
    >>> import tras
    >>> log = tras.simulate_closed_loop(tras.multisine(20, 0.01, [0.5, 1.2], [1.0, 2.5], 0), 0.01)
    >>> bool((noise_level(add_noise(log, 0.01, 0)) > 10 * noise_level(log)).all())
    True
    """
    recording = join(recording)
    fraction = np.asarray(level, dtype=float)
    if fraction.shape not in ((), (recording.n,)) or not (np.isfinite(fraction).all() and (fraction >= 0).all()):
        remedy = f"give a fraction of the range, 0 or more (0.01 is 1 %), or {recording.n} of them"
        raise ValueError(f"level is {level!r}; {remedy}.")
    arguments.seed("rng", rng, "the noise")
    rng = np.random.default_rng(rng)
    sigma = fraction * np.ptp(np.concatenate([x for x, _ in recording]), axis=0)
    noisy = [x + sigma * rng.standard_normal(x.shape) for x, _ in recording]
    return recording.with_data(noisy, [u for _, u in recording])


def noise_level(recording: Recording) -> np.ndarray:
    """Standard deviation of the noise on each state, (n,), in the states' own units, from third differences.

    ``x_(k+3) - 3 x_(k+2) + 3 x_(k+1) - x_k`` removes a smooth signal and leaves 20 times the variance of white noise
    (J. Rice, Ann. Statist. 12, 1984, p. 1215; P. Hall, J. W. Kay, D. M. Titterington, Biometrika 77, 1990, p. 521).
    What moves within four samples counts as noise: the sampling must be fine compared with the motion.

    Raises
    ------
    ValueError
        If no trajectory has four samples.

    Examples
    --------
    >>> import numpy as np
    >>> from tras import Recording
    >>> swing = np.sin(0.01 * np.arange(4000)) + np.random.default_rng(0).normal(0, 0.05, 4000)
    >>> noise_level(Recording(swing[None, :, None], dt=0.01)).round(3)
    array([0.05])
    """
    recording = join(recording)
    if recording.lengths.max() < 4:
        longest = recording.lengths.max()
        raise ValueError(f"the longest trajectory has {longest} samples; noise can be told from four or more.")
    third = np.concatenate([np.diff(x, n=3, axis=0) for x, _ in recording if len(x) > 3])
    return np.sqrt(np.mean(third**2, axis=0) / 20)
