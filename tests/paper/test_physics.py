"""The plant's parameters from a field: the torque balance, other plants recovered, intervals that mean something."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import tras
from tras.paper import physics
from tras.twin_rotor import plant

TORQUES = ["u_phi", "u_psi"]
TRUE = pd.Series(tras.PlantParameters().as_dict())[list(physics.PARAMETER_NAMES)]


class Known:
    """What stands for an identified model: the exact field of some plant."""

    def __init__(self, parameters):
        self.parameters = parameters

    def vector_field(self, x, u):
        return tras.vector_field(x, u, self.parameters)


def another_plant(factors):
    return tras.PlantParameters(**dict(zip(physics.PARAMETER_NAMES, TRUE * factors)))


@pytest.fixture(scope="module")
def data(experiment):
    return experiment.select(inputs=TORQUES)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(0.2, 5), min_size=8, max_size=8), st.integers(0, 99))
def test_the_torque_balance_is_the_plants(factors, seed):
    other = another_plant(np.array(factors))
    rng = np.random.default_rng(seed)
    x, u = rng.uniform(-2, 2, (20, 4)), rng.uniform(-1, 1, (20, 2))
    A = physics.torque_balance(x, tras.vector_field(x, u, other)[:, [1, 3]])
    p = TRUE.to_numpy() * factors
    assert np.allclose(A @ p, u.T, rtol=1e-9, atol=1e-9)


@settings(max_examples=10, deadline=None)
@given(st.lists(st.floats(0.2, 5), min_size=8, max_size=8))
def test_the_parameters_of_any_plant_come_back(factors):
    rng = np.random.default_rng(0)
    x, u = rng.uniform(-1, 1, (3, 50, 4)) * [1.2, 2, 3, 3], rng.uniform(-0.2, 0.2, (3, 50, 2))
    recording = tras.Recording(x, u, 0.01, state_names=plant.STATE_NAMES, input_names=TORQUES)
    values = physics.lumped_parameters(Known(another_plant(np.array(factors))), recording)
    assert list(values.index) == list(physics.PARAMETER_NAMES)
    assert values.to_numpy() == pytest.approx(TRUE.to_numpy() * factors, rel=1e-9)


def test_an_identified_field_gives_them_within_half_a_percent(data):
    """100 s here; 500 s and noise in test_trust."""
    model = tras.KoopmanModel(tras.Mechanical()).fit(data)
    assert np.abs(tras.lumped_parameters(model, data) / TRUE - 1).max() < 0.005


def test_channels_are_found_by_name(data):
    model = tras.KoopmanModel(tras.Mechanical(4)).fit(data)
    shuffled = data.select(states=["psi", "psidot", "phi", "phidot"], inputs=["u_psi", "u_phi"])
    by_name, in_order = (tras.lumped_parameters(model, recording) for recording in (shuffled, data))
    pd.testing.assert_series_equal(by_name, in_order, rtol=1e-10)


def noisy_case(data, seed=0):
    noisy = tras.add_noise(data, 0.01, seed)
    return tras.KoopmanModel(tras.Mechanical(2), strength=1e-4).fit(noisy), noisy


def test_intervals_are_the_quantiles_of_the_draws(data):
    """Against a bootstrap by hand."""
    model, noisy = noisy_case(data)
    table = tras.parameter_intervals(model, noisy, draws=4, level=0.5, seed=7)
    rng, rows = np.random.default_rng(7), []
    for _ in range(4):
        drawn = noisy[rng.integers(len(noisy), size=len(noisy)).tolist()]
        rows.append(tras.lumped_parameters(tras.KoopmanModel(tras.Mechanical(2), strength=1e-4).fit(drawn), drawn))
    rows = np.array(rows)
    assert np.allclose(table["low"], np.quantile(rows, 0.25, axis=0))
    assert np.allclose(table["high"], np.quantile(rows, 0.75, axis=0))
    assert np.allclose(table["standard_error"], rows.std(axis=0, ddof=1))
    assert np.array_equal(table["value"], tras.lumped_parameters(model, noisy))
    assert list(table.index) == list(physics.PARAMETER_NAMES)


@pytest.mark.slow
def test_the_pipeline_sees_the_recording_and_the_field_is_asked_at_the_points(data):
    model, noisy = noisy_case(data)
    smoothed = tras.smooth(noisy, [("phi", "phidot"), ("psi", "psidot")])
    seen = []

    def pipeline(recording):
        seen.append(recording)
        return model

    table = tras.parameter_intervals(model, noisy, draws=2, seed=1, pipeline=pipeline, points=smoothed)
    drawn = np.random.default_rng(1).integers(len(noisy), size=len(noisy)).tolist()
    assert np.array_equal(seen[0].states, noisy[drawn].states)
    assert np.array_equal(table["value"], tras.lumped_parameters(model, smoothed))
    other = np.random.default_rng(1).integers(len(noisy), size=(2, len(noisy)))[1].tolist()
    ends = np.sort([tras.lumped_parameters(model, smoothed[each]) for each in (drawn, other)], axis=0)
    reach = (ends[1] - ends[0]) * 0.025  # the quantiles lie that far inside the two draws
    assert np.allclose(table["low"], ends[0] + reach) and np.allclose(table["high"], ends[1] - reach)


@pytest.mark.slow
def test_more_data_narrow_the_intervals(data):
    model, noisy = noisy_case(data)
    smoothed = tras.smooth(noisy, [("phi", "phidot"), ("psi", "psidot")])
    few, many = (tras.parameter_intervals(model, smoothed[:count], draws=12)["standard_error"] for count in (5, 20))
    assert np.median(many / few) < 0.8


@pytest.mark.parametrize("call, part, options, words", [
    (tras.lumped_parameters, lambda r: r.select(inputs=["u_phi"]), {}, "no input 'u_psi' among u_phi; the torque"),
    (tras.lumped_parameters, lambda r: r.select(states=["phi", "psi"]), {}, "no state 'phidot' among phi, psi"),
    (tras.lumped_parameters, lambda r: r[[0]].cut(2)[[0]], {}, "tells only . combinations of the 8 parameters apart"),
    (tras.parameter_intervals, lambda r: r, {"draws": 1}, "draws is 1; give a whole number, 2 or more"),
    (tras.parameter_intervals, lambda r: r, {"level": 95}, "level is 95; give a confidence between 0 and 1"),
    (tras.parameter_intervals, lambda r: r[[0]], {}, "one trajectory, and a bootstrap draws among several; cut it"),
    (tras.parameter_intervals, lambda r: r, {"pipeline": 3}, "pipeline is 3; give a function"),
])  # fmt: skip
def test_mistakes_are_named(call, part, options, words, data):
    with pytest.raises(ValueError, match=words):
        call(Known(tras.PlantParameters()), part(data), **options)


def test_points_are_of_the_same_trajectories(data):
    with pytest.raises(ValueError, match="points has 2 trajectories, recording 20"):
        tras.parameter_intervals(Known(tras.PlantParameters()), data, points=data[[0, 1]])


def test_other_channels_and_units_are_refused(data, experiment):
    by_reference = tras.KoopmanModel(tras.Monomials(1)).fit(experiment.select(inputs=["phi_ref", "psi_ref"]))
    with pytest.raises(ValueError, match="inputs are phi_ref, psi_ref; the torque balance needs u_phi, u_psi"):
        tras.lumped_parameters(by_reference, data)
    names = {"state_names": data.state_names, "input_names": TORQUES, "state_units": ["deg", "deg/s", "rad", "rad/s"]}
    in_degrees = tras.Recording(data.states, data.inputs, data.dt, **names)
    with pytest.raises(ValueError, match="state 'phi' is in 'deg'; convert it to rad"):
        tras.lumped_parameters(Known(tras.PlantParameters()), in_degrees)
