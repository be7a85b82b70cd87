"""The one-step predictor as C99: a header and a source that need only libm, allocate nothing and keep no state."""

from pathlib import Path

import numpy as np

from tras.export import derivatives, symbols
from tras.export.common import file_and_name, map_of, origin, vectors
from tras.model import KoopmanModel
from tras.workflow.arguments import in_code
from tras.workflow.files import replacing

_SHIFTS = """\
    /* Shift the earlier samples, newest first. */
    for (int i = {last}; i >= {n}; i--) x_next[i] = x[i - {n}];
"""
_SHIFTS_OF_INPUTS = """\
    for (int i = {end}; i >= {second}; i--) x_next[i] = x[i - {m}];
    for (int i = 0; i < {m}; i++) x_next[{past} + i] = u[i];
"""
HULL = """\
    /* The nearest point of the box around the training data, along their principal axes. */
    double near[CHANNELS], beyond[CHANNELS];
    for (int j = 0; j < CHANNELS; j++) {
        double t = 0.0;
        for (int i = 0; i < CHANNELS; i++) t += axes[i][j] * (z[i] - centre[i]);
        beyond[j] = t < low[j] ? t - low[j] : t > high[j] ? t - high[j] : 0.0;
    }
    for (int i = 0; i < CHANNELS; i++) {
        near[i] = z[i];
        for (int j = 0; j < CHANNELS; j++) near[i] -= axes[i][j] * beyond[j];
    }
"""
_MAP = """\
/* {what}, in scaled channels: matrix psi(z){beyond}. */
static void map(const double *z, double *result)
{{
    double psi[FUNCTIONS];
{hull}    lift({point}, psi);
    for (int i = 0; i < ROWS; i++) {{
        result[i] = 0.0;
        for (int j = 0; j < FUNCTIONS; j++) result[i] += matrix[i][j] * psi[j];
{outward}    }}
}}
"""
_OUTWARD = "        for (int j = 0; j < CHANNELS; j++) result[i] += outward[i][j] * (z[j] - near[j]);\n"
_RUNGE_KUTTA = """\
    /* Classical steps of order 4, the input held. */
    const double h = {dt} / {substeps};
    double z[CHANNELS], point[CHANNELS], k1[STATES], k2[STATES], k3[STATES], k4[STATES];
    scale(x, u, z);
    for (int i = STATES; i < CHANNELS; i++) point[i] = z[i];
    for (int step = 0; step < {substeps}; step++) {{
        for (int i = 0; i < STATES; i++) point[i] = z[i];
        map(point, k1);
        for (int i = 0; i < STATES; i++) point[i] = z[i] + h / 2 * k1[i];
        map(point, k2);
        for (int i = 0; i < STATES; i++) point[i] = z[i] + h / 2 * k2[i];
        map(point, k3);
        for (int i = 0; i < STATES; i++) point[i] = z[i] + h * k3[i];
        map(point, k4);
        for (int i = 0; i < STATES; i++) z[i] += h / 6 * (k1[i] + 2 * (k2[i] + k3[i]) + k4[i]);
    }}
"""
_FIELD = """
void {name}_field(const double *x, const double *u, double *rate)
{{
    double z[CHANNELS];
    scale(x, u, z);
    map(z, rate);
    for (int i = 0; i < STATES; i++) rate[i] *= x_scale[i];
}}
"""
_SCALE = """
static void scale(const double *x, const double *u, double *z)
{{
    for (int i = 0; i < STATES; i++) z[i] = (x[i] - x_offset[i]) / x_scale[i];
{inputs}}}
"""
_STEP = """
void {name}_step(const double *x, const double *u, double *x_next)
{{
{body}    for (int i = 0; i < {n}; i++) x_next[i] = z[i] * x_scale[i] + x_offset[i];
}}
"""
_SCALE_INPUTS = "    for (int i = 0; i < INPUTS; i++) z[STATES + i] = (u[i] - u_offset[i]) / u_scale[i];\n"
_LINEAR = """\
void {name}_lift(const double *x, double *z)
{{
    double scaled[STATES];
    for (int i = 0; i < STATES; i++) scaled[i] = (x[i] - x_offset[i]) / x_scale[i];
    lift(scaled, z);
}}

void {name}_step(const double *z, const double *u, double *z_next)
{{
{unused}    double next[FUNCTIONS];
    for (int i = 0; i < FUNCTIONS; i++) {{
        next[i] = 0.0;
        for (int j = 0; j < FUNCTIONS; j++) next[i] += A[i][j] * z[j];
{inputs}    }}
    for (int i = 0; i < FUNCTIONS; i++) z_next[i] = next[i];
}}

void {name}_read(const double *z, double *x)
{{
    for (int i = 0; i < {n}; i++) x[i] = z[1 + i] * x_scale[i] + x_offset[i];
}}
"""
_LINEAR_INPUTS = "        for (int j = 0; j < INPUTS; j++) next[i] += B[i][j] * ((u[j] - u_offset[j]) / u_scale[j]);\n"
_UNUSED = "    (void)u;\n"


