"""Responses to an input over time and over frequency: of a linear system, and of a recording by itself.

A recording's response is its cross-spectra divided by the inputs' spectra, averaged over overlapping segments (P. D.
Welch, IEEE Trans. Audio Electroacoust. 15, 1967, 70). It needs no model, and is that of the best linear system for the
amplitudes of the recording (R. Pintelon and J. Schoukens, *System Identification: A Frequency Domain Approach*, 2nd
ed., Ch. 2 and 3). With feedback, noise that comes back through the input biases it.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg, signal

from tras.analysis.linearization import StateSpace, matrices

if TYPE_CHECKING:
    from tras.model import KoopmanModel
    from tras.recording import Recording

SEGMENTS = 12  # of a recording, without the overlaps: its length over that of a segment
LONGEST = 1024  # samples of a segment
FEWEST = 32  # samples of a segment: fewer resolve nothing
UNCERTAIN = 0.3  # standard deviation of a gain over the gain, from which on it is not trusted
QUIET = 1e-4  # power of an input over its largest, below which leaked power may be all there is
_OVERLAP = 1.056  # correlation between Hann's windows that overlap by half: averages that count, 1 + 2 / 36


def frequency_response(system: StateSpace, frequency: ArrayLike) -> np.ndarray:
    """``C (exp(2 pi i f dt) - A)^-1 B + D`` at frequencies (F,) in Hz: (F, n, m), complex.

    Examples
    --------
    >>> held = StateSpace(np.array([[0.5]]), np.array([[1.0]]), np.eye(1), np.zeros((1, 1)), 0.1)
    >>> frequency_response(held, [0.0, 5.0]).real.ravel()  # 1 / (1 - 0.5) and 1 / (-1 - 0.5)
    array([ 2.        , -0.66666667])
    """
    A, B, C, D, dt = system
    z = np.exp(2j * np.pi * np.asarray(frequency, dtype=float) * dt)
    triangle, Q = linalg.schur(A, output="complex")  # once for all frequencies
    right = Q.conj().T @ B
    states = np.empty((len(z), *B.shape), dtype=complex)
    with np.errstate(divide="ignore", invalid="ignore"):  # at a pole
        for i in reversed(range(len(A))):
            onward = right[i] + triangle[i, i + 1 :] @ states[:, i + 1 :]
            states[:, i] = onward / (z - triangle[i, i])[:, None]
        return C @ Q @ states + D


def step_response(system: StateSpace, samples: int) -> np.ndarray:
    """Outputs from rest after a step of one unit of each input, at the first sample: (samples, n, m).

    Examples
    --------
    >>> held = StateSpace(np.array([[0.5]]), np.array([[1.0]]), np.eye(1), np.zeros((1, 1)), 0.1)
    >>> step_response(held, 4).ravel()
    array([0.  , 1.  , 1.5 , 1.75])
    """
    A, B, C, D, _ = system
    z, outputs = np.zeros_like(B, dtype=float), np.empty((samples, len(C), B.shape[1]))
    with np.errstate(over="ignore", invalid="ignore"):  # of an unstable system
        for k in range(samples):
            outputs[k] = C @ z + D
            z = A @ z + B
    return outputs


def rest_point(model: "KoopmanModel", recording: "Recording") -> tuple[np.ndarray, np.ndarray, bool]:
    """Where to linearise: the point at which the model rests under the recording's mean input, by Newton's method.

    Returns
    -------
    x : (n,) ndarray
    u : (m,) ndarray
    rests : bool
        False if there is no such point in the range of the recording; x is then the recording's mean.
    """
    x, u = (np.concatenate(part) for part in zip(*model.channels_.matched(recording)))
    mean, held, n = x.mean(axis=0), u.mean(axis=0), x.shape[1]
    low, high, count = x.min(axis=0), x.max(axis=0), model.delays + 1
    point = mean
    if model.predictor == "lifted_linear":
        return mean, held, False  # its linear system is the same everywhere
    for _ in range(20):
        onward = model.simulate(np.tile(point, (count, 1)) if model.delays else point, np.tile(held, (count + 1, 1)))
        A = matrices(model, point, held).A
        # A state that rests has been there before: the columns of its delayed samples count as its own.
        slope = A[:n, : n * count].reshape(n, count, n).sum(axis=1)
        try:
            move = linalg.solve(np.eye(n) - slope, onward[-1] - point)
        except (linalg.LinAlgError, ValueError):
            break
        point = point + move
        if not np.all((point >= low) & (point <= high)):  # False for NaN
            break
        if np.all(np.abs(move) <= 1e-6 * (high - low)):
            return point, held, True
    return mean, held, False


@dataclass(frozen=True)
class Measured:
    """The response of a recording by itself; from `measured_response`.

    Attributes
    ----------
    frequency : (F,) ndarray
        In Hz, without zero.
    response : (F, n, m) complex ndarray
    deviation : (F, n, m) ndarray
        Standard deviation of the response, as a fraction of its size: where noise, or what is not linear, disturbs it.
    coherence : (F, n) ndarray
        The share of each state's power that is linear in all inputs together.
    excited : (F, m) bool ndarray
        Where the input has power of its own.
    segments, samples : int
        How many segments there are, and of how many samples each.
    """

    frequency: np.ndarray
    response: np.ndarray
    deviation: np.ndarray
    coherence: np.ndarray
    excited: np.ndarray
    segments: int
    samples: int

    @property
    def trusted(self) -> np.ndarray:
        """(F, n, m) bool: the input has power, and the response is certain enough."""
        return self.excited[:, None] & (self.deviation <= UNCERTAIN)


def segment_length(recording: "Recording") -> int:
    """Samples of a segment that leaves enough of them to average over; 0 if the recording is too short for that."""
    lengths = recording.lengths
    samples = min(int(lengths.sum()) // SEGMENTS, int(np.median(lengths)), LONGEST)
    return samples if samples >= FEWEST else 0


def starts(length: int, samples: int) -> range:
    """Where the segments of a trajectory begin, which overlap by half."""
    return range(0, length - samples + 1, samples // 2)


def measured_response(states: list[np.ndarray], inputs: list[np.ndarray], dt: float, samples: int) -> Measured | None:
    """From trajectories (samples_i, n) and (samples_i, m), in segments of ``samples``; None if they are too few.

    Each segment is less its mean, under Hann's window, and overlaps the next by half.
    """
    n, m = states[0].shape[1], inputs[0].shape[1]
    window, parts = signal.get_window("hann", samples)[:, None], []
    for pair in zip(states, inputs):
        both = np.hstack(pair)
        for k in starts(len(both), samples):
            parts.append(np.fft.rfft(signal.detrend(both[k : k + samples], axis=0, type="constant") * window, axis=0))
    averages = len(parts) / _OVERLAP
    if averages <= m + 1:
        return None
    spectra = np.stack(parts)[:, 1:]  # without the mean
    spectra = np.einsum("kfi,kfj->fij", spectra, spectra.conj(), optimize=True) / len(parts)
    xx, xu, uu = spectra[:, :n, :n], spectra[:, :n, n:], spectra[:, n:, n:]
    own = np.abs(np.einsum("fjj->fj", uu))
    power = np.abs(np.einsum("fii->fi", xx))
    # Pseudo-inverse: inputs that move together leave nothing to tell them apart by.
    size = np.sqrt(np.where(own > 0, own, 1.0))
    inverse = np.linalg.pinv(uu / size[:, :, None] / size[:, None], rcond=1e-6, hermitian=True)
    inverse = inverse / size[:, :, None] / size[:, None]
    response = xu @ inverse
    explained = np.einsum("fij,fij->fi", response, xu.conj()).real
    coherence = np.clip(explained / np.where(power > 0, power, 1.0), 0, 1)
    rest = np.maximum(power - explained, 0) / (averages - m)
    variance = rest[:, :, None] * np.abs(np.einsum("fjj->fj", inverse))[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        deviation = np.nan_to_num(np.sqrt(variance) / np.abs(response), nan=np.inf)
    frequency = np.fft.rfftfreq(samples, dt)[1:]
    excited = own > QUIET * own.max(axis=0)
    return Measured(frequency, response, deviation, coherence, excited, len(parts), samples)
