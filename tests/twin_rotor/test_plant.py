"""The plant against independent references: energy, Lagrange's equations, finite differences, DOP853."""

import math

import mpmath
import numpy as np
import pytest
import sympy
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

import tras
from tras.twin_rotor.plant import equations_of_motion, stepper

numbers = st.floats(-3, 3, allow_nan=False)
states = st.tuples(numbers, numbers, numbers, numbers)
torques = st.tuples(numbers, numbers)
inertias = st.floats(1e-3, 1.0)
coefficients = st.floats(0.0, 1.0)


@st.composite
def plants(draw):
    return tras.PlantParameters(
        J=draw(inertias), J_psi0=draw(inertias), J_phi=draw(inertias), G_c=draw(numbers), G_s=draw(numbers),
        C_phi=draw(coefficients), C_psi=draw(coefficients), K_psi=draw(coefficients),
    )  # fmt: skip


@given(plants(), states, torques)
def test_energy_balance(plant, x, u):
    """d(T + V)/dt = u . velocity - friction, for every plant, state and torque; the gradient is taken in 30 digits."""
    mpmath.mp.dps = 30
    rate = [mpmath.mpf(v) for v in tras.vector_field(x, u, plant)]

    def energy(phi, phidot, psi, psidot):
        kinetic = (plant.J_phi * phidot**2 + (plant.J * mpmath.cos(phi) ** 2 + plant.J_psi0) * psidot**2) / 2
        return kinetic + plant.G_c * mpmath.sin(phi) - plant.G_s * mpmath.cos(phi) + plant.K_psi * psi**2 / 2

    point = [mpmath.mpf(v) for v in x]
    gradient = [mpmath.diff(energy, tuple(point), tuple(int(i == j) for j in range(4))) for i in range(4)]
    power = u[0] * x[1] + u[1] * x[3] - plant.C_phi * x[1] ** 2 - plant.C_psi * x[3] ** 2
    change = float(mpmath.fdot(gradient, rate))
    # What cancels inside an acceleration leaves its rounding: forces times speeds count too.
    forces = (u[0], plant.C_phi * x[1], plant.G_c, plant.G_s, u[1], plant.C_psi * x[3], plant.K_psi * x[2])
    size = (
        float(sum(abs(g * r) for g, r in zip(gradient, rate))) + sum(map(abs, forces)) * (abs(x[1]) + abs(x[3])) + 1e-12
    )
    assert abs(change - power) <= 1e-12 * size
    assert np.isclose(plant.energy(x), float(energy(*point)), rtol=1e-12, atol=1e-12)


@settings(max_examples=20, deadline=None)
@given(states)
def test_energy_is_conserved_without_friction_and_torque(x0):
    plant = tras.PlantParameters(C_phi=0, C_psi=0)
    energy = plant.energy(tras.simulate_plant(x0, np.zeros((301, 2)), 0.01, plant))
    assert np.ptp(energy) <= 1e-9 * (1 + np.abs(energy).max())


@given(plants(), states, torques)
def test_the_printed_term_breaks_the_energy_balance(plant, x, u):
    """By exactly J/2 (psidot^2 - psi^2) phidot sin 2 phi; only the pitch acceleration differs."""
    printed = tras.PrintedPlant(**plant.as_dict())
    rate, correct = tras.vector_field(x, u, printed), tras.vector_field(x, u, plant)
    phi, phidot, psi, psidot = x
    gained = plant.J / 2 * (psidot**2 - psi**2) * phidot * math.sin(2 * phi)
    size = 1 + np.abs([correct[1], rate[1]]).max() * plant.J_phi * abs(phidot)
    assert plant.J_phi * phidot * (rate[1] - correct[1]) == pytest.approx(gained, rel=1e-9, abs=1e-12 * size)
    assert np.array_equal(rate[[0, 2, 3]], correct[[0, 2, 3]])


@pytest.mark.parametrize("kind, gains", [(tras.PlantParameters, False), (tras.PrintedPlant, True)])
def test_the_printed_term_creates_energy_round_a_closed_path(kind, gains):
    """Held by hand along pitch up at yaw 0, yaw to 2, pitch down there, yaw back: the hand's work must be zero."""
    plant = kind(C_phi=0, C_psi=0)
    corners = np.array([[-0.8, 0.0], [0.8, 0.0], [0.8, 2.0], [-0.8, 2.0], [-0.8, 0.0]])
    path = np.vstack([np.linspace(a, b, 2001) for a, b in zip(corners, corners[1:])])
    path[:, 0] += 0.4  # not symmetric about phi = 0
    x = np.zeros((len(path), 4))
    x[:, [0, 2]] = path
    force = tras.vector_field(x, np.zeros((len(x), 2)), plant)[:, [1, 3]]
    force *= np.column_stack(
        [np.full(len(x), plant.J_phi), plant.J * np.cos(x[:, 0]) ** 2 + plant.J_psi0]
    )  # by the rig, at rest
    work = np.sum((force[1:] + force[:-1]) / 2 * np.diff(path, axis=0))
    expected = plant.J / 2 * 2.0**2 * (math.sin(1.2) ** 2 - math.sin(-0.4) ** 2) if gains else 0.0
    assert work == pytest.approx(expected, abs=1e-7) and (work > 0.03) == gains


