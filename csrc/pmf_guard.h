/* Samples that no motion explains: a counter set anew, a wrong reading, a spike of the input. For pmf_encoder.c alone,
 * which see. SPDX-License-Identifier: Apache-2.0
 *
 * A change of the counts is predicted from the last one, from how that had changed, and from what the input does. What
 * predictions missed by so far, as a leaking maximum, says what a motion may do; at rest, and with an input larger than
 * any lately, in proportion to the input. A change beyond that is left out and the predicted one taken in its place.
 * The next sample says what it was: it changes as predicted: the counter was set anew, its zero has moved and all goes
 * on; it comes back: a wrong reading, and what was missed meanwhile came evenly over the samples since the last good
 * one; it goes on from the suspicious one, and so does the third: a blow, say, so what was held back is added, nothing
 * is lost, and the filters settle again, for it did not come all at once. An input far beyond the largest one lately is
 * judged before the filters get it, two samples later: by then the counts have answered, or it has stayed; else the
 * last one counts in its place. Nothing here touches a sample that is not suspicious.
 *
 * A wrong count that is smaller than the limit is believed; the next one then misses by three times as much, the other
 * way, and comes back to the motion before both: the first one is taken out of what is foreseen, and the filters
 * settle. Wrong counts must not widen the limit, or each lets a larger one in. So what swings back is no lesson, nor is
 * anything within CALM samples after a suspicious one, and a lesson that a suspicion follows is taken back.
 *
 * While it learns, all but the wildest is believed. Motion is missed the same way, sample after sample, until it is
 * followed; a wrong count J by J, -3 J, 3 J, -J. So what motion alone explains is the largest miss without a neighbour
 * that goes back. Where the limit is far beyond that, or a believed count is found wrong, the estimator begins again.
 */
#ifndef PMF_GUARD_H
#define PMF_GUARD_H

#include "pmf_internal.h"

#if PMF_WITH_GUARD

#define FIRST_SAMPLES 4U /* a record may begin in motion */
#define STEP PMF_R(4.0) /* by which the encoder's step alone spoils a prediction */
#define NOISE PMF_R(2.0) /* of a second difference of counts */
#define REST_EDGE PMF_R(6.0) /* less than that is never suspicious: at rest */
#define MOTION_EDGE PMF_R(8.0) /* and in motion */
#define CAUTION PMF_R(3.0) /* times what was missed so far */
#define EARLY_CAUTION PMF_R(30.0) /* while little is known */
#define EARLY_SPIKE PMF_R(1e6) /* times the largest input */
#define PEAK_MARGIN PMF_R(1.25) /* times the leaking peak: else an input that stays would move it in every sample */
#define NEW_SIZE PMF_R(2.0) /* times the peak: what a motion may do grows with such an input, at most by */
#define LARGEST_GROWTH PMF_R(100.0)
#define SWINGS PMF_R(0.25) /* part of the largest input: less of a change says little of its effect */
#define GAIN_STEP PMF_R(0.03125) /* of the normalised gradient */
#define LEAST_PEAK PMF_R(1e-12) /* of an input that is one: its inverse squared is a number */
#define LARGEST_RATE PMF_R(1e9) /* of a predicted change: it has to fit an integer */
#define ANY_SHARE PMF_R(1e20)
#define LESSON PMF_R(0.125) /* part of an excess that counts, once it has learned */
#define LARGEST_SWING PMF_R(5.1) /* times the last miss, backwards: a wrong count may do that */
#define SPOILT_BAND PMF_R(0.7) /* of what a wrong count spoils; else the next one is rather wrong */
#define GOES_ON PMF_R(0.3) /* from sample to sample a blow differs by less */
#define LARGEST_BLOW PMF_R(100.0) /* times the scatter */
#define BACKWARDS PMF_R(0.25) /* of a miss: a neighbour so large, the other way, comes with a wrong count */
#define DOUBTFUL PMF_R(3.0) /* times what motion alone explains */
#define LOOKED_AT(config) \
    ((config)->guard + PMF_GUARD_SOUND) /* the last lessons are, when the next samples are there */
#define CALM(config) ((config)->guard >> 3) /* samples after a suspicious one that teach nothing */

static integer_t signed_count(uint32_t mask, whole_t count); /* of pmf_encoder.c */

