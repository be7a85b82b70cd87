"""Dictionaries: the functions psi(x, u) that lift a state and an input (paper, (6)-(8)), and how to combine them.

Every dictionary begins with the constant, the states and the inputs, so a state can be read back from its lifting; what
follows is its own. They expect channels of order one: `tras.KoopmanModel` scales each channel to [-1, 1] before it lifts.

Here: monomials, exponentials, Fourier functions, unions and products. `tras.radial` holds the radial functions, `tras.mechanical` the one
for mechanical systems.
"""

import hashlib
import itertools

import numpy as np
from sklearn.base import BaseEstimator, clone

from tras import arguments

POSITIVE = "a positive number, in units of the scaled channels"  # what `tras.arguments.number` says to give
STRIP = 2**13  # points that are lifted at a time: what some dictionaries make on the way is no larger than that
_FEW = 256  # points for which calls cost more than copies

class Dictionary(BaseEstimator):
    """N functions of n states and m inputs, with names and exact Jacobians; scikit-learn conventions.

    A subclass supplies, for points in columns (``z`` is (n + m, points)):

    ``_learn(z)``
        Sets what depends on the data, in attributes that end in an underscore; these are what a file keeps.
    ``_build()``
        Derives the rest from them and from ``n_states_``, ``n_inputs_``; returns how many functions follow the head.
    ``_fill(psi, z)``
        Writes them into ``psi[head:]``; ``psi`` is (N, points), its head (constant, states, inputs) is there already. Several threads may call it
        at once, for strips of points.
    ``_fill_slopes(slopes, psi, z)``
        Writes their derivatives by the states into ``slopes[head:]``, (N, n, points), zero so far.
    ``_tail_names(channels)``
        Names them.
    """

    def fit(self, x, u=None):
        """Learn what the dictionary needs (the number of channels; centres) from samples (..., n) and (..., m)."""
        x, u = _samples(x, u)
        for name in [name for name in vars(self) if name.endswith("_")]:
            delattr(self, name)  # what an earlier fit learnt
        self.n_states_, self.n_inputs_ = x.shape[-1], u.shape[-1]
        self._learn(_columns(x, u))
        return self.restore()

    def __call__(self, x, u=None):
        """Lift: states (..., n) and inputs (..., m) -> (..., N), equation (7). An unfitted dictionary is fitted first."""
        z, leading = self.points(x, u)
        return self.lift(z).T.reshape(*leading, -1)

    def jacobian(self, x, u=None):
        """``d psi / d x``, used in (17) and (18): (..., n), (..., m) -> (..., N, n)."""
        z, leading = self.points(x, u)
        slopes = self.lift_slopes(z)
        return np.moveaxis(slopes, -1, 0).reshape(*leading, *slopes.shape[:2])

    def lift(self, z, out=None):
        """The same as calling, for points in columns: (n + m, points) -> (N, points), every function a contiguous row.

        ``out`` takes the result, if given. Symbols in place of numbers give formulas (`tras.symbols`).
        """
        head, points = 1 + len(z), z.shape[1]
        psi = np.empty((self.size, points), dtype=np.result_type(z, float)) if out is None else out
        psi[0] = 1
        psi[1:head] = z
        if points <= STRIP:
            self._fill(psi, z)
        else:
            for a in range(0, points, STRIP):
                self._fill(psi[:, a : a + STRIP], z[:, a : a + STRIP])
        return psi

    def lift_slopes(self, z):
        """The same as `jacobian`, for points in columns: (n + m, points) -> (N, n, points)."""
        return self.lift_with_slopes(z)[1]

    def lift_with_slopes(self, z):
        """`lift` and `lift_slopes` of the same points at once: most slopes are made of the functions' values."""
        psi, slopes = self.lift(z), np.zeros((self.size, self.n_states_, z.shape[1]))
        slopes[self.coordinates, np.arange(self.n_states_)] = 1
        self._fill_slopes(slopes, psi, z)
        return psi, slopes

    @property
    def names(self):
        """Names of the N functions, channels called x1, x2, ... and u1, u2, ..."""
        return self.feature_names([f"x{i + 1}" for i in range(self.n_states_)] + [f"u{i + 1}" for i in range(self.n_inputs_)])

    def feature_names(self, channels):
        """Names of the N functions for the given channel names, states first."""
        return ["1", *channels, *self._tail_names(list(channels))]

    def words(self, channels):
        """The dictionary in a few words for a report, channels by their names."""
        return label(self)

    def get_feature_names_out(self, input_features=None):
        """scikit-learn's name for `feature_names`."""
        return np.array(self.names if input_features is None else self.feature_names(list(input_features)), dtype=object)

    @property
    def coordinates(self):
        """Indices of the functions that are the states themselves: the constant comes first, then they."""
        return np.arange(1, 1 + self.n_states_)

    @property
    def confined(self):
        """Channels in which the functions are guesswork beyond the data, by number; None is all. See `tras.hull.Hull`."""
        return None

    def _learn(self, z):
        """Nothing depends on the data unless a subclass says so."""

    def restore(self):
        """Ready for use, from what was learnt: also after reading a file."""
        self.size = 1 + self.n_states_ + self.n_inputs_ + self._build()
        return self

    def points(self, x, u):
        x, u = _samples(x, u)
        if not hasattr(self, "n_states_"):
            self.fit(x, u)
        if (x.shape[-1], u.shape[-1]) != (self.n_states_, self.n_inputs_):
            raise ValueError(
                f"x and u have {x.shape[-1]} and {u.shape[-1]} channels but the dictionary was fitted to {self.n_states_} and "
                f"{self.n_inputs_}; hand in the same channels."
            )
        return _columns(x, u), x.shape[:-1]


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

    def words(self, channels):
        return "linear" if self.degree == 1 else f"monomials, degree {self.degree}"

    def _build(self):
        arguments.whole_number("degree", self.degree)
        channels = self.n_states_ + self.n_inputs_
        words = [w for k in range(self.degree + 1) for w in itertools.combinations_with_replacement(range(channels), k)]
        index = {word: j for j, word in enumerate(words)}
        self._exponents = np.array([[word.count(i) for i in range(channels)] for word in words])
        # Each monomial is a shorter one times one channel; one level of degree after the other is filled at once.
        first = [index.get(word[1:], 0) for word in words]
        letter = [word[0] if word else 0 for word in words]
        ends = np.cumsum(np.bincount([len(word) for word in words]))
        self._levels = [(slice(a, b), np.array(first[a:b]), np.array(letter[a:b])) for a, b in zip(ends[1:-1], ends[2:])]
        # The monomials of a level that begin with one channel stand together, and so do the shorter ones.
        same = [list(group) for _, group in itertools.groupby(range(1 + channels, len(words)), key=lambda j: (len(words[j]), letter[j]))]
        self._runs = [(slice(j[0], j[-1] + 1), slice(first[j[0]], first[j[-1]] + 1), letter[j[0]]) for j in same]
        # d/dx_i of a monomial is its exponent times the monomial with one x_i less.
        self._slopes = self._exponents[:, : self.n_states_, None].astype(float)
        self._lowered = np.array([[_without(word, i, index) for i in range(self.n_states_)] for word in words])
        return len(words) - 1 - channels

    def _fill(self, psi, z):
        if z.shape[1] < _FEW:
            for level, shorter, letter in self._levels:
                np.multiply(psi[shorter], z[letter], out=psi[level])
        else:
            for run, shorter, letter in self._runs:
                np.multiply(psi[shorter], z[letter], out=psi[run])

    def _fill_slopes(self, slopes, psi, z):
        np.multiply(self._slopes, psi[self._lowered], out=slopes)

    def _tail_names(self, channels):
        powers = [[c if e == 1 else f"{c}^{e}" for c, e in zip(channels, row) if e] for row in self._exponents]
        return [" ".join(factors) for factors in powers[1 + len(channels) :]]