def test_the_printed_plant_says_so_and_the_corrected_one_is_unchanged():
    assert "velocity_term" not in tras.PlantParameters().as_dict()
    assert tras.PrintedPlant().as_dict() == {**tras.PlantParameters().as_dict(), "velocity_term": "as_printed"}
    reference = tras.multisine(20, 0.01, [1.0, 1.0], [0.5, 2.0], np.random.default_rng(0))
    printed, correct = (
        tras.simulate_closed_loop(reference, 0.01, plant) for plant in (tras.PrintedPlant(), tras.PlantParameters())
    )
    assert printed.attributes["plant_velocity_term"] == "as_printed" and "plant_velocity_term" not in correct.attributes
    assert np.abs(printed.states - correct.states).max() > 0.01


@pytest.mark.slow
def test_equations_are_lagranges():
    """The function that simulates, fed with sympy symbols, solves Lagrange's equations derived here from T and V."""
    t, u_phi, u_psi = sympy.symbols("t u_phi u_psi")
    phi, psi = sympy.Function("phi")(t), sympy.Function("psi")(t)
    names = "m_m m_t m_cw l_m l_t l_cw J_x J_z C_phi C_psi K_psi g"
    m_m, m_t, m_cw, l_m, l_t, l_cw, J_x, J_z, C_phi, C_psi, K_psi, g = sympy.symbols(names, positive=True)
    c, s = sympy.cos(phi), sympy.sin(phi)
    beam, levers = m_m * l_m**2 + m_t * l_t**2, 2 * m_cw * l_cw**2
    T = (beam + levers + J_x) * phi.diff(t) ** 2 / 2 + (beam * c**2 + levers * s**2 + J_z) * psi.diff(t) ** 2 / 2
    V = g * (m_m * l_m - m_t * l_t) * s - 2 * g * m_cw * l_cw * c + K_psi * psi**2 / 2

    class Lumped:  # what PlantParameters.from_masses computes, in symbols
        J, J_psi0, J_phi = beam - levers, levers + J_z, beam + levers + J_x
        G_c, G_s = g * (m_m * l_m - m_t * l_t), 2 * g * m_cw * l_cw

    Lumped.C_phi, Lumped.C_psi, Lumped.K_psi = C_phi, C_psi, K_psi
    accelerations = equations_of_motion(Lumped, sympy)(phi, phi.diff(t), psi, psi.diff(t), u_phi, u_psi)
    for q, u, C in ((phi, u_phi, C_phi), (psi, u_psi, C_psi)):
        lagrange = (T - V).diff(q.diff(t)).diff(t) - (T - V).diff(q) - u + C * q.diff(t)
        residual = lagrange.subs({phi.diff(t, 2): accelerations[0], psi.diff(t, 2): accelerations[1]})
        assert sympy.simplify(residual) == 0


@given(plants(), states, torques, st.booleans())
def test_jacobian_matches_complex_step(plant, x, u, printed):
    """The complex step has no cancellation: derivatives to working precision."""
    plant = tras.PrintedPlant(**plant.as_dict()) if printed else plant
    A, B = tras.jacobian(x, u, plant)
    field = equations_of_motion(plant, np)
    exact = np.zeros((4, 6))
    for i in range(6):
        point = np.array([*x, *u], dtype=complex)
        point[i] += 1e-30j
        exact[:, i] = np.imag([point[1], field(*point)[0], point[3], field(*point)[1]]) / 1e-30
    assert np.allclose(np.hstack([A, B]), exact, rtol=1e-9, atol=1e-9 * (1 + np.abs(exact).max()))


LIMITS = np.array([[-0.144, -0.241], [0.207, 0.140]])


def dop853(x0, held, dt, plant):
    """States at the samples, restarted at each, where the torques jump."""
    accelerations = equations_of_motion(plant, math)
    states = [np.asarray(x0, dtype=float)]
    for u in held[:-1].tolist():

        def rates(t, x, u=u):
            x = x.tolist()
            phiddot, psiddot = accelerations(*x, *u)
            return x[1], phiddot, x[3], psiddot

        states.append(
            solve_ivp(rates, (0, dt), states[-1], method="DOP853", rtol=1e-12, atol=1e-13, max_step=0.01).y[:, -1]
        )
    return np.array(states)


