"""From the Koopman matrix to the vector field: A = log(K) / Ts and F(x, u) = W psi(x, u) (paper, (15)-(18))."""

import warnings

import numpy as np
from scipy import linalg

from tras.koopman import snapshot_pairs


class LogarithmError(ValueError):
    """K has no principal logarithm. ``eigenvalue`` is the eigenvalue at fault."""

    def __init__(self, message, eigenvalue):
        super().__init__(message)
        self.eigenvalue = eigenvalue

    def __reduce__(self):
        """Both arguments, so that it comes back whole from another process."""
        return type(self), (self.args[0], self.eigenvalue)


def branch_distance(eigenvalues):
    """Distance of each eigenvalue from the closed negative real axis, where the principal logarithm does not exist."""
    eigenvalues = np.asarray(eigenvalues, dtype=complex)
    return np.where(eigenvalues.real <= 0, np.abs(eigenvalues.imag), np.abs(eigenvalues))


def principal_logarithm(K):
    """The principal logarithm of a real matrix (N. J. Higham, *Functions of Matrices*, 2008, Thm. 1.31 and Ch. 11).

    Returns
    -------
    logarithm : (N, N) ndarray
    residual : float
        ``|exp(logarithm) - K| / |K|`` in the Frobenius norm: how well the logarithm was computed.

    Raises
    ------
    LogarithmError
        If an eigenvalue lies on the closed negative real axis to working precision. The paper's condition ("non-negative real
        parts") is not the right one: complex eigenvalues with negative real part do no harm, a zero eigenvalue does.
    """
    K = np.asarray(K, dtype=float)
    eigenvalues = linalg.eigvals(K)
    distance = branch_distance(eigenvalues)
    worst = complex(eigenvalues[int(np.argmin(distance))])
    advice = "use more data, a shorter sampling time or a smaller dictionary, or predictor='one_step', which needs no logarithm."
    if distance.min() <= len(K) * np.finfo(float).eps * np.abs(eigenvalues).max():
        shown = f"{worst.real:.6g}" if worst.imag == 0 else f"{worst:.6g}"
        raise LogarithmError(
            f"the Koopman matrix has the eigenvalue {shown}, to working precision on the closed negative real axis, where no principal "
            f"logarithm exists: {advice}",
            worst,
        )
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")  # the residual is checked instead
        try:
            logarithm = np.real(linalg.logm(K))
            residual = float(linalg.norm(linalg.expm(logarithm) - K) / linalg.norm(K))
        except (ValueError, linalg.LinAlgError):
            residual = np.inf
    if not residual <= 1e-8:  # NaN included
        raise LogarithmError(
            f"the logarithm of the Koopman matrix cannot be computed accurately (relative residual {residual:.1e}): its eigenvalue {worst:.6g} "
            f"is too close to the closed negative real axis, {advice}",
            worst,
        )
    return logarithm, residual


def generator(K, dt):
    """``A = log(K) / dt``, equation (15): d/dt of ``psi^T a`` is ``psi^T A a``. (N, N) -> (N, N) in 1/s."""
    return principal_logarithm(K)[0] / dt


def field_by_coordinates(A, dictionary):
    """W (n, N) read off the generator: the columns of the states, since d/dt x_i = psi^T A e_i."""
    return A[:, dictionary.coordinates].T.copy()


def field_by_least_squares(A, dictionary, recording, R):
    """W (n, N) of ``F(x, u) = W psi(x, u)`` from equation (18), over all data points.

    Minimises the sum over the points of ``|(d psi / d x) W psi - A^T psi|^2``, one equation a function and point. With
    ``q = R^-T psi`` the unknown is V = W R^T, and the matrix of its normal equations, the sum of ``(J^T J) kron (q q^T)`` with
    J = d psi / d x, is as well conditioned as ``J^T J``: the ill-conditioning of Psi stays out of it.

    Parameters
    ----------
    A : (N, N) ndarray
        Generator in 1/s.
    dictionary : Dictionary
    recording : Recording
    R : (N, N) ndarray
        Triangular factor of Psi_x, `LeastSquares.R`.
    """
    N, n = len(A), dictionary.n_states_
    H, B = np.zeros((n, n, N, N)), np.zeros((n, N))
    block = max(256, 4_000_000 // (N * n))
    for x, u, _ in snapshot_pairs(recording, block):
        psi = dictionary(x, u).T
        J = np.ascontiguousarray(np.moveaxis(dictionary.jacobian(x, u), 0, -1))  # (N, n, points)
        q = linalg.solve_triangular(R, psi, trans="T", check_finite=False)
        rate = A.T @ psi
        for i in range(n):
            B[i] += q @ np.einsum("jp,jp->p", J[:, i], rate)
            for k in range(i + 1):
                H[i, k] += (q * np.einsum("jp,jp->p", J[:, i], J[:, k])) @ q.T
    for i in range(n):
        for k in range(i):
            H[k, i] = H[i, k].T
    V = linalg.solve(H.transpose(0, 2, 1, 3).reshape(n * N, n * N), B.ravel(), assume_a="pos").reshape(n, N)
    return linalg.solve_triangular(R, V.T, check_finite=False).T
