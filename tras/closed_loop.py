"""The simulated experiment: PID in the loop, torques held over each sample (paper, "Data collection").

The paper gives no gains. Ours place the poles of the double integrator ``J qddot = u`` at 4 rad/s with damping 0.9: documented,
fast against the excitation (0.2 and 0.8 rad/s), slow against the sampling time of 0.01 s.
"""

import math
from dataclasses import dataclass

import numpy as np

from tras.plant import STATE_NAMES, STATE_UNITS, TORQUE_NAMES, TORQUE_UNITS, PlantParameters, stepper, torque_limits
from tras.recording import Recording, versions

REFERENCE_NAMES = ("phi_ref", "psi_ref")
REFERENCE_UNITS = ("rad", "rad")
INPUTS = {"reference": REFERENCE_NAMES, "torque": TORQUE_NAMES}  # what a model may take for its inputs


@dataclass(frozen=True)
class PID:
    """Gains of one axis: ``u = P e + I integral(e) - D qdot`` with ``e = reference - q``, limited to ``limits``.

    The derivative acts on the measurement, so that a step of the reference gives no kick. The integral stops while the
    torque is at a limit and the error drives it further out (anti-windup by conditional integration; K. J. Astrom and
    T. Hagglund, *Advanced PID Control*, Sec. 3.5).

    Parameters
    ----------
    P, I, D : float
        N m/rad, N m/(rad s), N m s/rad.
    limits : (float, float)
        Lowest and highest torque in N m.

    Raises
    ------
    ValueError
        If a gain is not a finite number or the limits are not two finite torques in order.
    """

    P: float
    I: float  # noqa: E741 the field's own name
    D: float
    limits: tuple[float, float]

    def __post_init__(self):
        for name in "PID":
            gain = getattr(self, name)
            if isinstance(gain, bool) or not isinstance(gain, (int, float, np.number)) or not math.isfinite(gain):
                raise ValueError(f"{name} is {gain!r}; give a finite gain.")
        object.__setattr__(self, "limits", torque_limits("limits", self.limits))

    @classmethod
    def pole_placement(cls, inertia, limits, *, frequency=4.0, damping=0.9, integral_rate=1.0):
        """``P = J w^2``, ``D = 2 zeta w J``, ``I = P * integral_rate`` for an axis of the given inertia (kg m^2).

        ``frequency`` in rad/s, ``integral_rate`` in 1/s.
        """
        P = inertia * frequency**2
        return cls(P=P, I=P * integral_rate, D=2 * damping * frequency * inertia, limits=limits)

    @classmethod
    def defaults(cls, parameters):
        """The pair (pitch, yaw) of this project. Yaw's inertia is the one at level beam, ``J + J_psi0``."""
        return (
            cls.pole_placement(parameters.J_phi, parameters.u_phi_limits, integral_rate=1.0),
            cls.pole_placement(parameters.J + parameters.J_psi0, parameters.u_psi_limits, integral_rate=0.5),
        )


def simulate_closed_loop(reference, dt, parameters=None, *, controllers=None, x0=None, step=0.01, attributes=None):
    """Follow references with the PID and record everything.

    At each sample the controller reads state and reference, and its torque is held until the next. By default the rig
    starts at rest ON the first reference with the integrators balanced (a bumpless start: the operator settles the rig, then
    starts the recorder).

    Parameters
    ----------
    reference : (samples, 2) array_like
        Pitch and yaw reference in rad.
    dt : float
        Sampling time in s.
    parameters : PlantParameters, optional
    controllers : (PID, PID), optional
        Pitch and yaw; default `PID.defaults`.
    x0 : (4,) array_like, optional
        Initial state; then the integrators start empty.
    step : float
        Longest integration step in s.
    attributes : dict, optional
        Goes into the recording beside the plant's parameters, the gains and limits (seed, kind of excitation, ...).

    Returns
    -------
    Recording
        One trajectory of ``samples`` samples: states phi, phidot, psi, psidot; inputs phi_ref, psi_ref (rad) and u_phi, u_psi
        (N m), sample ``k`` of the torques acting from sample ``k`` to ``k + 1``.

    Raises
    ------
    ValueError
        On wrong shapes or values.
    """
    parameters = parameters or PlantParameters()
    reference = np.asarray(reference, dtype=float)
    if reference.ndim != 2 or reference.shape[1] != 2 or len(reference) < 2:
        raise ValueError(f"reference has shape {reference.shape}; give (samples, 2): pitch and yaw in rad, two samples or more.")
    if not np.isfinite(reference).all():
        raise ValueError("reference holds NaN or infinity; give finite angles in rad.")
    controllers = controllers or PID.defaults(parameters)
    states, torques = _loop(reference, dt, parameters, controllers, x0, step)
    return recorded([states], [np.hstack([reference, torques])], dt, parameters, controllers, step, attributes)


