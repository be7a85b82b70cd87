"""What a controller needs of a model: the map over one sample, its exact slopes, and the states over a horizon.

Three kinds: `Identified` (a `tras.KoopmanModel` that lifts anew each sample), `Lifted` (one with
``predictor="lifted_linear"``: the whole horizon is linear), and `Equations` (a plant that is known, for comparison or
in place of a model; `plant` makes one of the twin rotor).

All numbers are in scaled channels: ``z = (x - offset) / scale``. Behind the present states z holds what the model
counts as states too: earlier states, then earlier inputs.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from tras.estimator import Channels
from tras.model import KoopmanModel
from tras.predictors import PREDICTORS
from tras.twin_rotor.closed_loop import Rig, stepper

_STEP = 6e-6  # of central differences, about the cube root of the rounding error: in scaled channels
_ACCURACY = 1e-6  # half-ranges: what no prediction over one sample is better than, for an observer


class Horizon(NamedTuple):
    """States ``free + response @ moves`` at the next samples: ``free`` (N, n'), ``response`` (N, n', moves, m)."""

    free: np.ndarray
    response: np.ndarray


class Predictor:
    """The common part: channels, limits of the inputs, states and inputs as the model counts them.

    Attributes
    ----------
    channels : tras.estimator.Channels
        Names, units, sampling time, scales, delays.
    limits : (m, 2) ndarray
        Lowest and highest input in physical units: those of the plant, or of the data that were fitted.
    accuracy : (n,) ndarray
        Root mean square of the error over one sample, in scaled channels.
    """

    model: KoopmanModel | None = None  # that it is of
    channels: Channels
    limits: np.ndarray
    accuracy: np.ndarray
    follows_plan = True  # whether the horizon depends on the plan along which it is linearised

    def advance(self, z: np.ndarray, u: np.ndarray) -> np.ndarray:
        """States one sample later: (n', points), (m, points) -> (n', points)."""
        raise NotImplementedError

    def advance_with_slopes(self, z: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The same, and the derivatives by state and input (points, n', n' + m)."""
        raise NotImplementedError

    def horizon(
        self,
        z0: np.ndarray,
        z: np.ndarray,
        u: np.ndarray,
        of_inputs: np.ndarray,
        of_states: np.ndarray,
        blocks: np.ndarray,
    ) -> Horizon:
        """The states from ``z0`` on, linear in the moves: linearised along a plan, one lifting for all of it.

        Parameters
        ----------
        z0 : (n',) ndarray
        z, u : (N, n') and (N, m) ndarray
            The plan: states from now on, and inputs. They need not fit each other.
        of_inputs, of_states : (m,) and (n',) ndarray
            Disturbances that are added to every input, and to the states after every sample.
        blocks : (N,) ndarray of int
            Number of the move that acts at each sample.
        """
        later, slopes = self.advance_with_slopes(z.T, (u + of_inputs).T)
        N, n, m = len(z), len(z0), u.shape[1]
        A, B = np.ascontiguousarray(slopes[:, :, :n]), np.ascontiguousarray(slopes[:, :, n:])
        c = later.T + of_states - (A @ z[:, :, None])[:, :, 0] - (B @ u[:, :, None])[:, :, 0]
        moves = blocks[-1] + 1
        free, response = np.empty((N, n)), np.empty((N, n, moves, m))
        state, by_moves = z0, np.zeros((n, moves * m))
        for k, move in enumerate(blocks):
            state = A[k] @ state + c[k]
            by_moves = A[k] @ by_moves
            by_moves[:, move * m : (move + 1) * m] += B[k]
            free[k], response[k] = state, by_moves.reshape(n, moves, m)
        return Horizon(free, response)

    def simulate(self, z0: np.ndarray, u: np.ndarray, of_states: np.ndarray) -> np.ndarray:
        """States from ``z0`` (n',) on under inputs (N, m), ``of_states`` added after each sample: (N + 1, n')."""
        states = [z0[:, None]]
        for held in u:
            states.append(self.advance(states[-1], held[:, None]) + of_states[:, None])
        return np.concatenate(states, axis=1).T

    def start(self, states: Sequence[np.ndarray], inputs: Sequence[np.ndarray]) -> np.ndarray:
        """z (n',) from states and inputs in physical units, newest first; what is not known yet was as the oldest."""
        c = self.channels
        z = [states[min(i, len(states) - 1)] for i in range(c.delays + 1)]
        middle = [c.u_offset] if not len(inputs) else inputs
        z += [middle[min(i, len(middle) - 1)] for i in range(c.delays * c.delayed_inputs)]
        return (np.concatenate(z) - c.z_offset) / c.z_scale


