"""The larger twin rotor: speeds of both rotors as states, motor commands as inputs (paper, "future work").

The state is ``x = [phi, phidot, psi, psidot, omega_m, omega_t]``: pitch, yaw, their rates, and the speeds of the main
and the tail rotor in rad/s. The inputs are the commands ``[u_m, u_t]`` of the two motors, in [-1, 1], and torques of
gusts in N m where there are any. Rotors follow their commands with a lag, their thrusts are the torques of
`tras.twin_rotor.plant`, and the body is that plant: it is the limit of this one for fast rotors.
"""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from tras.twin_rotor import plant
from tras.twin_rotor.curves import beyond, clipped
from tras.twin_rotor.rotor_parameters import STATE_NAMES, RotorParameters
from tras.workflow import arguments

CREEP = 0.02  # rad/s: below this rate dry friction falls to zero, so that the equations stay an ODE
STRIBECK = 0.1  # rad/s: above this rate the torque of breaking away is gone
_CROSSING = 0.02  # s: in which the rig's rates pass the range of CREEP
_OF_A_TIME_CONSTANT = 0.1  # the longest step as a fraction of the shortest time constant of rotors and dry friction


def equations_of_motion(parameters: RotorParameters, functions=np) -> Callable:
    """Accelerations of the body and of the rotors as a function of scalars or arrays.

    Parameters
    ----------
    parameters : RotorParameters
    functions : module
        Has ``sin``, ``cos``, ``tanh`` and ``exp`` for the arguments: ``math``, ``numpy`` or ``sympy``.

    Returns
    -------
    callable
        ``(phi, phidot, psi, psidot, omega_m, omega_t, u_m, u_t, gust_phi=0, gust_psi=0)`` in rad, rad/s, commands and
        N m ``-> (phiddot, psiddot, d omega_m/dt, d omega_t/dt)`` in rad/s^2.
    """
    body, acting = plant.equations_of_motion(parameters.loaded, functions), _torques(parameters, functions)
    side, (stiffness, slack) = parameters.spring_side, parameters.cable

    def rates(phi, phidot, psi, psidot, omega_m, omega_t, u_m, u_t, gust_phi=0.0, gust_psi=0.0):
        u_phi, u_psi, spin_m, spin_t = acting(phi, phidot, psidot, omega_m, omega_t, u_m, u_t, gust_phi, gust_psi)
        if side:
            u_psi = u_psi - side * abs(psi)
        if stiffness:
            u_psi = u_psi - stiffness * beyond(psi, slack)
        return (*body(phi, phidot, psi, psidot, u_phi, u_psi), spin_m, spin_t)

    return rates


def torques(x: ArrayLike, u: ArrayLike, parameters: RotorParameters) -> np.ndarray:
    """Torques (..., 2) about pitch and yaw in N m that act on the body in states (..., 6) under inputs (..., 2 or 4).

    Thrusts, reactions, dry friction, gusts; not gravity, springs and viscous friction, which belong to the body. They
    are the inputs of the four-state plant.

    Examples
    --------
    >>> torques([0, 0, 0, 0, 200, 0], [0.3, 0], RotorParameters.maker()).round(4)
    array([ 0.0512, -0.0034])
    """
    phi, phidot, _, psidot, *speeds, inputs = _split(x, u)
    u_phi, u_psi, *_ = _torques(parameters, np)(phi, phidot, psidot, *speeds, *inputs)
    return np.stack(np.broadcast_arrays(u_phi, u_psi), axis=-1)


