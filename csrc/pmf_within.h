/* A motion that is held within the counts, recursively, which tells how late the input acts (for pmf_auxiliary.c).
 * SPDX-License-Identifier: Apache-2.0
 *
 * Under control through a coarse encoder the input follows the encoder's error, and instruments made of it are none.
 * What does not mind is the likelihood of the counts: a body moved by the input alone lies between two edges at every
 * sample. Its place and velocity and all parameters have a normal distribution, which the model carries from sample to
 * sample and each count cuts off at its nearest edge; of what is left mean and covariance are kept (assumed density
 * filtering). Far from an edge a count says nothing, near one more than any variance of a twelfth, so that the bars
 * shrink with the number of edges and not with its root.
 *
 * That believes the model. How far the place was beyond an edge is compared with its own deviation, and where that is
 * too often too much, it begins again.
 */
#ifndef PMF_WITHIN_H
#define PMF_WITHIN_H

#include "pmf_shapes.h"

#if PMF_FOUND

#define PLACE 0U
#define SPEED 1U
#define FIRST 2U /* parameter */
#define MOST_KNOWN (PMF_MAX_PARAMETERS + 2)

#define WIDE PMF_R(0.1) /* variance of the place from which on a count is a reading of its middle */
#define TWELFTH (PMF_R(1.0) / PMF_R(12.0))
#define BLUR PMF_R(0.05) /* standard deviation of an edge: what the model misses otherwise */
#define FIRST_BLUR PMF_R(0.5) /* what it was linearised too far from */
#define BLUR_AGE PMF_R(5.0) /* goes like this over its age */
#define GROWING PMF_R(100.0) /* samples; those gathered while it was linearised further away count the less */
#define EDGE_MEMORY PMF_R(0.998)
#define SURPRISED PMF_R(1.3) /* as many times as large as expected is another motion */
#define NEAR PMF_R(3.0) /* deviations from an edge */
#define FAR PMF_R(5.0) /* from there on a count says nothing */
#define STRAYED \
    PMF_R(6.0) /* square of deviations by which a dead time moves away from what it was: too sure of that, */
#define WIDENED PMF_R(4.0) /* which counts a quarter */
#define SLACK PMF_R(0.1)
#define WHILE PMF_R(0.25) /* a while is as long as it takes for a variance to come down to this part */
#define STAYED PMF_R(0.25) /* [samples] */
#define YOUNG 10U
#define ENOUGH_AGE 100U /* before it is believed, and this near an edge: */
#define ENOUGH_NEAR 100U
#define SHARP PMF_R(0.1) /* standard deviation [samples] of a dead time that is known */
#define LEAST_KEPT PMF_R(0.3) /* of mass and viscous friction in one sample */

/* Where a sample leads, and its derivatives by place, velocity and theta before it. */
typedef struct {
    real_t velocity, distance; /* distance in counts */
    real_t place_by[MOST_KNOWN], velocity_by[MOST_KNOWN];
} motion_t;

