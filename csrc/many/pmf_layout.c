/* Words of a state that a configuration uses, and their packing.
 * SPDX-License-Identifier: Apache-2.0
 *
 * The sizes in pmf.h are those of the largest model. A drive with three parameters uses a tenth of the largest state.
 */
#include "pmf_many.h"

#include <stddef.h>

#define MAX_RANGES 192U
#define IN_STATE(member) (uint32_t)offsetof(pmf_state_t, member)
#define END_IN_STATE(member) (IN_STATE(member) + (uint32_t)sizeof(((pmf_state_t *)0)->member))
#define IN_RECURSION(member) (uint32_t)offsetof(pmf_recursion_state_t, member)
#define N_BYTES (PMF_MAX_PARAMETERS * (uint32_t)sizeof(scalar_t)) /* size of a vector of parameters */

typedef struct {
    uint32_t from, to;
} range_t;
/* Ranges of unused bytes. */
typedef struct {
    range_t range[MAX_RANGES];
    uint32_t ranges;
} unused_t;

static void leave_out(unused_t *unused, uint32_t from, uint32_t to)
{
    if (unused->ranges < MAX_RANGES) {
        unused->range[unused->ranges].from = from;
        unused->range[unused->ranges].to = to;
        unused->ranges += 1U;
    }
}

/* Mark elements or rows from number `p` of an array at `at` as unused. The array has PMF_MAX_PARAMETERS elements of
 * `size` bytes each.
 */
static void leave_tail(unused_t *unused, uint32_t at, uint32_t p, size_t size)
{
    leave_out(unused, at + p * (uint32_t)size, at + PMF_MAX_PARAMETERS * (uint32_t)size);
}

/* Mark the unused part of a matrix with p rows and columns. With `lower` only the lower half is used, and the diagonal
 * only if `lower` is 1. */
static void leave_matrix(unused_t *unused, uint32_t at, uint32_t p, uint32_t lower, uint32_t diagonal)
{
    uint32_t row = PMF_MAX_PARAMETERS * (uint32_t)sizeof(scalar_t), i;
    for (i = 0; i < p; ++i) {
        leave_tail(unused, at + i * row, lower != 0U ? i + diagonal : p, sizeof(scalar_t));
    }
    leave_tail(unused, at, p, row);
}

static void leave_estimate(unused_t *unused, uint32_t at, uint32_t p)
{
    leave_tail(unused, at + (uint32_t)offsetof(pmf_estimate_t, theta), p, sizeof(scalar_t));
    leave_tail(unused, at + (uint32_t)offsetof(pmf_estimate_t, variance_factor), p, sizeof(scalar_t));
    leave_tail(unused, at + (uint32_t)offsetof(pmf_estimate_t, inflation), p, sizeof(scalar_t));
}

/* Mark the values that only a varying step or a process uses, and roles of the auxiliary model that are always zero. */
static void leave_zeros(unused_t *unused, const pmf_config_t *config)
{
    const pmf_auxiliary_config_t *model = &config->auxiliary;
    uint32_t i;
    for (i = 0; i < PMF_ROLES && model->enabled != 0U; ++i) {
        if (model->index[i] == PMF_NO_PARAMETER && model->direct_index[i] == PMF_NO_PARAMETER &&
            model->initial[i] == 0) {
            leave_out(unused, IN_STATE(auxiliary.parameter[i]), END_IN_STATE(auxiliary.parameter[i]));
        }
    }
    if (!(config->encoder.rate > PMF_SCALAR(0.0))) {
        leave_out(unused, IN_STATE(encoder.tracker), END_IN_STATE(encoder.tracker));
        leave_out(unused, IN_STATE(network.time), END_IN_STATE(network.cubes));
    }
    if (config->encoder.process == 0U) {
        leave_out(unused, IN_STATE(encoder.first), END_IN_STATE(encoder.first));
    }
}

static void leave_recursion(unused_t *unused, uint32_t at, const pmf_recursion_config_t *config)
{
    uint32_t p = config->n_parameters;
    leave_matrix(unused, at + IN_RECURSION(sums.cross), p, config->instrumental == 0U, 1U);
    leave_matrix(unused, at + IN_RECURSION(sums.square), config->instrumental != 0U ? p : 0U, 1U, 1U);
    leave_tail(unused, at + IN_RECURSION(sums.right), p, sizeof(scalar_t));
    leave_tail(unused, at + IN_RECURSION(peak), p, sizeof(scalar_t));
    leave_matrix(unused, at + IN_RECURSION(factor), p, 1U, 0U);
    leave_tail(unused, at + IN_RECURSION(inverse_pivot), p, sizeof(scalar_t));
    leave_tail(unused, at + IN_RECURSION(score), p, sizeof(scalar_t));
    leave_estimate(unused, at + IN_RECURSION(estimate), p);
    if (config->misread_column == 0U) {
        leave_out(unused, at + IN_RECURSION(misread), at + IN_RECURSION(spread) + N_BYTES);
    } else {
        leave_tail(unused, at + IN_RECURSION(misread), p, sizeof(scalar_t));
        leave_tail(unused, at + IN_RECURSION(spread), p, sizeof(scalar_t));
    }
    if (!(config->unexplained > PMF_SCALAR(0.0))) {
        leave_out(unused, at + IN_RECURSION(check), at + IN_RECURSION(unmodelled) + 4U);
    }
    if (!(config->lift > PMF_SCALAR(0.0)) && !(config->lift < PMF_SCALAR(0.0))) {
        leave_out(unused, at + IN_RECURSION(lift), at + IN_RECURSION(lift) + (uint32_t)sizeof(scalar_t));
    }
}

