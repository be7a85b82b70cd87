"""Delays: recordings in which not all states are measured."""

import numpy as np
import pytest
from conftest import linear_system, ode_recording

import tras
from tras import metrics


def angles(seed):
    """100 s of the twin rotor, its velocities not measured, cut into 1 s."""
    reference = tras.multisine(100, 0.01, [0.5, 1.2], [1.0, 2.5], np.random.default_rng(seed))
    recording = tras.simulate_closed_loop(reference, 0.01, tras.PlantParameters())
    return recording.select(states=["phi", "psi"], inputs=["u_phi", "u_psi"]).cut(101)


@pytest.fixture(scope="module")
def seen():
    return angles(1)


@pytest.fixture(scope="module")
def unseen():
    return angles(2)


@pytest.fixture(scope="module")
def position():
    """x'' = -2 x - 0.5 x' + u seen by x only."""
    return linear_system([[0, 1], [-2, -0.5]], [[0], [1]], 0.1)[0].select(states=["x1"])


def test_delayed_values_by_hand():
    x = [np.array([[1.0, 10], [2, 20], [3, 30], [4, 40]]), np.array([[5.0, 50], [6, 60], [7, 70]])]
    u = [np.array([[0.1], [0.2], [0.3], [0.4]]), np.array([[0.5], [0.6], [0.7]])]
    recording = tras.Recording(
        x, u, 0.5, state_names=["a", "b"], input_names=["v"], state_units=["m", "rad"], input_units=["N"]
    )
    late = recording.delayed(2, inputs=True)
    assert late.state_names == ("a", "b", "a[-1]", "b[-1]", "a[-2]", "b[-2]", "v[-1]", "v[-2]")
    assert late.state_units == ("m", "rad", "m", "rad", "m", "rad", "N", "N")
    assert list(late.lengths) == [2, 1] and late.dt == 0.5
    assert late.states[0].tolist() == [[3, 30, 2, 20, 1, 10, 0.2, 0.1], [4, 40, 3, 30, 2, 20, 0.3, 0.2]]
    assert late.inputs[0].tolist() == [[0.3], [0.4]] and late.states[1].tolist() == [[7, 70, 6, 60, 5, 50, 0.6, 0.5]]
    assert recording.delayed(1).states[1].tolist() == [[6, 60, 5, 50], [7, 70, 6, 60]]
    assert recording.delayed(0) is recording
    with pytest.raises(ValueError, match="trajectory 1 has 3 samples, too few for 3 delays"):
        recording.delayed(3)
    with pytest.raises(ValueError, match="delays = -1; give 0 or more"):
        recording.delayed(-1)


@pytest.mark.parametrize("predictor", ["vector_field", "one_step"])
def test_angles_alone_are_predicted_with_delays_and_not_without(predictor, seen, unseen):
    """NRMSE over 1 s, measured: 4.7 and 10 % without delays, 0.7 and 0.9 % with one, 0.2-0.4 and 0.4-0.7 % with two."""
    error = []
    for delays in (0, 1, 2):
        model = tras.KoopmanModel(tras.Monomials(1), predictor, delays=delays).fit(seen)
        predicted = model.predict(unseen)
        assert predicted.shape == unseen.states.shape and np.array_equal(
            predicted[:, : delays + 1], unseen.states[:, : delays + 1]
        )
        error.append(metrics.nrmse(unseen.states, predicted))
    assert np.all(error[0] > 3)
    assert np.all(error[1] < 1.5) and np.all(error[1] < error[0] / 4)
    assert np.all(error[2] < 1.1) and np.all(error[2] < error[0] / 6)


def test_nonlinear_functions_of_delayed_angles(seen, unseen):
    """Degree 2 with one delay: 0.8 % both, no window lost."""
    model = tras.KoopmanModel(tras.Monomials(2), delays=1).fit(seen)
    assert not metrics.diverged(unseen.states, model.predict(unseen)).any()
    assert np.all(metrics.nrmse(unseen.states, model.predict(unseen)) < 2)


def test_second_order_system_seen_by_its_position_is_exact(position):
    model = tras.KoopmanModel(tras.Monomials(1), "one_step", delays=1).fit(position)
    assert model.names_ == ["1", "x1", "x1[-1]", "u1[-1]", "u1"]
    assert np.abs(model.predict(position) - position.states).max() <= 1e-9
    blind = tras.KoopmanModel(tras.Monomials(1), "one_step").fit(position)
    assert np.abs(blind.predict(position) - position.states).max() > 0.1


