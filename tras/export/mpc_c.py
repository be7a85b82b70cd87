"""The C of `tras.MPC`: the program of a model linearised along the last plan, or of one that is linear when lifted."""

PROGRAM = """\
static int has_plan;
static program qp;
static double plan[HORIZON][INPUTS]; /* from now on */

/* Rows of the program that hold the changes of the inputs. */
static void start_program(void)
{
    forget(&qp);
    for (int i = 0; i < VARIABLES; i++) qp.low[i] = u_low[i % INPUTS], qp.high[i] = u_high[i % INPUTS];
    for (int row = 0; row < GENERAL; row++) {
        qp.soft[row] = row >= CHANGES;
        for (int j = 0; j < VARIABLES; j++) qp.G[row][j] = 0.0;
    }
$changes}

/* The cost of changes of the inputs, and their limits; ``before`` is the last input, NULL at the first sample. */
static void add_changes(const double *before)
{
    for (int i = 0; i < VARIABLES; i++) {
        double weight = change_weight[i % INPUTS];
        if (i >= INPUTS) {
            qp.H[i][i] += weight;
            qp.H[i - INPUTS][i - INPUTS] += weight;
            qp.H[i][i - INPUTS] -= weight;
        } else if (before) {
            qp.H[i][i] += weight;
            qp.f[i] -= weight * before[i];
        }
    }
    if (!before) { /* nothing but the errors decides between inputs, so a little for their size */
        double trace = 0.0;
        for (int i = 0; i < VARIABLES; i++) trace += qp.H[i][i];
        for (int i = 0; i < VARIABLES; i++) qp.H[i][i] += 1e-9 * trace / VARIABLES;
    }
$limits}

/* The working set of the last sample, one sample later. */
static void shift_program(void)
{
    int kept = 0;
    for (int i = 0; i < qp.working && VARIABLES == HORIZON * INPUTS; i++) {
        int row = qp.row[i] - INPUTS;
        if (qp.row[i] >= VARIABLES + CHANGES) row = qp.row[i] - (GENERAL - CHANGES) / HORIZON;
        else if (qp.row[i] >= VARIABLES) row = qp.row[i] - CHANGES / HORIZON;
        if (row < 0 || (qp.row[i] >= VARIABLES && row < VARIABLES)) continue;
        if (qp.row[i] >= VARIABLES + CHANGES && row < VARIABLES + CHANGES) continue;
        qp.row[kept] = row, qp.side[kept] = qp.side[i], qp.mode[kept] = qp.mode[i];
        qp.multiplier[kept++] = qp.multiplier[i];
    }
    if (VARIABLES == HORIZON * INPUTS) qp.working = kept;
}

static const double *ahead(const double *reference, int samples, int k)
{
    return reference + FOLLOWED * (k < samples ? k : samples - 1);
}

"""
CHANGES = """\
    for (int row = 0; row < CHANGES; row++) {
        qp.G[row][changed[row]] = 1.0;
        if (changed[row] >= INPUTS) qp.G[row][changed[row] - INPUTS] = -1.0;
    }
"""
CHANGE_LIMITS = """\
    for (int row = 0; row < CHANGES; row++) {
        int i = changed[row], is_first_move = i < INPUTS;
        double most = is_first_move && !before ? INFINITY : change_limit[row];
        double from = is_first_move && before ? before[i] : 0.0;
        qp.low[VARIABLES + row] = from - most, qp.high[VARIABLES + row] = from + most;
    }
"""
ALONG_PLAN = """\
static double planned[HORIZON + 1][STATES]; /* states from now on */

static void start_inputs(void)
{
    has_plan = 0;
    start_program();
}

static int inputs(const double *z, const double *of_inputs, const double *of_states, const double *reference,
                  int samples, double *u)
{
    static double by_state[HORIZON][STATES][CHANNELS], constant[HORIZON][STATES]; /* z+ = by_state (z, u) + constant */
    double before[INPUTS];
    int first = !has_plan, is_solved = 0;
    shift_program();
    for (int j = 0; j < INPUTS; j++) before[j] = (last_u[j] - u_offset[j]) / u_scale[j];
    for (int k = 0; k < HORIZON; k++) {
        for (int j = 0; j < INPUTS; j++)
            plan[k][j] = !first ? plan[k < HORIZON - 1 ? k + 1 : k][j] : 0.0 < u_low[j] ? u_low[j]
                         : 0.0 > u_high[j] ? u_high[j] : 0.0;
        for (int i = 0; i < STATES; i++) planned[k][i] = first ? z[i] : planned[k + 1][i];
    }
    for (int round = 0; round < (first ? FIRST : ITERATIONS); round++) {
        static double by_moves[STATES][VARIABLES], turned[STATES][VARIABLES];
        double free[STATES], largest = 0.0, astray = 0.0;
        for (int i = 0; i < VARIABLES; i++) {
            qp.f[i] = 0.0;
            for (int j = 0; j < VARIABLES; j++) qp.H[i][j] = 0.0;
        }
        for (int i = 0; i < STATES; i++) {
            free[i] = z[i];
            for (int j = 0; j < VARIABLES; j++) by_moves[i][j] = 0.0;
        }
        for (int k = 0; k < HORIZON; k++) {
            double start[CHANNELS], later[STATES];
            int columns = (block[k] + 1) * INPUTS;
            const double *wanted = ahead(reference, samples, k + 1);
            for (int i = 0; i < STATES; i++) start[i] = planned[k][i];
            for (int j = 0; j < INPUTS; j++) start[STATES + j] = plan[k][j] + of_inputs[j];
            advance_slopes(start, later, by_state[k]);
            for (int i = 0; i < STATES; i++) {
                constant[k][i] = later[i] + of_states[i];
                for (int j = 0; j < STATES; j++) constant[k][i] -= by_state[k][i][j] * planned[k][j];
                for (int j = 0; j < INPUTS; j++) constant[k][i] -= by_state[k][i][STATES + j] * plan[k][j];
                later[i] = constant[k][i];
                for (int j = 0; j < STATES; j++) later[i] += by_state[k][i][j] * free[j];
                for (int c = 0; c < columns; c++) turned[i][c] = 0.0;
                for (int j = 0; j < STATES; j++)
                    for (int c = 0; c < columns; c++) turned[i][c] += by_state[k][i][j] * by_moves[j][c];
                for (int j = 0; j < INPUTS; j++) turned[i][columns - INPUTS + j] += by_state[k][i][STATES + j];
            }
            for (int i = 0; i < STATES; i++) {
                free[i] = later[i];
                astray += 0.0 * free[i]; /* not a number, if that is not finite */
                for (int c = 0; c < columns; c++) {
                    by_moves[i][c] = turned[i][c];
                    astray += 0.0 * turned[i][c];
                }
            }
            for (int r = 0; r < FOLLOWED; r++) {
                const double *row = by_moves[followed[r]], error = free[followed[r]] - wanted[r];
                for (int i = 0; i < columns; i++) {
                    double weighted = error_weight[r] * row[i];
                    qp.f[i] += weighted * error;
                    for (int j = 0; j <= i; j++) qp.H[i][j] += weighted * row[j];
                }
            }
$limits        }
        if (!(astray == 0.0)) break; /* the predictions run away */
        add_changes(first ? NULL : before);
        if (solve_program(&qp) != SOLVED) {
            forget(&qp);
            break;
        }
        is_solved = 1;
        for (int i = 0; i < STATES; i++) planned[0][i] = z[i];
        for (int k = 0; k < HORIZON; k++) {
            for (int i = 0; i < STATES; i++) {
                planned[k + 1][i] = constant[k][i];
                for (int j = 0; j < STATES; j++) planned[k + 1][i] += by_state[k][i][j] * planned[k][j];
                for (int j = 0; j < INPUTS; j++)
                    planned[k + 1][i] += by_state[k][i][STATES + j] * qp.v[block[k] * INPUTS + j];
            }
            for (int j = 0; j < INPUTS; j++) {
                double move = fabs(qp.v[block[k] * INPUTS + j] - plan[k][j]);
                if (move > largest) largest = move;
                plan[k][j] = qp.v[block[k] * INPUTS + j];
            }
        }
        if (first && largest < 1e-6) break;
        for (int k = 0; k < HORIZON - 1 && first; k++) { /* far from any plan its states are simulated */
            double start[CHANNELS], slopes[STATES][CHANNELS];
            for (int i = 0; i < STATES; i++) start[i] = planned[k][i];
            for (int j = 0; j < INPUTS; j++) start[STATES + j] = plan[k][j] + of_inputs[j];
            advance_slopes(start, planned[k + 1], slopes);
            for (int i = 0; i < STATES; i++) planned[k + 1][i] += of_states[i];
        }
    }
    for (int k = 0; k <= HORIZON && !is_solved; k++) /* the rest of the last plan, and states to begin anew with */
        for (int i = 0; i < STATES; i++) planned[k][i] = z[i];
    has_plan = 1;
    for (int j = 0; j < INPUTS; j++) u[j] = plan[0][j];
    return is_solved;
}

"""
STATE_LIMITS = """\
            for (int r = 0; r < LIMITED; r++) {
                int general = CHANGES + k * LIMITED + r;
                for (int c = 0; c < columns; c++) qp.G[general][c] = by_moves[limited[r]][c];
                qp.low[VARIABLES + general] = z_low[r] - free[limited[r]];
                qp.high[VARIABLES + general] = z_high[r] - free[limited[r]];
            }
"""
LIFTED = """\
/* What does not depend on the state: states to watch by the lifting, by disturbances, by the moves; the cost. */
static double by_lifting[HORIZON][WATCHED][FUNCTIONS], by_disturbance[HORIZON][WATCHED][CHANNELS];
static double by_moves[HORIZON][WATCHED][VARIABLES], cost[VARIABLES][VARIABLES];

static void start_inputs(void)
{
    double impulse[HORIZON][WATCHED][INPUTS], power[WATCHED][FUNCTIONS];
    has_plan = 0;
    start_program();
    for (int i = 0; i < VARIABLES; i++)
        for (int j = 0; j < VARIABLES; j++) cost[i][j] = 0.0;
    for (int w = 0; w < WATCHED; w++)
        for (int f = 0; f < FUNCTIONS; f++) power[w][f] = f == 1 + watched[w];
    for (int k = 0; k < HORIZON; k++) {
        for (int w = 0; w < WATCHED; w++) {
            for (int c = 0; c < VARIABLES; c++) by_moves[k][w][c] = 0.0;
            for (int j = 0; j < INPUTS; j++) {
                impulse[k][w][j] = 0.0;
                for (int f = 0; f < FUNCTIONS; f++) impulse[k][w][j] += power[w][f] * B[f][j];
                by_disturbance[k][w][STATES + j] = impulse[k][w][j] + (k ? by_disturbance[k - 1][w][STATES + j] : 0.0);
                for (int i = 0; i <= k; i++) by_moves[k][w][block[i] * INPUTS + j] += impulse[k - i][w][j];
            }
            for (int i = 0; i < STATES; i++)
                by_disturbance[k][w][i] = power[w][1 + i] + (k ? by_disturbance[k - 1][w][i] : 0.0);
            for (int f = 0; f < FUNCTIONS; f++) {
                by_lifting[k][w][f] = 0.0;
                for (int g = 0; g < FUNCTIONS; g++) by_lifting[k][w][f] += power[w][g] * A[g][f];
            }
            for (int f = 0; f < FUNCTIONS; f++) power[w][f] = by_lifting[k][w][f];
        }
        for (int r = 0; r < FOLLOWED; r++) {
            const double *row = by_moves[k][r];
            for (int i = 0; i < VARIABLES; i++)
                for (int j = 0; j <= i; j++) cost[i][j] += error_weight[r] * row[i] * row[j];
        }
$limits    }
}

static int inputs(const double *z, const double *of_inputs, const double *of_states, const double *reference,
                  int samples, double *u)
{
    double before[INPUTS], psi[FUNCTIONS], astray = 0.0;
    int is_solved, first = !has_plan;
    lift(z, psi);
    shift_program();
    for (int j = 0; j < INPUTS; j++) before[j] = (last_u[j] - u_offset[j]) / u_scale[j];
    for (int k = 0; k < HORIZON; k++)
        for (int j = 0; j < INPUTS; j++)
            plan[k][j] = !first ? plan[k < HORIZON - 1 ? k + 1 : k][j] : 0.0 < u_low[j] ? u_low[j]
                         : 0.0 > u_high[j] ? u_high[j] : 0.0;
    for (int i = 0; i < VARIABLES; i++) {
        qp.f[i] = 0.0;
        for (int j = 0; j <= i; j++) qp.H[i][j] = cost[i][j];
    }
    for (int k = 0; k < HORIZON; k++) {
        const double *wanted = ahead(reference, samples, k + 1);
        double free[WATCHED];
        int columns = (block[k] + 1) * INPUTS;
        for (int w = 0; w < WATCHED; w++) {
            free[w] = 0.0;
            for (int f = 0; f < FUNCTIONS; f++) free[w] += by_lifting[k][w][f] * psi[f];
            for (int i = 0; i < CHANNELS; i++)
                free[w] += by_disturbance[k][w][i] * (i < STATES ? of_states[i] : of_inputs[i - STATES]);
            astray += 0.0 * free[w]; /* not a number, if that is not finite */
        }
        for (int r = 0; r < FOLLOWED; r++)
            for (int c = 0; c < columns; c++)
                qp.f[c] += error_weight[r] * by_moves[k][r][c] * (free[r] - wanted[r]);
$free    }
    add_changes(first ? NULL : before);
    is_solved = astray == 0.0 && solve_program(&qp) == SOLVED;
    if (!is_solved) forget(&qp);
    for (int k = 0; k < HORIZON && is_solved; k++)
        for (int j = 0; j < INPUTS; j++) plan[k][j] = qp.v[block[k] * INPUTS + j];
    has_plan = 1;
    for (int j = 0; j < INPUTS; j++) u[j] = plan[0][j];
    return is_solved;
}

"""
LIFTED_LIMITS = """\
        for (int r = 0; r < LIMITED; r++)
            for (int c = 0; c < VARIABLES; c++)
                qp.G[CHANGES + k * LIMITED + r][c] = by_moves[k][FOLLOWED + r][c];
"""
LIFTED_FREE = """\
        for (int r = 0; r < LIMITED; r++) {
            int general = VARIABLES + CHANGES + k * LIMITED + r;
            qp.low[general] = z_low[r] - free[FOLLOWED + r], qp.high[general] = z_high[r] - free[FOLLOWED + r];
        }
"""
