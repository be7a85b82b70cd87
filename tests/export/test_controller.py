"""Controllers in C: what they compute is what the controllers in Python compute, over whole runs on the plant."""

import ctypes
import functools
import shutil
import subprocess

import numpy as np
import pytest

import tras
from tras.control.predictors import plant
from tras.export.controller import controller_to_c

CC = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
needs_cc = pytest.mark.skipif(
    CC is None, reason="no C compiler (cc, gcc, clang) is installed, so the generated C cannot be compiled here"
)
SOLVED, SHIFTED, NOT_FINITE = range(3)
TIGHT = {"u_phi": (-0.05, 0.1), "u_psi": (-0.06, 0.05)}
DICTIONARIES = {
    "vector_field": tras.Mechanical(4),
    "one_step": tras.GaussianRBF(12, width="auto", centres="kmeans"),
    "lifted_linear": tras.Monomials(2),
}
# Predictor, delays, options of the controller.
PREVIEW = [
    ("vector_field", 0, {}),
    ("vector_field", 0, {"states": {"psi": (-0.3, 0.3), "phidot": (-0.6, np.inf)}, "horizon": 12}),
    ("vector_field", 0, {"rates": {"u_psi": 0.4}, "moves": [1, 1, 2, 4, 8], "horizon": 16, "iterations": 2}),
    ("one_step", 0, {"limits": TIGHT, "offset_free": False, "horizon": 15}),
    ("one_step", 2, {"rates": 1.0, "horizon": 8}),
    ("one_step", 2, {"offset_free": False, "horizon": 8, "moves": 3}),
    ("vector_field", 2, {"offset_free": False, "horizon": 8}),
    ("lifted_linear", 0, {"limits": TIGHT}),
    ("lifted_linear", 0, {"states": {"psi": (-0.3, 0.3)}, "rates": 2.0, "horizon": 12, "offset_free": False}),
    ("lifted_linear", 2, {"horizon": 10, "moves": 4}),
]
REGULATORS = [
    ("vector_field", 0, {}), ("one_step", 0, {"offset_free": False, "limits": TIGHT}), ("lifted_linear", 0, {}),
    ("one_step", 1, {}), ("vector_field", 2, {"offset_free": False}), ("vector_field", 0, {"weights": {"phi": 1.0}}),
]  # fmt: skip


@pytest.fixture(scope="module")
def fitted(experiment):
    """The twin rotor's models, each made once; with delays of its angles alone."""

    @functools.cache
    def get(predictor, delays):
        states = ["phi", "psi"] if delays else ["phi", "phidot", "psi", "psidot"]
        recording = experiment[:12].select(states=states, inputs=["u_phi", "u_psi"])
        dictionary = tras.Monomials(2) if delays else DICTIONARIES[predictor]
        return tras.KoopmanModel(dictionary, predictor, delays=delays, strength=1e-4).fit(recording)

    return get


def compiled(controller, folder, **options):
    """``step(x, reference)`` of the generated C: (status, u); and its ``init``."""
    files = controller_to_c(controller, folder / "rig.c", **options)
    flags = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-O2", "-shared", "-fPIC"]
    done = subprocess.run(
        [CC, *flags, str(files[1]), "-o", str(folder / "rig.so"), "-lm"], capture_output=True, text=True
    )
    assert done.returncode == 0 and not done.stderr, done.stderr[:3000]
    library = ctypes.CDLL(str(folder / "rig.so"))
    library.rig_init()

    def step(x, reference):
        x, reference = np.ascontiguousarray(x, dtype=float), np.ascontiguousarray(np.atleast_2d(reference), dtype=float)
        u = np.full(3, 77.0)
        pointers = [a.ctypes.data_as(ctypes.c_void_p) for a in (x, reference, u)]
        status = library.rig_step(pointers[0], pointers[1], len(reference), pointers[2])
        assert u[2] == 77
        return status, u[:2]

    return step, library.rig_init


