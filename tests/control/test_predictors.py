"""What a controller needs of a model: the map of the simulation, its exact slopes, the states over a horizon."""

import numpy as np
import pytest

import tras
from tras.control.predictors import Equations, plant, predictor

MODELS = {
    "mechanical": (tras.Mechanical(4), {}),
    "cubic": (tras.Monomials(3), {}),
    "functions": (tras.Monomials(2), {"extrapolation": "functions"}),
    "one step": (tras.Monomials(2), {"predictor": "one_step"}),
    "states alone": (tras.Monomials(2), {"predictor": "one_step", "columns": "states"}),
    "delays": (tras.Monomials(2), {"predictor": "one_step", "delays": 2}),
    "lifted": (tras.Monomials(2), {"predictor": "lifted_linear"}),
    "lifted, delays": (tras.Monomials(2), {"predictor": "lifted_linear", "delays": 2}),
    "delayed field": (tras.Monomials(1), {"delays": 1}),
    "Gaussians": (tras.GaussianRBF(8, width="auto", centres="kmeans"), {"predictor": "one_step"}),
    "plates": (tras.ThinPlate(8), {"predictor": "one_step"}),
    "union": (tras.Union(tras.Monomials(1), tras.Fourier()), {"predictor": "one_step"}),
    "product": (tras.Product(tras.Monomials(1), tras.Monomials(1)), {"predictor": "one_step"}),
    "exponentials": (tras.Exponentials(1), {"predictor": "one_step"}),
}


@pytest.fixture(scope="module")
def recording():
    """Two coupled pendulums under two random torques, by midpoint steps."""
    rng, dt = np.random.default_rng(7), 0.1
    u = rng.uniform(-1, 1, (40, 40, 2))
    x = np.empty((40, 40, 4))
    x[:, 0] = rng.uniform(-1, 1, (40, 4))

    def field(x, u):
        q, v, r, w = x.T
        return np.stack([v, -2 * np.sin(q) + r - 0.3 * v + u[:, 0], w, -np.sin(r) + q * v - 0.2 * w + u[:, 1]], axis=1)

    for k in range(39):
        x[:, k + 1] = x[:, k] + dt * field(x[:, k] + dt / 2 * field(x[:, k], u[:, k]), u[:, k])
    return tras.Recording(x, u, dt, state_names=["q", "v", "r", "w"])


@pytest.fixture(scope="module")
def fitted(recording):
    """Models by name; those with delays know the angles alone."""
    made = {}

    def fit(name):
        dictionary, options = MODELS[name]
        if name not in made:
            source = recording.select(states=["q", "r"]) if options.get("delays") else recording
            made[name] = tras.KoopmanModel(dictionary, regularization=None, **options).fit(source)
        return made[name]

    return fit


@pytest.mark.parametrize("far", [0.5, 1.6])  # inside the data's box, and beyond it
@pytest.mark.parametrize("name", [name for name in MODELS if "lifted" not in name])
def test_slopes_are_those_of_the_simulated_sample(name, far, fitted):
    """... against differences of the roll-out that settle: `KoopmanModel.linearize` knows nothing of our slopes."""
    model = fitted(name)
    c = model.channels_
    rng = np.random.default_rng(3)
    z, u = far * rng.uniform(-1, 1, (len(c.z_scale), 3)), far * rng.uniform(-1, 1, (len(c.u_scale), 3))
    later, slopes = predictor(model).advance_with_slopes(z, u)
    for k in range(3):
        system = model.linearize(z[:, k] * c.z_scale + c.z_offset, u[:, k] * c.u_scale + c.u_offset)
        A = system.A * c.z_scale / c.z_scale[:, None]
        B = system.B * c.u_scale / c.z_scale[:, None]
        assert np.allclose(slopes[k], np.hstack([A, B]), rtol=0, atol=1e-8 * np.abs(A).max())
    assert np.allclose(later, model.roll_out_scaled(z, np.stack([u, u]))[1], rtol=0, atol=1e-13)
    assert np.allclose(later, predictor(model).advance(z, u), rtol=0, atol=1e-13)


@pytest.mark.parametrize("name", ["lifted", "lifted, delays"])
def test_a_lifted_linear_model_steps_as_its_first_sample(name, fitted):
    model = fitted(name)
    way, c = predictor(model), model.channels_
    rng = np.random.default_rng(0)
    z, u = rng.uniform(-1, 1, (len(c.z_scale), 4)), rng.uniform(-1, 1, (2, 4))
    later, slopes = way.advance_with_slopes(z, u)
    n = len(c.state_names)
    assert np.allclose(later[:n], model.roll_out_scaled(z, np.stack([u, u]))[1][:n], rtol=0, atol=1e-12)
    h = 1e-6
    for j in range(len(z) + 2):
        step = np.zeros((len(z) + 2, 1))
        step[j] = h
        up, down = (way.advance(z + s * step[:-2], u + s * step[-2:]) for s in (1, -1))
        assert np.allclose(slopes[:, :, j], (up - down).T / (2 * h), rtol=0, atol=1e-8)


