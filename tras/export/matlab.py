"""The model for MATLAB and GNU Octave: a .mat file with its arrays, and functions (.m) that evaluate the model."""

from pathlib import Path

import numpy as np

import tras
from tras.export import symbols
from tras.export.common import file_and_name, map_of, origin, vectors
from tras.io.matlab import cell, save
from tras.model import KoopmanModel
from tras.workflow.files import replacing

_LOAD = """\
    persistent model
    if isempty(model)
        model = load(fullfile(fileparts(mfilename('fullpath')), '{file}'));
    end
"""
_SCALED = "[(x - model.z_offset) ./ model.z_scale; (u - model.u_offset) ./ model.u_scale]"
_RUNGE_KUTTA = """\
    h = model.dt / double(model.substeps);  % classical steps of order 4
    now = x;
    for step = 1:model.substeps
        k1 = {name}_field(now, u);
        k2 = {name}_field(now + h / 2 * k1, u);
        k3 = {name}_field(now + h / 2 * k2, u);
        k4 = {name}_field(now + h * k3, u);
        now = now + h / 6 * (k1 + 2 * (k2 + k3) + k4);
    end
    now = now(1:{n}, :);
"""
_ONE_STEP = f"""\
    now = map(model, {_SCALED});
    now = now .* model.x_scale + model.x_offset;
"""
_HULL = """\
    % Beyond the box around the training data, along their principal axes, the model is extended linearly.
    t = model.hull.axes' * (z - model.hull.centre);
    t = t - min(max(t, model.hull.low), model.hull.high);
    nearest = z - model.hull.axes * t;
    result = model.map * lift(nearest) + model.hull.outward * (z - nearest);
"""
_MAP = """
function result = map(model, z)
{body}end
"""
_LIFT = """
function psi = lift(z)
    psi = ones({N}, size(z, 2));
{lines}
end
"""
# Functions: results and arguments, what they compute, and how.
_FIELD = (
    "rates = {}(x, u)",
    "dx/dt in physical units; one point per column.",
    f"    rates = map(model, {_SCALED}) .* model.z_scale;\n",
)
_STEP = "the states one sample ({dt} s) later, in physical units, u held; one point per column."
_LINEAR = {
    "lift": (
        "z = {}(x)",
        "lifts states in physical units, one point per column; {name}_step continues from z.",
        "    z = lift((x - model.z_offset) ./ model.z_scale);\n",
    ),
    "step": (
        "z_next = {}(z, u)",
        "liftings one sample ({dt} s) later, u in physical units and held; z from {name}_lift.",
        "    z_next = model.A * z + model.B * ((u - model.u_offset) ./ model.u_scale);\n",
    ),
    "read": (
        "x = {}(z)",
        "the (newest) states of liftings, in physical units.",
        "    x = z(2:{after}, :) .* model.x_scale + model.x_offset;\n",
    ),
}


def to_matlab(model: KoopmanModel, path: str | Path) -> list[Path]:
    """Write a model for MATLAB and Octave: arrays to ``path`` (.mat), functions beside it; returns the paths.

    ``x_next = NAME_step(x, u)`` predicts one sample in physical units, one point per column, also beyond the training
    data; NAME is the file's. With delays, x holds the newest sample, then the earlier ones, then (except with
    ``vector_field``) the earlier inputs, as the comments list. ``vector_field`` adds ``NAME_field``. With
    ``lifted_linear``, call ``z = NAME_lift(x)``, then ``z = NAME_step(z, u)``, and ``x = NAME_read(z)``.

    The .mat file (version 5) holds plain arrays, structs and cells: K, A, W or B, scales, names, hull, dictionary.

    Raises
    ------
    ValueError
        If the model is not fitted, the path does not end in .mat, or the dictionary cannot be written as formulas.

    Examples
    --------
    >>> import numpy as np, tempfile
    >>> x, u = np.random.default_rng(0).uniform(-1, 1, (2, 5, 20, 1))
    >>> model = tras.KoopmanModel(tras.Monomials(2), "one_step").fit(tras.Recording(x, u, 0.1))
    >>> [path.name for path in to_matlab(model, f"{tempfile.mkdtemp()}/rig.mat")]
    ['rig.mat', 'rig_step.m']
    """
    model.require_fitted()
    path, name = file_and_name(path, ".mat")
    notes = origin(model, path, name)
    functions = _functions(model, path, name, notes)  # first: it may refuse the dictionary
    title = f"MATLAB 5.0 MAT-file, tras {tras.__version__}"
    with replacing(path) as temporary:
        save(_arrays(model, notes), title, temporary, long_field_names=True, oned_as="column")
    for file, lines in functions.items():
        with replacing(file) as temporary:
            temporary.write_text(lines, encoding="utf-8", newline="\n")
    return [path, *functions]


