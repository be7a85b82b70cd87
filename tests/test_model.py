"""Models: the three predictors, units, divergence, files, mistakes."""

import hashlib
import json

import numpy as np
import pytest
from conftest import linear_system, ode_recording
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from sklearn.base import clone
from sklearn.model_selection import GridSearchCV

import tras
from tras import metrics, predictors, rollout
from tras.paper import operators

A2, B2 = [[0, 1], [-2, -0.5]], [[0], [1]]
PREDICTORS = ["vector_field", "one_step", "lifted_linear"]
TORQUES = ["u_phi", "u_psi"]


@pytest.fixture(scope="module")
def oscillator():
    return linear_system(A2, B2, 0.1)[0]


@pytest.fixture(scope="module")
def torque_data(experiment):
    return experiment.select(inputs=TORQUES)


@pytest.mark.parametrize("predictor", PREDICTORS)
def test_every_predictor_is_exact_on_a_linear_system(predictor, oscillator):
    model = tras.KoopmanModel(tras.Monomials(1), predictor).fit(oscillator)
    # The roll-out of F by Runge-Kutta is held to 1e-8 of a half-range a sample.
    assert np.abs(model.predict(oscillator) - oscillator.states).max() <= (
        1e-6 if predictor == "vector_field" else 1e-10
    )


def test_vector_field_is_the_systems_own(oscillator):
    model = tras.KoopmanModel(tras.Monomials(1), field="least_squares").fit(oscillator)
    x, u = np.random.default_rng(0).uniform(-1, 1, (2, 9, 2))
    assert np.allclose(model.vector_field(x, u[:, :1]), x @ np.transpose(A2) + u[:, :1] @ np.transpose(B2), atol=1e-9)
    assert np.max(model.field_disagreement_) <= 1e-9


def test_lifted_linear_lifts_once_and_one_step_lifts_again():
    """x+ = 0.8 x - 0.2 x^2 + u, functions (1, x, u, x^2, ...): only re-lifting follows the truth for long."""
    rng = np.random.default_rng(0)
    u = rng.uniform(-0.04, 0.04, (30, 40, 1))
    x = np.zeros((30, 40, 1))
    x[:, 0] = rng.uniform(-0.5, 0.5, (30, 1))
    for k in range(39):
        x[:, k + 1] = 0.8 * x[:, k] - 0.2 * x[:, k] ** 2 + u[:, k]
    recording = tras.Recording(x, u, 1.0)
    relifted = tras.KoopmanModel(tras.Monomials(2), "one_step").fit(recording)
    once = tras.KoopmanModel(tras.Monomials(2), "lifted_linear", regularization=None).fit(recording)
    assert np.abs(relifted.predict(recording) - x).max() <= 1e-12
    error = np.abs(once.predict(recording) - x).max(axis=(0, 2))
    assert error[1] <= 1e-12 < 1e-4 < error[10:].max()
    # ... and what lifted_linear does is z+ = A z + B u, by hand:
    scale = lambda v, letter: (v - getattr(once, f"{letter}_offset_")) / getattr(once, f"{letter}_scale_")  # noqa: E731
    z = once.dictionary_(scale(x[3, 0], "x"))
    for k in range(39):
        z = once.koopman_matrix.T @ z + once.B_ @ scale(u[3, k], "u")
    assert z[1] * once.x_scale_[0] + once.x_offset_[0] == pytest.approx(once.predict(recording)[3, -1, 0], abs=1e-12)


def test_roll_out_of_the_field_against_dop853(torque_data):
    """The prediction is the solution of the identified ODE: integrated again by another method at tight tolerance."""
    model = tras.KoopmanModel(tras.GaussianRBF(5)).fit(torque_data)
    x0, held = torque_data.states[3, 0], torque_data.inputs[3, :101]
    states = [x0]
    for u in held[:-1]:
        flow = solve_ivp(
            lambda t, x, u=u: model.vector_field(x, u), (0, 0.01), states[-1], method="DOP853", rtol=1e-11, atol=1e-12
        )
        states.append(flow.y[:, -1])
    assert np.abs(model.simulate(x0, held) - states).max() <= 1e-6


def test_slow_sampling_gets_more_steps():
    recording = ode_recording(lambda x, u: [x[1], -25 * x[0] - x[1] + u[0]], 0.1, n=2, m=1)
    model = tras.KoopmanModel(tras.Monomials(1)).fit(recording)
    assert model.substeps_ > 1
    assert np.abs(model.predict(recording) - recording.states).max() <= 1e-5


DEAR = tras.KoopmanModel(tras.GaussianRBF(150, width="auto", centres="kmeans"), delays=2, strength=0.1)


