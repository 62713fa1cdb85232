/* Sizes and parts of this build: here room for every configuration. `pmfid export` replaces this file by one that fits
 * the exported configuration. SPDX-License-Identifier: Apache-2.0
 */
#ifndef PMF_SIZES_H
#define PMF_SIZES_H

#define PMF_MAX_STAGES 128
#define PMF_MAX_TAPS 160
#define PMF_MAX_PARAMETERS 8
#define PMF_MAX_NOISE PMF_MAX_PARAMETERS
#define PMF_MAX_COLUMNS (5 * PMF_MAX_PARAMETERS + 4)
#define PMF_MAX_ORDER 6 /* of the linear process that is simulated */
#define PMF_MAX_LATE 22 /* inputs that are kept for a dead time: one more than its whole samples, and one */
#define PMF_MAX_SHAPES 6 /* of forces that the auxiliary model has in addition to the body's; 0 leaves them out */
#define PMF_MAX_KNOTS 520 /* in the tables of all of them */
#define PMF_MAX_RATES 16 /* ways in which stages follow a step that varies */
#define PMF_WINDOW_BLOCKS 8 /* of a sliding window; 0 saves their memory where no window is used */

/* 0 leaves a part out, its code and its memory. */
#define PMF_WITH_AUXILIARY 1 /* the auxiliary model and its recursion */
#define PMF_WITH_LINEAR 1 /* the model of a linear process and its recursion */
#define PMF_WITH_PROCESS 1 /* an output that no encoder's friction holds: its start and its own noise */
#define PMF_WITH_DEAD_TIME 1 /* an input that acts late */
#define PMF_WITH_DEAD_TIME_FOUND 1 /* and it is estimated */
#define PMF_WITH_LAG 1 /* the same with a first-order lag */
#define PMF_WITH_SEPARATE 1 /* forgetting by parameter */
#define PMF_WITH_GUARD 1 /* against samples that no motion explains */
#define PMF_WITH_ENDLESS 1 /* float32 that forgets nothing, or so slowly that its sums may be full */
#define PMF_WITH_SPLIT 1 /* signals beyond input, velocity and direction */
#define PMF_WITH_NOISE 1 /* known covariance of the noise */
#define PMF_WITH_STEPS 1 /* each sample comes with the time since the last one */

#define PMF_LAYOUT 0U /* CRC-32 of the state's fields; in the module Python knows it */

/* An export also says how many parameters every recursion has (PMF_PARAMETERS), whether it has instruments
 * (PMF_INSTRUMENTAL) and how it forgets (PMF_SCHEME), and PMF_FLOAT32 where the arithmetic is that; here the module's
 * build does. */

#endif
