"""Van der Pol, Lorenz and the slow manifold: is the vector field of a known system recovered?

The Lorenz experiment is that of the lifting method's public code (GitHub ``AlexMauroy/Koopman-identification``, commit
``ed9d808``, ``main/matlab/example_main_Lorenz.m``; A. Mauroy, J. Goncalves, IEEE Trans. Autom. Control 65, 2020, 2550):
20 runs of 15 steps of 1/30 s from the cube of half-width 20, a dictionary of degree 3. Its error measure and its noise,
which multiplies each measurement, serve for all three.
"""

import numpy as np
import pandas as pd
from scipy.integrate import solve_ivp

from tras.dictionaries.monomials import Monomials
from tras.identification.refinement import refine
from tras.model import KoopmanModel
from tras.recording import Recording
from tras.workflow.study import each

SLOW, FAST = -0.05, -1.0


def van_der_pol(x: np.ndarray) -> np.ndarray:
    """x1' = x2, x2' = (1 - x1^2) x2 - x1."""
    return np.stack([x[..., 1], (1 - x[..., 0] ** 2) * x[..., 1] - x[..., 0]], axis=-1)


def lorenz(x: np.ndarray) -> np.ndarray:
    """sigma 10, rho 28, beta 8/3: chaotic."""
    a, b, c = np.moveaxis(x, -1, 0)
    return np.stack([10 * (b - a), a * (28 - c) - b, a * b - 8 / 3 * c], axis=-1)


def slow_manifold(x: np.ndarray) -> np.ndarray:
    """x1' = mu x1, x2' = lambda (x2 - x1^2), mu -0.05, lambda -1 (S. Brunton et al., PLoS ONE 11, 2016, e0150171)."""
    return np.stack([SLOW * x[..., 0], FAST * (x[..., 1] - x[..., 0] ** 2)], axis=-1)


# Vector field, number of states, degree of the monomials, half-width of the initial states, sampling time in s.
SYSTEMS = {
    "Van der Pol": (van_der_pol, 2, 3, 2.0, 0.1),
    "Lorenz": (lorenz, 3, 3, 20.0, 1 / 30),
    "slow manifold": (slow_manifold, 2, 2, 1.0, 0.1),
}


def system_recording(name: str, trajectories: int, samples: int, noise: float, seed: int) -> Recording:
    """Free motion of one of `SYSTEMS` from random states, by DOP853, tight; noise in percent of each value."""
    field, n, _, half, dt = SYSTEMS[name]
    rng = np.random.default_rng(seed)
    times = dt * np.arange(samples)
    starts = rng.uniform(-half, half, (trajectories, n))
    options = {"method": "DOP853", "t_eval": times, "rtol": 1e-12, "atol": 1e-12}
    runs = [solve_ivp(lambda t, x: field(x), (0, times[-1]), x, **options).y.T for x in starts]
    measured = [x * (1 + noise / 100 * rng.standard_normal(x.shape)) for x in runs]
    return Recording(measured, np.empty((trajectories, samples, 0)), dt)


def coefficient_error(field, name: str) -> float:
    """Root mean square error of a field's coefficients of the monomials, in percent of the mean size of those not zero.

    ``field`` is a polynomial of the degree that `SYSTEMS` names, so its values at points of the box give them exactly.
    """
    exact_field, n, degree, half, _ = SYSTEMS[name]
    dictionary = Monomials(degree)
    z = np.random.default_rng(0).uniform(-1, 1, (500, n))
    functions, size = dictionary(z), dictionary(np.full((1, n), half)).T
    identified, exact = (np.linalg.lstsq(functions, f(half * z), rcond=None)[0] / size for f in (field, exact_field))
    exact[np.abs(exact) < 1e-9] = 0
    return 100 * np.sqrt(np.mean((identified - exact) ** 2)) / np.abs(exact[exact != 0]).mean()


def benchmark_study(trajectories: int, samples: int, noises, seeds, *, processes: int = 1) -> pd.DataFrame:
    """How well fields come back, by the lifting method (EDMD with the logarithm) and refined.

    Returns
    -------
    pandas.DataFrame
        ``system, noise`` (%), ``method`` ("lifting" or "refined"), ``degree, functions, pairs, sampling_time`` (s); the
        median over the seeds of ``coefficient_error`` (%, see there) and of ``eigenvalue_error``, the largest relative
        error of mu, lambda and 2 mu in percent (of the slow manifold by lifting; NaN elsewhere).
    """
    cases = [(name, noise) for name in SYSTEMS for noise in noises]
    runs = [(*case, seed) for case in cases for seed in seeds]
    errors = each(_errors, [(name, trajectories, samples, *rest) for name, *rest in runs], processes=processes)
    rows = []
    for (name, noise), of_seeds in zip(cases, np.reshape(errors, (len(cases), len(seeds), 3))):
        _, n, degree, _, dt = SYSTEMS[name]
        functions = len(Monomials(degree).fit(np.zeros((1, n))).names)
        about = {"degree": degree, "functions": functions, "pairs": trajectories * (samples - 1), "sampling_time": dt}
        lifting, refined, eigenvalues = np.median(of_seeds, axis=0)
        for method, error, of_eigenvalues in (("lifting", lifting, eigenvalues), ("refined", refined, np.nan)):
            case = {"system": name, "noise": noise, "method": method, **about}
            rows.append({**case, "coefficient_error": error, "eigenvalue_error": of_eigenvalues})
    return pd.DataFrame(rows)


def _errors(name, *simulation):
    """Coefficients' error by lifting and refined, and the eigenvalues'."""
    recording = system_recording(name, *simulation)
    model = KoopmanModel(Monomials(SYSTEMS[name][2]), regularization=None, extrapolation="functions").fit(recording)
    models = model, refine(model, recording, segment=recording.lengths[0])
    eigenvalue_error = np.nan
    if name == "slow manifold":
        rates = np.log(model.eigenvalues) / model.dt_
        eigenvalue_error = 100 * max(np.abs(rates - rate).min() / abs(rate) for rate in (SLOW, FAST, 2 * SLOW))
    return [*(coefficient_error(fitted.vector_field, name) for fitted in models), eigenvalue_error]
