/* Windows of the recursion: a reference, what its end keeps, and its beginning. Only pmf_redge.c includes this file.
 * SPDX-License-Identifier: Apache-2.0 */

static const uint32_t FIRST_WINDOW = 24U; /* edges in the first window */
static const uint32_t SHORTEST_WINDOW = 12U;
static const uint32_t LAST_WINDOW = 0x40000000U;
static const real_t PRIOR = PMF_R(0.09); /* variance of a parameter relative to its square, from the direct start */
static const real_t UNSEEN = PMF_R(10.0); /* of friction that a start does not see: variance relative to its square */
static const real_t LEAST_FRICTION = PMF_R(0.02); /* least Coulomb friction of a reference, relative to the input */
static const real_t ANYWHERE = PMF_R(0.1); /* variance of the place at the start of a window [counts^2] */
static const real_t FIRST_SPREAD = PMF_R(0.01); /* variance of the lines before it is known [counts^2] */
static const real_t FIRST_EVIDENCE = PMF_R(2.0); /* lines that this variance counts for */
static const real_t SECOND = PMF_R(3.0); /* error of the second order, relative to the product of two changes */
static const real_t LIKELY = PMF_R(2.0); /* standard deviations by which a parameter may change in a window */
static const real_t FARTHEST = PMF_R(4.0); /* move of the offset at the end of a window, over the constant forces */
static const real_t FRICTION =
    PMF_R(0.3); /* part of the relative change of Coulomb friction that makes an error of second order */
static const real_t LATE = PMF_R(5e-5); /* instants come late by about this time [s]; it is no alarm */
static const uint32_t AGAIN = 400U; /* edges after an alarm in which another one means a wrong model */
static const uint32_t MOST_UNREST = 3200U; /* eight times AGAIN */

static real_t smaller(real_t a, real_t b)
{
    return a < b ? a : b;
}

static real_t larger(real_t a, real_t b)
{
    return a > b ? a : b;
}

/* Move the number of the present count's line. */
static void turn_lines(const pmf_redge_config_t *config, pmf_redge_state_t *state, integer_t change)
{
    integer_t lines = (integer_t)config->lines, number;
    if (lines != 0) {
        number = ((integer_t)state->line_number + change) % lines;
        state->line_number = (uint32_t)(number < 0 ? number + lines : number);
    }
}

static real_t predict(const real_t *by, const real_t *change)
{
    real_t sum = PMF_R(0.0);
    uint32_t i;
    for (i = 0; i < PMF_EDGE_UNKNOWNS; ++i) {
        sum += by[i] * change[i];
    }
    return sum;
}

/* Return the variance of a prediction by the followed unknowns. */
static real_t variance_along(const pmf_redge_state_t *state, const real_t *by)
{
    real_t sum = PMF_R(0.0);
    uint32_t i;
    for (i = 0; i < PMF_EDGE_UNKNOWNS; ++i) {
        sum += by[i] * predict(state->covariance[i], by);
    }
    return sum;
}

static void forget_start(pmf_start_t *start)
{
    pmf_clear(start, (uint32_t)sizeof *start);
}

static void forget_lines(const pmf_redge_config_t *config, pmf_line_t *lines)
{
    uint32_t i, j;
    for (i = 0; i < config->lines; ++i) {
        lines[i].sum = PMF_R(0.0);
        for (j = 0; j < PMF_EDGE_UNKNOWNS; ++j) {
            lines[i].by[j] = PMF_R(0.0);
        }
    }
}

/* Let the motion begin again at its present place and velocity, with derivatives by these. */
static void begin_window(pmf_redge_state_t *state)
{
    uint32_t i;
    for (i = 0; i < PMF_EDGE_UNKNOWNS; ++i) {
        state->change[i] = PMF_R(0.0);
        state->opened[i] = state->covariance[i][i];
        state->stops_by[i] = PMF_R(0.0);
        state->place_by[i] = i == PLACE ? PMF_R(1.0) : PMF_R(0.0);
        state->velocity_by[i] = i == SPEED ? PMF_R(1.0) : PMF_R(0.0);
    }
    state->in_window = 0U;
    state->window_time = PMF_R(0.0);
}

