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

/* Distance [samples] from the accepted dead time at which sums count less, because of their linearisation. */
#define FAR_AWAY PMF_R(0.25)
#define ROOT_OF_ANOTHER \
    PMF_R(0.1) /* root of the weight of distant sums after a second look of the motion within the counts */
#define ROOT_OF_FAR_AWAY PMF_R(0.25) /* root of the weight of distant sums without a second look */

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

#if PMF_WITH_AUXILIARY
/* The regressor of the dead time is a derivative at the model's dead time, from which the direct target counts. */
static void correct_direct(const pmf_config_t *config, const pmf_state_t *state, real_t *column)
{
    uint32_t index = config->auxiliary.direct_index[PMF_DELAY], first = config->direct.first_column;
    if (index != PMF_NO_PARAMETER) {
        column[first + config->direct.n_parameters] += state->auxiliary.parameter[PMF_DELAY] * column[first + index];
    }
}

#if PMF_FOUND
#define APART PMF_R(4.0) /* contradiction [standard deviations] of the dead time */
#define HALF PMF_R(0.5) /* least standard deviation [samples] of a dead time that is held */
#define GUESSED PMF_R(5.0) /* a dead time is unknown above this multiple of WELL_KNOWN */
#define WELL_KNOWN PMF_R(0.1) /* standard deviation [samples] below which the recursion knows the dead time well */

static real_t within_reach(const pmf_late_config_t *late, real_t dead_time)
{
    real_t most = (real_t)late->room / late->rate;
    dead_time = dead_time > PMF_R(0.0) ? dead_time : PMF_R(0.0);
    return dead_time < most ? dead_time : most;
}

/* Move the estimate to another dead time in the direction given by the covariance. A positive variance of the other
 * dead time replaces the recursion's variance. */
static void move_to(const pmf_recursion_state_t *own, uint32_t p, real_t dead_time, real_t variance,
                    pmf_estimate_t *believed)
{
    real_t along[PMF_MAX_PARAMETERS], unsure = own->inverse_pivot[p - 1U];
    real_t apart = dead_time - own->estimate.theta[p - 1U];
    uint32_t i = p, j;
    while (i > 0U) {
        --i;
        along[i] = i == p - 1U ? PMF_R(1.0) : PMF_R(0.0);
        for (j = i + 1U; j < p; ++j) {
            along[i] -= own->factor[j][i] * along[j];
        }
        believed->theta[i] += along[i] * apart;
        if (variance > PMF_R(0.0) && believed->innovation_variance > PMF_R(0.0)) {
            real_t inflation = believed->inflation[i] > PMF_R(0.0) ? believed->inflation[i] : PMF_R(1.0), left;
            left = believed->variance_factor[i] - along[i] * along[i] * unsure;
            left = left > PMF_R(0.0) ? left : PMF_R(0.0);
            believed->variance_factor[i] =
                left + along[i] * along[i] * variance / (believed->innovation_variance * inflation);
        }
    }
    believed->theta[p - 1U] = dead_time;
}

/* Choose the dead time from the best source, in this order: the motion within the counts, a certain recursion, the last
 * accepted value, any recursion. `own` is the active recursion. */
static void believe(const pmf_config_t *config, pmf_state_t *state, const pmf_recursion_state_t *own, uint32_t p)
{
    const pmf_late_config_t *late = &config->late;
    const pmf_estimate_t *estimate = &own->estimate;
    pmf_found_state_t *found = &state->found;
    uint32_t had = found->believes;
    real_t dead_time = estimate->theta[p - 1U], variance = PMF_R(0.0), limit = WELL_KNOWN / late->rate, inflation;
    inflation = estimate->inflation[p - 1U] > PMF_R(0.0) ? estimate->inflation[p - 1U] : PMF_R(1.0);
    if (late->within != 0U && pmf_within_known(config, state, &variance) != 0U) {
        found->believes = PMF_BELIEVES_WITHIN;
        found->tries = 0U;
        dead_time = found->theta[config->auxiliary.index[PMF_DELAY]];
    } else {
        variance = estimate->variance_factor[p - 1U] * estimate->innovation_variance * inflation;
        found->believes = had == PMF_BELIEVES_NONE ? PMF_BELIEVES_NONE : PMF_BELIEVES_HELD;
        if (had == PMF_BELIEVES_OWN || had == PMF_BELIEVES_NONE) { /* sums from another dead time do not count */
            found->believes = variance > PMF_R(0.0) && variance < limit * limit ? PMF_BELIEVES_OWN : PMF_BELIEVES_NONE;
        }
        dead_time = found->believes == PMF_BELIEVES_HELD ? found->dead_time : dead_time;
        if (found->believes == PMF_BELIEVES_NONE && !(variance < GUESSED * GUESSED * limit * limit)) {
            dead_time = (real_t)found->tries / late->rate; /* a few samples are safer than an arbitrary number */
        }
        limit = found->believes == PMF_BELIEVES_HELD ? HALF / late->rate : PMF_R(0.0);
        variance = variance > limit * limit ? PMF_R(0.0) : limit * limit;
    }
    found->dead_time = within_reach(late, dead_time);
    pmf_copy(estimate, &found->believed, (uint32_t)sizeof found->believed);
    move_to(own, p, found->dead_time, variance, &found->believed);
}

