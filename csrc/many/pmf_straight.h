/* Steps of one axis for the most frequent configurations, from the same sources compiled for one method and its
 * network. SPDX-License-Identifier: Apache-2.0 */
#ifndef PMF_STRAIGHT_H
#define PMF_STRAIGHT_H

#include "pmf_many.h"

typedef uint32_t pmf_stepper_t(const pmf_config_t *config, pmf_state_t *state, scalar_t input, uint32_t count);

/* The code of a method: whether a configuration is one for which it is compiled, step, and encoder with filters. */
typedef struct {
    uint32_t (*is_for)(const pmf_config_t *config);
    pmf_stepper_t *step, *filter;
} pmf_straight_t;

extern const pmf_straight_t pmf_straight_rls, pmf_straight_bcrls, pmf_straight_riv;

/* Return PMF_GENERAL or the method of a configuration. */
uint32_t pmf_method_of(const pmf_config_t *config);
/* Return the fastest step of a configuration, with the bits of pmf_step(). */
pmf_stepper_t *pmf_fastest_step(const pmf_config_t *config);
/* Return the fastest filters of a configuration, with the bits of pmf_filter(). */
pmf_stepper_t *pmf_fastest_filter(const pmf_config_t *config);

#endif
