/* The motion of a body under the input in an interval, and the derivatives of this motion by all unknowns. Only
 * pmf_edges.h includes this file. SPDX-License-Identifier: Apache-2.0 */
#ifndef PMF_MOTION_H
#define PMF_MOTION_H

#include "pmf_shapes.h"

#if PMF_FOUND

#define PLACE 0U
#define SPEED 1U
#define FIRST 2U /* index of the first parameter, after place and velocity */
#define MOST_KNOWN (PMF_MAX_PARAMETERS + 2)

/* The motion at the end of a sample, and its derivatives by place, velocity and theta at the start. */
typedef struct {
    real_t velocity, distance; /* distance in counts */
    real_t place_by[MOST_KNOWN], velocity_by[MOST_KNOWN];
} motion_t;
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

/* Return the acceleration of a body at a velocity. At rest, the result is the acceleration after breaking away. */
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

/* Return the sum over the interval of the forces that each parameter multiplies. */
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

/* Differentiate an interval `whole` from the first velocity through the velocity at the switch to the last velocity. */
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

#endif
#endif