/* Density over distribution of a standard normal variable, from -6 in steps of a quarter. */
static const scalar_t mills[45] = {
    PMF_SCALAR(6.1584826),      PMF_SCALAR(5.91470462),     PMF_SCALAR(5.67141031),     PMF_SCALAR(5.42865539),
    PMF_SCALAR(5.18650397),     PMF_SCALAR(4.94503014),     PMF_SCALAR(4.70431984),     PMF_SCALAR(4.46447317),
    PMF_SCALAR(4.22560714),     PMF_SCALAR(3.98785918),     PMF_SCALAR(3.75139126),     PMF_SCALAR(3.51639514),
    PMF_SCALAR(3.28309865),     PMF_SCALAR(3.05177351),     PMF_SCALAR(2.8227448),      PMF_SCALAR(2.59640254),
    PMF_SCALAR(2.37321553),     PMF_SCALAR(2.15374775),     PMF_SCALAR(1.93867717),     PMF_SCALAR(1.72881663),
    PMF_SCALAR(1.52513528),     PMF_SCALAR(1.32877797),     PMF_SCALAR(1.14107777),     PMF_SCALAR(0.963553979),
    PMF_SCALAR(0.797884561),    PMF_SCALAR(0.645839371),    PMF_SCALAR(0.509160434),    PMF_SCALAR(0.389382057),
    PMF_SCALAR(0.287599971),    PMF_SCALAR(0.204225459),    PMF_SCALAR(0.13878975),     PMF_SCALAR(0.0898777455),
    PMF_SCALAR(0.0552478627),   PMF_SCALAR(0.0321324541),   PMF_SCALAR(0.0176378255),   PMF_SCALAR(0.00912074015),
    PMF_SCALAR(0.00443783904),  PMF_SCALAR(0.00203021954),  PMF_SCALAR(0.000872885754), PMF_SCALAR(0.000352626861),
    PMF_SCALAR(0.000133834464), PMF_SCALAR(4.77191466e-05), PMF_SCALAR(1.59837954e-05), PMF_SCALAR(5.0295124e-06),
    PMF_SCALAR(1.48671994e-06),
};

/* At t < 5. Cubic between the knots, with the slope that the ratio itself has: -r (r + t). */
static real_t mills_ratio(real_t t)
{
    real_t at = (t + PMF_R(6.0)) * PMF_R(4.0), knot, low, high, fall, falls;
    uint32_t i;
    if (!(t > PMF_R(-6.0))) {
        real_t far = PMF_R(-1.0) / t;
        return -t + far * (PMF_R(1.0) - PMF_R(2.0) * far * far);
    }
    i = at < PMF_R(43.0) ? (uint32_t)at : 43U;
    at -= (real_t)i;
    knot = PMF_R(-6.0) + PMF_R(0.25) * (real_t)i;
    low = mills[i];
    high = mills[i + 1U];
    fall = PMF_R(-0.25) * low * (low + knot);
    falls = PMF_R(-0.25) * high * (high + knot + PMF_R(0.25));
    return low + at * (fall + at * (PMF_R(3.0) * (high - low) - PMF_R(2.0) * fall - falls +
                                    at * (PMF_R(2.0) * (low - high) + fall + falls)));
}

/* Of a variance from that of an edge to that of a place that is not wide, by Newton. */
static real_t deviation_of(real_t variance)
{
    real_t root = PMF_R(0.5) * (variance / PMF_R(0.13) + PMF_R(0.13));
    uint32_t i;
    for (i = 0; i < 5U; ++i) {
        root = PMF_R(0.5) * (root + variance / root);
    }
    return root;
}

static uint32_t parameters_of(const pmf_config_t *config)
{
    return config->instrument.n_parameters;
}

static void roles_of(const pmf_config_t *config, const real_t *theta, real_t role[PMF_ROLES])
{
    uint32_t i;
    for (i = 0; i < PMF_ROLES; ++i) {
        uint32_t index = config->auxiliary.index[i];
        role[i] = index == PMF_NO_PARAMETER ? PMF_R(0.0) : theta[index];
    }
}

/* Acceleration of a body at a velocity, where it rests of one that breaks away. */
static real_t acceleration_of(const body_t *body, real_t velocity)
{
    uint32_t way = velocity < PMF_R(0.0) ? 1U : 0U;
    real_t sign = way != 0U ? PMF_R(-1.0) : PMF_R(1.0), net;
    if (velocity == PMF_R(0.0)) {
        way = body->force < PMF_R(0.0) ? 1U : 0U;
        sign = way != 0U ? PMF_R(-1.0) : PMF_R(1.0);
        net = sign * body->force - body->coulomb[way];
        return net > PMF_R(0.0) ? sign * net / body->mass : PMF_R(0.0);
    }
    return (body->force - sign * body->coulomb[way] - body->viscous[way] * velocity) / body->mass;
}

