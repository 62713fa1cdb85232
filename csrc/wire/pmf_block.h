/* A block of numbered samples for pmfid serve, as bytes; docs/wire.md gives their order.
 *
 * SPDX-License-Identifier: Apache-2.0
 *
 * It needs no kernel, no heap and no library. All drives of one program share this code, which is compiled once. */
#ifndef PMF_BLOCK_H
#define PMF_BLOCK_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

enum pmf_block_limits {
    PMF_BLOCK_SAMPLES = 1024, /* largest number of samples in a block */
    PMF_BLOCK_NAME = 64 /* largest number of bytes in a name */
};
/* Size of a block in bytes, without and with the ages of edges. */
#define PMF_BLOCK_SIZE(letters, samples) (44U + ((((uint32_t)(letters)) + 7U) & ~7U) + 8U * (uint32_t)(samples))
#define PMF_BLOCK_EDGES_SIZE(letters, samples) (PMF_BLOCK_SIZE(letters, samples) + 4U * (uint32_t)(samples))

typedef struct {
    const char *axis; /* name of the axis, UTF-8 */
    uint32_t epoch; /* number that rises when the sample numbers restart, as after a power cycle */
    uint64_t first; /* number of the first sample */
    double time; /* time of the first sample [s]; NaN without a clock */
    double dt; /* sample period [s] */
    uint32_t samples; /* number of samples, 1 to PMF_BLOCK_SAMPLES */
    const float *u; /* inputs; NaN marks a lost input */
    const int32_t *counts; /* counts; a counter of 32 bits that wraps is sent unchanged */
    const float *ages; /* times from the last edge to the sample [s], NaN without an edge; null: there are none */
} pmf_block_t;

/* Write a block into `room` bytes at `out`. Returns the size of the block, or 0 if the block does not fit or has wrong
 * sizes. */
uint32_t pmf_block(const pmf_block_t *block, uint8_t *out, uint32_t room);

#ifdef __cplusplus
}
#endif

#endif
