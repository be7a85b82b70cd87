"""What all other methods share: scaling, checks, roll-outs side by side."""

import math

import numpy as np
from sklearn.base import BaseEstimator

from tras import rollout
from tras.recording import join


class Baseline(BaseEstimator):
    """An identified model of scaled channels; a subclass supplies how to learn and how to go on.

    ``_learn(trajectories)``
        From a list of (states (samples, n), inputs (samples, m)), scaled; sets ``n_parameters_``, the numbers found from data that a prediction needs.
    ``_advance(z, u)``
        One sample: (n, batch), (m, batch) -> (n, batch). `_roll_out` may be replaced instead, by methods whose state is not the system's.
    """

    def fit(self, recording, y=None):
        """Identify from a `Recording`, or a sequence of recordings with the same channels.

        Raises
        ------
        ValueError
            On an option that is none, a constant channel, no snapshot pairs, too few data.
        """
        recording = join(recording)
        if recording.pairs == 0:
            raise ValueError("no trajectory has two samples, so there are no snapshot pairs; record more.")
        self._check_options()
        self.dt_, self.state_names_, self.input_names_ = recording.dt, tuple(recording.state_names), tuple(recording.input_names)
        x, u = (np.concatenate(part) for part in zip(*recording))
        self.x_offset_, self.x_scale_ = _scale(x, self.state_names_)
        self.u_offset_, self.u_scale_ = _scale(u, self.input_names_)
        self._learn([((x - self.x_offset_) / self.x_scale_, (u - self.u_offset_) / self.u_scale_) for x, u in recording])
        return self

    def simulate(self, x0, inputs):
        """Roll out from ``x0`` under ``inputs``, one sample of which acts from its own instant to the next.

        Parameters
        ----------
        x0 : (..., n) array_like
        inputs : (..., samples, m) array_like

        Returns
        -------
        (..., samples, n) ndarray
            Begins with ``x0``; NaN from where a prediction runs away.

        Raises
        ------
        ValueError
            If the model is not fitted, on wrong shapes or non-finite values.
        """
        self._fitted()
        x0, inputs = np.asarray(x0, dtype=float), np.asarray(inputs, dtype=float)
        n, m = len(self.state_names_), len(self.input_names_)
        if x0.ndim < 1 or x0.shape[-1] != n:
            raise ValueError(f"x0 has shape {x0.shape}; give (..., {n}): {', '.join(self.state_names_)}.")
        if inputs.ndim < 2 or inputs.shape[-1] != m or inputs.shape[-2] < 1:
            raise ValueError(f"inputs has shape {inputs.shape}; give (..., samples, {m}): {', '.join(self.input_names_) or 'no inputs'}.")
        if not (np.isfinite(x0).all() and np.isfinite(inputs).all()):
            raise ValueError("x0 or inputs holds NaN or infinity; repair them first.")
        batch, samples = np.broadcast_shapes(x0.shape[:-1], inputs.shape[:-2]), inputs.shape[-2]
        x = np.broadcast_to((x0 - self.x_offset_) / self.x_scale_, (*batch, n)).reshape(math.prod(batch), n)
        u = np.broadcast_to((inputs - self.u_offset_) / self.u_scale_, (*batch, samples, m)).reshape(-1, samples, m)
        with np.errstate(over="ignore", invalid="ignore"):  # what runs away is NaN, and not warned of
            states = self._roll_out(x.T.copy(), u.transpose(1, 2, 0)).transpose(2, 0, 1)
        result = states * self.x_scale_ + self.x_offset_
        result[:, 0] = np.broadcast_to(x0, (*batch, n)).reshape(-1, n)
        return result.reshape(*batch, samples, n)

    def predict(self, recording):
        """Roll out every trajectory from its own first state under its own inputs; shaped like ``recording.states``."""
        self._fitted()
        recording = join(recording).select(states=self.state_names_, inputs=self.input_names_)
        if abs(recording.dt - self.dt_) > 1e-9 * self.dt_:
            raise ValueError(f"the recording is sampled at {recording.dt:g} s but the model at {self.dt_:g} s; resample or fit again.")
        lengths = recording.lengths
        inputs = np.zeros((len(recording), lengths.max(), recording.m))
        for padded, (_, u) in zip(inputs, recording):
            padded[: len(u)] = u
        states = self.simulate(np.stack([x[0] for x, _ in recording]), inputs)
        return states if np.all(lengths == lengths[0]) else [x[:k] for x, k in zip(states, lengths)]

    def _roll_out(self, x, u):
        """Scaled states (samples, n, batch) from (n, batch) under (samples, m, batch)."""
        return rollout.roll_out(self._advance, x, u)

    def _check_options(self):
        """Nothing to check unless a subclass says so."""

    def _fitted(self):
        if not hasattr(self, "n_parameters_"):
            raise ValueError("the model is not fitted; call fit(recording) first.")


def pairs(trajectories):
    """All snapshot pairs, none across two trajectories: states, inputs, next states, (pairs, channels) each."""
    return tuple(np.concatenate(part) for part in ([x[:-1] for x, _ in trajectories], [u[:-1] for _, u in trajectories], [x[1:] for x, _ in trajectories]))


def ridge(features, targets, alpha=0.0):
    """Least squares by QR with ``alpha`` times the number of rows on the squares of the coefficients: (points, N), (points, k) -> (N, k)."""
    count = features.shape[1]
    if len(features) < count:
        raise ValueError(f"there are {len(features)} snapshot pairs for {count} coefficients a channel; record more or choose a smaller model.")
    if alpha:
        features = np.vstack([features, np.sqrt(alpha * len(features)) * np.eye(count)])
        targets = np.vstack([targets, np.zeros((count, targets.shape[1]))])
    return np.linalg.lstsq(features, targets, rcond=1e-13)[0]


class Monomial:
    """Monomials of channels by their exponents: (N, channels) -> values (N, batch) at (channels, batch)."""

    def __init__(self, powers):
        powers = np.asarray(powers, dtype=int)
        degree = max(1, powers.sum(axis=1).max(initial=0))
        one = powers.shape[1]  # the row behind all channels holds ones
        self.factors = np.full((degree, len(powers)), one)
        for k, row in enumerate(powers):
            chosen = np.repeat(np.arange(one), row)
            self.factors[: len(chosen), k] = chosen

    def __call__(self, z):
        z = np.concatenate([z, np.ones((1, z.shape[1]))])
        values = z[self.factors[0]]
        for factor in self.factors[1:]:
            values *= z[factor]
        return values


def exponents(channels, degree):
    """All exponents of total degree at most ``degree``, the constant first, then by degree: (N, channels)."""
    rows, level = [(0,) * channels], {(0,) * channels}
    for _ in range(degree):
        level = {tuple(e + (i == j) for i, e in enumerate(row)) for row in level for j in range(channels)}
        rows += sorted(level, reverse=True)
    return np.array(rows)


def check(name, value, sound, wanted):
    """Raise a ValueError that names the option unless ``sound``."""
    if not sound:
        raise ValueError(f"{name} is {value!r}; give {wanted}.")


def _scale(values, names):
    """Middle and half-range of each channel."""
    low, high = (values.min(axis=0), values.max(axis=0)) if values.size else (np.empty(0), np.empty(0))
    half = (high - low) / 2
    for name, a, b, width in zip(names, low, high, half):
        if width <= 1e-12 * max(abs(a), abs(b)):
            raise ValueError(f"channel {name!r} is constant ({a:g}) over the whole recording: nothing can be learnt about it; leave it out with recording.select(...).")
    return (high + low) / 2, half
