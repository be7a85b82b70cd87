"""The grey box: the plant's own equations, their eight parameters from data. What no black box should beat."""

from collections.abc import Sequence
from types import SimpleNamespace

import numpy as np
from scipy import optimize

from tras import rollout
from tras.paper.baselines.base import Baseline, check
from tras.paper.physics import PARAMETER_NAMES, torque_balance
from tras.recording import Recording, join
from tras.twin_rotor.plant import STATE_NAMES, TORQUE_NAMES, equations_of_motion


class GreyBox(Baseline):
    """The equations of motion of `tras.twin_rotor.plant` with the parameters that make whole roll-outs fit best.

    The start is a linear least-squares problem: the torque balance with accelerations by central differences. The input
    must be the torques: with the references the controller would have to be identified as well, another model.

    Parameters
    ----------
    seconds : float
        Length of the roll-outs that are fitted.
    loss : {"linear", "soft_l1"}
    every : int
        Of so many pieces one is fitted.
    """

    def __init__(self, seconds=1.0, loss="linear", every=1):
        self.seconds = seconds
        self.loss = loss
        self.every = every

    def fit(self, recording: Recording | Sequence[Recording], y=None) -> "GreyBox":
        """Identify from recordings of phi, phidot, psi, psidot and the torques u_phi, u_psi.

        Raises
        ------
        ValueError
            If these are not its channels, or as for the other methods.
        """
        recording = join(recording)
        if tuple(recording.state_names) != STATE_NAMES or tuple(recording.input_names) != TORQUE_NAMES:
            states, inputs = ", ".join(recording.state_names), ", ".join(recording.input_names) or "none"
            raise ValueError(
                f"the recording has states {states} and inputs {inputs}; the equations of motion need "
                f"{', '.join(STATE_NAMES)} and {', '.join(TORQUE_NAMES)}."
            )
        return super().fit(recording)

    def _check_options(self):
        check("seconds", self.seconds, self.seconds > 0, "a positive number")
        check("loss", self.loss, self.loss in ("linear", "soft_l1"), "'linear' or 'soft_l1'")
        check("every", self.every, self.every >= 1, "a whole number, 1 or more")

    def _learn(self, trajectories):
        physical = [(x * self.x_scale_ + self.x_offset_, u * self.u_scale_ + self.u_offset_) for x, u in trajectories]
        start = _balance(physical, self.dt_)
        samples = min(round(self.seconds / self.dt_) + 1, max(len(x) for x, _ in physical))
        starts = [(x, u, k) for x, u in physical for k in range(0, len(x) - samples + 1, samples - 1)]
        pieces = [(x[k : k + samples], u[k : k + samples]) for x, u, k in starts[:: self.every]]
        x, u = (np.stack(part) for part in zip(*pieces))
        runs = x[:, 0].T, u.transpose(1, 2, 0)
        true = x.transpose(1, 2, 0) / self.x_scale_[:, None]

        def misfit(factors):
            return np.nan_to_num((self._several(start * factors, *runs) - true), nan=1e3).ravel()

        def slopes(factors, step=1e-5):
            moved = np.concatenate([factors[None], factors + step * np.eye(len(factors))])
            values = self._several(start * moved, *runs)
            change = np.nan_to_num((values[..., 1:, :] - values[..., :1, :]) / step)
            return change.transpose(0, 1, 3, 2).reshape(-1, len(factors))

        options = {"f_scale": 0.01, "bounds": (1e-3, 1e3), "max_nfev": 12, "xtol": 1e-10, "ftol": 1e-10}
        solution = optimize.least_squares(misfit, np.ones(len(start)), slopes, loss=self.loss, **options)
        self.parameters_ = dict(zip(PARAMETER_NAMES, (start * solution.x).tolist()))
        self.n_parameters_ = len(self.parameters_)

    def _several(self, values, x, u):
        """Roll-outs, in half-ranges, of one set of parameters (8,) or of k sets (k, 8): (samples, n, [k,] batch)."""
        sets, batch = np.atleast_2d(values), x.shape[1]
        wide = [np.repeat(column, batch) for column in sets.T]
        parameters = SimpleNamespace(**dict(zip(PARAMETER_NAMES, wide)))
        x, u = np.tile(x, (1, len(sets))), np.tile(u, (1, 1, len(sets)))
        states = self._physical(parameters, x, u) / self.x_scale_[:, None]
        return states if np.ndim(values) == 1 else states.reshape(len(u), 4, len(sets), batch)

    def _physical(self, parameters, x, u):
        accelerations = equations_of_motion(parameters)

        def field(point):
            phiddot, psiddot = accelerations(*point)
            return np.stack([point[1], phiddot, point[3], psiddot])

        return rollout.roll_out(lambda z, v: rollout.runge_kutta(field, z, v, self.dt_, 1), x, u)

    def _roll_out(self, x, u):
        parameters = SimpleNamespace(**self.parameters_)
        x = x * self.x_scale_[:, None] + self.x_offset_[:, None]
        u = u * self.u_scale_[:, None] + self.u_offset_[:, None]
        return (self._physical(parameters, x, u) - self.x_offset_[:, None]) / self.x_scale_[:, None]


def _balance(trajectories, dt):
    """Parameters by the torque balance, accelerations by central differences under the mean of the two held torques."""
    x = np.concatenate([x[1:-1] for x, _ in trajectories])
    acceleration = np.concatenate([(x[2:, [1, 3]] - x[:-2, [1, 3]]) / (2 * dt) for x, _ in trajectories])
    u = np.concatenate([(u[1:-1] + u[:-2]) / 2 for _, u in trajectories])
    A = torque_balance(x, acceleration)
    estimate = np.linalg.lstsq(A.reshape(-1, A.shape[-1]), u.T.ravel(), rcond=None)[0]
    typical = np.maximum(np.abs(estimate), 1e-4)  # each is positive; noise may make a small one negative
    return np.where(estimate > 0, estimate, typical)
