"""Coefficients of the states in extended precision: what each method should have found on the same lifted rows."""

import hashlib
import sys
from pathlib import Path

import numpy as np
from scipy import linalg

from benchmarks.bench.data import problems, save
from tras.solver import least_squares as leastsquares

sys.path.append(str(Path(__file__).resolve().parent.parent.parent / "tests" / "solver"))
from test_least_squares import add, columnwise, product  # noqa: E402

ROWS = 4096
MOST = 8  # rounds of refinement; three serve where our own solver is good to five digits


def coefficients(folder, cache):
    """(N, n) of plain least squares ``psi(y, u) ~ psi(x, u) K``, states' columns; ``cache`` keeps it by content.

    The rows are doubles, lifted once; residuals and their products with the rows are summed in double-double, the
    correction is solved in double with our own triangular factor (`tests/solver/test_least_squares.py` verifies both).

    Raises
    ------
    RuntimeError
        If the refinement does not end: the functions are too nearly dependent on these data.
    """
    problem = problems.read(folder)
    content = hashlib.sha256(b"".join(array.tobytes() for array in (problem.values, problem.states, problem.inputs)))
    path = Path(cache) / f"{problem.functions}-{content.hexdigest()[:16]}.npy"
    if not path.is_file():
        path.parent.mkdir(parents=True, exist_ok=True)
        save(path, refined(problem))
    return np.load(path)


def refined(problem):
    """As `coefficients`, computed; memory: some chunks of rows."""
    before, after = problems.pairs(problem)
    columns = slice(1, 1 + problem.n)
    targets = after[:, : problem.n] - before[:, : problem.n]  # of K - I, as everywhere in this package

    def chunks(step=ROWS):
        for k in range(0, len(before), step):
            yield problems.lift(problem, before[k : k + step]), targets[k : k + step]

    step = max(1, len(before) // max(ROWS, 4 * problem.functions))
    dealt = ((problems.lift(problem, before[k::step]), targets[k::step]) for k in range(step))
    R = leastsquares.least_squares(dealt).R
    scale = np.ldexp(1.0, -np.frexp(np.linalg.norm(R, axis=0))[1])  # powers of two: exact
    R = R * scale
    Z = (np.zeros((problem.functions, problem.n)),) * 2
    for _ in range(MOST):
        gradient = (np.zeros_like(Z[0]),) * 2
        for psi, y in chunks():
            psi *= scale
            residual = add((y, 0.0), tuple(-part for part in product(psi, Z)))
            gradient = add(gradient, product(np.ascontiguousarray(psi.T), residual))
        change = linalg.solve_triangular(R, linalg.solve_triangular(R, gradient[0], trans="T"))
        Z = add(Z, (change, 0.0))
        if np.all(np.abs(change).max(axis=0) <= 1e-13 * np.abs(Z[0]).max(axis=0)):
            K = Z[0] * scale[:, None]
            K[columns] += np.eye(problem.n)
            return K
    raise RuntimeError(
        f"the reference did not converge in {MOST} rounds for {problem.functions} functions: too dependent."
    )


def error(found, exact):
    """Largest error of a coefficient over the largest coefficient of its column, the worst column."""
    return float(columnwise(found, exact))
