/* Shapes are forces of a given form and an unknown size in the auxiliary model (for pmf_auxiliary.c).
 * SPDX-License-Identifier: Apache-2.0
 *
 * A shape is friction at a speed, friction at a place, or a force at a place. The form is a sine, a square, or a table
 * of the configuration with straight lines between its knots. In an interval a shape acts with its mean along the
 * motion. The mean over the speeds is exact for a constant acceleration. A friction that falls within a fraction of a
 * sample's speed change therefore needs no smaller steps. */

typedef struct {
    real_t mass, force; /* input force without the constant load */
    real_t viscous[2], coulomb[2]; /* forward, backward */
} body_t;

typedef struct {
    real_t velocity, left; /* remaining fraction of the interval */
    real_t distance[2], moving[2]; /* times of motion forward and backward, as fractions of the interval */
} phase_t;

#if PMF_SHAPED

/* Defined in pmf_auxiliary.c. */
static void move(const body_t *body, scalar_t dt, truth_t forward, truth_t backward, phase_t *phase);

static const uint32_t FORESIGHTS = 2U; /* iterations of the end of an interval, each with the means of the last one */
static const scalar_t MOST_PERIODS =
    PMF_SCALAR(1e9); /* largest number of periods at which a number shows the place within a period */

typedef struct {
    real_t velocity, place; /* position and velocity at one end of a motion */
    real_t value[PMF_MAX_SHAPES]; /* values of the shapes of a place, only at the beginning of a motion */
} shape_end_t;

/* Return the distance from the first knot, in knots, within the table. */
static real_t knots_from_first(const pmf_shape_t *shape, real_t at)
{
    real_t x = (at - shape->start) * shape->knots_per_unit, last = PMF_ALIKE((scalar_t)shape->intervals);
    x = PMF_IF(x > PMF_R(0.0), x, PMF_R(0.0)); /* NaN counts as the first knot */
    return PMF_IF(x < last, x, last);
}

static integer_t knot_before(const pmf_shape_t *shape, real_t x)
{
    integer_t i = (integer_t)x, last = (integer_t)shape->intervals - 1;
    return PMF_IF(i < last, i, last);
}

/* Return sin(2 pi x), x in periods. A polynomial through Chebyshev's nodes over a quarter of a period has an error of
 * 1e-13. */
static real_t wave_value(const pmf_shape_t *shape, real_t at)
{
    real_t x = (at - shape->start) * shape->knots_per_unit, s;
    truth_t near = (x < MOST_PERIODS) & (x > -MOST_PERIODS);
    x = PMF_IF(near, x, PMF_R(0.0)); /* NaN counts as the start */
    x -= PMF_TO_REAL((integer_t)x);
    x = PMF_IF(x > PMF_R(0.5), x - PMF_R(1.0), PMF_IF(x < PMF_R(-0.5), x + PMF_R(1.0), x));
    x = PMF_IF(x > PMF_R(0.25), PMF_R(0.5) - x, PMF_IF(x < PMF_R(-0.25), PMF_R(-0.5) - x, x));
    s = x * x;
    s = PMF_R(81.605249149015829376) +
        s * (PMF_R(-76.705847543773266658) +
             s * (PMF_R(42.058134871372057197) +
                  s * (PMF_R(-15.081483206892999734) + s * PMF_R(3.6658551595639611937))));
    return x * (PMF_R(6.2831853071792701236) + x * x * (PMF_R(-41.341702239903672014) + x * x * s));
}

static real_t value_in_table(const pmf_shapes_config_t *config, const pmf_shape_t *shape, real_t at)
{
    real_t x = knots_from_first(shape, at);
    integer_t i = knot_before(shape, x);
    const scalar_t *knot = &config->knot[shape->first];
    real_t low = knot[i];
    return low + (x - PMF_TO_REAL(i)) * (knot[i + 1] - low);
}

static real_t shape_value(const pmf_shapes_config_t *config, const pmf_shape_t *shape, real_t at)
{
    return shape->of == PMF_OF_WAVE ? wave_value(shape, at) : value_in_table(config, shape, at);
}

