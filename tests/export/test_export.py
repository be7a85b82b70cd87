"""Models in other programs: C, GNU Octave, python-control, paper. What they compute is what the model computes."""

import ctypes
import re
import shutil
import subprocess
import sys

import latex2mathml.converter
import numpy as np
import pytest
from conftest import ROOT, linear_system, ode_recording
from scipy.io import loadmat, savemat
from sklearn.base import clone

import tras
from tras import predictors
from tras.analysis.linearization import StateSpace
from tras.export import common, symbols

CC = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
OCTAVE = shutil.which("octave-cli") or shutil.which("octave")
needs_cc = pytest.mark.skipif(
    CC is None, reason="no C compiler (cc, gcc, clang) is installed, so the generated C cannot be compiled here"
)
needs_octave = pytest.mark.skipif(
    OCTAVE is None, reason="GNU Octave is not installed (apt-get install octave), so the .m files cannot be run here"
)

PREDICTORS = ["vector_field", "one_step", "lifted_linear"]
SHIPPED = {
    "Monomials": tras.Monomials(2),
    "Exponentials": tras.Exponentials(),
    "Fourier": tras.Fourier(),
    "GaussianRBF": tras.GaussianRBF(12, width="auto", centres="kmeans"),
    "ThinPlate": tras.ThinPlate(9, centres="data"),
    "Mechanical": tras.Mechanical(4),
    "Mechanical with actuators": tras.Mechanical(2, actuators=[2, 3]),
    "Union": tras.Union(tras.Monomials(2), tras.GaussianRBF(4)),
    "Product": tras.Product(tras.Fourier(), tras.Monomials(1)),
}
CASES = [(name, predictor, 0, "linear") for name in SHIPPED for predictor in PREDICTORS]
CASES += [(name, predictor, 2, "linear") for name in ("Monomials", "GaussianRBF") for predictor in PREDICTORS]
CASES += [("Monomials", "vector_field", 0, "functions"), ("ThinPlate", "one_step", 1, "functions")]
SOME = [case for case in CASES if case[0] == "Monomials" and not case[2] or case[0] == "GaussianRBF" and case[2]]
SOME += [
    ("Mechanical", "vector_field", 0, "linear"),
    ("ThinPlate", "one_step", 1, "functions"),
    ("Product", "lifted_linear", 0, "linear"),
]


@pytest.fixture(scope="module")
def fitted(experiment):
    """Models by case, each made once, of the twin rotor; with delays of its angles alone."""
    models = {}

    def get(name, predictor, delays, extrapolation):
        key = (name, predictor, delays, extrapolation)
        if key not in models:
            states = ["phi", "psi"] if delays else ["phi", "phidot", "psi", "psidot"]
            recording = experiment[:8].select(states=states, inputs=["u_phi", "u_psi"])
            model = tras.KoopmanModel(
                SHIPPED[name], predictor, delays=delays, extrapolation=extrapolation, strength=1e-3
            )
            models[key] = model.fit(recording)
        return models[key]

    return get


def runs(model, experiment, samples, count=60):
    """First samples (count, d + 1, n), inputs (count, samples, m): half of the data, half random, twice as far out."""
    rng, half = np.random.default_rng(3), count // 2
    n, m, d = len(model.x_scale_), len(model.u_scale_), model.delays
    data = experiment[:8].select(states=model.state_names_, inputs=model.input_names_).cut(samples)
    numbers = rng.choice(len(data), half)
    far = rng.uniform(0.2, 2, (count - half, 1, 1))
    x0 = model.x_offset_ + model.x_scale_ * far * rng.uniform(-1, 1, (count - half, 1, n))
    x0 = x0 + 0.01 * model.x_scale_ * rng.uniform(-1, 1, (count - half, d + 1, n))
    inputs = model.u_offset_ + model.u_scale_ * far * rng.uniform(-1, 1, (count - half, samples, m))
    return np.concatenate([data.states[numbers][:, : d + 1], x0]), np.concatenate([data.inputs[numbers], inputs])


