"""The grid of readings computes what the public names compute, once, and hides no failure."""

import itertools
import json
import math

import numpy as np
import pandas as pd
import pytest

import tras
from tras.paper import grid, readings, validation
from tras.workflow import cache

SMALL = grid.Study(
    duration=30.0, trajectory=2.0, window=4.0, max_frequency=(0.6, 1.5),
    train_seeds=(1,), validation_seeds=(2, 3), centre_draws=(0, 1),
)  # fmt: skip
PART = {
    "frequency_unit": ["rad/s"], "velocity_term": ["corrected"], "start": ["on_reference"], "input": ["torque"],
    "state": ["four_states", "delayed_angles"], "dictionary": ["gaussian", "linear"],
}  # fmt: skip


def run(folder, only=PART, study=SMALL):
    return grid.run(study, grid.points(study, only), folder, processes=1)


@pytest.fixture(scope="module")
def computed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cache")
    return folder, *run(folder)


def by_hand(reading, draw, validation_seed):
    """The same numbers by public names only."""
    factor = 2 * math.pi if reading.frequency_unit == "Hz" else 1
    plant = tras.PrintedPlant() if reading.velocity_term == "as_printed" else tras.PlantParameters()

    def experiment(seed):
        band = [0.6 * factor, 1.5 * factor]
        signal = tras.multisine(30.0, 0.01, band, [1.22173, math.pi], np.random.default_rng(seed))
        whole = tras.simulate_closed_loop(signal, 0.01, plant)
        inputs = ["u_phi", "u_psi"] if reading.input == "torque" else ["phi_ref", "psi_ref"]
        return whole.select(inputs=inputs, states=["phi", "psi"] if reading.state == "delayed_angles" else None)

    dictionary = tras.GaussianRBF(2, seed=draw) if reading.dictionary == "gaussian" else tras.Monomials(1)
    delays = 1 if reading.state == "delayed_angles" else 0
    options = {"field": "least_squares", "regularization": None, "extrapolation": "functions"}
    model = tras.KoopmanModel(dictionary, delays=delays, **options)
    model.fit(experiment(1).cut(201).split(0.8, 0)[0])
    seconds = {"window": 4.0, "trajectory": 2.0, "free_run": 30.0}[reading.horizon]
    range_over = "all" if reading.nrmse_range == "validation_set" else "trajectory"
    return validation.score(model, {"": experiment(validation_seed)}, seconds, range_over=range_over).set_index("angle")


CASES = [
    (readings.Readings(input="torque"), 0),
    (readings.Readings(input="torque", nrmse_range="trajectory"), 1),
    (readings.Readings(input="torque", state="delayed_angles", horizon="trajectory"), 1),
    (readings.Readings(input="torque", state="delayed_angles", horizon="free_run", dictionary="linear"), 0),
    (readings.Readings(input="torque", horizon="free_run"), 1),
]


@pytest.mark.slow
@pytest.mark.parametrize("reading, draw", CASES, ids=lambda case: "")
def test_a_point_is_what_the_public_names_give(computed, reading, draw):
    table = computed[1]
    labels = reading.model_dump(exclude={"angle_names"}) | {"draw": draw, "train_seed": 1, "validation_seed": 3}
    rows = table[np.logical_and.reduce([table[name] == value for name, value in labels.items()])].set_index("angle")
    expected = by_hand(reading, draw, 3)
    assert len(rows) == 2 and (rows["outcome"] == "model").all()
    for angle in ("yaw", "pitch"):
        assert rows.loc[angle, "nrmse"] == pytest.approx(expected.loc[angle, "nrmse"], rel=1e-9, nan_ok=True)
        for name in ("windows", "diverged"):
            assert rows.loc[angle, name] == expected.loc[angle, name]


def a_simulation(**choices):
    return grid.simulate(SMALL, readings.Readings(**choices).model_dump(), 1)


def test_other_plant_and_unit_reach_the_simulation():
    ours, printed = (a_simulation(frequency_unit="Hz", velocity_term=term) for term in ("corrected", "as_printed"))
    reference = ours.select(inputs=["phi_ref"]).inputs[0, :, 0]
    spectrum = np.abs(np.fft.rfft(reference[:-1]))
    assert np.flatnonzero(spectrum > 1e-6 * spectrum.max()).max() == math.floor(0.6 * 30)  # 0.6 Hz
    assert printed.attributes["plant_velocity_term"] == "as_printed"
    assert np.abs(printed.states - ours.states).max() > 0.01


