/* An input that acts late drives the axis in the interval of the counts. Only pmf_step.c includes this
 * file.
 * SPDX-License-Identifier: Apache-2.0
 *
 * A dead time is whole samples and a fraction of a sample. The filters take the mean of the two inputs that share an
 * interval, because the mean acceleration depends only on this mean. The auxiliary model switches at the right instant.
 */
#ifndef PMF_DEAD_TIME_H
#define PMF_DEAD_TIME_H

#include "pmf_lag.h"

#if PMF_LATE

static real_t dead_time_of(const pmf_config_t *config, const pmf_state_t *state)
{
#if PMF_WITH_AUXILIARY
    if (config->auxiliary.enabled != 0U) {
        return state->auxiliary.parameter[PMF_DELAY];
    }
#endif
    (void)state;
    return config->late.dead_time;
}

/* Find the inputs that act in the interval of the counts, after a dead time of `samples`. */
static void acts_behind(const pmf_late_config_t *late, const pmf_late_state_t *state, real_t samples, real_t *older,
                        real_t *newer, real_t *part)
{
    uint32_t kept = late->room + 2U, whole;
    samples = samples > PMF_R(0.0) ? samples : PMF_R(0.0);
    samples = samples < (real_t)late->room ? samples : (real_t)late->room;
    whole = (uint32_t)samples;
    *part = samples - (real_t)whole;
    *older = state->past[(state->at + whole + 1U) % kept];
    *newer = state->past[(state->at + whole) % kept];
}

/* Delay the input after the encoder. All signals of the encoder belong to the interval before the last. */
static void delay_input(const pmf_config_t *config, pmf_state_t *state)
{
    const pmf_late_config_t *late = &config->late;
    real_t *signal = state->network.node, mean;
    real_t samples = dead_time_of(config, state) * late->rate;
    state->late.at = state->late.at == 0U ? late->room + 1U : state->late.at - 1U;
    state->late.past[state->late.at] = signal[PMF_LATE_INPUT];
    acts_behind(late, &state->late, samples, &state->late.older, &state->late.newer, &state->late.part);
#if PMF_WITH_LAG
    if (late->lags != 0U) {
        lag_input(late->decay, &state->late);
    }
#endif
    mean = state->late.newer + state->late.part * (state->late.older - state->late.newer);
    signal[PMF_LATE_INPUT] = mean;
    signal[PMF_INPUT] = signal[PMF_MOVING] * mean;
}

#endif
#endif
