/* Steps of one axis for configurations that are used most: the same sources, compiled for one method and its network.
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef PMF_STRAIGHT_H
#define PMF_STRAIGHT_H

#include "pmf_many.h"

typedef uint32_t pmf_stepper_t(const pmf_config_t *config, pmf_state_t *state, scalar_t input, uint32_t count);

/* Is a configuration one of those that the code of a method is compiled for? */
uint32_t pmf_is_rls(const pmf_config_t *config);
uint32_t pmf_is_bcrls(const pmf_config_t *config);
uint32_t pmf_is_riv(const pmf_config_t *config);
/* Has it a fixed step, and neither shapes nor a dead time nor a linear process that is simulated? */
uint32_t pmf_is_plain(const pmf_config_t *config);
/* The steps of these. */
uint32_t pmf_step_rls(const pmf_config_t *config, pmf_state_t *state, scalar_t input, uint32_t count);
uint32_t pmf_step_bcrls(const pmf_config_t *config, pmf_state_t *state, scalar_t input, uint32_t count);
uint32_t pmf_step_riv(const pmf_config_t *config, pmf_state_t *state, scalar_t input, uint32_t count);
uint32_t pmf_step_plain(const pmf_config_t *config, pmf_state_t *state, scalar_t input, uint32_t count);

/* Of PMF_GENERAL and so on. */
uint32_t pmf_method_of(const pmf_config_t *config);
/* The fastest step of a configuration, with the bits of pmf_step(). */
pmf_stepper_t *pmf_fastest_step(const pmf_config_t *config);

#endif
