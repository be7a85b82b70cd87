"""The linear quadratic regulator of a model linearised at a point."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

from tras.control.controller import Controller
from tras.control.observer import Observer
from tras.control.options import Numbers, Pairs, per_channel

_INPUT_WEIGHT = 1e-2  # of an input of a half-range, where an error of a half-range counts 1
ROUNDS = 20  # of Newton's method at most


class LQR(Controller):
    """``u = u_s - K (x - x_s)``, within the limits: the optimal gain K for the model linearised at a point.

    The target (x_s, u_s) is where the model rests with the followed states on the reference and the estimated
    disturbance in place (G. Pannocchia and J. B. Rawlings, AIChE J. 49, 2003, 426), found by Newton's method on
    the nonlinear model.

    Parameters
    ----------
    model, weights, limits, observer, offset_free
        As for `tras.MPC`.
    input_weights : float, sequence or mapping from the names of inputs
        Of the squared inputs, from the target on; positive. Default: 1e-2 over the square of each half-range.
    state_weights : sequence or mapping from the names of states, optional
        Of the squared states, from the target on, for states beside the followed ones, such as rates.
    x, u : array_like, optional
        The point, in physical units; default: the middle of the data.

    Attributes
    ----------
    gain, K : (m, n') ndarray
        In physical units and in scaled channels; of the delayed samples too.

    Raises
    ------
    ValueError
        On unknown names, numbers that do not fit, or where no gain stabilises the model.

    Examples
    --------
    >>> import tras
    >>> from tras.control.predictors import plant
    >>> controller = LQR(plant(tras.PlantParameters(), 0.01), weights={"phi": 1, "psi": 1})
    >>> controller([0.1, 0, 0, 0], [0.1, 0.0]).round(4)
    array([0.0592, 0.    ])
    """

    def __init__(
        self,
        model: Any,
        *,
        weights: Numbers | None = None,
        input_weights: Numbers | None = None,
        state_weights: Numbers | None = None,
        limits: Pairs | None = None,
        x: ArrayLike | None = None,
        u: ArrayLike | None = None,
        observer: Observer | None = None,
        offset_free: bool = True,
    ):
        super().__init__(model, weights, limits, observer, offset_free)
        c = self.channels
        n, m = len(c.state_names), len(c.input_names)
        self.input_weights = per_channel("input_weights", input_weights, c.input_names, _INPUT_WEIGHT / c.u_scale**2)
        further = per_channel("state_weights", state_weights, c.state_names, np.zeros(n), missing=0.0)
        x = c.x_offset if x is None else np.asarray(x, dtype=float)
        u = c.u_offset if u is None else np.asarray(u, dtype=float)
        if x.shape != (n,) or u.shape != (m,) or not (np.isfinite(x).all() and np.isfinite(u).all()):
            raise ValueError(f"x has shape {x.shape} and u {u.shape}; give finite numbers, ({n},) and ({m},).")
        z, v = self.predictor.start([x], [u]), (u - c.u_offset) / c.u_scale
        _, slopes = self.predictor.advance_with_slopes(z[:, None], v[:, None])
        A, B = slopes[0, :, : len(z)], slopes[0, :, len(z) :]
        Q = np.zeros((len(z), len(z)))
        Q[range(n), range(n)] = (self.weights + further) * c.x_scale**2
        try:
            P = linalg.solve_discrete_are(A, B, Q, np.diag(self.input_weights * c.u_scale**2))
        except (np.linalg.LinAlgError, ValueError) as error:
            raise ValueError(
                f"weights leave the linear quadratic problem without a solution ({error}); give positive "
                "input_weights, and a weight to a state that shows every mode that is not stable by itself."
            ) from None
        self.K = np.linalg.solve(np.diag(self.input_weights * c.u_scale**2) + B.T @ P @ B, B.T @ P @ A)
        self.gain = self.K * c.u_scale[:, None] / c.z_scale

    def reset(self) -> None:
        """Forget everything about the run so far."""
        super().reset()
        self._target = None

    def _inputs(self, z, of_inputs, of_states, reference):
        z_s, u_s = self._at_rest(of_inputs, of_states, reference[0], z)
        return u_s - self.K @ (z - z_s)

    def _at_rest(self, of_inputs, of_states, reference, z):
        """State and input at rest, in scaled channels, by Newton's method from the last one."""
        count, m, rows = len(z), len(of_inputs), self.rows
        state, u = (z.copy(), -of_inputs) if self._target is None else self._target
        residual = np.inf
        for _ in range(ROUNDS):
            later, slopes = self.predictor.advance_with_slopes(state[:, None], (u + of_inputs)[:, None])
            missing = np.concatenate([state - later[:, 0] - of_states, state[rows] - reference])
            slope = np.zeros((count + len(rows), count + m))
            slope[:count] = -slopes[0]
            slope[range(count), range(count)] += 1
            slope[count + np.arange(len(rows)), rows] = 1
            step = np.linalg.lstsq(slope, -missing, rcond=None)[0]
            state, u = state + step[:count], u + step[count:]
            residual = np.abs(step).max()
            if residual < 1e-10:
                break
        if not np.isfinite(residual):
            self._target = None
            return z, np.zeros(m)
        self._target = state, u
        return state, u
