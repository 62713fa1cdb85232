/* Block scores are the joint information of several samples on a deviation from reference parameters.
 * SPDX-License-Identifier: Apache-2.0
 *
 * The sums are double for any type of the kernel's numbers. Each sum has a fixed order, so that the bits of an axis do
 * not depend on other axes. */
#include "pmf_straight.h"

/* Return the number of sums in a block of p parameters. */
static uint32_t width_of(uint32_t p)
{
    return p * (1U + 2U * p);
}

/* Add a sample to the sums of zeta e, zeta phi^T and zeta zeta^T. z and zeta follow phi in memory. */
static void add_sample(uint32_t p, const double *theta, const scalar_t *phi, double *sums)
{
    const scalar_t *zeta = phi + p + 1U;
    double *cross = sums + p, *square = cross + p * p, predicted = (double)phi[0] * theta[0], error;
    uint32_t i, j;
    for (i = 1; i < p; ++i) {
        predicted += (double)phi[i] * theta[i];
    }
    error = (double)phi[p] - predicted;
    for (i = 0; i < p; ++i) {
        double own = (double)zeta[i];
        sums[i] += own * error;
        for (j = 0; j < p; ++j) {
            cross[i * p + j] += own * (double)phi[j];
            square[i * p + j] += own * (double)zeta[j];
        }
    }
}

/* Write the block and begin the next one. Returns 1 if all samples of the block were disturbed. */
static unsigned char end_block(const pmf_scoring_t *scoring, double *sums, uint32_t *progress, double *block)
{
    uint32_t width = width_of(scoring->parameters), i;
    unsigned char lost = progress[1] >= scoring->size ? 1U : 0U;
    for (i = 0; i < width; ++i) {
        block[i] = sums[i];
        sums[i] = 0.0;
    }
    progress[0] = progress[1] = 0U;
    return lost;
}

void pmf_score_axis(const pmf_config_t *config, const pmf_scoring_t *scoring, const pmf_scored_t *many, uint64_t axis,
                    pmf_state_t *state)
{
    pmf_stepper_t *filter = pmf_fastest_filter(config);
    uint32_t p = scoring->parameters, width = width_of(p), *progress = many->progress + 2U * axis;
    uint64_t at = axis * many->samples, end = at + many->samples, row = axis * many->kept;
    double *sums = many->sums + axis * width;
    for (; at < end; ++at) {
        uint32_t status = filter(config, state, (scalar_t)many->input[at], (uint32_t)(uint64_t)many->counts[at]);
        if ((status & scoring->left_out) == 0U) {
            add_sample(p, many->theta + axis * p, &state->network.column[scoring->first], sums);
        }
        progress[0] += 1U;
        progress[1] += (status & scoring->disturbed) != 0U ? 1U : 0U;
        if (progress[0] >= scoring->size) {
            many->lost[row] = end_block(scoring, sums, progress, many->blocks + row * width);
            ++row;
        }
    }
}

void pmf_many_scores(const pmf_config_t *config, const pmf_layout_t *layout, const pmf_scoring_t *scoring,
                     const pmf_scored_t *many, uint64_t axes, unsigned char *packed)
{
    uint64_t axis;
    pmf_state_t state;
    pmf_clear(&state, (uint32_t)sizeof state);
    for (axis = 0; axis < axes; ++axis, packed += layout->packed_size) {
        pmf_unpack(layout, packed, &state);
        pmf_score_axis(config, scoring, many, axis, &state);
        pmf_pack(layout, &state, packed);
    }
}
