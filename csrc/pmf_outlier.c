/* A count that no motion explains, found without any memory of the motion. SPDX-License-Identifier: Apache-2.0
 *
 * A sample is judged with PMF_PAST accepted counts before it and PMF_AHEAD readings after it. Each choice of readings
 * gives a path, and the largest acceleration along the path is its price. A reading is wrong if the path that leaves it
 * out is cheaper by far. How far follows from a blow, the hardest motion there is: at a reversal from v to -v within a
 * sample, leaving out m readings lowers the acceleration by a factor of m + 2. Leaving out one reading must therefore
 * lower the price by FIRST, which no blow reaches. Each further reading must halve it again, because a fast oscillation
 * looks smooth if most of its samples are left out. A path may also begin again from any count, which is a counter that
 * was set to another value; it counts as one more reading left out.
 *
 * No limit is learned from earlier samples. A wrong reading therefore changes nothing beyond its own neighbourhood. */
#include "pmf_outlier.h"
#include "pmf_internal.h"

#define LEFT_OUT 6U /* most readings of a view that may be wrong */
#define LEAST 4U /* fewest counts of a path: fewer than two accelerations prove nothing */
#define ENDLESS PMF_SCALAR(1e30)
#define FIRST PMF_SCALAR(3.2) /* above 3, the bound of a blow */
#define PAST PMF_PAST
#ifdef PMF_FLOAT32
#define MOST PMF_SCALAR(1e9)
#else
#define MOST PMF_SCALAR(9007199254740992.0) /* 2^53 */
#endif

/* A path through the readings, without those after the last chosen one. */
typedef struct {
    uint32_t place[PMF_VIEW]; /* chosen readings, ascending */
    uint32_t chosen;
    uint32_t moved; /* 1: the zero moved before the first chosen reading */
} path_t;

/* The best path so far: its first two readings, and its price. */
typedef struct {
    uint32_t first, second, moved;
    scalar_t most;
} best_t;

static scalar_t size_of(scalar_t x)
{
    return x < PMF_SCALAR(0.0) ? -x : x;
}

static scalar_t larger(scalar_t a, scalar_t b)
{
    return a > b ? a : b;
}

static scalar_t travel(const pmf_view_t *view, uint32_t from, uint32_t to)
{
    return (scalar_t)(view->count[to] - view->count[from]);
}

PMF_SELDOM scalar_t speed(const pmf_view_t *view, uint32_t from, uint32_t to)
{
    return travel(view, from, to) / (view->time[to] - view->time[from]);
}

/* Return whether the axis is too slow for an interval. */
PMF_SELDOM int is_too_fast(const pmf_view_t *view, uint32_t from, uint32_t to)
{
    scalar_t most = view->speed * (view->time[to] - view->time[from]) + view->slack;
    return view->speed > PMF_SCALAR(0.0) && size_of(travel(view, from, to)) > most;
}

/* Return the acceleration between the intervals a-b and c-d [counts per squared sample period], without the part that
 * the encoder's step explains. Readings at even times have second differences of up to two steps in a steady motion. */
PMF_SELDOM scalar_t acceleration(const pmf_view_t *view, uint32_t a, uint32_t b, uint32_t c, uint32_t d)
{
    scalar_t before = view->time[b] - view->time[a], after = view->time[d] - view->time[c];
    scalar_t middle = view->time[c] + view->time[d] - view->time[a] - view->time[b];
    scalar_t size = PMF_SCALAR(2.0) * size_of(speed(view, c, d) - speed(view, a, b)) / middle;
    scalar_t rounding = view->step / (before * after);
    return size > PMF_SCALAR(2.0) * rounding ? size - rounding : PMF_SCALAR(0.0);
}

/* Return the largest acceleration of the accepted counts, at least a step. */
PMF_SELDOM scalar_t of_past(const pmf_view_t *view)
{
    scalar_t most = view->step;
    uint32_t i;
    for (i = PAST - view->past; i + 2U < PAST; ++i) {
        most = larger(most, acceleration(view, i, i + 1U, i + 1U, i + 2U));
    }
    return most;
}

/* Return the place of the chosen reading or accepted count that is `back` places before the last chosen one. */
PMF_SELDOM uint32_t before_last(const path_t *path, uint32_t back)
{
    return back < path->chosen ? PAST + path->place[path->chosen - 1U - back] : PAST - 1U + path->chosen - back;
}

/* Return the price of a path, given its price `most` without the last chosen reading. The price is ENDLESS beyond the
 * highest speed. After a shift of the zero, the interval before the first chosen reading shows no speed. */
PMF_SELDOM scalar_t price(const pmf_view_t *view, const path_t *path, scalar_t most)
{
    uint32_t points = view->past + path->chosen, last = before_last(path, 0U), start, from, to;
    if (points < 2U || (path->moved != 0U && path->chosen == 1U)) {
        return most;
    }
    start = before_last(path, 1U);
    if (is_too_fast(view, start, last) != 0) {
        return ENDLESS;
    }
    if (points < 3U) {
        return most;
    }
    to = path->moved != 0U && path->chosen == 2U ? PAST - 1U : start;
    from = path->moved != 0U && path->chosen == 2U ? PAST - 2U : before_last(path, 2U);
    return larger(most, acceleration(view, from, to, start, last));
}

/* Return the factor by which a path must be cheaper. */
PMF_SELDOM scalar_t demanded(uint32_t left_out)
{
    return left_out == 0U ? PMF_SCALAR(1.0) : FIRST * (scalar_t)(1U << (left_out - 1U));
}