/* The sum of forces that each parameter multiplies, over the interval. */
static void note_causes(const pmf_config_t *config, const phase_t *whole, real_t change, real_t *by)
{
    const uint32_t *index = config->auxiliary.index;
    const real_t cause[6] = {
        change,           whole->distance[0], whole->distance[1],
        whole->moving[0], -whole->moving[1],  whole->moving[0] + whole->moving[1],
    };
    uint32_t i;
    for (i = 0; i <= (uint32_t)PMF_OFFSET; ++i) {
        if (index[i] != PMF_NO_PARAMETER) {
            by[FIRST + index[i]] += cause[i];
        }
    }
}

static void add_phase(phase_t *whole, const phase_t *part)
{
    whole->distance[0] += part->distance[0];
    whole->distance[1] += part->distance[1];
    whole->moving[0] += part->moving[0];
    whole->moving[1] += part->moving[1];
}

/* Derivatives of an interval that ran through `whole` from one velocity by way of that at the switch to the last one.
 */
static void differentiate(const pmf_config_t *config, const body_t *first, const body_t *second, const phase_t *whole,
                          const real_t velocity[3], real_t part, motion_t *motion)
{
    scalar_t dt = config->auxiliary.dt;
    uint32_t p = parameters_of(config), late = FIRST + config->auxiliary.index[PMF_DELAY], i;
    real_t z = second->viscous[velocity[2] < PMF_R(0.0) ? 1U : 0U] / second->mass * dt, moved, mean, keeps, left,
           switched;
    real_t divisor = PMF_R(12.0) + z * (PMF_R(6.0) + z), rest = PMF_R(1.0) - part;
    uint32_t was = velocity[0] != PMF_R(0.0), stops = was != 0U && !(velocity[0] * velocity[2] > PMF_R(0.0)), early;
    early = stops != 0U && !(velocity[0] * velocity[1] > PMF_R(0.0));
    mean = PMF_R(12.0) / divisor;
    keeps = (PMF_R(12.0) - z * (PMF_R(6.0) - z)) / divisor;
    left = stops == 0U ? PMF_R(1.0) : left_behind_stop(early != 0U ? first : second, velocity[0] > PMF_R(0.0));
    for (i = 0; i < FIRST + p; ++i) {
        motion->place_by[i] = motion->velocity_by[i] = PMF_R(0.0);
    }
    note_causes(config, whole, (velocity[2] - velocity[0]) / dt, motion->velocity_by);
    for (i = FIRST; i < FIRST + p; ++i) {
        real_t by = -dt * mean / second->mass * motion->velocity_by[i];
        motion->place_by[i] = PMF_R(0.5) * config->late.counts * dt * by;
        motion->velocity_by[i] = left * by;
    }
    switched = acceleration_of(first, velocity[1]);
    switched = velocity[1] == PMF_R(0.0) ? PMF_R(0.0) : switched;
    switched -= acceleration_of(second, velocity[1]);
    motion->place_by[late] = config->late.counts * dt * rest * switched;
    motion->velocity_by[late] = (early != 0U ? PMF_R(1.0) : left) * switched;
    moved = whole->moving[0] + whole->moving[1];
    motion->place_by[PLACE] = PMF_R(1.0);
    motion->place_by[SPEED] = was != 0U ? config->late.counts * dt * moved * mean : PMF_R(0.0);
    motion->velocity_by[SPEED] = was != 0U ? left * keeps : PMF_R(0.0);
}