def recorded(states, inputs, dt, parameters, controllers, step, attributes):
    """A `Recording` of simulated loops with everything that made it in its attributes."""
    return Recording(
        states,
        inputs,
        dt,
        state_names=STATE_NAMES,
        input_names=REFERENCE_NAMES + TORQUE_NAMES,
        state_units=STATE_UNITS,
        input_units=REFERENCE_UNITS + TORQUE_UNITS,
        attributes={
            **{f"plant_{name}": value for name, value in parameters.as_dict().items()},
            **{f"pid_{axis}_{gain}": getattr(c, gain) for axis, c in zip(("phi", "psi"), controllers) for gain in "PID"},
            **{f"pid_{axis}_limits": list(c.limits) for axis, c in zip(("phi", "psi"), controllers)},
            **{f"version_{name}": version for name, version in versions().items()},
            "integration_step": step,
            **(attributes or {}),
        },
    )


def saturated(recording, parameters):
    """Share of samples with a torque at its limit, (pitch, yaw), as fractions.

    The limits are those of the controllers, which `simulate_closed_loop` records, else those of ``parameters``.
    """
    torques = np.concatenate(recording.select(inputs=TORQUE_NAMES).inputs)
    recorded = recording.attributes
    limits = np.array([recorded.get(f"pid_{axis}_limits", getattr(parameters, f"u_{axis}_limits")) for axis in ("phi", "psi")], dtype=float)
    return ((torques <= limits[:, 0]) | (torques >= limits[:, 1])).mean(axis=0)


def _loop(reference, dt, parameters, controllers, x0, step):
    """States (samples, 4) and torques (samples, 2) of the loop, on plain floats: the recursion cannot be vectorised."""
    pitch, yaw = controllers
    start = reference[0].tolist()
    if x0 is None:
        x = (start[0], 0.0, start[1], 0.0)
        gravity = parameters.G_c * math.cos(x[0]) + parameters.G_s * math.sin(x[0])
        integral_phi, integral_psi = _balance(pitch, gravity), _balance(yaw, parameters.K_psi * x[2])
    else:
        x0 = np.asarray(x0, dtype=float)
        if x0.shape != (4,) or not np.isfinite(x0).all():
            raise ValueError(f"x0 is {x0.tolist()}; give four finite numbers phi, phidot, psi, psidot.")
        x, integral_phi, integral_psi = tuple(x0.tolist()), 0.0, 0.0
    advance = stepper(parameters, dt, step=step)
    states, torques = [x], []
    for r_phi, r_psi in reference.tolist():
        phi, phidot, psi, psidot = x
        u_phi, integral_phi = _control(pitch, r_phi - phi, phidot, integral_phi, dt)
        u_psi, integral_psi = _control(yaw, r_psi - psi, psidot, integral_psi, dt)
        torques.append((u_phi, u_psi))
        x = advance(x, torques[-1])
        states.append(x)
    return np.array(states[:-1]), np.array(torques)


def _balance(controller, torque):
    """The integrator's value (N m) that holds ``torque`` at zero error, as far as the limits and the gain allow."""
    low, high = controller.limits
    return min(max(torque, low), high) if controller.I else 0.0


def _control(controller, error, rate, integral, dt):
    """Limited torque and the integrator's next value (both N m)."""
    wanted = controller.P * error + integral - controller.D * rate
    low, high = controller.limits
    torque = min(max(wanted, low), high)
    if torque == wanted or (wanted - torque) * error < 0:
        integral += controller.I * error * dt
    return torque, integral
