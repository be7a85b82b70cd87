"""The moving rig and the phase portraits: they show what the tables say, and the bytes are the same each time."""

import itertools

import numpy as np
import pandas as pd
import pytest
from PIL import Image

import tras
from tras.explorer import explore, portraits
from tras.explorer import figures as figures_explore
from tras.explorer.choice import Choice
from tras.paper.figures import animation
from tras.twin_rotor import drawing as rig
from tras.twin_rotor.closed_loop import PID

SMALL = Choice(duration=60.0, input="torque", horizon=3.0)


def overlay(**changed):
    time = np.arange(0, 2.01, 0.01)
    table = {"time": time, "phi_true": 0.5 * np.sin(time), "psi_true": time}
    table |= {"phi_koopman": 0.3 * np.sin(time), "psi_koopman": 0.8 * time}
    return pd.DataFrame(table | changed)


@pytest.fixture(scope="module")
def outcome():
    return explore.explore(SMALL)


# --- the film --------------------------------------------------------------------------------------------------------


def test_a_film_runs_in_real_time():
    film = animation.film(overlay(), rate=10)
    np.testing.assert_allclose(film["time"], np.arange(0, 2.01, 0.1), atol=1e-12)
    np.testing.assert_allclose(film["psi_koopman"], 0.8 * film["time"])


def test_what_a_film_cannot_be_made_of():
    with pytest.raises(ValueError, match="overlay lacks the columns psi_true"):
        animation.film(overlay().drop(columns="psi_true"))
    with pytest.raises(ValueError, match="rate is 0"):
        animation.film(overlay(), rate=0)
    with pytest.raises(ValueError, match="NaN or infinity in the truth"):
        animation.film(overlay(phi_true=np.nan))


def test_a_reference_can_be_the_ghost():
    table = overlay().rename(columns={"phi_koopman": "phi_reference", "psi_koopman": "psi_reference"})
    film = animation.film(table, rate=5, ghost="reference")
    assert list(film) == animation.columns("reference")
    scene = animation.Scene(film, solid="rig")
    scene.show(7)
    assert [text.get_text() for text in scene.figure.legends[0].get_texts()] == ["rig", "reference"]
    other = animation.Scene(animation.film(overlay(), rate=5))
    other.show(7)
    np.testing.assert_array_equal(drawn(scene, 3), drawn(other, 3))
    with pytest.raises(ValueError, match="overlay lacks the columns phi_koopman"):
        animation.film(table)


def drawn(scene, zorder):
    """Corners (n, 2) of the rig that lies on this level."""
    (collection,) = [each for each in scene.rig.collections if each.get_zorder() == zorder]
    return np.concatenate([path.vertices for path in collection.get_paths()])


def test_truth_and_ghost_stand_where_the_table_says():
    """The drawn outlines reach exactly as far as the posed rig does."""
    film = animation.film(overlay(), rate=5)
    scene = animation.Scene(film)
    for frame in (7, 3):
        scene.show(frame)
        for who, zorder in (("true", 2), ("koopman", 3)):
            geometry = rig.rig_geometry(film[f"phi_{who}"][frame], film[f"psi_{who}"][frame])
            moving = geometry[geometry["part"].isin(set(rig.SOLIDS) - set(rig.STATIC))]
            seen = rig.project(moving[["x", "y", "z"]])[:, :2]
            corners = drawn(scene, zorder)
            for extreme in (np.min, np.max):
                np.testing.assert_allclose(extreme(corners, axis=0), extreme(seen, axis=0), atol=1e-9)
        markers = [line.get_xdata()[0] for line in scene.angles[0].lines if line.get_marker() == "o"]
        assert markers == [film["time"][frame]]


def test_a_prediction_that_ran_away_leaves_the_truth_alone():
    film = animation.film(overlay(phi_koopman=np.where(np.arange(201) < 100, 0.1, np.nan)), rate=5)
    scene = animation.Scene(film)
    scene.show(9)
    assert [each.get_zorder() for each in scene.rig.collections] == [1, 2]
    scene.show(1)
    assert sorted(each.get_zorder() for each in scene.rig.collections) == [1, 2, 3]


@pytest.mark.slow
def test_the_gif_has_all_frames_at_its_rate_and_the_same_bytes_again(tmp_path):
    film = animation.film(overlay(), rate=5)
    first, second = (animation.gif(film, tmp_path / name, rate=5) for name in ("a.gif", "b.gif"))
    assert first.read_bytes() == second.read_bytes() and len(first.read_bytes()) < 20_000 * len(film)
    with Image.open(first) as picture:
        assert picture.n_frames == len(film) == 11 and picture.info["duration"] == 200 and picture.info["loop"] == 0
        frames = []
        for k in range(picture.n_frames):
            picture.seek(k)
            frames.append(np.asarray(picture.convert("RGB")).astype(int))
    assert (frames[0][0, -1] == 255).all()  # paper is white
    assert all(np.abs(a - b).max() > 100 for a, b in itertools.pairwise(frames))
    exact = animation.Scene(film).pixels(6).astype(int)
    assert np.abs(frames[6] - exact).mean() < 3  # of 255: 40 colours are enough


# --- phase portraits -------------------------------------------------------------------------------------------------


def test_the_true_field_of_torques_is_the_plants(parameters):
    x, u = np.array([0.3, 0.1, -0.5, 0.2]), np.array([0.05, -0.02])
    field = portraits.vector_field_of(("u_phi", "u_psi"))
    np.testing.assert_array_equal(field(x, u), tras.vector_field(x, u, parameters))