static real_t size_of(real_t x)
{
    return PMF_IF(x < PMF_R(0.0), -x, x);
}

/* From a sample that is believed. Once it has learned, nothing that may come of a wrong count is a lesson: that is
 * missed by J, -3 J, 3 J, -J, and wrong ones come in flocks. */
PMF_SELDOM void learn_scatter(const pmf_encoder_config_t *config, pmf_guard_state_t *guard, truth_t where,
                              real_t missed)
{
    real_t excess = size_of(missed) - (guard->scatter + STEP);
    truth_t learned = guard->seen >= config->guard;
    truth_t swings = (missed * guard->missed < PMF_R(0.0)) & (size_of(missed) < LARGEST_SWING * size_of(guard->missed));
    where = where & (excess > PMF_R(0.0)) & (guard->doubt == 0U) & (guard->seen >= FIRST_SAMPLES) &
            PMF_NOT(learned & (swings | (guard->wait > 0U)));
    excess = PMF_IF(learned, LESSON * excess, excess);
    guard->lesson = PMF_IF(where, excess, guard->lesson);
    guard->scatter = PMF_IF(where, guard->scatter + excess, guard->scatter);
}

/* A suspicion begins: what was learned from a sample just before was no lesson. */
PMF_SELDOM void begin_suspicion(pmf_guard_state_t *guard, truth_t where, real_t last)
{
    truth_t fresh = where & ((guard->wait > 0U) | (size_of(guard->missed) > guard->scatter + STEP));
    guard->scatter -= PMF_IF(fresh & (guard->lesson < guard->scatter), guard->lesson, PMF_R(0.0));
    guard->lesson = PMF_IF(where, PMF_R(0.0), guard->lesson);
    guard->last = PMF_IF(where, last, guard->last);
}

/* By how much the last count was missed that was believed at once. */
PMF_SELDOM real_t last_miss(const pmf_encoder_config_t *config, const pmf_guard_state_t *guard, truth_t suspected)
{
    whole_t wait = guard->wait + 1U;
    truth_t judged = (wait == CALM(config)) | (wait == 2U * CALM(config));
#if PMF_PROCESS
    if (config->process != 0U) { /* its output may step there and back */
        return PMF_R(0.0);
    }
#endif
    return PMF_IF(suspected, guard->last, PMF_IF(judged, PMF_R(0.0), guard->missed));
}

/* What an input does, from a sample that nobody doubts. */
PMF_SELDOM void learn_gain(pmf_guard_state_t *guard, truth_t where, real_t swing, real_t missed)
{
    real_t gain = guard->gain + GAIN_STEP * missed * (swing / guard->peak) / guard->peak;
    where = where & (guard->peak > LEAST_PEAK) & (guard->seen >= FIRST_SAMPLES);
    guard->gain = PMF_IF(where, gain, guard->gain);
}

/* By how much a prediction may miss; `open`: by anything, for nothing is known yet. */
static real_t limit_of(const pmf_encoder_config_t *config, const pmf_encoder_state_t *state, truth_t *open)
{
    const pmf_guard_state_t *guard = &state->guard;
    truth_t learned = guard->seen >= config->guard, moves = state->moving > PMF_R(0.0);
    real_t last = size_of(state->input), reach = size_of(state->input_before), share;
    truth_t missed;
    reach = PMF_IF(last > reach, last, reach);
    share = PMF_IF(guard->peak > LEAST_PEAK, reach / guard->peak, PMF_IF(reach > PMF_R(0.0), ANY_SHARE, PMF_R(0.0)));
#if PMF_PROCESS
    if (config->process !=
        0U) { /* its output is no motion: it may step by right, so only what it never did is suspicious */
        *open = PMF_NOT(learned | (guard->seen > config->guard >> 3));
        return REST_EDGE + EARLY_CAUTION * (guard->scatter + STEP) * PMF_IF(share < PMF_R(1.0), PMF_R(1.0), share);
    }
#endif
    missed = learned | (guard->scatter > PMF_R(0.0)); /* or a smooth motion, of which all was foreseen */
    *open = (guard->seen < FIRST_SAMPLES) |
            (PMF_NOT(missed | (guard->seen > config->guard >> 3)) & (moves | (share > PMF_R(0.0))));
    last = guard->scatter + PMF_IF((share > NEW_SIZE) | PMF_NOT(missed), STEP, PMF_R(0.0));
    share = PMF_IF(moves & (share < PMF_R(1.0)), PMF_R(1.0), share);
    return PMF_IF(moves, MOTION_EDGE, REST_EDGE) + PMF_IF(learned, CAUTION, EARLY_CAUTION) * last * share;
}

