"""What the page of an identification has for a control engineer: residual tests, responses, criteria, figures."""

import xml.etree.ElementTree as ElementTree

import control
import numpy as np
import pandas as pd
import pytest
from conftest import visible_texts
from matplotlib.backends.backend_agg import FigureCanvasAgg

import tras
from tras.analysis import responses
from tras.display import plots
from tras.identification import diagnosis, figures, folder, page, search
from tras.identification.examples import example
from tras.plotting import WIDTH

XHTML = "{http://www.w3.org/1999/xhtml}"


@pytest.fixture(scope="module")
def result():
    return tras.identify(example("duffing", trials=6), predictor="one_step", delays=[0], smoothing=False, draws=10)


@pytest.fixture(scope="module")
def diagnosed(result):
    return diagnosis.diagnose(result)


@pytest.fixture(scope="module")
def written(result, tmp_path_factory):
    out = tmp_path_factory.mktemp("page") / "out"
    return out, folder.write(result, example("duffing", trials=6), "duffing.csv", out)


# --- residuals ---


def test_the_tests_are_those_of_the_model_on_the_test(result, diagnosed):
    one, ahead = diagnosed.tests["residuals"], diagnosed.tests["residuals_ahead"]
    assert one.steps == 1 and ahead.steps == result.test.lengths.max() // 5 > 5
    for each in (one, ahead):
        assert each.table.equals(result.model.residuals(result.whole_test, steps=each.steps).table)


def test_the_largest_correlation_is_that_of_the_table(diagnosed):
    tests = diagnosed.tests["residuals"]
    largest = tests.correlations[tests.correlations["tested"]].set_index(["state", "against", "lag"])["correlation"]
    state, other, lag = largest.abs().idxmax()
    assert f"{largest[(state, other, lag)]:.2f}, of {state} with {other} at lag {lag}" in diagnosis.strongest(tests)


def test_too_few_residuals_are_said(result):
    brief = result._replace(whole_test=result.whole_test.cut(12)[[0, 1]])
    one, ahead = diagnosis.residual_tests(brief).values()
    assert one.startswith("The residuals over 1 sample are not tested: ") and "too few for 25 lags" in one
    assert "over 15 samples are not tested: the longest trajectory has 12 samples" in ahead


# --- responses ---


def test_bode_and_step_are_of_the_linearised_model(result, diagnosed):
    x, u, rests = responses.rest_point(result.model, result.recording)
    assert rests and np.abs(x).max() < 0.05
    system = result.model.linearize(x, u)
    table = diagnosed.responses.bode.query("kind == 'linearised' and state == 'q'")
    expected = system(np.exp(2j * np.pi * table["frequency"].to_numpy() * system.dt))[0, 0]
    assert np.allclose(table["gain"] * np.exp(1j * np.radians(table["phase"])), expected, rtol=1e-6)
    assert np.isclose(table["frequency"].max(), 0.5 / system.dt)
    step = diagnosed.responses.step.query("state == 'q'")
    assert np.allclose(step["response"], control.step_response(system, step["time"].to_numpy()).outputs[0, 0])
    assert abs(step["response"].iloc[-1] - control.dcgain(system)[0, 0]) < 0.05


def test_the_band_is_of_the_ensemble(result, diagnosed):
    x, u, _ = responses.rest_point(result.model, result.recording)
    step = diagnosed.responses.step.query("state == 'q'")
    runs = [
        control.step_response(member.linearize(x, u), step["time"].to_numpy()).outputs[0, 0]
        for member in result.ensemble
    ]
    assert np.allclose(step["lower"], np.min(runs, axis=0)) and np.allclose(step["upper"], np.max(runs, axis=0))
    bode = diagnosed.responses.bode.query("kind == 'linearised'")
    assert (bode["lower"] <= bode["upper"]).all() and (bode["phase_lower"] <= bode["phase_upper"]).all()
    without = diagnosis.of_responses(result._replace(ensemble=[]))
    assert without.step["lower"].isna().all() and without.bode["gain"].equals(diagnosed.responses.bode["gain"])


def test_the_models_simulation_has_the_response_of_the_recording(diagnosed):
    """A Duffing oscillator at these amplitudes is far from its linear system: both say so, and where to trust it."""
    table = diagnosed.responses.bode.query("state == 'q'").set_index(["kind", "frequency"])
    trusted = table.loc["recording"].query("trusted == True").index
    gain = {kind: table.loc[kind]["gain"] for kind in ("recording", "simulated")}
    line = table.loc["linearised"]["gain"]
    assert len(trusted) >= 5 and trusted.max() < 0.6  # the force ends at 0.5 Hz
    assert (gain["simulated"][trusted] / gain["recording"][trusted] - 1).abs().max() < 0.1
    assert np.abs(np.interp(trusted, line.index, line) / gain["recording"][trusted] - 1).max() > 0.5
    words = " ".join(diagnosed.responses.remarks)
    assert "linearised about the point where the model rests" in words and "not linear" in words
    assert f"to {trusted.max():.2g} Hz" in words and "too little power" in words


