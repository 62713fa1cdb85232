/* A state that survives a loss of power, and the effect of this build's arithmetic on its bits.
 * SPDX-License-Identifier: Apache-2.0 */
#include "pmf_internal.h"

static const uint32_t POLYNOMIAL = 0xedb88320U; /* CRC-32 of ISO 3309, bits reversed */

uint32_t pmf_crc32(uint32_t crc, const void *data, uint32_t size)
{
    const unsigned char *byte = (const unsigned char *)data;
    uint32_t i, bit;
    crc = ~crc;
    for (i = 0; i < size; ++i) {
        crc ^= byte[i];
        for (bit = 0; bit < 8U; ++bit) {
            crc = (crc >> 1) ^ (POLYNOMIAL & (0U - (crc & 1U)));
        }
    }
    return ~crc;
}

/* Copy byte by byte, because an assignment need not copy the padding, which a checksum covers. */
static void copy(const void *from, void *to, uint32_t size)
{
    const unsigned char *source = (const unsigned char *)from;
    volatile unsigned char *target =
        (volatile unsigned char *)to; /* without volatile, compilers call memcpy of the C library */
    uint32_t i;
    for (i = 0; i < size; ++i) {
        target[i] = source[i];
    }
}

static uint32_t checksum(const pmf_saved_t *saved)
{
    uint32_t head = pmf_crc32(0U, saved, 5U * (uint32_t)sizeof saved->magic); /* the words before the checksum */
    return pmf_crc32(head, &saved->state, (uint32_t)sizeof saved->state);
}

#ifdef PMF_WITH_EDGES
#define pmf_clear_computed(config, state) ((void)(config)) /* nothing: the next step needs every value */
#else
void pmf_clear_computed(const pmf_config_t *config, pmf_state_t *state)
{
    real_t *node = state->network.node;
    uint32_t nodes = PMF_MODELLED(config) ? (uint32_t)PMF_AUXILIARY : (uint32_t)PMF_SIGNALS; /* the axis may rest */
    (void)config; /* an export may have its values as constants */
    pmf_clear(state->network.column, (uint32_t)sizeof state->network.column);
    if (PMF_SHAPES(config) == 0U && !PMF_SPACED(config)) { /* all stages compute their nodes from those of the step */
        pmf_clear(&node[PMF_SIGNALS], PMF_MAX_STAGES * (uint32_t)sizeof *node);
    }
    if (config->encoder.process == 0U && PMF_KEPT(config) == 0U) {
        pmf_clear(node, nodes * (uint32_t)sizeof *node);
    }
}
#endif

void pmf_save(const pmf_config_t *config, const pmf_state_t *state, pmf_saved_t *saved)
{
    saved->magic = PMF_STATE_MAGIC;
    saved->version = PMF_STATE_VERSION;
    saved->layout = PMF_LAYOUT;
    saved->size = (uint32_t)sizeof *saved;
    saved->config = PMF_CONFIG;
    copy(state, &saved->state, (uint32_t)sizeof *state);
    pmf_clear_computed(config, &saved->state);
    saved->checksum = checksum(saved);
}

uint32_t pmf_load(const pmf_config_t *config, const pmf_saved_t *saved, pmf_state_t *state)
{
    if (saved->magic != PMF_STATE_MAGIC || saved->size != (uint32_t)sizeof *saved) {
        return PMF_NOT_A_STATE;
    }
    if (saved->checksum != checksum(saved)) {
        return PMF_DAMAGED_STATE;
    }
    if (saved->version != PMF_STATE_VERSION || saved->layout != PMF_LAYOUT) {
        return PMF_OTHER_VERSION;
    }
    if (saved->config != PMF_CONFIG) {
        return PMF_OTHER_CONFIG;
    }
    if (pmf_plausible(config, &saved->state) == 0U) {
        return PMF_IMPLAUSIBLE_STATE;
    }
    copy(&saved->state, state, (uint32_t)sizeof *state);
    return PMF_LOADED;
}

static const real_t SMALL = PMF_EITHER(0x1p-13, 0x1p-28);
static const real_t LARGE = PMF_EITHER(0x1p30, 0x1p60);
static const real_t LEAST_NORMAL = PMF_EITHER(0x1p-126, 0x1p-1022);

/* The values are volatile, so that the target and not the compiler computes the results. */
uint32_t pmf_arithmetic(void)
{
    volatile real_t above = PMF_R(1.0) + SMALL, below = PMF_R(1.0) - SMALL, one = PMF_R(1.0), zero = PMF_R(0.0);
    volatile real_t large = LARGE, least = LEAST_NORMAL, half = PMF_R(0.5);
    real_t a = above, b = below, c = one, nothing = zero, half_least;
    uint32_t wrong = 0U;
    if (a * b - c != PMF_R(0.0)) { /* the product rounds to one, unless it is fused or has a wider format */
        wrong |= PMF_CONTRACTED;
    }
    a = large;
    if ((a + c) - a != PMF_R(0.0)) { /* the sum rounds to its large part, but a rearranged sum is one */
        wrong |= PMF_REARRANGED;
    }
    nothing = nothing / nothing;
    if (nothing - nothing == PMF_R(0.0)) { /* NaN is not equal to any number */
        wrong |= PMF_NO_NAN;
    }
    half_least = least * half;
    if (half_least == PMF_R(0.0)) {
        wrong |= PMF_FLUSHED;
    }
    return wrong;
}
