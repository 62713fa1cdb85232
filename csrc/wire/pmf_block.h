/* A block of numbered samples for pmfid serve, as bytes to be sent: docs/wire.md says where each is.
 *
 * SPDX-License-Identifier: Apache-2.0
 *
 * Needs nothing of the kernel, no heap and no library. Every drive of one program shares it: compile it once.
 */
#ifndef PMF_BLOCK_H
#define PMF_BLOCK_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define PMF_BLOCK_SAMPLES 1024U /* of one block, at most */
#define PMF_BLOCK_NAME 64U /* bytes of a name, at most */
/* Bytes of a block. */
#define PMF_BLOCK_SIZE(letters, samples) (44U + ((((uint32_t)(letters)) + 7U) & ~7U) + 8U * (uint32_t)(samples))

typedef struct {
    const char *axis; /* its name, UTF-8 */
    uint32_t epoch; /* raised when the numbers restart, as after a power cycle */
    uint64_t first; /* number of the first sample */
    double time; /* of the first sample [s]; not a number: there is no clock */
    double dt; /* sample period [s] */
    uint32_t samples; /* 1 to PMF_BLOCK_SAMPLES */
    const float *u; /* not a number where the input is lost */
    const int32_t *counts; /* a counter of 32 bits that wraps is sent as it is */
} pmf_block_t;

/* Writes a block into `room` bytes at `out`; returns how many it takes, 0 where it does not fit or its sizes are wrong.
 */
uint32_t pmf_block(const pmf_block_t *block, uint8_t *out, uint32_t room);

#ifdef __cplusplus
}
#endif

#endif