@pytest.fixture(scope="module")
def bent():
    """Two coupled states with some noise, two inputs: with delays much of it lies at the hull's edge."""
    rng = np.random.default_rng(0)
    u, x = np.repeat(rng.uniform(-1, 1, (6, 40, 2)), 7, axis=1), np.zeros((6, 280, 2))
    A, B = np.array([[0.95, 0.1], [-0.1, 0.9]]), np.array([[0.1, 0.05], [0.0, 0.2]])
    for k in range(279):
        x[:, k + 1] = x[:, k] @ A.T + u[:, k] @ B + 0.1 * np.sin(3 * x[:, k])
    return tras.Recording(x + rng.normal(0, 0.003, x.shape), u, 0.01)


def test_a_dear_field_takes_no_more_steps_than_its_own_error_is_worth(bent, monkeypatch):
    tried, lifts, choose, fill = [], [], rollout.enough_substeps, tras.GaussianRBF._fill

    def counted(field, *points, **options):
        tried.append(choose(field, *points).count)  # what was asked for without regard to the model's own error
        lifts.clear()
        steps = choose(field, *points, **options)
        tried.append(sum(shape[0] * shape[1] for shape in lifts))
        return steps

    def filled(self, psi, z):
        lifts.append(psi.shape)
        fill(self, psi, z)

    monkeypatch.setattr(tras.GaussianRBF, "_fill", filled)
    monkeypatch.setattr(rollout, "enough_substeps", counted)
    model = clone(DEAR).fit(bent)
    assert len(model.names_) > 128 and tried[0] == 64 and model.substeps_ == 8 and model.unsettled_ == []
    assert tried[1] <= 4 * (1 + 2 + 4 + 8 + 16) * 640_000
    lifts.clear()
    predicted = np.asarray(model.predict(bent))
    assert len(lifts) == 4 * 8 * (280 - 3)
    model.substeps_ = 64
    finer = np.asarray(model.predict(bent))
    misses = [np.sqrt(np.mean((states - finer) ** 2)) for states in (bent.states, predicted)]
    assert misses[1] < 1e-3 * misses[0]


def test_a_choice_of_steps_that_ends_by_its_count_says_so(bent, monkeypatch, tmp_path):
    monkeypatch.setattr(predictors, "_SHARE", 1e-9)
    model = clone(DEAR).fit(bent)
    assert model.substeps_ == 16 and len(model.unsettled_) == 1
    assert "the choice of Runge-Kutta steps ended at 16 per sample; the last doubling moved one" in model.report()
    model.save(tmp_path / "model.npz")
    assert tras.load_model(tmp_path / "model.npz").unsettled_ == model.unsettled_


def test_a_cheap_field_takes_all_steps_that_move_anything(bent, monkeypatch):
    """Whatever it misses: the paper's models keep their steps."""
    monkeypatch.setattr(predictors, "_SHARE", 1e9)
    model = clone(DEAR).set_params(dictionary__n_centres=100).fit(bent)
    assert len(model.names_) <= 128 and model.substeps_ == 64 and model.unsettled_ == []


@settings(max_examples=8, deadline=None)
@given(
    factors=st.lists(st.floats(1e-4, 1e4), min_size=6, max_size=6),
    shifts=st.lists(st.floats(-100, 100), min_size=6, max_size=6),
)
@pytest.mark.parametrize("predictor", PREDICTORS)
@pytest.mark.slow
def test_units_do_not_matter(predictor, torque_data, factors, shifts):
    """Degrees, millimetres, an encoder's zero: the same prediction in the new units (shifts in units of the range)."""
    factors, shifts = np.array(factors), np.array(shifts)
    x = torque_data.states * factors[:4] + shifts[:4] * factors[:4]
    u = torque_data.inputs * factors[4:] + shifts[4:] * factors[4:]
    model = tras.KoopmanModel(tras.Monomials(2), predictor)
    plain = clone(model).fit(torque_data).predict(torque_data[:2])
    changed = (
        clone(model).fit(tras.Recording(x, u, torque_data.dt)).predict(tras.Recording(x[:2], u[:2], torque_data.dt))
    )
    back = changed / factors[:4] - shifts[:4]
    assert np.abs(back - plain).max() <= 1e-6


def test_degrees_and_radians_agree(torque_data):
    degrees = tras.Recording(np.degrees(torque_data.states), torque_data.inputs, torque_data.dt)
    model = tras.KoopmanModel(tras.Monomials(2))
    a, b = clone(model).fit(torque_data), clone(model).fit(degrees)
    assert np.allclose(np.radians(b.predict(degrees)), a.predict(torque_data), atol=1e-9)
    assert a.condition_number == pytest.approx(b.condition_number, rel=1e-9)


