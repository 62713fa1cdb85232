/* Block scores are the joint information of several samples on a deviation from reference parameters.
 * SPDX-License-Identifier: Apache-2.0
 *
 * The sums are double for any type of the kernel's numbers. Each sum has a fixed order, so that the bits of an axis do
 * not depend on other axes. */
#include "pmf_scores.h"

uint32_t pmf_count_sample(const pmf_scoring_t *scoring, uint32_t status, uint32_t *progress)
{
    progress[1] += (status & scoring->disturbed) != 0U ? 1U : 0U;
    progress[0] += 1U;
    return progress[0] >= scoring->size ? 1U : 0U;
}

uint32_t pmf_score(const pmf_config_t *config, const pmf_scoring_t *scoring, pmf_state_t *state, scalar_t input,
                   uint32_t count, const double *theta, double *sums, uint32_t *progress)
{
    uint32_t status = pmf_filter(config, state, input, count);
    if ((status & scoring->left_out) == 0U) {
        pmf_add_sample(scoring->parameters, theta, &state->network.column[scoring->first], sums);
    }
    return pmf_count_sample(scoring, status, progress);
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

static void score_alone(const pmf_config_t *config, const pmf_scoring_t *scoring, const pmf_scored_t *many,
                        uint64_t axis, pmf_state_t *state)
{
    uint64_t sample, row = axis * many->kept, width = scoring->parameters * (1U + 2U * scoring->parameters);
    const double *theta = many->theta + axis * scoring->parameters;
    double *sums = many->sums + axis * width;
    uint32_t *progress = many->progress + 2U * axis;
    for (sample = 0; sample < many->samples; ++sample) {
        uint64_t at = axis * many->samples + sample;
        if (pmf_score(config, scoring, state, (scalar_t)many->input[at], (uint32_t)(uint64_t)many->counts[at], theta,
                      sums, progress) != 0U) {
            many->lost[row] = (unsigned char)pmf_end_block(scoring, sums, progress, many->blocks + row * width);
            ++row;
        }
    }
}

void pmf_many_scores(const pmf_config_t *config, const pmf_layout_t *layout, const pmf_scoring_t *scoring,
                     const pmf_scored_t *many, uint64_t axes, unsigned char *packed)
{
    const pmf_lanes_t *lanes = pmf_lanes_for(many->way, layout, many->samples);
    uint64_t axis = lanes != 0 ? lanes->score(config, layout, scoring, many, axes, packed) : 0U;
    pmf_state_t state;
    if (axis < axes) { /* clearing a state takes as long as some samples */
        pmf_clear(&state, (uint32_t)sizeof state);
    }
    for (; axis < axes; ++axis) {
        unsigned char *own = packed + axis * layout->packed_size;
        pmf_unpack(layout, own, &state);
        score_alone(config, scoring, many, axis, &state);
        pmf_pack(layout, &state, own);
    }
}
