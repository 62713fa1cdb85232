/* Auxiliary model: a body with viscous and Coulomb friction, driven by the input alone.
 * SPDX-License-Identifier: Apache-2.0
 *
 * The model supplies instruments without the encoder's noise, and the direction and the moving fractions of every
 * interval. Between events the motion is linear. A diagonal Pade approximant of order 3 replaces exp(), because the exp
 * of C libraries differ in their last bits. The relative error is below 1e-9 for damping * dt <= 0.15, and 1e-5 at 1. A
 * constant force allows at most one stop in an interval, so that two phases suffice and every sample takes the same
 * work. */
#include "pmf_internal.h"

#include "pmf_shapes.inl"

/* A spring acts with its force in the middle of the interval. */
static body_t body_of(const pmf_auxiliary_config_t *config, const real_t *parameter, real_t input, real_t middle)
{
    body_t body;
    body.mass = parameter[PMF_MASS];
    body.viscous[0] = parameter[PMF_VISCOUS_FORWARD];
    body.viscous[1] = parameter[PMF_VISCOUS_BACKWARD];
    body.coulomb[0] = parameter[PMF_COULOMB_FORWARD];
    body.coulomb[1] = parameter[PMF_COULOMB_BACKWARD];
    body.force = config->input_gain * input - parameter[PMF_OFFSET] - parameter[PMF_STIFFNESS] * middle;
    return body;
}

/* Return the time to stop, as a fraction of the interval: the root of the approximant by Newton's method, which starts
 * from the root of order 1. */
static real_t stop_time(real_t z, real_t speed, real_t target)
{
    real_t q = speed / (speed - target); /* 1 - exp(-z t) at the stop, with a target of the opposite sign */
    real_t x = PMF_R(2.0) * q / (PMF_R(2.0) - q);
    uint32_t i;
    for (i = 0; i < 3U; ++i) {
        real_t f =
            q * (PMF_R(120.0) + x * (PMF_R(60.0) + x * (PMF_R(12.0) + x))) - x * (PMF_R(120.0) + PMF_R(2.0) * x * x);
        real_t slope = q * (PMF_R(60.0) + x * (PMF_R(24.0) + PMF_R(3.0) * x)) - PMF_R(120.0) - PMF_R(6.0) * x * x;
        x -= f / slope;
    }
    return x / z;
}

/* Move in the direction whose truth holds, for the remaining time or until the stop. */
static void move(const body_t *body, scalar_t dt, truth_t forward, truth_t backward, phase_t *phase)
{
    truth_t moves = forward | backward, stops;
    real_t sign = PMF_IF(backward, PMF_R(-1.0), PMF_R(1.0));
    real_t net = sign * body->force - PMF_IF(backward, body->coulomb[1], body->coulomb[0]);
    real_t speed = sign * phase->velocity, h = phase->left, z, n, phi, end, distance;
    /* A little damping makes the division by z safe. With less, the motion over dt is that of a constant force. */
    real_t rate = PMF_IF(backward, body->viscous[1], body->viscous[0]) / body->mass * dt + PMF_R(1e-9);
    real_t target = net * dt / (body->mass * rate);
    z = rate * h;
    n = PMF_R(120.0) + z * (PMF_R(60.0) + z * (PMF_R(12.0) + z));
    phi = (PMF_R(120.0) + PMF_R(2.0) * z * z) / n; /* (1 - exp(-z)) / z */
    end = speed + (target - speed) * z * phi;
    stops = moves & (speed > PMF_R(0.0)) & (end < PMF_R(0.0));
    if (PMF_ANY(stops)) {
        real_t t = stop_time(rate, speed, target);
        h = PMF_IF(stops & (t < h), t, h);
        z = rate * h;
        n = PMF_R(120.0) + z * (PMF_R(60.0) + z * (PMF_R(12.0) + z));
        end = PMF_IF(stops, PMF_R(0.0), end);
    }
    /* mean of target + (speed - target) exp(-z t) over h: (1 - phi) / z without cancellation */
    distance = sign * h * (speed + (target - speed) * z * (PMF_R(60.0) + z * (PMF_R(10.0) + z)) / n);
    phase->distance[0] = PMF_IF(forward, distance, phase->distance[0]);
    phase->distance[1] = PMF_IF(backward, distance, phase->distance[1]);
    phase->moving[0] = PMF_IF(forward, h, phase->moving[0]);
    phase->moving[1] = PMF_IF(backward, h, phase->moving[1]);
    phase->velocity = PMF_IF(moves, sign * PMF_IF(end > PMF_R(0.0), end, PMF_R(0.0)), phase->velocity);
    phase->left = PMF_IF(moves, phase->left - h, phase->left);
}

