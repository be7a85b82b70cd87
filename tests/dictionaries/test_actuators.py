"""`tras.Mechanical` with actuators: what it spans, exact slopes, and a plant identified from its commands."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.base import clone

import tras

TWIN_ROTOR = tras.Mechanical(actuators=[4, 5])
RNG = np.random.default_rng(0)


def test_the_twin_rotor_has_at_most_200_functions_with_names_of_their_own():
    psi = clone(TWIN_ROTOR).fit(np.zeros((1, 6)), np.zeros((1, 2)))
    assert psi.count() == psi.size == len({*psi.names}) == 196
    names = psi.feature_names(["phi", "phidot", "psi", "psidot", "w", "v", "a", "b"])
    assert {"T3(phi) T2(w)", "T1(phi) w|w|", "w|w|", "T3(phi) w psidot", "T7(a)", "a|a|", "|psi|"} <= {*names}
    assert {"T1(phi) T2(a)", "T2(phi) T3(a)", "T2(phi) a|a|"} <= {*names}  # the reaction to a curved command
    values = psi(RNG.uniform(-1, 1, (2000, 6)), RNG.uniform(-1, 1, (2000, 2)))
    assert np.linalg.matrix_rank(values) == 196


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 10**6), st.integers(1, 9), st.booleans())
def test_slopes_are_the_derivatives(seed, degree, second_shape):
    """Against differences of fourth order: on polynomials of degree nine they are good to about 1e-9."""
    rng, h = np.random.default_rng(seed), 1e-3
    origin = rng.uniform(-1, 1, 8)
    psi = tras.Mechanical(degree, shape=[0, 2] if second_shape else None, actuators=[4, 5])
    x, u = rng.uniform(-1, 1, (4, 6)), rng.uniform(-1, 1, (4, 2))
    psi.fit(x, u, origin)
    near = np.abs(x - origin[:6]) < 3 * h
    x = np.where(near, x + 10 * h, x)  # differences may not cross the bend
    slopes = psi.jacobian(x, u)
    for i in range(6):
        step = h * np.eye(6)[i]
        near, far = ((psi(x + k * step, u) - psi(x - k * step, u)) / (2 * k * h) for k in (1, 2))
        assert np.abs(slopes[..., i] - (4 * near - far) / 3).max() <= 1e-6 * max(1.0, np.abs(slopes).max())


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 10**6), st.integers(1, 12), st.integers(1, 3), st.integers(0, 2), st.booleans())
def test_functions_are_counted_before_they_are_built(seed, degree, pairs, actuators, second_shape):
    n, m = 2 * pairs + actuators, 2
    shape = [0, 2] if second_shape and pairs > 1 else None
    psi = tras.Mechanical(degree, shape=shape, actuators=list(range(2 * pairs, n)) or None)
    psi.fit(np.zeros((1, n)), np.zeros((1, m)), np.random.default_rng(seed).uniform(-2, 2, n + m))
    assert psi.count() == psi.size == len({*psi.names}) == psi(np.zeros(n), np.zeros(m)).size
    enormous = clone(psi).set_params(degree=1000)
    enormous.n_states_, enormous.n_inputs_ = n, m
    if actuators:
        enormous.origin_ = psi.origin_
    assert enormous.count() > 1000  # at once, without a list of them


@given(st.floats(-1.5, 1.5))
def test_forces_bend_at_the_actuators_own_zero(zero):
    """z|z| from where the speed is zero; where all speeds have one sign it would be a polynomial, and is left out."""
    psi = tras.Mechanical(2, actuators=[2]).fit(np.zeros((1, 3)), np.zeros((1, 1)), [0, 0, zero, 3.0])
    names = psi.feature_names(["q", "v", "w", "u"])
    assert ("w|w|" in names) == (abs(zero) < 0.8) and "u|u|" not in names
    if "w|w|" in names:
        w = np.linspace(-1, 1, 7)
        x = np.stack([0 * w, 0 * w, w], axis=1)
        values = psi(x, np.zeros((7, 1)))[:, names.index("w|w|")]
        assert np.allclose(values, (w - zero) * np.abs(w - zero), rtol=1e-14, atol=1e-15)


def rotor_arm(x, u):
    """An arm on a hinge, lifted by a rotor: tanh of the command, asymmetric w|w|, the rotor's reaction, gravity."""
    q, v, w = x
    rate = (40 * np.tanh(1.5 * u[0]) + 4 * u[0] ** 2 - w - 0.004 * w * np.abs(w)) / 0.2
    force = np.where(w > 0, 3e-3, 2e-3) * w * np.abs(w)
    return np.array([v, force * np.cos(q) - 2 * np.sin(q + 0.4) - 0.8 * v - 2e-3 * rate - 0.01 * w * v, rate])