PMF_SELDOM integer_t rounded(real_t x)
{
    x = PMF_IF(size_of(x) > LARGEST_RATE, PMF_R(0.0), x);
    return PMF_TO_INTEGER(x + PMF_IF(x < PMF_R(0.0), PMF_R(-0.5), PMF_R(0.5)));
}

PMF_SELDOM integer_t sum_of(integer_t a, integer_t b)
{
    return signed_count(0xffffffffU, ((whole_t)a + (whole_t)b) & 0xffffffffU);
}

/* The change that is foreseen. Two differences of counts may be two counts off. */
static integer_t foreseen_change(integer_t change, real_t rate)
{
    real_t sure = size_of(rate) - NOISE;
    sure = PMF_IF(sure > PMF_R(0.0), sure, PMF_R(0.0));
    return sum_of(change, rounded(PMF_IF(rate < PMF_R(0.0), -sure, sure)));
}

/* Two wrong readings in a row may look like the first two samples of a blow; a third one goes on only after a blow. */
PMF_SELDOM truth_t is_blow(const pmf_encoder_config_t *config, const pmf_guard_state_t *guard, real_t missed,
                           real_t pending, real_t limit)
{
    real_t before = guard->missed, most = PMF_R(2.0) * PMF_TO_REAL((integer_t)guard->suspect) * size_of(missed) + limit;
    truth_t third = guard->suspect > 1U;
#if PMF_PROCESS
    if (config->process != 0U) { /* its output may do anything */
        return (third & (size_of(missed - PMF_R(1.25) * before) <= PMF_R(0.75) * size_of(before) + limit)) |
               (guard->suspect > 2U);
    }
#endif
    (void)config;
    return third & (size_of(missed - before) <= GOES_ON * size_of(before) + limit) &
           (size_of(missed) < LARGEST_BLOW * (guard->scatter + STEP)) & (size_of(pending) <= most);
}

/* While it learns: a jump is missed by J and -2 J, a wrong reading by J and -3 J. Was that the largest so far? */
PMF_SELDOM truth_t was_wild(const pmf_encoder_config_t *config, const pmf_guard_state_t *guard, real_t missed)
{
    real_t first = guard->missed, size = size_of(first);
    truth_t wild = (size_of(missed + PMF_R(2.5) * first) <= PMF_R(0.75) * size) & (size > guard->scatter);
#if PMF_PROCESS
    if (config->process != 0U) { /* its output may step */
        return wild & PMF_NOT(wild);
    }
#endif
    return wild & (size > MOTION_EDGE) & (guard->seen < config->guard);
}

/* Motion misses the same way until it is followed; a miss beside one that goes back may come of a wrong count. What it
 * learned is doubtful if far more was missed than by motion: then wrong counts were believed, and estimates
 * have them. All begin again, the guard with what motion alone explains. */
static whole_t doubt_lessons(const pmf_encoder_config_t *config, pmf_guard_state_t *guard, truth_t looks, real_t miss,
                             real_t scatter, whole_t status)
{
    truth_t doubtful;
    truth_t jumped = ((status & PMF_COUNT_JUMP) != 0U) | (guard->suspect != 0U), lesson;
    real_t fair = size_of(miss) - STEP, least = -BACKWARDS * miss * miss;
#if PMF_PROCESS
    if (config->process != 0U) { /* its output may step */
        return PMF_W(0);
    }
#endif
    (void)config;
    guard->sound += PMF_BIT(looks & (guard->sound < PMF_GUARD_SOUND), 1U);
    guard->sound = PMF_IF(looks & jumped, PMF_W(0), guard->sound);
    lesson =
        looks & (guard->sound >= PMF_GUARD_SOUND) & (miss * guard->earlier >= least) & (miss * guard->missed >= least);
    guard->fair = PMF_IF(lesson & (fair > guard->fair), fair, guard->fair);
    guard->earlier = PMF_IF(looks, miss, guard->earlier);
    doubtful = looks & (scatter > DOUBTFUL * guard->fair + PMF_R(2.0) * STEP);
    guard->scatter = PMF_IF(doubtful, guard->fair, guard->scatter);
    guard->gain = PMF_IF(doubtful | ((status & PMF_BEGIN_AGAIN) != 0U), PMF_R(0.0), guard->gain);
    return PMF_BIT(doubtful, PMF_BEGIN_AGAIN);
}

