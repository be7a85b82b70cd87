"""Small dense quadratic programs, solved by DAQP (D. Arnstroem et al., IEEE Trans. Autom. Control 67, 2022, 4362)."""

from typing import NamedTuple

import numpy as np

from tras.workflow.arguments import extra

_SOFT = 8  # DAQP's word for a constraint that may be violated at a cost
_REASONS = {-1: "infeasible", -2: "cycling", -3: "unbounded", -4: "iteration limit", -5: "not convex", -7: "time limit"}
TOLERANCE = 1e-12  # of constraints: those of a state at the next sample move the inputs by 1e5 times that


class Solution(NamedTuple):
    """The minimiser (v,), or None and the reason; multipliers of bounds and rows, positive at upper ones."""

    v: np.ndarray | None
    status: str
    multipliers: np.ndarray
    iterations: int


class Program:
    """``min v'Hv / 2 + f'v`` with ``low <= v <= high`` and ``lower <= G v <= upper``, H positive definite.

    The rows named by ``soft`` may be violated by e >= 0 each, at the cost ``linear e + quadratic e^2 / 2``: above the
    multiplier that the hard constraint would have, the linear part makes them exact (E. C. Kerrigan and J. M.
    Maciejowski, *Soft constraints and exact penalty functions in MPC*, UKACC 2000). The working set of the last
    solution is where the next one starts.
    """

    def __init__(self, *, linear: float = 1e3, quadratic: float = 1e3, time_limit: float = 0.0, iterations: int = 1000):
        with extra("control", "model predictive control"):
            import daqp

        self._new, self._model, self._shape = daqp.Model, None, None
        self.linear, self.quadratic = linear, quadratic
        self._settings = {"primal_tol": TOLERANCE, "time_limit": time_limit, "iter_limit": iterations}

    def forget(self) -> None:
        """Start the next solution from nothing."""
        self._model = None

    def solve(self, H, f, low, high, G=None, lower=(), upper=(), soft=None) -> Solution:
        """See the class; ``soft`` is (rows,) of bool."""
        G = np.empty((0, len(f))) if G is None else np.ascontiguousarray(G)
        sense = np.zeros(len(f) + len(G), dtype=np.int32)
        if soft is not None:
            sense[len(f) :] = np.where(soft, _SOFT, 0)
        above, below = np.concatenate([high, upper]), np.concatenate([low, lower])
        if self._model is not None and self._shape == G.shape:
            flag = self._model.update(H=H, f=f, A=G if len(G) else None, bupper=above, blower=below)
        else:
            self._model, self._shape = self._new(), G.shape
            self._model.settings = self._settings
            flag, _ = self._model.setup(H, f, G, above, below, sense)
            if flag >= 0 and soft is not None and np.any(soft):  # in units of the rows, not of DAQP's scaled ones
                linear, reciprocal = np.full((2, len(sense)), [[self.linear], [1 / self.quadratic]])
                self._model.soft_weights(reciprocal, reciprocal, linear, linear)
        if flag < 0:
            return self._failed(flag, 0)
        v, _, flag, info = self._model.solve()
        if flag <= 0 or not np.isfinite(v).all():
            return self._failed(flag, info["iterations"])
        return Solution(np.array(v), "solved", np.array(info["lam"]), info["iterations"])

    def _failed(self, flag, iterations):
        self._model = None  # whatever it holds, the next one begins anew
        return Solution(None, _REASONS.get(flag, f"DAQP's exit flag {flag}"), np.empty(0), iterations)