def recorded(runs, samples, seed, dt=0.01):
    """The arm under steps of its command, Runge-Kutta of order 4 with four steps per sample."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-0.8, 0.8, (samples // 25 + 1, 1, runs)), 25, axis=0)[:samples]
    x = np.zeros((samples, 3, runs))
    x[0] = np.array([0.8, 1.0, 25.0])[:, None] * rng.uniform(-1, 1, (3, runs))
    for k in range(samples - 1):
        z, h = x[k], dt / 4
        for _ in range(4):
            k1 = rotor_arm(z, u[k])
            k2 = rotor_arm(z + h / 2 * k1, u[k])
            k3 = rotor_arm(z + h / 2 * k2, u[k])
            z = z + h / 6 * (k1 + 2 * k2 + 2 * k3 + rotor_arm(z + h * k3, u[k]))
        x[k + 1] = z
    names = {"state_names": ["q", "v", "w"], "input_names": ["u"]}
    return tras.Recording(list(x.transpose(2, 0, 1)), list(u.transpose(2, 0, 1)), dt, **names)


def nrmse(model, test):
    """In percent of each state's range; infinite if a prediction ran away."""
    miss = np.sqrt(np.mean((model.predict(test) - test.states) ** 2, axis=(0, 1))) / np.ptp(test.states, axis=(0, 1))
    return 100 * np.where(np.isfinite(miss), miss, np.inf)


def test_a_rotor_arm_from_its_commands_is_predicted_to_the_twin_rotors_target():
    """0.05 % over 6 s of a fresh recording, from 100 s; at least twenty times better than monomials of degree three."""
    train, test = recorded(50, 201, 0), recorded(10, 601, 1)
    model = tras.KoopmanModel(tras.Mechanical(actuators=[2]), strength=0.0).fit(train)
    cubic = tras.KoopmanModel(tras.Monomials(3), strength=0.0).fit(train)
    errors = nrmse(model, test)
    assert len(model.names_) <= 100 and errors.max() <= 0.05
    assert errors[0] <= nrmse(cubic, test)[0] / 20


def test_a_model_with_actuators_comes_back_from_its_file(tmp_path):
    train = recorded(10, 101, 2)
    model = tras.KoopmanModel(tras.Mechanical(4, actuators=[2]), strength=1e-3).fit(train)
    assert np.allclose(model.dictionary_.origin_, np.concatenate([-model.x_offset_ / model.x_scale_, [
        -model.u_offset_[0] / model.u_scale_[0]]]))  # fmt: skip
    again = tras.load_model(model.save(tmp_path / "arm.npz") or tmp_path / "arm.npz")
    assert again.dictionary_.actuators == [2] and again.names_ == model.names_
    assert np.array_equal(again.predict(train), model.predict(train))
    without = tras.KoopmanModel(tras.Mechanical(2, positions=[0], velocities=[1]), strength=1e-3)
    path = tmp_path / "plain.npz"
    without.fit(train.select(states=["q", "v"])).save(path)
    assert "actuators" not in str(np.load(path)["header"])  # as earlier releases write and read it


def test_hull_confines_curves_but_not_velocities():
    model = tras.KoopmanModel(tras.Mechanical(4, actuators=[2]), strength=1e-3).fit(recorded(10, 101, 3))
    assert model.hull_.free == [1]
    far = model.simulate([0.0, 0.0, 1e3], np.full((300, 1), 50.0))
    assert np.isfinite(far).all()


def test_the_hull_is_wider_along_positions_and_actuators_also_from_a_file(tmp_path):
    model = tras.KoopmanModel(tras.Mechanical(4, actuators=[2]), strength=1e-3).fit(recorded(10, 101, 3))
    model.save(tmp_path / "arm.npz")
    for hull in (model.hull_, tras.load_model(tmp_path / "arm.npz").hull_):
        room = ((hull.upper - hull.high) / (hull.high - hull.low) * 2)[:, 0]  # in half-ranges of the data
        assert np.allclose(room, [0.5, np.inf, 0.5, 0.25])
    assert tras.Mechanical(2).margin == tras.Monomials(2).margin == 0.25


def test_the_same_in_a_union():
    x, u = RNG.uniform(-1, 1, (9, 3)), RNG.uniform(-1, 1, (9, 1))
    arm, origin = tras.Mechanical(2, actuators=[2]), [0.1, 0.0, 0.3, 0.2]
    union = tras.Union(arm, tras.Monomials(2)).fit(x, u, origin)
    alone = clone(arm).fit(x, u, origin)
    assert np.allclose(union(x, u)[:, : alone.size], alone(x, u))
    assert math.isclose(union.parts_[0].origin_[2], 0.3)


@pytest.mark.parametrize(
    "dictionary, words",
    [
        (tras.Mechanical(actuators=[6]), "actuators .6. must name states, 0 to 4"),
        (tras.Mechanical(actuators=[4, 4]), "actuators .4, 4. must name states"),
        (tras.Mechanical(actuators=[3, 4]), "do not pair the 3 states that are no actuators .3, 4."),
        (tras.Mechanical(shape=[4], actuators=[4]), "shape .4. must name positions"),
        (tras.Mechanical(positions=[0, 4], velocities=[1, 3], actuators=[4]), "do not pair the 4 states"),
    ],
)
def test_mistakes_are_named(dictionary, words):
    with pytest.raises(ValueError, match=words):
        dictionary.fit(np.zeros((2, 5)), np.zeros((2, 1)))
