/* A linear process, simulated from the input alone, and its own filters: refined instrumental variables.
 * SPDX-License-Identifier: Apache-2.0
 *
 * With a slow copy A, B of the estimate the columns are (Young and Jakeman 1980; Garnier and Young 2008)
 *     s^i / A(s) y   and, for the instruments,   s^i / A(s) x,  x = B(s) / A(s) u,   and   s^j / A(s) u.
 * The filters of y and x are trapezoidal and those of u exact behind its hold: with F_T = 1 / A(s_T) the equation
 * A(s_T) F_T y = sum b_j ZOH{s^j / A} u holds without any error of the discretisation at the true A.
 *
 * Time counts in samples: state j is dt^(j-n) s^j / A(s) of its signal, and A has the coefficients a_i dt^(n-i). States
 * move by increments, which keeps float32 accurate where poles are slow. When A moves they are carried over. The matrix
 * exponential is a Taylor polynomial after six halvings, for no libm gives the same bits everywhere; it is computed once
 * in update_samples, the rest is the same for every sample.
 */
#include "pmf.h"

#if PMF_LINEAR
#define M PMF_MAX_ORDER
#define HALVINGS 6
#define TAYLOR 10U
#define SETTLED PMF_R(0.05)
#define DISCOUNT PMF_R(2.0)
#define WORST PMF_R(1.0) /* mean square error of the model over the mean square output: it explains nothing */
#define LEAST PMF_R(2.0) /* over the samples gathered: filters must decay so fast to have forgotten their start */
#define RATE PMF_R(9.0)  /* the same of filters that are to settle within twice the samples */
#define RELEASED PMF_R(0.02) /* of what was gathered with damped filters, once they need not be */
#define SHIFTS 4U        /* to the left by such a rate, at most, where poles are too far to the right */
#define WORST_DAMPED PMF_R(2.0) /* ... without any correlation, at the same power */
#define PART PMF_R(0.3)       /* of the direct estimate's samples */
#define LONGER PMF_R(4.0)     /* error bars, squared */
#define SHORT_BAR PMF_R(0.01) /* of the parameter */

enum { DAMPED = 1, LEFT = 2 }; /* the copy more than the estimate; no longer, its filters not yet */

/* Are all roots in the left half-plane (Routh 1877), and none faster than the samples can show? */
static uint32_t plausible(const pmf_linear_config_t *config, const real_t *a)
{
    real_t row[2][M + 2]; /* two rows of the table, in turn */
    uint32_t n = config->n, i, k;
    for (i = 0; i < M + 2U; ++i) {
        row[0][i] = row[1][i] = PMF_R(0.0);
    }
    for (i = 0; i <= n; ++i) { /* from the highest power on, every other one */
        row[i % 2U][i / 2U] = i == 0U ? PMF_R(1.0) : a[n - i];
        if (i < n && !(a[i] > PMF_R(0.0) && a[i] < config->limit[i])) {
            return 0U;
        }
    }
    for (k = 0; k + 1U < n; ++k) {
        real_t *upper = row[k % 2U];
        const real_t *lower = row[(k + 1U) % 2U];
        real_t ratio = upper[0] / lower[0];
        for (i = 0; i + 1U < M + 2U; ++i) {
            upper[i] = upper[i + 1U] - ratio * lower[i + 1U];
        }
        upper[M + 1] = PMF_R(0.0);
        if (!(upper[0] > PMF_R(0.0))) {
            return 0U;
        }
    }
    return 1U;
}

/* matrix = companion * matrix, times a factor. */
static void companion(const real_t *a, uint32_t n, real_t factor, real_t matrix[M][M])
{
    uint32_t i, j;
    for (j = 0; j < n; ++j) {
        real_t last = PMF_R(0.0);
        for (i = 0; i < n; ++i) {
            last -= a[i] * matrix[i][j];
        }
        for (i = 0; i + 1U < n; ++i) {
            matrix[i][j] = factor * matrix[i + 1U][j];
        }
        matrix[n - 1U][j] = factor * last;
    }
}

/* From half the time to the whole: E = 2 E + E^2, g = 2 g + E g. */
static void twice(uint32_t n, real_t step[M][M], real_t gain[M])
{
    real_t square[M][M], moved[M];
    uint32_t i, j, k;
    for (i = 0; i < n; ++i) {
        moved[i] = PMF_R(2.0) * gain[i];
        for (j = 0; j < n; ++j) {
            moved[i] += step[i][j] * gain[j];
            square[i][j] = PMF_R(2.0) * step[i][j];
            for (k = 0; k < n; ++k) {
                square[i][j] += step[i][k] * step[k][j];
            }
        }
    }
    for (i = 0; i < n; ++i) {
        gain[i] = moved[i];
        for (j = 0; j < n; ++j) {
            step[i][j] = square[i][j];
        }
    }
}