def to_c(model: KoopmanModel, path: str | Path, *, slopes: bool = False) -> list[Path]:
    """Write a model as C99: ``path``, which ends in .c, and a header of the same name; returns both paths.

    ``void NAME_step(const double *x, const double *u, double *x_next)`` predicts one sample in physical units, also
    beyond the training data; NAME is the file's. With delays, x holds the newest sample, then the earlier ones, then
    (except with ``vector_field``) the earlier inputs, as the header lists. ``vector_field`` adds ``NAME_field``. With
    ``lifted_linear``, ``NAME_lift`` lifts x to z, ``NAME_step`` works on z, and ``NAME_read`` reads x from z.

    With ``slopes`` there is also ``void NAME_slopes(const double *x, const double *u, double *x_next, double *by_x,
    double *by_u)``: the step and its exact derivatives, row by row, as a Kalman filter or a controller needs them.

    Raises
    ------
    ValueError
        If the model is not fitted, the path does not end in .c, or the dictionary cannot be written as formulas.

    Examples
    --------
    >>> import numpy as np, tempfile, tras
    >>> x, u = np.random.default_rng(0).uniform(-1, 1, (2, 5, 20, 1))
    >>> model = tras.KoopmanModel(tras.Monomials(2), "one_step").fit(tras.Recording(x, u, 0.1))
    >>> [path.name for path in to_c(model, f"{tempfile.mkdtemp()}/rig.c")]
    ['rig.h', 'rig.c']
    """
    model.require_fitted()
    path, name = file_and_name(path, ".c")
    notes = [f" {line}" for line in origin(model, path, name)]
    source = f'#include "{path.stem}.h"\n\n#include <math.h>\n\n{_source(model, name, slopes)}'
    files = {path.with_suffix(".h"): _header(model, name, slopes), path: source}
    for file, contents in files.items():
        with replacing(file) as temporary:
            temporary.write_text("\n".join(["/*", *notes, " */", contents]), encoding="utf-8", newline="\n")
    return list(files)


def _header(model, name, slopes):
    linear, m = model.predictor == "lifted_linear", len(model.input_names_)
    (x, u), guard = vectors(model), f"{name.upper()}_H"
    lines = [f"#ifndef {guard}", f"#define {guard}", "", "/*", " Vectors, in physical units:"]
    lines += [f" x[{i}]: {channel}" for i, channel in enumerate(x)]
    lines += [f" u[{i}]: {channel}" for i, channel in enumerate(u)]
    lines += [" No input: u is not read and may be NULL."] * (m == 0) + [" */"]
    lines += [f"#define {name.upper()}_STATES {len(x)}", f"#define {name.upper()}_INPUTS {m}"]
    lines += [f"#define {name.upper()}_LIFTED {len(model.names_)}"] * linear
    lines += ["", "#ifdef __cplusplus", 'extern "C" {', "#endif", ""]
    if linear:
        lines += [
            "/* Lift a state once, step in the lifted space, where the system is linear, and read x from z. */",
            f"void {name}_lift(const double *x, double *z);",
        ]
    state = "z" if linear else "x"
    lines += [
        f"/* One sample ({model.dt_!r} s) later, the input held; {state}_next may be {state}. */",
        f"void {name}_step(const double *{state}, const double *u, double *{state}_next);",
    ]
    lines += [f"void {name}_read(const double *z, double *x);"] * linear
    if model.predictor == "vector_field":
        lines += ["/* dx/dt. */", f"void {name}_field(const double *x, const double *u, double *rate);"]
    if slopes:
        lines += [
            f"/* The step and its derivatives, row by row: by_{state} by each {state}, by_u by each input. */",
            f"void {name}_slopes(const double *{state}, const double *u, double *{state}_next, double *by_{state}, "
            "double *by_u);",
        ]
    return "\n".join([*lines, "", "#ifdef __cplusplus", "}", "#endif", "", "#endif", ""])


