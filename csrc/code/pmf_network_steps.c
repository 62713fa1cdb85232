/* The network of an export with a varying step, as code. SPDX-License-Identifier: Apache-2.0 */
#include "pmf_internal.h"

#define COLUMN(c, from, weight) column[c] = (weight) * node[from];
#define TAP(c, from, weight) column[c] += (weight) * node[from];
/* Straight code with the constants of an export, whose rates are variables. A stage is a trapezoidal rule, perhaps with
 * a cancelled zero, a delay, or a value of the auxiliary model. `last` is the source's preceding value: was##i of an
 * earlier stage i, or the memory of a signal. */
#define STEPPED(k, value)                    \
    real_t was##k = node[PMF_SIGNALS + (k)]; \
    node[PMF_SIGNALS + (k)] = value;         \
    (void)was##k;
#define FOLLOW(k, from, last, b0, b1, gain, keep) \
    STEPPED(k, (gain) * ((b0) * node[from] + (b1) * (last)) + (keep) * was##k)
#define CANCELLED(k, from, b0, gain, keep) STEPPED(k, (gain) * ((b0) * node[from]) + (keep) * was##k)
#define DELAYED(k, last) STEPPED(k, last)
#define WRITTEN(k)               \
    real_t was##k = memory[k];   \
    REMEMBER(k, PMF_SIGNALS + k) \
    (void)was##k;
#define REMEMBER(k, from) memory[k] = node[from];
#define RATE(i, half, step, effect)                                               \
    real_t h##i = (half) * (step), inverse##i = PMF_R(1.0) / (PMF_R(1.0) + h##i); \
    real_t keep##i = (PMF_R(1.0) - h##i) * inverse##i, gain##i = (effect) * inverse##i;

PMF_API void pmf_network_step(const pmf_network_config_t *config, pmf_network_state_t *state)
{
    real_t *node = state->node, *memory = state->memory, *column = state->column;
    real_t now = state->ratio, before = state->ratio_before, square = state->cubes / state->time;
    PMF_RATES(RATE)
    (void)config;
    (void)now;
    (void)before;
    (void)square;
    (void)memory;
    PMF_STAGES(FOLLOW, CANCELLED, DELAYED, WRITTEN, REMEMBER)
    PMF_COLUMNS(COLUMN, TAP)
}
