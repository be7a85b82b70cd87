"""kooplearn: `Ridge` without ridge on scikit-learn features, as documented for EDMD. The state is (x, u), u held.

It pairs samples ``lag_time`` apart of one trajectory: all x stacked on all y, with a lag of the number of pairs.
"""

import warnings
from importlib.metadata import version

import numpy as np
import problem as problems
from kooplearn.linear_model import Ridge
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import FunctionTransformer, PolynomialFeatures

VERSION = version("kooplearn")
HOW = "re-lift, all runs at once (predict)"


def NOTE(problem):
    return "lift (scikit-learn) + fit" if problem.kind == "monomials" else "lift (our NumPy function) + fit"


def load(problem):
    return np.vstack(problems.pairs(problem))


def fit(problem, data):
    polynomials = PolynomialFeatures(problem.degree) if problem.kind == "monomials" else None
    lift = polynomials or FunctionTransformer(lambda z: problems.lift(problem, z))
    return make_pipeline(lift, Ridge(alpha=None, reduced_rank=False, lag_time=len(data) // 2)).fit(data)


def features(problem, model, z):
    return model[0].transform(z)


def matrix(problem, model):
    return model[-1].estimator_


def roll_out(problem, model):
    warnings.simplefilter("ignore")
    states = problems.match(features(problem, model, problem.points), problem.values)[1 : 1 + problem.n]
    trajectory = [problem.x0]
    for u in problem.u.transpose(1, 0, 2)[:-1]:
        trajectory.append(model.predict(np.hstack([trajectory[-1], u]))[:, states])
    return np.stack(trajectory, axis=1)
