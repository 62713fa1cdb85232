/* pmfid kernel: continuous-time identification with Poisson moment functionals, one sample at a time.
 *
 * SPDX-License-Identifier: Apache-2.0
 *
 * One call of pmf_step() takes an input and an encoder count through these steps:
 *
 *   counts, input -> encoder -> network of first-order stages -> columns -> recursion -> estimate
 *
 * The kernel has no fixed equation. The configuration lists the stages, and sums their outputs to regressors, target
 * and instruments. Only the optional auxiliary model knows a body with friction. The kernel uses no malloc, no globals
 * and no libc. Every target gives the same bits if compiled with -std=c99 -ffp-contract=off and without -ffast-math. */
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

/* The configuration consists of scalars. Values that depend on the data have the types below. The file many/pmf_lanes.h
 * defines these types as vectors, so that the same source runs several axes at once. */
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

/* Signals of one sampling interval. Eight signals come from the counts (nodes 0..7) and eight from the auxiliary model
 * (nodes 8..15). All but the velocity from the counts are one sample late, because the direction of an interval is
 * known best one sample later. */
enum {
    PMF_INPUT = 0, /* input times moving fraction */
    PMF_VELOCITY = 1, /* mean velocity; from the counts, of the last interval */
    PMF_DIRECTION = 2, /* time moving forward minus time moving backward, as a fraction of the interval */
    PMF_MOVING = 3, /* fraction of time moving */
    PMF_FORWARD = 4, /* fraction of time moving forward */
    PMF_BACKWARD = 5, /* minus the fraction of time moving backward */
    PMF_FORWARD_VELOCITY = 6, /* part of the velocity from moving forward */
    PMF_BACKWARD_VELOCITY = 7, /* part of the velocity from moving backward */
    PMF_AUXILIARY = 8, /* first signal of the auxiliary model, which has the same eight signals */
    PMF_SPLIT_FORWARD = 16, /* late velocity from the counts while the auxiliary model moves forward */
    PMF_SPLIT_BACKWARD = 17, /* late velocity from the counts while the auxiliary model moves backward */
    PMF_LATE_INPUT = 18,
    PMF_LATE_VELOCITY = 19,
    PMF_ACCELERATION = 20, /* mean acceleration of the auxiliary model */
    PMF_LATE_POSITION = 21, /* mean position by the counts, relative to the first count */
    PMF_POSITION = 22, /* mean position by the counts times the moving fraction */
    PMF_SPLIT_POSITION = 23, /* mean position by the counts times the auxiliary model's moving fraction */
    PMF_MODEL_POSITION = 24, /* position of the auxiliary model times its moving fraction */
    PMF_SIGNALS = 25,
    /* signals of a linear process, which has no auxiliary model: */
    PMF_ONE = PMF_AUXILIARY, /* always 1 */
    PMF_START = PMF_AUXILIARY +
        1, /* 1 in the first interval, delayed like the other signals, for the effect of the initial state */
    /* signal of direct methods without an auxiliary model if the step varies: */
    PMF_TURN = PMF_AUXILIARY, /* effect of a reversal inside the interval on the mean velocity, per 1/12 of m v' */
    /* signals of direct methods without an auxiliary model: largest plausible errors of three signals, because counts
       show a start, a stop or a reversal late (pmf_misread.inl) */
    PMF_MISREAD_INPUT = PMF_AUXILIARY + 2,
    PMF_MISREAD_DIRECTION = PMF_AUXILIARY + 3,
    PMF_MISREAD_MOVING = PMF_AUXILIARY + 4
};

/* Roles of parameters in the auxiliary model. */
enum {
    PMF_MASS = 0,
    PMF_VISCOUS_FORWARD,
    PMF_VISCOUS_BACKWARD,
    PMF_COULOMB_FORWARD,
    PMF_COULOMB_BACKWARD,
    PMF_OFFSET,
    PMF_STIFFNESS,
    PMF_BODY_ROLES /* followed by a coefficient for each shape */
};

