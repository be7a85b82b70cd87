"""A basis in which rows of functions are nearly orthonormal, for `tras.leastsquares`: made of a sample of the rows, applied to all."""

import math

import numpy as np
from scipy.linalg import blas, lapack

_EPS = np.finfo(float).eps
_RIDGE = 2.0**-36  # shortest direction of a basis, relative to the columns
_CANCELLED = 1e7  # terms of a row of B over their sum: beyond, the rounding of one product would be felt in the tenth digit


class Basis:
    """T upper triangular such that (Psi / scale) T is nearly orthonormal.

    Attributes
    ----------
    bits : int
        So many leading bits of Psi are multiplied exactly, if ``split``.
    split : bool
        Whether they are: terms cancel so much that the rounding errors of one product would spoil the coefficients.
    """

    def __init__(self, T, scale, bits, ridge, split):
        self.T, self.scale, self.bits, self.ridge, self.split = T, scale, bits, ridge, bool(split)
        self._product = np.asfortranarray(T / scale[:, None])  # scales are powers of two: exact
        self._shift = 1.5 * 2.0 ** (52 - bits) * scale

    @classmethod
    def of(cls, R, scale):
        """From the triangular factor R of some rows of Psi / scale."""
        p = len(R)
        size = np.linalg.norm(R)
        # Directions that the sample hardly contains get a length of 2^-36 instead of none, so that T stays bounded.
        ridge = np.zeros(p)
        if not lapack.dtrcon(R)[0] > _RIDGE:
            norms = np.linalg.norm(R, axis=0)
            ridge = _RIDGE * np.where(norms > 0, norms, 1.0)
            R = householder(np.diag(ridge), R)
        T = lapack.dtrtri(R)[0]
        # Grid for T: rounding moves the rows of B by a fraction of their size. All partial sums of (bits of Psi) T are
        # then multiples of one unit below 2^53 units.
        unit = 2.0 ** math.floor(math.log2(math.sqrt(12) / 8 / size)) if size > 0 else 1.0
        largest = np.abs(T).sum(axis=0).max() / unit
        bits = max(0, min(26, 53 - math.ceil(math.log2(largest) + 0.1)))
        rounded = np.rint(T / unit) * unit
        np.fill_diagonal(rounded, np.where(np.diag(rounded) == 0, np.diag(T), np.diag(rounded)))
        cancelled = (np.linalg.norm(R, axis=0) @ np.abs(T)).max()
        return cls(np.asfortranarray(rounded), scale, bits, ridge, cancelled > _CANCELLED)

    def whiten(self, x, overwrite=False):
        """B = (Psi / scale) T for rows ``x`` of Psi, in their place if they may be overwritten and lie column by column."""
        if not self.split:
            return blas.dtrmm(1.0, self._product, np.asarray(x, order="F"), side=1, overwrite_b=overwrite)
        return self._whiten_exactly(x)

    def _whiten_exactly(self, x):
        leading = np.add(x, self._shift, order="F")
        leading -= self._shift
        trailing = np.subtract(x, leading, order="F")
        b = blas.dtrmm(1.0, self._product, leading, side=1, overwrite_b=1)
        b += blas.dtrmm(1.0, self._product, trailing, side=1, overwrite_b=1)
        return b

    def multiply(self, x):
        """``x T`` for an upper triangular matrix of any size, with leading bits multiplied exactly."""
        size = powers_of_two(x.T)[:, None]
        return np.triu(self._whiten_exactly(x / size * self.scale) * size)

    def inverse(self):
        """T^-1 as a sum of two matrices, the second of the size of the first one's rounding errors (Newton's iteration)."""
        inverse = lapack.dtrtri(self.T)[0]
        for _ in range(2):
            inverse = inverse + rest if _ else inverse
            rest = (np.eye(len(inverse)) - self.multiply(inverse)) @ inverse
        return inverse, rest

    def same_as(self, other):
        return self is other or (np.array_equal(self.T, other.T) and np.array_equal(self.scale, other.scale) and self.bits == other.bits)

    def ridge_gram(self):
        """What rows ``diag(ridge)`` would add to G."""
        rows = self.ridge[:, None] * self.T
        return rows.T @ rows if self.ridge.any() else 0.0

    def factor(self, L):
        """R = L T^-1, upper triangular, with R^T R = (Psi / scale)^T (Psi / scale) when L^T L = G."""
        return np.triu(blas.dtrsm(1.0, self.T, L, side=1))


def householder(x, R=None):
    """Triangular factor of ``x``, or of ``R`` on top of ``x``, by LAPACK's panel-wise Householder QR."""
    p = x.shape[1]
    if R is None:
        if len(x) < p:
            x = np.vstack([x, np.zeros((p - len(x), p))])
        return np.asfortranarray(np.triu(lapack.dgeqrt(min(32, p), np.asfortranarray(x), overwrite_a=1)[0][:p]))
    return np.asfortranarray(np.triu(lapack.dtpqrt(0, min(32, p), np.asfortranarray(R), np.asfortranarray(x), overwrite_b=1)[0]))


def cholesky(gram):
    """Upper triangular L with L^T L = gram, of the equilibrated matrix; shifted by rounding errors if it is not positive."""
    diagonal = np.sqrt(np.diag(gram))
    diagonal = np.where(diagonal > 0, diagonal, 1.0)
    scaled = np.asfortranarray(gram / diagonal / diagonal[:, None])
    shift = 0.0
    while True:
        L, info = lapack.dpotrf(scaled + shift * np.eye(len(scaled)), clean=1, overwrite_a=1)
        if info == 0:
            return L * diagonal
        shift = 100 * shift or len(scaled) * _EPS


def condition_number(gram):
    """Estimated condition number of the equilibrated matrix in the 1-norm; infinite if it is not positive definite."""
    diagonal = np.diag(gram)
    if not (diagonal > 0).all():
        return math.inf
    scale = 1 / np.sqrt(diagonal)
    scaled = gram * scale * scale[:, None]
    L, info = lapack.dpotrf(scaled)
    if info:
        return math.inf
    reciprocal = lapack.dpocon(L, np.abs(scaled).sum(axis=0).max())[0]
    return 1 / reciprocal if reciprocal > 0 else math.inf


def powers_of_two(x):
    """For each column a power of two above its largest entry; 1 for a column of zeros."""
    largest = np.maximum(x.max(axis=0), -x.min(axis=0))
    return np.ldexp(1.0, np.frexp(np.where(largest > 0, largest, 0.5))[1])


def sums_of_squares(x):
    return np.einsum("ij,ij->j", x, x)


