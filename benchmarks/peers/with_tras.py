"""This package in its environment. Variants: ``koopman_matrix``, also on all cores; options of `tras.KoopmanModel`."""

import tras
from tras import koopman

VERSION = "this checkout"
MODELS = {
    "one_step": {"predictor": "one_step", "regularization": None},
    "vector_field": {"predictor": "vector_field", "regularization": None},
    "lifted_linear": {"predictor": "lifted_linear", "regularization": None},
    "default": {},
    "states_alone": {"predictor": "one_step", "regularization": None, "columns": "states"},
}
WHOLE = ("koopman_matrix", "all_processors")  # and nothing else


def NOTE(problem):
    notes = {
        "koopman_matrix": "lift + fit (tras.koopman.koopman_matrix)",
        "all_processors": "the same by a thread a processor; see the wall-clock seconds",
        "states_alone": "lift of the first ends + fit of the states' columns alone (KoopmanModel, one_step, "
        "no regularization)",
        "one_step": "lift + fit + what prediction needs (KoopmanModel, no regularization)",
        "vector_field": "lift + fit + logarithm + vector field (KoopmanModel, no regularization)",
        "lifted_linear": "lift of x + fit, linear in u (KoopmanModel, no regularization)",
        "default": "as default, choice of the strength by roll-outs with it (KoopmanModel)",
    }
    return notes[problem.variant]


def HOW(problem):
    how = {
        "one_step": "re-lift",
        "lifted_linear": "linear, states lifted once",
        "states_alone": "re-lift",
    } | dict.fromkeys(WHOLE, "")
    return how.get(problem.variant, "integrates the vector field") + ", all runs at once"


def load(problem):
    return tras.Recording(problem.states, problem.inputs, 0.01)


def dictionary(problem, channels):
    if problem.kind == "monomials":
        return tras.Monomials(problem.degree)
    return tras.GaussianRBF(len(problem.centres), problem.width, centres=problem.centres[:, :channels])


def fit(problem, data):
    if problem.variant in WHOLE:
        functions = dictionary(problem, problem.n + problem.m).fit(problem.states[:1, :2], problem.inputs[:1, :2])
        return functions, koopman.koopman_matrix(functions, data)[0]
    options = MODELS[problem.variant] | {"max_functions": 10**6}  # the comparison has limits of its own
    linear = options.get("predictor") == "lifted_linear"
    return tras.KoopmanModel(dictionary(problem, problem.n + problem.m * (not linear)), **options).fit(data)


def features(problem, model, z):
    # A model scales its channels to [-1, 1], which the problem's are already.
    functions = model[0] if isinstance(model, tuple) else model.dictionary_
    return functions(z[:, : problem.n], z[:, problem.n :])


def matrix(problem, model):
    if problem.variant in ("lifted_linear", "default", "states_alone"):
        return None  # of other functions; not the plain least squares
    return model[1] if isinstance(model, tuple) else model.koopman_matrix


def roll_out(problem, model):
    return None if isinstance(model, tuple) else model.simulate(problem.x0, problem.u)