def test_the_start_is_that_of_the_reading():
    plant = tras.PlantParameters()
    on, hanging, zero = (a_simulation(start=start) for start in readings.choices("start"))
    assert np.array_equal(on.states[0, 0, ::2], on.select(inputs=["phi_ref", "psi_ref"]).inputs[0, 0])
    assert np.array_equal(hanging.states[0, 0], tras.rest_point(plant)) and not zero.states[0, 0].any()
    phi_limits = tras.PID.defaults(plant)[0]
    for recording in (hanging, zero):  # empty integrators: the first torque is proportional to the first error
        error = recording.select(inputs=["phi_ref"]).inputs[0, 0, 0] - recording.states[0, 0, 0]
        expected = np.clip(phi_limits.P * error, *phi_limits.limits)
        assert recording.select(inputs=["u_phi"]).inputs[0, 0, 0] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("gains, frequency, damping", [
    ("default", 4.0, 0.9), ("half_frequency", 2.0, 0.9), ("twice_frequency", 8.0, 0.9), ("less_damping", 4.0, 0.5),
])  # fmt: skip
def test_the_gains_are_those_of_the_reading(gains, frequency, damping):
    J = tras.PlantParameters().J_phi
    attributes = a_simulation(gains=gains).attributes
    assert attributes["pid_phi_P"] == pytest.approx(J * frequency**2)
    assert attributes["pid_phi_D"] == pytest.approx(2 * damping * frequency * J)


def test_every_plant_differs_in_one_parameter_as_its_name_says():
    usual = tras.PlantParameters().as_dict()
    assert grid.rig({"velocity_term": "corrected", "plant": "TRAS-A"}).as_dict() == usual
    for choice in readings.choices("plant")[1:]:
        name, _, word = choice.rpartition("_")
        factor = {"half": 0.5, "double": 2, "zero": 0, "less": 0.8, "more": 1.2}[word]
        other = grid.rig({"velocity_term": "corrected", "plant": choice}).as_dict()
        assert other == {**usual, name: pytest.approx(usual[name] * factor)}
    assert a_simulation(plant="G_c_more").attributes["plant_G_c"] == pytest.approx(1.2 * usual["G_c"])


def test_gains_and_plants_are_varied_one_at_a_time():
    bases = [readings.Readings(), readings.Readings(), readings.Readings(input="torque", dictionary="linear")]
    cases = grid.neighbours(SMALL, bases)
    singles = (len(readings.choices("gains")) - 1) + (len(readings.choices("plant")) - 1)
    assert len(cases) == singles * (2 + 1)  # two draws of the Gaussians, one of the linear model; a base counts once
    usual = readings.Readings().model_dump()
    for case in cases:
        assert sum(case[option] != usual[option] for option in readings.SINGLE) == 1
    assert {case["input"] for case in cases} == {"reference", "torque"}


def test_the_start_is_left_out_of_the_fit_and_of_the_judgement(tmp_path):
    only = PART | {"state": ["four_states"], "dictionary": ["linear"], "start": ["hanging"]}
    cases = grid.points(SMALL, only)
    table = grid.transient(SMALL, cases, 8.0, tmp_path, processes=1)
    assert len(table) == 2 * 2 * 2 * 2  # parts fitted, parts judged, validation seeds, angles
    table = table[table["validation_seed"] == 3].set_index(["fit_from", "judged_from", "angle"])["nrmse"]
    reading = readings.Readings(start="hanging").model_dump()
    train, judged = (grid.simulate(SMALL, reading, seed).select(inputs=["u_phi", "u_psi"]) for seed in (1, 3))
    for fit_from, judged_from in itertools.product((0.0, 8.0), repeat=2):
        parts = [
            recording.with_data([recording.states[0, k:]], [recording.inputs[0, k:]])
            for recording, k in ((train, round(fit_from / 0.01)), (judged, round(judged_from / 0.01)))
        ]
        model = tras.KoopmanModel(tras.Monomials(1), **readings.PAPER_FIT).fit(parts[0].cut(201).split(0.8, 0)[0])
        for row in validation.score(model, {"": parts[1]}, 4.0).itertuples():
            assert table[fit_from, judged_from, row.angle] == pytest.approx(row.nrmse, rel=1e-9)
    for skip in (0.0, 27.0, 40.0):
        with pytest.raises(ValueError, match="skip is"):
            grid.transient(SMALL, cases, skip, tmp_path)


def test_counts_add_up(computed):
    table, counts = computed[1:]
    assert counts == {"computed": 6, "cached": 0}  # (two draws of centres, and linear) x two states
    assert len(table) == 6 * 2 * 3 * 2 * 2  # validation seeds, horizons, ranges, angles
    per_horizon = table.groupby("horizon")["windows"].unique().map(list).to_dict()
    assert per_horizon == {"window": [7], "trajectory": [15], "free_run": [1]}
    assert (table["diverged"] <= table["windows"]).all() and not table.duplicated().any()
    free = table[table["horizon"] == "free_run"].drop(columns="nrmse_range")
    assert len(free.drop_duplicates()) == len(free) / 2  # one window: both ranges are the recording's