def stacked(model, x0, inputs):
    """The vectors x of the exported functions, (count, n'): newest sample first, then perhaps earlier inputs."""
    d = model.delays
    parts = [x0[:, ::-1].reshape(len(x0), -1)]
    if d and model.predictor != "vector_field":
        parts.append(inputs[:, :d][:, ::-1].reshape(len(x0), -1))
    return np.concatenate(parts, axis=1)


def error(model, computed, true):
    """The largest error, relative to the value or, where that is larger, to the channel's half-range."""
    return np.max(np.abs(computed - true) / np.maximum(np.abs(true), model.x_scale_))


# --- C --------------------


def compiled(model, path, **options):
    """The generated functions, as Python functions of arrays."""
    files = tras.export.to_c(model, path, **options)
    library = path.with_suffix(".so")
    flags = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-O1", "-shared", "-fPIC"]
    compiler = subprocess.run([CC, *flags, str(files[1]), "-o", str(library), "-lm"], capture_output=True, text=True)
    assert compiler.returncode == 0 and not compiler.stderr, compiler.stderr
    functions = ctypes.CDLL(str(library))

    def call(name, sizes, *arguments):
        outs = [np.full(size + 1, 77.0) for size in np.atleast_1d(sizes)]  # one more, which must not be written to
        arrays = [np.ascontiguousarray(a, dtype=float) for a in arguments]
        getattr(functions, name)(*(a.ctypes.data_as(ctypes.c_void_p) for a in (*arrays, *outs)))
        assert all(out[-1] == 77 for out in outs)
        return outs[0][:-1] if np.ndim(sizes) == 0 else [out[:-1] for out in outs]

    return call


@needs_cc
@pytest.mark.parametrize("case", CASES, ids=str)
def test_c_predicts_what_python_predicts(case, fitted, experiment, tmp_path):
    model = fitted(*case)
    call = compiled(model, tmp_path / "rig.c")
    d, n = model.delays, len(model.x_scale_)
    x0, inputs = runs(model, experiment, d + 6)
    true = model.simulate(x0 if d else x0[:, 0], inputs)
    assert np.isfinite(true).all()
    if model.hull_ is not None:  # there are runs on both sides of its edge
        x = (stacked(model, x0, inputs) - model.channels_.z_offset) / model.channels_.z_scale
        points = np.hstack([x, (inputs[:, d] - model.u_offset_) / model.u_scale_]).T
        outside = np.abs(model.hull_.nearest(points) - points).max(axis=0) > 1e-9
        assert 5 <= outside.sum() <= 50
    for run, x in enumerate(stacked(model, x0, inputs)):
        if model.predictor == "lifted_linear":
            z = call("rig_lift", len(model.names_), x)
            assert np.allclose(z, model.lift(x), rtol=1e-12, atol=1e-12)
        for k in range(d, d + 5):
            if model.predictor == "lifted_linear":
                z = call("rig_step", len(z), z, inputs[run, k])
                x = call("rig_read", n, z)
            else:
                x = call("rig_step", len(x), x, inputs[run, k])
                expected = stacked(
                    model, true[run : run + 1, k - d + 1 : k + 2], inputs[run : run + 1, k - d + 1 : k + 2]
                )[0]
                assert np.allclose(x, expected, rtol=1e-12, atol=1e-12)  # the shifted ones too
            assert error(model, x[:n], true[run, k + 1]) <= 1e-12
    if model.predictor == "vector_field":
        x = stacked(model, x0, inputs)
        rates = np.array([call("rig_field", len(x[0]), *point) for point in zip(x, inputs[:, 0])])
        expected = model.vector_field(x, inputs[:, 0])
        assert np.allclose(rates, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())


@needs_cc
@pytest.mark.parametrize("predictor", PREDICTORS)
def test_c_of_a_system_without_inputs(predictor, tmp_path):
    recording = ode_recording(lambda x, u: [x[1], -x[0] - 0.1 * x[0] ** 3], 0.2, n=2)
    model = tras.KoopmanModel(tras.Monomials(2), predictor, delays=0, strength=0.0).fit(recording)
    call = compiled(model, tmp_path / "free.c")
    true = model.simulate([0.3, -0.4], np.empty((2, 0)))[1]
    if predictor == "lifted_linear":
        x = call("free_read", 2, call("free_step", 6, call("free_lift", 6, [0.3, -0.4]), []))
    else:
        x = call("free_step", 2, [0.3, -0.4], [])
    assert error(model, x, true) <= 1e-12


