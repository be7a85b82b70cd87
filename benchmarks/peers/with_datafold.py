"""datafold: `EDMD`, its own dictionaries, `TSCDataFrame.from_shift_matrices`. The state is (x, u), the input held.

For roll-outs another model is fitted, `DMDControl`: functions of x, linear in u.
"""

from importlib.metadata import version

import numpy as np
import pandas as pd
import problem as problems
from datafold import EDMD, DMDControl, DMDStandard, TSCDataFrame, TSCPolynomialFeatures
from datafold.dynfold import TSCIdentity, TSCRadialBasis
from datafold.dynfold.compose import TSCColumnTransformer
from datafold.pcfold import GaussianKernel

VERSION = version("datafold")
NOTE = "lift + fit"
HOW = "linear, states lifted once, u linear (EDMD with DMDControl, predict)"


class Gaussians(TSCRadialBasis):
    """With its centres from the start: a column transformer cannot hand them to ``fit``."""

    def __init__(self, kernel, rows):
        super().__init__(kernel, center_type="fit_params")
        self.rows = rows

    def fit(self, X, y=None, **options):
        return super().fit(X, y, centers=self.rows)


def names(problem):
    return [f"z{i}" for i in range(problem.n + problem.m)]


def load(problem):
    return TSCDataFrame.from_shift_matrices(
        *problems.pairs(problem), snapshot_orientation="row", columns=names(problem)
    )


def dictionary(problem, channels):
    """The same functions as everywhere, of the first channels only for the roll-out's model."""
    if problem.kind == "monomials":
        return TSCPolynomialFeatures(problem.degree, include_bias=True, include_first_order=True)
    gaussians = Gaussians(GaussianKernel(problem.width**2 / 2), problem.centres[:, : len(channels)])
    parts = [("head", TSCIdentity(include_const=True), channels), ("tail", gaussians, channels)]
    return TSCColumnTransformer(parts, verbose_feature_names_out=False)


def fit(problem, data):
    model = EDMD(
        [("dictionary", dictionary(problem, names(problem)))], DMDStandard(sys_mode="matrix"), include_id_state=False
    )
    return model.fit(data)


def features(problem, model, z):
    return model.transform(
        TSCDataFrame.from_shift_matrices(z, z, snapshot_orientation="row", columns=names(problem))
    ).to_numpy()[::2]


def matrix(problem, model):
    return model.dmd_model.sys_matrix_.T


def collection(values, columns, samples):
    """Trajectories (runs, samples, channels) as datafold's table."""
    runs = len(values)
    index = pd.MultiIndex.from_product([range(runs), np.arange(samples)], names=["ID", "time"])
    return TSCDataFrame(values[:, :samples].reshape(runs * samples, -1), index=index, columns=columns)


def prepare_roll_out(problem, data, model):
    x, u = names(problem)[: problem.n], names(problem)[problem.n :]
    samples = problem.states.shape[1]
    model = EDMD([("dictionary", dictionary(problem, x))], DMDControl(), include_id_state=False)
    return model.fit(collection(problem.states, x, samples), U=collection(problem.inputs, u, samples - 1))


def roll_out(problem, model):
    samples = problem.u.shape[1]
    u = collection(problem.u, names(problem)[problem.n :], samples - 1)
    predicted = model.predict(problem.x0, U=u, qois=names(problem)[: problem.n])
    return predicted.to_numpy().reshape(len(problem.x0), samples, problem.n)
