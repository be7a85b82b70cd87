"""What objects show: plots told apart without colour, and HTML in which names from files are only text."""

import re
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
from conftest import HOSTILE, linear_system, visible_texts
from hypothesis import example as instance
from hypothesis import given, settings
from hypothesis import strategies as st
from IPython.core.formatters import DisplayFormatter
from matplotlib.figure import Figure

import tras
from tras.display import html, plots
from tras.identification.advice import Advice, AdviceList
from tras.identification.examples import example
from tras.plotting import WIDTH, new_figure

HOSTILE = HOSTILE[:5]


@pytest.fixture(scope="module")
def recording():
    return linear_system([[0, 1], [-4, -0.4]], [[0], [1]], 0.05, trajectories=6, samples=80)[0]


@pytest.fixture(scope="module")
def model(recording):
    return tras.KoopmanModel(tras.Monomials(1)).fit(recording)


@pytest.fixture(scope="module")
def poor(recording):
    """A model that is wrong: fitted to the same motion at other inputs."""
    other = recording.with_data([x for x, _ in recording], [0.3 * u[::-1] for _, u in recording])
    return tras.KoopmanModel(tras.Monomials(2), "one_step").fit(other)


def hostile():
    rng = np.random.default_rng(0)
    names, inputs = HOSTILE[:3], HOSTILE[3:]
    return tras.Recording(
        rng.normal(size=(4, 30, 3)).cumsum(axis=1), rng.normal(size=(4, 30, 2)), 0.1,
        state_names=names, input_names=inputs, state_units=HOSTILE[:3], input_units=HOSTILE[3:],
    )  # fmt: skip


def dashes(line):
    return line.get_linestyle(), line._unscaled_dash_pattern  # names, and what a sequence of lengths became


# --- plots ---


def test_the_table_of_a_comparison_is_of_all_trajectories(recording, model, poor):
    position = recording.select(states=["x1"])
    delayed = tras.KoopmanModel(tras.Monomials(1), "one_step", 1).fit(position)
    table = tras.compare(recording, model, delayed, names=["plain", "late"]).table.set_index(["state", "model"])
    assert list(table.index) == [("x1", "plain"), ("x1", "late"), ("x2", "plain")]
    later = recording.with_data([x[1:] for x, _ in recording], [u[1:] for _, u in recording])
    runs = {"plain": model.predict(later), "late": delayed.predict(position)[:, 1:]}
    for state, name in table.index:
        i = recording.state_names.index(state)
        pair = later.states[..., [i]], runs[name][..., [i]]
        row = table.loc[(state, name)]
        assert np.allclose([row["fit"], row["nrmse"]], np.ravel([tras.metrics.bfr(*pair), tras.metrics.nrmse(*pair)]))
    one = tras.compare(recording[[3]], poor).table
    legends = [
        panel.get_legend().get_texts()[1].get_text()
        for panel in tras.compare(recording, poor, trajectory=3).figure.axes
    ]
    assert [text.rpartition(": ")[2] for text in legends] == [f"{fit:.3g} %" for fit in one["fit"]]


def test_the_table_counts_what_diverged(recording, model):
    wild = tras.KoopmanModel(tras.Monomials(1)).fit(recording)
    wild.W_ = wild.W_ + 40 * np.eye(2, wild.W_.shape[1], 1)
    table = tras.compare(recording, wild).table
    assert (table["diverged"] == 6).all() and (table["trajectories"] == 6).all() and table["fit"].isna().all()


def test_compare_says_the_fit_that_the_metric_has(recording, model, poor):
    figure = tras.compare(recording, model, poor, names=["good", "poor"], trajectory=2).figure
    one = recording[2]
    for i, panel in enumerate(figure.axes):
        texts = [text.get_text() for text in panel.get_legend().get_texts()]
        fits = [tras.metrics.bfr(one.states, each.predict(one))[i] for each in (model, poor)]
        assert texts == ["measured", f"good: {fits[0]:.3g} %", f"poor: {fits[1]:.3g} %"]
        assert fits[0] > 99 and fits[1] < 90
        truth, *predictions = panel.get_lines()[:3]
        assert np.array_equal(truth.get_ydata(), one.states[0][:, i])
        shown, run = predictions[1].get_ydata(), poor.predict(one)[0][:, i]
        inside = (run >= panel.get_ylim()[0]) & (run <= panel.get_ylim()[1])
        assert np.allclose(shown[inside], run[inside], rtol=1e-9) and inside.sum() > 40
        assert len({str(dashes(line)) for line in (truth, *predictions)}) == 3
        assert np.allclose(truth.get_xdata(), np.arange(80) * 0.05)
    assert figure.axes[-1].get_xlabel() == "time (s), trajectory 2 of 6"


