"""Scoring on windows, and the table made from it."""

import numpy as np
import pandas as pd
import pytest
from conftest import ROOT

import tras
from tras import metrics
from tras.paper import pages, tables, validation


class Late:
    """Predicts the truth plus a known error; window ``bad`` runs away."""

    def __init__(self, error=0.0, bad=None):
        self.error, self.bad = error, bad

    def predict(self, recording):
        states = recording.states + self.error
        if self.bad is not None:
            states[self.bad, -1] = np.nan
        return states


@pytest.fixture(scope="module")
def two(experiment):
    return {"first": experiment[:10], "second": experiment[10:]}


def growth_of(model, recording, seconds, **options):
    windows = recording.cut(round(seconds / recording.dt) + 1)
    return validation.error_growth(windows, model.predict(windows), **options)


def typical_of(model, recording, seconds):
    windows = recording.cut(round(seconds / recording.dt) + 1)
    return validation.typical_window(windows, model.predict(windows))


def test_score_splits_windows_back_to_their_recordings(two):
    scores = validation.score(Late(error=[0.1, 0, 0.2, 0]), two, 2.5)
    assert list(scores["windows"]) == [20] * 4 and list(scores["diverged"]) == [0] * 4
    for row in scores.itertuples():
        true = two[row.recording].cut(251).states[..., [{"pitch": 0, "yaw": 2}[row.angle]]]
        wrong = true + {"pitch": 0.1, "yaw": 0.2}[row.angle]
        for name in ("enr", "bfr", "nrmse"):
            assert getattr(row, name) == pytest.approx(getattr(metrics, name)(true, wrong)[0])


def test_diverged_windows_are_counted_and_left_out(two):
    scores = validation.score(Late(error=0.1, bad=[3, 4, 12]), two, 5.0).set_index(["recording", "angle"])
    assert list(scores["diverged"]) == [2, 2, 1, 1]
    bounded = two["second"].cut(501).states[[0, 1, 3, 4, 5, 6, 7, 8, 9]][..., [2]]
    span = np.ptp(two["second"].cut(501).states[..., 2])
    assert scores.loc[("second", "yaw"), "nrmse"] == pytest.approx(100 * 0.1 / span)
    assert scores.loc[("second", "yaw"), "enr"] == pytest.approx(metrics.enr(bounded, bounded + 0.1)[0])
    gone = validation.score(Late(bad=slice(None)), two, 5.0)
    assert gone["nrmse"].isna().all() and list(gone["diverged"]) == [10] * 4


def test_losing_the_widest_window_does_not_narrow_the_range(experiment):
    t = np.linspace(0, 1, 101)[:, None]
    states = np.array([[1.0, 0, 1, 0], [1, 0, 1, 0], [8, 0, 8, 0]])[:, None] * t
    recording = tras.Recording(states, dt=0.01, state_names=["phi", "phidot", "psi", "psidot"])
    scores = validation.score(Late(error=0.4, bad=2), {"ramps": recording}, 1.0)
    assert list(scores["diverged"]) == [1, 1] and np.allclose(scores["nrmse"], 100 * 0.4 / 8)
    assert np.allclose(growth_of(Late(error=0.4, bad=2), recording, 1.0, every=50)["nrmse"], 100 * 0.4 / 8)


def test_mistakes_name_recording_and_angle(experiment):
    still = tras.Recording(experiment.states[:1] * [1, 1, 0, 1], dt=0.01, state_names=experiment.state_names)
    pitch = experiment.select(states=["phi", "phidot"])
    moving = experiment.select(inputs=[])
    for recordings, seconds, words in (
        ({"moving": moving, "still": still}, 5.0, "recording 'still': yaw: the truth psi is constant"),
        ({"half": pitch}, 5.0, "recording 'half': yaw: there is no state 'psi'; there are phi, phidot"),
        ({"short": experiment}, 50.0, "recording 'short': samples = 5001"),
    ):
        with pytest.raises(ValueError, match=words):
            validation.score(Late(), recordings, seconds)
    for measure in (growth_of, typical_of):
        with pytest.raises(ValueError, match="yaw: the truth psi is constant"):
            measure(Late(), still, 5.0)


def test_error_growth_of_nothing_left_is_nan(experiment):
    assert growth_of(Late(bad=slice(None)), experiment, 5.0)["nrmse"].isna().all()


def test_error_growth_is_the_error_at_each_instant(experiment):
    class Drift:
        def predict(self, recording):
            return recording.states + np.arange(recording.lengths[0])[:, None] * 1e-3

    growth = growth_of(Drift(), experiment, 5.0, every=100)
    span = np.ptp(experiment.states[..., 2])
    yaw = growth[growth["angle"] == "yaw"]
    assert np.allclose(yaw["time"], [1, 2, 3, 4, 5])
    assert np.allclose(yaw["nrmse"], 100 * np.array([0.1, 0.2, 0.3, 0.4, 0.5]) / span)


def test_typical_window_is_the_median_one(experiment):
    class Graded:
        def predict(self, recording):
            return recording.states + np.random.default_rng(0).permutation(len(recording))[:, None, None] * 0.01

    index = typical_of(Graded(), experiment, 5.0)
    assert np.random.default_rng(0).permutation(20)[index] == 9


