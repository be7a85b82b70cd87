"""The box around the training data, and how a model goes on beyond it. All in scaled channels."""

import numpy as np
from scipy import linalg

from tras.dictionaries.base import MARGIN
from tras.io.npz import require_numbers


class Hull:
    """The box around the training data, along their principal axes, wider by a margin on each side.

    Beyond it a dictionary is guesswork: monomials explode, Gaussians vanish. There the model's functions are evaluated
    at the nearest point of the box, P(z), and the rest of the way is linear: ``F(z) = W psi(P z) + S (z - P z)``.
    Inside nothing changes.

    With S Hurwitz in the states this is a stable linear system driven by a bounded term, so every prediction under
    bounded inputs stays bounded (H. K. Khalil, *Nonlinear Systems*, 3rd ed., Thm. 5.1), as long as all channels are
    confined.

    Parameters
    ----------
    z : (channels, points) ndarray
    confined : sequence of int, optional
        Channels that are held in the box, along their own axes, for a dictionary that is sound beyond the data in the
        others.
    margin : float or (channels,) array_like
        In half-ranges of the data along an axis.
    """

    def __init__(self, z, confined=None, margin=MARGIN):
        channels = len(z)
        self.centre = z.mean(axis=1, keepdims=True)
        turned = confined is None and z.shape[1] > 1  # a single point has no axes of its own
        self.axes = np.linalg.eigh(np.atleast_2d(np.cov(z)))[1] if turned else np.eye(channels)
        self.free, self.margin = self.unconfined(channels, confined), np.reshape(margin, (-1, 1))
        self.low, self.high = np.full((channels, 1), np.inf), np.full((channels, 1), -np.inf)
        self.widen(z)

    @staticmethod
    def unconfined(channels, confined):
        """Numbers of the channels in which the box has no edges."""
        return [] if confined is None else [i for i in range(channels) if i not in confined]

    def widen(self, z: np.ndarray) -> "Hull":
        """Make room for more data."""
        t = self.axes.T @ (z - self.centre)
        return self.merge(t.min(axis=1, keepdims=True), t.max(axis=1, keepdims=True))

    def arrays(self) -> dict[str, np.ndarray]:
        """Centre, axes, and the data's edges: what `restored` needs beside ``free``."""
        return {name: getattr(self, name) for name in ("centre", "axes", "low", "high")}

    @classmethod
    def restored(cls, arrays, free, margin=MARGIN):
        """The hull that had these `arrays`; a ValueError if no hull can have them."""
        hull, channels = object.__new__(cls), np.shape(arrays.get("centre", ()))[:1]
        for name in ("centre", "axes", "low", "high"):
            shape = (*channels, *channels) if name == "axes" else (*channels, 1)
            setattr(hull, name, require_numbers(f"hull.{name}", arrays.get(name, ()), shape))
        if (hull.low > hull.high).any() or np.abs(hull.axes.T @ hull.axes - np.eye(*channels)).max(initial=0.0) > 1e-6:
            raise ValueError("its hull is no box along orthogonal axes")
        hull.free, hull.margin = free, np.reshape(margin, (-1, 1))
        return hull.settle()

    def merge(self, low: np.ndarray, high: np.ndarray) -> "Hull":
        """Make room for the data of another hull with the same axes, whose edges these are."""
        self.low, self.high = np.minimum(self.low, low), np.maximum(self.high, high)
        return self.settle()

    def settle(self):
        """The edges with their margin, ``lower`` and ``upper``, from the data's."""
        room = self.margin * (self.high - self.low) / 2
        self.lower, self.upper = self.low - room, self.high + room
        self.lower[self.free], self.upper[self.free] = -np.inf, np.inf
        # The box as a cube [-1, 1]: one product tells whether points are inside.
        with np.errstate(divide="ignore", invalid="ignore"):  # data without any extent along an axis: never told so
            inward = np.where(np.isinf(self.upper), 0.0, 2 / (self.upper - self.lower))
            self._to_cube = inward * self.axes.T
            self._cube_shift = -inward * (
                self.axes.T @ self.centre + np.where(np.isinf(self.upper), 0.0, (self.lower + self.upper) / 2)
            )
        return self

    def nearest(self, z: np.ndarray) -> np.ndarray:
        """P(z): (channels, points) -> (channels, points); ``z`` itself, unchanged, when all points are inside."""
        if np.abs(self._to_cube @ z + self._cube_shift).max() <= 1:
            return z
        t = self.axes.T @ (z - self.centre)
        beyond = t - np.clip(t, self.lower, self.upper)
        return z - self.axes @ beyond if beyond.any() else z

    def slopes(self, z: np.ndarray) -> np.ndarray:
        """dP/dz: (channels, points) -> (points, channels, channels); along an axis it is 1 inside and 0 beyond."""
        t = self.axes.T @ (z - self.centre)
        inside = (t >= self.lower) & (t <= self.upper)
        return (self.axes * inside.T[:, None]) @ self.axes.T


def outward_rates(change: np.ndarray, n: int, dt: float, newest: int) -> np.ndarray:
    """S (n, n + m) in 1/s beyond the hull: the linear model's, shifted until its slowest mode decays as fast as its
    fastest one moves.

    Parameters
    ----------
    change : (1 + n + m, 1 + n + m) ndarray
        D = K - I of the linear model: constant, states, inputs. ``D / dt`` is good enough here for its logarithm.
    newest : int
        The first so many of the n states are the present ones. Delayed ones are shifted, not predicted; that they are
        far out tells the present ones nothing here, or the shift could undo the damping.
    """
    S = change[1:, 1 : 1 + n].T / dt
    S[newest:], S[:, newest:n] = 0, 0
    eigenvalues = np.linalg.eigvals(S[:newest, :newest])
    S[:newest, :newest] -= max(0.0, eigenvalues.real.max() + np.abs(eigenvalues).max()) * np.eye(newest)
    return S


def over_a_sample(S: np.ndarray, dt: float) -> np.ndarray:
    """The flow of ``z' = S (z, u)`` over a sample, u held: (n, n + m)."""
    n, channels = S.shape
    whole = np.zeros((channels, channels))
    whole[:n] = S * dt
    return linalg.expm(whole)[:n]