static void find_unused(const pmf_config_t *config, unused_t *unused)
{
    const pmf_network_config_t *network = &config->network;
    unused->ranges = 0U;
    leave_out(unused, IN_STATE(network.node) + (PMF_SIGNALS + network->n_stages) * (uint32_t)sizeof(scalar_t),
              END_IN_STATE(network.node));
    leave_out(unused, IN_STATE(network.memory) + network->n_stages * (uint32_t)sizeof(scalar_t),
              END_IN_STATE(network.memory));
    leave_out(unused, IN_STATE(network.column) + network->n_columns * (uint32_t)sizeof(scalar_t),
              END_IN_STATE(network.column));
    leave_recursion(unused, IN_STATE(direct), &config->direct);
    if (config->direct.constant != PMF_NO_PARAMETER) {
        leave_estimate(unused, IN_STATE(lifted), config->direct.n_parameters);
    } else {
        leave_out(unused, IN_STATE(lifted), END_IN_STATE(lifted));
    }
    if (config->encoder.misread == 0U) {
        leave_out(unused, IN_STATE(encoder.misread), END_IN_STATE(encoder.misread));
    }
    if (config->encoder.guard == 0U) {
        leave_out(unused, IN_STATE(guard), END_IN_STATE(guard));
    }
    if (config->auxiliary.enabled != 0U) {
        leave_recursion(unused, IN_STATE(instrument), &config->instrument);
    } else {
        leave_out(unused, IN_STATE(instrument), END_IN_STATE(instrument));
    }
    if (config->auxiliary.enabled != 0U) {
        uint32_t roles = PMF_BODY_ROLES + config->auxiliary.shapes.n;
        leave_estimate(unused, IN_STATE(borrowed), config->instrument.n_parameters);
        leave_out(unused, IN_STATE(auxiliary.parameter) + roles * (uint32_t)sizeof(scalar_t),
                  END_IN_STATE(auxiliary.parameter));
        leave_out(unused, IN_STATE(auxiliary.jump) + config->auxiliary.sensitivities * (uint32_t)sizeof(pmf_jump_t),
                  END_IN_STATE(auxiliary.jump));
    } else {
        leave_out(unused, IN_STATE(borrowed), END_IN_STATE(borrowed));
        leave_out(unused, IN_STATE(auxiliary), END_IN_STATE(auxiliary));
    }
    if (!(config->encoder.rate > PMF_SCALAR(0.0))) {
        leave_out(unused, IN_STATE(encoder.ratio), END_IN_STATE(encoder.ratio_before));
        leave_out(unused, IN_STATE(network.ratio), END_IN_STATE(network.ratio_before));
        leave_out(unused, IN_STATE(auxiliary.step), END_IN_STATE(auxiliary.step));
    }
    if (config->late.kept == 0U) {
        leave_out(unused, IN_STATE(late), END_IN_STATE(late));
    }
    leave_zeros(unused, config);
}

static uint32_t is_used(const unused_t *unused, uint32_t offset)
{
    uint32_t i;
    for (i = 0; i < unused->ranges; ++i) {
        if (offset >= unused->range[i].from && offset < unused->range[i].to) {
            return 0U;
        }
    }
    return 1U;
}

/* Fill a state without a zero byte. */
static void fill_state(pmf_state_t *state)
{
    unsigned char *byte = (unsigned char *)state;
    uint32_t i;
    for (i = 0; i < sizeof *state; ++i) {
        byte[i] = 1U;
    }
}

/* Pass over all words once, and add the reals in use or the integers. The given state is nonzero where a packed state
 * has content. */
static void add_words(pmf_layout_t *layout, const unused_t *unused, const pmf_state_t *filled,
                      const unsigned char *is_whole, uint32_t whole)
{
    const unsigned char *kept = (const unsigned char *)filled;
    uint32_t offset = 0, lane = 0;
    while (offset < sizeof(pmf_state_t)) {
        uint32_t found = is_whole[offset / 4U];
        uint32_t size = found != 0U ? 4U : (uint32_t)sizeof(scalar_t);
        if (found == 0U && offset % sizeof(scalar_t) != 0U) { /* the gap before an aligned real */
            offset += 4U;
            continue;
        }
        if (found == whole && kept[offset] != 0U && is_used(unused, offset) != 0U && layout->words < PMF_MAX_WORDS) {
            pmf_word_t *word = &layout->word[layout->words++];
            word->offset = offset;
            word->packed = layout->packed_size;
            word->lane = lane;
            layout->packed_size += size;
        }
        lane += 1U;
        offset += size;
    }
    layout->lane_words = lane;
}

uint32_t pmf_layout(const pmf_config_t *config, const unsigned char *is_whole, pmf_layout_t *layout)
{
    unused_t unused;
    pmf_state_t filled;
    find_unused(config, &unused);
    fill_state(&filled);
    pmf_clear_computed(config, &filled);
    layout->words = 0U;
    layout->packed_size = 0U;
    add_words(layout, &unused, &filled, is_whole, 0U);
    layout->reals = layout->words;
    add_words(layout, &unused, &filled, is_whole, 1U);
    layout->packed_size = (layout->packed_size + 7U) / 8U * 8U;
    if (config->late.kept != 0U || config->auxiliary.shapes.n != 0U || config->encoder.rate > PMF_SCALAR(0.0)) {
        layout->lane_words = 0U;
    }
    return layout->words < PMF_MAX_WORDS && unused.ranges < MAX_RANGES ? 1U : 0U;
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
