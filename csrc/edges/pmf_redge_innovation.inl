/* The innovation of an edge, and what it teaches. Only pmf_redge.c includes this file.
 * SPDX-License-Identifier: Apache-2.0
 *
 * Each line has an error of its own at all of its edges. The prediction of an edge is therefore that of the motion plus
 * the mean of what the edges of this line had left, and its regressors are without the means of this line (random
 * effects). So a line that is off costs one edge. */

static const real_t WIDEST = PMF_R(0.1); /* largest variance of the lines [counts^2] */
static const real_t VARIANCES = PMF_R(400.0); /* edges: memory of the variance of the lines */
static const real_t INSTANTS = PMF_R(50.0); /* edges: memory of the variance of the instants */
static const real_t MOST_HEARD = PMF_R(1e4);
static const real_t LEAST_SHARE =
    PMF_R(0.3); /* of the instants in an innovation that is too large, before their noise is known */
static const real_t MOST_SURPRISE = PMF_R(9.0);
static const real_t FORGOTTEN = PMF_R(1e-5); /* relative variance of a parameter, to which forgetting may increase it */
static const real_t SHRINK = PMF_R(0.95); /* of the drift, from edge to edge without a trend */

/* Innovation of an edge, and what it consists of. */
typedef struct {
    real_t value, variance, noise, instant, from_line, from_motion, regressor[PMF_EDGE_UNKNOWNS],
        gain[PMF_EDGE_UNKNOWNS];
} pmf_edge_t;

/* Return the squared error of the second order in the prediction of an edge, for parameters that may be off by their
 * standard deviations, and by their change since the start of the window if `changed` is 1. */
static real_t second_order(const pmf_redge_state_t *state, real_t changed)
{
    real_t most = PMF_R(0.0), relative = PMF_R(0.0), stops;
    uint32_t i;
    stops = state->stops_by[SPEED] *
            (changed * state->change[SPEED] * state->change[SPEED] + state->covariance[SPEED][SPEED]);
    for (i = FIRST; i < PMF_EDGE_UNKNOWNS; ++i) {
        real_t moved = changed * state->change[i] * state->change[i] + state->covariance[i][i];
        stops += state->stops_by[i] * moved;
        most = larger(most, moved * state->place_by[i] * state->place_by[i]);
        relative = larger(relative, i == FIRST + MASS ? moved : PMF_R(0.25) * moved);
    }
    return most * smaller(relative, PMF_R(1.0)) + stops * stops;
}

/* Compare an edge `distance` counts beyond the simulated place with its line. */
static void compare(const pmf_redge_config_t *config, const pmf_redge_state_t *state, const pmf_line_t *line,
                    real_t distance, pmf_edge_t *edge)
{
    real_t velocity = state->velocity + predict(state->velocity_by, state->change), weight;
    uint32_t i;
    edge->from_line = state->spread;
    for (i = 0; i < PMF_EDGE_UNKNOWNS; ++i) {
        edge->regressor[i] = state->place_by[i];
    }
    if (line != 0) {
        weight = line->by[PLACE] + state->scatter / state->spread;
        edge->from_line = state->scatter / weight;
        for (i = 0; i < PMF_EDGE_UNKNOWNS; ++i) {
            edge->regressor[i] -= line->by[i] / weight;
        }
        distance -= line->sum / weight;
    }
    edge->value = distance - predict(edge->regressor, state->change);
    for (i = 0; i < PMF_EDGE_UNKNOWNS; ++i) {
        edge->gain[i] = predict(state->covariance[i], edge->regressor);
    }
    edge->from_motion = predict(edge->gain, edge->regressor);
    edge->instant = config->tick * config->tick / PMF_R(12.0) * velocity * velocity;
    edge->noise = state->scatter * (edge->instant + config->finest * config->finest);
    edge->instant = edge->noise + second_order(state, PMF_R(1.0));
    edge->variance = edge->from_motion + edge->from_line + edge->instant;
}

/* Correct the parameters by the innovation. */
static void learn(const pmf_redge_config_t *config, pmf_redge_state_t *state, const pmf_edge_t *edge)
{
    uint32_t i, j;
    for (i = 0; i < PMF_EDGE_UNKNOWNS; ++i) {
        real_t gain = edge->gain[i] / edge->variance, move = gain * edge->value;
        state->change[i] += move;
        if (i >= FIRST) {
            state->block_moved[i - FIRST] += move;
            state->block_squares[i - FIRST] += move * move + gain * gain * config->finest * config->finest;
        }
        for (j = 0; j <= i; ++j) {
            state->covariance[i][j] -= edge->gain[i] * edge->gain[j] / edge->variance;
            state->covariance[j][i] = state->covariance[i][j];
        }
    }
}