/* Status bits of a step. The Python enumeration `Status` has the same values, with advice. */
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
    PMF_STATUS_END, /* follows the last bit, so that the union of all bits needs no further edit */
    PMF_STATUS_BITS = 2 * (PMF_STATUS_END - 1) - 1,
    /* Groups of bits. In the first, theta is no new estimate. In the second, the sample was left out. In the third,
       theta is wrong by more than its covariance, because of a controller or effects outside the model. */
    PMF_NOT_AN_ESTIMATE = PMF_STARTING | PMF_SETTLING | PMF_POOR_EXCITATION | PMF_RESET,
    PMF_SAMPLE_REJECTED = PMF_INVALID_INPUT | PMF_COUNT_JUMP,
    PMF_DISTORTED = PMF_UNMODELLED | PMF_FEEDBACK | PMF_DEAD_TIME
};

/* Samples that the guard sees. With the guard, status and estimate lag the last sample by PMF_AHEAD samples. */
enum {
    PMF_AHEAD = 8, /* samples after the judged one */
    PMF_VIEW = 9, /* the judged sample and those after it */
    PMF_PAST = 5 /* accepted counts: three accelerations, which show an oscillation of four samples or more */
};

/* If the step varies, pauses are counted in ticks, which are fractions of a sample period. */
enum { PMF_TICKS = 16 };

#define PMF_UNKNOWN PMF_R(1e30) /* variance of a parameter without an estimate */

#ifdef PMF_WITH_EDGES /* the recursion over edges takes the place of encoder, network and recursion */
#include "pmf_redge_axis.h"
#else

/* Number of roles, and the index of a role without a parameter. */
#define PMF_ROLES (7 + PMF_MAX_SHAPES)
enum { PMF_NO_PARAMETER = 0xff };

typedef struct {
    scalar_t velocity_per_count; /* resolution / dt */
    scalar_t position_per_count; /* resolution */
    uint32_t count_mask; /* 2^bits - 1 */
    uint32_t max_change; /* largest change of the count in one sample without a jump; 0: no check */
    uint32_t standstill_samples; /* time without a count that means rest, in the unit of `idle` */
    scalar_t position_gain, velocity_gain; /* gains of the tracker, per count */
    scalar_t smooth_end, smooth_start; /* gains of the one-step smoother of the tracker's velocity */
    uint32_t process; /* 1: output of a linear process, whose positions count from zero and may rest */
    uint32_t from_first; /* 1: positions count from the first count, for which the equation also holds */
    uint32_t guard; /* 1: the guard judges the samples */
    uint32_t misread; /* 1: the errors of direction and moving fraction are signals */
#if PMF_WITH_STEPS
    scalar_t rate; /* samples per second if each sample comes with its step, otherwise 0 */
    scalar_t push; /* variance of the acceleration that the tracker expects, in counts per squared sample period */
    uint32_t turns; /* 1: a reversal inside an interval is a separate signal */
#endif
} pmf_encoder_config_t;

/* Covariances of the tracker for a varying step, for a variance of the counts of 1. The covariances give the gains. */
typedef struct {
    real_t place, cross, speed; /* covariances of the last position and velocity. The first two are also gains. */
    real_t start_place, start_speed; /* covariances of the earlier velocity with the last position and velocity */
} pmf_tracker_t;

/* Intervals without a count, which may hide a stop or a reversal. */
typedef struct {
    real_t pause, usual; /* intervals since the last count, and before that count */
    real_t held, held_input; /* intervals of this pause that did not count as misread, and the sum of their inputs */
    real_t begun; /* samples since the first count after a standstill; 0: the start is known */
} pmf_misread_state_t;

/* Guard against samples that no motion explains. */
typedef struct {
    whole_t count[PMF_PAST + PMF_VIEW]; /* accepted counts, then counts that are not judged yet; modulo 2^32 */
    whole_t past; /* number of accepted counts, which are the last ones before the judged count */
    whole_t readings; /* number of counts that are not judged yet */
    whole_t zero; /* reading of the counter at count 0 */
    real_t input[PMF_VIEW]; /* inputs of the samples that are not judged yet */
} pmf_guard_state_t;

typedef struct {
    whole_t count;
    whole_t idle; /* samples since the last count (sixteenths if the step varies), saturating */
    whole_t gap; /* recent number of samples between counts */
    whole_t fast;
    whole_t started; /* 2 after the second sample of a linear process */
    integer_t change; /* change of the count in the last interval */
    whole_t travel; /* sum of the changes of the count, modulo 2^32 */
    integer_t first; /* first count of a process, with its sign */
    real_t position, velocity, velocity_before, innovation; /* tracker, in counts and samples */
    real_t direction, moving; /* direction and moving fraction of the last interval */
    real_t input, input_before;
    real_t mean_velocity; /* mean velocity of the last interval */
#if PMF_WITH_STEPS
    real_t ratio, ratio_before; /* steps of this interval and of the preceding one, over the sample period */
    pmf_tracker_t tracker;
#endif
    pmf_misread_state_t misread;
} pmf_encoder_state_t;

