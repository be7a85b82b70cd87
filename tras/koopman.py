"""The Koopman matrix: K = Psi_x^† Psi_y by least squares over all snapshot pairs (paper, (9)-(14)).

The pairs stream through `tras.solver.least_squares` in blocks: memory does not grow with the number of samples, and
coefficients are as good as those of a QR decomposition or better. The fit is of the change D = K - I, because ``psi(y)
- psi(x)`` is small and K near the identity: rounding errors are relative to D, which is what the logarithm needs, and
functions that do not change (the constant, the inputs) get exactly zero.
"""

import threading
from collections.abc import Iterator

import numpy as np

from tras.dictionaries.base import Dictionary
from tras.solver.least_squares import LeastSquares, StreamingLeastSquares, panel_rows
from tras.solver.threads import processors

DEALT = 2**20  # pairs that are shuffled at a time, 80 MB for ten channels
SUIT = 8  # successive pairs that are dealt together where they share liftings


def snapshot_pairs(recording, block: int = 4096, deal: int = 0) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Blocks ``(x, u, y)`` of snapshot pairs (12): ``y`` follows ``x`` by one sample while ``u`` is held.

    Pairs are formed inside each trajectory and never reach from one into the next.

    Parameters
    ----------
    recording : Recording
    block : int
        Pairs per block, about.
    deal : int
        Deal the pairs out like cards, this many successive ones at a time: each block is then typical of all pairs.

    Yields
    ------
    tuple of ndarray
        (pairs, n), (pairs, m), (pairs, n).
    """
    for x, u, y in _stretches(recording, max(block, DEALT) if deal else block):
        if deal:
            hands = max(1, len(x) // (block + deal - 1))  # of ``block`` pairs at least
            for k in range(hands):
                hand = _hand(len(x), k, hands, deal)
                yield tuple(values[hand].copy() for values in (x, u, y))  # views would keep all of them in memory
        else:
            yield x, u, y


def _hand(pairs, k, hands, lot):
    """Index of the pairs that are dealt to hand ``k``."""
    if lot == 1:
        return slice(k, None, hands)
    indices = (np.arange(k * lot, pairs, hands * lot)[:, None] + np.arange(lot)).ravel()
    return indices[indices < pairs]


def _stretches(recording, size):
    """Stretches of at least ``size`` pairs, in the order of time; the last one may be shorter."""
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


def rows(dictionary, x, u, y, buffer=None):
    """Regressors ``psi(x, u)`` and targets ``psi(y, u) - psi(x, u)`` of pairs, (pairs, N) each, column by column.

    Where a pair begins at the end of the one before it, under the same input (there is none, or it was held), its
    lifting serves both. ``buffer(number, rows, columns)`` supplies the memory.
    """
    z, _ = dictionary.points(x, u)
    N, pairs, buffer = dictionary.size, len(x), buffer or _fresh
    before = dictionary.lift(z, out=buffer(0, N, pairs))
    change = buffer(1, N, pairs)
    shared = (y[:-1] == x[1:]).all(axis=1) & (u[:-1] == u[1:]).all(axis=1)
    if 2 * np.count_nonzero(shared) < pairs:
        dictionary.lift(dictionary.points(y, u)[0], out=change)
        change -= before
    else:
        np.subtract(before[:, 1:], before[:, :-1], out=change[:, :-1])
        alone = np.flatnonzero(~np.append(shared, False))
        change[:, alone] = dictionary.lift(dictionary.points(y[alone], u[alone])[0]) - before[:, alone]
    return before.T, change.T


def lifted_linear_rows(dictionary, x, u, y, buffer=None):
    """The same for ``psi(y) = A psi(x) + B u`` (Korda and Mezic 2018), the inputs behind the states."""
    before, change = rows(dictionary, x, np.empty((len(x), 0)), y, buffer)
    head, m = 1 + x.shape[1], u.shape[1]
    regressors = (buffer or _fresh)(2, before.shape[1] + m, len(x))
    regressors[:head], regressors[head : head + m], regressors[head + m :] = before.T[:head], u.T, before.T[head:]
    return regressors.T, change


def state_rows(dictionary, x, u, y, buffer=None):
    """Regressors ``psi(x, u)`` and the states' change ``y - x`` alone: enough for one step, at 2/5 of the cost."""
    z, _ = dictionary.points(x, u)
    change = np.subtract(y.T, x.T, out=(buffer or _fresh)(1, x.shape[1], len(x)))
    return dictionary.lift(z, out=(buffer or _fresh)(0, dictionary.size, len(x))).T, change.T


def lifting(dictionary, of=rows):
    """``(x, u, y) -> (regressors, targets)`` in memory that each thread uses again and again."""
    thread = threading.local()

    def buffer(number, rows, columns):
        buffers = thread.__dict__.setdefault("buffers", {})
        if number not in buffers or buffers[number].size < rows * columns:
            buffers[number] = np.empty(rows * columns)
        return buffers[number][: rows * columns].reshape(rows, columns)

    return lambda block: of(dictionary, *block, buffer)


def regressors_alone(dictionary, of=rows):
    """``(x, u, y) -> regressors`` of what `lifting` gives."""
    lift = lifting(dictionary, state_rows if of is rows else of)
    return lambda block: lift(block)[0]


def _fresh(number, rows, columns):
    return np.empty((rows, columns))


def koopman_matrix(dictionary: Dictionary, recording, names=None) -> tuple[np.ndarray, LeastSquares]:
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
    blocks = snapshot_pairs(recording, block_size(dictionary), deal=1)
    solver.update_lifted(blocks, lifting(dictionary), processors(), regressors_alone(dictionary))
    fit = solver.solve(names).require_full_rank()
    return np.eye(len(fit.coefficients)) + fit.coefficients, fit


def block_size(dictionary):
    """Rows per block: one panel of the solver, so that nothing waits."""
    return panel_rows(dictionary.size)


def check_head(fit, head):
    """Channels that are linear combinations of each other are a fault of the recording, not of the dictionary."""
    if fit.rows < head:
        fit.require_full_rank()
    _, singular, right = np.linalg.svd(fit.R[:head, :head] / np.linalg.norm(fit.R[:head, :head], axis=0))
    if singular[-1] <= singular[0] * 4 * np.finfo(float).eps * fit.rows**0.5:
        names = [name for name, c in zip(fit.names, right[-1]) if abs(c) > 1e-6 and name != "1"]
        raise ValueError(
            f"the channels {', '.join(names)} are linearly dependent over the whole recording: leave one out with "
            "recording.select(...), use fewer delays, or record data that move each by itself."
        )
