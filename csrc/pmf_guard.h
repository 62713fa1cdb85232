/* Samples that no motion explains: a reset counter, a wrong reading, a spike of the input. Only pmf_encoder.c includes
 * this file. SPDX-License-Identifier: Apache-2.0
 *
 * The guard predicts a change of the counts from the last change, the last second difference, and the input. A
 * leaking maximum of the prediction errors is the limit of the motion. At rest, and with an input larger than the
 * recent ones, the limit grows in proportion to the input. A change beyond the limit is left out, and the predicted
 * change replaces it.
 *
 * The next sample decides. If the count changes as predicted, the counter was reset. The zero of the counter has moved,
 * and the motion continues. If the count returns, the reading was wrong. The missed travel is spread evenly over the
 * samples since the last good sample. If the next two samples continue from the suspicious sample, the motion is a
 * blow. The held-back travel is added, so that no count is lost, and the filters settle again. An input far beyond the
 * largest recent input is judged two samples later, before the filters receive it. If neither the counts responded nor
 * the input stayed, the preceding input replaces it. A sample without a suspicion is never changed.
 *
 * A wrong count below the limit is accepted. The next count misses by three times as much in the other direction, and
 * returns to the earlier motion. The prediction then replaces the wrong count, and the filters settle. Wrong counts
 * must not widen the limit, because each wrong count would admit a larger one. The guard therefore does not learn from
 * a swing back or within CALM samples after a suspicious sample. A suspicion withdraws the preceding lesson.
 *
 * The guard accepts all but the wildest counts while it learns. A motion is missed with the same sign, sample after
 * sample, until the prediction follows it. A wrong count gives the errors J, -3 J, 3 J, -J. Motion alone therefore
 * explains the largest error without a neighbour of the other sign. If the limit is far beyond that, or an accepted
 * count is found wrong, the estimator begins again. */
#ifndef PMF_GUARD_H
#define PMF_GUARD_H

#include "pmf_internal.h"

#if PMF_WITH_GUARD

#define FIRST_SAMPLES 4U /* samples at the start, because a record may begin in motion */
#define STEP PMF_R(4.0) /* error of a prediction by the encoder's step alone */
#define NOISE PMF_R(2.0) /* error of a second difference of counts */
#define REST_EDGE PMF_R(6.0) /* smaller errors are never suspicious at rest */
#define MOTION_EDGE PMF_R(8.0) /* smaller errors are never suspicious in motion */
#define CAUTION PMF_R(3.0) /* limit of an error in motion, as a multiple of the errors so far */
#define EARLY_CAUTION PMF_R(30.0) /* limit of an error at the start, as a multiple of the errors so far */
#define EARLY_SPIKE PMF_R(1e6) /* limit of an input at the start, as a multiple of the largest input */
#define PEAK_MARGIN                                                                                                    \
    PMF_R(1.25) /* multiple of the leaking peak above which an input moves the peak, so that a constant input does not \
                 */
#define NEW_SIZE PMF_R(2.0) /* an input above this multiple of the peak raises the limit of the motion */
#define LARGEST_GROWTH PMF_R(100.0)
#define SWINGS PMF_R(0.25) /* fraction of the largest input, below which a change gives little information */
#define GAIN_STEP PMF_R(0.03125) /* step of the normalised gradient */
#define LEAST_PEAK PMF_R(1e-12) /* least peak of an input, whose inverse square is finite */
#define LARGEST_RATE PMF_R(1e9) /* largest rate of a predicted change, which must fit an integer */
#define ANY_SHARE PMF_R(1e20)
#define LESSON PMF_R(0.125) /* fraction of an excess that counts after learning */
#define LARGEST_SWING PMF_R(5.1) /* largest opposite error after a wrong count, as a multiple of the last error */
#define SPOILT_BAND \
    PMF_R(0.7) /* relative band around the effect of a wrong count, outside which the next count is wrong */
