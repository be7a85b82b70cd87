"""The simulated experiment with motors: PID in cascade with the rotors' speeds, and a test signal on the commands.

A controller's output is a function of the states, so that a recording of it alone does not tell plant from controller.
A small test signal that is added to the commands makes them differ (L. Ljung, *System Identification*, 2nd ed., Sec.
13.4).
"""

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from tras.recording import Recording
from tras.twin_rotor import plant, rotors
from tras.twin_rotor.closed_loop import PID, REFERENCE_NAMES, REFERENCE_UNITS, clip_float, control_law
from tras.twin_rotor.curves import Curve
from tras.twin_rotor.rotor_parameters import GUST_NAMES, GUST_UNITS, RotorParameters
from tras.workflow import arguments
from tras.workflow.provenance import versions

FREQUENCY = 2.0  # rad/s: poles of the angles' PID, slow against the rotors under their own loops


def simulate_motor_loop(
    reference: ArrayLike,
    dt: float,
    parameters: RotorParameters,
    *,
    test_signal: ArrayLike | None = None,
    gusts: ArrayLike | None = None,
    controllers: Sequence[PID] | None = None,
    speed_gain: float = 3.0,
    x0: ArrayLike | None = None,
    step: float = 0.01,
    attributes: dict | None = None,
) -> Recording:
    """Follow references with motor commands and record everything.

    A PID per angle demands a torque; the static thrust gives the speed for it and the static curve the command for that
    speed; a proportional loop makes the rotor follow. The test signal is added and the sum limited to [-1, 1].

    Parameters
    ----------
    reference : (samples, 2) or (runs, samples, 2) array_like
        Pitch and yaw in rad; many runs take each step together.
    dt : float
        Sampling time in s.
    parameters : RotorParameters
    test_signal : array_like, optional
        Added to the commands; as many samples as ``reference``.
    gusts : array_like, optional
        Torques in N m from outside, for example of `tras.gusts`; recorded as inputs.
    controllers : (PID, PID), optional
        Pitch and yaw; default `PID.defaults` with poles at 2 rad/s.
    speed_gain : float
        Gain of the rotors' loops, in full commands per whole range of speeds.
    x0 : (6,) or (runs, 6) array_like, optional
        Initial states; default the rest under commands of 0. The integrators start empty.
    step : float
        Longest integration step in s.
    attributes : dict, optional
        Goes into the recording beside the parameters.

    Returns
    -------
    Recording
        States phi, phidot, psi, psidot, omega_m, omega_t; inputs u_m, u_t, with gusts gust_phi and gust_psi, and
        phi_ref, psi_ref. Sample ``k`` of the commands acts from sample ``k`` to ``k + 1``.

    Raises
    ------
    ValueError
        On wrong shapes or values.

    Examples
    --------
    >>> import tras
    >>> rig = tras.RotorParameters.maker()
    >>> reference = tras.multisine(20, 0.01, [1.0, 1.0], [0.2, 0.5], 0)
    >>> test = tras.multisine(20, 0.01, [20.0, 20.0], [0.1, 0.1], 1)
    >>> log = tras.simulate_motor_loop(reference, 0.01, rig, test_signal=test)
    >>> log.states.shape, log.input_names
    ((1, 2001, 6), ('u_m', 'u_t', 'phi_ref', 'psi_ref'))
    """
    reference = plant.as_array("reference", reference, 2)
    if reference.ndim not in (2, 3) or reference.shape[-2] < 2:
        raise ValueError(f"reference has shape {reference.shape}; give (samples, 2) or (runs, samples, 2).")
    batch = reference.shape[:-2]
    test = np.zeros(reference.shape) if test_signal is None else _as_long("test_signal", test_signal, reference.shape)
    outside = np.empty((*reference.shape[:-1], 0)) if gusts is None else _as_long("gusts", gusts, reference.shape)
    arguments.number("speed_gain", speed_gain, 0, give="a gain, 0 or more")
    controllers = controllers or PID.defaults(parameters.loaded, frequency=FREQUENCY)
    start = np.broadcast_to(rotors.rest_point(parameters) if x0 is None else plant.as_array("x0", x0, 6), (*batch, 6))
    states, commands = _loop(parameters, dt, controllers, speed_gain, step, start, reference, test, outside)
    inputs = np.concatenate([commands, outside, reference], axis=-1)
    gust_names, gust_units = (GUST_NAMES, GUST_UNITS) if outside.shape[-1] else ((), ())
    return Recording(
        states if states.ndim == 3 else states[None],
        inputs if states.ndim == 3 else inputs[None],
        dt,
        state_names=parameters.state_names,
        state_units=parameters.state_units,
        input_names=parameters.input_names + gust_names + REFERENCE_NAMES,
        input_units=parameters.input_units + gust_units + REFERENCE_UNITS,
        attributes={
            **{f"plant_{name}": value for name, value in parameters.as_dict().items()},
            **{f"version_{name}": version for name, version in versions().items()},
            "speed_gain": speed_gain,
            "integration_step": step,
            **(attributes or {}),
        },
    )


