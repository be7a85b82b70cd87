"""The derivatives of the one-step predictor as C99: exact, by the rules of calculus, through every substep."""

from tras.export import symbols

_LIFT = """\
/* psi, and the derivatives of its functions that are not zero everywhere: by channel slope_by[k] of slope_of[k]. */
static void lift_slopes(const double *z, double *psi, double *slope)
{{
{lines}
}}

"""
_MAP = """\
/* map(z), and its derivatives by the channels. */
static void map_slopes(const double *z, double *result, double slopes[][CHANNELS])
{{
    double psi[FUNCTIONS], slope[SLOPES];
{hull}    lift_slopes({point}, psi, slope);
    for (int i = 0; i < ROWS; i++) {{
        result[i] = 0.0;
        for (int j = 0; j < CHANNELS; j++) slopes[i][j] = 0.0;
    }}
    /* Row by row inside: a processor need not wait for one sum before it goes on with the next. */
    for (int j = 0; j < FUNCTIONS; j++)
        for (int i = 0; i < ROWS; i++) result[i] += matrix[i][j] * psi[j];
    for (int k = 0; k < SLOPES; k++)
        for (int i = 0; i < ROWS; i++) slopes[i][slope_by[k]] += matrix[i][slope_of[k]] * slope[k];
{inputs}{outward}}}

"""
_INPUTS = """\
    for (int i = 0; i < ROWS; i++)
        for (int j = 0; j < CHANNELS - STATES; j++) {
            result[i] += by_input[i][j] * z[STATES + j];
            slopes[i][STATES + j] = by_input[i][j];
        }
"""
_OUTWARD = """\
    for (int i = 0; i < ROWS; i++)
        for (int j = 0; j < CHANNELS; j++) result[i] += outward[i][j] * (z[j] - near[j]);
    /* The nearest point moves along the edges that z is beyond, not across them. */
    for (int k = 0; k < CHANNELS; k++) {
        if (beyond[k] == 0.0) continue;
        for (int i = 0; i < ROWS; i++) {
            double across = 0.0;
            for (int j = 0; j < CHANNELS; j++) across += (outward[i][j] - slopes[i][j]) * axes[j][k];
            for (int j = 0; j < CHANNELS; j++) slopes[i][j] += across * axes[j][k];
        }
    }
"""
_ADVANCE = """\
/* The scaled states z one sample after the scaled channels ``start``, and their derivatives by those. */
static void advance_slopes(const double *start, double *z, double slopes[][CHANNELS])
{{
{core}{shifts}}}
"""
_RUNGE_KUTTA = """\
    static const double part[4] = {{0.0, 0.5, 0.5, 1.0}}, weight[4] = {{1.0, 2.0, 2.0, 1.0}};
    const double h = {dt} / {substeps};
    double point[CHANNELS], rate[STATES], sum[STATES], of_map[STATES][CHANNELS];
    double at_point[STATES][CHANNELS], of_rate[STATES][CHANNELS], of_sum[STATES][CHANNELS];
    for (int i = 0; i < CHANNELS; i++) point[i] = start[i];
    for (int i = 0; i < STATES; i++) {{
        z[i] = start[i];
        for (int j = 0; j < CHANNELS; j++) slopes[i][j] = i == j;
    }}
    for (int step = 0; step < {substeps}; step++) {{
        for (int i = 0; i < STATES; i++) {{
            rate[i] = sum[i] = 0.0;
            for (int j = 0; j < CHANNELS; j++) of_rate[i][j] = of_sum[i][j] = 0.0;
        }}
        for (int stage = 0; stage < 4; stage++) {{
            for (int i = 0; i < STATES; i++) {{
                point[i] = z[i] + part[stage] * h * rate[i];
                for (int j = 0; j < CHANNELS; j++) at_point[i][j] = slopes[i][j] + part[stage] * h * of_rate[i][j];
            }}
            map_slopes(point, rate, of_map);
            for (int i = 0; i < STATES; i++) {{
                sum[i] += weight[stage] * rate[i];
                for (int j = 0; j < CHANNELS; j++) of_rate[i][j] = j < STATES ? 0.0 : of_map[i][j];
                for (int k = 0; k < STATES; k++)
                    for (int j = 0; j < CHANNELS; j++) of_rate[i][j] += of_map[i][k] * at_point[k][j];
                for (int j = 0; j < CHANNELS; j++) of_sum[i][j] += weight[stage] * of_rate[i][j];
            }}
        }}
        for (int i = 0; i < STATES; i++) {{
            z[i] += h / 6 * sum[i];
            for (int j = 0; j < CHANNELS; j++) slopes[i][j] += h / 6 * of_sum[i][j];
        }}
    }}
"""
_SHIFTS = """\
    /* Earlier samples are shifted: each state behind the newest is the channel of ``before``. */
    static const int before[] = {{{before}}};
    for (int i = {n}; i < STATES; i++) {{
        z[i] = start[before[i - {n}]];
        for (int j = 0; j < CHANNELS; j++) slopes[i][j] = j == before[i - {n}];
    }}
"""
_STEP = """
void {name}_slopes(const double *x, const double *u, double *x_next, double *by_x, double *by_u)
{{
    double start[CHANNELS], z[STATES], slopes[STATES][CHANNELS];
{inputless}    scale(x, u, start);
    advance_slopes(start, z, slopes);
    for (int i = 0; i < STATES; i++) {{
        for (int j = 0; j < STATES; j++) by_x[i * STATES + j] = slopes[i][j] * x_scale[i] / x_scale[j];
{by_inputs}        x_next[i] = z[i] * x_scale[i] + x_offset[i];
    }}
}}
"""
_BY_INPUTS = """\
        for (int j = 0; j < INPUTS; j++) by_u[i * INPUTS + j] = slopes[i][STATES + j] * x_scale[i] / u_scale[j];
"""
_LINEAR = """
void {name}_slopes(const double *z, const double *u, double *z_next, double *by_z, double *by_u)
{{
{inputless}    {name}_step(z, u, z_next);
    for (int i = 0; i < FUNCTIONS; i++) {{
        for (int j = 0; j < FUNCTIONS; j++) by_z[i * FUNCTIONS + j] = A[i][j];
{by_inputs}    }}
}}
"""
_LINEAR_BY_INPUTS = "        for (int j = 0; j < INPUTS; j++) by_u[i * INPUTS + j] = B[i][j] / u_scale[j];\n"
_INPUTLESS = "    (void)by_u;\n"


