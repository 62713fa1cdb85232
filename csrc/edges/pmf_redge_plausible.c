/* Check whether numbers can be a state of the recursion over edges. SPDX-License-Identifier: Apache-2.0
 *
 * An accepted state cannot write outside its memory or hold NaN, as in pmf_plausible.c. */
#include "pmf_redge.h"

/* Return whether the reals from `number` up to `end` are finite. */
static uint32_t are_finite(const real_t *number, const void *end)
{
    uint32_t fine = 1U;
    for (; number < (const real_t *)end; ++number) {
        fine &= *number - *number == PMF_R(0.0) ? 1U : 0U;
    }
    return fine;
}

uint32_t pmf_redge_plausible(const pmf_redge_config_t *config, const pmf_redge_state_t *state, const pmf_line_t *lines)
{
    const pmf_start_t *start = &state->start;
    uint32_t i, fine = are_finite(&state->place, start) & are_finite(&start->mark[0].t, &start->marks);
    fine &= are_finite(state->theta, &state->count);
    for (i = 0; i < config->lines; ++i) {
        fine &= are_finite(&lines[i].sum, &lines[i + 1U]);
    }
    for (i = 0; i < PMF_FOLLOWED; ++i) {
        fine &= state->covariance[i][i] >= PMF_R(0.0) ? 1U : 0U;
    }
    for (i = 0; i < PMF_BODY; ++i) {
        fine &= state->variance[i] >= PMF_R(0.0) ? 1U : 0U;
    }
    fine &= start->marks <= PMF_MARKS && state->status <= PMF_STATUS_BITS ? 1U : 0U;
    return state->line_number == 0U || state->line_number < config->lines ? fine : 0U;
}