def follow(controller, step, references, samples, parameters, *, measured=None, disturbance=0.0):
    """A run of the plant under the controller in Python: errors of C in half-ranges, inputs, statuses."""
    controller.reset()
    c, rng, x = controller.channels, np.random.default_rng(3), np.array([0.1, 0.0, 0.0, 0.0])
    columns = ["phi", "phidot", "psi", "psidot"]
    rows = [columns.index(name) for name in measured or c.state_names]
    errors, inputs, statuses = [], [], []
    for k in range(samples):
        y = x[rows] + 1e-4 * rng.normal(size=len(rows))
        u = controller(y, references(k))
        status, computed = step(y, references(k))
        errors.append(np.abs((computed - u) / c.u_scale).max())
        inputs.append(u), statuses.append(status)
        x = tras.simulate_plant(x, np.tile(u + disturbance, (2, 1)), 0.01, parameters)[-1]
    return np.array(errors), np.array(inputs), np.array(statuses)


@needs_cc
@pytest.mark.slow
@pytest.mark.parametrize("case", PREVIEW, ids=str)
def test_c_computes_the_inputs_of_the_mpc(case, fitted, parameters, tmp_path):
    """Within 1e-9 of a half-range over 300 samples: first with a preview of a fast reference, then a step without."""
    predictor, delays, options = case
    model = fitted(predictor, delays)
    controller = tras.MPC(model, **{"weights": {"phi": 1, "psi": 1}, "horizon": 20, "limits": TIGHT} | options)
    step, init = compiled(controller, tmp_path)
    fast, N = tras.multisine(10, 0.01, [3.0, 2.0], [0.5, 1.0], 3), controller.horizon
    errors, inputs, statuses = follow(
        controller, step, lambda k: fast[k : k + N + 1], 300, parameters, disturbance=0.01
    )
    assert errors.max() <= 1e-9 and not statuses.any() and controller.failures == 0
    assert (np.abs(inputs[:, :, None] - controller.limits).min(axis=2) < 1e-9).any()  # limits were active
    init()
    errors, _, _ = follow(controller, step, lambda k: [0.1, 0.5], 100, parameters)
    assert errors.max() <= 1e-9


@needs_cc
@pytest.mark.slow
@pytest.mark.parametrize("case", REGULATORS, ids=str)
def test_c_computes_the_inputs_of_the_lqr(case, fitted, parameters, tmp_path):
    predictor, delays, options = case
    controller = tras.LQR(fitted(predictor, delays), **{"weights": {"phi": 1, "psi": 1}} | options)
    step, init = compiled(controller, tmp_path)
    goal = [0.1, 0.3][: len(controller.followed)]
    for _ in range(2):
        errors, _, statuses = follow(controller, step, lambda k: goal, 300, parameters, disturbance=0.005)
        assert errors.max() <= 1e-9 and not statuses.any()
        init()


@needs_cc
def test_c_estimates_from_angles_alone(fitted, parameters, tmp_path):
    model = fitted("vector_field", 0)
    observer = tras.Observer(model, measured=["psi", "phi"], noise=1e-4)
    controller = tras.MPC(model, weights={"psi": 1, "phi": 2}, horizon=10, observer=observer)
    step, _ = compiled(controller, tmp_path)
    errors, _, _ = follow(
        controller, step, lambda k: [0.4, 0.1], 300, parameters, measured=observer.measured, disturbance=0.01
    )
    assert errors.max() <= 1e-9 and np.abs(controller.disturbance - 0.01).max() < 3e-3
    header = (tmp_path / "rig.h").read_text()
    assert " x[0]: psi (rad)" in header and " reference[1]: phi (rad)" in header and "RIG_MEASURED 2" in header


