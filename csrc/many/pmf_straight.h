/* Steps of one axis for the most frequent configurations, from the same sources compiled for one method and its
 * network. SPDX-License-Identifier: Apache-2.0 */
#ifndef PMF_STRAIGHT_H
#define PMF_STRAIGHT_H

#include "pmf_many.h"

typedef uint32_t pmf_stepper_t(const pmf_config_t *config, pmf_state_t *state, scalar_t input, uint32_t count);

/* Return whether a method's code is compiled for a configuration. `plain` needs a fixed step, no shapes and no dead
 * time. */
typedef uint32_t pmf_condition_t(const pmf_config_t *config);
pmf_condition_t pmf_is_rls, pmf_is_bcrls, pmf_is_riv, pmf_is_plain;
/* The steps of the methods, and their encoder and filters. */
pmf_stepper_t pmf_step_rls, pmf_step_bcrls, pmf_step_riv, pmf_step_plain;
pmf_stepper_t pmf_filter_rls, pmf_filter_bcrls, pmf_filter_riv, pmf_filter_plain;

/* Return PMF_GENERAL or the method of a configuration. */
uint32_t pmf_method_of(const pmf_config_t *config);
/* Return the fastest step of a configuration, with the bits of pmf_step(). */
pmf_stepper_t *pmf_fastest_step(const pmf_config_t *config);
/* Return the fastest filters of a configuration, with the bits of pmf_filter(). */
pmf_stepper_t *pmf_fastest_filter(const pmf_config_t *config);

#endif