def test_lifted_linear_is_exact_too(position):
    model = tras.KoopmanModel(tras.Monomials(1), "lifted_linear", delays=1).fit(position)
    assert np.abs(model.predict(position) - position.states).max() <= 1e-9


def test_more_delays_than_a_linear_system_has_states_are_named(position):
    with pytest.raises(ValueError, match=r"x1\[-1\].* are linearly dependent"):
        tras.KoopmanModel(tras.Monomials(1), "one_step", delays=2).fit(position)


def test_unequal_lengths(position):
    lengths = [60, 3, 17, 33, 60, 45]
    cut = tras.Recording(
        [x[:k] for k, (x, _) in zip(lengths, position)], [u[:k] for k, (_, u) in zip(lengths, position)], 0.1
    )
    model = tras.KoopmanModel(tras.Monomials(1), "one_step", delays=1).fit(cut)
    predicted = model.predict(cut)
    assert [len(x) for x in predicted] == lengths
    assert all(np.abs(p - x).max() <= 1e-9 for p, x in zip(predicted, cut.states))
    assert model.pairs_ == sum(k - 2 for k in lengths)
    assert model.score(cut) == pytest.approx(0, abs=1e-7)
    short = tras.Recording(
        [position.states[0, :1], position.states[0]], [position.inputs[0, :1], position.inputs[0]], 0.1
    )
    with pytest.raises(ValueError, match="a trajectory has 1 samples but 1 delays need 2; leave it out"):
        model.predict(short)
    with pytest.raises(ValueError, match="trajectory 0 has 1 samples, too few for 1 delays"):
        tras.KoopmanModel(tras.Monomials(1), "one_step", delays=1).fit(short)


def test_x0_holds_the_first_samples(position):
    model = tras.KoopmanModel(tras.Monomials(1), "one_step", delays=1).fit(position)
    x, u = position.states, position.inputs
    states = model.simulate(x[0, :2], u[0])
    assert states.shape == (60, 1) and np.array_equal(states[:2], x[0, :2]) and np.allclose(states, x[0], atol=1e-9)
    many = model.simulate(x[:6, :2].reshape(2, 3, 2, 1), u[:6].reshape(2, 3, 60, 1))
    assert many.shape == (2, 3, 60, 1) and np.allclose(many.reshape(6, 60, 1), x[:6], atol=1e-9)
    assert model.simulate(x[0, :2], u[0, :2]).shape == (2, 1)
    for x0, shape in ((x[0, 0], r"\(1,\)"), (x[0, :3], r"\(3, 1\)"), (np.zeros((2, 2)), r"\(2, 2\)")):
        with pytest.raises(ValueError, match=rf"x0 has shape {shape}; give \(..., 2, 1\), the first 2 samples of x1"):
            model.simulate(x0, u[0])
    with pytest.raises(ValueError, match=r"inputs has shape \(1, 1\); give \(..., samples, 1\), 2 samples or more"):
        model.simulate(x[0, :2], u[0, :1])


def test_a_saved_model_keeps_its_delays(position, tmp_path):
    model = tras.KoopmanModel(tras.Monomials(1), "one_step", delays=1).fit(position)
    model.save(tmp_path / "a.npz")
    assert np.array_equal(tras.load_model(tmp_path / "a.npz").predict(position), model.predict(position))


def test_vector_field_of_an_oscillator_seen_by_its_position():
    """x'' = -4 x - 0.2 x': the rate of x and of the earlier x as functions of both; roll-outs to 1e-8 per sample."""
    whole = ode_recording(lambda x, u: [x[1], -4 * x[0] - 0.2 * x[1]], 0.05, n=2, trajectories=10, samples=41)
    recording = whole.select(states=["x1"])
    model = tras.KoopmanModel(tras.Monomials(1), delays=1).fit(recording)
    assert np.abs(model.predict(recording) - recording.states).max() <= 1e-5
    x = whole.states
    now = np.stack([x[:, 1:, 0], x[:, :-1, 0]], axis=-1)
    rates = model.vector_field(now)
    assert np.abs(rates - np.stack([x[:, 1:, 1], x[:, :-1, 1]], axis=-1)).max() <= 1e-8
    with pytest.raises(ValueError, match=r"x has shape \(1,\).*give \(..., 2\)"):
        model.vector_field([0.1])
