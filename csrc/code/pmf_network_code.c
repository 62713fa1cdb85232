/* The network of an export, or of a method of many/pmf_method.h, as code. SPDX-License-Identifier: Apache-2.0 */
#include "pmf_internal.h"

#define DELAY(k, from)                       \
    {                                        \
        real_t w = node[from];               \
        node[PMF_SIGNALS + (k)] = memory[k]; \
        memory[k] = w;                       \
    }

#define COLUMN(c, from, weight) column[c] = (weight) * node[from];
#define TAP(c, from, weight) column[c] += (weight) * node[from];
/* Straight code with coefficients. A rise has the coefficient b1 = -b0. */
#define STAGE(k, from, a, b0, b1)                        \
    {                                                    \
        real_t w = node[from], y = (b0) * w + memory[k]; \
        memory[k] = (b1) * w + (a) * y;                  \
        node[PMF_SIGNALS + (k)] = y;                     \
    }
#define RISE(k, from, a, b0)                             \
    {                                                    \
        real_t x = (b0) * node[from], y = x + memory[k]; \
        memory[k] = (a) * y - x;                         \
        node[PMF_SIGNALS + (k)] = y;                     \
    }

PMF_API void pmf_network_step(const pmf_network_config_t *config, pmf_network_state_t *state)
{
    real_t *node = state->node, *memory = state->memory, *column = state->column;
    (void)config;
    PMF_STAGES(STAGE, RISE, DELAY)
    PMF_COLUMNS(COLUMN, TAP)
}
