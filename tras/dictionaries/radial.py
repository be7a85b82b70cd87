"""Radial functions of the distance from centres: Gaussians and thin plates (paper, "Gauss RBF")."""

from collections.abc import Sequence

import numpy as np

from tras.dictionaries.base import POSITIVE, Dictionary
from tras.workflow import arguments

CENTRES = ("uniform", "data", "kmeans")


class Radial(Dictionary):
    """One function of ``|z - c| / width`` for each centre c behind the head: N = 1 + n + m + centres."""

    def __init__(
        self,
        n_centres: int = 2,
        width: float | str = 1.0,
        seed: int = 0,
        centres: str = "uniform",
    ):
        self.n_centres = n_centres
        self.width = width
        self.seed = seed
        self.centres = centres

    def _learn(self, z):
        self.centres_ = self._place(z)
        self.width_ = (
            typical_distance(self.centres_) if isinstance(self.width, str) and self.width == "auto" else self.width
        )
        arguments.number("width", self.width_, 0, ends=False, give=POSITIVE)
        self.width_ = float(self.width_)

    def _place(self, z):
        if not isinstance(self.centres, str):
            centres = np.array(self.centres, dtype=float)
            if centres.ndim != 2 or centres.shape[1] != len(z) or not np.isfinite(centres).all():
                raise ValueError(
                    f"centres has shape {centres.shape}; give (centres, {len(z)}) finite numbers in scaled channels, "
                    "or a word."
                )
            return centres
        arguments.whole_number("n_centres", self.n_centres)
        if self.centres not in CENTRES:
            raise ValueError(f"centres is {self.centres!r}; choose one of {', '.join(CENTRES)}, or give an array.")
        rng = np.random.default_rng(self.seed)
        if self.centres == "uniform":
            return rng.uniform(-1, 1, size=(self.n_centres, len(z)))
        if z.shape[1] < self.n_centres:
            raise ValueError(
                f"n_centres is {self.n_centres} but there are only {z.shape[1]} samples; use fewer centres."
            )
        points = z.T[rng.choice(z.shape[1], self.n_centres, replace=False)]
        return points if self.centres == "data" else _kmeans(z.T, points)

    def _count(self):
        if hasattr(self, "centres_"):
            return len(self.centres_)
        if not isinstance(self.centres, str):
            return len(self.centres)
        arguments.whole_number("n_centres", self.n_centres)
        return self.n_centres

    def _build(self):
        square = self.width_**2
        level = np.sum(self.centres_**2, axis=1, keepdims=True)
        self._affine = np.hstack([-level / square, self.centres_ * (2 / square), np.full_like(level, -1 / square)])
        return len(self.centres_)

    def _minus_squares(self, z, out):
        """``-|z - c|^2 / width^2`` by one matrix product: no array of (centres, channels, points)."""
        if z.dtype == object:  # symbols (`tras.export.symbols`): as a reader expects it
            return -(((z[None] - self.centres_[..., None]) ** 2).sum(axis=1) / self.width_**2)
        lifted = np.empty((len(z) + 2, z.shape[1]))
        lifted[0], lifted[1:-1] = 1, z
        np.einsum("ij,ij->j", z, z, out=lifted[-1])
        return np.matmul(self._affine, lifted, out=out)

    def _towards_centres(self, z, channels):
        """``(c - z) / width^2`` of the first channels: (centres, channels, points)."""
        return (self.centres_[:, :channels, None] - z[None, :channels]) / self.width_**2

    def _tail_names(self, channels):
        return [f"{self._word}{i + 1}" for i in range(len(self.centres_))]


class GaussianRBF(Radial):
    """The constant, the states, the inputs, and Gaussians ``exp(-|z - c|^2 / width^2)`` of ``z = (x, u)``: N = 1 + n +
    m + centres.

    With the defaults this is what "Gauss RBF of maximum degree w = 2" means in the public MATLAB code that the paper's
    method comes from: w Gaussians of width 1 at random centres in [-1, 1]^(n+m), on channels scaled to [-1, 1], beside
    states, inputs and a constant.

    Parameters
    ----------
    n_centres : int
        Number of Gaussians. A few bend a linear model a little; N grows by one each.
    width : float or "auto"
        Distance at which a Gaussian has fallen to 1/e, in scaled units. Wider functions are smoother and closer to
        linearly dependent: watch the condition number. "auto": the median distance between centres
        (`typical_distance`).
    seed : int or numpy.random.Generator
        Draws the centres.
    centres : {"uniform", "data", "kmeans"} or (centres, n + m) array_like
        Random in the cube [-1, 1]^(n+m), random samples of the data, cluster centres of the data (k-means), or given,
        in scaled channels. The data fill little of the cube: "kmeans" spends no centre where there is none.

    Examples
    --------
    >>> import numpy as np
    >>> GaussianRBF(2, seed=1)(np.zeros((501, 4)), np.zeros((501, 2))).shape
    (501, 9)
    """

    _word = "gauss"

    def words(self, channels: Sequence[str]) -> str:
        return f"{self.n_centres} Gaussians"

    def _fill(self, psi, z):
        tail = psi[1 + len(z) :]
        np.exp(self._minus_squares(z, tail), out=tail)

    def _fill_slopes(self, slopes, psi, z):
        head = 1 + len(z)
        np.multiply(2 * self._towards_centres(z, slopes.shape[1]), psi[head:, None], out=slopes[head:])


class ThinPlate(Radial):
    """The constant, the states, the inputs, and thin plates ``r^2 log r``, ``r = |z - c| / width``. Parameters as of
    `GaussianRBF`.

    They grow with the distance, so they extrapolate where Gaussians fall to nothing, for better or worse.

    Examples
    --------
    >>> ThinPlate(2).fit([[-1.0], [1.0]]).names
    ['1', 'x1', 'plate1', 'plate2']
    """

    _word = "plate"

    def __init__(
        self,
        n_centres: int = 28,
        width: float | str = "auto",
        seed: int = 0,
        centres: str = "kmeans",
    ):
        super().__init__(n_centres, width, seed, centres)

    def _fill(self, psi, z):
        tail = psi[1 + len(z) :]
        squares = -self._minus_squares(z, tail)
        squares = squares + 1e-300 if z.dtype == object else np.maximum(squares, 1e-300)  # r^2 log r is 0 at 0
        np.multiply(squares / 2, np.log(squares), out=tail)

    def _fill_slopes(self, slopes, psi, z):
        squares = np.maximum(-self._minus_squares(z, np.empty((len(self.centres_), z.shape[1]))), 1e-300)
        towards = self._towards_centres(z, slopes.shape[1])
        np.multiply(-towards, (np.log(squares) + 1)[:, None], out=slopes[1 + len(z) :])


def typical_distance(centres):
    """Median distance between centres (centres, d); 1 for a single one. A common rule of thumb for the width.

    Neighbouring functions overlap there, and their matrix is not yet singular (S. Haykin, *Neural Networks*, Sec. 5).
    """
    if len(centres) < 2:
        return 1.0
    squares = np.sum((centres[:, None] - centres[None]) ** 2, axis=-1)
    return float(np.sqrt(np.median(squares[np.triu_indices(len(centres), 1)])))


def _kmeans(points, start, most=5000):
    """Cluster centres of at most ``most`` points, evenly taken, from the given start."""
    from sklearn.cluster import KMeans

    some = points[np.linspace(0, len(points) - 1, min(len(points), most)).astype(int)]
    return KMeans(len(start), init=start, n_init=1).fit(some).cluster_centers_