@pytest.mark.parametrize("name", ["mechanical", "delays", "lifted", "lifted, delays", "plant"])
@pytest.mark.parametrize("blocks", [[0, 1, 2, 3, 4, 5], [0, 0, 1, 1, 1, 1]])
def test_a_horizon_along_its_own_plan_is_the_simulation(name, blocks, fitted, true_plant):
    way = true_plant if name == "plant" else predictor(fitted(name))
    n, rng, blocks = len(way.channels.z_scale), np.random.default_rng(1), np.array(blocks)
    z0, moves, d = 0.3 * rng.uniform(-1, 1, n), 0.3 * rng.uniform(-1, 1, (blocks[-1] + 1, 2)), np.array([0.1, -0.05])
    kick = np.zeros(n)
    if "lifted" not in name:
        kick[: len(way.channels.state_names)] = 0.01
    if name.startswith("lifted"):
        u = np.vstack([moves[blocks] + d, [0, 0]])[:, :, None]
        expected = fitted(name).roll_out_scaled(z0[:, None], u)[1:, :, 0]
    else:
        expected, z = [], z0[:, None]
        for move in moves[blocks] + d:
            z = way.advance(z, move[:, None]) + kick[:, None]
            expected.append(z[:, 0])
    plan = np.vstack([z0, expected[:-1]])[:, :n] if not name.startswith("lifted") else np.zeros((6, n))
    horizon = way.horizon(z0, plan, moves[blocks], d, kick, blocks)
    states = horizon.free + np.einsum("knij,ij->kn", horizon.response, moves)
    assert np.allclose(states, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def test_a_kick_of_the_states_goes_on_in_the_lifted_space(fitted):
    """Added to the states' own functions after each sample, by the recursion itself."""
    model = fitted("lifted")
    way, rows = predictor(model), model.dictionary_.coordinates
    z0, u, kick = np.full(4, 0.1), np.full((5, 2), 0.2), np.array([0.0, 0.02, 0.0, -0.01])
    horizon = way.horizon(z0, np.zeros((5, 4)), u, np.zeros(2), kick, np.arange(5))
    s = model.dictionary_.lift(z0[:, None])[:, 0]
    for k in range(5):
        s = model.koopman_matrix.T @ s + model.B_ @ u[k]
        s[rows] += kick
        states = horizon.free[k] + np.einsum("nij,ij->n", horizon.response[k], u)
        assert np.allclose(states, s[rows], rtol=0, atol=1e-12)


@pytest.mark.parametrize("rig", [tras.PlantParameters(), tras.RotorParameters.maker()])
def test_a_plant_has_the_slopes_of_its_equations(rig):
    """... over a short sample: those of the flow, ``expm`` of the analytic linearisation at rest."""
    from scipy.linalg import expm

    from tras.twin_rotor import plant as torque_plant
    from tras.twin_rotor import rotors

    equations = torque_plant if isinstance(rig, tras.PlantParameters) else rotors
    way, u = plant(rig, 0.01), np.array([0.05, 0.02])
    x = equations.rest_point(rig, u)
    c, n = way.channels, len(x)
    _, slopes = way.advance_with_slopes((x / c.x_scale)[:, None], ((u - c.u_offset) / c.u_scale)[:, None])
    A, B = equations.jacobian(x, u, rig)
    whole = expm(np.block([[A, B], [np.zeros((2, n + 2))]]) * 0.01)[:n]
    scale = np.concatenate([c.x_scale, c.u_scale])
    assert np.allclose(slopes[0], whole * scale / c.x_scale[:, None], rtol=0, atol=1e-8)


def test_the_past_before_the_first_sample_is_as_the_oldest(fitted):
    way = predictor(fitted("delays"))
    c = way.channels
    x, u = np.array([0.1, 0.2]), np.array([0.01, 0.02])
    expected = np.concatenate([x, x + 1, x + 1, u, u])
    assert np.allclose(way.start([x, x + 1], [u]) * c.z_scale + c.z_offset, expected)
    assert np.allclose(way.start([x], [])[-4:], 0, atol=1e-12)  # no input yet: the middle of the data


def autonomous():
    recording = tras.Recording([[[0.9**k] for k in range(20)]], dt=0.1)
    return tras.KoopmanModel(tras.Monomials(1), "one_step").fit(recording)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: predictor("model.npz"), "model is 'model.npz'; give a fitted tras.KoopmanModel"),
        (lambda: predictor(tras.KoopmanModel(tras.Monomials(1))), "not fitted"),
        (
            lambda: predictor(autonomous()),
            "model has no inputs",
        ),
        (lambda: Equations(lambda x, u: x, 0.1, [[1, -1]], ["q"], ["f"]), r"limits is .* for each of the 1 inputs"),
    ],
)
def test_what_is_no_model_is_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()