class Exponentials(Dictionary):
    """``exp(rate k.z)`` for every whole vector k with ``0 < |k|_1 <= order``: named by the paper ("exponentials") beside monomials.

    Parameters
    ----------
    order : int
    rate : float
        Exponent at the edge of the scaled range. Small rates are nearly polynomials and nearly dependent, large ones steep.
    """

    def __init__(self, order=1, rate=1.0):
        self.order = order
        self.rate = rate

    def _build(self):
        arguments.whole_number("order", self.order)
        arguments.number("rate", self.rate, 0, ends=False, give=POSITIVE)
        self._k = np.array([k for k in _lattice(self.n_states_ + self.n_inputs_, self.order) if any(k)])
        self._wave = self.rate * self._k
        return len(self._wave)

    def _fill(self, psi, z):
        np.exp(self._wave @ z, out=psi[1 + len(z) :])

    def _fill_slopes(self, slopes, psi, z):
        head = 1 + len(z)
        slopes[head:] = self._wave[:, : self.n_states_, None] * psi[head:, None]

    def _tail_names(self, channels):
        return [f"exp({_combination(self.rate * k, channels)})" for k in self._k]


class Fourier(Dictionary):
    """``cos(2 pi k.z / period)`` and ``sin(...)`` for every whole vector k with ``0 < |k|_1 <= order``, k and -k once.

    Parameters
    ----------
    order : int
    period : float
        In scaled units, in which the data span 2. The default 4 lets functions that are not periodic over the data be followed.
    """

    def __init__(self, order=1, period=4.0):
        self.order = order
        self.period = period

    def _build(self):
        arguments.whole_number("order", self.order)
        arguments.number("period", self.period, 0, ends=False, give=POSITIVE)
        lattice = _lattice(self.n_states_ + self.n_inputs_, self.order)
        self._k = np.array([k for k in lattice if any(k) and next(c for c in k if c) > 0])
        self._wave = 2 * np.pi / self.period * self._k
        return 2 * len(self._wave)

    def _fill(self, psi, z):
        angle, head = self._wave @ z, 1 + len(z)
        half = head + len(angle)
        np.cos(angle, out=psi[head:half])
        np.sin(angle, out=psi[half:])

    def _fill_slopes(self, slopes, psi, z):
        head = 1 + len(z)
        half = head + len(self._wave)
        wave = self._wave[:, : self.n_states_, None]
        slopes[head:half] = -wave * psi[half:, None]
        slopes[half:] = wave * psi[head:half, None]

    def _tail_names(self, channels):
        sums = [_combination(k, channels) for k in self._k]
        return [f"{f}(w ({s}))" if " " in s else f"{f}(w {s})" for f in ("cos", "sin") for s in sums]


