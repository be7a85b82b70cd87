"""The identified vector field beside the true one in two planes of the state space, for the phase portraits.

In each plane one angle and its rate vary, beyond the box of the training data too; the other states are fixed
(`PLANES`) and the inputs are zero. With torques the truth is the plant itself, with references the plant and the
controller. The controller's integrators are no states of the model; they take the values that balance the reference.
"""

import contextlib

import numpy as np
import pandas as pd

from tras.explorer.choice import SIZES, ChoiceError
from tras.explorer.explore import Outcome, identify, training
from tras.model import KoopmanModel
from tras.twin_rotor.closed_loop import PID
from tras.twin_rotor.plant import STATE_NAMES, TORQUE_NAMES, PlantParameters, vector_field

NAMES = {name: name for name in SIZES} | {"gaussian": "Gaussian RBF", "fourier": "Fourier"}  # of dictionaries, to show
# plane -> (the angle, its rate, values of the other two states)
PLANES = {
    "pitch": ("phi", "phidot", {"psi": 0.0, "psidot": 0.0}),
    "yaw": ("psi", "psidot", {"phi": 0.8, "phidot": 0.0}),  # rad: half the yaw inertia of the level beam
}
REACH = 2.0  # rad/s, the rates that are shown to either side of zero, or those of the data if they reach farther
WIDER = 1.15  # than the data, the angles that are shown


def has_field(model: KoopmanModel) -> bool:
    """Whether `portrait` can show a model: four states, no delays, and a vector field."""
    return model.predictor == "vector_field" and not model.delays and model.state_names_ == STATE_NAMES


def compared(outcome: Outcome) -> dict[str, KoopmanModel]:
    """Models whose fields are worth a look beside the truth: of an `Outcome` the chosen one, and the mechanical one.

    A linear model, if need be from data without noise, takes the place of one that has no field. The dict holds one or
    two models by the names of their dictionaries.
    """
    choice = outcome.choice.replaced(state="four_states", delays=0, predictor="vector_field", regularization="none")
    mechanical = choice.replaced(dictionary="mechanical", size=8, field="coordinates", extrapolation="functions")
    linear = choice.replaced(dictionary="linear")
    models = {NAMES[outcome.choice.dictionary]: outcome.model} if has_field(outcome.model) else {}
    for other in (mechanical, linear, linear.replaced(noise=0.0)):
        if len(models) < 2 and NAMES[other.dictionary] not in models:
            with contextlib.suppress(ChoiceError):
                models[NAMES[other.dictionary]] = identify(other, training(other))
    return models


def portrait(models: dict[str, KoopmanModel], *, points: int = 25) -> pd.DataFrame:
    """The fields on a grid with ``points`` per direction, and the errors of the identified ones.

    Parameters
    ----------
    models : dict of str to KoopmanModel
        Name -> model with `has_field`; all with the same inputs.
    points : int

    Returns
    -------
    pandas.DataFrame
        Columns ``model`` ("true" first), ``plane`` ("pitch" or "yaw"), ``angle`` (rad), ``rate`` (rad/s), their
        derivatives ``d_angle`` (rad/s) and ``d_rate`` (rad/s^2), ``error`` (rad/s^2): the absolute difference between
        the identified and the true ``d_rate``; and the box of the training data, the same in all rows of a plane:
        ``angle_low, angle_high`` (rad), ``rate_low, rate_high`` (rad/s).

    Raises
    ------
    ValueError
        If there is no model, one has no field in these coordinates, or they have different inputs.
    """
    for name, model in models.items():
        if not has_field(model):
            problem = (
                "only a model of the four states without delays, with predictor = vector_field, has a field to show"
            )
            raise ValueError(f"{name}: {problem}.")
    if len({model.input_names_ for model in models.values()}) != 1:
        raise ValueError("models have different inputs, or there are none; give models of the same inputs.")
    reference = next(iter(models.values()))
    true = vector_field_of(reference.input_names_)
    parts = []
    for plane, (angle, rate, others) in PLANES.items():
        box = {name: _range(reference, channel) for name, channel in (("angle", angle), ("rate", rate))}
        x = _grid(box, angle, rate, others, points)
        u = np.zeros((len(x), len(reference.input_names_)))
        i, j = STATE_NAMES.index(angle), STATE_NAMES.index(rate)
        truth = true(x, u)
        fields = {"true": truth, **{name: model.vector_field(x, u) for name, model in models.items()}}
        for name, field in fields.items():
            columns = {"angle": x[:, i], "rate": x[:, j], "d_angle": field[:, i], "d_rate": field[:, j]}
            columns["error"] = np.abs(field[:, j] - truth[:, j])
            for axis, (low, high) in box.items():
                columns |= {f"{axis}_low": low, f"{axis}_high": high}
            parts.append(pd.DataFrame({"model": name, "plane": plane, **columns}))
    return pd.concat(parts, ignore_index=True)


def vector_field_of(input_names: tuple[str, ...], parameters: PlantParameters | None = None):
    """The true field for these inputs, (..., 4), (..., 2) -> (..., 4): of the plant, or of the loop in balance.

    Examples
    --------
    >>> field = vector_field_of(("phi_ref", "psi_ref"))
    >>> (field([0.3, 0, 0.5, 0], [0.3, 0.5]) + 0.0).round(12).tolist()  # at rest on the reference
    [0.0, 0.0, 0.0, 0.0]
    """
    parameters = parameters or PlantParameters()
    if tuple(input_names) == TORQUE_NAMES:
        return lambda x, u: vector_field(x, u, parameters)

    def closed(x, u):
        x, reference = np.asarray(x, dtype=float), np.asarray(u, dtype=float)
        balance = (
            parameters.G_c * np.cos(reference[..., 0]) + parameters.G_s * np.sin(reference[..., 0]),
            parameters.K_psi * reference[..., 1],
        )
        torques = [
            np.clip(pid.P * (reference[..., k] - x[..., 2 * k]) - pid.D * x[..., 2 * k + 1] + balance[k], *pid.limits)
            for k, pid in enumerate(PID.defaults(parameters))
        ]
        return vector_field(x, np.stack(torques, axis=-1), parameters)

    return closed


def _range(model, channel):
    """Lowest and highest value in the training data."""
    k = STATE_NAMES.index(channel)
    return model.x_offset_[k] - model.x_scale_[k], model.x_offset_[k] + model.x_scale_[k]


def _grid(box, angle, rate, others, points):
    """States (points^2, 4) over the box of the training data and beyond it."""
    (low, high), fastest = box["angle"], max(REACH, *np.abs(box["rate"]))
    middle, half = (low + high) / 2, WIDER * (high - low) / 2
    axes = np.linspace(middle - half, middle + half, points), np.linspace(-fastest, fastest, points)
    first, second = (values.ravel() for values in np.meshgrid(*axes))
    columns = {angle: first, rate: second, **{name: np.full(first.shape, value) for name, value in others.items()}}
    return np.stack([columns[name] for name in STATE_NAMES], axis=-1)
