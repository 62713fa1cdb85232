/* The internal interface between the kernel's sources. Firmware includes only pmf.h. SPDX-License-Identifier:
 * Apache-2.0 */
#ifndef PMF_INTERNAL_H
#define PMF_INTERNAL_H

#include "pmf.h"

/* Choices that depend on the data, for one axis; many/pmf_lanes.h defines them for several axes at once. */
#ifndef PMF_LANES
typedef int truth_t; /* truths, combined by & and | and inverted by PMF_NOT */
#define PMF_W(x) ((uint32_t)(x))
#define PMF_ALIKE(x) (x)
#define PMF_TO_REAL(x) ((real_t)(x))
#define PMF_IF(truth, yes, no) ((truth) ? (yes) : (no))
#if !defined(__GNUC__) /* the size of -0 has no effect */
#define PMF_SIZE(x) ((x) < PMF_R(0.0) ? -(x) : (x))
#elif defined(PMF_FLOAT32)
#define PMF_SIZE(x) __builtin_fabsf(x)
#else
#define PMF_SIZE(x) __builtin_fabs(x)
#endif
#define PMF_WIDTH 1U /* axes, and the value of one of them */
#define PMF_LANE(x, lane) (*((void)(lane), &(x)))
#define PMF_ANY(truth) ((truth) != 0)
#define PMF_ALL(truth) ((truth) != 0)
#define PMF_APART static PMF_ATTRIBUTE((noinline))
/* Do `action`, which changes only `object` (a pointer), if the truth holds. */
#define PMF_WHERE(truth, object, action) \
    do {                                 \
        if ((truth) != 0) {              \
            action;                      \
        }                                \
    } while (0)
#endif
/* Numbers for float32 and for float64. */
#ifdef PMF_FLOAT32
#define PMF_EITHER(single, twice) PMF_R(single)
#else
#define PMF_EITHER(single, twice) PMF_R(twice)
#endif
#define PMF_NOT(truth) ((truth) == 0)
#define PMF_BIT(truth, bit) PMF_IF(truth, PMF_W(bit), PMF_W(0))

#if defined(__GNUC__)
#define PMF_ATTRIBUTE(words) __attribute__(words)
#else
#define PMF_ATTRIBUTE(words)
#endif
/* Rarely used code is compiled for size. */
#define PMF_SELDOM PMF_ATTRIBUTE((cold, noinline)) static
/* Firmware has code with branches, but without long loops. Small code is then also fast on a microcontroller. Elsewhere
 * loops over a constant number of parameters unroll. */
#if defined(PMF_PARAMETERS) && !defined(PMF_STRAIGHT)
#define PMF_FOR_SIZE PMF_ATTRIBUTE((cold))
#define PMF_INLINE static
#else
#define PMF_FOR_SIZE
#define PMF_INLINE static inline PMF_ATTRIBUTE((always_inline))
#endif

#ifdef PMF_WITH_EDGES
#define PMF_STATUS(state) ((state)->edge.status)
#else
#define PMF_STATUS(state) ((state)->status)

/* Lanes and straight steps (many/pmf_straight.c) leave out the code of some parts, but not their room in the
 * structures. */
#if defined(PMF_LANES) || defined(PMF_STRAIGHT)
#define PMF_WHOLE 0
#else
#define PMF_WHOLE 1
#endif
#ifdef PMF_WITH_MODEL /* straight steps are for one method of a drive */
#define PMF_PROCESS 0
#define PMF_MODELLED(config) PMF_WITH_MODEL
#elif PMF_WITH_AUXILIARY
#define PMF_PROCESS PMF_WITH_PROCESS
#define PMF_MODELLED(config) ((config)->auxiliary.enabled != 0U)
#else
#define PMF_PROCESS PMF_WITH_PROCESS
#define PMF_MODELLED(config) 0
#endif
#ifndef PMF_SPLIT /* otherwise no column has the signals beyond input, velocity and direction */
#define PMF_SPLIT PMF_WITH_SPLIT
#endif
#define PMF_SHAPED (PMF_WHOLE && PMF_MAX_SHAPES > 0) /* each axis reads a table elsewhere: lanes save no time */
#define PMF_LATE (PMF_WHOLE && PMF_WITH_DEAD_TIME) /* each axis reads another input: lanes save no time */
#define PMF_STEPS (PMF_WHOLE && PMF_WITH_STEPS) /* a varying step would give each axis its own coefficients */
/* Return whether the step varies. In an export with steps the step always varies. */
#define PMF_STEPPED(truth) (PMF_LAYOUT != 0U || (truth))
/* Return whether a reversal inside an interval is a separate signal. */
#ifdef PMF_TURNS
#define PMF_TURNED(config) PMF_TURNS
#else
#define PMF_TURNED(config) ((config)->turns)
#endif
/* Sample period in the unit of pauses, and interval [s] that the auxiliary model simulates. */
#if PMF_STEPS
#define PMF_SAMPLE(config) (PMF_STEPPED((config)->rate > PMF_R(0.0)) ? (uint32_t)PMF_TICKS : 1U)
#define PMF_SPAN(config, state) (PMF_STEPPED((config)->steps != 0U) ? (state)->step : (config)->dt)
#define PMF_SPACED(config) PMF_STEPPED((config)->encoder.rate > PMF_R(0.0)) /* whether the step varies */
#else
#define PMF_SPACED(config) 0
#define PMF_SAMPLE(config) 1U
#define PMF_SPAN(config, state) ((config)->dt)
#endif

