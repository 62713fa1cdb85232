/* Counts that no motion explains, found without any memory of the motion.
 * SPDX-License-Identifier: Apache-2.0
 *
 * A sample is judged with PAST accepted counts before it and AHEAD readings after it. Each choice of readings gives a
 * path, and the largest acceleration along the path is its price. A reading is wrong if the path that leaves it out is
 * cheaper by far. How far follows from a blow, the hardest motion there is: at a reversal from v to -v within a sample,
 * leaving out m readings lowers the acceleration by a factor of m + 2. Leaving out one reading must therefore lower the
 * price by FIRST, which no blow reaches. Each further reading must halve it again, because a fast oscillation looks
 * smooth if most of its samples are left out. A path may also begin again from any count, which is a counter that was
 * set to another value; it counts as one more reading left out.
 *
 * No limit is learned from earlier samples. A wrong reading therefore changes nothing beyond its own neighbourhood. */
#include "pmf_outliers.h"

#include <string.h>

#define PAST 5U /* accepted counts: three accelerations, one of which shows an oscillation of four samples or more */
#define AHEAD 8U
#define WINDOW (AHEAD + 1U) /* the judged reading and those after it */
#define LEFT_OUT 6U /* most readings of a window that may be wrong */
#define LEAST 4U /* fewest counts of a path: fewer than two accelerations prove nothing */
#define ENDLESS 1e300
#define MOST 9007199254740992.0 /* 2^53, the limit of the counts */
#define FIRST 3.2 /* above 3, the bound of a blow */

/* Counts and times, oldest first: `past` accepted ones, then the judged reading at PAST, then those ahead. */
typedef struct {
    double count[PAST + WINDOW], time[PAST + WINDOW];
    uint32_t past, readings;
    double step, speed; /* those of the record */
} window_t;

/* A choice of readings as bits, and whether the counter's zero moved before the first of them. */
typedef struct {
    uint32_t readings, moved;
} choice_t;

static double size_of(double x)
{
    return x < 0.0 ? -x : x;
}

static uint32_t number_of(uint32_t bits)
{
    uint32_t number = 0U;
    for (; bits != 0U; bits &= bits - 1U) {
        number += 1U;
    }
    return number;
}

static double speed(const window_t *window, uint32_t from, uint32_t to)
{
    return (window->count[to] - window->count[from]) / (window->time[to] - window->time[from]);
}

/* Return whether the axis is too slow for an interval. */
static int is_too_fast(const window_t *window, uint32_t from, uint32_t to)
{
    double most = window->speed * (window->time[to] - window->time[from]) + window->step;
    return window->speed > 0.0 && size_of(window->count[to] - window->count[from]) > most;
}

/* Return the acceleration between the intervals a-b and c-d [counts per squared sample period], without the part that
 * the encoder's step explains. Readings at even times have second differences of up to two steps in a steady motion. */
static double acceleration(const window_t *window, uint32_t a, uint32_t b, uint32_t c, uint32_t d)
{
    double before = window->time[b] - window->time[a], after = window->time[d] - window->time[c];
    double middle = window->time[c] + window->time[d] - window->time[a] - window->time[b];
    double size = 2.0 * size_of(speed(window, c, d) - speed(window, a, b)) / middle;
    double rounding = window->step / (before * after);
    return size > 2.0 * rounding ? size - rounding : 0.0;
}

/* Return the largest acceleration of the accepted counts, at least a step. */
static double of_past(const window_t *window)
{
    double most = window->step;
    uint32_t i;
    for (i = PAST - window->past; i + 2U < PAST; ++i) {
        double next = acceleration(window, i, i + 1U, i + 1U, i + 2U);
        most = next > most ? next : most;
    }
    return most;
}

/* Return the largest acceleration along a path, or the first above `enough`. The price is ENDLESS beyond the highest
 * speed. */
static double price(const window_t *window, choice_t choice, double most, double enough)
{
    uint32_t points = window->past, before = PAST - 2U, last = PAST - 1U, broken = choice.moved, i;
    for (i = 0; i < window->readings && most < enough; ++i) {
        uint32_t place = PAST + i;
        double next = 0.0;
        if ((choice.readings >> i & 1U) == 0U) {
            continue;
        }
        if (broken == 1U) { /* the interval before this count shows no speed */
            broken = place;
            points += 1U;
            continue;
        }
        if (points >= 1U && is_too_fast(window, broken != 0U ? broken : last, place)) {
            return ENDLESS;
        }
        if (points >= 2U) {
            uint32_t start = broken != 0U ? broken : last;
            next = acceleration(window, before, last, start, place);
        }
        before = broken != 0U ? broken : last;
        broken = 0U;
        last = place;
        points += 1U;
        most = next > most ? next : most;
    }
    return most;
}

static double demanded(uint32_t left_out)
{
    return FIRST * (double)(1U << (left_out - 1U));
}

/* Return the best choice. A shift of the zero needs three counts on its other side. */
static choice_t best_choice(const window_t *window)
{
    uint32_t all = (1U << window->readings) - 1U, readings, moved;
    double past = of_past(window), least;
    choice_t best = {0U, 0U}, other;
    best.readings = all;
    least = price(window, best, past, ENDLESS);
    for (moved = 0U; moved <= (window->past >= 2U ? 1U : 0U); ++moved) {
        for (readings = 1U; readings <= all; ++readings) {
            uint32_t chosen = number_of(readings), left_out = window->readings - chosen + moved;
            double factor, found;
            if (left_out == 0U || left_out - moved > LEFT_OUT || chosen < 2U + moved || chosen + window->past < LEAST) {
                continue;
            }
            factor = demanded(left_out);
            other.readings = readings;
            other.moved = moved;
            found = factor * price(window, other, past, least / factor);
            if (found < least) {
                least = found;
                best = other;
            }
        }
    }
    return best;
}