static void emit_motion(const phase_t *phase, real_t middle, real_t *signal)
{
    real_t moving = phase->moving[0] + phase->moving[1];
    real_t *own = &signal[PMF_AUXILIARY];
    real_t measured = signal[PMF_LATE_VELOCITY];
    signal[PMF_SPLIT_POSITION] = moving * signal[PMF_LATE_POSITION];
    signal[PMF_MODEL_POSITION] = moving * middle;
    own[PMF_INPUT] = moving * signal[PMF_LATE_INPUT];
    own[PMF_VELOCITY] = phase->distance[0] + phase->distance[1];
    own[PMF_DIRECTION] = phase->moving[0] - phase->moving[1];
    own[PMF_MOVING] = moving;
    own[PMF_FORWARD] = phase->moving[0];
    own[PMF_BACKWARD] = -phase->moving[1];
    own[PMF_FORWARD_VELOCITY] = phase->distance[0];
    own[PMF_BACKWARD_VELOCITY] = phase->distance[1];
    signal[PMF_SPLIT_FORWARD] = PMF_IF(own[PMF_DIRECTION] > PMF_R(0.0), measured, PMF_R(0.0));
    signal[PMF_SPLIT_BACKWARD] = PMF_IF(own[PMF_DIRECTION] > PMF_R(0.0), PMF_R(0.0), measured);
}

static void forget_sensitivity(pmf_auxiliary_state_t *state)
{
    pmf_clear(state->fading.jump, (uint32_t)sizeof state->fading.jump);
}

/* Return the fraction of a velocity deviation that remains after a stop: 0 if friction holds the body. If the body
 * reverses, the fraction is the force after the stop over the force before it, because the instant of the stop depends
 * on the deviation. */
static real_t left_behind_stop(const body_t *body, truth_t forward)
{
    real_t push = PMF_IF(forward, -body->force, body->force);
    real_t behind = push - PMF_IF(forward, body->coulomb[1], body->coulomb[0]);
    real_t before = push + PMF_IF(forward, body->coulomb[0], body->coulomb[1]);
    return PMF_IF((behind > PMF_R(0.0)) & (before > PMF_R(0.0)), behind / before, PMF_R(0.0));
}

/* The velocity deviation w by each parameter follows m w' + d w = -signal, and a stop removes the remaining momentum m
 * w like a blow. The blow is the derivative of the sum of friction and input in the equation. After two filter stages
 * with the delay of the equation's filters, the blow completes regressors and target. */
static void note_sensitivity(const pmf_auxiliary_config_t *config, pmf_auxiliary_state_t *state, const body_t *body,
                             real_t before, real_t after, const real_t *signal)
{
    truth_t forward = before > PMF_R(0.0), was = forward | (before < PMF_R(0.0));
    truth_t stops = was & PMF_NOT(before * after > PMF_R(0.0));
    real_t viscous = PMF_IF(forward, body->viscous[0], body->viscous[1]);
    real_t kept = body->mass / (body->mass + PMF_SPAN(config, state) * viscous), left = PMF_R(1.0), lost;
    uint32_t i;
    real_t ratio = PMF_R(1.0), gain = PMF_ALIKE(config->jump_gain);
    if (PMF_STEPS) {
        ratio = PMF_ALIKE(PMF_SPAN(config, state) / config->dt);
        gain = config->jump_gain * ratio / (PMF_R(1.0) + (ratio - PMF_R(1.0)) * config->jump_gain);
    }
    if (PMF_ANY(stops)) {
        left = PMF_IF(stops, left_behind_stop(body, forward), left);
    }
    lost = (left - PMF_R(1.0)) * config->jump_gain;
    for (i = 0; i < config->sensitivities; ++i) {
        pmf_jump_t *jump = &state->fading.jump[i];
        real_t momentum = kept * (jump->momentum - ratio * signal[config->cause[i]]);
        jump->momentum = left * momentum;
        jump->filtered += gain * (jump->blow - jump->filtered);
        jump->blow += lost * momentum - gain * jump->blow;
    }
}

#if PMF_SHAPED
void pmf_shapes_measured(const pmf_config_t *config, real_t *signal)
{
    const pmf_shapes_config_t *shapes = &config->auxiliary.shapes;
    uint32_t i;
    for (i = 0; i < shapes->n; ++i) {
        const pmf_shape_t *shape = &shapes->shape[i];
        if (shape->measured != 0U) {
            signal[shape->measured] = shape_value(shapes, shape, signal[PMF_LATE_POSITION]) *
                                      signal[shape->resists != 0U ? PMF_DIRECTION : PMF_MOVING];
        }
    }
}
#endif

