"""A basis in which rows of functions are nearly orthonormal: made of a sample of the rows, applied to all."""

import math

import numpy as np
from scipy import sparse
from scipy.linalg import blas, lapack

_EPS = np.finfo(float).eps
_SPREAD = 2  # rows of a sketch that each row goes into
_NOTHING = 2.0**-480  # a column whose entries are all smaller holds nothing: their squares are no numbers
_RIDGE = 2.0**-36  # shortest direction of a basis, relative to the columns
_TOGETHER = 16  # columns whose leading bits are taken at a time, in the cache
_CANCELLED = 1e7  # terms of a row of B over their sum: beyond, rounding would be felt in the tenth digit


class Basis:
    """T upper triangular such that (Psi / scale) T is nearly orthonormal.

    Attributes
    ----------
    bits : int
        Number of leading bits of Psi that are multiplied exactly, for columns from ``exact`` on.
    exact : int
        First column of T whose terms cancel so much that the rounding errors of one product would spoil the
        coefficients; the number of columns if there is none.
    """

    def __init__(self, T, scale, bits, ridge, exact):
        self.T, self.scale, self.bits, self.ridge, self.exact = T, scale, bits, ridge, int(exact)
        self._blocks = _blocks(T / scale[:, None], self.exact)  # scales are powers of two: no rounding
        self._shift = 1.5 * 2.0 ** (52 - bits) * scale

    @classmethod
    def of(cls, R, scale) -> "Basis":
        """From the triangular factor R of some rows of Psi / scale."""
        p = len(R)
        size = np.linalg.norm(R)
        # Directions that the sample hardly contains get a length of 2^-36 instead of none, so that T stays bounded.
        ridge = np.zeros(p)
        if not lapack.dtrcon(R)[0] > _RIDGE:
            norms = np.linalg.norm(R, axis=0)
            ridge = _RIDGE * np.where(norms > _NOTHING, norms, 1.0)
            R = householder(np.diag(ridge), R, triangular=True)
        T = lapack.dtrtri(R)[0]
        # Grid for T: rounding moves the rows of B by a fraction of their size. All partial sums of (bits of Psi) T are
        # then multiples of one unit below 2^53 units.
        unit = 2.0 ** math.floor(math.log2(math.sqrt(12) / 8 / size)) if size > 0 else 1.0
        largest = np.abs(T).sum(axis=0).max() / unit
        bits = max(0, min(26, 53 - math.ceil(math.log2(largest) + 0.1)))
        rounded = np.rint(T / unit) * unit
        np.fill_diagonal(rounded, np.where(np.diag(rounded) == 0, np.diag(T), np.diag(rounded)))
        cancelled = np.linalg.norm(R, axis=0) @ np.abs(T)
        # Columns whose terms cancel by less than what is left of the worst one's rounding errors need no care either.
        exact = np.argmax(cancelled > cancelled.max() * 2.0**-bits) if cancelled.max() > _CANCELLED else p
        return cls(np.asfortranarray(rounded), scale, bits, ridge, exact)

    def whiten(self, x, overwrite=False) -> np.ndarray:
        """B = (Psi / scale) T for rows ``x`` of Psi, in place if ``overwrite`` and ``x`` lies column by column."""
        if self.exact == len(self.T):
            return blas.dtrmm(1.0, self._blocks[0], np.asarray(x, order="F"), side=1, overwrite_b=overwrite)
        return self._exactly(x if overwrite and x.flags.f_contiguous else np.array(x, order="F"), *self._blocks)

    def _exactly(self, x, head, side, corner):
        """Leading bits of x, then trailing ones, times ``corner``; one product for ``head``. Overwrites x."""
        leading, j = np.empty_like(x), len(head)
        for k in range(0, x.shape[1], _TOGETHER):
            some = slice(k, k + _TOGETHER)
            np.add(x[:, some], self._shift[some], out=leading[:, some])
            leading[:, some] -= self._shift[some]
            x[:, some] -= leading[:, some]
        for bits in (leading, x):
            blas.dtrmm(1.0, corner, bits[:, j:], side=1, overwrite_b=1)
            if j:
                blas.dgemm(1.0, bits[:, :j], side, 1.0, bits[:, j:], overwrite_c=1)
        x += leading
        if j:
            blas.dtrmm(1.0, head, x[:, :j], side=1, overwrite_b=1)
        return x

    def multiply(self, x) -> np.ndarray:
        """``x T`` for an upper triangular matrix of any size, with leading bits multiplied exactly."""
        size = powers_of_two(x.T)[:, None]
        whole = _blocks(self.T / self.scale[:, None], 0)
        return np.triu(self._exactly(np.array(x / size * self.scale, order="F"), *whole) * size)

    def inverse(self) -> tuple[np.ndarray, np.ndarray]:
        """T^-1 as a sum of two, the second as small as the first one's rounding errors (Newton's iteration)."""
        inverse = lapack.dtrtri(self.T)[0]
        one = np.eye(len(inverse))
        inverse = inverse + (one - self.multiply(inverse)) @ inverse
        return inverse, (one - self.multiply(inverse)) @ inverse

    def same_as(self, other: "Basis") -> bool:
        same = self.bits == other.bits and np.array_equal(self.scale, other.scale)
        return same and np.array_equal(self.T, other.T)

    def inverse_of_factor(self, L) -> np.ndarray:
        """T L^-1, the inverse of `factor`."""
        return blas.dtrmm(1.0, self.T, lapack.dtrtri(L)[0], overwrite_b=1)

    def ridge_gram(self):
        """What rows ``diag(ridge)`` add to G."""
        rows = self.ridge[:, None] * self.T
        return rows.T @ rows if self.ridge.any() else 0.0

    def factor(self, L) -> np.ndarray:
        """R = L T^-1, with R^T R = (Psi / scale)^T (Psi / scale) when L^T L = G; refined once, as T may cancel much."""
        R = np.triu(blas.dtrsm(1.0, self.T, L, side=1))
        return R + np.triu(blas.dtrsm(1.0, self.T, L - self.multiply(R), side=1))


