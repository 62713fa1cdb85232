/* The parts of the kernel for a drive with mass, viscous and Coulomb friction. PMF_STRAIGHT names the recursive method.
 * The code has no tests for absent parts, unrolled loops over parameters, and the network as straight code.
 * SPDX-License-Identifier: Apache-2.0 */
#define METHOD_rls 1
#define METHOD_bcrls 2
#define METHOD_riv 3
/* A name and the method, or the number of bytes, for which code is compiled. */
#define JOINED(name, kind) name##_##kind
#define JOIN(name, kind) JOINED(name, kind)
#define METHOD JOIN(METHOD, PMF_STRAIGHT)

/* Lists of the stages (number, source), the columns and the further taps (column, tap, node). */
#define MEASURED(STAGE, DELAY) \
    STAGE(0, 1) STAGE(1, 25) DELAY(2, 25) DELAY(3, 26) DELAY(4, 28) STAGE(5, 2) STAGE(6, 30) STAGE(7, 0) STAGE(8, 32)
#define DIRECT(COLUMN, TAP) \
    COLUMN(0, 0, 27) TAP(0, 1, 28) COLUMN(1, 2, 26) TAP(1, 3, 28) TAP(1, 4, 29) COLUMN(2, 5, 31) COLUMN(3, 6, 33)
#define PREFILTERED(STAGE) STAGE(9, 33) STAGE(10, 34) STAGE(11, 33) STAGE(12, 36)
#define INSTRUMENTS(COLUMN) COLUMN(4, 7, 35) COLUMN(5, 8, 37) COLUMN(6, 9, 31)

/* clang-format off */
#if METHOD == METHOD_rls
#define PMF_NETWORK(STAGE, DELAY, COLUMN, TAP) \
    MEASURED(STAGE, DELAY) STAGE(9, 11) STAGE(10, 34) STAGE(11, 10) STAGE(12, 36) \
    DIRECT(COLUMN, TAP) COLUMN(4, 7, 35) COLUMN(5, 8, 37)
#elif METHOD == METHOD_bcrls
#define PMF_NETWORK(STAGE, DELAY, COLUMN, TAP) \
    MEASURED(STAGE, DELAY) PREFILTERED(STAGE) STAGE(13, 11) STAGE(14, 38) STAGE(15, 10) STAGE(16, 40) \
    DIRECT(COLUMN, TAP) INSTRUMENTS(COLUMN) COLUMN(7, 10, 39) COLUMN(8, 11, 41)
#elif METHOD == METHOD_riv
#define PMF_NETWORK(STAGE, DELAY, COLUMN, TAP) \
    MEASURED(STAGE, DELAY) PREFILTERED(STAGE) STAGE(13, 10) STAGE(14, 38) STAGE(15, 8) STAGE(16, 40) \
    STAGE(17, 9) STAGE(18, 42) STAGE(19, 20) STAGE(20, 44) DIRECT(COLUMN, TAP) INSTRUMENTS(COLUMN) \
    COLUMN(7, 10, 27) TAP(7, 11, 28) COLUMN(8, 12, 28) COLUMN(9, 13, 39) COLUMN(10, 14, 41) \
    COLUMN(11, 15, 42) TAP(11, 16, 43) COLUMN(12, 17, 43) COLUMN(13, 18, 39) \
    COLUMN(14, 19, 28) COLUMN(15, 20, 43) COLUMN(16, 21, 45)
#endif
/* clang-format on */
#if METHOD == 0
#define PMF_NETWORK_FILE "../pmf_network.c"
#else
#define PMF_NETWORK_FILE "../code/pmf_network_code.c"
#define KNOWN_STAGE(k, from) STAGE(k, from, config->stage[k].a, config->stage[k].b0, config->stage[k].b1)
#define KNOWN_COLUMN(c, t, from) COLUMN(c, from, config->tap[t].weight)
#define KNOWN_TAP(c, t, from) TAP(c, from, config->tap[t].weight)
#define PMF_STAGES(STAGE, RISE, DELAY) PMF_NETWORK(KNOWN_STAGE, DELAY, KNOWN_COLUMN, KNOWN_TAP)
#define PMF_COLUMNS(COLUMN, TAP)
#define PMF_PARAMETERS 3U
#define PMF_INSTRUMENTAL (METHOD != METHOD_rls)
#define PMF_WITH_MODEL (METHOD == METHOD_riv)
#if !PMF_WITH_MODEL
#define PMF_SPLIT 0
#endif
#endif
