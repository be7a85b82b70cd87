"""States, delays and a disturbance from what is measured: the extended Kalman filter."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tras.control.options import Numbers, per_channel, require_known
from tras.control.predictors import predictor

_NOISE = 1e-3  # half-ranges: the default of a measurement
_EXACT = 1e-6  # half-ranges: the same where all states are measured and none has to be found by differences
_GUSTS = 0.1  # half-ranges of the inputs: the default of what acts for one sample
_MEMORY = 100  # samples in which a disturbance is told from that, by default
_UNKNOWN = 1.0  # half-ranges: the standard deviation of a state that was never measured


class Observer:
    """Estimate all states and a disturbance of the inputs from some of the states.

    The disturbance d is added to inputs, or to states after each sample, and constant but for a random walk: what a
    controller needs to be without steady error (G. Pannocchia and J. B. Rawlings, AIChE J. 49, 2003, 426). It has to be
    where the unknown acts: on the inputs, if these are torques; on all states, if the inputs are commands of motors
    whose speeds are measured too. As many disturbances as measurements are enough for any constant error of the model.
    The filter is the extended Kalman filter of z, which with a model's delays holds earlier samples too, and d. Where
    the model runs away from an estimate, the filter begins anew with the measurement.

    Parameters
    ----------
    model : KoopmanModel or tras.control.predictors.Predictor
    measured : sequence of str, optional
        Names of the states that are measured; default all.
    disturbed : sequence of str, optional
        Names of the inputs or states that a disturbance is added to; default the inputs. ``[]``: there is none.
    noise : float, sequence or mapping, optional
        Standard deviation of the noise of each of them, in its unit (`tras.noise_level` estimates it). Default: a
        thousandth of the half-range of the data; next to nothing where all states of a model without delays are
        measured, so that a controller acts on what is measured.
    process : float, sequence or mapping, optional
        Standard deviation of what else acts on each input for one sample, in its unit: the larger, the more a
        measurement counts and the less the model. Default: a tenth of the half-range. The states have the residual of
        the fit besides, and those that are disturbed at least a thousandth of their half-range.
    drift : float, sequence or mapping, optional
        Standard deviation of the change of each disturbance from sample to sample, in the unit of its input or state.
        Default: a hundredth of what else acts there, so that with little noise it is known after 100 samples. 0: it
        stays where it is.

    Attributes
    ----------
    disturbance : (disturbed,) ndarray
        Its estimate, in the units of these inputs or states.
    covariance : (n' + disturbed, n' + disturbed) ndarray
        Of the estimate's error, in scaled channels.
    restarts : int
        How often the filter began anew since the last `reset`.
    rows : (measured,) ndarray
        Indices of the measured states.
    on_inputs, on_states : (m, disturbed) and (n', disturbed) ndarray
        Where the disturbances are added.
    R, Q, gusts : (measured, measured), (n' + disturbed, n' + disturbed) and (m,) ndarray
        Covariance of the measurements and of what is added in a sample, and the deviation of what acts on the inputs
        besides, in scaled channels.

    Raises
    ------
    ValueError
        On unknown names, or numbers that do not fit.

    Examples
    --------
    >>> import numpy as np, tras
    >>> from tras.control.predictors import plant
    >>> rig = plant(tras.PlantParameters(), 0.01)
    >>> observer = Observer(rig, measured=["phi", "psi"])
    >>> for _ in range(200):
    ...     x = observer.update([-0.4909, 0.0], [0.0, 0.0])
    >>> bool(np.abs(x - [-0.4909, 0, 0, 0]).max() < 1e-3)
    True
    """

    def __init__(
        self,
        model: Any,
        measured: Sequence[str] | None = None,
        *,
        disturbed: Sequence[str] | None = None,
        noise: Numbers | None = None,
        process: Numbers | None = None,
        drift: Numbers | None = None,
    ):
        self.predictor = predictor(model)
        c = self.channels = self.predictor.channels
        self.measured = tuple(c.state_names if measured is None else measured)
        for name in self.measured:
            require_known("measured", name, c.state_names)
        if len(set(self.measured)) < len(self.measured) or not self.measured:
            raise ValueError(f"measured is {list(self.measured)}; name one state or more, each once.")
        self.rows = np.array([c.state_names.index(name) for name in self.measured])
        self._place_disturbances(disturbed)
        n, count, m = len(c.state_names), len(c.z_scale), len(c.input_names)
        size = count + len(self.disturbed)
        everything = set(self.measured) == set(c.state_names) and not c.delays  # delays are for what is not measured
        least = (_EXACT if everything else _NOISE) * c.x_scale[self.rows]
        self.noise = per_channel("noise", noise, self.measured, least)
        self.process = per_channel("process", process, c.input_names, _GUSTS * c.u_scale)
        self.gusts = self.process / c.u_scale
        _, slopes = self.predictor.advance_with_slopes(np.zeros((count, 1)), np.zeros((m, 1)))
        white = np.sqrt(slopes[0, :n, count:] ** 2 @ self.gusts**2)  # of each state, in the middle of the data
        of_states = np.where(self.on_states[:n].any(axis=1), np.maximum(white, _NOISE), 0)
        acting = self.on_inputs.T @ self.gusts + self.on_states[:n].T @ of_states
        self.drift = per_channel("drift", drift, self.disturbed, acting / _MEMORY * self._disturbance_scale)
        self.R = np.diag(np.maximum(self.noise / c.x_scale[self.rows], 1e-9) ** 2)
        self.Q = np.zeros((size, size))
        self.Q[range(n), range(n)] = self.predictor.accuracy**2 + np.where(of_states > white, of_states, 0) ** 2
        self.Q[range(count, size), range(count, size)] = (self.drift / self._disturbance_scale) ** 2
        self.reset()

    def _place_disturbances(self, names):
        """Matrices that add the disturbances to inputs (m, disturbed) and to states (n', disturbed)."""
        c = self.channels
        self.disturbed = tuple(c.input_names if names is None else names)
        for name in self.disturbed:
            require_known("disturbed", name, c.input_names + c.state_names)
        self.on_inputs = np.zeros((len(c.input_names), len(self.disturbed)))
        self.on_states = np.zeros((len(c.z_scale), len(self.disturbed)))
        self._disturbance_scale = np.empty(len(self.disturbed))
        for j, name in enumerate(self.disturbed):
            place, scale, names = self.on_inputs, c.u_scale, c.input_names
            if name not in names:
                place, scale, names = self.on_states, c.x_scale, c.state_names
            i = names.index(name)
            place[i, j], self._disturbance_scale[j] = 1, scale[i]

    def reset(self) -> None:
        """Forget everything: the next measurement is the first one."""
        self._state = self.covariance = None
        self.restarts = 0

    @property
    def disturbance(self) -> np.ndarray:
        estimate = np.zeros(len(self.disturbed)) if self._state is None else self._state[len(self.channels.z_scale) :]
        return estimate * self._disturbance_scale

    def update(self, y: ArrayLike, u: ArrayLike | None) -> np.ndarray:
        """The present states (n,) from a measurement now and the input that was held since the last one.

        Parameters
        ----------
        y : (measured,) or (n,) array_like
            The measured states, or all of them: the others are not looked at.
        u : (m,) array_like or None
            None at the first measurement.
        """
        z, _, _ = self.scaled(np.asarray(y, dtype=float), u)
        c = self.channels
        return z[: len(c.x_scale)] * c.x_scale + c.x_offset

    def scaled(self, y: np.ndarray, u: ArrayLike | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The same in scaled channels: z (n',), and what disturbs the inputs (m,) and the states (n',)."""
        c = self.channels
        if y.shape == c.x_scale.shape:
            y = y[self.rows]
        if y.shape != self.rows.shape or not np.isfinite(y).all():
            raise ValueError(f"y is {y.tolist()}; give finite numbers: {', '.join(self.measured)}.")
        with np.errstate(over="ignore"):
            y = (y - c.x_offset[self.rows]) / c.x_scale[self.rows]
        follows = self._state is not None and u is not None
        if not (follows and self._follow(y, (np.asarray(u, dtype=float) - c.u_offset) / c.u_scale)):
            self.restarts += follows
            self.begin(y)
        return self.estimate

    def _follow(self, y, u):
        """One sample on; False if the estimate has gone where the model runs away."""
        try:
            with np.errstate(over="ignore", invalid="ignore"):
                self._predict(u)
                self._correct(y)
        except (ValueError, ArithmeticError):  # so `tras.twin_rotor` says that it cannot go on, and a singular matrix
            return False
        return bool(np.isfinite(self._state).all() and np.isfinite(self.covariance).all())

    @property
    def estimate(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """State, and what disturbs the inputs and the states, in scaled channels."""
        count = len(self.channels.z_scale)
        d = self._state[count:]
        return self._state[:count], self.on_inputs @ d, self.on_states @ d

    def begin(self, y: np.ndarray) -> None:
        """Nothing is known but the measurement y (measured,), in scaled channels, and it was so before."""
        c = self.channels
        n, count, size = len(c.x_scale), len(c.z_scale), len(self.Q)
        present, spread = np.zeros(n), np.full(n, _UNKNOWN)
        present[self.rows], spread[self.rows] = y, np.sqrt(np.diag(self.R))
        states = n * (c.delays + 1)
        self._state, deviations = np.zeros(size), np.zeros(size)
        self._state[:states], deviations[:states] = np.tile(present, c.delays + 1), np.tile(spread, c.delays + 1)
        deviations[count:] = self.drift / self._disturbance_scale * _MEMORY
        self.covariance = np.diag(deviations**2)

    def _predict(self, u):
        count = len(self.channels.z_scale)
        z, d = self._state[:count], self._state[count:]
        later, slopes = self.predictor.advance_with_slopes(z[:, None], (u + self.on_inputs @ d)[:, None])
        A, B = slopes[0, :, :count], slopes[0, :, count:]
        F = np.eye(len(self._state))
        F[:count, :count], F[:count, count:] = A, B @ self.on_inputs + self.on_states
        self._state = np.concatenate([later[:, 0] + self.on_states @ d, d])
        self.covariance = F @ self.covariance @ F.T + self.Q
        gusts = B * self.gusts
        self.covariance[:count, :count] += gusts @ gusts.T

    def _correct(self, y):
        P, rows = self.covariance, self.rows
        gain = np.linalg.solve(P[np.ix_(rows, rows)] + self.R, P[rows]).T
        self._state = self._state + gain @ (y - self._state[rows])
        keep = np.eye(len(P))
        keep[:, rows] -= gain
        self.covariance = keep @ P @ keep.T + gain @ self.R @ gain.T  # Joseph's form: symmetric, never negative