static void follow_motion(const pmf_config_t *config, pmf_state_t *state, const acts_t *acts, motion_t *motion)
{
    const pmf_auxiliary_config_t *model = &config->auxiliary;
    real_t role[PMF_ROLES], velocity[3];
    body_t first, second;
    phase_t phase, rest;
    roles_of(config, state->found.theta, role);
    first = body_of(model, role, acts->older, PMF_R(0.0));
    second = body_of(model, role, acts->newer, PMF_R(0.0));
    velocity[0] = phase.velocity = state->found.velocity;
    phase.left = acts->part;
    advance(model, &state->auxiliary, &first, &phase, state->network.node);
    velocity[1] = rest.velocity = phase.velocity;
    rest.left = PMF_R(1.0) - acts->part;
    advance(model, &state->auxiliary, &second, &rest, state->network.node);
    velocity[2] = rest.velocity;
    add_phase(&rest, &phase);
    motion->velocity = velocity[2];
    motion->distance = config->late.counts * model->dt * (rest.distance[0] + rest.distance[1]);
    differentiate(config, &first, &second, &rest, velocity, acts->part, motion);
}

/* Covariance after the motion: only place and velocity move. */
static void carry(pmf_found_state_t *found, const motion_t *motion, uint32_t n)
{
    real_t place[MOST_KNOWN], velocity[MOST_KNOWN];
    real_t own = PMF_R(0.0), both = PMF_R(0.0), speed = PMF_R(0.0);
    uint32_t i, j;
    for (i = 0; i < n; ++i) {
        place[i] = velocity[i] = PMF_R(0.0);
        for (j = 0; j < n; ++j) {
            place[i] += motion->place_by[j] * found->covariance[j][i];
            velocity[i] += motion->velocity_by[j] * found->covariance[j][i];
        }
    }
    for (i = 0; i < n; ++i) {
        own += place[i] * motion->place_by[i];
        both += place[i] * motion->velocity_by[i];
        speed += velocity[i] * motion->velocity_by[i];
    }
    for (i = FIRST; i < n; ++i) {
        found->covariance[PLACE][i] = found->covariance[i][PLACE] = place[i];
        found->covariance[SPEED][i] = found->covariance[i][SPEED] = velocity[i];
    }
    found->covariance[PLACE][PLACE] = own;
    found->covariance[PLACE][SPEED] = found->covariance[SPEED][PLACE] = both;
    found->covariance[SPEED][SPEED] = speed;
}

/* Moves everything with one of the numbers that is known better now: by so much, and with this part of its variance
 * gone. */
static void learn(pmf_found_state_t *found, uint32_t n, uint32_t which, real_t moved, real_t gone)
{
    real_t gain[MOST_KNOWN], own = found->covariance[which][which];
    uint32_t i, j;
    for (i = 0; i < n; ++i) {
        gain[i] = found->covariance[i][which] / own;
    }
    found->place += gain[PLACE] * moved;
    found->velocity += gain[SPEED] * moved;
    for (i = FIRST; i < n; ++i) {
        found->theta[i - FIRST] += gain[i] * moved;
    }
    for (i = 0; i < n; ++i) {
        for (j = 0; j <= i; ++j) {
            found->covariance[i][j] -= gain[i] * gain[j] * own * gone;
            found->covariance[j][i] = found->covariance[i][j];
        }
    }
}

/* How often it is beyond an edge, and how far, against what is to be expected. */
static void note_edge(pmf_found_state_t *found, real_t t, real_t ratio)
{
    real_t square = t * t;
    if (t < NEAR && t > -NEAR) {
        real_t other = mills_ratio(-t), beyond = ratio / (ratio + other);
        found->surprise *= EDGE_MEMORY;
        found->expected = EDGE_MEMORY * found->expected + square * beyond;
        found->near += found->near < PMF_OLDEST ? 1U : 0U;
    }
    found->surprise += t < PMF_R(0.0) ? square : PMF_R(0.0);
}

