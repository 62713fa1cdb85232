/* Wrong counts of a record. SPDX-License-Identifier: Apache-2.0 */
#ifndef PMF_OUTLIERS_H
#define PMF_OUTLIERS_H

#include <stdint.h>

/* A record of `samples` counts at increasing times [sample periods]. The counts are below 2^53 in size and do not
 * wrap. */
typedef struct {
    uint64_t samples;
    double step; /* size of the rounding error, at least the encoder's step [counts] */
    double speed; /* highest possible speed, which is a hard limit, otherwise 0 [counts per sample period] */
    const double *time;
    int64_t *count; /* in: the readings; out: the counts of the motion, from the first zero */
    int64_t *moved; /* out: shift of the counter's zero at each sample, otherwise 0 */
    unsigned char *wrong; /* out: 1 at a reading that no motion explains, otherwise 0 */
} pmf_outliers_t;

/* Replace wrong readings by the straight line between their neighbours, and take back shifts of the counter's zero.
 * The work is proportional to the samples. */
void pmf_find_outliers(const pmf_outliers_t *record);

#endif
