/* Sizes and parts of this build, which has room for every configuration. `pmfid export` replaces this file by one for
 * the exported configuration. SPDX-License-Identifier: Apache-2.0 */
#ifndef PMF_SIZES_H
#define PMF_SIZES_H

#define PMF_MAX_STAGES 128
#define PMF_MAX_TAPS 160
#define PMF_MAX_PARAMETERS 8
#define PMF_MAX_MISREADS PMF_MAX_PARAMETERS /* parameters with errors from misread counts, at least 1 */
#define PMF_MAX_COLUMNS (5 * PMF_MAX_PARAMETERS + 4)
#define PMF_MAX_LATE 22 /* inputs kept for a dead time, two more than its whole samples */
#define PMF_MAX_SHAPES 6 /* number of shapes in the auxiliary model; 0 leaves shapes out */
#define PMF_MAX_KNOTS 520 /* knots in the tables of all shapes */
#define PMF_MAX_RATES 16 /* rules by which stages follow a varying step */

/* 0 leaves out a part with its code and memory. */
#define PMF_WITH_AUXILIARY 1 /* the auxiliary model and its recursion */
#define PMF_WITH_PROCESS 1 /* the output of a process, with its start and noise */
#define PMF_WITH_DEAD_TIME 1 /* an input that acts late, or with a first-order lag */
#define PMF_WITH_GUARD 1 /* guard against samples that no motion explains */
#define PMF_WITH_SPLIT 1 /* signals beyond input, velocity and direction */
#define PMF_WITH_MISREAD 1 /* standard errors include the late direction of coarse counts */
#define PMF_WITH_STEPS 1 /* each sample has the time since the preceding sample */
#define PMF_WITH_NETWORK 1 /* the network is part of the configuration; otherwise it is code */

#define PMF_LAYOUT 0U /* CRC-32 of the state's fields. Python computes the number for the module. */
#define PMF_CONFIG 0U /* CRC-32 of the configuration, likewise */

/* An export also defines the number of parameters of every recursion (PMF_PARAMETERS), the use of instruments
 * (PMF_INSTRUMENTAL), and PMF_FLOAT32 for float32 arithmetic. The build defines these for the module. */

#endif