@needs_cc
def test_c_may_write_the_next_state_over_the_present_one(fitted, experiment, tmp_path):
    model = fitted("GaussianRBF", "one_step", 2, "linear")
    tras.export.to_c(model, tmp_path / "rig.c")
    call = compiled(model, tmp_path / "rig.c")
    x0, inputs = runs(model, experiment, 3)
    x = stacked(model, x0, inputs)[0]
    expected, same = call("rig_step", len(x), x, inputs[0, 2]), x.copy()
    library = ctypes.CDLL(str(tmp_path / "rig.so"))
    pointer = lambda a: a.ctypes.data_as(ctypes.c_void_p)  # noqa: E731
    library.rig_step(pointer(same), pointer(np.ascontiguousarray(inputs[0, 2])), pointer(same))
    assert np.array_equal(same, expected)


def differences(function, point, step=1e-4):
    """The Jacobian of a function of scaled channels, by central differences of order 4."""
    columns = []
    for direction in np.eye(len(point)) * step:
        near, far = (function(point + k * direction) - function(point - k * direction) for k in (1, 2))
        columns.append((8 * near - far) / (12 * step))
    return np.transpose(columns)


@needs_cc
@pytest.mark.parametrize("case", CASES, ids=str)
def test_c_has_the_exact_slopes_of_its_step(case, fitted, experiment, tmp_path):
    """What differences of the step tend to, on both sides of the hull's edge, through all substeps and shifts.

    With delays the hull is thinner than a step of the differences; then they are those of Python.
    """
    model = fitted(*case)
    call = compiled(model, tmp_path / "rig.c", slopes=True)
    x0, inputs = runs(model, experiment, model.delays + 2)
    m, linear = len(model.u_scale_), model.predictor == "lifted_linear"
    for x, u in zip(stacked(model, x0, inputs)[::5], inputs[::5, model.delays]):
        x = call("rig_lift", len(model.names_), x) if linear else x
        count = len(x)
        scale = np.ones(count) if linear else model.channels_.z_scale
        scales = np.concatenate([scale, model.u_scale_])
        following, by_x, by_u = call("rig_slopes", (count, count**2, count * m), x, u)
        step = lambda point: call("rig_step", count, point[:count] * scale, point[count:] * scales[count:]) / scale  # noqa: E731, B023
        assert np.allclose(following / scale, step(np.concatenate([x, u]) / scales), rtol=1e-12, atol=1e-12)
        computed = np.hstack([by_x.reshape(count, count), by_u.reshape(count, m)]) * scales / scale[:, None]
        if model.delays and not linear:
            c = model.channels_
            z, v = (x - c.z_offset) / c.z_scale, (u - c.u_offset) / c.u_scale
            expected = predictors.PREDICTORS[model.predictor].advance_with_slopes(model)(z[:, None], v[:, None])[1][0]
        else:
            expected = differences(step, np.concatenate([x, u]) / scales)
        assert np.abs(computed - expected).max() <= 1e-8 * max(1.0, np.abs(expected).max())


@needs_cc
def test_c_has_the_slopes_of_the_dictionarys_own_jacobian(fitted, experiment, tmp_path):
    """And with one_step no substeps stand between them."""
    for name in SHIPPED:
        model = fitted(name, "one_step", 0, "linear")
        folder = tmp_path / name
        folder.mkdir()
        call = compiled(model, folder / "rig.c", slopes=True)
        point = model.x_offset_ + 0.1 * model.x_scale_, model.u_offset_ - 0.1 * model.u_scale_
        z, v = model.channels_.points(*point)
        assert model.hull_.nearest(np.concatenate([z, v])[:, None]).ravel().tolist() == [*z, *v]
        slopes = model.map().matrix @ model.dictionary_.jacobian(z, v)
        by_x = call("rig_slopes", (4, 16, 8), *point)[1].reshape(4, 4)
        expected = slopes[:4] * model.x_scale_[:, None] / model.x_scale_
        assert np.allclose(by_x, expected, rtol=1e-11, atol=1e-11 * np.abs(expected).max())


