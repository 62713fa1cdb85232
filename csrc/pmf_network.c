/* A network of first-order stages, and the columns tapped from the network.
 * SPDX-License-Identifier: Apache-2.0
 *
 * A chain of first-order stages keeps float32 accurate, while direct-form sections of the same filter lose three
 * digits at small pole * dt. */
#include "pmf_internal.h"

#if PMF_STEPS
/* Apply the trapezoidal rule over a step, with h as the pole times half the step. A stage whose source is an earlier
 * stage takes the source's preceding value from its node. The memory is for signals and for values of the auxiliary
 * model. */
static void follow_steps(const pmf_network_config_t *config, pmf_network_state_t *state)
{
    const pmf_rates_t *rates = &config->rates;
    const pmf_stage_t *stage = config->stage;
    real_t keep[PMF_MAX_RATES], gain[PMF_MAX_RATES], was[PMF_MAX_STAGES], square = state->cubes / state->time;
    real_t *node = &state->node[PMF_SIGNALS];
    uint32_t i;
    for (i = 0; i < config->n_rates; ++i) {
        real_t step = rates->now[i] * state->ratio + rates->before[i] * state->ratio_before;
        real_t h = rates->half[i] * step, inverse = PMF_R(1.0) / (PMF_R(1.0) + h);
        keep[i] = (rates->keep[i] - h) * inverse;
        gain[i] = (rates->gain[i] + rates->growth[i] * step + rates->square[i] * square) * inverse;
    }
    for (i = 0; i < config->n_stages; ++i, ++stage) {
        uint32_t rate = stage->rate;
        real_t now = state->node[stage->source], last = state->memory[i];
        was[i] = node[i];
        if (stage->source >= PMF_SIGNALS) {
            last = was[stage->source - PMF_SIGNALS];
        } else if (stage->b1 != PMF_SCALAR(0.0)) {
            state->memory[i] = now;
        }
        if (rate != 0U && stage->b1 != PMF_SCALAR(0.0)) {
            node[i] = gain[rate] * (stage->b0 * now + stage->b1 * last) + keep[rate] * was[i];
        } else if (rate != 0U) {
            node[i] = gain[rate] * (stage->b0 * now) + keep[rate] * was[i];
        } else if (stage->b1 != PMF_SCALAR(0.0)) {
            node[i] = last;
        } else { /* the auxiliary model has written the node */
            was[i] = state->memory[i];
            state->memory[i] = node[i];
        }
    }
}
#else
#define follow_steps(config, state) ((void)(state))
#endif

PMF_API void pmf_network_step(const pmf_network_config_t *config, pmf_network_state_t *state)
{
    const pmf_stage_t *stage = config->stage;
    const pmf_tap_t *tap = config->tap;
    uint32_t i, n_stages = config->n_stages;
    if (PMF_STEPS && config->n_rates != 0U) {
        follow_steps(config, state);
        n_stages = 0U;
    }
    for (i = 0; i < n_stages; ++i, ++stage) {
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
