"""The Koopman matrix: K = Psi_x^+ Psi_y by least squares over all snapshot pairs (paper, (9)-(14)).

The pairs stream through `tras.leastsquares` in blocks: memory does not grow with the number of samples, and coefficients are better than those
of a QR decomposition. Fitted is the change D = K - I, because ``psi(y) - psi(x)`` is small and K near the identity: rounding errors are
relative to D, which is what the logarithm needs, and functions that do not change (the constant, the inputs) get exactly zero.
"""

import numpy as np

from tras.leastsquares import StreamingLeastSquares

DEALT = 2**20  # pairs that are shuffled at a time, 80 MB for ten channels


def snapshot_pairs(recording, block=4096, deal=False):
    """Blocks ``(x, u, y)`` of snapshot pairs (12): ``y`` follows ``x`` by one sample while ``u`` is held.

    Pairs are formed inside each trajectory and never reach from one into the next.

    Parameters
    ----------
    recording : Recording
    block : int
        Pairs a block, about.
    deal : bool
        Deal the pairs out like cards, every k-th one into one block, so that each block is typical of all.

    Yields
    ------
    tuple of ndarray
        (pairs, n), (pairs, m), (pairs, n).
    """
    for x, u, y in _stretches(recording, max(block, DEALT) if deal else block):
        if deal:
            hands = max(1, round(len(x) / block))
            yield from ((x[k::hands], u[k::hands], y[k::hands]) for k in range(hands))
        else:
            yield x, u, y


def _stretches(recording, size):
    """At least ``size`` pairs each, in the order of time; the last one what is left."""
    waiting, count = [], 0
    for x, u in recording:
        for k in range(0, len(x) - 1, size):
            end = min(k + size, len(x) - 1)
            waiting.append((x[k:end], u[k:end], x[k + 1 : end + 1]))
            count += end - k
            if count >= size:
                yield _joined(waiting)
                waiting, count = [], 0
    if waiting:
        yield _joined(waiting)


def _joined(parts):
    """A single part as it is, without a copy."""
    return parts[0] if len(parts) == 1 else tuple(map(np.concatenate, zip(*parts)))


def rows(dictionary, x, u, y):
    """Regressors ``psi(x, u)`` and targets ``psi(y, u) - psi(x, u)`` of pairs; the same ``u`` in both."""
    before = dictionary(x, u)
    return before, dictionary(y, u) - before


def lifted_linear_rows(dictionary, x, u, y):
    """The same for ``psi(y) = A psi(x) + B u`` (M. Korda and I. Mezic, Automatica 93, 2018, 149), the inputs behind the states."""
    before = dictionary(x)
    head = 1 + x.shape[1]
    return np.hstack([before[:, :head], u, before[:, head:]]), dictionary(y) - before


def koopman_matrix(dictionary, recording, names=None):
    """K with ``psi(y, u)^T = psi(x, u)^T K`` over all pairs, equations (13) and (14), plain least squares.

    Returns
    -------
    K : (N, N) ndarray
    LeastSquares
        Of D = K - I: triangular factor, condition number, residual.

    Raises
    ------
    ValueError
        If there are fewer pairs than functions, or the functions are linearly dependent on the data.
    """
    solver = StreamingLeastSquares()
    for x, u, y in snapshot_pairs(recording, block_size(dictionary), deal=True):
        solver.update(*rows(dictionary, x, u, y))
    fit = solver.solve(names).require_full_rank()
    return np.eye(len(fit.R)) + fit.coefficients, fit


def block_size(dictionary):
    """Rows a block: several times the columns."""
    return max(4096, 4 * len(dictionary.names))


def check_head(fit, head):
    """Channels that are linear combinations of each other are a fault of the recording, not of the dictionary."""
    if fit.rows < head:
        fit.require_full_rank()
    singular = np.linalg.svd(fit.R[:head, :head] / np.linalg.norm(fit.R[:head, :head], axis=0), compute_uv=False)
    if singular[-1] <= singular[0] * 4 * np.finfo(float).eps * fit.rows**0.5:
        right = np.linalg.svd(fit.R[:head, :head] / np.linalg.norm(fit.R[:head, :head], axis=0))[2][-1]
        names = [name for name, c in zip(fit.names, right) if abs(c) > 1e-6 and name != "1"]
        raise ValueError(
            f"the channels {', '.join(names)} are linearly dependent over the whole recording: leave one out with recording.select(...), "
            "use fewer delays, or record data that move each by itself."
        )
