"""The plant with rotors against energy, sympy, DOP853, the printed equations and the four-state plant."""

import dataclasses
import math

import mpmath
import numpy as np
import pytest
import sympy
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial import polynomial
from scipy.integrate import solve_ivp

import tras
from tras.twin_rotor import plant, rotors
from tras.twin_rotor.curves import Curve, beyond, clipped
from tras.twin_rotor.rotor_parameters import RPM

MAKER, ROTONDO = tras.RotorParameters.maker, tras.RotorParameters.rotondo
OPTIONS = {
    "plain": {},
    "dry friction": {"coulomb": (0.002, 0.001)},
    "stiction": {"coulomb": (0.002, 0.001), "stiction": (0.002, 0.0015)},
    "dead zone": {"dead_zone": (0.05, 0.1)},
    "cable": {"cable": (0.02, 0.5)},
    "saturation": {"saturation": (0.6, 0.5)},
    "sag": {"sag": 0.2},
    "payload": {"payload": 0.02},
    "everything": {
        "coulomb": (0.002, 0.001), "stiction": (0.002, 0.0015), "dead_zone": (0.05, 0.1), "cable": (0.02, 0.5),
        "saturation": (0.6, 0.5), "sag": 0.2, "payload": 0.02,
    },
}  # fmt: skip
SETS = {"maker": MAKER, "rotondo": ROTONDO, "rotondo as printed": lambda **o: ROTONDO(as_printed=True, **o)}
RIGS = {f"{name}, {what}": make(**options) for name, make in SETS.items() for what, options in OPTIONS.items()}
numbers = st.floats(-2, 2, allow_nan=False)
shares = st.floats(0.02, 0.98)


def states_of(rig, share_m, share_t):
    """Rotor speeds at shares of their ranges."""
    return [low + share * (high - low) for (low, high), share in zip(rig.speed_limits, (share_m, share_t))]


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(sorted(RIGS)), st.tuples(*[numbers] * 8), shares, shares)
def test_energy_balance(name, values, share_m, share_t):
    """d(energy)/dt is the power of the torques less viscous friction; the gradient is taken in 30 digits."""
    rig = RIGS[name]
    *body, u_m, u_t, gust_phi, gust_psi = values
    x, u = [*body, *states_of(rig, share_m, share_t)], [u_m / 2, u_t / 2, gust_phi / 100, gust_psi / 100]
    mpmath.mp.dps = 30
    loaded, (stiffness, slack) = rig.loaded, rig.cable

    def energy(phi, phidot, psi, psidot):
        kinetic = (loaded.J_phi * phidot**2 + (loaded.J * mpmath.cos(phi) ** 2 + loaded.J_psi0) * psidot**2) / 2
        gravity = loaded.G_c * mpmath.sin(phi) - loaded.G_s * mpmath.cos(phi)
        taut = max(abs(psi) - slack, 0)
        spring = (loaded.K_psi + (rig.spring_side if psi > 0 else -rig.spring_side)) * psi**2
        return kinetic + gravity + (spring + stiffness * taut**2) / 2

    point = tuple(mpmath.mpf(v) for v in body)
    gradient = [mpmath.diff(energy, point, tuple(int(i == j) for j in range(4))) for i in range(4)]
    rate = tras.twin_rotor.rotors.vector_field(x, u, rig)
    change = float(mpmath.fdot(gradient, [mpmath.mpf(v) for v in rate[:4]]))
    u_phi, u_psi = rotors.torques(x, u, rig)
    power = u_phi * x[1] + u_psi * x[3] - loaded.C_phi * x[1] ** 2 - loaded.C_psi * x[3] ** 2
    size = float(sum(abs(g * r) for g, r in zip(gradient, rate[:4]))) + abs(u_phi * x[1]) + abs(u_psi * x[3]) + 0.1
    assert abs(change - power) <= 1e-12 * size
    assert np.isclose(rig.energy(x), float(energy(*point)), rtol=1e-12, atol=1e-12)


def free(rig):
    """The rig without any torque from rotors, friction or cable."""
    none = Curve()
    body = dataclasses.replace(rig.body, C_phi=0.0, C_psi=0.0)
    return dataclasses.replace(
        rig, body=body, thrust_m=none, thrust_t=none, twist=none, reaction_phi=0.0, reaction_psi=0.0, momentum=0.0
    )


