/* The axis of an export with edges. SPDX-License-Identifier: Apache-2.0 */
#include "pmf_internal.h"

#include "pmf_bytes.inl"

void pmf_init(const pmf_config_t *config, pmf_state_t *state)
{
    pmf_clear(state, (uint32_t)sizeof *state);
    pmf_redge_init(config, &state->edge, state->line);
}

uint32_t pmf_plausible(const pmf_config_t *config, const pmf_state_t *state)
{
    return pmf_redge_plausible(config, &state->edge, state->line);
}

void pmf_rebase(pmf_state_t *state, uint32_t count)
{
    state->edge.count = count;
}

uint32_t pmf_step(const pmf_config_t *config, pmf_state_t *state, real_t input, uint32_t count, real_t age)
{
    return pmf_redge_step(config, &state->edge, state->line, input, count, age);
}

const pmf_estimate_t *pmf_estimate(const pmf_config_t *config, const pmf_state_t *state)
{
    (void)config;
    return &state->edge;
}

real_t pmf_variance(const pmf_config_t *config, const pmf_state_t *state, uint32_t parameter)
{
    (void)config;
    return state->edge.variance[parameter];
}