#define GOES_ON PMF_R(0.3) /* relative difference of a blow from sample to sample */
#define LARGEST_BLOW PMF_R(100.0) /* largest blow, as a multiple of the scatter */
#define BACKWARDS PMF_R(0.25) /* fraction of an error that the opposite neighbour of a wrong count has */
#define DOUBTFUL PMF_R(3.0) /* lessons above this multiple of the error by motion alone are doubtful */
#define LOOKED_AT(config) ((config)->guard + PMF_GUARD_SOUND) /* updates at which the lessons are final */
#define CALM(config) ((config)->guard >> 3) /* samples without learning after a suspicious sample */

static integer_t signed_count(uint32_t mask, whole_t count); /* defined in pmf_encoder.c */

static real_t size_of(real_t x)
{
    return PMF_SIZE(x);
}

/* Learn from an accepted sample. After the first learning, possible effects of a wrong count are no lesson. A wrong
 * count by J causes the errors J, -3 J, 3 J and -J, and wrong counts come in groups. */
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

/* Begin a suspicion, and withdraw the lesson of the preceding sample. */
PMF_RARE void begin_suspicion(pmf_guard_state_t *guard, truth_t where, real_t last)
{
    truth_t fresh = where & ((guard->wait > 0U) | (size_of(guard->missed) > guard->scatter + STEP));
    guard->scatter -= PMF_IF(fresh & (guard->lesson < guard->scatter), guard->lesson, PMF_R(0.0));
    guard->lesson = PMF_IF(where, PMF_R(0.0), guard->lesson);
    guard->last = PMF_IF(where, last, guard->last);
}

/* Return the error of the last count that was accepted at once. */
PMF_RARE real_t last_miss(const pmf_encoder_config_t *config, const pmf_guard_state_t *guard, truth_t suspected)
{
    whole_t wait = guard->wait + 1U;
    truth_t judged = (wait == CALM(config)) | (wait == 2U * CALM(config));
#if PMF_PROCESS
    if (config->process != 0U) { /* the output of a process may step in both directions */
        return PMF_R(0.0);
    }
#endif
    return PMF_IF(suspected, guard->last, PMF_IF(judged, PMF_R(0.0), guard->missed));
}

/* Learn the effect of an input from a sample without a doubt. */
PMF_RARE void learn_gain(pmf_guard_state_t *guard, truth_t where, real_t swing, real_t missed)
{
    real_t gain = guard->gain + GAIN_STEP * missed * (swing / guard->peak) / guard->peak;
    where = where & (guard->peak > LEAST_PEAK) & (guard->seen >= FIRST_SAMPLES);
    guard->gain = PMF_IF(where, gain, guard->gain);
}

