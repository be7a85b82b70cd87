"""Dictionaries: size, values, Jacobians, scikit-learn conventions."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.base import clone

import tras
from tras.dictionaries.kinds import KINDS

RNG = np.random.default_rng(0)
DICTIONARIES = [
    tras.Monomials(1),
    tras.Monomials(2),
    tras.Monomials(4),
    tras.Exponentials(2, rate=0.7),
    tras.Fourier(2),
    tras.GaussianRBF(2),
    tras.GaussianRBF(5, width="auto", seed=5, centres="kmeans"),
    tras.ThinPlate(5, centres="data"),
    tras.Union(tras.Monomials(2), tras.GaussianRBF(3)),
    tras.Product(tras.Fourier(1), tras.Monomials(2)),
    tras.Union(tras.Monomials(2), tras.Product(tras.Exponentials(), tras.ThinPlate(3, centres="uniform"))),
]
MECHANICAL = [
    tras.Mechanical(),
    tras.Mechanical(3, shape=[0, 2]),
    tras.Mechanical(2, positions=[0, 1], velocities=[3, 2], shape=[1]),
]
SIZES = [(1, 0), (1, 1), (2, 0), (4, 2)]
CASES = [(d, n, m) for d in DICTIONARIES for n, m in SIZES] + [(d, 4, m) for d in MECHANICAL for m in (0, 2)]


def test_every_kind_is_tried():
    assert {type(dictionary) for dictionary in [*DICTIONARIES, *MECHANICAL]} == set(KINDS.values())


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


@pytest.mark.parametrize("dictionary, n, m", CASES)
def test_jacobian_against_central_differences(dictionary, n, m):
    psi = clone(dictionary)
    x, u = RNG.uniform(-1, 1, (6, n)), RNG.uniform(-1, 1, (6, m))
    jacobian, h = psi.fit(x, u).jacobian(x, u), 1e-5
    assert jacobian.shape == (6, len(psi.names), n)
    for i in range(n):
        step = h * np.eye(n)[i]
        assert np.allclose(jacobian[..., i], (psi(x + step, u) - psi(x - step, u)) / (2 * h), rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("dictionary", DICTIONARIES + MECHANICAL, ids=repr)
def test_shapes_coordinates_and_names(dictionary):
    psi = clone(dictionary)
    x, u = RNG.uniform(-1, 1, (3, 5, 4)), RNG.uniform(-1, 1, (3, 5, 2))
    values = psi(x, u)
    assert values.shape == (3, 5, len(psi.names)) and psi.jacobian(x, u).shape == (3, 5, len(psi.names), 4)
    assert np.allclose(values[1, 2], psi(x[1, 2], u[1, 2]), rtol=1e-13, atol=1e-14)
    assert len({*psi.names}) == len(psi.names)
    assert np.linalg.matrix_rank(psi(RNG.uniform(-1, 1, (900, 4)), RNG.uniform(-1, 1, (900, 2)))) == len(psi.names)
    assert np.array_equal(values[..., psi.coordinates], x)
    assert list(psi.get_feature_names_out(["phi", "phidot", "psi", "psidot", "u_phi", "u_psi"])[[1, 5]]) == [
        "phi",
        "u_phi",
    ]


def test_gaussians_are_gaussians_at_their_centres():
    psi = tras.GaussianRBF(7, width=0.8, seed=3)
    x, u = RNG.uniform(-1, 1, (9, 2)), RNG.uniform(-1, 1, (9, 1))
    values = psi(x, u)
    z = np.hstack([x, u])
    assert np.allclose(values[:, 4:], np.exp(-((z[:, None] - psi.centres_) ** 2).sum(-1) / 0.8**2), rtol=1e-13)
    assert psi.centres_.shape == (7, 3) and np.abs(psi.centres_).max() <= 1
    assert np.array_equal(psi.centres_, tras.GaussianRBF(7, seed=3).fit(x, u).centres_)


def test_mechanical_spans_the_twin_rotors_own_terms():
    """Every term of the equations of motion, even 1 / J_psi(phi), is in the span: to 1e-3 at degree 8, 1e-6 at 16."""
    plant = tras.PlantParameters()
    x, u = RNG.uniform(-1.2, 1.2, (3000, 4)), RNG.uniform(-0.1, 0.1, (3000, 2))
    field = tras.vector_field(x, u, plant)
    miss = []
    for degree in (8, 16):
        psi = tras.Mechanical(degree)(x / 1.2, u / 0.1)
        miss.append(np.abs(psi @ np.linalg.lstsq(psi, field, rcond=None)[0] - field).max() / np.abs(field).max())
    assert miss[0] < 1e-3 and miss[1] < 1e-6


def test_mechanical_reads_off_roles():
    psi = tras.Mechanical(2, positions=[0, 2], velocities=[1, 3]).fit(np.zeros((1, 4)), np.zeros((1, 2)))
    names = psi.feature_names(["q1", "v1", "q2", "v2", "a", "b"])
    assert names[:7] == ["1", "q1", "v1", "q2", "v2", "a", "b"]
    assert {"T2(q1)", "T1(q1) a", "T2(q1) q2", "T1(q1) v1 v2", "v2 v2"} <= {*names}
    assert not any("q2 q2" in name or "a b" in name or "a a" in name for name in names)


def test_union_and_product_hold_every_function_once():
    x, u = RNG.uniform(-1, 1, (9, 2)), RNG.uniform(-1, 1, (9, 1))
    assert tras.Union(tras.Monomials(3), tras.Monomials(2)).fit(x, u).names == tras.Monomials(3).fit(x, u).names
    squares = tras.Product(tras.Monomials(1), tras.Monomials(1)).fit(x, u)
    assert len(squares.names) == 10
    assert np.allclose(np.sort(squares(x, u)), np.sort(tras.Monomials(2)(x, u)))
    by_list, by_name = (
        tras.Union([tras.Monomials(2), tras.Fourier()]),
        tras.Union(parts=[tras.Monomials(2), tras.Fourier()]),
    )
    assert np.array_equal(by_list(x, u), by_name(x, u)) and np.array_equal(clone(by_list)(x, u), by_list(x, u))


def test_centres_from_data_lie_in_the_data():
    x, u = RNG.normal(0.5, 0.1, (500, 2)), RNG.normal(-0.5, 0.1, (500, 1))
    data = tras.GaussianRBF(6, centres="data").fit(x, u).centres_
    assert all(np.any(np.all(np.isclose(row, np.hstack([x, u])), axis=1)) for row in data)
    means = tras.GaussianRBF(6, width="auto", centres="kmeans").fit(x, u)
    assert np.abs(means.centres_ - [0.5, 0.5, -0.5]).max() < 0.35
    distances = np.linalg.norm(means.centres_[:, None] - means.centres_, axis=-1)[np.triu_indices(6, 1)]
    assert means.width_ == pytest.approx(np.median(distances))
    explicit = tras.GaussianRBF(centres=[[0, 0, 0], [0.5, 0.5, -0.5]]).fit(x, u)
    assert explicit.centres_.shape == (2, 3)


@pytest.mark.parametrize(
    "call, words",
    [
        (lambda: tras.Monomials(0)(np.zeros(2)), "degree is 0"),
        (lambda: tras.Monomials(1.5)(np.zeros(2)), "degree is 1.5"),
        (lambda: tras.GaussianRBF(0)(np.zeros(2)), "n_centres is 0"),
        (lambda: tras.GaussianRBF(2, width=0)(np.zeros(2)), "width is 0"),
        (lambda: tras.GaussianRBF(2, width="wide")(np.zeros(2)), "width is 'wide'"),
        (lambda: tras.GaussianRBF(2, centres="best")(np.zeros(2)), "centres is 'best'; choose one of uniform"),
        (lambda: tras.GaussianRBF(centres=[[0.0]])(np.zeros(2)), "centres has shape .1, 1."),
        (lambda: tras.GaussianRBF(9, centres="data")(np.zeros((4, 2))), "n_centres is 9 but there are only 4"),
        (lambda: tras.Exponentials(0)(np.zeros(2)), "order is 0"),
        (lambda: tras.Fourier(1, period=-1)(np.zeros(2)), "period is -1"),
        (lambda: tras.Union(tras.Monomials(2), 3)(np.zeros(2)), "parts is .*give dictionaries"),
        (lambda: tras.Product(tras.Monomials(2))(np.zeros(2)), "parts holds 1 dictionaries"),
        (lambda: tras.Mechanical()(np.zeros(3)), "do not pair the 3 states"),
        (lambda: tras.Mechanical(shape=[1])(np.zeros(4)), "shape .1. must name positions"),
        (lambda: tras.Monomials(2)(np.zeros((3, 2)), np.zeros((4, 1))), "same leading axes"),
        (lambda: tras.Monomials(2).fit(np.zeros((3, 2)))(np.zeros((3, 4))), "fitted to 2 and 0"),
    ],
)
def test_mistakes_are_named(call, words):
    with pytest.raises(ValueError, match=words):
        call()