/* What a wrong count taught would hide all others. It does not begin from the start: it might never end. */
PMF_SELDOM void learn_anew(pmf_guard_state_t *guard, truth_t where, real_t change)
{
    guard->scatter = PMF_IF(where, PMF_R(0.0), guard->scatter);
    guard->missed = PMF_IF(where, PMF_R(0.0), guard->missed);
    guard->sound = PMF_IF(where, PMF_W(0), guard->sound);
    guard->rate = PMF_IF(where, PMF_R(0.0), guard->rate);
    guard->change = PMF_IF(where, rounded(change), guard->change);
}

/* Decides on a change from the accepted count where it or one before is suspicious. A doubtful input counts as none. */
PMF_SELDOM whole_t judge_change(const pmf_encoder_config_t *config, pmf_encoder_state_t *state, whole_t count,
                                truth_t apart, integer_t *change)
{
    pmf_guard_state_t *guard = &state->guard;
    uint32_t mask = config->count_mask;
    truth_t suspected = guard->suspect != 0U, back, anew, real, sound, open, closes, wild, rough;
    integer_t read = PMF_IF(suspected, signed_count(mask, (count - guard->reading) & mask), *change), foreseen;
    real_t driven = PMF_IF((guard->doubt & 1U) == 0U, state->input,
                           PMF_IF((guard->doubt & 2U) == 0U, state->input_before, guard->held));
    real_t predicted = guard->rate + guard->gain * (driven - guard->held), before = PMF_TO_REAL(guard->change);
    real_t gap = PMF_TO_REAL((integer_t)guard->suspect);
    real_t part = PMF_TO_REAL(read) - before, whole = PMF_TO_REAL(*change) - before, pending = whole - part;
    real_t missed = part - predicted, missed_whole = whole - predicted, size = size_of(missed), most, limit, rate,
           share, expected;
    real_t steady = before - guard->rate, last = last_miss(config, guard, suspected), spoilt;
    truth_t undone, ends, lost, learned = guard->seen >= config->guard;
    limit = (PMF_R(1.0) + gap) * limit_of(config, state, &open); /* what is missed adds up until the next good sample */
    back = size_of(missed_whole) <= limit;
    back = (back & PMF_NOT(suspected & (size < size_of(missed_whole)))) | open | apart;
    /* or the last believed count was wrong: then it comes back to the motion before that */
    spoilt = PMF_R(0.5) * (gap + PMF_R(2.0)) * (gap + PMF_R(3.0)) * last;
    undone = PMF_NOT(back) & (size_of(missed_whole + spoilt) < SPOILT_BAND * size_of(spoilt));
    begin_suspicion(guard, PMF_NOT(suspected | back), last);
    last = PMF_IF(undone, last, PMF_R(0.0));
    missed_whole += PMF_IF(undone, spoilt, PMF_R(0.0));
    predicted -= last;
    gap += PMF_IF(undone, PMF_R(1.0), PMF_R(0.0));
    back = back | undone;
    anew = suspected & PMF_NOT(back) & (size <= limit) & (size < size_of(missed - pending));
    real = suspected & PMF_NOT(back | anew) & is_blow(config, guard, missed, pending, limit);
    sound = back | anew | real;
    ends = sound | (guard->suspect >= PMF_GUARD_SUSPECTS);
    wild = back & PMF_NOT(suspected | apart | undone) & was_wild(config, guard, missed_whole);
    /* What was missed since the last good sample came evenly: all at once, it would be taken for an acceleration. */
    closes = (suspected | undone) & sound & PMF_NOT(real | open | apart);
    rate = PMF_IF(back, whole, part - guard->missed); /* a blow goes on from the reading before */
    missed = PMF_IF(back, missed_whole, missed);
    share = missed / (PMF_R(1.0) + gap);
    most = CAUTION * guard->scatter + MOTION_EDGE;
    most = PMF_IF(real & (size > most), most, missed);
    learn_scatter(config, guard, sound & PMF_NOT(apart | wild | undone | (closes & learned)),
                  PMF_IF(closes, share, most));
    guard->missed = missed;
    expected = PMF_IF((size_of(predicted) > LARGEST_RATE) | (guard->suspect > 1U), PMF_R(0.0), predicted);
    foreseen = foreseen_change(guard->change, expected);
    rate = PMF_IF(sound, PMF_IF(closes, predicted + share, rate), expected);
    guard->rate = PMF_IF(apart, PMF_R(0.0), rate);
#if PMF_PROCESS
    if (config->process != 0U) { /* its output has a zero that cannot move */
        anew = anew & PMF_NOT(anew);
    }
#endif
    /* nobody knows what a moved zero hid; its neighbours' mean is the best guess */
    read = PMF_IF(closes & back, sum_of(guard->change, rounded(predicted + share - gap * last)), read);
    *change = PMF_IF(sound, PMF_IF(anew, sum_of(read, rounded(missed - share)), *change), foreseen);
    guard->change = PMF_IF(apart, guard->change, PMF_IF(sound, PMF_IF(closes | real, read, *change), foreseen));
    if (PMF_ANY(wild)) {
        learn_anew(guard, wild, steady);
    }
    lost = ends & PMF_NOT(sound) & (guard->scatter < LARGEST_RATE);
    guard->scatter = PMF_IF(lost, PMF_R(2.0) * guard->scatter + STEP, guard->scatter);
    guard->wait = PMF_IF(ends & (suspected | undone),
                         PMF_IF(guard->wait > 0U, PMF_W(2U * CALM(config)), PMF_W(CALM(config))), guard->wait);
    undone = undone | (wild & (guard->seen > CALM(config))); /* before, the filters settle anyway */
    rough = real | undone | (ends & (guard->suspect > 1U));
    guard->reading = PMF_IF(sound, guard->reading, count);
    guard->suspect = PMF_IF(ends, PMF_W(0), guard->suspect + 1U);
    state->count = PMF_IF(ends, count, (state->count + (whole_t)*change) & 0xffffffffU);
    return PMF_BIT(PMF_NOT(sound) | undone, PMF_COUNT_JUMP) | PMF_BIT(rough, PMF_SETTLING) |
           PMF_BIT(undone & PMF_NOT(learned), PMF_BEGIN_AGAIN);
}

