"""Lifted-linear models ``z+ = A z + B u`` that cannot blow up: least squares with the spectral radius of A bounded.

Every matrix with a bounded power sequence, and no other, is ``A = S^-1 M S`` with S positive definite and ``|M|_2 <=
1`` (N. Gillis, M. Karow, P. Sharma, Linear Algebra Appl. 573, 2019, 37, with M orthogonal times positive semidefinite).
With the misfit of snapshots as cost this is the "SOC" of G. Mamakoukas, O. Xherija, T. D. Murphey, Adv. Neural Inf.
Process. Syst. 33, 2020. Both papers descend along the gradient by S and M. When sampling is fast, A is near the
identity, which commutes with S: the gradient by S nearly vanishes, that by M is ill-conditioned, and the descent
crawls. Here, in turn, S is the Lyapunov norm of the present A, and the problem in M, which is convex, is solved.

The start is improved by a few steps that treat the moduli of the eigenvalues as linear in A (sequential quadratic
programming on ``|lambda_i| <= radius``; compare F. E. Curtis, T. Mitchell, M. L. Overton, Optim. Methods Softw. 32,
2017, 148): they go far at once, but stop where eigenvalues meet. All is done in the coordinates of orthonormal
regressors, in which the free matrix is nearly a contraction already.
"""

import numpy as np
from scipy import linalg, optimize

from tras.workflow import arguments

_LINEAR_STEPS = 5  # more of them only creep
_BAND = 0.05  # eigenvalues this close to the largest are watched in a linearised step
_INSIDE = 1e-6  # A must be strictly stable, or its Lyapunov norm does not exist
_ROUND = 20  # iterations with the same S
_ITERATIONS, _FEW = 100, 300  # by default, up to so many functions; with more as many as take about as long
_WEIGHT = 1e-10  # of a regressor's length, against changes that the data do not determine


def spectral_radius(A) -> float:
    """Largest modulus of the eigenvalues of A (N, N)."""
    return float(np.abs(np.linalg.eigvals(A)).max(initial=0.0))


def stable_change(fit, D, n: int, m: int, **options) -> np.ndarray:
    """`stable_least_squares` in the terms of `tras.koopman.lifted_linear_rows`: rows ``[1, x, u, further functions]``.

    ``fit`` is a `LeastSquares`; D (N + m, N) stands for A - I and B, its coefficients or regularized ones; n and m
    count states and inputs; ``options`` are ``radius``, ``iterations`` and ``unsettled``. Returns (N + m, N), D itself
    if it is stable already.
    """
    p, N = D.shape
    order = np.r_[: 1 + n, 1 + n + m : p, 1 + n : 1 + n + m]
    identity = np.eye(p, N)
    free = D[order] + identity
    coefficients = stable_least_squares(fit.R[:, order], free, **options)
    if coefficients is free:
        return D
    change = np.empty_like(free)
    change[order] = coefficients - identity
    return change


