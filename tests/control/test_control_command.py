"""`tras control` and docs/control.md: its commands run as they stand there, wrong input is one sentence."""

import shutil
import subprocess

import numpy as np
import pandas as pd
import pytest
import yaml
from conftest import HOSTILE, ROOT, checkout_in, code_blocks

import tras
from tras.control import command
from tras.control.design import design
from tras.control.page import warnings

PAGE = (ROOT / "docs" / "control.md").read_text(encoding="utf-8")
CC = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")


@pytest.fixture(scope="module")
def model():
    return tras.KoopmanModel(tras.Monomials(3), strength=1e-6).fit(tras.example("duffing", noise=0))


@pytest.fixture
def saved(model, tmp_path):
    path = tmp_path / "mine" / "model.npz"
    path.parent.mkdir()
    model.save(path)
    return path


QUICK = {"horizon": 10, "run": {"seconds": 2}}


@pytest.fixture
def quick(tmp_path):
    path = tmp_path / "quick.yaml"
    path.write_text(yaml.safe_dump(QUICK))
    return str(path)


@pytest.fixture(scope="module")
def checkout(tmp_path_factory):
    """What make needs, with this environment; the commands of the page have run in it."""
    folder = tmp_path_factory.mktemp("checkout")
    (folder / "mine.yaml").write_text(code_blocks(PAGE, "yaml")[0])
    return checkout_in(folder, "tras", "notebooks", commands=code_blocks(PAGE, "sh"))


@pytest.mark.slow
def test_the_commands_of_the_page(checkout):
    pytest.importorskip("daqp", reason="the extra control is not installed")
    for name in ("duffing", "mine"):
        folder = checkout / "build" / "control" / name
        listed = pd.read_csv(folder / "contents.csv")["file"]
        assert all((folder / path).is_file() for path in listed)
        assert {"control.html", "settings.yaml", "controller.c", "controller.h", "run.csv"} <= set(listed)
        run = pd.read_csv(folder / "run.csv")
        assert run["solved"].all() and abs(run["q"] - run["q: reference"]).iloc[-1] < 5e-3
    assert run["force"].abs().max() <= 2 and run["force"].diff().abs().max() <= 20 * 0.05 + 1e-9
    assert run["qdot"].abs().max() <= 1.6
    settings = yaml.safe_load((folder / "settings.yaml").read_text())
    given = yaml.safe_load(code_blocks(PAGE, "yaml")[0])
    assert {name: settings[name] for name in given} == given


