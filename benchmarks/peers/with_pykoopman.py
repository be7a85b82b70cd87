"""pykoopman: `Koopman`, its own observables, `EDMD` on snapshot pairs, ``fit(x, y)``. The state is (x, u), u held.

Its prediction with inputs is another model, `EDMDc`: functions of x, linear in u; that one is fitted for the roll-out.
"""

import sys
import types
import warnings

# Only its neural network needs torch and lightning, which it imports always; they are not installed (see README.md).
for name in (
    "torch",
    "torch.nn",
    "torch.nn.utils",
    "torch.nn.utils.rnn",
    "torch.utils",
    "torch.utils.data",
    "lightning",
):
    sys.modules[name] = types.ModuleType(name)
sys.modules["torch"].nn = sys.modules["torch.nn"]
sys.modules["torch"].Tensor = sys.modules["torch"].device = object
sys.modules["torch.nn"].Module = type("Module", (), {})
sys.modules["torch.nn.utils.rnn"].pad_sequence = None
for name in ("DataLoader", "Dataset"):
    setattr(sys.modules["torch.utils.data"], name, type(name, (), {}))
for name in ("LightningModule", "LightningDataModule", "Trainer"):
    setattr(sys.modules["lightning"], name, type(name, (), {}))
warnings.simplefilter("ignore")

import numpy as np  # noqa: E402
import problem as problems  # noqa: E402
import pykoopman  # noqa: E402
from pykoopman.observables import Polynomial, RadialBasisFunction  # noqa: E402
from pykoopman.regression import EDMD, EDMDc  # noqa: E402

VERSION = pykoopman.__version__
NOTE = "lift + fit"
HOW = "linear, states lifted once, u linear (EDMDc, simulate), one run after the other"


def load(problem):
    return problems.pairs(problem)


def observables(problem, channels):
    if problem.kind == "monomials":
        return Polynomial(degree=problem.degree)
    centres = np.ascontiguousarray(problem.centres[:, :channels].T)
    return Polynomial(degree=1) + RadialBasisFunction(
        "gauss", centres.shape[1], centres, 1 / problem.width, include_state=False
    )


def fit(problem, data):
    return pykoopman.Koopman(observables(problem, problem.n + problem.m), EDMD(svd_rank=-1), quiet=True).fit(*data)


def features(problem, model, z):
    return model.observables.transform(z)


def matrix(problem, model):
    return (model.ur @ model.A @ model.ur.conj().T).T


def prepare_roll_out(problem, data, model):
    x, u, y = data[0][:, : problem.n], data[0][:, problem.n :], data[1][:, : problem.n]
    return pykoopman.Koopman(observables(problem, problem.n), EDMDc(), quiet=True).fit(x, y, u=u)


def roll_out(problem, model):
    runs = []
    for x0, u in zip(problem.x0, problem.u):
        runs.append(np.vstack([x0, model.simulate(x0, u[:-1], n_steps=len(u) - 1)]))
    return np.stack(runs)
