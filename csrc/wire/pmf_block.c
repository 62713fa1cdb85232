/* A block of numbered samples as bytes (docs/wire.md). The byte order of the machine does not matter.
 * SPDX-License-Identifier: Apache-2.0 */
#include "pmf_block.h"

static const uint32_t POLYNOMIAL = 0xedb88320U; /* CRC-32 of ISO 3309, bits reversed, as in zlib */

typedef union {
    double number;
    uint64_t bits;
} wide_t;

typedef union {
    float number;
    uint32_t bits;
} narrow_t;

/* Write the lowest bytes of a value, the lowest first, and return the next position. */
static uint8_t *put(uint8_t *out, uint64_t value, uint32_t bytes)
{
    for (; bytes > 0U; --bytes, value >>= 8) {
        *out++ = (uint8_t)(value & 0xffU);
    }
    return out;
}

static uint8_t *put_number(uint8_t *out, double number)
{
    wide_t wide;
    wide.number = number;
    return put(out, wide.bits, 8U);
}

static uint32_t checksum(const uint8_t *from, const uint8_t *end)
{
    uint32_t crc = 0xffffffffU, bit;
    for (; from != end; ++from) {
        crc ^= *from;
        for (bit = 0U; bit < 8U; ++bit) {
            crc = (crc >> 1) ^ (POLYNOMIAL & (0U - (crc & 1U)));
        }
    }
    return ~crc;
}

uint32_t pmf_block(const pmf_block_t *block, uint8_t *out, uint32_t room)
{
    uint8_t *next = out;
    uint32_t letters = 0U, i, n = block->samples, edges = block->ages != 0 ? 1U : 0U;
    narrow_t narrow;
    while (letters <= PMF_BLOCK_NAME && block->axis[letters] != '\0') {
        ++letters;
    }
    if (letters - 1U >= PMF_BLOCK_NAME || n - 1U >= PMF_BLOCK_SAMPLES ||
        room < PMF_BLOCK_SIZE(letters, n) + 4U * edges * n) {
        return 0U;
    }
    next = put(next, 0x42464d50U, 4U); /* "PMFB" */
    next = put(next, 1U + edges, 2U); /* version 1 or 2, no flags: float32 and int32 */
    next = put(put(next, n, 2U), block->epoch, 4U);
    next = put(put(next, letters, 4U), block->first, 8U);
    next = put_number(put_number(next, block->time), block->dt);
    for (i = 0U; i < ((letters + 7U) & ~7U); ++i) {
        next = put(next, i < letters ? (uint8_t)block->axis[i] : 0U, 1U);
    }
    for (i = 0U; i < n; ++i) {
        narrow.number = block->u[i];
        next = put(next, narrow.bits, 4U);
    }
    for (i = 0U; i < n; ++i) {
        next = put(next, (uint32_t)block->counts[i], 4U);
    }
    for (i = 0U; i < edges * n; ++i) {
        narrow.number = block->ages[i];
        next = put(next, narrow.bits, 4U);
    }
    return (uint32_t)(put(next, checksum(out, next), 4U) - out);
}