def test_overlay_starts_at_the_truth(experiment):
    recording = experiment.select(inputs=["u_phi", "u_psi"])
    model = tras.KoopmanModel(tras.Monomials(1)).fit(recording)
    window = recording.cut(201)[3]
    table = validation.overlay(window, {"linear": model.predict(window)[0]})
    assert list(table.columns) == ["time", "psi_true", "psi_linear", "phi_true", "phi_linear"] and len(table) == 201
    assert np.allclose(table.iloc[0][["psi_linear", "phi_linear"]], table.iloc[0][["psi_true", "phi_true"]])


def test_an_overlay_knows_the_range_of_the_whole_recording(experiment):
    window, states = experiment.cut(201)[3], np.concatenate(list(experiment.states))
    table = validation.overlay(window, {}, experiment)
    for name, column in (("phi", 0), ("psi", 2)):
        assert set(table[f"{name}_low"]) == {states[:, column].min()}
        assert set(table[f"{name}_high"]) == {states[:, column].max()}


def a_table():
    rows = []
    sources = [source for source in tables.COLUMNS if source[0] != "paper"]
    for i, (name, model) in enumerate(sources):
        for kind, horizon in (("window", 6.0), ("free run", 500.0)):
            for seed in (1, 2, 3):
                for angle in ("yaw", "pitch"):
                    value = 1.0 + i + 0.1 * seed**2  # skewed: the median is not the mean
                    rows.append({
                        "recording": f"multisine {seed}", "kind": kind, "horizon": horizon, "angle": angle,
                        "enr": value / 100, "bfr": 90.0, "nrmse": value, "windows": 83, "diverged": int(i == 2),
                        "input": name, "model": model,
                    })  # fmt: skip
        rows.append({**rows[-1], "recording": "steps", "nrmse": 99.0})
    identification = pd.DataFrame([{"input": name, "model": model, "condition": 123.4} for name, model in sources])
    return tables.comparison(pd.DataFrame(rows), identification)


def test_comparison_takes_median_and_range_over_the_multisines_only():
    table = a_table()
    row = table.query("kind == 'window' and metric == 'nrmse' and angle == 'yaw' and input == 'torque'").iloc[0]
    assert (row["median"], row["lowest"], row["highest"]) == pytest.approx((3.4, 3.1, 3.9))
    assert (row["windows"], row["diverged"]) == (249, 3)
    paper = table[table["input"] == "paper"]
    assert list(paper["median"]) == [4.0589, 5.5889]


def test_rendering_shows_paper_range_condition_and_divergence(tmp_path, capsys):
    a_table().to_csv(tmp_path / "table.csv", index=False)
    text = tables.markdown(tables.read(tmp_path / "table.csv"))
    assert "| NRMSE (%), yaw, 6 s windows | 4.0589 | 1.40 (1.10 to 1.90) |" in text
    assert "| diverged, 6 s windows | not given | 0 of 249 | 0 of 249 | 3 of 249 | 0 of 249 | 0 of 249 |" in text
    assert "| Enr, yaw, 6 s windows | not given | 0.0140 (0.0110 to 0.0190) |" in text
    assert "| 1.2e+02 |" in text
    readme = tmp_path / "README.md"
    begin, end = pages.markers("table")
    readme.write_text(f"before\n{begin}\nold\n{end}\nafter\n")
    call = ["table", f"--figures={tmp_path}", f"--pages={tmp_path}"]
    assert pages.main([*call, "--check"]) == 0
    assert "holds another table" in capsys.readouterr().out
    pages.main([*call, "--write"])
    first = tables.first_markdown(tables.read(tmp_path / "table.csv"))
    assert readme.read_text() == f"before\n{begin}\n{first}\n{end}\nafter\n"
    kept = [line for line in text.split("\n") if line.startswith(("|  |", "| ---", "| NRMSE", "| BFR"))]
    assert first.split("\n") == [line for line in kept if "yaw, 500 s" not in line] and len(first.split("\n")) == 2 + 5
    pages.main([*call, "--check"])
    assert "holds another table" not in capsys.readouterr().out


def test_missing_files_and_markers_are_named(tmp_path, capsys):
    assert pages.main(["table", f"--figures={tmp_path / 'none'}"]) == 2
    assert "none/table.csv does not exist" in capsys.readouterr().err
    (tmp_path / "README.md").write_text("no markers")
    assert pages.main(["table", f"--figures={ROOT / 'figures'}", f"--pages={tmp_path}", "--write"]) == 2
    assert "README.md must hold" in capsys.readouterr().err and (tmp_path / "README.md").read_text() == "no markers"
    assert pages.main(["tables"]) == 2
    assert "there is no table 'tables': did you mean 'table'?" in capsys.readouterr().err


def test_the_readme_holds_the_committed_table():
    """`make readme` wrote it from figures/table.csv, which `make all` makes: no number in it was typed."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert tables.first_markdown(tables.read(ROOT / "figures" / "table.csv")) in readme
