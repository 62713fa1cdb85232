/* Check whether numbers can be a state of this configuration.
 * SPDX-License-Identifier: Apache-2.0
 *
 * A checksum shows that a state was not damaged, not that it is valid: any writer of the bytes can compute it. Before a
 * state is accepted, every integer is therefore compared to its limits, because one of the integers is an index. Every
 * real number must be finite and have a valid sign. An accepted state may still be wrong. An accepted state cannot
 * write outside its memory, block the estimator, or hold NaN. */
#include "pmf_internal.h"

static const real_t LARGEST = PMF_EITHER(3.402823466e38, 1.7976931348623157e308);
static const real_t MOST_COUNTS = PMF_R(1e15); /* limit of the tracker, far beyond a counter of 32 bits */
#define REALS(member) \
    ((uint32_t)(sizeof(member) / (sizeof(real_t)))) /* number of reals in an array, or in a structure of reals */

/* Return whether numbers are within limits. NaN is outside. */
PMF_SELDOM uint32_t within(const real_t *number, uint32_t numbers, real_t least, real_t most)
{
    uint32_t i, fine = 1U;
    for (i = 0; i < numbers; ++i) {
        if (!(number[i] >= least && number[i] <= most)) {
            fine = 0U;
        }
    }
    return fine;
}

PMF_SELDOM uint32_t all_finite(const real_t *number, uint32_t numbers)
{
    return within(number, numbers, -LARGEST, LARGEST);
}

PMF_SELDOM uint32_t not_negative(const real_t *number, uint32_t numbers)
{
    return within(number, numbers, PMF_R(0.0), LARGEST);
}

PMF_SELDOM uint32_t at_most(uint32_t number, uint32_t most)
{
    return number <= most ? 1U : 0U;
}

PMF_SELDOM uint32_t check_encoder(const pmf_encoder_config_t *config, const pmf_encoder_state_t *state)
{
    return at_most(state->idle, config->standstill_samples) &
           at_most(state->gap > 0U ? state->gap - 1U : 0U, config->standstill_samples) &
           at_most(state->fast, PMF_FAST_SAMPLES * PMF_SAMPLE(config)) & at_most(state->started, 2U) &
           within(&state->position, 1U, -MOST_COUNTS, MOST_COUNTS) &
           within(&state->velocity, 1U, -MOST_COUNTS, MOST_COUNTS) &
           within(&state->velocity_before, 1U, -MOST_COUNTS, MOST_COUNTS) &
           within(&state->innovation, 1U, -MOST_COUNTS, MOST_COUNTS) &
           within(&state->direction, 1U, PMF_R(-1.0), PMF_R(1.0)) & within(&state->moving, 1U, PMF_R(0.0), PMF_R(1.0)) &
           within(&state->input, 1U, -PMF_LARGEST_INPUT, PMF_LARGEST_INPUT) &
           within(&state->input_before, 1U, -PMF_LARGEST_INPUT, PMF_LARGEST_INPUT) &
           all_finite(&state->mean_velocity, 1U) & within(&state->misread.pause, 1U, PMF_R(0.0), MOST_COUNTS) &
           within(&state->misread.usual, 1U, PMF_R(0.0), MOST_COUNTS) &
           within(&state->misread.held, 1U, PMF_R(0.0), MOST_COUNTS) &
           within(&state->misread.begun, 1U, PMF_R(0.0), MOST_COUNTS) & all_finite(&state->misread.held_input, 1U);
}

/* The diagonals are sums of squares. */
PMF_SELDOM uint32_t check_sums(const pmf_recursion_config_t *config, const pmf_sums_t *sums)
{
    uint32_t i, fine = all_finite((const real_t *)(const void *)sums, REALS(*sums)) & not_negative(&sums->weight, 1U) &
                       not_negative(&sums->squares, 1U);
    for (i = 0; i < config->n_parameters; ++i) {
        fine &= not_negative(config->instrumental != 0U ? &sums->square[i][i] : &sums->cross[i][i], 1U);
    }
    return fine;
}

PMF_SELDOM uint32_t check_estimate(const pmf_estimate_t *estimate)
{
    return all_finite(estimate->theta, REALS(estimate->theta)) &
           not_negative(estimate->variance_factor, REALS(estimate->variance_factor)) &
           not_negative(estimate->inflation, REALS(estimate->inflation)) & all_finite(&estimate->innovation, 1U) &
           not_negative(&estimate->innovation_variance, 1U);
}

PMF_SELDOM uint32_t check_check(const pmf_check_t *check)
{
    return not_negative(&check->weight, 1U) & not_negative(&check->innovation, 1U) & not_negative(&check->target, 1U);
}

/* Check the present and the past size of the motion. */
PMF_SELDOM uint32_t check_scale(const pmf_recursion_config_t *config, const pmf_recursion_state_t *state)
{
    return not_negative(state->peak, REALS(state->peak)) & not_negative(&state->power, 1U) &
           not_negative(&state->power_before, 1U) & at_most(state->moved, config->half_memory) &
           at_most(state->swings, PMF_SWING_BITS) & at_most(state->outdated, 2U * config->half_memory * config->every) &
           at_most(state->frozen, 1U);
}

