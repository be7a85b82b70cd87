"""What all other methods share: scaling, checks, roll-outs side by side."""

from collections.abc import Sequence

import numpy as np

from tras import rollout
from tras.estimator import Channels, Estimator
from tras.recording import Recording, join


class Baseline(Estimator):
    """An identified model of scaled channels; a subclass supplies how to learn and how to go on.

    ``_learn(trajectories)``
        From a list of (states (samples, n), inputs (samples, m)), scaled; sets ``n_parameters_``, how many numbers from
        data a prediction needs.
    ``_advance(z, u)``
        One sample: (n, batch), (m, batch) -> (n, batch). Methods whose state is not the system's replace `_roll_out`.
    """

    def fit(self, recording: Recording | Sequence[Recording], y=None) -> "Baseline":
        """Identify from a `Recording`, or a sequence of recordings with the same channels.

        Raises
        ------
        ValueError
            On a wrong option, a constant channel, no snapshot pairs, too few data.
        """
        recording = join(recording)
        if recording.pairs == 0:
            raise ValueError("no trajectory has two samples, so there are no snapshot pairs; record more.")
        self._check_options()
        self.channels_ = Channels.of(recording)
        scaled = [((x - self.x_offset_) / self.x_scale_, (u - self.u_offset_) / self.u_scale_) for x, u in recording]
        self._learn(scaled)
        return self

    def _simulate_scaled(self, x, u):
        return self._roll_out(x[:, 0].T.copy(), u.transpose(1, 2, 0)).transpose(2, 0, 1)

    def _roll_out(self, x, u):
        """Scaled states (samples, n, batch) from (n, batch) under (samples, m, batch)."""
        return rollout.roll_out(self._advance, x, u)

    def _check_options(self):
        """Nothing to check unless a subclass says so."""

    def require_fitted(self):
        if not hasattr(self, "n_parameters_"):
            raise ValueError("the model is not fitted; call fit(recording) first.")


def pairs(trajectories):
    """All snapshot pairs, none across two trajectories: states, inputs, next states, (pairs, channels) each."""
    return tuple(map(np.concatenate, zip(*[(x[:-1], u[:-1], x[1:]) for x, u in trajectories])))


def ridge(features, targets, alpha=0.0):
    """Least squares, (points, N), (points, k) -> (N, k); the coefficients' squares weigh ``alpha`` times the points."""
    count = features.shape[1]
    if len(features) < count:
        counts = f"{len(features)} snapshot pairs for {count} coefficients per channel"
        raise ValueError(f"there are {counts}; record more or choose a smaller model.")
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
            channels = np.repeat(np.arange(one), row)
            self.factors[: len(channels), k] = channels

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


def check(name, value, sound, expected):
    """Raise a ValueError that names the option unless ``sound``."""
    if not sound:
        raise ValueError(f"{name} is {value!r}; give {expected}.")
