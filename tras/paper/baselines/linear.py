"""Dynamic mode decomposition with control: the linear one-step model."""

import numpy as np

from tras.paper.baselines.base import Baseline, check, pairs, ridge


class DMDc(Baseline):
    """``x+ = A x + B u + c`` by least squares over all snapshot pairs.

    J. L. Proctor, S. L. Brunton, J. N. Kutz, SIAM J. Appl. Dyn. Syst. 15, 2016, p. 142. Written here, since PyDMD's
    ``DMDc`` takes one trajectory only (its thread 582).

    Parameters
    ----------
    alpha : float
        Ridge on the change over a sample, so that a strong one means that nothing moves.
    rank : int, optional
        Keep so many directions of (x, u); None: all.
    """

    def __init__(self, alpha=0.0, rank=None):
        self.alpha = alpha
        self.rank = rank

    def _check_options(self):
        check("alpha", self.alpha, self.alpha >= 0, "a number that is not negative")
        check("rank", self.rank, self.rank is None or self.rank >= 1, "None or a whole number, 1 or more")

    def _learn(self, trajectories):
        x, u, y = pairs(trajectories)
        z = np.hstack([x, u])
        directions = np.eye(z.shape[1])
        if self.rank is not None:
            directions = np.linalg.eigh(z.T @ z)[1][:, ::-1][:, : self.rank]
        theta = ridge(np.hstack([z @ directions, np.ones((len(z), 1))]), y - x, self.alpha)
        n = x.shape[1]
        whole = (directions @ theta[:-1]).T
        self.A_, self.B_, self.c_ = np.eye(n) + whole[:, :n], whole[:, n:], theta[-1][:, None]
        self.n_parameters_ = theta.size

    def _advance(self, z, u):
        return self.A_ @ z + self.B_ @ u + self.c_