/* What a count says of the place: between two edges, the nearer of which counts. */
static void cut_off(pmf_found_state_t *found, uint32_t n)
{
    real_t variance = found->covariance[PLACE][PLACE], up = PMF_R(1.0) - found->place, blur, all, root, t, ratio;
    uint32_t above = up < found->place;
    if (variance > WIDE) {
        real_t gone = variance / (variance + TWELFTH);
        learn(found, n, PLACE, (PMF_R(0.5) - found->place) * gone, gone);
        return;
    }
    blur = BLUR_AGE / (real_t)(found->age + 1U);
    blur = blur < FIRST_BLUR ? blur : FIRST_BLUR;
    blur = blur > BLUR ? blur : BLUR;
    all = variance + blur * blur;
    root = deviation_of(all);
    t = (above != 0U ? up : found->place) / root;
    if (t < FAR) {
        ratio = mills_ratio(t);
        note_edge(found, t, ratio);
        t = ratio * (ratio + t) * variance / all;
        ratio *= variance / root;
        learn(found, n, PLACE, above != 0U ? -ratio : ratio, t);
    }
}

/* Masses and frictions are not negative, a dead time within what the kernel can delay. */
static void keep_possible(const pmf_config_t *config, pmf_found_state_t *found, const real_t *before)
{
    const uint32_t *index = config->auxiliary.index;
    uint32_t i, late = index[PMF_DELAY];
    real_t most = (real_t)config->late.room / config->late.rate, apart;
    for (i = 0; i < (uint32_t)PMF_OFFSET; ++i) {
        if (index[i] != PMF_NO_PARAMETER) {
            real_t least = i < (uint32_t)PMF_COULOMB_FORWARD ? LEAST_KEPT * before[index[i]] : PMF_R(0.0);
            real_t *own = &found->theta[index[i]];
            *own = *own > least ? *own : least;
        }
    }
    apart = found->theta[late] < PMF_R(0.0) ? -found->theta[late] : PMF_R(0.0);
    apart = found->theta[late] > most ? most - found->theta[late] : apart;
    if (apart != PMF_R(0.0)) {
        learn(found, FIRST + parameters_of(config), FIRST + late, apart, PMF_R(0.0));
        found->theta[late] = apart > PMF_R(0.0) ? PMF_R(0.0) : most;
    }
}

/* What is not known of a parameter at first, as a standard deviation. */
static real_t unknown_of(const pmf_config_t *config, const pmf_found_state_t *found, const real_t *role, uint32_t which)
{
    real_t friction = PMF_R(0.1) * (role[PMF_COULOMB_FORWARD] + role[PMF_COULOMB_BACKWARD]);
    switch (which) {
    case PMF_MASS: return PMF_R(0.1) * role[which];
    case PMF_VISCOUS_FORWARD:
    case PMF_VISCOUS_BACKWARD:
        return PMF_R(0.1) * role[which] +
               (found->speed > PMF_R(0.0) ? PMF_R(0.02) * found->push / found->speed : PMF_R(0.0));
    case PMF_DELAY: return PMF_R(0.5) * (real_t)(1U + found->tries) / config->late.rate;
    default: return friction + PMF_R(0.01) * found->push;
    }
}

/* The place anywhere in its count, at the measured velocity. */
static void anchor(const pmf_config_t *config, pmf_state_t *state)
{
    pmf_found_state_t *found = &state->found;
    real_t step = PMF_R(1.0) / (config->late.counts * config->auxiliary.dt), measured, apart;
    uint32_t i;
    measured = state->network.node[PMF_LATE_VELOCITY];
    apart = measured - found->velocity;
    found->velocity = apart * apart < step * step ? found->velocity : measured;
    found->place = PMF_R(0.5);
    for (i = 0; i < FIRST + parameters_of(config); ++i) {
        found->covariance[PLACE][i] = found->covariance[i][PLACE] = PMF_R(0.0);
        found->covariance[SPEED][i] = found->covariance[i][SPEED] = PMF_R(0.0);
    }
    found->covariance[PLACE][PLACE] = TWELFTH;
    found->covariance[SPEED][SPEED] = PMF_R(0.25) * step * step;
}

