"""Sweeps: each point is what the public names give, wherever it runs, once; no damage costs more than a sentence."""

import json
import os
import signal

import numpy as np
import pandas as pd
import pytest
from conftest import ROOT, linear_system

import tras
from tras.dictionaries.base import label
from tras.metrics import nrmse
from tras.sweeps import command
from tras.sweeps import point as sweep_point
from tras.sweeps import sweep as sweeps
from tras.sweeps.figures import sweep_figure
from tras.sweeps.grid import dictionaries, points
from tras.workflow import cache, executors, yaml_file

GRID = [
    {
        "dictionary": [tras.Monomials(1), tras.Monomials(2)],
        "predictor": ["one_step", "lifted_linear"],
        "strength": 1e-3,
        "delays": [0, 1],
    },
    {"dictionary": "GaussianRBF", "strength": 0.0, "predictor": "one_step", "seconds": 20.0},
]
ONE = {"dictionary": tras.Monomials(1), "predictor": "one_step", "strength": 0.0}
RESULTS = [
    "functions",
    "pairs",
    "condition",
    "strength_used",
    "error",
    "nrmse_x1",
    "nrmse_x2",
    "windows",
    "diverged",
    "outcome",
    "best",
]


def oscillator():
    return linear_system([[0, 1], [-2, -0.3]], [[0], [1]], 0.1, trajectories=20, samples=61, seed=3)[0]


@pytest.fixture(scope="module")
def recording():
    """With noise, so that states and earlier states do not depend on each other."""
    clean = oscillator()
    return tras.Recording(
        clean.states + np.random.default_rng(1).normal(0, 0.01, clean.states.shape), clean.inputs, 0.1
    )


@pytest.fixture(scope="module")
def path(recording, tmp_path_factory):
    path = tmp_path_factory.mktemp("recordings") / "log.nc"
    recording.write(path)
    return path


def run(recording, grid=GRID, **options):
    return tras.sweep(recording, grid, **({"window": 6.0, "scheduler": None, "progress": False} | options))


@pytest.fixture(scope="module")
def computed(path, tmp_path_factory):
    folder = tmp_path_factory.mktemp("cache")
    return folder, run(path, cache=folder)


def same(table, other):
    return table.drop(columns="model").equals(other.drop(columns="model"))


# --- the numbers ---


def test_a_point_is_what_the_public_names_give(recording, computed):
    _, table = computed
    train, held = recording.split(0.8, 0)
    span = np.ptp(held.states, axis=(0, 1))
    assert (
        len(table) == 9
        and (table["outcome"] == "model").all()
        and (table["windows"] == 4).all()
        and (table["diverged"] == 0).all()
    )
    for k, late in (
        (0, 1),
        (3, 0),
        (7, 0),
    ):  # all predictions begin at the second sample, for some models need the first
        row = table.iloc[k]
        model = tras.KoopmanModel(row["model"].dictionary, row["predictor"], row["delays"], strength=1e-3).fit(train)
        judged = tras.Recording(held.states[:, late:], held.inputs[:, late:], 0.1)
        predicted, first = model.predict(judged), 1 - late
        true = judged.states[:, first:]
        assert [row["nrmse_x1"], row["nrmse_x2"]] == pytest.approx(
            nrmse(true, predicted[:, first:], span=span), rel=1e-6, abs=1e-10
        )
        assert row["error"] == pytest.approx(
            np.sqrt(np.mean(((predicted[:, first:] - true) / (span / 2)) ** 2)), rel=1e-6, abs=1e-12
        )
        assert (row["functions"], row["pairs"], row["strength_used"]) == (len(model.names_), model.pairs_, 1e-3)
        assert row["condition"] == pytest.approx(model.condition_number)
    assert table["best"].sum() == 1 and table.loc[table["best"], "error"].iloc[0] == table["error"].min()


