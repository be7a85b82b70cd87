"""Each method recovers a system of its class; none crosses a boundary, runs away loudly, or takes a wrong option."""

import warnings

import numpy as np
import pytest
from conftest import linear_system, ode_recording
from sklearn.base import clone

import tras
from tras.paper.baselines import base
from tras.paper.baselines.edmd import PykoopEdmd
from tras.paper.baselines.greybox import GreyBox
from tras.paper.baselines.hammerstein import HammersteinWiener
from tras.paper.baselines.linear import DMDc
from tras.paper.baselines.narx import NeuralNARX, PolynomialNARX, forward_selection
from tras.paper.baselines.sindy import SINDy
from tras.paper.baselines.subspace import N4SID

A, B = [[0, 1], [-2, -0.3]], [[0], [1]]
ALL = [
    DMDc(), N4SID(2, 5, 0), HammersteinWiener(3, 3), PolynomialNARX(2), PolynomialNARX(2, 2, 8),
    NeuralNARX((4,), iterations=20), SINDy(2), PykoopEdmd(2), PykoopEdmd(2, relift=False),
]  # fmt: skip
each = pytest.mark.parametrize("model", ALL, ids=lambda model: " ".join(str(model).split()))


@pytest.fixture(scope="module")
def linear():
    return linear_system(A, B, 0.05, trajectories=10, samples=100)[0]


@pytest.fixture(scope="module")
def polynomial():
    """A map of degree 2 with a product of state and input: ten trajectories from random states."""
    rng = np.random.default_rng(3)
    u = rng.uniform(-1, 1, (10, 60, 1))
    x = np.empty((10, 60, 2))
    x[:, 0] = rng.uniform(-0.5, 0.5, (10, 2))
    for k in range(59):
        a, b, v = x[:, k, 0], x[:, k, 1], u[:, k, 0]
        x[:, k + 1] = np.stack([0.9 * a + 0.1 * b, 0.8 * b - 0.2 * a * a + 0.3 * v + 0.1 * a * v], axis=1)
    return tras.Recording(x, u, 0.1)


def worst(model, recording):
    return float(np.abs(model.predict(recording) - recording.states).max())


LINEAR = [DMDc(), N4SID(2, 5, 0), N4SID(2, 8, 1e-9), PolynomialNARX(1), PykoopEdmd(1), HammersteinWiener(1, 1)]


@pytest.mark.parametrize("model", LINEAR, ids=str)
def test_a_linear_system_is_found_exactly(model, linear):
    fresh = linear_system(A, B, 0.05, trajectories=3, samples=200, seed=9)[0]
    assert worst(clone(model).fit(linear), fresh) < 1e-9


def test_n4sid_finds_the_poles_and_a_rest_away_from_zero(linear):
    moved = tras.Recording(linear.states + [5.0, 0.0], linear.inputs + 3.0, 0.05)
    model = N4SID(2, 5, 0).fit(moved)
    expected = np.linalg.eigvals(linear_system(A, B, 0.05)[1])
    assert np.allclose(np.sort_complex(np.linalg.eigvals(model.A_)), np.sort_complex(expected), atol=1e-9)
    assert worst(model, moved) < 1e-8


@pytest.mark.parametrize("model", [PolynomialNARX(2), PolynomialNARX(3, terms=9), PykoopEdmd(2)], ids=str)
def test_a_polynomial_map_is_found_exactly(model, polynomial):
    assert worst(clone(model).fit(polynomial), polynomial) < 1e-9
    assert worst(DMDc().fit(polynomial), polynomial) > 0.01


def test_forward_selection_takes_first_what_explains_most():
    rng = np.random.default_rng(0)
    columns = rng.standard_normal((200, 5))
    columns[:, 4] = columns[:, 0] + 1e-9 * columns[:, 1]  # depends on the first one
    target = 3 * columns[:, 2] - 2 * columns[:, 0] + 0.1 * columns[:, 3]
    order = forward_selection(columns, target, 5)
    assert list(order[:3]) in ([2, 0, 3], [2, 4, 3]) and not {0, 4} <= set(order[:3])
    assert list(forward_selection(columns, target, 1)) == [2]


def test_terms_are_counted_for_each_state(polynomial):
    assert PolynomialNARX(2, terms=2).fit(polynomial).n_parameters_ == 4


def test_two_lags_find_what_one_cannot():
    """The mean of two inputs acts: a model of one lag misses it, one of two has it from its second step on."""
    rng = np.random.default_rng(0)
    u = rng.uniform(-1, 1, (8, 80, 1))
    x = np.zeros((8, 80, 1))
    x[:, 0] = rng.uniform(-1, 1, (8, 1))
    for k in range(1, 79):
        x[:, 1] = 0.5 * x[:, 0] + 0.5 * u[:, 0]
        x[:, k + 1] = 0.5 * x[:, k] + 0.25 * (u[:, k] + u[:, k - 1])
    recording = tras.Recording(x, u, 1.0)
    one, two = (PolynomialNARX(1, lags).fit(recording) for lags in (1, 2))
    late = slice(20, None)
    assert np.abs(one.predict(recording) - x)[:, late].max() > 0.1
    assert np.abs(two.predict(recording) - x)[:, late].max() < 1e-5


