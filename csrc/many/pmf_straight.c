/* The step of a drive with mass, viscous and Coulomb friction, once for each recursive method: without tests for parts
 * that it has not, its loops over parameters unrolled and its network as straight code.
 * SPDX-License-Identifier: Apache-2.0
 *
 * Compiled with PMF_STRAIGHT as the name of the method.
 */
#define METHOD_rls 1
#define METHOD_bcrls 2
#define METHOD_riv 3
#define NUMBER_OF(method) METHOD_##method
#define NUMBER(method) NUMBER_OF(method)
#define METHOD NUMBER(PMF_STRAIGHT)

/* Stages: number, source; columns and their further taps: column, tap, node. */
#define MEASURED(STAGE, DELAY) \
    STAGE(0, 1) STAGE(1, 25) DELAY(2, 25) DELAY(3, 26) DELAY(4, 28) STAGE(5, 2) STAGE(6, 30) STAGE(7, 0) STAGE(8, 32)
#define DIRECT(COLUMN, TAP) \
    COLUMN(0, 0, 27) TAP(0, 1, 28) COLUMN(1, 2, 26) TAP(1, 3, 28) TAP(1, 4, 29) COLUMN(2, 5, 31) COLUMN(3, 6, 33)
#define PREFILTERED(STAGE) STAGE(9, 33) STAGE(10, 34) STAGE(11, 33) STAGE(12, 36)
#define INSTRUMENTS(COLUMN) COLUMN(4, 7, 35) COLUMN(5, 8, 37) COLUMN(6, 9, 31)
#define SIMULATED(STAGE) \
    STAGE(13, 10) STAGE(14, 38) STAGE(15, 8) STAGE(16, 40) STAGE(17, 9) STAGE(18, 42) STAGE(19, 20) STAGE(20, 44)
#define BY_MODEL(COLUMN, TAP) COLUMN(7, 10, 27) TAP(7, 11, 28) COLUMN(8, 12, 28) COLUMN(9, 13, 39) COLUMN(10, 14, 41)
#define OF_MODEL(COLUMN, TAP) COLUMN(11, 15, 42) TAP(11, 16, 43) COLUMN(12, 17, 43) COLUMN(13, 18, 39)
#define CHECKED(COLUMN) COLUMN(14, 19, 28) COLUMN(15, 20, 43) COLUMN(16, 21, 45)

#if METHOD == METHOD_rls
#define PMF_NETWORK(STAGE, DELAY, COLUMN, TAP) MEASURED(STAGE, DELAY) DIRECT(COLUMN, TAP)
#elif METHOD == METHOD_bcrls
#define PMF_NETWORK(STAGE, DELAY, COLUMN, TAP) \
    MEASURED(STAGE, DELAY) PREFILTERED(STAGE) DIRECT(COLUMN, TAP) INSTRUMENTS(COLUMN)
#else
#define PMF_NETWORK(STAGE, DELAY, COLUMN, TAP) \
    MEASURED(STAGE, DELAY)                     \
    PREFILTERED(STAGE)                         \
    SIMULATED(STAGE) DIRECT(COLUMN, TAP) INSTRUMENTS(COLUMN) BY_MODEL(COLUMN, TAP) OF_MODEL(COLUMN, TAP) CHECKED(COLUMN)
#endif
#define PMF_PARAMETERS 3U
#define PMF_INSTRUMENTAL (METHOD != METHOD_rls)
#define PMF_WITH_MODEL (METHOD == METHOD_riv)
#define PMF_SCHEME PMF_EXPONENTIAL
#define PMF_API static __attribute__((unused))

#include "../pmf_auxiliary.c"
#include "../pmf_verdicts.c"
#include "../pmf_encoder.c"
#include "../pmf_network.c"
#include "../pmf_recursion.c"
#include "../pmf_step.c"

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
    return alike && config->n_parameters == PMF_PARAMETERS && config->instrumental == PMF_INSTRUMENTAL &&
           config->scheme == PMF_SCHEME;
}

static uint32_t step_straight(const pmf_config_t *config, pmf_state_t *state, scalar_t input, uint32_t count)
{
    return pmf_step(config, state, input, count);
}

#define PASTE(method) pmf_straight_##method
#define STRAIGHT(method) PASTE(method)
pmf_stepper_t *STRAIGHT(PMF_STRAIGHT)(const pmf_config_t *config)
{
    uint32_t plain = config->encoder.process == 0U && config->encoder.rate == 0 && config->late.room == 0U &&
                     config->linear.enabled == 0U && config->auxiliary.shapes.n == 0U &&
                     config->auxiliary.enabled == PMF_WITH_MODEL;
    return plain && has_network(&config->network) && has_recursion(&config->direct) &&
                   (PMF_WITH_MODEL == 0 || has_recursion(&config->instrument))
               ? step_straight
               : 0;
}