def test_options_of_the_data():
    """By hand: the beginning, every second sample with mean inputs, another split."""
    recording = oscillator()
    grid = {"dictionary": [tras.Monomials(1)], "predictor": "one_step", "strength": 0.0}
    table = run(recording, grid | {"seconds": [7.0, None], "every": [1, 2], "split_seed": [0, 5]})
    assert list(table["pairs"]) == [70, 70, 35, 35, 960, 960, 480, 480]
    train, held = recording.split(0.8, 5)
    short = tras.Recording([train.states[0], train.states[1, :11]], [train.inputs[0], train.inputs[1, :11]], 0.1)
    models = [tras.KoopmanModel(tras.Monomials(1), "one_step", strength=0.0).fit(short)]

    def halved(r):
        u = r.inputs
        mean = np.concatenate([(u[:, 0:60:2] + u[:, 1:60:2]) / 2, u[:, 60:]], axis=1)
        return tras.Recording(r.states[:, ::2], mean, 0.2)

    models.append(tras.KoopmanModel(tras.Monomials(1), "one_step", strength=0.0).fit(halved(train)))
    for k, model, judged in ((1, models[0], held), (7, models[1], halved(held))):
        error = (model.predict(judged) - judged.states) / (np.ptp(judged.states, axis=(0, 1)) / 2)
        assert table["error"].iloc[k] == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-6, abs=1e-12)
    assert table["error"].iloc[7] > 1e-3 > 1e-9 > table["error"].iloc[1]  # means of the inputs are not quite what acted


def test_the_rest_of_a_thinned_trajectory_is_averaged_too():
    thinned = sweep_point._thinned(tras.Recording([np.arange(8.0)[:, None]], [np.arange(8.0)[:, None] ** 2], 0.5), 3)
    assert (
        thinned.dt == 1.5
        and thinned.states[0, :, 0].tolist() == [0, 3, 6]
        and thinned.inputs[0, :, 0].tolist() == [5 / 3, 50 / 3, 85 / 2]
    )
    assert sweep_point._thinned(tras.Recording([np.arange(8.0)[:, None]], None, 0.5), 3).inputs.shape == (1, 3, 0)


@pytest.mark.slow
def test_held_out_files_and_windows(path, recording, tmp_path):
    """A second recording to judge by: nothing is split. Files larger than a chunk are read in pieces."""
    recording[:5].write(tmp_path / "held.nc")
    grid = {"dictionary": [tras.Monomials(1)], "predictor": "one_step", "strength": 1e-3, "seconds": [None, 30.0]}
    table = run([path, path], grid, held_out=tmp_path / "held.nc", window=3.0)
    assert list(table["pairs"]) == [2 * recording.pairs, 300] and list(table["windows"]) == [10, 10]
    assert same(table, run([recording, path], grid, held_out=[recording[:5]], window=3.0))
    part = run(
        path, grid | {"seconds": None}, held_out=tmp_path / "held.nc", states=["x2", "x1"], inputs=[], window=3.0
    )
    assert (
        list(part["functions"]) == [3]
        and "nrmse_x2" in part
        and part.columns.get_loc("nrmse_x2") < part.columns.get_loc("nrmse_x1")
    )


def test_a_fit_that_fails_is_a_row(recording):
    grid = [{"dictionary": tras.Monomials(12), "strength": 0.0, "predictor": "one_step", "seconds": 20.0}, ONE]
    table = run(recording, grid)
    reason = "200 snapshot pairs cannot determine 455 functions; record at least 455 pairs or use a smaller dictionary."
    assert table["outcome"].iloc[0] == f"no model: {reason}"
    assert table.loc[0, RESULTS[:-2]].isna().all() and list(table["best"]) == [False, True]
    none = run(recording, grid[0])
    assert not none["best"].any()
    with pytest.raises(ValueError, match="table has no model"):
        sweep_figure(none)