/* Anew from parameters by roles. */
static void begin_at(const pmf_config_t *config, pmf_state_t *state, const real_t *role, uint32_t looks)
{
    pmf_found_state_t *found = &state->found;
    const uint32_t *index = config->auxiliary.index;
    uint32_t i;
    pmf_clear(found->covariance, (uint32_t)sizeof found->covariance);
    for (i = 0; i < (uint32_t)PMF_BODY_ROLES; ++i) {
        if (index[i] != PMF_NO_PARAMETER) {
            real_t unknown = unknown_of(config, found, role, i);
            found->theta[index[i]] = role[i];
            found->covariance[FIRST + index[i]][FIRST + index[i]] = unknown * unknown;
        }
    }
    anchor(config, state);
    found->begun = found->before = role[PMF_DELAY];
    found->unsure = found->covariance[FIRST + index[PMF_DELAY]][FIRST + index[PMF_DELAY]];
    found->surprise = PMF_R(0.0);
    found->expected = PMF_R(1.0);
    found->age = found->near = 0U;
    found->looks = looks;
    found->running = role[PMF_MASS] > PMF_R(0.0) ? 1U : 0U;
}

/* From what is believed. Before anything is, that is at the dead time of an estimate that hardly knows it: another one
 * is tried with every beginning. */
static void begin(const pmf_config_t *config, pmf_state_t *state)
{
    const uint32_t *from = config->auxiliary.direct_index;
    real_t role[PMF_ROLES];
    uint32_t i;
    from = state->auxiliary.in_charge != 0U ? config->auxiliary.index : from;
    for (i = 0; i < (uint32_t)PMF_BODY_ROLES; ++i) {
        role[i] = from[i] == PMF_NO_PARAMETER ? PMF_R(0.0) : state->found.believed.theta[from[i]];
        role[i] = role[i] > PMF_R(0.0) || i == (uint32_t)PMF_OFFSET ? role[i] : PMF_R(0.0);
    }
    begin_at(config, state, role, 0U);
}

/* What led it here was linearised further away, and would stay: once more, from what it has found, until that stays
 * where it is. Till then it is good enough for the auxiliary model. */
static void look_again(const pmf_config_t *config, pmf_state_t *state)
{
    pmf_found_state_t *found = &state->found;
    real_t role[PMF_ROLES], apart;
    roles_of(config, found->theta, role);
    apart = (role[PMF_DELAY] - found->begun) * config->late.rate;
    found->tries = 0U;
    found->dead_time = role[PMF_DELAY];
    if (found->looks != 0U && apart * apart < STAYED * STAYED) {
        found->looks = PMF_LOOKS;
    } else {
        found->believes = PMF_BELIEVES_HELD;
        begin_at(config, state, role, 1U);
    }
}

/* A dead time that moves as its own variance does not allow was linearised too far away: what was learned counts less.
 */
static void doubt(const pmf_config_t *config, pmf_found_state_t *found)
{
    uint32_t late = config->auxiliary.index[PMF_DELAY], i, j, n = FIRST + parameters_of(config);
    real_t now = found->theta[late], apart = now - found->before,
           variance = found->covariance[FIRST + late][FIRST + late];
    real_t learned = found->unsure - variance;
    uint32_t strayed;
    learned = (learned > PMF_R(0.0) ? learned : PMF_R(0.0)) + SLACK * found->unsure;
    strayed = apart * apart > STRAYED * learned ? 1U : 0U;
    for (i = 0; i < n && strayed != 0U; ++i) {
        for (j = 0; j < n; ++j) {
            found->covariance[i][j] *= WIDENED;
        }
    }
    if (strayed != 0U || variance < WHILE * found->unsure) {
        found->before = now;
        found->unsure = found->covariance[FIRST + late][FIRST + late];
    }
}

