/* Refined instrumental variables from a linear process that is simulated from the input alone.
 * SPDX-License-Identifier: Apache-2.0
 *
 * With a slow copy A, B of the estimate the columns are (Young and Jakeman 1980; Garnier and Young 2008)
 *     s^i / A(s) y   and, for the instruments,   s^i / A(s) x,  x = B(s) / A(s) u,   and   s^j / A(s) u.
 * The filters of y and x are trapezoidal. The filters of u are exact for the hold. With F_T = 1 / A(s_T) the equation
 * A(s_T) F_T y = sum b_j ZOH{s^j / A} u has no error of the discretisation at the true A.
 *
 * The equation also holds after any other filters. If 1 / A rings for too long, data pass fixed filters of a more
 * damped polynomial, and only the instruments keep 1 / A. For a resonance, even very fast filters cost at most a factor
 * 2 of the variance. The fast filters and a step of the copy cause no transient in the data. After the fast filters the
 * equation holds exactly with the coefficients of the copy's sampled form (`bend`).
 *
 * Time counts in samples: state j is dt^(j-n) s^j / A(s) of its signal, and A has the coefficients a_i dt^(n-i). States
 * move by increments, which keeps float32 accurate for slow poles. The states are converted when A moves. The matrix
 * exponential is a Taylor polynomial after six halvings, so that no libm changes the bits. The filter is computed once
 * in update_samples. All other work is the same for every sample. */
#include "pmf_linear_filters.h"

#if PMF_LINEAR
#define SETTLED PMF_R(0.05)
#define SETTLED_FAST PMF_R(0.01) /* limit of the settling for fast filters, which forget early */
#define DISCOUNT PMF_R(2.0)
#define WORST \
    PMF_R(1.0) /* ratio of the mean square error to the mean square output, at which a model explains nothing */
#define WORST_DAMPED PMF_R(2.0) /* ratio of the errors without correlation, at equal power */
#define LEAST PMF_R(2.0) /* least decay of a copy over the samples so far */
#define IN_TIME PMF_R(4.5) /* least decay of filters that settle within as many further samples */
#define RATE PMF_R(30.0) /* decay of the filters of data if the filters of the copy are too slow */
#define AGAIN PMF_R(3.0) /* ratio of samples at which slower filters replace fast ones */
#define DOUBTFUL PMF_R(0.05) /* remaining fraction of the sums after filters that became too slow */
#define PART PMF_R(0.3) /* least fraction of the direct estimate's samples */
#define LONGER PMF_R(4.0) /* largest squared ratio of standard errors */
#define SHORT_BAR PMF_R(0.01) /* fraction of a parameter as a small standard error */

/* After the fast filters, a process exactly obeys the equation of its sampled form. The coefficients are the parameters
 * of the process plus the differences computed here. */
static void bend(const pmf_linear_config_t *config, pmf_linear_state_t *state)
{
    real_t row[M], one = config->offset != 0U ? state->b[config->m + 1U] * config->scale[0] : PMF_R(0.0);
    uint32_t i;
    for (i = 0; i < config->n; ++i) {
        row[i] = i <= config->m ? state->b[i] * config->scale[i] : PMF_R(0.0);
    }
    sampled_form(&state->own, config->n, row, one, state->bent.measured, state->bent.held, state->bent.one);
    for (i = 0; i < config->n; ++i) {
        state->bent.measured[i] -= state->own.a[i];
        state->bent.held[i] -= row[i];
    }
    state->bent.one[0] -= one;
}

/* Take over the filters of the copy, and discount the sums from the preceding filters. Early filters may have been
 * lightly damped, with large columns. With permanent filters for data, only the instruments were worse. */
static void adopt(const pmf_linear_config_t *config, pmf_linear_state_t *state)
{
    real_t largest = PMF_R(0.0), a[M];
    uint32_t i;
    for (i = config->n; i-- > 0U;) {
        real_t change;
        a[i] = state->parameter[i] * config->scale[i];
        change = a[i] - state->own.a[i];
        change = (change < PMF_R(0.0) ? -change : change) / (state->damped != 0U ? state->fast.a[i] : a[i]);
        largest = change > largest ? change : largest;
    }
    for (i = 0; i + config->n < PMF_MAX_PARAMETERS; ++i) {
        state->b[i] = state->parameter[config->n + i];
    }
    state->discount = PMF_R(1.0) / (PMF_R(1.0) + DISCOUNT * largest);
    make_filter(&state->own, config->n, a, 1U);
    if (state->damped != 0U) {
        bend(config, state);
    }
    state->wait = config->update_samples;
}

