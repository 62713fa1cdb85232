/* Counts to velocity, direction and standstill.
 * SPDX-License-Identifier: Apache-2.0
 *
 * With several counts per sample the instant of a reversal inside an interval follows from the velocities at
 * its ends, which a tracker of piecewise constant acceleration estimates (Kalata 1984, fixed gains, smoothed
 * by one step). With less than two counts per sample the tracker would only follow the staircase: there the
 * direction is that of the last count.
 */
#include "pmf.h"

#define FAST_COUNTS 2 /* counts in one sample from which on the tracker is trusted */
#define FAST_SAMPLES 3
#define CLOSE 3

static uint32_t magnitude(int32_t x)
{
    return x < 0 ? (uint32_t)0 - (uint32_t)x : (uint32_t)x;
}

/* Difference modulo the counter's range, sign-extended. */
static int32_t count_change(uint32_t mask, uint32_t now, uint32_t before)
{
    uint32_t change = (now - before) & mask;
    uint32_t half = (mask >> 1) + 1U;
    if (change < half) {
        return (int32_t)change;
    }
    return -(int32_t)(mask - change) - 1;
}

static real_t signed_count(uint32_t count)
{
    return count <= 0x7fffffffU ? (real_t)count : -(real_t)((uint32_t)0 - count);
}

/* Signed moving fraction of an interval from the velocities at its start and end. */
static real_t signed_fraction(real_t start, real_t end)
{
    real_t sum = start + end;
    if ((start < PMF_R(0.0)) != (end < PMF_R(0.0))) {
        real_t span = start < end ? end - start : start - end;
        return span > PMF_R(0.0) ? sum / span : PMF_R(0.0);
    }
    return sum < PMF_R(0.0) ? PMF_R(-1.0) : PMF_R(1.0);
}

/* The interval before the last: its direction from the tracker, or the last count's. */
static real_t late_direction(const pmf_encoder_config_t *config, const pmf_encoder_state_t *state,
                             real_t innovation, int32_t fast, real_t velocity_two_before)
{
    real_t end, start;
    if (fast == 0 && state->fast == 0) {
        return state->direction;
    }
    end = state->velocity + config->smooth_end * innovation;
    start = velocity_two_before + config->smooth_end * state->innovation + config->smooth_start * innovation;
    return signed_fraction(start, end);
}

static int32_t next_fast(int32_t fast, uint32_t counts)
{
    if (counts >= FAST_COUNTS) {
        return FAST_SAMPLES;
    }
    return fast > 0 ? fast - 1 : 0;
}

/* Counts and the pauses between them. A pause much longer than the last ones is a standstill. Where counts came at
 * least every CLOSE samples, one sample more is enough; with a coarser encoder it may be a slow reversal, which takes
 * the longer the coarser it is. */
static uint32_t note_motion(const pmf_encoder_config_t *config, pmf_encoder_state_t *state, int32_t change)
{
    uint32_t still = config->standstill_samples, leaked, limit;
    if (change != 0) {
        leaked = state->gap - state->gap / 4U;
        state->gap = state->idle + 1U > leaked ? state->idle + 1U : leaked;
        state->direction = change > 0 ? PMF_R(1.0) : PMF_R(-1.0);
        state->moving = PMF_R(1.0);
        state->idle = 0;
        return 0U;
    }
    state->idle += state->idle < still ? 1U : 0U;
    if (config->process != 0U) {
        return 0U;
    }
    limit = state->gap <= CLOSE ? state->gap + 1U : 4U * state->gap + 2U;
    if (state->idle >= still || state->idle > limit) {
        state->direction = PMF_R(0.0);
        state->moving = PMF_R(0.0);
        return PMF_STANDSTILL;
    }
    return 0U;
}

static void track(const pmf_encoder_config_t *config, pmf_encoder_state_t *state, real_t innovation,
                  real_t predicted)
{
    state->velocity_before = state->velocity;
    state->position = predicted + config->position_gain * innovation;
    state->velocity += config->velocity_gain * innovation;
    state->innovation = innovation;
}

static uint32_t check(const pmf_encoder_config_t *config, pmf_encoder_state_t *state, real_t *input,
                      int32_t *change)
{
    uint32_t status = 0;
    if (!(*input - *input == PMF_R(0.0))) { /* NaN or infinite */
        *input = state->input;
        status |= PMF_INVALID_INPUT;
    }
    if (config->max_change > 0U && magnitude(*change) > config->max_change) {
        *change = 0;
        status |= PMF_COUNT_JUMP;
    }
    return status;
}

/* The signals of the interval before the last. */
static void emit(const pmf_encoder_config_t *config, const pmf_encoder_state_t *state, real_t direction, real_t *signal)
{
    real_t half = PMF_R(0.5) * direction, moving = PMF_R(0.5) * state->moving;
    real_t position = config->position_per_count *
                      (signed_count(state->travel) - PMF_R(0.5) * (real_t)state->change +
                       (config->process != 0U ? PMF_R(0.5) : PMF_R(0.0))); /* a count says "in the middle" */
    signal[PMF_INPUT] = state->moving * state->input_before;
    signal[PMF_DIRECTION] = direction;
    signal[PMF_MOVING] = state->moving;
    signal[PMF_FORWARD] = moving + half;
    signal[PMF_BACKWARD] = half - moving;
    signal[PMF_FORWARD_VELOCITY] = direction > PMF_R(0.0) ? state->mean_velocity : PMF_R(0.0);
    signal[PMF_BACKWARD_VELOCITY] = direction > PMF_R(0.0) ? PMF_R(0.0) : state->mean_velocity;
    signal[PMF_LATE_POSITION] = position;
    signal[PMF_POSITION] = state->moving * position;
    signal[PMF_LATE_INPUT] = state->input_before;
    signal[PMF_LATE_VELOCITY] = state->mean_velocity;
    signal[PMF_ONE] = PMF_R(1.0);
    signal[PMF_START] = state->started == 1 ? PMF_R(1.0) : PMF_R(0.0);
}

uint32_t pmf_encoder_step(const pmf_encoder_config_t *config, pmf_encoder_state_t *state, real_t input,
                          uint32_t count, real_t *signal)
{
    int32_t change = state->started != 0 ? count_change(config->count_mask, count, state->count) : 0;
    uint32_t status = check(config, state, &input, &change);
    int32_t fast = next_fast(state->fast, magnitude(change));
    /* Position of the axis within the new count, in counts; a count says "in the middle". */
    real_t predicted = state->started != 0 ? state->position + state->velocity - (real_t)change : PMF_R(0.5);
    real_t innovation = PMF_R(0.5) - predicted;

    emit(config, state, state->moving * late_direction(config, state, innovation, fast, state->velocity_before), signal);
    signal[PMF_VELOCITY] = config->velocity_per_count * (real_t)change;

    track(config, state, innovation, predicted);
    status |= note_motion(config, state, change);
    state->mean_velocity = signal[PMF_VELOCITY];
    state->change = change;
    if (state->started == 0 && config->process != 0U) {
        state->travel = (uint32_t)count_change(config->count_mask, count, 0U);
    }
    state->travel += (uint32_t)change;
    state->count = count;
    state->started += state->started < 2 ? 1 : 0;
    state->fast = fast;
    state->input_before = state->input;
    state->input = input;
    return status;
}
