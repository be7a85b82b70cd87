"""Roll-outs: many trajectories at once, and what a model does beyond the data it has seen. All in scaled channels."""

import numpy as np
from scipy import linalg

STRETCH = 32  # samples between two looks at which predictions have left
LIMIT = 1e3  # half-ranges of the training data; a prediction beyond is abandoned and NaN from there on


def roll_out(advance, z, inputs, read=lambda state: state):
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


def runge_kutta(field, z, u, dt, substeps):
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


def enough_substeps(field, z, u, dt, tolerance=1e-8, most=64):
    """Doubled until halving the step moves no prediction over one sample by more than ``tolerance`` of a half-range."""
    substeps, coarse = 1, runge_kutta(field, z, u, dt, 1)
    while substeps < most:
        fine = runge_kutta(field, z, u, dt, 2 * substeps)
        if np.abs(fine - coarse).max() <= tolerance:
            break
        substeps, coarse = 2 * substeps, fine
    return substeps


class Hull:
    """The box around the training data, along their principal axes, a quarter of the half-range wider on each side.

    Beyond it a dictionary is guesswork: monomials explode, Gaussians vanish. There the model's functions are evaluated at the nearest point of
    the box, P(z), and the rest of the way is linear: ``F(z) = W psi(P z) + S (z - P z)``. Inside nothing changes.

    With S Hurwitz in the states this is a stable linear system driven by a bounded term, so every prediction under bounded inputs stays
    bounded (H. K. Khalil, *Nonlinear Systems*, 3rd ed., Thm. 5.1), as long as all channels are confined.

    Parameters
    ----------
    z : (channels, points) ndarray
    confined : sequence of int, optional
        Channels that are held in the box, along their own axes, for a dictionary that is sound beyond the data in the others.
    """

    margin = 0.25

    def __init__(self, z, confined=None):
        channels = len(z)
        self.centre = z.mean(axis=1, keepdims=True)
        self.axes = np.linalg.eigh(np.atleast_2d(np.cov(z)))[1] if confined is None else np.eye(channels)
        self.free = [] if confined is None else [i for i in range(channels) if i not in confined]
        self.low, self.high = np.full((channels, 1), np.inf), np.full((channels, 1), -np.inf)
        self.widen(z)

    def widen(self, z):
        """Make room for more data."""
        t = self.axes.T @ (z - self.centre)
        self.low = np.minimum(self.low, t.min(axis=1, keepdims=True))
        self.high = np.maximum(self.high, t.max(axis=1, keepdims=True))
        return self.settle()

    def settle(self):
        """The edges with their margin, from the data's."""
        room = self.margin * (self.high - self.low) / 2
        self._low, self._high = self.low - room, self.high + room
        self._low[self.free], self._high[self.free] = -np.inf, np.inf
        # The box as a cube [-1, 1]: one product tells whether points are inside.
        with np.errstate(divide="ignore", invalid="ignore"):  # data without any extent along an axis: never told so
            inward = np.where(np.isinf(self._high), 0.0, 2 / (self._high - self._low))
            self._to_cube = inward * self.axes.T
            self._cube_shift = -inward * (self.axes.T @ self.centre + np.where(np.isinf(self._high), 0.0, (self._low + self._high) / 2))
        return self

    def nearest(self, z):
        """P(z): (channels, points) -> (channels, points); ``z`` itself, unchanged, when all points are inside."""
        if np.abs(self._to_cube @ z + self._cube_shift).max() <= 1:
            return z
        t = self.axes.T @ (z - self.centre)
        beyond = t - np.clip(t, self._low, self._high)
        return z - self.axes @ beyond if beyond.any() else z


def outward_rates(change, n, dt, newest):
    """S (n, n + m) in 1/s beyond the hull: the linear model's, shifted until its slowest mode decays as fast as its fastest one moves.

    Parameters
    ----------
    change : (1 + n + m, 1 + n + m) ndarray
        D = K - I of the linear model: constant, states, inputs. ``D / dt`` is good enough here for its logarithm.
    newest : int
        The first so many of the n states are the present ones. Delayed ones are shifted, not predicted; that they are far out tells the
        present ones nothing here, or the shift could undo the damping.
    """
    S = change[1:, 1 : 1 + n].T / dt
    S[newest:], S[:, newest:n] = 0, 0
    eigenvalues = np.linalg.eigvals(S[:newest, :newest])
    S[:newest, :newest] -= max(0.0, eigenvalues.real.max() + np.abs(eigenvalues).max()) * np.eye(newest)
    return S


def over_a_sample(S, dt):
    """The flow of ``z' = S (z, u)`` over a sample, u held: (n, n + m)."""
    n, channels = S.shape
    whole = np.zeros((channels, channels))
    whole[:n] = S * dt
    return linalg.expm(whole)[:n]
