/* A network of first-order stages, and the columns tapped from it.
 * SPDX-License-Identifier: Apache-2.0
 *
 * A chain of first-order stages keeps float32 accurate where direct-form sections of the same filter lose
 * three digits at small pole * dt.
 */
#include "pmf_internal.h"

#if PMF_STEPS
typedef struct {
    real_t keep, gain;
} pace_t;

/* (1 - h) / (1 + h) and what that makes of the gain: the trapezoidal rule over a step, h: pole times half the step. */
static pace_t pace_of(const pmf_rate_t *rate, real_t ratio, real_t before)
{
    real_t own = rate->late != 0U ? before : ratio, h = rate->half * own, inverse = PMF_R(1.0) / (PMF_R(1.0) + h);
    pace_t pace;
    if (rate->kind == PMF_BENDING) {
        pace.keep = PMF_R(0.0);
        pace.gain = PMF_R(0.5) * (ratio + before);
        return pace;
    }
    pace.keep = (PMF_R(1.0) - h) * inverse;
    pace.gain = (PMF_R(1.0) + rate->half) * inverse * (rate->kind == PMF_LASTING ? own : PMF_R(1.0));
    return pace;
}

/* `memory` has the source of the step before. */
static void follow_steps(const pmf_network_config_t *config, pmf_network_state_t *state)
{
    pace_t pace[PMF_MAX_RATES + 1];
    const pmf_stage_t *stage = config->stage;
    uint32_t i;
    pace[0].keep = PMF_R(0.0);
    pace[0].gain = PMF_R(1.0);
    for (i = 0; i < config->n_rates; ++i) {
        pace[i + 1U] = pace_of(&config->rate[i], state->ratio, state->ratio_before);
    }
    for (i = 0; i < config->n_stages; ++i, ++stage) {
        const pace_t *own = &pace[stage->rate];
        real_t w = state->node[stage->source], *y = &state->node[PMF_SIGNALS + i];
        *y = own->gain * (stage->b0 * w + stage->b1 * state->memory[i]) + own->keep * *y;
        state->memory[i] = w;
    }
}
#endif

PMF_API void pmf_network_step(const pmf_network_config_t *config, pmf_network_state_t *state)
{
    const pmf_stage_t *stage = config->stage;
    const pmf_tap_t *tap = config->tap;
    uint32_t i;
#if PMF_STEPS
    if (config->n_rates != 0U) {
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