@pytest.mark.parametrize("printed", [False, True])
def test_the_printed_equations_of_the_second_set_create_energy(printed):
    rig = free(ROTONDO(as_printed=printed))
    energy = rig.energy(tras.simulate_rotors([0.3, 0.5, 0.4, 1.5, 0, 0], np.zeros((601, 2)), 0.01, rig))
    assert (np.ptp(energy) > 0.01) == printed and (np.ptp(energy) < 1e-6) != printed


def test_the_second_set_as_printed():
    """Equations and numbers of the public example, written down here once more."""
    l_t, l_m, k_m, k_g = 0.282, 0.246, 0.0017, 0.2
    K_A, K_B, K_C = (0.0075 + 0.221 + 0.119) * l_t, (0.007 + 0.236 + 0.219) * l_m, 0.011 * 0.29 + 0.068 * 0.276
    K_D = (0.014 / 3 + 0.236 + 0.219) * l_m**2 + (0.005 + 0.221 + 0.119) * l_t**2
    K_E, K_F = 0.022 * 0.29**2 / 3 + 0.068 * 0.276**2, 0.219 * 0.155**2 + 0.0595 * 0.01
    K_H = K_A * l_t + K_B * l_m + 0.011 * 0.29**2 + 0.068 * 0.276
    J_v = K_D + K_E + 0.1095 * 0.155**2 + 0.0595 * 0.01
    rest = -0.619426178368110

    def squared(w, forwards, backwards):
        return forwards * w**2 if w >= 0 else -backwards * w**2

    def printed(phi, phidot, psi, psidot, w_v, w_h, volts_v, volts_h):
        c, s = math.cos(phi), math.sin(phi)
        I = K_D * c**2 + K_E * s**2 + K_F  # noqa: E741 the printed name
        w_h_rate = (0.0202 * 6.5 / 8 * volts_h - (0.0086 + 0.0202**2 / 8) * w_h - squared(w_h, 0.0027, 0.0028)) / 0.0059
        w_v_torque = 0.0202 * 8.5 / 8 * volts_v - (0.0026 + 0.0202**2 / 8) * w_v - squared(w_v, 0.0168, 0.0155)
        cable = (0.0158 if psi >= 0 else 0.0111) * psi - (0.0623 if phi >= rest else 0.0563) * (phi - rest) ** 2
        thrust = squared(w_v, 0.3819, 0.2197)
        yaw = (l_t * squared(w_h, 0.0566, 0.0660) * c - 0.0185 * psidot - cable) / I
        yaw += k_m * w_v * s * phidot * (K_D * c**2 - K_E * s**2 - K_F - 2 * K_E * c**2) / I**2
        yaw += k_m * c * w_v_torque / (0.0254 * I)
        gravity = 9.81 * ((K_A - K_B) * c - K_C * s)
        pitch = l_m * thrust + k_g * psidot * thrust * c - 0.1026 * phidot + gravity - psidot**2 * K_H * s * c
        return [phidot, pitch / J_v, psidot, yaw, w_v_torque / 0.0254, w_h_rate]

    rig, rng = ROTONDO(as_printed=True), np.random.default_rng(0)
    for _ in range(50):
        x, u = rng.uniform(-1, 1, 6) * [1.2, 2, 3, 2, 1.5, 2.5], rng.uniform(-1, 1, 2)
        expected = printed(*x, 2.0 * u[0], 2.5 * u[1])
        assert np.allclose(rotors.vector_field(x, u, rig), expected, rtol=1e-12, atol=1e-12)
    assert rotors.rest_point(rig)[0] == pytest.approx(rest, abs=1e-12)
    assert K_H == pytest.approx(0.0753, abs=5e-5) and K_D - K_E == pytest.approx(0.0495, abs=5e-5)


def test_the_curves_of_the_maker():
    """Which of them rises everywhere, and how far ``hold`` is from the inverse."""
    main = [-5.36, 7330.4, -37.57, -10996.7, 150.34, 13653.8, -129.69, -6165.7]
    tail = [-9.20, 9838.9, 303.13, -4470.7, -173.47, 2171.0]
    turns = polynomial.polyroots(polynomial.polyder(main))
    turns = np.sort(turns[np.abs(turns.imag) < 1e-12].real)
    assert turns.round(3).tolist() == [-0.994, 0.984]
    everywhere = np.linspace(-1, 1, 2001)
    assert polynomial.polyval(everywhere, polynomial.polyder(tail)).min() > 5500
    rig = MAKER()
    for curve, coefficients, end, most in ((rig.hold_m, main, 0.96, 0.0046), (rig.hold_t, tail, 1.0, 0.0012)):
        commands = np.linspace(-end, end, 4001)
        deviation = np.abs(curve(polynomial.polyval(commands, coefficients) * RPM) - commands).max()
        assert 0.9 * most < deviation <= most
    rpm = 2000.0
    force = -7.3069e-19 * rpm**5 - 3.7928e-16 * rpm**4 + 2.4067e-11 * rpm**3 + 1.8694e-8 * rpm**2 + 2.8912e-5 * rpm
    assert rig.thrust_m(rpm * RPM) == pytest.approx(0.202 * (force - 1.4202e-2), rel=1e-12)