def _torques(parameters, functions):
    """``(phi, phidot, psidot, omega_m, omega_t, u_m, u_t, gusts) -> (u_phi, u_psi, d omega_m/dt, d omega_t/dt)``."""
    p = parameters
    sin, cos, tanh, exp = functions.sin, functions.cos, functions.tanh, functions.exp
    thrust_m, thrust_t, hold_m, hold_t, I_m, I_t = p.thrust_m, p.thrust_t, p.hold_m, p.hold_t, p.I_m, p.I_t
    reaction_phi, reaction_psi, momentum, inflow = p.reaction_phi, p.reaction_psi, p.momentum, p.inflow
    twist, twist_rest, twists = p.twist, p.twist_rest, any(p.twist.polynomial + p.twist.sided)
    body, printed = p.loaded, p.J_printed
    motors, dry = _motors(parameters), any(p.coulomb + p.stiction)

    def friction(rate, coulomb, stiction):
        return tanh(rate / CREEP) * (coulomb + stiction * exp(-rate * rate / STRIBECK**2))

    def acting(phi, phidot, psidot, omega_m, omega_t, u_m, u_t, gust_phi=0.0, gust_psi=0.0):
        c = cos(phi)
        u_m, u_t = motors(u_m, u_t)
        spin_m, spin_t = (u_m - hold_m(omega_m)) / I_m, (u_t - hold_t(omega_t)) / I_t
        u_phi = thrust_m(omega_m) * (1 + inflow * psidot * c) + reaction_phi * u_t + gust_phi
        u_psi = (thrust_t(omega_t) + reaction_psi * u_m) * c + gust_psi
        if momentum:
            u_psi = u_psi + momentum * (spin_m * c - omega_m * sin(phi) * phidot)
        if twists:
            u_psi = u_psi + twist(phi - twist_rest)
        if printed is not None:  # another centrifugal inertia; the rotor's momentum turns where the body's should
            s = sin(phi)
            u_phi = u_phi + (body.J - printed) * psidot * psidot * s * c
            turning = momentum * omega_m * c / (body.J * c * c + body.J_psi0) - psidot
            u_psi = u_psi + 2 * body.J * s * c * phidot * turning
        if dry:
            u_phi = u_phi - friction(phidot, p.coulomb[0], p.stiction[0])
            u_psi = u_psi - friction(psidot, p.coulomb[1], p.stiction[1])
        return u_phi, u_psi, spin_m, spin_t

    return acting


def _motors(parameters):
    """``(u_m, u_t) -> (u_m, u_t)``: the commands that arrive, after limits, dead zones and the supply."""
    limits, zones, sag = parameters.saturation, parameters.dead_zone, parameters.sag

    def motors(u_m, u_t):
        if limits:
            u_m, u_t = clipped(u_m, limits[0]), clipped(u_t, limits[1])
        if zones[0]:
            u_m = beyond(u_m, zones[0])
        if zones[1]:
            u_t = beyond(u_t, zones[1])
        if sag:
            supply = 1 - sag * (abs(u_m) + abs(u_t)) / 2
            u_m, u_t = supply * u_m, supply * u_t
        return u_m, u_t

    return motors


def vector_field(x: ArrayLike, u: ArrayLike, parameters: RotorParameters) -> np.ndarray:
    """``dx/dt = F(x, u)``: states (..., 6) and inputs (..., 2), or (..., 4) with gusts in N m -> (..., 6).

    Raises
    ------
    ValueError
        If the last axis of ``x`` is not 6 or that of ``u`` neither 2 nor 4.

    Examples
    --------
    >>> rig = RotorParameters.rotondo()
    >>> bool(abs(vector_field(rest_point(rig, (0.5, 0.2)), (0.5, 0.2), rig)).max() < 1e-9)
    True
    """
    phi, phidot, psi, psidot, *speeds, inputs = _split(x, u)
    phiddot, psiddot, *spins = equations_of_motion(parameters)(phi, phidot, psi, psidot, *speeds, *inputs)
    return np.stack(np.broadcast_arrays(phidot, phiddot, psidot, psiddot, *spins), axis=-1)