# --- Octave --------------------


def octave(folder, script):
    """Runs it in a folder and returns what it saved as out.mat."""
    command = [OCTAVE, "--norc", "--quiet", "--no-gui", "--eval", f"{script}; save('-v7', 'out.mat', 'out');"]
    process = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert (folder / "out.mat").is_file(), process.stderr
    return loadmat(folder / "out.mat")["out"]


@needs_octave
@pytest.mark.parametrize("case", SOME, ids=str)
def test_octave_predicts_what_python_predicts(case, fitted, experiment, tmp_path):
    model = fitted(*case)
    tras.export.to_matlab(model, tmp_path / "rig.mat")
    d, n, samples = model.delays, len(model.x_scale_), model.delays + 6
    x0, inputs = runs(model, experiment, samples)
    true = model.simulate(x0 if d else x0[:, 0], inputs)
    savemat(tmp_path / "in.mat", {"x": stacked(model, x0, inputs).T, "u": inputs.transpose(2, 0, 1)})
    if model.predictor == "lifted_linear":
        step, start = f"z = rig_step(z, u(:, :, k)); out(:, :, k - {d}) = rig_read(z);", "z = rig_lift(x);"
    else:
        step, start = f"x = rig_step(x, u(:, :, k)); out(:, :, k - {d}) = x(1:{n}, :);", ""
    out = octave(tmp_path, f"load in.mat; {start} for k = {d + 1}:{d + 5}, {step} end")
    assert error(model, out.transpose(1, 2, 0), true[:, d + 1 :]) <= 1e-12
    if model.predictor == "vector_field":
        rates = octave(tmp_path, "load in.mat; out = rig_field(x, u(:, :, 1))").T
        expected = model.vector_field(stacked(model, x0, inputs), inputs[:, 0])
        assert np.allclose(rates, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())


@needs_octave
def test_octave_without_inputs(tmp_path):
    recording = ode_recording(lambda x, u: [x[1], -x[0] - 0.1 * x[0] ** 3], 0.2, n=2)
    scripts = {
        "one_step": "a_step([0.3; -0.4], zeros(0, 1))",
        "lifted_linear": "b_read(b_step(b_lift([0.3; -0.4]), zeros(0, 1)))",
    }
    for predictor, script in scripts.items():
        model = tras.KoopmanModel(tras.Monomials(2), predictor, strength=0.0).fit(recording)
        tras.export.to_matlab(model, tmp_path / f"{script[0]}.mat")
        true = model.simulate([0.3, -0.4], np.empty((2, 0)))[1]
        assert error(model, octave(tmp_path, f"out = {script}")[:, 0], true) <= 1e-12


def test_mat_file_holds_plain_arrays(fitted, tmp_path):
    model = fitted("Union", "vector_field", 0, "linear")
    tras.export.to_matlab(model, tmp_path / "rig.mat")
    file = loadmat(tmp_path / "rig.mat", simplify_cells=True)
    expected = {
        "K": model.koopman_matrix,
        "A": model.generator,
        "W": model.W_,
        "x_scale": model.x_scale_,
        "u_offset": model.u_offset_,
    }
    for key, value in expected.items():
        assert np.array_equal(file[key], value)
    assert file["dt"] == 0.01 and list(file["functions"]) == model.names_
    assert list(file["state_units"]) == ["rad", "rad/s"] * 2
    assert np.array_equal(file["hull"]["axes"], model.hull_.axes)
    parts = file["dictionary"]["parts"]
    assert [part["name"] for part in parts] == ["Monomials", "GaussianRBF"] and parts[0]["degree"] == 2
    assert np.array_equal(parts[1]["learnt_centres"], model.dictionary_.parts_[1].centres_)
    linear = fitted("Monomials", "lifted_linear", 0, "linear")
    tras.export.to_matlab(linear, tmp_path / "linear.mat")
    assert np.array_equal(loadmat(tmp_path / "linear.mat")["B"], linear.B_)


