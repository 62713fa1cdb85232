/* The recursion over the edges. SPDX-License-Identifier: Apache-2.0 */
#include "pmf_redge.h"

#include "pmf_redge_motion.inl"
#include "pmf_redge_start.inl"
#include "pmf_redge_window.inl"
#include "pmf_redge_innovation.inl"
#include "pmf_redge_signs.inl"

static const real_t NOT_A_STEP = PMF_R(0.5); /* distance from a line [counts] at which the edge is of another line */
static const real_t SURE = PMF_R(0.04); /* variance of a prediction [counts^2] below which that is known */
static const uint32_t LOST_AFTER = 8U; /* edges that are the same whole counts away, before the place moves */
static const uint32_t ASTRAY = 12U; /* edges in a row that are of another line, before an alarm */
static const real_t NARROWEST = PMF_R(0.125); /* samples: edges further from the ends of their sample are taken */
static const real_t CREEP = PMF_R(0.02); /* counts per sample: a slower axis has edges by noise */
static const real_t CHANCE = PMF_R(4.0); /* standard deviations of an instant */
static const uint32_t AGAINST = 6U; /* edges against the simulated motion, before it is given up */
static const real_t AWAY = PMF_R(1.5); /* counts beyond the step of the count: the simulated motion is lost */
static const uint32_t AWAY_AFTER = 3U; /* samples without an edge */
static const uint32_t CHECKED = 32U; /* edges after given parameters, from which on others may contradict these, */
static const uint32_t YOUNG = 1000U; /* and up to which they do, */
static const real_t DEPARTED = PMF_R(0.4); /* if a parameter is further from the given one, relative to it */
static const real_t STILL_HEARD = PMF_R(10.0); /* edges that the noise of the instants counts for after an alarm */
static const real_t DOUBT = PMF_R(10.0); /* edges that show the instants' noise, at which variances double */
static const real_t DRIFTING = PMF_R(8.0); /* edges over which such an innovation has grown */
static const int32_t MOST_CHANGE = 1000000; /* counts in a sample */
static const real_t SETTLED = PMF_R(0.06); /* part of the squared errors of second order that a reference may leave */
static const real_t STRAIGHT = PMF_R(1.001);
static const real_t EXACT = PMF_R(0.1); /* error of each parameter, relative to the best edge in counts: rounding */
static const real_t CLOCK = PMF_R(1e-5); /* relative error of a time, or of a force: crystals are made to 20 ppm */
static const real_t TURN_DOUBT = PMF_R(4.0); /* trend after reversals, from which on it widens the variances */
static const real_t LATEST = PMF_R(1e-4); /* time by which no capture of an edge is late: the input acts late [s] */

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

/* Take an edge of another line, or with lost counts, out; return 1 if it is one. */
static uint32_t is_of_another_line(const pmf_redge_config_t *config, pmf_redge_state_t *state, const pmf_edge_t *edge)
{
    real_t away = absolute(edge->value);
    integer_t counts;
    if (away != away || !(edge->variance < SURE && away > NOT_A_STEP)) {
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
    real_t size = smaller(state->size, MOST_SIZE), scatter = state->scatter, heard = state->heard;
    real_t time = state->window_time + config->dt;
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
    state->scatter = scatter; /* the encoder is still the same */
    state->heard = smaller(heard, STILL_HEARD);
    state->drift = again != 0U ? drift : PMF_R(0.0);
    state->covariance[PLACE][PLACE] += size;
    state->window = FIRST_WINDOW;
    state->least = SHORTEST_WINDOW;
    state->surprise = PMF_R(1.0);
    state->size = state->trend = PMF_R(0.0);
    state->calm = state->lost = 0U;
    note_unrest(state);
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
    note_turn(state, &edge, (real_t)way);
    if (alone != 0U) {
        return;
    }
    learn(config, state, &edge);
    note_block(state);
    learn_line(config, state, line, distance, &edge);
    state->edges += state->edges < LAST_WINDOW ? 1U : 0U;
    state->calm += state->calm < LAST_WINDOW ? 1U : 0U;
    state->unrest -= state->unrest != 0U ? 1U : 0U;
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
        mark_edge(config, &state->start, travel, way, state->input);
        state->edges += 1U;
        if (state->start.marks > 2U &&
            (state->start.known != 0U || is_started(&state->start, config->parameters) != 0U)) {
            begin(config, state, lines, line, travel);
        }
    }
    state->last_line = line;
    state->since = PMF_R(0.0);
}