def test_windows_that_diverge_are_counted_and_left_out_of_nrmse_only(recording, monkeypatch):
    predict, whole = tras.KoopmanModel.predict, run(recording, ONE)

    def running_away(self, recording):
        predicted = predict(self, recording)
        predicted[widest, 30:] = np.nan
        return predicted

    held = recording.split(0.8, 0)[1]
    widest = int(np.argmax(np.abs(held.states[..., 0]).max(axis=1)))  # without it the range is another one

    monkeypatch.setattr(tras.KoopmanModel, "predict", running_away)
    table = run(recording, ONE)
    train, held = recording.split(0.8, 0)
    rest, span = held[np.arange(4) != widest], np.ptp(held.states, axis=(0, 1))
    predicted = predict(tras.KoopmanModel(tras.Monomials(1), "one_step", strength=0.0).fit(train), rest)
    assert (table["windows"].iloc[0], table["diverged"].iloc[0]) == (4, 1)
    assert [table["nrmse_x1"].iloc[0], table["nrmse_x2"].iloc[0]] == pytest.approx(
        nrmse(rest.states, predicted, span=span)
    )
    assert (
        table["error"].iloc[0] == pytest.approx(np.sqrt(100 * 31 / (4 * 61)), rel=0.05) and whole["error"].iloc[0] < 0.5
    )
    monkeypatch.setattr(tras.KoopmanModel, "predict", lambda *_: np.full_like(held.states, np.nan))
    lost = run(recording, ONE)
    assert (
        lost["diverged"].iloc[0] == 4
        and np.isnan(lost["nrmse_x1"].iloc[0])
        and lost["error"].iloc[0] == pytest.approx(10.0)
    )


# --- where it runs ---


@pytest.mark.slow
def test_dask_gives_the_same_table_and_a_killed_worker_changes_nothing(
    path, recording, computed, cluster, tmp_path, monkeypatch
):
    marker, evaluate = tmp_path / "marker", sweep_point.evaluate

    def killed(data, latest, point):
        if point.model.delays and not marker.exists():
            marker.write_text("killed")
            os.kill(os.getpid(), signal.SIGKILL)
        return evaluate(data, latest, point)

    monkeypatch.setattr(sweep_point, "evaluate", killed)
    spread = run(path, scheduler=cluster.scheduler_address, cache=tmp_path / "cache")
    assert marker.exists() and same(spread, computed[1])
    assert sorted(p.name for p in (tmp_path / "cache").iterdir()) == sorted(p.name for p in computed[0].iterdir())
    monkeypatch.undo()
    assert same(run(recording, GRID[1], scheduler=cluster.scheduler_address), run(path, GRID[1]))  # recordings are sent


@pytest.mark.slow
def test_local_processes_give_the_same_table(path, computed):
    assert same(run(path, scheduler="processes", processes=1), computed[1])


def test_a_point_that_kills_every_worker_is_a_row_and_is_tried_again(path, tmp_path, monkeypatch):
    def lossy(work, jobs, shared, **_):
        return (
            (k, executors.Lost("its process was killed") if k == 1 else work(*shared, *job))
            for k, job in enumerate(jobs)
        )

    monkeypatch.setattr(executors, "run", lossy)
    table = run(path, cache=tmp_path)
    assert list(table["outcome"]).count("no result: its process was killed") == 1 and table["outcome"].iloc[
        1
    ].startswith("no result")
    monkeypatch.undo()
    with monkeypatch.context() as patch:
        patch.setattr(tras.KoopmanModel, "predict", lambda *_: np.empty(10**16))
        assert list(run(path, [GRID[1], GRID[0] | {"every": 2}], cache=tmp_path)["outcome"]) == [
            "model",
            *["no result: out of memory"] * 8,
        ]
    assert (run(path, cache=tmp_path)["outcome"] == "model").all()


# --- the cache ---


def counted(monkeypatch):
    calls, evaluate = [], sweep_point.evaluate
    monkeypatch.setattr(
        sweep_point, "evaluate", lambda *arguments: (calls.append(arguments[2]), evaluate(*arguments))[1]
    )
    return calls


def copied(folder, tmp_path):
    for path in folder.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    return tmp_path


def test_a_second_sweep_computes_nothing_and_a_wider_one_what_is_new(path, computed, tmp_path, monkeypatch):
    folder, table = computed
    calls = counted(monkeypatch)
    assert same(run(path, cache=folder), table) and not calls
    folder = copied(folder, tmp_path)
    wider = run(
        path, [*GRID, {"dictionary": tras.Monomials(1), "predictor": "one_step", "strength": 0.0}], cache=folder
    )
    assert len(calls) == 1 and same(wider.iloc[:9].assign(best=table["best"]), table)


