"""How good is the operator: residuals of eigenpairs, eigenfunctions, projection error, and the studies of them.

An eigenvalue of K need not be one of the Koopman operator: a finite dictionary adds spurious ones. Residual dynamic
mode decomposition (ResDMD; M. J. Colbrook and A. Townsend, Comm. Pure Appl. Math. 77, 2024, 221) tells them apart by
what the true operator does to the eigenfunction, measured on data, best on data that were not fitted.
"""

import numpy as np
import pandas as pd
from scipy import linalg

from tras.koopman import snapshot_pairs
from tras.model import KoopmanModel
from tras.recording import Recording
from tras.twin_rotor.plant import STATE_NAMES, STATE_UNITS, PlantParameters, jacobian, rest_point, simulate_plant

SPURIOUS = 0.1  # a residual beyond a tenth of the eigenfunction's size


def eigenpairs(model: KoopmanModel) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues (N,) of K, largest modulus first, and in columns the coefficients (N, N) of the eigenfunctions."""
    model.require_all_columns()
    values, vectors = linalg.eig(model.koopman_matrix)
    order = np.lexsort((-values.imag, -np.abs(values)))
    return values[order], vectors[:, order]


def eigenfunctions(model: KoopmanModel, x: np.ndarray, u: np.ndarray | None = None) -> np.ndarray:
    """Eigenfunctions at states (..., n) and inputs (..., m) in physical units -> (..., N), ordered as `eigenpairs`.

    Along the true system ``f(y) = lambda f(x)``, as far as the eigenpair is one of the Koopman operator.
    """
    return model.lift(x, u) @ eigenpairs(model)[1]


def residuals(model: KoopmanModel, recording: Recording) -> pd.DataFrame:
    """ResDMD residual of each eigenpair on a recording.

    The root mean square of ``f(y) - lambda f(x)`` over that of ``f(x)``, f the eigenfunction: zero for an eigenpair of
    the Koopman operator itself, in time units of one sample.

    Parameters
    ----------
    model : KoopmanModel
        With ``vector_field`` or ``one_step``.
    recording : Recording
        Fresh data, if there are any: on the data that were fitted residuals come out too small.

    Returns
    -------
    pandas.DataFrame
        ``real, imag, modulus`` of the eigenvalue; ``rate`` (1/s) and ``frequency`` (rad/s) of its logarithm;
        ``residual``; the ``relative`` residual, over the distance ``|lambda - 1|`` that the eigenvalue moves in one
        sample (infinite for eigenvalue one); ``spurious``.

    Raises
    ------
    ValueError
        With ``lifted_linear``, whose matrix acts on functions of the state alone while the input changes them.
    """
    values, vectors = eigenpairs(model)
    if model.predictor == "lifted_linear":
        reason = "its functions change with the input, too; fit with 'vector_field' or 'one_step'."
        raise ValueError(f"predictor is 'lifted_linear': {reason}")
    error, size = np.zeros(len(values)), np.zeros(len(values))
    for before, after in _liftings(model, recording):
        f, g = before @ vectors, after @ vectors
        error += np.sum(np.abs(g - f * values) ** 2, axis=0)
        size += np.sum(np.abs(f) ** 2, axis=0)
    residual = np.sqrt(error / size)
    with np.errstate(divide="ignore", invalid="ignore"):
        rates = np.log(values) / model.dt_
        moved = np.abs(values - 1)
        relative = np.where(residual <= 1e-12, 0.0, residual / np.where(moved > 1e-12, moved, 0.0))
    table = {"real": values.real, "imag": values.imag, "modulus": np.abs(values), "rate": rates.real}
    table |= {"frequency": rates.imag, "residual": residual, "relative": relative, "spurious": relative > SPURIOUS}
    return pd.DataFrame(table)


def projection_error(model: KoopmanModel, recording: Recording) -> pd.Series:
    """How much of each function's change over a sample lies outside the dictionary's span, on a recording.

    Returns
    -------
    pandas.Series
        By function name: the root mean square of ``psi_j(y) - (K^T psi(x))_j`` over that of ``psi_j(y) - psi_j(x)``.
        Zero where the dictionary is closed, about one where K explains nothing, above it on fresh data that K misleads.
        Functions of the input alone do not change and have zero.
    """
    model.require_all_columns()
    error = change = 0.0
    for before, after in _liftings(model, recording):
        error = error + np.sum((after - before @ model.koopman_matrix) ** 2, axis=0)
        change = change + np.sum((after - before) ** 2, axis=0)
    ratio = np.sqrt(np.divide(error, change, out=np.zeros_like(error), where=change > 0))
    return pd.Series(ratio, index=model.names_, name="projection_error")


def _liftings(model, recording):
    """Blocks of (psi(x, u), psi(y, u)) over the snapshot pairs."""
    for x, u, y in snapshot_pairs(model.channels_.matched(recording)):
        yield model.lift(x, u), model.lift(y, u)


def free_swings(count: int, seconds: float, dt: float, reach, seed: int) -> Recording:
    """Swings of the rig without torque, released at random around its rest point: an autonomous recording, no inputs.

    ``reach`` is the half-width of the states at release, (4,), in rad and rad/s.
    """
    parameters = PlantParameters()
    start = rest_point(parameters) + np.random.default_rng(seed).uniform(-1, 1, (count, 4)) * reach
    samples = round(seconds / dt) + 1
    states = simulate_plant(start, np.zeros((count, samples, 2)), dt, parameters)
    return Recording(states, np.empty((count, samples, 0)), dt, state_names=STATE_NAMES, state_units=STATE_UNITS)


def residual_study(models: dict[str, KoopmanModel], recordings: dict[str, Recording]) -> pd.DataFrame:
    """`residuals` of every model, each on its recording of data that were not fitted; ``model`` is the first column."""
    parts = [residuals(model, recordings[name]).assign(model=name) for name, model in models.items()]
    table = pd.concat(parts, ignore_index=True)
    return table[["model", *table.columns.drop("model")]]


def projection_study(models: dict[str, KoopmanModel], recordings: dict[str, Recording]) -> pd.DataFrame:
    """`projection_error` of every model, likewise: columns ``model, function, projection_error``."""
    errors = {name: projection_error(model, recordings[name]) for name, model in models.items()}
    return pd.concat(errors, names=["model", "function"]).reset_index()


def trivial(residuals: pd.DataFrame) -> pd.Series:
    """Eigenvalue one with nothing left over: the constant, and functions of the held inputs alone."""
    return (residuals["residual"] <= 1e-9) & ((residuals["modulus"] - 1).abs() <= 1e-9)


def eigenfunction_table(
    model: KoopmanModel, recording: Recording, reach, *, count: int = 2, points: int = 41
) -> pd.DataFrame:
    """The eigenfunctions of smallest relative residual over (phi, psi) around rest, rates zero; conjugates once.

    Scaled to one at the corner of largest phi and psi, since an eigenfunction has no size of its own.

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
        Columns ``rank, rate`` (1/s), ``frequency`` (rad/s), ``relative`` residual, ``phi, psi`` (rad), ``real, imag``.
    """
    table = residuals(model, recording)
    table = table[~trivial(table) & (table["frequency"] >= 0)].sort_values("relative", kind="stable").head(count)
    rest = rest_point(PlantParameters())
    phi, psi = np.meshgrid(*(middle + half * np.linspace(-1, 1, points) for middle, half in zip(rest[[0, 2]], reach)))
    x = np.stack([phi, 0 * phi, psi, 0 * psi], axis=-1).reshape(-1, 4)
    values = eigenfunctions(model, x, np.empty((len(x), 0)))
    parts = []
    for rank, (index, row) in enumerate(table.iterrows(), start=1):
        f = values[:, index] / values[-1, index]
        about = {name: row[name] for name in ("rate", "frequency", "relative")}
        part = {"rank": rank, **about, "phi": x[:, 0], "psi": x[:, 2], "real": f.real, "imag": f.imag}
        parts.append(pd.DataFrame(part))
    return pd.concat(parts, ignore_index=True)


def linearised_rates() -> np.ndarray:
    """Eigenvalues (1/s) of the plant linearised at rest, of positive imaginary part: what the operator's must be."""
    parameters = PlantParameters()
    values = np.linalg.eigvals(jacobian(rest_point(parameters), [0.0, 0.0], parameters)[0])
    return np.sort_complex(values[values.imag > 0])[::-1]