class Identified(Predictor):
    """A fitted `tras.KoopmanModel` of the predictors ``vector_field`` and ``one_step``.

    Its map over one sample is that of `tras.KoopmanModel.simulate`, with the steps of the integration; the slopes are
    the exact derivatives of that.
    """

    def __init__(self, model: KoopmanModel):
        model.require_fitted()
        self.model, self.channels = model, model.channels_
        self.limits = np.stack([model.u_offset_ - model.u_scale_, model.u_offset_ + model.u_scale_], axis=1)
        first = 0 if model.columns == "states" else 1  # otherwise the constant's residual, zero, comes first
        residual = np.asarray(model.residual_)[first : first + len(model.state_names_)]
        self.accuracy = np.maximum(residual, _ACCURACY)
        way = PREDICTORS[model.predictor]
        self._advance, self._advance_with_slopes = way.advance(model), way.advance_with_slopes(model)

    def advance(self, z, u):
        return self._advance(z, u)

    def advance_with_slopes(self, z, u):
        return self._advance_with_slopes(z, u)


class Lifted(Identified):
    """A fitted model with ``predictor="lifted_linear"``: the states are lifted once, the horizon is linear.

    M. Korda and I. Mezic, Automatica 93 (2018) 149. What does not depend on the state is made once.
    """

    follows_plan = False

    def __init__(self, model: KoopmanModel):
        super().__init__(model)
        self._A, self._B, self._lift = model.koopman_matrix.T, model.B_, model.dictionary_.lift
        self._rows, self._made = model.dictionary_.coordinates, None

    def horizon(self, z0, z, u, of_inputs, of_states, blocks):
        if self._made is None or not np.array_equal(self._made[0], blocks):
            self._made = (blocks.copy(), *self._matrices(blocks))
        _, by_lifting, by_inputs, by_states, response = self._made
        free = by_lifting @ self._lift(z0[:, None])[:, 0] + by_inputs @ of_inputs + by_states @ of_states
        return Horizon(free, response)

    def _matrices(self, blocks):
        """``C A^k`` (N, n', N'), sums of ``C A^i B`` (N, n', m) and ``C A^i C'`` (N, n', n'), the response to moves."""
        rows, m, N = self._rows, self._B.shape[1], len(blocks)
        by_lifting, impulses = np.empty((N, len(rows), len(self._A))), np.empty((N, len(rows), m))
        kicks = np.empty((N, len(rows), len(rows)))
        power = np.eye(len(self._A))[rows]
        for k in range(N):
            impulses[k], kicks[k] = power @ self._B, power[:, rows]
            power = power @ self._A
            by_lifting[k] = power
        response = np.zeros((N, len(rows), blocks[-1] + 1, m))
        for j, move in enumerate(blocks):
            response[j:, :, move] += impulses[: N - j]
        return by_lifting, np.cumsum(impulses, axis=0), np.cumsum(kicks, axis=0), response