@pytest.mark.parametrize("name", RIGS)
def test_jacobian_is_sympys(name):
    rig = RIGS[name]
    symbols = sympy.symbols("phi phidot psi psidot omega_m omega_t u_m u_t gust_phi gust_psi", real=True)
    rates = rotors.equations_of_motion(rig, sympy)(*symbols)
    field = sympy.Matrix([symbols[1], rates[0], symbols[3], rates[1], *rates[2:]])
    slopes = sympy.lambdify(symbols, field.jacobian(symbols), "numpy")
    rng = np.random.default_rng(1)
    for _ in range(5):
        x, u = rng.uniform(-1, 1, 6) * [1, 0.3, 2, 0.3, 0, 0], rng.uniform(-1, 1, 4) * [1, 1, 0.01, 0.01]
        x[4:] = states_of(rig, *rng.uniform(0.1, 0.9, 2))
        A, B = rotors.jacobian(x, u, rig)
        exact = np.array(slopes(*x, *u), dtype=float)
        assert np.allclose(np.hstack([A, B]), exact, rtol=1e-9, atol=1e-9 * np.abs(exact).max())
    xs, us = np.tile(x, (2, 3, 1)), np.tile(u, (3, 1))
    assert [part.shape for part in rotors.jacobian(xs, us, rig)] == [(2, 3, 6, 6), (2, 3, 6, 4)]
    assert np.allclose(rotors.jacobian(xs, us, rig)[0][1, 2], A, rtol=1e-13)
    assert rotors.jacobian(x, u[:2], rig)[1].shape == (6, 2)


def dop853(x0, inputs, dt, rig):
    """States at the samples, restarted at each, where the inputs jump."""
    rates = rotors.equations_of_motion(rig, math)
    states = [np.asarray(x0, dtype=float)]
    for u in inputs[:-1].tolist():

        def field(t, x, u=u):
            phiddot, psiddot, *spins = rates(*x.tolist(), *u)
            return x[1], phiddot, x[3], psiddot, *spins

        solution = solve_ivp(field, (0, dt), states[-1], method="DOP853", rtol=1e-12, atol=1e-13, max_step=dt / 4)
        states.append(solution.y[:, -1])
    return np.array(states)


SMOOTH = {"plain", "payload", "sag", "dead zone", "saturation"}  # of the maker's set; the second reverses its rotors


@pytest.mark.parametrize("name", [name for name in RIGS if "printed" not in name])
def test_integrator_against_dop853(name):
    rig, rng = RIGS[name], np.random.default_rng(3)
    x0 = rotors.rest_point(rig) + [*rng.normal(0, 0.3, 4), 0, 0]
    commands = np.repeat(rng.uniform(-0.8, 0.8, (7, 2)), 50, axis=0)[:301]
    outside = rng.normal(0, 0.005, (301, 2))
    ours = tras.simulate_rotors(x0, commands, 0.01, rig, gusts=outside)
    error = np.abs(ours - dop853(x0, np.hstack([commands, outside]), 0.01, rig))
    smooth = name.startswith("maker") and name.split(", ")[1] in SMOOTH
    assert error[:, :4].max() <= (1e-9 if smooth else 1e-6)
    assert error[:, 4:].max() <= 1e-6


@pytest.mark.parametrize("make", [MAKER, ROTONDO])
def test_the_four_state_plant_is_the_limit_for_fast_rotors(make):
    """Under the torques of the speeds that the commands hold: angles to first order in the inertia of the rotors."""
    commands = np.repeat(np.random.default_rng(0).uniform(-0.3, 0.6, (4, 2)), 50, axis=0)
    rig = dataclasses.replace(make(), spring_side=0.0, momentum=0.0)  # with it a jump of the speed is a kick
    x0 = rotors.rest_point(rig)
    states = [x0[:4]]
    for u in commands[:-1]:
        speeds = [rig.hold_m.speed(u[0]), rig.hold_t.speed(u[1])]

        def field(t, x, u=u, speeds=speeds):
            return plant.vector_field(x, rotors.torques([*x, *speeds], u, rig), rig.body)

        states.append(solve_ivp(field, (0, 0.01), states[-1], method="DOP853", rtol=1e-10, atol=1e-12).y[:, -1])
    fast = []
    for share in (0.01, 0.005):
        rotor = dataclasses.replace(rig, I_m=share * rig.I_m, I_t=share * rig.I_t)
        fast.append(tras.simulate_rotors(x0, commands, 0.01, rotor)[:, :4])
    first, second, limit = (np.abs(x - states)[:, [0, 2]].max() for x in (*fast, 2 * fast[1] - fast[0]))
    assert first / second == pytest.approx(2, abs=0.05) and limit < 0.1 * second


