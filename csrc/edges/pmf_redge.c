/* The recursion over the edges. SPDX-License-Identifier: Apache-2.0
 *
 * Each line has an error of its own at all of its edges. The prediction of an edge is therefore that of the motion plus
 * the mean of what the edges of this line had left, and its regressors are without the means of this line (random
 * effects). So a line that is off costs one edge. */
#include "pmf_redge_window.h"

#define WIDEST PMF_R(0.1) /* largest variance of the lines [counts^2] */
#define NOT_A_STEP PMF_R(0.5) /* distance from a line [counts] from which on the edge is of another line */
#define SURE PMF_R(0.04) /* variance of a prediction [counts^2] below which that is known */
#define LOST_AFTER 8U /* edges that are the same whole counts away, before the place moves */
#define ASTRAY 12U /* edges in a row that are of another line, before an alarm */
#define NARROWEST PMF_R(0.125) /* samples: edges further from the ends of their sample are taken */
#define CREEP PMF_R(0.02) /* counts per sample: a slower axis has edges by noise, and its instants say nothing */
#define OUTLIER PMF_R(25.0) /* squared innovation over its variance of an edge by noise, */
#define USUAL PMF_R(9.0) /* and most of the edge before */
#define CHANCE PMF_R(4.0) /* standard deviations of an instant */
#define AGAINST 6U /* edges against the simulated motion, before it is given up */
#define AWAY PMF_R(1.5) /* counts beyond the step of the count: the simulated motion is lost */
#define AWAY_AFTER 3U /* samples without an edge */
#define RECENT PMF_R(16.0) /* edges: memory of the surprise */
#define COLOURED PMF_R(64.0) /* edges: memory of the covariance of successive innovations, */
#define CORRELATED PMF_R(128.0) /* and of their correlation */
#define BLOCK 16U /* edges */
#define BLOCKS PMF_R(16.0) /* memory of the blocks */
#define VARIANCES PMF_R(400.0) /* edges: memory of the variance of the lines */
#define INSTANTS PMF_R(50.0) /* edges: memory of the variance of the instants */
#define MOST_HEARD PMF_R(1e4)
#define LEAST_SHARE PMF_R(0.3) /* of the instants in an innovation that is too large, before their noise is known */
#define DOUBT PMF_R(10.0) /* edges that show the instants' noise, at which variances are twice as large */
#define MOST_SURPRISE PMF_R(9.0)
#define MOST_SIZE PMF_R(100.0) /* mean squared innovation [counts^2] that an alarm takes for true */
#define DRIFTING PMF_R(8.0) /* edges over which such an innovation has grown */
#define ALARM PMF_R(6.0) /* mean squared innovation over its variance: another machine, or another model */
#define VISIBLE PMF_R(4e-4) /* smaller mean squared innovations [counts^2] are no alarm */
#define RECENT_EDGES 24U /* edges after an alarm before the correlation is known */
#define MOST_CHANGE 1000000 /* counts in a sample */
#define SETTLED PMF_R(0.06) /* part of the squared errors of second order that a new reference may leave */
#define STRAIGHT PMF_R(1.001)
#define CALM 8U /* edges before an alarm */
#define EXACT PMF_R(0.1) /* error of each parameter, relative to the best edge in counts: rounding */
#define TREND PMF_R(0.3) /* correlation of innovations, of an alarm */
#define SHRINK PMF_R(0.95) /* of the drift, from edge to edge without a trend */
#define MOST_MOVES (6U * STEADY) /* moves of the reference, of which a right model needs three to six */
#define COLOUR PMF_R(0.3) /* covariance over the variance from which on the model is wrong */
#define CORRELATION PMF_R(0.2) /* correlation from which on the model is wrong; chance makes 0.06 */
#define CORRELATION_OF_FEW PMF_R(5.0) /* the same, of one edge */
#define FURTHER PMF_R(3.0) /* squared moves of blocks over those by chance, from which on the model is wrong */
#define FURTHER_OF_FEW PMF_R(8.0) /* the same, of one block */
#define JITTER PMF_R(1.6e-5) /* standard deviation of instants from which on the model is wrong [s], */
#define UNEVENLY PMF_R(3e-3) /* and of places [counts] */
#define UNEVEN PMF_R(6.4e-3) /* variance of the lines from which on the model is wrong [counts^2] */
#define LATEST PMF_R(1e-4) /* time by which no capture of an edge is late: the input acts late [s] */

