/* The guard holds samples back until the next PMF_AHEAD counts show which of them no motion explains.
 * SPDX-License-Identifier: Apache-2.0
 *
 * pmf_outlier.c judges the counts, for one axis. Nearly all counts continue the motion before them, or belong to a
 * view that is smooth as a whole. Lanes know this from second differences alone, and judge only the other counts one
 * by one. The guard keeps no limits. A wrong count changes nothing but its own sample.
 *
 * An input far beyond its neighbours is replaced by the preceding one, unless the counts answer to it. */
#include "pmf_outlier.h"
#include "pmf_internal.h"

static const scalar_t SMOOTH = PMF_SCALAR(3.2); /* FIRST of pmf_outlier.c */
static const scalar_t ROUNDING = PMF_SCALAR(2.0); /* second difference of counts in a steady motion */
static const scalar_t SPIKE = PMF_SCALAR(8.0); /* ratio of an input to its neighbours, above which counts must answer */
static const uint32_t LATER = PMF_PAST + PMF_AHEAD - 3U; /* as in pmf_outlier.c */
static const uint32_t FAR = 0x20000000U; /* counts that are further apart are wrong in any case */

static real_t larger(real_t a, real_t b)
{
    return PMF_IF(a > b, a, b);
}

/* Return the second difference with its middle at a place. */
static real_t signed_bend(const pmf_encoder_config_t *config, const pmf_guard_state_t *guard, uint32_t place)
{
    uint32_t mask = config->count_mask;
    whole_t here = guard->count[place], size = guard->count[place + 1U] - here - here + guard->count[place - 1U];
    return PMF_TO_REAL(pmf_signed(mask, size & mask));
}

static real_t bend(const pmf_encoder_config_t *config, const pmf_guard_state_t *guard, uint32_t place)
{
    return PMF_SIZE(signed_bend(config, guard, place));
}

/* Return the largest second difference whose middle is one of the counts from `first` to `last`, at least ROUNDING. */
static real_t roughness(const pmf_encoder_config_t *config, const pmf_guard_state_t *guard, uint32_t first,
                        uint32_t last)
{
    real_t most = PMF_ALIKE(ROUNDING);
    uint32_t place;
    for (place = first; place <= last; ++place) {
        most = larger(bend(config, guard, place), most);
    }
    return most;
}

/* Return the acceleration of a second difference without the part that rounding explains. */
static real_t beyond_rounding(real_t size)
{
    return PMF_IF(size > ROUNDING, size - PMF_R(1.0), PMF_R(0.0));
}

/* Return whether the highest speed allows the change to the judged count. */
static truth_t is_slow(const pmf_encoder_config_t *config, const pmf_guard_state_t *guard)
{
    uint32_t mask = config->count_mask;
    real_t size =
        PMF_SIZE(PMF_TO_REAL(pmf_signed(mask, (guard->count[PMF_PAST] - guard->count[PMF_PAST - 1U]) & mask)));
    return size <= PMF_ALIKE((scalar_t)config->max_change);
}

/* Return the least of the three second differences from a place on, without the part that rounding explains, or 0
 * unless all of them have the sign of `sign`. */
static real_t lasting_bend(const pmf_encoder_config_t *config, const pmf_guard_state_t *guard, uint32_t first,
                           real_t sign)
{
    real_t least = sign * signed_bend(config, guard, first);
    uint32_t place;
    for (place = first + 1U; place <= first + 2U; ++place) {
        real_t here = sign * signed_bend(config, guard, place);
        least = PMF_IF(here < least, here, least);
    }
    return beyond_rounding(least);
}

/* Return whether the judged count continues the counts before it, or the motion around it is as smooth as the motion
 * before and after, or the acceleration around it lasts. Most counts continue a steady motion. A wrong count always
 * shows accelerations of both signs, of which only one can last. Without enough counts before, a later acceleration
 * that lasts is the one before and after. */
static truth_t is_smooth(const pmf_encoder_config_t *config, const pmf_guard_state_t *guard)
{
    real_t size = bend(config, guard, PMF_PAST - 1U), past, limit, up, down;
    truth_t whole = guard->past == PMF_PAST, plain = whole & (size <= ROUNDING), within;
    uint32_t place;
    if (PMF_ALL(plain)) {
        return plain;
    }
    past = roughness(config, guard, 1U, PMF_PAST - 2U);
    plain = whole & (size <= past);
    if (PMF_ALL(plain)) {
        return plain;
    }
    limit = roughness(config, guard, LATER, LATER + 2U);
    limit = beyond_rounding(PMF_IF(past < limit, past, limit));
    if (!PMF_ALL(whole)) {
        up = lasting_bend(config, guard, LATER, PMF_R(1.0));
        down = lasting_bend(config, guard, LATER, PMF_R(-1.0));
        limit = PMF_IF(whole, limit, larger(up, down));
    }
    limit = larger(limit, PMF_R(1.0));
    up = SMOOTH * larger(lasting_bend(config, guard, PMF_PAST + 2U, PMF_R(1.0)), limit);
    down = SMOOTH * larger(lasting_bend(config, guard, PMF_PAST + 2U, PMF_R(-1.0)), limit);
    within = whole | PMF_NOT(whole);
    for (place = PMF_PAST - 1U; place <= PMF_PAST + 2U; ++place) {
        real_t here = signed_bend(config, guard, place);
        truth_t absent = guard->past + place <= PMF_PAST, rises = beyond_rounding(here) <= up;
        truth_t falls = beyond_rounding(-here) <= down;
        within = within & (absent | (rises & falls));
    }
    return plain | within;
}

