/* One sample straight through: encoder, network, recursion.
 * SPDX-License-Identifier: Apache-2.0
 */
#include "pmf.h"

#define TAKE_OVER PMF_R(1.5)
#define PART PMF_R(0.3)       /* of the direct estimate's samples */
#define LONGER PMF_R(4.0)     /* error bars, squared */
#define SHORT_BAR PMF_R(0.01) /* of the parameter */

void pmf_clear(void *memory, uint32_t size)
{
    unsigned char *byte = (unsigned char *)memory;
    uint32_t i;
    for (i = 0; i < size; ++i) {
        byte[i] = 0;
    }
}

void pmf_init(const pmf_config_t *config, pmf_state_t *state)
{
    pmf_clear(state, (uint32_t)sizeof *state);
    state->settle = config->first_samples;
    state->encoder.idle = config->encoder.standstill_samples; /* at rest until a count says otherwise */
    pmf_auxiliary_start(&config->auxiliary, &state->auxiliary);
}

uint32_t pmf_parameters(const pmf_config_t *config)
{
    return config->auxiliary.enabled != 0U ? config->instrument.n_parameters : config->direct.n_parameters;
}

uint32_t pmf_filter(const pmf_config_t *config, pmf_state_t *state, real_t input, uint32_t count)
{
    uint32_t status =
        pmf_encoder_step(&config->encoder, &state->encoder, input, count, state->network.node);
    if (config->auxiliary.enabled != 0U && state->auxiliary.running != 0U) {
        pmf_auxiliary_step(&config->auxiliary, &state->auxiliary, state->network.node);
    }
    pmf_network_step(&config->network, &state->network);
    if (config->auxiliary.enabled != 0U) {
        pmf_auxiliary_correct(&config->auxiliary, &state->auxiliary, state->network.column);
    }
    if (config->linear.enabled != 0U) {
        pmf_linear_step(&config->linear, &state->linear, state->network.node, state->network.column);
    }
    if ((status & (PMF_INVALID_INPUT | PMF_COUNT_JUMP)) != 0U) {
        state->settle = config->settle_samples;
    }
    if (state->settle > 0U) {
        if (state->settle == config->settle_samples / 2U && config->auxiliary.enabled != 0U) {
            /* by now the measured velocity is known: the model need not run up to it with its own time constant */
            state->auxiliary.velocity = state->network.column[config->auxiliary.check_column];
            state->auxiliary.position = state->network.node[PMF_LATE_POSITION];
        }
        state->settle -= 1U;
        status |= PMF_SETTLING;
    }
    return status;
}

/* The direct estimate in the parameters of the instrumental one. */
static void borrow_estimate(const pmf_config_t *config, pmf_state_t *state)
{
    const pmf_auxiliary_config_t *auxiliary = &config->auxiliary;
    pmf_estimate_t *borrowed = &state->borrowed;
    uint32_t i;
    for (i = 0; i < PMF_ROLES; ++i) {
        if (auxiliary->index[i] != PMF_NO_PARAMETER && auxiliary->direct_index[i] != PMF_NO_PARAMETER) {
            borrowed->theta[auxiliary->index[i]] = state->direct.estimate.theta[auxiliary->direct_index[i]];
            borrowed->variance_factor[auxiliary->index[i]] =
                state->direct.estimate.variance_factor[auxiliary->direct_index[i]];
        }
    }
    pmf_clear(borrowed->inflation, (uint32_t)sizeof borrowed->inflation);
    borrowed->innovation = state->direct.estimate.innovation;
    borrowed->innovation_variance = state->direct.estimate.innovation_variance;
}

const pmf_estimate_t *pmf_estimate(const pmf_config_t *config, const pmf_state_t *state)
{
    if (config->linear.enabled != 0U) {
        return (state->status & PMF_FALLBACK) == 0U ? &state->instrument.estimate : &state->direct.estimate;
    }
    if (config->auxiliary.enabled == 0U) {
        return &state->direct.estimate;
    }
    return (state->status & PMF_FALLBACK) == 0U ? &state->instrument.estimate : &state->borrowed;
}

/* The instrumental estimate takes over once it knows the mass as well as the direct one, which has gathered longer. */
static uint32_t takes_over(const pmf_config_t *config, const pmf_state_t *state)
{
    real_t own = state->instrument.estimate.variance_factor[config->auxiliary.index[PMF_MASS]];
    real_t direct = state->direct.estimate.variance_factor[config->auxiliary.direct_index[PMF_MASS]];
    return state->instrument.started > 0U && (state->direct.started == 0U || own < TAKE_OVER * direct) ? 1U : 0U;
}

