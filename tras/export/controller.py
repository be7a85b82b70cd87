"""A controller as C99 for the rig's computer: a header and a source that need only libm and allocate nothing.

The arithmetic is that of `tras.LQR`, `tras.MPC` and `tras.Observer`, in scaled channels; the quadratic programs are
solved by `tras.export.program`.
"""

import copy
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

import tras
from tras.control.lqr import _ROUNDS, LQR
from tras.control.mpc import _FIRST, MPC
from tras.export import derivatives, symbols
from tras.export.c import HULL, array
from tras.export.common import file_and_name, map_of
from tras.export.program import solver
from tras.workflow.arguments import in_code, whole_number
from tras.workflow.files import replacing

_HEADER = Template("""\
#ifndef ${guard}
#define ${guard}

/*
$vectors
 */
#define ${NAME}_MEASURED $measured
#define ${NAME}_FOLLOWED $followed
#define ${NAME}_INPUTS $inputs
#define ${NAME}_HORIZON $horizon

/* What ${name}_step returns. */
enum {
    ${NAME}_SOLVED,    /* u is the controller's. */
    ${NAME}_SHIFTED,   /* The program was not solved, so u is the next of the last plan, within the limits. */
    ${NAME}_NOT_FINITE /* x or reference holds NaN or infinity: u is the last one, and the step does not count. */
};

#ifdef __cplusplus
extern "C" {
#endif

/* Forget everything about the run so far; to be called first. There is one controller, with a state of its own. */
void ${name}_init(void);
/*
 The input to hold until the next sample. x is what is measured now; reference holds ``samples`` rows of ${NAME}_FOLLOWED
 numbers, from now on: 1 is a constant, more are a preview, whose last row is held beyond its end.
 */
int ${name}_step(const double *x, const double *reference, int samples, double *u);

#ifdef __cplusplus
}
#endif

#endif
""")
_STATE = """\
static int is_first;                /* whether no input was given yet */
static double last_u[INPUTS];       /* in physical units */
"""
_WITHOUT_OBSERVER = """\
static double past_x[DELAYS + 1][PRESENT], past_u[DELAYS + 1][INPUTS];

static void start_estimate(void)
{
}

/* What is not known yet was as the oldest that is known. */
static void estimate(const double *x, double *z, double *d)
{
    for (int i = DELAYS; i >= 0; i--)
        for (int j = 0; j < PRESENT; j++) past_x[i][j] = i == 0 || is_first ? x[j] : past_x[i - 1][j];
    for (int i = 0; i <= DELAYS; i++)
        for (int j = 0; j < PRESENT; j++)
            z[i * PRESENT + j] = (past_x[i][j] - x_offset[i * PRESENT + j]) / x_scale[i * PRESENT + j];
    for (int i = PRESENT * (DELAYS + 1); i < STATES; i++) {
        int of_past = i - PRESENT * (DELAYS + 1);
        double u = is_first ? u_offset[of_past % INPUTS] : past_u[of_past / INPUTS][of_past % INPUTS];
        z[i] = (u - x_offset[i]) / x_scale[i];
    }
    for (int j = 0; j < INPUTS; j++) d[j] = 0.0;
}

static void remember(void)
{
    for (int i = DELAYS; i >= 0; i--)
        for (int j = 0; j < INPUTS; j++) past_u[i][j] = i == 0 || is_first ? last_u[j] : past_u[i - 1][j];
}

"""
_OBSERVER = """\
static double estimated[ALL], covariance[ALL][ALL]; /* of z and of the disturbance of the inputs */

static void start_estimate(void)
{
    for (int i = 0; i < ALL; i++)
        for (int j = 0; j < ALL; j++) covariance[i][j] = 0.0;
}

/* The extended Kalman filter over one sample, u held. */
static void predict_estimate(void)
{
    double start[CHANNELS], z[STATES], slopes[STATES][CHANNELS], move[ALL][ALL], half[ALL][ALL];
    for (int i = 0; i < STATES; i++) start[i] = estimated[i];
    for (int j = 0; j < INPUTS; j++)
        start[STATES + j] = (last_u[j] - u_offset[j]) / u_scale[j] + estimated[STATES + j];
    advance_slopes(start, z, slopes);
    for (int i = 0; i < ALL; i++)
        for (int j = 0; j < ALL; j++) move[i][j] = i < STATES ? slopes[i][j] : i == j;
    for (int j = 0; j < INPUTS && DELAYED_INPUTS; j++) { /* the past holds the inputs without what disturbs them */
        z[PRESENT * (DELAYS + 1) + j] = start[STATES + j] - estimated[STATES + j];
        for (int k = STATES; k < ALL; k++) move[PRESENT * (DELAYS + 1) + j][k] = 0.0;
    }
    for (int i = 0; i < STATES; i++) estimated[i] = z[i];
    for (int i = 0; i < ALL; i++)
        for (int j = 0; j < ALL; j++) {
            half[i][j] = 0.0;
            for (int k = 0; k < ALL; k++) half[i][j] += move[i][k] * covariance[k][j];
        }
    for (int i = 0; i < ALL; i++)
        for (int j = 0; j < ALL; j++) {
            covariance[i][j] = i == j ? process[i] : 0.0;
            for (int k = 0; k < ALL; k++) covariance[i][j] += half[i][k] * move[j][k];
            for (int k = 0; k < INPUTS && i < STATES && j < STATES; k++) /* what acts for one sample */
                covariance[i][j] += move[i][STATES + k] * gusts[k] * move[j][STATES + k];
        }
}

static void correct_estimate(const double *y)
{
    double root[MEASURED][MEASURED], gain[ALL][MEASURED], keep[ALL][ALL], half[ALL][ALL];
    for (int i = 0; i < MEASURED; i++)
        for (int j = 0; j <= i; j++) {
            double sum = covariance[measured[i]][measured[j]] + (i == j ? noise[i] : 0.0);
            for (int k = 0; k < j; k++) sum -= root[i][k] * root[j][k];
            root[i][j] = i == j ? sqrt(sum) : sum / root[j][j];
        }
    for (int s = 0; s < ALL; s++) {
        for (int i = 0; i < MEASURED; i++) {
            gain[s][i] = covariance[measured[i]][s];
            for (int k = 0; k < i; k++) gain[s][i] -= root[i][k] * gain[s][k];
            gain[s][i] /= root[i][i];
        }
        for (int i = MEASURED - 1; i >= 0; i--) {
            for (int k = i + 1; k < MEASURED; k++) gain[s][i] -= root[k][i] * gain[s][k];
            gain[s][i] /= root[i][i];
        }
    }
    {
        double surprise[MEASURED];
        for (int i = 0; i < MEASURED; i++) surprise[i] = y[i] - estimated[measured[i]];
        for (int s = 0; s < ALL; s++)
            for (int i = 0; i < MEASURED; i++) estimated[s] += gain[s][i] * surprise[i];
    }
    for (int i = 0; i < ALL; i++) {
        for (int j = 0; j < ALL; j++) keep[i][j] = i == j;
        for (int k = 0; k < MEASURED; k++) keep[i][measured[k]] -= gain[i][k];
    }
    for (int i = 0; i < ALL; i++)
        for (int j = 0; j < ALL; j++) {
            half[i][j] = 0.0;
            for (int k = 0; k < ALL; k++) half[i][j] += keep[i][k] * covariance[k][j];
        }
    for (int i = 0; i < ALL; i++) /* Joseph's form: symmetric, never negative */
        for (int j = 0; j < ALL; j++) {
            covariance[i][j] = 0.0;
            for (int k = 0; k < ALL; k++) covariance[i][j] += half[i][k] * keep[j][k];
            for (int k = 0; k < MEASURED; k++) covariance[i][j] += gain[i][k] * noise[k] * gain[j][k];
        }
}

static void estimate(const double *x, double *z, double *d)
{
    double y[MEASURED];
    for (int i = 0; i < MEASURED; i++) y[i] = (x[i] - x_offset[measured[i]]) / x_scale[measured[i]];
    if (is_first) { /* nothing is known but y, and it was so before */
        for (int i = 0; i < ALL; i++) {
            estimated[i] = 0.0;
            for (int k = 0; k < MEASURED && i < PRESENT * (DELAYS + 1); k++)
                if (measured[k] == i % PRESENT) estimated[i] = y[k];
            covariance[i][i] = first_variance[i];
        }
    } else {
        predict_estimate();
        correct_estimate(y);
    }
    for (int i = 0; i < STATES; i++) z[i] = estimated[i];
    for (int j = 0; j < INPUTS; j++) d[j] = estimated[STATES + j];
}

static void remember(void)
{
}

"""
_LQR = """\
static int has_target;
static double target[CHANNELS]; /* state and input at rest */

static void start_inputs(void)
{
    has_target = 0;
}

/* The shortest x that minimises |A x - b|, by a singular value decomposition (one-sided, M. R. Hestenes, 1958). */
static void least_squares(double A[EQUATIONS][CHANNELS], const double *b, double *x)
{
    double V[CHANNELS][CHANNELS], square[CHANNELS], largest = 0.0;
    for (int i = 0; i < CHANNELS; i++)
        for (int j = 0; j < CHANNELS; j++) V[i][j] = i == j;
    for (int sweep = 0; sweep < 60; sweep++) {
        double off = 0.0;
        for (int p = 0; p < CHANNELS; p++)
            for (int q = p + 1; q < CHANNELS; q++) {
                double a = 0.0, c = 0.0, g = 0.0, zeta, t, cosine, sine;
                for (int i = 0; i < EQUATIONS; i++) {
                    a += A[i][p] * A[i][p];
                    c += A[i][q] * A[i][q];
                    g += A[i][p] * A[i][q];
                }
                if (g == 0.0 || fabs(g) <= 1e-17 * sqrt(a * c)) continue;
                if (fabs(g) > off * sqrt(a * c)) off = fabs(g) / sqrt(a * c);
                zeta = (c - a) / (2 * g);
                t = (zeta >= 0.0 ? 1.0 : -1.0) / (fabs(zeta) + sqrt(1 + zeta * zeta));
                cosine = 1 / sqrt(1 + t * t);
                sine = cosine * t;
                for (int i = 0; i < EQUATIONS; i++) {
                    double first = A[i][p];
                    A[i][p] = cosine * first - sine * A[i][q];
                    A[i][q] = sine * first + cosine * A[i][q];
                }
                for (int i = 0; i < CHANNELS; i++) {
                    double first = V[i][p];
                    V[i][p] = cosine * first - sine * V[i][q];
                    V[i][q] = sine * first + cosine * V[i][q];
                }
            }
        if (!(off > 1e-15)) break;
    }
    for (int j = 0; j < CHANNELS; j++) {
        square[j] = 0.0;
        for (int i = 0; i < EQUATIONS; i++) square[j] += A[i][j] * A[i][j];
        if (square[j] > largest) largest = square[j];
        x[j] = 0.0;
    }
    for (int j = 0; j < CHANNELS; j++) {
        double share = 0.0;
        if (!(sqrt(square[j]) > SMALLEST * sqrt(largest))) continue;
        for (int i = 0; i < EQUATIONS; i++) share += A[i][j] * b[i];
        for (int i = 0; i < CHANNELS; i++) x[i] += V[i][j] * share / square[j];
    }
}

/* u = u_s - gain (z - z_s), about the state and input at rest that Newton's method finds, from the last ones. */
static int inputs(const double *z, const double *d, const double *reference, int samples, double *u)
{
    double point[CHANNELS], largest = INFINITY;
    (void)samples;
    for (int i = 0; i < CHANNELS; i++) point[i] = has_target ? target[i] : i < STATES ? z[i] : -d[i - STATES];
    for (int round = 0; round < ROUNDS; round++) {
        double start[CHANNELS], later[STATES], slopes[STATES][CHANNELS];
        double missing[EQUATIONS], slope[EQUATIONS][CHANNELS], step[CHANNELS];
        for (int i = 0; i < CHANNELS; i++) start[i] = point[i] + (i < STATES ? 0.0 : d[i - STATES]);
        advance_slopes(start, later, slopes);
        for (int j = 0; j < INPUTS && DELAYED_INPUTS; j++) /* at rest the past inputs are u, without the disturbance */
            later[PRESENT * (DELAYS + 1) + j] = point[STATES + j];
        for (int i = 0; i < EQUATIONS; i++) {
            missing[i] = i < STATES ? later[i] - point[i] : reference[i - STATES] - point[followed[i - STATES]];
            for (int j = 0; j < CHANNELS; j++)
                slope[i][j] = i < STATES ? (i == j) - slopes[i][j] : j == followed[i - STATES];
        }
        least_squares(slope, missing, step);
        largest = 0.0;
        for (int i = 0; i < CHANNELS; i++) {
            point[i] += step[i];
            if (!(fabs(step[i]) <= largest)) largest = fabs(step[i]);
        }
        if (largest < 1e-10) break;
    }
    has_target = fabs(largest) < INFINITY;
    for (int i = 0; i < CHANNELS; i++) target[i] = point[i];
    for (int j = 0; j < INPUTS; j++) {
        u[j] = has_target ? point[STATES + j] : 0.0;
        for (int i = 0; i < STATES && has_target; i++) u[j] -= gain[j][i] * (z[i] - point[i]);
    }
    return 1;
}

"""
_MPC = """\
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

static const double *ahead(const double *reference, int samples, int k)
{
    return reference + FOLLOWED * (k < samples ? k : samples - 1);
}

"""
_CHANGES = """\
    for (int row = 0; row < CHANGES; row++) {
        qp.G[row][changed[row]] = 1.0;
        if (changed[row] >= INPUTS) qp.G[row][changed[row] - INPUTS] = -1.0;
    }
"""
_CHANGE_LIMITS = """\
    for (int row = 0; row < CHANGES; row++) {
        int i = changed[row], is_first_move = i < INPUTS;
        double most = is_first_move && !before ? INFINITY : change_limit[row];
        double from = is_first_move && before ? before[i] : 0.0;
        qp.low[VARIABLES + row] = from - most, qp.high[VARIABLES + row] = from + most;
    }
"""
_ALONG_PLAN = """\
static double planned[HORIZON + 1][STATES]; /* states from now on */

static void start_inputs(void)
{
    has_plan = 0;
    start_program();
}

static int inputs(const double *z, const double *d, const double *reference, int samples, double *u)
{
    static double by_state[HORIZON][STATES][CHANNELS], constant[HORIZON][STATES]; /* z+ = by_state (z, u) + constant */
    double before[INPUTS];
    int first = !has_plan, status = SOLVED;
    for (int j = 0; j < INPUTS; j++) before[j] = (last_u[j] - u_offset[j]) / u_scale[j];
    for (int k = 0; k < HORIZON; k++) {
        for (int j = 0; j < INPUTS; j++)
            plan[k][j] = !first ? plan[k < HORIZON - 1 ? k + 1 : k][j] : 0.0 < u_low[j] ? u_low[j]
                         : 0.0 > u_high[j] ? u_high[j] : 0.0;
        for (int i = 0; i < STATES; i++) planned[k][i] = first ? z[i] : planned[k + 1][i];
    }
    for (int round = 0; round < (first ? FIRST : ITERATIONS); round++) {
        static double by_moves[STATES][VARIABLES], turned[STATES][VARIABLES];
        double free[STATES], largest = 0.0;
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
            for (int j = 0; j < INPUTS; j++) start[STATES + j] = plan[k][j] + d[j];
            advance_slopes(start, later, by_state[k]);
            for (int i = 0; i < STATES; i++) {
                constant[k][i] = later[i];
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
                for (int c = 0; c < columns; c++) by_moves[i][c] = turned[i][c];
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
        add_changes(first ? NULL : before);
        status = solve_program(&qp);
        if (status != SOLVED) /* the rest of the last plan */
            for (int k = HORIZON - 1; k >= 0; k--)
                for (int j = 0; j < INPUTS; j++) qp.v[block[k] * INPUTS + j] = plan[k][j];
        for (int i = 0; i < STATES; i++) planned[0][i] = z[i];
        for (int k = 0; k < HORIZON; k++) {
            for (int i = 0; i < STATES; i++) {
                planned[k + 1][i] = constant[k][i];
                for (int j = 0; j < STATES; j++) planned[k + 1][i] += by_state[k][i][j] * planned[k][j];
                for (int j = 0; j < INPUTS; j++)
                    planned[k + 1][i] += by_state[k][i][STATES + j] * qp.v[block[k] * INPUTS + j];
            }
            for (int j = 0; j < INPUTS && status == SOLVED; j++) {
                double move = fabs(qp.v[block[k] * INPUTS + j] - plan[k][j]);
                if (move > largest) largest = move;
                plan[k][j] = qp.v[block[k] * INPUTS + j];
            }
        }
        if (status != SOLVED || (first && largest < 1e-6)) break;
    }
    has_plan = 1;
    for (int j = 0; j < INPUTS; j++) u[j] = plan[0][j];
    return status == SOLVED;
}

"""
_STATE_LIMITS = """\
            for (int r = 0; r < LIMITED; r++) {
                int general = CHANGES + k * LIMITED + r;
                for (int c = 0; c < columns; c++) qp.G[general][c] = by_moves[limited[r]][c];
                qp.low[VARIABLES + general] = z_low[r] - free[limited[r]];
                qp.high[VARIABLES + general] = z_high[r] - free[limited[r]];
            }
"""
_LIFTED = """\
/* What does not depend on the state: states to watch by the lifting, by the disturbance, by the moves; the cost. */
static double by_lifting[HORIZON][WATCHED][FUNCTIONS], by_disturbance[HORIZON][WATCHED][INPUTS];
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
                by_disturbance[k][w][j] = impulse[k][w][j] + (k ? by_disturbance[k - 1][w][j] : 0.0);
                for (int i = 0; i <= k; i++) by_moves[k][w][block[i] * INPUTS + j] += impulse[k - i][w][j];
            }
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

static int inputs(const double *z, const double *d, const double *reference, int samples, double *u)
{
    double before[INPUTS], psi[FUNCTIONS];
    int status, first = !has_plan;
    lift(z, psi);
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
            for (int j = 0; j < INPUTS; j++) free[w] += by_disturbance[k][w][j] * d[j];
        }
        for (int r = 0; r < FOLLOWED; r++)
            for (int c = 0; c < columns; c++)
                qp.f[c] += error_weight[r] * by_moves[k][r][c] * (free[r] - wanted[r]);
$free    }
    add_changes(first ? NULL : before);
    status = solve_program(&qp);
    for (int k = 0; k < HORIZON && status == SOLVED; k++)
        for (int j = 0; j < INPUTS; j++) plan[k][j] = qp.v[block[k] * INPUTS + j];
    has_plan = 1;
    for (int j = 0; j < INPUTS; j++) u[j] = plan[0][j];
    return status == SOLVED;
}

"""
_LIFTED_LIMITS = """\
        for (int r = 0; r < LIMITED; r++)
            for (int c = 0; c < VARIABLES; c++)
                qp.G[CHANGES + k * LIMITED + r][c] = by_moves[k][FOLLOWED + r][c];
"""
_LIFTED_FREE = """\
        for (int r = 0; r < LIMITED; r++) {
            int general = VARIABLES + CHANGES + k * LIMITED + r;
            qp.low[general] = z_low[r] - free[FOLLOWED + r], qp.high[general] = z_high[r] - free[FOLLOWED + r];
        }
"""
_STEP = Template("""\
void ${name}_init(void)
{
    is_first = 1;
    for (int j = 0; j < INPUTS; j++) last_u[j] = 0.0 < lowest[j] ? lowest[j] : 0.0 > highest[j] ? highest[j] : 0.0;
    start_estimate();
    start_inputs();
}

int ${name}_step(const double *x, const double *reference, int samples, double *u)
{
    static double wanted[(HORIZON + 1) * FOLLOWED];
    double z[STATES], d[INPUTS], scaled[INPUTS];
    int solved, rows = samples < HORIZON + 1 ? samples : HORIZON + 1, finite = rows > 0;
    for (int i = 0; i < MEASURED; i++) finite = finite && fabs(x[i]) < INFINITY;
    for (int i = 0; i < rows * FOLLOWED; i++) {
        int state = followed[i % FOLLOWED];
        finite = finite && fabs(reference[i]) < INFINITY;
        wanted[i] = (reference[i] - x_offset[state]) / x_scale[state];
    }
    for (int j = 0; j < INPUTS; j++) u[j] = last_u[j];
    if (!finite) return ${NAME}_NOT_FINITE;
    estimate(x, z, d);
    solved = inputs(z, d, wanted, rows, scaled);
    for (int j = 0; j < INPUTS; j++) {
        double unlimited = scaled[j] * u_scale[j] + u_offset[j];
        u[j] = last_u[j] = unlimited < lowest[j] ? lowest[j] : unlimited > highest[j] ? highest[j] : unlimited;
    }
    remember();
    is_first = 0;
    return solved ? ${NAME}_SOLVED : ${NAME}_SHIFTED;
}
""")


