"""The studies of 05_robustness, small: they count what happened."""

import numpy as np
import pandas as pd
import pytest
import scipy.stats

import tras
from tras.paper import operators, physics, robustness, systems, validation
from tras.paper.figures.robustness import length_figure

TORQUES = ["u_phi", "u_psi"]
REACH = [0.6, 0.9, 1.2, 0.9]


@pytest.fixture(scope="module")
def train(parameters):
    """60 s in one piece."""
    reference = tras.multisine(60, 0.01, [0.5, 1.2], [1.0, 2.5], np.random.default_rng(1))
    return tras.simulate_closed_loop(reference, 0.01, parameters).select(inputs=TORQUES)


@pytest.fixture(scope="module")
def fresh(parameters):
    reference = tras.multisine(30, 0.01, [0.5, 1.2], [1.0, 2.5], np.random.default_rng(2))
    return tras.simulate_closed_loop(reference, 0.01, parameters).select(inputs=TORQUES)


@pytest.fixture(scope="module")
def length(train):
    options = {"fits": ["plain"], "dictionaries": ["linear", "monomials2"]}
    return robustness.length_study(train, [0.0, 1.0], [1.5, 200.0], 4, **options)


@pytest.fixture(scope="module")
def swings():
    recordings = [operators.free_swings(60, 10.0, 0.1, REACH, seed) for seed in (0, 1)]
    return tras.KoopmanModel(tras.Monomials(5), regularization=None).fit(recordings[0]), recordings[1]


def test_without_noise_the_study_scores_the_plain_fit(train, fresh):
    methods = ["plain", "refined"]
    study, models, recordings = robustness.noise_study(train, fresh, [0.0], [0, 1], 201, 2.0, methods=methods)
    model = tras.KoopmanModel(tras.Mechanical(6), regularization=None, extrapolation="functions").fit(train.cut(201))
    expected = validation.score(model, {"fresh": fresh}, 2.0)
    assert list(models) == [(0.0, 0, "plain")] and recordings[0.0, 0][0] is recordings[0.0, 0][1]
    assert list(study["angle"]) == list(expected["angle"]) and set(study["failure"]) == {""}
    np.testing.assert_allclose(study["nrmse"], expected["nrmse"], rtol=1e-9)
    values, true = physics.lumped_parameters(model, train), tras.PlantParameters().as_dict()
    worst = 100 * max(abs(values[name] / true[name] - 1) for name in values.index)
    assert study["parameter_error"].iloc[0] == pytest.approx(worst)


@pytest.fixture(scope="module")
def noise(train, fresh):
    methods = ["plain", "smoothed", "refined"]
    return robustness.noise_study(train, fresh, [0.0, 1.0], [3], 201, 2.0, methods=methods, segment=101, processes=2)


@pytest.mark.slow
def test_smoothing_mends_what_noise_spoils_and_refining_follows_it(noise):
    study, models, recordings = noise
    assert list(study["noise"].unique()) == [0.0, 1.0]
    of = study[study["noise"] == 1].set_index(["method", "angle"])
    for angle in ("yaw", "pitch"):
        plain, smoothed = (of.loc[(method, angle)] for method in ("plain", "smoothed"))
        assert smoothed["failure"] == "" and smoothed["nrmse"] < 5  # a minute of data
        assert plain["failure"] == "logarithm" or plain["nrmse"] > 2 * smoothed["nrmse"]
    before, after = models[1.0, 3, "smoothed"], models[1.0, 3, "refined"]
    assert np.array_equal(before.koopman_matrix, after.koopman_matrix) and not np.array_equal(before.W_, after.W_)
    assert after.refinement_[-1] < after.refinement_[0]
    measured, smooth = recordings[1.0, 3]
    clean = recordings[0.0, 3][0]
    assert np.abs(smooth.states - clean.states).mean() < 0.5 * np.abs(measured.states - clean.states).mean()


@pytest.mark.slow
def test_parameters_with_intervals(noise):
    _, models, recordings = noise
    methods = {0.0: "plain", 1.0: "refined"}
    cases = {level: (models[level, 3, method], *recordings[level, 3]) for level, method in methods.items()}
    table = robustness.parameter_study(cases, 201, 6)
    assert list(table["noise"].unique()) == [0.0, 1.0] and list(table["parameter"][:8]) == list(physics.PARAMETER_NAMES)
    np.testing.assert_allclose(table["error"], 100 * (table["value"] / table["true"] - 1))
    clean, noisy = (table[table["noise"] == level] for level in (0.0, 1.0))
    assert (clean["error"].abs() < 0.5).all() and (noisy["error"].abs() < 5).all()
    reach = scipy.stats.norm.ppf(0.975) * table["standard_error"]
    assert np.allclose(table["value"] - table["low"], reach, rtol=1e-3)
    assert np.allclose(table["high"] - table["value"], reach, rtol=1e-3)
    assert (noisy["standard_error"].to_numpy() > 10 * clean["standard_error"].to_numpy()).all()