# --- python-control --------------------


@pytest.mark.parametrize(
    "case", [("Monomials", "lifted_linear", 0, "linear"), ("GaussianRBF", "lifted_linear", 2, "linear")], ids=str
)
def test_state_space_simulates_what_the_model_simulates(case, fitted, experiment, monkeypatch):
    control = pytest.importorskip("control", reason="python-control is not installed")
    model, d = fitted(*case), case[2]
    x0, inputs = runs(model, experiment, 60, count=2)
    true = model.simulate(x0[0] if d else x0[0, 0], inputs[0])[d:]
    z0 = model.lift(stacked(model, x0, inputs)[0])
    system = tras.export.to_statespace(model)
    assert isinstance(system, control.StateSpace) and system.dt == 0.01
    assert system.output_labels == list(model.state_names_) and system.input_labels == ["u_phi", "u_psi"]
    response = control.forced_response(system, np.arange(60 - d) * 0.01, inputs[0, d:].T, z0)
    computed = np.asarray(response.outputs).T
    # With delays a sample is twice the last one less the one before: rounding grows with the square of the time.
    assert error(model, computed[:10], true[:10]) <= 1e-12 and error(model, computed, true) <= 1e-10
    assert np.array_equal(system.A[0], np.eye(len(z0))[0]) and not system.B[0].any()  # the constant stays one
    # Without python-control the same matrices.
    monkeypatch.setitem(sys.modules, "control", None)
    plain = tras.export.to_statespace(model)
    assert isinstance(plain, StateSpace) and plain.dt == 0.01
    assert all(np.array_equal(getattr(plain, name), getattr(system, name)) for name in "ABCD")


def test_a_state_space_without_inputs_is_a_named_tuple():
    """python-control has no such systems."""
    free = tras.Recording(np.random.default_rng(0).uniform(-1, 1, (5, 20, 1)), None, 0.1)
    model = tras.KoopmanModel(tras.Monomials(2), "lifted_linear").fit(free)
    system, z = tras.export.to_statespace(model), model.lift([0.3])
    assert isinstance(system, StateSpace) and system.B.shape == (3, 0)
    assert np.allclose(system.C @ system.A @ z, model.simulate([0.3], np.empty((2, 0)))[1], rtol=0, atol=1e-12)


# --- formulas --------------------


def run(text, channels, points):
    """What the formulas' last lines give at points (points, channels), as Python reads them."""
    namespace = {name: getattr(np, name) for name in symbols.FUNCTIONS} | dict(zip(channels, np.transpose(points)))
    exec(text, namespace)
    return np.transpose(
        [value + np.zeros(len(points)) for name, value in namespace.items() if name.endswith(("_dt", "_next"))]
    )


@pytest.mark.parametrize("tolerance", [0, 0.02])
@pytest.mark.parametrize("case", [case for case in CASES if case[1] != "lifted_linear"], ids=str)
def test_formulas_say_what_the_model_computes(case, tolerance, fitted, experiment):
    model = fitted(*case)
    recording = experiment[:8].select(states=model.state_names_, inputs=model.input_names_)
    text = tras.export.formulas(model, recording, tolerance=tolerance)
    late = recording.delayed(model.delays, inputs=model.predictor == "one_step")
    x, u = (np.concatenate(part)[::7] for part in zip(*late))
    channels = common.identifiers([*late.state_names, *late.input_names])
    values = run(text, channels, np.hstack([x, u]))
    if model.predictor == "vector_field":
        expected = size = model.vector_field(x, u)
    else:
        z = np.hstack(
            [(x - model.channels_.z_offset) / model.channels_.z_scale, (u - model.u_offset_) / model.u_scale_]
        )
        n = len(model.x_scale_)
        expected = model.map()(z.T).T[:, :n] * model.x_scale_ + model.x_offset_
        size = expected - x[:, :n]
    rms = lambda v: np.sqrt(np.mean(v**2, axis=0))  # noqa: E731
    # The tolerance holds over 2000 samples of the recording; these are others.
    assert np.all(rms(values - expected) <= max(1.2 * tolerance, 1e-8) * rms(size))


