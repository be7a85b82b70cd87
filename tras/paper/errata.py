"""The paper's errors and our repairs, each with a computation that shows the error; `table` computes them all."""

import math
from dataclasses import replace

import numpy as np
import pandas as pd

from tras.dictionaries.monomials import Monomials
from tras.generator import LogarithmError, principal_logarithm
from tras.koopman import koopman_matrix
from tras.metrics import bfr
from tras.recording import Recording
from tras.twin_rotor.plant import PlantParameters, PrintedPlant, rest_point, simulate_plant, vector_field
from tras.workflow import files


def _below(value):
    """A rounding error in words that do not depend on the processor."""
    return f"less than {10.0 ** max(-12, math.ceil(math.log10(value or 1e-99))):.0e}"


def swapped_sides():
    """Gravity, u_phi and the weight of the beam in the equation of psi would turn the rig about its vertical axis."""
    p = PlantParameters()
    printed = -p.G_c / p.J_phi  # the printed right-hand side of psiddot at rest, level, no torque
    ours = float(vector_field(np.zeros(4), np.zeros(2), p)[3])
    text = (
        f"at rest, level and without torque the printed equation for ψ̈ gives {printed:.3g} rad/s²: "
        f"gravity would turn the rig about the vertical; ours gives {ours:g}"
    )
    return text, abs(printed) > 1 and ours == 0


def energy_gained(plant, seconds=20.0):
    """Largest change of the energy in a free motion without friction and spring, and its start above rest, in J."""
    frictionless = replace(plant, C_phi=0.0, C_psi=0.0, K_psi=0.0)
    start = rest_point(frictionless) + [0.8, 0.0, 1.0, 1.0]
    states = simulate_plant(start, np.zeros((round(seconds / 0.01) + 1, 2)), 0.01, frictionless)
    energy = PlantParameters.energy(frictionless, states)
    at_rest = float(PlantParameters.energy(frictionless, rest_point(frictionless)))
    return float(np.abs(energy - energy[0]).max()), float(energy[0] - at_rest)


def velocity_term():
    """The printed term is no torque of any potential: without friction the energy must stay, and does not."""
    (printed, whole), (ours, _) = energy_gained(PrintedPlant()), energy_gained(PlantParameters())
    text = (
        f"a free motion without friction or spring must keep its energy, {whole:.2g} J above rest: with the printed "
        f"term it changes by up to {printed:.2g} J within 20 s, with ours by {_below(ours)} J"
    )
    return text, printed > 0.1 * whole and ours < 1e-9 * whole


def first_power():
    """A moment of inertia must not depend on the unit of length that it is computed in."""
    masses = PlantParameters().masses()

    def inertia(power, unit):  # in kg m^2, computed with lengths in `unit` metres
        main, tail, weight = (masses[name] / unit for name in ("l_m", "l_t", "l_cw"))
        sum_of_rotors = masses["m_m"] * main**2 + masses["m_t"] * tail**2
        return (sum_of_rotors + 2 * masses["m_cw"] * weight**power + masses["J_x"] / unit**2) * unit**2

    printed, ours = [[inertia(power, unit) for unit in (1.0, 1e-3)] for power in (1, 2)]
    text = (
        f"computed in metres the printed J_φ is {printed[0]:.4g} kg m², computed in millimetres {printed[1]:.4g} "
        f"kg m²; ours is {ours[0]:.4g} in both"
    )
    return text, abs(printed[0] / printed[1] - 1) > 0.01 and math.isclose(*ours, rel_tol=1e-12)


def names_of_angles():
    """Gravity lifts and lowers pitch; yaw turns about the vertical and feels none."""
    plant, steps = PlantParameters(), 1e-6 * np.eye(4)[[0, 2]]  # level: all four states are zero
    pitch, yaw = ((plant.energy(step) - plant.energy(-step)) / 2e-6 for step in steps)
    text = (
        f"gravity's torque in the level position is {-pitch:.3g} N m on φ and {-yaw + 0.0:.3g} on ψ: "
        "φ is the angle that goes up and down"
    )
    return text, abs(pitch) > 1e-2 and abs(yaw) < 1e-9


def lost_dots():
    """Two angles, each twice, are two states."""
    x = np.random.default_rng(0).standard_normal((100, 2))
    rank = int(np.linalg.matrix_rank(np.repeat(x, 2, axis=1)))
    return f"as printed, the vector holds each angle twice: 100 samples of it have rank {rank} instead of 4", rank == 2