/* Instrumental variables where the auxiliary model follows the plant, else the direct estimate. */
static uint32_t instrument_step(const pmf_config_t *config, pmf_state_t *state, uint32_t direct_status, uint32_t settled)
{
    const pmf_auxiliary_config_t *auxiliary = &config->auxiliary;
    uint32_t trusted = pmf_auxiliary_check(auxiliary, &state->auxiliary, state->network.column);
    uint32_t status = PMF_STARTING;
    state->auxiliary.in_charge &= trusted;
    if (trusted == 0U) { /* what was gathered with a wrong direction would stay */
        pmf_clear(&state->instrument, (uint32_t)sizeof state->instrument);
    } else if (settled != 0U) {
        status = pmf_recursion_step(&config->instrument, &state->instrument, state->network.column);
    } else {
        status = state->instrument.started != 0U ? 0U : status;
    }
    if (trusted != 0U && state->auxiliary.in_charge == 0U) {
        state->auxiliary.in_charge = takes_over(config, state);
    }
    if (state->auxiliary.in_charge != 0U) {
        pmf_auxiliary_follow(auxiliary, &state->auxiliary, state->instrument.estimate.theta, auxiliary->index);
        return status;
    }
    if (state->direct.started != 0U && (direct_status & PMF_POOR_EXCITATION) == 0U &&
        (trusted == 0U || auxiliary->has_initial == 0U)) {
        pmf_auxiliary_follow(auxiliary, &state->auxiliary, state->direct.estimate.theta, auxiliary->direct_index);
    }
    borrow_estimate(config, state);
    return (direct_status & ~(uint32_t)PMF_COMPENSATION_HELD) | PMF_FALLBACK | (status & (PMF_RESET | PMF_UNMODELLED));
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

/* While the direct estimate is in charge, the model starts from it; and again, if that did not lead to a refined one
 * within twice the samples: the first copy may have been far off, with filters that settle too slowly. */
static void start_linear(const pmf_config_t *config, pmf_state_t *state)
{
    uint32_t wait = 2U * state->linear.since;
    wait = wait > config->linear.start_updates ? wait : config->linear.start_updates;
    if (state->direct.started > wait &&
        pmf_linear_start(&config->linear, &state->linear, state->direct.estimate.theta) != 0U) {
        state->linear.since = state->direct.started;
    }
}

/* Refined instrumental variables where the model of the linear process has settled, else the direct estimate. */
static uint32_t linear_step(const pmf_config_t *config, pmf_state_t *state, uint32_t direct_status, uint32_t settled)
{
    const pmf_linear_config_t *linear = &config->linear;
    uint32_t status = PMF_STARTING;
    if (pmf_linear_lost(&state->linear) != 0U) { /* begin again from the direct estimate */
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
        pmf_linear_follow(linear, &state->linear, state->instrument.estimate.theta);
        return status;
    }
    if ((direct_status & PMF_POOR_EXCITATION) == 0U) {
        start_linear(config, state);
    }
    return (direct_status & ~(uint32_t)PMF_COMPENSATION_HELD) | PMF_FALLBACK | (status & (uint32_t)PMF_RESET);
}

uint32_t pmf_step(const pmf_config_t *config, pmf_state_t *state, real_t input, uint32_t count)
{
    uint32_t status = pmf_filter(config, state, input, count);
    uint32_t settled = (status & PMF_SETTLING) == 0U ? 1U : 0U;
    uint32_t direct_status = state->direct.started == 0U ? (uint32_t)PMF_STARTING : 0U;
    /* with an auxiliary model the second half of the settling is the model's */
    if (settled != 0U || (config->auxiliary.enabled != 0U && state->settle < config->settle_samples / 2U)) {
        direct_status = pmf_recursion_step(&config->direct, &state->direct, state->network.column);
    }
    if (config->auxiliary.enabled != 0U) {
        status |= instrument_step(config, state, direct_status, settled);
    } else if (config->linear.enabled != 0U) {
        status |= linear_step(config, state, direct_status, settled);
    } else {
        status |= direct_status;
    }
    if ((status & PMF_RESET) != 0U) { /* a value beyond the number format may sit in the filters as well */
        pmf_clear(&state->network, (uint32_t)sizeof state->network);
        pmf_clear(&state->linear, (uint32_t)sizeof state->linear);
        pmf_auxiliary_start(&config->auxiliary, &state->auxiliary);
        state->auxiliary.velocity = PMF_R(0.0);
        state->auxiliary.position = PMF_R(0.0);
        state->settle = config->settle_samples;
    }
    state->status = status;
    return status;
}

void pmf_covariance_factor(const pmf_config_t *config, const pmf_state_t *state, real_t *p)
{
    uint32_t n = pmf_parameters(config), i;
    uint32_t two = config->auxiliary.enabled + config->linear.enabled;
    if (two == 0U || (config->linear.enabled != 0U && (state->status & PMF_FALLBACK) != 0U)) {
        pmf_recursion_covariance(&config->direct, &state->direct, p);
    } else if ((state->status & PMF_FALLBACK) == 0U) {
        pmf_recursion_covariance(&config->instrument, &state->instrument, p);
    } else {
        for (i = 0; i < n * n; ++i) {
            p[i] = i % (n + 1U) == 0U ? state->borrowed.variance_factor[i / (n + 1U)] : PMF_R(0.0);
        }
    }
}
