"""Which eigenpairs of an identified Koopman matrix are real, what they look like, and what its dictionary misses."""

import numpy as np
import pandas as pd

from tras.paper import spectrum
from tras.recording import Recording
from tras.twin_rotor.plant import STATE_NAMES, STATE_UNITS, PlantParameters, jacobian, rest_point, simulate_plant


def free_swings(count, seconds, dt, reach, seed, parameters=None):
    """Swings of the rig without torque, released at random around its rest point: an autonomous recording, no inputs.

    ``reach`` is the half-width of the states at release, (4,), in rad and rad/s.
    """
    parameters = parameters or PlantParameters()
    start = rest_point(parameters) + np.random.default_rng(seed).uniform(-1, 1, (count, 4)) * reach
    samples = round(seconds / dt) + 1
    states = simulate_plant(start, np.zeros((count, samples, 2)), dt, parameters)
    return Recording(states, np.empty((count, samples, 0)), dt, state_names=STATE_NAMES, state_units=STATE_UNITS)


def residual_study(models, recordings):
    """ResDMD residuals of every eigenpair on data that were not fitted.

    Parameters
    ----------
    models : dict of str to KoopmanModel
    recordings : dict of str to Recording
        What each model is judged on.

    Returns
    -------
    pandas.DataFrame
        ``model`` and the columns of `tras.paper.spectrum.residuals`.
    """
    parts = [spectrum.residuals(model, recordings[name]).assign(model=name) for name, model in models.items()]
    table = pd.concat(parts, ignore_index=True)
    return table[["model", *table.columns.drop("model")]]


def projection_study(models, recordings):
    """Projection error of every function on data that were not fitted: ``model, function, projection_error`` (`tras.paper.spectrum.projection_error`)."""
    parts = []
    for name, model in models.items():
        errors = spectrum.projection_error(model, recordings[name])
        parts.append(pd.DataFrame({"model": name, "function": errors.index, "projection_error": errors.to_numpy()}))
    return pd.concat(parts, ignore_index=True)


def trivial(residuals):
    """Eigenvalue one with nothing left over: the constant, and functions of the held inputs alone."""
    return (residuals["residual"] <= 1e-9) & ((residuals["modulus"] - 1).abs() <= 1e-9)


def eigenfunction_table(model, recording, reach, *, count=2, points=41):
    """The best eigenfunctions over (phi, psi) around the rest point, rates zero: smallest relative residual, conjugates once.

    Scaled to one at the panel's corner of largest phi and psi, since an eigenfunction has no size of its own.

    Parameters
    ----------
    model : KoopmanModel
        Of an autonomous recording.
    recording : Recording
        To judge by.
    reach : (float, float)
        Half-widths in phi and psi, rad.

    Returns
    -------
    pandas.DataFrame
        Columns ``rank, rate`` (1/s), ``frequency`` (rad/s), ``relative`` (residual), ``phi, psi`` (rad), ``real, imag``.
    """
    table = spectrum.residuals(model, recording)
    table = table[~trivial(table) & (table["frequency"] >= 0)].sort_values("relative", kind="stable").head(count)
    rest = rest_point(PlantParameters())
    phi, psi = np.meshgrid(*(middle + half * np.linspace(-1, 1, points) for middle, half in zip(rest[[0, 2]], reach)))
    x = np.stack([phi, 0 * phi, psi, 0 * psi], axis=-1).reshape(-1, 4)
    values = spectrum.eigenfunctions(model, x, np.empty((len(x), 0)))
    parts = []
    for rank, (index, row) in enumerate(table.iterrows(), start=1):
        f = values[:, index] / values[-1, index]
        about = {name: row[name] for name in ("rate", "frequency", "relative")}
        parts.append(
            pd.DataFrame({"rank": rank, **about, "phi": x[:, 0], "psi": x[:, 2], "real": f.real, "imag": f.imag})
        )
    return pd.concat(parts, ignore_index=True)


def linearised_rates():
    """Eigenvalues (1/s) of the plant linearised at rest, those with a positive imaginary part: what the operator's must be."""
    parameters = PlantParameters()
    values = np.linalg.eigvals(jacobian(rest_point(parameters), [0.0, 0.0], parameters)[0])
    return np.sort_complex(values[values.imag > 0])[::-1]