def stable_least_squares(R, free, *, constant=True, radius=1.0, iterations=None, unsettled=None) -> np.ndarray:
    """``[psi(x), u] @ coefficients = psi(y)`` by least squares, with no eigenvalue of A beyond ``radius``.

    The problem is not convex. The result is feasible and never worse than the free solution with its eigenvalues drawn
    back to the circle: on closed-loop data it had less than 1 % of that one's excess cost with 44 to 194 functions, 0.3
    to 6 % with some 30, 26 and 65 % with 14; nine in ten random 2 x 2 problems ended within 4 % of the global optimum.
    It stops when ``iterations`` are used up or twenty of them have gained less than 1 %. No random numbers.

    A mode at exactly one adds up whatever the constant and the inputs feed it. With ``radius = 1 - dt / tau`` every
    mode forgets in about the time tau, and bounded inputs have a bounded response. Slower modes than the training
    trajectories can show are guesses: with these at 5 s, sampled at 0.01 s, and torque inputs, radius 0.999 instead of
    1 brought the error of 500 s free runs from 30-420 % to 6-11 %. A lower cost, being a one-step error, did not.

    Parameters
    ----------
    R : (p, p) ndarray
        Triangular or any other square root of the Gram matrix ``R.T @ R`` of the regressors ``[psi(x), u]``; p = N + m.
        What the data determine to less than 1e-10 (dependent functions) stays where it is, by a weight of that size.
    free : (p, N) ndarray
        The unconstrained solution ``[A B]^T``. If it is a regularized one, the result is the stable model whose
        predictions on the data are near to it.
    constant : bool
        The first function is the constant 1, whose own eigenvalue is one; the bound is on the other functions, for
        which it is an input.
    radius : float
    iterations : int, optional
        Steps on M, of order N^3; 0 leaves the improved start. A hundred take about 0.05 s for 30 functions, 0.5 s for
        100, 3 s for 200. Default: 100, beyond 300 functions as many as take about as long, but 20 at least.
    unsettled : callable, optional
        Called with the number of iterations if these were used up while twenty of them still gained 1 % or more.

    Returns
    -------
    (p, N) ndarray
        A^T in the first N rows, B^T below; ``free`` itself if that is stable already. The eigenvalues that
        `numpy.linalg.eigvals` finds, of A or of its transpose, are at most ``radius`` (but for the constant's): A is
        scaled by what rounding adds to them, some 1e-15, or up to 1e-6 if the regressors are nearly dependent.

    Raises
    ------
    ValueError
        On wrong shapes, NaN or infinity, a first function that is not the constant, or a wrong radius or number.

    Examples
    --------
    >>> import numpy as np
    >>> A = stable_least_squares(np.eye(2), np.diag([1.5, 0.5]), constant=False)  # the nearest in the Frobenius norm
    >>> np.diag(A).round(6)
    array([1. , 0.5])
    """
    R, free, iterations = _checked(R, free, constant, radius, iterations)
    p, N = free.shape
    outer, inner = np.r_[: int(constant), N:p], np.arange(int(constant), N)
    block, rows = np.ix_(inner, inner), np.ix_(outer, inner)
    if _radius(free[block]) <= radius:
        return free
    # Outer regressors first: what the triangle has left of the others is orthogonal to them, and B follows from A
    # (Frisch and Waugh).
    lengths = np.linalg.norm(R, axis=0)
    weights = np.diag(_WEIGHT * np.where(lengths > 0, lengths, 1.0))
    R = np.linalg.qr(np.vstack([R, weights])[:, np.r_[outer, inner]], mode="r")
    k, F = len(outer), free[block].T
    A = _nearest(F, R[k:, k:].T, radius, iterations, unsettled or (lambda count: None))
    coefficients = free.copy()
    coefficients[block] = A.T
    coefficients[rows] -= _triangular(R[:k, :k], R[:k, k:] @ (A - F).T, lower=False)
    coefficients[:, : int(constant)] = np.eye(p, int(constant))
    return coefficients


def _nearest(F, L, radius, iterations, unsettled):
    """A of spectral radius at most ``radius`` with small ``|(A - F) L|_F``; L (N, N) lower triangular."""
    white = _triangular(L, F @ L)  # the coordinates of orthonormal regressors: L^-1 F L
    A = _contractions(white, L, radius, iterations, _linear_steps(white, L, radius), unsettled)
    A = _triangular(L, (L @ A).T, trans="T").T
    plain = _drawn_back(F, radius)[0]
    # False for NaN. True only if the regressors are so nearly dependent that the change of coordinates lost more than
    # was won.
    if np.linalg.norm((plain - F) @ L) < np.linalg.norm((A - F) @ L):
        A = plain
    while (largest := _radius(A)) > radius:  # as computed, by rounding
        A = A / (1 + max(2 * (largest / radius - 1), 1e-15))
    return A


