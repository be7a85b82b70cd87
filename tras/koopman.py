"""The Koopman matrix: K = Psi_x^+ Psi_y by least squares over all snapshot pairs (paper, (9)-(14)).

The pairs stream through in blocks, and what is kept of them is the triangular factor of a QR decomposition: memory does not
grow with the number of samples, and the condition number of Psi is not squared as it is in the Gram matrix Psi_x^T Psi_x.
"""

from typing import NamedTuple

import numpy as np
from scipy import linalg


class LeastSquares(NamedTuple):
    """Solution of ``regressors @ coefficients = targets`` in the least-squares sense, and how far to trust it."""

    coefficients: np.ndarray  # (regressors, targets)
    R: np.ndarray  # (regressors, regressors) upper triangular, R^T R = regressors^T regressors
    condition_number: float  # of the matrix of regressors, in the 2-norm
    residual: np.ndarray  # (targets,) root mean square of each target's residual
    rows: int


def snapshot_pairs(recording, block=4096):
    """Blocks ``(x, u, y)`` of snapshot pairs (12): ``y`` follows ``x`` by one sample while ``u`` is held.

    Pairs are formed inside each trajectory and never reach from one into the next.

    Yields
    ------
    tuple of ndarray
        (pairs, n), (pairs, m), (pairs, n), with about ``block`` pairs each.
    """
    waiting, count = [], 0
    for x, u in recording:
        for k in range(0, len(x) - 1, block):
            end = min(k + block, len(x) - 1)
            waiting.append((x[k:end], u[k:end], x[k + 1 : end + 1]))
            count += end - k
            if count >= block:
                yield tuple(map(np.concatenate, zip(*waiting)))
                waiting, count = [], 0
    if waiting:
        yield tuple(map(np.concatenate, zip(*waiting)))


def least_squares(blocks, names=None):
    """Least squares over a stream of row blocks, by a sequential tall-skinny QR decomposition.

    The factor R of all rows so far is stacked on the next block and decomposed again (J. Demmel et al., SIAM J. Sci.
    Comput. 34, 2012, A206). Backward stable whatever the scale of the columns.

    Parameters
    ----------
    blocks : iterable of (regressors (rows, p), targets (rows, q))
    names : sequence of str, optional
        Names of the regressors, for the error message.

    Returns
    -------
    LeastSquares

    Raises
    ------
    ValueError
        If there are fewer rows than regressors, or the regressors are linearly dependent to working precision.
    """
    R, rows, p = None, 0, None
    for regressors, targets in blocks:
        rows, p = rows + len(regressors), regressors.shape[1]
        stacked = np.hstack([regressors, targets])
        if R is not None:
            stacked = np.vstack([R, stacked])
        R = linalg.qr(stacked, mode="r", overwrite_a=True, check_finite=False)[0][: stacked.shape[1]]
    if rows < p:
        raise ValueError(f"{rows} snapshot pairs cannot determine {p} functions; record at least {p} pairs or use a smaller dictionary.")
    R11, R12 = np.triu(R[:p, :p]), R[:p, p:]
    left, singular, right = linalg.svd(R11, check_finite=False)
    rank = int(np.sum(singular > singular[0] * np.finfo(float).eps * rows**0.5))
    if rank < p:
        # The right singular vectors of the smallest values say which functions depend on each other.
        involved = np.argsort(-np.abs(right[rank:]).max(axis=0))[:3]
        labels = [names[j] if names is not None else f"number {j}" for j in sorted(involved)]
        raise ValueError(
            f"the dictionary's {p} functions are linearly dependent on this data (numerical rank {rank}; {', '.join(labels)} take "
            "part): use fewer functions or a lower degree, or record data that moves every channel independently."
        )
    coefficients = linalg.solve_triangular(R11, R12, check_finite=False)
    residual = np.sqrt(np.sum(R[p:, p:] ** 2, axis=0) / rows)
    return LeastSquares(coefficients, R11, float(singular[0] / singular[-1]), residual, rows)


def koopman_matrix(dictionary, recording, names=None):
    """K with ``psi(y, u)^T = psi(x, u)^T K`` over all pairs, equations (13) and (14): `LeastSquares` with K (N, N).

    Functions of u alone have the same value in both rows of a pair: K leaves them as they are.
    """
    pairs = snapshot_pairs(recording, _block(dictionary))
    return least_squares(((dictionary(x, u), dictionary(y, u)) for x, u, y in pairs), names)


def lifted_linear(dictionary, recording, names=None):
    """``psi(y) = A psi(x) + B u`` over all pairs (M. Korda and I. Mezic, Automatica 93, 2018): [A B]^T (N + m, N)."""
    pairs = snapshot_pairs(recording, _block(dictionary))
    return least_squares(((np.hstack([dictionary(x), u]), dictionary(y)) for x, u, y in pairs), names)


def _block(dictionary):
    """Rows a block: several times the columns, so that decomposing the old factor again costs little."""
    return max(4096, 8 * len(dictionary.names))
