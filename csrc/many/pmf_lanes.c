/* The whole kernel once more, for some axes side by side: the same sources with vectors for numbers.
 * SPDX-License-Identifier: Apache-2.0
 *
 * Compiled once for each width of a vector, PMF_LANE_BYTES, with the processor's option for it. What it gives is one
 * constant: pmf_lanes_16, pmf_lanes_32 or pmf_lanes_64.
 */
#ifndef PMF_LANE_BYTES
#define PMF_LANE_BYTES 16
#endif
#ifdef PMF_FLOAT32
#define PMF_LANES (PMF_LANE_BYTES / 4)
#else
#define PMF_LANES (PMF_LANE_BYTES / 8)
#endif

#include "../pmf_sizes.h"
#undef PMF_WINDOW_BLOCKS
#define PMF_WINDOW_BLOCKS 0 /* seldom used, but most of the memory */

#include "../pmf_auxiliary.c"
#include "../pmf_verdicts.c"
#include "../pmf_encoder.c"
#include "pmf_many.h"
#include "../pmf_network.c"
#include "../pmf_recursion.c"
#include "../pmf_step.c"

#define TILE 32U /* samples that are brought into lanes at a time */

typedef scalar_t lane_real_t __attribute__((may_alias));
typedef lane_whole_t lane_word_t __attribute__((may_alias));

typedef struct {
    real_t input[TILE];
    whole_t count[TILE];
} tile_t;

/* Lanes without an axis repeat the last one. */
static uint32_t axis_of(uint32_t lane, uint32_t axes)
{
    return lane < axes ? lane : axes - 1U;
}

static void load(const pmf_layout_t *layout, uint32_t axes, const unsigned char *packed, pmf_state_t *state)
{
    const pmf_word_t *word = layout->word;
    uint32_t lane, i;
    for (lane = 0; lane < PMF_LANES; ++lane) {
        const unsigned char *own = packed + axis_of(lane, axes) * (uint64_t)layout->packed_size;
        for (i = 0; i < layout->reals; ++i) {
            lane_real_t *to = (lane_real_t *)state + word[i].lane * PMF_LANES + lane;
            *to = *(const scalar_t *)(const void *)(own + word[i].packed);
        }
        for (; i < layout->words; ++i) {
            lane_word_t *to = (lane_word_t *)state + word[i].lane * PMF_LANES + lane;
            *to = *(const uint32_t *)(const void *)(own + word[i].packed);
        }
    }
}

static void store(const pmf_layout_t *layout, uint32_t axes, const pmf_state_t *state, unsigned char *packed)
{
    const pmf_word_t *word = layout->word;
    uint32_t lane, i;
    for (lane = 0; lane < axes; ++lane) {
        unsigned char *own = packed + lane * (uint64_t)layout->packed_size;
        for (i = 0; i < layout->reals; ++i) {
            *(scalar_t *)(void *)(own + word[i].packed) = ((const lane_real_t *)state)[word[i].lane * PMF_LANES + lane];
        }
        for (; i < layout->words; ++i) {
            *(uint32_t *)(void *)(own + word[i].packed) =
                (uint32_t)((const lane_word_t *)state)[word[i].lane * PMF_LANES + lane];
        }
    }
}

static void take_inputs(const pmf_rows_t *rows, uint64_t axis, uint64_t sample, uint32_t samples, lane_real_t *target)
{
    const unsigned char *at = rows->start + (int64_t)axis * rows->axis + (int64_t)sample * rows->sample;
    uint32_t k;
    for (k = 0; k < samples; ++k, at += rows->sample) {
        target[k * PMF_LANES] = rows->size == 4U ? (scalar_t) * (const float *)(const void *)at
                                                 : (scalar_t) * (const double *)(const void *)at;
    }
}

static void take_counts(const pmf_rows_t *rows, uint64_t axis, uint64_t sample, uint32_t samples, lane_word_t *target)
{
    const unsigned char *at = rows->start + (int64_t)axis * rows->axis + (int64_t)sample * rows->sample;
    uint32_t k;
    for (k = 0; k < samples; ++k, at += rows->sample) {
        target[k * PMF_LANES] =
            rows->size == 4U ? *(const uint32_t *)(const void *)at : (uint32_t)*(const uint64_t *)(const void *)at;
    }
}