def test_sindy_finds_the_terms_of_a_field():
    def duffing(x, u):
        return np.array([x[1], -x[0] - 0.2 * x[1] - 0.5 * x[0] ** 3 + u[0]])

    recording = ode_recording(duffing, 0.02, n=2, m=1, trajectories=12, samples=40)
    fresh = ode_recording(duffing, 0.02, n=2, m=1, trajectories=4, samples=60, seed=5)
    model = SINDy(3, 0.05, 1e-9, "forward").fit(recording)
    assert worst(model, fresh) < 0.02 and model.n_parameters_ < 20
    linear = SINDy(1, 0.0, 1e-9, "forward").fit(recording)
    assert worst(linear, fresh) > 2 * worst(model, fresh)


def test_sindy_steps_as_pysindy_says(polynomial):
    """Our batched evaluation of its coefficients is the library's own."""
    import pysindy

    x = (polynomial.states[0] - polynomial.states.min((0, 1))) / np.ptp(polynomial.states, axis=(0, 1)) * 2 - 1
    library = pysindy.PolynomialLibrary(degree=3).fit(x)
    assert np.allclose(base.Monomial(library.powers_)(x.T).T, np.asarray(library.transform(x)))


def test_edmd_predicts_as_pykoop_does(polynomial):
    for relift in (True, False):
        model = PykoopEdmd(2, alpha=0.1, relift=relift).fit(polynomial)
        x = (polynomial.states[0] - model.x_offset_) / model.x_scale_
        u = (polynomial.inputs[0] - model.u_offset_) / model.u_scale_
        theirs = model.pipeline_.predict_trajectory(x[:1], u, relift_state=relift, episode_feature=False)
        ours = (model.predict(polynomial)[0] - model.x_offset_) / model.x_scale_
        assert np.allclose(ours, theirs[:, :2], atol=1e-10)


def test_a_hammerstein_wiener_system_is_found():
    rng = np.random.default_rng(1)
    u = rng.uniform(-1, 1, (10, 120, 1))
    v = np.zeros((10, 120, 2))
    v[:, 0] = rng.uniform(-0.5, 0.5, (10, 2))
    for k in range(119):
        curved = u[:, k, 0] + 0.6 * u[:, k, 0] ** 2 - 0.3 * u[:, k, 0] ** 3
        v[:, k + 1] = np.stack([0.9 * v[:, k, 0] + 0.2 * v[:, k, 1], 0.8 * v[:, k, 1] + 0.3 * curved], axis=1)
    x = v.copy()
    for _ in range(60):  # x + 0.1 x^3 = v, by Newton's method
        x -= (x + 0.1 * x**3 - v) / (1 + 0.3 * x**2)
    recording = tras.Recording(x, u, 0.1)
    whole, straight = HammersteinWiener(3, 3).fit(recording), HammersteinWiener(3, 1).fit(recording)
    assert worst(whole, recording) < 2e-4 < 0.01 < worst(straight, recording)
    assert worst(HammersteinWiener(1, 3).fit(recording), recording) > 0.05


def test_the_network_learns_a_map(polynomial):
    model = NeuralNARX((8,), iterations=300).fit(polynomial)
    span = np.ptp(polynomial.states)
    assert worst(model, polynomial) < 0.02 * span
    assert np.array_equal(model.predict(polynomial), clone(model).fit(polynomial).predict(polynomial))
    assert worst(DMDc().fit(polynomial), polynomial) > 3 * worst(model, polynomial)


def test_the_grey_box_finds_the_parameters(experiment, parameters):
    train = experiment.select(inputs=["u_phi", "u_psi"])
    model = GreyBox(1.0).fit(train[:12])
    for name, value in model.parameters_.items():
        assert value == pytest.approx(getattr(parameters, name), rel=1e-5), name
    assert worst(model, train[12:]) < 1e-6
    with pytest.raises(ValueError, match="phi_ref.*need phi"):
        GreyBox().fit(experiment.select(inputs=["phi_ref", "psi_ref"]))


@each
def test_order_of_trajectories_does_not_matter_but_their_boundaries_do(model, linear):
    """Whatever one trajectory's end and the next one's start have to do with each other must not be learnt."""
    forth, back = clone(model).fit(linear), clone(model).fit(linear[::-1])
    if not isinstance(model, NeuralNARX):  # whose optimiser follows its sums of rounding errors
        assert np.allclose(forth.predict(linear), back.predict(linear), atol=1e-6)
    glued = tras.Recording([np.concatenate(linear.states)], [np.concatenate(linear.inputs)], linear.dt)
    if worst(forth, linear) < 1e-6:
        assert worst(clone(model).fit(glued), linear) > 1e-3


