"""Dictionaries: the functions psi(x, u) that lift a state and an input (paper, (6)-(8)).

Every dictionary holds the constant, the states and the inputs themselves, so a state can be read back from its lifting.
They expect channels of order one: `tras.KoopmanModel` scales each channel to [-1, 1] before it lifts.
"""

import itertools

import numpy as np
from sklearn.base import BaseEstimator


class Dictionary(BaseEstimator):
    """N functions of n states and m inputs, with names and exact Jacobians; scikit-learn conventions.

    A subclass supplies ``_prepare(z)``, ``_lift(z)``, ``_lift_jacobian(z)`` and ``feature_names``, on points in columns:
    ``z`` is (n + m, points), liftings are (N, points), Jacobians (N, n, points).
    """

    def fit(self, x, u=None):
        """Learn what the dictionary needs (the number of channels; centres) from samples (..., n) and (..., m)."""
        x, u = _samples(x, u)
        for name in [name for name in vars(self) if name.endswith("_")]:
            delattr(self, name)  # what an earlier fit learnt
        self.n_states_, self.n_inputs_ = x.shape[-1], u.shape[-1]
        self._prepare(_columns(x, u))
        return self

    def __call__(self, x, u=None):
        """Lift: states (..., n) and inputs (..., m) -> (..., N), equation (7). An unfitted dictionary is fitted first."""
        z, leading = self._points(x, u)
        return self._lift(z).T.reshape(*leading, -1)

    def jacobian(self, x, u=None):
        """``d psi / d x``, used in (17) and (18): (..., n), (..., m) -> (..., N, n)."""
        z, leading = self._points(x, u)
        jacobian = self._lift_jacobian(z)
        return np.moveaxis(jacobian, -1, 0).reshape(*leading, *jacobian.shape[:2])

    def _points(self, x, u):
        x, u = _samples(x, u)
        if not hasattr(self, "n_states_"):
            self.fit(x, u)
        if (x.shape[-1], u.shape[-1]) != (self.n_states_, self.n_inputs_):
            raise ValueError(
                f"x and u have {x.shape[-1]} and {u.shape[-1]} channels but the dictionary was fitted to {self.n_states_} and "
                f"{self.n_inputs_}; hand in the same channels."
            )
        return _columns(x, u), x.shape[:-1]

    @property
    def names(self):
        """Names of the N functions, channels called x1, x2, ... and u1, u2, ..."""
        return self.feature_names([f"x{i + 1}" for i in range(self.n_states_)] + [f"u{i + 1}" for i in range(self.n_inputs_)])

    def get_feature_names_out(self, input_features=None):
        """scikit-learn's name for `feature_names`."""
        return np.array(self.names if input_features is None else self.feature_names(list(input_features)), dtype=object)

    @property
    def coordinates(self):
        """Indices of the functions that are the states themselves: the constant comes first, then they."""
        return np.arange(1, 1 + self.n_states_)


class Monomials(Dictionary):
    """All products of states and inputs up to total degree ``degree``: N = (n + m + w)! / ((n + m)! w!) (paper, after (12)).

    Parameters
    ----------
    degree : int
        Total degree w >= 1. Degree 1 is a linear model.

    Examples
    --------
    >>> import numpy as np
    >>> psi = Monomials(2)
    >>> psi(np.array([[2.0, 3.0]]), np.array([[5.0]]))
    array([[ 1.,  2.,  3.,  5.,  4.,  6., 10.,  9., 15., 25.]])
    >>> psi.names
    ['1', 'x1', 'x2', 'u1', 'x1^2', 'x1 x2', 'x1 u1', 'x2^2', 'x2 u1', 'u1^2']
    """

    def __init__(self, degree=2):
        self.degree = degree

    def _prepare(self, z):
        if isinstance(self.degree, bool) or not isinstance(self.degree, (int, np.integer)) or self.degree < 1:
            raise ValueError(f"degree is {self.degree!r}; give a whole number, 1 or more.")
        channels = len(z)
        words = [w for k in range(self.degree + 1) for w in itertools.combinations_with_replacement(range(channels), k)]
        place = {word: j for j, word in enumerate(words)}
        self.exponents_ = np.array([[word.count(i) for i in range(channels)] for word in words])
        # Each monomial is a shorter one times one channel; one level of degree after the other is filled at once.
        first = [place.get(word[1:], 0) for word in words]
        letter = [word[0] if word else 0 for word in words]
        ends = np.cumsum(np.bincount([len(word) for word in words]))
        self._levels = [(slice(a, b), np.array(first[a:b]), np.array(letter[a:b])) for a, b in zip(ends[1:-1], ends[2:])]
        # d/dx_i of a monomial is its exponent times the monomial with one x_i less.
        self._slopes = self.exponents_[:, : self.n_states_, None].astype(float)
        self._lowered = np.array([[_without(word, i, place) for i in range(self.n_states_)] for word in words])

    def _lift(self, z):
        psi = np.empty((len(self.exponents_), z.shape[1]))
        psi[0] = 1
        psi[1 : 1 + len(z)] = z
        for level, shorter, letter in self._levels:
            np.multiply(psi[shorter], z[letter], out=psi[level])
        return psi

    def _lift_jacobian(self, z):
        return self._slopes * self._lift(z)[self._lowered]

    def feature_names(self, channels):
        """Names of the functions for the given channel names, states first."""
        powers = [[c if e == 1 else f"{c}^{e}" for c, e in zip(channels, row) if e] for row in self.exponents_]
        return [" ".join(factors) or "1" for factors in powers]


