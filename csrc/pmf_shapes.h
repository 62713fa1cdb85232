/* Shapes: forces of a given form and an unknown size, of the auxiliary model alone (for pmf_auxiliary.c).
 * SPDX-License-Identifier: Apache-2.0
 *
 * A shape is friction at a speed, friction at a place, or a force at a place. Its form stands in a table that was made
 * where the configuration was, so that nothing is computed here but a straight line between two knots; what is new is a
 * new table. In an interval a shape acts with its mean along the motion: over the speeds, for an acceleration that does
 * not change, exactly, so that friction that falls within a fraction of a sample's change of speed needs no smaller
 * steps.
 */
#ifndef PMF_SHAPES_H
#define PMF_SHAPES_H

#include "pmf_internal.h"

#if PMF_WITH_AUXILIARY

typedef struct {
    real_t mass, force; /* input force without the constant load */
    real_t viscous[2], coulomb[2]; /* forward, backward */
} body_t;

typedef struct {
    real_t velocity, left; /* left: of the interval, as a part */
    real_t distance[2], moving[2]; /* forward, backward; in parts of the interval */
} phase_t;

#if PMF_SHAPED

/* In pmf_auxiliary.c. */
static void move(const body_t *body, scalar_t dt, truth_t forward, truth_t backward, phase_t *phase);

#define FORESIGHTS 2U /* of where an interval ends, each with the means along the one before */
#define MOST_PERIODS PMF_R(1e9) /* beyond, a number says nothing of the place in a period */

typedef struct {
    real_t velocity, place; /* of one end of a motion */
} shape_end_t;

/* How many knots from the first one; within the table. */
static real_t knots_from_first(const pmf_shape_t *shape, real_t at)
{
    real_t x = (at - shape->start) * shape->knots_per_unit, last = (real_t)shape->intervals;
    if (shape->periodic != 0U) {
        real_t periods = x / last;
        if (!(periods < MOST_PERIODS && periods > -MOST_PERIODS)) {
            return PMF_R(0.0);
        }
        x -= last * (real_t)(int32_t)periods;
        x = x < PMF_R(0.0) ? x + last : x;
    }
    x = x > PMF_R(0.0) ? x : PMF_R(0.0); /* what is no number is the first knot */
    return x < last ? x : last;
}

static real_t shape_value(const pmf_shapes_config_t *config, const pmf_shape_t *shape, real_t at)
{
    real_t x = knots_from_first(shape, at);
    uint32_t i = (uint32_t)x;
    const scalar_t *knot = &config->knot[shape->first];
    i = i < shape->intervals ? i : shape->intervals - 1U;
    return knot[i] + (x - (real_t)i) * (knot[i + 1U] - knot[i]);
}

/* From the first knot on, in steps of the table; beyond it the last value goes on. */
static real_t shape_integral(const pmf_shapes_config_t *config, const pmf_shape_t *shape, real_t at)
{
    real_t x = knots_from_first(shape, at), part;
    uint32_t i = (uint32_t)x;
    const scalar_t *knot = &config->knot[shape->first];
    i = i < shape->intervals ? i : shape->intervals - 1U;
    part = x - (real_t)i;
    return config->sum[shape->first + i] + part * (knot[i] + PMF_R(0.5) * part * (knot[i + 1U] - knot[i])) +
           ((at - shape->start) * shape->knots_per_unit - x) * knot[shape->intervals];
}

/* Mean over speeds from a to b, both >= 0. */
static real_t mean_over_speed(const pmf_shapes_config_t *config, const pmf_shape_t *shape, real_t a, real_t b)
{
    real_t knots;
    if (shape->of == PMF_OF_SQUARE) {
        return (a * a + a * b + b * b) * PMF_R(0.333333333333333333);
    }
    knots = (b - a) * shape->knots_per_unit;
    if (knots < PMF_R(1.0) && knots > PMF_R(-1.0)) { /* too near for a difference of integrals */
        return shape_value(config, shape, PMF_R(0.5) * (a + b));
    }
    return (shape_integral(config, shape, b) - shape_integral(config, shape, a)) / knots;
}

/* Mean along a motion from one end to the other in a time [s], by Simpson's rule. */
static real_t mean_over_place(const pmf_shapes_config_t *config, const pmf_shape_t *shape, const shape_end_t *from,
                              const shape_end_t *to, real_t time)
{
    real_t middle = PMF_R(0.5) * (from->place + to->place) - PMF_R(0.125) * time * (to->velocity - from->velocity);
    real_t ends = shape_value(config, shape, from->place) + shape_value(config, shape, to->place);
    return (ends + PMF_R(4.0) * shape_value(config, shape, middle)) * PMF_R(0.166666666666666667);
}