/* node[k] = b0 * node[source] + (contribution of b1 and a from the preceding step) */
typedef struct {
    uint32_t source;
    scalar_t a, b0, b1;
    uint32_t rate; /* rule by which the stage follows a varying step */
} pmf_stage_t;

/* Rules by which stages follow a varying step. The coefficients of a stage are those for the sample period. The step
 * ratio is now * (ratio of this step) + before * (ratio of the preceding step). The first rule belongs to stages that
 * follow no step. Lists replace a list of structures, so that compilers compute several rules at once. */
typedef struct {
    scalar_t now[PMF_MAX_RATES], before[PMF_MAX_RATES];
    scalar_t half[PMF_MAX_RATES]; /* pole times half the sample period */
    scalar_t keep[PMF_MAX_RATES]; /* 1: the memory of the stage counts, 0: the memory is ignored */
    /* effects on the coefficients: constant, by the step, and by the mean square of the step over time */
    scalar_t gain[PMF_MAX_RATES], growth[PMF_MAX_RATES], square[PMF_MAX_RATES];
} pmf_rates_t;

typedef struct {
    uint32_t node;
    scalar_t weight;
} pmf_tap_t;

/* Columns are sums of taps: regressors, then the target, then the instruments if there are any. */
typedef struct {
    uint32_t n_columns;
#if PMF_WITH_NETWORK
    uint32_t n_stages;
    pmf_stage_t stage[PMF_MAX_STAGES];
    uint32_t tap_end[PMF_MAX_COLUMNS];
    pmf_tap_t tap[PMF_MAX_TAPS];
    uint32_t n_rates; /* 0: the step does not vary */
    pmf_rates_t rates;
#endif
} pmf_network_config_t;

typedef struct {
    real_t node[PMF_SIGNALS + PMF_MAX_STAGES];
    real_t memory[PMF_MAX_STAGES];
    real_t column[PMF_MAX_COLUMNS];
#if PMF_WITH_STEPS
    real_t ratio, ratio_before; /* step ratios of the encoder */
    real_t time, cubes; /* leaking sums of steps and of cubes of steps */
#endif
} pmf_network_state_t;

typedef struct {
    uint32_t n_parameters;
    uint32_t instrumental; /* 0: least squares, 1: instruments in their own columns */
    uint32_t first_column; /* first column of regressors, target and instruments */
    uint32_t every; /* samples between two solutions, once the sums hold many samples; a power of two */
    uint32_t min_updates; /* updates before the first estimate */
    uint32_t residual_updates; /* number of first updates; their solutions correct each other's rounding */
    scalar_t forgetting;
    scalar_t regularization; /* information that is never forgotten, as a fraction of the largest so far */
    scalar_t pivot; /* smallest relative pivot for a first estimate */
    uint32_t compensated; /* 1: the noise of the columns is known */
    scalar_t noise[PMF_MAX_PARAMETERS]
                  [PMF_MAX_PARAMETERS]; /* covariance of the known noise in one sample's phi phi^T */
    scalar_t target_noise[PMF_MAX_PARAMETERS]; /* covariance of the known noise in phi z */
    scalar_t target_power; /* power of the known noise in z^2 */
    uint32_t constant, lowest; /* parameters of the output's constant and lowest coefficient, or PMF_NO_PARAMETER */
    scalar_t lift; /* shift of the constant for the first count, as a multiple of `lowest` */
    uint32_t block; /* updates in a block with correlated errors. The spread of blocks scales P. */
    scalar_t correlated; /* number of updates with equal errors, assumed until blocks exist */
    uint32_t half_memory; /* half memory, counted in solutions; 0: nothing is forgotten */
    uint32_t leading; /* index of the parameter of the highest derivative */
    scalar_t haste, leak; /* weights of outdated information at the next sample, and of peaks after half a memory */
    scalar_t shown; /* inverse square of the encoder's error in the leading column */
    scalar_t outgrown; /* ratio of information in the leading column to recent squares, above which the information
                          comes from larger motions */
    uint32_t growing; /* power of the sample number as the weight of early samples, whose model is poor; above 1 only
                         with shapes */
    uint32_t n_misread; /* number of regressors with an error from misread counts */
    uint32_t misread_column; /* first column of these errors, followed by the error of the target; 0: none */
    uint32_t misread_index[PMF_MAX_MISREADS]; /* parameters of these regressors */
    scalar_t unexplained; /* ratio of mean square innovation to the known noise, above which the model is wrong; 0: no
                             check */
    scalar_t check_samples; /* number of samples in a stretch of this check */
} pmf_recursion_config_t;

