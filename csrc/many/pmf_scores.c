/* Block scores: what some samples together say of a deviation from reference parameters.
 * SPDX-License-Identifier: Apache-2.0
 *
 * The sums are double whatever the kernel's numbers are, and each is made in one order, so that an axis has the same
 * bits alone and among others.
 */
#include "pmf_many.h"

/* Adds the sample whose columns are in the state. */
static void add_sample(const pmf_scoring_t *scoring, const double *theta, const scalar_t *column, double *sums)
{
    const scalar_t *phi = &column[scoring->first], *zeta;
    uint32_t p = scoring->parameters, i, j;
    double *cross = sums + p, *square = cross + p * p, told = (double)phi[0] * theta[0], error;
    zeta = phi + p + 1U;
    for (i = 1; i < p; ++i) {
        told += (double)phi[i] * theta[i];
    }
    error = (double)phi[p] - told;
    for (i = 0; i < p; ++i) {
        double own = (double)zeta[i];
        sums[i] += own * error;
        for (j = 0; j < p; ++j) {
            cross[i * p + j] += own * (double)phi[j];
            square[i * p + j] += own * (double)zeta[j];
        }
    }
}

uint32_t pmf_score(const pmf_config_t *config, const pmf_scoring_t *scoring, pmf_state_t *state, scalar_t input,
                   uint32_t count, const double *theta, double *sums, uint32_t *progress)
{
    uint32_t status = pmf_filter(config, state, input, count);
    if ((status & scoring->left_out) == 0U) {
        add_sample(scoring, theta, state->network.column, sums);
    }
    progress[1] += (status & scoring->disturbed) != 0U ? 1U : 0U;
    progress[0] += 1U;
    return progress[0] >= scoring->size ? 1U : 0U;
}

uint32_t pmf_end_block(const pmf_scoring_t *scoring, double *sums, uint32_t *progress, double *block)
{
    uint32_t width = scoring->parameters * (1U + 2U * scoring->parameters), i;
    uint32_t lost = progress[1] >= scoring->size ? 1U : 0U;
    for (i = 0; i < width; ++i) {
        block[i] = sums[i];
        sums[i] = 0.0;
    }
    progress[0] = progress[1] = 0U;
    return lost;
}

void pmf_many_scores(const pmf_config_t *config, const pmf_layout_t *layout, const pmf_scoring_t *scoring,
                     const pmf_scored_t *many, uint64_t axes, unsigned char *packed)
{
    uint64_t width = scoring->parameters * (1U + 2U * scoring->parameters), axis, sample, row;
    pmf_state_t state;
    pmf_clear(&state, (uint32_t)sizeof state);
    for (axis = 0; axis < axes; ++axis) {
        unsigned char *own = packed + axis * layout->packed_size;
        const double *theta = many->theta + axis * scoring->parameters;
        double *sums = many->sums + axis * width;
        uint32_t *progress = many->progress + 2U * axis;
        row = axis * many->kept;
        pmf_unpack(layout, own, &state);
        for (sample = 0; sample < many->samples; ++sample) {
            uint64_t at = axis * many->samples + sample;
            if (pmf_score(config, scoring, &state, (scalar_t)many->input[at], (uint32_t)(uint64_t)many->counts[at],
                          theta, sums, progress) != 0U) {
                many->lost[row] = (unsigned char)pmf_end_block(scoring, sums, progress, many->blocks + row * width);
                ++row;
            }
        }
        pmf_pack(layout, &state, own);
    }
}