def test_formulas_are_the_systems_own():
    """x' = v, v' = u - 2 x - 0.5 v - x^3 comes out as it went in."""
    recording = ode_recording(
        lambda x, u: [x[1], -2 * x[0] - 0.5 * x[1] - x[0] ** 3 + u[0]], 0.02, n=2, m=1, trajectories=60
    )
    named = tras.Recording(recording.states, recording.inputs, 0.02, state_names=["x", "v"], input_names=["u"])
    model = tras.KoopmanModel(tras.Monomials(5), strength=0.0).fit(named)
    text = tras.export.formulas(model, named, tolerance=0.01)
    assert text.splitlines()[-2:] == ["dx_dt = v", "dv_dt = -2*x + u - x**3 - 0.5*v"]
    assert r"\frac{d v}{d t} &= -2 \, x + u - {x}^{3} - 0.5 \, v" in tras.export.formulas(
        model, named, tolerance=0.01, latex=True
    )
    assert "dv_dt: 52 of 56 terms left out" in text


def test_latex_is_latex(fitted):
    model = fitted("GaussianRBF", "vector_field", 0, "linear")
    latex = tras.export.formulas(model, latex=True, tolerance=0.01)
    for part in (r"\frac{d \phi}{d t} &= ", r"\dot{\phi}", r"u_{\psi}", r"\exp\left(-"):
        assert part in latex
    assert latex.count("{") == latex.count("}") and latex.count(r"\left") == latex.count(r"\right")
    block = latex[latex.index(r"\begin") :]
    assert "\\dot" not in latex2mathml.converter.convert(block) and "<mfrac>" in latex2mathml.converter.convert(block)
    # The same numbers in the same order as the text.
    digits = [
        word
        for line in tras.export.formulas(model, tolerance=0.01).splitlines()
        if not line.startswith("#")
        for word in line.split(" = ", 1)[1].split()
    ]
    assert all(w.partition("*")[0] in block for w in digits if w.partition("*")[0].replace(".", "").isdigit())


def test_formulas_of_a_saved_model_are_the_same(fitted, tmp_path):
    model = fitted("Union", "one_step", 0, "linear")
    model.save(tmp_path / "a.npz")
    assert tras.export.formulas(tras.load_model(tmp_path / "a.npz")) == tras.export.formulas(model)


# --- names, bytes --------------------


def test_same_model_same_bytes(fitted, tmp_path):
    for name in ("a", "b"):
        model = fitted("Union", "vector_field", 0, "linear")
        (tmp_path / name).mkdir()
        tras.export.to_matlab(model, tmp_path / name / "rig.mat")
        tras.export.to_c(model, tmp_path / name / "rig.c")
    files = sorted(path.name for path in (tmp_path / "a").iterdir())
    assert files == ["rig.c", "rig.h", "rig.mat", "rig_field.m", "rig_step.m"]
    for name in files:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    for name in ("rig.c", "rig.h", "rig_step.m", "rig_field.m"):
        head = (tmp_path / "a" / name).read_text()[:1500]
        for word in ("tras 0.1.0", "Union(parts=[", "N = 32", "sampling time 0.01 s", "phidot (rad/s)", "u_psi (N m)"):
            assert word in head


