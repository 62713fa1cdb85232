/* Counts to velocity, direction and standstill.
 * SPDX-License-Identifier: Apache-2.0
 *
 * With several counts per sample, the velocities at both ends of an interval give the instant of a reversal inside
 * it. A tracker of piecewise constant acceleration estimates these velocities (Kalata 1984, fixed gains, smoothed by
 * one step). With less than two counts per sample the tracker would only follow the staircase. In slow motion the last
 * count therefore gives the direction. */
#include "pmf_internal.h"

#include "pmf_misread.inl"

static const uint32_t FAST_COUNTS = 2U; /* counts in one sample above which the tracker is trusted */
static const scalar_t FAST_SPEED = PMF_SCALAR(2.0); /* counts in one sample period above which the tracker is trusted */
static const uint32_t CLOSE = 3U;
/* Gains of the tracker and of its smoother. */
typedef struct {
    real_t position_gain, velocity_gain, smooth_end, smooth_start;
    real_t smooth_before; /* smooth_end of the preceding sample */
} gains_t;

static whole_t magnitude(integer_t x)
{
    return PMF_IF(x < 0, PMF_W(0) - (whole_t)x, (whole_t)x);
}

/* Return the signed moving fraction of an interval from the velocities at its start and end. */
static real_t signed_fraction(real_t start, real_t end)
{
    real_t sum = start + end, fraction = PMF_IF(sum < PMF_R(0.0), PMF_R(-1.0), PMF_R(1.0));
    truth_t reversal = (start < PMF_R(0.0)) != (end < PMF_R(0.0));
    if (PMF_ANY(reversal)) {
        real_t span = PMF_IF(start < end, end - start, start - end);
        fraction = PMF_IF(reversal, PMF_IF(span > PMF_R(0.0), sum / span, PMF_R(0.0)), fraction);
    }
    return fraction;
}

/* Return the direction of the interval before the last, from the tracker or from the last count. */
static real_t late_direction(const gains_t *gains, const pmf_encoder_state_t *state, real_t innovation, whole_t fast,
                             real_t velocity_two_before)
{
    truth_t slow = (fast == 0) & (state->fast == 0);
    real_t end, start;
    if (PMF_ALL(slow)) {
        return state->direction;
    }
    end = state->velocity + gains->smooth_end * innovation;
    start = velocity_two_before + gains->smooth_before * state->innovation + gains->smooth_start * innovation;
    return PMF_IF(slow, state->direction, signed_fraction(start, end));
}

/* A short step has few counts even in fast motion. `ticks` is the last step in the unit of pauses. */
static whole_t next_fast(const pmf_encoder_config_t *config, const pmf_encoder_state_t *state, whole_t counts,
                         uint32_t ticks)
{
    real_t speed = PMF_SAMPLE(config) != 1U ? state->velocity : PMF_R(0.0);
    truth_t fast = (counts >= FAST_COUNTS) | (speed > FAST_SPEED) | (speed < -FAST_SPEED);
    (void)config; /* only a varying step needs it */
    return PMF_IF(fast, PMF_W(PMF_FAST_SAMPLES * PMF_SAMPLE(config)),
                  PMF_IF(state->fast > ticks, state->fast - ticks, PMF_W(0)));
}

/* Count the pauses between counts. A pause much longer than the recent ones is a standstill. If counts came at least
 * every CLOSE samples, a pause of one further sample is a standstill. With a coarser encoder the pause may be a slow
 * reversal, which takes longer with larger counts. */
static whole_t note_motion(const pmf_encoder_config_t *config, pmf_encoder_state_t *state, integer_t change,
                           uint32_t ticks)
{
    uint32_t still = config->standstill_samples;
    truth_t counted = change != 0, rest = PMF_NOT(counted);
    whole_t passed = PMF_W(ticks);
    if (PMF_SAMPLE(config) != 1U) {
        whole_t left = still - state->idle;
        passed = PMF_IF(left < ticks, left, passed);
    }
    if (PMF_ANY(counted)) {
        whole_t leaked = state->gap - ((state->gap >> 2) & ~(PMF_SAMPLE(config) - 1U)), pause = state->idle + passed;
        state->gap = PMF_IF(counted, PMF_IF(pause > leaked, pause, leaked), state->gap);
        state->direction = PMF_IF(counted, PMF_IF(change > 0, PMF_R(1.0), PMF_R(-1.0)), state->direction);
        state->moving = PMF_IF(counted, PMF_R(1.0), state->moving);
        state->idle = PMF_IF(counted, PMF_W(0), state->idle);
    }
    if (PMF_PROCESS && config->process != 0U) { /* a process may be constant without a standstill */
        return PMF_W(0);
    }
    if (PMF_ANY(rest)) {
        whole_t limit = PMF_IF(state->gap < (CLOSE + 1U) * PMF_SAMPLE(config), state->gap + PMF_SAMPLE(config),
                               4U * state->gap + 2U * PMF_SAMPLE(config));
        state->idle += PMF_IF(rest & (state->idle < still), passed, PMF_W(0));
        rest = rest & ((state->idle >= still) | (state->idle > limit));
        state->direction = PMF_IF(rest, PMF_R(0.0), state->direction);
        state->moving = PMF_IF(rest, PMF_R(0.0), state->moving);
    }
    return PMF_BIT(rest, PMF_STANDSTILL);
}

