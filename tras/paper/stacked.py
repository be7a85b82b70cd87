"""Free runs of many models at once: models of one structure (the same dictionary in scaled channels), stacked.

A free run is tens of thousands of steps one after the other, and Python's cost of a step hardly depends on how many models take it.
"""

import numpy as np

from tras import rollout


def field_of(model):
    """What a roll-out of a `KoopmanModel` with the predictor ``vector_field`` needs beside its dictionary, as plain lists and numbers.

    Raises
    ------
    ValueError
        If the model predicts in another way, or is confined to its training data: its functions alone do not say what it does then.
    """
    if model.predictor != "vector_field" or model.hull_ is not None:
        raise ValueError(
            "only models with predictor='vector_field' and extrapolation='functions' can be stacked; fit one with these options."
        )
    scales = {
        f"{letter}_{kind}": getattr(model, f"{letter}_{kind}_").tolist()
        for letter in "xu"
        for kind in ("offset", "scale")
    }
    return {"W": model.W_.tolist(), "substeps": model.substeps_, "delays": model.delays, "dt": model.dt_, **scales}


def alike(models):
    """Numbers of the models that can be rolled out together, as lists in the order of their first members; others stand alone."""
    groups, points = {}, {}
    for i, model in enumerate(models):
        key = i
        if model.predictor == "vector_field" and not model.hull_ is not None:
            channels = model.dictionary_.n_states_ + model.dictionary_.n_inputs_
            some = points.setdefault(
                channels, np.random.default_rng(0).uniform(-1, 1, (channels, 5))
            )  # dictionaries are told apart by values there
            key = (
                model.delays,
                model.substeps_,
                model.dt_,
                len(model.state_names_),
                model.dictionary_.lift(some).tobytes(),
            )
        groups.setdefault(key, []).append(i)
    return list(groups.values())


def predict(models, recordings):
    """``model.predict(recording)`` for each model of one group of `alike` and its own recording; trajectories in equal number and length.

    Returns
    -------
    list of (trajectories, samples, n) ndarray
    """
    if len(models) == 1:
        return [models[0].predict(recordings[0])]
    recordings = [model.channels_.matched(recording) for model, recording in zip(models, recordings)]
    starts = np.stack([recording.states[:, : model.delays + 1] for model, recording in zip(models, recordings)])
    inputs = np.stack([recording.inputs for recording in recordings])
    return list(free_runs(models[0].dictionary_, [field_of(model) for model in models], starts, inputs))


def free_runs(dictionary, fields, starts, inputs):
    """Every model's prediction of its own runs.

    Parameters
    ----------
    dictionary : Dictionary
        Fitted, of scaled channels; the same one for all models.
    fields : list of dict
        From `field_of`, one per model; delays, substeps and sampling time alike.
    starts : (models, runs, delays + 1, n) ndarray
        First samples, in physical units.
    inputs : (models, runs, samples, m) ndarray

    Returns
    -------
    (models, runs, samples, n) ndarray
        As `KoopmanModel.simulate` gives it: NaN from where a prediction is abandoned.
    """
    shared = {tuple(field[name] for name in ("delays", "substeps", "dt")) for field in fields}
    if len(shared) != 1:
        raise ValueError(
            f"fields differ in (delays, substeps, dt): {sorted(shared)}; stack only models that agree in them."
        )
    ((delays, substeps, dt),) = shared
    W, x_offset, x_scale, u_offset, u_scale = (
        _array(fields, name) for name in ("W", "x_offset", "x_scale", "u_offset", "u_scale")
    )
    (models, runs, samples, m), n, d = inputs.shape, starts.shape[-1], delays
    z = (starts - _wide(x_offset)) / _wide(x_scale)
    z = z[:, :, ::-1].reshape(models * runs, -1).T.copy()  # newest first
    u = ((inputs - _wide(u_offset)) / _wide(u_scale))[:, :, d:].transpose(2, 3, 0, 1).reshape(samples - d, m, -1)

    def field(point):
        psi = dictionary.lift(point).reshape(-1, models, runs)
        return np.matmul(W, psi.transpose(1, 0, 2)).transpose(1, 0, 2).reshape(-1, models * runs)

    def advance(z, held):
        later = rollout.runge_kutta(field, z, held, dt, substeps)
        later[n : n * (d + 1)] = z[: n * d]  # what is known of the earlier samples is shifted, not predicted
        return later

    rolled = rollout.roll_out(advance, z, u)[:, :n].reshape(samples - d, n, models, runs).transpose(2, 3, 0, 1)
    return np.concatenate([starts, (rolled * _wide(x_scale) + _wide(x_offset))[:, :, 1:]], axis=2)


def _array(fields, name):
    return np.array([field[name] for field in fields])


def _wide(values):
    """(models, channels) for (models, runs, samples, channels)."""
    return values[:, None, None]