typedef struct {
    real_t cross[PMF_MAX_PARAMETERS][PMF_MAX_PARAMETERS]; /* sum zeta phi^T; lower half for least squares */
    real_t square[PMF_MAX_PARAMETERS][PMF_MAX_PARAMETERS]; /* sum zeta zeta^T, lower half; instruments only */
    real_t weight; /* sum of the discounted weights */
    real_t squares; /* sum of the squared weights */
} pmf_sums_t;

typedef struct {
    real_t theta[PMF_MAX_PARAMETERS];
    real_t variance_factor[PMF_MAX_PARAMETERS]; /* diagonal of P */
    real_t inflation[PMF_MAX_PARAMETERS]; /* factor of the variances for coloured innovations, unequal weights of
                                             samples, and known causes of bias */
    real_t innovation, innovation_variance;
} pmf_estimate_t;

/* Sums of squared innovations and targets; `weight` is the number of samples. */
typedef struct {
    real_t weight, innovation, target;
} pmf_check_t;

typedef struct {
    pmf_sums_t sums;
    real_t peak[PMF_MAX_PARAMETERS]; /* largest information in motions of the present size */
    real_t power, power_before; /* squares of the leading column over the encoder's error, in two half memories */
    real_t factor[PMF_MAX_PARAMETERS][PMF_MAX_PARAMETERS]; /* information = L D L^T: L below the diagonal */
    real_t inverse_pivot[PMF_MAX_PARAMETERS]; /* 1 / D */
    pmf_estimate_t estimate;
    real_t mass; /* 1 - forgetting^updates: the active fraction of the regularisation */
    real_t weight; /* weight of the innovations below */
    real_t innovation_square;
    whole_t updates; /* number of updates, saturating */
    whole_t started; /* updates since the first estimate, 0 before, saturating */
    real_t gathered[PMF_MAX_PARAMETERS]; /* sum of zeta times innovation since the last solution */
    real_t rest[PMF_MAX_PARAMETERS]; /* part of the earlier innovations that a young solution has left */
    whole_t verdict; /* status bits of the last solution */
    real_t score[PMF_MAX_PARAMETERS]; /* sum of zeta times innovation in this block */
    whole_t block_updates, blocks;
    whole_t moved; /* looks at samples in motion in this half memory */
    whole_t swings; /* swings of the leading column in this half memory and the last, as bits */
    whole_t outdated; /* remaining updates of fast forgetting, after motions that were larger than the recent ones */
    whole_t frozen; /* 1: too little information is left for further forgetting */
#if PMF_WITH_PROCESS
    real_t lift; /* effect of `lowest` on the constant of the output itself */
#endif
    real_t misread[PMF_MAX_MISREADS]; /* sums of the sizes of errors from misread counts, over the diagonal of P */
    real_t strayed[PMF_MAX_MISREADS]; /* sum of zeta times these errors since the last solution */
    real_t spread[PMF_MAX_MISREADS]; /* inflation without these errors */
    pmf_check_t check, check_before; /* checks of the model in this stretch of samples and in the last */
    whole_t unmodelled; /* last verdict of the check, as a status bit */
} pmf_recursion_state_t;

#if PMF_MAX_SHAPES > 0
/* Variable on which a force of a given form depends. */
enum {
    PMF_OF_SPEED = 0,
    PMF_OF_SQUARE = 1, /* square of the speed, without a table */
    PMF_OF_PLACE = 2, /* position */
    PMF_OF_WAVE = 3 /* sine of the position, without a table */
};

