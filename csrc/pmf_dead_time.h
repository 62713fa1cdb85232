/* An input that acts late: what drives the axis in the interval that the counts speak of. For pmf_step.c alone.
 * SPDX-License-Identifier: Apache-2.0
 *
 * A dead time is whole samples and a part of one. The filters take the mean of the two inputs that share an interval,
 * which is all that an interval's mean acceleration depends on; the auxiliary model switches where it belongs.
 */
#ifndef PMF_DEAD_TIME_H
#define PMF_DEAD_TIME_H

#include "pmf_lag.h"

#if PMF_LATE

/* What was gathered while the dead time was further away [samples] was linearised too far from it: */
#define FAR_AWAY PMF_R(0.25)
#define ROOT_OF_FAR_AWAY PMF_R(0.25) /* the square of this of it counts on. */

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

/* After the encoder: its input is that of the interval before the last, as the other signals are. */
static void delay_input(const pmf_config_t *config, pmf_state_t *state)
{
    const pmf_late_config_t *late = &config->late;
    real_t *signal = state->network.node, *past = state->late.past, mean;
    real_t samples = dead_time_of(config, state) * late->rate;
    uint32_t kept = late->room + 2U, whole;
    state->late.at = state->late.at == 0U ? kept - 1U : state->late.at - 1U;
    past[state->late.at] = signal[PMF_LATE_INPUT];
    samples = samples > PMF_R(0.0) ? samples : PMF_R(0.0);
    samples = samples < (real_t)late->room ? samples : (real_t)late->room;
    whole = (uint32_t)samples;
    state->late.part = samples - (real_t)whole;
    state->late.older = past[(state->late.at + whole + 1U) % kept];
    state->late.newer = past[(state->late.at + whole) % kept];
#if PMF_WITH_LAG
    if (late->lags != 0U) {
        lag_input(late->decay, &state->late);
    }
#endif
    mean = state->late.newer + state->late.part * (state->late.older - state->late.newer);
    signal[PMF_LATE_INPUT] = mean;
    signal[PMF_INPUT] = signal[PMF_MOVING] * mean;
}

#if PMF_WITH_AUXILIARY
/* The regressor of the dead time is a derivative, taken at the model's own; the direct target counts from there. */
static void correct_direct(const pmf_config_t *config, const pmf_state_t *state, real_t *column)
{
    uint32_t index = config->auxiliary.direct_index[PMF_DELAY], first = config->direct.first_column;
    if (index != PMF_NO_PARAMETER) {
        column[first + config->direct.n_parameters] += state->auxiliary.parameter[PMF_DELAY] * column[first + index];
    }
}

static void follow_dead_time(const pmf_config_t *config, pmf_state_t *state)
{
    real_t now = state->auxiliary.parameter[PMF_DELAY];
    real_t apart = (now - state->late.gathered) * config->late.rate;
    if (config->auxiliary.index[PMF_DELAY] == PMF_NO_PARAMETER || apart * apart <= FAR_AWAY * FAR_AWAY) {
        return;
    }
    state->late.gathered = now;
    pmf_open(config, state, PMF_NO_PARAMETER, ROOT_OF_FAR_AWAY);
}
#endif

#endif
#endif
