"""Functions of linear combinations of the channels: exponentials (named by the paper), cosines and sines."""

import math

import numpy as np

from tras.dictionaries.base import MOST_DEGREE, POSITIVE, Dictionary
from tras.workflow import arguments


class Exponentials(Dictionary):
    """``exp(rate k.z)`` for every whole vector k with ``0 < |k|_1 <= order``: named by the paper ("exponentials")
    beside monomials.

    Parameters
    ----------
    order : int
    rate : float
        Exponent at the edge of the scaled range. Small rates are nearly polynomials and nearly dependent, large ones
        steep.

    Examples
    --------
    >>> Exponentials(1).fit([[0.0]], [[0.0]]).names
    ['1', 'x1', 'u1', 'exp(-x1)', 'exp(-u1)', 'exp(u1)', 'exp(x1)']
    """

    def __init__(self, order: int = 1, rate: float = 1.0):
        self.order = order
        self.rate = rate

    def _count(self):
        arguments.whole_number("order", self.order, 1, MOST_DEGREE)
        arguments.number("rate", self.rate, 0, ends=False, give=POSITIVE)
        return _lattice_size(self.n_states_ + self.n_inputs_, self.order) - 1

    def _build(self):
        arguments.whole_number("order", self.order, 1, MOST_DEGREE)
        arguments.number("rate", self.rate, 0, ends=False, give=POSITIVE)
        self._k = np.array([k for k in _lattice(self.n_states_ + self.n_inputs_, self.order) if any(k)])
        self._wave = self.rate * self._k
        return len(self._wave)

    def _fill(self, psi, z):
        np.exp(self._wave @ z, out=psi[1 + len(z) :])

    def _fill_slopes(self, slopes, psi, z):
        head = 1 + len(z)
        slopes[head:] = self._wave[:, : slopes.shape[1], None] * psi[head:, None]

    def _tail_names(self, channels):
        return [f"exp({_combination(self.rate * k, channels)})" for k in self._k]


class Fourier(Dictionary):
    """``cos(2 pi k.z / period)`` and ``sin(...)`` for every whole vector k with ``0 < |k|_1 <= order``, k and -k once.

    Parameters
    ----------
    order : int
    period : float
        In scaled units, in which the data span 2. The default 4 lets functions that are not periodic over the data be
        followed.

    Examples
    --------
    >>> Fourier(1).fit([[0.0]], [[0.0]]).names
    ['1', 'x1', 'u1', 'cos(w u1)', 'cos(w x1)', 'sin(w u1)', 'sin(w x1)']
    """

    def __init__(self, order: int = 1, period: float = 4.0):
        self.order = order
        self.period = period

    def _count(self):
        arguments.whole_number("order", self.order, 1, MOST_DEGREE)
        arguments.number("period", self.period, 0, ends=False, give=POSITIVE)
        return _lattice_size(self.n_states_ + self.n_inputs_, self.order) - 1

    def _build(self):
        arguments.whole_number("order", self.order, 1, MOST_DEGREE)
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
        wave = self._wave[:, : slopes.shape[1], None]
        slopes[head:half] = -wave * psi[half:, None]
        slopes[half:] = wave * psi[head:half, None]

    def _tail_names(self, channels):
        sums = [_combination(k, channels) for k in self._k]
        return [f"{f}(w ({s}))" if " " in s else f"{f}(w {s})" for f in ("cos", "sin") for s in sums]


def _lattice(channels, order):
    """Whole vectors k with ``|k|_1 <= order``, in lexicographic order; longer ones are never made."""
    if channels == 0:
        return [()]
    return [(first, *rest) for first in range(-order, order + 1) for rest in _lattice(channels - 1, order - abs(first))]


def _lattice_size(channels, order):
    """How many vectors `_lattice` has: i of the channels are not zero, each with a sign."""
    return sum(2**i * math.comb(channels, i) * math.comb(order, i) for i in range(min(channels, order) + 1))


def _combination(k, channels):
    """``x1 - 2 u1`` for coefficients and names."""
    terms = [
        f"{'-' if c < 0 else '+'} {'' if abs(c) == 1 else f'{abs(c):g} '}{name}" for c, name in zip(k, channels) if c
    ]
    return (
        " ".join(terms).removeprefix("+ ").replace("- ", "-", 1)
        if terms[0].startswith("-")
        else " ".join(terms).removeprefix("+ ")
    )