/* Straight lines between evenly spaced knots. The last value continues beyond the knots. */
typedef struct {
    uint32_t of;
    uint32_t resists; /* 1: the force acts against the motion, and holds at rest */
    uint32_t positive; /* 1: the coefficient of the shape is never negative */
    uint32_t first, intervals; /* first knot and number of intervals */
    uint32_t node; /* node for the signed mean over an interval, which no stage overwrites */
    uint32_t measured; /* node for the mean at the measured position, for the direct estimate; 0: none */
    scalar_t start, knots_per_unit; /* first knot, and knots (or periods of a wave) per unit of speed or position */
} pmf_shape_t;

typedef struct {
    uint32_t n;
    pmf_shape_t shape[PMF_MAX_SHAPES];
    scalar_t knot[PMF_MAX_KNOTS];
    scalar_t sum[PMF_MAX_KNOTS]; /* integral of a speed's shape from the first knot, in steps */
} pmf_shapes_config_t;
#endif

/* A body with friction, simulated from the input alone with a slow copy of the estimate. */
typedef struct {
    uint32_t enabled;
    uint32_t adapt; /* 0: the parameters keep their initial values (off-line passes) */
    uint32_t has_initial;
    uint32_t direct_index[PMF_ROLES]; /* index of a role's parameter in the direct recursion; PMF_NO_PARAMETER: none */
    uint32_t index[PMF_ROLES]; /* index of a role's parameter in the instrumental recursion */
    uint32_t check_column; /* measured filtered velocity, followed by velocity and acceleration of the model */
    uint32_t target_column; /* target, which is corrected by the filters' error for the model's acceleration */
    uint32_t mass_column; /* column of the instrument of the mass */
    uint32_t sensitivities; /* number of parameters that move the model's stops and reversals; 0: none */
    uint32_t cause[PMF_ROLES], role[PMF_ROLES]; /* signal that each parameter multiplies, and its first role */
    uint32_t trial_samples; /* samples before a new start is judged */
    scalar_t dt, input_gain;
    scalar_t jump_gain; /* gain of both stages that filter a blow at a stop */
    scalar_t position_gain; /* gain of the correction of the model's position, needed only with a spring */
    scalar_t initial[PMF_ROLES];
    scalar_t smoothing; /* smoothing of the copy, per four samples */
    scalar_t memory; /* forgetting of the check, per sample */
    scalar_t mismatch_limit; /* mean square difference of the velocities, as a fraction of their mean square */
    scalar_t noise_power; /* noise power of the filtered measured velocity */
    scalar_t lag_memory; /* forgetting of the comparison that shows a model ahead of the plant, per sample */
    scalar_t lag_samples; /* samples that count as one in the comparison of the lag, because the filters correlate
                             neighbours */
    uint32_t steps; /* 1: the step varies */
#if PMF_MAX_SHAPES > 0
    pmf_shapes_config_t shapes;
#endif
} pmf_auxiliary_config_t;

/* Measured minus modelled velocity (lack): sums of products with the model's acceleration and velocity. */
typedef struct {
    real_t weight, lack_lack, lack_acceleration, lack_velocity, acceleration, cross, velocity;
} pmf_lag_t;

/* Effect of a parameter's change on the model's stops. */
typedef struct {
    real_t momentum; /* mass times the deviation of the velocity, over dt */
    real_t blow, filtered; /* force by which a stop removes the momentum, after one and two stages of a filter */
} pmf_jump_t;

/* Sums that fade while the axis rests. */
typedef struct {
    pmf_jump_t jump[PMF_ROLES]; /* effect of each parameter on the stops */
    real_t power, mismatch;
    real_t cross, after, chance, bends, changes; /* sums for the verdict on feedback */
    pmf_lag_t lag;
} pmf_fading_t;

typedef struct {
    real_t parameter[PMF_ROLES];
    real_t velocity, position;
    pmf_fading_t fading;
    real_t lack, change; /* measured minus modelled velocity of the last interval, and change of the input after it */
    whole_t running; /* 1: the model has parameters */
    whole_t trial; /* samples until the model is judged */
    whole_t trusted;
    whole_t in_charge; /* 1: the instrumental estimate has replaced the direct estimate */
    whole_t feedback; /* last verdict on feedback, as a status bit */
    whole_t late; /* last verdict on a model ahead of the plant, as a status bit */
    whole_t turn; /* counter of the samples between two steps of the copy */
    real_t step; /* length of the simulated interval [s] if the step varies */
} pmf_auxiliary_state_t;

