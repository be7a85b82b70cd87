"""Extended dynamic mode decomposition by others: pykoop."""

import numpy as np

from tras import rollout
from tras.paper.baselines.base import Baseline, Monomial, check


class PykoopEdmd(Baseline):
    """EDMD with monomials and Tikhonov regularization as pykoop does it (S. Dahdah, J. R. Forbes, pykoop).

    pykoop lifts and fits; the roll-out is ours, all trajectories at once, where pykoop predicts one at a time.

    Parameters
    ----------
    order : int
        Highest degree of the monomials of states and inputs; a constant is added.
    alpha : float
        Tikhonov regularization, as pykoop has it.
    relift : bool
        Lift the predicted state again at each sample, or go on in the lifted space.
    """

    def __init__(self, order=2, alpha=0.0, relift=True):
        self.order = order
        self.alpha = alpha
        self.relift = relift

    def _check_options(self):
        check("order", self.order, self.order >= 1, "a whole number, 1 or more")
        check("alpha", self.alpha, self.alpha >= 0, "a number that is not negative")

    def _learn(self, trajectories):
        import pykoop

        lifting = [
            ("polynomial", pykoop.PolynomialLiftingFn(order=self.order)),
            ("constant", pykoop.ConstantLiftingFn()),
        ]
        self.pipeline_ = pykoop.KoopmanPipeline(lifting, pykoop.Edmd(alpha=self.alpha))
        table = np.vstack([np.hstack([np.full((len(x), 1), float(i)), x, u]) for i, (x, u) in enumerate(trajectories)])
        n, m = (part.shape[1] for part in trajectories[0])
        self.pipeline_.fit(table, n_inputs=m, episode_feature=True)
        polynomial = self.pipeline_.lifting_functions_[0][1]
        powers = polynomial.transformer_.powers_[polynomial.transform_order_]
        of_states = ~powers[:, n:].any(axis=1)
        constant = np.zeros((1, n), dtype=int)  # stands last among the states
        self.lift_state_ = Monomial(np.vstack([powers[of_states, :n], constant]))
        self.lift_input_ = Monomial(powers[~of_states])
        self.A_ = np.asarray(self.pipeline_.regressor_.coef_).T
        self.n_parameters_ = n * self.A_.shape[1] if self.relift else self.A_.size

    def _roll_out(self, x, u):
        n = len(x)

        def advance(state, now):
            here = state[:n]
            lifted = self.lift_state_(here) if self.relift else state
            rows = self.A_[:n] if self.relift else self.A_
            return rows @ np.concatenate([lifted, self.lift_input_(np.concatenate([here, now]))])

        return rollout.roll_out(advance, x if self.relift else self.lift_state_(x), u, lambda state: state[:n])