/* step = exp(companion) - 1 and gain = the integral of exp(companion t) over one sample, last column. */
static void discretise(pmf_linear_state_t *state, uint32_t n)
{
    real_t h = PMF_R(1.0), sum[M][M];
    uint32_t i, j, k;
    for (k = 0; k < HALVINGS; ++k) {
        h *= PMF_R(0.5);
    }
    for (i = 0; i < n; ++i) {
        for (j = 0; j < n; ++j) {
            sum[i][j] = i == j ? PMF_R(1.0) : PMF_R(0.0);
        }
    }
    for (k = TAYLOR; k >= 2U; --k) { /* 1 + A h / 2 (1 + A h / 3 (...)) */
        companion(state->a, n, h / (real_t)k, sum);
        for (i = 0; i < n; ++i) {
            sum[i][i] += PMF_R(1.0);
        }
    }
    for (i = 0; i < n; ++i) {
        state->gain[i] = h * sum[i][n - 1U];
    }
    companion(state->a, n, h, sum);
    for (i = 0; i < n; ++i) {
        for (j = 0; j < n; ++j) {
            state->step[i][j] = sum[i][j];
        }
    }
    for (k = 0; k < HALVINGS; ++k) {
        twice(n, state->step, state->gain);
    }
}

/* The filters of the copy, and how much less what was gathered with the ones before counts: early ones may have been
 * lightly damped and have large columns. */
static void adopt(const pmf_linear_config_t *config, pmf_linear_state_t *state)
{
    real_t divisor = PMF_R(1.0), part = PMF_R(1.0), largest = PMF_R(0.0);
    uint32_t i;
    for (i = config->n; i-- > 0U;) {
        real_t a = state->parameter[i] * config->scale[i], change = a - state->a[i];
        change = (change < PMF_R(0.0) ? -change : change) / a;
        largest = change > largest ? change : largest;
        part *= PMF_R(0.5);
        divisor += a * part;
        state->a[i] = a;
    }
    for (i = 0; i + config->n < PMF_MAX_PARAMETERS; ++i) {
        state->b[i] = state->parameter[config->n + i];
    }
    state->discount = PMF_R(1.0) / (PMF_R(1.0) + DISCOUNT * largest);
    if (state->damped == LEFT) {
        state->discount *= state->in_charge != 0U ? RELEASED : PMF_R(1.0);
        state->damped = 0U;
    }
    state->inverse = PMF_R(1.0) / divisor;
    discretise(state, config->n);
    state->wait = config->update_samples;
}

/* x += E x + g u: exact for a held u. */
static void held(const pmf_linear_state_t *state, uint32_t n, real_t u, real_t x[M])
{
    real_t moved[M];
    uint32_t i, j;
    for (i = 0; i < n; ++i) {
        moved[i] = state->gain[i] * u;
        for (j = 0; j < n; ++j) {
            moved[i] += state->step[i][j] * x[j];
        }
    }
    for (i = 0; i < n; ++i) {
        x[i] += moved[i];
    }
}

/* The trapezoidal rule with the mean of a signal over the sample: the middle of the states, c + q / 2^(n-i) with the last
 * one's increment q, is each one's increment but for the one above. */
static void trapezoidal(const pmf_linear_state_t *state, uint32_t n, real_t mean, real_t w[M])
{
    real_t middle[M + 1], q = mean;
    uint32_t i;
    middle[n] = PMF_R(0.0);
    for (i = n; i-- > 0U;) {
        middle[i] = w[i] + PMF_R(0.5) * middle[i + 1U];
        q -= state->a[i] * middle[i];
    }
    middle[n] = q * state->inverse;
    for (i = n; i-- > 0U;) {
        middle[i] = w[i] + PMF_R(0.5) * middle[i + 1U];
        w[i] += middle[i + 1U];
    }
}

/* Has the step response of 1 / A stayed at its end? A transient of the size of the change of A decays with it. */
static void note_settling(const pmf_linear_config_t *config, pmf_linear_state_t *state)
{
    real_t off;
    trapezoidal(state, config->n, PMF_R(1.0), state->settling);
    off = state->a[0] * state->settling[0] - PMF_R(1.0);
    state->age += state->age < 0x7fffffffU ? 1U : 0U;
    if (off > SETTLED || off < -SETTLED) {
        state->unsettled = state->age;
    } else if (state->age / 3U * 2U > state->unsettled + config->settle_samples) {
        state->settled = 1U;
    }
}