def test_a_second_run_computes_nothing(computed, monkeypatch):
    folder, table, _ = computed
    for name in ("fit", "simulate", "judge_windows"):
        monkeypatch.setattr(grid, name, lambda *_: pytest.fail("computed again"))
    monkeypatch.setattr(validation, "free_runs", lambda *_: pytest.fail("computed again"))
    again, counts = run(folder)
    assert counts == {"computed": 0, "cached": 6} and again.equals(table)


def copied(folder, tmp_path):
    for path in folder.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    return tmp_path


@pytest.mark.parametrize("kind, spoil, fits", [
    ("point", lambda content: content[: len(content) // 2], 1),
    ("point", lambda content: content.replace(b'"N": 9', b'"N": 8').replace(b'"N": 7', b'"N": 8'), 1),
    ("free", lambda content: b"", 0),
    ("recording", lambda content: content[:-1000] + bytes(900) + content[-100:], 0),
])  # fmt: skip
def test_a_damaged_file_is_said_and_computed_again(computed, tmp_path, capsys, kind, spoil, fits):
    folder, table, _ = computed
    folder = copied(folder, tmp_path)
    victim = next(folder.glob(f"{kind}-*"))
    victim.write_bytes(spoil(victim.read_bytes()))
    (folder / ".point-0.abcdefgh.json").write_text("what a killed run was writing")
    if kind == "recording":  # read only when a point is missing
        next(folder.glob("point-*")).unlink()
        fits = 1
    again, counts = run(folder)
    assert counts["computed"] == fits and again.equals(table)
    assert f"{victim.name} in the cache is damaged: computed again." in capsys.readouterr().err
    assert not list(folder.glob(".*"))


def test_a_killed_run_goes_on_where_it_was(computed, tmp_path, monkeypatch):
    fit, calls = grid.fit, []

    def killed(*arguments):
        calls.append(arguments)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return fit(*arguments)

    monkeypatch.setattr(grid, "fit", killed)
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path)
    again, counts = run(tmp_path)
    assert counts == {"computed": 3, "cached": 3} and again.equals(computed[1])
    assert not list(tmp_path.glob(".*"))


def test_changed_options_and_changed_code_are_computed(computed, tmp_path, monkeypatch):
    folder, table, _ = computed
    folder = copied(folder, tmp_path)
    only = PART | {"state": ["four_states"], "dictionary": ["linear"]}
    assert run(folder, only)[1] == {"computed": 0, "cached": 1}
    assert run(folder, only | {"frequency_unit": ["Hz"]})[1]["computed"] == 1
    other, counts = run(folder, only, study=grid.Study(**(vars(SMALL) | {"split_seed": 1})))
    assert counts["computed"] == 1 and other["nrmse"].iloc[0] != run(folder, only)[0]["nrmse"].iloc[0]
    before = len(list(folder.glob("recording-*")))
    monkeypatch.setattr(cache, "code_digest", lambda *_: "other code")
    assert run(folder, only)[1]["computed"] == 1 and len(list(folder.glob("recording-*"))) > before


def test_the_code_that_counts_is_what_the_module_needs():
    assert cache.code_digest("tras.twin_rotor.closed_loop") != cache.code_digest("tras.paper.grid")
    needed = cache._package().closure({"tras.paper.grid"}, without=cache.SHOWS)
    modules = ("generator", "dictionaries.radial", "twin_rotor.plant", "metrics", "paper.validation")
    assert {f"tras.{name}" for name in modules} <= needed
    assert "tras.plotting" not in needed and "tras.paper.effects" not in needed
    assert {"tras.plotting", "tras.display.plots"} <= cache._package().closure({"tras.paper.grid"})


@pytest.mark.parametrize("error, outcome", [
    (lambda: grid.LogarithmError("no", -1.0), "no model: logarithm"),
    (lambda: ValueError("the functions are linearly dependent on this data"), "no model: dependent functions"),
    (lambda: ValueError("something else"), "no model: something else"),
    (lambda: np.linalg.LinAlgError("singular"), "no model: equation (18) is singular"),
])  # fmt: skip
def test_a_fit_that_fails_is_a_result(tmp_path, monkeypatch, error, outcome):
    def failing(self, recording):
        if isinstance(self.dictionary, tras.GaussianRBF):
            raise error()
        return whole(self, recording)

    whole = tras.KoopmanModel.fit
    monkeypatch.setattr(tras.KoopmanModel, "fit", failing)
    table, _ = run(tmp_path, PART | {"state": ["four_states"]})
    lost = table[table["dictionary"] == "gaussian"]
    assert len(lost) == 2 * 2 * 3 * 2 * 2 and (lost["outcome"] == outcome).all() and lost["nrmse"].isna().all()
    linear = table[table["dictionary"] == "linear"]
    assert (linear["outcome"] == "model").all() and len(linear) == 24
    assert linear.loc[linear["horizon"] != "free_run", "nrmse"].notna().all()
    assert run(tmp_path, PART | {"state": ["four_states"]})[0].equals(table)  # from the cache


def test_stacked_free_runs_are_each_models_own(experiment):
    """Also where one of them runs away."""
    recording = experiment.select(inputs=["u_phi", "u_psi"])
    dictionary = tras.GaussianRBF(2, seed=3)
    models = [tras.KoopmanModel(dictionary, **readings.PAPER_FIT).fit(part) for part in (recording[:8], recording[8:])]
    models[1].W_[1] *= 1.5  # faster than the data
    models[1].W_[1, 1] += 30.0
    starts, inputs = recording.states[:6, :1].reshape(2, 3, 1, 4), recording.inputs[:6].reshape(2, 3, 501, 2)
    together = validation.free_runs(
        models[0].dictionary_, [validation.field_of(model) for model in models], starts, inputs
    )
    for model, start, held, prediction in zip(models, starts, inputs, together):
        alone = model.simulate(start[:, 0], held)
        assert np.array_equal(np.isnan(alone), np.isnan(prediction))
        assert np.allclose(prediction, alone, rtol=1e-9, atol=1e-9, equal_nan=True)
    assert np.isnan(together[1]).any() and not np.isnan(together[0]).any()
    fields = [validation.field_of(models[0]), validation.field_of(models[1]) | {"substeps": 2}]
    with pytest.raises(ValueError, match="fields differ in"):
        validation.free_runs(dictionary, fields, starts, inputs)
    with pytest.raises(ValueError, match="only models with predictor='vector_field'"):
        validation.field_of(tras.KoopmanModel(dictionary, "one_step").fit(recording))


def test_options_that_make_no_fit_are_refused():
    sentence = "only names 'horizon', which makes no other fit: choose among frequency_unit"
    with pytest.raises(readings.ReadingError, match=sentence):
        grid.points(SMALL, {"horizon": ["window"]})
    with pytest.raises(readings.ReadingError, match="dictionary is 'gauss': did you mean 'gaussian'"):
        grid.points(SMALL, {"dictionary": ["gauss"]})
    with pytest.raises(readings.ReadingError, match="dictionary is 'gauss': did you mean 'gaussian'"):
        grid.dictionary("gauss")


def test_the_whole_grid_has_every_combination_once():
    points = grid.points(grid.Study())
    assert len(points) == 2 * 2 * 2 * 2 * 3 * (3 + 3 + 4) * 3 == len({json.dumps(point) for point in points})
    states, inputs = np.zeros((5, 4)), np.zeros((5, 2))
    counts = [len(grid.dictionary(name).fit(states, inputs).names) for name in readings.choices("dictionary")]
    assert counts == [9, 35, 28, 84, 19, 7]


def test_only_models_of_the_same_functions_and_steps_are_alike(experiment):
    recording = experiment.select(inputs=["u_phi", "u_psi"])
    plain = {"regularization": None, "extrapolation": "functions"}
    cases = [
        (tras.Monomials(1), {}),
        (tras.GaussianRBF(2, seed=0), {}),
        (tras.GaussianRBF(2, seed=1), {}),
        (tras.Monomials(1), {"field": "least_squares"}),
        (tras.Mechanical(2), {"extrapolation": "linear"}),
        (tras.Mechanical(2), {"extrapolation": "linear"}),
        (tras.Monomials(1), {"predictor": "one_step"}),
    ]
    fitted = [tras.KoopmanModel(dictionary, **(plain | options)).fit(recording) for dictionary, options in cases]
    assert validation.alike(fitted) == [[0, 3], [1], [2], [4], [5], [6]]
    fitted[3].substeps_ += 1
    assert validation.alike(fitted)[0] == [0]
    # Models of several structures are scored as each by itself.
    windows = [{"a": recording[k : k + 2]} for k in range(len(fitted))]
    for model, window, table in zip(fitted, windows, validation.score_together(fitted, windows, 2.0)):
        pd.testing.assert_frame_equal(table, validation.score(model, window, 2.0), rtol=1e-9)