@pytest.mark.slow
def test_the_vector_field_survives_slow_sampling():
    band, peak = [0.5, 1.2], [1.0, 2.5]
    predictors = ["vector_field", "one_step"]
    study = robustness.sampling_study([0.2], 200.0, band, peak, [1, 2], 5.0, 2.0, predictors=predictors)
    assert (study["fastest"] < 10).all() and (study["diverged"] == 0).all() and (study["failure"] == "").all()
    error = study.groupby(["dictionary", "predictor"])["nrmse"].mean()
    assert error["mechanical", "vector_field"] < error["mechanical", "one_step"]
    assert error["mechanical", "vector_field"] < error["monomials3", "vector_field"]


def test_more_data_mend_the_logarithm(length):
    failed = length.set_index(["noise", "dictionary", "ratio"])["failed"]
    assert failed[0.0, "monomials2", 1.5] == 1 and failed[0.0, "monomials2", 200.0] == 0
    assert failed[0.0, "linear", 1.5] == 0
    assert failed[1.0, "monomials2", 1.5] > 0
    assert ((length["no_logarithm"] + length["dependent"]) == length["failed"]).all()
    clean = length["noise"] == 0
    assert (length["no_logarithm"][clean] == 0).all() and (length["dependent"][~clean] == 0).all()
    assert (length["pairs"] == np.ceil(length["ratio"] * length["functions"])).all()
    np.testing.assert_allclose(length["seconds"], 0.01 * length["pairs"])


def test_the_study_does_not_depend_on_the_processes(train):
    options = {"fits": ["plain"], "dictionaries": ["linear"]}
    one, two = (robustness.length_study(train, [1.0], [2.0, 10.0], 3, processes=n, **options) for n in (1, 2))
    pd.testing.assert_frame_equal(one, two)


@pytest.mark.slow
def test_the_best_eigenpairs_of_free_swings_are_the_plants_own(swings):
    model, judged = swings
    table = operators.residual_study({"free": model}, {"free": judged})
    best = table[~operators.trivial(table) & (table["frequency"] > 0)].sort_values("relative").head(2)
    assert not best["spurious"].any()
    for exact in operators.linearised_rates():
        assert np.abs(best["rate"] + 1j * best["frequency"] - exact).min() < 0.01 * abs(exact)


def test_projection_errors_are_the_spectrum_modules(swings):
    model, judged = swings
    table = operators.projection_study({"free": model}, {"free": judged})
    assert list(table["function"]) == list(model.names_) and table["projection_error"].iloc[0] == 0  # the constant
    assert table.set_index("function").loc["phi", "projection_error"] < 0.01 < table["projection_error"].max()


@pytest.mark.slow
def test_known_systems_come_back():
    table = systems.benchmark_study(20, 16, [0.0], [0]).set_index(["system", "method"])
    error = table["coefficient_error"]
    assert table.loc[("slow manifold", "lifting"), ["coefficient_error", "eigenvalue_error"]].max() < 1e-6
    assert (error.xs("lifting", level="method") < 1).all() and (error.xs("refined", level="method") < 1e-3).all()


def test_coefficient_error_of_a_field_that_is_off_in_one_coefficient():
    def field(x):
        return systems.van_der_pol(x) + 0.1 * np.stack([0 * x[..., 0], x[..., 0] ** 2 * x[..., 1]], axis=-1)

    # 20 coefficients, four of which are not zero: 1, 1, -1, -1.
    assert systems.coefficient_error(field, "Van der Pol") == pytest.approx(100 * 0.1 / np.sqrt(20))


def test_eigenfunctions_are_the_best_ones_scaled_to_one_at_the_corner(swings):
    table = operators.eigenfunction_table(*swings, [0.6, 1.2], points=21)
    assert list(table["rank"].unique()) == [1, 2] and len(table) == 2 * 21**2 and (table["frequency"] >= 0).all()
    corner = table[(table["phi"] == table["phi"].max()) & (table["psi"] == table["psi"].max())]
    assert np.allclose(corner["real"], 1) and np.allclose(corner["imag"], 0, atol=1e-12)
    assert corner["relative"].is_monotonic_increasing


def test_the_figure_of_lengths_has_a_row_for_each_fit(length):
    figure = length_figure(pd.concat([length, length.assign(fit="default")]))
    assert len(figure.axes) == 2 * length["noise"].nunique()
