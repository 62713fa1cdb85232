/* The step of one axis, compiled again for each recursive method. SPDX-License-Identifier: Apache-2.0 */
#include "pmf_method.h"
#define PMF_API static __attribute__((unused))

#include "../pmf_auxiliary.c"
#include "../pmf_verdicts.c"
#include "../pmf_encoder.c"
#include "../pmf_guard.c"
#include PMF_NETWORK_FILE
#include "../pmf_recursion.c"
#include "../pmf_step.c"
#include "../pmf_instrument.c"

#include "pmf_straight.h"

#define ALIKE_STAGE(k, from) \
    n_stages += 1U;          \
    alike &= network->stage[k].source == (from);
#define ALIKE_DELAY(k, from) \
    ALIKE_STAGE(k, from)     \
    alike &= network->stage[k].a == 0 && network->stage[k].b0 == 0 && network->stage[k].b1 == 1;
#define ALIKE_TAP(c, t, from)                \
    alike &= network->tap[t].node == (from); \
    last = t;
#define ALIKE_COLUMN(c, t, from)                                        \
    alike &= (c) == 0U || network->tap_end[(c) ? (c) - 1U : 0U] == (t); \
    n_columns += 1U;                                                    \
    ALIKE_TAP(c, t, from)

static uint32_t has_network(const pmf_network_config_t *network)
{
    uint32_t alike = 1U, n_stages = 0U, n_columns = 0U, last = 0U;
    PMF_NETWORK(ALIKE_STAGE, ALIKE_DELAY, ALIKE_COLUMN, ALIKE_TAP)
    return alike && network->n_stages == n_stages && network->n_columns == n_columns && network->n_rates == 0U &&
           network->tap_end[n_columns - 1U] == last + 1U;
}

static uint32_t has_recursion(const pmf_recursion_config_t *config)
{
    uint32_t i, alike = config->target_power == 0 && config->lift == 0 && config->constant == PMF_NO_PARAMETER;
    for (i = 0; i < PMF_PARAMETERS; ++i) {
        alike &= config->target_noise[i] == 0;
    }
    return alike && config->n_parameters == PMF_PARAMETERS && config->instrumental == PMF_INSTRUMENTAL;
}

static uint32_t has_method(const pmf_config_t *config)
{
    return config->encoder.rate == 0 && config->late.kept == 0U && config->auxiliary.shapes.n == 0U &&
           config->encoder.process == 0U && config->auxiliary.enabled == PMF_WITH_MODEL &&
           has_network(&config->network) && has_recursion(&config->direct) &&
           (PMF_WITH_MODEL == 0 || has_recursion(&config->instrument));
}

const pmf_straight_t JOIN(pmf_straight, PMF_STRAIGHT) = {has_method, pmf_step, pmf_filter};