def jacobian(x: ArrayLike, u: ArrayLike, parameters: RotorParameters) -> tuple[np.ndarray, np.ndarray]:
    """Linearisation at (x, u): ``A = dF/dx`` (..., 6, 6) and ``B = dF/du`` (..., 6, 2), or (..., 6, 4) with gusts.

    At a kink (a rotor at rest, a command at the edge of its dead zone) it is that of one side.

    Examples
    --------
    >>> rig = RotorParameters.maker()
    >>> A, B = jacobian(rest_point(rig), [0, 0], rig)
    >>> A.shape, B.shape
    ((6, 6), (6, 2))
    """
    p, body = parameters, parameters.loaded
    phi, phidot, psi, psidot, omega_m, omega_t, inputs = _split(x, u)
    given_m, given_t = inputs[:2]
    u_m, u_t = _motors(p)(given_m, given_t)
    acting = torques(x, u, p)
    side, (stiffness, slack) = p.spring_side, p.cable
    springs = side * np.abs(psi) + stiffness * beyond(psi, slack)
    on_body = np.stack(np.broadcast_arrays(acting[..., 0], acting[..., 1] - springs), axis=-1)
    A4, B4 = plant.jacobian(plant.as_array("x", x, 6)[..., :4], on_body, body)

    s, c = np.sin(phi), np.cos(phi)
    T, slope_m = p.thrust_m(omega_m), p.thrust_m.slope(omega_m)
    spin_m, lag_m = (u_m - p.hold_m(omega_m)) / p.I_m, p.hold_m.slope(omega_m) / p.I_m
    shape = B4.shape[:-2]
    D = np.zeros((*shape, 2, 6))  # slopes of the torques on the body with respect to the state
    D[..., 0, 0], D[..., 0, 3] = -T * p.inflow * psidot * s, T * p.inflow * c
    D[..., 0, 4] = slope_m * (1 + p.inflow * psidot * c)
    twist = p.twist.slope(phi - p.twist_rest)
    turned = p.momentum * (spin_m * s + omega_m * c * phidot)
    D[..., 1, 0] = twist - (p.thrust_t(omega_t) + p.reaction_psi * u_m) * s - turned
    D[..., 1, 1] = -p.momentum * omega_m * s
    D[..., 1, 2] = -side * np.sign(psi) - stiffness * (np.abs(psi) > slack)
    D[..., 1, 4], D[..., 1, 5] = -p.momentum * (lag_m * c + s * phidot), p.thrust_t.slope(omega_t) * c
    for row, rate in ((0, phidot), (1, psidot)):
        coulomb, stiction = p.coulomb[row], p.stiction[row]
        fading = stiction * np.exp(-rate * rate / STRIBECK**2)
        rising = (1 - np.tanh(rate / CREEP) ** 2) / CREEP * (coulomb + fading)
        D[..., row, 2 * row + 1] -= rising - 2 * rate / STRIBECK**2 * np.tanh(rate / CREEP) * fading
    if p.J_printed is not None:
        s2, c2, J_psi = 2 * s * c, c * c - s * s, body.J * c * c + body.J_psi0
        turning = p.momentum * omega_m * c / J_psi - psidot
        D[..., 0, 0] += (body.J - p.J_printed) * psidot**2 * c2
        D[..., 0, 3] += (body.J - p.J_printed) * psidot * s2
        drift = p.momentum * omega_m * (-s / J_psi + c * body.J * s2 / J_psi**2)  # slope of `turning` in phi
        D[..., 1, 0] += body.J * phidot * (2 * c2 * turning + s2 * drift)
        D[..., 1, 1] += body.J * s2 * turning
        D[..., 1, 3] -= body.J * s2 * phidot
        D[..., 1, 4] += body.J * s2 * phidot * p.momentum * c / J_psi
    A = np.zeros((*shape, 6, 6))
    A[..., :4, :4] = A4
    A[..., :4, :] += B4 @ D
    A[..., 4, 4], A[..., 5, 5] = -lag_m, -p.hold_t.slope(omega_t) / p.I_t

    arriving = _motor_slopes(p, given_m, given_t, shape)
    E = np.zeros((*shape, 2, 2))  # of the torques with respect to the commands that arrive
    E[..., 0, 1], E[..., 1, 0] = p.reaction_phi, (p.reaction_psi + p.momentum / p.I_m) * c
    B = np.zeros((*shape, 6, len(inputs)))
    B[..., :4, :2] = B4 @ E @ arriving
    B[..., 4:, :2] = arriving / np.array([[p.I_m], [p.I_t]])
    B[..., :4, 2:] = B4[..., : len(inputs) - 2]
    return A, B


