"""A model as a linear system about a point, for control: `tras.KoopmanModel.linearize`."""

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from tras.predictors import PREDICTORS

if TYPE_CHECKING:
    from tras.model import KoopmanModel


class StateSpace(NamedTuple):
    """``z[k+1] = A z[k] + B u[k]``, ``x[k] = C z[k] + D u[k]``, sampled every ``dt`` seconds: without control."""

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    dt: float


def linearize(model: "KoopmanModel", x: ArrayLike | None = None, u: ArrayLike | None = None) -> Any:
    """See `tras.KoopmanModel.linearize`."""
    system = matrices(model, x, u)
    lifted = model.predictor == "lifted_linear"
    names = [f"z{i + 1}" for i in range(len(system.A))] if lifted else model.channels_.z_names
    return _named(model, system, names)


def matrices(model: "KoopmanModel", x: ArrayLike | None = None, u: ArrayLike | None = None) -> StateSpace:
    """The matrices of `linearize`, without python-control."""
    model.require_fitted()
    lead, dt = model.channels_.lead, float(model.dt_)
    if model.predictor == "lifted_linear":
        return acting(lead, *_of_lifting(model), dt)
    channels = model.channels_
    x, u = _point(model, x, u)
    z, v = channels.points(x, u)
    with np.errstate(over="ignore", invalid="ignore"):
        slopes = PREDICTORS[model.predictor].advance_with_slopes(model)(z[:, None], v[:, None])[1][0]
    if not np.isfinite(slopes).all():
        raise ValueError("the model's prediction from this point runs away; give x and u in the range of its data.")
    count, n = len(z), len(channels.state_names)
    A = slopes[:, :count] * channels.z_scale[:, None] / channels.z_scale
    B = slopes[:, count:] * channels.z_scale[:, None] / channels.u_scale
    return acting(lead, A, B, np.eye(n, count), dt)


def acting(lead: int, A: np.ndarray, B: np.ndarray, C: np.ndarray, dt: float) -> StateSpace:
    """``z[k+1] = A z[k] + B u[k + lead]``, ``x = C z`` as a system of the input u[k].

    With a lead the state is ``z[k] - B u[k]``: what the input of the same instant has not moved yet. So D is ``C B``.
    """
    return StateSpace(A, A @ B, C, C @ B, dt) if lead else StateSpace(A, B, C, np.zeros((len(C), B.shape[1])), dt)


def _of_lifting(model):
    """``lifted_linear`` is linear in its liftings everywhere; without the constant, which no deviation has."""
    scale, n = model.u_scale_, len(model.state_names_)
    A, B = model.koopman_matrix.T[1:, 1:].copy(), model.B_[1:] / scale
    C = np.zeros((n, len(A)))
    C[np.arange(n), model.dictionary_.coordinates[:n] - 1] = model.x_scale_
    return A, B, C


def _named(model, system, states):
    """The system with names of signals, for python-control; ``states`` are those of its states."""
    n = len(system.C)
    signals = [name.replace(".", "_") for name in (*model.state_names_, *model.input_names_)]  # it allows no dot
    outputs, inputs = signals[:n], signals[n:]
    if len(set(signals)) < len(signals):
        outputs, inputs = [f"x{i + 1}" for i in range(n)], [f"u{i + 1}" for i in range(len(inputs))]
    states = [name.replace(".", "_") for name in states]
    if len(set(states)) < len(states) or model.channels_.lead:  # with a lead they are no channels
        states = [f"z{i + 1}" for i in range(len(states))]
    return for_control(system, inputs=inputs, outputs=outputs, states=states, name="linearized")


def for_control(system: StateSpace, **labels) -> Any:
    """The matrices as a system of python-control with these labels; as they are without it, or without inputs."""
    if not system.B.shape[1]:  # python-control has no such systems
        return system
    try:
        import control
    except ImportError:
        return system
    return control.ss(*system, **labels)


def _point(model, x, u):
    """State with its delayed samples, and input, in physical units; a state alone has been there before, too."""
    channels = model.channels_
    n, m, count = len(channels.state_names), len(channels.input_names), len(channels.z_names)
    x = np.asarray(model.x_offset_ if x is None else x, dtype=float)
    u = np.asarray(model.u_offset_ if u is None else u, dtype=float)
    if u.shape != (m,):
        raise ValueError(f"u has shape {u.shape}; give ({m},): {', '.join(channels.input_names) or 'no inputs'}.")
    if x.shape == (n,) and count > n:
        past = np.tile(u, model.delays * channels.delayed_inputs)
        x = np.concatenate([np.tile(x, model.delays + 1), past])
    if x.shape != (count,):
        both = f"({n},) or ({count},)" if count > n else f"({n},)"
        raise ValueError(f"x has shape {x.shape}; give {both}: {', '.join(channels.z_names)}.")
    if not (np.isfinite(x).all() and np.isfinite(u).all()):
        raise ValueError("x or u holds NaN or infinity; give a point in the range of the data.")
    return x, u
