/* Stand-ins of the straight steps, if the general step is compiled alone. SPDX-License-Identifier: Apache-2.0 */
#include "pmf_straight.h"
static uint32_t is_for(const pmf_config_t *config)
{
    return config == 0;
}
const pmf_straight_t pmf_straight_rls = {is_for, 0, 0}, pmf_straight_bcrls = {is_for, 0, 0},
                     pmf_straight_riv = {is_for, 0, 0};