@pytest.mark.parametrize("change", [None, "data", "window", "delays", "code", "fraction", "states", "seconds"])
def test_what_the_result_depends_on_is_in_the_key(path, recording, computed, tmp_path, monkeypatch, change):
    folder, calls = copied(computed[0], tmp_path), counted(monkeypatch)
    grid = [{"dictionary": tras.Monomials(1), "predictor": "one_step", "strength": 1e-3, "delays": 1}]  # one of GRID's
    if change == "data":
        path = tmp_path / "other.nc"
        tras.Recording(recording.states + 1e-9, recording.inputs, 0.1).write(path)
    if change == "delays":  # of another model: all predictions begin later
        grid.append(ONE | {"delays": 3})
    if change == "seconds":
        grid[0]["seconds"] = 90.0
    if change == "code":
        monkeypatch.setattr(cache, "code_digest", lambda *_: "other code")
    options = {"window": {"window": 3.0}, "fraction": {"train_fraction": 0.5}, "states": {"states": ["x2", "x1"]}}.get(
        change, {}
    )
    run(path, grid, cache=folder, **options)
    assert len(calls) == (len(grid) if change else 0)


def test_a_moved_file_is_the_same_data(path, computed, tmp_path, monkeypatch):
    folder, calls = copied(computed[0], tmp_path), counted(monkeypatch)
    (tmp_path / "moved.nc").write_bytes(path.read_bytes())
    assert same(run(tmp_path / "moved.nc", cache=folder), computed[1]) and not calls


@pytest.mark.parametrize(
    "spoil",
    [
        lambda content: content[:50],
        lambda content: b"",
        lambda content: content.replace(b'"diverged": ', b'"diverged": 1'),
    ],
)
def test_a_damaged_file_is_said_and_computed_again(path, computed, tmp_path, monkeypatch, capsys, spoil):
    folder, calls = copied(computed[0], tmp_path), counted(monkeypatch)
    victim = next(folder.glob("fit-*"))
    victim.write_bytes(spoil(victim.read_bytes()))
    (folder / ".fit-0.abc.json").write_text("what a killed sweep was writing")
    assert same(run(path, cache=folder), computed[1]) and len(calls) == 1
    assert f"{victim.name} in the cache is damaged: computed again." in capsys.readouterr().err
    assert not list(folder.glob(".*"))


def test_interrupted_and_gone_on_with(path, computed, tmp_path, monkeypatch):
    evaluate, calls = sweep_point.evaluate, []

    def interrupted(*arguments):
        if len(calls) == 4:
            raise KeyboardInterrupt
        calls.append(1)
        return evaluate(*arguments)

    monkeypatch.setattr(sweep_point, "evaluate", interrupted)
    with pytest.raises(
        KeyboardInterrupt, match="interrupted; 4 of 9 fits are done and kept in .*: sweep again to go on"
    ):
        run(path, cache=tmp_path)
    assert len(list(tmp_path.iterdir())) == 4
    with pytest.raises(KeyboardInterrupt, match="0 of 9 fits are done and lost: give a cache"):
        run(path)
    monkeypatch.undo()
    calls = counted(monkeypatch)
    assert same(run(path, cache=tmp_path), computed[1]) and len(calls) == 5


# --- the mistakes ---


def meddled(monkeypatch, change):
    """Between the beginning and the first fit."""
    whole = executors.run
    monkeypatch.setattr(
        executors,
        "run",
        lambda *arguments, **options: (change(), sweep_point.forget(), whole(*arguments, **options))[2],
    )


def test_a_worker_that_does_not_see_the_file_is_named(path, tmp_path, monkeypatch):
    copy = tmp_path / "copy.nc"
    copy.write_bytes(path.read_bytes())
    sweep_point._require_unchanged.cache_clear()
    meddled(monkeypatch, lambda: (copy.unlink(), sweep_point._require_unchanged.cache_clear()))
    with pytest.raises(
        ValueError,
        match="copy.nc cannot be read by a worker on .* .No such file or directory.; put it where every worker sees it",
    ):
        run(copy)