/* Values of exp(-t / lag) over a part of a sample: the end value, the integral, and the integral of t exp(-t / lag), t
 * in samples. */
typedef struct {
    scalar_t rest, mean, moment;
} pmf_decay_t;

/* An input that acts late, by any fraction of a sample, and perhaps with a lag. */
typedef struct {
    uint32_t kept; /* inputs kept: the whole samples of the dead time and two; 0: the input acts at once */
    scalar_t part; /* fraction of the interval in which the older input acts */
    uint32_t lags; /* 1: the input has a lag */
    pmf_decay_t decay[2]; /* decays over the parts of the older and the newer input */
} pmf_late_config_t;

typedef struct {
    real_t past[PMF_MAX_LATE]; /* ring of inputs, the last one at `at` */
    real_t older, newer, part; /* inputs in the interval of the counts; the older one acts for the fraction `part` */
    real_t lagged; /* output of the lag at the end of the interval */
    whole_t at;
} pmf_late_state_t;

typedef struct {
    uint32_t settle_samples;
    uint32_t first_samples; /* samples of settling at the start. The value is shorter if the initial state is part of
                               the equation. */
    pmf_encoder_config_t encoder;
    pmf_network_config_t network;
    pmf_recursion_config_t direct; /* recursion from the counts alone */
#if PMF_WITH_DEAD_TIME
    pmf_late_config_t late;
#endif
#if PMF_WITH_AUXILIARY
    pmf_auxiliary_config_t auxiliary;
    pmf_recursion_config_t instrument; /* recursion with the simulated model, if there is one */
#endif
} pmf_config_t;

typedef struct {
    whole_t status;
    whole_t settle; /* samples until the filters have forgotten their start */
    whole_t hold; /* samples until the filters have forgotten a guess */
    whole_t samples; /* number of samples in the filters, modulo 2^32 */
#if PMF_WITH_GUARD
    pmf_guard_state_t guard;
#endif
    pmf_encoder_state_t encoder;
    pmf_network_state_t network;
    pmf_recursion_state_t direct;
#if PMF_WITH_DEAD_TIME
    pmf_late_state_t late;
#endif
#if PMF_WITH_PROCESS
    pmf_estimate_t lifted; /* estimate with the constant of the output itself */
#endif
#if PMF_WITH_AUXILIARY
    pmf_auxiliary_state_t auxiliary;
    pmf_estimate_t output; /* the instrumental estimate with the errors of its model, or the direct estimate */
    real_t model[PMF_MAX_PARAMETERS]; /* mean parameters of the model, with the weights of the instrumental sums */
    pmf_recursion_state_t instrument;
#endif
} pmf_state_t;

/* Begin at rest, without an estimate. In all functions a count is a reading of the counter, 0 to 2^32 - 1, of which
 * only the lowest bits count, and the input has its unit of the configuration. */
PMF_API void pmf_init(const pmf_config_t *config, pmf_state_t *state);
/* Set the reading of the counter at the last sample. Estimate and filters stay. */
void pmf_rebase(pmf_state_t *state, uint32_t count);
/* Report lost samples before pmf_step() of the next sample, which reads `count`. Filters and model restart with the
 * motion after the gap. The sums of the estimate stay. Straight lines replace a few lost samples better. */
void pmf_gap(const pmf_config_t *config, pmf_state_t *state, uint32_t count);
/* Report that the last sample was a guess. The recursion skips `samples` samples, or more in slow motion, at most the
 * settling time. The filters continue. */
void pmf_doubt(const pmf_config_t *config, pmf_state_t *state, uint32_t samples);
/* Process one sample: `input` acts from the moment at which `count` is read. Returns the status bits, 0 to
 * PMF_STATUS_BITS. An input that is NaN, or larger than 1e15 (float32) or 1e100, is flagged and replaced. */
PMF_API whole_t pmf_step(const pmf_config_t *config, pmf_state_t *state, real_t input, whole_t count);
/* Set the time since the last sample [s] before pmf_step() if the configuration has a rate. The default of the step is
 * the sample period. A step that is not positive, or longer than 100 periods, is flagged as an invalid input. */
void pmf_set_step(const pmf_config_t *config, pmf_state_t *state, real_t step);
/* Write P of the estimate to n x n numbers, row by row, n = pmf_parameters(). The covariance of theta is the innovation
 * variance times P. A borrowed estimate of another parametrisation has only the diagonal. */
