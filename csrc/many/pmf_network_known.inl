/* The network of a method of pmf_method.h, as code. SPDX-License-Identifier: Apache-2.0 */

#define DELAY(k, from)                       \
    {                                        \
        real_t w = node[from];               \
        node[PMF_SIGNALS + (k)] = memory[k]; \
        memory[k] = w;                       \
    }

/* Straight code for known stages and taps, listed in order. */
#define COLUMN(c, t, from) column[c] = tap[t].weight * node[from];
#define TAP(c, t, from) column[c] += tap[t].weight * node[from];
#define STAGE(k, from)                                          \
    {                                                           \
        real_t w = node[from], y = stage[k].b0 * w + memory[k]; \
        memory[k] = stage[k].b1 * w + stage[k].a * y;           \
        node[PMF_SIGNALS + (k)] = y;                            \
    }

PMF_API void pmf_network_step(const pmf_network_config_t *config, pmf_network_state_t *state)
{
    const pmf_stage_t *stage = config->stage;
    const pmf_tap_t *tap = config->tap;
    real_t *node = state->node, *memory = state->memory, *column = state->column;
    PMF_NETWORK(STAGE, DELAY, COLUMN, TAP)
}