def test_a_worker_that_sees_another_file_is_named(path, tmp_path, monkeypatch):
    copy = tmp_path / "copy.nc"
    copy.write_bytes(path.read_bytes())
    meddled(
        monkeypatch, lambda: (tras.Recording.read(path)[:10].write(copy), sweep_point._require_unchanged.cache_clear())
    )
    with pytest.raises(ValueError, match="copy.nc as seen by a worker on .* is not what it was when the sweep began"):
        run(copy)


@pytest.mark.slow
def test_other_code_on_a_worker_is_named(path, cluster, monkeypatch):
    monkeypatch.setattr(sweeps.results_cache, "code_digest", lambda *_: "changed here")
    with pytest.raises(
        executors.SchedulerError,
        match="worker tcp://.* has the code of tras in the state .* but changed here is needed",
    ):
        run(path, scheduler=cluster.scheduler_address)


@pytest.mark.parametrize(
    "grid, options, words",
    [
        (
            {"dictionary": tras.Monomials(1), "predicter": ["one_step"]},
            {},
            "grid: there is no option 'predicter': did you mean 'predictor'",
        ),
        (ONE | {"predictor": ["one"]}, {}, "grid: predictor is 'one'; choose one of"),
        (ONE | {"strength": "1e-6"}, {}, "grid: strength is '1e-6'; give 'auto' or a number"),
        ({"predictor": "one_step"}, {}, "grid names no dictionary; give for example"),
        (ONE | {"dictionary": []}, {}, "grid: dictionary has no value; give one or more"),
        (ONE | {"dictionary": "Monomial"}, {}, "grid: there is no dictionary 'Monomial': did you mean 'Monomials'"),
        (ONE | {"dictionary": 3}, {}, "grid: dictionary is 3; give one such as tras.Monomials"),
        (
            ONE | {"dictionary": {"Monomials": {"order": 2}}},
            {},
            "grid: Monomials has no parameter 'order': choose one of degree",
        ),
        (ONE | {"dictionary": {"Monomials": 2}}, {}, "grid: Monomials has 2; give its parameters by name"),
        (ONE | {"dictionary": {"Union": "Monomials"}}, {}, "grid: Union has 'Monomials'; give a list of dictionaries"),
        (ONE | {"seconds": -1}, {}, "grid: seconds is -1; give the length of the training data"),
        (ONE | {"seconds": 500}, {}, "seconds = 500, but there are 96 s to train on, in steps of 0.1 s; give less"),
        (ONE | {"every": 0}, {}, "grid: every is 0; give a whole number, 1 or more"),
        (ONE | {"split_seed": 1.5}, {}, "grid: split_seed is 1.5; give a whole number"),
        (ONE | {"split_seed": 1}, {"held_out": "log.nc"}, "grid varies split_seed, but held_out is given"),
        (ONE | {"strength": [0.0] * 200, "every": [1] * 200}, {}, "grid: 40000 points or more, up to 20000 are fitted"),
        (
            ONE | dict.fromkeys(("strength", "every", "split_seed", "delays", "lead"), list(range(10**3))),
            {},
            "grid: more than 1e12 points or more",
        ),
        (
            ONE | {"dictionary": {"GaussianRBF": {"seed": list(range(200)), "n_centres": list(range(1, 200))}}},
            {},
            "grid: 39800 points or more, .* several smaller grids",
        ),
        ({"dictionary": {"Union": [{"Monomials": {"degree": list(range(1, 200))}}] * 3}}, {}, "grid: 7880599 points"),
        ([], {}, "grid is empty"),
        ("Monomials", {}, "grid holds 'Monomials'; give a dict option -> list of values"),
        (ONE, {"window": 60.0}, "window = 60 s at 0.1 s per sample: .* pieces need 2 to 61 samples"),
        (ONE, {"window": -1}, "window is -1; give the length of a roll-out in s"),
        (ONE | {"delays": 10}, {"window": 1.0}, "window = 1 s has 11 samples, too few for 10 delays; make it longer"),
        (ONE, {"train_fraction": 2}, "train_fraction is 2; give a number between 0 and 1"),
        (ONE, {"states": ["x3"]}, "there is no channel 'x3'; there are x1, x2"),
        (ONE, {"scheduler": "cluster"}, "scheduler is 'cluster'; give None, 'processes', or an address"),
        (ONE, {"held_out": 3}, "held_out holds int; give a tras.Recording, the path"),
        (ONE, {"held_out": []}, "held_out is empty"),
    ],
)
def test_mistakes_in_the_grid_are_named(recording, grid, options, words):
    with pytest.raises(ValueError, match=words):
        run(recording, grid, **options)


