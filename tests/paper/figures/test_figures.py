"""The drawn rig obeys the equations of motion; figures are legible, complete and repeat byte for byte."""

import subprocess
import sys
from functools import partial

import matplotlib
import numpy as np
import pandas as pd
import pytest
from conftest import ROOT, visible_texts
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from tras import plotting
from tras.explorer.figures import portrait_figure
from tras.paper.figures import comparison, control, drawings, paper, readings, robustness
from tras.twin_rotor import drawing as rig

FIGURES = ROOT / "figures"

G = 9.81
MASSES = {"main_mass": 0.32306, "tail_mass": 0.27850, "left_weight_mass": 0.01908, "right_weight_mass": 0.01908}  # kg
G_C, G_S = 0.05005756, 0.09360078  # N m


def rig_case():
    table = rig.rig_geometry(*rig.FIGURE_POSE)
    return drawings.rig_figure(table), table


def method_case():
    table = drawings.method_diagram()
    return drawings.method_figure(table), table


def redrawn(draw, name):
    """A figure of the data, drawn again from the numbers that are stored beside it."""

    def case():
        table = pd.read_csv(FIGURES / f"{name}.csv")
        return draw(table), table

    case.__name__ = name
    return case


DATA_FIGURES = {
    "fig3_overlay": paper.overlay_figure,
    "excitation": paper.excitation_figure,
    "spectrum": paper.spectrum_figure,
    "horizon": paper.horizon_figure,
    "comparison_window": comparison.window_figure,
    "comparison_horizon": comparison.horizon_figure,
    "comparison_data": comparison.data_figure,
    "readings_effects": readings.effects_figure,
    "readings_nearest": partial(readings.nearest_figure, within=0.25),
    "robustness_noise": robustness.noise_figure,
    "robustness_length": robustness.length_figure,
    "eigenfunctions": robustness.eigenfunctions_figure,
    "parameters": robustness.parameters_figure,
    "portrait": portrait_figure,
    "control_tracking": control.tracking_figure,
    "control_disturbance": control.disturbance_figure,
}
CASES = pytest.mark.parametrize(
    "case", [rig_case, method_case, *(redrawn(draw, name) for name, draw in DATA_FIGURES.items())]
)


@pytest.mark.parametrize("name", DATA_FIGURES)
def test_a_table_without_its_columns_is_refused(name):
    with pytest.raises(ValueError, match="table lacks the columns"):
        DATA_FIGURES[name](pd.read_csv(FIGURES / f"{name}.csv").iloc[:, :1])


def an_overlay(whole=3.0):
    """Two inputs, of which the second has the mechanical model too; both angles move by 0.5 rad."""
    time = np.linspace(0, 6, 61)
    curves = [f"{angle}_{who}" for angle in ("psi", "phi") for who in ("true", "koopman", "linear")]
    table = pd.DataFrame({"time": time} | dict.fromkeys(curves, 0.5 * time / 6))
    table = table.assign(phi_low=-whole / 2, phi_high=whole / 2, psi_low=-0.5, psi_high=0.5)
    mechanical = dict.fromkeys(("psi_mechanical", "phi_mechanical"), 0.5 * time / 6)
    return pd.concat([table.assign(input="reference"), table.assign(input="torque", **mechanical)])


def test_truth_and_predictions_differ_in_dash_or_width_not_only_in_colour():
    figure = paper.overlay_figure(an_overlay())
    for axes, curves in zip(figure.axes, (3, 4, 3, 4), strict=True):
        looks = {(str(line.get_linestyle()), line.get_linewidth()) for line in axes.lines}
        assert len(looks) == len(axes.lines) == curves
    assert [text.get_text() for text in figure.legends[0].get_texts()][-1] == "Koopman, mechanical"


def test_a_narrow_axis_says_how_far_the_recording_reaches():
    notes = [axes.get_title(loc="right") for axes in paper.overlay_figure(an_overlay()).axes]
    assert notes == ["", "", *["whole recording: \N{MINUS SIGN}1.5 to 1.5 rad"] * 2]
    assert not any(axes.get_title(loc="right") for axes in paper.overlay_figure(an_overlay(whole=1.0)).axes)


def test_what_was_varied_is_said_in_words_and_a_new_choice_by_its_name():
    table = pd.read_csv(FIGURES / "readings_effects.csv")
    table = pd.concat([table, table.tail(1).assign(option="gains", choice="twice_as_high")])
    labels = [text.get_text() for text in readings.effects_figure(table).axes[0].get_yticklabels()]
    assert labels[0] == "input: torques" and labels[-1] == "gains: twice as high"
    assert not any("_" in label for label in labels)