def test_a_list_of_recordings_is_one_recording(torque_data):
    together = tras.KoopmanModel(tras.Monomials(2)).fit(torque_data)
    parts = tras.KoopmanModel(tras.Monomials(2)).fit([torque_data[:7], torque_data[7:]])
    assert np.array_equal(together.koopman_matrix, parts.koopman_matrix)


def test_unequal_lengths(oscillator):
    lengths = [60, 2, 17, 33, 60, 45]
    cut = tras.Recording(
        [x[:k] for k, (x, _) in zip(lengths, oscillator)], [u[:k] for k, (_, u) in zip(lengths, oscillator)], 0.1
    )
    model = tras.KoopmanModel(tras.Monomials(1), "one_step").fit(cut)
    predicted = model.predict(cut)
    assert [len(x) for x in predicted] == lengths
    assert all(np.allclose(p, x, atol=1e-10) for p, x in zip(predicted, cut.states))
    assert model.score(cut) == pytest.approx(0, abs=1e-7)


def test_autonomous_system():
    recording = ode_recording(lambda x, u: [x[1], -x[0]], 0.2, n=2)
    model = tras.KoopmanModel(tras.Monomials(1)).fit(recording)
    assert np.allclose(model.simulate([1, 0], np.empty((6, 0)))[-1], [np.cos(1), -np.sin(1)], atol=1e-6)


def test_simulate_broadcasts(torque_data):
    model = tras.KoopmanModel(tras.GaussianRBF(2)).fit(torque_data)
    x0, inputs = torque_data.states[:6, 0].reshape(2, 3, 4), torque_data.inputs[0]
    states = model.simulate(x0, inputs)
    assert states.shape == (2, 3, 501, 4)
    assert np.allclose(states[1, 2], model.simulate(x0[1, 2], inputs), atol=1e-10)
    assert np.array_equal(states[..., 0, :], x0) or np.allclose(states[..., 0, :], x0, rtol=1e-15, atol=1e-15)


def test_prediction_that_leaves_is_nan_from_there_on_and_the_others_go_on():
    """x' = x^2 escapes in finite time from x0 > 0 and decays from x0 < 0."""
    recording = ode_recording(lambda x, u: [x[0] ** 2], 0.05, n=1, samples=11, size=0.9)
    model = tras.KoopmanModel(tras.Monomials(2), "one_step", extrapolation="functions").fit(recording)
    states = model.simulate([[0.9], [-0.5]], np.empty((400, 0)))
    lost = np.isnan(states[0, :, 0])
    assert lost.any() and np.all(lost[np.argmax(lost) :]) and not lost[: np.argmax(lost)].any()
    assert np.isfinite(states[1]).all() and abs(states[1, -1, 0]) < 0.5
    truth = np.zeros((2, 400, 1)) + [[[0.0]], [[-1.0]]]
    assert list(metrics.diverged(truth, states)) == [True, False]


@pytest.mark.slow
def test_score_is_minus_nrmse_and_a_grid_search_runs(torque_data):
    model = tras.KoopmanModel(tras.GaussianRBF(2)).fit(torque_data)
    assert model.score(torque_data) == pytest.approx(
        -np.mean(metrics.nrmse(torque_data.states, model.predict(torque_data)))
    )
    grid = {"dictionary": [tras.Monomials(1), tras.GaussianRBF(3)], "predictor": ["vector_field", "one_step"]}
    search = GridSearchCV(tras.KoopmanModel(tras.Monomials(1)), grid, cv=2, error_score="raise").fit(torque_data)
    assert np.isfinite(search.best_score_) and search.best_estimator_.koopman_matrix.ndim == 2


@pytest.mark.slow
@pytest.mark.parametrize("predictor", PREDICTORS)
@pytest.mark.parametrize(
    "dictionary",
    [
        tras.Monomials(2),
        tras.GaussianRBF(4, seed=9),
        tras.Mechanical(2, positions=[0, 2], velocities=[1, 3]),
        tras.Union(tras.Fourier(1), tras.Product(tras.Exponentials(), tras.GaussianRBF(2, seed=1))),
        tras.ThinPlate(4, centres="data"),
    ],
    ids=lambda d: type(d).__name__,
)
def test_saved_model_predicts_the_same_bits(dictionary, predictor, torque_data, tmp_path):
    model = tras.KoopmanModel(dictionary, predictor).fit(torque_data)
    digests = set()
    for name in ("a.npz", "b.npz"):
        model.save(tmp_path / name)
        digests.add(hashlib.sha256((tmp_path / name).read_bytes()).hexdigest())
    assert len(digests) == 1
    again = tras.load_model(tmp_path / "a.npz")
    assert np.array_equal(again.predict(torque_data), model.predict(torque_data), equal_nan=True)
    assert again.report() == model.report() and again.get_params()["predictor"] == predictor


