/* pmfid kernel: continuous-time identification with Poisson moment functionals, one sample at a time.
 *
 * SPDX-License-Identifier: Apache-2.0
 *
 * One call of pmf_step() takes an input and an encoder count and walks straight through:
 *
 *   counts, input -> encoder -> network of first-order stages -> columns -> recursion -> estimate
 *
 * The kernel knows no equation: the configuration says which stages there are and which sums of their outputs are
 * regressors, target and instruments. Only the auxiliary model (optional) knows what a body with friction is, and the
 * linear one (optional) what a transfer function is. No malloc, no globals, no libc.
 * Compile with -std=c99 -ffp-contract=off and never with -ffast-math: then every target gives the same bits.
 */
#ifndef PMF_H
#define PMF_H

#include <stdint.h>
#include "pmf_sizes.h"

#ifdef __cplusplus
extern "C" {
#endif

#ifdef PMF_FLOAT32
typedef float scalar_t;
#define PMF_SCALAR(x) (x##f)
#else
typedef double scalar_t;
#define PMF_SCALAR(x) (x)
#endif

/* The configuration consists of scalars. What depends on the data is written in these types, so that the same source
 * also runs several axes side by side: many/pmf_lanes.h then defines them for vectors. */
#ifdef PMF_LANES
#include "many/pmf_lanes.h"
#else
typedef scalar_t real_t;
typedef uint32_t whole_t;
typedef int32_t integer_t;
#ifndef PMF_API
#define PMF_API
#endif
#define PMF_R(x) PMF_SCALAR(x)
#endif

/* Signals of one sampling interval. A block of eight comes from the counts (nodes 0..7) and one from the auxiliary
 * model (nodes 8..15). All but the velocity from the counts are one sample late, because the direction of an interval
 * is known best one sample after it. */
enum {
    PMF_INPUT = 0, /* input times moving fraction */
    PMF_VELOCITY = 1, /* mean velocity; from the counts that of the last interval */
    PMF_DIRECTION = 2, /* time moving forward minus backward, as a part of the interval */
    PMF_MOVING = 3, /* time moving */
    PMF_FORWARD = 4, /* time moving forward */
    PMF_BACKWARD = 5, /* minus the time moving backward */
    PMF_FORWARD_VELOCITY = 6, /* the velocity's part from moving forward */
    PMF_BACKWARD_VELOCITY = 7, /* and from moving backward */
    PMF_AUXILIARY = 8, /* the same from the auxiliary model */
    PMF_SPLIT_FORWARD = 16, /* late velocity from the counts while the auxiliary model moves forward */
    PMF_SPLIT_BACKWARD = 17, /* and backward */
    PMF_LATE_INPUT = 18,
    PMF_LATE_VELOCITY = 19,
    PMF_ACCELERATION = 20, /* mean acceleration of the auxiliary model */
    PMF_LATE_POSITION = 21, /* mean position from the counts, from the first one */
    PMF_POSITION = 22, /* the same times moving fraction */
    PMF_SPLIT_POSITION = 23, /* the same times the auxiliary model's moving fraction */
    PMF_MODEL_POSITION = 24, /* the auxiliary model's own, times its moving fraction */
    PMF_SIGNALS = 25,
    /* of a linear process, which has no auxiliary model: */
    PMF_ONE = PMF_AUXILIARY, /* always 1 */
    PMF_START = PMF_AUXILIARY +
        1, /* 1 in the first interval, as late as the rest: what stood in the plant at the start */
    /* of direct methods without an auxiliary model where the step varies: */
    PMF_TURN = PMF_AUXILIARY /* what a reversal inside the interval adds to its mean velocity, per 1/12 of m v' */
};

/* What a parameter means to the auxiliary model. */
enum {
    PMF_MASS = 0,
    PMF_VISCOUS_FORWARD,
    PMF_VISCOUS_BACKWARD,
    PMF_COULOMB_FORWARD,
    PMF_COULOMB_BACKWARD,
    PMF_OFFSET,
    PMF_STIFFNESS,
    PMF_DELAY, /* [s], of the input */
    PMF_BODY_ROLES /* then a coefficient for each shape */
};
#define PMF_ROLES (7 + (PMF_WITH_DEAD_TIME + PMF_MAX_SHAPES > 0) + PMF_MAX_SHAPES)
#define PMF_NO_PARAMETER 0xffU

/* Status bits of a step. The Python enumeration `Status` has the same values and the advice. */
enum {
    PMF_STARTING = 1,
    PMF_SETTLING = 2,
    PMF_POOR_EXCITATION = 4,
    PMF_COMPENSATION_HELD = 8,
    PMF_INVALID_INPUT = 16,
    PMF_COUNT_JUMP = 32,
    PMF_STANDSTILL = 64,
    PMF_RESET = 128,
    PMF_FALLBACK = 256,
    PMF_UNMODELLED = 512,
    PMF_FEEDBACK = 1024,
    PMF_DEAD_TIME = 2048,
    PMF_STATUS_END, /* follows the last bit, so that all bits together need no further edit */
    PMF_STATUS_BITS = 2 * (PMF_STATUS_END - 1) - 1,
    /* What a reader asks: does theta say nothing, or nothing new? Was this sample left out? Do effects outside the
    model, or a controller, move theta beyond its covariance? */
    PMF_NOT_AN_ESTIMATE = PMF_STARTING | PMF_SETTLING | PMF_POOR_EXCITATION | PMF_RESET,
    PMF_SAMPLE_REJECTED = PMF_INVALID_INPUT | PMF_COUNT_JUMP,
    PMF_DISTORTED = PMF_UNMODELLED | PMF_FEEDBACK | PMF_DEAD_TIME
};

/* Forgetting of old samples, in addition to the regularisation. */
enum {
    PMF_EXPONENTIAL = 0, /* every sample is forgotten alike */
    PMF_DIRECTIONAL = 1, /* only in the direction of each phi; least squares only */
    PMF_CONSTANT_TRACE = 2, /* as much as keeps the trace of P */
    PMF_WINDOW = 3, /* the last samples alike, the others not at all */
    PMF_SEPARATE = 4 /* every parameter in its own time */
};

/* Where the step varies, pauses are counted in these parts of a sample period. */
enum { PMF_TICKS = 16 };

typedef struct {
    scalar_t velocity_per_count; /* resolution / dt */
    scalar_t position_per_count; /* resolution */
    uint32_t count_mask; /* 2^bits - 1 */
    uint32_t max_change; /* more counts in one sample are a jump; 0: no check */
    uint32_t standstill_samples; /* without a count for so long, in the unit of `idle`: at rest */
    scalar_t position_gain, velocity_gain; /* of the tracker, per count */
    scalar_t smooth_end, smooth_start; /* one-step smoother of the tracker's velocity */
#if PMF_WITH_PROCESS
    uint32_t process; /* the output of a linear process: positions count from zero, and rest means nothing */
    uint32_t from_first; /* but its positions count from the first one, where the equation is as true of these */
#endif
#if PMF_WITH_GUARD
    uint32_t guard; /* samples in motion that it learns from before it judges strictly; 0: none */
    scalar_t spike; /* factor over the largest recent input from which an input is suspicious */
    scalar_t guard_leak; /* of what it has learned, per sample in motion */
    uint32_t guard_hold; /* samples from a suspicious one on that are left out */
#endif
#if PMF_WITH_STEPS
    scalar_t rate; /* samples per second where each comes with its step, else 0 */
    scalar_t push; /* variance of the acceleration that the tracker expects, in counts per squared sample period */
    uint32_t turns; /* 1: a reversal inside an interval is a signal of its own */
#endif
} pmf_encoder_config_t;

#if PMF_WITH_STEPS
/* Covariances of the tracker where the step varies, which its gains come from; the counts have a variance of 1. */
typedef struct {
    real_t place, cross, speed; /* of the last position and velocity; the first two are its last gains as well */
    real_t start_place, start_speed; /* of the velocity before with them */
} pmf_tracker_t;
#endif


#if PMF_WITH_GUARD
/* Against samples that no motion explains. */
typedef struct {
    whole_t seen; /* the first samples and those in motion, until it has learned */
    whole_t suspect; /* suspicious changes in a row */
    whole_t doubt; /* on the last two inputs */
    whole_t wait; /* samples until it learns again what a motion may do */
    whole_t reading; /* the last count while it is suspicious */
    integer_t change; /* the last one, read or predicted, that the next is predicted from */
    real_t rate; /* how that had changed */
    real_t scatter; /* what predictions missed by, beyond the encoder's step: a leaking maximum */
    real_t peak; /* of the input, leaking as fast */
    real_t gain; /* change of the change by a unit of the input's */
    real_t missed; /* what the last prediction missed by */
    real_t last; /* and that of the last believed count, while the next ones are suspicious */
    real_t lesson; /* what scatter grew by last */
    real_t held; /* input that the filters had last */
    whole_t sound; /* samples since a suspicious one, saturating; this and the next ones while it learns */
    real_t earlier; /* what the prediction before the last missed by */
    real_t fair; /* scatter that motion alone explains */
} pmf_guard_state_t;
#endif

typedef struct {
    whole_t count;
    whole_t idle; /* samples since the last count, or sixteenths where the step varies, saturating */
    whole_t gap; /* samples between counts lately */
    whole_t fast;
    whole_t started; /* of a linear process 2 after the second sample */
    integer_t change; /* of the last interval */
    whole_t travel; /* counts since the first one, modulo 2^32 */
#if PMF_WITH_PROCESS
    integer_t first; /* count, with its sign */
#endif
    real_t position, velocity, velocity_before, innovation; /* tracker, in counts and samples */
    real_t direction, moving; /* of the last interval */
    real_t input, input_before;
    real_t mean_velocity; /* of the last interval */
#if PMF_WITH_STEPS
    real_t ratio, ratio_before; /* steps of this interval and of the one before, over the sample period */
    pmf_tracker_t tracker;
#endif
#if PMF_WITH_GUARD
    pmf_guard_state_t guard;
#endif
} pmf_encoder_state_t;

/* node[k] = b0 * node[source] + (what b1 and a left from the step before) */
typedef struct {
    uint32_t source;
    scalar_t a, b0, b1;
#if PMF_WITH_STEPS
    uint32_t rate; /* how it follows the step */
#endif
} pmf_stage_t;

#if PMF_WITH_STEPS
/* Ways in which stages follow a step that varies; what a stage has is for the sample period. The step that matters,
 * over the period, is now * (this one) + before * (the one before). The first way is that of a stage that follows none.
 * Lists, not a list of structures: compilers then compute several ways at once. */
typedef struct {
    scalar_t now[PMF_MAX_RATES], before[PMF_MAX_RATES];
    scalar_t half[PMF_MAX_RATES]; /* pole times half the sample period */
    scalar_t keep[PMF_MAX_RATES]; /* 1: what the stage had counts, 0: it does not */
    /* of its coefficients, by the step, and by the mean square of the step over time */
    scalar_t gain[PMF_MAX_RATES], growth[PMF_MAX_RATES], square[PMF_MAX_RATES];
} pmf_rates_t;
#endif

typedef struct {
    uint32_t node;
    scalar_t weight;
} pmf_tap_t;

/* Columns are sums of taps: regressors, then the target, then the instruments if there are any. */
typedef struct {
    uint32_t n_stages, n_columns;
    pmf_stage_t stage[PMF_MAX_STAGES];
    uint32_t tap_end[PMF_MAX_COLUMNS];
    pmf_tap_t tap[PMF_MAX_TAPS];
#if PMF_WITH_STEPS
    uint32_t n_rates; /* 0: the step does not vary */
    pmf_rates_t rates;
#endif
} pmf_network_config_t;

typedef struct {
    real_t node[PMF_SIGNALS + PMF_MAX_STAGES];
    real_t memory[PMF_MAX_STAGES];
    real_t column[PMF_MAX_COLUMNS];
#if PMF_WITH_STEPS
    real_t ratio, ratio_before; /* those of the encoder */
    real_t time, cubes; /* leaking sums of steps and of their cubes */
#endif
} pmf_network_state_t;

typedef struct {
    uint32_t n_parameters;
    uint32_t instrumental; /* 0: least squares, 1: instruments in their own columns */
    uint32_t first_column; /* regressors, target, instruments from here on */
    uint32_t min_updates; /* before the first estimate */
    uint32_t residual_updates; /* first steps, solved with the accumulated right-hand side; later ones by innovation */
    scalar_t forgetting;
    scalar_t regularization; /* information that is never forgotten, as a part of the largest seen */
    scalar_t pivot; /* smallest relative pivot for a first estimate */
    uint32_t scheme; /* of forgetting */
    uint32_t window_block; /* samples in a block of the window */
    uint32_t compensated; /* the noise of the columns is known: */
    scalar_t noise[PMF_MAX_NOISE][PMF_MAX_NOISE]; /* its covariance in one sample's phi phi^T */
#if PMF_WITH_PROCESS
    scalar_t target_noise[PMF_MAX_NOISE]; /* and in phi z */
    scalar_t target_power; /* and in z^2 */
    uint32_t constant,
        lowest; /* the parameter that the output's level is in, and its share of that; PMF_NO_PARAMETER: none */
    scalar_t lift; /* ... for the first count: a multiple of `lowest` */
#endif
#if PMF_WITH_SEPARATE
    scalar_t keep[PMF_MAX_PARAMETERS]; /* root of each parameter's forgetting factor */
#endif
    uint32_t block; /* updates whose errors may be correlated; the spread of such blocks scales P */
    scalar_t correlated; /* updates whose errors are taken to be the same until there are such blocks */
    uint32_t half_memory; /* in looks at the size of the motion; 0: nothing is forgotten */
    uint32_t leading; /* the parameter of the highest derivative */
    scalar_t haste,
        leak; /* weights of what is outdated at the next sample, and of the peaks after half a memory of motion */
    scalar_t shown; /* inverse square of what the encoder shows of the leading column */
    scalar_t outgrown; /* information in that column, over its squares at the looks of late, from which on it is from
                          larger motions */
#if PMF_WITH_AUXILIARY
    uint32_t growing; /* the first samples, gathered with a model that was still wrong, count the less, by this power of
                         their number; beyond 1 with shapes alone */
#endif
#if PMF_WITH_NOISE
    scalar_t unexplained; /* mean square innovation over what the noise explains, beyond which the model is wrong; 0: no
                             check */
    scalar_t check_samples; /* of a stretch of that comparison */
#endif
} pmf_recursion_config_t;

typedef struct {
    real_t cross[PMF_MAX_PARAMETERS][PMF_MAX_PARAMETERS]; /* sum zeta phi^T; lower half if least squares */
    real_t square[PMF_MAX_PARAMETERS][PMF_MAX_PARAMETERS]; /* sum zeta zeta^T, lower half; instruments only */
    real_t right[PMF_MAX_PARAMETERS]; /* sum zeta z */
    real_t weight; /* sum of the discounted weights */
    real_t squares; /* and of their squares */
} pmf_sums_t;

typedef struct {
    real_t theta[PMF_MAX_PARAMETERS];
    real_t variance_factor[PMF_MAX_PARAMETERS]; /* diagonal of P */
    real_t
        inflation[PMF_MAX_PARAMETERS]; /* theirs, for innovations that are not white and samples that count unequally */
    real_t innovation, innovation_variance;
} pmf_estimate_t;

#if PMF_WITH_NOISE
/* Sums of squared innovations and targets; weight: number of samples. */
typedef struct {
    real_t weight, innovation, target;
} pmf_check_t;
#endif

typedef struct {
    pmf_sums_t sums;
    real_t peak[PMF_MAX_PARAMETERS]; /* largest information seen in motions of the present size */
    real_t power, power_before; /* squares of the leading column over what the encoder shows, of this half memory of
                                   motion, and the last */
    real_t factor[PMF_MAX_PARAMETERS][PMF_MAX_PARAMETERS]; /* information = L D L^T: L below the diagonal */
    real_t inverse_pivot[PMF_MAX_PARAMETERS]; /* 1 / D */
    pmf_estimate_t estimate;
    real_t mass; /* 1 - forgetting^updates: how much of the regularisation is in force */
    real_t weight; /* of the innovations below */
    real_t innovation_square;
    whole_t updates; /* saturating */
    whole_t started; /* updates since the first estimate, 0 before, saturating */
    real_t score[PMF_MAX_PARAMETERS]; /* sum of zeta times innovation in this block */
    whole_t block_updates, blocks;
    whole_t moved; /* looks at samples in motion in this half memory */
    whole_t swings; /* what these, and those of the last one, showed of the leading column, as bits */
    whole_t
        outdated; /* updates in which to forget in haste: the information is from larger motions than those of late */
    whole_t excited; /* constant trace: looks for which the axis is taken to be excited */
    whole_t since; /* updates since the start, or since then; saturating */
    whole_t frozen; /* too little information left to forget any more */
#if PMF_WITH_PROCESS
    real_t lift; /* what `lowest` is worth in the constant of the output itself */
#endif
#if PMF_WITH_NOISE
    pmf_check_t check, check_before; /* of the model: this stretch of samples, and the last */
    whole_t unmodelled; /* the last verdict on it, as a status bit */
#endif
    real_t reference[PMF_MAX_PARAMETERS]; /* diagonal of P that constant trace keeps */
    real_t trace; /* mean of P over the reference; 0: not set yet */
#if PMF_WINDOW_BLOCKS > 0
    pmf_sums_t window[PMF_WINDOW_BLOCKS];
    whole_t window_block, window_updates; /* the one that is filled, and its updates */
#endif
} pmf_recursion_state_t;

#if PMF_MAX_SHAPES > 0
/* What a force of a given form depends on. */
enum {
    PMF_OF_SPEED = 0,
    PMF_OF_SQUARE = 1, /* of the speed; it has no table */
    PMF_OF_PLACE = 2, /* this and all that follow */
    PMF_OF_WAVE = 3 /* sine of the place; it has no table */
};

/* Straight lines between evenly spaced knots; beyond them the last one goes on. */
typedef struct {
    uint32_t of;
    uint32_t resists; /* 1: it acts against the motion, and holds at rest */
    uint32_t positive; /* 1: its coefficient is never negative */
    uint32_t first, intervals; /* of its knots */
    uint32_t node; /* that its mean over an interval, with its direction, is given to: a stage that leaves it there */
    uint32_t measured; /* the same at the place of the counts, for the direct estimate; 0: none */
    scalar_t start, knots_per_unit; /* of the speed or the position; of a wave: periods per unit */
} pmf_shape_t;

typedef struct {
    uint32_t n;
    pmf_shape_t shape[PMF_MAX_SHAPES];
    scalar_t knot[PMF_MAX_KNOTS];
    scalar_t sum[PMF_MAX_KNOTS]; /* of a speed: the integral from its first knot on, in steps */
} pmf_shapes_config_t;
#endif

/* A body with friction, simulated from the input alone with a slow copy of the estimate. */
typedef struct {
    uint32_t enabled;
    uint32_t adapt; /* 0: the parameters stay the initial ones (off-line passes) */
    uint32_t has_initial;
    uint32_t direct_index[PMF_ROLES]; /* a role's parameter in the direct recursion, PMF_NO_PARAMETER: none */
    uint32_t index[PMF_ROLES]; /* and in the instrumental one */
    uint32_t check_column; /* filtered velocity, measured; the next ones are the model's, and its acceleration */
    uint32_t target_column; /* corrected by what the discrete filters make of the model's own acceleration: */
    uint32_t mass_column; /* that of the instrument of the mass */
    uint32_t sensitivities; /* the number of parameters; 0: the model's stops and reversals count as known */
    uint32_t cause[PMF_ROLES], role[PMF_ROLES]; /* the model's signal that each one multiplies, and its first role */
    uint32_t trial_samples; /* so long is a new start given before it is judged */
    scalar_t dt, input_gain;
    scalar_t jump_gain; /* of each of the two stages that a blow at a stop goes through */
    scalar_t position_gain; /* of the correction of the model's position, which matters with a spring only */
    scalar_t initial[PMF_ROLES];
    scalar_t smoothing; /* per four samples, of the copy */
    scalar_t memory; /* forgetting of the check, per sample */
    scalar_t mismatch_limit; /* mean square difference of the velocities, as a part of their mean square */
    scalar_t noise_power; /* of the filtered measured velocity */
    scalar_t lag_memory; /* forgetting of the comparison that shows a model ahead of the plant, per sample */
    scalar_t lag_samples; /* that are worth one in it: the filters make neighbours alike */
#if PMF_WITH_STEPS
    uint32_t steps; /* 1: the step varies */
#endif
#if PMF_MAX_SHAPES > 0
    pmf_shapes_config_t shapes;
#endif
} pmf_auxiliary_config_t;

/* Measured minus modelled velocity (lack): sums of products with the model's acceleration and velocity. */
typedef struct {
    real_t weight, lack_lack, lack_acceleration, lack_velocity, acceleration, cross, velocity;
} pmf_lag_t;

/* What a parameter's change makes of the model's stops. */
typedef struct {
    real_t momentum; /* the mass times the deviation of its velocity, over dt */
    real_t blow, filtered; /* the force by which a stop takes that away, filtered once and twice */
} pmf_jump_t;

typedef struct {
    real_t parameter[PMF_ROLES];
    real_t velocity, position;
    pmf_jump_t jump[PMF_ROLES]; /* of each parameter */
    real_t power, mismatch;
    real_t cross, innovations, changes; /* products of the innovations and the changes of the input; their squares */
    whole_t running; /* has parameters */
    whole_t trial; /* samples until it is judged */
    whole_t trusted;
    whole_t in_charge; /* the instrumental estimate has taken over from the direct one */
    whole_t feedback; /* the last verdict, as a status bit */
    pmf_lag_t lag;
    whole_t late; /* whether the model is ahead, the last verdict as a status bit */
    whole_t turn; /* of the samples between two steps of the copy */
#if PMF_WITH_STEPS
    real_t step; /* of the interval that is simulated [s] */
#endif
} pmf_auxiliary_state_t;

#if PMF_WITH_LAG
/* exp(-t / lag) over a part of a sample: its end, its integral, and that of t times it; t in samples. */
typedef struct {
    scalar_t rest, mean, moment;
} pmf_decay_t;
#endif

#if PMF_WITH_DEAD_TIME
/* An input that acts late, by any part of a sample, and perhaps with a lag. */
typedef struct {
    uint32_t room; /* whole samples at most; 0: it acts at once */
    scalar_t rate; /* samples per second */
    scalar_t dead_time; /* [s], where no auxiliary model has its own */
#if PMF_WITH_DEAD_TIME_FOUND
    uint32_t found; /* it is estimated, as the last parameter */
    uint32_t within; /* also by the motion within the counts */
    scalar_t counts; /* per unit of position */
    scalar_t growth; /* of the covariance of what is estimated, per sample */
#endif
#if PMF_WITH_LAG
    uint32_t lags; /* is there a lag? Then the dead time is known */
    pmf_decay_t decay[2]; /* over the older input's part of an interval and over the newer one's */
#endif
} pmf_late_config_t;

typedef struct {
    real_t
        past[PMF_MAX_LATE]; /* inputs, from `at` on and round: that of the interval which the counts speak of first */
    real_t older, newer, part; /* what acts in that interval: `part` of it the older one */
    real_t gathered; /* dead time that what was gathered is for [s] */
#if PMF_WITH_LAG
    real_t lagged; /* output of the lag at the end of that interval */
#endif
    whole_t at;
} pmf_late_state_t;

#if PMF_WITH_DEAD_TIME_FOUND
/* The estimate at the dead time that is believed, and a motion that is held within the counts, which tells it. */
typedef struct {
    pmf_estimate_t believed; /* in the parameters of the recursion in charge */
    real_t dead_time; /* that it is at */
    real_t theta[PMF_MAX_PARAMETERS]; /* of the motion */
    real_t covariance[PMF_MAX_PARAMETERS + 2][PMF_MAX_PARAMETERS + 2]; /* of its place, its velocity and theta */
    real_t place; /* in counts, from the lower edge of the last one on */
    real_t velocity;
    real_t push, speed; /* the largest force of the input, and speed */
    real_t begun; /* its dead time at the beginning */
    real_t before, unsure; /* its dead time a while ago, and the variance of that */
    real_t surprise, expected; /* squares of what it was beyond an edge by, over its own deviation */
    integer_t change; /* of the counts in the last interval */
    whole_t running;
    whole_t age, near; /* samples since it began, and those near an edge; saturating */
    whole_t looks; /* 1: it began from what it had found itself, 2: and stayed there */
    whole_t tries; /* beginnings since it was last believed */
    whole_t believes; /* what is believed, PMF_BELIEVES_... */
} pmf_found_state_t;
#endif
#endif

#if PMF_WITH_LINEAR
/* A linear process, simulated from the input alone with a slow copy of the estimate, and the filters 1 / A(s). */
typedef struct {
    uint32_t enabled;
    uint32_t n, m, offset; /* parameters: a_0 to a_(n-1), b_0 to b_m and the constant, if there is one */
    uint32_t input_node; /* held input, as late as the output and its dead time later */
    uint32_t first_column; /* regressors, target, instruments */
    uint32_t update_samples; /* so often are the filters computed from the copy */
    uint32_t settle_samples; /* in addition to the settling of the process itself */
    uint32_t start_updates; /* of the direct estimate before the model starts from it */
    scalar_t half_dt;
    scalar_t scale[PMF_MAX_ORDER + 1]; /* dt^(n-i) */
    scalar_t limit[PMF_MAX_ORDER]; /* of a_i dt^(n-i), beyond which the process is too fast for the samples */
    scalar_t smoothing; /* per update, of the copy */
    scalar_t memory; /* forgetting of the comparison with the output, per sample */
} pmf_linear_config_t;

/* The filters s^i / A(s), time in samples. */
typedef struct {
    real_t a[PMF_MAX_ORDER];
    real_t inverse; /* of a trapezoidal step */
    real_t step[PMF_MAX_ORDER][PMF_MAX_ORDER], gain[PMF_MAX_ORDER]; /* of a held signal */
} pmf_linear_filter_t;

/* Signals after such a filter. */
typedef struct {
    real_t held[PMF_MAX_ORDER], one[PMF_MAX_ORDER]; /* the input and a constant */
    real_t measured[PMF_MAX_ORDER], simulated[PMF_MAX_ORDER];
} pmf_linear_signals_t;

typedef struct {
    real_t parameter[PMF_MAX_PARAMETERS]; /* the copy */
    real_t b[PMF_MAX_PARAMETERS]; /* as the simulation has it */
    pmf_linear_filter_t own, fast; /* of the copy; more damped, for data, where that would settle too late */
    pmf_linear_signals_t behind_own, behind_fast;
    pmf_linear_signals_t bent; /* how the coefficients of these signals differ where time goes in samples */
    real_t settling[PMF_MAX_ORDER];
    real_t output, power, mismatch;
    real_t discount; /* of what was gathered with other filters; 1 where they did not change */
    whole_t since; /* updates of the direct estimate at the start */
    whole_t wait, age, unsettled, settled;
    whole_t running, in_charge;
    whole_t damped; /* data go through the fast filters */
} pmf_linear_state_t;
#endif

typedef struct {
    uint32_t settle_samples;
#if PMF_WITH_PROCESS
    uint32_t first_samples; /* the same at the start, shorter where the start is part of the equation */
#endif
    pmf_encoder_config_t encoder;
    pmf_network_config_t network;
    pmf_recursion_config_t direct; /* from the counts alone */
#if PMF_WITH_DEAD_TIME
    pmf_late_config_t late;
#endif
#if PMF_WITH_AUXILIARY
    pmf_auxiliary_config_t auxiliary;
#endif
#if PMF_WITH_LINEAR
    pmf_linear_config_t linear;
#endif
#if PMF_WITH_AUXILIARY + PMF_WITH_LINEAR
    pmf_recursion_config_t instrument; /* with the model that is simulated, if there is one */
#endif
} pmf_config_t;

typedef struct {
    whole_t status;
    whole_t settle; /* samples until the filters have forgotten their start */
#if PMF_WITH_GUARD
    whole_t hold; /* samples until they have forgotten what stands in place of a suspicious one */
#endif
    pmf_encoder_state_t encoder;
    pmf_network_state_t network;
    pmf_recursion_state_t direct;
#if PMF_WITH_DEAD_TIME
    pmf_late_state_t late;
#if PMF_WITH_DEAD_TIME_FOUND
    pmf_found_state_t found;
#endif
#endif
#if PMF_WITH_PROCESS
    pmf_estimate_t lifted; /* the estimate with the constant of the output itself */
#endif
#if PMF_WITH_AUXILIARY
    pmf_auxiliary_state_t auxiliary;
    pmf_estimate_t borrowed; /* the direct estimate in the parameters of the instrumental one */
#endif
#if PMF_WITH_LINEAR
    pmf_linear_state_t linear;
#endif
#if PMF_WITH_AUXILIARY + PMF_WITH_LINEAR
    pmf_recursion_state_t instrument;
#endif
} pmf_state_t;

PMF_API void pmf_init(const pmf_config_t *config, pmf_state_t *state);
/* The counter is reset: it would have read `count` at the last sample. Estimate and filters stay. */
void pmf_rebase(pmf_state_t *state, uint32_t count);
/* Samples were lost, and the next one, for pmf_step() after this, reads `count`. Filters and model restart with its
 * motion; the sums of the estimate stay. A few lost samples are better stepped through, along straight lines. */
void pmf_gap(const pmf_config_t *config, pmf_state_t *state, uint32_t count);
/* The last sample was a guess: the next `samples` are not learnt from (in slow motion some more), at most the settling
 * time of the filters. The filters go on. */
void pmf_doubt(const pmf_config_t *config, pmf_state_t *state, uint32_t samples);
/* One sample: `input` is applied from now on, `count` is read now. Returns the status bits. */
PMF_API whole_t pmf_step(const pmf_config_t *config, pmf_state_t *state, real_t input, whole_t count);
#if PMF_WITH_STEPS
/* Before pmf_step() of a configuration with a rate: the time since the last sample [s]; without this call it is the
 * sample period. One that is not positive, or longer than 100 periods, is flagged as an invalid input. */
void pmf_set_step(const pmf_config_t *config, pmf_state_t *state, real_t step);
#endif
/* P of the estimate, with theta_cov = innovation variance times P; n x n, row by row; its diagonal alone where the
 * estimate is borrowed from another parametrisation. */
void pmf_covariance_factor(const pmf_config_t *config, const pmf_state_t *state, real_t *p);
/* The estimate of the last step. */
const pmf_estimate_t *pmf_estimate(const pmf_config_t *config, const pmf_state_t *state);
/* Opens the memory after a change of the plant: of what was gathered on one parameter, or with PMF_NO_PARAMETER on all,
 * only the part root^2 counts on, 0 < root <= 1. The estimate stays where it is; filters and auxiliary model go on.
 * The inflation of standard errors restarts, also with root = 1. */
void pmf_open(const pmf_config_t *config, pmf_state_t *state, uint32_t parameter, real_t root);
/* Variance of a parameter of the estimate, for innovations as coloured as they are; PMF_UNKNOWN until there is one. */
real_t pmf_variance(const pmf_config_t *config, const pmf_state_t *state, uint32_t parameter);
#define PMF_UNKNOWN PMF_R(1e30)
/* The number of parameters of the estimate. */
PMF_API uint32_t pmf_parameters(const pmf_config_t *config);

/* Continue after a loss of power: a state with what says whose it is. The same bytes as `get_state` in Python. */
#define PMF_STATE_MAGIC 0x53464d50U /* "PMFS" */
#define PMF_STATE_VERSION 1U

typedef struct {
    uint32_t magic, version;
    uint32_t layout; /* CRC-32 of names, types and places of the state's fields */
    uint32_t size; /* of all this, in bytes */
    uint32_t config; /* CRC-32 of the configuration */
    uint32_t checksum; /* CRC-32 of the five words above and the state */
    pmf_state_t state;
} pmf_saved_t;

enum { PMF_LOADED = 0, PMF_NOT_A_STATE, PMF_DAMAGED_STATE, PMF_OTHER_VERSION, PMF_OTHER_CONFIG, PMF_IMPLAUSIBLE_STATE };

void pmf_save(const pmf_config_t *config, const pmf_state_t *state, pmf_saved_t *saved);
/* PMF_LOADED, or why not; then the state is as before. */
uint32_t pmf_load(const pmf_config_t *config, const pmf_saved_t *saved, pmf_state_t *state);
/* 1: these can be the numbers of a state, 0: no sample could have made them, whatever their checksum. */
uint32_t pmf_plausible(const pmf_config_t *config, const pmf_state_t *state);
/* CRC-32 of ISO 3309 (Ethernet, zlib) of more data; crc: of the data before, 0 at the start. */
uint32_t pmf_crc32(uint32_t crc, const void *data, uint32_t size);

/* An alarm on a parameter of the estimate, after every step; not a part of the state: clear it to start. */
typedef struct {
    uint32_t parameter;
    uint32_t interval; /* samples between two estimates that count */
    real_t nominal;
    real_t shift; /* the change to be noticed, > 0 */
    real_t threshold; /* of the logarithm of the likelihood ratio */
} pmf_alarm_config_t;

typedef struct {
    real_t up, down;
    uint32_t wait;
} pmf_alarm_state_t;

#define PMF_LEAST_VARIANCE PMF_R(1e-30)
/* 1: the parameter is above nominal, -1: below, 0: no alarm. */
int32_t pmf_alarm_step(const pmf_alarm_config_t *alarm, pmf_alarm_state_t *sums, const pmf_config_t *config,
                       const pmf_state_t *state);

/* What compiler options did to the arithmetic of this build, as bits; 0: the bits are those of Python. */
enum { PMF_CONTRACTED = 1, PMF_REARRANGED = 2, PMF_NO_NAN = 4, PMF_FLUSHED = 8 };
uint32_t pmf_arithmetic(void);

/* Byte-wise, so that padding is zero too and two states can be compared. */
PMF_API void pmf_clear(void *memory, uint32_t size);

#ifdef __cplusplus
}
#endif

#endif