void pmf_covariance_factor(const pmf_config_t *config, const pmf_state_t *state, real_t *p);
/* Return the estimate of the last step: theta [unit of each parameter] and its statistics. */
const pmf_estimate_t *pmf_estimate(const pmf_config_t *config, const pmf_state_t *state);
/* Open the memory after a change of the plant. The information on one parameter, or on all with PMF_NO_PARAMETER, is
 * multiplied by root^2, 0 < root <= 1. Estimate, filters and auxiliary model stay. The inflation of standard errors
 * restarts, also with root = 1. */
void pmf_open(const pmf_config_t *config, pmf_state_t *state, uint32_t parameter, real_t root);
/* Return the variance of parameter 0 to pmf_parameters() - 1 [squared unit], corrected for coloured innovations, from 0
 * to PMF_UNKNOWN, which stands for no estimate. */
real_t pmf_variance(const pmf_config_t *config, const pmf_state_t *state, uint32_t parameter);
/* Return the number of parameters of the estimate, 1 to PMF_MAX_PARAMETERS. */
PMF_API uint32_t pmf_parameters(const pmf_config_t *config);
#endif

/* A saved state for a restart after a loss of power, with the identity of its configuration. Python's `get_state` gives
 * the same bytes. */
enum { PMF_STATE_MAGIC = 0x53464d50 /* "PMFS" */, PMF_STATE_VERSION = 1 };

typedef struct {
    uint32_t magic, version;
    uint32_t layout; /* CRC-32 of names, types and offsets of the state's fields */
    uint32_t size; /* size of this structure [byte] */
    uint32_t config; /* CRC-32 of the configuration */
    uint32_t checksum; /* CRC-32 of the five words above and the state */
    pmf_state_t state;
} pmf_saved_t;

enum { PMF_LOADED = 0, PMF_NOT_A_STATE, PMF_DAMAGED_STATE, PMF_OTHER_VERSION, PMF_OTHER_CONFIG, PMF_IMPLAUSIBLE_STATE };

/* Write a state with its identity and checksum. */
void pmf_save(const pmf_config_t *config, const pmf_state_t *state, pmf_saved_t *saved);
/* Load a saved state. Returns PMF_LOADED, or the reason of a failure, which leaves the state unchanged. */
uint32_t pmf_load(const pmf_config_t *config, const pmf_saved_t *saved, pmf_state_t *state);
/* Return 1 if the numbers can be a state, 0 if no sample could have made them, whatever their checksum. */
uint32_t pmf_plausible(const pmf_config_t *config, const pmf_state_t *state);
/* Return the CRC-32 of ISO 3309 (Ethernet, zlib) of `size` bytes after data with the CRC `crc`, 0 at the start. */
uint32_t pmf_crc32(uint32_t crc, const void *data, uint32_t size);

/* An alarm on a parameter of the estimate, after every step. Its sums are no part of the state. Clear them at first. */
typedef struct {
    uint32_t parameter; /* 0 to pmf_parameters() - 1 */
    uint32_t interval; /* samples between two estimates that count */
    real_t nominal; /* value in normal work [unit of the parameter] */
    real_t shift; /* size of the change to be noticed, > 0 [unit of the parameter] */
    real_t threshold; /* threshold of the logarithm of the likelihood ratio, > 0 */
} pmf_alarm_config_t;

typedef struct {
    real_t up, down;
    uint32_t wait;
} pmf_alarm_state_t;

/* Return 1 if the parameter is above nominal, -1 if below, 0 without an alarm. */
int32_t pmf_alarm_step(const pmf_alarm_config_t *alarm, pmf_alarm_state_t *sums, const pmf_config_t *config,
                       const pmf_state_t *state);

/* Effects of compiler options on this build's arithmetic, as bits. With 0 the results have the bits of Python. */
enum { PMF_CONTRACTED = 1, PMF_REARRANGED = 2, PMF_NO_NAN = 4, PMF_FLUSHED = 8 };
/* Return these bits. */
uint32_t pmf_arithmetic(void);

/* Clear `size` bytes of memory one by one, so that padding is zero and two states can be compared. */
PMF_API void pmf_clear(void *memory, uint32_t size);

#ifdef __cplusplus
}
#endif

#endif
