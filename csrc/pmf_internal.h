/* The kernel from within: what its sources share and a drive does not need. Firmware includes pmf.h alone.
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef PMF_INTERNAL_H
#define PMF_INTERNAL_H

#include "pmf.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The choices that depend on the data, of one axis; many/pmf_lanes.h defines them for several side by side. */
#ifndef PMF_LANES
typedef int truth_t; /* combined by & and |, turned round by PMF_NOT */
#define PMF_W(x) ((uint32_t)(x))
#define PMF_ALIKE(x) (x)
#define PMF_TO_REAL(x) ((real_t)(x))
#define PMF_TO_INTEGER(x) ((integer_t)(x))
#define PMF_IF(truth, yes, no) ((truth) ? (yes) : (no))
#define PMF_READ(table, index) ((table)[index])
#define PMF_ANY(truth) ((truth) != 0)
#define PMF_ALL(truth) ((truth) != 0)
/* Does `action`, which changes nothing but `object` (a pointer) that is kept, where the truth holds. */
#define PMF_WHERE(truth, object, action) \
    do {                                 \
        if ((truth) != 0) {              \
            action;                      \
        }                                \
    } while (0)
#endif
/* Lanes and straight steps (many/pmf_straight.c) leave parts out that the structures have room for. */
#if defined(PMF_LANES) || defined(PMF_STRAIGHT)
#define PMF_WHOLE 0
#define PMF_LINEAR 0 /* its matrices would pay in lanes only where all axes compute them at once */
#else
#define PMF_WHOLE 1
#define PMF_LINEAR PMF_WITH_LINEAR
#endif
#ifdef PMF_WITH_MODEL /* one method of a drive */
#define PMF_PROCESS 0
#define PMF_MODELLED(config) PMF_WITH_MODEL
#else
#define PMF_PROCESS PMF_WITH_PROCESS
#define PMF_MODELLED(config) ((config)->auxiliary.enabled != 0U)
#endif
#if !PMF_WHOLE && !defined(PMF_MOTIONS)
#define PMF_SHAPED 0 /* tables that each axis reads elsewhere pay for motions alone (many/pmf_motions.c) */
#define PMF_LATE 0 /* as do other inputs for each axis */
#else
#define PMF_SHAPED (PMF_MAX_SHAPES > 0)
#define PMF_LATE PMF_WITH_DEAD_TIME
#endif
#if !PMF_WHOLE
#define PMF_STEPS 0 /* each axis would have coefficients of its own */
#else
#define PMF_STEPS PMF_WITH_STEPS
#endif
/* Does the step vary? In an export with steps it does. */
#if PMF_LAYOUT != 0U
#define PMF_STEPPED(truth) ((void)(truth), 1)
#else
#define PMF_STEPPED(truth) (truth)
#endif
/* A sample period in the unit of pauses, and the interval that the auxiliary model simulates [s]. */
#if PMF_STEPS
#define PMF_SAMPLE(config) (PMF_STEPPED((config)->rate > PMF_R(0.0)) ? (uint32_t)PMF_TICKS : 1U)
#define PMF_SPAN(config, state) (PMF_STEPPED((config)->steps != 0U) ? (state)->step : (config)->dt)
#else
#define PMF_SAMPLE(config) 1U
#define PMF_SPAN(config, state) ((config)->dt)
#endif
#if !PMF_WHOLE
#define PMF_FOUND 0
#else
#define PMF_FOUND (PMF_LATE && PMF_WITH_DEAD_TIME_FOUND)
#endif
#ifdef PMF_FLOAT32
#define PMF_ENDLESS PMF_WITH_ENDLESS
#else
#define PMF_ENDLESS 0 /* no sum of float64 is ever full */
#endif
#define PMF_NOT(truth) ((truth) == 0)
#define PMF_BIT(truth, bit) PMF_IF(truth, PMF_W(bit), PMF_W(0))

/* What runs seldom is compiled for size. */
#if defined(__GNUC__)
#define PMF_SELDOM __attribute__((cold, noinline)) static
#else
#define PMF_SELDOM static
#endif

/* Of a dead time that is estimated: what is believed of it. */
#define PMF_BELIEVES_NONE 0U /* what the recursion has, for there is nothing better */
#define PMF_BELIEVES_HELD 1U /* what was believed last */
#define PMF_BELIEVES_OWN 2U /* the recursion, which knows it well */
#define PMF_BELIEVES_WITHIN 3U /* the motion within the counts */

#define PMF_OLDEST 1000000U /* samples that it counts */
#define PMF_LOOKS 2U /* until it is believed */
#define PMF_MOST_TRIES 3U /* beginnings */

#define PMF_FOLLOWED 4U /* so often is the slow copy of the estimate taken on; a power of two */

/* Limits of what a state may hold. */
#define PMF_FAST_SAMPLES 3U /* after two counts in one sample or more */
#define PMF_BLOCK_MEMORY 100U /* blocks of innovations */
#define PMF_LEAST_RATIO PMF_R(1e-6) /* of a step to the sample period */
#define PMF_MOST_RATIO PMF_R(100.0)
#define PMF_LONGEST 4U /* periods: a longer step is a gap, not the clock */
#define PMF_LOOK 4U /* updates between two looks at the size of the motion: no column changes much faster */
#define PMF_SWING_BITS 15U /* what they may show, in this half memory and in the last */
/* From encoder to filters alone: a wrong count was replaced as well as an encoder can tell. */
#define PMF_BRIDGED 0x80000000U
#define PMF_BEGIN_AGAIN 0x40000000U /* wrong counts were believed while the guard learned */
#define PMF_GUARD_SUSPECTS 16U /* suspicious changes in a row; then the guard restarts */
#define PMF_GUARD_SOUND 3U /* samples since a suspicious one: then a miss and its neighbours are the motion's */
#define PMF_GUARD_DOUBTS 3U /* on the last two inputs, as bits; that before the last has the higher one */
#ifdef PMF_FLOAT32
#define PMF_LARGEST_INPUT PMF_R(1e15)
#else
#define PMF_LARGEST_INPUT PMF_R(1e100)
#endif