/* Return the filters of the data. */
static const pmf_linear_filter_t *data_filter(const pmf_linear_state_t *state)
{
    return state->damped != 0U ? &state->fast : &state->own;
}

/* Check whether the step response of the data's 1 / A has settled. The transient after a change of A decays with the
 * step response. */
static void note_settling(const pmf_linear_config_t *config, pmf_linear_state_t *state)
{
    const pmf_linear_filter_t *filter = data_filter(state);
    real_t off, within = state->damped != 0U ? SETTLED_FAST : SETTLED;
    trapezoidal(filter, config->n, PMF_R(1.0), state->settling);
    off = filter->a[0] * state->settling[0] - PMF_R(1.0);
    state->age += state->age < 0x7fffffffU ? 1U : 0U;
    if (off > within || off < -within) {
        state->unsettled = state->age;
    } else if (state->age / 3U * 2U > state->unsettled + config->settle_samples) {
        state->settled = 1U;
    } else {
        /* wait */
    }
}

/* Write the regressors of the process in one direction of the data: output, input, constant. */
static void emit(const pmf_linear_config_t *config, const pmf_linear_signals_t *signals, const real_t *output,
                 real_t *column)
{
    uint32_t i;
    for (i = 0; i < config->n; ++i) {
        column[i] = config->scale[i] * output[i];
    }
    for (i = 0; i <= config->m; ++i) {
        column[config->n + i] = -config->scale[i] * signals->held[i];
    }
    if (config->offset != 0U) {
        column[config->n + config->m + 1U] = -config->scale[0] * signals->one[0];
    }
}

/* Return B / A of the input with the constant's part, at the end of the interval. */
static real_t model_output(const pmf_linear_config_t *config, const pmf_linear_state_t *state)
{
    const pmf_linear_signals_t *signals = &state->behind_own;
    real_t output = PMF_R(0.0);
    uint32_t i;
    for (i = 0; i <= config->m; ++i) {
        output += state->b[i] * config->scale[i] * signals->held[i];
    }
    return config->offset != 0U ? output + state->b[config->m + 1U] * config->scale[0] * signals->one[0] : output;
}

/* Pass one sample of all signals through the copy's filters, and return the simulated output at the end of the sample.
 */
static real_t simulate(const pmf_linear_config_t *config, pmf_linear_state_t *state, real_t input)
{
    pmf_linear_signals_t *signals = &state->behind_own;
    real_t model;
    held(&state->own, config->n, input, signals->held);
    if (config->offset != 0U) {
        held(&state->own, config->n, PMF_R(1.0), signals->one);
    }
    model = model_output(config, state);
    trapezoidal(&state->own, config->n, PMF_R(0.5) * (model + state->output), signals->simulated);
    state->output = model;
    return model;
}

/* Pass one sample of the data through the fast filters, and return the correction of the target for the copy's
 * equation. */
static real_t bent(const pmf_linear_config_t *config, pmf_linear_state_t *state, real_t input)
{
    pmf_linear_signals_t *signals = &state->behind_fast;
    real_t left = PMF_R(0.0);
    uint32_t i;
    trapezoidal(&state->fast, config->n, input, signals->held);
    if (config->offset != 0U) {
        trapezoidal(&state->fast, config->n, PMF_R(1.0), signals->one);
    }
    for (i = 0; i < config->n; ++i) {
        left += state->bent.measured[i] * signals->measured[i] - state->bent.held[i] * signals->held[i] -
                state->bent.one[i] * signals->one[i];
    }
    return left;
}