/* Return the integral from the first knot, in steps of the table. The last value continues beyond the table. */
static real_t shape_integral(const pmf_shapes_config_t *config, const pmf_shape_t *shape, real_t at)
{
    real_t x = knots_from_first(shape, at), part, low;
    integer_t i = knot_before(shape, x);
    const scalar_t *knot = &config->knot[shape->first];
    part = x - PMF_TO_REAL(i);
    low = knot[i];
    return config->sum[shape->first + (uint32_t)i] + part * (low + PMF_R(0.5) * part * (knot[i + 1] - low)) +
           ((at - shape->start) * shape->knots_per_unit - x) * knot[shape->intervals];
}

/* Return the mean over speeds from a to b, both >= 0. */
static real_t mean_over_speed(const pmf_shapes_config_t *config, const pmf_shape_t *shape, real_t a, real_t b)
{
    real_t knots, middle, apart;
    truth_t near;
    if (shape->of == PMF_OF_SQUARE) {
        return (a * a + a * b + b * b) * PMF_R(0.333333333333333333);
    }
    knots = (b - a) * shape->knots_per_unit;
    near = (knots < PMF_R(1.0)) & (knots > PMF_R(-1.0)); /* too close for a difference of integrals */
    middle = PMF_ANY(near) ? shape_value(config, shape, PMF_R(0.5) * (a + b)) : PMF_R(0.0);
    if (PMF_ALL(near)) {
        return middle;
    }
    apart = (shape_integral(config, shape, b) - shape_integral(config, shape, a)) / knots;
    return PMF_IF(near, middle, apart);
}

/* Return the mean along a motion between two ends in a time [s], by Simpson's rule. */
static real_t mean_over_place(const pmf_shapes_config_t *config, const pmf_shape_t *shape, real_t begun,
                              const shape_end_t *from, const shape_end_t *to, real_t time)
{
    real_t middle = PMF_R(0.5) * (from->place + to->place) - PMF_R(0.125) * time * (to->velocity - from->velocity);
    real_t ends = begun + shape_value(config, shape, to->place);
    return (ends + PMF_R(4.0) * shape_value(config, shape, middle)) * PMF_R(0.166666666666666667);
}

static real_t speed_of(real_t velocity)
{
    return PMF_IF(velocity < PMF_R(0.0), -velocity, velocity);
}