def _linear_steps(free, L, radius):
    """A stable A with small ``|L (A - free)|_F``: eigenvalues drawn back, then steps of linearised problems."""
    cost = _cost(free, L)
    A, w, V = _drawn_back(free, radius)
    if np.isnan(A).any():
        return free * (radius / spectral_radius(free))
    for _ in range(_LINEAR_STEPS):
        step = _linearised(free, L, A, w, V, radius)
        for t in 3.0 ** -np.arange(5):
            trial, *eigen = _drawn_back(A + t * step, radius)
            if cost(trial) < cost(A):
                break
        else:
            break
        A, (w, V) = trial, eigen
    return A


def _drawn_back(A, radius):
    """A with its eigenvalues drawn back to the circle, these, their vectors; A is NaN if these are near parallel."""
    w, V = np.linalg.eig(A)
    w = w * np.minimum(1, radius / np.maximum(np.abs(w), radius))
    if np.linalg.cond(V) > 1e8:
        return np.full_like(A, np.nan), w, V
    return np.real(np.linalg.solve(V.T, (V * w).T).T), w, V


def _linearised(free, L, A, w, V, radius):
    """The step from A to the least ``|L (A - free)|`` with ``|lambda_i| <= radius`` to first order.

    With ``Y = L (A - free)``, ``d |lambda| = Re(conj(lambda) / |lambda| w^H L^-1 dY v)``, v and w the right and left
    eigenvectors, ``w^H v = 1``.
    """
    near = (np.abs(w) > (1 - _BAND) * np.abs(w).max()) & (w.imag >= 0)
    right, w = V[:, near], w[near]
    left = _triangular(L, np.linalg.inv(V)[near].T, trans="T") * (w.conj() / np.abs(w))
    # The slope of |lambda_i| by Y is Re(left_i right_i^T): inner products and sums of them need no N x N array each.
    gram = np.real((left.conj().T @ left) * (right.conj().T @ right) + (left.T @ left) * (right.T @ right)) / 2
    room = radius - np.abs(w) + np.real(np.sum(left * (L @ (A - free) @ right), axis=0))
    u = _least_distance(gram, room)
    return -_triangular(L, np.real((left * u) @ right.T)) + free - A


def _least_distance(gram, room):
    """u >= 0 such that ``-G^T u`` is the least x with ``G x <= room``, ``gram = G G^T``; zeros if there is none.

    C. L. Lawson, R. J. Hanson, *Solving Least Squares Problems*, 1974, Ch. 23.
    """
    values, vectors = np.linalg.eigh(gram)
    big, size = max(values[-1], 1e-300), max(np.abs(room).max(), 1e-300)
    E = np.vstack([(vectors * np.sqrt(np.maximum(values / big, 0))).T, -room / size])
    last = (np.arange(len(E)) == len(E) - 1).astype(float)
    try:
        u = optimize.nnls(E, last, maxiter=100 * len(room))[0]
    except RuntimeError:  # it cycles
        return np.zeros(len(room))
    left_over = 1 - E[-1] @ u  # zero if the inequalities contradict each other
    return u * (size / big / left_over) if left_over > 0 else 0 * u


def _contractions(free, L, radius, iterations, A, unsettled):
    """From A: the best M with the S of its Lyapunov norm, then again, as long as that gains one percent."""
    cost, gram = _cost(free, L), L.T @ L
    for start in range(0, iterations, _ROUND):
        S, M = _in_lyapunov_norm(A * (1 - _INSIDE), radius)
        before = cost(A)
        A = min((A, _best_contraction(free, gram, S, M, radius, min(iterations - start, _ROUND), cost)), key=cost)
        if not cost(A) < 0.99 * before:
            break
    else:
        unsettled(iterations)
    return A


