/* Can these numbers be a state of this configuration?
 * SPDX-License-Identifier: Apache-2.0
 *
 * A checksum says that a state was not damaged, not that it is one: whoever can write the bytes can compute it. So before
 * a state is taken, every whole number is compared with what the configuration lets it become (one of them is an
 * index), and every real one must be finite and where it has a sign, have it. What passes may still be wrong; it cannot
 * write where it should not, hold the estimator still, or be not a number.
 */
#include "pmf.h"

#ifdef PMF_FLOAT32
#define LARGEST PMF_R(3.402823466e38)
#else
#define LARGEST PMF_R(1.7976931348623157e308)
#endif
#define MOST_COUNTS PMF_R(1e15) /* of the tracker: far more than a counter of 32 bits makes of it */
#define REALS(member) ((uint32_t)(sizeof(member) / sizeof(real_t))) /* of an array, or a structure of reals alone */

/* Not for what is no number, either. */
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

PMF_SELDOM uint32_t finite(const real_t *number, uint32_t numbers)
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
    return at_most(state->idle, config->standstill_samples) & at_most(state->gap > 0U ? state->gap - 1U : 0U, config->standstill_samples) &
           at_most(state->fast, PMF_FAST_SAMPLES) & at_most(state->fast_before, PMF_FAST_SAMPLES) &
           at_most(state->started, 2U) & within(&state->position, 1U, -MOST_COUNTS, MOST_COUNTS) &
           within(&state->velocity, 1U, -MOST_COUNTS, MOST_COUNTS) &
           within(&state->velocity_before, 1U, -MOST_COUNTS, MOST_COUNTS) &
           within(&state->innovation, 1U, -MOST_COUNTS, MOST_COUNTS) &
           within(&state->direction, 1U, PMF_R(-1.0), PMF_R(1.0)) &
           within(&state->moving, 1U, PMF_R(0.0), PMF_R(1.0)) &
           within(&state->input, 1U, -PMF_LARGEST_INPUT, PMF_LARGEST_INPUT) &
           within(&state->input_before, 1U, -PMF_LARGEST_INPUT, PMF_LARGEST_INPUT) & finite(&state->mean_velocity, 1U);
}

/* The diagonals are sums of squares. */
PMF_SELDOM uint32_t check_sums(const pmf_recursion_config_t *config, const pmf_sums_t *sums)
{
    uint32_t i, fine = finite((const real_t *)(const void *)sums, REALS(*sums)) & not_negative(&sums->weight, 1U);
    for (i = 0; i < config->n_parameters; ++i) {
        fine &= not_negative(config->instrumental != 0U ? &sums->square[i][i] : &sums->cross[i][i], 1U);
    }
    return fine;
}

PMF_SELDOM uint32_t check_estimate(const pmf_estimate_t *estimate)
{
    return finite(estimate->theta, REALS(estimate->theta)) &
           not_negative(estimate->variance_factor, REALS(estimate->variance_factor)) &
           not_negative(estimate->inflation, REALS(estimate->inflation)) & finite(&estimate->innovation, 1U) &
           not_negative(&estimate->innovation_variance, 1U);
}

PMF_SELDOM uint32_t check_window(const pmf_recursion_config_t *config, const pmf_recursion_state_t *state)
{
    uint32_t fine = 1U;
#if PMF_WINDOW_BLOCKS > 0
    uint32_t block;
    for (block = 0; block < PMF_WINDOW_BLOCKS; ++block) {
        fine &= check_sums(config, &state->window[block]);
    }
    fine &= at_most(state->window_block, PMF_WINDOW_BLOCKS - 1U);
#else
    (void)config;
    (void)state;
#endif
    return fine;
}

PMF_SELDOM uint32_t check_recursion(const pmf_recursion_config_t *config, const pmf_recursion_state_t *state)
{
    return check_sums(config, &state->sums) & check_estimate(&state->estimate) & check_window(config, state) &
           not_negative(state->peak, REALS(state->peak)) & finite(&state->factor[0][0], REALS(state->factor)) &
           not_negative(state->inverse_pivot, REALS(state->inverse_pivot)) &
           within(&state->mass, 1U, PMF_R(0.0), PMF_R(1.0)) & not_negative(&state->weight, 1U) &
           not_negative(&state->innovation_square, 1U) & at_most(state->started, state->updates) &
           finite(state->score, REALS(state->score)) & not_negative(state->spread, REALS(state->spread)) &
           at_most(state->block_updates, config->block) & at_most(state->blocks, PMF_BLOCK_MEMORY) &
           at_most(state->frozen, 1U) & not_negative(&state->check_weight, 1U) &
           not_negative(&state->check_innovation, 1U) & not_negative(&state->check_target, 1U) &
           not_negative(state->reference, REALS(state->reference)) & not_negative(&state->trace, 1U);
}

#if PMF_WITH_AUXILIARY
PMF_SELDOM uint32_t check_auxiliary(const pmf_auxiliary_config_t *config, const pmf_auxiliary_state_t *state)
{
    return finite(state->parameter, REALS(state->parameter)) & finite(&state->velocity, 1U) &
           finite(&state->position, 1U) & not_negative(&state->power, 1U) & not_negative(&state->mismatch, 1U) &
           at_most(state->running, 1U) & at_most(state->trial, config->trial_samples) & at_most(state->trusted, 1U) &
           at_most(state->in_charge, 1U);
}
#endif

#if PMF_WITH_LINEAR
PMF_SELDOM uint32_t check_linear(const pmf_linear_config_t *config, const pmf_linear_state_t *state)
{
    return finite(state->parameter, REALS(state->parameter)) & finite(state->a, REALS(state->a)) &
           finite(state->b, REALS(state->b)) & finite(&state->inverse, 1U) &
           finite(&state->step[0][0], REALS(state->step)) & finite(state->gain, REALS(state->gain)) &
           finite(state->held, REALS(state->held)) & finite(state->one, REALS(state->one)) &
           finite(state->measured, REALS(state->measured)) & finite(state->simulated, REALS(state->simulated)) &
           finite(state->settling, REALS(state->settling)) & finite(&state->output, 1U) &
           not_negative(&state->power, 1U) & not_negative(&state->mismatch, 1U) &
           within(&state->discount, 1U, PMF_R(0.0), PMF_R(1.0)) & at_most(state->wait, config->update_samples) &
           at_most(state->age, 0x7fffffffU) & at_most(state->unsettled, state->age) & at_most(state->settled, 1U) &
           at_most(state->running, 1U) & at_most(state->in_charge, 1U);
}
#endif

uint32_t pmf_plausible(const pmf_config_t *config, const pmf_state_t *state)
{
    uint32_t settle = config->settle_samples, fine;
#if PMF_WITH_PROCESS
    settle = config->first_samples > settle ? config->first_samples : settle;
#endif
    fine = at_most(state->status, PMF_STATUS_BITS) & at_most(state->settle, settle) &
           check_encoder(&config->encoder, &state->encoder) & finite((const real_t *)(const void *)&state->network, REALS(state->network)) &
           check_recursion(&config->direct, &state->direct);
#if PMF_WITH_AUXILIARY
    fine &= check_auxiliary(&config->auxiliary, &state->auxiliary) & check_estimate(&state->borrowed);
#endif
#if PMF_WITH_LINEAR
    fine &= check_linear(&config->linear, &state->linear);
#endif
#if PMF_WITH_AUXILIARY + PMF_WITH_LINEAR
    fine &= check_recursion(&config->instrument, &state->instrument);
#endif
    return fine;
}