def best_fit_ratio():
    """Without ``1 -`` the worst model has the best ratio."""
    x = np.sin(np.linspace(0, 10, 1000))
    norm, errors = np.linalg.norm(x - x.mean()), (0.0, 0.5, 2.0)
    printed = [100 * max(np.linalg.norm(error * x) / norm, 0) for error in errors]
    ours = [float(bfr(x[:, None], (1 - error) * x[:, None])[0]) for error in errors]
    text = (
        "a perfect prediction, one half off and one that is twice off have {:.3g}, {:.3g} and {:.3g} % as printed, "
        "and {:.3g}, {:.3g} and {:.3g} % here"
    ).format(*printed, *ours)
    return text, printed == sorted(printed) and ours == sorted(ours, reverse=True) and ours[0] == 100


def logarithm():
    """Eigenvalues with a negative real part have a principal logarithm; only the closed negative real axis has not."""
    angle = 0.75 * np.pi
    K = 0.9 * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    residual = principal_logarithm(K)[1]
    try:
        principal_logarithm(np.diag([-0.5, 0.5]))
        refused = False
    except LogarithmError:
        refused = True
    text = (
        f"a K with the eigenvalues {0.9 * np.cos(angle):.2f} ± {0.9 * np.sin(angle):.2f}i, real part negative, "
        f"has one: exp(log K) misses K by {_below(residual)}. One with the eigenvalue -0.5 has none, and is refused"
    )
    return text, residual < 1e-12 and refused


def one_vector():
    """(18) has N equations per point for n unknowns, F there: one F for all points would be a constant field."""
    n, N, points = 4, 9, 50_000
    text = (
        f"read as one vector, (18) gives {n} numbers, the same velocity everywhere; a field F = W ψ of {N} functions "
        f"has {n} x {N} = {n * N} coefficients, and {points} points give {N * points} equations for them"
    )
    return text, n < n * N < N * points


def same_input():
    """If the input of the second row is the next one, K has to predict inputs, and the generator acts on them."""
    rng = np.random.default_rng(0)
    u = np.cumsum(rng.standard_normal((20, 100, 1)), axis=1)
    x = np.zeros((20, 100, 1))
    for k in range(99):
        x[:, k + 1] = 0.9 * x[:, k] + 0.1 * u[:, k]
    psi = Monomials(1).fit(x.reshape(-1, 1), u.reshape(-1, 1))
    ours = koopman_matrix(psi, Recording(x, u, 0.1))[0]
    before, after = psi(x[:, :-1], u[:, :-1]).reshape(-1, 3), psi(x[:, 1:], u[:, 1:]).reshape(-1, 3)
    other = np.linalg.lstsq(before, after, rcond=None)[0]
    same, following = [float(np.abs(K[:, 2] - [0, 0, 1]).max()) for K in (ours, other)]
    text = (
        f"with the next input in the second row K moves the input by {following:.2g} of itself in a sample, "
        f"in this random walk; with the same one by {_below(same)}"
    )
    return text, same < 1e-12 < 1e-3 < following


def samples():
    """Trajectories that share end points."""
    apart, shared = 100 * 501, 100 * 501 - 99
    text = f"100 x 501 = {apart} samples are not 50001; 100 pieces that share their end points are: "
    return text + f"100 x 501 - 99 = {shared}", shared == 50001


def six_seconds():
    """A window of 6 s does not fit into a trajectory of 501 samples at 0.01 s."""
    lasts, needed = 500 * 0.01, round(6 / 0.01) + 1
    text = f"a trajectory of 501 samples at 0.01 s lasts {lasts:g} s, so a window of 6 s needs {needed} samples"
    return text, lasts < 6


def additivity():
    """An operator on observables takes one observable: the sum of two, which (3) splits."""
    x, (a, b) = np.linspace(-2, 2, 101), (2.0, -3.0)

    def koopman(observable):  # of the flow x -> 0.9 x - 0.1 x^3
        return observable(0.9 * x - 0.1 * x**3)

    error = float(
        np.abs(koopman(lambda y: a * np.sin(y) + b * y**2) - a * koopman(np.sin) - b * koopman(np.square)).max()
    )
    try:
        koopman(np.sin, np.square)
        refused = False
    except TypeError:
        refused = True
    text = f"along a cubic map both sides of (3) differ by {_below(error)} with the plus; a comma gives two observables"
    return text, error < 1e-12 and refused


def size_of_a_pair():
    """The two rows of a snapshot pair hold a state and an input each."""
    n, m = 4, 2
    pair = np.stack([np.concatenate([np.zeros(n), np.zeros(m)])] * 2)
    text = f"two rows of {n} states and {m} inputs are {pair.size} numbers; as printed there would be {n * m * 2}"
    return text, pair.size == (n + m) * 2 != n * m * 2