class _Combination(Dictionary):
    """Several dictionaries of the same channels, made one."""

    def __init__(self, *dictionaries, parts=()):
        if len(dictionaries) == 1 and isinstance(dictionaries[0], (list, tuple)):
            (dictionaries,) = dictionaries
        self.parts = list(dictionaries) if dictionaries else parts

    @classmethod
    def _get_param_names(cls):
        return ["parts"]  # scikit-learn wants every parameter named

    def _learn(self, z):
        if not self.parts or not all(isinstance(part, Dictionary) for part in self.parts):
            raise ValueError(f"parts is {self.parts!r}; give dictionaries, for example Union(Monomials(2), GaussianRBF(10)).")
        x, u = z[: self.n_states_].T, z[self.n_states_ :].T
        self.parts_ = [clone(part).fit(x, u) for part in self.parts]
        # Functions that two parts share must not come twice: they are recognised by their values at random points.
        points = np.random.default_rng(0).uniform(-1, 1, (len(z), 7))
        fingerprints, indices = set(), []
        for j, values in enumerate(self._all(points)):
            fingerprint = tuple(np.round(values, 10) + 0.0)
            if fingerprint not in fingerprints:
                fingerprints.add(fingerprint)
                indices.append(j)
        self.kept_ = np.array(indices)

    def _build(self):
        for part in self.parts_:
            part.restore()
        return len(self.kept_) - 1 - self.n_states_ - self.n_inputs_

    def _fill(self, psi, z):
        head = 1 + len(z)
        psi[head:] = self._all(z)[self.kept_[head:]]

    def _fill_slopes(self, slopes, psi, z):
        head = 1 + len(z)
        slopes[head:] = self._all_slopes(z)[self.kept_[head:]]

    def _tail_names(self, channels):
        names = self._all_names(channels)
        return [names[j] for j in self.kept_[1 + len(channels) :]]


