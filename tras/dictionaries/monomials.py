"""All products of states and inputs up to a total degree (paper, after (12))."""

import itertools
import math
from collections.abc import Sequence

import numpy as np

from tras.dictionaries.base import MOST_DEGREE, Dictionary
from tras.workflow import arguments

_FEW = 256  # points for which calls cost more than copies


class Monomials(Dictionary):
    """All products of states and inputs up to total degree ``degree``: N = (n + m + w)! / ((n + m)! w!) (paper, after
    (12)).

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

    def __init__(self, degree: int = 2):
        self.degree = degree

    def words(self, channels: Sequence[str]) -> str:
        return "linear" if self.degree == 1 else f"monomials, degree {self.degree}"

    def _count(self):
        arguments.whole_number("degree", self.degree, 1, MOST_DEGREE)
        channels = self.n_states_ + self.n_inputs_
        return math.comb(channels + self.degree, channels) - 1 - channels

    def _build(self):
        arguments.whole_number("degree", self.degree, 1, MOST_DEGREE)
        channels = self.n_states_ + self.n_inputs_
        words = [w for k in range(self.degree + 1) for w in itertools.combinations_with_replacement(range(channels), k)]
        index = {word: j for j, word in enumerate(words)}
        self._exponents = np.array([[word.count(i) for i in range(channels)] for word in words])
        # Each monomial is a shorter one times one channel; one level of degree after the other is filled at once.
        first = [index.get(word[1:], 0) for word in words]
        letter = [word[0] if word else 0 for word in words]
        ends = np.cumsum(np.bincount([len(word) for word in words]))
        self._levels = [
            (slice(a, b), np.array(first[a:b]), np.array(letter[a:b])) for a, b in zip(ends[1:-1], ends[2:])
        ]
        # The monomials of a level that begin with one channel stand together, and so do the shorter ones.
        same = [
            list(group)
            for _, group in itertools.groupby(range(1 + channels, len(words)), key=lambda j: (len(words[j]), letter[j]))
        ]
        self._runs = [(slice(j[0], j[-1] + 1), slice(first[j[0]], first[j[-1]] + 1), letter[j[0]]) for j in same]
        # d/dx_i of a monomial is its exponent times the monomial with one x_i less.
        self._slopes = self._exponents[:, :, None].astype(float)
        self._lowered = np.array([[_without(word, i, index) for i in range(channels)] for word in words])
        return len(words) - 1 - channels

    def _fill(self, psi, z):
        if z.shape[1] < _FEW:
            for level, shorter, letter in self._levels:
                np.multiply(psi[shorter], z[letter], out=psi[level])
        else:
            for run, shorter, letter in self._runs:
                np.multiply(psi[shorter], z[letter], out=psi[run])

    def _fill_slopes(self, slopes, psi, z):
        channels = slopes.shape[1]
        np.multiply(self._slopes[:, :channels], psi[self._lowered[:, :channels]], out=slopes)

    def _tail_names(self, channels):
        powers = [[c if e == 1 else f"{c}^{e}" for c, e in zip(channels, row) if e] for row in self._exponents]
        return [" ".join(factors) for factors in powers[1 + len(channels) :]]


def _without(word, i, index):
    """Where the monomial with one factor i less stands; anywhere (0) when it has none, its slope is 0 then."""
    if i not in word:
        return 0
    shorter = list(word)
    shorter.remove(i)
    return index[tuple(shorter)]