def test_mistakes_in_the_data_are_named(recording, tmp_path):
    with pytest.raises(FileNotFoundError, match="nowhere.nc"):
        run("nowhere.nc", ONE)
    with pytest.raises(ValueError, match="log.docx ends in '.docx'; recordings are"):
        run("log.docx", ONE)
    (tmp_path / "bad.nc").write_bytes(b"no recording")
    with pytest.raises(ValueError, match="bad.nc cannot be read as a recording"):
        run(tmp_path / "bad.nc", ONE)
    with pytest.raises(ValueError, match="recording 0 has dt 0.2 but the first has 0.1"):
        run(tras.Recording(recording.states, recording.inputs, 0.2), ONE, held_out=recording)
    still = tras.Recording(recording.states * [1, 0], recording.inputs, 0.1)
    with pytest.raises(ValueError, match="the held-out state 'x2' is constant"):
        run(still, ONE)

    class Own(tras.Monomials):
        pass

    with pytest.raises(
        ValueError, match="cache: Own is no dictionary of this package, so a change of its code would go unnoticed"
    ):
        run(recording, ONE | {"dictionary": tras.Union(tras.Monomials(1), Own(2))}, cache=tmp_path)
    assert run(recording, ONE | {"dictionary": Own(2)})["outcome"].iloc[0] == "model"


def test_dictionaries_as_yaml_has_them():
    assert [repr(d) for d in dictionaries({"Monomials": {"degree": [1, 3]}})] == [
        "Monomials(degree=1)",
        "Monomials(degree=3)",
    ]
    (one,) = dictionaries({"Mechanical": {"degree": 2, "positions": [[0, 2]]}})
    assert one.positions == [0, 2]
    unions = dictionaries(
        {"Union": [{"Monomials": {"degree": [1, 2]}}, {"GaussianRBF": {"n_centres": 5, "seed": [0, 1]}}]}
    )
    assert len(unions) == 4 and [
        part.get_params()["seed"] for part in (u.get_params()["parts"][1] for u in unions)
    ] == [0, 1, 0, 1]
    assert label(unions[0]).startswith("Union(parts=[Monomials(degree=1), GaussianRBF(centres='uniform', n_centres=5,")
    twice = points([ONE, ONE, tras.KoopmanModel(tras.Monomials(1), "one_step", strength=0.0)])
    assert len(twice) == 1


# --- the command ---


@pytest.mark.slow
def test_the_command_makes_table_and_figure_and_goes_on(tmp_path, capsys, monkeypatch):
    call = [str(ROOT / "params" / "sweeps" / "smoke.yaml"), "--out", str(tmp_path), "--scheduler", "none"]
    assert command.main(call) == 0
    said = capsys.readouterr().out
    assert (
        "13 fits, 12 with a model" in said
        and "Mechanical(degree=4), N = 45, predictor vector_field" in said.splitlines()[1]
        and "table.csv" in said
    )
    (axes,) = sweep_figure(pd.read_csv(tmp_path / "error.csv")).axes
    lines = {line.get_label(): line for line in axes.lines if len(line.get_xdata()) > 1}
    best = (
        pd.read_csv(tmp_path / "error.csv")
        .query("dictionary.str.startswith('Monomials')")
        .groupby("functions")["error"]
        .min()
    )
    assert any(
        np.array_equal(line.get_ydata(), best) and np.array_equal(line.get_xdata(), best.index)
        for line in lines.values()
    )
    files = {p.name: p.read_bytes() for p in tmp_path.iterdir() if p.is_file()}
    assert set(files) == {"table.csv", "error.csv", "error.pdf", "error.png", "error.svg"}
    table = pd.read_csv(tmp_path / "table.csv")
    assert (
        len(table) == 13
        and table["best"].sum() == 1
        and table["outcome"].iloc[-1].startswith("no model: 400 snapshot pairs")
    )
    calls = counted(monkeypatch)
    assert command.main(call) == 0 and not calls
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir() if p.is_file()} == files


