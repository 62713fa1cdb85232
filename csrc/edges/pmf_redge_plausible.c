/* Check whether numbers can be a state of the recursion over edges. SPDX-License-Identifier: Apache-2.0
 *
 * An accepted state cannot write outside its memory or hold NaN, as in pmf_plausible.c. */
#include "pmf_redge.h"

/* Return whether the squares of the reals from `number` up to `end` are finite. The step multiplies pairs of them. */
static uint32_t are_finite(const real_t *number, const void *end)
{
    uint32_t fine = 1U;
    for (; number < (const real_t *)end; ++number) {
        const real_t square = *number * *number;
        fine &= square - square == PMF_R(0.0) ? 1U : 0U;
    }
    return fine;
}

/* Return whether the sizes and variances are not negative. An unknown variance is too large for its square. */
static uint32_t are_sizes(const pmf_redge_state_t *state)
{
    uint32_t i, fine = state->drift >= PMF_R(0.0) && state->spread >= PMF_R(0.0) ? 1U : 0U;
    fine &= state->scatter >= PMF_R(0.0) && state->heard >= PMF_R(0.0) && state->evidence >= PMF_R(0.0) ? 1U : 0U;
    for (i = 0; i < PMF_EDGE_UNKNOWNS; ++i) {
        fine &= state->covariance[i][i] >= PMF_R(0.0) && state->opened[i] >= PMF_R(0.0) ? 1U : 0U;
    }
    for (i = 0; i < PMF_BODY; ++i) {
        fine &= state->variance[i] >= PMF_R(0.0) && state->variance[i] - state->variance[i] == PMF_R(0.0) ? 1U : 0U;
    }
    return fine;
}

uint32_t pmf_redge_plausible(const pmf_redge_config_t *config, const pmf_redge_state_t *state, const pmf_line_t *lines)
{
    const pmf_start_t *start = &state->start;
    uint32_t i, fine = are_finite(&state->place, start) & are_finite(&start->mark[0].t, &start->marks);
    fine &= are_finite(state->theta, state->variance) & are_finite(&state->innovation, &state->count);
    for (i = 0; i < config->lines; ++i) {
        fine &= are_finite(&lines[i].sum, &lines[i + 1U]);
    }
    fine &= are_sizes(state);
    fine &= start->marks <= PMF_MARKS && state->status <= PMF_STATUS_BITS ? 1U : 0U;
    return state->line_number == 0U || state->line_number < config->lines ? fine : 0U;
}
