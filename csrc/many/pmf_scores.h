/* One sample of block scores for one axis or for several axes at once. pmf_sum_t is a double, or a vector of doubles.
 * SPDX-License-Identifier: Apache-2.0 */
#ifndef PMF_SCORES_H
#define PMF_SCORES_H

#include "pmf_many.h"

#ifdef PMF_LANES
typedef double pmf_sum_t __attribute__((vector_size(PMF_LANES * 8)));
#define PMF_TO_SUM(x) __builtin_convertvector((x), pmf_sum_t)
#else
typedef double pmf_sum_t;
#define PMF_TO_SUM(x) ((double)(x))
#endif

/* z and zeta follow phi in memory. */
static inline void pmf_add_sample(uint32_t p, const pmf_sum_t *theta, const real_t *phi, pmf_sum_t *sums)
{
    uint32_t i, j;
    const real_t *zeta = phi + p + 1U;
    pmf_sum_t *cross = sums + p, *square = cross + p * p, told = PMF_TO_SUM(phi[0]) * theta[0], error;
    for (i = 1; i < p; ++i) {
        told += PMF_TO_SUM(phi[i]) * theta[i];
    }
    error = PMF_TO_SUM(phi[p]) - told;
    for (i = 0; i < p; ++i) {
        pmf_sum_t own = PMF_TO_SUM(zeta[i]);
        sums[i] += own * error;
        for (j = 0; j < p; ++j) {
            cross[i * p + j] += own * PMF_TO_SUM(phi[j]);
            square[i * p + j] += own * PMF_TO_SUM(zeta[j]);
        }
    }
}

#endif