def test_five_models_differ_without_colour(recording, model):
    panel = tras.compare(recording, *[model] * 5, states=["x1"]).figure.axes[0]
    assert len({str(dashes(line)) for line in panel.get_lines()}) == 6
    names = [text.get_text().partition(":")[0] for text in panel.get_legend().get_texts()]
    assert names == ["measured", *(f"Monomials [{i}]" for i in range(1, 6))]


def test_models_with_delays_begin_together(recording, model):
    noisy = tras.add_noise(recording, 0.01, 0)  # else a delay says nothing new
    late = tras.KoopmanModel(tras.Monomials(1), "one_step", delays=3).fit(noisy)
    positions = tras.KoopmanModel(tras.Monomials(1), "one_step", delays=2).fit(noisy.select(states=["x1"]))
    figure = tras.compare(recording, model, late, positions, names=["a", "b", "c"]).figure
    first, second = figure.axes
    assert [len(line.get_ydata()) for line in first.get_lines()] == [80, 77, 77, 77]
    assert [text.get_text()[0] for text in second.get_legend().get_texts()] == ["m", "a", "b"]
    assert first.get_lines()[1].get_ydata()[0] == recording.states[0, 3, 0]


def test_a_prediction_that_diverges_is_said(recording, model):
    class Diverging:
        delays, state_names_, input_names_, dictionary = 0, ("x1", "x2"), ("u1",), tras.Monomials(3)

        def require_fitted(self):
            pass

        def predict(self, recording):
            return recording.states * 10.0 ** np.arange(recording.lengths[0])[:, None]

    panel = tras.compare(recording, Diverging(), model).figure.axes[0]
    assert panel.get_legend().get_texts()[1].get_text() == "Monomials(degree=3): diverged"
    truth, curve = recording.states[0, :, 0], panel.get_lines()[1]
    assert panel.get_ylim()[0] > truth.min() - 0.9 * np.ptp(truth)
    assert panel.get_ylim()[1] < truth.max() + 0.9 * np.ptp(truth)
    (triangle,) = triangles(panel)
    low, high = panel.get_ylim()
    edge = low if truth[0] < 0 else high
    assert triangle.get_ydata() == [edge] and triangle.get_marker() == ("v" if truth[0] < 0 else "^")
    # It stands on the curve, which the frame cuts there.
    assert np.isclose(np.interp(triangle.get_xdata()[0], curve.get_xdata(), curve.get_ydata()), edge)


def triangles(panel):
    return [line for line in panel.get_lines() if line.get_label() == "_leaves"]


@pytest.mark.parametrize("before, up", [([0.5, 0.9], True), ([-0.5, -0.9], False), ([0.5], True)])
def test_a_curve_that_ends_in_nan_leaves_by_its_last_step(before, up):
    truth = np.sin(np.arange(10.0))
    run = np.array([*before, *[np.nan] * (10 - len(before))])
    figure, panel = new_figure()
    frame = plots.frame_of(truth, run)
    line = plots.draw_in_frame(panel, np.arange(10), run, frame)
    (triangle,) = triangles(panel)
    assert triangle.get_ydata() == [frame[up]] and panel.get_ylim() == frame
    assert np.array_equal(line.get_ydata()[: len(before)], before) and len(before) - 1 < triangle.get_xdata()[0]


@given(st.lists(st.floats(allow_nan=True, allow_infinity=True), min_size=2, max_size=20))
def test_no_run_squashes_the_truth(values):
    """The frame holds the truth, and at most 1.5 times its range more; whatever is drawn is finite."""
    truth, run = np.linspace(-1, 1, len(values)), np.array(values)
    low, high = plots.frame_of(truth, run)
    assert low < -1 and 1 < high and high - low <= 1.1 * 2.5 * 2
    figure, panel = new_figure()
    drawn = plots.draw_in_frame(panel, np.arange(len(run)), run, (low, high)).get_ydata()
    seen = np.isfinite(run) & (run >= low) & (run <= high)
    assert np.array_equal(drawn[seen], run[seen])
    assert bool(triangles(panel)) == bool((~np.isnan(run) & ~seen).any() or (seen[:-1] & np.isnan(run[1:])).any())


