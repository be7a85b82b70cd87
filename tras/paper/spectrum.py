"""How good is the operator: residuals of eigenpairs, eigenfunctions, projection error.

An eigenvalue of K need not be one of the Koopman operator: a finite dictionary adds spurious ones. Residual dynamic mode
decomposition (ResDMD; M. J. Colbrook and A. Townsend, Comm. Pure Appl. Math. 77, 2024, 221) tells them apart by what the true operator
does to the eigenfunction, measured on data, best on data that were not fitted.
"""

import numpy as np
import pandas as pd
from scipy import linalg

from tras.koopman import snapshot_pairs

SPURIOUS = 0.1  # a residual beyond a tenth of the eigenfunction's size


def eigenpairs(model):
    """Eigenvalues (N,) of K, largest modulus first, and the coefficients (N, N) of the eigenfunctions ``psi^T g`` in columns."""
    model.require_all_columns()
    values, vectors = linalg.eig(model.koopman_matrix)
    order = np.lexsort((-values.imag, -np.abs(values)))
    return values[order], vectors[:, order]


def eigenfunctions(model, x, u=None):
    """Eigenfunctions at states (..., n) and inputs (..., m) in physical units -> (..., N), in the order of `eigenpairs`.

    Along the true system ``f(y) = lambda f(x)``, as far as the eigenpair is one of the Koopman operator.
    """
    _, vectors = eigenpairs(model)
    return model.lift(x, u) @ vectors


def residuals(model, recording):
    """ResDMD residual of each eigenpair on a recording.

    The root mean square of ``f(y) - lambda f(x)`` over that of ``f(x)``, f the eigenfunction: zero for an eigenpair of the Koopman operator
    itself, in time units of one sample.

    Parameters
    ----------
    model : KoopmanModel
        With ``vector_field`` or ``one_step``.
    recording : Recording
        Fresh data, if there are any: on the data that were fitted residuals come out too small.

    Returns
    -------
    pandas.DataFrame
        ``real, imag, modulus`` of the eigenvalue; ``rate`` (1/s) and ``frequency`` (rad/s) of its logarithm; ``residual``; the ``relative``
        residual, over the distance ``|lambda - 1|`` that the eigenvalue moves in a sample (infinite for eigenvalue one); ``spurious``.

    Raises
    ------
    ValueError
        With ``lifted_linear``, whose matrix acts on functions of the state alone while the input changes them.
    """
    values, vectors = eigenpairs(model)
    if model.predictor == "lifted_linear":
        raise ValueError(
            "predictor is 'lifted_linear': its functions change with the input too; fit with 'vector_field' or 'one_step'."
        )
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
    return pd.DataFrame(
        {
            "real": values.real,
            "imag": values.imag,
            "modulus": np.abs(values),
            "rate": rates.real,
            "frequency": rates.imag,
            "residual": residual,
            "relative": relative,
            "spurious": relative > SPURIOUS,
        }
    )


def projection_error(model, recording):
    """How much of each function's change over a sample lies outside the dictionary's span, on a recording.

    Returns
    -------
    pandas.Series
        By function name: the root mean square of ``psi_j(y) - (K^T psi(x))_j`` over that of ``psi_j(y) - psi_j(x)``. Zero where the
        dictionary is closed, about one where K explains nothing, above it on fresh data that K misleads; functions of the input alone do not
        change and have zero.
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
    recording = model.channels_.matched(recording)
    for x, u, y in snapshot_pairs(recording):
        yield model.lift(x, u), model.lift(y, u)