def test_feedback_is_said(result):
    facts = result.checks.facts | {"feedback": {"force": 0.81}}
    words = diagnosis.of_responses(result._replace(checks=result.checks._replace(facts=facts))).remarks[-2]
    assert "explains 81 % of force" in words and "closed loop" in words


def test_a_short_recording_has_no_response_of_its_own(result):
    brief = result._replace(recording=result.recording[[0]].cut(100)[[0]])
    diagnosed = diagnosis.of_responses(brief)
    assert set(diagnosed.bode["kind"]) == {"linearised"} and "too short" in diagnosed.remarks[1]


@pytest.mark.parametrize("key", ["step", "bode", "residuals", "residuals_ahead"])
def test_figures_fit_their_column(key, diagnosed):
    units, source = {"q": "m", "qdot": "m/s"}, ("force", "N")
    figure = {
        "step": lambda: figures.step_figure(diagnosed.responses.step, units, dict([source])),
        "bode": lambda: figures.bode_figure(diagnosed.responses.bode, units, source),
        "residuals": lambda: diagnosed.tests["residuals"].plot(),
        "residuals_ahead": lambda: diagnosed.tests["residuals_ahead"].plot(),
    }[key]()
    renderer, texts = visible_texts(figure)
    assert figure.get_figwidth() == WIDTH
    for text in texts:
        box = text.get_window_extent(renderer)
        assert figure.bbox.x0 - 1 <= box.x0 and box.x1 <= figure.bbox.x1 + 1, text
        assert figure.bbox.y0 - 1 <= box.y0 and box.y1 <= figure.bbox.y1 + 1 and text.get_fontsize() >= 7, text
    words = " ".join(text.get_text() for text in texts)
    assert {"step": "force (N)", "bode": "frequency (Hz)"}.get(key, "lag (samples)") in words
    if key == "bode":  # lines and dots differ without colour; an untrusted dot is hollow
        lines = {line.get_label(): line for line in figure.axes[0].get_lines()}
        assert lines["recording"].get_linestyle() == "None" and lines["linearised model"].get_marker() == "None"
        assert lines["recording, not to be trusted"].get_markerfacecolor() == "none"
        assert lines["model simulated"].get_linestyle() == "-."


def test_names_of_any_length_stay_in_the_figure(diagnosed):
    long = {"q": "W" * 60, "qdot": "$\\frac{"}
    for table in (diagnosed.responses.step, diagnosed.responses.bode):
        renamed = table.replace({"state": long, "input": {"force": "_x$"}})
        units = {long["q"]: "m", long["qdot"]: ""}
        few = (units, {"_x$": "N"}) if "time" in table else (units, ("_x$", "N"))
        figure = (figures.step_figure if "time" in table else figures.bode_figure)(renamed, *few)
        FigureCanvasAgg(figure).draw()
        words = "".join(text.get_text() for text in visible_texts(figure)[1])
        assert "WWWWW…" in words and "_x" in words


# --- criteria ---


def test_criteria_of_the_candidates_are_of_the_same_samples(result):
    """Those of `information_criteria`, from the sample on that the longest delays leave, whatever was fitted."""
    table = result.search
    assert np.isfinite(table[["AIC", "BIC", "FPE"]].to_numpy()).all()
    linear, chosen = table[table["dictionary"] == "Monomials(degree=1)"], table[table["chosen"]]
    assert chosen["BIC"].iloc[0] < linear["BIC"].min() and chosen["FPE"].iloc[0] < linear["FPE"].min()
    measured, windows = result.train.cut(51), result.test
    fitted = tras.add_noise(measured, 1e-3, 0)
    for delays in (0, 2):
        model = tras.KoopmanModel(tras.Monomials(1), "one_step", delays, strength=0)
        scores = search.attempt(model, fitted, windows, 2, None, measured)
        later = measured.with_data([x[2 - delays :] for x, _ in measured], [u[2 - delays :] for _, u in measured])
        expected = model.fit(fitted).information_criteria(later).iloc[-1]
        assert expected["samples"] == len(measured) * 48
        assert all(np.isclose(scores[name], expected[name]) for name in ("AIC", "BIC", "FPE"))


