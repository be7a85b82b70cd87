"""Least squares over a stream of rows: QR-grade coefficients at the price of matrix products.

The Gram matrix Psi^T Psi is as fast as linear algebra gets, but squares the condition number of Psi; a Householder QR
does not, and takes several times as long. Here the rows are first written in a basis T in which they are nearly
orthonormal,

    B = Psi T,   T ~ R0^-1,   R0 the triangular factor of a sketch of the first rows,

and the normal equations are formed there: G = sum B^T B, C = sum B^T Y, K = T G^-1 C. G has a condition number of some
tens for the rows that the factor saw and mostly below 1e5 for all, so that squaring costs little. Preconditioning by
the factor of random sums of the rows is the idea of V. Rokhlin and M. Tygert (PNAS 105, 2008, 13212), of Blendenpik (H.
Avron, P. Maymounkov and S. Toledo, SIAM J. Sci. Comput. 32, 2010, 1217) and of E. N. Epperly, M. Meier and Y.
Nakatsukasa (arXiv:2406.03468, 2024); a Cholesky factor in a nearly orthonormal basis is the second half of CholeskyQR2
(Y. Yamamoto et al., ETNA 44, 2015, 306; with a shift: T. Fukaya et al., SIAM J. Sci. Comput. 42, 2020, A477). If later
rows leave the span of the sample, G tells, and the basis is renewed with a Householder QR of the factor so far on top
of the new rows, a step of sequential TSQR (J. Demmel et al., SIAM J. Sci. Comput. 34, 2012, A206).

What is left is the rounding of B, where columns cancel. T is free to choose, so its entries are rounded to a coarse
grid: the leading bits of Psi times T is then a sum of integers below 2^53, which floating point adds *exactly*, and
only the trailing bits of Psi, 2^-10 or less of the whole, contribute rounding errors (error-free transformation: K.
Ozaki et al., Numer. Algorithms 59, 2012, 95). So coefficients are about as good as those of a Householder QR, and up to
three digits better where Psi is ill-conditioned (`benchmarks/solver.py`).
"""

import itertools
import math
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from functools import cached_property, partial

import numpy as np
from scipy.linalg import blas, svd

from tras.solver.basis import (
    Basis,
    Sketch,
    cholesky,
    condition_number,
    householder,
    powers_of_two,
    require_finite,
    sums_of_squares,
)
from tras.solver.threads import one_blas_thread

_EPS = np.finfo(float).eps
_WORST_GRAM = 1e5  # condition number of G (1-norm, equilibrated) beyond which the basis is renewed
_LOST = 1e12  # ... beyond which G itself is too rounded to renew the basis from
_SAMPLE = 16  # rows per regressor that the first basis is made of, if there are so many to be seen at once
_GROWTH = 4.0  # G is examined again when its trace has grown by this factor