def test_plants_that_change_nothing_are_counted():
    table = pd.read_csv(FIGURES / "readings_effects.csv")
    plants = table[table["option"] == "plant"]
    far = (np.log(plants["median"]).abs() > np.log(1.05)).groupby(plants["choice"]).any()
    figure = readings.effects_figure(table)
    labels = [text.get_text() for text in figure.axes[0].get_yticklabels()]
    assert sum(label.startswith("plant") for label in labels) == far.sum() < len(far)
    assert f"{(~far).sum()} other plants" in figure.get_supxlabel()


def test_where_no_run_gave_a_model_the_curve_has_a_gap():
    table = pd.read_csv(FIGURES / "robustness_noise.csv")
    table.loc[(table["method"] == "plain") & (table["noise"] > 0), "nrmse"] = np.nan
    curve = robustness.noise_figure(table).axes[0].lines[0].get_ydata()
    assert np.isfinite(curve[0]) and np.isnan(curve[1:]).all()


def test_times_stand_beside_the_sampling_time():
    rng = np.random.default_rng(0)
    table = pd.DataFrame({"controller": ["MPC, a"] * 90 + ["MPC, b"] * 90, "seconds": rng.lognormal(-6, 0.3, 180)})
    figure = control.times_figure(table, 0.01)
    assert [panel.get_ylabel() for panel in figure.axes] == ["a", "b"]
    for panel in figure.axes:
        assert panel.lines[0].get_xdata()[0] == pytest.approx(10) and panel.get_xlim()[1] > 10
        assert sum(bar.get_height() for bar in panel.patches) == 90


def test_torques_stand_within_their_limits_and_angles_beside_their_reference():
    table = pd.read_csv(FIGURES / "control_tracking.csv")
    figure = control.tracking_figure(table)
    for panel, name in zip(figure.axes, ("phi", "psi", "u_phi", "u_psi"), strict=True):
        curves = [line.get_ydata() for line in panel.lines]
        if name.startswith("u_"):
            low, high = (curve[0] for curve in curves[-2:])
            assert all(low - 1e-9 <= curve.min() and curve.max() <= high + 1e-9 for curve in curves[:-2])
        else:
            first = table[table["controller"] == table["controller"].iloc[0]]
            assert np.array_equal(curves[-1], first[f"{name}_reference"])


# ------------------------------------------------------------------------------------------------------------ the rig


def potential(phi, psi):
    table = rig.rig_geometry(phi, psi)
    return sum(G * mass * rig.part_points(table, part)[0, 2] for part, mass in MASSES.items())


@pytest.mark.parametrize("psi", [0.0, 0.6, -2.0])
@pytest.mark.parametrize("phi", [-1.2, -0.491, 0.0, 0.3, 1.1])
def test_heights_of_the_masses_give_the_gravity_torque(phi, psi):
    step = 1e-4
    slope = (potential(phi + step, psi) - potential(phi - step, psi)) / (2 * step)
    expected = G_C * np.cos(phi) + G_S * np.sin(phi)
    assert slope == pytest.approx(expected, abs=1e-3 * np.hypot(G_C, G_S))


def test_positive_pitch_lifts_the_main_rotor_and_positive_yaw_turns_it_anticlockwise():
    level, posed = rig.rig_geometry(0.0, 0.0), rig.rig_geometry(0.3, 0.2)
    assert rig.part_points(level, "main_mass")[0] == pytest.approx([0.202, 0, 0])
    assert rig.part_points(level, "tail_mass")[0] == pytest.approx([-0.216, 0, 0])
    x, y, z = rig.part_points(posed, "main_mass")[0]
    assert z == pytest.approx(0.202 * np.sin(0.3)) and np.arctan2(y, x) == pytest.approx(0.2)
    assert rig.part_points(posed, "tail_mass")[0, 2] == pytest.approx(-0.216 * np.sin(0.3))
    assert rig.part_points(posed, "left_weight_mass")[0, 2] == pytest.approx(-0.25 * np.cos(0.3))


def test_thrust_arrows_have_positive_moments_about_their_axes():
    psi = 0.6
    table = rig.rig_geometry(0.36, psi)
    moment = {}
    for part in ("main_thrust", "tail_thrust"):
        foot, tip = rig.part_points(table, part)
        moment[part] = np.cross(foot, tip - foot)
    raising = np.array([np.sin(psi), -np.cos(psi), 0.0])  # the rotation vector of a growing pitch
    assert moment["main_thrust"] @ raising > 0
    assert moment["tail_thrust"][2] > 0