static real_t speed_of(real_t velocity)
{
    return velocity < PMF_R(0.0) ? -velocity : velocity;
}

/* The body with its shapes' means; `mean` keeps those, of friction against the motion. */
static body_t shaped_body(const pmf_shapes_config_t *config, const body_t *plain, const real_t *parameter,
                          const shape_end_t *from, const shape_end_t *to, real_t time, real_t *mean)
{
    body_t body = *plain;
    real_t friction = PMF_R(0.0);
    uint32_t i;
    for (i = 0; i < config->n; ++i) {
        const pmf_shape_t *shape = &config->shape[i];
        mean[i] = shape->of == PMF_OF_PLACE
                      ? mean_over_place(config, shape, from, to, time)
                      : mean_over_speed(config, shape, speed_of(from->velocity), speed_of(to->velocity));
        if (shape->resists != 0U) {
            friction += parameter[PMF_BODY_ROLES + i] * mean[i];
        } else {
            body.force -= parameter[PMF_BODY_ROLES + i] * mean[i];
        }
    }
    body.coulomb[0] += friction;
    body.coulomb[1] += friction;
    return body;
}

static real_t place_of(const pmf_auxiliary_config_t *config, const pmf_auxiliary_state_t *state, const phase_t *phase)
{
    return state->position + PMF_SPAN(config, state) * (phase->distance[0] + phase->distance[1]);
}

/* A body at rest: what holds it, and what drives it. */
static body_t body_at_rest(const pmf_auxiliary_config_t *config, const pmf_auxiliary_state_t *state,
                           const body_t *plain, const phase_t *phase)
{
    real_t mean[PMF_MAX_SHAPES];
    shape_end_t here;
    here.velocity = PMF_R(0.0);
    here.place = place_of(config, state, phase);
    return shaped_body(&config->shapes, plain, state->parameter, &here, &here, PMF_R(0.0), mean);
}

/* About where a body comes to in a time [s], or where it stops before; returns the time. */
static real_t foresee(const body_t *body, truth_t backward, const shape_end_t *from, real_t time, shape_end_t *to)
{
    real_t side = backward != 0 ? PMF_R(-1.0) : PMF_R(1.0), speed = side * from->velocity;
    real_t push = side * body->force - (backward != 0 ? body->coulomb[1] : body->coulomb[0]);
    real_t drag = PMF_R(0.5) * time * (backward != 0 ? body->viscous[1] : body->viscous[0]);
    real_t end = ((body->mass - drag) * speed + time * push) / (body->mass + drag);
    if (!(end > PMF_R(0.0))) {
        time = speed > PMF_R(0.0) ? time * speed / (speed - end) : PMF_R(0.0);
        end = PMF_R(0.0);
    }
    to->velocity = side * end;
    to->place = from->place + PMF_R(0.5) * time * side * (speed + end);
    return time;
}

/* `move` with the shapes' means along the motion that comes of it, which are added to the shapes' signals. */
static void move_shaped(const pmf_auxiliary_config_t *config, const pmf_auxiliary_state_t *state, const body_t *plain,
                        truth_t forward, truth_t backward, phase_t *phase, real_t *signal)
{
    real_t mean[PMF_MAX_SHAPES], left = phase->left, time = PMF_R(0.0);
    shape_end_t from, to;
    body_t body;
    uint32_t turn, i;
    from.velocity = phase->velocity;
    from.place = place_of(config, state, phase);
    to = from;
    for (turn = 0; turn < FORESIGHTS; ++turn) {
        body = shaped_body(&config->shapes, plain, state->parameter, &from, &to, time, mean);
        time = foresee(&body, backward, &from, left * PMF_SPAN(config, state), &to);
    }
    body = shaped_body(&config->shapes, plain, state->parameter, &from, &to, time, mean);
    move(&body, PMF_SPAN(config, state), forward, backward, phase);
    left -= phase->left;
    for (i = 0; i < config->shapes.n; ++i) {
        real_t part = backward != 0 && config->shapes.shape[i].resists != 0U ? -left : left;
        signal[config->shapes.shape[i].node] += part * mean[i];
    }
}

static void clear_shapes(const pmf_shapes_config_t *config, real_t *signal)
{
    uint32_t i;
    for (i = 0; i < config->n; ++i) {
        signal[config->shape[i].node] = PMF_R(0.0);
    }
}

#endif

#endif
#endif
