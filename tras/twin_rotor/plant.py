"""The twin rotor: parameters, equations of motion, energy, linearisation, rest point, simulation (paper, Sec. II).

``phi`` is pitch (elevation), ``psi`` is yaw (azimuth). The state is ``x = [phi, phidot, psi, psidot]`` in rad and
rad/s, the input is the pair of torques ``u = [u_phi, u_psi]`` in N m. The equations are the paper's with its
misprints repaired; ``docs/paper.md`` lists every repair with its reason.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from tras.twin_rotor.integrator import butcher
from tras.workflow import arguments

STATE_NAMES = ("phi", "phidot", "psi", "psidot")
STATE_UNITS = ("rad", "rad/s", "rad", "rad/s")
STATE_PAIRS = (("phi", "phidot"), ("psi", "psidot"))  # an angle and its rate
TORQUE_NAMES = ("u_phi", "u_psi")
TORQUE_UNITS = ("N m", "N m")
LUMPED = ("J", "J_psi0", "J_phi", "G_c", "G_s", "C_phi", "C_psi", "K_psi")

# The longest step is _STEP seconds at _SPEED rad/s and falls as speed**-_POWER, where speed is what the rig could
# reach in _AHEAD seconds. This is the cheapest rule that keeps errors below 1e-9, measured on random runs of 6 s up
# to 31 rad/s and 540 rad/s^2. In ordinary runs 4 % of the samples take a second step.
_STEP, _SPEED, _POWER, _AHEAD = 0.01, 1.5, 1.2, 0.1
_FASTEST = 1e3  # rad/s: no rig is faster, and the steps would never end


@dataclass(frozen=True)
class PlantParameters:
    """The eight lumped parameters of the twin rotor, SI units, and the torque limits. Default: the set TRAS-A.

    Motion identifies these eight numbers, not the single masses and lengths. Seven come from a public TRAS model;
    ``K_psi`` is an estimate from a rig's record and good to a factor of two (``docs/paper.md``).

    Parameters
    ----------
    J, J_psi0, J_phi : float
        Inertias in kg m^2: ``J_psi(phi) = J cos^2 phi + J_psi0`` about the yaw axis, ``J_phi`` about the pitch axis.
    G_c, G_s : float
        Gravity torque ``G_c cos phi + G_s sin phi`` in N m.
    C_phi, C_psi : float
        Viscous friction in N m s/rad.
    K_psi : float
        Stiffness of the cable about the yaw axis in N m/rad.
    u_phi_limits, u_psi_limits : (float, float)
        Lowest and highest torque in N m (thrust range times arm).

    Raises
    ------
    ValueError
        If a value is not finite, an inertia not positive, a friction or stiffness negative, or limits are reversed.

    Examples
    --------
    >>> round(float(rest_point(PlantParameters())[0]), 3)
    -0.491
    """

    J: float = 0.0237903793335
    J_psi0: float = 0.0030096206665
    J_phi: float = 0.0300580807997
    G_c: float = 0.05005756
    G_s: float = 0.09360078
    C_phi: float = 0.0127095
    C_psi: float = 0.00588996198
    K_psi: float = 0.003
    u_phi_limits: tuple[float, float] = (-0.144, 0.207)
    u_psi_limits: tuple[float, float] = (-0.241, 0.140)

    # No field: it belongs to the class, `PrintedPlant` has another.
    velocity_term: ClassVar[str] = "corrected"
    # What a controller or a recording needs to know of a plant, beside its equations.
    state_names: ClassVar[tuple[str, ...]] = STATE_NAMES
    state_units: ClassVar[tuple[str, ...]] = STATE_UNITS
    input_names: ClassVar[tuple[str, ...]] = TORQUE_NAMES
    input_units: ClassVar[tuple[str, ...]] = TORQUE_UNITS

    def __post_init__(self):
        for name in LUMPED:
            value = getattr(self, name)
            arguments.number(name, value, give="a finite number in SI units")
            if name[0] in "CK" and value < 0:
                raise ValueError(f"{name} is {value}; friction and stiffness cannot be negative.")
        for name, value in (("J_phi", self.J_phi), ("J_psi0", self.J_psi0), ("J + J_psi0", self.J + self.J_psi0)):
            if value <= 0:
                raise ValueError(f"{name} is {value}; an inertia must be positive.")
        for name in ("u_phi_limits", "u_psi_limits"):
            object.__setattr__(self, name, torque_limits(name, getattr(self, name)))

    @property
    def input_limits(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Lowest and highest torque in N m about pitch and yaw."""
        return self.u_phi_limits, self.u_psi_limits

    @classmethod
    def from_masses(
        cls, *, m_m: float, m_t: float, m_cw: float, l_m: float, l_t: float, l_cw: float, J_x: float, J_z: float,
        C_phi: float, C_psi: float, K_psi: float, g: float = 9.81, **limits: tuple[float, float],
    ) -> "PlantParameters":  # fmt: skip
        """Lump masses (kg), lengths (m) and the remaining inertias ``J_x``, ``J_z`` (kg m^2) as in the paper's Sec. II.

        ``m_cw`` is the mass of ONE of the two counterweights. The paper prints ``2 m_cw l_cw`` in the inertias; the
        units require the square of the length, used here.
        """
        beam = m_m * l_m**2 + m_t * l_t**2
        levers = 2 * m_cw * l_cw**2
        inertias = beam - levers, levers + J_z, beam + levers + J_x  # J, J_psi0, J_phi
        gravity = g * (m_m * l_m - m_t * l_t), 2 * g * m_cw * l_cw  # G_c, G_s
        return cls(*inertias, *gravity, C_phi, C_psi, K_psi, **limits)

    def masses(
        self, *, l_m: float = 0.202, l_t: float = 0.216, l_cw: float = 0.25, g: float = 9.81
    ) -> dict[str, float]:
        """Arguments of `from_masses` that lump into these parameters, for three lengths in m: a dict."""
        m_cw = self.G_s / (2 * g * l_cw)
        levers = 2 * m_cw * l_cw**2
        m_m, m_t = np.linalg.solve([[l_m**2, l_t**2], [l_m, -l_t]], [self.J + levers, self.G_c / g]).tolist()
        J_x, J_z = self.J_phi - self.J - 2 * levers, self.J_psi0 - levers
        lengths = {"l_m": l_m, "l_t": l_t, "l_cw": l_cw}
        return {"m_m": m_m, "m_t": m_t, "m_cw": m_cw, **lengths, "J_x": J_x, "J_z": J_z, "g": g}

    def energy(self, x: ArrayLike) -> np.ndarray:
        """Kinetic plus potential energy in J of states ``x`` (..., 4) -> (...).

        ``d(energy)/dt = u_phi phidot + u_psi psidot - C_phi phidot^2 - C_psi psidot^2`` along every motion.
        """
        phi, phidot, psi, psidot = np.moveaxis(as_array("x", x, 4), -1, 0)
        kinetic = (self.J_phi * phidot**2 + (self.J * np.cos(phi) ** 2 + self.J_psi0) * psidot**2) / 2
        return kinetic + self.G_c * np.sin(phi) - self.G_s * np.cos(phi) + self.K_psi * psi**2 / 2

    def as_dict(self) -> dict:
        """Name -> value, for provenance."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


@dataclass(frozen=True)
class PrintedPlant(PlantParameters):
    """The rig with the pitch equation as printed: ``J psi^2 / 2 sin 2 phi`` in place of ``J psidot^2 / 2 sin 2 phi``.

    It shows that the repair is needed: the printed term has the unit of a torque times s^2, and as a pitch torque that
    depends on yaw, without its counterpart in the yaw equation, it lets a closed path gain energy; ``d(energy)/dt`` is
    off by ``J/2 (psidot^2 - psi^2) phidot sin 2 phi``. Every function here accepts either class.

    Examples
    --------
    >>> x, u = [0.5, 0, 1, 0], [0, 0]
    >>> float(vector_field(x, u, PrintedPlant())[1] - vector_field(x, u, PlantParameters())[1])
    -0.333
    """

    velocity_term: ClassVar[str] = "as_printed"

    def as_dict(self) -> dict:
        """Name -> value, for provenance, with the velocity term."""
        return {**super().as_dict(), "velocity_term": self.velocity_term}


def torque_limits(name: str, limits) -> tuple[float, float]:
    """``limits`` as two floats; raises a ValueError unless they are finite torques in order."""
    try:
        low, high = map(float, limits)
    except (TypeError, ValueError):
        low = high = math.nan
    if not (low < high and math.isfinite(high - low)):
        raise ValueError(f"{name} is {limits!r}; give (lowest, highest), two finite torques in N m.")
    return low, high


def equations_of_motion(parameters: PlantParameters, functions=np) -> Callable:
    """The accelerations as a function of six scalars or arrays (paper, Sec. II, corrected).

    Parameters
    ----------
    parameters : PlantParameters
    functions : module
        Has ``sin`` and ``cos`` for the arguments: ``math`` for floats (fast), ``numpy`` for arrays, ``sympy`` in tests.

    Returns
    -------
    callable
        ``(phi, phidot, psi, psidot, u_phi, u_psi) -> (phiddot, psiddot)`` in rad/s^2.
    """
    J, J_psi0, J_phi, G_c, G_s, C_phi, C_psi, K_psi = (getattr(parameters, name) for name in LUMPED)
    sin, cos = functions.sin, functions.cos

    def accelerations(phi, phidot, psi, psidot, u_phi, u_psi):
        s, c = sin(phi), cos(phi)
        coupling = J * psidot * s * c  # = J psidot sin(2 phi) / 2
        return (
            (u_phi - coupling * psidot - C_phi * phidot - G_c * c - G_s * s) / J_phi,
            (u_psi + 2 * coupling * phidot - C_psi * psidot - K_psi * psi) / (J * c * c + J_psi0),
        )

    def as_printed(phi, phidot, psi, psidot, u_phi, u_psi):
        pitch, yaw = accelerations(phi, phidot, psi, psidot, u_phi, u_psi)
        return pitch + J * (psidot * psidot - psi * psi) * sin(phi) * cos(phi) / J_phi, yaw

    return as_printed if getattr(parameters, "velocity_term", "corrected") == "as_printed" else accelerations


def vector_field(x: ArrayLike, u: ArrayLike, parameters: PlantParameters) -> np.ndarray:
    """``dx/dt = F(x, u)``: states (..., 4) and torques (..., 2) in N m -> (..., 4).

    Raises
    ------
    ValueError
        If the last axis of ``x`` is not 4 or that of ``u`` not 2.

    Examples
    --------
    >>> import tras
    >>> rig = tras.PlantParameters()
    >>> bool(abs(tras.vector_field(tras.rest_point(rig), [0, 0], rig)).max() < 1e-9)
    True
    """
    phi, phidot, psi, psidot = np.moveaxis(as_array("x", x, 4), -1, 0)
    u_phi, u_psi = np.moveaxis(as_array("u", u, 2), -1, 0)
    phiddot, psiddot = equations_of_motion(parameters)(phi, phidot, psi, psidot, u_phi, u_psi)
    return np.stack(np.broadcast_arrays(phidot, phiddot, psidot, psiddot), axis=-1)


def jacobian(x: ArrayLike, u: ArrayLike, parameters: PlantParameters) -> tuple[np.ndarray, np.ndarray]:
    """Linearisation at (x, u): ``A = dF/dx`` (..., 4, 4) and ``B = dF/du`` (..., 4, 2).

    Examples
    --------
    >>> import tras
    >>> rig = tras.PlantParameters()
    >>> A, B = tras.jacobian(tras.rest_point(rig), [0, 0], rig)
    >>> A.shape, B.shape
    ((4, 4), (4, 2))
    """
    p = parameters
    phi, phidot, psi, psidot = np.moveaxis(as_array("x", x, 4), -1, 0)
    u_psi = as_array("u", u, 2)[..., 1]
    s, c, sin2, cos2 = np.sin(phi), np.cos(phi), np.sin(2 * phi), np.cos(2 * phi)
    J_psi = p.J * c**2 + p.J_psi0
    torque_psi = u_psi + p.J * psidot * phidot * sin2 - p.C_psi * psidot - p.K_psi * psi
    shape = np.broadcast_shapes(phi.shape, u_psi.shape)
    A, B = np.zeros((*shape, 4, 4)), np.zeros((*shape, 4, 2))
    A[..., 0, 1] = A[..., 2, 3] = 1
    printed = p.velocity_term == "as_printed"
    squared = psi if printed else psidot
    A[..., 1, 0] = (-p.J * squared**2 * cos2 + p.G_c * s - p.G_s * c) / p.J_phi
    A[..., 1, 1] = -p.C_phi / p.J_phi
    A[..., 1, 2 if printed else 3] = -p.J * squared * sin2 / p.J_phi
    A[..., 3, 0] = (2 * p.J * psidot * phidot * cos2 + torque_psi * p.J * sin2 / J_psi) / J_psi
    A[..., 3, 1] = p.J * psidot * sin2 / J_psi
    A[..., 3, 2] = -p.K_psi / J_psi
    A[..., 3, 3] = (p.J * phidot * sin2 - p.C_psi) / J_psi
    B[..., 1, 0] = 1 / p.J_phi
    B[..., 3, 1] = 1 / J_psi
    return A, B


def rest_point(parameters: PlantParameters, torques: ArrayLike = (0.0, 0.0)) -> np.ndarray:
    """The stable rest state (4,) under constant torques (N m), counterweight below the pivot.

    Raises
    ------
    ValueError
        If gravity cannot balance ``u_phi``, or ``u_psi`` is not zero on a rig without a yaw spring.

    Examples
    --------
    >>> import tras
    >>> tras.rest_point(tras.PlantParameters()).round(3)
    array([-0.491,  0.   ,  0.   ,  0.   ])
    """
    u_phi, u_psi = as_array("torques", torques, 2).tolist()
    gravity = math.hypot(parameters.G_c, parameters.G_s)
    if gravity == 0:
        raise ValueError("G_c and G_s are both 0, so no pitch angle is the rest point; give the rig a gravity torque.")
    if abs(u_phi) > gravity:
        raise ValueError(f"u_phi = {u_phi} N m has no rest point: gravity balances at most {gravity:.6g} N m.")
    if parameters.K_psi == 0 and u_psi != 0:
        raise ValueError(f"u_psi = {u_psi} N m has no rest point: K_psi is 0, yaw keeps turning. Use u_psi = 0.")
    phi = math.asin(u_phi / gravity) - math.atan2(parameters.G_c, parameters.G_s)
    return np.array([phi, 0.0, u_psi / parameters.K_psi if u_psi else 0.0, 0.0])


def simulate_plant(
    x0: ArrayLike, torques: ArrayLike, dt: float, parameters: PlantParameters, *, step: float = 0.01
) -> np.ndarray:
    """States at the sampling instants under torques that are held from one sample to the next.

    Parameters
    ----------
    x0 : (..., 4) array_like
        Initial states in rad and rad/s; leading axes run many simulations at once.
    torques : (..., samples, 2) array_like
        Torques in N m, not limited: limits belong to the controller. The last one has no effect.
    dt : float
        Sampling time in s.
    parameters : PlantParameters
    step : float
        Longest integration step in s; see `stepper`.

    Returns
    -------
    (..., samples, 4) ndarray

    Raises
    ------
    ValueError
        On wrong shapes, non-finite values, a ``dt`` or ``step`` that is not positive, or torques that make the rig
        faster than 1000 rad/s.

    Examples
    --------
    >>> import numpy as np
    >>> simulate_plant([-0.49, 0, 0.1, 0], np.zeros((601, 2)), 0.01, PlantParameters()).shape
    (601, 4)
    """
    x0, torques = as_array("x0", x0, 4), as_array("torques", torques, 2)
    if torques.ndim < 2 or torques.shape[-2] == 0:
        raise ValueError(f"torques has shape {torques.shape}; give (samples, 2) with at least one sample.")
    batch = np.broadcast_shapes(x0.shape[:-1], torques.shape[:-2])
    advance = stepper(parameters, dt, step=step, functions=np if batch else math)
    return rolled(advance, np.broadcast_to(x0, (*batch, 4)), np.broadcast_to(torques, (*batch, *torques.shape[-2:])))


def rolled(advance: Callable, x0: np.ndarray, inputs: np.ndarray) -> np.ndarray:
    """States (..., samples, n) that ``advance`` makes from ``x0`` (..., n) under ``inputs`` (..., samples, m)."""
    x, u = np.moveaxis(x0, -1, 0), np.moveaxis(inputs, (-2, -1), (0, 1))
    if x0.ndim == 1:  # one run: plain floats are ten times as fast as arrays of one
        x, u = x.tolist(), u.tolist()
    states = [x]
    with np.errstate(over="ignore", invalid="ignore"):  # `advance` raises
        for sample in u[:-1]:
            states.append(advance(states[-1], sample))
    return np.moveaxis(np.array(states), (0, 1), (-2, -1))


def stepper(parameters: PlantParameters, dt: float, *, step: float = 0.01, functions=math) -> Callable:
    """The flow over one sample as ``advance((phi, phidot, psi, psidot), (u_phi, u_psi)) -> tuple``, torques held.

    Butcher's method of order 6 (`tras.twin_rotor.integrator`) in steps of at most ``step`` seconds, shorter where 0.1 s
    of the present acceleration leads to more than 1.5 rad/s: 1 ms at 10 rad/s, 0.45 ms at 20 rad/s.

    With TRAS-A, torques within its limits, any ``dt``, and ``step`` up to 0.01 s, the error over 6 s is at most 1e-9
    (rad, rad/s), measured on 480 random motions with initial rates of up to 10 rad/s. On five of them, which tumble or
    magnify disturbances thousands of times, DOP853 at rtol 1e-12 is up to 5e-8 away.

    Parameters
    ----------
    parameters : PlantParameters
    dt, step : float
        Sampling time and longest step in s.
    functions : module
        ``math`` for floats, ``numpy`` for arrays of many runs at once (then all take the steps of the fastest one).

    Raises
    ------
    ValueError
        If ``dt`` or ``step`` is not positive; by ``advance``, if the rig gets faster than 1000 rad/s.
    """
    return flow(equations_of_motion(parameters, functions), dt, step=step, functions=functions)


def flow(
    rates: Callable, dt: float, *, step: float = 0.01, functions=math, others: int = 0, inputs: int = 2
) -> Callable:
    """`stepper` for any plant of two axes: ``advance(x, u) -> tuple``.

    Parameters
    ----------
    rates : callable
        ``(phi, phidot, psi, psidot, *others, *inputs) -> (phiddot, psiddot, *derivatives of the others)``.
    dt, step, functions
        As for `stepper`; ``step`` also has to suit the further states, of which the choice of steps knows nothing.
    others, inputs : int
        Number of further states, such as the speeds of rotors, and of inputs.

    Raises
    ------
    ValueError
        As for `stepper`.
    """
    for name, value in (("dt", dt), ("step", step)):
        arguments.number(name, value, 0, ends=False, give="a positive time in s")
    one_step = butcher(2, others, inputs)
    free = _SPEED * (_STEP / step) ** (1 / _POWER)  # rad/s: up to here `step` is short enough

    def advance(x, u):
        remaining, n = dt, 2
        while n > 1:
            k = rates(*x, *u)
            if functions is math:
                speed = max(abs(x[1]), abs(x[3])) + _AHEAD * max(abs(k[0]), abs(k[1]))
            else:
                speed = _largest(x[1], x[3]) + _AHEAD * _largest(k[0], k[1])
            if not speed < _FASTEST:  # NaN too
                raise ValueError(
                    f"the simulation left the representable range: the rig turns at more than {_FASTEST:g} rad/s; "
                    "reduce the torques or the initial rates."
                )
            longest = step if speed <= free else _STEP * (_SPEED / speed) ** _POWER
            n = math.ceil(remaining / longest * (1 - 1e-12))  # 0.1 / 0.01 is 10, not 11
            h = remaining / n
            remaining -= h
            x = one_step(rates, x, u, k, h)
        return x

    return advance


def _largest(*arrays):
    return max(float(np.abs(array).max()) for array in arrays)


def as_array(name, values, width):
    """``values`` as floats; raises a ValueError unless all are finite and the last axis has ``width`` of them."""
    array = np.asarray(values, dtype=float)
    if array.ndim == 0 or array.shape[-1] != width:
        raise ValueError(f"{name} has shape {array.shape}; its last axis must hold {width} values.")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} holds NaN or infinity; remove or repair those values first.")
    return array