PMF_SELDOM uint32_t check_recursion(const pmf_recursion_config_t *config, const pmf_recursion_state_t *state)
{
    real_t lift = PMF_LIFT(state);
    return check_sums(config, &state->sums) & check_estimate(&state->estimate) & check_scale(config, state) &
           all_finite(&state->factor[0][0], REALS(state->factor)) &
           not_negative(state->inverse_pivot, REALS(state->inverse_pivot)) &
           within(&state->mass, 1U, PMF_R(0.0), PMF_R(1.0)) & not_negative(&state->weight, 1U) &
           not_negative(&state->innovation_square, 1U) & at_most(state->started, state->updates) &
           check_check(&state->check) & check_check(&state->check_before) & at_most(state->unmodelled, PMF_UNMODELLED) &
           all_finite(&lift, 1U) & not_negative(state->misread, REALS(state->misread)) &
           not_negative(state->spread, REALS(state->spread)) & all_finite(state->score, REALS(state->score)) &
           all_finite(state->gathered, REALS(state->gathered)) & all_finite(state->rest, REALS(state->rest)) &
           all_finite(state->strayed, REALS(state->strayed)) & at_most(state->verdict, PMF_STATUS_BITS) &
           at_most(state->blocks, PMF_BLOCK_MEMORY) &
           /* a block counts only solutions without a status, and may end some updates late */
           at_most(state->block_updates > config->every ? state->block_updates - config->every : 0U, state->updates);
}

#if PMF_WITH_AUXILIARY
PMF_SELDOM uint32_t check_auxiliary(const pmf_auxiliary_config_t *config, const pmf_auxiliary_state_t *state)
{
    const pmf_fading_t *fading = &state->fading;
    return all_finite(state->parameter, REALS(state->parameter)) & all_finite(&state->velocity, 1U) &
           all_finite(&state->position, 1U) & all_finite((const real_t *)(const void *)fading, REALS(*fading)) &
           not_negative(&fading->power, 1U) & not_negative(&fading->mismatch, 1U) & not_negative(&fading->chance, 1U) &
           not_negative(&fading->bends, 1U) & not_negative(&fading->changes, 1U) & at_most(state->running, 1U) &
           at_most(state->trial, config->trial_samples) & at_most(state->trusted, 1U) & at_most(state->in_charge, 1U) &
           all_finite(&state->lack, 1U) & all_finite(&state->change, 1U) & at_most(state->feedback, PMF_FEEDBACK) &
           at_most(state->late, PMF_DEAD_TIME) & not_negative(&state->step, 1U);
}
#endif

/* Check the parts that some exports leave out. */
PMF_SELDOM uint32_t check_parts(const pmf_config_t *config, const pmf_state_t *state)
{
    uint32_t fine = PMF_WITH_GUARD != 0 ? pmf_guard_plausible(state) : 1U;
    (void)config;
#if PMF_WITH_STEPS
    fine &= within(&state->encoder.ratio, 1U, PMF_R(0.0), PMF_MOST_RATIO) &
            within(&state->encoder.ratio_before, 1U, PMF_R(0.0), PMF_MOST_RATIO) &
            all_finite((const real_t *)(const void *)&state->encoder.tracker, REALS(state->encoder.tracker)) &
            not_negative(&state->encoder.tracker.place, 1U) & not_negative(&state->encoder.tracker.speed, 1U) &
            not_negative(&state->network.time, 1U);
#endif
#if PMF_WITH_DEAD_TIME
    fine &= all_finite(state->late.past, REALS(state->late.past)) & all_finite(&state->late.older, 1U) &
            all_finite(&state->late.newer, 1U) & within(&state->late.part, 1U, PMF_R(0.0), PMF_R(1.0)) &
            all_finite(&state->late.lagged, 1U) &
            (state->late.at == 0U || state->late.at < config->late.kept ? 1U : 0U);
#endif
#if PMF_WITH_AUXILIARY
    fine &= check_auxiliary(&config->auxiliary, &state->auxiliary) & check_estimate(&state->output) &
            all_finite(state->model, REALS(state->model)) & check_recursion(&config->instrument, &state->instrument);
#endif
    return fine;
}

uint32_t pmf_plausible(const pmf_config_t *config, const pmf_state_t *state)
{
    uint32_t settle = config->settle_samples;
    settle = config->first_samples > settle ? config->first_samples : settle;
    return at_most(state->status, PMF_STATUS_BITS) & at_most(state->settle, settle) &
           at_most(state->hold, settle + PMF_AHEAD) & check_encoder(&config->encoder, &state->encoder) &
           all_finite((const real_t *)(const void *)&state->network, REALS(state->network)) &
           check_estimate(PMF_LIFTED(state)) & check_recursion(&config->direct, &state->direct) &
           check_parts(config, state);
}