/* Return the largest allowed error of a prediction. `open` allows any error, because nothing is known yet. */
static real_t limit_of(const pmf_encoder_config_t *config, const pmf_encoder_state_t *state, truth_t *open)
{
    const pmf_guard_state_t *guard = &state->guard;
    truth_t learned = guard->seen >= config->guard, moves = state->moving > PMF_R(0.0);
    real_t last = size_of(state->input), reach = size_of(state->input_before), share;
    truth_t missed;
    reach = PMF_IF(last > reach, last, reach);
    share = PMF_IF(guard->peak > LEAST_PEAK, reach / guard->peak, PMF_IF(reach > PMF_R(0.0), ANY_SHARE, PMF_R(0.0)));
#if PMF_PROCESS
    if (config->process != 0U) { /* the output of a process may step, and only unprecedented steps are suspicious */
        *open = PMF_NOT(learned | (guard->seen > config->guard >> 3));
        return REST_EDGE + EARLY_CAUTION * (guard->scatter + STEP) * PMF_IF(share < PMF_R(1.0), PMF_R(1.0), share);
    }
#endif
    missed = learned | (guard->scatter > PMF_R(0.0)); /* a smooth motion was fully predicted */
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

PMF_RARE integer_t sum_of(integer_t a, integer_t b)
{
    return signed_count(0xffffffffU, ((whole_t)a + (whole_t)b) & 0xffffffffU);
}

/* Return the predicted change, which may be wrong by two counts. */
static integer_t foreseen_change(integer_t change, real_t rate)
{
    real_t sure = size_of(rate) - NOISE;
    sure = PMF_IF(sure > PMF_R(0.0), sure, PMF_R(0.0));
    return sum_of(change, rounded(PMF_IF(rate < PMF_R(0.0), -sure, sure)));
}

/* Two successive wrong readings may look like the first two samples of a blow. Only after a blow does a third sample
 * continue.
 */
PMF_RARE truth_t is_blow(const pmf_encoder_config_t *config, const pmf_guard_state_t *guard, real_t missed,
                         real_t pending, real_t limit)
{
    real_t before = guard->missed, most = PMF_R(2.0) * PMF_TO_REAL((integer_t)guard->suspect) * size_of(missed) + limit;
    truth_t third = guard->suspect > 1U;
#if PMF_PROCESS
    if (config->process != 0U) { /* the output of a process may do anything */
        return (third & (size_of(missed - PMF_R(1.25) * before) <= PMF_R(0.75) * size_of(before) + limit)) |
               (guard->suspect > 2U);
    }
#endif
    (void)config;
    return third & (size_of(missed - before) <= GOES_ON * size_of(before) + limit) &
           (size_of(missed) < LARGEST_BLOW * (guard->scatter + STEP)) & (size_of(pending) <= most);
}

/* Return whether this error is the largest so far. During learning a jump causes the errors J and -2 J, and a wrong
 * reading J and -3 J. */
PMF_RARE truth_t was_wild(const pmf_encoder_config_t *config, const pmf_guard_state_t *guard, real_t missed)
{
    real_t first = guard->missed, size = size_of(first);
    truth_t wild = (size_of(missed + PMF_R(2.5) * first) <= PMF_R(0.75) * size) & (size > guard->scatter);
#if PMF_PROCESS
    if (config->process != 0U) { /* the output of a process may step */
        return wild & PMF_NOT(wild);
    }
#endif
    return wild & (size > MOTION_EDGE) & (guard->seen < config->guard);
}

/* Predictions miss a motion with one sign until they follow it. Two neighbouring errors of opposite sign may come from
 * a wrong count. The lessons are doubtful if the errors far exceed those of motion, because the estimates then contain
 * wrong counts. Guard and estimates then begin again, the guard with the errors of motion alone. */
static whole_t doubt_lessons(const pmf_encoder_config_t *config, pmf_guard_state_t *guard, truth_t looks, real_t miss,
                             real_t scatter, whole_t status)
{
    truth_t doubtful;
    truth_t jumped = ((status & PMF_COUNT_JUMP) != 0U) | (guard->suspect != 0U), lesson;
    real_t fair = size_of(miss) - STEP, least = -BACKWARDS * miss * miss;
#if PMF_PROCESS
    if (config->process != 0U) { /* the output of a process may step */
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

/* The lesson of a wrong count would hide all other wrong counts. The guard does not restart from the first sample,
 * because the learning might never end. */
PMF_RARE void learn_anew(pmf_guard_state_t *guard, truth_t where, real_t change)
{
    guard->scatter = PMF_IF(where, PMF_R(0.0), guard->scatter);
    guard->missed = PMF_IF(where, PMF_R(0.0), guard->missed);
    guard->sound = PMF_IF(where, PMF_W(0), guard->sound);
    guard->rate = PMF_IF(where, PMF_R(0.0), guard->rate);
    guard->change = PMF_IF(where, rounded(change), guard->change);
}

/* Decide on a change from the accepted count if this or an earlier change is suspicious. A doubtful input has no
 * effect. */
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
    limit = (PMF_R(1.0) + gap) * limit_of(config, state, &open); /* errors add up until the next good sample */
    back = size_of(missed_whole) <= limit;
    back = (back & PMF_NOT(suspected & (size < size_of(missed_whole)))) | open | apart;
    /* if the last accepted count was wrong, the count returns to the earlier motion */
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
    /* The missed travel since the last good sample is spread evenly, so that it does not look like an acceleration. */
    closes = (suspected | undone) & sound & PMF_NOT(real | open | apart);
    rate = PMF_IF(back, whole, part - guard->missed); /* a blow continues from the last reading */
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
    if (config->process != 0U) { /* the output of a process has a fixed zero */
        anew = anew & PMF_NOT(anew);
    }
#endif
    /* a moved zero hides the motion, so that the mean of the neighbouring changes is the best guess */
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
    undone = undone | (wild & (guard->seen > CALM(config))); /* before the end of settling, no correction is needed */
    rough = real | undone | (ends & (guard->suspect > 1U));
    guard->reading = PMF_IF(sound, guard->reading, count);
    guard->suspect = PMF_IF(ends, PMF_W(0), guard->suspect + 1U);
    state->count = PMF_IF(ends, count, (state->count + (whole_t)*change) & 0xffffffffU);
    return PMF_BIT(PMF_NOT(sound) | undone, PMF_COUNT_JUMP) | PMF_BIT(rough, PMF_SETTLING) |
           PMF_BIT(undone & PMF_NOT(learned), PMF_BEGIN_AGAIN);
}

/* Update the largest input and, with it, the limit of the motion. */
PMF_SELDOM void grow(const pmf_encoder_config_t *config, pmf_guard_state_t *guard, truth_t where, real_t size)
{
    truth_t scales =
        where & (guard->seen >= config->guard) & (guard->peak > LEAST_PEAK) & (size > NEW_SIZE * guard->peak);
    real_t growth = PMF_IF(size < LARGEST_GROWTH * guard->peak, size / guard->peak, LARGEST_GROWTH);
    guard->scatter = PMF_IF(scales, (guard->scatter + STEP) * growth - STEP, guard->scatter);
    guard->peak = PMF_IF(where, size, guard->peak);
}

/* Decide on a doubtful input when the filters receive it. */
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

/* Judge a new input, which sets a new size or is doubtful. */
PMF_RARE truth_t meet_input(const pmf_encoder_config_t *config, pmf_encoder_state_t *state, truth_t grows,
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

/* Process the new input, and the input that the filters receive now. */
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

/* Process a sample and return status bits. `change`, counted from the accepted count, and state->input_before become
 * the accepted values. `apart` means that max_speed has rejected the change. */
static whole_t pmf_guard(const pmf_encoder_config_t *config, pmf_encoder_state_t *state, real_t input, whole_t count,
                         truth_t apart, integer_t *change)
{
    pmf_guard_state_t *guard = &state->guard;
    real_t swing = state->input - guard->held, rate = PMF_TO_REAL(*change) - PMF_TO_REAL(guard->change);
    real_t missed = rate - (guard->rate + guard->gain * swing), missed_before = guard->missed;
    real_t edge = REST_EDGE + PMF_IF(state->moving > PMF_R(0.0), CAUTION * guard->scatter, PMF_R(0.0));
    truth_t plain = (missed * missed <= edge * edge) & ((guard->suspect | guard->doubt) == 0U) & PMF_NOT(apart);
    real_t scatter = guard->scatter, beyond = scatter + STEP, least = SWINGS * guard->peak;
    truth_t looks = (guard->seen < config->guard) &
                    (missed * missed > REST_EDGE * REST_EDGE); /* the last lesson of the guard may be wrong */
    whole_t status = PMF_W(0);
    if (PMF_ANY(guard->wait > 0U)) {
        guard->wait -= PMF_BIT((guard->wait > 0U) & (guard->suspect == 0U), 1U);
    }
#if PMF_LAYOUT == 0U /* an export saves the code */
    if (PMF_ANY(looks)) { /* the lesson was wrong only if this error undoes the last one */
        looks = looks & was_wild(config, guard, missed);
    }
#endif
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
