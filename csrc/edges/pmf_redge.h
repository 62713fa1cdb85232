/* Mass, viscous and Coulomb friction of an axis, and a constant force, on-line, from the instants of the encoder's
 * edges. SPDX-License-Identifier: Apache-2.0
 *
 * At an edge the position is known as well as the line is cut. A body that only the input moves is simulated at
 * reference parameters, with its derivatives. The difference from each edge is linear in place, velocity and parameters
 * at the start of a window. At the end of a window the reference moves to the estimate. The first reference needs no
 * guess: docs/decisions/estimation.md. */
#include "pmf.h" /* an export with edges includes this file from there */

#ifndef PMF_REDGE_H
#define PMF_REDGE_H

#ifndef PMF_BODY
#define PMF_BODY 4 /* most parameters: mass, viscous friction, Coulomb friction, offset; an export has its own */
#endif
enum pmf_edge_sizes {
    PMF_EDGE_UNKNOWNS = 3 + PMF_BODY, /* place and velocity at the start of the window, lateness, and the body */
    PMF_MARKS = 17 /* edges of one way that are kept for the start */
};

/* The fields of the configuration do not change. `lines` is the number of lines that repeat, 0 if none does. */
typedef struct {
    scalar_t dt; /* sample period [s] */
    scalar_t resolution; /* travel per count */
    scalar_t input_gain; /* force per unit of the input */
    scalar_t tick; /* period of the timer that takes the instants [s] */
    scalar_t memory; /* time constant of forgetting [s], 0 for none */
    scalar_t finest; /* standard deviation of the best edge [counts], which the number format allows */
    uint32_t lines;
    uint32_t sign; /* sign bit of a change of the counter, 2^(bits - 1) */
    uint32_t parameters; /* 3, or 4 with an offset */
} pmf_redge_config_t;

/* Running sums of one line: its error, and what the unknowns change. The place changes by as much as its unknown, so
 * by[0] is the weight of the sums. The caller owns `lines` of them. */
typedef struct {
    real_t sum, by[PMF_EDGE_UNKNOWNS];
} pmf_line_t;

/* An edge of the present way: time [s], line, double integral of the input, integral of the place since its start. */
typedef struct {
    real_t t, line, pushed, placed;
} pmf_mark_t;

/* Sums of the direct start: instruments times regressors, and regressors with themselves and the target. */
typedef struct {
    pmf_mark_t mark[PMF_MARKS];
    real_t t, push, pushed, way;
    real_t cross[PMF_BODY][PMF_BODY], target[PMF_BODY];
    real_t square[PMF_BODY][PMF_BODY], own[PMF_BODY][PMF_BODY], own_target[PMF_BODY], energy, weight;
    real_t theta[PMF_BODY];
    uint32_t marks, ways, counted;
    uint32_t rose; /* 1: the input rose in the direction of the motion since the last mark */
    uint32_t known; /* 1: theta is given */
} pmf_start_t;

typedef struct {
    real_t place, velocity; /* of the reference: counts beyond the line of the present count, counts/s */
    real_t place_rest, velocity_rest; /* what the last digits do not hold */
    real_t place_by[PMF_EDGE_UNKNOWNS], velocity_by[PMF_EDGE_UNKNOWNS];
    real_t stops_by[PMF_EDGE_UNKNOWNS]; /* half of the second derivatives of the place by the stops */
    real_t reference[PMF_BODY]; /* per count of position, as a force per count/s^2 and count/s */
    real_t change[PMF_EDGE_UNKNOWNS],
        covariance[PMF_EDGE_UNKNOWNS][PMF_EDGE_UNKNOWNS]; /* parameters relative to the reference */
    real_t opened[PMF_EDGE_UNKNOWNS]; /* variances at the start of the window */
    real_t late; /* time by which all instants come late [s] */
    real_t drift; /* variance that the place gains per second, of a wrong model [counts^2/s] */
    real_t spread, scatter; /* variance of the lines [counts^2]; variance of the instants over that of a tick */
    real_t heard; /* edges that show the variance of the instants */
    real_t evidence; /* errors of lines that their variance follows from */
    real_t block_moved[PMF_BODY], block_squares[PMF_BODY]; /* of the parameters in the present block */
    real_t further[PMF_BODY]; /* squared moves of blocks over the sums of squared corrections */
    real_t turned, turned_known; /* of the first innovations after reversals: sum, its variance */
    real_t heading; /* direction of the last edge */
    real_t surprise, colour, correlation, trend, last, last_variance, size; /* of the innovations */
    real_t input, since, window_time,
        last_line; /* last input; time since the last edge, and in this window; its line */
    pmf_start_t start;
    real_t theta[PMF_BODY], variance[PMF_BODY], innovation;
    uint32_t count, begun, running, edges, in_window, window, least, calm, lost, astray, against, away, unrest,
        in_block, blocks, status;
    integer_t offset; /* whole counts that the edges are away from the simulated motion */
    uint32_t line_number; /* number of the line at the present count, below `lines` */
} pmf_redge_state_t;

void pmf_redge_init(const pmf_redge_config_t *config, pmf_redge_state_t *state, pmf_line_t *lines);

/* Take a sample and return its status bits. `input` acts from now on. `age` is the time from the last edge to now, and
 * negative or not finite without an edge since the last sample. */
uint32_t pmf_redge_step(const pmf_redge_config_t *config, pmf_redge_state_t *state, pmf_line_t *lines, scalar_t input,
                        uint32_t count, scalar_t age);

/* Begin again at the next edges, from given parameters in their units: the axis may have changed a little. */
void pmf_redge_expect(const pmf_redge_config_t *config, pmf_redge_state_t *state, const real_t *theta);

/* Return 1 if the numbers can be a state, 0 if no sample could have made them. */
uint32_t pmf_redge_plausible(const pmf_redge_config_t *config, const pmf_redge_state_t *state, const pmf_line_t *lines);

#endif