#if PMF_PROCESS
/* After a step, or another change of the estimate: that of the output itself in state->lifted. */
PMF_API void pmf_lift(const pmf_config_t *config, pmf_state_t *state);
#endif
void pmf_recursion_covariance(const pmf_recursion_config_t *config, const pmf_recursion_state_t *state, real_t *p);
/* What each step computes before it reads it is zero in what is saved. */
void pmf_clear_computed(const pmf_config_t *config, pmf_state_t *state);
/* Byte-wise, too: an assignment need not copy the padding, which a checksum covers. */
void pmf_copy(const void *from, void *to, uint32_t size);

/* The parts; `signal` has PMF_SIGNALS entries. */
PMF_API whole_t pmf_encoder_step(const pmf_encoder_config_t *config, pmf_encoder_state_t *state, real_t input,
                                 whole_t count, real_t *signal);
/* Needs the encoder's signals of the same step. */
PMF_API void pmf_auxiliary_step(const pmf_auxiliary_config_t *config, pmf_auxiliary_state_t *state, real_t *signal);
#if PMF_LATE
/* The same where the input changes inside the interval. */
PMF_API void pmf_auxiliary_late_step(const pmf_auxiliary_config_t *config, pmf_auxiliary_state_t *state,
                                     const pmf_late_state_t *late, real_t *signal);
#endif
#if PMF_FOUND
/* What acts in an interval: `part` of it the older input, then the newer one. */
typedef struct {
    real_t older, newer, part;
} acts_t;

/* A motion of its own, moved by that, is brought within the next count, and what moves it with it. `usable`: the counts
 * are what the axis did. */
void pmf_within_step(const pmf_config_t *config, pmf_state_t *state, const acts_t *acts, uint32_t usable);
/* The auxiliary model is set to that motion, which the counts have judged already. */
void pmf_within_lend(const pmf_config_t *config, pmf_state_t *state);
/* Is the dead time of that motion to be believed, and its variance. */
uint32_t pmf_within_known(const pmf_config_t *config, const pmf_state_t *state, real_t *variance);
#endif
#if PMF_SHAPED
/* Forces of a place at that of the counts; needs the encoder's signals of the same step. */
PMF_API void pmf_shapes_measured(const pmf_shapes_config_t *config, real_t *signal);
#endif
/* The equation holds exactly for the model; what its columns leave is the error of the discretisation, and the same
 * for the plant. It is taken from the target. Regressors and target then know that the model's stops and reversals move
 * with its parameters. `first`: the column of the first regressor. */
PMF_API void pmf_auxiliary_correct(const pmf_auxiliary_config_t *config, const pmf_auxiliary_state_t *state,
                                   uint32_t first, real_t *column);
PMF_API void pmf_auxiliary_start(const pmf_auxiliary_config_t *config, pmf_auxiliary_state_t *state);
/* Judges the model against the measured velocity; true where its instruments may be used. */
PMF_API truth_t pmf_auxiliary_check(const pmf_auxiliary_config_t *config, pmf_auxiliary_state_t *state,
                                    const real_t *column, truth_t held);
/* Do the changes of the input follow the innovations? PMF_FEEDBACK or 0; `where`: the recursion has made a step. */
PMF_API whole_t pmf_auxiliary_feedback(pmf_auxiliary_state_t *state, const pmf_recursion_state_t *recursion,
                                       truth_t where, real_t change);
/* Does the measured velocity lag the model's, as if the input acts late? PMF_DEAD_TIME or 0. */
PMF_API whole_t pmf_auxiliary_late(const pmf_auxiliary_config_t *config, pmf_auxiliary_state_t *state,
                                   const real_t *column, truth_t where);
/* Moves the copy towards an estimate, whose parameters are found by `index`. */
PMF_API void pmf_auxiliary_follow(const pmf_auxiliary_config_t *config, pmf_auxiliary_state_t *state, truth_t where,
                                  const real_t *theta, const uint32_t *index);
#if PMF_LINEAR
/* Columns of the linear process, from the network's nodes of the same step. */
void pmf_linear_step(const pmf_linear_config_t *config, pmf_linear_state_t *state, const real_t *node, real_t *column);
/* The recursion on them where the model has settled, else the direct estimate: its status. */
uint32_t pmf_linear_estimate(const pmf_config_t *config, pmf_state_t *state, uint32_t direct_status, uint32_t settled);
/* Lets everything gathered so far count by a factor <= 1. */
void pmf_recursion_discount(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, real_t factor);
#endif
PMF_API void pmf_network_step(const pmf_network_config_t *config, pmf_network_state_t *state);
PMF_API whole_t pmf_recursion_step(const pmf_recursion_config_t *config, pmf_recursion_state_t *state,
                                   const real_t *column);
#if PMF_PROCESS
/* The estimate of an output that was counted from its first value, with the constant for the output itself. */
PMF_API void pmf_recursion_lift(const pmf_recursion_config_t *config, pmf_recursion_state_t *state,
                                pmf_estimate_t *lifted);
#endif
/* Encoder, auxiliary model and network alone, for batch methods: the columns are in state->network.column. */
PMF_API whole_t pmf_filter(const pmf_config_t *config, pmf_state_t *state, real_t input, whole_t count);

#ifdef __cplusplus
}
#endif

#endif
