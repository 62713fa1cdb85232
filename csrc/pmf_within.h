/* A recursive motion that is held within the counts, which shows the delay of the input (for pmf_auxiliary.c).
 * SPDX-License-Identifier: Apache-2.0
 *
 * Under control through a coarse encoder the input follows the encoder's error, so that instruments from the input
 * fail. The likelihood of the counts does not suffer. A body moved by the input alone must lie between two edges at
 * every sample. The place, velocity and parameters of the body have a normal distribution. The model carries the
 * distribution from sample to sample. Each count cuts off the distribution at the nearest edge. The mean and covariance
 * of the remainder are kept (assumed density filtering). A count far from an edge has no information, a count near an
 * edge more than a variance of a twelfth. Standard errors therefore shrink with the number of edges instead of its
 * root.
 *
 * The method assumes a right model. If the place is too often too many standard deviations beyond an edge, the motion
 * begins again. */
#ifndef PMF_WITHIN_H
#define PMF_WITHIN_H

#include "pmf_edges.h"

#if PMF_FOUND

#define GROWING PMF_R(100.0) /* memory [samples], which gives less weight to samples linearised further away */
#define SURPRISED PMF_R(1.3) /* ratio to the expectation above which the motion is wrong */
#define STRAYED PMF_R(6.0) /* squared deviations above which a moved dead time had too small a variance */
#define WIDENED PMF_R(4.0) /* factor of the covariance after a dead time that moved too far */
#define SLACK PMF_R(0.1)
#define WHILE PMF_R(0.25) /* fraction of the variance that ends an interval of comparison */
#define STAYED PMF_R(0.25) /* [samples] */
#define YOUNG 10U
#define ENOUGH_AGE 100U /* least numbers of samples, and of samples near an edge, of an accepted motion */
#define ENOUGH_NEAR 100U
#define SHARP PMF_R(0.1) /* standard deviation [samples] of a known dead time */
#define LEAST_KEPT PMF_R(0.3) /* least kept fraction of mass and viscous friction in one sample */

/* Keep masses and frictions positive, and the dead time within the kernel's room. */
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

/* Return the initial standard deviation of a parameter. */
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

/* Set the place to an arbitrary value within the last count, and the velocity to the measured one. */
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

/* Start from parameters by roles. */
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

/* Begin from the accepted dead time. Without an accepted dead time, every beginning tries the dead time of an uncertain
 * estimate. */
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

/* Earlier data were linearised further away, and the error of this linearisation would stay. The motion begins once
 * more from its result, until the result stays. The auxiliary model may already use the result. */
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

/* A dead time that moves beyond its own variance was linearised too far away, so that the sums lose weight. */
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
        /* the motion goes on */
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