/* Return P (n x n) at the accepted dead time, with the known variance in place of the recursion's */
static void covariance_there(const pmf_recursion_config_t *config, const pmf_recursion_state_t *own,
                             const pmf_estimate_t *believed, real_t *p)
{
    uint32_t n = config->n_parameters, last = n - 1U, i, j;
    real_t unsure = p[last * n + last], now = believed->variance_factor[last] * believed->inflation[last];
    real_t along[PMF_MAX_PARAMETERS];
    if (!(unsure > PMF_R(0.0)) || believed->variance_factor[last] == own->estimate.variance_factor[last]) {
        return;
    }
    for (i = 0; i < n; ++i) {
        along[i] = p[i * n + last] / unsure;
    }
    for (i = 0; i < n; ++i) {
        for (j = 0; j < n; ++j) {
            real_t inflation = PMF_R(0.5) * (believed->inflation[i] + believed->inflation[j]);
            p[i * n + j] += along[i] * along[j] * (now / inflation - unsure);
        }
    }
}

/* Return whether the active recursion contradicts the dead time. */
static uint32_t contradicted(const pmf_config_t *config, const pmf_state_t *state)
{
    const pmf_estimate_t *own = &state->instrument.estimate;
    uint32_t last = config->instrument.n_parameters - 1U;
    real_t apart = own->theta[last] - state->found.dead_time, variance;
    real_t inflation = own->inflation[last] > PMF_R(1.0) ? own->inflation[last] : PMF_R(1.0);
    variance = own->innovation_variance * inflation *
               (own->variance_factor[last] + state->found.believed.variance_factor[last]);
    return state->auxiliary.in_charge != 0U && variance > PMF_R(0.0) && apart * apart > APART * APART * variance ? 1U
                                                                                                                 : 0U;
}

/* Step the sources of the dead time, and flag an unknown dead time. */
static whole_t find_dead_time(const pmf_config_t *config, pmf_state_t *state, uint32_t settled, uint32_t in_charge)
{
    pmf_found_state_t *found = &state->found;
    if (config->late.within != 0U) {
        real_t samples = found->theta[config->instrument.n_parameters - 1U] * config->late.rate;
        acts_t acts;
        acts_behind(&config->late, &state->late, samples, &acts.older, &acts.newer, &acts.part);
        pmf_within_step(config, state, &acts, settled);
    }
    if (in_charge != 0U) {
        believe(config, state, &state->instrument, config->instrument.n_parameters);
    } else {
        believe(config, state, &state->direct, config->direct.n_parameters);
        if (found->looks != 0U && found->believes >= PMF_BELIEVES_HELD && state->auxiliary.trusted == 0U) {
            pmf_within_lend(config, state);
        }
    }
    return found->believes <= PMF_BELIEVES_HELD || contradicted(config, state) != 0U ? (whole_t)PMF_DEAD_TIME
                                                                                     : PMF_W(0);
}

/* Give the slow copy the accepted dead time at once, and reduce the weight of sums from a distant one. */
static void follow_dead_time(const pmf_config_t *config, pmf_state_t *state)
{
    real_t *copied = &state->auxiliary.parameter[PMF_DELAY], apart;
    if (config->late.found == 0U) {
        return;
    }
    if (state->found.believes == PMF_BELIEVES_HELD || state->found.believes == PMF_BELIEVES_WITHIN) {
        *copied = state->found.dead_time;
    }
    *copied = within_reach(&config->late, *copied);
    apart = (*copied - state->late.gathered) * config->late.rate;
    if (apart * apart <= FAR_AWAY * FAR_AWAY) {
        return;
    }
    state->late.gathered = *copied;
    pmf_open(config, state, PMF_NO_PARAMETER, state->found.looks != 0U ? ROOT_OF_ANOTHER : ROOT_OF_FAR_AWAY);
}
#endif
#endif

#endif
#endif