/* Return the price of the path through all readings. */
PMF_SELDOM scalar_t price_of_all(const pmf_view_t *view, scalar_t past)
{
    path_t path;
    scalar_t most = past;
    path.moved = 0U;
    for (path.chosen = 0U; path.chosen < view->readings;) {
        path.place[path.chosen] = path.chosen;
        path.chosen += 1U;
        most = price(view, &path, most);
    }
    return most;
}

/* Return whether a path may end at its last chosen reading. A shift of the zero needs counts on its other side. */
static int may_end(const pmf_view_t *view, const path_t *path)
{
    return view->readings - path->chosen <= LEFT_OUT && path->chosen >= 2U + path->moved &&
           path->chosen + view->past >= LEAST;
}

/* Improve the best path by all paths with a shift of the zero, or all without. `least` is the price of the best path
 * times its factor. A path that is too expensive has no cheap continuation. */
PMF_SELDOM void search(const pmf_view_t *view, scalar_t past, uint32_t moved, best_t *best, scalar_t *least)
{
    scalar_t most[PMF_VIEW + 1U];
    path_t path;
    uint32_t next = 0U;
    path.chosen = 0U;
    path.moved = moved;
    most[0] = past;
    for (;;) {
        uint32_t skipped = next - path.chosen + moved, left_out;
        if (next >= view->readings || skipped > LEFT_OUT + moved) { /* one step back */
            if (path.chosen == 0U) {
                return;
            }
            path.chosen -= 1U;
            next = path.place[path.chosen] + 1U;
            continue;
        }
        path.place[path.chosen] = next;
        path.chosen += 1U;
        next += 1U;
        most[path.chosen] = price(view, &path, most[path.chosen - 1U]);
        left_out = view->readings - path.chosen + moved;
        if (left_out != 0U && may_end(view, &path) && demanded(left_out) * most[path.chosen] < *least) {
            *least = demanded(left_out) * most[path.chosen];
            best->first = path.place[0];
            best->second = path.place[1];
            best->moved = moved;
            best->most = most[path.chosen];
        }
        if (demanded(skipped == 0U ? 1U : skipped) * most[path.chosen] >= *least) {
            path.chosen -= 1U;
        }
    }
}

PMF_SELDOM void find_best(const pmf_view_t *view, best_t *best)
{
    scalar_t past = of_past(view), least = price_of_all(view, past);
    best->first = 0U;
    best->second = 1U;
    best->moved = 0U;
    best->most = least;
    if (least > FIRST * past) { /* otherwise, no path is cheap enough */
        search(view, past, 0U, best, &least);
        if (view->past >= 2U) {
            search(view, past, 1U, best, &least);
        }
    }
}

/* Return the whole number next to a change of the counts, or 0 if no count can change so much. */
PMF_SELDOM pmf_relative_t rounded(scalar_t x)
{
    if (size_of(x) > MOST) {
        return 0;
    }
    return x < PMF_SCALAR(0.0) ? -(pmf_relative_t)(PMF_SCALAR(0.5) - x) : (pmf_relative_t)(x + PMF_SCALAR(0.5));
}

/* Replace the judged reading as its path demands, unless the accelerations along the path explain the difference. */
PMF_SELDOM void replace(const pmf_view_t *view, const best_t *path, pmf_verdict_t *verdict)
{
    uint32_t first = PAST + path->first, second = PAST + path->second, last = PAST - 1U;
    scalar_t after = view->time[first] - view->time[PAST], before = view->time[PAST] - view->time[last];
    scalar_t explained = PMF_SCALAR(0.5) * path->most * before * after, slope;
    pmf_relative_t end = view->count[first], count, apart;
    if (view->past == 0U) {
        explained = PMF_SCALAR(0.5) * path->most * after * (after + PMF_SCALAR(1.0));
        count = end - rounded(after * speed(view, first, second));
    } else {
        if (path->moved != 0U) {
            slope = PMF_SCALAR(0.5) * (speed(view, last - 1U, last) + speed(view, first, second));
            end = view->count[last] + rounded(slope * (before + after));
            explained = PMF_SCALAR(0.5) * path->most * (before + after) * (before + after);
        }
        slope = (scalar_t)(end - view->count[last]) / (before + after);
        count = view->count[last] + rounded(slope * before);
    }
    apart = path->moved != 0U ? view->count[first] - end : view->count[PAST] - count;
    if (size_of((scalar_t)apart) > view->step + explained) {
        verdict->verdict = path->moved != 0U ? PMF_ZERO_MOVED : PMF_READING_WRONG;
        verdict->count = count;
        verdict->first = first;
        verdict->end = end;
    }
}

/* Return whether the judged reading continues the accepted counts. */
PMF_SELDOM int is_plain(const pmf_view_t *view)
{
    return view->past >= 3U && !is_too_fast(view, PAST - 1U, PAST) &&
           acceleration(view, PAST - 2U, PAST - 1U, PAST - 1U, PAST) <= of_past(view);
}

void pmf_judge(const pmf_view_t *view, pmf_verdict_t *verdict)
{
    best_t best;
    verdict->verdict = PMF_READING_FITS;
    verdict->count = view->count[PAST];
    verdict->first = PAST;
    verdict->end = 0;
    if (view->past + view->readings <= LEAST || is_plain(view)) {
        return;
    }
    find_best(view, &best);
    if (best.first != 0U || best.moved != 0U) {
        replace(view, &best, verdict);
        return;
    }
    if (view->past >= 2U && is_too_fast(view, PAST - 1U, PAST)) { /* no path is slow enough: the motion continues */
        scalar_t time = view->time[PAST] - view->time[PAST - 1U];
        verdict->verdict = PMF_READING_WRONG;
        verdict->count = view->count[PAST - 1U] + rounded(time * speed(view, PAST - 2U, PAST - 1U));
    }
}