class Union(_Combination):
    """The functions of several dictionaries, each once: ``Union(Monomials(2), GaussianRBF(10))``.

    Examples
    --------
    >>> import numpy as np
    >>> Union(Monomials(2), Monomials(3))(np.zeros(2)).shape == Monomials(3)(np.zeros(2)).shape
    True
    """

    def _all(self, z):
        return np.concatenate([part.lift(z) for part in self.parts_])

    def _all_slopes(self, z):
        return np.concatenate([part.lift_slopes(z) for part in self.parts_])

    def _all_names(self, channels):
        return [name for part in self.parts_ for name in part.feature_names(channels)]


class Product(_Combination):
    """Every function of one dictionary times every function of another, each product once.

    All dictionaries hold the constant, so their own functions are among the products.

    Examples
    --------
    >>> import numpy as np
    >>> Product(Monomials(1), Monomials(1))(np.zeros(2)).shape == Monomials(2)(np.zeros(2)).shape
    True
    """

    def _learn(self, z):
        if len(self.parts) != 2:
            raise ValueError(f"parts holds {len(self.parts)} dictionaries; a Product is of two, nest it for more.")
        super()._learn(z)

    def _all(self, z):
        a, b = (part.lift(z) for part in self.parts_)
        return (b[:, None] * a[None]).reshape(-1, z.shape[1])  # the constant of b first: the head of a leads

    def _all_slopes(self, z):
        (a, b), (da, db) = [part.lift(z) for part in self.parts_], [part.lift_slopes(z) for part in self.parts_]
        slopes = db[:, None] * a[None, :, None] + b[:, None, None] * da[None]
        return slopes.reshape(-1, *slopes.shape[2:])

    def _all_names(self, channels):
        a, b = (part.feature_names(channels) for part in self.parts_)
        return [f if g == "1" else g if f == "1" else f"{f} {g}" for g in b for f in a]


def label(estimator):
    """A dictionary in one line of a table, or a model by its dictionary and delays: every parameter that is set, with its value.

    >>> label(Union(Monomials(1), Fourier()))
    'Union(parts=[Monomials(degree=1), Fourier(order=1, period=4.0)])'
    """
    dictionary, delays = getattr(estimator, "dictionary", estimator), getattr(estimator, "delays", 0)
    parameters = {name: value for name, value in dictionary.get_params(deep=False).items() if value is not None}
    line = f"{type(dictionary).__name__}({', '.join(f'{name}={spelled(value)}' for name, value in parameters.items())})"
    return line + (f", {delays} delays" if delays else "")


def spelled(value):
    """An estimator with all its parameters, or the value of one, in a line of text; arrays and generators by a digest."""
    if isinstance(value, BaseEstimator):
        inner = {key: spelled(item) for key, item in value.get_params(deep=False).items()}
        return f"{type(value).__name__}({', '.join(f'{key}={item}' for key, item in inner.items())})"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(spelled, value))}]"
    if isinstance(value, np.random.Generator):
        return f"Generator {_digest(repr(value.bit_generator.state).encode())}"
    if isinstance(value, np.ndarray):
        return f"array {value.shape} {_digest(np.ascontiguousarray(value).tobytes())}"
    return repr(value.item() if isinstance(value, np.generic) else value)


def _digest(data):
    return hashlib.sha256(data).hexdigest()[:12]


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


def _without(word, i, index):
    """Where the monomial with one factor i less stands; anywhere (0) when it has none, its slope is 0 then."""
    if i not in word:
        return 0
    shorter = list(word)
    shorter.remove(i)
    return index[tuple(shorter)]


def _lattice(channels, order):
    """Whole vectors k with ``|k|_1 <= order``, in lexicographic order. (Those that are too long are never made: they would be (2 order + 1)^channels.)"""
    if channels == 0:
        return [()]
    return [(first, *rest) for first in range(-order, order + 1) for rest in _lattice(channels - 1, order - abs(first))]


def _combination(k, channels):
    """``x1 - 2 u1`` for coefficients and names."""
    terms = [f"{'-' if c < 0 else '+'} {'' if abs(c) == 1 else f'{abs(c):g} '}{name}" for c, name in zip(k, channels) if c]
    return " ".join(terms).removeprefix("+ ").replace("- ", "-", 1) if terms[0].startswith("-") else " ".join(terms).removeprefix("+ ")