/* Return the body with the means of its shapes. `mean` keeps these means for friction against the motion. */
static body_t shaped_body(const pmf_shapes_config_t *config, const body_t *plain, const real_t *parameter,
                          const shape_end_t *from, const shape_end_t *to, real_t time, real_t *mean)
{
    body_t body = *plain;
    real_t friction = PMF_R(0.0);
    uint32_t i;
    for (i = 0; i < config->n; ++i) {
        const pmf_shape_t *shape = &config->shape[i];
        mean[i] = shape->of >= PMF_OF_PLACE
                      ? mean_over_place(config, shape, from->value[i], from, to, time)
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

/* Return the beginning of a motion. */
static shape_end_t begin_motion(const pmf_auxiliary_config_t *config, const pmf_auxiliary_state_t *state,
                                const phase_t *phase)
{
    const pmf_shapes_config_t *shapes = &config->shapes;
    shape_end_t here;
    uint32_t i;
    here.velocity = phase->velocity;
    here.place = state->position + PMF_SPAN(config, state) * (phase->distance[0] + phase->distance[1]);
    for (i = 0; i < shapes->n; ++i) {
        if (shapes->shape[i].of >= PMF_OF_PLACE) {
            here.value[i] = shape_value(shapes, &shapes->shape[i], here.place);
        }
    }
    return here;
}

/* Return a body at rest with its holding and driving forces. */
static body_t body_at_rest(const pmf_auxiliary_config_t *config, const pmf_auxiliary_state_t *state,
                           const body_t *plain, const phase_t *phase)
{
    real_t mean[PMF_MAX_SHAPES];
    shape_end_t here = begin_motion(config, state, phase);
    here.velocity = PMF_R(0.0);
    return shaped_body(&config->shapes, plain, state->parameter, &here, &here, PMF_R(0.0), mean);
}

/* Predict the place of a body after a time [s] or at an earlier stop. Returns the time. */
static real_t foresee(const body_t *body, truth_t backward, const shape_end_t *from, real_t time, shape_end_t *to)
{
    real_t side = PMF_IF(backward, PMF_R(-1.0), PMF_R(1.0)), speed = side * from->velocity;
    real_t push = side * body->force - PMF_IF(backward, body->coulomb[1], body->coulomb[0]);
    real_t drag = PMF_R(0.5) * time * PMF_IF(backward, body->viscous[1], body->viscous[0]);
    real_t end = ((body->mass - drag) * speed + time * push) / (body->mass + drag);
    truth_t stops = PMF_NOT(end > PMF_R(0.0));
    if (PMF_ANY(stops)) {
        time = PMF_IF(stops, PMF_IF(speed > PMF_R(0.0), time * speed / (speed - end), PMF_R(0.0)), time);
        end = PMF_IF(stops, PMF_R(0.0), end);
    }
    to->velocity = side * end;
    to->place = from->place + PMF_R(0.5) * time * side * (speed + end);
    return time;
}

/* Call `move` with the means of the shapes along the resulting motion, and add these means to the shapes' signals. */
static void move_shaped(const pmf_auxiliary_config_t *config, const pmf_auxiliary_state_t *state, const body_t *plain,
                        truth_t forward, truth_t backward, phase_t *phase, real_t *signal)
{
    real_t mean[PMF_MAX_SHAPES], left = phase->left, time = PMF_R(0.0);
    shape_end_t from = begin_motion(config, state, phase), to = from;
    body_t body;
    uint32_t turn, i;
    for (turn = 0; turn < FORESIGHTS; ++turn) {
        body = shaped_body(&config->shapes, plain, state->parameter, &from, &to, time, mean);
        time = foresee(&body, backward, &from, left * PMF_SPAN(config, state), &to);
    }
    body = shaped_body(&config->shapes, plain, state->parameter, &from, &to, time, mean);
    move(&body, PMF_SPAN(config, state), forward, backward, phase);
    left -= phase->left;
    for (i = 0; i < config->shapes.n; ++i) {
        real_t part = config->shapes.shape[i].resists != 0U ? PMF_IF(backward, -left, left) : left;
        signal[config->shapes.shape[i].node] += part * mean[i];
    }
}

static void clear_shapes(const pmf_auxiliary_config_t *config, truth_t where, real_t *signal)
{
    const pmf_shape_t *shape = config->shapes.shape;
    uint32_t i;
    for (i = 0; i < config->shapes.n; ++i) {
        signal[shape[i].node] = PMF_IF(where, PMF_R(0.0), signal[shape[i].node]);
    }
}

static truth_t has_shapes(const pmf_auxiliary_config_t *config)
{
    return config->shapes.n != 0U;
}

static uint32_t roles_of(const pmf_auxiliary_config_t *config)
{
    return PMF_BODY_ROLES + config->shapes.n;
}

/* Return whether the role is a shape whose coefficient is never negative. */
static truth_t is_positive(const pmf_auxiliary_config_t *config, uint32_t role)
{
    return role >= PMF_BODY_ROLES && config->shapes.shape[role - PMF_BODY_ROLES].positive != 0U;
}

#else /* no shapes: the compiler leaves out what they would need */
#define has_shapes(config) 0
#define roles_of(config) PMF_ROLES
#define is_positive(config, role) 0
#define body_at_rest(config, state, plain, phase) (*(plain))
#define move_shaped(config, state, plain, forward, backward, phase, signal) ((void)(state), (void)(signal))
#define clear_shapes(config, where, signal) ((void)(signal))
#endif
