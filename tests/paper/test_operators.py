"""Quality of the operator: residuals of eigenpairs, eigenfunctions, projection error."""

import numpy as np
import pytest
from conftest import ode_recording
from test_koopman import SlowManifold

import tras
from tras.paper import operators

MU, LAM, DT = -0.05, -1.0, 0.1
EXACT = np.exp(DT * np.array([0, MU, 2 * MU, LAM]))  # largest first


def slow(x, u):
    return [MU * x[0], LAM * (x[1] - x[0] ** 2)]


@pytest.fixture(scope="module")
def recording():
    return ode_recording(slow, DT, n=2)


@pytest.fixture(scope="module")
def fresh():
    return ode_recording(slow, DT, n=2, trajectories=10, seed=7)


@pytest.fixture(scope="module")
def closed(recording):
    return tras.KoopmanModel(SlowManifold()).fit(recording)


@pytest.fixture(scope="module")
def gaussian(recording):
    """x1 is an eigenfunction, and in the dictionary; the Gaussians close nothing."""
    return tras.KoopmanModel(tras.GaussianRBF(12), "one_step", strength=0.0).fit(recording)


def test_exact_eigenpairs_have_no_residual(closed, fresh):
    table = operators.residuals(closed, fresh)
    assert list(table) == ["real", "imag", "modulus", "rate", "frequency", "residual", "relative", "spurious"]
    assert np.allclose(table["real"], EXACT, atol=1e-10) and np.allclose(table["modulus"], EXACT, atol=1e-10)
    assert np.allclose(table["rate"], [0, MU, 2 * MU, LAM], atol=1e-9)
    assert np.allclose(table["frequency"], 0, atol=1e-12)
    assert table["residual"].max() <= 1e-9 and table["relative"].max() <= 1e-9 and not table["spurious"].any()


def test_spurious_eigenvalues_are_flagged_and_true_ones_are_not(gaussian, fresh):
    """Of 15 eigenvalues two are certain: 1 (the constant) and exp(mu dt) (x1)."""
    table = operators.residuals(gaussian, fresh)
    assert len(table) == 15
    for exact in EXACT[:2]:
        row = table.iloc[int(np.argmin(np.hypot(table["real"] - exact, table["imag"])))]
        assert abs(row["real"] - exact) <= 1e-9 and row["residual"] <= 1e-9 and not row["spurious"]
    assert table["spurious"].sum() >= 8
    # Complex eigenvalues cannot be right: the system's own are real. All are flagged.
    assert table["spurious"][table["imag"] != 0].all() and (table["imag"] != 0).any()
    # What is not flagged is near products of true ones exp(j mu dt + k lambda dt).
    j, k = np.meshgrid(range(20), range(4))
    true = (j * MU + k * LAM).ravel()
    for row in table[~table["spurious"]].itertuples():
        assert np.abs(true - row.rate).min() <= 0.1 * max(abs(row.rate), 0.05)


def test_a_dictionary_that_is_closed_in_part(recording, fresh):
    """Monomials of degree 2 hold all four eigenfunctions, and x1 x2 and x2^2, which do not close: two spurious."""
    table = operators.residuals(tras.KoopmanModel(tras.Monomials(2)).fit(recording), fresh)
    good = table[~table["spurious"]]
    assert table["spurious"].sum() == 2 and good["residual"].max() <= 1e-9
    assert np.allclose(good["real"], EXACT, atol=1e-9)


def test_residual_by_its_definition(gaussian, fresh):
    table = operators.residuals(gaussian, fresh)
    values, _ = operators.eigenpairs(gaussian)
    f = operators.eigenfunctions(gaussian, fresh.states)
    x, y = f[:, :-1].reshape(-1, 15), f[:, 1:].reshape(-1, 15)
    expected = np.linalg.norm(y - values * x, axis=0) / np.linalg.norm(x, axis=0)
    assert np.allclose(table["residual"], expected, rtol=1e-9, atol=1e-14)
    moving = np.abs(values - 1) > 1e-9
    assert np.allclose(table["relative"][moving], expected[moving] / np.abs(values - 1)[moving], rtol=1e-9, atol=1e-9)


def test_eigenpairs_are_those_of_k_in_the_models_order(gaussian):
    values, vectors = operators.eigenpairs(gaussian)
    assert np.allclose(values, gaussian.eigenvalues, atol=1e-12)
    assert np.allclose(gaussian.koopman_matrix @ vectors, vectors * values, atol=1e-10)
    assert np.all(np.diff(np.abs(values)) <= 1e-12)


def test_eigenfunctions_evolve_by_their_eigenvalue_on_fresh_trajectories(closed, fresh):
    """f(x(t)) = lambda^t f(x(0)), over the whole trajectory."""
    values, _ = operators.eigenpairs(closed)
    f = operators.eigenfunctions(closed, fresh.states)
    assert f.shape == (10, 21, 4)
    assert np.allclose(f, f[:, :1] * values ** np.arange(21)[:, None], atol=1e-9)
    # The closed form of that with eigenvalue lambda: x2 - b x1^2, b = lambda / (lambda - 2 mu), up to a factor.
    x = np.random.default_rng(0).uniform(-1, 1, (50, 2))
    last = operators.eigenfunctions(closed, x)[:, 3]
    exact = x[:, 1] - LAM / (LAM - 2 * MU) * x[:, 0] ** 2
    assert np.allclose(last / last[0], exact / exact[0], atol=1e-8)


def test_projection_error(closed, gaussian, fresh):
    none = operators.projection_error(closed, fresh)
    assert list(none.index) == ["1", "x1", "x2", "x1^2"] and none.max() <= 1e-9 and none["1"] == 0
    some = operators.projection_error(gaussian, fresh)
    assert some["1"] == 0 and some["x1"] <= 1e-9  # closed by themselves
    assert some["x2"] > 0.01 and some.filter(like="gauss").min() > 0.01 and some.max() <= 1


def test_projection_error_of_functions_of_the_input_is_zero(experiment):
    recording = experiment.select(inputs=["u_phi", "u_psi"])
    model = tras.KoopmanModel(tras.Monomials(2), "one_step", strength=0.0).fit(recording)
    error = operators.projection_error(model, recording)
    assert list(error[["u_phi", "u_psi", "u_phi u_psi", "u_psi^2"]]) == [0] * 4
    # On the data that were fitted K cannot be worse than no change.
    assert 0 < error["phidot"] < 0.8 and error.max() <= 1


def test_lifted_linear_is_refused(recording):
    model = tras.KoopmanModel(tras.Monomials(1), "lifted_linear").fit(recording)
    with pytest.raises(ValueError, match="predictor is 'lifted_linear'.*fit with 'vector_field' or 'one_step'"):
        operators.residuals(model, recording)


def test_units_do_not_matter(closed, recording, fresh):
    factors = np.array([100.0, 1e-3])
    other = tras.KoopmanModel(SlowManifold()).fit(tras.Recording(recording.states * factors, dt=DT))
    there = tras.Recording(fresh.states * factors, dt=DT)
    assert np.allclose(operators.residuals(other, there)["real"], EXACT, atol=1e-10)
    assert operators.projection_error(other, there).max() <= 1e-9


def test_an_unfitted_model_says_so(fresh):
    with pytest.raises(ValueError, match="not fitted"):
        operators.residuals(tras.KoopmanModel(tras.Monomials(1)), fresh)