#ifdef PMF_PARAMETERS
#define PARAMETERS(config) PMF_PARAMETERS
#define INSTRUMENTAL(config) PMF_INSTRUMENTAL
#else
#define PARAMETERS(config) ((config)->n_parameters)
#define INSTRUMENTAL(config) ((config)->instrumental)
#endif

/* Periods, and limits of the values in a state. */
enum pmf_limits {
    PMF_CLEARED = 64, /* samples between two searches for traces of zero signals in the filters, a power of two */
    PMF_FOLLOWED = 4, /* samples between two steps of the slow copy, a power of two */
    PMF_FAST_SAMPLES = 3, /* samples that count as fast after two or more counts in one sample */
    PMF_BLOCK_MEMORY = 100, /* memory of the statistics, in blocks of innovations */
    PMF_LONGEST = 4, /* largest ratio of a step to the sample period, above which the step is a gap */
    PMF_LOOK = 4, /* most samples between two solutions, because no column changes much faster */
    PMF_SWING_BITS = 15 /* bits of the looks in this half memory and the last */
};
static const scalar_t PMF_LEAST_RATIO = PMF_SCALAR(1e-6); /* least ratio of a step to the sample period */
static const scalar_t PMF_MOST_RATIO = PMF_SCALAR(100.0);
#define PMF_TINY PMF_EITHER(1e-30, 1e-200) /* a smaller number is nothing */
#define PMF_LARGEST_INPUT PMF_EITHER(1e15, 1e100)

/* Return a count modulo mask + 1 with its sign. */
static inline integer_t pmf_signed(uint32_t mask, whole_t count)
{
    uint32_t half = (mask >> 1) + 1U;
    return PMF_IF(count < half, (integer_t)count, ~(integer_t)(mask - count));
}

/* Parts of configuration and state that some exports leave out. Code for an absent part is never reached. */
#define PMF_GUARDED(config) (PMF_WITH_GUARD && (config)->encoder.guard != 0U)
#if PMF_WITH_PROCESS
#define PMF_LIFTED(state) (&(state)->lifted)
#define PMF_LIFT(recursion) ((recursion)->lift)
#else
#define PMF_LIFTED(state) (&(state)->direct.estimate)
#define PMF_LIFT(recursion) PMF_R(0.0)
#endif
/* Return whether the equation counts from the first output, so that `lifted` is the estimate for the output itself. */
#define PMF_LIFTS(config) (PMF_PROCESS && (config)->direct.constant != PMF_NO_PARAMETER)
#if PMF_WITH_DEAD_TIME
#define PMF_KEPT(config) ((config)->late.kept)
#else
#define PMF_KEPT(config) 0U
#endif
#if PMF_MAX_SHAPES > 0
#define PMF_SHAPES(config) ((config)->auxiliary.shapes.n)
#else
#define PMF_SHAPES(config) 0U
#endif

/* Write P of a recursion (n x n, row by row). */
void pmf_recursion_covariance(const pmf_recursion_config_t *config, const pmf_recursion_state_t *state, real_t *p);
/* A saved state has zeros for values that each step computes before their use. */
void pmf_clear_computed(const pmf_config_t *config, pmf_state_t *state);
/* The parts of a step; `signal` has PMF_SIGNALS entries. */
PMF_API whole_t pmf_encoder_step(const pmf_encoder_config_t *config, pmf_encoder_state_t *state, real_t input,
                                 whole_t count, real_t *signal);
/* Replace a sample by the one that the guard has judged, and return whether there is one. `guarded` gets its status
 * bits. The recursion waits until the filters have forgotten a count that may be wrong. */
PMF_API truth_t pmf_guard_sample(const pmf_config_t *config, pmf_state_t *state, real_t *input, whole_t *count,
                                 whole_t *guarded);
/* Clear the guard before a motion after lost samples. */
void pmf_guard_gap(pmf_state_t *state);
/* Set the reading of the counter at the last sample. Returns 0 if the guard holds no sample. */
uint32_t pmf_guard_rebase(pmf_state_t *state, uint32_t count);
/* Return 1 if the numbers can be those of a guard. */
uint32_t pmf_guard_plausible(const pmf_state_t *state);
/* Step the auxiliary model, after the encoder's signals of the same step. */
PMF_API void pmf_auxiliary_step(const pmf_auxiliary_config_t *config, pmf_auxiliary_state_t *state, real_t *signal);
/* Step the auxiliary model if the input changes inside the interval. */
void pmf_auxiliary_late_step(const pmf_auxiliary_config_t *config, pmf_auxiliary_state_t *state,
                             const pmf_late_state_t *late, real_t *signal);
