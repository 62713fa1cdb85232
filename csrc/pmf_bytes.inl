/* Bytes of a structure. A program's kernel has one file that includes this file. SPDX-License-Identifier: Apache-2.0 */
#ifndef PMF_LANES
PMF_API void pmf_clear(void *memory, uint32_t size)
{
    volatile unsigned char *byte =
        (volatile unsigned char *)memory; /* without volatile, compilers call memset of the C library */
    uint32_t i;
    for (i = 0; i < size; ++i) {
        byte[i] = 0;
    }
}
#endif