def test_the_true_field_of_references_is_the_loop_at_its_balance(parameters):
    """The first step of the simulated loop, which starts with its integrators in balance."""
    reference, dt = np.array([0.3, 0.5]), 1e-4
    start = np.array([0.3, 0.0, 0.5, 0.0])
    loop = tras.simulate_closed_loop(np.tile(reference, (3, 1)), dt, parameters, step=dt)
    np.testing.assert_allclose(loop.states[0, 0], start)
    away = start + [0.02, 0.03, -0.04, 0.05]
    pitch, yaw = PID.defaults(parameters)
    balance = [parameters.G_c * np.cos(0.3) + parameters.G_s * np.sin(0.3), parameters.K_psi * 0.5]
    torques = [pitch.P * -0.02 - pitch.D * 0.03 + balance[0], yaw.P * 0.04 - yaw.D * 0.05 + balance[1]]
    expected = tras.simulate_plant(away, np.tile(torques, (2, 1)), dt, parameters)
    field = portraits.vector_field_of(("phi_ref", "psi_ref"))
    np.testing.assert_allclose(field(away, reference), (expected[1] - away) / dt, rtol=2e-3, atol=2e-3)
    np.testing.assert_allclose(field(start, reference), loop.states[0, 1] - start, atol=1e-9)


def test_far_from_the_reference_the_torques_are_at_their_limits(parameters):
    """Both angles a radian below the reference: the controller would like more than the rotors have."""
    x = np.array([-0.7, 0.0, -0.5, 0.0])
    expected = tras.vector_field(x, np.array([parameters.u_phi_limits[1], parameters.u_psi_limits[1]]), parameters)
    np.testing.assert_allclose(portraits.vector_field_of(("phi_ref", "psi_ref"))(x, [0.3, 0.5]), expected, rtol=1e-12)


def test_a_portrait_holds_truth_models_and_the_distance_between_them(outcome, parameters):
    models = portraits.compared(outcome)
    assert list(models) == ["Gaussian RBF", "mechanical"]
    table = portraits.portrait(models, points=5)
    assert len(table) == 3 * 2 * 25 and (table["error"][table["model"] == "true"] == 0).all()
    row = table[(table["model"] == "Gaussian RBF") & (table["plane"] == "yaw")].iloc[7]
    x = [0.8, 0.0, row["angle"], row["rate"]]
    true = tras.vector_field(np.array(x), np.zeros(2), parameters)
    angle, rate = outcome.model.vector_field(x, [0.0, 0.0])[2:]
    columns = row[["d_angle", "d_rate", "error"]].astype(float)
    np.testing.assert_allclose(columns, [angle, rate, abs(rate - true[3])], rtol=1e-9)


def test_a_portrait_reaches_beyond_the_box_of_the_training_data(outcome):
    """The box holds the data, which the model was fitted to; rates are shown over +-2 rad/s, angles over more."""
    table, train = portraits.portrait(portraits.compared(outcome), points=5), explore.training(SMALL)
    for plane, k in (("pitch", 0), ("yaw", 2)):
        rows, data = table[table["plane"] == plane], np.concatenate(list(train.states))
        for name, j in (("angle", k), ("rate", k + 1)):
            low, high = (rows[f"{name}_{end}"].unique().item() for end in ("low", "high"))
            np.testing.assert_allclose([low, high], [data[:, j].min(), data[:, j].max()], rtol=1e-9)
            assert rows[name].min() < low and high < rows[name].max()
        assert (rows["rate"].min(), rows["rate"].max()) == (-portraits.REACH, portraits.REACH)


def test_a_model_without_a_field_is_replaced_and_refused():
    blind = explore.explore(SMALL.replaced(predictor="one_step"))
    assert not portraits.has_field(blind.model) and list(portraits.compared(blind)) == ["mechanical", "linear"]
    with pytest.raises(ValueError, match="blind: only a model of the four states without delays"):
        portraits.portrait({"blind": blind.model})
    with pytest.raises(ValueError, match="different inputs, or there are none"):
        portraits.portrait({})


def test_with_noise_that_no_dictionary_stands_there_is_still_a_portrait():
    loud = explore.explore(SMALL.replaced(noise=5.0, predictor="one_step"))
    names = list(portraits.compared(loud))
    assert names and set(names) <= {"mechanical", "linear"}
    assert len(portraits.portrait(portraits.compared(loud), points=3)) == (1 + len(names)) * 18


def test_the_figure_has_a_column_for_each_model_and_one_scale_of_errors(outcome):
    table = portraits.portrait(portraits.compared(outcome), points=7)
    figure = figures_explore.portrait_figure(table)
    titles = [axes.get_title(loc="left") for axes in figure.axes[:3]]
    assert titles == ["true", "Gaussian RBF", "mechanical"] and len(figure.axes) == 7
    meshes = [each for axes in figure.axes[:6] for each in axes.collections if type(each).__name__ == "QuadMesh"]
    for panel in figure.axes[:6]:
        (box,) = panel.patches[-1:]
        plane = table[table["plane"] == ("pitch" if panel in figure.axes[:3] else "yaw")].iloc[0]
        assert box.get_bbox().extents == pytest.approx(plane[["angle_low", "rate_low", "angle_high", "rate_high"]])
    assert len(meshes) == 4 and len({(mesh.norm.vmin, mesh.norm.vmax) for mesh in meshes}) == 1