@pytest.mark.slow
def test_the_python_and_the_c_of_the_page(checkout, monkeypatch):
    pytest.importorskip("daqp", reason="the extra control is not installed")
    monkeypatch.chdir(checkout)
    names = {}
    exec(code_blocks(PAGE, "python")[0], names)
    assert names["u"].shape == (1,) and abs(names["u"][0]) <= 2
    if CC is None:
        pytest.skip("no C compiler (cc, gcc, clang) is installed, so the generated C cannot be compiled here")
    folder = checkout / "build" / "control" / "mine"
    (checkout / "main.c").write_text(code_blocks(PAGE, "c")[0])
    flags = ["-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror", f"-I{folder}"]
    command = [CC, *flags, "main.c", str(folder / "controller.c"), "-o", "main", "-lm"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert subprocess.run(["./main"]).returncode == 0


@pytest.mark.slow
def test_a_folder_is_written_whole(saved, quick, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert command.main([str(saved), "--settings", quick]) == 0
    folder = tmp_path / "build" / "control" / "mine"
    assert capsys.readouterr().out.splitlines()[-1] == "build/control/mine/control.html"
    listed = set(pd.read_csv(folder / "contents.csv")["file"])
    assert listed == {path.name for path in folder.iterdir()} and len(listed) == 9
    before = {name: (folder / name).read_bytes() for name in listed}
    # The settings that it wrote make the same controller, and the same bytes.
    assert command.main([str(saved), "--settings", str(folder / "settings.yaml")]) == 0
    assert {name: (folder / name).read_bytes() for name in listed} == before


def test_it_follows_with_either_controller(model):
    for settings in (QUICK, {"controller": "lqr", "run": {"seconds": 8}}):
        made = design(model, settings)
        assert made.controller.followed == ("q",) and list(made.settings["weights"]) == ["q"]
        ends = made.run.iloc[[end - 1 for _, _, end in made.parts]]
        assert (abs(ends["q"] - ends["q: reference"]) < 0.01).all() and made.run["solved"].all()
        assert [what for what, _, _ in made.parts] == ["step 1", "step 2", "step 3", "disturbance"]
        inside = made.run["force"].between(*made.controller.limits[0])
        assert inside.all() and made.beyond_hull == 0


def test_what_was_never_excited_is_said(model):
    far = design(model, QUICK | {"limits": {"force": [-20, 20]}, "run": {"reference": {"q": [0, 2.5]}, "seconds": 2}})
    sentences = " ".join(warnings(far))
    assert far.beyond_hull > 0.1 and "where the model was never excited" in sentences
    assert "Beyond the range of the data, share of the samples: q (" in sentences
    assert "The limits of force lie beyond the range of the data." in sentences
    row = far.outside.set_index("channel").loc["q"]
    assert row["run to"] > row["to"] and row["beyond"] > 0.1
    near = design(model, QUICK)
    assert near.beyond_hull == 0 and not near.outside["beyond"].any()
    assert "never excited" not in " ".join(warnings(near))


def test_an_observer_that_began_anew_is_said(model):
    made = design(model, QUICK)
    assert "began anew" not in " ".join(warnings(made))
    made.controller.observer.restarts = 2
    assert "The observer began anew 2 times" in " ".join(warnings(made))


@pytest.mark.parametrize(
    "settings, sentence",
    [
        ({"horizonn": 3}, "the settings have 'horizonn', which is none: did you mean 'horizon'?"),
        ([1], "give names and values, such as horizon: 40"),
        ({"controller": "pid"}, "controller is 'pid'; choose mpc or lqr."),
        ({"controller": "lqr", "horizon": 3}, "horizon is no setting of controller: lqr"),
        ({"input_weights": 1}, "input_weights is no setting of controller: mpc"),
        ({"weights": 3}, "weights is 3; give states and their weights"),
        ({"weights": {"p": 3}}, "weights names 'p', which the model does not have"),
        ({"limits": {"force": 3}}, "limits['force'] is 3; give (lowest, highest)."),
        ({"limits": {"force": [1, None]}, "weights": {"q": -1}}, "weights['q'] is -1"),
        ({"horizon": 2.5}, "horizon is 2.5; give a whole number"),
        ({"measured": ["x"]}, "measured names 'x'"),
        ({"run": 3}, "run is 3; give names and values"),
        ({"run": {"second": 3}}, "'second' in run, which is none: did you mean 'seconds'?"),
        ({"run": {"seconds": -1}}, "seconds is -1; give a number"),
        ({"run": {"reference": {"qdot": [1]}}}, "reference names 'qdot', which has no weight"),
        ({"run": {"reference": {"q": ["a"]}}}, "reference['q'] is 'a'"),
        ({"run": {"reference": 3}}, "reference is 3; give states and their values"),
        ({"run": {"disturbance": {"f": 1}}}, "disturbance names 'f'"),
    ],
    ids=str,
)
def test_wrong_settings_are_one_sentence(settings, sentence, saved, tmp_path, capsys):
    path, out = tmp_path / "wrong.yaml", tmp_path / "out"
    path.write_text(yaml.safe_dump(settings))
    assert command.main([str(saved), "--settings", str(path), "--out", str(out)]) == 2
    error = capsys.readouterr().err
    assert sentence in error and len(error.splitlines()) == 1 and not out.exists()


def test_wrong_calls_are_one_sentence(saved, quick, tmp_path, capsys):
    recording = tmp_path / "log.npz"
    np.savez(recording, a=1)
    others = tmp_path / "others"
    others.mkdir()
    (others / "thesis.tex").touch()
    for arguments, sentence in (
        ([str(tmp_path / "none.npz")], "does not exist; give the path of a model"),
        ([str(tmp_path)], "is a folder; give the path of a model"),
        ([str(recording)], "log.npz"),
        ([str(saved), "--settings", str(tmp_path / "none.yaml")], "cannot be read"),
        ([str(saved), "--out", str(others)], "holds files of others, such as thesis.tex"),
        ([str(saved), "--out", str(saved)], "is a file; give a folder"),
        ([str(saved), "--out", "\udc80"], "OUT holds"),
    ):
        assert command.main(arguments) == 2
        error = capsys.readouterr().err
        assert sentence in error and len(error.splitlines()) == 1
    with pytest.raises(SystemExit) as stop:
        command.main([])
    assert stop.value.code == 2 and len(capsys.readouterr().err.splitlines()) == 1
    assert [path.name for path in others.iterdir()] == ["thesis.tex"]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:Glyph .* missing")
def test_the_folder_of_a_model_with_hostile_names(tmp_path):
    from test_hostile_text import is_harmless

    names = list(dict.fromkeys(text.replace("/", "|") for text in HOSTILE))
    rng, n = np.random.default_rng(0), len(names) - 1
    u, x = rng.uniform(-1, 1, (8, 60, 1)), np.zeros((8, 60, n))
    x[:, 0] = rng.uniform(-1, 1, (8, n))
    for k in range(59):
        x[:, k + 1] = 0.9 * x[:, k] + 0.2 * u[:, k] + 0.01 * rng.normal(size=(8, n))
    labels = {"state_names": names[1:], "input_names": names[:1], "state_units": (HOSTILE[::-1] * 2)[:n]}
    model = tras.KoopmanModel(tras.Monomials(1), "one_step", strength=1e-3).fit(tras.Recording(x, u, 0.1, **labels))
    settings = {"controller": "lqr", "weights": {names[1]: 1.0}, "run": {"seconds": 1}}
    command.write(model, settings, "".join(HOSTILE[:9]), tmp_path / "out")
    page = (tmp_path / "out" / "control.html").read_text(encoding="utf-8")
    assert is_harmless(page) and "PWNED" in page
    written = yaml.safe_load((tmp_path / "out" / "settings.yaml").read_text(encoding="utf-8"))
    assert list(written["weights"]) == names[1:2] and written["measured"] == names[1:]
    assert not list(tmp_path.rglob("PWNED*"))
