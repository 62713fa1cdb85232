/* The scale of information: what is known from larger motions than those of late is outdated. For pmf_recursion.c
 * alone. SPDX-License-Identifier: Apache-2.0
 */
#ifndef PMF_SCALE_H
#define PMF_SCALE_H

#include "pmf_forgetting.h"

#define HALF_MEMORIES 4U /* factor by which the same bits of the last half memory are larger */
#define SOME PMF_R(0.0625) /* of what the encoder shows, squared: the axis moves */
#define LITTLE PMF_SCALAR(0.25) /* of what begins the haste ends it */

/* Sums the squares of the acceleration in motion, in units of what the encoder shows, over this half memory of motion
 * and the last. Is another one over? */
PMF_INLINE truth_t note_swing(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, real_t lead,
                              real_t square, truth_t moves)
{
    state->moved += PMF_BIT(moves, 1U);
    state->swings |=
        PMF_IF(moves & (square > PMF_R(1.0)), PMF_IF(lead < PMF_R(0.0), PMF_W(SLOWED_DOWN), PMF_W(SPED_UP)), PMF_W(0));
    state->power = PMF_IF(moves, state->power + square, state->power);
    return moves & PMF_NOT(state->moved < config->half_memory);
}

/* Were both more than the encoder's errors could feign, and did it show how the axis sped up and slowed down? All but
 * that, as a constant speed or running down, says little, however long. */
PMF_INLINE truth_t excites(const pmf_recursion_config_t *config, const pmf_recursion_state_t *state)
{
    real_t least = PMF_ALIKE((scalar_t)config->half_memory);
    whole_t both = PMF_W(SPED_UP | SLOWED_DOWN);
    return (((state->swings | (state->swings >> 2)) & both) == both) & (state->power > least) &
           (state->power_before > least);
}

/* The next half memory of motion begins. */
PMF_INLINE void end_half_memory(pmf_recursion_state_t *state, truth_t ends)
{
    state->moved = PMF_IF(ends, PMF_W(0), state->moved);
    state->swings = PMF_IF(ends, (state->swings & PMF_W(SPED_UP | SLOWED_DOWN)) * HALF_MEMORIES, state->swings);
    state->power_before = PMF_IF(ends, state->power, state->power_before);
    state->power = PMF_IF(ends, PMF_R(0.0), state->power);
}

/* After every half memory of motions that excite the axis the peaks come down to what these can give. Where more is
 * known than accelerations like those of late could give for good, it is from larger motions, and forgotten in haste: a
 * memory is one of time, whatever the size of the motion. */
PMF_SELDOM void compare_sizes(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, real_t lead,
                              truth_t looks, uint32_t p, real_t known)
{
    real_t square = config->shown * lead * lead;
    truth_t moves = looks & (square > SOME), ends, excited;
    uint32_t i;
    if (SCHEME(config) == PMF_CONSTANT_TRACE) {
        state->excited -= PMF_BIT(looks & (state->excited != 0U), 1U);
    }
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
    if (SCHEME(config) == PMF_CONSTANT_TRACE) {
        state->excited = PMF_IF(excited, PMF_W(2U * config->half_memory), state->excited);
    }
    excited = excited & (known > config->outgrown * (state->power + state->power_before));
    state->outdated = PMF_IF(excited, PMF_W(2U * config->half_memory * PMF_LOOK), state->outdated);
    end_half_memory(state, ends);
}

#endif