def _motor_slopes(parameters, u_m, u_t, shape):
    """Slopes (..., 2, 2) of the commands that arrive with respect to those that are given."""
    u = np.stack(np.broadcast_arrays(u_m, u_t), axis=-1) * np.ones((*shape, 1))
    inside = np.ones_like(u)
    if parameters.saturation:
        inside *= np.abs(u) < parameters.saturation
        u = clipped(u, np.array(parameters.saturation))
    inside *= np.abs(u) >= parameters.dead_zone
    u = np.where(np.array(parameters.dead_zone) > 0, beyond(u, np.array(parameters.dead_zone)), u)
    supply = 1 - parameters.sag * np.abs(u).sum(axis=-1) / 2
    slopes = supply[..., None, None] * np.eye(2) - parameters.sag / 2 * u[..., :, None] * np.sign(u)[..., None, :]
    return slopes * inside[..., None, :]


def rest_point(parameters: RotorParameters, commands: ArrayLike = (0.0, 0.0)) -> np.ndarray:
    """The stable rest state (6,) under constant commands.

    Raises
    ------
    ValueError
        If gravity cannot balance the main thrust, or nothing holds yaw against a torque.

    Examples
    --------
    >>> rest_point(RotorParameters.maker(), (0.3, 0.1)).round(3)
    array([3.30000e-02, 0.00000e+00, 7.20000e-02, 0.00000e+00, 2.02563e+02,
           1.01374e+02])
    """
    from scipy.optimize import brentq

    commands = _commands(plant.as_array("commands", commands, 2), parameters)
    u_m, u_t = _motors(parameters)(*commands.tolist())
    speeds = parameters.hold_m.speed(u_m), parameters.hold_t.speed(u_t)
    body, side, (stiffness, slack) = parameters.loaded, parameters.spring_side, parameters.cable
    still = [0.0, 0.0, 0.0, 0.0, *speeds]
    u_phi = float(torques(still, commands, parameters)[0])
    still[0] = phi = float(plant.rest_point(body, (u_phi, 0.0))[0])
    u_psi = float(torques(still, commands, parameters)[1])

    def missing(psi):
        return body.K_psi * psi + side * abs(psi) + stiffness * beyond(psi, slack) - u_psi

    if body.K_psi == 0 and stiffness == 0 and abs(u_psi) > 1e-15:
        raise ValueError(f"yaw has a torque of {u_psi:.6g} N m and neither spring nor cable; it keeps turning.")
    weakest = body.K_psi - abs(side) or stiffness
    far = 2 * (abs(u_psi) / weakest + slack) if weakest else 0.0
    psi = brentq(missing, -far, far, xtol=1e-15) if far and missing(0.0) else 0.0
    return np.array([phi, 0.0, psi, 0.0, *speeds])


def stepper(parameters: RotorParameters, dt: float, *, step: float = 0.01, functions=math, gusts=False) -> Callable:
    """The flow over one sample as ``advance(x, u) -> x``; two inputs, or four with ``gusts``, are held.

    The method is that of `tras.twin_rotor.plant.stepper`. The longest step also is a tenth of the shortest time
    constant of rotors and dry friction. The error over 6 s is about 1e-10 rad and rad/s of the body, 1e-7 with dry
    friction and where the equations have a kink that is often passed (a rotor that reverses, a cable that tightens).
    """
    p = parameters
    constants = [
        1 / float(curve.slope(np.linspace(*limits, 1001)).max()) * inertia
        for curve, limits, inertia in zip((p.hold_m, p.hold_t), p.speed_limits, (p.I_m, p.I_t))
    ]
    for coulomb, stiction, inertia in zip(p.coulomb, p.stiction, (p.loaded.J_phi, p.loaded.J + p.loaded.J_psi0)):
        if coulomb + stiction:
            constants += [inertia * CREEP / (coulomb + stiction), _CROSSING]
    arguments.number("step", step, 0, ends=False, give="a positive time in s")
    step = min(step, _OF_A_TIME_CONSTANT * min(constants))
    rates = equations_of_motion(p, functions)
    return plant.flow(rates, dt, step=step, functions=functions, others=2, inputs=4 if gusts else 2)