def test_with_still_rotors_the_body_is_the_four_state_plant():
    """Gusts are then its torques, sample for sample."""
    rig = dataclasses.replace(free(MAKER()), body=tras.PlantParameters())
    held = np.random.default_rng(0).uniform(-0.1, 0.1, (301, 2))
    six = tras.simulate_rotors([0.1, 0.2, 0.3, 0.4, 0, 0], np.zeros((301, 2)), 0.01, rig, gusts=held)
    four = tras.simulate_plant([0.1, 0.2, 0.3, 0.4], held, 0.01, rig.body)
    assert np.allclose(six[:, :4], four, rtol=0, atol=1e-10)


@pytest.mark.parametrize("name", RIGS)
def test_rest_point_rests(name):
    rig = RIGS[name]
    for commands in ((0, 0), (0.3, 0.2), (-0.2, -0.5)):
        rest = rotors.rest_point(rig, commands)
        assert np.abs(rotors.vector_field(rest, commands, rig)).max() <= 1e-9 * np.abs(rest).max()
        A, _ = rotors.jacobian(rest, commands, rig)
        assert np.linalg.eigvals(A).real.max() < 0


@given(numbers, st.floats(0.01, 1))
def test_dead_zone_and_limit(value, width):
    assert clipped(value, width) == pytest.approx(np.clip(value, -width, width), abs=1e-15)
    assert beyond(value, width) == pytest.approx(np.sign(value) * max(abs(value) - width, 0), abs=1e-15)


@given(st.lists(numbers, min_size=1, max_size=6), st.lists(numbers, max_size=4), numbers, st.floats(0.1, 10))
def test_curve(polynomials, sided, speed, scale):
    curve, s = Curve(polynomials, sided, scale), speed / scale
    value = sum(a * s**k for k, a in enumerate(polynomials)) + abs(s) * sum(b * s**k for k, b in enumerate(sided))
    assert curve(speed) == pytest.approx(value, rel=1e-9, abs=1e-9)
    assert np.ravel(curve(np.array([speed])))[0] == curve(speed)
    if abs(s) > 1e-3:
        h = 1e-6 * scale
        assert curve.slope(speed) == pytest.approx((curve(speed + h) - curve(speed - h)) / (2 * h), rel=1e-4, abs=1e-4)


def test_speed_of_a_curve():
    curve = Curve.sides(2.0, 0.5, 1.0)
    for value in (-3.0, -0.1, 0.0, 0.4, 7.0):
        assert curve(curve.speed(value)) == pytest.approx(value, abs=1e-12)
    assert math.isnan(Curve().speed(1.0)) and math.isnan(Curve((0, 0, 1)).speed(-1.0))


def test_what_arrives_of_a_command():
    arriving = rotors._motors(MAKER(saturation=(0.6, 0.5), dead_zone=(0.1, 0.0), sag=0.2))
    assert arriving(0.05, 0.0) == (0.0, 0.0)
    assert np.allclose(arriving(3.0, 0.0), (0.5 * (1 - 0.1 * 0.5), 0.0))
    assert np.allclose(arriving(3.0, -3.0), (0.5 * 0.9, -0.5 * 0.9))


def test_payload_lowers_the_main_rotor():
    light, heavy = MAKER(), MAKER(payload=0.05)
    assert rotors.rest_point(heavy)[0] < rotors.rest_point(light)[0] - 0.3
    assert heavy.loaded.J_phi - light.body.J_phi == pytest.approx(0.05 * 0.202**2)
    assert light.loaded is light.body