def controller_to_c(controller: Any, path: str | Path, *, iterations: int = 1000) -> list[Path]:
    """Write a controller as C99: ``path``, which ends in .c, and a header of the same name; returns both paths.

    ``void NAME_init(void)`` begins a run, ``int NAME_step(const double *x, const double *reference, int samples, double
    *u)`` computes the input for one sample, in physical units, and says whether the program was solved; NAME is the
    file's. Observer, limits, preview and the plan that is kept where a program is not solved are those of the
    controller, which is not changed and whose run so far does not matter.

    Parameters
    ----------
    controller : tras.LQR or tras.MPC
        Of a fitted `tras.KoopmanModel`.
    path
    iterations
        Of one quadratic program, at most: in place of a ``time_limit``, which C without an operating system lacks.

    Raises
    ------
    ValueError
        If it is no controller of a fitted model, the path does not end in .c, or the dictionary cannot be written as
        formulas.

    Examples
    --------
    >>> import numpy as np, tempfile
    >>> x, u = np.random.default_rng(0).uniform(-1, 1, (2, 5, 20, 1))
    >>> model = tras.KoopmanModel(tras.Monomials(2), "one_step").fit(tras.Recording(x, u, 0.1))
    >>> [file.name for file in controller_to_c(tras.LQR(model), f"{tempfile.mkdtemp()}/rig.c")]
    ['rig.h', 'rig.c']
    """
    whole_number("iterations", iterations)
    model = controller.predictor.model if isinstance(controller, (LQR, MPC)) else None
    if model is None:
        raise ValueError(
            f"controller is {controller!r}; give a tras.LQR or tras.MPC of a fitted tras.KoopmanModel, whose equations "
            "can be written in C."
        )
    path, name = file_and_name(path, ".c")
    parts = _Parts(controller, model, iterations)
    notes = [f" {line}" for line in _origin(controller, model, path, name)]
    source = f'#include "{path.stem}.h"\n\n#include <math.h>\n#include <stddef.h>\n\n{parts.source(name)}'
    files = {path.with_suffix(".h"): parts.header(name), path: source}
    for file, contents in files.items():
        with replacing(file) as temporary:
            temporary.write_text("\n".join(["/*", *notes, " */", contents]), encoding="utf-8", newline="\n")
    return list(files)