/* Innovation of an edge, and what it consists of. */
typedef struct {
    real_t value, variance, noise, instant, from_line, from_motion, regressor[PMF_FOLLOWED], gain[PMF_FOLLOWED];
} pmf_edge_t;

void pmf_redge_init(const pmf_redge_config_t *config, pmf_redge_state_t *state, pmf_line_t *lines)
{
    uint32_t i;
    pmf_clear(state, (uint32_t)sizeof *state);
    forget_lines(config, lines);
    for (i = 0; i < PMF_BODY; ++i) {
        state->variance[i] = PMF_UNKNOWN;
    }
    state->status = PMF_STARTING;
}

/* Return the squared error of the second order in the prediction of an edge, for parameters that may be off by their
 * standard deviations, and by their change since the start of the window if `changed` is 1. */
static real_t second_order(const pmf_redge_state_t *state, real_t changed)
{
    real_t most = PMF_R(0.0), relative = PMF_R(0.0), stops;
    uint32_t i;
    stops = state->stops_by[SPEED] *
            (changed * state->change[SPEED] * state->change[SPEED] + state->covariance[SPEED][SPEED]);
    for (i = FIRST; i < PMF_FOLLOWED; ++i) {
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
    for (i = 0; i < PMF_FOLLOWED; ++i) {
        edge->regressor[i] = state->place_by[i];
    }
    if (line != 0) {
        weight = line->weight + state->scatter / state->spread;
        edge->from_line = state->scatter / weight;
        for (i = 0; i < PMF_FOLLOWED; ++i) {
            edge->regressor[i] -= line->by[i] / weight;
        }
        distance -= line->sum / weight;
    }
    edge->value = distance - predict(edge->regressor, state->change);
    for (i = 0; i < PMF_FOLLOWED; ++i) {
        edge->gain[i] = predict(state->covariance[i], edge->regressor);
    }
    edge->from_motion = predict(edge->gain, edge->regressor);
    edge->instant = config->tick * config->tick / PMF_R(12.0) * velocity * velocity;
    edge->noise = state->scatter * (edge->instant + config->finest * config->finest);
    edge->instant = edge->noise + second_order(state, PMF_R(1.0));
    edge->variance = edge->from_motion + edge->from_line + edge->instant;
}

/* Note size and correlation of the innovations. */
static void note_surprise(const pmf_redge_config_t *config, pmf_redge_state_t *state, const pmf_edge_t *edge)
{
    real_t velocity = state->place_by[LATENESS], limit, square, alike;
    real_t one = PMF_R(1.0) / ((real_t)state->calm + PMF_R(1.0)), ratio = edge->value * edge->value / edge->variance;
    real_t both = edge->value * state->last / (PMF_R(0.5) * (edge->variance + state->last_variance));
    real_t gain = larger(one, PMF_R(1.0) / RECENT);
    state->surprise += gain * (smaller(ratio, PMF_R(100.0)) - state->surprise);
    state->size += gain * (edge->value * edge->value - state->size);
    both = smaller(larger(both, PMF_R(-9.0)), PMF_R(9.0));
    limit = velocity * velocity * JITTER * JITTER + UNEVENLY * UNEVENLY;
    state->rough += gain * (edge->noise / limit - state->rough);
    state->trend += gain * (both - state->trend);
    square = edge->value * edge->value + state->last * state->last + PMF_R(2.0) * config->finest * config->finest;
    alike = PMF_R(2.0) * edge->value * state->last / square; /* from -1 to 1, whatever the size of the innovations */
    state->colour += larger(one, PMF_R(1.0) / COLOURED) * (both - state->colour); /* sees a change at once */
    state->correlation += larger(one, PMF_R(1.0) / CORRELATED) * (alike - state->correlation);
    state->last = edge->value;
    state->last_variance = edge->variance;
    state->innovation = edge->value;
}

/* Correct the parameters by the innovation. */
static void learn(const pmf_redge_config_t *config, pmf_redge_state_t *state, const pmf_edge_t *edge)
{
    uint32_t i, j;
    for (i = 0; i < PMF_FOLLOWED; ++i) {
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

/* Note how much further the parameters moved in a block of edges than by corrections without a correlation. */
static void note_block(pmf_redge_state_t *state)
{
    real_t gain = larger(PMF_R(1.0) / ((real_t)state->blocks + PMF_R(1.0)), PMF_R(1.0) / BLOCKS);
    uint32_t i;
    state->in_block += 1U;
    if (state->in_block < BLOCK) {
        return;
    }
    for (i = 0; i < PMF_BODY; ++i) {
        real_t moved = state->block_moved[i] * state->block_moved[i];
        if (moved > PMF_R(0.0)) {
            state->further[i] += gain * (moved / state->block_squares[i] - state->further[i]);
        }
        state->block_moved[i] = state->block_squares[i] = PMF_R(0.0);
    }
    state->blocks += state->blocks < LAST_WINDOW ? 1U : 0U;
    state->in_block = 0U;
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
    for (i = 0; i < PMF_FOLLOWED; ++i) {
        for (j = 0; j < PMF_FOLLOWED; ++j) {
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
        line->weight += weight;
        line->sum += distance * weight;
        for (i = 0; i < PMF_FOLLOWED; ++i) {
            line->by[i] += state->place_by[i] * weight;
        }
        weight = line->weight + state->scatter / state->spread;
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

/* Forget for the time since the last edge; the velocity at the start of the window has nothing to forget. */
static void forget(const pmf_redge_config_t *config, pmf_redge_state_t *state)
{
    real_t time = smaller(state->since, WAIT * config->dt), growth;
    uint32_t i;
    if (config->memory > PMF_R(0.0)) {
        growth = PMF_R(1.0) + time / config->memory;
        for (i = 0; i < PMF_FOLLOWED; ++i) {
            state->opened[i] *= growth * growth;
            if (i != SPEED) {
                uint32_t j;
                for (j = 0; j < PMF_FOLLOWED; ++j) {
                    state->covariance[i][j] *= j == SPEED ? PMF_R(1.0) : growth;
                }
            }
        }
    }
    state->covariance[PLACE][PLACE] += state->drift * time;
    state->window_time += time;
}

/* Take an edge of another line, or with lost counts, out; return 1 if it is one. */
static uint32_t is_of_another_line(const pmf_redge_config_t *config, pmf_redge_state_t *state, const pmf_edge_t *edge)
{
    real_t away = absolute(edge->value);
    integer_t counts;
    if (!(edge->variance < SURE && away > NOT_A_STEP)) {
        state->lost = state->astray = 0U;
        return 0U;
    }
    counts = away < PMF_R(1000.0) ? (integer_t)(away + PMF_R(0.5)) : 1000;
    counts = edge->value < PMF_R(0.0) ? -counts : counts;
    state->lost = counts == state->offset ? state->lost + 1U : 1U;
    state->offset = counts;
    state->astray += 1U;
    if (state->lost >= LOST_AFTER) { /* the counts were lost: later edges are those of the lines next to them */
        state->place += (real_t)counts;
        turn_lines(config, state, -counts);
        state->lost = 0U;
    }
    return 1U;
}

/* The innovations are too large. At first this is another machine: the prior opens and short windows find its
 * parameters, or the direct start does if the motion is lost. If it happens again soon, the model is wrong: the place
 * drifts away from the simulated one. */
static void take_alarm(const pmf_redge_config_t *config, pmf_redge_state_t *state, pmf_line_t *lines)
{
    real_t size = smaller(state->size, MOST_SIZE), scatter = state->scatter, time = state->window_time + config->dt;
    real_t drift = state->drift + size * ((real_t)state->in_window + PMF_R(1.0)) / (time * DRIFTING);
    uint32_t again = state->unrest != 0U ? 1U : 0U;
    if (size > NOT_A_STEP * NOT_A_STEP && (again == 0U || size >= MOST_SIZE)) {
        give_up(state);
        return;
    }
    end_window(config, state, lines);
    if (again == 0U) {
        open_prior(config, state, state->velocity);
    }
    state->scatter = scatter;
    state->drift = again != 0U ? drift : PMF_R(0.0);
    state->covariance[PLACE][PLACE] += size;
    state->window = FIRST_WINDOW;
    state->least = SHORTEST_WINDOW;
    state->surprise = PMF_R(1.0);
    state->size = state->trend = PMF_R(0.0);
    state->calm = state->lost = 0U;
    note_unrest(state);
}

/* Return 1 if the innovations are too large and are no noise: noise has no trend. */
static uint32_t is_alarm(const pmf_redge_state_t *state)
{
    real_t late = state->velocity * LATE;
    return state->calm >= CALM && state->surprise > ALARM && state->trend > TREND * state->surprise &&
                   state->size > VISIBLE + late * late
               ? 1U
               : 0U;
}

/* Return the line of an edge in the direction of `way`: the present count's own line, or the next one. */
static pmf_line_t *line_of(const pmf_redge_config_t *config, const pmf_redge_state_t *state, pmf_line_t *lines,
                           integer_t way)
{
    uint32_t number = state->line_number + (way > 0 ? 0U : 1U);
    return config->lines == 0U ? 0 : &lines[number < config->lines ? number : number - config->lines];
}

/* Return 1 if it depends on its lateness whether the edge is the last of its sample: such edges are a biased choice. */
static uint32_t is_chosen_by_chance(const pmf_redge_config_t *config, const pmf_redge_state_t *state, real_t velocity,
                                    real_t age)
{
    real_t margin = smaller(age, config->dt - age), limit = config->dt * NARROWEST;
    real_t other = absolute(PMF_R(1.0) / absolute(velocity) - age), variance;
    margin = smaller(margin, other);
    variance = state->scatter * config->tick * config->tick / PMF_R(12.0);
    return margin < limit && margin * margin < CHANCE * CHANCE * variance ? 1U : 0U;
}

/* Return 1 if the edge is far off and the one before was not: an edge of noise. A change makes several such edges. */
static uint32_t is_alone(const pmf_redge_state_t *state, const pmf_edge_t *edge)
{
    return state->calm >= CALM && edge->value * edge->value > OUTLIER * edge->variance &&
                   state->last * state->last < USUAL * state->last_variance
               ? 1U
               : 0U;
}

/* Return 1 if the errors of second order exceed the noise, and a new reference makes them smaller. */
static uint32_t is_bent(const pmf_redge_state_t *state, const pmf_edge_t *edge)
{
    real_t error = edge->instant - edge->noise;
    return state->in_window >= state->least && error > edge->noise && second_order(state, PMF_R(0.0)) < SETTLED * error
               ? 1U
               : 0U;
}

/* Follow an edge `distance` counts beyond the simulated place. */
static void follow_edge(const pmf_redge_config_t *config, pmf_redge_state_t *state, pmf_line_t *lines, real_t distance,
                        integer_t way, real_t age)
{
    pmf_line_t *line = line_of(config, state, lines, way);
    pmf_edge_t edge;
    real_t velocity = state->velocity + predict(state->velocity_by, state->change);
    uint32_t alone;
    if (!((real_t)way * velocity > PMF_R(0.0))) { /* it turned: the last edge may be of another line */
        state->against += velocity == PMF_R(0.0) && absolute(distance) < NOT_A_STEP ? 0U : 1U; /* or chatters at rest */
        if (state->against >= AGAINST) {
            give_up(state);
        }
        return;
    }
    state->against = state->away = 0U;
    if (absolute(velocity) * config->dt < CREEP || is_chosen_by_chance(config, state, velocity, age) != 0U) {
        return;
    }
    state->place_by[LATENESS] = velocity;
    distance += state->late * velocity;
    forget(config, state);
    compare(config, state, line, distance, &edge);
    if (is_of_another_line(config, state, &edge) != 0U) {
        if (state->astray >= ASTRAY) {
            state->size = larger(state->size, edge.value * edge.value);
            state->astray = 0U;
            take_alarm(config, state, lines);
        }
        return;
    }
    alone = is_alone(state, &edge);
    note_surprise(config, state, &edge);
    if (alone != 0U) {
        return;
    }
    learn(config, state, &edge);
    note_block(state);
    learn_line(config, state, line, distance, &edge);
    state->edges += state->edges < LAST_WINDOW ? 1U : 0U;
    state->calm += state->calm < LAST_WINDOW ? 1U : 0U;
    state->unrest -= state->unrest != 0U ? 1U : 0U;
    state->moves -= state->moves != 0U ? 1U : 0U;
    state->in_window += 1U;
    if (is_alarm(state) != 0U) {
        take_alarm(config, state, lines);
    } else if (is_bent(state, &edge) != 0U) {
        end_window(config, state, lines);
        state->least *= 2U;
    } else if (state->in_window >= state->window) {
        if (edge.instant > edge.noise * STRAIGHT) {
            end_window(config, state, lines);
        }
        state->window = state->window < LAST_WINDOW ? 2U * state->window : LAST_WINDOW;
    } else {
        /* the window goes on */
    }
}

/* A count is an interval: without an edge the simulated place is within it. */
static void follow_silence(pmf_redge_state_t *state)
{
    real_t place;
    state->place_by[LATENESS] = PMF_R(0.0);
    place = state->place + predict(state->place_by, state->change);
    state->away = place < -AWAY || place > PMF_R(1.0) + AWAY ? state->away + 1U : 0U;
    if (state->away >= AWAY_AFTER) {
        give_up(state);
    }
}

/* Move everything that goes with the time. */
static void pass(const pmf_redge_config_t *config, pmf_redge_state_t *state, real_t time)
{
    real_t input = state->input;
    pmf_start_t *start = &state->start;
    state->since += time;
    if (state->running != 0U) {
        move_body(state, force_of(state, config->input_gain * input), time);
    } else {
        start->pushed += time * (start->push + PMF_R(0.5) * input * time);
        start->push += input * time;
        start->t += time;
    }
}

/* Take an edge where the axis has just moved on by `change` counts. */
static void take_edge(const pmf_redge_config_t *config, pmf_redge_state_t *state, pmf_line_t *lines, integer_t change,
                      real_t age)
{
    real_t way = change > 0 ? PMF_R(1.0) : PMF_R(-1.0), travel;
    real_t line = change > 0 ? PMF_R(0.0) : PMF_R(1.0);
    if (state->running != 0U) {
        follow_edge(config, state, lines, line - state->place, change, age);
    } else {
        travel = (real_t)change + line - state->last_line;
        mark_edge(config, &state->start, travel, way);
        state->edges += 1U;
        if (state->start.marks > 2U &&
            (state->start.known != 0U || is_started(&state->start, config->parameters) != 0U)) {
            begin(config, state, lines, line, travel);
        }
    }
    state->last_line = line;
    state->since = PMF_R(0.0);
}

/* Return 1 if the innovations depend on each other: the right model leaves none that do. */
static uint32_t is_correlated(const pmf_redge_state_t *state)
{
    real_t few = FURTHER_OF_FEW / ((real_t)state->blocks + PMF_R(1.0));
    uint32_t i, found;
    found = state->calm >= RECENT_EDGES && (state->colour > COLOUR ||
                                            state->correlation > CORRELATION + CORRELATION_OF_FEW / (real_t)state->calm)
                ? 1U
                : 0U;
    for (i = 0; i < PMF_BODY; ++i) {
        found |= state->further[i] > FURTHER + few ? 1U : 0U;
    }
    return found;
}

/* Publish the parameters. Surprises and correlated innovations widen the variance, and so do errors of second order. */
static void publish(const pmf_redge_config_t *config, pmf_redge_state_t *state)
{
    real_t bend = SECOND * bend_of(state), colour = smaller(larger(state->colour, PMF_R(0.0)), PMF_R(0.9)), widened,
           lateness;
    uint32_t i;
    state->status = state->running != 0U ? 0U : (uint32_t)PMF_STARTING;
    if (state->running == 0U) {
        return;
    }
    widened = contradiction_of(config, state) * larger(state->surprise, PMF_R(1.0)) * (PMF_R(1.0) + colour) /
              (PMF_R(1.0) - colour);
    widened *= PMF_R(1.0) + DOUBT / state->heard;
    for (i = 0; i < PMF_BODY; ++i) {
        real_t per = i < COULOMB ? config->resolution : PMF_R(1.0), scale = unit_of(state->reference, i) / per;
        real_t error = bend * state->change[FIRST + i],
               least = EXACT * config->finest * (PMF_R(1.0) + absolute(state->change[FIRST + i]));
        state->theta[i] = scale * (PMF_R(1.0) + state->change[FIRST + i]);
        state->variance[i] =
            scale * scale * (widened * state->covariance[FIRST + i][FIRST + i] + error * error + least * least);
    }
#if PMF_BODY > 3
    state->theta[OFFSET] = state->reference[OFFSET] + unit_of(state->reference, OFFSET) * state->change[FIRST + OFFSET];
#endif
    lateness = state->late - state->change[LATENESS];
    state->status |= lateness > LATEST || lateness < -LATEST ? (uint32_t)PMF_DEAD_TIME : 0U;
    if (state->unrest != 0U || state->moves > MOST_MOVES || is_correlated(state) != 0U || state->rough > PMF_R(1.0) ||
        state->spread > UNEVEN) {
        state->status |= PMF_UNMODELLED;
    }
}

/* Return 1 if every number that the next sample depends on is one. */
static uint32_t is_sound(const pmf_redge_config_t *config, const pmf_redge_state_t *state)
{
    real_t sum = state->place + state->velocity + state->spread + state->scatter;
    uint32_t i, sound = 1U;
    for (i = 0; i < PMF_FOLLOWED; ++i) {
        sum += state->change[i] + state->place_by[i] + state->velocity_by[i];
        sound &= i >= FIRST + config->parameters || state->covariance[i][i] > PMF_R(0.0) ? 1U : 0U;
    }
    return sum - sum == PMF_R(0.0) ? sound : 0U;
}

void pmf_redge_expect(const pmf_redge_config_t *config, pmf_redge_state_t *state, const real_t *theta)
{
    uint32_t i, unrest = state->unrest;
    give_up(state);
    state->unrest = unrest;
    state->start.known = 1U;
    for (i = 0; i < config->parameters; ++i) {
        state->start.theta[i] = theta[i] * (i < COULOMB ? config->resolution : PMF_R(1.0));
    }
}

uint32_t pmf_redge_step(const pmf_redge_config_t *config, pmf_redge_state_t *state, pmf_line_t *lines, scalar_t input,
                        uint32_t count, scalar_t age)
{
    uint32_t sign = config->sign, moved = (count - state->count) & (2U * sign - 1U); /* the counter may wrap */
    integer_t change = (integer_t)((moved ^ sign) - sign);
    uint32_t invalid = input - input == PMF_R(0.0) ? 0U : (uint32_t)PMF_INVALID_INPUT, far;
    if (state->begun == 0U) {
        state->begun = 1U;
        change = 0;
    }
    far = change > MOST_CHANGE || change < -MOST_CHANGE ? (uint32_t)PMF_COUNT_JUMP : 0U;
    state->count = count;
    if (far != 0U) {
        give_up(state);
        begin_way(&state->start);
        change = 0;
    }
    if (change != 0 && age >= PMF_R(0.0) && age <= config->dt) {
        real_t before = smaller(config->dt - age + PMF_R(0.5) * config->tick, config->dt);
        pass(config, state, before);
        state->place -= (real_t)change;
        turn_lines(config, state, change);
        take_edge(config, state, lines, change, age);
        pass(config, state, config->dt - before);
    } else {
        invalid |= change != 0 ? (uint32_t)PMF_INVALID_INPUT : 0U; /* an edge without its instant */
        pass(config, state, config->dt);
        state->place -= (real_t)change;
        state->last_line -= (real_t)change;
        turn_lines(config, state, change);
        if (state->running != 0U) {
            follow_silence(state);
        }
    }
    if (state->running != 0U && is_sound(config, state) == 0U) {
        give_up(state);
    }
    state->input = input - input == PMF_R(0.0) ? input : state->input;
    publish(config, state);
    state->status |= invalid | far;
    return state->status;
}
