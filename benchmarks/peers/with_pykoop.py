"""pykoop: `KoopmanPipeline` with its lifting functions of (x, u), and `Edmd`. Targets are the functions of x alone."""

from importlib.metadata import version

import numpy as np
import pykoop

VERSION = version("pykoop")
NOTE = "lift + fit; targets: only the functions of x"
HOW = "re-lift (predict_trajectory)"


class Centres(pykoop.Centers):
    """Given centres, in the form in which pykoop takes them."""

    def __init__(self, points=None):
        self.points = points

    def fit(self, X, y=None):
        self.centers_ = self.points
        self.n_centers_, self.n_features_in_ = self.points.shape
        return self


def load(problem):
    trajectories, samples = problem.states.shape[:2]
    episode = np.repeat(np.arange(trajectories), samples)[:, None]
    return np.hstack([episode, problem.states.reshape(-1, problem.n), problem.inputs.reshape(-1, problem.m)])


def fit(problem, data):
    if problem.kind == "monomials":
        functions = ("monomials", pykoop.PolynomialLiftingFn(order=problem.degree))
    else:
        functions = ("gaussians", pykoop.RbfLiftingFn("gaussian", Centres(problem.centres), shape=1 / problem.width))
    pipeline = pykoop.KoopmanPipeline([functions, ("constant", pykoop.ConstantLiftingFn())], pykoop.Edmd(alpha=0))
    return pipeline.fit(data, n_inputs=problem.m, episode_feature=True)


def features(problem, model, z):
    return model.transform(np.hstack([np.zeros((len(z), 1)), z]))[:, 1:]


def matrix(problem, model):
    return model.regressor_.coef_


def roll_out(problem, model):
    runs, samples = problem.u.shape[:2]
    episode = np.repeat(np.arange(runs), samples)[:, None]
    start = np.hstack([np.arange(runs)[:, None], problem.x0])
    u = np.hstack([episode, problem.u.reshape(-1, problem.m)])
    return model.predict_trajectory(start, u, relift_state=True)[:, 1:].reshape(runs, samples, problem.n)
