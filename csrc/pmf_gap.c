/* Lost samples: the motion restarts, and the sums of the estimate stay. SPDX-License-Identifier: Apache-2.0 */
#include "pmf_internal.h"

/* The counter shows the distance during the gap unless the counter wrapped. The next samples show the velocity. */
static void begin_encoder(const pmf_encoder_config_t *config, pmf_encoder_state_t *state, uint32_t count)
{
    uint32_t mask = config->count_mask, half = (mask >> 1) + 1U, moved = (count - state->count) & mask;
    if (PMF_WITH_SPLIT) {
        state->travel = (state->travel + (moved < half ? moved : moved - mask - 1U)) & 0xffffffffU;
        state->change = 0;
    }
    state->count = count;
#if PMF_STEPS
    state->ratio = state->ratio_before = PMF_R(1.0);
#endif
    state->started = 0U;
    state->idle = 0U;
    state->fast = 0U;
    state->position = PMF_R(0.5);
    pmf_clear(&state->misread, (uint32_t)sizeof state->misread);
    state->velocity = state->velocity_before = state->innovation = state->mean_velocity = PMF_R(0.0);
}

void pmf_gap(const pmf_config_t *config, pmf_state_t *state, uint32_t count)
{
    begin_encoder(&config->encoder, &state->encoder, count);
    pmf_clear(&state->network, (uint32_t)sizeof state->network);
    state->settle = config->settle_samples;
    state->hold = 0U;
    if (PMF_GUARDED(config)) {
        pmf_guard_gap(state);
    }
    if (PMF_MODELLED(config)) {
        pmf_instrument_gap(config, state);
    }
}

void pmf_doubt(const pmf_config_t *config, pmf_state_t *state, uint32_t samples)
{
    samples = samples < config->settle_samples ? samples : config->settle_samples;
    samples += config->encoder.guard != 0U ? (uint32_t)PMF_AHEAD : 0U; /* first come those that the guard holds */
    state->hold = samples > state->hold ? samples : state->hold;
}

void pmf_rebase(pmf_state_t *state, uint32_t count)
{
    if (PMF_WITH_GUARD == 0 || pmf_guard_rebase(state, count) == 0U) {
        state->encoder.count = count;
    }
}