static uint32_t first_of(uint32_t bits)
{
    uint32_t place = 0U;
    for (; (bits & 1U) == 0U; bits >>= 1) {
        place += 1U;
    }
    return place;
}

/* Return the whole number next to a change of the counts, or 0 if no count can change so much. */
static double rounded(double x)
{
    if (size_of(x) > MOST) {
        return 0.0;
    }
    return x < 0.0 ? -(double)(int64_t)(0.5 - x) : (double)(int64_t)(x + 0.5);
}

/* Return the judged count by a choice that leaves it out or moves the zero, the move, and the part of the difference
 * that the accelerations of the path explain. */
static double replaced(const window_t *window, choice_t choice, double *moved, double *explained)
{
    uint32_t first = PAST + first_of(choice.readings), last = PAST - 1U, second;
    double time = window->time[PAST], end = window->count[first],
           most = price(window, choice, of_past(window), ENDLESS);
    double after = window->time[first] - time, before = time - window->time[last], slope;
    second = PAST + first_of(choice.readings & (choice.readings - 1U));
    *moved = 0.0;
    if (window->past == 0U) {
        *explained = window->step + 0.5 * most * after * (after + 1.0);
        return end - rounded(after * speed(window, first, second));
    }
    *explained = window->step + 0.5 * most * before * after;
    if (choice.moved != 0U) {
        slope = 0.5 * (speed(window, last - 1U, last) + speed(window, first, second));
        end = window->count[last] + rounded(slope * (before + after));
        *moved = window->count[first] - end;
        *explained = window->step + 0.5 * most * (before + after) * (before + after);
    }
    slope = (end - window->count[last]) / (before + after);
    return window->count[last] + rounded(slope * before);
}

/* Return whether the judged reading continues the accepted counts. */
static int is_plain(const window_t *window)
{
    double last;
    if (window->past < 3U) {
        return 0;
    }
    last = acceleration(window, PAST - 2U, PAST - 1U, PAST - 1U, PAST);
    return !is_too_fast(window, PAST - 1U, PAST) && last <= of_past(window);
}

/* Judge the reading at PAST. Returns 1 if it is wrong or read from another zero. */
static unsigned char judge(const window_t *window, double *count, double *moved)
{
    choice_t best;
    double reading = window->count[PAST], other, explained;
    *count = reading;
    *moved = 0.0;
    if (window->past + window->readings <= LEAST || is_plain(window)) {
        return 0U;
    }
    best = best_choice(window);
    if ((best.readings & 1U) != 0U && best.moved == 0U) {
        if (window->past < 2U || !is_too_fast(window, PAST - 1U, PAST)) {
            return 0U;
        }
        /* no path is slow enough, so that the motion continues */
        other = (window->time[PAST] - window->time[PAST - 1U]) * speed(window, PAST - 2U, PAST - 1U);
        *count = window->count[PAST - 1U] + rounded(other);
        return 1U;
    }
    other = replaced(window, best, moved, &explained);
    if (size_of(best.moved != 0U ? *moved : reading - other) <= explained) {
        *moved = 0.0;
        return 0U;
    }
    *count = other;
    return 1U;
}

static void accept(window_t *window, double count, double time)
{
    memmove(window->count, window->count + 1, (PAST - 1U) * sizeof *window->count);
    memmove(window->time, window->time + 1, (PAST - 1U) * sizeof *window->time);
    window->count[PAST - 1U] = count;
    window->time[PAST - 1U] = time;
    window->past += window->past < PAST ? 1U : 0U;
}

/* Judge the samples from the first to the last, or backwards for the last `end` samples. */
static void judge_all(const pmf_outliers_t *record, uint64_t samples, int back)
{
    window_t window;
    double zero = 0.0;
    uint64_t k, last = record->samples - 1U;
    memset(&window, 0, sizeof window);
    window.step = record->step;
    window.speed = record->speed;
    for (k = 0; k < samples; ++k) {
        uint64_t place = back ? last - k : k, left = record->samples - k;
        double count, moved;
        uint32_t i;
        window.readings = left < WINDOW ? (uint32_t)left : WINDOW;
        for (i = 0; i < window.readings; ++i) {
            uint64_t other = back ? place - i : place + i;
            window.count[PAST + i] = record->count[other] - zero;
            window.time[PAST + i] = back ? -record->time[other] : record->time[other];
        }
        if (judge(&window, &count, &moved) != 0U) {
            record->wrong[place] = 1U;
            record->moved[place] = back ? 0.0 : moved;
        }
        zero += back ? 0.0 : moved;
        record->count[place] = count;
        accept(&window, count, window.time[PAST]);
    }
}

void pmf_find_outliers(const pmf_outliers_t *record)
{
    memset(record->wrong, 0, record->samples);
    memset(record->moved, 0, record->samples * sizeof *record->moved);
    if (record->samples == 0U) {
        return;
    }
    judge_all(record, record->samples, 0);
    judge_all(record, record->samples < AHEAD ? record->samples : AHEAD,
              1); /* the last samples have too few after them */
}
