/* Verdicts from the auxiliary model's errors on an input that follows the encoder's errors, or that acts late.
 * SPDX-License-Identifier: Apache-2.0
 *
 * Both verdicts are correlations of known values, sample by sample, and each gives one bit of the status. */
#include "pmf_internal.h"

static const scalar_t SURE = PMF_SCALAR(9.0); /* least evidence against chance: three standard deviations */
/* A controller answers a step of the encoder's error, which is in the change of the velocity residual. The limit is the
 * squared correlation with this change of the input and the next one: 0 in open loop, and 0.2 to 1 under control where
 * the encoder is coarse enough to move the mass. */
static const scalar_t FEEDBACK_PART = PMF_SCALAR(0.2);
static const scalar_t FEEDBACK_MEMORY = PMF_SCALAR(0.999);
/* The first limit is the least squared correlation of the velocity residual with the model's acceleration, and the
 * second the least lead [samples]. Half a sample of dead time gives 0.06 and 0.03 under position control, and 0.2 in
 * open loop. Chance and a right model stay below one of these limits. */
static const scalar_t LATE_PART = PMF_SCALAR(0.04);
static const scalar_t LATE_BY = PMF_SCALAR(0.02);

PMF_API whole_t pmf_auxiliary_feedback(pmf_auxiliary_state_t *state, const real_t *signal, truth_t where, real_t change)
{
    pmf_fading_t *sums = &state->fading;
    real_t lack = signal[PMF_LATE_VELOCITY] - signal[PMF_AUXILIARY + PMF_VELOCITY], bend = lack - state->lack;
    real_t answer = state->change, now = bend * answer, next = bend * change, square;
    truth_t follows;
    state->lack = lack;
    state->change = change;
    sums->cross = PMF_IF(where, FEEDBACK_MEMORY * sums->cross + now, sums->cross);
    sums->after = PMF_IF(where, FEEDBACK_MEMORY * sums->after + next, sums->after);
    sums->chance = PMF_IF(where, FEEDBACK_MEMORY * sums->chance + now * now + next * next, sums->chance);
    sums->bends = PMF_IF(where, FEEDBACK_MEMORY * sums->bends + bend * bend, sums->bends);
    sums->changes = PMF_IF(where, FEEDBACK_MEMORY * sums->changes + answer * answer, sums->changes);
    square = sums->cross * sums->cross + sums->after * sums->after;
    follows = (square > FEEDBACK_PART * sums->bends * sums->changes) & (square > SURE * sums->chance);
    state->feedback = PMF_IF(where, PMF_BIT(follows, PMF_FEEDBACK), state->feedback);
    return state->feedback;
}

static void note_lag(pmf_lag_t *lag, scalar_t memory, real_t lack, real_t acceleration, real_t velocity)
{
    lag->weight = memory * lag->weight + PMF_R(1.0);
    lag->lack_lack = memory * lag->lack_lack + lack * lack;
    lag->lack_acceleration = memory * lag->lack_acceleration + lack * acceleration;
    lag->lack_velocity = memory * lag->lack_velocity + lack * velocity;
    lag->acceleration = memory * lag->acceleration + acceleration * acceleration;
    lag->cross = memory * lag->cross + acceleration * velocity;
    lag->velocity = memory * lag->velocity + velocity * velocity;
}

/* Return whether the acceleration explains the velocity residual, without the part that a wrong velocity scale
 * explains. */
static truth_t is_behind(const pmf_auxiliary_config_t *config, const pmf_lag_t *lag)
{
    real_t lack = lag->lack_velocity / lag->velocity, alike = lag->cross / lag->velocity;
    real_t lacks = lag->lack_lack - lag->lack_velocity * lack, both, acceleration, part;
    both = lag->lack_acceleration - lag->lack_velocity * alike;
    acceleration = lag->acceleration - lag->cross * alike;
    part = (both / acceleration) * (both / lacks);
    return (lacks > PMF_R(0.0)) & (acceleration > PMF_R(0.0)) & (part > LATE_PART) &
           (part * lag->weight > SURE * config->lag_samples) & (-both > LATE_BY * config->dt * acceleration);
}

PMF_API whole_t pmf_auxiliary_late(const pmf_auxiliary_config_t *config, pmf_auxiliary_state_t *state,
                                   const real_t *column, truth_t where)
{
    real_t modelled = column[config->check_column + 1U], acceleration = column[config->check_column + 2U];
    real_t lack = column[config->check_column] - modelled;
    truth_t looks = where & ((state->turn & (PMF_FOLLOWED - 1U)) == 0U);
    PMF_WHERE(where, &state->fading.lag,
              note_lag(&state->fading.lag, config->lag_memory, lack, acceleration, modelled));
    if (PMF_ANY(looks)) {
        state->late = PMF_IF(looks, PMF_BIT(is_behind(config, &state->fading.lag), PMF_DEAD_TIME), state->late);
    }
    return state->late;
}