def test_awkward_names_are_made_ones_that_compile(tmp_path):
    plain = linear_system([[0, 1], [-2, -0.5]], [[0], [1]], 0.1)[0]
    names = {"state_names": ["3 angle *\\ (°)", "while"], "input_names": ["exp"], "state_units": ["/* */ % '", "a\nb"]}
    model = tras.KoopmanModel(tras.Monomials(2), "one_step", strength=0.0).fit(
        tras.Recording(plain.states, plain.inputs, 0.1, **names)
    )
    true = model.simulate([0.1, 0.2], [[0.3], [0.3]])[1]
    text = tras.export.formulas(model, tolerance=0)
    assert "Names: x3_angle is '3 angle *<U+005C> (°)', while_ is 'while', exp_ is 'exp'." in text
    assert np.allclose(run(text, ["x3_angle", "while_", "exp_"], [[0.1, 0.2, 0.3]])[0], true, rtol=1e-12)
    latex = tras.export.formulas(model, tolerance=0, latex=True)
    assert r"{x_{3}}_{\mathrm{angle}}" in latex  # a second index needs braces
    if CC:
        call = compiled(model, tmp_path / "2 rigs.c")
        assert error(model, call("x2_rigs_step", 2, [0.1, 0.2], [0.3]), true) <= 1e-12
        assert "'2 rigs' is no name in the language" in (tmp_path / "2 rigs.h").read_text()
    tras.export.to_matlab(model, tmp_path / "2 rigs.mat")
    if OCTAVE:
        assert error(model, octave(tmp_path, "out = x2_rigs_step([0.1; 0.2], 0.3)")[:, 0], true) <= 1e-12


def test_a_dictionary_of_ones_own_travels_too(experiment, tmp_path):
    class Tanh(tras.dictionaries.base.Dictionary):
        def _build(self):
            return self.n_states_

        def _fill(self, psi, z):
            np.tanh(z[: self.n_states_] * 2, out=psi[1 + len(z) :])

        def _tail_names(self, channels):
            return [f"tanh(2 {name})" for name in channels[: self.n_states_]]

    class Clipped(Tanh):
        def _fill(self, psi, z):
            np.maximum(z[: self.n_states_], 0, out=psi[1 + len(z) :])

    recording = experiment[:4].select(inputs=["u_phi", "u_psi"])
    model = tras.KoopmanModel(Tanh(), strength=0.0).fit(recording)
    assert "*tanh(" in tras.export.formulas(model, tolerance=0)
    if CC:
        call = compiled(model, tmp_path / "own.c")
        x, u = recording.states[0, 7], recording.inputs[0, 7]
        assert error(model, call("own_step", 4, x, u), model.simulate(x, [u, u])[1]) <= 1e-12
    clipped = tras.KoopmanModel(Clipped(), "one_step", strength=0.0).fit(recording)
    for call in (
        lambda: tras.export.to_c(clipped, tmp_path / "no.c"),
        lambda: tras.export.to_matlab(clipped, tmp_path / "no.mat"),
        lambda: tras.export.formulas(clipped),
    ):
        with pytest.raises(ValueError, match="dictionary 'Clipped' cannot be written as formulas .*its _fill may use"):
            call()
    assert not list(tmp_path.glob("no*"))


def test_brackets_stand_where_they_must(experiment):
    """Random expressions, written and read again; and some through all of a dictionary's formulas."""
    rng = np.random.default_rng(0)

    def random(depth, leaves):
        if depth == 0 or rng.random() < 0.1:
            return leaves[rng.integers(len(leaves))]
        a, b = random(depth - 1, leaves), random(depth - 1, leaves)
        return [lambda: a + b, lambda: a - b, lambda: a * b, lambda: a / b, lambda: -a, lambda: b - (a - b)][
            rng.integers(6)
        ]()

    table, values = {}, [0.7, -1.3, 2.1]
    z = [symbols.Symbol("z", (i,), table) for i in range(3)]
    for seed in range(300):
        rng = np.random.default_rng(seed)
        expression = random(4, [*z, z[0].number(-0.4), z[0].number(3)])
        rng = np.random.default_rng(seed)
        try:
            true = random(4, [*values, -0.4, 3.0])
        except ZeroDivisionError:
            continue
        text = symbols.text(expression, symbols.C)
        assert eval(text, {"z": values}) == pytest.approx(true, rel=1e-12, abs=1e-12), text

    class Odd(tras.Monomials):
        def _build(self):
            super()._build()
            self._levels = []
            return 3

        def _fill(self, psi, z):
            a, b = z[:2]
            psi[-3] = 1 / (1 + a**2) - (b - (a - b)) / (2 + b * b) / 3
            psi[-2] = np.exp(-(a - 2 * b)) * (a - (b - 1)) / 7 - -(a + b) * (a - b)
            psi[-1] = a / (3 / (2 + (a * b) * (a * b)))

        def _tail_names(self, channels):
            return ["f", "g", "h"]

    recording = experiment[:4].select(inputs=["u_phi", "u_psi"])
    model = tras.KoopmanModel(Odd(), strength=0.0).fit(recording)
    x, u = recording.states[0], recording.inputs[0]
    values = run(
        tras.export.formulas(model, tolerance=0), [*model.state_names_, *model.input_names_], np.hstack([x, u])
    )
    assert np.allclose(values, model.vector_field(x, u), rtol=1e-9, atol=1e-9)