static void track(const gains_t *gains, pmf_encoder_state_t *state, real_t innovation, real_t predicted)
{
    state->velocity_before = state->velocity;
    state->position = predicted + gains->position_gain * innovation;
    state->velocity += gains->velocity_gain * innovation;
    state->innovation = innovation;
}

/* Check the sample without knowledge of the motion. An error lets the filters settle again. */
static whole_t check(const pmf_encoder_config_t *config, const pmf_encoder_state_t *state, real_t *input,
                     integer_t *change, whole_t *counts)
{
    truth_t invalid = PMF_NOT(*input * *input <=
                              PMF_LARGEST_INPUT *
                                  PMF_LARGEST_INPUT); /* the input is NaN, or the square of the input may be infinite */
    whole_t status = PMF_W(0);
    if (PMF_ANY(invalid)) {
        *input = PMF_IF(invalid, state->input, *input);
        status |= PMF_BIT(invalid, PMF_INVALID_INPUT | PMF_SETTLING);
    }
    if (config->max_change > 0U) {
        truth_t jump = *counts > config->max_change;
        *change = PMF_IF(jump, 0, *change);
        *counts = PMF_IF(jump, PMF_W(0), *counts);
        status |= PMF_BIT(jump, PMF_COUNT_JUMP | PMF_SETTLING);
    }
    return status;
}

/* Write the signals of the interval before the last. */
static void emit_interval(const pmf_encoder_config_t *config, const pmf_encoder_state_t *state, real_t direction,
                          real_t *signal)
{
    real_t half = PMF_R(0.5) * direction, moving = PMF_R(0.5) * state->moving;
    real_t middle = PMF_TO_REAL(pmf_signed(0xffffffffU, state->travel)) - PMF_R(0.5) * PMF_TO_REAL(state->change);
    signal[PMF_INPUT] = state->moving * state->input_before;
    signal[PMF_DIRECTION] = direction;
    if (PMF_PROCESS && config->process != 0U) {
        middle += PMF_R(0.5); /* a count stands for the middle of its interval */
        signal[PMF_ONE] = PMF_R(1.0);
        signal[PMF_START] = PMF_IF(state->started == 1U, PMF_R(1.0), PMF_R(0.0));
    }
    if (PMF_SPLIT) {
        signal[PMF_MOVING] = state->moving;
        signal[PMF_FORWARD] = moving + half;
        signal[PMF_BACKWARD] = half - moving;
        signal[PMF_FORWARD_VELOCITY] = PMF_IF(direction > PMF_R(0.0), state->mean_velocity, PMF_R(0.0));
        signal[PMF_BACKWARD_VELOCITY] = PMF_IF(direction > PMF_R(0.0), PMF_R(0.0), state->mean_velocity);
        signal[PMF_LATE_POSITION] = config->position_per_count * middle;
        signal[PMF_POSITION] = state->moving * signal[PMF_LATE_POSITION];
        signal[PMF_LATE_INPUT] = state->input_before;
        signal[PMF_LATE_VELOCITY] = state->mean_velocity;
    }
}

/* Set the constant gains. */
static void keep_gains(const pmf_encoder_config_t *config, gains_t *gains)
{
    gains->position_gain = PMF_ALIKE(config->position_gain);
    gains->velocity_gain = PMF_ALIKE(config->velocity_gain);
    gains->smooth_before = gains->smooth_end = PMF_ALIKE(config->smooth_end);
    gains->smooth_start = PMF_ALIKE(config->smooth_start);
}

#if PMF_STEPS
/* Return the step of this interval over the sample period. */
static real_t ratio_of(pmf_encoder_state_t *state, whole_t *status)
{
    if (!(state->ratio > PMF_R(0.0))) {
        state->ratio = PMF_R(1.0);
        *status |= PMF_INVALID_INPUT | PMF_SETTLING;
    }
    return state->ratio;
}

/* Return the last step in the unit of pauses. */
static uint32_t ticks_of(real_t ratio)
{
    return (uint32_t)((real_t)PMF_TICKS * ratio + PMF_R(0.5));
}

/* Set the gains of a Kalman filter for an acceleration that is constant within each step, and of its smoother by one
 * sample. */
