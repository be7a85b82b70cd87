"""What every identified model shares: channels and their scales, roll-outs from measured states, the score."""

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator

from tras import metrics
from tras.io.npz import MAX_NUMBER
from tras.recording import Recording, join
from tras.workflow import arguments

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame

    from tras.analysis.residuals import Residuals


@dataclass(frozen=True)
class Channels:
    """Names, units, sampling time and scale of each channel: its middle becomes 0, the ends of its range -1 and 1.

    ``delays`` earlier samples of the states count as states too (z, newest first), and those of the inputs if
    ``delayed_inputs``. With ``lead`` 1 the input that acts from one sample to the next is the one recorded at the next.
    """

    dt: float
    state_names: tuple[str, ...]
    state_units: tuple[str, ...]
    input_names: tuple[str, ...]
    input_units: tuple[str, ...]
    x_offset: np.ndarray
    x_scale: np.ndarray
    u_offset: np.ndarray
    u_scale: np.ndarray
    delays: int = 0
    delayed_inputs: bool = False
    lead: int = 0

    def __post_init__(self):
        object.__setattr__(self, "delayed_inputs", bool(self.delayed_inputs and self.delays and self.input_names))

    @classmethod
    def of(
        cls,
        recording: Recording,
        ranges: dict | None = None,
        delays: int = 0,
        delayed_inputs: bool = False,
        lead: int = 0,
    ) -> "Channels":
        """Those of a recording, scaled by ``ranges`` (channel -> (lowest, highest)) or by its own.

        Raises
        ------
        ValueError
            If a channel is constant, or a number is beyond 1e100 or a range or the sampling time below 1e-100: what
            follows would overflow.
        """
        arguments.number("dt, the sampling time in s,", recording.dt, 1 / MAX_NUMBER, MAX_NUMBER)
        names, inputs = tuple(recording.state_names), tuple(recording.input_names)
        ranges = ranges_of(recording) if ranges is None else ranges
        (x_offset, x_scale), (u_offset, u_scale) = _middle_and_half(ranges, names), _middle_and_half(ranges, inputs)
        units = tuple(recording.state_units), tuple(recording.input_units)
        labels = recording.dt, names, units[0], inputs, units[1]
        return cls(*labels, x_offset, x_scale, u_offset, u_scale, delays, delayed_inputs, lead)

    @property
    def z_names(self) -> list[str]:
        """Names of the states and of what is delayed."""
        past = range(1, self.delays + 1)
        names = [*self.state_names, *(f"{name}[-{k}]" for k in past for name in self.state_names)]
        return names + [f"{name}[-{k}]" for k in past for name in self.input_names if self.delayed_inputs]

    @property
    def z_offset(self) -> np.ndarray:
        return self._over_delays(self.x_offset, self.u_offset)

    @property
    def z_scale(self) -> np.ndarray:
        return self._over_delays(self.x_scale, self.u_scale)

    @property
    def origin(self) -> np.ndarray:
        """Where the zeros of all channels (n' + m,) lie in their scaled values."""
        return np.concatenate([-self.z_offset / self.z_scale, -self.u_offset / self.u_scale])

    def _over_delays(self, of_states, of_inputs):
        return np.concatenate(
            [np.tile(of_states, self.delays + 1), np.tile(of_inputs, self.delays * self.delayed_inputs)]
        )

    def matched(self, recording) -> Recording:
        """A recording, or a sequence of them, with these channels in this order.

        Raises
        ------
        ValueError
            If a channel is missing or the sampling time differs.
        """
        recording = join(recording).select(states=self.state_names, inputs=self.input_names)
        if abs(recording.dt - self.dt) > 1e-9 * self.dt:
            every, remedy = round(self.dt / recording.dt), "resample or fit again"
            if every > 1 and abs(every * recording.dt - self.dt) <= 1e-9 * self.dt:
                remedy = f"take recording.decimated({every}{', lead=1' if self.lead else ''})"
            raise ValueError(
                f"the recording is sampled at {recording.dt:g} s but the model at {self.dt:g} s; {remedy}."
            )
        return recording

    def scaled(self, recording: Recording) -> Recording:
        """The recording in scaled channels, delayed samples among the states."""
        states = [(x - self.x_offset) / self.x_scale for x, _ in recording]
        inputs = [self.acting((u - self.u_offset) / self.u_scale) for _, u in recording]
        return Recording(states, inputs, recording.dt).delayed(self.delays, inputs=self.delayed_inputs)

    def acting(self, inputs: np.ndarray) -> np.ndarray:
        """The inputs (..., samples, m) that act from each sample on; nothing is known of the one after the last."""
        return np.concatenate([inputs[..., 1:, :], inputs[..., -1:, :]], axis=-2) if self.lead else inputs

    def points(self, x, u=None) -> tuple[np.ndarray, np.ndarray]:
        """Scaled copies of z (..., n') and u (..., m) in physical units."""
        x = np.asarray(x, dtype=float)
        u = np.empty((*x.shape[:-1], 0)) if u is None else np.asarray(u, dtype=float)
        offset, m = self.z_offset, len(self.input_names)
        if x.ndim == 0 or x.shape[-1] != len(offset) or u.shape != (*x.shape[:-1], m):
            raise ValueError(
                f"x has shape {x.shape} and u {u.shape}; give (..., {len(offset)}) and (..., {m}) "
                "with the same leading axes."
            )
        return (x - offset) / self.z_scale, (u - self.u_offset) / self.u_scale


