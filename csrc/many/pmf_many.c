/* Many axes, in groups as wide as the processor's vectors. SPDX-License-Identifier: Apache-2.0 */
#include "pmf_many.h"
#include "pmf_straight.h"

#include "pmf_rows.inl"

static const uint32_t FEW_SAMPLES = 8U; /* with fewer samples, the change into lanes and back costs too much */

#if defined(__x86_64__) || defined(__i386__)
#define HAS(feature) __builtin_cpu_supports(feature)
#else
#define HAS(feature) 1
#endif

/* Return the lanes, or null if this build or the processor does not have them. */
static const pmf_lanes_t *lanes_of(uint32_t way)
{
#ifdef PMF_HAVE_LANES_16
    if (way == PMF_LANES_16 && HAS("sse4.2")) {
        return &pmf_lanes_16;
    }
#endif
#ifdef PMF_HAVE_LANES_32
    if (way == PMF_LANES_32 && HAS("avx2")) {
        return &pmf_lanes_32;
    }
#endif
#ifdef PMF_HAVE_LANES_64
    if (way == PMF_LANES_64 && HAS("avx512f") && HAS("avx512dq") && HAS("avx512vl") && HAS("avx512bw")) {
        return &pmf_lanes_64;
    }
#endif
    (void)way;
    return 0;
}

uint32_t pmf_many_way(void)
{
    uint32_t way = PMF_WAYS - 1U;
    while (way > PMF_ONE_BY_ONE && lanes_of(way) == 0) {
        --way;
    }
    return way;
}

void pmf_pack(const pmf_layout_t *layout, const pmf_state_t *state, unsigned char *packed)
{
    const unsigned char *from = (const unsigned char *)state;
    const pmf_word_t *word = layout->word;
    uint32_t i;
    for (i = 0; i < layout->reals; ++i) {
        *(scalar_t *)(void *)(packed + word[i].packed) = *(const scalar_t *)(const void *)(from + word[i].offset);
    }
    for (; i < layout->words; ++i) {
        *(uint32_t *)(void *)(packed + word[i].packed) = *(const uint32_t *)(const void *)(from + word[i].offset);
    }
}

void pmf_unpack(const pmf_layout_t *layout, const unsigned char *packed, pmf_state_t *state)
{
    unsigned char *to = (unsigned char *)state;
    const pmf_word_t *word = layout->word;
    uint32_t i;
    for (i = 0; i < layout->reals; ++i) {
        *(scalar_t *)(void *)(to + word[i].offset) = *(const scalar_t *)(const void *)(packed + word[i].packed);
    }
    for (; i < layout->words; ++i) {
        *(uint32_t *)(void *)(to + word[i].offset) = *(const uint32_t *)(const void *)(packed + word[i].packed);
    }
}

static const pmf_straight_t *const STRAIGHT[PMF_METHODS] = {0, &pmf_straight_rls, &pmf_straight_bcrls,
                                                            &pmf_straight_riv};

uint32_t pmf_method_of(const pmf_config_t *config)
{
    uint32_t method = PMF_METHODS - 1U;
    while (method != PMF_GENERAL && STRAIGHT[method]->is_for(config) == 0U) {
        --method;
    }
    return method;
}

pmf_stepper_t *pmf_fastest_step(const pmf_config_t *config)
{
    uint32_t method = pmf_method_of(config);
    return method == PMF_GENERAL ? pmf_step : STRAIGHT[method]->step;
}

pmf_stepper_t *pmf_fastest_filter(const pmf_config_t *config)
{
    uint32_t method = pmf_method_of(config);
    return method == PMF_GENERAL ? pmf_filter : STRAIGHT[method]->filter;
}

static void run_one(const pmf_config_t *config, const pmf_many_t *many, pmf_stepper_t *step, uint64_t axis,
                    pmf_state_t *state)
{
    uint64_t sample, row = axis * many->kept, until = many->every;
    for (sample = 0; sample < many->samples; ++sample) {
        (void)step(config, state, input_at(&many->input, axis, sample), count_at(&many->counts, axis, sample));
        if (--until == 0U || sample + 1U == many->samples) {
            keep(config, state, many, 0U, row++);
            until = many->every;
        }
    }
}

void pmf_many_run(const pmf_config_t *config, const pmf_layout_t *layout, const pmf_many_t *many, uint64_t first,
                  uint64_t end, unsigned char *packed)
{
    const pmf_lanes_t *lanes = many->samples >= FEW_SAMPLES ? lanes_of(many->way) : 0;
    uint64_t axis = lanes != 0 && layout->lane_words == lanes->words
                        ? lanes->run[pmf_method_of(config)](config, layout, many, first, end, packed)
                        : first;
    pmf_stepper_t *step = pmf_fastest_step(config);
    pmf_state_t state;
    if (axis < end) { /* clearing a state takes as long as some samples */
        pmf_clear(&state, (uint32_t)sizeof state);
    }
    for (; axis < end; ++axis) {
        unsigned char *own = packed + axis * layout->packed_size;
        pmf_unpack(layout, own, &state);
        run_one(config, many, step, axis, &state);
        pmf_pack(layout, &state, own);
    }
}
