/* The simulated body and its derivatives. Only pmf_redge.c includes this file. SPDX-License-Identifier: Apache-2.0 */

static const uint32_t PLACE = 0U;
static const uint32_t SPEED = 1U;
static const uint32_t LATENESS = 2U; /* minus the time by which all instants come late */
static const uint32_t FIRST = 3U; /* the parameters */
enum pmf_carried { CARRIED = PMF_EDGE_UNKNOWNS - 2 }; /* lateness and parameters, which go on in the next window */
static const uint32_t MASS = 0U;
static const uint32_t VISCOUS = 1U;
static const uint32_t COULOMB = 2U;
static const uint32_t OFFSET = 3U;
static const uint32_t TERMS = 14U; /* of the series, half a time constant long: below the last digit of a double */
static const real_t LONGEST = PMF_R(0.5); /* piece of a motion [time constants] */
static const uint32_t MOST_PIECES = 256U;
static const uint32_t NEWTON = 6U; /* steps to the instant of a stop */

/* Integrals over a piece of the decay exp(-z) at its end, relative to powers of the time of the piece. */
typedef struct {
    real_t kept, once, twice, weighted, weighted_twice;
} decays_t;

static decays_t decays_of(real_t z)
{
    decays_t sums = {PMF_R(0.0), PMF_R(0.0), PMF_R(0.0), PMF_R(0.0), PMF_R(0.0)};
    real_t term = PMF_R(1.0);
    uint32_t k;
    for (k = 0; k < TERMS; ++k) {
        real_t n = (real_t)k;
        sums.kept += term;
        sums.once += term / (n + PMF_R(1.0));
        sums.twice += term / ((n + PMF_R(1.0)) * (n + PMF_R(2.0)));
        sums.weighted += term / (n + PMF_R(2.0));
        sums.weighted_twice += term / ((n + PMF_R(2.0)) * (n + PMF_R(3.0)));
        term *= -z / (n + PMF_R(1.0));
    }
    return sums;
}

static real_t absolute(real_t x)
{
    return x < PMF_R(0.0) ? -x : x;
}

/* Add to a sum what its last digit cannot hold, too (Kahan 1965): in float32 the place would drift away. */
static void add_exactly(real_t *sum, real_t *rest, real_t part)
{
    real_t before = *sum;
    part += *rest;
    *sum = before + part;
    *rest = part - (*sum - before);
}

/* Return the force of a relative change of one: the parameter itself. An offset may be zero, and is relative to the
 * size of the constant forces. */
static real_t unit_of(const real_t *reference, uint32_t i)
{
#if PMF_BODY > 3
    if (i == OFFSET) {
        return reference[COULOMB] + absolute(reference[OFFSET]);
    }
#endif
    return reference[i];
}

/* Return the force of the input that is left to move the body. */
static real_t force_of(const pmf_redge_state_t *state, real_t force)
{
#if PMF_BODY > 3
    return force - state->reference[OFFSET];
#else
    (void)state;
    return force;
#endif
}

/* Return the direction of the motion, or of the motion that the force begins, and 0 at rest. */
static real_t way_of(const pmf_redge_state_t *state, real_t force)
{
    real_t coulomb = state->reference[COULOMB];
    if (state->velocity != PMF_R(0.0)) {
        return state->velocity > PMF_R(0.0) ? PMF_R(1.0) : PMF_R(-1.0);
    }
    return force > coulomb ? PMF_R(1.0) : force < -coulomb ? PMF_R(-1.0) : PMF_R(0.0);
}

/* Return the time to the stop of a body that is braked, by Newton's method, or `time` if it does not stop before. */
static real_t time_to_stop(real_t velocity, real_t acceleration, real_t rate, real_t time)
{
    real_t needed = -velocity / acceleration, found = needed;
    uint32_t i;
    for (i = 0; i < NEWTON && found < time; ++i) {
        decays_t decay = decays_of(rate * found);
        found -= (found * decay.once - needed) / decay.kept;
    }
    return found < time ? found : time;
}