@pytest.mark.parametrize(
    "text, status, words",
    [
        ("models: [", 2, "mine.yaml is not valid YAML"),
        ("- 1", 2, "mine.yaml: it holds \\[1\\]; write one `name: value` per line, there are recording, models"),
        ("recording: a.nc", 2, "mine.yaml: models is missing; there are recording"),
        ("recording: a.nc\nmodels: {}\nwindows: 3", 2, "mine.yaml: there is no 'windows': did you mean 'window'"),
        ("recording: a.nc\nmodels: {}\nwindow: -3.0", 2, "mine.yaml: window is -3.0; it should be greater than 0"),
        ("recording: 3\nmodels: {}", 2, "recording is 3; give the path of a file, a list of paths, or `simulate"),
        (
            "recording: {simulate: {length: 3}}\nmodels: {}",
            2,
            "recording: simulate: there is no 'length': choose one of duration",
        ),
        (
            "recording: {simulate: {duration: 20.0, pitch_max_frequency: 1.0}}\nmodels: {dictionary: Monomial}",
            1,
            "grid: there is no dictionary 'Monomial'",
        ),
        ("recording: nowhere.nc\nmodels: {dictionary: Monomials}", 1, "nowhere.nc"),
    ],
)
def test_mistakes_in_the_file_are_one_sentence(tmp_path, capsys, text, status, words):
    (tmp_path / "mine.yaml").write_text(text)
    assert command.main([str(tmp_path / "mine.yaml"), "--out", str(tmp_path / "out"), "--scheduler", "none"]) == status
    captured = capsys.readouterr()
    assert (
        pd.Series([captured.err]).str.contains(words).all()
        and len(captured.err.strip().splitlines()) == 1
        and not captured.out
    )
    assert not (tmp_path / "out" / "table.csv").exists()


def test_roles_no_file_no_model_and_ctrl_c(recording, tmp_path, capsys, monkeypatch):
    assert (
        command.main([str(tmp_path / "none.yaml")]) == 2
        and "none.yaml cannot be read (No such file" in capsys.readouterr().err
    )
    frame = recording.to_frame().rename(columns={"x1": "a", "x2": "b", "u1": "c", "time": "stamp"})
    frame.to_csv(tmp_path / "log.csv", index=False)
    description = {
        "recording": str(tmp_path / "log.csv"),
        "roles": {"time": "stamp", "trial": "trajectory", "states": ["b", "a"], "inputs": ["c"]},
    }
    description |= {"window": 6.0, "models": {"dictionary": {"Monomials": {"degree": 16}}, "strength": 0.0}}
    (tmp_path / "mine.yaml").write_text(json.dumps(description))
    call = [str(tmp_path / "mine.yaml"), "--out", str(tmp_path / "out"), "--scheduler", "none"]
    assert command.main(call) == 1
    said = capsys.readouterr().out
    assert (
        "1 fits, 0 with a model" in said and "none has a model; the first because: no model: 960 snapshot pairs" in said
    )
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["cache", "table.csv"]
    monkeypatch.setattr(sweep_point, "evaluate", lambda *_: os.kill(os.getpid(), signal.SIGTERM))
    description["models"]["dictionary"] = "Monomials"
    (tmp_path / "mine.yaml").write_text(json.dumps(description))
    assert command.main(call) == 130
    assert "interrupted; 0 of 1 fits are done and kept in" in capsys.readouterr().err


def test_the_description_in_the_documentation_is_one():
    text = (ROOT / "docs" / "scale.md").read_text(encoding="utf-8")
    block = text.partition("```yaml\n")[2].partition("```")[0]
    given = command._checked(command.Description, yaml_file.parse_yaml(block, "docs/scale.md"), "").arguments()
    assert given["recording"] == ["monday.nc", "tuesday.nc"] and given["held_out"] == ["friday.nc"]
    assert len(points(given["grid"])) == 4 * 2 * 2 * 2 * 2
    default = command.read(ROOT / "params" / "sweeps" / "dictionaries.yaml")
    assert len(points(default.models)) == 96  # as the documentation says
