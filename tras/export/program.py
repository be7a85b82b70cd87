"""A solver of dense quadratic programs in C99 for generated controllers: nothing but libm, no memory of its own.

A dual active-set method (D. Goldfarb and A. Idnani, Math. Program. 27, 1983, 1; in the form of D. Arnstroem, A.
Bemporad and D. Axehill, IEEE Trans. Autom. Control 67, 2022, 4362): the multipliers climb the dual function, one row
enters or leaves the working set per iteration, and what the last program ended with is where the next one starts. The
solver that the controllers in Python use has C source, too, but it allocates memory and is ten files with a licence to
carry along; its solutions are the same, for such a program has but one.
"""

SOLVER = """\
/*
 min v'Hv / 2 + f'v  with  low <= (v, Gv) <= high, H positive definite: a dual active-set method. Rows of G that are
 soft may be violated by e >= 0, at the cost LINEAR e + QUADRATIC e^2 / 2. The working set of the last program is where
 the next one starts. Returns SOLVED, or why not.
 */
enum {{ VARIABLES = {variables}, GENERAL = {general}, BOUNDED = VARIABLES + GENERAL }};
enum {{ LARGEST = VARIABLES + {soft} + 1 }};
enum {{ SOLVED, INFEASIBLE, TOO_MANY_ITERATIONS, NOT_CONVEX, RUN_AWAY }};
enum {{ HARD, SLACK }};
#define LINEAR {linear}
#define QUADRATIC {quadratic}
#define TOLERANCE {tolerance}
#define ROUNDING 1e-9 /* what a row that depends on the working set may miss by rounding alone */
#define MOST_ITERATIONS {iterations}

typedef struct {{
    double H[VARIABLES][VARIABLES], f[VARIABLES], low[BOUNDED], high[BOUNDED];
    double G[GENERAL ? GENERAL : 1][VARIABLES];
    int soft[GENERAL ? GENERAL : 1]; /* whether that row of G is */
    double v[VARIABLES];             /* the solution */
    int iterations;
    /* The working set: rows (variables first, then G), their sides 1 (high) or -1, and multipliers. */
    int working, row[LARGEST], side[LARGEST], mode[LARGEST], is_working[BOUNDED];
    int waiting; /* rows at the end of these arrays that are to enter, their multipliers fixed meanwhile */
    double multiplier[LARGEST];
    /* H = cholesky cholesky'; the rows a as half = cholesky^-1 a; half half' = lower diag(pivot) lower'. */
    double cholesky[VARIABLES][VARIABLES], free[VARIABLES];
    double half[LARGEST][VARIABLES], lower[LARGEST][LARGEST], pivot[LARGEST];
    int first[GENERAL ? GENERAL : 1], last[GENERAL ? GENERAL : 1]; /* entries of that row of G that are not zero */
}} program;

static void forget(program *p)
{{
    p->working = p->waiting = 0;
}}

/* Four sums at a time: a processor need not wait for one product before it begins the next. */
static double dot(const double *a, const double *b, int size)
{{
    double sum[4] = {{0.0, 0.0, 0.0, 0.0}};
    int i = 0;
    for (; i + 4 <= size; i += 4)
        for (int j = 0; j < 4; j++) sum[j] += a[i + j] * b[i + j];
    for (; i < size; i++) sum[0] += a[i] * b[i];
    return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}}

/* v -= times a */
static void subtract(double *restrict v, const double *restrict a, double times, int size)
{{
    int i = 0;
    for (; i + 4 <= size; i += 4)
        for (int j = 0; j < 4; j++) v[i + j] -= times * a[i + j];
    for (; i < size; i++) v[i] -= times * a[i];
}}

static double of_row(const program *p, int row, const double *v)
{{
    if (row < VARIABLES) return v[row];
    row -= VARIABLES;
    return dot(&p->G[row][p->first[row]], &v[p->first[row]], p->last[row] - p->first[row]);
}}

static int factorized(program *p)
{{
    for (int i = 0; i < VARIABLES; i++)
        for (int j = 0; j <= i; j++) {{
            double sum = p->H[i][j] - dot(p->cholesky[i], p->cholesky[j], j);
            if (i == j && !(sum > 0.0 && sum < INFINITY)) return 0;
            p->cholesky[i][j] = i == j ? sqrt(sum) : sum / p->cholesky[j][j];
        }}
    return 1;
}}

/* v = cholesky^-T v */
static void substitute_back(const program *p, double *v)
{{
    for (int i = VARIABLES - 1; i >= 0; i--) {{
        v[i] /= p->cholesky[i][i];
        subtract(v, p->cholesky[i], v[i], i);
    }}
}}

/* v = cholesky^-1 v, whose entries before ``first`` are zero */
static void substitute(const program *p, double *v, int first)
{{
    for (int i = first; i < VARIABLES; i++) {{
        v[i] = (v[i] - dot(&p->cholesky[i][first], &v[first], i - first)) / p->cholesky[i][i];
    }}
}}

/* Append a row to the working set; 0, and nothing happens, if it depends on the rows there. */
static int append(program *p, int row, int side, int mode, double multiplier)
{{
    int k = p->working, first = row < VARIABLES ? row : p->first[row - VARIABLES], hard = mode == HARD;
    double size, pivot;
    for (int i = 0; i < k; i++) hard += p->mode[i] == HARD;
    for (int j = 0; j < VARIABLES; j++) p->half[k][j] = row < VARIABLES ? j == row : p->G[row - VARIABLES][j];
    substitute(p, p->half[k], first);
    size = dot(p->half[k], p->half[k], VARIABLES);
    pivot = size += mode == SLACK ? 1.0 / QUADRATIC : 0.0;
    for (int i = 0; i < k; i++) {{
        p->lower[k][i] = dot(&p->half[i][first], &p->half[k][first], VARIABLES - first);
        p->lower[k][i] -= dot(p->lower[i], p->lower[k], i);
    }}
    for (int i = 0; i < k; i++) {{
        double scaled = p->lower[k][i] / p->pivot[i];
        pivot -= scaled * p->lower[k][i];
        p->lower[k][i] = scaled;
    }}
    p->row[k] = row, p->side[k] = side, p->mode[k] = mode, p->multiplier[k] = multiplier;
    if (!(pivot > 1e-12 * size) || (mode == HARD && hard > VARIABLES)) return 0;
    p->pivot[k] = pivot;
    p->is_working[row] = 1;
    p->working++;
    return 1;
}}

static void delete(program *p, int which)
{{
    int k = --p->working;
    double move[LARGEST], weight = p->pivot[which];
    p->is_working[p->row[which]] = 0;
    for (int row = 0; row < BOUNDED; row++)
        if (p->is_working[row] < 0) p->is_working[row] = 0;
    for (int i = which; i < k; i++) {{
        move[i] = p->lower[i + 1][which];
        for (int j = 0; j < VARIABLES; j++) p->half[i][j] = p->half[i + 1][j];
        for (int j = 0; j < which; j++) p->lower[i][j] = p->lower[i + 1][j];
        for (int j = which; j < i; j++) p->lower[i][j] = p->lower[i + 1][j + 1];
        p->pivot[i] = p->pivot[i + 1], p->row[i] = p->row[i + 1], p->side[i] = p->side[i + 1];
        p->mode[i] = p->mode[i + 1], p->multiplier[i] = p->multiplier[i + 1];
    }}
    /* The rows behind it keep what they had in its direction: an update of rank one, which is stable. */
    for (int j = which; j < k; j++) {{
        double before = p->pivot[j], gain;
        p->pivot[j] = before + weight * move[j] * move[j];
        gain = weight * move[j] / p->pivot[j];
        weight *= before / p->pivot[j];
        for (int i = j + 1; i < k; i++) {{
            move[i] -= move[j] * p->lower[i][j];
            p->lower[i][j] += gain * move[i];
        }}
    }}
}}

/* x = (lower diag(pivot) lower')^-1 x */
static void solve_factors(const program *p, double *x)
{{
    for (int i = 0; i < p->working; i++) x[i] -= dot(p->lower[i], x, i);
    for (int i = 0; i < p->working; i++) x[i] /= p->pivot[i];
    for (int i = p->working - 1; i > 0; i--) subtract(x, p->lower[i], x[i], i);
}}

/* v from the multipliers of the first rows, and of those that wait. */
static void primal(program *p, int rows)
{{
    for (int j = 0; j < VARIABLES; j++) p->v[j] = 0.0;
    for (int i = 0; i < rows; i++) subtract(p->v, p->half[i], p->multiplier[i], VARIABLES);
    for (int i = LARGEST - p->waiting; i < LARGEST; i++) subtract(p->v, p->half[i], p->multiplier[i], VARIABLES);
    substitute_back(p, p->v);
    for (int j = 0; j < VARIABLES; j++) p->v[j] += p->free[j];
}}

/* How far each of the first rows is from where it should be. */
static void miss(const program *p, int rows, double *missing)
{{
    for (int i = 0; i < rows; i++) {{
        int row = p->row[i], side = p->side[i];
        missing[i] = of_row(p, row, p->v) - (side > 0 ? p->high[row] : p->low[row]);
        if (p->mode[i] == SLACK) missing[i] -= (p->multiplier[i] - side * LINEAR) / QUADRATIC;
    }}
}}

/* How far (at most ``step``) the multiplier may move before it leaves its piece of the dual function. */
static double allowed(const program *p, int i, double move, double step, int *blocks)
{{
    double now = p->side[i] * p->multiplier[i], change = p->side[i] * move, end = step;
    int soft = p->row[i] >= VARIABLES && p->soft[p->row[i] - VARIABLES];
    if (change < 0.0) end = (now - (p->mode[i] == SLACK ? LINEAR : 0.0)) / -change;
    else if (change > 0.0 && soft && p->mode[i] == HARD) end = (LINEAR - now) / change;
    if (!(end < step)) return step;
    *blocks = i;
    return end > 0.0 ? end : 0.0;
}}

static int is_at_price(const program *p, int i)
{{
    return p->row[i] >= VARIABLES && p->soft[p->row[i] - VARIABLES] && p->side[i] * p->multiplier[i] > 0.5 * LINEAR;
}}

/* A multiplier at the end of its piece: its row leaves the working set, or stops or begins to be violated. */
static void change(program *p, int which)
{{
    int row = p->row[which], side = p->side[which], mode = p->mode[which], at_price = is_at_price(p, which);
    int slot = LARGEST - 1 - p->waiting;
    double half[VARIABLES];
    for (int j = 0; j < VARIABLES; j++) half[j] = p->half[which][j];
    delete(p, which);
    if (!at_price) return;
    if (mode == HARD) {{
        append(p, row, side, SLACK, side * LINEAR);
        return;
    }}
    p->row[slot] = row, p->side[slot] = side, p->multiplier[slot] = side * LINEAR;
    for (int j = 0; j < VARIABLES; j++) p->half[slot][j] = half[j];
    p->is_working[row] = 1;
    p->waiting++;
}}

/* The row beyond its limit by most, or -1. */
static int violated(const program *p, int *side)
{{
    int worst = -1;
    double most = TOLERANCE;
    for (int row = 0; row < BOUNDED; row++) {{
        double value, above, below;
        if (p->is_working[row]) continue;
        value = of_row(p, row, p->v), above = value - p->high[row], below = p->low[row] - value;
        if (above > most) most = above, worst = row, *side = 1;
        if (below > most) most = below, worst = row, *side = -1;
    }}
    return worst;
}}

/* Take a row into the working set, on which it may depend: other rows leave until it does not, or it does itself. */
static int enter(program *p, int row, int side, double multiplier)
{{
    double move[LARGEST], missing[LARGEST];
    while (!append(p, row, side, HARD, multiplier)) {{
        int k = p->working, blocks = -1;
        double step = INFINITY, slope;
        for (int i = 0; i < k; i++) {{
            move[i] = -dot(p->half[i], p->half[k], VARIABLES);
        }}
        solve_factors(p, move);
        move[k] = 1.0;
        /* Along this direction v does not move, and the dual function is a straight line: uphill. */
        primal(p, k + 1);
        miss(p, k + 1, missing);
        slope = 0.0;
        for (int i = 0; i <= k; i++) slope += move[i] * missing[i];
        if (slope < 0.0)
            for (int i = 0; i <= k; i++) move[i] = -move[i];
        for (int i = 0; i <= k; i++) step = allowed(p, i, move[i], step, &blocks);
        if (multiplier == 0.0 && fabs(slope) <= ROUNDING) {{
            p->is_working[row] = -1; /* those that it depends on keep it, until one of them leaves */
            return SOLVED;
        }}
        if (blocks < 0) return INFEASIBLE;
        if (++p->iterations > MOST_ITERATIONS) return TOO_MANY_ITERATIONS;
        for (int i = 0; i <= k; i++) p->multiplier[i] += step * move[i];
        multiplier = p->multiplier[k];
        if (blocks < k) change(p, blocks);
        else if (!is_at_price(p, k)) p->is_working[row] = 0;
        else append(p, row, side, SLACK, side * LINEAR);
        if (blocks == k) return SOLVED;
    }}
    return SOLVED;
}}

static int solve_program(program *p)
{{
    double move[LARGEST];
    int before = p->working, refined = 0;
    p->iterations = p->working = p->waiting = 0;
    for (int row = 0; row < BOUNDED; row++) p->is_working[row] = 0;
    for (int row = 0; row < GENERAL; row++) {{
        int first = 0, last = VARIABLES;
        while (first < last && p->G[row][first] == 0.0) first++;
        while (first < last && p->G[row][last - 1] == 0.0) last--;
        p->first[row] = first, p->last[row] = last;
    }}
    if (!factorized(p)) return NOT_CONVEX;
    for (int j = 0; j < VARIABLES; j++) p->free[j] = -p->f[j];
    substitute(p, p->free, 0);
    substitute_back(p, p->free);
    for (int i = 0; i < before; i++) {{ /* the last working set; a limit may have moved to infinity meanwhile */
        double limit = p->side[i] > 0 ? p->high[p->row[i]] : p->low[p->row[i]];
        if (fabs(limit) < INFINITY) append(p, p->row[i], p->side[i], p->mode[i], p->multiplier[i]);
    }}
    primal(p, p->working);
    for (;;) {{
        int blocks = -1, row, side = 1, status;
        double step = 1.0, multiplier = 0.0;
        /* Towards the minimum on the working set, as far as the multipliers stay on their pieces. */
        miss(p, p->working, move);
        solve_factors(p, move);
        for (int i = 0; i < p->working; i++) step = allowed(p, i, move[i], step, &blocks);
        for (int i = 0; i < p->working; i++) p->multiplier[i] += step * move[i];
        if (blocks >= 0) change(p, blocks);
        primal(p, p->working);
        if (++p->iterations > MOST_ITERATIONS) return TOO_MANY_ITERATIONS;
        if (p->waiting) {{
            int slot = LARGEST - p->waiting--;
            row = p->row[slot], side = p->side[slot], multiplier = p->multiplier[slot];
        }} else if (blocks >= 0) {{
            refined = 0;
            continue;
        }} else {{
            row = violated(p, &side);
            if (row < 0 && refined++) {{ /* the second step on the same set removes what rounding left */
                for (int j = 0; j < VARIABLES; j++)
                    if (!(fabs(p->v[j]) < INFINITY)) return RUN_AWAY; /* numbers so large that they overflow */
                return SOLVED;
            }}
            if (row < 0) continue;
        }}
        refined = 0;
        before = p->iterations;
        status = enter(p, row, side, multiplier);
        if (status != SOLVED) return status;
        if (p->iterations > before || multiplier != 0.0) primal(p, p->working);
    }}
}}
"""


def solver(
    variables: int,
    general: int,
    *,
    soft: int = 0,
    linear: float = 1e3,
    quadratic: float = 1e3,
    tolerance: float = 1e-12,
    iterations: int = 1000,
) -> str:
    """Its source for programs of one size: ``general`` rows beside the bounds of the variables, ``soft`` of them soft.

    Static functions; ``solve_program`` and ``forget`` are to be called. Needs ``<math.h>``.
    """
    return SOLVER.format(
        variables=variables,
        general=general,
        soft=soft,
        linear=repr(float(linear)),
        quadratic=repr(float(quadratic)),
        tolerance=repr(float(tolerance)),
        iterations=iterations,
    )