class GaussianRBF(Dictionary):
    """The constant, the states, the inputs, and Gaussians ``exp(-|z - c|^2 / width^2)`` of ``z = (x, u)``: N = 1 + n + m + centres.

    This is what "Gauss RBF of maximum degree w = 2" means in the public MATLAB code that the paper's method comes from: w
    Gaussians of width 1 at random centres in [-1, 1]^(n+m), on channels scaled to [-1, 1], beside states, inputs and a constant.

    Parameters
    ----------
    n_centres : int
        Number of Gaussians. A few bend a linear model a little; N grows by one each.
    width : float
        Distance at which a Gaussian has fallen to 1/e, in scaled units. Wider functions are smoother and closer to linearly
        dependent: watch the condition number.
    seed : int or numpy.random.Generator
        Draws the centres.

    Examples
    --------
    >>> import numpy as np
    >>> GaussianRBF(2, seed=1)(np.zeros((501, 4)), np.zeros((501, 2))).shape
    (501, 9)
    """

    def __init__(self, n_centres=2, width=1.0, seed=0):
        self.n_centres = n_centres
        self.width = width
        self.seed = seed

    def _prepare(self, z):
        if isinstance(self.n_centres, bool) or not isinstance(self.n_centres, (int, np.integer)) or self.n_centres < 1:
            raise ValueError(f"n_centres is {self.n_centres!r}; give a whole number, 1 or more.")
        if not (np.isfinite(self.width) and self.width > 0):
            raise ValueError(f"width is {self.width!r}; give a positive number, in units of the scaled channels.")
        if not hasattr(self, "centres_"):
            self.centres_ = np.random.default_rng(self.seed).uniform(-1, 1, size=(self.n_centres, len(z)))
        self._slope = self.centres_ * (2 / self.width**2)
        self._level = np.sum(self.centres_**2, axis=1, keepdims=True) / self.width**2

    def _lift(self, z):
        head = 1 + len(z)
        psi = np.empty((head + len(self.centres_), z.shape[1]))
        psi[0] = 1
        psi[1:head] = z
        # -|z - c|^2 = 2 c.z - |c|^2 - |z|^2 by one matrix product: no array of (centres, channels, points).
        exponent = psi[head:]
        np.matmul(self._slope, z, out=exponent)
        exponent -= self._level
        exponent -= np.add.reduce(z * z) / self.width**2
        np.exp(exponent, out=exponent)
        return psi

    def _lift_jacobian(self, z):
        n, head = self.n_states_, 1 + len(z)
        gaussians = self._lift(z)[head:, None, :]
        jacobian = np.zeros((head + len(self.centres_), n, z.shape[1]))
        jacobian[self.coordinates, np.arange(n)] = 1
        jacobian[head:] = (self.centres_[:, :n, None] - z[None, :n]) * gaussians * (2 / self.width**2)
        return jacobian

    def feature_names(self, channels):
        """Names of the functions for the given channel names, states first."""
        return ["1", *channels, *(f"gauss{i + 1}" for i in range(len(self.centres_)))]


def _samples(x, u):
    """x (..., n) and u (..., m) as floats with the same leading axes; ``u=None`` is m = 0."""
    x = np.asarray(x, dtype=float)
    u = np.empty((*x.shape[:-1], 0)) if u is None else np.asarray(u, dtype=float)
    if x.ndim == 0 or u.shape[:-1] != x.shape[:-1]:
        raise ValueError(f"x has shape {x.shape} and u {u.shape}; give (..., n) and (..., m) with the same leading axes.")
    return x, u


def _columns(x, u):
    """(n + m, points): channels first, so that every function of the lifting is one contiguous row."""
    n, m = x.shape[-1], u.shape[-1]
    z = np.empty((n + m, x.size // n))
    z[:n], z[n:] = x.reshape(-1, n).T, u.reshape(-1, m).T if m else 0
    return z


def _without(word, i, place):
    """Where the monomial with one factor i less stands; anywhere (0) when it has none, its slope is 0 then."""
    if i not in word:
        return 0
    shorter = list(word)
    shorter.remove(i)
    return place[tuple(shorter)]
