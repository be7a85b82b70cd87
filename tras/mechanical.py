"""A dictionary for mechanical systems M(q) qddot + ... = ..., whose inertia and gravity depend on a few positions only."""

import itertools

import numpy as np

from tras.dictionary import Dictionary, check_count


class Mechanical(Dictionary):
    """Functions of the shape times {1, inputs, velocities, other positions, products of two velocities}.

    The accelerations of a mechanical system are ``M(s)^-1 (u - C(s) qdot qdot - D qdot - K q - g(s))``: with respect to inputs,
    velocities and the positions that do not change the inertia they are polynomials of degree one or two, and only the dependence
    on the *shape* s, the positions that M and gravity depend on, is of any kind. So the shape gets polynomials up to a high degree (Chebyshev, well
    conditioned on [-1, 1]) and everything else no more than mechanics allows. For the twin rotor (shape: pitch) N = 81.

    Parameters
    ----------
    degree : int
        Highest total degree of the Chebyshev polynomials of the shape.
    positions, velocities : sequence of int, optional
        Which states are positions and which their velocities, in the same order. Default: they alternate, position first.
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

    def __init__(self, degree=8, positions=None, velocities=None, shape=None):
        self.degree = degree
        self.positions = positions
        self.velocities = velocities
        self.shape = shape

    def _build(self):
        check_count("degree", self.degree)
        positions, velocities, shape = self._roles()
        n, m = self.n_states_, self.n_inputs_
        others = [p for p in positions if p not in shape]
        words = [(), *((n + j,) for j in range(m)), *((v,) for v in velocities), *((p,) for p in others)]
        words += itertools.combinations_with_replacement(velocities, 2)
        powers = [k for k in itertools.product(range(self.degree + 1), repeat=len(shape)) if sum(k) <= self.degree]
        # The head already holds the constant, every channel, and T1 of the shape.
        terms = [(k, w) for w in words for k in powers if sum(k) + len(w) > 1]
        self._shape, self._words = shape, words
        self._powers = np.array([k for k, _ in terms])
        self._word = np.array([words.index(w) for _, w in terms])
        # For the slopes: each factor of each word, and the word without it.
        self._factors = [(j, i, tuple(w[:k] + w[k + 1 :])) for j, w in enumerate(words) for k, i in enumerate(w) if i < n]
        return len(terms)

    def _roles(self):
        n = self.n_states_
        positions = list(range(0, n, 2)) if self.positions is None else list(self.positions)
        velocities = list(range(1, n, 2)) if self.velocities is None else list(self.velocities)
        shape = positions[:1] if self.shape is None else list(self.shape)
        if sorted(positions + velocities) != list(range(n)) or len(positions) != len(velocities):
            raise ValueError(
                f"positions {positions} and velocities {velocities} do not pair the {n} states; say which state is which, for example "
                "positions=[0, 2], velocities=[1, 3]."
            )
        if not shape or not set(shape) <= set(positions):
            raise ValueError(f"shape {shape} must name positions, which are {positions}.")
        return positions, velocities, shape

    def _fill(self, psi, z):
        chebyshev, _ = self._chebyshev(z)
        np.multiply(chebyshev, self._products(z)[self._word], out=psi[1 + len(z) :])

    def _fill_slopes(self, slopes, psi, z):
        head = 1 + len(z)
        chebyshev, derivatives = self._chebyshev(z)
        products = self._products(z)
        for i, derivative in zip(self._shape, derivatives):
            slopes[head:, i] += derivative * products[self._word]
        for j, i, rest in self._factors:
            rows = np.flatnonzero(self._word == j)
            slopes[head + rows, i] += chebyshev[rows] * _product(z, rest)

    def _products(self, z):
        """The products of channels: (words, points)."""
        return np.array([_product(z, word) for word in self._words])

    def _chebyshev(self, z):
        """Products of Chebyshev polynomials of the shape for each function, and their derivatives by each shape coordinate."""
        tables = [_chebyshev(z[i], self.degree) for i in self._shape]
        factors = [T[self._powers[:, c]] for c, (T, _) in enumerate(tables)]
        derivatives = []
        for c, (_, dT) in enumerate(tables):
            others = [factor for d, factor in enumerate(factors) if d != c]
            derivatives.append(np.prod([dT[self._powers[:, c]], *others], axis=0))
        return np.prod(factors, axis=0), derivatives

    def _tail_names(self, channels):
        names = []
        for powers, word in zip(self._powers, self._word):
            shape = [f"T{k}({channels[i]})" for k, i in zip(powers, self._shape) if k]
            names.append(" ".join(shape + [channels[i] for i in self._words[word]]))
        return names


def _product(z, word):
    return np.prod(z[list(word)], axis=0) if word else np.ones(z.shape[1])


def _chebyshev(s, degree):
    """T_0 ... T_degree at s (points,) and their derivatives ``T_k' = k U_(k-1)``: two arrays (degree + 1, points)."""
    T, U = np.ones((degree + 1, len(s))), np.zeros((degree + 1, len(s)))  # U[k] holds U_(k-1)
    T[1], U[1] = s, 1
    for k in range(2, degree + 1):
        T[k] = 2 * s * T[k - 1] - T[k - 2]
        U[k] = 2 * s * U[k - 1] - U[k - 2]
    return T, U * np.arange(degree + 1)[:, None]