def _source(model, name, slopes):
    m, states, functions = len(model.input_names_), len(model.channels_.z_scale), len(model.names_)
    counts = {"STATES": states} | ({"INPUTS": m} if m else {})
    arrays = {"x_offset": model.channels_.z_offset, "x_scale": model.channels_.z_scale}
    if m:
        arrays |= {"u_offset": model.u_offset_, "u_scale": model.u_scale_}
    if model.predictor == "lifted_linear":
        counts["FUNCTIONS"] = functions
        arrays |= {"A": model.koopman_matrix.T} | ({"B": model.B_} if m else {})
        inputs, unused = (_LINEAR_INPUTS, "") if m else ("", _UNUSED)
        body = _LINEAR.format(name=name, n=len(model.state_names_), inputs=inputs, unused=unused)
    else:
        matrix, hull = map_of(model)
        counts |= {"CHANNELS": states + m, "FUNCTIONS": functions, "ROWS": len(matrix)}
        arrays |= {"matrix": matrix, **hull}
        body = _MAP.format(
            what="Rates of the states" if model.predictor == "vector_field" else "The states one sample later",
            beyond="; beyond the training data linear" if hull else "",
            hull=HULL if hull else "",
            point="near" if hull else "z",
            outward=_OUTWARD if hull else "",
        )
        body += _steps(model, name)
        if slopes:
            entries, code = derivatives.advance(model, HULL if hull else "")
            counts["SLOPES"], body = len(entries["slope_of"]), f"{body}\n{code}"
            arrays |= entries
    if slopes:
        body += derivatives.function(model, name)
    constants = "enum { " + ", ".join(f"{key} = {value}" for key, value in counts.items()) + " };\n\n"
    return constants + "".join(map(array, arrays, arrays.values())) + "\n" + lift(model) + body


def lift(model):
    """The function that lifts scaled channels."""
    lines = symbols.code(symbols.functions(model.dictionary_), symbols.C)
    names = [f" psi[{i}]: {in_code(function)}" for i, function in enumerate(model.names_)]
    head = ["/*", *names, " */", "static void lift(const double *z, double *psi)", "{"]
    return "\n".join([*head, *(f"    {line}" for line in lines), "}", "", ""])


def _steps(model, name):
    """The functions of scaling, of one step, and of the field."""
    n, m, d, field = len(model.state_names_), len(model.input_names_), model.delays, model.predictor == "vector_field"
    past = n * (d + 1)
    if field:
        body = _RUNGE_KUTTA.format(dt=symbols.literal(model.dt_), substeps=int(model.substeps_))
    else:
        body = "    double point[CHANNELS], z[ROWS];\n    scale(x, u, point);\n    map(point, z);\n"
    if model.channels_.delayed_inputs:
        body += _SHIFTS_OF_INPUTS.format(end=past + m * d - 1, second=past + m, m=m, past=past)
    if d:
        body += _SHIFTS.format(last=past - 1, n=n)
    scale = _SCALE.format(inputs=_SCALE_INPUTS if m else _UNUSED)
    return scale + _STEP.format(name=name, body=body, n=n) + (_FIELD.format(name=name) if field else "")


def array(name, values):
    """A constant array, one row per line; of whole numbers if all are."""
    size = "".join(f"[{k}]" for k in np.shape(values))
    if np.asarray(values).dtype.kind == "i":
        return f"static const int {name}{size} = {{{', '.join(map(str, values))}}};\n"
    rows = [", ".join(map(symbols.literal, row)).replace("inf", "INFINITY") for row in np.atleast_2d(values)]
    if np.ndim(values) == 1:
        return f"static const double {name}{size} = {{{rows[0]}}};\n"
    rows = ",\n".join(f"    {{{row}}}" for row in rows)
    return f"static const double {name}{size} = {{\n{rows}\n}};\n"
