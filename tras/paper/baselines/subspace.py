"""Subspace identification (N4SID): a linear model whose state is found from the data."""

import numpy as np
from scipy import linalg

from tras import rollout
from tras.paper.baselines.base import Baseline, check


class N4SID(Baseline):
    """``z+ = A z + B u, x = C z + D u`` by the oblique projection.

    P. Van Overschee, B. De Moor, *Subspace Identification for Linear Systems*, 1996, Fig. 4.8. nfoursid takes one
    trajectory only; here the block Hankel matrices of all trajectories stand side by side, their rows without their
    means. All measured states are outputs; constants c and d stand beside the four matrices. A roll-out starts at the z
    that least squares over the training data predict from (x0, u0), moved by the smallest step that makes
    ``C z + D u0 = x0`` exact; with as many states as outputs that is the inverse of C.

    Parameters
    ----------
    order : int
        States of the model; at least as many as outputs.
    horizon : int
        Block rows of past and of future.
    tolerance : float
        Directions of past and future inputs weaker than this share of the strongest are left out of the projection.
        Smooth signals need it: without noise the past has hardly more directions than the system has states.
    """

    def __init__(self, order=4, horizon=10, tolerance=1e-4):
        self.order = order
        self.horizon = horizon
        self.tolerance = tolerance

    def _check_options(self):
        check("horizon", self.horizon, self.horizon >= 2, "a whole number, 2 or more")
        check("order", self.order, self.order >= 1, "a whole number, 1 or more")
        check("tolerance", self.tolerance, 0 <= self.tolerance < 1, "a number from 0 to 1")

    def _learn(self, trajectories):
        i, n = self.horizon, trajectories[0][0].shape[1]
        expected = f"a whole number from {n}, the number of states, to {n * (i - 1)}"
        check("order", self.order, n <= self.order <= n * (i - 1), expected)
        long = [(x, u) for x, u in trajectories if len(x) >= 2 * i]
        m = trajectories[0][1].shape[1]
        columns, needed = sum(len(x) - 2 * i + 1 for x, _ in long), 2 * i * (n + m)
        if columns < needed:
            counts = f"{columns} columns of {2 * i} samples, fewer than {needed}"
            raise ValueError(f"the trajectories give {counts}; record more or choose a smaller horizon.")
        y, u = (np.hstack([_hankel(part, 2 * i) for part in parts]) for parts in zip(*long))
        states, later = self._states(y - y.mean(axis=1, keepdims=True), u - u.mean(axis=1, keepdims=True), i, n)
        known = np.vstack([y[i * n : (i + 1) * n], u[i * m : (i + 1) * m], np.ones((1, y.shape[1]))])
        now, then = np.vstack([states, known[n:]]), np.vstack([later, known[:n]])
        system = linalg.lstsq(now.T, then.T, check_finite=False)[0].T
        k = self.order  # c and d are the last columns of B and D
        (self.A_, self.B_), (self.C_, self.D_) = ((rows[:, :k], rows[:, k:]) for rows in (system[:k], system[k:]))
        self.B_[:, -1] = self._constant(y.mean(axis=1).reshape(2 * i, n)[i:], u.mean(axis=1).reshape(2 * i, m)[i:])
        self.start_ = linalg.lstsq(known.T, states.T, check_finite=False)[0].T
        self.n_parameters_ = system.size + (self.start_.size if k > n else 0)

    def _states(self, y, u, i, n):
        """Kalman states at the sample i of every column, and one later, from the oblique projections, in one basis."""
        m, tolerance = len(u) // (2 * i), self.tolerance
        projected = _oblique(y[i * n :], u[i * m :], np.vstack([u[: i * m], y[: i * n]]), tolerance)
        U, s, _ = linalg.svd(projected @ projected.T, check_finite=False)
        gamma = U[:, : self.order] * s[: self.order] ** 0.25
        past = np.vstack([u[: (i + 1) * m], y[: (i + 1) * n]])
        shorter = _oblique(y[(i + 1) * n :], u[(i + 1) * m :], past, tolerance)
        return linalg.pinv(gamma) @ projected, linalg.pinv(gamma[:-n]) @ shorter

    def _constant(self, y, u):
        """c, from the means of the future samples (i, n), (i, m): both states have mean zero, but two origins."""
        z, effect, rows, rest = np.zeros(self.order), np.zeros((self.order, self.order)), [], []
        for now, held, after in zip(y[1:], u[:-1], u[1:]):
            z, effect = self.A_ @ z + self.B_[:, :-1] @ held, self.A_ @ effect + np.eye(self.order)
            rows.append(self.C_ @ effect)
            rest.append(now - self.C_ @ z - self.D_ @ np.append(after, 1.0))
        return linalg.lstsq(np.concatenate(rows), np.concatenate(rest), check_finite=False)[0]

    def _roll_out(self, x, u):
        u = np.concatenate([u, np.ones((len(u), 1, u.shape[2]))], axis=1)
        k, following = self.order, iter(u[1:])
        z = self.start_ @ np.concatenate([x, u[0]])
        z = z + linalg.pinv(self.C_) @ (x - self.C_ @ z - self.D_ @ u[0])

        def advance(state, now):  # the output needs the input of its own instant, which stands behind the state
            return np.concatenate([self.A_ @ state[:k] + self.B_ @ now, next(following)])

        start = np.concatenate([z, u[0]])
        return rollout.roll_out(advance, start, u, lambda state: self.C_ @ state[:k] + self.D_ @ state[k:])


def _hankel(values, rows):
    """Columns of ``rows`` consecutive samples: (samples, channels) -> (rows * channels, samples - rows + 1)."""
    windows = np.lib.stride_tricks.sliding_window_view(values, rows, axis=0)  # (columns, channels, rows)
    return windows.transpose(2, 1, 0).reshape(rows * values.shape[1], -1)


def _oblique(future, inputs, past, tolerance):
    """The part of ``future`` that the rows of ``past`` explain when ``inputs`` explain theirs."""
    both = np.vstack([past, inputs])
    scale = np.linalg.norm(both, axis=1, keepdims=True)
    Q, R = linalg.qr((both / scale).T, mode="economic", check_finite=False)
    coefficients = linalg.lstsq(R, Q.T @ future.T, cond=max(tolerance, 1e-12), check_finite=False)[0] / scale
    return coefficients[: len(past)].T @ past
