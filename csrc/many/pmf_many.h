/* Many axes with one configuration, for fleets and simulations on a computer.
 * SPDX-License-Identifier: Apache-2.0
 *
 * Every axis has the bits of pmf_step() for a single axis. If compiler and processor have vectors, several axes are
 * computed at once (pmf_lanes.c). Between two calls a state is packed to the words that the configuration uses. */
#ifndef PMF_MANY_H
#define PMF_MANY_H

#include "../pmf_internal.h"

/* Ways to compute axes: one after the other, or in vectors of 16, 32 (AVX2) or 64 bytes (AVX-512). */
enum { PMF_ONE_BY_ONE = 0, PMF_LANES_16, PMF_LANES_32, PMF_LANES_64, PMF_WAYS };

/* Places of a word of a state: byte offsets in pmf_state_t and in the packed state, number among the vectors. */
typedef struct {
    uint32_t offset, packed, lane;
} pmf_word_t;
enum { PMF_MAX_WORDS = 8192 };

/* The words in use, reals first. Values that each step computes again, or that the configuration does not use, are left
 * out. Python chooses the words, because it knows the fields. */
typedef struct {
    uint32_t reals, words;
    uint32_t packed_size; /* bytes of a packed state */
    uint32_t lane_words; /* vectors in a state of lanes, or 0 if the configuration has no lanes */
    pmf_word_t word[PMF_MAX_WORDS];
} pmf_layout_t;

/* A table of numbers of 4 or 8 bytes, one row per axis. */
typedef struct {
    const unsigned char *start;
    int64_t axis, sample; /* bytes between two rows */
    uint32_t size;
} pmf_rows_t;

typedef struct {
    uint32_t way;
    pmf_rows_t input; /* float or double */
    pmf_rows_t counts; /* int32_t or int64_t */
    uint64_t samples;
    uint64_t every; /* samples between two kept estimates, or 0 for none. The last estimate is always kept. */
    uint64_t kept; /* estimates of each axis: */
    double *theta, *variance_factor, *inflation; /* axes x kept x parameters */
    double *innovation, *innovation_variance; /* axes x kept */
    uint32_t *status; /* axes x kept */
} pmf_many_t;

/* Scores of blocks of `size` samples for a deviation from reference parameters, after the filters. With e = z - phi^T
 * theta the scores are the sums of zeta e, zeta phi^T and zeta zeta^T, p + 2 p^2 numbers. `first` is the first of the
 * columns phi, z, zeta. Samples with a bit of `left_out` do not count. Samples with a bit of `disturbed` must not fill
 * a block alone. */
typedef struct {
    uint32_t first, parameters, size, left_out, disturbed;
} pmf_scoring_t;

/* Many axes: tables of one row each, without gaps. */
typedef struct {
    const double *input, *theta;
    const int64_t *counts;
    uint64_t samples;
    double *sums; /* sums of the current block */
    uint32_t *progress; /* numbers of samples and of disturbed samples in the current block */
    uint64_t kept; /* most blocks of an axis */
    double *blocks;
    unsigned char *lost; /* 1: the block had only disturbed samples */
} pmf_scored_t;

/* Code for a single method (pmf_straight.h), and general code. */
enum { PMF_GENERAL = 0, PMF_RLS, PMF_BCRLS, PMF_RIV, PMF_METHODS };

/* Run the axes `first` to `end` through all samples in groups. `packed` holds the states of all axes. Returns the axis
 * after the last group, because the remaining axes are too few for a group. */
typedef uint64_t pmf_lanes_run_t(const pmf_config_t *config, const pmf_layout_t *layout, const pmf_many_t *many,
                                 uint64_t first, uint64_t end, unsigned char *packed);
typedef struct {
    uint32_t lanes, words; /* vectors in a state */
    pmf_lanes_run_t *run[PMF_METHODS]; /* by pmf_method_of() */
} pmf_lanes_t;

extern const pmf_lanes_t pmf_lanes_16, pmf_lanes_32, pmf_lanes_64;

#ifndef PMF_LANES
/* Copy the words in use of a state to a packed state. */
void pmf_pack(const pmf_layout_t *layout, const pmf_state_t *state, unsigned char *packed);
/* Unpack a state. The unused part of the state stays, which is zero after pmf_init() or pmf_clear(). */
void pmf_unpack(const pmf_layout_t *layout, const unsigned char *packed, pmf_state_t *state);
/* Return the fastest way of this build on this processor. */
uint32_t pmf_many_way(void);
/* Run the axes `first` to `end` through all samples. `packed` holds the states of all axes. */
void pmf_many_run(const pmf_config_t *config, const pmf_layout_t *layout, const pmf_many_t *many, uint64_t first,
                  uint64_t end, unsigned char *packed);
/* Compute the scores of all samples of the axis `axis`, 0 for a single one, from its state. */
void pmf_score_axis(const pmf_config_t *config, const pmf_scoring_t *scoring, const pmf_scored_t *many, uint64_t axis,
                    pmf_state_t *state);
/* Process all samples of all axes, whose states are in `packed`. */
void pmf_many_scores(const pmf_config_t *config, const pmf_layout_t *layout, const pmf_scoring_t *scoring,
                     const pmf_scored_t *many, uint64_t axes, unsigned char *packed);
#endif

#endif