def test_a_candidate_with_more_parameters_than_samples_has_no_criteria(result):
    short = result.train.cut(4)[[0, 1, 2, 3, 4]]
    scores = search.attempt(
        tras.KoopmanModel(tras.Monomials(3), "one_step", strength=0.1), result.train, result.test, 0, None, short
    )
    assert np.isfinite(scores["error"]) and np.isnan(scores["AIC"]) and not scores["failure"]


def test_without_measured_data_a_candidate_has_no_criteria():
    log = example("duffing", trials=6)
    model, tried = tras.choose(log.cut(51), [tras.KoopmanModel(tras.Monomials(d), "one_step") for d in (1, 3)])
    assert "AIC" not in tried and model.dictionary.degree == 3


# --- the page ---


def test_the_page_has_it_in_this_order(written):
    out, contents = written
    text = (out / "report.html").read_text(encoding="utf-8")
    tree = ElementTree.fromstring(text.removeprefix("<!DOCTYPE html>\n"))
    order = [element.get("id") for element in tree.iter() if element.tag in (f"{XHTML}figure", f"{XHTML}h2")]
    wanted = ["in-short", "free_run", "growth", "residuals", "residuals_ahead", "step", "bode", "spectrum", "files"]
    assert [name for name in order if name in wanted] == wanted
    tables = ["".join(table.itertext()) for table in tree.iter(f"{XHTML}table")]
    assert "Candidates" in tables[-1] and all(word in tables[-1] for word in ("AIC", "BIC", "FPE"))
    search = pd.read_csv(out / "tables" / "search.csv")
    assert f"{search.sort_values('error')['AIC'].iloc[0]:.0f}" in tables[-1]
    tests = pd.read_csv(out / "tables" / "residuals.csv")
    assert set(tests["steps"]) == {1, tests["steps"].max()} and {"p", "alarm"} <= set(tests)
    for link in contents["file"]:
        assert (out / link).exists() or link == "identify.ipynb"
        assert f'href="{link}"' in text


def test_short_equations_stand_on_the_page_and_long_ones_in_their_file():
    text = "# Rates (per s) by tras 0.1.0; dictionary.\n# Names: a_1 is 'a[-1]'.\n# x: 3 of 4 left out.\n"
    short, long = "dx_dt = y", "dy_dt = " + " + ".join(f"{k}*x**{k}" for k in range(13))
    html = page._formulas(f"{text}{short}\n{long}\n")
    assert f"{short}\ndy_dt = ...  # 13 terms" in html and "left out" not in html and "<p>Rates (per s), " in html
    assert "a_1 is" in html and html.count("formulas.txt") == 2
    assert "The equations are long (13 terms)" in page._formulas(f"{text}{long}\n") and not page._formulas("")


def test_an_autonomous_system_has_no_responses(tmp_path):
    rng = np.random.default_rng(0)
    x = np.exp(-0.05 * np.arange(300))[:, None] * np.column_stack([np.cos(0.2 * np.arange(300))])
    log = tras.Recording(
        [x * scale + 1e-3 * rng.normal(size=x.shape) for scale in (1, -0.7, 0.5, 0.9, 0.8, 1.1)], dt=0.1
    )
    result = tras.identify(log, predictor="one_step", delays=[2], smoothing=False, draws=0)
    assert diagnosis.diagnose(result).responses is None
    folder.write(result, log, "free.csv", tmp_path / "out")
    text = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "Step and frequency" not in text and 'id="residuals"' in text


def test_the_page_is_centred_and_fits_a_telephone(written, browser):
    out, _ = written
    for width in (1280, 390):
        window = browser.new_page(viewport={"width": width, "height": 900})
        window.goto((out / "report.html").resolve().as_uri())
        boxes = window.evaluate(
            "[...document.querySelectorAll('main > p, main > h2, main > figure, main > pre, main > .scroll')]"
            ".map(e => e.getBoundingClientRect()).map(b => [b.left, b.right])"
        )
        assert window.evaluate("document.documentElement.scrollWidth") == width
        assert all(left >= 0 and right <= width for left, right in boxes)
        assert all(abs(left + right - width) < 20 for left, right in boxes)  # but for the bar that scrolls
        window.close()


def test_a_run_that_leaves_is_drawn_to_the_edge(result):
    """In the windows of the test as in the free run, and the truth keeps its size."""
    table = result.overlay.copy()
    late = table.groupby("window").cumcount() > 10
    table.loc[late, "q: model"] *= 1e9
    figure = figures.prediction_figure(table, ["q", "qdot"], ["m", "m/s"])
    panel = figure.axes[0]
    assert [line for line in panel.get_lines() if line.get_label() == "_leaves"]
    assert np.ptp(panel.get_ylim()) < 3 * np.ptp(table["q: true"])
    assert plots.frame_of(table["q: true"].to_numpy(), table["q: model"].to_numpy()) == panel.get_ylim()
