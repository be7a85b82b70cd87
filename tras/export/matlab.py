"""The model for MATLAB and GNU Octave: a .mat file with its arrays, and functions (.m) that evaluate the model."""

import io

import numpy as np
from scipy.io import savemat

import tras
from tras.export import symbols
from tras.export.common import file_and_name, input_vector, map_of, origin, state_vector
from tras.workflow.files import replacing

_LOAD = """\
    persistent model
    if isempty(model)
        model = load(fullfile(fileparts(mfilename('fullpath')), '{file}'));
    end
"""
_STEP = """\
function x_next = {name}_step(x, u)
{notes}
% x_next = {name}_step(x, u): the states one sample ({dt} s) later, in physical units, u held; one point per column.
{vectors}
{load}{body}end
"""
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
_ONE_STEP = """\
    now = map(model, [(x - model.z_offset) ./ model.z_scale; (u - model.u_offset) ./ model.u_scale]);
    now = now .* model.x_scale + model.x_offset;
"""
_FIELD = """\
function rates = {name}_field(x, u)
{notes}
% rates = {name}_field(x, u): dx/dt in physical units; one point per column.
{vectors}
{load}    rates = map(model, [(x - model.z_offset) ./ model.z_scale; (u - model.u_offset) ./ model.u_scale]) .* model.z_scale;
end
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
_LINEAR = {
    "lift": """\
function z = {name}_lift(x)
{notes}
% z = {name}_lift(x): lifts states in physical units, one point per column; {name}_step continues from z.
{vectors}
{load}    z = lift((x - model.z_offset) ./ model.z_scale);
end
""",
    "step": """\
function z_next = {name}_step(z, u)
{notes}
% z_next = {name}_step(z, u): liftings one sample ({dt} s) later, u in physical units and held; z from {name}_lift.
{vectors}
{load}    z_next = model.A * z + model.B * ((u - model.u_offset) ./ model.u_scale);
end
""",
    "read": """\
function x = {name}_read(z)
{notes}
% x = {name}_read(z): the (newest) states of liftings, in physical units.
{load}    x = z(2:{after}, :) .* model.x_scale + model.x_offset;
end
""",
}


def to_matlab(model, path):
    """Write a model for MATLAB and GNU Octave: arrays to ``path``, which ends in .mat, and functions beside it.

    ``x_next = NAME_step(x, u)`` predicts one sample in physical units, one point per column, also beyond the training
    data; NAME is the file's. With delays, x holds the newest sample, then the earlier ones, then (except with
    ``vector_field``) the earlier inputs, as the comments list. ``vector_field`` adds ``NAME_field``. With
    ``lifted_linear``, call ``z = NAME_lift(x)``, then ``z = NAME_step(z, u)``, and ``x = NAME_read(z)``.

    The .mat file (version 5) holds plain arrays, structs and cells: K, A, W or B, offsets and scales, names, units, dt,
    the hull, the dictionary.

    Returns
    -------
    list of pathlib.Path

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
    notes, contents = origin(model, path, name), io.BytesIO()
    functions = _functions(model, path, name, notes)  # first: it may refuse the dictionary
    savemat(contents, _arrays(model, notes), long_field_names=True, oned_as="column")
    whole = contents.getvalue()
    # SciPy writes the time into the first 116 bytes, which are free text.
    head = f"MATLAB 5.0 MAT-file, tras {tras.__version__}".encode().ljust(116)
    with replacing(path) as temporary:
        temporary.write_bytes(head + whole[116:])
    for file, lines in functions.items():
        with replacing(file) as temporary:
            temporary.write_text(lines, encoding="utf-8", newline="\n")
    return [path, *functions]