def _as_long(name, values, shape):
    """``values`` as an array of that shape, one run for all or one per run."""
    array = plant.as_array(name, values, 2)
    try:
        return np.broadcast_to(array, shape)
    except ValueError:
        raise ValueError(f"{name} has shape {array.shape} but reference {shape}; give as many samples.") from None


def _loop(parameters, dt, controllers, speed_gain, step, start, *signals):
    """States and commands under reference, test signal and gusts (..., samples, 2).

    A single run takes plain floats, many take arrays and make each step together.
    """
    batch, gusts = start.shape[:-1], signals[-1].shape[-1] > 0
    functions, clip, number = (np, np.clip, np.asarray) if batch else (math, clip_float, float)
    advance = rotors.stepper(parameters, dt, step=step, functions=functions, gusts=gusts)
    pitch, yaw = (control_law(pid, dt, clip) for pid in controllers)
    curves = (parameters.thrust_m, parameters.hold_m), (parameters.thrust_t, parameters.hold_t)
    main, tail = (_motor(*pair, ends, speed_gain, number) for pair, ends in zip(curves, parameters.speed_limits))
    x, *signals = np.moveaxis(start, -1, 0), *(np.moveaxis(signal, (-2, -1), (0, 1)) for signal in signals)
    if not batch:
        x, *signals = x.tolist(), *(signal.tolist() for signal in signals)
    integral_phi = integral_psi = 0.0
    states, commands, held = [], [], None
    with np.errstate(over="ignore", invalid="ignore"):  # `advance` raises
        for (r_phi, r_psi), (test_m, test_t), outside in zip(*signals):
            if held is not None:
                x = advance(x, held)
            phi, phidot, psi, psidot, omega_m, omega_t = x
            torque_phi, integral_phi = pitch(r_phi - phi, phidot, integral_phi)
            torque_psi, integral_psi = yaw(r_psi - psi, psidot, integral_psi)
            u_m = clip(main(torque_phi, omega_m) + test_m, -1.0, 1.0)
            u_t = clip(tail(torque_psi, omega_t) + test_t, -1.0, 1.0)
            states.append(x)
            commands.append((u_m, u_t))
            held = (u_m, u_t, *outside)
    return tuple(np.moveaxis(np.array(values), (0, 1), (-2, -1)) for values in (states, commands))


def _motor(thrust: Curve, hold: Curve, ends, gain, number) -> Callable:
    """``(torque, speed) -> command``: what holds the speed of that thrust, and ``gain`` times the way there."""
    speeds = np.linspace(ends[0], ends[1], 401)
    torques = np.maximum.accumulate(thrust(speeds))
    gain = gain / (ends[1] - ends[0])

    def command(torque, speed):
        wanted = number(np.interp(torque, torques, speeds))
        return hold(wanted) + gain * (wanted - speed)

    return command
