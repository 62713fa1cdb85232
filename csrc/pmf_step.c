/* One sample straight through: encoder, network, recursion.
 * SPDX-License-Identifier: Apache-2.0
 */
#include "pmf.h"

#define TAKE_OVER PMF_R(1.5)

PMF_API void pmf_clear(void *memory, uint32_t size)
{
    unsigned char *byte = (unsigned char *)memory;
    uint32_t i;
    for (i = 0; i < size; ++i) {
        byte[i] = 0;
    }
}

PMF_API void pmf_init(const pmf_config_t *config, pmf_state_t *state)
{
    pmf_clear(state, (uint32_t)sizeof *state);
    state->settle = PMF_W(config->settle_samples);
    state->encoder.idle = PMF_W(config->encoder.standstill_samples); /* at rest until a count says otherwise */
    pmf_auxiliary_start(&config->auxiliary, &state->auxiliary);
}

PMF_API uint32_t pmf_parameters(const pmf_config_t *config)
{
    return config->auxiliary.enabled != 0U ? config->instrument.n_parameters : config->direct.n_parameters;
}

PMF_API whole_t pmf_filter(const pmf_config_t *config, pmf_state_t *state, real_t input, whole_t count)
{
    whole_t status =
        pmf_encoder_step(&config->encoder, &state->encoder, input, count, state->network.node);
    truth_t settling;
    if (config->auxiliary.enabled != 0U) {
        PMF_WHERE(state->auxiliary.running != 0U, state,
                  pmf_auxiliary_step(&config->auxiliary, &state->auxiliary, state->network.node));
    }
    pmf_network_step(&config->network, &state->network);
    if (config->auxiliary.enabled != 0U) {
        pmf_auxiliary_correct(&config->auxiliary, &state->auxiliary, state->network.column);
    }
    state->settle = PMF_IF((status & (PMF_INVALID_INPUT | PMF_COUNT_JUMP)) != 0U, PMF_W(config->settle_samples),
                           state->settle);
    settling = state->settle > 0U;
    if (PMF_ANY(settling)) {
        if (config->auxiliary.enabled != 0U) {
            /* by now the measured velocity is known: the model need not run up to it with its own time constant */
            truth_t half_way = settling & (state->settle == config->settle_samples / 2U);
            state->auxiliary.velocity = PMF_IF(half_way, state->network.column[config->auxiliary.check_column],
                                               state->auxiliary.velocity);
            state->auxiliary.position =
                PMF_IF(half_way, state->network.node[PMF_LATE_POSITION], state->auxiliary.position);
        }
        state->settle -= PMF_BIT(settling, 1U);
        status |= PMF_BIT(settling, PMF_SETTLING);
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

#ifndef PMF_LANES /* of one axis */
PMF_API const pmf_estimate_t *pmf_estimate(const pmf_config_t *config, const pmf_state_t *state)
{
    if (config->auxiliary.enabled == 0U) {
        return &state->direct.estimate;
    }
    return (state->status & PMF_FALLBACK) == 0U ? &state->instrument.estimate : &state->borrowed;
}
#endif

/* The instrumental estimate takes over once it knows the mass as well as the direct one, which has gathered longer. */
static truth_t takes_over(const pmf_config_t *config, const pmf_state_t *state)
{
    real_t own = state->instrument.estimate.variance_factor[config->auxiliary.index[PMF_MASS]];
    real_t direct = state->direct.estimate.variance_factor[config->auxiliary.direct_index[PMF_MASS]];
    return (state->instrument.started > 0U) & ((state->direct.started == 0U) | (own < TAKE_OVER * direct));
}

/* Instrumental variables where the auxiliary model follows the plant, else the direct estimate. */
static whole_t instrument_step(const pmf_config_t *config, pmf_state_t *state, whole_t direct_status, truth_t settled)
{
    const pmf_auxiliary_config_t *auxiliary = &config->auxiliary;
    truth_t trusted = pmf_auxiliary_check(auxiliary, &state->auxiliary, state->network.column), in_charge, borrows;
    /* a restart keeps theta */
    truth_t used = (state->instrument.updates != 0U) |
                   (state->instrument.estimate.theta[auxiliary->index[PMF_MASS]] != PMF_R(0.0));
    whole_t status, stepped = PMF_W(0);
    /* what was gathered with a wrong direction would stay */
    PMF_WHERE(PMF_NOT(trusted) & used, &state->instrument,
              pmf_clear(&state->instrument, (uint32_t)sizeof state->instrument));
    status = PMF_BIT(PMF_NOT(trusted) | (state->instrument.started == 0U), PMF_STARTING);
    PMF_WHERE(trusted & settled, &state->instrument,
              stepped = pmf_recursion_step(&config->instrument, &state->instrument, state->network.column));
    status = PMF_IF(trusted & settled, stepped, status);
    in_charge = trusted & (state->auxiliary.in_charge != 0U);
    if (PMF_ANY(trusted & PMF_NOT(in_charge))) {
        in_charge = in_charge | (trusted & takes_over(config, state));
    }
    state->auxiliary.in_charge = PMF_BIT(in_charge, 1U);
    pmf_auxiliary_follow(auxiliary, &state->auxiliary, in_charge, state->instrument.estimate.theta, auxiliary->index);
    if (PMF_ALL(in_charge)) {
        return status;
    }
    borrows = PMF_NOT(in_charge) & (state->direct.started != 0U) & ((direct_status & PMF_POOR_EXCITATION) == 0U);
    if (auxiliary->has_initial != 0U) {
        borrows = borrows & PMF_NOT(trusted);
    }
    pmf_auxiliary_follow(auxiliary, &state->auxiliary, borrows, state->direct.estimate.theta, auxiliary->direct_index);
    PMF_WHERE(PMF_NOT(in_charge), &state->borrowed, borrow_estimate(config, state));
    direct_status = (direct_status & ~(uint32_t)PMF_COMPENSATION_HELD) | PMF_FALLBACK;
    return PMF_IF(in_charge, status, direct_status | (status & (PMF_RESET | PMF_UNMODELLED)));
}

PMF_API whole_t pmf_step(const pmf_config_t *config, pmf_state_t *state, real_t input, whole_t count)
{
    whole_t status = pmf_filter(config, state, input, count), stepped = PMF_W(0);
    truth_t settled = (status & PMF_SETTLING) == 0U, runs = settled, reset;
    whole_t direct_status = PMF_BIT(state->direct.started == 0U, PMF_STARTING);
    if (config->auxiliary.enabled != 0U) { /* the second half of the settling is the model's */
        runs = runs | (state->settle < config->settle_samples / 2U);
    }
    PMF_WHERE(runs, &state->direct,
              stepped = pmf_recursion_step(&config->direct, &state->direct, state->network.column));
    direct_status = PMF_IF(runs, stepped, direct_status);
    if (config->auxiliary.enabled != 0U) {
        status |= instrument_step(config, state, direct_status, settled);
    } else {
        status |= direct_status;
    }
    reset = (status & PMF_RESET) != 0U;
    if (PMF_ANY(reset)) { /* a value beyond the number format may sit in the filters as well */
        PMF_WHERE(reset, &state->network, pmf_clear(&state->network, (uint32_t)sizeof state->network));
        PMF_WHERE(reset, &state->auxiliary, pmf_auxiliary_start(&config->auxiliary, &state->auxiliary));
        state->auxiliary.velocity = PMF_IF(reset, PMF_R(0.0), state->auxiliary.velocity);
        state->auxiliary.position = PMF_IF(reset, PMF_R(0.0), state->auxiliary.position);
        state->settle = PMF_IF(reset, PMF_W(config->settle_samples), state->settle);
    }
    state->status = status;
    return status;
}

#ifndef PMF_LANES
PMF_API void pmf_covariance_factor(const pmf_config_t *config, const pmf_state_t *state, real_t *p)
{
    uint32_t n = pmf_parameters(config), i;
    if (config->auxiliary.enabled == 0U) {
        pmf_recursion_covariance(&config->direct, &state->direct, p);
    } else if ((state->status & PMF_FALLBACK) == 0U) {
        pmf_recursion_covariance(&config->instrument, &state->instrument, p);
    } else {
        for (i = 0; i < n * n; ++i) {
            p[i] = i % (n + 1U) == 0U ? state->borrowed.variance_factor[i / (n + 1U)] : PMF_R(0.0);
        }
    }
}
#endif
