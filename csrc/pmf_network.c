/* A network of first-order stages, and the columns tapped from the network.
 * SPDX-License-Identifier: Apache-2.0
 *
 * A chain of first-order stages keeps float32 accurate, while direct-form sections of the same filter lose three
 * digits at small pole * dt. */
#include "pmf_internal.h"

#if PMF_STEPS
static const scalar_t RECENT = PMF_SCALAR(0.99609375); /* forgetting of steps, a memory of 256 samples */

/* Return the mean square of the step over time, in which long steps have more weight. */
static real_t mean_square(pmf_network_state_t *state)
{
    real_t longest = (real_t)PMF_LONGEST, step = state->ratio < longest ? state->ratio : longest;
    state->time = RECENT * state->time + step;
    state->cubes = RECENT * state->cubes + step * step * step;
    return state->cubes / state->time;
}
#endif

#define DELAY(k, from)                       \
    {                                        \
        real_t w = node[from];               \
        node[PMF_SIGNALS + (k)] = memory[k]; \
        memory[k] = w;                       \
    }

#if !PMF_WITH_NETWORK
#define COLUMN(c, from, weight) column[c] = (weight) * node[from];
#define TAP(c, from, weight) column[c] += (weight) * node[from];
#endif

#if !PMF_WITH_NETWORK && PMF_STEPS
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
    real_t now = state->ratio, before = state->ratio_before, square = mean_square(state);
    PMF_RATES(RATE)
    (void)config;
    (void)now;
    (void)before;
    (void)square;
    (void)memory;
    PMF_STAGES(FOLLOW, CANCELLED, DELAYED, WRITTEN, REMEMBER)
    PMF_COLUMNS(COLUMN, TAP)
}
#elif !PMF_WITH_NETWORK
/* Straight code with the constants of an export. A rise has the coefficient b1 = -b0. */
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
#elif defined(PMF_NETWORK)
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
#else
#if PMF_STEPS
/* Apply the trapezoidal rule over a step, with h as the pole times half the step. A stage whose source is an earlier
 * stage takes the source's preceding value from its node. The memory is for signals and for values of the auxiliary
 * model. */
static void follow_steps(const pmf_network_config_t *config, pmf_network_state_t *state)
{
    const pmf_rates_t *rates = &config->rates;
    const pmf_stage_t *stage = config->stage;
    real_t keep[PMF_MAX_RATES], gain[PMF_MAX_RATES], was[PMF_MAX_STAGES], square = mean_square(state);
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
#endif

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