@pytest.mark.parametrize("phi", [-1.2, -0.5, 0.0, 0.36, 1.2])
@pytest.mark.parametrize("psi", [-3.0, -1.0, 0.6, 2.0])
@pytest.mark.slow
def test_nearer_parts_are_drawn_later(phi, psi):
    """Rays through the picture: of all bodies that a ray meets, the one met first must be the last one drawn."""
    table = rig.rig_geometry(phi, psi)
    solids = {name: rig.part_points(table, name) for name in rig.SOLIDS}
    order = rig.back_to_front(solids, rig.CAMERA)
    right, up, towards = rig.view_axes(rig.CAMERA)
    across, height = np.meshgrid(np.linspace(-0.3, 0.3, 90), np.linspace(-0.4, 0.3, 90))
    rays = across.reshape(-1, 1) * right + height.reshape(-1, 1) * up
    surface = np.stack([_first_hit(rays, towards, solids[name]) for name in order])
    hit = np.isfinite(surface).any(axis=0)
    assert hit.sum() > 500
    seen = surface.argmax(axis=0)[hit]
    drawn_last = len(order) - 1 - np.isfinite(surface[::-1]).argmax(axis=0)[hit]
    np.testing.assert_array_equal(seen, drawn_last)


def _first_hit(rays, towards, solid):
    """Largest s with ray + s * towards inside a convex body, -inf where the ray misses it."""
    normals, offsets = rig.face_planes(solid)
    slope, room = normals @ towards, offsets - rays @ normals.T
    with np.errstate(divide="ignore", invalid="ignore"):
        bound = room / slope
    enter = np.where(slope < -1e-12, bound, -np.inf).max(axis=1)
    leave = np.where(slope > 1e-12, bound, np.inf).min(axis=1)
    outside = ((np.abs(slope) <= 1e-12) & (room < 0)).any(axis=1)
    return np.where((enter < leave) & ~outside, leave, -np.inf)


def test_two_rigs_overlay_in_one_axes():
    axes = Figure().add_subplot()
    truth = rig.draw_rig(axes, rig.rig_geometry(0.2, 0.1))
    ghost = rig.draw_rig(axes, rig.rig_geometry(0.4, 0.3), parts=set(rig.SOLIDS) - set(rig.STATIC), alpha=0.3, zorder=1)
    assert all(artist in axes.collections for artist in truth + ghost)
    assert ghost[0].get_facecolor()[:, 3].max() == pytest.approx(0.3)
    assert len(ghost[0].get_paths()) < len(truth[0].get_paths())


@pytest.mark.parametrize("wrong", [{"phi": np.nan}, {"psi": [0.1, 0.2]}, {"phi": "up"}, {"l_m": 0.0}, {"l_cw": np.inf}])
def test_impossible_poses_are_named(wrong):
    name = next(iter(wrong))
    with pytest.raises(ValueError, match=f"^{name} is .*; give a"):
        rig.rig_geometry(**({"phi": 0.0, "psi": 0.0} | wrong))


def test_unknown_part_is_named():
    with pytest.raises(ValueError, match="no part 'wing'"):
        rig.part_points(rig.rig_geometry(0.0, 0.0), "wing")


# -------------------------------------------------------------------------------------------------------- appearance


@CASES
@pytest.mark.slow
def test_figure_is_one_column_wide_with_everything_inside(case):
    figure, _ = case()
    assert figure.get_figwidth() == 3.5
    renderer, texts = visible_texts(figure)
    assert texts
    for text in texts:
        box = text.get_window_extent(renderer)
        assert box.x0 >= 0 and box.y0 >= 0 and box.x1 <= figure.bbox.x1 and box.y1 <= figure.bbox.y1, text.get_text()


@pytest.mark.parametrize("case", [rig_case, method_case])
def test_labels_do_not_overlap(case):
    renderer, texts = visible_texts(case()[0])
    boxes = [text.get_window_extent(renderer).padded(-0.5) for text in texts]
    for i, box in enumerate(boxes):
        for j in range(i):
            assert not box.overlaps(boxes[j]), (texts[i].get_text(), texts[j].get_text())


@CASES
def test_every_letter_reaches_six_points(case):
    for text in visible_texts(case()[0])[1]:
        has_index = "$" in text.get_text() and any(c in text.get_text() for c in "_^")
        smallest = text.get_fontsize() * (0.7 if has_index else 1.0)
        assert smallest >= 6.0, text.get_text()


