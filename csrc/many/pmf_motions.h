/* Motions of the auxiliary model for several sets of parameters, for off-line estimators.
 * SPDX-License-Identifier: Apache-2.0 */
#ifndef PMF_MOTIONS_H
#define PMF_MOTIONS_H

#include "../pmf_internal.h"

/* Arguments of the motions. `hold` is the number of simulation steps for each sample of the input, `parts` for each
 * kept mean. The lengths are `samples` for the input and samples hold / parts for the means. The dt of `config` is the
 * length of a simulation step. */
typedef struct {
    const pmf_auxiliary_config_t *config;
    uint64_t motions, samples, hold, parts;
    const double *parameter; /* motions x PMF_ROLES */
    const double *velocity, *position; /* at the start: motions */
    const double *input; /* samples */
    const double *span; /* length of each sample [s] if nothing acts late, or null for hold dt */
    const double *before; /* n_before >= 1 inputs before the first. The oldest input has always acted. */
    uint64_t n_before;
    const double *decay; /* motions x 2 x 3 for a lag after the dead time, or null for no lag */
    const double *on_top; /* null, or an input that acts at once, as fine as the means: one row, or one for each motion
                             (own_force) */
    uint32_t own_force;
    double *mean, *direction, *moving; /* motions x means; null: not requested */
    double *end; /* velocities: motions */
} pmf_motions_t;

typedef struct {
    uint32_t lanes;
    uint64_t (*run)(const pmf_motions_t *motions, uint64_t first);
} pmf_motions_run_t;

extern const pmf_motions_run_t pmf_motions_1, pmf_motions_16, pmf_motions_32, pmf_motions_64;

/* Return null if this build or the processor has no vectors. */
const pmf_motions_run_t *pmf_motions_widest(void);
void pmf_move_all(const pmf_motions_t *motions);

#endif