/* Note an alarm, or a loss of the motion. */
static void note_unrest(pmf_redge_state_t *state)
{
    state->unrest = state->unrest < MOST_UNREST ? state->unrest + AGAIN : MOST_UNREST;
}

/* Return to the direct start; the parameters stay, without a standard deviation. */
static void give_up(pmf_redge_state_t *state)
{
    uint32_t i;
    state->running = 0U;
    for (i = 0; i < PMF_BODY; ++i) {
        state->variance[i] = PMF_UNKNOWN;
    }
    forget_start(&state->start);
    state->edges = 0U;
    note_unrest(state);
}

static void open_prior(const pmf_redge_config_t *config, pmf_redge_state_t *state, real_t velocity)
{
    uint32_t i, j;
    for (i = 0; i < PMF_EDGE_UNKNOWNS; ++i) {
        for (j = 0; j < PMF_EDGE_UNKNOWNS; ++j) {
            state->covariance[i][j] = PMF_R(0.0);
        }
        state->covariance[i][i] = state->opened[i] = i < FIRST + config->parameters ? PRIOR : PMF_R(0.0);
    }
    state->covariance[PLACE][PLACE] = ANYWHERE;
    state->covariance[LATENESS][LATENESS] = LATE * LATE;
    state->covariance[SPEED][SPEED] = PRIOR * velocity * velocity + PMF_R(1e-6);
    state->surprise = state->scatter = state->heard = PMF_R(1.0);
    state->colour = state->correlation = state->trend = state->last = state->size = PMF_R(0.0);
    state->last_variance = PMF_R(1.0);
    state->turned = state->turned_known = state->heading = PMF_R(0.0);
    state->calm = state->lost = state->astray = state->against = state->away = 0U;
    state->drift = PMF_R(0.0);
}

/* Open the prior of friction that the direct start does not see: its reference is larger than the value found. */
static void open_unseen(pmf_redge_state_t *state)
{
    uint32_t i;
    for (i = VISCOUS; i <= COULOMB; ++i) {
        if (state->reference[i] > state->start.theta[i]) {
            state->covariance[FIRST + i][FIRST + i] = state->opened[FIRST + i] = UNSEEN;
        }
    }
}

/* Begin at the direct start. The last edge was `travel` counts after the one before. */
static void begin(const pmf_redge_config_t *config, pmf_redge_state_t *state, pmf_line_t *lines, real_t place,
                  real_t travel)
{
    const real_t *theta = state->start.theta;
    real_t slow = PMF_R(4e-4) * theta[MASS] / config->dt, fast = PMF_R(50.0) * theta[MASS] / config->dt;
    real_t drift = state->drift, scatter = state->scatter, heard = state->heard;
    state->reference[MASS] = theta[MASS];
    state->reference[VISCOUS] = smaller(larger(theta[VISCOUS], slow), fast);
    state->reference[COULOMB] = larger(theta[COULOMB], LEAST_FRICTION * absolute(config->input_gain * state->input));
#if PMF_BODY > 3
    state->reference[OFFSET] = theta[OFFSET];
#endif
    state->place = place;
    state->velocity = travel / state->since;
    state->place_rest = state->velocity_rest = PMF_R(0.0);
    forget_lines(config, lines);
    begin_window(state);
    open_prior(config, state, state->velocity);
    open_unseen(state);
    state->drift = state->unrest > AGAIN ? drift : PMF_R(0.0);
    if (state->start.known != 0U && state->spread > PMF_R(0.0)) { /* the encoder is still the same */
        state->scatter = scatter;
        state->heard = heard;
    } else {
        state->late = PMF_R(0.0);
        state->spread = FIRST_SPREAD;
        state->evidence = FIRST_EVIDENCE;
    }
    state->window = state->edges > FIRST_WINDOW ? state->edges : FIRST_WINDOW;
    state->least = SHORTEST_WINDOW;
    state->running = 1U;
    state->edges = 0U;
}

/* Return the largest relative change of a parameter in this window, which makes errors of second order. */
static real_t bend_of(const pmf_redge_state_t *state)
{
    real_t most = larger(absolute(state->change[FIRST + MASS]), absolute(state->change[FIRST + VISCOUS]));
    return larger(most, FRICTION * absolute(state->change[FIRST + COULOMB]));
}