@each
def test_conventions(model, linear):
    fitted = clone(model).fit(linear)
    assert clone(fitted).get_params() == model.get_params() and not hasattr(clone(fitted), "n_parameters_")
    assert fitted.n_parameters_ > 0
    one = fitted.simulate(linear.states[0, 0], linear.inputs[0])
    assert one.shape == (100, 2) and np.array_equal(one[0], linear.states[0, 0])
    assert np.allclose(one, fitted.predict(linear)[0], equal_nan=True)
    assert np.array_equal(fitted.predict(linear), fitted.predict(linear.select(inputs=["u1"], states=["x1", "x2"])))
    uneven = fitted.predict([linear[0], linear[1].cut(50)[0]])
    assert [len(part) for part in uneven] == [100, 50]
    assert np.allclose(uneven[1], fitted.predict(linear)[1, :50], equal_nan=True)


@pytest.mark.parametrize("model", [
    DMDc(), PolynomialNARX(2), SINDy(1, 0.0), PykoopEdmd(2), PykoopEdmd(2, relift=False), N4SID(2, 5, 0),
    HammersteinWiener(1, 1),
], ids=str)  # fmt: skip
def test_what_runs_away_is_nan_without_a_word(model):
    rng = np.random.default_rng(0)
    u = rng.uniform(-1, 1, (5, 40, 1))
    x = np.empty((5, 40, 2))
    x[:, 0] = rng.uniform(-1, 1, (5, 2))
    for k in range(39):
        x[:, k + 1] = x[:, k] * 1.2 + 0.1 * u[:, k]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fitted = clone(model).fit(tras.Recording(x, u, 0.1))
        states = fitted.simulate(x[0, 0], np.zeros((3000, 1)))
    lost = np.isnan(states).any(axis=1)
    assert lost[-1] and not lost[0] and np.array_equal(lost, np.sort(lost)) and np.isfinite(states[~lost]).all()


@pytest.mark.parametrize(
    "model, sentence",
    [
        (DMDc(-1.0), "alpha is -1.0"),
        (DMDc(rank=0), "rank is 0"),
        (N4SID(1, 5), "order is 1; give a whole number from 2"),
        (N4SID(2, 1), "horizon is 1"),
        (N4SID(2, 60), "columns of 120 samples"),
        (N4SID(2, 5, 2.0), "tolerance is 2.0"),
        (PolynomialNARX(0), "degree is 0"),
        (PolynomialNARX(2, 0), "lags is 0"),
        (PolynomialNARX(30), "snapshot pairs for 5456 terms"),
        (NeuralNARX(()), "hidden is"),
        (SINDy(differentiation="magic"), "differentiation is 'magic'"),
        (SINDy(2, 1e9), "threshold is 1000000000.0, above every coefficient"),
        (PykoopEdmd(0), "order is 0"),
        (HammersteinWiener(0), "input_degree is 0"),
        (GreyBox(loss="huge"), "the equations of motion need"),
    ],
    ids=lambda part: " ".join(str(part).split())[:40],
)
def test_wrong_options_are_named(model, sentence, linear):
    with pytest.raises(ValueError, match=sentence):
        model.fit(linear)


def test_wrong_data_are_named(linear):
    model = DMDc().fit(linear)
    with pytest.raises(ValueError, match="not fitted"):
        DMDc().predict(linear)
    with pytest.raises(ValueError, match="x0 has shape"):
        model.simulate(np.zeros(3), np.zeros((5, 1)))
    with pytest.raises(ValueError, match="inputs has shape"):
        model.simulate(np.zeros(2), np.zeros((5, 2)))
    with pytest.raises(ValueError, match="NaN or infinity"):
        model.simulate([0.0, np.nan], np.zeros((5, 1)))
    with pytest.raises(ValueError, match="sampled at"):
        model.predict(tras.Recording(linear.states, linear.inputs, 0.1))
    still = tras.Recording(np.concatenate([linear.states, np.ones((10, 100, 1))], axis=2), linear.inputs, 0.05)
    with pytest.raises(ValueError, match="'x3' is constant"):
        DMDc().fit(still)
    with pytest.raises(ValueError, match="snapshot pairs for 4 coefficients"):
        DMDc().fit(linear[[0]].cut(3)[[0]])
    with pytest.raises(ValueError, match="more than 4 samples, which 4 lags need"):
        PolynomialNARX(1, 4).fit(linear.cut(4))
    with pytest.raises(ValueError, match="fewer than 12 samples"):
        SINDy().fit(linear.cut(5))
