"""What a fit found, in words and numbers: the text of `KoopmanModel.report`."""

import numpy as np

from tras import generator, metrics
from tras.workflow.arguments import one_line, visible


def describe(model, recording=None):
    """A few lines of text on a fitted model; also how well it predicts a recording in its channels, if there is one."""
    lines = [*_fit(model), *_dynamics(model), *(_prediction(model, recording) if recording is not None else [])]
    return visible("\n".join(lines))


def _fit(model):
    states, inputs = len(model.state_names_), len(model.input_names_)
    chosen = f", chosen among {len(model.errors_)} by multi-step error" if hasattr(model, "errors_") else ""
    condition = model.condition_number
    return [
        f"{model.predictor} model of {states} states, {inputs} inputs at {model.dt_:g} s, {model.delays} delays",
        f"dictionary {model.dictionary_}, N = {len(model.names_)} functions, {model.pairs_} snapshot pairs",
        f"numerical rank {model.rank_}, condition number of the liftings "
        f"{f'{condition:.2e}' if np.isfinite(condition) else 'infinite'}",
        f"regularization {model.regularization}, strength {model.strength_:g}{chosen}",
        *getattr(model, "unsettled_", []),
        *_horizon(model),
    ]


def _horizon(model):
    if model.horizon == 1 or not hasattr(model, "refinement_"):
        return []
    first, last = model.refinement_[[0, -1]]
    misses = f"miss by {last:.3g} half-ranges, root mean square, {first:.3g} before"
    return [f"the next states were then fitted to predictions over {model.horizon} samples, which {misses}"]


def _dynamics(model):
    if model.columns == "states":
        return ["of K the states' columns alone, so no eigenvalues", *_beyond(model)]
    eigenvalues = model.eigenvalues
    radius = np.abs(eigenvalues).max()
    lines = [f"spectral radius of K {radius:.8f}: {'stable' if radius <= 1 + 1e-9 else 'the lifted system grows'}"]
    if model.stable:
        others = np.delete(eigenvalues, np.argmin(np.abs(eigenvalues - 1)))
        largest = np.abs(others).max(initial=0.0)
        lines.append(
            f"without the constant's one the largest modulus is {largest:.8f}; "
            f"at most {float(model.stable):g} was asked for"
        )
    if model.predictor == "vector_field":
        distance = generator.branch_distance(eigenvalues).min()
        lines += [
            f"distance of the spectrum from the logarithm's branch cut {distance:.3g}; "
            f"exp(log K) misses K by {model.log_residual_:.1e}, relative",
            f"vector field by {model.field}, {model.substeps_} Runge-Kutta step(s) per sample",
        ]
    if hasattr(model, "field_disagreement_"):
        names = map(one_line, model.state_names_)
        apart = ", ".join(f"{name} {100 * d:.2g} %" for name, d in zip(names, model.field_disagreement_))
        lines.append(f"it differs from the field by coordinates by {apart} (root mean square)")
    if hasattr(model, "refinement_") and model.predictor == "vector_field":
        first, last = model.refinement_[[0, -1]]
        lines.append(
            f"refined on whole trajectories: predictions miss the measurements by {last:.3g} times their noise, "
            f"{first:.3g} before"
        )
    return lines + _beyond(model)


def _beyond(model):
    return (
        ["beyond the training data, plus a margin, the model is linear and damped"] if model.hull_ is not None else []
    )


def _prediction(model, recording):
    short = recording.cut(model.delays + 2)
    one = metrics.judge(short.states[:, -1:], np.asarray(model.predict(short))[:, -1:])
    many = metrics.judge(recording.states, model.predict(recording))
    names = map(one_line, model.state_names_)
    both = ", ".join(f"{name} {_percent(a)} and {_percent(b)}" for name, a, b in zip(names, one.nrmse, many.nrmse))
    steps = f", {one.diverged} of {one.windows} single steps" if one.diverged else ""
    lost = f"{many.diverged} of {many.windows} trajectories{steps}"
    return [f"one-step and multi-step NRMSE: {both}", f"diverged: {lost}"]


def _percent(error):
    """An error in percent, or why there is none."""
    if np.isfinite(error):
        return f"{error:.3g} %"
    return "too large for a number" if np.isinf(error) else "none, for all ran away or nothing moves,"