def simulate_rotors(
    x0: ArrayLike,
    commands: ArrayLike,
    dt: float,
    parameters: RotorParameters,
    *,
    gusts: ArrayLike | None = None,
    step: float = 0.01,
) -> np.ndarray:
    """States at the sampling instants under motor commands and gusts that are held from one sample to the next.

    Parameters
    ----------
    x0 : (..., 6) array_like
        Initial states in rad and rad/s; leading axes run many simulations at once.
    commands : (..., samples, 2) array_like
        Commands of the main and the tail motor, in [-1, 1] unless the motors saturate. The last one has no effect.
    dt : float
        Sampling time in s.
    parameters : RotorParameters
    gusts : (..., samples, 2) array_like, optional
        Torques in N m about pitch and yaw from outside, for example of `tras.gusts`.
    step : float
        Longest integration step in s; see `stepper`.

    Returns
    -------
    (..., samples, 6) ndarray

    Raises
    ------
    ValueError
        On wrong shapes, values that are not finite, commands or rotor speeds out of range, a ``dt`` or ``step`` that is
        not positive, or a rig that gets faster than 1000 rad/s.

    Examples
    --------
    >>> import numpy as np
    >>> rig = RotorParameters.maker()
    >>> simulate_rotors(rest_point(rig), np.full((601, 2), 0.2), 0.01, rig).shape
    (601, 6)
    """
    x0, inputs = plant.as_array("x0", x0, 6), _commands(plant.as_array("commands", commands, 2), parameters)
    if inputs.ndim < 2 or inputs.shape[-2] == 0:
        raise ValueError(f"commands has shape {inputs.shape}; give (samples, 2) with at least one sample.")
    for name, speeds, (low, high) in zip(STATE_NAMES[4:], np.moveaxis(x0[..., 4:], -1, 0), parameters.speed_limits):
        if not np.all((low <= speeds) & (speeds <= high)):
            raise ValueError(f"x0 has {name} outside {low:.6g} to {high:.6g} rad/s, the range of full commands.")
    if gusts is not None:
        gusts = plant.as_array("gusts", gusts, 2)
        if gusts.ndim < 2 or gusts.shape[-2] != inputs.shape[-2]:
            raise ValueError(f"gusts has shape {gusts.shape}; give (samples, 2) with {inputs.shape[-2]} samples.")
        inputs = np.concatenate(np.broadcast_arrays(inputs, gusts), axis=-1)
    batch = np.broadcast_shapes(x0.shape[:-1], inputs.shape[:-2])
    advance = stepper(parameters, dt, step=step, functions=np if batch else math, gusts=gusts is not None)
    return plant.rolled(
        advance, np.broadcast_to(x0, (*batch, 6)), np.broadcast_to(inputs, (*batch, *inputs.shape[-2:]))
    )


def _commands(commands, parameters):
    if parameters.saturation is None and not np.all(np.abs(commands) <= 1):
        raise ValueError(
            f"commands reach {np.abs(commands).max():.6g}; give commands in [-1, 1], or motors with a saturation."
        )
    return commands


def _split(x, u):
    """The six states, and the list of inputs."""
    u = np.asarray(u, dtype=float)
    width = 4 if u.ndim and u.shape[-1] == 4 else 2
    return *np.moveaxis(plant.as_array("x", x, 6), -1, 0), list(np.moveaxis(plant.as_array("u", u, width), -1, 0))
