"""From the Koopman matrix to the vector field: A = log(K) / Ts and F(x, u) = W psi(x, u) (paper, (15)-(18))."""

import contextlib
import warnings

import numpy as np
from scipy import linalg
from scipy.linalg import blas

from tras.dictionaries.base import Dictionary
from tras.koopman import snapshot_pairs
from tras.recording import Recording


class LogarithmError(ValueError):
    """K has no principal logarithm. ``eigenvalue`` is the eigenvalue at fault."""

    def __init__(self, message, eigenvalue):
        super().__init__(message)
        self.eigenvalue = eigenvalue

    def __reduce__(self):
        """Both arguments, so that it comes back whole from another process."""
        return type(self), (self.args[0], self.eigenvalue)


def branch_distance(eigenvalues: np.ndarray) -> np.ndarray:
    """Distance of each eigenvalue from the closed negative real axis, where the principal logarithm does not exist."""
    eigenvalues = np.asarray(eigenvalues, dtype=complex)
    return np.where(eigenvalues.real <= 0, np.abs(eigenvalues.imag), np.abs(eigenvalues))


def principal_logarithm(K: np.ndarray) -> tuple[np.ndarray, float]:
    """The principal logarithm of a real matrix (N. J. Higham, *Functions of Matrices*, 2008, Thm. 1.31 and Ch. 11).

    Returns
    -------
    logarithm : (N, N) ndarray
    residual : float
        ``|exp(logarithm) - K| / |K|`` in the Frobenius norm: how well the logarithm was computed.

    Raises
    ------
    LogarithmError
        If an eigenvalue lies on the closed negative real axis to working precision. The paper's condition
        ("non-negative real parts") is not the right one: complex eigenvalues with negative real part do no harm, a zero
        eigenvalue does.
    """
    K = np.asarray(K, dtype=float)
    eigenvalues = linalg.eigvals(K)
    distance = branch_distance(eigenvalues)
    worst = complex(eigenvalues[int(np.argmin(distance))])
    advice = (
        "use more data, a shorter sampling time or a smaller dictionary, "
        "or predictor='one_step', which needs no logarithm."
    )
    if distance.min() <= len(K) * np.finfo(float).eps * np.abs(eigenvalues).max():
        shown = f"{worst.real:.6g}" if worst.imag == 0 else f"{worst:.6g}"
        raise LogarithmError(
            f"the Koopman matrix has the eigenvalue {shown}, to working precision on the closed negative real axis, "
            f"where no principal logarithm exists: {advice}",
            worst,
        )
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")  # the residual is checked instead
        try:
            with _same_draws():
                logarithm = np.real(linalg.logm(K))
            residual = float(linalg.norm(linalg.expm(logarithm) - K) / linalg.norm(K))
        except (ValueError, linalg.LinAlgError):
            residual = np.inf
    if not residual <= 1e-8:  # NaN included
        raise LogarithmError(
            f"the logarithm of the Koopman matrix cannot be computed accurately (relative residual {residual:.1e}): "
            f"its eigenvalue {worst:.6g} is too close to the closed negative real axis, {advice}",
            worst,
        )
    return logarithm, residual


@contextlib.contextmanager
def _same_draws():
    """NumPy's global generator, seeded and put back: SciPy's logm estimates norms with it, which may move last bits."""
    state = np.random.get_state()
    np.random.seed(0)
    try:
        yield
    finally:
        np.random.set_state(state)


def generator(K: np.ndarray, dt: float) -> np.ndarray:
    """``A = log(K) / dt``, equation (15): d/dt of ``psi^T a`` is ``psi^T A a``. (N, N) -> (N, N) in 1/s."""
    return principal_logarithm(K)[0] / dt


def field_by_coordinates(A: np.ndarray, dictionary: Dictionary) -> np.ndarray:
    """W (n, N) read off the generator: the columns of the states, since d/dt x_i = psi^T A e_i."""
    return A[:, dictionary.coordinates].T.copy()


def field_by_least_squares(A: np.ndarray, dictionary: Dictionary, recording: Recording, R: np.ndarray) -> np.ndarray:
    """W (n, N) of ``F(x, u) = W psi(x, u)`` from equation (18), over all data points.

    Minimises the sum over the points of ``|(d psi / d x) W psi - A^T psi|^2``, one equation per function and point.
    With ``q = R^-T psi`` the unknown is V = W R^T, and the matrix of its normal equations, the sum of ``(J^T J) kron (q
    q^T)`` with J = d psi / d x, is as well conditioned as ``J^T J``: the ill-conditioning of Psi stays out of it.

    Parameters
    ----------
    A : (N, N) ndarray
        Generator in 1/s.
    dictionary : Dictionary
    recording : Recording
    R : (N, N) ndarray
        Triangular factor of Psi_x, `LeastSquares.R`.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the normal equations are singular to working precision.
    """
    N, n = len(A), dictionary.n_states_
    S, B = np.zeros((n, n, N, N)), np.zeros((n, N))
    for x, u, _ in snapshot_pairs(recording, max(1024, 2**15 // N)):  # blocks that stay in the cache
        psi, J = dictionary.lift_with_slopes(np.ascontiguousarray(np.hstack([x, u]).T))
        q = blas.dtrsm(1.0, R, psi.T, side=1).T
        rate = A.T @ psi
        B += np.stack([np.einsum("jp,jp->p", J[:, i], rate) for i in range(n)]) @ q.T
        # With J_i the i-th column, J_i.J_k = (|J_i + J_k|^2 - |J_i|^2 - |J_k|^2) / 2: sums of squares cost half as much
        # as products.
        for i in range(n):
            for k in range(i + 1):
                slope = J[:, i] if i == k else J[:, i] + J[:, k]
                weighted = q * np.sqrt(np.einsum("jp,jp->p", slope, slope))
                S[i, k] += weighted @ weighted.T
    H = np.zeros((n, N, n, N))
    for i in range(n):
        for k in range(i + 1):
            H[i, :, k] = H[k, :, i] = S[i, i] if i == k else (S[i, k] - S[i, i] - S[k, k]) / 2
    with warnings.catch_warnings():
        warnings.simplefilter("error", linalg.LinAlgWarning)
        try:
            V = linalg.solve(H.reshape(n * N, n * N), B.ravel(), assume_a="pos").reshape(n, N)
        except (linalg.LinAlgError, linalg.LinAlgWarning) as error:
            raise linalg.LinAlgError(
                "equation (18) is singular to working precision; field='coordinates' does without it"
            ) from error
    return linalg.solve_triangular(R, V.T, check_finite=False).T