class StreamingLeastSquares:
    """``regressors @ coefficients = targets`` in the least-squares sense, from blocks of rows, each seen once.

    Memory: about five matrices of the size of the coefficients and the workspace of one panel, whatever the number of
    rows. The outcome depends on the order of the rows by rounding only. It is best when the first panel is typical of
    all rows: deal a recording out like cards (every k-th pair in one block), do not cut it into stretches of time.

    Parameters
    ----------
    panel : int, optional
        Rows that are worked on at once; default ``max(4096, 4 p)`` for p regressors. Fewer wait until a panel is full.

    Attributes
    ----------
    rows : int
    basis : Basis or None
        None before the first panel.

    Examples
    --------
    >>> import numpy as np
    >>> rng = np.random.default_rng(0)
    >>> solver = StreamingLeastSquares()
    >>> for _ in range(5):
    ...     a = rng.standard_normal((100, 2))
    ...     _ = solver.update(a, a @ [[1.0], [2.0]])
    >>> solver.solve().coefficients.round(12).ravel()
    array([1., 2.])
    """

    def __init__(self, panel: int | None = None):
        self.panel = panel
        self.rows = 0
        self._waiting = []
        self.basis = None

    @property
    def shapes(self) -> tuple[int, int]:
        """Numbers of regressors and targets of its rows."""
        return self._shapes

    def update(self, regressors, targets) -> "StreamingLeastSquares":
        """Add rows (rows, p) with targets (rows, q); returns self."""
        regressors, targets = _two_dimensional("regressors", regressors), _two_dimensional("targets", targets)
        shapes = regressors.shape[1], targets.shape[1]
        if len(regressors) != len(targets):
            raise ValueError(f"regressors has {len(regressors)} rows but targets has {len(targets)}; give one for one.")
        if self.rows == 0:
            self._shapes = shapes
        elif shapes != self._shapes:
            block = f"this block has (regressors, targets) {shapes}"
            raise ValueError(f"{block}, earlier ones {self._shapes}; they must be alike.")
        self.rows += len(regressors)
        panel = self.panel or panel_rows(shapes[0])
        waiting = sum(len(x) for x, _ in self._waiting) + len(regressors)
        full = waiting >= panel
        self._waiting.append((regressors, targets) if full else (regressors.copy(), targets.copy()))
        if full:
            self.work_off(panel)
        return self

    def work_off(self, panel=None):
        """Absorb all waiting rows, in panels of equal size, about ``panel`` rows each; by default in one."""
        panel = panel or max(self.rows, 1)
        parts, self._waiting = [part for part in self._waiting if len(part[0])], []
        if not parts:
            return
        x, y = parts[0] if len(parts) == 1 else map(np.concatenate, zip(*parts))
        pieces = max(1, len(x) // panel)
        for k in range(pieces):
            rows = slice(k * len(x) // pieces, (k + 1) * len(x) // pieces)
            self._absorb(x[rows], y[rows])

    def update_lifted(self, blocks, lift, threads=1, regressors=None) -> "StreamingLeastSquares":
        """``update(*lift(block))`` for each block, by several threads, with the same bits whatever their number.

        Each thread lifts a block and multiplies what it lifted; the products are added here, in the order of the
        blocks. BLAS is held to one thread meanwhile. If the first block has fewer than 16 rows per regressor, the basis
        is made of as many blocks as have them.

        Parameters
        ----------
        blocks : iterable
            Of tuples of arrays, one entry per row. Blocks between one panel and two are multiplied as they are; others
            take the way of `update`.
        lift : callable
            ``block -> (regressors, targets)``, arrays that nobody needs afterwards. Called again for a block when the
            basis is made of it or renewed at it.
        threads : int
        regressors : callable, optional
            ``block -> regressors``, if they cost less without targets.
        """
        with one_blas_thread(), ThreadPoolExecutor(threads) if threads > 1 else nullcontext() as pool:
            running = deque()
            for block in self._begun(iter(blocks), lift, regressors or (lambda block: lift(block)[0])):
                if not self._ready_for(len(block[0])):  # the basis is not made yet, rows wait, or will have to
                    self._collect(running, lift)
                    self.update(*lift(block))
                    continue
                work = _lifted_products, self.basis, lift, block
                running.append((block, self.basis, pool.submit(*work).result if pool else partial(*work)))
                if len(running) > threads:
                    self._collect(running, lift, leave=threads)
            self._collect(running, lift)
        return self

    def _ready_for(self, rows):
        panel = self.panel or (self.basis is not None and panel_rows(self._shapes[0]))
        return self.basis is not None and not self._waiting and panel <= rows < 2 * panel

    def _begun(self, blocks, lift, regressors):
        """The blocks still to be absorbed after a look at the first ones, which make the basis if they are panels."""
        block = next(blocks, None) if self.basis is None and not self._waiting else None
        if block is None:
            return blocks
        x, y = map(_two_dimensional, ("regressors", "targets"), lift(block))
        p = x.shape[1]
        panel = self.panel or panel_rows(p)
        if not panel <= len(x) < min(2 * panel, _SAMPLE * p):
            self.update(x, y)
            return blocks
        sample, blocks_of_sample = Sketch(p).add(x), [block]
        while sample.rows < _SAMPLE * p and (block := next(blocks, None)) is not None:
            blocks_of_sample.append(block)
            sample.add(regressors(block))
        self._begin(sample.basis(), (p, y.shape[1]))
        return itertools.chain(blocks_of_sample, blocks)

    def _begin(self, basis, shapes):
        """No products yet, in a basis that is to serve from here on."""
        self.basis, self._shapes = basis, shapes
        p, q = shapes
        self._gram, self._cross = np.zeros((p, p)), np.zeros((p, q))
        self._lengths, self._square = np.zeros(p), np.zeros(q)  # sums of squares of regressors and targets
        self._examined = float(p)  # with the rows of the sample G has the trace p or 2 p, and a condition of some tens

    def _collect(self, running, lift, leave=0):
        """Add the products of the first blocks, in order, but for the last ``leave``."""
        while len(running) > leave:
            block, basis, products = running.popleft()
            # Products in a basis that was renewed meanwhile are made again.
            current = products() if basis is self.basis else _lifted_products(self.basis, lift, block)
            self._add(current, partial(lift, block))
            self.rows += len(block[0])

    def _absorb(self, x, y):
        if self.basis is None:
            self._begin(Sketch(x.shape[1]).add(x).basis(), self._shapes)
        self._add(_products(self.basis, x, y), lambda: (x, y))

    def _add(self, products, rows):
        """Add a panel's products; ``rows()`` gives the panel itself, should its rows leave the span of the basis."""
        gram, cross, lengths, square = products
        gram = np.add(self._gram, gram, out=gram)
        if not np.trace(gram) <= _GROWTH * self._examined:
            condition = condition_number(gram + self.basis.ridge_gram())
            if condition > _WORST_GRAM:
                x, y = rows()
                self._renew_basis(x, gram if condition < _LOST else None)
                gram, cross, lengths, square = _products(self.basis, x, y)
                gram = self._gram + gram
            self._examined = np.trace(gram)
        self._gram, self._cross = gram, np.add(self._cross, cross, out=cross)
        self._lengths, self._square = self._lengths + lengths, self._square + square

    def _renew_basis(self, x, gram):
        """A basis for all rows so far and those of ``x``: from ``gram``, which holds both, or by Householder QR."""
        scale = np.maximum(self.basis.scale, powers_of_two(x))
        factor = self._factor(self._gram if gram is None else gram + self.basis.ridge_gram(), scale)
        self._change_basis(Basis.of(householder(x / scale, factor) if gram is None else factor, scale))

    def _factor(self, gram, scale):
        """R of rows of Psi / scale from their products in the basis."""
        return self.basis.factor(cholesky(gram)) * (self.basis.scale / scale)

    def _change_basis(self, new):
        """G and C as if the rows had been written in another basis: rows B are B S there, S = T_old^-1 T_new."""
        inverse, rest = self.basis.inverse()
        ratio = self.basis.scale / new.scale
        S = new.multiply(inverse * ratio) + (rest * ratio) @ new.T
        self._gram = S.T @ self._gram @ S
        self._cross = S.T @ self._cross
        self.basis = new

    def merge(self, other: "StreamingLeastSquares") -> "StreamingLeastSquares":
        """Add the rows of another solver, which is not changed; returns self.

        Solvers of one basis (see `emptied`) are added. Otherwise both are written in a basis made of their stacked
        triangular factors, a step of TSQR, for the price of a few products of matrices of the size of the coefficients.
        The order of merging matters by rounding only.

        Raises
        ------
        ValueError
            If they have other numbers of regressors or targets.
        """
        if other.rows == 0:
            return self
        other = StreamingLeastSquares.from_state(other.state(), other.panel)
        if self.rows == 0:
            self.__dict__.update(other.__dict__)
            return self
        if other._shapes != self._shapes:
            block = f"other has (regressors, targets) {other._shapes}"
            raise ValueError(f"{block}, these rows {self._shapes}; they must be alike.")
        for solver in (self, other):
            solver.work_off()
        if not self.basis.same_as(other.basis):
            scale = np.maximum(self.basis.scale, other.basis.scale)
            ours, theirs = (s._factor(s._gram + s.basis.ridge_gram(), scale) for s in (self, other))
            common = Basis.of(householder(theirs, ours), scale)
            self._change_basis(common)
            other._change_basis(common)
        for name in ("_gram", "_cross", "_lengths", "_square"):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        self.rows += other.rows
        self._examined = 0.0  # the next rows decide whether the basis still serves
        return self

    def __copy__(self):
        """Another solver of the same rows, at no cost: arrays are replaced, never changed, so both may hold them."""
        new = StreamingLeastSquares(self.panel)
        new.__dict__.update(self.__dict__, _waiting=list(self._waiting))
        return new

    def emptied(self) -> "StreamingLeastSquares":
        """A solver without rows that begins with this one's basis, for rows of the same kind."""
        if self.basis is None:
            self.work_off()
        new = StreamingLeastSquares(self.panel)
        new._begin(self.basis, self._shapes)
        return new

    def solve(self, names=None) -> "LeastSquares":
        """Solution over all rows so far, to be regularized if these do not determine it; rows may be added afterwards.

        Parameters
        ----------
        names : sequence of str, optional
            Names of the regressors, for messages.

        Raises
        ------
        ValueError
            If there are no rows.
        """
        if self.rows == 0:
            raise ValueError("there are no rows; call update(regressors, targets) first.")
        self.work_off()
        L = cholesky(self._gram)
        basis = self.basis
        rotated = blas.dtrsm(1.0, L, self._cross, trans_a=1)  # Q^T targets
        coefficients = blas.dtrmm(1.0, basis.T, blas.dtrsm(1.0, L, rotated), overwrite_b=1)
        coefficients /= basis.scale[:, None]
        return LeastSquares(coefficients, basis, L, rotated, self._lengths, self._square, self.rows, names)

    def state(self) -> dict[str, np.ndarray]:
        """All that is known of the rows, as plain arrays: store them with `numpy.savez`, continue with `from_state`.

        Rows that wait for a panel are stored as they are: what follows has the same bits with and without a store.
        """
        if self.rows == 0:
            raise ValueError("there are no rows; call update(regressors, targets) first.")
        x, y = map(np.concatenate, zip(*self._waiting)) if self._waiting else (np.empty((0, k)) for k in self._shapes)
        state = {"rows": np.array(self.rows), "waiting_regressors": x, "waiting_targets": y}
        if self.basis is None:
            return state
        basis = self.basis
        return state | {
            "gram": self._gram, "cross": self._cross, "lengths": self._lengths, "square": self._square,
            "examined": np.array(self._examined), "T": basis.T, "scale": basis.scale, "bits": np.array(basis.bits),
            "ridge": basis.ridge, "exact": np.array(basis.exact),
        }  # fmt: skip

    @classmethod
    def from_state(cls, state, panel=None) -> "StreamingLeastSquares":
        """The solver whose `state` this was."""
        self = cls(panel)
        self.rows = int(state["rows"])
        waiting = np.array(state["waiting_regressors"]), np.array(state["waiting_targets"])
        self._shapes = waiting[0].shape[1], waiting[1].shape[1]
        self._waiting = [waiting] if len(waiting[0]) else []
        if "gram" in state:
            self._examined = float(state["examined"])
            for key in ("gram", "cross", "lengths", "square"):
                setattr(self, "_" + key, np.array(state[key], dtype=float))
            T, scale, ridge = (np.array(state[key]) for key in ("T", "scale", "ridge"))
            self.basis = Basis(np.asfortranarray(T), scale, int(state["bits"]), ridge, state["exact"])
        return self


class LeastSquares:
    """The solution and how far to trust it; `tras.regularization` makes regularized ones of ``R`` and ``rotated``.

    D, below, holds the norms of the columns of the regressors Psi: those of Psi D^-1 have length one, whatever the
    units.

    Attributes
    ----------
    coefficients : (p, q) ndarray
        Asking for them when the rows do not determine them is a ValueError (see `require_full_rank`).
    R : (p, p) ndarray
        Upper triangular, R^T R = Psi^T Psi.
    rotated : (p, q) ndarray
        Q^T targets: R coefficients = rotated.
    residual : (q,) ndarray
        Root mean square of each target's residual. By Pythagoras, so not below 1e-8 of the target's own.
    rows : int
    rank : int
        Numerical rank of Psi D^-1: singular values above sqrt(rows) rounding units, relative to the largest.
    condition_number : float
        Of Psi as given, in the 2-norm.
    scaled_condition_number : float
        Of Psi D^-1: the one that counts, because rounding errors do not feel the scale of columns.
    """

    def __init__(self, coefficients, basis, L, rotated, lengths, square, rows, names=None):
        self._coefficients, self.basis, self._L = coefficients, basis, L
        self.rotated, self.rows, self.names = rotated, rows, names
        self._least = np.maximum(square - sums_of_squares(rotated), 0)  # squared norm of the residual
        self._norms = np.where(lengths > 0, np.sqrt(lengths), 1.0)

    @cached_property
    def R(self) -> np.ndarray:
        return self.basis.factor(self._L) * self.basis.scale

    @cached_property
    def rank(self) -> int:
        p, smallest = len(self._L), _EPS * math.sqrt(self.rows)  # smaller singular values are rounding errors
        # A bound on the condition number costs less than the number itself.
        if math.sqrt(p) * np.linalg.norm(self._inverse) * smallest < 0.1:
            return p
        return int(np.sum(self._singular > self._singular[0] * smallest))

    @cached_property
    def _singular(self):
        return np.linalg.svd(self.R / self._norms, compute_uv=False)

    @cached_property
    def _inverse(self):
        """(R D^-1)^-1."""
        return self.basis.inverse_of_factor(self._L) * (self._norms / self.basis.scale)[:, None]

    @property
    def coefficients(self) -> np.ndarray:
        self.require_full_rank()
        return self._coefficients

    @property
    def residual(self) -> np.ndarray:
        return np.sqrt(self._least / self.rows)

    @property
    def scaled_condition_number(self) -> float:
        return _ratio(self._singular)

    @cached_property
    def condition_number(self) -> float:
        return _ratio(np.linalg.svd(self.R, compute_uv=False))

    def require_full_rank(self) -> "LeastSquares":
        """Self, if the coefficients are determined; else a ValueError that names regressors that depend on others."""
        p = len(self._L)
        if self.rows < p:
            remedy = f"record at least {p} pairs or use a smaller dictionary"
            raise ValueError(f"{self.rows} snapshot pairs cannot determine {p} functions; {remedy}.")
        if self.rank < p:
            directions = svd(self.R / self._norms, check_finite=False)[2]
            shares = np.abs(directions[self.rank :]).max(axis=0)  # of each regressor in combinations that vanish
            involved = sorted(j for j in np.argsort(-shares)[:3] if shares[j] > 0.1 * shares.max())
            labels = ", ".join(f"number {j}" if self.names is None else self.names[j] for j in involved)
            raise ValueError(
                f"the dictionary's {p} functions are linearly dependent on this data (numerical rank {self.rank}; "
                f"{labels} take part): use fewer functions or a lower degree, record data that moves every channel "
                "independently, or ask for a truncated or regularized solution (regularization='truncated', "
                "strength=1e-8)."
            )
        return self


def least_squares(blocks, names=None) -> LeastSquares:
    """A `LeastSquares` of full rank over an iterable of blocks (regressors (rows, p), targets (rows, q)).

    Raises
    ------
    ValueError
        If there are fewer rows than regressors, these are linearly dependent, or there is NaN or infinity.
    """
    solver = StreamingLeastSquares()
    for regressors, targets in blocks:
        solver.update(regressors, targets)
    return solver.solve(names).require_full_rank()


def _products(basis, x, y, overwrite=False):
    """What a panel of rows adds to G, to C, and to the sums of squares of regressors and targets."""
    lengths, square = sums_of_squares(x), sums_of_squares(y)
    require_finite(lengths, square)
    b = basis.whiten(x, overwrite)
    return b.T @ b, b.T @ y, lengths, square


def _lifted_products(basis, lift, block):
    return _products(basis, *lift(block), overwrite=True)


def panel_rows(p: int) -> int:
    """Rows that are worked on at once."""
    return max(4096, 4 * p)


def panels_of_a_basis(p: int) -> int:
    """Number of panels that the first basis is made of, if they come as blocks that are lifted here."""
    return -(-_SAMPLE * p // panel_rows(p))


def _ratio(singular):
    return float(singular[0] / singular[-1]) if singular[-1] > 0 else math.inf


def _two_dimensional(name, values):
    values = np.asarray(values, dtype=float)
    if values.ndim != 2:
        raise ValueError(f"{name} has shape {values.shape}; give (rows, columns).")
    return values
