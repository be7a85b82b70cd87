"""Dictionaries: size, values, Jacobians, scikit-learn conventions."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.base import clone

import tras

RNG = np.random.default_rng(0)
DICTIONARIES = [tras.Monomials(1), tras.Monomials(2), tras.Monomials(4), tras.GaussianRBF(2), tras.GaussianRBF(30, width=0.7, seed=5)]
SIZES = [(1, 0), (1, 1), (2, 0), (4, 2)]


@given(st.integers(1, 4), st.integers(0, 3), st.integers(1, 5))
def test_number_of_monomials_is_the_papers(n, m, w):
    psi = tras.Monomials(w).fit(np.zeros((1, n)), np.zeros((1, m)))
    assert len(psi.names) == math.factorial(n + m + w) // (math.factorial(n + m) * math.factorial(w))
    assert len({*psi.names}) == len(psi.names)
    assert (n, m, w) != (4, 2, 2) or len(psi.names) == 28


@settings(deadline=None)
@given(st.integers(0, 10**6))
def test_monomials_are_the_products_that_they_are_called(seed):
    point = np.random.default_rng(seed).uniform(-2, 2, 5)
    psi = tras.Monomials(4)
    values = psi(point[:3], point[3:])
    named = dict(zip(["x1", "x2", "x3", "u1", "u2"], point))
    for value, name in zip(values, psi.names):
        exact = math.prod(named[f.partition("^")[0]] ** int(f.partition("^")[2] or 1) for f in name.split() if f != "1")
        assert value == pytest.approx(exact, rel=1e-12)


@pytest.mark.parametrize("n, m", SIZES)
@pytest.mark.parametrize("dictionary", DICTIONARIES, ids=repr)
def test_jacobian_against_central_differences(dictionary, n, m):
    psi = clone(dictionary)
    x, u = RNG.uniform(-1, 1, (6, n)), RNG.uniform(-1, 1, (6, m))
    jacobian, h = psi.fit(x, u).jacobian(x, u), 1e-5
    assert jacobian.shape == (6, len(psi.names), n)
    for i in range(n):
        step = h * np.eye(n)[i]
        assert np.allclose(jacobian[..., i], (psi(x + step, u) - psi(x - step, u)) / (2 * h), rtol=1e-7, atol=1e-8)


@pytest.mark.parametrize("dictionary", DICTIONARIES, ids=repr)
def test_shapes_coordinates_and_names(dictionary):
    psi = clone(dictionary)
    x, u = RNG.uniform(-1, 1, (3, 5, 4)), RNG.uniform(-1, 1, (3, 5, 2))
    values = psi(x, u)
    assert values.shape == (3, 5, len(psi.names)) and psi.jacobian(x, u).shape == (3, 5, len(psi.names), 4)
    assert np.allclose(values[1, 2], psi(x[1, 2], u[1, 2]), rtol=1e-14)
    assert np.array_equal(values[..., psi.coordinates], x)
    assert list(psi.get_feature_names_out(["phi", "phidot", "psi", "psidot", "u_phi", "u_psi"])[[1, 5]]) == ["phi", "u_phi"]


def test_gaussians_are_gaussians_at_their_centres():
    psi = tras.GaussianRBF(7, width=0.8, seed=3)
    x, u = RNG.uniform(-1, 1, (9, 2)), RNG.uniform(-1, 1, (9, 1))
    values = psi(x, u)
    z = np.hstack([x, u])
    assert np.allclose(values[:, 4:], np.exp(-((z[:, None] - psi.centres_) ** 2).sum(-1) / 0.8**2), rtol=1e-13)
    assert psi.centres_.shape == (7, 3) and np.abs(psi.centres_).max() <= 1
    assert np.array_equal(psi.centres_, tras.GaussianRBF(7, seed=3).fit(x, u).centres_)


@pytest.mark.parametrize(
    "call, words",
    [
        (lambda: tras.Monomials(0)(np.zeros(2)), "degree is 0"),
        (lambda: tras.Monomials(1.5)(np.zeros(2)), "degree is 1.5"),
        (lambda: tras.GaussianRBF(0)(np.zeros(2)), "n_centres is 0"),
        (lambda: tras.GaussianRBF(2, width=0)(np.zeros(2)), "width is 0"),
        (lambda: tras.Monomials(2)(np.zeros((3, 2)), np.zeros((4, 1))), "same leading axes"),
        (lambda: tras.Monomials(2).fit(np.zeros((3, 2)))(np.zeros((3, 4))), "fitted to 2 and 0"),
    ],
)
def test_mistakes_are_named(call, words):
    with pytest.raises(ValueError, match=words):
        call()