def test_many_at_once_equal_one_after_the_other():
    rig, rng = MAKER(cable=(0.01, 0.3)), np.random.default_rng(0)
    x0 = rotors.rest_point(rig) + np.column_stack([rng.uniform(-0.3, 0.3, (3, 4)), np.zeros((3, 2))])
    held, outside = rng.uniform(-1, 1, (3, 50, 2)), rng.normal(0, 0.01, (50, 2))
    together = tras.simulate_rotors(x0, held, 0.01, rig, gusts=outside)
    alone = [tras.simulate_rotors(x, u, 0.01, rig, gusts=outside) for x, u in zip(x0, held)]
    assert together.shape == (3, 50, 6)
    assert np.allclose(together, alone, rtol=1e-12, atol=1e-12)


def test_rotors_stay_within_their_range():
    rig = MAKER()
    commands = np.where(np.random.default_rng(0).random((2001, 2)) < 0.5, -1.0, 1.0)
    x = tras.simulate_rotors(rotors.rest_point(rig), commands.repeat(1, axis=0), 0.05, rig)
    low, high = np.array(rig.speed_limits).T
    assert np.all((x[:, 4:] >= low) & (x[:, 4:] <= high))


def test_as_dict_is_what_a_recording_keeps():
    rig = ROTONDO(dead_zone=(0.1, 0.0))
    log = tras.Recording([np.zeros((2, 1))], dt=0.1, attributes=rig.as_dict())
    assert log.attributes["body"]["J"] == rig.body.J and log.attributes["dead_zone"] == [0.1, 0.0]
    assert Curve(**log.attributes["thrust_m"]) == rig.thrust_m


@pytest.mark.parametrize(
    "call, words",
    [
        (lambda: MAKER(sag=1.0), "sag is 1.0; give a number from 0 to 0.9"),
        (lambda: MAKER(sag="0.1"), "sag is '0.1'"),
        (lambda: MAKER(payload=-1), "payload is -1; give a mass"),
        (lambda: MAKER(I_m=0.0), "I_m is 0.0; give a positive number"),
        (lambda: MAKER(momentum=math.nan), "momentum is nan"),
        (lambda: MAKER(coulomb=0.1), "coulomb is 0.1; give two numbers"),
        (lambda: MAKER(coulomb=(0.1, -1)), "coulomb is .0.1, -1.; give two numbers, 0 or more"),
        (lambda: MAKER(dead_zone=(0.1, 1.0)), "dead_zone is .*0 or more up to 0.9"),
        (lambda: MAKER(saturation=(0.2, 0.05), dead_zone=(0.1, 0.1)), "saturation is .*above the dead zone"),
        (lambda: MAKER(spring_side=0.1), "spring_side is 0.1; give at most K_psi"),
        (lambda: MAKER(hold_m=Curve((0.0, -1.0))), "hold_m does not rise from -1 to 1"),
        (lambda: MAKER(hold_t=Curve((0.0, 1.0, 0.0, -4.0))), "hold_t does not rise"),
        (lambda: Curve(()), "polynomial is empty"),
        (lambda: Curve((1.0, math.inf)), "polynomial is inf"),
        (lambda: Curve(scale=0), "scale is 0"),
        (lambda: rotors.rest_point(MAKER(), (1.5, 0)), r"commands reach 1.5; give commands in \[-1, 1\]"),
        (lambda: rotors.rest_point(MAKER(body=tras.PlantParameters(K_psi=0)), (0, 0.5)), "neither spring nor cable"),
        (lambda: rotors.vector_field([0] * 4, [0, 0], MAKER()), "x has shape .4,."),
        (lambda: rotors.vector_field([0] * 6, [0, 0, 0], MAKER()), "u has shape .3,."),
        (lambda: tras.simulate_rotors([0] * 6, [[0, 2]], 0.01, MAKER()), "commands reach 2"),
        (lambda: tras.simulate_rotors([0] * 6, [0, 0], 0.01, MAKER()), "commands has shape .2,."),
        (
            lambda: tras.simulate_rotors([0] * 5 + [1e3], [[0, 0]], 0.01, MAKER()),
            "x0 has omega_t outside -776.959 to 802.493",
        ),
        (lambda: tras.simulate_rotors([0] * 6, [[0, 0]], 0, MAKER()), "dt is 0"),
        (lambda: tras.simulate_rotors([0] * 6, [[0, 0]], 0.1, MAKER(), step=0), "step is 0"),
        (lambda: tras.simulate_rotors([0] * 6, [[0, 0]], 0.1, MAKER(), gusts=[[0, 0]] * 2), "gusts has shape .2, 2."),
        (lambda: tras.simulate_rotors([0] * 6, np.zeros((99, 2)), 1.0, MAKER(), gusts=np.full((99, 2), 1e4)), "left"),
    ],
)
def test_mistakes_are_named(call, words):
    with pytest.raises(ValueError, match=words):
        call()