class Equations(Predictor):
    """A system whose map over one sample is known: to compare with, or first principles in place of a model.

    Slopes are central differences, all points and perturbations in one call: good to about nine digits.

    Parameters
    ----------
    advance : callable
        ``(x, u) -> x`` one sample later, (n, points) and (m, points) in physical units.
    dt : float
        Sampling time in s.
    limits : (m, 2) array_like
        Lowest and highest value of each input.
    state_names, input_names, state_units, input_units : sequence of str
    state_scale : (n,) array_like, optional
        Typical size of each state; default 1.

    Examples
    --------
    >>> import numpy as np
    >>> mass = Equations(lambda x, u: np.stack([x[0] + 0.1 * x[1] + 0.005 * u[0], x[1] + 0.1 * u[0]]),
    ...     0.1, [[-1, 1]], ["q", "v"], ["f"])
    >>> mass.advance_with_slopes(np.zeros((2, 1)), np.zeros((1, 1)))[1].round(6)[0]
    array([[1.   , 0.1  , 0.005],
           [0.   , 1.   , 0.1  ]])
    """

    def __init__(
        self,
        advance: Callable,
        dt: float,
        limits: ArrayLike,
        state_names: Sequence[str],
        input_names: Sequence[str],
        *,
        state_units: Sequence[str] | None = None,
        input_units: Sequence[str] | None = None,
        state_scale: ArrayLike | None = None,
    ):
        self.limits = np.asarray(limits, dtype=float)
        n, m = len(state_names), len(input_names)
        if self.limits.shape != (m, 2) or not (np.isfinite(self.limits).all() and (np.diff(self.limits) > 0).all()):
            raise ValueError(f"limits is {limits!r}; give a finite (lowest, highest) for each of the {m} inputs.")
        scale = np.ones(n) if state_scale is None else np.asarray(state_scale, dtype=float)
        middle, half = self.limits.mean(axis=1), np.diff(self.limits)[:, 0] / 2
        units = tuple(state_units or [""] * n), tuple(input_units or [""] * m)
        names = tuple(state_names), tuple(input_names)
        self.channels = Channels(dt, names[0], units[0], names[1], units[1], np.zeros(n), scale, middle, half)
        self.accuracy = np.full(n, _ACCURACY)
        self._physical = advance

    def advance(self, z, u):
        c = self.channels
        x, v = z * c.x_scale[:, None], u * c.u_scale[:, None] + c.u_offset[:, None]
        return np.asarray(self._physical(x, v)) / c.x_scale[:, None]

    def advance_with_slopes(self, z, u):
        point = np.concatenate([z, u])
        channels, points = point.shape
        steps = _STEP * np.eye(channels)[:, :, None]
        moved = np.concatenate([point[:, None], point[:, None] + steps, point[:, None] - steps], axis=1)
        moved = moved.reshape(channels, -1)
        later = self.advance(moved[: len(z)], moved[len(z) :]).reshape(len(z), 2 * channels + 1, points)
        slopes = (later[:, 1 : channels + 1] - later[:, channels + 1 :]) / (2 * _STEP)
        return later[:, 0], slopes.transpose(2, 0, 1)


def plant(parameters: Rig, dt: float, *, step: float = 0.01) -> Equations:
    """The twin rotor itself in place of a model, with or without rotors: the bound for every model, in one controller.

    Examples
    --------
    >>> import tras
    >>> plant(tras.PlantParameters(), 0.01).channels.state_names
    ('phi', 'phidot', 'psi', 'psidot')
    """
    p, flow = parameters, stepper(parameters, dt, step=step, functions=np)
    speeds = getattr(p, "speed_limits", ())

    def advance(x, u):
        # A plan may hold speeds that no command gives; the rotors' polynomials mean nothing there.
        rotors = (np.clip(speed, *ends) for speed, ends in zip(x[4:], speeds))
        return np.stack(flow((*x[:4], *rotors), tuple(u)))

    return Equations(
        advance,
        dt,
        p.input_limits,
        p.state_names,
        p.input_names,
        state_units=p.state_units,
        input_units=p.input_units,
        state_scale=[1.0] * 4 + [(high - low) / 2 for low, high in speeds],
    )


def predictor(model: Any) -> Predictor:
    """A `Predictor` as it is; one of a fitted `tras.KoopmanModel`.

    Raises
    ------
    ValueError
        If it is neither, is not fitted, or has no inputs.
    """
    if isinstance(model, KoopmanModel):
        model = Lifted(model) if model.predictor == "lifted_linear" else Identified(model)
    if not isinstance(model, Predictor):
        raise ValueError(
            f"model is {model!r}; give a fitted tras.KoopmanModel, or a tras.control.predictors.Predictor."
        )
    if not model.channels.input_names:
        raise ValueError("model has no inputs, so nothing can be controlled; fit a recording with inputs.")
    return model