/* Return 1 if instants are later, or earlier, than captures of edges can be. */
static uint32_t is_late(const pmf_redge_state_t *state)
{
    return absolute(state->late - state->change[LATENESS]) > LATEST ? 1U : 0U;
}

/* Publish the parameters. Surprises and correlated innovations widen the variance, and so do errors of second order. */
static void publish(const pmf_redge_config_t *config, pmf_redge_state_t *state)
{
    real_t bend = SECOND * bend_of(state), colour = smaller(larger(state->colour, PMF_R(0.0)), PMF_R(0.9)), widened;
    uint32_t i;
    state->status = state->running != 0U ? 0U : (uint32_t)PMF_STARTING;
    if (state->running == 0U) {
        return;
    }
    widened = contradiction_of(config, state) * larger(state->surprise, PMF_R(1.0)) * (PMF_R(1.0) + colour) /
              (PMF_R(1.0) - colour);
    widened *= (PMF_R(1.0) + DOUBT / state->heard) * larger(PMF_R(1.0), turn_trend(state) - TURN_DOUBT);
    for (i = 0; i < PMF_BODY; ++i) {
        real_t per = i < COULOMB ? config->resolution : PMF_R(1.0), scale = unit_of(state->reference, i) / per;
        real_t error = bend * state->change[FIRST + i],
               least = larger(EXACT * config->finest, i == MASS ? PMF_R(2.0) * CLOCK : CLOCK);
        least *= PMF_R(1.0) + absolute(state->change[FIRST + i]);
        state->theta[i] = scale * (PMF_R(1.0) + state->change[FIRST + i]);
        state->variance[i] =
            scale * scale * (widened * state->covariance[FIRST + i][FIRST + i] + error * error + least * least);
    }
#if PMF_BODY > 3
    state->theta[OFFSET] = state->reference[OFFSET] + unit_of(state->reference, OFFSET) * state->change[FIRST + OFFSET];
#endif
    state->status |= is_late(state) != 0U ? (uint32_t)PMF_DEAD_TIME : 0U;
    if (state->unrest != 0U || is_correlated(state) != 0U) {
        state->status |= PMF_UNMODELLED;
    }
}

/* Return 1 if every number that the next sample depends on is one. */
static uint32_t is_sound(const pmf_redge_config_t *config, const pmf_redge_state_t *state)
{
    real_t sum = state->place + state->velocity + state->spread + state->scatter;
    uint32_t i, sound = 1U;
    for (i = 0; i < PMF_EDGE_UNKNOWNS; ++i) {
        sum += state->change[i] + state->place_by[i] + state->velocity_by[i];
        sound &= i >= FIRST + config->parameters || state->covariance[i][i] > PMF_R(0.0) ? 1U : 0U;
    }
    return sum - sum == PMF_R(0.0) ? sound : 0U;
}

/* Return 1 if a parameter is far from the given one. */
static uint32_t has_departed(const pmf_redge_state_t *state)
{
    uint32_t i, far = 0U;
    for (i = 0; i <= COULOMB; ++i) {
        real_t given = state->start.theta[i], now = state->reference[i] * (PMF_R(1.0) + state->change[FIRST + i]);
        far |= absolute(now - given) > DEPARTED * given ? 1U : 0U;
    }
    return far;
}

/* Return 1 if the first edges after given parameters contradict these. */
static uint32_t is_refuted(const pmf_redge_state_t *state)
{
    uint32_t young = state->start.known != 0U && state->edges > CHECKED && state->edges < YOUNG ? 1U : 0U;
    return young != 0U && has_departed(state) != 0U && (is_late(state) != 0U || is_correlated(state) != 0U) ? 1U : 0U;
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
    if (state->running != 0U && (is_sound(config, state) == 0U || is_refuted(state) != 0U)) {
        give_up(state);
    }
    if (input - input == PMF_R(0.0)) {
        state->start.rose |= (input - state->input) * state->start.way > PMF_R(0.0) ? 1U : 0U;
        state->input = input;
    }
    publish(config, state);
    state->status |= invalid | far;
    return state->status;
}
