"""K, its logarithm and the vector field against closed forms and extended precision."""

import pickle

import mpmath
import numpy as np
import pytest
from conftest import linear_system, ode_recording
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import linalg
from scipy.linalg import expm

import tras
from tras import koopman
from tras.dictionaries import base as dictionaries
from tras.dictionaries.base import Dictionary
from tras.generator import LogarithmError, branch_distance, field_by_least_squares, generator, principal_logarithm
from tras.solver.least_squares import least_squares

A4 = np.array([[0, 1, 0, 0], [-3, -0.4, 0.2, 0], [0, 0, 0, 1], [0.1, 0, -1, -0.3]])
B4 = np.array([[0, 0], [2, 0], [0, 0], [0, 1.5]])


def test_pairs_stay_inside_their_trajectory_and_share_the_input():
    """Samples carry (trajectory, time), so that every pair can be checked by eye."""
    lengths = [3, 1, 5, 2]
    x = [np.column_stack([np.full(k, i), np.arange(k)]).astype(float) for i, k in enumerate(lengths)]
    recording = tras.Recording(x, [10 * a[:, :1] + a[:, 1:] for a in x], 1.0)
    for block in (1, 2, 3, 100):
        blocks = list(koopman.snapshot_pairs(recording, block))
        xs, us, ys = (np.concatenate(part) for part in zip(*blocks))
        assert len(xs) == recording.pairs == 7
        assert np.array_equal(xs[:, 0], ys[:, 0]) and np.array_equal(xs[:, 1] + 1, ys[:, 1])
        assert np.array_equal(us[:, 0], 10 * xs[:, 0] + xs[:, 1])


@settings(max_examples=30, deadline=None)
@given(lengths=st.lists(st.integers(1, 40), min_size=1, max_size=6), block=st.integers(1, 60), lot=st.integers(1, 9))
def test_dealing_gives_every_pair_once_and_blocks_of_one_size(lengths, block, lot):
    x = [np.column_stack([np.full(k, i), np.arange(k)]).astype(float) for i, k in enumerate(lengths)]
    recording = tras.Recording(x, [a[:, :1] + a[:, 1:] for a in x], 1.0)
    blocks = list(koopman.snapshot_pairs(recording, block, deal=lot))
    pairs = sorted(tuple(row) for part in blocks for row in np.hstack(part).tolist())
    assert pairs == [(i, k, i + k, i, k + 1) for i, length in enumerate(lengths) for k in range(length - 1)]
    if recording.pairs >= block + lot:
        assert min(len(part[0]) for part in blocks) >= block - lot + 1