/* Let the noise follow the innovations: the drift of a wrong model, or the variance of the instants. The covariance
 * follows the latter, because information is relative to the noise. */
static void scale_noise(pmf_redge_state_t *state, real_t ratio, real_t share)
{
    real_t gain = larger(PMF_R(1.0) / ((real_t)state->calm + PMF_R(2.0)), PMF_R(1.0) / INSTANTS);
    real_t factor = PMF_R(1.0) + gain * (ratio - PMF_R(1.0)), before = state->scatter;
    uint32_t i, j;
    if (state->unrest == 0U) {
        state->drift = PMF_R(0.0);
    } else if (state->drift > PMF_R(0.0) && state->trend > PMF_R(0.0)) {
        state->drift *= factor;
        return;
    } else {
        state->drift *= SHRINK;
    }
    share = ratio > PMF_R(1.0) ? larger(share, LEAST_SHARE) : share;
    gain = larger(share / state->heard, share / INSTANTS);
    factor = PMF_R(1.0) + gain * (ratio - PMF_R(1.0));
    state->scatter = larger(before * factor, PMF_R(1.0));
    for (i = 0; i < PMF_EDGE_UNKNOWNS; ++i) {
        for (j = 0; j < PMF_EDGE_UNKNOWNS; ++j) {
            state->covariance[i][j] *= state->scatter / before;
        }
        state->opened[i] *= state->scatter / before;
    }
}

/* Add an edge to the sums of its line, and to the variances of lines and instants. The variance of the lines follows
 * MacKay (1992): squared errors of the lines over the part of each error that the edges determine. */
static void learn_line(const pmf_redge_config_t *config, pmf_redge_state_t *state, pmf_line_t *line, real_t distance,
                       const pmf_edge_t *edge)
{
    real_t ratio = smaller(edge->value * edge->value / edge->variance, MOST_SURPRISE), weight;
    real_t square, known = PMF_R(1.0), share = PMF_R(1.0);
    uint32_t i;
    if (line != 0) {
        weight = state->scatter / edge->instant;
        line->sum += distance * weight;
        for (i = 0; i < PMF_EDGE_UNKNOWNS; ++i) {
            line->by[i] += state->place_by[i] * weight;
        }
        weight = line->by[PLACE] + state->scatter / state->spread;
        square = (line->sum - predict(line->by, state->change)) / weight;
        square *= square;
        known -= (state->scatter / weight + variance_along(state, line->by) / (weight * weight)) / state->spread;
        known = larger(known, PMF_R(0.0));
        share = edge->noise / edge->variance;
        scale_noise(state, ratio, share);
    } else {
        square = distance - predict(state->place_by, state->change);
        square = square * square + edge->from_motion * (PMF_R(1.0) - edge->from_motion / edge->variance);
    }
    state->heard = smaller(state->heard + share, MOST_HEARD);
    state->evidence = smaller(state->evidence + known, VARIANCES);
    state->spread += (square - known * state->spread) / state->evidence;
    state->spread = smaller(larger(state->spread, config->finest * config->finest), WIDEST);
}

/* Return 1 if the covariance of an unknown may grow. Edges that say nothing on it, as those of an even motion, would
 * make it grow for ever. The velocity at the start of the window has nothing to forget. */
static uint32_t is_forgotten(const pmf_redge_state_t *state, uint32_t i)
{
    real_t most = i == PLACE ? ANYWHERE : i == LATENESS ? LATE * LATE : FORGOTTEN;
    return i != SPEED && state->covariance[i][i] < most ? 1U : 0U;
}

/* Forget for the time since the last edge. */
static void forget(const pmf_redge_config_t *config, pmf_redge_state_t *state)
{
    real_t time = smaller(state->since, WAIT * config->dt), growth;
    uint32_t i, j, forgotten[PMF_EDGE_UNKNOWNS];
    if (config->memory > PMF_R(0.0)) {
        growth = PMF_R(1.0) + time / config->memory;
        for (i = 0; i < PMF_EDGE_UNKNOWNS; ++i) {
            forgotten[i] = is_forgotten(state, i);
            state->opened[i] *= i == SPEED || forgotten[i] != 0U ? growth * growth : PMF_R(1.0);
        }
        for (i = 0; i < PMF_EDGE_UNKNOWNS; ++i) {
            for (j = 0; j < PMF_EDGE_UNKNOWNS; ++j) {
                state->covariance[i][j] *= forgotten[i] != 0U && forgotten[j] != 0U ? growth : PMF_R(1.0);
            }
        }
    }
    state->covariance[PLACE][PLACE] += state->drift * time;
    state->window_time += time;
}
