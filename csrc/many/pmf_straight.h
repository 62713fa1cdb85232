/* Steps of one axis for the most frequent configurations, from the same sources compiled for one method and its
 * network. SPDX-License-Identifier: Apache-2.0 */
#ifndef PMF_STRAIGHT_H
#define PMF_STRAIGHT_H

#include "pmf_many.h"

typedef uint32_t pmf_stepper_t(const pmf_config_t *config, pmf_state_t *state, scalar_t input, uint32_t count);

/* Return whether a configuration is one for which a method's code is compiled. */
uint32_t pmf_is_rls(const pmf_config_t *config);
uint32_t pmf_is_bcrls(const pmf_config_t *config);
uint32_t pmf_is_riv(const pmf_config_t *config);
/* The steps of the methods. */
uint32_t pmf_step_rls(const pmf_config_t *config, pmf_state_t *state, scalar_t input, uint32_t count);
uint32_t pmf_step_bcrls(const pmf_config_t *config, pmf_state_t *state, scalar_t input, uint32_t count);
uint32_t pmf_step_riv(const pmf_config_t *config, pmf_state_t *state, scalar_t input, uint32_t count);
/* Encoder and filters of the methods. */
uint32_t pmf_filter_rls(const pmf_config_t *config, pmf_state_t *state, scalar_t input, uint32_t count);
uint32_t pmf_filter_bcrls(const pmf_config_t *config, pmf_state_t *state, scalar_t input, uint32_t count);
uint32_t pmf_filter_riv(const pmf_config_t *config, pmf_state_t *state, scalar_t input, uint32_t count);

/* Return PMF_GENERAL or the method of a configuration. */
uint32_t pmf_method_of(const pmf_config_t *config);
/* Return the fastest step of a configuration, with the bits of pmf_step(). */
pmf_stepper_t *pmf_fastest_step(const pmf_config_t *config);
/* Return the fastest filters of a configuration, with the bits of pmf_filter(). */
pmf_stepper_t *pmf_fastest_filter(const pmf_config_t *config);

#endif
