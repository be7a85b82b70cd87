"""Dictionaries: the functions psi(x, u) that lift a state and an input (paper, (6)-(8)).

Every dictionary begins with the constant, the states and the inputs, so a state can be read back from its lifting; what
follows is its own. They expect channels of order one: `tras.KoopmanModel` scales each channel to [-1, 1] before it
lifts.
"""

import hashlib
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator, clone

POSITIVE = "a positive number, in units of the scaled channels"  # what `tras.workflow.arguments.number` says to give
MOST_DEGREE = 1000  # of a polynomial or a wave; what is beyond is a slip, and slow to count already
MARGIN = 0.25  # of the box around the data in which functions are trusted (`tras.hull`), in half-ranges
STRIP = 2**13  # points that are lifted at a time: what some dictionaries make on the way is no larger than that


class Dictionary(BaseEstimator):
    """N functions of n states and m inputs, with names and exact Jacobians; scikit-learn conventions.

    A subclass supplies, for points in columns (``z`` is (n + m, points)):

    ``_learn(z)``
        Sets what depends on the data, in attributes that end in an underscore; these are what a file keeps.
    ``_count()``
        How many functions follow the head, before anything is learnt or built: a ValueError on a wrong parameter.
    ``_build()``
        Derives the rest from them and from ``n_states_``, ``n_inputs_``; returns how many functions follow the head.
    ``_fill(psi, z)``
        Writes them into ``psi[head:]``; ``psi`` is (N, points), its head (constant, states, inputs) is there already.
        Several threads may call it at once, for strips of points.
    ``_fill_slopes(slopes, psi, z)``
        Writes their derivatives by the first channels into ``slopes[head:]``, zero so far: by the states, (N, n,
        points), or by the inputs too, (N, n + m, points).
    ``_tail_names(channels)``
        Names them.
    """

    def fit(self, x: ArrayLike, u: ArrayLike | None = None, origin: ArrayLike | None = None) -> "Dictionary":
        """Learn what the dictionary needs (the number of channels; centres) from samples (..., n) and (..., m).

        ``origin`` (n + m,) says where the zeros of the channels lie in their scaled values; 0 by default.
        """
        x, u = _samples(x, u)
        for name in [name for name in vars(self) if name.endswith("_")]:
            delattr(self, name)  # what an earlier fit learnt
        self.n_states_, self.n_inputs_ = x.shape[-1], u.shape[-1]
        self._origin = np.zeros(x.shape[-1] + u.shape[-1]) if origin is None else np.asarray(origin, dtype=float)
        self._learn(_columns(x, u))
        return self.restore()

    def __call__(self, x: ArrayLike, u: ArrayLike | None = None) -> np.ndarray:
        """Lift states (..., n) and inputs (..., m): (..., N), equation (7). An unfitted dictionary is fitted first."""
        z, leading = self.points(x, u)
        return self.lift(z).T.reshape(*leading, -1)

    def jacobian(self, x: ArrayLike, u: ArrayLike | None = None) -> np.ndarray:
        """``d psi / d x``, used in (17) and (18): (..., n), (..., m) -> (..., N, n)."""
        z, leading = self.points(x, u)
        slopes = self.lift_slopes(z)
        return np.moveaxis(slopes, -1, 0).reshape(*leading, *slopes.shape[:2])

    def lift(self, z: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """The same as calling, for points in columns: (n + m, points) -> (N, points), every function a contiguous row.

        ``out`` takes the result, if given. Symbols in place of numbers give formulas (`tras.export.symbols`).
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

    def lift_slopes(self, z: np.ndarray) -> np.ndarray:
        """The same as `jacobian`, for points in columns: (n + m, points) -> (N, n, points)."""
        return self.lift_with_slopes(z)[1]

    def lift_with_slopes(self, z: np.ndarray, *, inputs: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """`lift` and `lift_slopes` of the same points at once: most slopes are made of the functions' values.

        With ``inputs`` the slopes by the inputs follow those by the states: (N, n + m, points).
        """
        channels = len(z) if inputs else self.n_states_
        psi, slopes = self.lift(z), np.zeros((self.size, channels, z.shape[1]))
        slopes[1 + np.arange(channels), np.arange(channels)] = 1
        self._fill_slopes(slopes, psi, z)
        return psi, slopes

    @property
    def names(self) -> list[str]:
        """Names of the N functions, channels called x1, x2, ... and u1, u2, ..."""
        return self.feature_names(
            [f"x{i + 1}" for i in range(self.n_states_)] + [f"u{i + 1}" for i in range(self.n_inputs_)]
        )

    def feature_names(self, channels: list[str]) -> list[str]:
        """Names of the N functions for the given channel names, states first."""
        return ["1", *channels, *self._tail_names(list(channels))]

    def words(self, channels: Sequence[str]) -> str:
        """The dictionary in a few words for a report, channels by their names."""
        return label(self)

    def get_feature_names_out(self, input_features: Sequence[str] | None = None) -> np.ndarray:
        """scikit-learn's name for `feature_names`."""
        return np.array(
            self.names if input_features is None else self.feature_names(list(input_features)), dtype=object
        )

    @property
    def coordinates(self) -> np.ndarray:
        """Indices of the functions that are the states themselves: the constant comes first, then they."""
        return np.arange(1, 1 + self.n_states_)

    @property
    def confined(self) -> list[int] | None:
        """Numbers of the channels in which the functions are guesswork beyond the data (`tras.hull`); None is all."""
        return None

    @property
    def margin(self) -> float | np.ndarray:
        """How far beyond the data the functions are still trusted, in half-ranges; a number, or (n + m,) numbers."""
        return MARGIN

    def _learn(self, z):
        """Nothing depends on the data unless a subclass says so."""

    def count(self) -> int:
        """The number of functions, known from what was learnt before anything is built or lifted."""
        return 1 + self.n_states_ + self.n_inputs_ + self._count()

    def count_of(self, states: int, inputs: int) -> int:
        """The number of functions of so many channels, known before anything is learnt; of a combination at most.

        >>> import tras
        >>> tras.Monomials(6).count_of(18, 0)
        134596
        """
        new = clone(self)
        new.n_states_, new.n_inputs_ = states, inputs
        return new.count()

    def _count(self):
        """None behind the head, as far as is known: a subclass says better."""
        return 0

    def restore(self) -> "Dictionary":
        """Ready for use, from what was learnt: also after reading a file."""
        self.size = 1 + self.n_states_ + self.n_inputs_ + self._build()
        return self

    def points(self, x: ArrayLike, u: ArrayLike | None) -> tuple[np.ndarray, np.ndarray]:
        """``x`` (..., n) and ``u`` (..., m) as arrays of floats; without inputs ``u`` is (..., 0)."""
        x, u = _samples(x, u)
        if not hasattr(self, "n_states_"):
            self.fit(x, u)
        if (x.shape[-1], u.shape[-1]) != (self.n_states_, self.n_inputs_):
            raise ValueError(
                f"x and u have {x.shape[-1]} and {u.shape[-1]} channels but the dictionary was fitted to "
                f"{self.n_states_} and {self.n_inputs_}; hand in the same channels."
            )
        return _columns(x, u), x.shape[:-1]


def label(estimator: BaseEstimator) -> str:
    """A dictionary in one line of a table, or a model by its dictionary and delays: every parameter that is set, with
    its value.

    >>> import tras
    >>> label(tras.Union(tras.Monomials(1), tras.Fourier()))
    'Union(parts=[Monomials(degree=1), Fourier(order=1, period=4.0)])'
    """
    dictionary, delays = getattr(estimator, "dictionary", estimator), getattr(estimator, "delays", 0)
    parameters = {name: value for name, value in dictionary.get_params(deep=False).items() if value is not None}
    line = f"{type(dictionary).__name__}({', '.join(f'{name}={spelled(value)}' for name, value in parameters.items())})"
    return line + (f", {delays} delays" if delays else "")


def spelled(value) -> str:
    """An estimator with all its parameters, or one value, in a line of text; arrays and generators by a digest."""
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
        raise ValueError(
            f"x has shape {x.shape} and u {u.shape}; give (..., n) and (..., m) with the same leading axes."
        )
    return x, u


def _columns(x, u):
    """(n + m, points): channels first, so that every function of the lifting is one contiguous row."""
    n, m = x.shape[-1], u.shape[-1]
    z = np.empty((n + m, x.size // n))
    z[:n], z[n:] = x.reshape(-1, n).T, u.reshape(-1, m).T if m else 0
    return z
