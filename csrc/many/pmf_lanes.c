/* The whole kernel for several axes at once, from the same sources with vectors for numbers.
 * SPDX-License-Identifier: Apache-2.0
 *
 * This file is compiled once for each width of a vector, PMF_LANE_BYTES, with the processor's option for it. Its only
 * export is one constant: pmf_lanes_16, pmf_lanes_32 or pmf_lanes_64. */
#ifndef PMF_LANE_BYTES
#define PMF_LANE_BYTES 16
#endif
#define PMF_LANES (PMF_LANE_BYTES / (uint32_t)sizeof(scalar_t))

#include "pmf_method.h"
#include "../pmf_sizes.h"

#include "../pmf_auxiliary.c"
#include "../pmf_verdicts.c"
#include "../pmf_encoder.c"
#include "../pmf_guard.c"
#include "pmf_many.h"
#include PMF_NETWORK_FILE
#include "../pmf_recursion.c"
#include "../pmf_step.c"
#include "../pmf_instrument.c"
#include "pmf_rows.inl"

enum { TILE = 32 }; /* number of samples that are moved into lanes at a time */

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

/* Load word by word, because the lanes of a vector are neighbours in memory. */
static void load(const pmf_layout_t *layout, uint32_t axes, const unsigned char *packed, pmf_state_t *state)
{
    const unsigned char *own[PMF_LANES];
    const pmf_word_t *word = layout->word, *reals = word + layout->reals, *end = word + layout->words;
    uint32_t lane;
    for (lane = 0; lane < PMF_LANES; ++lane) {
        own[lane] = packed + axis_of(lane, axes) * (uint64_t)layout->packed_size;
    }
    for (; word != reals; ++word) {
        lane_real_t *to = (lane_real_t *)state + word->lane * PMF_LANES;
        for (lane = 0; lane < PMF_LANES; ++lane) {
            to[lane] = *(const scalar_t *)(const void *)(own[lane] + word->packed);
        }
    }
    for (; word != end; ++word) {
        lane_word_t *to = (lane_word_t *)state + word->lane * PMF_LANES;
        for (lane = 0; lane < PMF_LANES; ++lane) {
            to[lane] = *(const uint32_t *)(const void *)(own[lane] + word->packed);
        }
    }
}

static void store(const pmf_layout_t *layout, uint32_t axes, const pmf_state_t *state, unsigned char *packed)
{
    const pmf_word_t *word = layout->word, *reals = word + layout->reals, *end = word + layout->words;
    uint32_t lane;
    for (; word != reals; ++word) {
        const lane_real_t *from = (const lane_real_t *)state + word->lane * PMF_LANES;
        unsigned char *own = packed + word->packed;
        for (lane = 0; lane < axes; ++lane, own += layout->packed_size) {
            *(scalar_t *)(void *)own = from[lane];
        }
    }
    for (; word != end; ++word) {
        const lane_word_t *from = (const lane_word_t *)state + word->lane * PMF_LANES;
        unsigned char *own = packed + word->packed;
        for (lane = 0; lane < axes; ++lane, own += layout->packed_size) {
            *(uint32_t *)(void *)own = (uint32_t)from[lane];
        }
    }
}

/* Return the number of axes in the next group, or 0 if the remaining axes are faster one by one. */
static uint32_t group_of(uint64_t left)
{
    return left >= PMF_LANES ? PMF_LANES : 4U * left >= PMF_LANES ? (uint32_t)left : 0U;
}

static void run_group(const pmf_config_t *config, const pmf_layout_t *layout, const pmf_many_t *many, uint64_t first,
                      uint32_t axes, unsigned char *packed, pmf_state_t *state)
{
    uint64_t sample, row = first * many->kept, until = many->every;
    tile_t tile;
    uint32_t lane, k;
    load(layout, axes, packed, state);
    for (sample = 0; sample < many->samples; sample += TILE) {
        uint32_t samples = many->samples - sample < TILE ? (uint32_t)(many->samples - sample) : TILE;
        for (lane = 0; lane < PMF_LANES; ++lane) {
            uint64_t axis = first + axis_of(lane, axes);
            for (k = 0; k < samples; ++k) {
                ((lane_real_t *)tile.input)[k * PMF_LANES + lane] = input_at(&many->input, axis, sample + k);
                ((lane_word_t *)tile.count)[k * PMF_LANES + lane] = count_at(&many->counts, axis, sample + k);
            }
        }
        for (k = 0; k < samples; ++k) {
            (void)pmf_step(config, state, tile.input[k], tile.count[k]);
            if (--until == 0U || sample + k + 1U == many->samples) {
                for (lane = 0; lane < axes; ++lane) {
                    keep(config, state, many, lane, row + lane * many->kept);
                }
                ++row;
                until = many->every;
            }
        }
    }
    store(layout, axes, state, packed);
}

/* The large unused part of a state is cleared once, because no group changes it. */
static uint64_t run(const pmf_config_t *config, const pmf_layout_t *layout, const pmf_many_t *many, uint64_t first,
                    uint64_t end, unsigned char *packed)
{
    pmf_state_t state;
    uint32_t axes;
    pmf_clear(&state, (uint32_t)sizeof state);
    for (; (axes = group_of(end - first)) != 0U; first += axes) {
        run_group(config, layout, many, first, axes, packed + first * layout->packed_size, &state);
    }
    return first;
}

#define PMF_LANES_NAME JOIN(pmf_lanes, PMF_LANE_BYTES)

#ifdef PMF_STRAIGHT
uint64_t JOIN(PMF_LANES_NAME, PMF_STRAIGHT)(const pmf_config_t *config, const pmf_layout_t *layout,
                                            const pmf_many_t *many, uint64_t first, uint64_t end, unsigned char *packed)
{
    return run(config, layout, many, first, end, packed);
}
#else
pmf_lanes_run_t JOIN(PMF_LANES_NAME, rls), JOIN(PMF_LANES_NAME, bcrls), JOIN(PMF_LANES_NAME, riv);
const pmf_lanes_t PMF_LANES_NAME = {
    PMF_LANES,
    sizeof(pmf_state_t) / PMF_LANE_BYTES,
    {run, JOIN(PMF_LANES_NAME, rls), JOIN(PMF_LANES_NAME, bcrls), JOIN(PMF_LANES_NAME, riv)},
};
#endif
