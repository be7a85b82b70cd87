"""The C of `tras.LQR`: the gain, about the state and input at rest."""

LQR = """\
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
static int inputs(const double *z, const double *of_inputs, const double *of_states, const double *reference,
                  int samples, double *u)
{
    double point[CHANNELS], largest = INFINITY;
    (void)samples;
    for (int i = 0; i < CHANNELS; i++) point[i] = has_target ? target[i] : i < STATES ? z[i] : -of_inputs[i - STATES];
    for (int round = 0; round < ROUNDS; round++) {
        double start[CHANNELS], later[STATES], slopes[STATES][CHANNELS];
        double missing[EQUATIONS], slope[EQUATIONS][CHANNELS], step[CHANNELS];
        for (int i = 0; i < CHANNELS; i++) start[i] = point[i] + (i < STATES ? 0.0 : of_inputs[i - STATES]);
        advance_slopes(start, later, slopes);
        for (int i = 0; i < EQUATIONS; i++) {
            missing[i] = i < STATES ? later[i] + of_states[i] - point[i]
                         : reference[i - STATES] - point[followed[i - STATES]];
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