def _arrays(model, notes):
    """What the .mat file holds, vectors as columns."""
    linear = model.predictor == "lifted_linear"
    values = {
        "origin": _cells(notes), "predictor": model.predictor, "dt": float(model.dt_), "delays": float(model.delays),
        "K": model.koopman_matrix, "x_offset": model.x_offset_, "x_scale": model.x_scale_, "z_scale": model.channels_.z_scale,
        "z_offset": model.channels_.z_offset, "u_offset": model.u_offset_[:, None], "u_scale": model.u_scale_[:, None],
        "functions": _cells(model.names_), "dictionary": _described(model.dictionary_),
    }  # fmt: skip
    for role in ("state", "input"):
        values |= {f"{role}_{kind}": _cells(getattr(model, f"{role}_{kind}_")) for kind in ("names", "units")}
    values["x_names"] = _cells(model.channels_.z_names)
    if linear:
        return values | {"A": model.koopman_matrix.T, "B": model.B_}
    matrix, _, hull, outward = map_of(model)
    values["map"] = matrix
    if hull is not None:
        values["hull"] = {
            "centre": hull.centre,
            "axes": hull.axes,
            "low": hull.lower,
            "high": hull.upper,
            "outward": outward,
        }
    if model.predictor == "vector_field":
        values |= {"A": model.generator, "W": model.W_, "substeps": float(model.substeps_)}
    return values


def _cells(words):
    cells = np.empty((len(words), 1), dtype=object)
    cells[:, 0] = [str(word) for word in words]
    return cells


def _described(dictionary):
    """A dictionary as a struct: its name, those parameters that are numbers or words, and what it learnt."""
    struct = {"name": type(dictionary).__name__}
    for key, value in dictionary.get_params(deep=False).items():
        if isinstance(value, (bool, int, float, str, np.number)):
            struct[key] = float(value) if not isinstance(value, str) else value
    for key, value in vars(dictionary).items():
        if key == "parts_":
            parts = np.empty((len(value), 1), dtype=object)
            parts[:, 0] = [_described(part) for part in value]
            struct["parts"] = parts
        elif key == "kept_":
            struct["kept"] = value + 1.0  # MATLAB counts from 1
        elif key.endswith("_") and isinstance(value, (np.ndarray, float, int)):
            struct[f"learnt_{key[:-1]}"] = np.asarray(value, dtype=float)
    return struct


def _functions(model, path, name, notes):
    """The .m files: path -> text."""
    n, d, comments = len(model.state_names_), model.delays, _comments(notes)
    words = {"name": name, "notes": comments, "dt": repr(model.dt_), "n": n, "after": n + 1, "vectors": _vectors(model)}
    words["load"] = _LOAD.format(file=path.name.replace("'", "''"))
    lines = symbols.code(symbols.functions(model.dictionary_), symbols.MATLAB)
    lift = _LIFT.format(N=len(model.names_), lines="\n".join(f"    {line}" for line in lines))
    at = lambda which: path.with_name(f"{name}_{which}.m")  # noqa: E731
    if model.predictor == "lifted_linear":
        files = {at(which): template.format(**words) for which, template in _LINEAR.items()}
        return {**files, at("lift"): files[at("lift")] + lift}
    map_ = _MAP.format(body=_HULL if model.hull_ is not None else "    result = model.map * lift(z);\n")
    field = model.predictor == "vector_field"
    body = _RUNGE_KUTTA.format(**words) if field else _ONE_STEP
    history = [f"x(1:{n * d}, :)"] * (d > 0) + ["u"] * model.channels_.delayed_inputs
    if model.channels_.delayed_inputs and d > 1:
        past = n * (d + 1)
        history.append(f"x({past + 1}:{past + (d - 1) * len(model.input_names_)}, :)")
    body += f"    x_next = [{'; '.join(['now', *history])}];\n" if history else "    x_next = now;\n"
    step = _STEP.format(body=body, **words)
    if field:
        return {at("field"): _FIELD.format(**words) + map_ + lift, at("step"): step}
    return {at("step"): step + map_ + lift}


def _vectors(model):
    """Comments on what the vectors hold."""
    lines = [f"x({i + 1}): {channel}" for i, channel in enumerate(state_vector(model))]
    inputs = [f"u({i + 1}): {channel}" for i, channel in enumerate(input_vector(model))]
    return _comments(lines + (inputs or ["u: no inputs; zeros(0, columns of x)"]))


def _comments(lines):
    return "\n".join(f"% {' '.join(line.split())}" for line in lines)