/* Return the factor by which variances at the start of this window were too small for what the parameters changed
 * since, at least 1. */
static real_t contradiction_of(const pmf_redge_config_t *config, const pmf_redge_state_t *state)
{
    real_t most = PMF_R(1.0);
    uint32_t i;
    for (i = FIRST; i < FIRST + config->parameters; ++i) {
        real_t gained = larger(state->opened[i] - state->covariance[i][i], PMF_R(0.1) * state->opened[i]);
        most = larger(most, state->change[i] * state->change[i] / (LIKELY * LIKELY * gained));
    }
    return most;
}

/* Add the errors of second order to the variances of the parameters. A scaled covariance would not contain them in the
 * combination of parameters that is known best. */
static void admit_bend(pmf_redge_state_t *state)
{
    real_t bend = SECOND * bend_of(state);
    uint32_t i;
    for (i = FIRST; i < PMF_EDGE_UNKNOWNS; ++i) {
        real_t error = bend * state->change[i];
        state->covariance[i][i] += error * error;
    }
}

/* Move the reference to the estimate within limits; `ratio` is old over new. */
static void move_reference(pmf_redge_state_t *state, real_t *ratio)
{
    static const scalar_t least[3] = {PMF_SCALAR(0.5), PMF_SCALAR(0.1), PMF_SCALAR(0.1)};
    static const scalar_t most[3] = {PMF_SCALAR(2.0), PMF_SCALAR(5.0), PMF_SCALAR(5.0)};
#if PMF_BODY > 3
    real_t unit = unit_of(state->reference, OFFSET);
#endif
    uint32_t i;
    state->place_by[LATENESS] = PMF_R(0.0); /* it moves the instants and not the axis */
    state->place += predict(state->place_by, state->change);
    state->velocity += predict(state->velocity_by, state->change);
    ratio[0] = PMF_R(1.0);
    for (i = 0; i < 3U; ++i) {
        real_t factor = PMF_R(1.0) + state->change[FIRST + i];
        factor = smaller(larger(factor, least[i]), most[i]);
        ratio[FIRST - LATENESS + i] = PMF_R(1.0) / factor;
        state->reference[i] *= factor;
    }
#if PMF_BODY > 3
    state->reference[OFFSET] += unit * smaller(larger(state->change[FIRST + OFFSET], -FARTHEST), FARTHEST);
    ratio[FIRST - LATENESS + OFFSET] = unit / unit_of(state->reference, OFFSET);
#endif
}

/* End the window: its information on the parameters stays, and the reference moves to the estimate. */
static void end_window(const pmf_redge_config_t *config, pmf_redge_state_t *state, pmf_line_t *lines)
{
    real_t doubt = contradiction_of(config, state), with_velocity[PMF_EDGE_UNKNOWNS], ratio[CARRIED], own;
    uint32_t i, j;
    admit_bend(state);
    for (i = 0; i < PMF_EDGE_UNKNOWNS; ++i) {
        with_velocity[i] = predict(state->covariance[i], state->velocity_by);
    }
    own = predict(with_velocity, state->velocity_by);
    if (predict(state->velocity_by, state->velocity_by) == PMF_R(0.0)) {
        state->velocity = state->velocity_rest = PMF_R(0.0);
    }
    move_reference(state, ratio);
    forget_lines(config, lines);
    for (i = 0; i < CARRIED; ++i) {
        real_t *row = &state->covariance[LATENESS + i][LATENESS];
        for (j = 0; j < CARRIED; ++j) {
            row[j] *= ratio[i] * ratio[j] * doubt;
        }
        with_velocity[LATENESS + i] *= ratio[i] * doubt;
        state->covariance[SPEED][LATENESS + i] = state->covariance[LATENESS + i][SPEED] = with_velocity[LATENESS + i];
        state->covariance[PLACE][LATENESS + i] = state->covariance[LATENESS + i][PLACE] = PMF_R(0.0);
    }
    state->late -= state->change[LATENESS];
    state->covariance[PLACE][SPEED] = state->covariance[SPEED][PLACE] = PMF_R(0.0);
    state->covariance[PLACE][PLACE] = ANYWHERE;
    state->covariance[SPEED][SPEED] = own * doubt + PMF_R(1e-12);
    begin_window(state);
}