def test_loading_runs_no_code_and_names_bad_files(tmp_path, torque_data):
    with pytest.raises(FileNotFoundError, match="none.npz does not exist"):
        tras.load_model(tmp_path / "none.npz")
    (tmp_path / "text.npz").write_text("hello")
    with pytest.raises(ValueError, match="text.npz cannot be read as a model"):
        tras.load_model(tmp_path / "text.npz")
    np.savez(tmp_path / "pickle.npz", header=np.array([{"format": "tras model 1"}], dtype=object))
    with pytest.raises(ValueError, match="pickle.npz cannot be read as a model .its entry .header.npy. is no plain"):
        tras.load_model(tmp_path / "pickle.npz")
    tras.KoopmanModel(tras.Monomials(1)).fit(torque_data).save(tmp_path / "good.npz")
    with np.load(tmp_path / "good.npz") as file:
        arrays = dict(file)
    for change, words in (
        (("format", "tras model 99"), "tras model 99"),
        (("dictionary", {"name": "os", "parameters": {}}), "'os' is not one"),
    ):
        header = json.loads(str(arrays["header"])) | dict([change])
        np.savez(tmp_path / "other.npz", **{**arrays, "header": np.array(json.dumps(header))})
        with pytest.raises(ValueError, match=words):
            tras.load_model(tmp_path / "other.npz")


def test_a_refit_forgets_the_fit_before(torque_data):
    model = tras.KoopmanModel(tras.GaussianRBF(2), field="least_squares").fit(torque_data)
    assert "differs from the field by coordinates" in model.report()
    model.set_params(field="coordinates").fit(torque_data)
    assert "differs" not in model.report()
    model.set_params(predictor="one_step")
    with pytest.raises(ValueError, match="fitted with .'vector_field', 0.; fit it again"):
        model.predict(torque_data)
    model.fit(torque_data)
    assert not hasattr(model, "generator") and "Runge" not in model.report()


@pytest.mark.slow
def test_models_of_a_grid_search_and_of_drawn_centres_are_saved(torque_data, tmp_path):
    grid = {"dictionary__degree": np.arange(1, 3)}
    best = GridSearchCV(tras.KoopmanModel(tras.Monomials(1)), grid, cv=2).fit(torque_data).best_estimator_
    best.save(tmp_path / "a.npz")
    assert np.array_equal(tras.load_model(tmp_path / "a.npz").predict(torque_data), best.predict(torque_data))
    drawn = tras.KoopmanModel(tras.GaussianRBF(3, seed=np.random.default_rng(5))).fit(torque_data)
    drawn.save(tmp_path / "b.npz")
    again = clone(tras.load_model(tmp_path / "b.npz")).fit(torque_data)
    assert np.array_equal(again.dictionary_.centres_, drawn.dictionary_.centres_)


def test_a_dictionary_of_ones_own_is_not_saved(torque_data, tmp_path):
    class Own(tras.Monomials):
        pass

    with pytest.raises(ValueError, match="'Own' is not one of this package"):
        tras.KoopmanModel(Own(2)).fit(torque_data).save(tmp_path / "a.npz")
    assert not list(tmp_path.iterdir())


def test_damaged_files_are_named(torque_data, tmp_path):
    tras.KoopmanModel(tras.Monomials(1)).fit(torque_data).save(tmp_path / "good.npz")
    with np.load(tmp_path / "good.npz") as file:
        arrays = dict(file)
    (tmp_path / "empty.npz").write_bytes(b"")
    np.savez(tmp_path / "less.npz", **{key: value for key, value in arrays.items() if key != "W_"})
    for name, words in (("empty.npz", "cannot be read"), ("less.npz", "lacks 'W_'")):
        with pytest.raises(ValueError, match=words):
            tras.load_model(tmp_path / name)


def constant_input(experiment):
    x, u = experiment.states, experiment.inputs[..., 2:].copy()
    u[..., 1] = 0.5
    return tras.Recording(x, u, 0.01, input_names=["u_phi", "u_psi"])


def linear(*options, **named_options):
    return tras.KoopmanModel(tras.Monomials(1), *options, **named_options)


def resampled(e):
    return tras.Recording(e.states, e.inputs, 0.02, state_names=e.state_names, input_names=e.input_names)


