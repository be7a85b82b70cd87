"""deeptime: EDMD of snapshot pairs, ``EDMD(basis).fit((X, Y))``. The state is (x, u), the input held over a sample."""

import deeptime
import numpy as np
import problem as problems
from deeptime.basis import Monomials
from deeptime.decomposition import EDMD

VERSION = deeptime.__version__
HOW = "re-lift, all runs at once"


def NOTE(problem):
    return "lift + fit" if problem.kind == "monomials" else "lift (our NumPy function as basis) + fit"


def load(problem):
    return problems.pairs(problem)


def fit(problem, data):
    basis = (
        Monomials(problem.degree, problem.n + problem.m)
        if problem.kind == "monomials"
        else lambda z: problems.lift(problem, z)
    )
    return EDMD(basis).fit(data).fetch_model()


def features(problem, model, z):
    return model.instantaneous_obs(z)


def matrix(problem, model):
    return model.operator


def prepare_roll_out(problem, data, model):
    order = problems.match(features(problem, model, problem.points), problem.values)
    return model, order[1 : 1 + problem.n]


def roll_out(problem, prepared):
    model, states = prepared
    trajectory = [problem.x0]
    for u in problem.u.transpose(1, 0, 2)[:-1]:
        psi = model.instantaneous_obs(np.hstack([trajectory[-1], u]))
        trajectory.append((psi @ model.operator)[:, states])
    return np.stack(trajectory, axis=1)