/* Regressors of the process in one direction of the data: the output's, the input's, the constant's. */
static void emit(const pmf_linear_config_t *config, const pmf_linear_state_t *state, const real_t *output, real_t *column)
{
    uint32_t i;
    for (i = 0; i < config->n; ++i) {
        column[i] = config->scale[i] * output[i];
    }
    for (i = 0; i <= config->m; ++i) {
        column[config->n + i] = -config->scale[i] * state->held[i];
    }
    if (config->offset != 0U) {
        column[config->n + config->m + 1U] = -config->scale[0] * state->one[0];
    }
}

/* Output of the model at the end of the interval. */
static real_t model_output(const pmf_linear_config_t *config, const pmf_linear_state_t *state)
{
    real_t output = PMF_R(0.0);
    uint32_t i;
    for (i = 0; i <= config->m; ++i) {
        output += state->b[i] * config->scale[i] * state->held[i];
    }
    return config->offset != 0U ? output + state->b[config->m + 1U] * config->scale[0] * state->one[0] : output;
}

void pmf_linear_step(const pmf_linear_config_t *config, pmf_linear_state_t *state, const real_t *node, real_t *column)
{
    real_t mean = node[PMF_LATE_POSITION], end = mean + config->half_dt * node[PMF_LATE_VELOCITY], model, target = -end;
    uint32_t n = config->n, p = n + config->m + 1U + (config->offset != 0U ? 1U : 0U), i;
    if (state->running == 0U) {
        return;
    }
    state->discount = PMF_R(1.0);
    if (state->wait == 0U) {
        adopt(config, state);
    }
    state->wait -= 1U;
    held(state, n, node[config->input_node], state->held);
    if (config->offset != 0U) {
        held(state, n, PMF_R(1.0), state->one);
    }
    model = model_output(config, state);
    trapezoidal(state, n, mean, state->measured);
    trapezoidal(state, n, PMF_R(0.5) * (model + state->output), state->simulated);
    state->output = model;
    note_settling(config, state);
    for (i = 0; i < n; ++i) {
        target += state->a[i] * state->measured[i];
    }
    emit(config, state, state->measured, &column[config->first_column]);
    column[config->first_column + p] = target;
    emit(config, state, state->simulated, &column[config->first_column + p + 1U]);
    state->power = config->memory * state->power + end * end;
    state->mismatch = config->memory * state->mismatch + (end - model) * (end - model);
}

/* Does its output explain nothing of the measured one? Of a copy that was damped less is expected. */
static uint32_t is_lost(const pmf_linear_state_t *state)
{
    real_t worst = state->damped == DAMPED ? WORST_DAMPED : WORST;
    return state->settled != 0U && state->mismatch > worst * state->power ? 1U : 0U;
}

/* A(s + rate): all roots further left by it. */
static void shift(uint32_t n, real_t rate, real_t *a)
{
    uint32_t i, k;
    for (k = 0; k < n; ++k) {
        for (i = n; i-- > k;) {
            a[i] += rate * (i + 1U == n ? PMF_R(1.0) : a[i + 1U]);
        }
    }
}

/* Do all roots decay at least so fast? */
static uint32_t decays(const pmf_linear_config_t *config, const real_t *a, real_t rate)
{
    real_t moved[M];
    uint32_t i;
    for (i = 0; i < config->n; ++i) {
        moved[i] = a[i];
    }
    shift(config->n, -rate, moved);
    return plausible(config, moved);
}

/* Moves the copy by a part of the way to theta, if that is plausible: stable, and theta first moved to the left until its
 * filters decay. They may be any for the instruments to be right, but must settle within the record. */
static uint32_t take(const pmf_linear_config_t *config, pmf_linear_state_t *state, const real_t *theta, real_t part,
                     real_t least, real_t rate)
{
    real_t next[PMF_MAX_PARAMETERS], target[PMF_MAX_PARAMETERS], a[M];
    uint32_t i, shifts = 0U;
    for (i = 0; i < PMF_MAX_PARAMETERS; ++i) {
        target[i] = theta[i];
    }
    for (i = 0; i < config->n; ++i) {
        a[i] = theta[i] * config->scale[i];
    }
    while (least > PMF_R(0.0) && shifts < SHIFTS && decays(config, a, least) == 0U) {
        shift(config->n, rate, a);
        ++shifts;
    }
    for (i = 0; i < config->n && shifts > 0U; ++i) {
        target[i] = a[i] / config->scale[i];
    }
    for (i = 0; i < PMF_MAX_PARAMETERS; ++i) {
        next[i] = state->parameter[i] + part * (target[i] - state->parameter[i]);
    }
    for (i = 0; i < config->n; ++i) {
        a[i] = next[i] * config->scale[i];
    }
    if (plausible(config, a) == 0U) { /* the last stable copy stays */
        return 0U;
    }
    for (i = 0; i < PMF_MAX_PARAMETERS; ++i) {
        state->parameter[i] = next[i];
    }
    state->damped = shifts > 0U ? DAMPED : state->damped != 0U ? LEFT : 0U;
    return 1U;
}

