"""Reference signals: multisines for identification (paper, "Controlled input"), steps and chirps for validation.

All return (samples, channels) on the grid 0, dt, ..., duration with both ends: 500 s at 0.01 s are 50001 samples.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from tras.workflow import arguments

# The paper's excitation, in the order of the plant's inputs (pitch, yaw). "0.8 and 0.2 rad/cycle" is read as rad/s.
PITCH_MAX_FREQUENCY, YAW_MAX_FREQUENCY = 0.2, 0.8  # rad/s
PITCH_PEAK, YAW_PEAK = 1.22173, math.pi  # rad
_SAMPLES = 100_000_000  # of a signal, at most: 0.8 GB per channel
_DRAWN = 100_000_000  # points of all draws of a channel, at most: 1.6 GB on the way


def multisine(
    duration: float,
    dt: float,
    max_frequency: ArrayLike,
    peak: ArrayLike,
    rng: np.random.Generator | int,
    *,
    max_correlation: float = 0.05,
    draws: int = 1000,
) -> np.ndarray:
    """Random-phase multisines, one per channel: flat spectrum, low crest factor, low correlation.

    Channel ``i`` is the sum of cosines of equal amplitude and random phase at the lines ``2 pi k / duration``, ``k =
    1, 2, ...`` up to ``max_frequency[i]`` (R. Pintelon and J. Schoukens, *System Identification*, 2nd ed., Sec. 5.3).
    Of ``draws`` sets of phases whose correlation with the earlier channels is small enough ("we reduced the
    correlation"), the one with the lowest crest factor counts. The mean is zero, the period ``duration``.

    Parameters
    ----------
    duration, dt : float
        Period and sampling time in s; ``duration`` is a whole number of samples.
    max_frequency : sequence of float
        Highest frequency of each channel in rad/s.
    peak : sequence of float
        Largest absolute value of each channel, in the channel's unit.
    rng : numpy.random.Generator or int
        An integer is a seed.
    max_correlation : float
        Largest absolute correlation coefficient between two channels over one period.
    draws : int
        Number of phase sets per channel.

    Returns
    -------
    (samples, channels) ndarray

    Raises
    ------
    ValueError
        If a channel has no line, a line is not below the Nyquist frequency, no draw is uncorrelated enough, or there
        would be more than 1e8 samples, or points of all draws.

    Examples
    --------
    >>> import numpy as np
    >>> r = multisine(500, 0.01, [0.2, 0.8], [1.22173, np.pi], np.random.default_rng(1))
    >>> r.shape, np.abs(r).max(axis=0).round(5).tolist()
    ((50001, 2), [1.22173, 3.14159])
    """
    samples, rng = grid(duration, dt), _generator(rng)
    max_frequency, peak = np.atleast_1d(max_frequency), np.atleast_1d(peak)
    if max_frequency.shape != peak.shape:
        sizes = f"max_frequency has {max_frequency.size} channels but peak has {peak.size}"
        raise ValueError(f"{sizes}; give one of each per channel.")
    lines = [multisine_lines(duration, dt, top) for top in max_frequency]
    points = min(samples - 1, 16 * max(lines))  # enough to judge crest factors; correlations are exact on it
    if draws * points > _DRAWN:
        need = f"{draws} draws of {max(lines)} lines are {draws * points:.2g} numbers, more than {_DRAWN:.0e}"
        raise ValueError(f"duration = {duration:g} s: {need}; give fewer draws, or a shorter duration.")
    channels = []
    for i, count in enumerate(lines):
        phases = 2 * np.pi * rng.random((draws, count))
        candidates = _cosines(phases, points)
        limits = [max_correlation * points / 2 * math.sqrt(count * len(phase)) for phase, _ in channels]
        small = [np.abs(candidates @ other) <= limit for limit, (_, other) in zip(limits, channels)]
        crest = np.where(np.all(small, axis=0), np.abs(candidates).max(axis=1), np.inf)
        best = int(np.argmin(crest))
        if not np.isfinite(crest[best]):
            raise ValueError(
                f"max_correlation = {max_correlation}: none of {draws} draws of channel {i} is that little correlated "
                "with the channels before it; raise max_correlation or draws."
            )
        channels.append((phases[best], candidates[best]))
    signals = np.column_stack([_cosines(phase, samples - 1) for phase, _ in channels])
    return np.vstack([signals, signals[:1]]) * (peak / np.abs(signals).max(axis=0))


def multisine_lines(duration: float, dt: float, max_frequency: float) -> int:
    """Number of lines ``2 pi k / duration <= max_frequency`` (rad/s): over 500 s 63 for 0.8 rad/s, 15 for 0.2 rad/s."""
    lines = math.floor(max_frequency * duration / (2 * math.pi) * (1 + 1e-12))
    if lines < 1:
        raise ValueError(
            f"max_frequency = {max_frequency} rad/s is below the first line 2 pi / duration = "
            f"{2 * math.pi / duration:.4g} rad/s; raise it or the duration."
        )
    if 2 * lines >= grid(duration, dt) - 1:
        nyquist = f"pi / dt = {math.pi / dt:.4g} rad/s"
        raise ValueError(f"max_frequency = {max_frequency} rad/s is not below {nyquist}; lower it or dt.")
    return lines


def steps(
    duration: float,
    dt: float,
    peak: ArrayLike,
    rng: np.random.Generator | int,
    *,
    shortest: float = 4.0,
    longest: float = 10.0,
) -> np.ndarray:
    """Random levels within ``+-peak``, each for a random time between ``shortest`` and ``longest`` seconds.

    Channels change independently. Parameters and result as for `multisine`.

    Examples
    --------
    >>> import tras
    >>> tras.steps(20, 0.01, [0.5, 1.0], 0).shape
    (2001, 2)
    """
    samples, rng = grid(duration, dt), _generator(rng)
    if not 0 < shortest <= longest:
        raise ValueError(f"shortest = {shortest} s and longest = {longest} s; give 0 < shortest <= longest.")
    signals = []
    for height in np.atleast_1d(peak):
        holds = rng.uniform(shortest, longest, size=math.ceil(duration / shortest) + 1)
        levels = rng.uniform(-height, height, size=holds.size)
        signals.append(levels[np.searchsorted(np.cumsum(holds), np.arange(samples) * dt, side="right")])
    return np.column_stack(signals)


def chirp(duration: float, dt: float, max_frequency: ArrayLike, peak: ArrayLike) -> np.ndarray:
    """Sines whose frequency rises linearly from 0 to ``max_frequency`` (rad/s), one per channel, without randomness.

    Odd channels are cosines, so that two channels with the same sweep are not the same signal.

    Examples
    --------
    >>> import tras
    >>> tras.chirp(20, 0.01, [1.0, 2.0], [0.5, 1.0]).shape
    (2001, 2)
    """
    t = np.arange(grid(duration, dt)) * dt
    angle = np.multiply.outer(t**2, np.atleast_1d(max_frequency)) / (2 * duration)
    angle[:, 1::2] += np.pi / 2
    return np.sin(angle) * np.atleast_1d(peak)


def grid(duration: float, dt: float) -> int:
    """Number of samples 0, dt, ..., duration; ``duration`` must be a whole number of ``dt``."""
    for name, value in (("duration", duration), ("dt", dt)):
        arguments.number(name, value, 0, ends=False, give="a positive time in s")
    if duration / dt > _SAMPLES:
        many = f"duration = {duration:g} s at dt = {dt:g} s is {duration / dt:.2g} samples"
        raise ValueError(f"{many}, more than {_SAMPLES:.0e}; give a shorter duration, or a longer dt.")
    intervals = round(duration / dt)
    if intervals < 1 or abs(intervals * dt - duration) > 1e-9 * duration:
        raise ValueError(f"duration = {duration} s is not a whole number of samples of dt = {dt} s; change either.")
    return intervals + 1


def _generator(rng):
    try:
        return np.random.default_rng(rng)
    except (TypeError, ValueError) as error:
        raise ValueError(f"rng is {rng!r}; give a numpy.random.Generator or a seed of 0 or more.") from error


def _cosines(phases, points):
    """Sums of unit cosines at lines 1, 2, ... with phases (..., lines), over one period: (..., points)."""
    lines = phases.shape[-1]
    spectrum = np.zeros((*phases.shape[:-1], points // 2 + 1), dtype=complex)
    spectrum[..., 1 : lines + 1] = np.exp(1j * phases)
    return np.fft.irfft(spectrum, n=points, axis=-1) * (points / 2)