static void set_gains(const pmf_encoder_config_t *config, pmf_tracker_t *tracker, real_t ratio, gains_t *gains)
{
    real_t half = PMF_R(0.5) * ratio, pushed = config->push * ratio * ratio, pulled = half * pushed;
    real_t carried =
        tracker->cross + ratio * tracker->speed; /* covariance of the earlier velocity with the present position */
    real_t place = tracker->place + ratio * (tracker->cross + carried) + half * pulled, cross = carried + pulled;
    real_t inverse = PMF_R(1.0) / (place + PMF_R(1.0));
    gains->position_gain = place * inverse;
    gains->velocity_gain = cross * inverse;
    gains->smooth_before = tracker->start_place;
    gains->smooth_end = carried * inverse;
    gains->smooth_start = (tracker->start_place + ratio * tracker->start_speed) * inverse;
    tracker->start_place = gains->smooth_end;
    tracker->start_speed = tracker->speed - carried * gains->velocity_gain;
    tracker->speed += pushed - gains->velocity_gain * cross;
    tracker->place = gains->position_gain;
    tracker->cross = gains->velocity_gain;
}

/* A reversal at the fraction x of an interval h changes the acceleration. Like a jerk, a reversal makes the mean
 * velocity differ from the mean of both ends, by 6 x (1 - x) = 1.5 (1 - direction^2) times a jerk's effect. */
static real_t late_turn(const pmf_encoder_state_t *state, real_t direction, real_t velocity)
{
    real_t turn = PMF_R(1.0) - direction * direction;
    if (turn == PMF_R(0.0)) {
        return turn;
    }
    turn *= PMF_R(3.0) * state->ratio_before * state->moving;
    return velocity < PMF_R(0.0) ? -turn : turn;
}

/* Set ratio, ticks and gains for the step of this interval. */
static void follow_step(const pmf_encoder_config_t *config, pmf_encoder_state_t *state, real_t *ratio, uint32_t *ticks,
                        gains_t *gains, whole_t *status)
{
    if (PMF_STEPPED(config->rate > PMF_R(0.0))) {
        *ratio = ratio_of(state, status);
        *ticks = ticks_of(*ratio);
        set_gains(config, &state->tracker, *ratio, gains);
    }
}

static void emit_turn(const pmf_encoder_config_t *config, const pmf_encoder_state_t *state, real_t *signal)
{
    (void)config; /* an export has the answer as a constant */
    if (PMF_TURNED(config) != 0U) {
        signal[PMF_TURN] = late_turn(state, signal[PMF_DIRECTION], state->velocity);
    }
}
#else
#define follow_step(config, state, ratio, ticks, gains, status) ((void)(ticks))
#define emit_turn(config, state, signal) ((void)(signal))
#endif

PMF_FOR_SIZE PMF_API whole_t pmf_encoder_step(const pmf_encoder_config_t *config, pmf_encoder_state_t *state,
                                              real_t input, whole_t count, real_t *signal)
{
    uint32_t mask = config->count_mask;
    truth_t started = state->started != 0U;
    integer_t change = PMF_IF(started, pmf_signed(mask, (count - state->count) & mask), 0);
    whole_t counts = magnitude(change), status = check(config, state, &input, &change, &counts), fast;
    real_t changed, predicted, innovation, ratio = PMF_R(1.0), direction = state->direction;
    truth_t moved = state->moving > PMF_R(0.0);
    uint32_t ticks = 1U; /* the last step in the unit of pauses */
    gains_t gains;
    keep_gains(config, &gains);
    follow_step(config, state, &ratio, &ticks, &gains, &status);
    state->count = count;
    fast = next_fast(config, state, counts, ticks);
    /* Position of the axis within the new count, in counts. A count stands for the middle of its interval. */
    changed = PMF_TO_REAL(change);
    predicted = PMF_IF(started, state->position + state->velocity * ratio - changed, PMF_R(0.5));
    innovation = PMF_R(0.5) - predicted;

    emit_interval(config, state,
                  state->moving * late_direction(&gains, state, innovation, fast, state->velocity_before), signal);
    emit_turn(config, state, signal);
    signal[PMF_VELOCITY] = config->velocity_per_count * changed / ratio;

    track(&gains, state, innovation, predicted);
    status |= note_motion(config, state, change, ticks);
    if (PMF_WITH_MISREAD && config->misread != 0U) {
        emit_misread(state, change, moved, direction, (fast > 0U) | (state->fast > 0U), signal);
    }
    state->mean_velocity = signal[PMF_VELOCITY];
    if (PMF_WITH_SPLIT) {
        state->change = change;
        state->travel = (state->travel + (whole_t)change) & 0xffffffffU;
    }
    state->started = PMF_W(1);
    if (PMF_PROCESS && config->process != 0U) {
        state->first = PMF_IF(started, state->first, pmf_signed(mask, count & mask));
        if (config->from_first == 0U) {
            state->travel = PMF_IF(started, state->travel, (whole_t)state->first & 0xffffffffU);
        }
        state->started = PMF_IF(started, PMF_W(2), PMF_W(1));
    }
    state->fast = fast;
    state->input_before = state->input;
    state->input = input;
    return status;
}