static uint32_t is_lost(const pmf_found_state_t *found, uint32_t n)
{
    real_t sum = found->place + found->velocity;
    uint32_t i, lost = found->age > YOUNG && found->surprise > SURPRISED * found->expected ? 1U : 0U;
    for (i = 0; i < n; ++i) {
        sum += found->covariance[i][i];
        lost |= found->covariance[i][i] >= PMF_R(0.0) ? 0U : 1U;
    }
    return lost | (sum - sum == PMF_R(0.0) ? 0U : 1U);
}

static void note_size(const pmf_config_t *config, pmf_found_state_t *found, real_t input, real_t speed)
{
    real_t push = config->auxiliary.input_gain * input;
    push = push < PMF_R(0.0) ? -push : push;
    speed = speed < PMF_R(0.0) ? -speed : speed;
    found->push = push > found->push ? push : found->push;
    found->speed = speed > found->speed ? speed : found->speed;
}

static uint32_t is_known(const pmf_config_t *config, const pmf_found_state_t *found, real_t *variance)
{
    uint32_t late = FIRST + config->auxiliary.index[PMF_DELAY];
    real_t limit = SHARP / config->late.rate, scatter = PMF_R(2.0) * found->surprise / found->expected;
    *variance = found->covariance[late][late] * (scatter > PMF_R(1.0) ? scatter : PMF_R(1.0));
    return found->running != 0U && found->age > ENOUGH_AGE && found->near > ENOUGH_NEAR && *variance < limit * limit
               ? 1U
               : 0U;
}

static void one_sample(const pmf_config_t *config, pmf_state_t *state, const acts_t *acts)
{
    pmf_found_state_t *found = &state->found;
    uint32_t p = parameters_of(config), i, j;
    real_t growth = config->late.growth * (PMF_R(1.0) + PMF_R(1.0) / ((real_t)found->age + GROWING)),
           before[PMF_MAX_PARAMETERS];
    real_t variance;
    motion_t motion;
    follow_motion(config, state, acts, &motion);
    found->place += motion.distance - PMF_TO_REAL(found->change);
    found->velocity = motion.velocity;
    carry(found, &motion, FIRST + p);
    for (i = 0; i < p; ++i) {
        for (j = 0; j < p; ++j) {
            found->covariance[FIRST + i][FIRST + j] *= growth;
        }
        before[i] = found->theta[i];
    }
    cut_off(found, FIRST + p);
    keep_possible(config, found, before);
    doubt(config, found);
    found->age += found->age < PMF_OLDEST ? 1U : 0U;
    if (is_lost(found, FIRST + p) != 0U) {
        found->tries = found->tries < PMF_MOST_TRIES ? found->tries + 1U : 0U;
        begin(config, state);
    } else if (found->looks < PMF_LOOKS && is_known(config, found, &variance) != 0U) {
        look_again(config, state);
    } else {
        /* it goes on */
    }
}

void pmf_within_step(const pmf_config_t *config, pmf_state_t *state, const acts_t *acts, uint32_t usable)
{
    pmf_found_state_t *found = &state->found;
    note_size(config, found, acts->newer, state->network.node[PMF_LATE_VELOCITY]);
    if (found->running == 0U) {
        if (usable != 0U && state->auxiliary.running != 0U) {
            begin(config, state);
        }
    } else if (usable == 0U) {
        anchor(config, state);
    } else {
        one_sample(config, state, acts);
    }
    found->change = state->encoder.change;
}

void pmf_within_lend(const pmf_config_t *config, pmf_state_t *state)
{
    pmf_auxiliary_state_t *model = &state->auxiliary;
    roles_of(config, state->found.theta, model->parameter);
    forget_sensitivity(model);
    model->velocity = state->found.velocity;
    model->power = model->mismatch = PMF_R(0.0);
    model->trusted = 1U;
    model->trial = 0U;
}

uint32_t pmf_within_known(const pmf_config_t *config, const pmf_state_t *state, real_t *variance)
{
    return state->found.looks == PMF_LOOKS ? is_known(config, &state->found, variance) : 0U;
}

#endif
#endif