/* Compute the forces of a place at the measured position, after the encoder's signals of the same step. */
void pmf_shapes_measured(const pmf_config_t *config, real_t *signal);
/* Begin at rest, also after an overflow. */
PMF_API void pmf_instrument_restart(const pmf_config_t *config, pmf_state_t *state);
/* Step the auxiliary model if it has parameters. */
PMF_API void pmf_instrument_simulate(const pmf_config_t *config, pmf_state_t *state);
/* Clear the traces of signals that have stayed zero, where `looks` holds. Rounding never lowers the least numbers of a
 * filter to zero, and many processors compute with such numbers ten times slower. */
PMF_API void pmf_clear_traces(truth_t looks, real_t *value, uint32_t values);
/* Correct the columns of this sample, see pmf_auxiliary_correct(). `looks` says when to clear traces. */
PMF_API void pmf_instrument_correct(const pmf_config_t *config, pmf_state_t *state, truth_t looks);
/* Half-way through the settling the model takes the measured velocity at once, instead of approaching it with its own
 * time constant. */
PMF_API void pmf_instrument_settle(const pmf_config_t *config, pmf_state_t *state, truth_t settling);
/* Use instrumental variables if the auxiliary model follows the plant, otherwise the direct estimate. Returns the
 * status of the estimate. */
PMF_API whole_t pmf_instrument_step(const pmf_config_t *config, pmf_state_t *state, whole_t direct_status,
                                    truth_t settled);
PMF_API uint32_t pmf_instrument_parameters(const pmf_config_t *config);
const pmf_estimate_t *pmf_instrument_estimate(const pmf_state_t *state);
void pmf_instrument_covariance(const pmf_config_t *config, const pmf_state_t *state, real_t *p);
void pmf_instrument_gap(const pmf_config_t *config, pmf_state_t *state);
/* Open the memory of the instrumental estimate. Returns the parameter of the direct estimate that belongs to the same
 * quantity. Without one, all parameters are opened. */
uint32_t pmf_instrument_open(const pmf_config_t *config, pmf_state_t *state, uint32_t parameter, real_t root);
/* Open the memory of a recursion, see pmf_open(). */
void pmf_recursion_open(const pmf_recursion_config_t *config, pmf_recursion_state_t *state, uint32_t parameter,
                        real_t root);
/* The equation holds exactly for the model. The residual of the model's columns is therefore the error of the
 * discretisation, which is subtracted from the target. Regressors and target then include the effect of the parameters
 * on the model's stops and reversals. `first` is the column of the first regressor. */
PMF_API void pmf_auxiliary_correct(const pmf_auxiliary_config_t *config, const pmf_auxiliary_state_t *state,
                                   uint32_t first, real_t *column);
PMF_API void pmf_auxiliary_start(const pmf_auxiliary_config_t *config, pmf_auxiliary_state_t *state);
/* Judge the model by the measured velocity, and return whether its instruments are usable. */
PMF_API truth_t pmf_auxiliary_check(const pmf_auxiliary_config_t *config, pmf_auxiliary_state_t *state,
                                    const real_t *column, truth_t held);
/* Return PMF_FEEDBACK if changes of the input follow the encoder's error, otherwise 0. `where` marks a step. */
PMF_API whole_t pmf_auxiliary_feedback(pmf_auxiliary_state_t *state, const real_t *signal, truth_t where,
                                       real_t change);
/* Return PMF_DEAD_TIME if the measured velocity lags the model's velocity, otherwise 0. */
PMF_API whole_t pmf_auxiliary_late(const pmf_auxiliary_config_t *config, pmf_auxiliary_state_t *state,
                                   const real_t *column, truth_t where);
/* Move the slow copy towards an estimate, with `index` as the places of its parameters. */
PMF_API void pmf_auxiliary_follow(const pmf_auxiliary_config_t *config, pmf_auxiliary_state_t *state, truth_t where,
                                  const real_t *theta, const uint32_t *index);
PMF_API void pmf_network_step(const pmf_network_config_t *config, pmf_network_state_t *state);
/* Add a sample to the sums, and solve for theta where a solution is due. Returns status bits. */
PMF_API whole_t pmf_recursion_step(const pmf_recursion_config_t *config, pmf_recursion_state_t *state,
                                   const real_t *column, truth_t due);
/* Write the estimate of the output itself to state->lifted, after a step or another change of the estimate. */
PMF_API void pmf_lift(const pmf_config_t *config, pmf_state_t *state);
/* Run encoder, auxiliary model and network only, for batch methods. The columns are in state->network.column. */
PMF_API whole_t pmf_filter(const pmf_config_t *config, pmf_state_t *state, real_t input, whole_t count);
#endif


#endif