def _origin(controller, model, path, name):
    """Lines of text, safe in a comment."""
    c = controller.channels
    lines = [
        f"A {type(controller).__name__} of a Koopman model; written by tras {tras.__version__}.",
        f"predictor {model.predictor}, dictionary {model.dictionary_!r}, N = {len(model.names_)}",
        f"sampling time {c.dt!r} s, delays {c.delays}, horizon {controller.horizon} samples",
    ]
    if path.stem != name:
        lines.append(f"Functions are called {name}_..., because {path.stem!r} is no name in the language.")
    return [in_code(line) for line in lines]


class _Parts:
    """Sizes, constants and code of one controller."""

    def __init__(self, controller, model, iterations):
        self.controller, self.model, self.iterations = controller, model, iterations
        self.predicts = isinstance(controller, MPC)
        self.lifted = self.predicts and model.predictor == "lifted_linear"
        c = controller.channels
        self.measured = controller.observer.measured if controller.observer else c.state_names

    def header(self, name):
        c, controller = self.controller.channels, self.controller
        units = dict(zip((*c.state_names, *c.input_names), (*c.state_units, *c.input_units)))
        labels = [(f"x[{i}]", state) for i, state in enumerate(self.measured)]
        labels += [(f"reference[{i}]", state) for i, state in enumerate(controller.followed)]
        labels += [(f"u[{i}]", channel) for i, channel in enumerate(c.input_names)]
        texts = [in_code(f"{what}: {label} ({units[label]})" if units[label] else f"{what}: {label}")
                 for what, label in labels]  # fmt: skip
        vectors = "\n".join([" Vectors, in physical units:", *(f" {text}" for text in texts)])
        return _HEADER.substitute(
            name=name, NAME=name.upper(), guard=f"{name.upper()}_H", vectors=vectors, measured=len(self.measured),
            followed=len(controller.followed), inputs=len(c.input_names), horizon=controller.horizon,
        )  # fmt: skip

    def source(self, name):
        c, controller, model = self.controller.channels, self.controller, self.model
        n, m, count = len(c.state_names), len(c.input_names), len(c.z_scale)
        counts = {"STATES": count, "INPUTS": m, "CHANNELS": count + m, "FUNCTIONS": len(model.names_),
                  "PRESENT": n, "DELAYS": c.delays, "DELAYED_INPUTS": int(bool(c.delayed_inputs)),
                  "MEASURED": len(self.measured), "FOLLOWED": len(controller.followed), "HORIZON": controller.horizon}  # fmt: skip
        arrays = {"x_offset": c.z_offset, "x_scale": c.z_scale, "u_offset": c.u_offset, "u_scale": c.u_scale}
        arrays |= {"lowest": controller.limits[:, 0], "highest": controller.limits[:, 1]}
        arrays["followed"] = controller._rows.tolist()
        code = ""
        if not self.lifted or controller.observer:
            more_counts, more_arrays, code = _advance(model)
            counts, arrays = counts | more_counts, arrays | more_arrays
        if self.lifted:
            code += _lift(model)
        for part in (self._estimate, self._plan if self.predicts else self._regulator):
            more_counts, more_arrays, more_code = part()
            counts, arrays, code = counts | more_counts, arrays | more_arrays, code + more_code
        constants = "enum {\n    " + ",\n    ".join(f"{key} = {value}" for key, value in counts.items()) + "\n};\n\n"
        constants += "".join(map(array, arrays, arrays.values())) + "\n"
        return constants + code + _STEP.substitute(name=name, NAME=name.upper())

    def _estimate(self):
        observer, c = self.controller.observer, self.controller.channels
        if observer is None:
            return {}, {}, _STATE + _WITHOUT_OBSERVER
        arrays = {"measured": observer._rows.tolist(), "noise": np.diag(observer._R), "process": np.diag(observer._Q)}
        arrays["gusts"] = observer._gusts
        fresh = copy.copy(observer)
        fresh._begin(np.zeros(len(observer.measured)))
        arrays["first_variance"] = np.diag(fresh.covariance)
        return {"ALL": len(c.z_scale) + len(c.u_scale)}, arrays, _STATE + _OBSERVER

    def _regulator(self):
        lqr = self.controller
        equations = len(lqr.channels.z_scale) + len(lqr.followed)
        size = max(equations, len(lqr.channels.z_scale) + len(lqr.channels.u_scale))
        code = f"#define SMALLEST {float(np.finfo(float).eps * size)!r}\n" + _LQR
        return {"EQUATIONS": equations, "ROUNDS": _ROUNDS}, {"gain": lqr._K}, code

    def _plan(self):
        mpc, c = self.controller, self.controller.channels
        m, blocks = len(c.input_names), mpc._blocks
        variables = int(blocks[-1] + 1) * m
        rate_limit = mpc.rates * c.dt / c.u_scale
        changed = np.flatnonzero(np.isfinite(np.tile(rate_limit, variables // m)))
        changes = len(changed)
        scaled = (mpc.state_limits - c.x_offset[:, None]) / c.x_scale[:, None]
        limited = np.flatnonzero(np.isfinite(scaled).any(axis=1))
        soft = mpc.horizon * len(limited)
        low, high = ((mpc.limits - c.u_offset[:, None]) / c.u_scale[:, None]).T
        counts = {"CHANGES": changes}
        arrays = {
            "block": blocks.tolist(), "error_weight": (mpc.weights * c.x_scale**2)[mpc._rows],
            "change_weight": mpc.rate_weights * c.u_scale**2, "u_low": low, "u_high": high,
        }  # fmt: skip
        if changes:
            arrays |= {"changed": changed.tolist(), "change_limit": rate_limit[changed % m]}
        if len(limited):
            counts["LIMITED"] = len(limited)
            arrays |= {"z_low": scaled[limited, 0], "z_high": scaled[limited, 1]}
        code = solver(
            variables, changes + soft, soft=soft, linear=mpc._program._linear, quadratic=mpc._program._quadratic,
            iterations=self.iterations,
        )  # fmt: skip
        words = {"changes": _CHANGES, "limits": _CHANGE_LIMITS} if changes else {"changes": "", "limits": ""}
        code += "\n" + Template(_MPC).substitute(words)
        if self.lifted:
            watched = [*mpc._rows.tolist(), *limited.tolist()]
            counts["WATCHED"] = len(watched)
            arrays |= {"watched": watched, "A": self.model.koopman_matrix.T, "B": self.model.B_}
            words = {"limits": _LIFTED_LIMITS, "free": _LIFTED_FREE} if soft else {"limits": "", "free": ""}
            return counts, arrays, code + Template(_LIFTED).substitute(words)
        counts |= {"ITERATIONS": mpc.iterations, "FIRST": _FIRST}
        arrays |= {"limited": limited.tolist()} if soft else {}
        words = {"limits": _STATE_LIMITS if soft else ""}
        return counts, arrays, code + Template(_ALONG_PLAN).substitute(words)


def _lift(model):
    lines = symbols.code(symbols.functions(model.dictionary_), symbols.C)
    head = ["static void lift(const double *z, double *psi)", "{"]
    return "\n".join([*head, *(f"    {line}" for line in lines), "}", "", ""])


def _advance(model):
    """Sizes, constants and code of the map over one sample with its slopes, in scaled channels."""
    if model.predictor == "lifted_linear":
        rows = model.dictionary_.coordinates
        arrays, hull = {"matrix": model.koopman_matrix.T[rows], "by_input": model.B_[rows]}, ""
    else:
        matrix, arrays = map_of(model)
        hull = HULL if arrays else ""
        arrays = {"matrix": matrix, **arrays}
    entries, code = derivatives.advance(model, hull)
    return {"ROWS": len(arrays["matrix"]), "SLOPES": len(entries["slope_of"])}, arrays | entries, code + "\n"