/* Gather the view of a lane. Counts modulo mask + 1 are those next to a steady motion from the count before. */
PMF_SELDOM void gather(const pmf_encoder_config_t *config, const pmf_guard_state_t *guard, uint32_t lane,
                       pmf_view_t *view)
{
    uint32_t mask = config->count_mask, i, past = (uint32_t)PMF_LANE(guard->past, lane);
    uint32_t base = (uint32_t)PMF_LANE(guard->count[past > 0U ? PMF_PAST - 1U : (uint32_t)PMF_PAST], lane), steady = 0U;
    if (past >= 2U) {
        uint32_t change = (base - (uint32_t)PMF_LANE(guard->count[PMF_PAST - 2U], lane)) & mask;
        steady = change <= mask >> 1 ? change : change - mask - 1U;
    }
    for (i = 0; i < PMF_PAST + PMF_VIEW; ++i) {
        uint32_t expected =
            i > PMF_PAST ? (uint32_t)view->count[i - 1U] + steady : steady * (i - (PMF_PAST - 1U)); /* modulo 2^32 */
        uint32_t apart = ((uint32_t)PMF_LANE(guard->count[i], lane) - base - expected) & mask, size;
        apart = (apart <= mask >> 1 ? apart : apart - mask - 1U) + expected;
        size = apart <= 0x7fffffffU ? apart : ~apart;
        size = size < FAR ? size : FAR + (size & (FAR - 1U)); /* counts beyond a shift keep the motion between them */
        view->count[i] = apart <= 0x7fffffffU ? (int32_t)size : -(int32_t)size - 1;
        view->time[i] = (scalar_t)i;
    }
    view->past = past;
    view->readings = PMF_VIEW;
    view->step = PMF_SCALAR(1.0);
    view->speed = (scalar_t)config->max_change;
    view->slack = PMF_SCALAR(0.0);
}

/* Judge the count of a lane, and return status bits. The count becomes that of the motion. */
PMF_SELDOM uint32_t judge_lane(const pmf_encoder_config_t *config, pmf_guard_state_t *guard, uint32_t lane)
{
    pmf_view_t view;
    pmf_verdict_t verdict;
    uint32_t base, i;
    gather(config, guard, lane, &view);
    pmf_judge(&view, &verdict);
    if (verdict.verdict == PMF_READING_FITS) {
        return verdict.unsure * (uint32_t)PMF_SETTLING;
    }
    base = (uint32_t)PMF_LANE(guard->count[view.past > 0U ? PMF_PAST - 1U : (uint32_t)PMF_PAST], lane);
    if (verdict.verdict == PMF_ZERO_MOVED) {
        uint32_t moved = (uint32_t)PMF_LANE(guard->count[verdict.first], lane) - (base + (uint32_t)verdict.end);
        for (i = PMF_PAST; i < PMF_PAST + PMF_VIEW; ++i) {
            PMF_LANE(guard->count[i], lane) = (uint32_t)PMF_LANE(guard->count[i], lane) - moved;
        }
        PMF_LANE(guard->zero, lane) = (uint32_t)PMF_LANE(guard->zero, lane) + moved;
    }
    PMF_LANE(guard->count[PMF_PAST], lane) = base + (uint32_t)verdict.count;
    return (uint32_t)PMF_COUNT_JUMP | verdict.unsure * (uint32_t)PMF_SETTLING;
}

/* Judge the counts that are not obviously right. */
static whole_t judge_counts(const pmf_encoder_config_t *config, pmf_guard_state_t *guard, truth_t ready)
{
    truth_t doubtful = ready & PMF_NOT(is_smooth(config, guard));
    whole_t status = PMF_W(0);
    uint32_t lane;
    if (config->max_change != 0U) {
        doubtful = doubtful | (ready & PMF_NOT(is_slow(config, guard)));
    }
    if (PMF_ANY(doubtful)) {
        for (lane = 0; lane < PMF_WIDTH; ++lane) {
            if (PMF_LANE(doubtful, lane) != 0) {
                PMF_LANE(status, lane) = judge_lane(config, guard, lane);
            }
        }
    }
    return status;
}