class Estimator(BaseEstimator):
    """An identified model of scaled channels: the base of `tras.KoopmanModel` and of the methods that it is compared
    with.

    A subclass sets ``channels_`` in its ``fit`` and supplies `require_fitted` and `_simulate_scaled`.
    """

    delays = 0

    channels_: Channels

    dt_ = property(lambda self: self.channels_.dt)
    state_names_ = property(lambda self: self.channels_.state_names)
    state_units_ = property(lambda self: self.channels_.state_units)
    input_names_ = property(lambda self: self.channels_.input_names)
    input_units_ = property(lambda self: self.channels_.input_units)
    x_offset_ = property(lambda self: self.channels_.x_offset)
    x_scale_ = property(lambda self: self.channels_.x_scale)
    u_offset_ = property(lambda self: self.channels_.u_offset)
    u_scale_ = property(lambda self: self.channels_.u_scale)

    @abstractmethod
    def require_fitted(self) -> None:
        """A ValueError unless it is ready to predict."""

    @abstractmethod
    def _simulate_scaled(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """(runs, samples, n) from scaled first samples (runs, delays + 1, n) under scaled inputs (runs, samples, m)."""

    def simulate(self, x0: ArrayLike, inputs: ArrayLike) -> np.ndarray:
        """Roll out from ``x0`` under ``inputs``, one sample of which acts from its own instant to the next.

        With ``lead=1`` it acts from the instant before it to its own.

        Parameters
        ----------
        x0 : (..., n) array_like
            With delays the first ``delays + 1`` samples, (..., delays + 1, n); the prediction starts at the last of
            them.
        inputs : (..., samples, m) array_like
            From the first sample of ``x0`` on. ``m = 0`` (autonomous): an empty array of shape (samples, 0).

        Returns
        -------
        (..., samples, n) ndarray
            Begins with ``x0``. A prediction that leaves the training data's range a thousandfold is abandoned: NaN from
            there on.

        Raises
        ------
        ValueError
            If the model is not fitted, on wrong shapes or non-finite values.
        """
        self.require_fitted()
        x0, inputs = np.asarray(x0, dtype=float), np.asarray(inputs, dtype=float)
        n, m, d = len(self.state_names_), len(self.input_names_), self.delays
        states, channels = ", ".join(self.state_names_), ", ".join(self.input_names_) or "no inputs"
        x0 = x0[..., None, :] if not d and x0.ndim else x0
        if x0.ndim < 2 or x0.shape[-2:] != (d + 1, n):
            shape = x0.shape if d else x0.shape[:-2] + x0.shape[-1:]
            needed = f"(..., {d + 1}, {n}), the first {d + 1} samples of" if d else f"(..., {n}):"
            raise ValueError(f"x0 has shape {shape}; give {needed} {states}.")
        if inputs.ndim < 2 or inputs.shape[-1] != m or inputs.shape[-2] < d + 1:
            raise ValueError(
                f"inputs has shape {inputs.shape}; give (..., samples, {m}), {d + 1} samples or more: {channels}."
            )
        if not (np.isfinite(x0).all() and np.isfinite(inputs).all()):
            raise ValueError("x0 or inputs holds NaN or infinity; repair them first.")
        batch = np.broadcast_shapes(x0.shape[:-2], inputs.shape[:-2])
        runs, samples = math.prod(batch), inputs.shape[-2]
        x = np.broadcast_to((x0 - self.x_offset_) / self.x_scale_, (*batch, d + 1, n)).reshape(runs, d + 1, n)
        u = np.broadcast_to((inputs - self.u_offset_) / self.u_scale_, (*batch, samples, m)).reshape(runs, samples, m)
        u = self.channels_.acting(u)
        with np.errstate(over="ignore", invalid="ignore"):  # a prediction that runs away is NaN, without a warning
            result = self._simulate_scaled(x, u) * self.x_scale_ + self.x_offset_
        result[:, : d + 1] = np.broadcast_to(x0, (*batch, d + 1, n)).reshape(runs, d + 1, n)
        return result.reshape(*batch, samples, n)

    def predict(self, recording: Recording | Sequence[Recording]) -> np.ndarray | list[np.ndarray]:
        """Roll out every trajectory from its own first state under its own inputs; shaped like ``recording.states``."""
        self.require_fitted()
        recording = self.channels_.matched(recording)
        d, lengths = self.delays, recording.lengths
        if lengths.min() < d + 1:
            raise ValueError(f"a trajectory has {lengths.min()} samples but {d} delays need {d + 1}; leave it out.")
        longest = np.zeros((len(recording), lengths.max(), recording.m))
        for padded, (_, u) in zip(longest, recording):
            padded[: len(u)] = u
        start = np.stack([x[: d + 1] for x, _ in recording])
        states = self.simulate(start if d else start[:, 0], longest)
        return states if np.all(lengths == lengths[0]) else [x[:k] for x, k in zip(states, lengths)]

    def plot(self, recording: Recording, trajectory: int = 0, ax: "Axes | Sequence[Axes] | None" = None) -> "Figure":
        """Measured states against simulated ones over one trajectory, the fit in the legend: `tras.compare`.

        Examples
        --------
        >>> import tras
        >>> recording = tras.Recording([[[0.9**k] for k in range(20)]], dt=0.1)
        >>> model = tras.KoopmanModel(tras.Monomials(1), "one_step").fit(recording)
        >>> model.plot(recording).axes[0].get_ylabel()
        'x1'
        """
        from tras.display import plots

        return plots.one_run(recording, self, trajectory, ax)

    def residuals(
        self, recording: Recording, *, steps: int = 1, lags: int = 25, significance: float = 0.01
    ) -> "Residuals":
        """Errors of predictions over ``steps`` samples, and whether they still hold what a model could predict.

        Tested are the correlation of each state's residuals with their own past (Ljung and Box, Biometrika 65, 1978,
        297) and with the past of each input (L. Ljung, *System Identification*, 2nd ed., (16.67)), as MATLAB's
        ``resid`` does. Predictions over several samples overlap: their residuals are correlated over ``steps - 1`` lags
        whatever the model. These lags are not tested, and the bounds beyond allow for them (Bartlett's formula).

        An alarm means that a better model of the same channels may exist, not that this one is of no use. These are
        tests of correlation: what a model lacks in a product such as ``x u`` of a fast input leaves no trace in them.
        On the data that were fitted there are fewer alarms than ``significance``.

        Parameters
        ----------
        recording : Recording
            Best one that was not fitted.
        steps : int
            Samples that each prediction reaches.
        lags : int
            Number of lags tested: ``steps`` to ``steps + lags - 1``.
        significance : float
            Share of false alarms, of all tests together, and the level of the bounds of a single lag.

        Returns
        -------
        Residuals
            Of `tras.analysis.residuals`: ``white``, ``verdict``, ``table`` of the tests, ``correlations``, ``errors``,
            ``plot()``.

        Raises
        ------
        ValueError
            If the model is not fitted, channels are missing, there are too few samples, or a prediction runs away.

        Examples
        --------
        >>> import numpy as np, tras
        >>> rng = np.random.default_rng(0)
        >>> u, noise, x = rng.normal(size=(500, 1)), 0.1 * rng.normal(size=(500, 1)), np.zeros((500, 1))
        >>> for k in range(499):
        ...     x[k + 1] = 0.8 * x[k] + u[k] + noise[k]
        >>> recording = tras.Recording([x[:250], x[250:]], [u[:250], u[250:]], 0.1)
        >>> model = tras.KoopmanModel(tras.Monomials(1), "one_step").fit(recording[[0]])
        >>> model.residuals(recording[[1]]).white
        True
        """
        from tras.analysis import residuals

        return residuals.residuals(self, recording, steps=steps, lags=lags, significance=significance)

    def information_criteria(self, recording: Recording, parameters: int | None = None) -> "DataFrame":
        """AIC, BIC and FPE from one-step residuals, per state and for all of them: the smaller, the better.

        With N residuals, n states, p parameters and the loss ``V = det(E^T E / N)``: ``AIC = N ln V + N n (ln(2 pi) +
        1) + 2 p``, ``BIC`` with ``p ln N`` in place of ``2 p``, ``FPE = V (1 + p/N) / (1 - p/N)`` (L. Ljung, *System
        Identification*, 2nd ed., Sec. 16.4; MATLAB's ``aic`` and ``fpe``). Without the last term the first two are
        minus twice the likelihood of Gaussian residuals at its maximum. Compare models on the same recording, with the
        same delays or nearly so, for V is of the samples that a model predicts.

        Parameters
        ----------
        recording : Recording
            The one that the model was fitted to: what p adds is for having fitted it.
        parameters : int, optional
            p. Default: coefficients that are not zero, of all states together; a state has its share. Regularization
            makes them count for less, which is not known here.

        Returns
        -------
        pandas.DataFrame
            ``state`` (the last row is "all"), ``samples, parameters, loss, AIC, BIC, FPE``.

        Raises
        ------
        ValueError
            If the model is not fitted or has no known number of parameters, or there are not more samples than these.

        Examples
        --------
        >>> import numpy as np, tras
        >>> x = np.random.default_rng(0).normal(size=(100, 1))
        >>> recording = tras.Recording([x], dt=0.1)
        >>> small, large = (tras.KoopmanModel(tras.Monomials(d), "one_step").fit(recording) for d in (1, 6))
        >>> bool(small.information_criteria(recording)["BIC"][0] < large.information_criteria(recording)["BIC"][0])
        True
        """
        from tras.analysis import residuals

        return residuals.criteria(self, recording, parameters)

    def score(self, recording: Recording | Sequence[Recording], y: None = None) -> float:
        """``-mean(NRMSE)`` over the states, in percent, of the roll-outs; ``-inf`` if one of them diverges."""
        predicted = self.predict(recording)
        true = self.channels_.matched(recording).states
        if metrics.diverged(true, predicted).any():
            return -np.inf
        return -float(np.mean(metrics.nrmse(true, predicted)))


def ranges_of(recording: Recording) -> dict:
    """Channel -> (lowest, highest) over a recording."""
    x, u = (np.concatenate(part) for part in zip(*recording))
    both = zip((*recording.state_names, *recording.input_names), (*x.T, *u.T))
    return {name: (values.min(), values.max()) for name, values in both}


def checked(ranges: dict | None, recording) -> dict | None:
    """``ranges`` in the order of the recording's channels; None stays None.

    Raises
    ------
    ValueError
        If a channel has none, or one that is no range.
    """
    if ranges is None:
        return None
    pairs = {}
    for name in (*recording.state_names, *recording.input_names):
        try:
            low, high = map(float, ranges[name])
        except (KeyError, TypeError, ValueError):
            raise ValueError(
                f"ranges holds no pair (lowest, highest) for the channel {name!r}; give one for each channel."
            ) from None
        if not (np.isfinite([low, high]).all() and low < high):
            raise ValueError(
                f"ranges has ({low:g}, {high:g}) for the channel {name!r}; "
                "give two finite numbers, the lower one first."
            )
        pairs[name] = low, high
    return pairs


def _middle_and_half(ranges, names):
    """Middle and half-range of the named channels, two arrays."""
    low, high = np.array([ranges[name] for name in names], dtype=float).reshape(-1, 2).T
    for name, least, most in zip(names, low, high):
        if max(abs(least), abs(most)) > MAX_NUMBER:
            raise ValueError(
                f"channel {name!r} reaches from {least:g} to {most:g}, whose squares no number can hold: if that is an "
                "outlier, repair it, otherwise choose another unit."
            )
    half = (high - low) / 2
    constant = half <= 1e-12 * np.maximum(np.abs(low), np.abs(high))
    if constant.any():
        i = int(np.argmax(constant))
        raise ValueError(
            f"channel {names[i]!r} is constant ({low[i]:g}) over the whole recording: "
            "nothing can be learnt about it; leave it out with recording.select(...)."
        )
    if (half < 1 / MAX_NUMBER).any():
        i = int(np.argmin(half))
        raise ValueError(
            f"channel {names[i]!r} moves by {2 * half[i]:g} in all, whose square no number can hold: choose another "
            "unit, or leave it out with recording.select(...)."
        )
    return (high + low) / 2, half