def _best_contraction(free, gram, S, M, radius, iterations, cost):
    """``S^-1 M S`` nearest to ``free`` over ``|M| <= radius``, by alternating directions.

    S. Boyd et al., Found. Trends Mach. Learn. 3, 2011, 1. The quadratic cost is diagonal in the eigenvectors of its two
    factors, so the half step that minimises it is exact.
    """
    inverse = np.linalg.inv(S)
    p, U = np.linalg.eigh(inverse @ gram @ inverse)
    q, V = np.linalg.eigh(S @ S)
    curvature = np.outer(np.maximum(p, 0), q)
    penalty = np.exp(np.mean(np.log(np.maximum(curvature, 1e-30 * curvature.max()))))
    target = U.T @ inverse @ gram @ free @ S @ V
    dual, best = np.zeros_like(M), inverse @ M @ S
    for _ in range(iterations):
        X = U @ ((target + penalty * (U.T @ (M - dual) @ V)) / (curvature + penalty)) @ V.T
        M = _contraction(X + dual, radius)
        dual = dual + X - M
        best = min((best, inverse @ M @ S), key=cost)
    return best


def _in_lyapunov_norm(A, radius):
    """(S, M) with ``A = S^-1 M S`` and ``|M| <= radius``: S^2 is the sum of ``(A^k)^T A^k / radius^2k``.

    Summed by doubling (R. A. Smith, SIAM J. Appl. Math. 16, 1968, 198), which keeps it positive definite whatever the
    rounding. A is strictly stable.
    """
    P, power = np.eye(len(A)), A / radius
    for _ in range(24):  # 2^24 terms: far beyond 1 / _INSIDE
        P, power = P + power.T @ P @ power, power @ power
        if np.linalg.norm(P) > 1e60:  # hopelessly far from normal: what follows will not be better than A
            break
    w, V = np.linalg.eigh((P + P.T) / 2)
    w = np.sqrt(np.maximum(w, w[-1] * 1e-14))
    S = (V * (w / np.sqrt(w[0] * w[-1]))) @ V.T
    return S, _contraction(np.linalg.solve(S, (S @ A).T).T, radius)


def _contraction(M, radius):
    """The nearest matrix of 2-norm at most ``radius``, from the singular values beyond it alone."""
    w, V = linalg.eigh(M.T @ M, subset_by_value=(radius**2, np.inf), check_finite=False)
    return M - (M @ V * (1 - radius / np.sqrt(w))) @ V.T


def _cost(free, L):
    """Excess cost of A in the coordinates of orthonormal regressors; infinite for what is no matrix."""
    return lambda A: np.nan_to_num(np.sum((L @ (A - free)) ** 2), nan=np.inf, posinf=np.inf)


def _triangular(T, b, lower=True, trans="N"):
    return linalg.solve_triangular(T, b, lower=lower, trans=trans, check_finite=False)


def _radius(A):
    """As any caller may compute it: rounding makes the eigenvalues of A and of its transpose differ."""
    return max(spectral_radius(A), spectral_radius(A.T))


def _checked(R, free, constant, radius, iterations):
    R, free = np.asarray(R, dtype=float), np.asarray(free, dtype=float)
    if free.ndim != 2 or R.shape != (len(free), len(free)) or not int(constant) < free.shape[1] <= len(free):
        raise ValueError(
            f"R has shape {R.shape} and free {free.shape}; give a square root (N + m, N + m) of the Gram matrix of "
            f"[psi(x), u] and coefficients (N + m, N), N at least {1 + int(constant)}."
        )
    if not (np.isfinite(R).all() and np.isfinite(free).all()):
        raise ValueError("R or free holds NaN or infinity; repair the data or the fit that it comes from.")
    if constant and np.linalg.norm(R @ (free[:, 0] - np.eye(len(free))[0])) > 1e-6 * np.linalg.norm(R[:, 0]):
        raise ValueError("free does not predict its first function as a constant; put that first, or constant=False.")
    arguments.number("radius", radius, 0, ends=False, give="a positive number, 1 for a model whose powers stay bounded")
    if iterations is None:
        N = free.shape[1]
        iterations = _ITERATIONS if N <= _FEW else max(_ROUND, round(_ITERATIONS * (_FEW / N) ** 3))
    arguments.whole_number("iterations", iterations, 0)
    return R, free, iterations