/* Moves the copy towards an estimate, as far as that is stable, where the filters are about to be computed anew. */
static void follow(const pmf_linear_config_t *config, pmf_linear_state_t *state, const real_t *theta, uint32_t gathered)
{
    if (state->wait == 0U) {
        (void)take(config, state, theta, config->smoothing, LEAST / (real_t)gathered, LEAST / (real_t)gathered);
    }
}

/* While the direct estimate is in charge, the model starts from it; and again, if that did not lead to a refined one
 * within twice the samples: the first copy may have been far off, with filters that settle too slowly. Then, and where
 * the direct estimate is unstable, as noise makes it of a light damping, from filters that settle in time. */
static void start(const pmf_linear_config_t *config, pmf_linear_state_t *state, const pmf_recursion_state_t *direct)
{
    const real_t *theta = direct->estimate.theta;
    uint32_t wait = 2U * state->since, taken = 0U;
    wait = wait > config->start_updates ? wait : config->start_updates;
    if (direct->started <= wait) {
        return;
    }
    if (state->running == 0U) {
        taken = take(config, state, theta, PMF_R(1.0), PMF_R(0.0), PMF_R(0.0));
    }
    if (taken == 0U) {
        real_t part = PMF_R(1.0) / (real_t)direct->started;
        taken = take(config, state, theta, PMF_R(1.0), LEAST * part, RATE * part);
    }
    if (taken != 0U) {
        state->running = 1U;
        state->wait = 0U;
        state->since = direct->started;
    }
}

/* The refined estimate takes over once it has gathered a fair part of what the direct one has, if its error bars are not
 * much longer, or short enough. */
static uint32_t refined_enough(const pmf_config_t *config, const pmf_state_t *state)
{
    const pmf_estimate_t *own = &state->instrument.estimate, *direct = &state->direct.estimate;
    uint32_t i, enough = state->instrument.sums.weight > PART * state->direct.sums.weight ? 1U : 0U;
    for (i = 0; i < config->linear.n; ++i) {
        real_t bar = own->variance_factor[i] * own->innovation_variance, small = SHORT_BAR * own->theta[i];
        if (!(bar < LONGER * direct->variance_factor[i] * direct->innovation_variance + small * small)) {
            enough = 0U;
        }
    }
    return enough;
}

uint32_t pmf_linear_estimate(const pmf_config_t *config, pmf_state_t *state, uint32_t direct_status, uint32_t settled)
{
    const pmf_linear_config_t *linear = &config->linear;
    uint32_t status = PMF_STARTING;
    if (is_lost(&state->linear) != 0U) { /* begin again from the direct estimate */
        pmf_clear(&state->linear, (uint32_t)sizeof state->linear);
        pmf_clear(&state->instrument, (uint32_t)sizeof state->instrument);
    } else if (settled != 0U && state->linear.settled != 0U) {
        if (state->linear.discount < PMF_R(1.0)) {
            pmf_recursion_discount(&config->instrument, &state->instrument, state->linear.discount);
        }
        status = pmf_recursion_step(&config->instrument, &state->instrument, state->network.column);
    } else {
        status = state->instrument.started != 0U ? 0U : status;
    }
    if (state->linear.in_charge == 0U && state->instrument.started > linear->settle_samples && status == 0U) {
        state->linear.in_charge = refined_enough(config, state);
    }
    if (state->linear.in_charge != 0U) {
        follow(linear, &state->linear, state->instrument.estimate.theta, state->direct.started);
        return state->linear.damped == DAMPED ? status | PMF_SETTLING : status;
    }
    if ((direct_status & PMF_POOR_EXCITATION) == 0U) {
        start(linear, &state->linear, &state->direct);
    }
    return (direct_status & ~(uint32_t)PMF_COMPENSATION_HELD) | PMF_FALLBACK | (status & (uint32_t)PMF_RESET);
}
#endif