/* Move for the remaining part of the interval, under a constant force and the forces of the shapes. */
static void advance(const pmf_auxiliary_config_t *config, const pmf_auxiliary_state_t *state, body_t *body,
                    phase_t *phase, real_t *signal)
{
    uint32_t turn;
    const body_t plain = *body;
    phase->distance[0] = phase->distance[1] = phase->moving[0] = phase->moving[1] = PMF_R(0.0);
    for (turn = 0; turn < 2U; ++turn) {
        if (has_shapes(config)) {
            PMF_WHERE(phase->velocity == PMF_R(0.0), body, *body = body_at_rest(config, state, &plain, phase));
        }
        /* from rest the body may break away, or stick */
        truth_t rests = phase->velocity == PMF_R(0.0), left = phase->left > PMF_R(0.0);
        truth_t forward = (rests & (body->force > body->coulomb[0])) | (phase->velocity > PMF_R(0.0));
        truth_t backward = PMF_NOT(forward) & (PMF_NOT(rests) | (-body->force > body->coulomb[1]));
        if (PMF_ANY((forward | backward) & left)) {
            if (has_shapes(config)) {
                move_shaped(config, state, &plain, forward & left, backward & left, phase, signal);
            } else {
                move(body, PMF_SPAN(config, state), forward & left, backward & left, phase);
            }
        }
    }
}

/* Set signals and state after the motion of an interval. */
static void conclude(const pmf_auxiliary_config_t *config, pmf_auxiliary_state_t *state, const body_t *body,
                     phase_t *phase, real_t middle, real_t *signal)
{
    real_t sum;
    truth_t absurd;
    signal[PMF_ACCELERATION] = (phase->velocity - state->velocity) / PMF_SPAN(config, state);
    sum = signal[PMF_ACCELERATION] + phase->distance[0] + phase->distance[1] + middle;
    absurd = PMF_NOT(sum - sum == PMF_R(0.0));
    if (PMF_ANY(absurd)) { /* absurd parameters: the body starts again from rest */
        phase->velocity = PMF_IF(absurd, PMF_R(0.0), phase->velocity);
        phase->distance[0] = PMF_IF(absurd, PMF_R(0.0), phase->distance[0]);
        phase->distance[1] = PMF_IF(absurd, PMF_R(0.0), phase->distance[1]);
        signal[PMF_ACCELERATION] = PMF_IF(absurd, PMF_R(0.0), signal[PMF_ACCELERATION]);
        middle = PMF_IF(absurd, signal[PMF_LATE_POSITION], middle);
        state->position = PMF_IF(absurd, middle, state->position);
        clear_shapes(config, absurd, signal);
    }
    emit_motion(phase, middle, signal);
    if (config->sensitivities != 0U) {
        note_sensitivity(config, state, body, state->velocity, phase->velocity, signal);
        PMF_WHERE(absurd, state, forget_sensitivity(state));
    }
    state->velocity = phase->velocity;
    state->position += PMF_SPAN(config, state) * (phase->distance[0] + phase->distance[1]) +
                       config->position_gain * (signal[PMF_LATE_POSITION] - middle);
}

PMF_API void pmf_auxiliary_step(const pmf_auxiliary_config_t *config, pmf_auxiliary_state_t *state, real_t *signal)
{
    real_t middle = state->position + PMF_R(0.5) * PMF_SPAN(config, state) * state->velocity;
    body_t body = body_of(config, state->parameter, signal[PMF_LATE_INPUT], middle);
    phase_t phase;
    phase.velocity = state->velocity;
    phase.left = PMF_R(1.0);
    clear_shapes(config, PMF_R(0.0) == PMF_R(0.0), signal);
    advance(config, state, &body, &phase, signal);
    conclude(config, state, &body, &phase, middle, signal);
}

#if PMF_LATE
/* The older input acts for a part of the interval, the newer input for the remainder. Both parts are exact. */
void pmf_auxiliary_late_step(const pmf_auxiliary_config_t *config, pmf_auxiliary_state_t *state,
                             const pmf_late_state_t *late, real_t *signal)
{
    real_t middle = state->position + PMF_R(0.5) * PMF_SPAN(config, state) * state->velocity, pushed, moved;
    body_t body = body_of(config, state->parameter, late->older, middle);
    body_t second = body_of(config, state->parameter, late->newer, middle), last;
    phase_t phase, rest;
    phase.velocity = state->velocity;
    phase.left = late->part;
    clear_shapes(config, PMF_R(0.0) == PMF_R(0.0), signal);
    advance(config, state, &body, &phase, signal);
    rest.velocity = phase.velocity;
    rest.left = PMF_R(1.0) - late->part;
    moved = PMF_SPAN(config, state) * (phase.distance[0] + phase.distance[1]);
    state->position += moved; /* the shapes of the second part start here */
    advance(config, state, &second, &rest, signal);
    state->position -= moved;
    pushed = late->older * (phase.moving[0] + phase.moving[1]) + late->newer * (rest.moving[0] + rest.moving[1]);
    rest.distance[0] += phase.distance[0];
    rest.distance[1] += phase.distance[1];
    rest.moving[0] += phase.moving[0];
    rest.moving[1] += phase.moving[1];
    /* after a stop in the first part, the force of that part decides the remaining deviation */
    last = body;
    PMF_WHERE(state->velocity * phase.velocity > PMF_R(0.0), &last, last = second);
    conclude(config, state, &last, &rest, middle, signal);
    signal[PMF_AUXILIARY + PMF_INPUT] = pushed;
}
#endif

