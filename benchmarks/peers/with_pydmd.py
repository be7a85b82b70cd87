"""PyDMD: `DMD` of lifted rows. Its EDMD is a kernel method (a matrix of pairs by pairs) without functions to choose."""

from importlib.metadata import version

import numpy as np
import problem as problems
from pydmd import DMD

VERSION = version("pydmd")
NOTE = "fit of lifted rows (it has no such functions)"
HOW = "our lifting, one step by DMD.predict, all runs at once"


def load(problem):
    return [problems.lift(problem, z).T for z in problems.pairs(problem)]


def fit(problem, data):
    return DMD(svd_rank=-1).fit(*data)


def features(problem, model, z):
    return problems.lift(problem, z)


def matrix(problem, model):
    return (model._svd_modes @ model.operator.as_numpy_array @ model._svd_modes.conj().T).T


def roll_out(problem, model):
    states = [problem.x0]
    for u in problem.u.transpose(1, 0, 2)[:-1]:
        psi = problems.lift(problem, np.hstack([states[-1], u])).T
        states.append(model.predict(psi).real[1 : 1 + problem.n].T)
    return np.stack(states, axis=1)