def _blocks(T, j):
    """Of an upper triangular matrix: the corner of the first j columns, the block beside it, the other corner."""
    return tuple(map(np.asfortranarray, (T[:j, :j], T[:j, j:], T[j:, j:])))


class Sketch:
    """Some 2 p rows that stand for any number of rows of p functions: sums with random signs, each row in `_SPREAD`.

    A basis made of them serves all rows nearly as well as one of the rows themselves (M. B. Cohen, SODA 2016, 278). The
    random choices are the same each time. Rows that find room are taken as they are.
    """

    def __init__(self, p):
        self._rng = np.random.default_rng(0)
        self._sums, self.rows = np.zeros((2 * p + 32, p)), 0
        self._scale = np.zeros(p)

    def add(self, x) -> "Sketch":
        """Rows (rows, p); returns self."""
        rows, room = len(x), len(self._sums)
        if rows == 0:
            return self
        self._scale = np.maximum(self._scale, powers_of_two(x))
        if self.rows + rows <= room:
            self._sums[self.rows : self.rows + rows] = x
        else:
            into = self._rng.integers(room, size=(_SPREAD, rows))
            signs = self._rng.choice([-1.0, 1.0], size=(_SPREAD, rows)) / math.sqrt(_SPREAD)
            which = np.tile(np.arange(rows), _SPREAD)
            self._sums += sparse.csr_array((signs.ravel(), (into.ravel(), which)), shape=(room, rows)) @ x
        self.rows += rows
        return self

    def basis(self) -> Basis:
        """A `Basis` for all these rows."""
        require_finite(self._sums)
        return Basis.of(householder(self._sums / self._scale), self._scale)


def require_finite(*values):
    """Refuse rows, or what was made of them."""
    if not all(np.isfinite(value).all() for value in values):
        raise ValueError("regressors or targets hold NaN, infinity or values too large to square; repair them first.")


def householder(x, R=None, triangular=False) -> np.ndarray:
    """Triangular factor of ``x``, or of ``R`` on top of ``x``, which may be ``triangular``, by LAPACK's QR."""
    p = x.shape[1]
    if R is None:
        if len(x) < p:
            x = np.vstack([x, np.zeros((p - len(x), p))])
        return np.asfortranarray(np.triu(lapack.dgeqrt(min(48, p), np.asfortranarray(x), overwrite_a=1)[0][:p]))
    factor = lapack.dtpqrt(p * triangular, min(48, p), np.asfortranarray(R), np.asfortranarray(x), overwrite_b=1)[0]
    return np.asfortranarray(np.triu(factor))


def cholesky(gram) -> np.ndarray:
    """Upper triangular L with L^T L = gram, of the equilibrated matrix; shifted by rounding errors if not positive."""
    diagonal = np.sqrt(np.diag(gram))
    diagonal = np.where(diagonal > 0, diagonal, 1.0)
    scaled = np.asfortranarray(gram / diagonal / diagonal[:, None])
    shift = 0.0
    while True:
        L, info = lapack.dpotrf(scaled + shift * np.eye(len(scaled)), clean=1, overwrite_a=1)
        if info == 0:
            return L * diagonal
        shift = 100 * shift or len(scaled) * _EPS


def condition_number(gram) -> float:
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


def powers_of_two(x) -> np.ndarray:
    """For each column a power of two above its largest entry; 1 for a column that holds nothing."""
    largest = np.maximum(x.max(axis=0), -x.min(axis=0))
    return np.ldexp(1.0, np.frexp(np.where(largest > _NOTHING, largest, 0.5))[1])


def sums_of_squares(x) -> np.ndarray:
    return np.einsum("ij,ij->j", x, x)
