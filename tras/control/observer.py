"""States, delays and a disturbance from what is measured: the extended Kalman filter."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tras.control.options import Numbers, per_channel, require_known
from tras.control.predictors import predictor

_NOISE = 1e-3  # half-ranges: the default of a measurement
_GUSTS = 0.1  # half-ranges of the inputs: the default of what acts for one sample
_MEMORY = 100  # samples in which a disturbance is told from that, by default
_UNKNOWN = 1.0  # half-ranges: the standard deviation of a state that was never measured


class Observer:
    """Estimate all states and a disturbance of the inputs from some of the states.

    The disturbance is added to the inputs, ``x+ = f(x, u + d + w)``, and constant but for a random walk: what a
    controller needs to be without steady error (G. Pannocchia and J. B. Rawlings, AIChE J. 49, 2003, 426). The filter
    is the extended Kalman filter of z, which with a model's delays holds earlier samples too, and d.

    Parameters
    ----------
    model : KoopmanModel or tras.control.predictors.Predictor
    measured : sequence of str, optional
        Names of the states that are measured; default all.
    noise : float, sequence or mapping, optional
        Standard deviation of the noise of each of them, in its unit (`tras.noise_level` estimates it). Default: a
        thousandth of the half-range of the data.
    process : float, sequence or mapping, optional
        Standard deviation of w, what else acts on each input for one sample, in its unit: the larger, the more a
        measurement counts and the less the model. Default: a tenth of the half-range. The states have the residual of
        the fit besides.
    drift : float, sequence or mapping, optional
        Standard deviation of the change of the disturbance from sample to sample, in the input's unit. With little
        noise, ``process / drift`` is the number of samples after which it is known. Default: a hundredth of
        ``process``. 0: it stays where it is.

    Attributes
    ----------
    disturbance : (m,) ndarray
        Its estimate, in the inputs' units.
    covariance : (n' + m, n' + m) ndarray
        Of the estimate's error, in scaled channels.

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
        self._rows = np.array([c.state_names.index(name) for name in self.measured])
        n, z, m = len(c.state_names), len(c.z_scale), len(c.input_names)
        scale = c.x_scale[self._rows]
        self.noise = per_channel("noise", noise, self.measured, _NOISE * scale)
        self.process = per_channel("process", process, c.input_names, _GUSTS * c.u_scale)
        self.drift = per_channel("drift", drift, c.input_names, self.process / _MEMORY)
        self._R = np.diag(np.maximum(self.noise / scale, 1e-9) ** 2)
        self._Q = np.zeros((z + m, z + m))
        self._Q[range(n), range(n)] = self.predictor.accuracy**2
        self._Q[range(z, z + m), range(z, z + m)] = (self.drift / c.u_scale) ** 2
        self._gusts = (self.process / c.u_scale) ** 2
        self.reset()

    def reset(self) -> None:
        """Forget everything: the next measurement is the first one."""
        self._state = self.covariance = None

    @property
    def disturbance(self) -> np.ndarray:
        c = self.channels
        return np.zeros(len(c.u_scale)) if self._state is None else self._state[len(c.z_scale) :] * c.u_scale

    def update(self, y: ArrayLike, u: ArrayLike | None) -> np.ndarray:
        """The present states (n,) from a measurement now and the input that was held since the last one.

        Parameters
        ----------
        y : (measured,) or (n,) array_like
            The measured states, or all of them: the others are not looked at.
        u : (m,) array_like or None
            None at the first measurement.
        """
        z, _ = self.scaled(np.asarray(y, dtype=float), u)
        c = self.channels
        return z[: len(c.x_scale)] * c.x_scale + c.x_offset

    def scaled(self, y: np.ndarray, u: ArrayLike | None) -> tuple[np.ndarray, np.ndarray]:
        """The same in scaled channels: z (n',) and the disturbance (m,)."""
        c, count = self.channels, len(self.channels.z_scale)
        if y.shape == c.x_scale.shape:
            y = y[self._rows]
        if y.shape != self._rows.shape or not np.isfinite(y).all():
            raise ValueError(f"y is {y.tolist()}; give finite numbers: {', '.join(self.measured)}.")
        y = (y - c.x_offset[self._rows]) / c.x_scale[self._rows]
        if self._state is None or u is None:
            self._begin(y)
        else:
            self._predict((np.asarray(u, dtype=float) - c.u_offset) / c.u_scale)
            self._correct(y)
        return self._state[:count], self._state[count:]

    def _begin(self, y):
        """Nothing is known but y, and it was so before."""
        c = self.channels
        n, count, m = len(c.x_scale), len(c.z_scale), len(c.u_scale)
        present, spread = np.zeros(n), np.full(n, _UNKNOWN)
        present[self._rows], spread[self._rows] = y, np.sqrt(np.diag(self._R))
        past = np.zeros(count + m)
        past[: n * (c.delays + 1)] = np.tile(present, c.delays + 1)
        self._state = past
        deviations = np.zeros(count + m)
        deviations[: n * (c.delays + 1)] = np.tile(spread, c.delays + 1)
        deviations[count:] = self.drift / c.u_scale * _MEMORY
        self.covariance = np.diag(deviations**2)

    def _predict(self, u):
        count = len(self.channels.z_scale)
        z, d = self._state[:count], self._state[count:]
        later, slopes = self.predictor.advance_with_slopes(z[:, None], (u + d)[:, None])
        F = np.eye(len(self._state))
        F[:count] = slopes[0]
        self._state = np.concatenate([later[:, 0], d])
        self.covariance = F @ self.covariance @ F.T + self._Q
        by_input = F[:count, count:]
        self.covariance[:count, :count] += (by_input * self._gusts) @ by_input.T

    def _correct(self, y):
        P, rows = self.covariance, self._rows
        gain = np.linalg.solve(P[np.ix_(rows, rows)] + self._R, P[rows]).T
        self._state = self._state + gain @ (y - self._state[rows])
        keep = np.eye(len(P))
        keep[:, rows] -= gain
        self.covariance = keep @ P @ keep.T + gain @ self._R @ gain.T  # Joseph's form: symmetric, never negative