def counterweights():
    """Masses at the two ends of the beam lift with sin phi, a weight below its axis with -cos phi."""
    masses = PlantParameters().masses()
    plant, phi = PlantParameters.from_masses(**masses, C_phi=0.0, C_psi=0.0, K_psi=0.0), np.linspace(-1, 1, 101)
    energy = plant.energy(phi[:, None] * [1, 0, 0, 0])

    def miss(main, tail, below):  # of the potential energy of point masses there, in J
        ends = (main * masses["l_m"] - tail * masses["l_t"]) * np.sin(phi)
        return float(np.abs(masses["g"] * (ends - 2 * below * masses["l_cw"] * np.cos(phi)) - energy).max())

    rotors, weight = (masses["m_m"], masses["m_t"]), masses["m_cw"]
    ours, printed = miss(*rotors, weight), miss(weight, weight, sum(rotors) / 2)
    text = (
        f"with m_m and m_t at the ends of the beam and m_cw below it, point masses have the plant's energy to "
        f"{_below(ours)} J; with m_m and m_t as the counterweights they miss it by up to {printed:.2g} J"
    )
    return text, ours < 1e-12 and printed > 0.1


# What is quoted, the number printed there, the equation with that content.
REFERENCES = (
    ("solving", 12, 10), ("lift every pair in accordance with", 10, 7), ("invert", 6, 5), ("found using", 5, 4),
    ("the finite equivalent of", 17, 16), ("such that … holds", 18, 17), ("the least-square solution to", 18, 17),
)  # fmt: skip


def references():
    """What each reference builds on, by its content."""
    listed = "; ".join(f"“{quote}” ({printed}) is ({meant})" for quote, printed, meant in REFERENCES)
    return f"by their content, {len(REFERENCES)} references name a later equation than they use: {listed}", None


# What is printed, what stands here, why, and the computation that shows it.
ERRORS = (
    ("the two left-hand sides ψ̈, φ̈", "swapped", "u_φ, C_φ, K_g belong to pitch; K_ψ, J_ψ to yaw", swapped_sides),
    ("J ψ²/2 sin 2φ", "J ψ̇²/2 sin 2φ", "units; the printed form creates energy", velocity_term),
    ("2 m_cw l_cw in J_ψ, J_φ, J", "2 m_cw l_cw²", "kg m against kg m²; the first power is right in K_g only",
     first_power),
    ("“φ azimuth, ψ pitch”, “yaw angle (φ), pitch angle (ψ)”", "φ is pitch, ψ is yaw", "gravity and cos² act on φ",
     names_of_angles),
    ("x = [φ φ ψ ψ]", "[φ φ̇ ψ ψ̇]", "lost dots", lost_dots),
    ("BFR (20) without “1 −”", "100 max(1 − ‖x − x̂‖/‖x − x̄‖, 0)", "as printed, larger is worse", best_fit_ratio),
    ("logarithm needs eigenvalues “with non-negative real components”",
     "no eigenvalue on the closed negative real axis",
     "the definition (Higham, *Functions of Matrices*, Thm. 1.31)", logarithm),
    ("(18) as a single vector", "solved for the matrix W of F(x, u) = W ψ(x, u)", "dimensions", one_vector),
    ("snapshot pair (x_k, u_k) : (y_k, u_k)", "the same u_k in both rows, y_k the flow over Ts",
     "so that the generator does not act on u", same_input),
    ("501 steps x 100 trajectories (50100)", "100 pieces of 501 that share end points: 50001 samples, 50000 pairs",
     "the count", samples),
    ("Fig. 3 “6-second window”, 5 s trajectories", "both: 5 s for fitting, 6 s windows for validation",
     "conflict in the text", six_seconds),
    ("(3) with a comma, and with K_t", "K^t(λ₁β₁ + λ₂β₂)", "linearity is of a sum; (2) calls the operator K^t",
     additivity),
    ("pairs in R^{(n × m) × 2}", "R^{(n + m) × 2}", "dimensions", size_of_a_pair),
    ("“masses of counter weights at the main rotor and tail rotor” m_m, m_t",
     "masses of the rotors; m_cw is the counterweight's", "K_g and the inertias", counterweights),
    ("cross references before (11), (13), (15) and at (16) to (18)", "by content", "copied numbering", references),
)  # fmt: skip


def table() -> pd.DataFrame:
    """All errors with their evidence, computed now.

    Returns
    -------
    pandas.DataFrame
        Columns ``printed, here, why, evidence`` (a sentence with its numbers) and ``shown`` (whether the computation
        shows the error; None where there is nothing to compute).
    """
    rows = []
    for *texts, show in ERRORS:
        evidence, shown = show()
        rows.append((*texts, evidence, None if shown is None else bool(shown)))
    return pd.DataFrame(rows, columns=["printed", "here", "why", "evidence", "shown"])


def markdown(errors: pd.DataFrame | None = None) -> str:
    """The table as Markdown, computed now if it is not at hand."""
    errors = table() if errors is None else errors
    rows = errors[["printed", "here", "why", "evidence"]].itertuples(index=False)
    return files.markdown_table([("as printed", "here", "why", "shown by computing"), *rows])