def test_lines_of_the_cycle_differ_in_grey_or_dashes():
    with plotting.styled():
        cycle = list(matplotlib.rcParams["axes.prop_cycle"])
    grey = [np.dot([0.299, 0.587, 0.114], to_rgb(entry["color"])) for entry in cycle]
    for i, one in enumerate(cycle):
        for j, other in enumerate(cycle[:i]):
            assert one["linestyle"] != other["linestyle"] or abs(grey[i] - grey[j]) > 0.25


def test_method_diagram_holds_the_three_steps_and_their_equations():
    table = drawings.method_diagram()
    arrows = table[(table["kind"] == "arrow") & (table["step"] > 0)]
    assert list(arrows["step"]) == [1, 2, 3, 3]
    assert list(arrows["equation"]) == ["(13)", "(14)", "(15)", "(18)"]
    nodes = set(table.loc[table["kind"] == "node", "name"])
    assert set(arrows["start"]) | set(arrows["end"]) == nodes


# ------------------------------------------------------------------------------------------------------------- files


@pytest.mark.slow
def test_saving_twice_gives_the_same_bytes(tmp_path):
    """One figure will do, for this is about `save_figure`; `make verify` compares the bytes of every figure."""
    case = redrawn(paper.overlay_figure, "fig3_overlay")
    first = plotting.save_figure(*case(), tmp_path / "a" / "fig")
    figure, table = case()
    with matplotlib.rc_context({"font.size": 20, "svg.hashsalt": "other", "savefig.dpi": 50, "svg.fonttype": "none"}):
        second = plotting.save_figure(figure, table, tmp_path / "b" / "fig")
    again = plotting.save_figure(figure, table, tmp_path / "c" / "fig")
    assert [path.suffix for path in first] == [".pdf", ".svg", ".png", ".csv"]
    for one, two, three in zip(first, second, again):
        assert one.read_bytes() == two.read_bytes() == three.read_bytes(), one.suffix


def test_files_hold_no_date_version_or_place(tmp_path):
    pdf, svg, png, _ = plotting.save_figure(*method_case(), tmp_path / "fig")
    for path in (pdf, svg, png):
        content = path.read_bytes()
        for word in (b"CreationDate", b"Software", b"/work", matplotlib.__version__.encode()):
            assert word not in content, (path.suffix, word)


def test_table_comes_back_from_its_file(tmp_path):
    figure, table = rig_case()
    path = plotting.save_figure(figure, table, str(tmp_path / "rig_0.5s"))[-1]
    assert path.name == "rig_0.5s.csv" and b"\r" not in path.read_bytes()
    pd.testing.assert_frame_equal(pd.read_csv(path), table, rtol=1e-9, check_dtype=False)


def test_failing_save_leaves_the_older_files_and_nothing_else(tmp_path, monkeypatch):
    figure, table = method_case()
    finals = plotting.save_figure(figure, table, tmp_path / "fig")
    before = {path: path.read_bytes() for path in finals}

    def full_disk(self, path, **options):
        path.write_bytes(b"half")
        if options["format"] == "png":
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(Figure, "savefig", full_disk)
    with pytest.raises(OSError, match="No space left"):
        plotting.save_figure(figure, table, tmp_path / "fig")
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_wrong_arguments_are_named_before_anything_is_written(tmp_path):
    figure, table = method_case()
    with pytest.raises(TypeError, match="table must be a pandas DataFrame.*not dict"):
        plotting.save_figure(figure, {"x": [1]}, tmp_path / "new" / "fig")
    with pytest.raises(TypeError, match="figure must be a matplotlib Figure, not NoneType"):
        plotting.save_figure(None, table, tmp_path / "new" / "fig")
    assert list(tmp_path.iterdir()) == []


def test_wrong_tables_are_named():
    with pytest.raises(ValueError, match="geometry lacks the columns point, z; it has part, x, y"):
        drawings.rig_figure(rig.rig_geometry(0.0, 0.0)[["part", "x", "y"]])
    with pytest.raises(TypeError, match="diagram must be a pandas DataFrame, not list"):
        drawings.method_figure([1, 2])


def test_figures_do_without_pyplot():
    code = (
        "import sys; from tras import plotting; from tras.paper.figures import drawings;"
        "from tras.twin_rotor import drawing; drawings.rig_figure(drawing.rig_geometry(0.3, 0.6));"
        "plotting.new_figure(rows=2); sys.exit('matplotlib.pyplot' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT).returncode == 0
