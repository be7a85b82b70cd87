"""A dictionary for mechanical systems whose inertia and gravity depend on a few positions only."""

import itertools
import math
from collections.abc import Sequence

import numpy as np

from tras.dictionaries.base import MOST_DEGREE, Dictionary
from tras.workflow import arguments


class Mechanical(Dictionary):
    """Functions of the shape times {1, inputs, velocities, other positions, products of two velocities}.

    The accelerations of a mechanical system are ``M(s)^-1 (u - C(s) qdot qdot - D qdot - K q - g(s))``: with respect to
    inputs, velocities and the positions that do not change the inertia they are polynomials of degree one or two, and
    only the dependence on the *shape* s, the positions that M and gravity depend on, is of any kind. So the shape gets
    polynomials up to a high degree (Chebyshev, well conditioned on [-1, 1]) and everything else no more than mechanics
    allows. For the twin rotor (shape: pitch) N = 81.

    Parameters
    ----------
    degree : int
        Highest total degree of the Chebyshev polynomials of the shape.
    positions, velocities : sequence of int, optional
        Which states are positions and which their velocities, in the same order. Default: they alternate, position
        first.
    shape : sequence of int, optional
        The positions that inertia and gravity depend on. Default: the first position.

    Raises
    ------
    ValueError
        On ``fit``, if the states cannot be told apart or ``shape`` holds something that is no position.

    Examples
    --------
    >>> import numpy as np
    >>> psi = Mechanical(2)
    >>> psi(np.zeros((501, 2)), np.zeros((501, 1))).shape
    (501, 12)
    >>> psi.feature_names(["q", "v", "u"])[4:]
    ['T2(q)', 'T1(q) u', 'T2(q) u', 'T1(q) v', 'T2(q) v', 'v v', 'T1(q) v v', 'T2(q) v v']
    """

    def __init__(
        self,
        degree: int = 8,
        positions: Sequence[int] | None = None,
        velocities: Sequence[int] | None = None,
        shape: Sequence[int] | None = None,
    ):
        self.degree = degree
        self.positions = positions
        self.velocities = velocities
        self.shape = shape

    def words(self, channels: Sequence[str]) -> str:
        shape = ", ".join(channels[i] if i < len(channels) else str(i) for i in self.shape or [0])
        return f"mechanical, degree {self.degree} in {shape}"

    def _count(self):
        arguments.whole_number("degree", self.degree, 1, MOST_DEGREE)
        positions, velocities, shape = self._roles()
        polynomials = math.comb(len(shape) + self.degree, len(shape))
        pairs = math.comb(len(velocities) + 1, 2)
        letters = self.n_inputs_ + len(velocities) + len(positions) - len(shape)
        return polynomials - 1 - len(shape) + letters * (polynomials - 1) + pairs * polynomials

    def _build(self):
        arguments.whole_number("degree", self.degree, 1, MOST_DEGREE)
        positions, velocities, shape = self._roles()
        n, m = self.n_states_, self.n_inputs_
        others = [p for p in positions if p not in shape]
        words = [(), *((n + j,) for j in range(m)), *((v,) for v in velocities), *((p,) for p in others)]
        words += itertools.combinations_with_replacement(velocities, 2)
        powers = _powers(len(shape), self.degree)
        # The head already holds the constant, every channel, and T1 of the shape.
        terms = [(k, w) for w in words for k in powers if sum(k) + len(w) > 1]
        self._shape, self._words = shape, words
        self._powers = np.array([k for k, _ in terms])
        self._word = np.array([words.index(w) for _, w in terms])
        # A word has at most two letters: its product is one of two rows of (1, z), 0 standing for the 1.
        self._letters = np.array([[1 + i for i in w] + [0] * (2 - len(w)) for w in words]).T
        # For the slopes: each factor of each word that is a state, and what it leaves.
        self._factors = [(j, i, w[:k] + w[k + 1 :]) for j, w in enumerate(words) for k, i in enumerate(w) if i < n]
        return len(terms)

    @property
    def confined(self) -> list[int] | None:
        """The positions: inputs and velocities enter at most quadratically, as mechanics has it everywhere."""
        return self._roles()[0]

    def _roles(self):
        n = self.n_states_
        positions = list(range(0, n, 2)) if self.positions is None else list(self.positions)
        velocities = list(range(1, n, 2)) if self.velocities is None else list(self.velocities)
        shape = positions[:1] if self.shape is None else list(self.shape)
        if sorted(positions + velocities) != list(range(n)) or len(positions) != len(velocities):
            raise ValueError(
                f"positions {positions} and velocities {velocities} do not pair the {n} states; "
                "say which state is which, for example "
                "positions=[0, 2], velocities=[1, 3]."
            )
        if not shape or not set(shape) <= set(positions) or len(set(shape)) < len(shape):
            raise ValueError(f"shape {shape} must name positions, which are {positions}, each once.")
        return positions, velocities, shape

    def _fill(self, psi, z):
        polynomials = self._polynomials([_chebyshev(z[i], self.degree) for i in self._shape])
        np.multiply(polynomials, self._products(psi, z)[self._word], out=psi[1 + len(z) :])

    def _fill_slopes(self, slopes, psi, z):
        head = 1 + len(z)
        tables = [_chebyshev(z[i], self.degree) for i in self._shape]
        products = self._products(psi, z)[self._word]
        for c, i in enumerate(self._shape):
            derived = [_chebyshev_derivatives(z[i], self.degree) if d == c else table for d, table in enumerate(tables)]
            slopes[head:, i] += self._polynomials(derived) * products
        polynomials = self._polynomials(tables)
        for j, i, rest in self._factors:
            rows = np.flatnonzero(self._word == j)
            slopes[head + rows, i] += polynomials[rows] * (z[rest[0]] if rest else 1.0)

    def _products(self, psi, z):
        """The words' values (words, points), from the head of ``psi``, which is (1, z)."""
        first, second = self._letters
        return psi[first] * psi[second]

    def _polynomials(self, tables):
        """Products over the shape of polynomials: tables (degree + 1, points) -> (functions, points)."""
        product = tables[0][self._powers[:, 0]]
        for c in range(1, len(tables)):
            product = product * tables[c][self._powers[:, c]]
        return product

    def _tail_names(self, channels):
        names = []
        for powers, word in zip(self._powers, self._word):
            shape = [f"T{k}({channels[i]})" for k, i in zip(powers, self._shape) if k]
            names.append(" ".join(shape + [channels[i] for i in self._words[word]]))
        return names


def _powers(channels, degree):
    """Exponents of total degree at most ``degree``, in lexicographic order; others are never made."""
    if channels == 0:
        return [()]
    return [(first, *rest) for first in range(degree + 1) for rest in _powers(channels - 1, degree - first)]


def _chebyshev(s, degree):
    """T_0 ... T_degree at s (points,): (degree + 1, points)."""
    T = np.empty((degree + 1, len(s)), dtype=np.result_type(s, float))
    T[0], T[1] = 1, s
    twice = 2 * s
    for k in range(2, degree + 1):
        np.multiply(twice, T[k - 1], out=T[k])
        T[k] -= T[k - 2]
    return T


def _chebyshev_derivatives(s, degree):
    """``T_k' = k U_(k-1)``: (degree + 1, points)."""
    U = np.zeros((degree + 1, len(s)))  # U[k] holds U_(k-1)
    U[1] = 1
    for k in range(2, degree + 1):
        U[k] = 2 * s * U[k - 1] - U[k - 2]
    return U * np.arange(degree + 1)[:, None]