def test_the_pages_examples_run(experiment, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs" / "export.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    namespace = {"recording": experiment[:4].select(inputs=["u_phi", "u_psi"])}
    exec("\n".join(blocks), namespace)
    names = {path.name for path in tmp_path.iterdir()}
    files = {"rig.mat", "rig_step.m", "rig_field.m", "rig.c", "rig.h", "flight.c", "flight.h"}
    assert len(blocks) == 6 and names == files
    if CC:
        (tmp_path / "main.c").write_text(re.search(r"```c\n(.*?)```", page, re.DOTALL)[1])
        subprocess.run(
            [CC, "-std=c99", "-Wall", "-Wextra", "-Werror", "main.c", "rig.c", "-o", "main", "-lm"], check=True
        )
        printed = float(subprocess.run(["./main"], check=True, capture_output=True, text=True).stdout)
        assert printed == pytest.approx(
            namespace["model"].simulate([0.1, 0, 0, 0], np.zeros((101, 2)))[-1, 0], rel=1e-9
        )


@pytest.mark.parametrize("dictionary", SHIPPED.values(), ids=SHIPPED)
def test_symbols_are_the_functions(dictionary):
    """The code of the lifting, run by Python, against the dictionary itself."""
    rng = np.random.default_rng(1)
    z = rng.uniform(-1, 1, (6, 50))
    psi = clone(dictionary).fit(z[:4].T, z[4:].T)
    values = np.full((len(psi.names), 50), np.nan)
    code = symbols.code(symbols.functions(psi), symbols.C)
    exec("\n".join(line.removeprefix("const double ") for line in code), {"z": z, "psi": values, **vars(np)})
    assert np.allclose(values, psi.lift(z), rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize(
    "call, words",
    [
        (lambda m: tras.export.to_c(tras.KoopmanModel(tras.Monomials(2)), "a.c"), "not fitted"),
        (lambda m: tras.export.to_matlab(tras.KoopmanModel(tras.Monomials(2)), "a.mat"), "not fitted"),
        (lambda m: tras.export.to_statespace(tras.KoopmanModel(tras.Monomials(2))), "not fitted"),
        (lambda m: tras.export.formulas(tras.KoopmanModel(tras.Monomials(2))), "not fitted"),
        (
            lambda m: tras.export.to_statespace(m("vector_field")),
            "predictor is 'vector_field', no linear system; fit with predictor='lifted_linear'",
        ),
        (
            lambda m: tras.export.formulas(m("lifted_linear")),
            "predictor is 'lifted_linear', which steps in the lifted space.*use to_statespace",
        ),
        (lambda m: tras.export.formulas(m("one_step"), tolerance=-1), "tolerance is -1; give the error to allow"),
        (lambda m: tras.export.formulas(m("one_step"), tolerance="small"), "tolerance is 'small'"),
        (lambda m: tras.export.to_c(m("one_step"), "a.cpp"), "ends in '.cpp'; give one that ends in .c"),
        (lambda m: tras.export.to_matlab(m("one_step"), "a"), "ends in ''; give one that ends in .mat"),
    ],
)
def test_mistakes_are_named(call, words, fitted):
    with pytest.raises(ValueError, match=words):
        call(lambda predictor: fitted("Monomials", predictor, 0, "linear"))
