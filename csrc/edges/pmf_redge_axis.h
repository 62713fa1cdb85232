/* The axis of an export with edges, under the names of pmf.h. Only pmf.h includes this file.
 * SPDX-License-Identifier: Apache-2.0 */
#ifndef PMF_REDGE_AXIS_H
#define PMF_REDGE_AXIS_H

#include "pmf_redge.h"

typedef pmf_redge_config_t pmf_config_t;

typedef struct {
    pmf_redge_state_t edge;
    pmf_line_t line[PMF_MAX_LINES];
} pmf_state_t;

typedef pmf_redge_state_t pmf_estimate_t;

#define PMF_NO_EDGE PMF_R(-1.0) /* age of a sample without an edge */

void pmf_init(const pmf_config_t *config, pmf_state_t *state);
/* Set the reading of the counter at the last sample. The estimate stays, and the motion goes on. */
void pmf_rebase(pmf_state_t *state, uint32_t count);
/* Process one sample: `input` acts from the moment at which `count` is read, and `age` is the time from the last edge
 * to that moment [s]. Returns the status bits. */
uint32_t pmf_step(const pmf_config_t *config, pmf_state_t *state, real_t input, uint32_t count, real_t age);
/* Return the estimate of the last step. */
const pmf_estimate_t *pmf_estimate(const pmf_config_t *config, const pmf_state_t *state);
/* Return the variance of an estimated parameter, PMF_UNKNOWN before the first estimate. */
real_t pmf_variance(const pmf_config_t *config, const pmf_state_t *state, uint32_t parameter);

#endif
