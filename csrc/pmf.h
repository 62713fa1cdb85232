/* pmfid kernel: continuous-time identification with Poisson moment functionals, one sample at a time.
 *
 * SPDX-License-Identifier: Apache-2.0
 *
 * One call of pmf_step() takes an input and an encoder count and walks straight through:
 *
 *   counts, input -> encoder -> network of first-order stages -> columns -> recursion -> estimate
 *
 * The kernel knows neither a drive nor an equation: the configuration says which stages there are and
 * which sums of their outputs are regressors, target and instruments. No malloc, no globals, no libc.
 * Compile with -std=c99 -ffp-contract=off and never with -ffast-math: then every target gives the same bits.
 */
#ifndef PMF_H
#define PMF_H

#include <stdint.h>

#ifdef PMF_FLOAT32
typedef float real_t;
#define PMF_R(x) (x##f)
#else
typedef double real_t;
#define PMF_R(x) (x)
#endif

#ifndef PMF_MAX_STAGES
#define PMF_MAX_STAGES 40
#endif
#ifndef PMF_MAX_TAPS
#define PMF_MAX_TAPS 64
#endif
#ifndef PMF_MAX_PARAMETERS
#define PMF_MAX_PARAMETERS 8
#endif
#define PMF_MAX_COLUMNS (2 * PMF_MAX_PARAMETERS + 1)

/* Signals of one sampling interval; nodes 0..3 of the network. All but the velocity are one sample late,
 * because the direction of an interval is known best one sample after it. */
enum {
    PMF_INPUT = 0,     /* input times moving fraction; one sample late */
    PMF_VELOCITY = 1,  /* mean velocity over the last interval */
    PMF_DIRECTION = 2, /* time moving forward minus backward, over the interval; one sample late */
    PMF_MOVING = 3,    /* time moving, over the interval; one sample late */
    PMF_SIGNALS = 4
};

/* Status bits of a step. The Python enumeration `Status` has the same values and the advice. */
enum {
    PMF_STARTING = 1,
    PMF_SETTLING = 2,
    PMF_POOR_EXCITATION = 4,
    PMF_COMPENSATION_HELD = 8,
    PMF_INVALID_INPUT = 16,
    PMF_COUNT_JUMP = 32,
    PMF_STANDSTILL = 64,
    PMF_RESET = 128
};

typedef struct {
    real_t velocity_per_count;   /* resolution / dt */
    uint32_t count_mask;         /* 2^bits - 1 */
    uint32_t max_change;         /* more counts in one sample are a jump; 0: no check */
    uint32_t standstill_samples; /* without a count for so long: at rest */
    real_t position_gain, velocity_gain; /* of the tracker, per count */
    real_t smooth_end, smooth_start;     /* one-step smoother of the tracker's velocity */
} pmf_encoder_config_t;

typedef struct {
    uint32_t count;
    uint32_t idle; /* samples since the last count, saturating */
    uint32_t gap;  /* samples between counts lately */
    int32_t fast, fast_before;
    int32_t started;
    real_t position, velocity, velocity_before, innovation; /* tracker, in counts and samples */
    real_t direction, moving; /* of the last interval */
    real_t input, input_before;
} pmf_encoder_state_t;

/* node[k] = b0 * node[source] + (what b1 and a left from the step before) */
typedef struct {
    uint32_t source;
    real_t a, b0, b1;
} pmf_stage_t;

typedef struct {
    uint32_t node;
    real_t weight;
} pmf_tap_t;

/* Columns are sums of taps: regressors, then the target, then the instruments if there are any. */
typedef struct {
    uint32_t n_stages, n_columns;
    pmf_stage_t stage[PMF_MAX_STAGES];
    uint32_t tap_end[PMF_MAX_COLUMNS];
    pmf_tap_t tap[PMF_MAX_TAPS];
} pmf_network_config_t;

typedef struct {
    real_t node[PMF_SIGNALS + PMF_MAX_STAGES];
    real_t memory[PMF_MAX_STAGES];
    real_t column[PMF_MAX_COLUMNS];
} pmf_network_state_t;

typedef struct {
    uint32_t n_parameters;
    uint32_t instrumental;     /* 0: least squares, 1: instruments in their own columns */
    uint32_t min_updates;      /* before the first estimate */
    uint32_t residual_updates; /* so many steps from the accumulated right-hand side, then from the innovation */
    real_t forgetting;
    real_t regularization; /* information that is never forgotten, as a part of the largest seen */
    real_t pivot;          /* smallest relative pivot for a first estimate */
} pmf_recursion_config_t;

typedef struct {
    real_t cross[PMF_MAX_PARAMETERS][PMF_MAX_PARAMETERS]; /* sum zeta phi^T; lower half if least squares */
    real_t square[PMF_MAX_PARAMETERS][PMF_MAX_PARAMETERS]; /* sum zeta zeta^T, lower half; instruments only */
    real_t right[PMF_MAX_PARAMETERS];                      /* sum zeta z */
    real_t peak[PMF_MAX_PARAMETERS];                       /* largest information seen, slowly leaking */
    real_t factor[PMF_MAX_PARAMETERS][PMF_MAX_PARAMETERS]; /* information = L D L^T: L below the diagonal */
    real_t inverse_pivot[PMF_MAX_PARAMETERS];              /* 1 / D */
    real_t variance_factor[PMF_MAX_PARAMETERS];            /* diagonal of P */
    real_t theta[PMF_MAX_PARAMETERS];
    real_t mass;   /* 1 - forgetting^updates: how much of the regularisation is in force */
    real_t weight; /* of the innovations below */
    real_t innovation, innovation_square, innovation_variance;
    uint32_t updates; /* saturating */
    uint32_t started; /* updates since the first estimate, 0 before, saturating */
    uint32_t frozen;  /* too little information left to forget any more */
} pmf_recursion_state_t;

typedef struct {
    uint32_t settle_samples;
    pmf_encoder_config_t encoder;
    pmf_network_config_t network;
    pmf_recursion_config_t recursion;
} pmf_config_t;

typedef struct {
    uint32_t status;
    uint32_t settle; /* samples until the filters have forgotten their start */
    pmf_encoder_state_t encoder;
    pmf_network_state_t network;
    pmf_recursion_state_t recursion;
} pmf_state_t;

void pmf_init(const pmf_config_t *config, pmf_state_t *state);
/* One sample: `input` is applied from now on, `count` is read now. Returns the status bits. */
uint32_t pmf_step(const pmf_config_t *config, pmf_state_t *state, real_t input, uint32_t count);
/* P, with theta_cov = innovation variance times P; n_parameters x n_parameters, row by row. */
void pmf_covariance_factor(const pmf_config_t *config, const pmf_state_t *state, real_t *p);

/* Byte-wise, so that padding is zero too and two states can be compared. */
void pmf_clear(void *memory, uint32_t size);

/* The parts; `signal` has PMF_SIGNALS entries. */
uint32_t pmf_encoder_step(const pmf_encoder_config_t *config, pmf_encoder_state_t *state, real_t input,
                          uint32_t count, real_t *signal);
void pmf_network_step(const pmf_network_config_t *config, pmf_network_state_t *state);
uint32_t pmf_recursion_step(const pmf_recursion_config_t *config, pmf_recursion_state_t *state,
                            const real_t *column);
/* Encoder and network alone, for batch methods: the columns are in state->network.column. */
uint32_t pmf_filter(const pmf_config_t *config, pmf_state_t *state, real_t input, uint32_t count);

#endif
