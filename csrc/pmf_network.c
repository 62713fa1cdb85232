/* A network of first-order stages, and the columns tapped from it.
 * SPDX-License-Identifier: Apache-2.0
 *
 * A chain of first-order stages keeps float32 accurate where direct-form sections of the same filter lose
 * three digits at small pole * dt.
 */
#include "pmf_internal.h"

PMF_API void pmf_network_step(const pmf_network_config_t *config, pmf_network_state_t *state)
{
    const pmf_stage_t *stage = config->stage;
    const pmf_tap_t *tap = config->tap;
    uint32_t i;
    for (i = 0; i < config->n_stages; ++i, ++stage) {
        real_t w = state->node[stage->source];
        real_t y = stage->b0 * w + state->memory[i];
        state->memory[i] = stage->b1 * w + stage->a * y;
        state->node[PMF_SIGNALS + i] = y;
    }
    for (i = 0; i < config->n_columns; ++i) {
        const pmf_tap_t *end = &config->tap[config->tap_end[i]];
        real_t sum = tap->weight * state->node[tap->node]; /* every column has a tap */
        for (++tap; tap != end; ++tap) {
            sum += tap->weight * state->node[tap->node];
        }
        state->column[i] = sum;
    }
}
