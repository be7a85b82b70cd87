"""Model predictive control: the best plan over a horizon, of which the first input is used."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from tras.control.controller import Controller
from tras.control.observer import Observer
from tras.control.options import Numbers, Pairs, pairs, per_channel
from tras.control.qp import Program
from tras.workflow.arguments import number, whole_number

_RATE_WEIGHT = 1e-3  # of a change of an input by its half-range, where an error of a half-range counts 1
_ASTRAY = "the predictions run away"
FIRST_ROUNDS = 10  # rounds at most for the first plan, which has none before it


class MPC(Controller):
    """Minimise errors and changes of the inputs over a horizon, within limits, at every sample.

    The cost is ``sum_i weights (x[k + i] - reference[k + i])^2 + sum_i rate_weights (u[k + i] - u[k + i - 1])^2`` over
    the ``horizon``. A model with ``predictor="lifted_linear"`` is linear over it, so this is one quadratic program (M.
    Korda and I. Mezic, Automatica 93, 2018, 149). Any other model is linearised along the last plan, shifted by one
    sample: one lifting for the whole horizon, exact slopes, and again one program (real-time iteration; M. Diehl, H. G.
    Bock and J. P. Schloeder, SIAM J. Control Optim. 43, 2005, 1714).

    It is without steady error by default: a disturbance is estimated and predicted (G. Pannocchia and J. B. Rawlings,
    AIChE J. 49, 2003, 426), by a `tras.Observer` of all states with a disturbance of the inputs, or by the ``observer``
    that it has.

    Parameters
    ----------
    model : KoopmanModel or tras.control.predictors.Predictor
        `tras.control.predictors.plant` makes one of the true equations.
    horizon : int
        Samples.
    weights : sequence or mapping from the names of states
        Of the squared errors, in the states' units. The states with a weight follow the reference, whose columns have
        the mapping's order. Default: all states, 1 over the square of each half-range.
    rate_weights : float, sequence or mapping from the names of inputs
        Of the squared changes of the inputs from sample to sample, in their units; positive. Default: 1e-3 over the
        square of each half-range.
    limits : sequence of pairs or mapping from the names of inputs
        Lowest and highest input. Default: the range of the data, or the limits of the plant.
    rates : float, sequence or mapping from the names of inputs
        Largest change of an input in a second. Default: none.
    states : mapping from the names of states
        Name -> (lowest, highest): soft limits, kept if it can be done at all (exact penalty).
    moves : int or sequence of int
        How many samples each input of the plan is held (move blocking), with the horizon for their sum. A number: so
        many samples have inputs of their own, the last of which is held. Default: all.
    iterations : int
        Linearisations and programs per sample.
    time_limit : float
        Seconds for one program, or 0.
    observer : Observer, optional
        Of the same model; ``controller(y, reference)`` then takes what is measured.
    offset_free : bool
        False, and without an ``observer``: no disturbance is estimated.

    Attributes
    ----------
    status : str
        "solved", or why the last program was not: then the rest of the last plan was used, within the limits; without
        any plan the middle of the limits' and the data's range.
    failures : int
        How often that was.
    plan, states_planned : (horizon, m) and (horizon, n) ndarray
        Inputs from now on, and the states that they are predicted to lead to one sample later each, in physical units.
    blocks : (horizon,) ndarray of int
        Which input of the plan's own each sample has.
    program : tras.control.qp.Program

    Raises
    ------
    ValueError
        On unknown names, or numbers that do not fit.

    Examples
    --------
    >>> import numpy as np, tras
    >>> log = tras.simulate_closed_loop(tras.multisine(20, 0.01, [0.5, 1.2], [1.0, 2.5], 0), 0.01)
    >>> model = tras.KoopmanModel(tras.Mechanical(4)).fit(log.select(inputs=["u_phi", "u_psi"]).cut(101))
    >>> controller = MPC(model, weights={"phi": 1, "psi": 1}, limits=[(-0.144, 0.207), (-0.241, 0.14)])
    >>> controller([0.1, 0, 0, 0], [0.1, 0.5]).shape, controller.status
    ((2,), 'solved')
    >>> run = tras.simulate_closed_loop(np.tile([0.1, 0.5], (100, 1)), 0.01, controllers=controller, x0=[0.1, 0, 0, 0])
    >>> bool(abs(run.states[0][-1, 2] - 0.5) < 0.2)
    True
    """

    def __init__(
        self,
        model: Any,
        *,
        horizon: int = 40,
        weights: Numbers | None = None,
        rate_weights: Numbers | None = None,
        limits: Pairs | None = None,
        rates: Numbers | None = None,
        states: Pairs | None = None,
        moves: int | Sequence[int] | None = None,
        iterations: int = 1,
        time_limit: float = 0.0,
        observer: Observer | None = None,
        offset_free: bool = True,
    ):
        whole_number("horizon", horizon)
        whole_number("iterations", iterations)
        number("time_limit", time_limit, 0, give="seconds, or 0 for no limit")
        self.horizon, self.iterations = horizon, iterations
        self.blocks = _blocks(moves, horizon)
        self.program = Program(time_limit=time_limit)
        super().__init__(model, weights, limits, observer, offset_free)
        c = self.channels
        inputs, n = c.input_names, len(c.state_names)
        self.rate_weights = per_channel("rate_weights", rate_weights, inputs, _RATE_WEIGHT / c.u_scale**2)
        if not (self.rate_weights > 0).all():
            raise ValueError(f"rate_weights is {rate_weights!r}; give positive numbers.")
        self.rates = per_channel("rates", rates, inputs, np.full(len(inputs), np.inf))
        self.state_limits = pairs("states", states, c.state_names, np.tile([-np.inf, np.inf], (n, 1)))
        self._prepare()

    def _prepare(self):
        """What stays the same from sample to sample, in scaled channels."""
        c, blocks, m = self.channels, self.blocks, len(self.channels.input_names)
        moves = blocks[-1] + 1
        self._error_scale = np.sqrt(self.weights[self.rows]) * c.x_scale[self.rows]
        # Changes between moves: the first from the last input.
        changes = np.eye(moves * m) - np.eye(moves * m, k=-m)
        weights = np.tile(self.rate_weights * c.u_scale**2, moves)
        self._change_cost = changes.T @ (weights[:, None] * changes)
        self._first_cost = np.diag(np.concatenate([weights[:m], np.zeros((moves - 1) * m)]))
        low, high = self._scaled_limits()
        self._low, self._high = np.tile(low, moves), np.tile(high, moves)
        most = self.rates * c.dt / c.u_scale
        limited = np.isfinite(np.tile(most, moves))
        self._changes, self._most = changes[limited], np.tile(most, moves)[limited]
        self._of_first = limited[:m]
        scaled = (self.state_limits - c.x_offset[:, None]) / c.x_scale[:, None]
        self._limited = np.flatnonzero(np.isfinite(scaled).any(axis=1))
        self._state_low, self._state_high = (np.repeat(side, self.horizon) for side in scaled[self._limited].T)

    def reset(self) -> None:
        """Forget everything about the run so far: estimate, plan, last input, failures."""
        super().reset()
        self.status, self.failures = "no step yet", 0
        self._z = self._u = None
        self.program.forget()

    @property
    def plan(self) -> np.ndarray:
        self._require_plan()
        return self._u * self.channels.u_scale + self.channels.u_offset

    @property
    def states_planned(self) -> np.ndarray:
        self._require_plan()
        c = self.channels
        return self._z[1 : self.horizon + 1, : len(c.x_scale)] * c.x_scale + c.x_offset

    def _require_plan(self):
        if self._u is None:
            raise ValueError("the controller has no plan yet; call it first.")

    def _inputs(self, z, of_inputs, of_states, reference):
        N = self.horizon
        ahead = reference[np.minimum(np.arange(1, N + 1), len(reference) - 1)]
        first = self._u is None
        if first:
            before = None
            u = np.clip(np.zeros((N, len(self.limits))), *self._scaled_limits())
            states = np.tile(z, (N, 1))
        else:
            before = (self.u - self.channels.u_offset) / self.channels.u_scale
            u, states = np.vstack([self._u[1:], self._u[-1:]]), self._z[1:]
        later = None
        for _ in range(FIRST_ROUNDS if first else self.iterations):
            horizon = self._horizon(z, states, u, of_inputs, of_states)
            if horizon is None:
                self.status = _ASTRAY
                break
            solution = self._solve(horizon, ahead, before)
            self.status = solution.status
            if solution.v is None:
                break
            moves = solution.v.reshape(-1, u.shape[1])[self.blocks]
            settled = first and np.abs(moves - u).max() < 1e-6
            later = horizon.free + horizon.response.reshape(*horizon.free.shape, -1) @ solution.v
            u, states = moves, np.vstack([z, later[:-1]])
            if settled or not self.predictor.follows_plan:
                break
            if first:  # far from any plan its states are simulated, which keeps them where the model is sound
                states = self.predictor.simulate(z, (u + of_inputs)[:-1], of_states)
        if later is None:  # nothing was solved: the rest of the last plan, and states to begin anew with
            self.failures += 1
            later = states = np.tile(z, (N, 1))
        self._u = u
        # States from now on, with one more behind the horizon: the plan of the next sample begins one later.
        self._z = np.vstack([states, later[-1:]])
        return u[0]

    def _horizon(self, z, states, u, *disturbances):
        """The linear predictions, or None where the plan has gone where the model has no finite ones."""
        try:
            with np.errstate(over="ignore", invalid="ignore"):
                horizon = self.predictor.horizon(z, states, u, *disturbances, self.blocks)
        except (ValueError, ArithmeticError):  # so `tras.twin_rotor` says that it cannot go on
            return None
        return horizon if np.isfinite(horizon.free).all() and np.isfinite(horizon.response).all() else None

    def _solve(self, horizon, reference, before):
        N, rows = self.horizon, self.rows
        response = horizon.response.reshape(*horizon.free.shape, -1)
        weighted = (response[:, rows] * self._error_scale[:, None]).reshape(N * len(rows), -1)
        errors = ((horizon.free[:, rows] - reference) * self._error_scale).ravel()
        H = weighted.T @ weighted + self._change_cost
        f = weighted.T @ errors
        m = len(self.limits)
        if before is None:
            H -= self._first_cost
            H[range(len(H)), range(len(H))] += 1e-9 * np.trace(H) / len(H)
        else:
            f[:m] -= self._first_cost.diagonal()[:m] * before
        G, lower, upper, soft = [], [], [], []
        if len(self._changes):
            offset = np.zeros(len(self._most))
            if before is not None:
                offset[: self._of_first.sum()] = before[self._of_first]
            most = self._most.copy()
            if before is None:
                most[: self._of_first.sum()] = np.inf
            G.append(self._changes), lower.append(offset - most), upper.append(offset + most)
            soft.append(np.zeros(len(most), dtype=bool))
        if len(self._limited):
            free = horizon.free[:, self._limited].T.ravel()
            G.append(response[:, self._limited].transpose(1, 0, 2).reshape(len(free), -1))
            lower.append(self._state_low - free), upper.append(self._state_high - free)
            soft.append(np.ones(len(free), dtype=bool))
        if not G:
            return self.program.solve(H, f, self._low, self._high)
        parts = (np.concatenate(part) for part in (lower, upper, soft))
        return self.program.solve(H, f, self._low, self._high, np.vstack(G), *parts)


def _blocks(moves, horizon):
    """Number of the move at each sample of the horizon."""
    if moves is None:
        return np.arange(horizon)
    if np.ndim(moves) == 0:
        whole_number("moves", moves, 1, horizon)
        return np.minimum(np.arange(horizon), moves - 1)
    lengths = list(moves)
    for i, length in enumerate(lengths):
        whole_number(f"moves[{i}]", length)
    if sum(lengths) != horizon:
        raise ValueError(f"moves holds {sum(lengths)} samples together but the horizon {horizon}; make them equal.")
    return np.repeat(np.arange(len(lengths)), lengths)