def random_runs(seed, count):
    """(name, x0, torques for 6 s at 0.01 s): initial rates of 3 and 10 rad/s; random, bang-bang, constant torques."""
    rng = np.random.default_rng(seed)
    for i in range(count):
        rate = (3, 10)[i % 2]
        x0 = rng.uniform([-1.2, -rate, -3, -rate], [1.2, rate, 3, rate])
        kind = ("random", "bang-bang", "constant", "bang-bang every 0.5 s")[i // 2 % 4]
        if kind == "random":
            held = rng.uniform(*LIMITS, (601, 2))
        elif kind == "constant":
            held = np.tile(rng.uniform(*LIMITS), (601, 1))
        else:
            hold = 1 if kind == "bang-bang" else 50
            held = np.repeat(np.where(rng.random((601 // hold + 1, 2)) < 0.5, *LIMITS), hold, axis=0)[:601]
        yield f"{i}: {kind}, {rate} rad/s", x0, held


RNG = np.random.default_rng(5)
START = [0.3, 0.5, 1.0, 3.0]
SIX_SECONDS = {
    "full torque, yaw spins at 17 rad/s": (0.01, START, np.tile([0.207, -0.241], (601, 1))),
    "full torque the other way": (0.01, START, np.tile([-0.144, 0.140], (601, 1))),
    "smooth": (
        0.01,
        START,
        np.column_stack([0.03 + 0.1 * np.sin(0.02 * np.arange(601)), 0.1 * np.sin(0.013 * np.arange(601))]),
    ),
    "slow sampling": (0.2, START, RNG.uniform(*LIMITS, (31, 2))),
    "yaw spins up as the beam rises": (0.01, [-1, 0, 0, 10], np.tile([0.1, -0.2], (601, 1))),
    "constant, 5 rad/s": (0.01, [0.5, 1, 0, 5], np.tile([-0.144, -0.241], (601, 1))),
    "one hold of 6 s": (6.0, START, np.tile([0.207, -0.241], (2, 1))),
    **{f"holds of 1 s {name}": (1.0, x0, held[::100]) for name, x0, held in random_runs(1, 16)},
    **{name: (0.01, x0, held) for name, x0, held in random_runs(2, 16)},
}


@pytest.mark.parametrize("case", SIX_SECONDS)
def test_integrator_against_dop853(case, parameters):
    dt, x0, held = SIX_SECONDS[case]
    error = tras.simulate_plant(x0, held, dt, parameters) - dop853(x0, held, dt, parameters)
    assert np.abs(error).max() <= 1e-9


def test_speed_that_grows_inside_a_long_sample(parameters):
    """Ten times the torque of the rig, from rest, held for 1.5 s: far outside the promise, but no nonsense."""
    x0, held = [0, 0, 0, 0], np.full((2, 2), 2.0)
    ours = tras.simulate_plant(x0, held, 1.5, parameters)
    assert np.abs(ours[-1]).max() > 50
    assert np.abs(ours - dop853(x0, held, 1.5, parameters)).max() <= 1e-8


def test_where_dop853_itself_is_wrong_by_more_than_1e_9(parameters, monkeypatch):
    """This motion magnifies a disturbance 100000 times in 6 s, and DOP853 at rtol 1e-12 pays for it."""
    _, x0, held = list(random_runs(0, 111))[110]
    ours, disturbed = (tras.simulate_plant(x, held, 0.01, parameters) for x in (x0, x0 + [1e-8, 0, 0, 0]))
    assert np.abs(disturbed - ours).max() > 1e-8 * 1e4
    monkeypatch.setattr(tras.twin_rotor.plant, "_SPEED", 0.5)  # steps a quarter as long
    fine = tras.simulate_plant(x0, held, 0.01, parameters)
    assert np.abs(dop853(x0, held, 0.01, parameters) - fine).max() > 1e-9
    assert np.abs(ours - fine).max() <= 1e-9


def test_an_ordinary_sample_is_one_step(parameters, monkeypatch):
    """What makes 500 s of closed loop simulate in half a second: seven evaluations a sample."""
    states = tras.simulate_plant([-0.4, 0.5, 1.0, 1.2], np.zeros((501, 2)), 0.01, parameters)
    assert np.abs(states[:, [1, 3]]).max() < 1.3
    cos, calls = math.cos, []
    monkeypatch.setattr(math, "cos", lambda angle: calls.append(angle) or cos(angle))
    advance = stepper(parameters, 0.01)
    for x in states.tolist():
        advance(x, (0.0, 0.0))
    assert len(calls) == 7 * len(states)


@pytest.mark.parametrize("torque", [1e4, 1e8, 1e200, 1e308])
@pytest.mark.parametrize("batch", [(), (3,)])
def test_a_run_that_blows_up_is_named(torque, batch, parameters):
    with pytest.raises(ValueError, match="left the representable range.*reduce the torques"):
        tras.simulate_plant(np.zeros((*batch, 4)), np.full((1001, 2), torque), 0.01, parameters)


def test_integrator_is_of_order_six(parameters, monkeypatch):
    monkeypatch.setattr(tras.twin_rotor.plant, "_SPEED", 1e3)  # no step is shortened
    x0, held = [-0.45, 0.02, 0.1, 0.02], np.tile([-0.001, 0.0005], (6, 1))
    exact = tras.simulate_plant(x0, held, 0.4, parameters, step=0.01)
    errors = [np.abs(tras.simulate_plant(x0, held, 0.4, parameters, step=h) - exact).max() for h in (0.4, 0.2)]
    assert 5.5 <= np.log2(errors[0] / errors[1]) <= 6.8


def test_many_rigs_at_once_equal_one_after_the_other(parameters):
    x0 = RNG.uniform(-1, 1, (3, 4))
    held = RNG.uniform(-0.1, 0.1, (3, 50, 2))
    together = tras.simulate_plant(x0, held, 0.01, parameters)
    alone = [tras.simulate_plant(x, u, 0.01, parameters) for x, u in zip(x0, held)]
    assert together.shape == (3, 50, 4)
    assert np.allclose(together, alone, rtol=0, atol=1e-13)


def test_rest_point_rests(parameters):
    rest = tras.rest_point(parameters)
    assert rest[0] == pytest.approx(-0.491, abs=5e-4)
    assert np.allclose(tras.vector_field(rest, [0, 0], parameters), 0, atol=1e-15)
    under_torque = tras.rest_point(parameters, (0.05, 0.003))
    assert np.allclose(tras.vector_field(under_torque, (0.05, 0.003), parameters), 0, atol=1e-15)
    A, _ = tras.jacobian(rest, [0, 0], parameters)
    pairs = sorted({(round(abs(w), 2), round(-w.real / abs(w), 2)) for w in np.linalg.eigvals(A)})
    assert pairs == [(0.37, 0.37), (1.88, 0.11)]  # rad/s and damping of yaw and pitch


def test_masses_lump_to_the_parameters(parameters):
    masses = parameters.masses()
    rounded = {"m_m": 0.32306, "m_t": 0.27850, "m_cw": 0.01908, "J_x": 0.001497, "J_z": 0.000624}
    assert all(masses[name] == pytest.approx(value, rel=5e-4) for name, value in rounded.items())
    again = tras.PlantParameters.from_masses(
        **masses, C_phi=parameters.C_phi, C_psi=parameters.C_psi, K_psi=parameters.K_psi
    )
    assert np.allclose([*again.as_dict().values()][:8], [*parameters.as_dict().values()][:8], rtol=1e-13)


@pytest.mark.parametrize(
    "call, words",
    [
        (lambda p: tras.PlantParameters(J_phi=0), "J_phi is 0"),
        (lambda p: tras.PlantParameters(C_phi=-1), "C_phi is -1.*negative"),
        (lambda p: tras.PlantParameters(G_c=float("nan")), "G_c is nan"),
        (lambda p: tras.PlantParameters(K_psi="0.003"), "K_psi is '0.003'"),
        (lambda p: tras.PlantParameters(u_phi_limits=(1, 0)), "u_phi_limits"),
        (lambda p: tras.PlantParameters(u_phi_limits=0.2), "u_phi_limits is 0.2; give .lowest, highest."),
        (lambda p: tras.PlantParameters(u_psi_limits=(0, np.inf)), "u_psi_limits is .0, inf."),
        (lambda p: tras.rest_point(tras.PlantParameters(G_c=0, G_s=0)), "G_c and G_s are both 0"),
        (lambda p: tras.rest_point(p, (np.nan, 0)), "torques holds NaN"),
        (lambda p: tras.vector_field([0, 0, 0], [0, 0], p), "x has shape .3,."),
        (lambda p: tras.vector_field([0, 0, 0, 0], [0], p), "u has shape .1,."),
        (lambda p: tras.simulate_plant([0, 0, 0, np.nan], [[0, 0]], 0.01, p), "x0 holds NaN"),
        (lambda p: tras.simulate_plant([0, 0, 0, 0], [0, 0], 0.01, p), "torques has shape"),
        (lambda p: tras.simulate_plant([0, 0, 0, 0], [[0, 0]], 0, p), "dt is 0"),
        (lambda p: tras.simulate_plant([0, 0, 0, 0], [[0, 0]], 0.01, p, step=-1), "step is -1"),
        (lambda p: tras.rest_point(p, (1.0, 0)), "u_phi = 1.0 N m has no rest point"),
        (lambda p: tras.rest_point(tras.PlantParameters(K_psi=0), (0, 0.1)), "u_psi = 0.1 N m has no rest point"),
    ],
)
def test_mistakes_are_named(call, words, parameters):
    with pytest.raises(ValueError, match=words):
        call(parameters)