@pytest.mark.slow
@pytest.mark.parametrize("inputs", ["none", "held", "moving", "states alone"])
@pytest.mark.parametrize(
    "dictionary",
    [
        tras.Monomials(3),
        tras.GaussianRBF(20, 1.0),
        tras.Mechanical(3),
        tras.Product(tras.Fourier(1), tras.Monomials(1)),
    ],
)
def test_rows_are_the_liftings_of_both_ends(dictionary, inputs, monkeypatch):
    """... whether the second lifting is computed or is the next pair's first, in blocks above and below a strip."""
    monkeypatch.setattr(dictionaries, "STRIP", 256)
    rng = np.random.default_rng(0)
    x = [rng.uniform(-1, 1, (k, 2)) for k in (700, 3, 2, 90)]
    u = [
        {
            "moving": rng.uniform(-1, 1, (len(a), 1)),
            "held": np.repeat(rng.uniform(-1, 1, (len(a) // 7 + 1, 1)), 7, axis=0)[: len(a)],
        }.get(inputs)
        for a in x
    ]
    recording = tras.Recording(x, None if u[0] is None else u, 1.0)
    lift = koopman.lifted_linear_rows if inputs == "states alone" else koopman.rows
    for deal in (0, 1, koopman.SUIT):
        for x, u, y in koopman.snapshot_pairs(recording, 300, deal):
            fitted = dictionary.fit(x, u)
            work, alone = koopman.lifting(fitted, lift), koopman.regressors_alone(fitted, lift)
            assert np.array_equal(alone((x, u, y)), work((x, u, y))[0])
            for regressors, change in (lift(fitted, x, u, y), work((x, u, y)), work((x, u, y))):
                single = [np.array([fitted(a, b) for a, b in zip(end, u)]) for end in (x, y)]
                assert regressors.flags.f_contiguous and change.flags.f_contiguous
                assert np.allclose(regressors, single[0], rtol=0, atol=1e-13) and np.allclose(
                    change, single[1] - single[0], rtol=0, atol=1e-13
                )


def test_inputs_stand_behind_the_states_in_rows_of_a_lifted_linear_model():
    rng = np.random.default_rng(0)
    x, u, y = rng.normal(size=(50, 2)), rng.normal(size=(50, 2)), rng.normal(size=(50, 2))
    psi = tras.Monomials(2).fit(x)
    regressors, change = koopman.lifted_linear_rows(psi, x, u, y)
    assert np.array_equal(regressors, np.hstack([psi(x)[:, :3], u, psi(x)[:, 3:]])) and np.array_equal(
        change, psi(y) - psi(x)
    )


@pytest.mark.parametrize("options", [{}, {"predictor": "lifted_linear"}, {"predictor": "one_step", "delays": 2}])
def test_a_fit_has_the_same_bits_for_any_number_of_threads(options):
    rng = np.random.default_rng(0)
    x = np.cumsum(rng.normal(size=(3, 9001, 2)), axis=1) * 0.01
    recording = tras.Recording(x, rng.uniform(-1, 1, (3, 9001, 1)), 0.1)
    one, three = (
        tras.KoopmanModel(tras.Monomials(3), **{"predictor": "one_step"} | options, strength=1e-6).fit(
            recording, threads=k
        )
        for k in (1, 3)
    )
    assert np.array_equal(one.koopman_matrix, three.koopman_matrix) and one.condition_number == three.condition_number
    with pytest.raises(ValueError, match="threads = 0; give the number of threads, 1 or more"):
        tras.KoopmanModel(tras.Monomials(3)).fit(recording, threads=0)


def test_a_jump_between_trajectories_does_not_reach_k():
    recording, Ad, Bd = linear_system(A4, B4, 0.05)
    K = tras.KoopmanModel(tras.Monomials(1), "one_step").fit(recording)
    prediction = K.predict(recording)
    assert np.allclose(prediction, recording.states, atol=1e-10)
    joined = tras.Recording(recording.states.reshape(1, -1, 4), recording.inputs.reshape(1, -1, 2), recording.dt)
    wrong = tras.KoopmanModel(tras.Monomials(1), "one_step").fit(joined)
    assert np.abs(wrong.koopman_matrix - K.koopman_matrix).max() > 1e-3


def test_least_squares_in_blocks_equals_extended_precision():
    rng = np.random.default_rng(0)
    X = rng.normal(size=(300, 6)) @ np.diag([1, 1e3, 1e-3, 1, 1, 1]) + 1e-3 * rng.normal(size=(300, 1))
    Y = rng.normal(size=(300, 2))
    fit = least_squares((X[k : k + 37], Y[k : k + 37]) for k in range(0, 300, 37))
    mpmath.mp.dps = 50
    MX, MY = mpmath.matrix(X.tolist()), mpmath.matrix(Y.tolist())
    exact = mpmath.inverse(MX.T * MX) * (MX.T * MY)
    exact = np.array(exact.tolist(), dtype=float)
    assert np.allclose(fit.coefficients, exact, rtol=1e-11)
    assert fit.condition_number == pytest.approx(np.linalg.cond(X), rel=1e-6)
    assert np.allclose(fit.residual, np.sqrt(np.mean((X @ exact - Y) ** 2, axis=0)), rtol=1e-10)
    assert np.allclose(fit.R.T @ fit.R, X.T @ X, rtol=1e-10, atol=1e-10)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6), st.floats(-3, 3), st.floats(-3, 3))
def test_k_is_linear_in_what_it_predicts(seed, a, b):
    """(3): the coefficients of a f + b g are a (those of f) + b (those of g)."""
    rng = np.random.default_rng(seed)
    X, f, g = rng.normal(size=(50, 5)), rng.normal(size=(50, 2)), rng.normal(size=(50, 2))
    solve = lambda Y: least_squares([(X, Y)]).coefficients  # noqa: E731
    assert np.allclose(solve(a * f + b * g), a * solve(f) + b * solve(g), atol=1e-12)


def test_linear_system_gives_its_exponential_and_log_gives_it_back():
    """K of a linear system is the matrix exponential; its logarithm is the system, both to 1e-10."""
    dt = 0.05
    recording, Ad, Bd = linear_system(A4, B4, dt)
    psi = tras.Monomials(1).fit(recording.states, recording.inputs)
    K, _ = koopman.koopman_matrix(psi, recording)
    exact = np.zeros((7, 7))
    exact[0, 0], exact[1:5, 1:5], exact[5:, 1:5], exact[5:, 5:] = 1, Ad.T, Bd.T, np.eye(2)
    assert np.abs(K - exact).max() <= 1e-10
    A = generator(K, dt)
    assert np.abs(A[1:5, 1:5] - A4.T).max() <= 1e-10 and np.abs(A[5:, 1:5] - B4.T).max() <= 1e-10
    assert np.abs(A[:, [0, 5, 6]]).max() <= 1e-10  # the generator does not act on the constant, nor on u


class SlowManifold(Dictionary):
    """(1, x1, x2, x1^2), closed under x1' = mu x1, x2' = lambda (x2 - x1^2) (Brunton et al., PLoS ONE 11, 2016)."""

    def _build(self):
        return 1

    def _fill(self, psi, z):
        psi[3] = z[0] ** 2

    def _fill_slopes(self, slopes, psi, z):
        slopes[3, 0] = 2 * z[0]

    def _tail_names(self, channels):
        return [f"{channels[0]}^2"]


def test_slow_manifold_has_its_exact_spectrum():
    """Closed form: the generator's eigenvalues are 0, mu, lambda and 2 mu, K's their exponentials, F is exact."""
    mu, lam, dt = -0.05, -1.0, 0.1
    recording = ode_recording(lambda x, u: [mu * x[0], lam * (x[1] - x[0] ** 2)], dt, n=2)
    psi = SlowManifold().fit(recording.states)
    K, _ = koopman.koopman_matrix(psi, recording)
    A = generator(K, dt)
    assert np.allclose(np.sort(np.linalg.eigvals(A).real), [lam, 2 * mu, mu, 0], atol=1e-9)
    assert np.allclose(np.sort(np.linalg.eigvals(K).real), np.exp(np.array([lam, 2 * mu, mu, 0]) * dt), atol=1e-10)
    model = tras.KoopmanModel(SlowManifold()).fit(recording)
    x = np.random.default_rng(1).uniform(-1, 1, (20, 2))
    exact = np.column_stack([mu * x[:, 0], lam * (x[:, 1] - x[:, 0] ** 2)])
    assert np.allclose(model.vector_field(x), exact, atol=1e-8)


def test_vector_field_of_a_polynomial_system_with_input():
    """x1' = -x1 + u, x2' = -0.3 x2 + x1^2 - u x1: monomials of degree 2 span the field, not their rates.

    The states' columns give the field. Equation (18) also asks the rates of x2^2, x1 x2, ... to fit, which they cannot,
    and that error shows in F: the reason why "coordinates" is the default.
    """
    rate = lambda x, u: np.array([-x[0] + u[0], -0.3 * x[1] + x[0] ** 2 - u[0] * x[0]])  # noqa: E731
    recording = ode_recording(rate, 0.001, n=2, m=1, trajectories=200, samples=4)
    rng = np.random.default_rng(1)
    x, u = rng.uniform(-0.9, 0.9, (50, 2)), rng.uniform(-0.9, 0.9, (50, 1))
    error = {}
    for field in ("coordinates", "least_squares"):
        model = tras.KoopmanModel(tras.Monomials(2), field=field).fit(recording)
        error[field] = np.abs(model.vector_field(x, u) - rate(x.T, u.T).T).max()
    assert error["coordinates"] <= 2e-3
    assert error["least_squares"] >= 50 * error["coordinates"]
    # ... and the model says how far the two are apart, in the root mean square over the data.
    plain = tras.KoopmanModel(tras.Monomials(2)).fit(recording)
    x, u = recording.states[:, :-1].reshape(-1, 2), recording.inputs[:, :-1].reshape(-1, 1)
    apart = model.vector_field(x, u) - plain.vector_field(x, u)
    expected = np.sqrt(np.mean(apart**2, axis=0) / np.mean(plain.vector_field(x, u) ** 2, axis=0))
    assert np.allclose(model.field_disagreement_, expected, rtol=1e-6) and expected.max() > 0.05
    assert f"x2 {100 * expected[1]:.2g} %" in model.report()


def test_a_field_that_stands_still_by_either_way_differs_by_nothing():
    """Everything is truncated: K is the identity, and both fields are zero."""
    recording = tras.Recording(np.random.default_rng(0).normal(size=(5, 100, 2)), dt=0.1)
    options = {"field": "least_squares", "regularization": "truncated", "strength": 1.0}
    model = tras.KoopmanModel(tras.Monomials(2), **options).fit(recording)
    assert not model.W_.any() and not model.field_disagreement_.any()
    assert "nan" not in model.report()


def test_vector_field_least_squares_is_equation_18_solved_densely():
    """The whitened normal equations against one big dense least squares, every row of (18) written out."""
    rng = np.random.default_rng(0)
    recording = tras.Recording(rng.uniform(-1, 1, (4, 30, 2)), rng.uniform(-1, 1, (4, 30, 1)), 0.1)
    psi = tras.GaussianRBF(5, seed=2).fit(recording.states, recording.inputs)
    N = len(psi.names)
    A = rng.normal(size=(N, N))
    R = koopman.koopman_matrix(psi, recording)[1].R
    W = field_by_least_squares(A, psi, recording, R)
    x, u = recording.states[:, :-1].reshape(-1, 2), recording.inputs[:, :-1].reshape(-1, 1)
    lifted, J = psi(x, u), psi.jacobian(x, u)
    rows = np.einsum("pji,pk->pjik", J, lifted).reshape(-1, 2 * N)
    dense = np.linalg.lstsq(rows, (lifted @ A).ravel(), rcond=None)[0].reshape(2, N)
    assert np.allclose(W, dense, rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("apart", [0.0, 1e-9])
def test_equation_18_without_one_solution_is_refused(apart):
    """Two states whose slopes are the same, or nearly: no field can be told from another, and SciPy only warns."""
    rng = np.random.default_rng(0)
    recording = tras.Recording(rng.uniform(-1, 1, (2, 30, 2)), rng.uniform(-1, 1, (2, 30, 1)), 0.1)

    class Alike:
        n_states_ = 2

        def lift_with_slopes(self, z):
            slopes = np.ones((2, 2, z.shape[1]))
            slopes[1, 1] += apart
            return z[:2], slopes

    with pytest.raises(np.linalg.LinAlgError, match="equation .18. is singular to working precision; field="):
        field_by_least_squares(np.eye(2), Alike(), recording, np.eye(2))


def test_logarithm_against_extended_precision():
    rng = np.random.default_rng(3)
    K = expm(0.3 * rng.normal(size=(7, 7)))
    mpmath.mp.dps = 40
    exact = np.array(mpmath.logm(mpmath.matrix(K.tolist())).apply(mpmath.re).tolist(), dtype=float)
    assert np.abs(principal_logarithm(K)[0] - exact).max() <= 1e-13 * np.abs(exact).max() * np.linalg.cond(K)


def test_the_logarithm_does_not_depend_on_the_global_generator(monkeypatch):
    """SciPy's logm draws from it: one seed in a hundred gave a fit of 10 Gaussians other last bits."""
    draws, logm = [], linalg.logm

    def watched(K):
        draws.append(np.random.get_state()[1].copy())
        return logm(K)

    monkeypatch.setattr(linalg, "logm", watched)
    for seed in (1, 2):
        np.random.seed(seed)
        before = np.random.get_state()
        principal_logarithm(expm(0.1 * A4))
        assert np.array_equal(np.random.get_state()[1], before[1]) and np.random.get_state()[2] == before[2]
    assert np.array_equal(draws[0], draws[1])


@pytest.mark.parametrize(
    "K, eigenvalue",
    [
        (np.diag([1.0, 0.9, -0.5]), -0.5),
        (np.diag([1.0, 0.0, 0.5]), 0.0),
        (np.array([[1.0, 1.0], [1.0, 1.0]]), 0.0),
    ],
)
def test_no_principal_logarithm_is_said_with_the_eigenvalue(K, eigenvalue):
    with pytest.raises(LogarithmError, match="closed negative real axis.*more data.*one_step") as caught:
        principal_logarithm(K)
    assert abs(caught.value.eigenvalue - eigenvalue) < 1e-12
    again = pickle.loads(pickle.dumps(caught.value))  # as it travels from a worker process
    assert str(again) == str(caught.value) and again.eigenvalue == caught.value.eigenvalue


def test_dead_time_has_no_logarithm():
    """A zero Jordan block, as a delay of whole samples gives it, in a random basis: its eigenvalues are eps^(1/3)."""
    for seed in range(6):
        S = np.random.default_rng(seed).normal(size=(4, 4))
        K = S @ np.array([[0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 0], [0, 0, 0, 0.9]]) @ np.linalg.inv(S)
        with pytest.raises(LogarithmError, match="closed negative real axis"):
            principal_logarithm(K)


def test_negative_real_parts_alone_do_no_harm():
    """The paper asks for eigenvalues with real parts >= 0; a rotation by 120 degrees has none, and yet a logarithm."""
    K = 0.9 * np.array([[np.cos(2.1), np.sin(2.1)], [-np.sin(2.1), np.cos(2.1)]])
    assert np.all(np.linalg.eigvals(K).real < 0)
    assert np.allclose(principal_logarithm(K)[0], [[np.log(0.9), 2.1], [-2.1, np.log(0.9)]], atol=1e-13)


def test_branch_distance():
    assert np.allclose(branch_distance([1, -1, 1j, -1 + 0.1j, 0.3 + 0.4j]), [1, 0, 1, 0.1, 0.5])


def test_too_few_pairs_and_dependent_functions_are_named():
    rng = np.random.default_rng(0)
    few = tras.Recording(rng.normal(size=(1, 8, 2)), dt=0.1)
    with pytest.raises(ValueError, match="7 snapshot pairs cannot determine 10 functions"):
        koopman.koopman_matrix(tras.Monomials(3).fit(few.states), few)
    x = rng.normal(size=(1, 100, 1))
    twin = tras.Recording(np.dstack([x, 2 * x]), dt=0.1)
    psi = tras.Monomials(1).fit(twin.states)
    with pytest.raises(ValueError, match="linearly dependent.*rank 2; .*x1, x2"):
        koopman.koopman_matrix(psi, twin, psi.names)
