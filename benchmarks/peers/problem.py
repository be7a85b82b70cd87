"""What is measured, as a folder of plain arrays that any environment with NumPy can read: data, functions, roll-outs.

``problem.json``
    ``kind`` ("monomials" or "gaussians"), ``degree``, ``width``, ``functions`` (N); paths: ``states``, ``inputs``.
``states.npy`` (trajectories, samples, n), ``inputs.npy`` (trajectories, samples, m)
    In channels scaled to [-1, 1].
``exponents.npy`` (N, n + m) or ``centres.npy`` (centres, n + m)
``points.npy`` (points, n + m), ``values.npy`` (points, N)
    The functions at some points: by them a package's own order of functions is told (`match`).
``x0.npy`` (runs, n), ``u.npy`` (runs, samples, m)
    What is rolled out.
"""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np


def read(folder):
    """The problem in ``folder`` as a namespace."""
    folder = Path(folder)
    problem = SimpleNamespace(**json.loads((folder / "problem.json").read_text()))
    problem.states, problem.inputs = np.load(problem.states), np.load(problem.inputs)
    for path in folder.glob("*.npy"):
        setattr(problem, path.stem, np.load(path))
    problem.n, problem.m = problem.states.shape[2], problem.inputs.shape[2]
    return problem


def pairs(problem):
    """Snapshot pairs of all trajectories, the input held: ``(x, u)`` and ``(y, u)``, each (pairs, n + m)."""
    u = problem.inputs[:, :-1]
    before, after = (
        np.concatenate([x, u], axis=2).reshape(-1, problem.n + problem.m)
        for x in (problem.states[:, :-1], problem.states[:, 1:])
    )
    return before, after


def lift(problem, z):
    """The N functions at points ``z`` (points, n + m) -> (points, N): constant, channels, then their own."""
    psi = np.empty((len(z), problem.functions))
    psi[:, 0], psi[:, 1 : 1 + z.shape[1]] = 1, z
    if problem.kind == "gaussians":
        tail = psi[:, 1 + z.shape[1] :]
        np.matmul(z, problem.centres.T * (2 / problem.width**2), out=tail)
        tail -= (problem.centres**2).sum(axis=1) / problem.width**2
        tail -= (z**2).sum(axis=1)[:, None] / problem.width**2
        np.exp(tail, out=tail)
        return psi
    row_of = {tuple(row): j for j, row in enumerate(problem.exponents)}
    for j, row in enumerate(problem.exponents):
        if row.sum() > 1:  # a shorter monomial, which comes before it, times one channel
            channel = np.flatnonzero(row)[0]
            shorter = row.copy()
            shorter[channel] -= 1
            np.multiply(psi[:, row_of[tuple(shorter)]], z[:, channel], out=psi[:, j])
    return psi


def match(columns, values):
    """Each function's place in a package's order: ``columns`` (points, features) has ``values[:, j]`` at ``match[j]``.

    Raises
    ------
    ValueError
        If a function is not among them, that is, the package was given others.
    """
    order = []
    for j, wanted in enumerate(values.T):
        distance = np.abs(columns - wanted[:, None]).max(axis=0)
        best = int(np.argmin(distance))
        if not distance[best] <= 1e-8:
            raise ValueError(
                f"function {j} is not among the {columns.shape[1]} of the package (nearest: {distance[best]:.1e})."
            )
        order.append(best)
    return order