void pmf_linear_step(const pmf_linear_config_t *config, pmf_linear_state_t *state, const real_t *node, real_t *column)
{
    real_t mean = node[PMF_LATE_POSITION], end = mean + config->half_dt * node[PMF_LATE_VELOCITY], model, target = -end;
    uint32_t n = config->n, p = n + config->m + 1U + (config->offset != 0U ? 1U : 0U), i;
    const pmf_linear_filter_t *filter = data_filter(state);
    pmf_linear_signals_t *data = state->damped != 0U ? &state->behind_fast : &state->behind_own;
    if (state->running == 0U) {
        return;
    }
    state->discount = PMF_R(1.0);
    if (state->wait == 0U) {
        adopt(config, state);
    }
    state->wait -= 1U;
    model = simulate(config, state, node[config->input_node]);
    trapezoidal(filter, n, mean, data->measured);
    note_settling(config, state);
    for (i = 0; i < n; ++i) {
        target += filter->a[i] * data->measured[i];
    }
    if (state->damped != 0U) {
        target -= bent(config, state, node[config->input_node]);
    }
    emit(config, data, data->measured, &column[config->first_column]);
    column[config->first_column + p] = target;
    emit(config, &state->behind_own, state->behind_own.simulated, &column[config->first_column + p + 1U]);
    state->power = config->memory * state->power + end * end;
    state->mismatch = config->memory * state->mismatch + (end - model) * (end - model);
}

/* Return whether the model explains nothing of the measured output. During build-up the limit is more tolerant. */
static uint32_t is_lost(const pmf_linear_state_t *state)
{
    real_t worst = state->damped != 0U ? WORST_DAMPED : WORST;
    return state->settled != 0U && state->mismatch > worst * state->power ? 1U : 0U;
}

/* Move the copy by a fraction of the way to theta if the result is stable. */
static uint32_t take(const pmf_linear_config_t *config, pmf_linear_state_t *state, const real_t *theta, const real_t *a,
                     real_t part)
{
    real_t next[PMF_MAX_PARAMETERS], next_a[M];
    uint32_t i;
    for (i = 0; i < PMF_MAX_PARAMETERS; ++i) {
        real_t target = i < config->n && state->damped != 0U ? a[i] / config->scale[i] : theta[i];
        next[i] = state->parameter[i] + part * (target - state->parameter[i]);
    }
    for (i = 0; i < config->n; ++i) {
        next_a[i] = next[i] * config->scale[i];
    }
    if (plausible(config, next_a) == 0U) { /* the last stable copy stays */
        return 0U;
    }
    for (i = 0; i < PMF_MAX_PARAMETERS; ++i) {
        state->parameter[i] = next[i];
    }
    return 1U;
}

static void scaled(const pmf_linear_config_t *config, const real_t *theta, real_t *a)
{
    uint32_t i;
    for (i = 0; i < M; ++i) {
        a[i] = i < config->n ? theta[i] * config->scale[i] : PMF_R(0.0);
    }
}

/* New filters must forget their start. */
static void settle_anew(pmf_linear_state_t *state)
{
    state->age = state->unsettled = state->settled = 0U;
    pmf_clear(state->settling, (uint32_t)sizeof state->settling);
}

/* Let data pass filters of the copy with additional damping, so that the filters settle in the number of past samples.
 */
static void go_behind_fast(const pmf_linear_config_t *config, pmf_linear_state_t *state, real_t samples)
{
    real_t a[M];
    scaled(config, state->parameter, a);
    (void)damp(config, a, RATE / samples);
    make_filter(&state->fast, config->n, a, 0U);
    pmf_clear(&state->behind_fast, (uint32_t)sizeof state->behind_fast);
    settle_anew(state);
    state->damped = 1U;
}

/* Begin a model from an estimate. The filters for data must settle in as many samples as have passed, as the model's
 * own filters may do. Other filters of the same order lose little if the instruments keep the model's filters, because
 * the equation holds after every filter. If the model rings for long or is unstable by noise, the data have filters of
 * a more damped model. */
static uint32_t begin(const pmf_linear_config_t *config, pmf_linear_state_t *state, const real_t *theta, real_t samples)
{
    real_t a[M];
    scaled(config, theta, a);
    if (decays(config, a, IN_TIME / samples) != 0U) {
        if (state->damped != 0U) {
            settle_anew(state);
            state->damped = 0U;
        }
        return take(config, state, theta, a, PMF_R(1.0));
    }
    if (damp(config, a, LEAST / samples) == 0U) {
        return 0U;
    }
    state->damped = 1U;
    (void)take(config, state, theta, a, PMF_R(1.0));
    go_behind_fast(config, state, samples);
    return 1U;
}

