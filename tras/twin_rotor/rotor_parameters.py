"""Parameters of the twin rotor with its rotors: a body, two rotors, and what a polynomial does not describe.

The latter is an option each, off by default: dry friction, a dead zone, a cable with slack, motors at their limit, a
supply that sags. A payload is one, too. Gusts are inputs (`tras.twin_rotor.rotors`).
"""

import math
from dataclasses import dataclass, field, fields, replace
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from tras.twin_rotor import plant
from tras.twin_rotor.curves import Curve, beyond
from tras.twin_rotor.plant import PlantParameters
from tras.workflow import arguments

STATE_NAMES = (*plant.STATE_NAMES, "omega_m", "omega_t")
STATE_UNITS = (*plant.STATE_UNITS, "rad/s", "rad/s")
COMMAND_NAMES = ("u_m", "u_t")
COMMAND_UNITS = ("", "")
GUST_NAMES = ("gust_phi", "gust_psi")
GUST_UNITS = plant.TORQUE_UNITS
RPM = math.pi / 30  # rad/s


@dataclass(frozen=True)
class RotorParameters:
    """Body, rotors and options of the six-state twin rotor, SI units. `maker` and `rotondo` are published sets.

    Each rotor is ``I domega/dt = command - hold(omega)``, where ``hold`` is the command that holds a speed, and gives
    the torque ``thrust(omega)`` about its axis; the tail's acts on yaw times cos(phi).

    Parameters
    ----------
    body : PlantParameters
        Inertias, gravity, viscous friction and spring.
    thrust_m, thrust_t : Curve
        Torque in N m of the main rotor about the pitch axis and of the tail rotor about the yaw axis at level beam.
    hold_m, hold_t : Curve
        Command that holds a speed. Must rise from -1 to 1.
    I_m, I_t : float
        Inertia of rotor and motor in s (command) per rad/s.
    reaction_phi, reaction_psi : float
        Torque in N m of a full tail command on pitch, and of a full main command on yaw at level beam.
    momentum : float
        Angular momentum of the main rotor per speed in kg m^2; its change turns the yaw axis.
    inflow : float
        Share of the main thrust gained per rad/s of yaw at level beam, in s/rad.
    spring_side : float
        The spring has ``K_psi + spring_side`` at positive yaw and ``K_psi - spring_side`` at negative, in N m/rad.
    twist : Curve
        Torque in N m of the cable on yaw as a function of pitch less ``twist_rest``.
    twist_rest : float
        Pitch in rad.
    J_printed : float, optional
        Inertia in kg m^2 of the centrifugal torque in equations without the Coriolis torque, as Rotondo et al. print
        them (`rotondo` says more). None: the consistent pair, which conserves energy.
    coulomb, stiction : (float, float)
        Dry friction about pitch and yaw in N m, and what breaking away takes in addition. The torque is smooth: it
        falls to zero below 0.02 rad/s.
    dead_zone : (float, float)
        Commands of the main and the tail motor up to which nothing happens; beyond it the rest acts.
    saturation : (float, float), optional
        Commands at which the motors are at their limit. None: a command outside [-1, 1] is refused.
    sag : float
        Share of the supply voltage that is lost when both motors have full commands.
    cable : (float, float)
        Stiffness in N m/rad of a cable about the yaw axis, and the yaw in rad up to which it is slack.
    payload : float
        Mass in kg at the main rotor.
    arm : float
        Distance of the main rotor from the pivot in m, for the payload.

    Raises
    ------
    ValueError
        If a value is not finite or out of its range, or a ``hold`` curve does not rise from -1 to 1.

    Examples
    --------
    >>> rig = RotorParameters.maker(dead_zone=(0.05, 0.05))
    >>> [[round(speed) for speed in limits] for limits in rig.speed_limits]
    [[-407, 404], [-777, 802]]
    """

    body: PlantParameters
    thrust_m: Curve
    thrust_t: Curve
    hold_m: Curve
    hold_t: Curve
    I_m: float
    I_t: float
    reaction_phi: float = 0.0
    reaction_psi: float = 0.0
    momentum: float = 0.0
    inflow: float = 0.0
    spring_side: float = 0.0
    twist: Curve = field(default_factory=Curve)
    twist_rest: float = 0.0
    J_printed: float | None = None
    coulomb: tuple[float, float] = (0.0, 0.0)
    stiction: tuple[float, float] = (0.0, 0.0)
    dead_zone: tuple[float, float] = (0.0, 0.0)
    saturation: tuple[float, float] | None = None
    sag: float = 0.0
    cable: tuple[float, float] = (0.0, 0.0)
    payload: float = 0.0
    arm: float = 0.202

    # What a controller or a recording needs to know of a plant, beside its equations.
    state_names: ClassVar[tuple[str, ...]] = STATE_NAMES
    state_units: ClassVar[tuple[str, ...]] = STATE_UNITS
    input_names: ClassVar[tuple[str, ...]] = COMMAND_NAMES
    input_units: ClassVar[tuple[str, ...]] = COMMAND_UNITS
    input_limits: ClassVar[tuple[tuple[float, float], ...]] = ((-1.0, 1.0), (-1.0, 1.0))

    def __post_init__(self):
        for name in ("reaction_phi", "reaction_psi", "momentum", "inflow", "spring_side", "twist_rest"):
            arguments.number(name, getattr(self, name), give="a finite number in SI units")
        for name in ("I_m", "I_t", "arm"):
            arguments.number(name, getattr(self, name), 0, ends=False, give="a positive number in SI units")
        if self.J_printed is not None:
            arguments.number("J_printed", self.J_printed, give="a finite inertia in kg m^2, or None")
        arguments.number("payload", self.payload, 0, give="a mass in kg, 0 or more")
        arguments.number("sag", self.sag, 0, 0.9)
        for name, high in (("coulomb", math.inf), ("stiction", math.inf), ("dead_zone", 0.9), ("cable", math.inf)):
            object.__setattr__(self, name, _pair(name, getattr(self, name), high))
        if self.saturation is not None:
            object.__setattr__(self, "saturation", _pair("saturation", self.saturation, 1.0))
            if min(self.saturation) <= max(self.dead_zone):
                raise ValueError(f"saturation is {self.saturation}; it must lie above the dead zone {self.dead_zone}.")
        if abs(self.spring_side) > self.body.K_psi:
            raise ValueError(
                f"spring_side is {self.spring_side}; give at most K_psi = {self.body.K_psi}, or yaw has no rest point."
            )
        for name in ("hold_m", "hold_t"):
            low, high = self._range(name)
            if not high > low or getattr(self, name).slope(np.linspace(low, high, 1001)).min() <= 0:
                raise ValueError(f"{name} does not rise from -1 to 1; give the command that holds a speed, monotone.")

    @classmethod
    def maker(cls, **options) -> "RotorParameters":
        """The public TRAS model: its body (TRAS-A), its curves, arms, rotor inertias and reaction torques.

        The model gives the speed in rpm as a polynomial of the command. The tail's rises everywhere; the main rotor's
        of degree 7 falls below -0.994 and above 0.984, so that it has no inverse. ``hold`` is a polynomial fitted to
        the inverse, of degree 11 for the main rotor up to commands of 0.96 and of degree 7 for the tail. It rises from
        -1 to 1 and differs from the model's curve by at most 0.0046 and 0.0012 of command there.
        """
        to_main = Curve((-1.4202e-2, 2.8912e-5, 1.8694e-8, 2.4067e-11, -3.7928e-16, -7.3069e-19), (), RPM)  # N of rpm
        to_tail = Curve((9.1355e-3, 2.1293e-5, -7.3425e-9, 3.1671e-12, 4.0965e-17, -2.5610e-20), (), RPM)
        main = (0.00071, 0.51601, 0.00572, 1.12239, -0.05316, -6.86123, 0.31534, 22.73983, -0.62411, -28.58844, 0.37815)
        tail = (0.00053, 0.82072, -0.00321, 0.11952, -0.11599, 0.66348, 0.11146, -0.55722)
        rotors = {
            "thrust_m": to_main.times(0.202),
            "thrust_t": to_tail.times(0.216),
            "hold_m": Curve((*main, 12.21322), (), 4000 * RPM),
            "hold_t": Curve(tail, (), 8000 * RPM),
            "I_m": 1 / (6100 * RPM),
            "I_t": 1 / (37000 * RPM),
            "reaction_phi": 0.00417495398545,
            "reaction_psi": -0.0178200378418,
        }
        return cls(**{"body": PlantParameters(), **rotors, **options})

    @classmethod
    def rotondo(cls, *, as_printed: bool = False, **options) -> "RotorParameters":
        """The TRMS of D. Rotondo, F. Nejjari and V. Puig, Control Engineering Practice 21 (2013).

        Its numbers are read from the TRMS example of ``arielmb94/CHRONOS-MPC`` (MIT licence); a full command is 2.5 V
        at the tail motor and 2 V at the main motor, its limits. Two terms of the equations create energy and are
        repaired unless ``as_printed``: the yaw inertia changes with pitch by ``K_D - K_E`` (0.0495 kg m^2), but the
        Coriolis torque is missing, and the centrifugal torque has ``K_H`` (0.0753), which adds the counterweight's part
        where it is to be subtracted, with ``m_cb l_cb`` for ``m_cb l_cb^2``.
        """
        l_t, l_m, l_b, l_cb, r_ts, r_ms = 0.282, 0.246, 0.29, 0.276, 0.1, 0.155
        m_cb, m_b, m_m, m_mr, m_ms, m_t, m_tr, m_ts = 0.068, 0.022, 0.014, 0.236, 0.219, 0.015, 0.221, 0.119
        k_a, k_t, k_m, R_a, g = 0.0202, 6.5 * 2.5, 8.5 * 2.0, 8.0, 9.81  # k_t, k_m: volts of a full command
        K_A, K_B = (m_t / 2 + m_tr + m_ts) * l_t, (m_m / 2 + m_mr + m_ms) * l_m
        K_D = (m_m / 3 + m_mr + m_ms) * l_m**2 + (m_t / 3 + m_tr + m_ts) * l_t**2
        K_E, K_F = m_b * l_b**2 / 3 + m_cb * l_cb**2, m_ms * r_ms**2 + m_ts * r_ts**2 / 2
        main, tail = (
            Curve.sides(forwards, backwards, friction + k_a**2 / R_a).times(R_a / (k_a * volts))
            for forwards, backwards, friction, volts in ((0.0168, 0.0155, 0.0026, k_m), (0.0027, 0.0028, 0.0086, k_t))
        )
        thrust_m, thrust_t = Curve.sides(0.3819, 0.2197).times(l_m), Curve.sides(0.0566, 0.0660).times(l_t)
        limits = [(t(h.speed(-1)), t(h.speed(1))) for t, h in ((thrust_m, main), (thrust_t, tail))]
        body = PlantParameters(
            J=K_D - K_E, J_psi0=K_E + K_F, J_phi=K_D + K_E + (m_ms * r_ms**2 + m_ts * r_ts**2) / 2,
            G_c=g * (K_B - K_A), G_s=g * (m_b * l_b / 2 + m_cb * l_cb), C_phi=0.1026, C_psi=0.0185,
            K_psi=(0.0158 + 0.0111) / 2, u_phi_limits=limits[0], u_psi_limits=limits[1],
        )  # fmt: skip
        rotors = {
            "thrust_m": thrust_m,
            "thrust_t": thrust_t,
            "hold_m": main,
            "hold_t": tail,
            "I_m": 0.0254 * R_a / (k_a * k_m),
            "I_t": 0.0059 * R_a / (k_a * k_t),
            "momentum": 0.0017,
            "inflow": 0.2 / l_m,
            "spring_side": (0.0158 - 0.0111) / 2,
            "twist": Curve((0.0, 0.0, (0.0623 + 0.0563) / 2), (0.0, (0.0623 - 0.0563) / 2)),
            "twist_rest": -0.619426178368110,
            "J_printed": K_A * l_t + K_B * l_m + m_b * l_b**2 / 2 + m_cb * l_cb if as_printed else None,
            "arm": l_m,
        }
        return cls(**{"body": body, **rotors, **options})

    @property
    def loaded(self) -> PlantParameters:
        """The body with its payload."""
        extra = self.payload * self.arm**2
        body = self.body
        gravity = body.G_c + 9.81 * self.payload * self.arm
        return replace(body, J=body.J + extra, J_phi=body.J_phi + extra, G_c=gravity) if self.payload else body

    @property
    def speed_limits(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Lowest and highest speed in rad/s of the main and of the tail rotor, those that commands of -1 and 1 hold."""
        return self._range("hold_m"), self._range("hold_t")

    def _range(self, name):
        curve = getattr(self, name)
        return curve.speed(-1.0), curve.speed(1.0)

    def energy(self, x: ArrayLike) -> np.ndarray:
        """Energy in J of body, springs and cable in states ``x`` (..., 6) -> (...); the rotors' is none of the body's.

        ``d(energy)/dt = u_phi phidot + u_psi psidot - C_phi phidot^2 - C_psi psidot^2`` along every motion, with the
        torques of `tras.twin_rotor.rotors.torques`, which hold thrusts, reactions, dry friction and gusts.
        """
        x = plant.as_array("x", x, 6)
        psi, (stiffness, slack) = x[..., 2], self.cable
        springs = self.spring_side * psi * np.abs(psi) + stiffness * beyond(psi, slack) ** 2
        return self.loaded.energy(x[..., :4]) + springs / 2

    def as_dict(self) -> dict:
        """Name -> value, for provenance; parts with an ``as_dict`` of their own become dicts."""
        values = ((field.name, getattr(self, field.name)) for field in fields(self))
        return {name: value.as_dict() if hasattr(value, "as_dict") else value for name, value in values}


def _pair(name, values, high):
    try:
        first, second = map(float, values)
    except (TypeError, ValueError):
        first = second = math.nan
    if not (0 <= first <= high and 0 <= second <= high and math.isfinite(first + second)):
        most = f" up to {high:g}" if math.isfinite(high) else ""
        raise ValueError(f"{name} is {values!r}; give two numbers, 0 or more{most}.")
    return first, second
