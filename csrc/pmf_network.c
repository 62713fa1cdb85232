/* A network of first-order stages, and the columns tapped from it.
 * SPDX-License-Identifier: Apache-2.0
 *
 * A chain of first-order stages keeps float32 accurate where direct-form sections of the same filter lose
 * three digits at small pole * dt.
 */
#include "pmf_internal.h"

#if PMF_STEPS
#if PMF_LAYOUT != 0U /* an export has just what it needs */
#define RATES(config) PMF_MAX_RATES
#define STAGES(config) PMF_MAX_STAGES
#else
#define RATES(config) (config)->n_rates
#define STAGES(config) (config)->n_stages
#endif

#define RECENT PMF_R(0.99609375) /* forgetting of steps: 256 samples */

/* Of the step, over time: long ones last longer. */
static real_t mean_square(pmf_network_state_t *state)
{
    real_t longest = (real_t)PMF_LONGEST, step = state->ratio < longest ? state->ratio : longest;
    state->time = RECENT * state->time + step;
    state->cubes = RECENT * state->cubes + step * step * step;
    return state->cubes / state->time;
}

/* The trapezoidal rule over a step, h: pole times half the step. `memory` has the source of the step before. */
static void follow_steps(const pmf_network_config_t *config, pmf_network_state_t *state)
{
    const pmf_rates_t *rates = &config->rates;
    real_t keep[PMF_MAX_RATES], gain[PMF_MAX_RATES], square = mean_square(state);
    uint32_t i;
    for (i = 0; i < RATES(config); ++i) {
        real_t step = rates->now[i] * state->ratio + rates->before[i] * state->ratio_before;
        real_t h = rates->half[i] * step, inverse = PMF_R(1.0) / (PMF_R(1.0) + h);
        keep[i] = (rates->keep[i] - h) * inverse;
        gain[i] = (rates->gain[i] + rates->growth[i] * step + rates->square[i] * square) * inverse;
    }
    for (i = 0; i < STAGES(config); ++i) {
        const pmf_stage_t *stage = &config->stage[i];
        real_t w = state->node[stage->source], *y = &state->node[PMF_SIGNALS + i];
        *y = gain[stage->rate] * (stage->b0 * w + stage->b1 * state->memory[i]) + keep[stage->rate] * *y;
        state->memory[i] = w;
    }
}
#endif

#ifdef PMF_NETWORK
/* Straight code where it is known which stages and taps there are: a list of them, in order. */
#define STAGE(k, from)                                          \
    {                                                           \
        real_t w = node[from], y = stage[k].b0 * w + memory[k]; \
        memory[k] = stage[k].b1 * w + stage[k].a * y;           \
        node[PMF_SIGNALS + (k)] = y;                            \
    }
#define DELAY(k, from)                       \
    {                                        \
        real_t w = node[from];               \
        node[PMF_SIGNALS + (k)] = memory[k]; \
        memory[k] = w;                       \
    }
#define COLUMN(c, t, from) column[c] = tap[t].weight * node[from];
#define TAP(c, t, from) column[c] += tap[t].weight * node[from];

PMF_API void pmf_network_step(const pmf_network_config_t *config, pmf_network_state_t *state)
{
    const pmf_stage_t *stage = config->stage;
    const pmf_tap_t *tap = config->tap;
    real_t *node = state->node, *memory = state->memory, *column = state->column;
    PMF_NETWORK(STAGE, DELAY, COLUMN, TAP)
}
#else
PMF_API void pmf_network_step(const pmf_network_config_t *config, pmf_network_state_t *state)
{
    const pmf_stage_t *stage = config->stage;
    const pmf_tap_t *tap = config->tap;
    uint32_t i;
#if PMF_STEPS
    if (PMF_STEPPED(config->n_rates != 0U)) {
        follow_steps(config, state);
    } else
#endif
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
#endif