/* The largest input, and with it what a motion may do. */
PMF_SELDOM void grow(const pmf_encoder_config_t *config, pmf_guard_state_t *guard, truth_t where, real_t size)
{
    truth_t scales =
        where & (guard->seen >= config->guard) & (guard->peak > LEAST_PEAK) & (size > NEW_SIZE * guard->peak);
    real_t growth = PMF_IF(size < LARGEST_GROWTH * guard->peak, size / guard->peak, LARGEST_GROWTH);
    guard->scatter = PMF_IF(scales, (guard->scatter + STEP) * growth - STEP, guard->scatter);
    guard->peak = PMF_IF(where, size, guard->peak);
}

/* Decides on the input that the filters get now, where it was doubtful. */
static void judge_input(const pmf_encoder_config_t *config, pmf_encoder_state_t *state, real_t missed_before,
                        truth_t large)
{
    pmf_guard_state_t *guard = &state->guard;
    truth_t doubtful = (guard->doubt & 2U) != 0U, stays = large & ((guard->doubt & 1U) != 0U);
    real_t now = size_of(guard->missed), answer = size_of(missed_before), size = size_of(state->input_before);
    real_t expected = size * (guard->scatter / guard->peak + size_of(guard->gain));
    truth_t real;
    answer = PMF_IF(now > answer, now, answer);
    real = doubtful & (stays | (answer > MOTION_EDGE + PMF_R(0.25) * expected));
    state->input_before = PMF_IF(doubtful & PMF_NOT(real), guard->held, state->input_before);
    grow(config, guard, real & (size > guard->peak), size);
}

