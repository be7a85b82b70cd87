"""The C of a controller that estimates the state: what was measured and what is remembered, or `tras.Observer`."""

STATE = """\
static int is_first;                /* whether no input was given yet */
static double last_u[INPUTS];       /* in physical units */
"""
WITHOUT_OBSERVER = """\
static double past_x[DELAYS + 1][PRESENT], past_u[DELAYS + 1][INPUTS];

/* What is not known yet was as the oldest that is known. */
static void estimate(const double *x, double *z, double *of_inputs, double *of_states)
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
    for (int j = 0; j < INPUTS; j++) of_inputs[j] = 0.0;
    for (int i = 0; i < STATES; i++) of_states[i] = 0.0;
}

static void remember(void)
{
    for (int i = DELAYS; i >= 0; i--)
        for (int j = 0; j < INPUTS; j++) past_u[i][j] = i == 0 || is_first ? last_u[j] : past_u[i - 1][j];
}

"""
OBSERVER = """\
static double estimated[ALL], covariance[ALL][ALL]; /* of z and of the disturbances */

/* What the estimated disturbances add to the inputs, and to the states after a sample. */
static void disturb(double *of_inputs, double *of_states)
{
    for (int i = 0; i < INPUTS; i++) of_inputs[i] = 0.0;
    for (int i = 0; i < STATES; i++) of_states[i] = 0.0;
    for (int k = STATES; k < ALL; k++) {
        for (int i = 0; i < INPUTS; i++) of_inputs[i] += on_inputs[i][k - STATES] * estimated[k];
        for (int i = 0; i < STATES; i++) of_states[i] += on_states[i][k - STATES] * estimated[k];
    }
}

/* The extended Kalman filter over one sample, u held. */
static void predict_estimate(void)
{
    double start[CHANNELS], z[STATES], slopes[STATES][CHANNELS], move[ALL][ALL], half[ALL][ALL], of_states[STATES];
    disturb(start + STATES, of_states);
    for (int i = 0; i < STATES; i++) start[i] = estimated[i];
    for (int j = 0; j < INPUTS; j++) start[STATES + j] += (last_u[j] - u_offset[j]) / u_scale[j];
    advance_slopes(start, z, slopes);
    for (int i = 0; i < ALL; i++)
        for (int j = 0; j < ALL; j++) {
            move[i][j] = i < STATES && j < STATES ? slopes[i][j] : i == j;
            if (i >= STATES || j < STATES) continue;
            move[i][j] = on_states[i][j - STATES];
            for (int k = 0; k < INPUTS; k++) move[i][j] += slopes[i][STATES + k] * on_inputs[k][j - STATES];
        }
    for (int i = 0; i < STATES; i++) estimated[i] = z[i] + of_states[i];
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
                covariance[i][j] += slopes[i][STATES + k] * gusts[k] * gusts[k] * slopes[j][STATES + k];
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

static void estimate(const double *x, double *z, double *of_inputs, double *of_states)
{
    double y[MEASURED], astray = 0.0;
    for (int i = 0; i < MEASURED; i++) y[i] = (x[i] - x_offset[measured[i]]) / x_scale[measured[i]];
    if (!is_first) {
        predict_estimate();
        correct_estimate(y);
        for (int i = 0; i < ALL; i++) {
            astray += 0.0 * estimated[i]; /* not a number, if that is not finite */
            for (int j = 0; j < ALL; j++) astray += 0.0 * covariance[i][j];
        }
    }
    if (is_first || !(astray == 0.0)) /* nothing is known but y, and it was so before */
        for (int i = 0; i < ALL; i++) {
            estimated[i] = 0.0;
            for (int k = 0; k < MEASURED && i < PRESENT * (DELAYS + 1); k++)
                if (measured[k] == i % PRESENT) estimated[i] = y[k];
            for (int j = 0; j < ALL; j++) covariance[i][j] = i == j ? first_variance[i] : 0.0;
        }
    for (int i = 0; i < STATES; i++) z[i] = estimated[i];
    disturb(of_inputs, of_states);
}

static void remember(void)
{
}

"""