PMF_API void pmf_auxiliary_correct(const pmf_auxiliary_config_t *config, const pmf_auxiliary_state_t *state,
                                   uint32_t first, real_t *column)
{
    real_t exact = column[config->check_column + 2U];
    real_t target = state->parameter[PMF_MASS] * (exact - column[config->mass_column]);
    uint32_t i;
    for (i = 0; i < config->sensitivities; ++i) {
        real_t jump = state->fading.jump[i].filtered;
        column[first + i] -= jump;
        target += jump * state->parameter[config->role[i]];
    }
    column[config->target_column] -= target;
}

PMF_API void pmf_auxiliary_start(const pmf_auxiliary_config_t *config, pmf_auxiliary_state_t *state)
{
    uint32_t i;
    for (i = 0; i < PMF_ROLES; ++i) {
        state->parameter[i] = PMF_ALIKE(config->initial[i]);
    }
    forget_sensitivity(state);
    state->running = PMF_W(config->has_initial);
    state->trusted = PMF_W(config->has_initial);
    state->trial = PMF_W(config->trial_samples);
}

/* Restart a model that lost the plant. The restart sets the measured velocity. */
static void try_again(const pmf_auxiliary_config_t *config, pmf_auxiliary_state_t *state, real_t velocity)
{
    state->trusted = PMF_W(0);
    state->trial = PMF_W(config->trial_samples);
    state->velocity = velocity;
    forget_sensitivity(state);
    state->fading.power = PMF_R(0.0);
    state->fading.mismatch = PMF_R(0.0);
}

PMF_API truth_t pmf_auxiliary_check(const pmf_auxiliary_config_t *config, pmf_auxiliary_state_t *state,
                                    const real_t *column, truth_t held)
{
    real_t measured = column[config->check_column], apart = measured - column[config->check_column + 1U];
    real_t limit;
    truth_t running = state->running != 0U, looks, judged, lost;
    if (config->adapt == 0U) {
        return running | PMF_NOT(running); /* a model without a check is accepted */
    }
    if (!PMF_ANY(running)) {
        return running;
    }
    looks = running & PMF_NOT(held);
    state->fading.power =
        PMF_IF(looks, config->memory * state->fading.power + measured * measured, state->fading.power);
    state->fading.mismatch =
        PMF_IF(looks, config->memory * state->fading.mismatch + apart * apart, state->fading.mismatch);
    limit = config->mismatch_limit * state->fading.power + config->noise_power;
    judged = looks & (state->trial == 0U);
    state->trial -= PMF_BIT(looks & PMF_NOT(judged), 1U);
    lost = judged & (state->fading.mismatch > limit);
    state->trusted = PMF_IF(judged, PMF_W(1), state->trusted);
    PMF_WHERE(lost, state, try_again(config, state, measured));
    return running & (state->trusted != 0U);
}

PMF_API void pmf_auxiliary_follow(const pmf_auxiliary_config_t *config, pmf_auxiliary_state_t *state, truth_t where,
                                  const real_t *theta, const uint32_t *index)
{
    real_t smoothing = PMF_IF(state->running != 0U, config->smoothing, PMF_R(1.0));
    uint32_t i;
    where = where & (theta[index[PMF_MASS]] > PMF_R(0.0));
    if (config->adapt == 0U || !PMF_ANY(where)) {
        return;
    }
    state->turn += PMF_BIT(where, 1U);
    where = where & ((state->running == 0U) | ((state->turn & (PMF_FOLLOWED - 1U)) == 0U));
    if (!PMF_ANY(where)) {
        return;
    }
    for (i = 0; i < roles_of(config); ++i) {
        real_t target = index[i] == PMF_NO_PARAMETER ? PMF_R(0.0) : theta[index[i]], moved;
        if (i < PMF_OFFSET || is_positive(config, i)) {
            target = PMF_IF(target < PMF_R(0.0), PMF_R(0.0), target);
        }
        moved = state->parameter[i] + smoothing * (target - state->parameter[i]);
        state->parameter[i] = PMF_IF(where, moved, state->parameter[i]);
    }
    state->running = PMF_IF(where, PMF_W(1), state->running);
}
