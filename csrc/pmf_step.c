/* One sample straight through: encoder, network, recursion.
 * SPDX-License-Identifier: Apache-2.0
 */
#include "pmf.h"

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
    state->settle = config->settle_samples;
    state->encoder.idle = config->encoder.standstill_samples; /* at rest until a count says otherwise */
}

uint32_t pmf_filter(const pmf_config_t *config, pmf_state_t *state, real_t input, uint32_t count)
{
    uint32_t status =
        pmf_encoder_step(&config->encoder, &state->encoder, input, count, state->network.node);
    pmf_network_step(&config->network, &state->network);
    if ((status & (PMF_INVALID_INPUT | PMF_COUNT_JUMP)) != 0U) {
        state->settle = config->settle_samples;
    }
    if (state->settle > 0U) {
        state->settle -= 1U;
        status |= PMF_SETTLING;
    }
    return status;
}

uint32_t pmf_step(const pmf_config_t *config, pmf_state_t *state, real_t input, uint32_t count)
{
    uint32_t status = pmf_filter(config, state, input, count);
    if ((status & PMF_SETTLING) != 0U) {
        status |= state->recursion.started == 0U ? (uint32_t)PMF_STARTING : 0U;
    } else {
        status |= pmf_recursion_step(&config->recursion, &state->recursion, state->network.column);
    }
    if ((status & PMF_RESET) != 0U) { /* a value beyond the number format may sit in the filters as well */
        pmf_clear(&state->network, (uint32_t)sizeof state->network);
        state->settle = config->settle_samples;
    }
    state->status = status;
    return status;
}