/* Return the part of a velocity's derivative that is left after a stop. */
static real_t left_after_stop(const pmf_redge_state_t *state, real_t force, real_t way)
{
    real_t coulomb = state->reference[COULOMB], after = PMF_R(0.0);
    after = force > coulomb ? force - coulomb : force < -coulomb ? force + coulomb : after;
    return after / (force - way * coulomb);
}

/* Move through a piece without an event, and its derivatives. The parameters are relative to the reference. */
static void move_piece(pmf_redge_state_t *state, real_t acceleration, real_t time, real_t way)
{
    const real_t *at = state->reference;
    real_t by_place[PMF_BODY], by_velocity[PMF_BODY];
    decays_t decay = decays_of(at[VISCOUS] / at[MASS] * time);
    real_t once = time * decay.once, twice = time * time * decay.twice, weighted = time * time * decay.weighted;
    real_t further = time * time * time * decay.weighted_twice, viscous = at[VISCOUS] / at[MASS];
    uint32_t i;
    by_velocity[MASS] = -acceleration * time * decay.kept;
    by_place[MASS] = -acceleration * weighted;
    by_velocity[VISCOUS] = -viscous * (state->velocity * once + acceleration * weighted);
    by_place[VISCOUS] = -viscous * (state->velocity * twice + acceleration * further);
    by_velocity[COULOMB] = -way * at[COULOMB] / at[MASS] * once;
    by_place[COULOMB] = -way * at[COULOMB] / at[MASS] * twice;
#if PMF_BODY > 3
    by_velocity[OFFSET] = -unit_of(at, OFFSET) / at[MASS] * once;
    by_place[OFFSET] = -unit_of(at, OFFSET) / at[MASS] * twice;
#endif
    for (i = 0; i < PMF_EDGE_UNKNOWNS; ++i) {
        state->place_by[i] += once * state->velocity_by[i];
        state->velocity_by[i] *= decay.kept;
        if (i >= FIRST) {
            state->place_by[i] += by_place[i - FIRST];
            state->velocity_by[i] += by_velocity[i - FIRST];
        }
    }
    add_exactly(&state->place, &state->place_rest, time * state->velocity_rest + acceleration * twice);
    add_exactly(&state->place, &state->place_rest, time * state->velocity);
    add_exactly(&state->velocity, &state->velocity_rest, acceleration * once);
}

/* Stop the body. Where its braking is weak, a small change of velocity moves the stop by much: by the squared change
 * over twice the acceleration. */
static void stop_body(pmf_redge_state_t *state, real_t force, real_t way)
{
    real_t kept = left_after_stop(state, force, way), braking;
    uint32_t i;
    braking = absolute(force - way * state->reference[COULOMB]) / state->reference[MASS];
    state->velocity = state->velocity_rest = PMF_R(0.0);
    for (i = 0; i < PMF_EDGE_UNKNOWNS; ++i) {
        state->stops_by[i] +=
            PMF_R(0.5) * (PMF_R(1.0) - kept) * state->velocity_by[i] * state->velocity_by[i] / braking;
        state->velocity_by[i] *= kept;
    }
}

/* Move the body and its derivatives for `time` under a force. */
static void move_body(pmf_redge_state_t *state, real_t force, real_t time)
{
    real_t rate = state->reference[VISCOUS] / state->reference[MASS], way, acceleration, part, left;
    uint32_t pieces;
    for (pieces = 0; pieces < MOST_PIECES && time > PMF_R(0.0); ++pieces) {
        way = way_of(state, force);
        if (way == PMF_R(0.0)) {
            return;
        }
        acceleration = force - way * state->reference[COULOMB] - state->reference[VISCOUS] * state->velocity;
        acceleration /= state->reference[MASS];
        part = rate * time > LONGEST ? LONGEST / rate : time;
        left = part;
        if (state->velocity != PMF_R(0.0) && acceleration * way < PMF_R(0.0)) {
            left = time_to_stop(state->velocity, acceleration, rate, part);
        }
        move_piece(state, acceleration, left, way);
        if (left < part) {
            stop_body(state, force, way);
        }
        time -= left;
    }
}
