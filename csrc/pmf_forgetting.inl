/* Amount and time of forgetting in the sums of a recursion. Only pmf_recursion.c includes this file.
 * SPDX-License-Identifier: Apache-2.0 */

static const uint32_t SATURATED = 0xffffffffU;
static const uint32_t SPED_UP = 1U;
static const uint32_t SLOWED_DOWN = 2U;

/* If a model follows the estimate, the first samples come from a poor model. Until the memory is full, the weight of a
 * sample is proportional to its number, so that early errors fade with the square of time. */
PMF_INLINE real_t memory_of(const pmf_recursion_config_t *config, const pmf_recursion_state_t *state, real_t weight)
{
    if (PMF_WITH_AUXILIARY && config->growing != 0U) {
        real_t updates = PMF_TO_REAL(state->updates), part = updates / (updates + (scalar_t)config->growing);
        weight = PMF_IF(part < weight, part, weight);
    }
    return weight;
}

PMF_INLINE void add_sample(pmf_sums_t *sums, real_t f, const real_t *column, uint32_t p, uint32_t instrumental)
{
    const real_t *zeta = instrumental != 0U ? &column[p + 1U] : column;
    uint32_t i, j;
    for (i = 0; i < p; ++i) {
        for (j = 0; j < (instrumental != 0U ? p : i + 1U); ++j) {
            sums->cross[i][j] = f * sums->cross[i][j] + zeta[i] * column[j];
        }
        if (instrumental != 0U) {
            for (j = 0; j <= i; ++j) {
                sums->square[i][j] = f * sums->square[i][j] + zeta[i] * zeta[j];
            }
        }
    }
    sums->weight = f * sums->weight + PMF_R(1.0);
    sums->squares = f * f * sums->squares + PMF_R(1.0);
}

/* Add a sample to the sums, and return the weight of the samples before it. */
PMF_INLINE real_t accumulate(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, const real_t *column,
                             uint32_t p, uint32_t instrumental)
{
    real_t fade = PMF_IF(state->frozen != 0U, PMF_R(1.0), PMF_ALIKE(config->forgetting));
    real_t f = PMF_IF(state->outdated != 0U, PMF_ALIKE(config->haste), memory_of(config, state, fade));
    state->outdated -= PMF_BIT(state->outdated != 0U, 1U);
    add_sample(&state->sums, f, column, p, instrumental);
    state->mass = fade * state->mass + (PMF_R(1.0) - fade);
    state->updates += PMF_BIT(state->updates < SATURATED, 1U);
    return f;
}

/* The scale of information. Information from motions that were larger than recent ones is outdated. */

static const uint32_t HALF_MEMORIES = 4U; /* factor between the bits of this half memory and of the last */
static const scalar_t SOME = PMF_SCALAR(0.0625); /* part of the encoder's squared error above which the axis moves */
static const scalar_t LITTLE = PMF_SCALAR(0.25); /* fraction of `outgrown` below which the fast forgetting ends */

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
    state->outdated = PMF_IF(excited, PMF_W(2U * config->half_memory * config->every), state->outdated);
    end_half_memory(state, ends);
}
