"""What all controllers have in common: names and limits as arrays, the state from measurements, the reference."""

from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tras.control.observer import Observer
from tras.control.options import Numbers, Pairs, pairs, per_channel
from tras.control.predictors import predictor


class Controller:
    """Called as ``u = controller(x, reference)`` once per sample. A subclass supplies `_inputs`.

    Attributes
    ----------
    followed : tuple of str
        The states that follow the reference, in the order of its columns.
    rows : (p,) ndarray
        Their indices.
    u : (m,) ndarray or None
        The last input, in physical units.
    disturbance : ndarray
        What the observer estimates to be added to its ``disturbed`` inputs and states, in physical units.
    """

    horizon = 0  # samples of the reference that are looked ahead

    def __init__(
        self, model: Any, weights: Numbers | None, limits: Pairs | None, observer: Observer | None, offset_free
    ):
        self.predictor = predictor(model)
        c = self.channels = self.predictor.channels
        self.weights = per_channel("weights", weights, c.state_names, 1 / c.x_scale**2, missing=0.0)
        self.rows = np.flatnonzero(self.weights)
        if isinstance(weights, Mapping):  # the reference has its columns in this order
            self.rows = np.array([c.state_names.index(name) for name in weights if weights[name]], dtype=int)
        if not len(self.rows):
            raise ValueError(f"weights is {weights!r}; give a positive weight to at least one state.")
        self.followed = tuple(c.state_names[i] for i in self.rows)
        self.limits = pairs("limits", limits, c.input_names, self.predictor.limits)
        if observer is not None and not isinstance(observer, Observer):
            raise ValueError(f"observer is {observer!r}; give a tras.Observer of the same model, or None.")
        if observer is not None and observer.channels.z_names != c.z_names:
            theirs = ", ".join(observer.channels.z_names)
            raise ValueError(f"observer estimates {theirs}; make it of the model that the controller has.")
        self.observer = Observer(model) if observer is None and offset_free else observer
        self.reset()

    def reset(self) -> None:
        """Forget everything about the run so far: estimate, plan, last input."""
        self.u = None
        self._states = deque(maxlen=self.channels.delays + 1)
        self._inputs_before = deque(maxlen=max(1, self.channels.delays))
        if self.observer is not None:
            self.observer.reset()

    @property
    def disturbance(self) -> np.ndarray:
        return np.empty(0) if self.observer is None else self.observer.disturbance

    def __call__(self, x: ArrayLike, reference: ArrayLike) -> np.ndarray:
        """The input to hold until the next sample.

        Parameters
        ----------
        x : (n,) array_like
            The measured states in physical units; with an observer of some of them, these alone will do.
        reference : (p,) or (samples, p) array_like
            What the followed states should be: a constant, or the samples from now on (a preview). After its last
            sample a preview is held.

        Returns
        -------
        (m,) ndarray

        Raises
        ------
        ValueError
            On wrong shapes, NaN or infinity.
        """
        c = self.channels
        x, reference = np.asarray(x, dtype=float), np.asarray(reference, dtype=float)
        p = len(self.rows)
        if reference.ndim not in (1, 2) or reference.shape[-1] != p or not reference.size:
            raise ValueError(
                f"reference has shape {reference.shape}; give ({p},) or (samples, {p}): {', '.join(self.followed)}."
            )
        if not np.isfinite(reference).all():
            raise ValueError("reference holds NaN or infinity; give finite numbers.")
        estimate = self._estimate(x)
        wanted = (np.atleast_2d(reference) - c.x_offset[self.rows]) / c.x_scale[self.rows]
        u = self._inputs(*estimate, wanted) * c.u_scale + c.u_offset
        self.u = np.clip(u, *self.limits.T)
        self._inputs_before.appendleft(self.u)
        return self.u.copy()

    def _inputs(self, z, of_inputs, of_states, reference):
        """The inputs in scaled channels from state, disturbances and reference (samples, p)."""
        raise NotImplementedError

    def _estimate(self, x):
        """State, and what disturbs inputs and states, in scaled channels."""
        c = self.channels
        if self.observer is not None:
            return self.observer.scaled(x, self.u)
        if x.shape != c.x_offset.shape or not np.isfinite(x).all():
            raise ValueError(f"x is {x.tolist()}; give finite numbers: {', '.join(c.state_names)}.")
        self._states.appendleft(x)
        z = self.predictor.start(self._states, self._inputs_before)
        return z, np.zeros(len(c.u_offset)), np.zeros(len(z))

    def _scaled_limits(self):
        c = self.channels
        return ((self.limits - c.u_offset[:, None]) / c.u_scale[:, None]).T

    def __repr__(self):
        followed = ", ".join(f"{name!r}: {self.weights[i]:.4g}" for name, i in zip(self.followed, self.rows))
        return f"{type(self).__name__}(weights={{{followed}}})"
