"""The classes of rows: what rounding does to sensitive rows is allowed, tampering is not."""

import functools
import io
import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import tras
from tras.explorer import explore, portraits
from tras.explorer.choice import Choice
from tras.paper import artefacts, classes, comparison, grid, sensitivity, verification
from tras.recording import join
from tras.workflow import provenance

TABLE = Path("data/table.csv")
RULE = classes.Sensitive(
    TABLE.as_posix(), ("error", "windows", "diverged", "setting"), ({"method": ("network",)},), "it is trained"
)
ROWS, COPIES = 40, 20
GRID = {
    "duration": 20.0, "sampling_time": 0.01, "pitch_max_frequency": 0.6, "yaw_max_frequency": 1.5, "pitch_peak": 1.2,
    "yaw_peak": 3.1, "trajectory": 2.0, "window": 4.0, "train_seeds": [1], "validation_seeds": [2], "centre_draws": [0],
    "default": {},
}  # fmt: skip


def table(seed=None):
    """Rows of two methods; a seed moves the errors of one by 1 %, and one of its counts by one."""
    rng = np.random.default_rng(0)
    frame = pd.DataFrame({
        "method": np.repeat(["linear", "network"], ROWS // 2), "case": np.tile(np.arange(ROWS // 2), 2),
        "error": rng.uniform(0.1, 9, ROWS), "windows": 20, "diverged": rng.integers(0, 8, ROWS), "setting": "small",
    })  # fmt: skip
    frame.loc[ROWS - 3, "diverged"] = 15
    if seed is not None:
        rng, network = np.random.default_rng(seed), frame["method"] == "network"
        frame.loc[network, "error"] *= 1 + 0.01 * rng.normal(size=ROWS // 2)
        frame.loc[ROWS - 1, "diverged"] += rng.integers(2)
        frame.loc[ROWS - 1, "error"] = np.nan if rng.integers(2) else frame.loc[ROWS - 1, "error"]
        frame.loc[ROWS - 2, "setting"] = rng.choice(["small", "large"])
    return frame


def write(frame, path=TABLE):
    """As a stage leaves it: the table, and what it has written beside it."""
    path.parent.mkdir(exist_ok=True)
    frame.to_csv(path, index=False, float_format="%.10g", lineterminator="\n")
    provenance.write_beside({"outputs": {str(path): provenance.file_stamp(path)}})


@pytest.fixture
def blessed(tmp_path, monkeypatch):
    """A blessed table with a sensitive class, as the working folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(classes, "SENSITIVE", [RULE])
    copies = {TABLE: sensitivity.interval(table(), [table(seed) for seed in range(COPIES)], RULE)}
    monkeypatch.setattr(sensitivity, "spreads", lambda tables, **options: copies)
    write(table())
    assert verification.main(["--bless", str(TABLE)]) == 0


def verify():
    return verification.main([str(TABLE)])


@pytest.mark.parametrize("seed", range(100, 130))
def test_other_perturbations_pass(blessed, seed):
    write(table(seed))
    assert verify() == 0


def change(row, column, value):
    frame = table(100)
    frame[column] = frame[column].astype(object)
    frame.loc[row, column] = value
    write(frame)


# What is done to a table of another machine, and what is said.
WRONG = {
    "an exact number by 2e-6": (lambda: change(3, "error", table()["error"][3] * (1 + 2e-6)), r"error, row 4: \S+ for"),
    "a sensitive number by half": (
        lambda: change(30, "error", table()["error"][30] * 1.5),
        "error, row 31: .* by pert",
    ),
    "a number for none": (lambda: change(30, "error", np.nan), "error, row 31: nan, .* by perturbation"),
    "text for a number": (lambda: change(30, "error", "x"), "error, row "),
    "a count that never moved": (lambda: change(30, "diverged", 99), "diverged, row 31: 99, . to . by perturbation"),
    "a count out of its range": (lambda: change(ROWS - 1, "diverged", 99), f"diverged, row {ROWS}: 99"),
    "a count of windows": (lambda: change(30, "windows", 21), "windows, row 31: 21, 20 to 20 by perturbation"),
    "two more lost windows": (
        lambda: change(30, "diverged", table()["diverged"][30] + 2),
        r"diverged, row 31: \d+, \d+ to \d+ by perturbation",
    ),
    "a choice that was never made": (lambda: change(38, "setting", "huge"), r"setting, row 39: huge, large\|small by"),
    "another key": (lambda: change(30, "method", "other"), "a row is missing: network, 10"),
    "a sensitive row less": (lambda: write(table().drop(index=30)), "a row is missing: network, 10"),
    "a row more": (lambda: write(pd.concat([table(), table()[-1:].assign(case=99)])), "no such row in .*: network, 99"),
    "a row twice": (lambda: write(pd.concat([table(), table()[-1:]])), "a row is there twice"),
    "a column less": (lambda: write(table().drop(columns="setting")), "column setting is only in the reference"),
}


@pytest.mark.parametrize("what", WRONG)
def test_what_rounding_does_not_do_fails(blessed, what, capsys):
    make, pattern = WRONG[what]
    make()
    capsys.readouterr()
    assert verify() == 1
    line = capsys.readouterr().out.splitlines()[0]
    assert line.startswith("DIFFERS") and re.search(pattern, line), line


def test_rows_that_just_diverge_are_compared_by_their_lost_windows(blessed):
    """One more than in any copy, and where half of all windows are lost: the error is of other windows."""
    frame = table(100)
    frame.loc[30, ["diverged", "error"]] = frame["diverged"][30] + 1, frame["error"][30] * 3
    frame.loc[ROWS - 3, "error"] *= 3
    write(frame)
    assert verify() == 0


def test_a_choice_is_compared_by_its_scores():
    rule = RULE._replace(values=("error", "chosen"), rows=({},), choice=("chosen", "error", "setting"))
    columns = {
        "case": np.array([1, 1, 2, 2]), "setting": np.array(list("abab")), "error": np.array([1.0, 1.01, 2.0, 3.0]),
        "chosen": np.array(["True", "False", "True", "False"]),
    }  # fmt: skip
    near = columns | {"error": np.array([1.02, 1.01, 2.0, 3.0]), "chosen": np.array(["False", "True", "True", "False"])}
    reference, other = pd.DataFrame(columns), pd.DataFrame(near)
    frame = sensitivity.interval(reference, [other], rule)
    intervals = {name: frame[name].to_numpy() for name in frame}

    def share(ours):
        return classes.compare_table(ours, columns, intervals, classes.exact(TABLE), rule)

    assert share(columns)[0] == 0 and share(near)[0] == 0
    for chosen in ("False True True False", "True True True False", "True False False False"):
        deviation, detail = share(columns | {"chosen": np.array(chosen.split())})
        assert np.isinf(deviation) and "chosen is not the row with the least error: " in detail


def test_sensitive_rows_in_another_order_pass(blessed):
    frame = table(100)
    write(frame.iloc[[*range(ROWS // 2), *range(ROWS - 1, ROWS // 2 - 1, -1)]])
    assert verify() == 0


def tampered(text, rng):
    """The text of a table with one digit of one number of a random row changed; how far that moves the number."""
    lines = text.splitlines()
    while True:
        row = rng.integers(1, len(lines))
        fields = lines[row].split(",")
        column = rng.integers(len(fields))
        digits = [k for k, letter in enumerate(fields[column]) if letter.isdigit()]
        if digits and fields[column].replace(".", "").isdigit():
            break
    k, old = rng.choice(digits), fields[column]
    digit = str((int(old[k]) + rng.integers(1, 10)) % 10)
    fields[column] = old[:k] + digit + old[k + 1 :]
    lines[row] = ",".join(fields)
    return "\n".join(lines) + "\n", abs(float(fields[column]) / (float(old) or 1) - 1)


def test_each_of_fifty_tampered_digits_fails(blessed, capsys):
    """Whatever the digit, in a table of this machine, of another one, and in the reference."""
    rng, copy = np.random.default_rng(0), Path("reference") / TABLE
    for seed in (None, 100):
        write(table(seed))
        text, blessed_text = TABLE.read_text(), copy.read_text()
        for _ in range(50):
            changed, share = tampered(text, rng)
            TABLE.write_text(changed)
            assert verify() == 1, share
        TABLE.write_text(text)
        assert verify() == 0
    for _ in range(50):
        copy.write_text(tampered(blessed_text, rng)[0])
        assert verify() == 1
    copy.write_text(blessed_text)
    assert verify() == 0
    interval = Path("reference/intervals") / TABLE
    interval.write_text(tampered(interval.read_text(), rng)[0])
    assert verify() == 1 and "is not what reference/SHA256SUMS names" in capsys.readouterr().out


def test_by_numbers_alone_the_smallest_tampering_is_the_tolerance_of_the_class(blessed):
    """Where nobody knows what the stage wrote: 1e-6 in an exact row, the interval's reach in a sensitive one."""
    intervals = {name: values for name, (_, values) in artefacts.read_copy(Path("reference/intervals") / TABLE).items()}
    reach = (classes.WIDER + 1) * (intervals["error.high"] - intervals["error.low"]) + 1e-5
    for row in {*range(ROWS)} - {ROWS - 3}:  # that row is compared by its lost windows
        exact, value = row < ROWS // 2, table()["error"][row]
        least = 1.1e-6 * value if exact else reach[row - ROWS // 2]
        frame = table()
        frame.loc[row, "error"] = value + least
        write(frame)
        provenance.beside(TABLE).unlink()
        assert verify() == 1, row


PORTRAIT = classes.exact(Path("figures/portrait.csv"))


@pytest.fixture(scope="module")
def portrait_of():
    """A function: a seed of rounding in the data, or None -> the portrait's columns, with ten digits as in the file."""
    chosen = Choice(input="torque", dictionary="gaussian", duration=100.0)
    mechanical = chosen.replaced(dictionary="mechanical", size=8, field="coordinates")
    train = explore.training(chosen)

    def portrait(seed=None):
        data = train if seed is None else sensitivity.nudged_recording(train, seed)
        models = {choice.dictionary: explore.identify(choice, data) for choice in (chosen, mechanical)}
        text = portraits.portrait(models, points=9).to_csv(index=False, float_format="%.10g")
        return {name: column.to_numpy() for name, column in pd.read_csv(io.StringIO(text)).items()}

    return portrait


def portrait_share(ours, theirs):
    return classes.compare_columns(ours, {name: (None, values) for name, values in theirs.items()}, PORTRAIT)[0]


def test_rounding_in_the_data_is_allowed_in_an_identified_field(portrait_of):
    """Also where it is nearly zero: on the axis of no rate, the derivative of the angle is what cancels."""
    reference = portrait_of()
    tiny = (reference["d_angle"] != 0) & (np.abs(reference["d_angle"]) < 1e-5)
    assert tiny.any()
    perturbed = [portrait_of(seed) for seed in range(5)]
    assert 0 < max(portrait_share(ours, reference) for ours in perturbed) < 1
    relative = [np.abs(ours["d_angle"][tiny] / reference["d_angle"][tiny] - 1).max() for ours in perturbed]
    assert max(relative) > 100 * PORTRAIT.rtol  # so their own size is no measure


def test_a_tampered_number_of_an_identified_field_fails(portrait_of):
    """By 1e-7 of itself, which the rule for all tables lets pass, or by 1e-10 of the field, whichever is more."""
    reference = portrait_of()
    for name in ("d_angle", "d_rate", "error"):
        largest = np.abs(reference[name]).max()
        for row in range(0, len(reference[name]), 7):
            changed = reference[name].copy()
            changed[row] += max(1e-7 * abs(changed[row]), 1e-10 * largest)
            assert portrait_share(reference | {name: changed}, reference) > 1, (name, row)


def test_nudged_numbers_are_neighbours():
    values = np.array([0.0, 1.0, -2.5, 1e300])
    moved = sensitivity.nudged(values, np.random.default_rng(0))
    assert np.all(moved != values) and np.all(np.nextafter(moved, values) == values)


def test_every_class_names_columns_that_its_table_has():
    for rule in classes.SENSITIVE:
        path = Path(rule.table)
        copy = artefacts.copy_of(path, Path("reference")) or path
        columns = set(artefacts.read_copy(Path(tras.__file__).parents[1] / copy))
        keys = {name for one in rule.rows for name in one}
        assert columns & set(rule.values) and keys <= columns - set(rule.values), rule.table


# --- the studies themselves, small ------------------------------------------------------------------------------------


def simulated(seed):
    reference = tras.multisine(15, 0.01, [2.0, 4.0], [0.6, 1.2], np.random.default_rng(seed))
    return tras.simulate_closed_loop(reference, 0.01)


@pytest.mark.slow
def test_the_comparison_perturbed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = Path("data")
    folder.mkdir()
    for name, seed in (("train", 1), ("validation_steps", 4), ("validation_chirp", 5)):
        simulated(seed).write(folder / f"{name}.nc")
    multisines = join([simulated(2), simulated(3)])
    multisines.attributes["seed"] = [2, 3]
    multisines.write(folder / "validation_multisine.nc")
    parameters = {"trajectory": 1.0, "window": 1.0, "middle": 0.5, "fractions": [0.5], "methods": ["DMDc", "N4SID"]}
    study = comparison.Study(**{name: tuple(v) if isinstance(v, list) else v for name, v in parameters.items()})
    tables = {"comparison": "scores", "comparison_tuning": "tuning", "comparison_data": "data"}
    rules = [rule._replace(rows=({"method": ("N4SID",)},)) for rule in classes.SENSITIVE if "data/comp" in rule.table]
    monkeypatch.setattr(classes, "SENSITIVE", rules)
    monkeypatch.setattr(classes, "RIVALS", rules[0].rows)

    def write_all(seed=None):
        train, fresh = comparison.recordings(folder)
        if seed is not None:
            train = sensitivity.nudged_recording(train, seed)
            fresh = {name: sensitivity.nudged_recording(recording, seed) for name, recording in fresh.items()}
        results = comparison.run(study, train, fresh, folder / "cache", processes=1)
        for name, key in tables.items():
            write(results[key], folder / f"{name}.csv")

    write_all()
    record = provenance.beside(folder / "comparison.csv")
    record.write_text(json.dumps({**json.loads(record.read_text()), "parameters": parameters}))
    paths = [str(folder / f"{name}.csv") for name in tables]
    monkeypatch.setattr(sensitivity, "spreads", functools.partial(sensitivity.spreads, count=4, processes=1))
    assert verification.main(["--bless", *paths]) == 0
    assert verification.main(paths) == 0
    write_all(seed=99)
    assert verification.main(paths) == 0
    text = Path(paths[0]).read_text()
    Path(paths[0]).write_text(tampered(text, np.random.default_rng(0))[0])
    assert verification.main(paths) == 1


@pytest.mark.slow
def test_the_readings_perturbed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = Path("data/readings.csv")
    study = grid.Study(20.0, 0.01, (0.6, 1.5), (1.2, 3.1), 0.05, 2.0, 4.0, 0.8, 0, (1,), (2,), (0,))
    only = {"dictionary": ["gaussian", "monomials3"]}
    table, _ = grid.run(study, grid.points(study, only), path.parent / "cache", processes=1)
    write(table, path)
    write(table.assign(gains="half_frequency"), path.with_name("readings_around.csv"))
    record = provenance.beside(path)
    record.write_text(json.dumps({**json.loads(record.read_text()), "parameters": GRID}))
    frames = sensitivity.spreads([path], count=2, processes=1)
    again = sensitivity.spreads([path], count=2, processes=1)
    frame, rule = frames[path], classes.sensitive(path)
    assert frame.equals(again[path]) and list(frames) == [path]
    assert set(frame["dictionary"]) == {"monomials3"} and (frame["tables"] == 3).all()
    assert len(frame) == classes.selected(dict(table.items()), rule).sum()
    moved = frame["nrmse.high"] > frame["nrmse.low"]
    assert moved.any() and not list((path.parent / "cache").glob("perturbed-*/"))