def advance(model, hull):
    """Arrays for ``lift_slopes``, ``map_slopes`` and ``advance_slopes``, the map over one sample, and their code.

    A ``lifted_linear`` model is lifted anew here, and its ``by_input`` holds B. ``hull`` is the code by which a model
    finds the nearest point of its hull, "" without one.
    """
    nodes = symbols.functions(model.dictionary_)
    n, m = len(model.state_names_), len(model.input_names_)
    count = len(model.channels_.z_scale)
    linear = model.predictor == "lifted_linear"
    entries = symbols.slopes(nodes, count if linear else count + m)
    lines = symbols.code(nodes, symbols.C, [slope for _, _, slope in entries], "slope[{}]")
    code = _LIFT.format(lines="\n".join(f"    {line}" for line in lines))
    code += _MAP.format(
        hull=hull, point="near" if hull else "z", outward=_OUTWARD if hull else "", inputs=_INPUTS if linear else ""
    )
    core = "    map_slopes(start, z, slopes);\n"
    if model.predictor == "vector_field":
        core = _RUNGE_KUTTA.format(dt=symbols.literal(model.dt_), substeps=int(model.substeps_))
    before = list(range(n * model.delays))
    if model.channels_.delayed_inputs:
        past = n * (model.delays + 1)
        before += [*range(count, count + m), *range(past, count - m)]
    shifts = _SHIFTS.format(before=", ".join(map(str, before)), n=n) if before else ""
    arrays = {"slope_of": [row for row, _, _ in entries], "slope_by": [column for _, column, _ in entries]}
    return arrays, code + _ADVANCE.format(core=core, shifts=shifts)


def function(model, name):
    """The public function of the slopes in physical units, behind what it calls."""
    m = len(model.input_names_)
    linear = model.predictor == "lifted_linear"
    by_inputs = (_LINEAR_BY_INPUTS if linear else _BY_INPUTS) if m else ""
    return (_LINEAR if linear else _STEP).format(name=name, by_inputs=by_inputs, inputless="" if m else _INPUTLESS)