/* Move the copy towards an estimate, as far as the copy stays stable, before the filters are computed again. If the
 * filters of the copy do not settle in time, data leave these filters, and the function returns 1 once. Without
 * forgetting, slower filters later replace fast filters, because slower filters average more noise. */
static uint32_t follow(const pmf_linear_config_t *config, pmf_linear_state_t *state, const real_t *theta,
                       real_t samples, uint32_t forgets)
{
    real_t a[M];
    uint32_t leaving;
    if (state->wait != 0U) {
        return 0U;
    }
    if (state->damped != 0U && forgets == 0U && samples > AGAIN * (real_t)state->since) {
        state->since = (whole_t)samples;
        go_behind_fast(config, state, samples);
        return 0U;
    }
    scaled(config, theta, a);
    leaving = state->damped == 0U && decays(config, a, IN_TIME / samples) == 0U ? 1U : 0U;
    if (leaving != 0U) {
        go_behind_fast(config, state, samples);
    }
    if (state->damped == 0U || damp(config, a, LEAST / samples) != 0U) {
        (void)take(config, state, theta, a, config->smoothing);
    }
    return leaving;
}

/* While the direct estimate is active, the model starts from this estimate. The model starts again if it gives no
 * refined estimate within twice the samples, because the first copy may have been wrong. */
static void start(const pmf_linear_config_t *config, pmf_linear_state_t *state, const pmf_recursion_state_t *direct)
{
    uint32_t wait = 2U * state->since;
    wait = wait > config->start_updates ? wait : config->start_updates;
    if (direct->started > wait && begin(config, state, direct->estimate.theta, (real_t)direct->started) != 0U) {
        state->running = 1U;
        state->wait = 0U;
        state->since = direct->started;
    }
}

/* Return a squared standard error. */
static real_t bar(const pmf_estimate_t *estimate, uint32_t i, uint32_t inflated)
{
    real_t inflation = inflated != 0U && estimate->inflation[i] > PMF_R(0.0) ? estimate->inflation[i] : PMF_R(1.0);
    return estimate->variance_factor[i] * estimate->innovation_variance * inflation;
}

/* The refined estimate takes over after a fair fraction of the direct estimate's samples. Its standard errors must be
 * small, or at most slightly larger than the direct ones. After the fast filters, innovations are not white. */
static uint32_t refined_enough(const pmf_config_t *config, const pmf_state_t *state)
{
    const pmf_estimate_t *own = &state->instrument.estimate, *direct = &state->direct.estimate;
    uint32_t i, enough = state->instrument.sums.weight > PART * state->direct.sums.weight ? 1U : 0U;
    for (i = 0; i < config->linear.n; ++i) {
        real_t small = SHORT_BAR * own->theta[i];
        if (!(bar(own, i, state->linear.damped) < LONGER * bar(direct, i, state->linear.damped) + small * small)) {
            enough = 0U;
        }
    }
    return enough;
}

uint32_t pmf_linear_estimate(const pmf_config_t *config, pmf_state_t *state, uint32_t direct_status, uint32_t settled)
{
    const pmf_linear_config_t *linear = &config->linear;
    uint32_t status = PMF_STARTING;
    if (is_lost(&state->linear) != 0U) { /* the model begins again from the direct estimate */
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
        real_t samples = (real_t)state->direct.started;
        uint32_t forgets = config->instrument.forgetting < PMF_SCALAR(1.0) ? 1U : 0U;
        if (follow(linear, &state->linear, state->instrument.estimate.theta, samples, forgets) != 0U) {
            pmf_recursion_discount(&config->instrument, &state->instrument, DOUBTFUL);
        }
        return status;
    }
    if ((direct_status & PMF_POOR_EXCITATION) == 0U) {
        start(linear, &state->linear, &state->direct);
    }
    return (direct_status & ~(uint32_t)PMF_COMPENSATION_HELD) | PMF_FALLBACK | (status & (uint32_t)PMF_RESET);
}
#endif