@needs_cc
@pytest.mark.parametrize("size", [1.0, 0.1])
def test_c_bears_a_reading_near_the_largest_number(size, tmp_path):
    """The inputs stay finite; where the estimate overflows (size 0.1), it begins anew and the loop goes on."""
    rng = np.random.default_rng(0)
    x, u = rng.uniform(-size, size, (2, 40, 2, 1))
    x[:, 1] = 1.5 * x[:, 0] + u[:, 0]
    recording = tras.Recording(x, u, 0.1, state_names=["q"], input_names=["f"])
    model = tras.KoopmanModel(tras.Monomials(1), "one_step", regularization=None).fit(recording)
    controller = tras.MPC(model, horizon=5, observer=tras.Observer(model, noise=0.01 * size))
    step, _ = compiled(controller, tmp_path)
    q, inputs = 0.0, []
    for k in range(60):
        reading, reference = [1.7e308 if k == 20 else q], [(0.1 if k < 30 else 0.2) * size]
        u, (_, computed) = controller(reading, reference), step(reading, reference)
        inputs.append([u[0], computed[0]])
        q = 1.5 * q + u[0]
    inputs = np.array(inputs)
    assert np.isfinite(inputs).all()
    if size < 1:
        errors = np.abs(np.diff(inputs))
        assert max(errors[:20].max(), errors[40:].max()) <= 1e-9 and abs(q - 0.02) < 1e-4


@needs_cc
def test_c_says_when_a_program_was_not_solved_and_goes_on_with_the_last_plan(fitted, parameters, tmp_path):
    controller = tras.MPC(fitted("vector_field", 0), weights={"phi": 1, "psi": 1}, horizon=15, limits=TIGHT)
    step, _ = compiled(controller, tmp_path, iterations=3)  # enough without active limits only
    rest = np.array([-0.4909, 0.0, 0.0, 0.0])
    status, u = step(rest, [-0.4909, 0.0])
    assert status == SOLVED
    statuses, inputs = zip(*(step(rest, [0.4, 1.5]) for _ in range(20)))
    assert set(statuses) == {SHIFTED} and all((v >= controller.limits[:, 0]).all() for v in inputs)
    assert all((v <= controller.limits[:, 1]).all() for v in inputs)
    assert np.array_equal(inputs[-1], inputs[-2])  # the end of the plan is held
    assert step(rest, [-0.4909, 0.0])[0] == SOLVED  # as soon as it can be


@needs_cc
def test_c_refuses_what_is_not_finite_and_forgets_it(fitted, parameters, tmp_path):
    controller = tras.MPC(fitted("one_step", 0), weights={"phi": 1, "psi": 1}, horizon=5)
    (tmp_path / "other").mkdir()
    step, other = compiled(controller, tmp_path)[0], compiled(controller, tmp_path / "other")[0]
    x, reference = np.array([0.1, 0.0, 0.0, 0.0]), np.array([[0.1, 0.2], [0.1, 0.3]])
    first = step([np.nan, 0, 0, 0], reference)
    assert first[0] == NOT_FINITE and np.isfinite(first[1]).all()
    for k in range(5):
        status, u = step(x, reference + k / 100)
        assert status == SOLVED
        for bad in ((x * [np.inf, 1, 1, 1], reference), (x, reference * [[1, 1], [1, np.nan]]), (x, np.empty((0, 2)))):
            status, same = step(*bad)
            assert status == NOT_FINITE and np.array_equal(same, u)
        assert np.array_equal(other(x, reference + k / 100)[1], u)  # as if nothing had been between


def test_what_cannot_be_written_is_refused(parameters, fitted, tmp_path):
    model = fitted("vector_field", 0)
    for other in (model, tras.LQR(plant(parameters, 0.01)), None):
        with pytest.raises(ValueError, match="give a tras.LQR or tras.MPC of a fitted"):
            controller_to_c(other, tmp_path / "rig.c")
    with pytest.raises(ValueError, match="give one that ends in .c"):
        controller_to_c(tras.LQR(model), tmp_path / "rig.py")
    with pytest.raises(ValueError, match="iterations is 0"):
        controller_to_c(tras.LQR(model), tmp_path / "rig.c", iterations=0)
    assert list(tmp_path.iterdir()) == []


def test_the_same_controller_gives_the_same_bytes(fitted, tmp_path):
    controller = tras.MPC(fitted("vector_field", 0), horizon=5)
    files = controller_to_c(controller, tmp_path / "rig.c")
    before = [file.read_bytes() for file in files]
    controller([0.1, 0, 0, 0], [0.1, 0, 0, 0])  # its run so far does not matter
    assert [file.read_bytes() for file in controller_to_c(controller, tmp_path / "rig.c")] == before
    assert controller.status == "solved" and controller.plan.shape == (5, 2)