def _arrays(model, notes):
    """What the .mat file holds, vectors as columns."""
    values = {
        "origin": cell(notes), "predictor": model.predictor, "dt": float(model.dt_), "delays": float(model.delays),
        "lead": float(model.channels_.lead),
        "K": model.koopman_matrix, "x_offset": model.x_offset_, "x_scale": model.x_scale_,
        "z_scale": model.channels_.z_scale, "z_offset": model.channels_.z_offset, "u_offset": model.u_offset_[:, None],
        "u_scale": model.u_scale_[:, None], "functions": cell(model.names_), "dictionary": _struct(model.dictionary_),
    }  # fmt: skip
    for role in ("state", "input"):
        values |= {f"{role}_{kind}": cell(getattr(model, f"{role}_{kind}_")) for kind in ("names", "units")}
    values["x_names"] = cell(model.channels_.z_names)
    if model.predictor == "lifted_linear":
        return values | {"A": model.koopman_matrix.T, "B": model.B_}
    values["map"], hull = map_of(model)
    values |= {"hull": hull} if hull else {}
    if model.predictor == "vector_field":
        values |= {"A": model.generator, "W": model.W_, "substeps": float(model.substeps_)}
    return values


def _struct(dictionary):
    """A dictionary as a struct: its name, those parameters that are numbers or words, and what it learnt."""
    struct = {"name": type(dictionary).__name__}
    for key, value in dictionary.get_params(deep=False).items():
        if isinstance(value, (bool, int, float, str, np.number)):
            struct[key] = value if isinstance(value, str) else float(value)
    for key, value in vars(dictionary).items():
        if key == "parts_":
            struct["parts"] = cell([_struct(part) for part in value])
        elif key == "kept_":
            struct["kept"] = value + 1.0  # MATLAB counts from 1
        elif key.endswith("_") and isinstance(value, (np.ndarray, float, int)):
            struct[f"learnt_{key[:-1]}"] = np.asarray(value, dtype=float)
    return struct


def _functions(model, path, name, notes):
    """The .m files: path -> text."""
    n, m, d = len(model.state_names_), len(model.input_names_), model.delays
    lines = symbols.code(symbols.functions(model.dictionary_), symbols.MATLAB)
    subfunctions = _LIFT.format(N=len(model.names_), lines="\n".join(f"    {line}" for line in lines))
    functions = _LINEAR
    if model.predictor != "lifted_linear":
        body = "    result = model.map * lift(z);\n" if model.hull_ is None else _HULL
        subfunctions = _MAP.format(body=body) + subfunctions
        history = [f"x(1:{n * d}, :)"] * (d > 0) + ["u"] * model.channels_.delayed_inputs
        if model.channels_.delayed_inputs and d > 1:
            history.append(f"x({n * (d + 1) + 1}:{n * (d + 1) + (d - 1) * m}, :)")
        x_next = f"[{'; '.join(['now', *history])}]" if history else "now"
        is_field = model.predictor == "vector_field"
        body = (_RUNGE_KUTTA if is_field else _ONE_STEP) + f"    x_next = {x_next};\n"
        functions = ({"field": _FIELD} if is_field else {}) | {"step": ("x_next = {}(x, u)", _STEP, body)}
    x, u = vectors(model)
    entries = [f"x({i + 1}): {channel}" for i, channel in enumerate(x)]
    entries += [f"u({i + 1}): {channel}" for i, channel in enumerate(u)]
    entries += ["u: no inputs; zeros(0, columns of x)"] * (m == 0)
    words = {"name": name, "dt": repr(model.dt_), "n": n, "after": n + 1}
    load, files = _LOAD.format(file=path.name), {}
    for which, (signature, what, body) in functions.items():
        signature = signature.format(f"{name}_{which}")
        lines = [*notes, f"{signature}: {what.format(**words)}", *(entries if which != "read" else ())]
        comments = "\n".join(f"% {line}" for line in lines)
        text = f"function {signature}\n{comments}\n{load}{body.format(**words)}end\n"
        files[path.with_name(f"{name}_{which}.m")] = text
    first = next(iter(files))
    return {**files, first: files[first] + subfunctions}
