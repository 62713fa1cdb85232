/* The scale of information. Information from motions that were larger than recent ones is outdated. Only
 * pmf_recursion.c includes this file. SPDX-License-Identifier: Apache-2.0 */
#ifndef PMF_SCALE_H
#define PMF_SCALE_H

#include "pmf_forgetting.h"

#define HALF_MEMORIES 4U /* factor between the bits of this half memory and of the last */
#define SOME PMF_R(0.0625) /* fraction of the encoder's squared error above which the axis moves */
#define LITTLE PMF_SCALAR(0.25) /* fraction of `outgrown` below which the fast forgetting ends */

/* Sum the squares of the acceleration in motion over this and the last half memory, in units of the encoder's error.
 * Returns whether a half memory is complete. */
PMF_INLINE truth_t note_swing(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, real_t lead,
                              real_t square, truth_t moves)
{
    state->moved += PMF_BIT(moves, 1U);
    state->swings |=
        PMF_IF(moves & (square > PMF_R(1.0)), PMF_IF(lead < PMF_R(0.0), PMF_W(SLOWED_DOWN), PMF_W(SPED_UP)), PMF_W(0));
    state->power = PMF_IF(moves, state->power + square, state->power);
    return moves & PMF_NOT(state->moved < config->half_memory);
}

/* Return whether both sums exceed the encoder's errors, and whether the axis visibly accelerated and braked. Even long
 * motions of constant speed give little information. */
PMF_INLINE truth_t excites(const pmf_recursion_config_t *config, const pmf_recursion_state_t *state)
{
    real_t least = PMF_ALIKE((scalar_t)config->half_memory);
    whole_t both = PMF_W(SPED_UP | SLOWED_DOWN);
    return (((state->swings | (state->swings >> 2)) & both) == both) & (state->power > least) &
           (state->power_before > least);
}

/* Begin the next half memory of motion. */
PMF_INLINE void end_half_memory(pmf_recursion_state_t *state, truth_t ends)
{
    state->moved = PMF_IF(ends, PMF_W(0), state->moved);
    state->swings = PMF_IF(ends, (state->swings & PMF_W(SPED_UP | SLOWED_DOWN)) * HALF_MEMORIES, state->swings);
    state->power_before = PMF_IF(ends, state->power, state->power_before);
    state->power = PMF_IF(ends, PMF_R(0.0), state->power);
}

/* After every half memory of motions that excite the axis, lower the peaks to the level of these motions. Information
 * that recent accelerations cannot explain comes from larger motions, and is forgotten fast. */
PMF_SELDOM void compare_sizes(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, real_t lead,
                              truth_t looks, uint32_t p, real_t known)
{
    real_t square = config->shown * lead * lead;
    truth_t moves = looks & (square > SOME), ends, excited;
    uint32_t i;
    if (!PMF_ANY(moves)) {
        return;
    }
    known *= config->shown;
    state->outdated =
        PMF_IF(moves & (known < LITTLE * config->outgrown * state->power_before), PMF_W(0), state->outdated);
    ends = note_swing(config, state, lead, square, moves);
    if (!PMF_ANY(ends)) {
        return;
    }
    excited = ends & excites(config, state);
    for (i = 0; i < p; ++i) {
        state->peak[i] = PMF_IF(excited, config->leak * state->peak[i], state->peak[i]);
    }
    excited = excited & (known > config->outgrown * (state->power + state->power_before));
    state->outdated = PMF_IF(excited, PMF_W(2U * config->half_memory * PMF_LOOK), state->outdated);
    end_half_memory(state, ends);
}

#endif