/* Judge the input of the judged sample. An input acts on the two second differences around the next count. */
static whole_t judge_input(const pmf_encoder_config_t *config, pmf_guard_state_t *guard, truth_t ready, real_t held)
{
    real_t most = PMF_SIZE(held), size = PMF_SIZE(guard->input[0]), answer, other;
    truth_t spike = ready & (size > SPIKE * most) & (size <= PMF_LARGEST_INPUT); /* the encoder flags larger inputs */
    uint32_t i;
    if (!PMF_ANY(spike)) {
        return PMF_W(0);
    }
    for (i = 1U; i < PMF_VIEW; ++i) {
        real_t next = PMF_SIZE(guard->input[i]);
        most = PMF_IF((next > most) & (next <= PMF_LARGEST_INPUT), next, most);
    }
    spike = spike & (size > SPIKE * most);
    answer = roughness(config, guard, PMF_PAST, PMF_PAST + 1U);
    other = roughness(config, guard, PMF_PAST + 2U, PMF_PAST + PMF_AHEAD - 1U);
    answer = PMF_IF(answer > other, answer, PMF_R(0.0));
    other = roughness(config, guard, 1U, PMF_PAST - 1U);
    spike = spike & PMF_NOT((guard->past == PMF_PAST) & (answer > other));
    guard->input[0] = PMF_IF(spike, held, guard->input[0]);
    return PMF_BIT(spike, PMF_INVALID_INPUT);
}

static void push(pmf_guard_state_t *guard, real_t input, whole_t count)
{
    truth_t invalid = PMF_NOT(input * input <= PMF_LARGEST_INPUT * PMF_LARGEST_INPUT);
    uint32_t i;
    input = PMF_IF(invalid, PMF_R(2.0) * PMF_LARGEST_INPUT, input);
    count = (count - guard->zero) & 0xffffffffU;
    if (PMF_ALL(guard->readings == PMF_AHEAD)) {
        guard->input[PMF_AHEAD] = input;
        guard->count[PMF_PAST + PMF_AHEAD] = count;
    } else {
        for (i = 0; i < PMF_VIEW; ++i) {
            guard->input[i] = PMF_IF(guard->readings == i, input, guard->input[i]);
            guard->count[PMF_PAST + i] = PMF_IF(guard->readings == i, count, guard->count[PMF_PAST + i]);
        }
    }
    guard->readings += 1U;
}

/* Make the judged sample the last accepted one. */
static void shift(pmf_guard_state_t *guard)
{
    whole_t count = guard->count[PMF_PAST + PMF_VIEW - 1U];
    real_t input = guard->input[PMF_VIEW - 1U];
    uint32_t i;
    for (i = PMF_PAST + PMF_VIEW - 1U; i-- > 0U;) { /* downwards, a compiler makes no call of memmove of the loop */
        whole_t moved = guard->count[i];
        guard->count[i] = count;
        count = moved;
    }
    for (i = PMF_VIEW - 1U; i-- > 0U;) {
        real_t moved = guard->input[i];
        guard->input[i] = input;
        input = moved;
    }
    guard->readings -= 1U;
    guard->past += PMF_BIT(guard->past < PMF_PAST, 1U);
}

/* Take a sample, and return whether an earlier one is judged. This sample replaces `input` and `count`, and `status`
 * gets its status bits. `held` is the input before it. */
PMF_FOR_SIZE static truth_t take_sample(const pmf_encoder_config_t *config, pmf_guard_state_t *guard, real_t held,
                                        real_t *input, whole_t *count, whole_t *status)
{
    truth_t ready;
    push(guard, *input, *count);
    ready = guard->readings == PMF_VIEW;
    *status = PMF_W(0);
    if (PMF_ANY(ready)) {
        *status = judge_counts(config, guard, ready);
        *status |= judge_input(config, guard, ready, held);
        *input = guard->input[0];
        *count = guard->count[PMF_PAST] & 0xffffffffU;
        PMF_WHERE(ready, guard, shift(guard));
    }
    return ready;
}

PMF_API truth_t pmf_guard_sample(const pmf_config_t *config, pmf_state_t *state, real_t *input, whole_t *count,
                                 whole_t *guarded)
{
    truth_t ready = take_sample(&config->encoder, &state->guard, state->encoder.input, input, count, guarded), unsure;
    unsure = (*guarded & PMF_SETTLING) != 0U;
    if (PMF_ANY(unsure)) {
        state->hold = PMF_IF(unsure, PMF_W(config->settle_samples), state->hold);
    }
    return ready;
}

#if PMF_WHOLE /* for one axis */
void pmf_guard_gap(pmf_state_t *state)
{
    pmf_clear(&state->guard, (uint32_t)sizeof state->guard);
}

uint32_t pmf_guard_rebase(pmf_state_t *state, uint32_t count)
{
    pmf_guard_state_t *guard = &state->guard;
    if (guard->readings > 0U) {
        guard->zero = count - guard->count[PMF_PAST + guard->readings - 1U];
    }
    return guard->readings;
}

uint32_t pmf_guard_plausible(const pmf_state_t *state)
{
    const pmf_guard_state_t *guard = &state->guard;
    uint32_t i, fine = guard->past <= PMF_PAST && guard->readings <= PMF_AHEAD ? 1U : 0U;
    for (i = 0; i < PMF_VIEW; ++i) {
        fine &= PMF_SIZE(guard->input[i]) <= PMF_R(2.0) * PMF_LARGEST_INPUT ? 1U : 0U;
    }
    return fine;
}
#endif
