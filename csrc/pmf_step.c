/* The step of one sample through encoder, network and recursion. SPDX-License-Identifier: Apache-2.0 */
#include "pmf_internal.h"

#include "pmf_bytes.inl"
#include "pmf_late.inl"
#include "pmf_steps.inl"

PMF_API void pmf_init(const pmf_config_t *config, pmf_state_t *state)
{
    pmf_clear(state, (uint32_t)sizeof *state);
    state->settle = PMF_W(config->first_samples);
    state->encoder.idle = PMF_W(config->encoder.standstill_samples); /* at rest until a count shows a motion */
    if (PMF_MODELLED(config)) {
        pmf_instrument_restart(config, state);
    }
    begin_steps(state);
}

PMF_API uint32_t pmf_parameters(const pmf_config_t *config)
{
    return PMF_MODELLED(config) ? pmf_instrument_parameters(config) : config->direct.n_parameters;
}

/* Clear the filters, which may hold infinite values. */
static void restart_filters(const pmf_config_t *config, pmf_state_t *state)
{
    pmf_clear(&state->network, (uint32_t)sizeof state->network);
    state->settle = PMF_W(config->settle_samples);
    if (PMF_MODELLED(config)) {
        pmf_instrument_restart(config, state);
    }
}

PMF_API void pmf_clear_traces(truth_t looks, real_t *value, uint32_t values)
{
    uint32_t i;
    for (i = 0; PMF_ANY(looks) && i < values; ++i) {
        value[i] = PMF_IF(looks & (PMF_SIZE(value[i]) < PMF_TINY), PMF_R(0.0), value[i]);
    }
}

/* Run encoder, auxiliary model and network on a sample that the guard has passed. */
static whole_t filter_sample(const pmf_config_t *config, pmf_state_t *state, real_t input, whole_t count)
{
    whole_t status = pmf_encoder_step(&config->encoder, &state->encoder, input, count, state->network.node);
    truth_t settling, looks;
    if (PMF_ANY(state->hold > 0U)) {
        state->hold -= PMF_BIT(state->hold > 0U, 1U);
    }
    delay_input(config, state);
    if (PMF_SHAPED) {
        pmf_shapes_measured(config, state->network.node);
    }
    if (PMF_MODELLED(config)) {
        pmf_instrument_simulate(config, state);
    }
    pass_step(config, state);
    pmf_network_step(&config->network, &state->network);
    looks = (state->samples & (PMF_CLEARED - 1U)) == 0U;
    state->samples += 1U;
    pmf_clear_traces(looks, state->network.memory, PMF_MAX_STAGES);
    if (PMF_MODELLED(config)) {
        pmf_instrument_correct(config, state, looks);
    }
    state->settle = PMF_IF((status & PMF_SETTLING) != 0U, PMF_W(config->settle_samples), state->settle);
    settling = state->settle > 0U;
    if (PMF_ANY(settling)) {
        if (PMF_MODELLED(config)) {
            pmf_instrument_settle(config, state, settling);
        }
        state->settle -= PMF_BIT(settling, 1U);
        status |= PMF_BIT(settling, PMF_SETTLING);
    }
    status |= PMF_BIT(state->hold > 0U, PMF_SETTLING);
    return status;
}

/* Run the recursions on the columns of this sample, unless the filters settle. */
static whole_t estimate_step(const pmf_config_t *config, pmf_state_t *state, whole_t filtered)
{
    whole_t status = PMF_BIT(state->direct.started == 0U, PMF_STARTING), stepped = PMF_W(0);
    truth_t settled = (filtered & PMF_SETTLING) == 0U, use = settled, due;
    if (PMF_MODELLED(config)) { /* the second half of the settling belongs to the model */
        use = use | ((state->hold == 0U) & (state->settle < config->settle_samples / 2U));
    }
    due = (state->samples & (config->direct.every - 1U)) == 0U;
    PMF_WHERE(use, &state->direct,
              stepped = pmf_recursion_step(&config->direct, &state->direct, state->network.column, due));
    status = PMF_IF(use, stepped, status) | judge_bursts(config, state);
    if (PMF_MODELLED(config)) {
        status = pmf_instrument_step(config, state, status, settled);
    }
    return status;
}

static whole_t step_sample(const pmf_config_t *config, pmf_state_t *state, real_t input, whole_t count, whole_t guarded)
{
    whole_t status = filter_sample(config, state, input, count) | guarded;
#if PMF_PROCESS
    state->direct.lift = config->direct.lift * PMF_TO_REAL(state->encoder.first);
#endif
    status |= estimate_step(config, state, status);
    PMF_WHERE((status & PMF_RESET) != 0U, state, restart_filters(config, state));
    state->status = status;
    if (PMF_LIFTS(config)) {
        pmf_lift(config, state);
    }
    return status;
}

/* Return the status while the guard waits for its first counts. The estimate stays. */
static whole_t waiting(const pmf_state_t *state)
{
    return (state->status & (uint32_t)PMF_FALLBACK) | PMF_SETTLING | PMF_BIT(state->direct.started == 0U, PMF_STARTING);
}

PMF_API whole_t pmf_filter(const pmf_config_t *config, pmf_state_t *state, real_t input, whole_t count)
{
    whole_t guarded = PMF_W(0), status = PMF_W(0);
    if (PMF_GUARDED(config)) {
        truth_t ready = pmf_guard_sample(config, state, &input, &count, &guarded);
        PMF_WHERE(ready, state, status = filter_sample(config, state, input, count));
        return PMF_IF(ready, status | guarded, waiting(state));
    }
    return filter_sample(config, state, input, count);
}

PMF_API whole_t pmf_step(const pmf_config_t *config, pmf_state_t *state, real_t input, whole_t count)
{
    whole_t guarded = PMF_W(0);
    if (PMF_GUARDED(config)) {
        truth_t ready = pmf_guard_sample(config, state, &input, &count, &guarded);
        state->status = PMF_IF(ready, state->status, waiting(state));
        PMF_WHERE(ready, state, (void)step_sample(config, state, input, count, guarded));
        return state->status;
    }
    return step_sample(config, state, input, count, guarded);
}