static void keep_lane(const pmf_config_t *config, const pmf_state_t *state, const pmf_many_t *many, uint32_t lane,
                      uint64_t row)
{
    const pmf_estimate_t *estimate = &state->direct.estimate;
    uint32_t p = pmf_parameters(config), i;
    if (config->direct.constant != PMF_NO_PARAMETER) {
        estimate = &state->lifted;
    }
    if (config->auxiliary.enabled != 0U) {
        estimate = (state->status[lane] & PMF_FALLBACK) == 0U ? &state->instrument.estimate : &state->borrowed;
    }
    for (i = 0; i < p; ++i) {
        many->theta[row * p + i] = (double)estimate->theta[i][lane];
        many->variance_factor[row * p + i] = (double)estimate->variance_factor[i][lane];
        many->inflation[row * p + i] = (double)estimate->inflation[i][lane];
    }
    many->innovation[row] = (double)estimate->innovation[lane];
    many->innovation_variance[row] = (double)estimate->innovation_variance[lane];
    many->status[row] = (uint32_t)state->status[lane];
}

static void run(const pmf_config_t *config, const pmf_layout_t *layout, const pmf_many_t *many, uint64_t first,
                uint32_t axes, unsigned char *packed)
{
    uint64_t sample, row = first * many->kept, until = many->every;
    pmf_state_t state;
    tile_t tile;
    uint32_t lane, k;
    pmf_clear(&state, (uint32_t)sizeof state);
    load(layout, axes, packed, &state);
    for (sample = 0; sample < many->samples; sample += TILE) {
        uint32_t samples = many->samples - sample < TILE ? (uint32_t)(many->samples - sample) : TILE;
        for (lane = 0; lane < PMF_LANES; ++lane) {
            uint64_t axis = first + axis_of(lane, axes);
            take_inputs(&many->input, axis, sample, samples, (lane_real_t *)tile.input + lane);
            take_counts(&many->counts, axis, sample, samples, (lane_word_t *)tile.count + lane);
        }
        for (k = 0; k < samples; ++k) {
            (void)pmf_step(config, &state, tile.input[k], tile.count[k]);
            if (--until == 0U || sample + k + 1U == many->samples) {
                for (lane = 0; lane < axes; ++lane) {
                    keep_lane(config, &state, many, lane, row + lane * many->kept);
                }
                ++row;
                until = many->every;
            }
        }
    }
    store(layout, axes, &state, packed);
}

/* A table without gaps. */
static pmf_rows_t table_of(const void *start, uint64_t samples)
{
    pmf_rows_t rows = {(const unsigned char *)start, 8 * (int64_t)samples, 8, 8U};
    return rows;
}

static void score(const pmf_config_t *config, const pmf_layout_t *layout, const pmf_scoring_t *scoring,
                  const pmf_scored_t *many, uint64_t first, uint32_t axes, unsigned char *packed)
{
    pmf_rows_t input = table_of(many->input, many->samples), counts = table_of(many->counts, many->samples);
    uint32_t numbers = 2U * scoring->parameters + 1U, lane, k, i;
    uint64_t sample, row[PMF_LANES] = {0};
    scalar_t own[2 * PMF_MAX_PARAMETERS + 1];
    pmf_state_t state;
    tile_t tile;
    pmf_clear(&state, (uint32_t)sizeof state);
    load(layout, axes, packed, &state);
    for (sample = 0; sample < many->samples; sample += TILE) {
        uint32_t samples = many->samples - sample < TILE ? (uint32_t)(many->samples - sample) : TILE;
        for (lane = 0; lane < PMF_LANES; ++lane) {
            take_inputs(&input, first + axis_of(lane, axes), sample, samples, (lane_real_t *)tile.input + lane);
            take_counts(&counts, first + axis_of(lane, axes), sample, samples, (lane_word_t *)tile.count + lane);
        }
        for (k = 0; k < samples; ++k) {
            whole_t status = pmf_filter(config, &state, tile.input[k], tile.count[k]);
            for (lane = 0; lane < axes; ++lane) {
                for (i = 0; i < numbers; ++i) {
                    own[i] = state.network.column[scoring->first + i][lane];
                }
                pmf_score_one(scoring, many, first + lane, (uint32_t)status[lane], own, &row[lane]);
            }
        }
    }
    store(layout, axes, &state, packed);
}

#if PMF_LANE_BYTES == 64
#define PMF_LANES_NAME pmf_lanes_64
#elif PMF_LANE_BYTES == 32
#define PMF_LANES_NAME pmf_lanes_32
#else
#define PMF_LANES_NAME pmf_lanes_16
#endif
const pmf_lanes_t PMF_LANES_NAME = {PMF_LANES, sizeof(pmf_state_t) / PMF_LANE_BYTES, run, score};