def test_a_constant_state_has_no_fit(recording, model):
    still = recording.with_data([0 * x for x, _ in recording], [u for _, u in recording])
    assert "no fit: constant" in tras.compare(still, model).figure.axes[0].get_legend().get_texts()[1].get_text()


@pytest.mark.parametrize("draw", ["recording", "model", "two", "five", "spectrum"])
def test_a_figure_fits_its_column(draw, recording, model, poor):
    figure = {
        "recording": recording.plot,
        "model": lambda: model.plot(recording),
        "two": lambda: tras.compare(recording, model, poor, names=["mechanical", "linear"]).figure,
        "five": lambda: (
            tras.compare(recording, *[model, poor] * 2, model, names=["MMMM", "l" * 22, "m", "W" * 30, "x"]).figure
        ),
        "spectrum": model.plot_spectrum,
    }[draw]()
    assert isinstance(figure, Figure) and figure.get_figwidth() == WIDTH
    renderer, texts = visible_texts(figure)
    page = figure.bbox
    for text in texts:
        box = text.get_window_extent(renderer)
        assert page.x0 - 1 <= box.x0 and box.x1 <= page.x1 + 1 and page.y0 - 1 <= box.y0 and box.y1 <= page.y1 + 1, text
        assert text.get_fontsize() >= 7
    png = DisplayFormatter().format(figure)[0]["image/png"]  # a notebook shows it, without pyplot
    assert png.startswith(b"\x89PNG")


def test_axes_of_ones_own(recording, model):
    mine = Figure()
    axes = mine.subplots(3)
    assert recording.plot(["x2"], ax=axes[0]) is mine and model.plot(recording, ax=axes[:2]) is mine
    assert model.plot_spectrum(ax=axes[2]) is mine
    assert axes[0].get_title(loc="left") == "x2" and axes[2].get_xlabel() == "real part"
    points = axes[2].get_lines()[1]
    assert np.array_equal(points.get_xdata() + 1j * points.get_ydata(), model.eigenvalues)


def test_trajectories_are_not_joined(recording):
    curve = recording.plot(["x1"]).axes[0].get_lines()[0]
    assert np.isnan(curve.get_ydata()).sum() == len(recording) - 1
    assert np.array_equal(curve.get_ydata()[:80], recording.states[0, :, 0])


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda r, m: r.plot(["y"]), "channels: there is no 'y'; there are x1, x2, u1"),
        (lambda r, m: r.plot([]), "channels has 0 names; give 1 to 6"),
        (lambda r, m: r.plot(ax=Figure().subplots(2)), "ax is 2 of Axes; give 3 matplotlib Axes"),
        (lambda r, m: r.plot(["x1"], ax="here"), "ax is 1 of str; give 1 matplotlib Axes"),
        (lambda r, m: tras.compare(r), "there are 0 models; give 1 to 5"),
        (lambda r, m: tras.compare(r, *[m] * 6), "there are 6 models; give 1 to 5"),
        (lambda r, m: tras.compare(r, tras.KoopmanModel(tras.Monomials(1))), "not fitted; call fit"),
        (lambda r, m: tras.compare(r, "model.npz"), "models holds a str; give fitted models"),
        (lambda r, m: tras.compare(r, m, names="m"), "names is 'm'; give a list of 1"),
        (lambda r, m: tras.compare(r, m, states=["u1"]), "states: there is no 'u1'; there are x1, x2"),
        (lambda r, m: m.plot(r, trajectory=6), "trajectory is 6; give a whole number from 0 to 5"),
        (lambda r, m: m.plot(r, trajectory=True), "trajectory is True"),
        (lambda r, m: m.plot(r.select(states=["x1"])), "there is no channel 'x2'"),
        (lambda r, m: m.plot(r[[0]].with_data([r.states[0, :1]], [r.inputs[0, :1]])), "1 samples; 0 delays need 2"),
        (lambda r, m: tras.KoopmanModel(tras.Monomials(1)).plot_spectrum(), "not fitted"),
    ],
)
def test_a_wrong_call_is_a_sentence(call, words, recording, model):
    with pytest.raises(ValueError, match=re.escape(words)):
        call(recording, model)


# --- HTML and short texts ---