/* The input that comes: does it set a new size, or is it doubtful? */
PMF_SELDOM truth_t meet_input(const pmf_encoder_config_t *config, pmf_encoder_state_t *state, truth_t grows,
                              real_t missed_before, real_t size)
{
    pmf_guard_state_t *guard = &state->guard;
    real_t spike = PMF_IF(guard->seen >= config->guard, PMF_ALIKE(config->spike), EARLY_SPIKE);
    truth_t large = (guard->peak > LEAST_PEAK) & (size > spike * guard->peak);
    judge_input(config, state, missed_before, large);
    large = (guard->peak > LEAST_PEAK) & (size > spike * guard->peak);
    grow(config, guard, grows & (size > guard->peak) & PMF_NOT(large), size);
    guard->doubt = ((guard->doubt << 1) & PMF_GUARD_DOUBTS) | PMF_BIT(large, 1U);
    return large;
}

/* The input that comes, and the one that the filters get now. */
static whole_t guard_input(const pmf_encoder_config_t *config, pmf_encoder_state_t *state, real_t missed_before,
                           real_t input)
{
    pmf_guard_state_t *guard = &state->guard;
    real_t margin = PEAK_MARGIN * guard->peak;
    truth_t large = input * input > margin * margin, moves = state->moving > PMF_R(0.0),
            learns = guard->seen < LOOKED_AT(config);
    if (PMF_ANY(large | (guard->doubt != 0U))) {
        large = meet_input(config, state, large, missed_before, size_of(input));
    }
    guard->held = state->input_before;
    if (PMF_ANY(moves)) {
        real_t leak = PMF_IF(moves, PMF_ALIKE(config->guard_leak), PMF_R(0.0));
        guard->scatter -= leak * guard->scatter;
        guard->peak -= leak * guard->peak;
    }
    if (PMF_ANY(learns)) {
        guard->seen += PMF_BIT(learns & (moves | (guard->seen < FIRST_SAMPLES)), 1U);
    }
    return PMF_BIT(large, PMF_INVALID_INPUT);
}

/* A sample: `change`, from the accepted count, becomes what is to be believed, and so does state->input_before.
 * `apart`: max_speed has judged the change. Returns status bits. */
static whole_t pmf_guard(const pmf_encoder_config_t *config, pmf_encoder_state_t *state, real_t input, whole_t count,
                         truth_t apart, integer_t *change)
{
    pmf_guard_state_t *guard = &state->guard;
    real_t swing = state->input - guard->held, rate = PMF_TO_REAL(*change) - PMF_TO_REAL(guard->change);
    real_t missed = rate - (guard->rate + guard->gain * swing), missed_before = guard->missed;
    real_t edge = REST_EDGE + PMF_IF(state->moving > PMF_R(0.0), CAUTION * guard->scatter, PMF_R(0.0));
    truth_t plain = (missed * missed <= edge * edge) & ((guard->suspect | guard->doubt) == 0U) & PMF_NOT(apart);
    real_t scatter = guard->scatter, beyond = scatter + STEP, least = SWINGS * guard->peak;
    truth_t looks =
        (guard->seen < config->guard) & (missed * missed > REST_EDGE * REST_EDGE); /* the lesson may be wrong */
    whole_t status = PMF_W(0);
    if (PMF_ANY(guard->wait > 0U)) {
        guard->wait -= PMF_BIT((guard->wait > 0U) & (guard->suspect == 0U), 1U);
    }
    if (PMF_ALL(plain & PMF_NOT(looks))) {
        if (PMF_ANY(missed * missed > beyond * beyond)) {
            learn_scatter(config, guard, plain, missed);
        }
        guard->missed = missed;
        guard->rate = rate;
        guard->change = *change;
        state->count = count;
    } else {
        status = judge_change(config, state, count, apart, change);
    }
    if (PMF_ANY(swing * swing > least * least)) {
        learn_gain(guard, plain & (swing * swing > least * least), swing, missed);
    }
    if (PMF_ANY(guard->seen < LOOKED_AT(config))) {
        status |= doubt_lessons(config, guard, guard->seen < LOOKED_AT(config), missed_before, scatter, status);
    }
    return status | guard_input(config, state, missed_before, input);
}

#endif
#endif
