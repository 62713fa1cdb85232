/* Block scores: what some samples together say of a deviation from reference parameters.
 * SPDX-License-Identifier: Apache-2.0
 *
 * The sums are double whatever the kernel's numbers are, and each is made in one order, so that an axis has the same
 * bits alone and among others.
 */
#include "pmf_many.h"

static void add_sample(const pmf_scoring_t *scoring, const double *theta, const scalar_t *phi, double *sums)
{
    uint32_t p = scoring->parameters, i, j;
    const scalar_t *zeta = phi + p + 1U;
    double *cross = sums + p, *square = cross + p * p, told = (double)phi[0] * theta[0], error;
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

uint32_t pmf_add_score(const pmf_scoring_t *scoring, uint32_t status, const scalar_t *own, const double *theta,
                       double *sums, uint32_t *progress)
{
    if ((status & scoring->left_out) == 0U) {
        add_sample(scoring, theta, own, sums);
    }
    progress[1] += (status & scoring->disturbed) != 0U ? 1U : 0U;
    progress[0] += 1U;
    return progress[0] >= scoring->size ? 1U : 0U;
}

uint32_t pmf_score(const pmf_config_t *config, const pmf_scoring_t *scoring, pmf_state_t *state, scalar_t input,
                   uint32_t count, const double *theta, double *sums, uint32_t *progress)
{
    uint32_t status = pmf_filter(config, state, input, count);
    return pmf_add_score(scoring, status, &state->network.column[scoring->first], theta, sums, progress);
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

void pmf_score_one(const pmf_scoring_t *scoring, const pmf_scored_t *many, uint64_t axis, uint32_t status,
                   const scalar_t *own, uint64_t *row)
{
    uint64_t width = scoring->parameters * (1U + 2U * scoring->parameters);
    double *sums = many->sums + axis * width;
    uint32_t *progress = many->progress + 2U * axis;
    if (pmf_add_score(scoring, status, own, many->theta + axis * scoring->parameters, sums, progress) != 0U) {
        uint64_t at = axis * many->kept + *row;
        many->lost[at] = (unsigned char)pmf_end_block(scoring, sums, progress, many->blocks + at * width);
        *row += 1U;
    }
}

static void score_alone(const pmf_config_t *config, const pmf_scoring_t *scoring, const pmf_scored_t *many,
                        uint64_t axis, pmf_state_t *state)
{
    uint64_t sample, row = 0U;
    for (sample = 0; sample < many->samples; ++sample) {
        uint64_t at = axis * many->samples + sample;
        uint32_t status = pmf_filter(config, state, (scalar_t)many->input[at], (uint32_t)(uint64_t)many->counts[at]);
        pmf_score_one(scoring, many, axis, status, &state->network.column[scoring->first], &row);
    }
}

void pmf_many_scores(const pmf_config_t *config, const pmf_layout_t *layout, const pmf_scoring_t *scoring,
                     const pmf_scored_t *many, uint64_t axes, unsigned char *packed)
{
    const pmf_lanes_t *lanes = pmf_lanes_for(many->way, layout, many->samples);
    uint64_t axis = 0U, left;
    pmf_state_t state;
    pmf_clear(&state, (uint32_t)sizeof state);
    while (axis < axes) {
        unsigned char *own = packed + axis * layout->packed_size;
        left = axes - axis;
        if (lanes != 0 && 4U * left >= lanes->lanes) {
            uint32_t together = left < lanes->lanes ? (uint32_t)left : lanes->lanes;
            lanes->score(config, layout, scoring, many, axis, together, own);
            axis += together;
        } else {
            pmf_unpack(layout, own, &state);
            score_alone(config, scoring, many, axis, &state);
            pmf_pack(layout, &state, own);
            ++axis;
        }
    }
}