@pytest.mark.parametrize(
    "call, words",
    [
        (lambda e: linear("magic").fit(e), "predictor is 'magic'; choose one of vector_field"),
        (lambda e: linear(field="x").fit(e), "field is 'x'"),
        (lambda e: tras.KoopmanModel(2).fit(e), "dictionary is 2; give one"),
        (lambda e: linear().fit([]), "recording is empty"),
        (lambda e: linear().fit(e.states), "recording is ndarray; give a tras.Recording"),
        (lambda e: linear().fit([e, e.select(inputs=TORQUES)]), "recording 1 has input_names"),
        (lambda e: linear().fit(constant_input(e)), "channel 'u_psi' is constant .0.5."),
        (lambda e: linear().simulate([0], [[0]]), "not fitted"),
        (lambda e: linear().predict(e), "not fitted"),
        (lambda e: linear().eigenvalues, "not fitted"),
        (lambda e: linear().fit(tras.Recording(e.states[:, :1], e.inputs[:, :1], 1)), "no trajectory has two samples"),
        (lambda e: linear(delays=-1).fit(e), "delays is -1"),
        (lambda e: linear(delays=501).fit(e), "too few for 501 delays"),
        (lambda e: linear(strength=-1).fit(e), "strength is -1"),
        (lambda e: linear(regularization="lasso").fit(e), "regularization is 'lasso'; choose one of shrink"),
        (lambda e: linear(stable=True).fit(e), "stable=True needs predictor='lifted_linear'"),
        (lambda e: linear(stable=0.99).fit(e), "stable=0.99 needs predictor='lifted_linear'"),
        (lambda e: linear("lifted_linear", stable=1.5).fit(e), "stable is 1.5; give True, False, or a spectral radius"),
        (lambda e: linear("lifted_linear", stable="yes").fit(e), "stable is 'yes'; give True, False"),
        (lambda e: linear().fit(e).simulate([0, 0], e.inputs), "x0 has shape"),
        (lambda e: linear().fit(e).simulate([0, 0, 0, 0], [0, 0]), "inputs has shape"),
        (lambda e: linear().fit(e).simulate([0, 0, 0, np.inf], e.inputs), "NaN or infinity"),
        (lambda e: linear("one_step").fit(e).vector_field([0, 0, 0, 0]), "has no vector field"),
        (lambda e: linear().fit(e).predict(e.select(inputs=TORQUES)), "no channel 'phi_ref'"),
        (lambda e: linear().fit(e).predict(resampled(e)), "sampled at 0.02 s"),
        (lambda e: linear().fit(e).save("model.pkl"), "ends in '.pkl'"),
    ],
)  # fmt: skip
def test_mistakes_are_named(call, words, experiment):
    with pytest.raises(ValueError, match=words):
        call(experiment)


def test_fit_leaves_the_dictionary_alone(torque_data):
    dictionary = tras.GaussianRBF(2)
    tras.KoopmanModel(dictionary).fit(torque_data)
    assert not hasattr(dictionary, "centres_")


@pytest.mark.parametrize("delays", [0, 1])
def test_the_states_columns_alone_predict_as_all_of_k_do(oscillator, delays, tmp_path):
    recording = oscillator.select(states=["x1"]) if delays else oscillator
    whole, part = (
        tras.KoopmanModel(tras.Monomials(3), "one_step", delays, strength=1e-3, columns=columns).fit(recording)
        for columns in ("all", "states")
    )
    n = len(part.dictionary_.coordinates)
    assert part.koopman_matrix.shape == (len(part.names_), n)
    assert np.allclose(part.koopman_matrix, whole.koopman_matrix[:, 1 : 1 + n], rtol=0, atol=1e-12)
    assert np.allclose(part.predict(recording), whole.predict(recording), rtol=0, atol=1e-10)
    part.save(tmp_path / "part.npz")
    loaded = tras.load_model(tmp_path / "part.npz")
    assert np.array_equal(loaded.predict(recording), part.predict(recording))
    assert "no eigenvalues" in part.report(recording) and tras.export.formulas(part) == tras.export.formulas(whole)
    for ask in (
        lambda: part.eigenvalues,
        lambda: operators.eigenpairs(part),
        lambda: operators.projection_error(part, recording),
    ):
        with pytest.raises(
            ValueError, match="columns is 'states', so the other columns of K and its eigenvalues are not known"
        ):
            ask()
    with pytest.raises(ValueError, match="columns='states' needs predictor='one_step', but it is 'vector_field'"):
        tras.KoopmanModel(tras.Monomials(3), columns="states").fit(recording)