def test_a_recording_in_a_notebook(recording):
    tree = ElementTree.fromstring(recording._repr_html_())
    rows = [[cell.text for cell in row][:5] for row in tree.iter("tr")][1:]
    x = recording.states[..., 0]
    assert rows[0] == ["x1", "state", "–", f"{x.min():.4g}", f"{x.max():.4g}"] and rows[2][:2] == ["u1", "input"]
    assert len(list(tree.iter("polyline"))) == 3
    assert "6 trajectories of 80 samples at 0.05 s" in recording._repr_html_()


def test_a_sparkline_keeps_the_peak():
    values = np.zeros(100_000)
    values[54_321] = 1.0
    (line,) = ElementTree.fromstring(html.sparkline(values)).iter("polyline")
    points = np.array([point.split(",") for point in line.get("points").split()], dtype=float)
    assert len(points) <= 241 and abs(points[points[:, 1].argmin(), 0] - 120 * 0.54321) < 2
    assert len(html.sparkline(np.array([1.0]))) < 300


def test_a_model_and_an_identification_in_a_notebook(model):
    tree = ElementTree.fromstring(model._repr_html_())
    assert tree.find("pre").text == model.report()
    shown = DisplayFormatter().format(model)[0]
    assert shown["text/html"] == model._repr_html_() and shown["text/plain"] == repr(model)
    assert set(DisplayFormatter().format(tras.KoopmanModel(tras.Monomials(1)))[0]) == {"text/plain"}


@pytest.mark.slow
def test_an_identification_shows_itself():
    result = tras.identify(example("duffing", trials=6), predictor="one_step", delays=[0], smoothing=False, draws=0)
    text = result._repr_html_()
    ElementTree.fromstring(text)
    assert text.count("<table") == 1 and "the model misses the test data by" in text
    assert (
        repr(result).startswith(f"Identification: {type(result.model.dictionary).__name__}(degree=3")
        and len(repr(result)) < 500
    )
    figure = result.plot()
    assert [panel.get_ylabel() for panel in figure.axes[::2]] == ["q (m)", "qdot (m/s)"]


def test_advice_shows_itself():
    advice = AdviceList([Advice("stop", HOSTILE[0], HOSTILE[1]), Advice("note", "b", HOSTILE[3])])
    tree = ElementTree.fromstring(advice._repr_html_())
    assert [paragraph.text for paragraph in tree.iter("p")] == [HOSTILE[1], HOSTILE[3]]
    assert repr(advice) == f"stop: {HOSTILE[0]}\nnote: b" and repr(AdviceList()) == "no warnings"
    ElementTree.fromstring(AdviceList()._repr_html_())


def test_hostile_names_are_text_everywhere():
    recording = hostile()
    model = tras.KoopmanModel(tras.Monomials(1), "one_step").fit(recording)
    for thing in (recording, model):
        tree = ElementTree.fromstring(thing._repr_html_())
        assert {each.tag for each in tree.iter()} <= set(
            "div table caption span thead tbody tr th td svg polyline pre".split()
        )
        assert "mathjax_ignore" in tree.get("class")
    names = [row[0].text for row in ElementTree.fromstring(recording._repr_html_()).iter("tr")][1:]
    assert names[:3] == [HOSTILE[0], HOSTILE[1], "_a b"] and names[4] == "ü" * 39 + "…"
    assert "\n" not in repr(recording) and len(repr(recording)) < 300
    for figure in (recording.plot(), model.plot(recording), tras.compare(recording, model, names=["_$x$"]).figure):
        _, texts = visible_texts(figure)
        assert all(len(text.get_text()) <= 45 for text in texts)
    assert " _\\$x\\$: " in figure.axes[0].get_legend().get_texts()[1].get_text()


def test_many_channels_stay_short():
    wide = tras.Recording(np.zeros((1, 5, 200)), dt=0.1)
    assert repr(wide).endswith("states x1, x2, x3, x4, x5, x6, ... (200); inputs none")
    assert wide._repr_html_().count("<svg") == 30 and "170 more channels" in wide._repr_html_()
    assert len(wide.plot().axes) == plots.MOST


@pytest.mark.filterwarnings("ignore:Glyph .* missing")  # a box is drawn
@settings(deadline=None, max_examples=50)
@instance("$\\frac{$")
@given(st.text(min_size=1))
def test_any_name_is_drawn_and_escaped(name):
    from tras.plotting import plain
    from tras.workflow.page import escape

    ElementTree.fromstring(f"<p>{escape(name)}</p>")
    figure = Figure(figsize=(1, 1))
    figure.text(0, 0, plain(name)).get_window_extent()
    assert not plain(name).startswith("_") and len(plain(name).replace("\\$", "$")) <= 41
