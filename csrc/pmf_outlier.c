/* A count that no motion explains, found without any memory of the motion. SPDX-License-Identifier: Apache-2.0
 *
 * A sample is judged with PMF_PAST accepted counts before it and PMF_AHEAD readings after it. Each choice of readings
 * gives a path, and the largest acceleration along the path is its price. A reading is wrong if the path that leaves it
 * out is cheaper by far. How far follows from a blow, the hardest motion there is: at a reversal from v to -v within a
 * sample, leaving out m readings lowers the acceleration by a factor of m + 2. A path may therefore leave out a reading
 * if it is cheaper by FIRST, which no blow reaches, and further readings if each lowers the price by a third. Beyond
 * MANY readings, each must halve it, because a fast oscillation looks smooth if most of its samples are left out.
 *
 * A path may also begin again from any count, which is a counter that was set to another value. Wrong counts next to
 * each other look alike, and are more frequent. The counter therefore counts as SHIFT readings left out.
 *
 * Between the bound of a blow and that demand, the reading may be right or wrong. It is then accepted, but unsure. If
 * no path is smooth and the readings turn around from sample to sample, most of them are wrong, and none is believed.
 * If the best path speeds up and brakes at once, far beyond the motion before it, the reading is unsure as well.
 *
 * No limit is learned from earlier samples. A wrong reading therefore changes nothing beyond its own neighbourhood. */
#include "pmf_outlier.h"
#include "pmf_internal.h"

enum pmf_left_out { LEFT_OUT = 6 }; /* most readings of a view that may be wrong */
static const uint32_t LEAST = 4U; /* fewest counts of a path: fewer than two accelerations prove nothing */
static const scalar_t ENDLESS = PMF_SCALAR(1e30);
static const scalar_t BLOW = PMF_SCALAR(3.0); /* ratio of accelerations with and without one reading, for a blow */
static const scalar_t FIRST = PMF_SCALAR(3.2); /* above BLOW */
static const scalar_t FURTHER = PMF_SCALAR(1.5); /* above (m + 3) / (m + 2), the bound for each further reading */
static const uint32_t MANY = 3U; /* most readings left out before a fast oscillation may look smooth */
static const uint32_t CHOICES = 2048U; /* most choices of a search, which bound its time; a wrong count takes fewer */
enum pmf_shift { SHIFT = 3 };
static const scalar_t ALONE = PMF_SCALAR(7.2); /* FIRST * FURTHER * FURTHER, the demand on a shift alone */
static const uint32_t LATER = PMF_PAST + PMF_AHEAD - 3U; /* first of the last accelerations of a view */
static const uint32_t LATEST = 2U; /* most wrong readings before a shift */
enum pmf_demands { DEMANDS = (int)LEFT_OUT + (int)SHIFT + 1 };
static const scalar_t CLEAR =
    PMF_SCALAR(2.0); /* least ratio of a deviation to the one that the accelerations along a path explain */
static const scalar_t WILD = PMF_SCALAR(6.0); /* twice BLOW: no reading or its neighbour is the reversal */
static const scalar_t NEAR =
    PMF_SCALAR(10.0); /* accelerations within this ratio of the largest one may come from the same wrong counts */
static const uint32_t LONGEST = 4U; /* more wrong readings in a row have no certain replacement */
static const scalar_t MOST = PMF_EITHER(1e9, 9007199254740992.0); /* 2^53 */

/* Chosen accepted counts and readings, ascending. */
typedef struct {
    uint8_t place[PMF_PAST + PMF_VIEW];
    uint32_t chosen;
    uint32_t past; /* chosen accepted counts, which come first */
    uint32_t moved; /* 1: the zero moved before the first chosen reading */
    scalar_t most, cost; /* price, and price times factor */
} path_t;

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
    return view->speed > PMF_SCALAR(0.0) && PMF_SIZE(travel(view, from, to)) > most;
}

/* Return the acceleration between the intervals a-b and c-d [counts per squared sample period], without the part that
 * the encoder's step explains. Readings at even times have second differences of up to two steps in a steady motion. */
PMF_SELDOM scalar_t signed_acceleration(const pmf_view_t *view, uint32_t a, uint32_t b, uint32_t c, uint32_t d)
{
    scalar_t before = view->time[b] - view->time[a], after = view->time[d] - view->time[c];
    scalar_t middle = view->time[c] + view->time[d] - view->time[a] - view->time[b], rounding = view->step * middle;
    scalar_t twice = PMF_SCALAR(2.0) * (travel(view, c, d) * before - travel(view, a, b) * after);
    if (PMF_SIZE(twice) <= PMF_SCALAR(2.0) * rounding) {
        return PMF_SCALAR(0.0);
    }
    return (twice < PMF_SCALAR(0.0) ? twice + rounding : twice - rounding) / (before * after * middle);
}

static scalar_t acceleration(const pmf_view_t *view, uint32_t a, uint32_t b, uint32_t c, uint32_t d)
{
    return PMF_SIZE(signed_acceleration(view, a, b, c, d));
}

/* Return the largest acceleration whose middle is one of the places from `first` to `last`, at least a step. */
PMF_SELDOM scalar_t roughness(const pmf_view_t *view, uint32_t first, uint32_t last)
{
    scalar_t most = view->step;
    uint32_t i;
    for (i = first; i <= last; ++i) {
        most = larger(most, acceleration(view, i - 1U, i, i, i + 1U));
    }
    return most;
}

/* Return the price of a path, given its price `most` without the last chosen place. The price is ENDLESS beyond the
 * highest speed. After a shift of the zero, the interval before the first chosen reading shows no speed. The axis may
 * rest before the first readings, and then start with a jerk. A path without one of them therefore starts from rest. */
PMF_SELDOM scalar_t price(const pmf_view_t *view, const path_t *path, scalar_t most)
{
    uint32_t n = path->chosen, apart = path->moved != 0U && n == path->past + 2U ? 1U : 0U, start, end, middle;
    if (n < 2U || (path->moved != 0U && n == path->past + 1U)) {
        return most;
    }
    start = path->place[n - 2U];
    end = path->place[n - 1U];
    if (is_too_fast(view, start, end) != 0) {
        return ENDLESS;
    }
    if (n < 3U) {
        int from_rest = view->past < 2U && end > PMF_PAST - view->past + 1U;
        return from_rest ? larger(most, PMF_SIZE(speed(view, start, end))) : most;
    }
    middle = n - 2U - apart;
    return middle == 0U ? most
                        : larger(most, acceleration(view, path->place[middle - 1U], path->place[middle], start, end));
}

/* Write the factors by which paths must be cheaper, by the number of readings that they leave out: for a verdict, or
 * for a doubt, which is the bound of a blow. */
PMF_SELDOM void demand(uint32_t doubt, scalar_t *factor)
{
    uint32_t i;
    factor[0] = PMF_SCALAR(1.0);
    factor[1] = FIRST;
    for (i = 2U; i < DEMANDS; ++i) {
        factor[i] =
            doubt != 0U ? FIRST / BLOW * (scalar_t)(i + 2U) : factor[i - 1U] * (i <= MANY ? FURTHER : PMF_SCALAR(2.0));
    }
}

/* Choose the place after the last one. Two accepted counts, or all of fewer, show the motion before the reading. */
PMF_SELDOM void choose(const pmf_view_t *view, uint32_t place, path_t *path, scalar_t *most)
{
    path->place[path->chosen] = (uint8_t)place;
    path->chosen += 1U;
    path->past += place < PMF_PAST ? 1U : 0U;
    most[path->chosen] = place >= PMF_PAST && path->past < 2U && path->past < view->past
                             ? ENDLESS
                             : price(view, path, most[path->chosen - 1U]);
}

/* Take back the last choice, and return the place after it. */
static uint32_t take_back(path_t *path)
{
    path->chosen -= 1U;
    path->past -= path->place[path->chosen] < PMF_PAST ? 1U : 0U;
    return path->place[path->chosen] + 1U;
}

/* Begin a path without counts. Every place has a value, so that no code can read memory without one. */
PMF_SELDOM void begin_path(const pmf_view_t *view, uint32_t moved, path_t *path, scalar_t *most)
{
    uint32_t i;
    for (i = 0; i < PMF_PAST + PMF_VIEW; ++i) {
        path->place[i] = (uint8_t)i;
        most[i] = view->step;
    }
    most[PMF_PAST + PMF_VIEW] = path->most = path->cost = view->step;
    path->chosen = path->past = 0U;
    path->moved = moved;
}

/* Make `best` the path through all counts. */
PMF_SELDOM void choose_all(const pmf_view_t *view, path_t *best)
{
    scalar_t most[PMF_PAST + PMF_VIEW + 1U];
    uint32_t place;
    begin_path(view, 0U, best, most);
    for (place = PMF_PAST - view->past; place < PMF_PAST + view->readings; ++place) {
        choose(view, place, best, most);
    }
    best->most = best->cost = most[best->chosen];
}

/* Return the places, as bits, that a cheaper path may leave out. Such a path avoids all accelerations near the largest
 * one, so that only the places that show them matter. Those that the path leaves out after its end count as well,
 * because some of them may be right. */
PMF_SELDOM uint32_t suspects(const pmf_view_t *view, const path_t *path)
{
    uint32_t places = (1U << (PMF_PAST + view->readings)) - (2U << path->place[path->chosen - 1U]), i;
    for (i = 1U; i + 1U < path->chosen; ++i) {
        uint32_t before = path->place[i - 1U], here = path->place[i], after = path->place[i + 1U];
        if (NEAR * acceleration(view, before, here, here, after) > path->most || is_too_fast(view, before, here) != 0 ||
            is_too_fast(view, here, after) != 0) {
            places |= (1U << before) | (1U << here) | (1U << after);
        }
    }
    return places;
}

/* Improve the best path by all paths with a shift of the zero, or all without. A path that is too expensive has no
 * cheap continuation. The search ends after `choices` choices, which are counted down. */
PMF_SELDOM void search(const pmf_view_t *view, uint32_t places, uint32_t moved, uint32_t doubt, uint32_t *choices,
                       path_t *best)
{
    scalar_t most[PMF_PAST + PMF_VIEW + 1U], factor[DEMANDS];
    path_t path;
    uint32_t begin = PMF_PAST - view->past, end = PMF_PAST + view->readings, next = begin,
             shift = moved != 0U ? (uint32_t)SHIFT : 0U;
    demand(doubt, factor);
    begin_path(view, moved, &path, most);
    while (*choices > 0U) {
        uint32_t skipped = next - begin - path.chosen + shift, left_out = end - begin - path.chosen - 1U + shift;
        if (next < end && path.chosen < PMF_PAST + PMF_VIEW && skipped <= LEFT_OUT + shift &&
            (moved == 0U || path.past < path.chosen || next <= PMF_PAST + LATEST)) {
            choose(view, next, &path, most);
            *choices -= 1U;
            next += 1U;
            if (left_out != 0U && left_out <= LEFT_OUT + shift && path.chosen >= path.past + 2U + moved &&
                path.past <= PMF_PAST && path.chosen >= LEAST && factor[left_out] * most[path.chosen] < best->cost) {
                path.most = most[path.chosen];
                path.cost = factor[left_out] * path.most;
                *best = path;
            }
            if (factor[skipped == 0U ? 1U : skipped] * most[path.chosen] < best->cost) {
                continue;
            }
        }
        do {
            if (path.chosen == 0U) {
                return;
            }
            next = take_back(&path);
        } while (((places >> (next - 1U)) & 1U) == 0U);
    }
}

/* Return the whole number next to a change of the counts, or 0 if no count can change so much or if x is NaN. */
PMF_SELDOM pmf_relative_t rounded(scalar_t x)
{
    if (x != x || x < -MOST || x > MOST) {
        return 0;
    }
    return x < PMF_SCALAR(0.0) ? -(pmf_relative_t)(PMF_SCALAR(0.5) - x) : (pmf_relative_t)(x + PMF_SCALAR(0.5));
}

/* Replace the judged reading as its path demands, unless the accelerations along the path explain the difference.
 * Return whether it is replaced. */
PMF_SELDOM int replace(const pmf_view_t *view, const path_t *path, pmf_verdict_t *verdict)
{
    uint32_t first = path->place[path->past], second, last, before_last;
    scalar_t after = view->time[first] - view->time[PMF_PAST], before, explained, slope, apart;
    pmf_relative_t end = view->count[first], count, moves;
    if (first == PMF_PAST && path->moved == 0U) {
        return 0;
    }
    second = path->place[path->past + 1U];
    if (path->past == 0U) {
        explained = PMF_SCALAR(0.5) * path->most * after * (after + PMF_SCALAR(1.0));
        count = end - rounded(after * speed(view, first, second));
    } else {
        last = path->place[path->past - 1U];
        before = view->time[PMF_PAST] - view->time[last];
        explained = PMF_SCALAR(0.5) * path->most * before * after;
        moves = end - view->count[last];
        if (path->moved != 0U && path->past >= 2U) {
            before_last = path->place[path->past - 2U];
            slope = PMF_SCALAR(0.5) * (speed(view, before_last, last) + speed(view, first, second));
            moves = rounded(slope * (before + after));
            end = view->count[last] + moves;
            explained = PMF_SCALAR(0.5) * path->most * (before + after) * (before + after);
        }
        slope = (scalar_t)moves / (before + after);
        count = view->count[last] + rounded(slope * before);
    }
    apart = path->moved != 0U ? (scalar_t)view->count[first] - (scalar_t)end
                              : (scalar_t)view->count[PMF_PAST] - (scalar_t)count;
    if (PMF_SIZE(apart) <= view->step + CLEAR * explained) {
        return 0;
    }
    verdict->verdict = path->moved != 0U ? PMF_ZERO_MOVED : PMF_READING_WRONG;
    verdict->count = count;
    verdict->first = first;
    verdict->end = end;
    verdict->unsure |= first > PMF_PAST + LONGEST ? 1U : 0U;
    return 1;
}

/* Return whether an accepted count between chosen ones was wrong: no acceleration along the path explains it. */
PMF_SELDOM int was_wrong(const pmf_view_t *view, const path_t *path)
{
    uint32_t i, place;
    for (i = 0; i < path->past; ++i) {
        uint32_t from = path->place[i], to = path->place[i + 1U];
        for (place = from + 1U; place < to && place < PMF_PAST; ++place) {
            scalar_t before = view->time[place] - view->time[from], after = view->time[to] - view->time[place];
            scalar_t apart = travel(view, from, place) - before * speed(view, from, to);
            if (PMF_SIZE(apart) > view->step + CLEAR * PMF_SCALAR(0.5) * path->most * before * after) {
                return 1;
            }
        }
    }
    return 0;
}

/* Find the best path, and judge the reading by it. */
PMF_SELDOM void follow_best(const pmf_view_t *view, uint32_t doubt, path_t *best, pmf_verdict_t *verdict)
{
    path_t moved;
    uint32_t places = 0U, choices = CHOICES, cheaper, between;
    scalar_t cost, with_shift;
    choose_all(view, best);
    moved = *best;
    do { /* a large wrong count hides smaller ones, with a shift and without */
        cost = best->cost;
        with_shift = moved.cost;
        if (best->most <= FURTHER * view->step) { /* no path is cheap enough */
            break;
        }
        places |= suspects(view, best);
        search(view, places, 0U, doubt, &choices, best);
        moved = best->cost < moved.cost ? *best : moved;
        if (view->past >= 2U) {
            search(view, places, 1U, doubt, &choices, &moved);
        }
        cheaper = best->cost < cost || moved.cost < with_shift ? 1U : 0U;
    } while (cheaper != 0U);
    /* a path between many wrong readings proves as little as one that ends the search */
    between = moved.place[moved.chosen - 1U] + 1U + view->past - (uint32_t)PMF_PAST - moved.chosen;
    verdict->unsure |= choices == 0U || between > MANY ? 1U : 0U;
    if (moved.moved != 0U && replace(view, &moved, verdict) != 0) {
        *best = moved;
        return;
    }
    (void)replace(view, best, verdict); /* a shift that is no shift hides no wrong count */
    if (was_wrong(view, best) != 0) {
        verdict->unsure = 1U;
    }
}

/* Return whether the readings along a path turn around all the time: their speed changes by more than itself. */
PMF_SELDOM int turns_around(const pmf_view_t *view, const path_t *path)
{
    scalar_t fastest = PMF_SCALAR(0.0), change = PMF_SCALAR(0.0), before = PMF_SCALAR(0.0), after;
    uint32_t i;
    for (i = path->past + 1U; i < path->chosen; ++i) {
        after = speed(view, path->place[i - 1U], path->place[i]);
        fastest = larger(fastest, PMF_SIZE(after));
        change = i > path->past + 1U ? larger(change, PMF_SIZE(after - before)) : change;
        before = after;
    }
    return change > fastest;
}

/* Return whether a path speeds up by more than a limit and brakes as much at once, or the reverse. A blow or a start
 * has one sign alone, and a fast oscillation has the same accelerations before. */
PMF_SELDOM int shakes(const pmf_view_t *view, const path_t *path, scalar_t limit)
{
    scalar_t last = PMF_SCALAR(0.0);
    uint32_t i;
    for (i = path->past > 1U ? path->past - 1U : 1U; i + 1U < path->chosen; ++i) {
        uint32_t before = path->place[i - 1U], here = path->place[i], after = path->place[i + 1U];
        scalar_t change = signed_acceleration(view, before, here, here, after);
        if (path->moved != 0U && i <= path->past) { /* a shift shows no speed */
            change = PMF_SCALAR(0.0);
        }
        if ((change > limit && last < -limit) || (change < -limit && last > limit)) {
            return 1;
        }
        last = change;
    }
    return 0;
}

/* The motion continues with its last speed. */
PMF_SELDOM void continue_motion(const pmf_view_t *view, pmf_verdict_t *verdict)
{
    scalar_t time = view->time[PMF_PAST] - view->time[PMF_PAST - 1U];
    verdict->verdict = PMF_READING_WRONG;
    verdict->count = view->count[PMF_PAST - 1U] + rounded(time * speed(view, PMF_PAST - 2U, PMF_PAST - 1U));
}

/* Return the least of the three accelerations from a place on, at least `limit`, which it is unless all of them have
 * the sign of `sign`. */
PMF_SELDOM scalar_t lasting_acceleration(const pmf_view_t *view, uint32_t first, scalar_t sign, scalar_t limit)
{
    scalar_t least = ENDLESS;
    uint32_t i;
    for (i = first; i <= first + 2U; ++i) {
        scalar_t here = sign * signed_acceleration(view, i - 1U, i, i, i + 1U);
        least = here < least ? here : least;
    }
    return larger(least, limit);
}

int pmf_is_smooth(const pmf_view_t *view)
{
    uint32_t whole = view->past == PMF_PAST ? 1U : 0U, i = PMF_PAST + 1U - (view->past < 2U ? view->past : 2U);
    scalar_t past, limit, up, down;
    if (view->readings < PMF_VIEW || is_too_fast(view, PMF_PAST - 1U, PMF_PAST) != 0) {
        return 0;
    }
    past = whole != 0U ? roughness(view, 1U, PMF_PAST - 2U) : view->step;
    if (whole != 0U && acceleration(view, PMF_PAST - 2U, PMF_PAST - 1U, PMF_PAST - 1U, PMF_PAST) <= past) {
        return 1;
    }
    if (whole != 0U) {
        limit = roughness(view, LATER, LATER + 2U);
        limit = past < limit ? past : limit;
    } else {
        limit = lasting_acceleration(view, LATER, PMF_SCALAR(1.0), past);
        limit = lasting_acceleration(view, LATER, PMF_SCALAR(-1.0), limit);
    }
    up = FIRST * lasting_acceleration(view, PMF_PAST + 2U, PMF_SCALAR(1.0), limit);
    down = FIRST * lasting_acceleration(view, PMF_PAST + 2U, PMF_SCALAR(-1.0), limit);
    for (; i <= PMF_PAST + 2U; ++i) {
        scalar_t here = signed_acceleration(view, i - 1U, i, i, i + 1U);
        if (here > up || -here > down) {
            return 0;
        }
    }
    return 1;
}

/* Return whether one shift of the zero explains a view that is smooth otherwise. Only a shift at the judged reading is
 * a verdict. */
PMF_SELDOM int is_one_shift(const pmf_view_t *view, pmf_verdict_t *verdict)
{
    pmf_view_t other;
    uint32_t first, i, whole = view->past + view->readings == PMF_PAST + PMF_VIEW ? 1U : 0U;
    other.past = view->past;
    other.readings = view->readings;
    other.step = view->step;
    other.speed = view->speed;
    other.slack = view->slack;
    for (first = PMF_PAST; whole != 0U && first < PMF_PAST + PMF_AHEAD; ++first) {
        scalar_t slope = PMF_SCALAR(0.5) * (speed(view, first - 2U, first - 1U) + speed(view, first, first + 1U));
        pmf_relative_t moves = rounded(slope * (view->time[first] - view->time[first - 1U]));
        scalar_t size = PMF_SIZE(travel(view, first - 1U, first) - (scalar_t)moves);
        scalar_t most = larger(view->step, acceleration(view, first - 2U, first - 1U, first, first + 1U));
        for (i = 0; i < PMF_PAST + PMF_VIEW && size > ALONE * most; ++i) {
            uint32_t zero = i < first ? first - 1U : first;
            pmf_relative_t start = i < first ? 0 : moves, apart = view->count[i] - view->count[zero];
            other.time[i] = view->time[i];
            other.count[i] = rounded((scalar_t)apart + (scalar_t)start);
            most = i < 2U ? most : larger(most, acceleration(&other, i - 2U, i - 1U, i - 1U, i));
            most = i > 0U && is_too_fast(&other, i - 1U, i) != 0 ? ENDLESS : most;
        }
        if (size > ALONE * most && pmf_is_smooth(&other) != 0) {
            if (first == PMF_PAST) {
                verdict->verdict = PMF_ZERO_MOVED;
                verdict->count = verdict->end = view->count[first - 1U] + moves;
            }
            return 1;
        }
    }
    return 0;
}

void pmf_judge(const pmf_view_t *view, pmf_verdict_t *verdict)
{
    pmf_verdict_t other;
    path_t best;
    scalar_t apart;
    verdict->verdict = PMF_READING_FITS;
    verdict->count = view->count[PMF_PAST];
    verdict->first = PMF_PAST;
    verdict->end = 0;
    verdict->unsure = 0U;
    if (view->past + view->readings <= LEAST || is_one_shift(view, verdict) != 0) {
        return;
    }
    other = *verdict;
    follow_best(view, 1U, &best, &other);
    if (other.verdict != PMF_READING_FITS || best.chosen < view->past + view->readings || other.unsure != 0U) {
        follow_best(view, 0U, &best, verdict); /* no path is cheaper than all counts if none is with the least demand */
        /* with either demand, a sure verdict is the same, and the counts differ by rounding */
        apart = PMF_SIZE((scalar_t)other.count - (scalar_t)verdict->count);
        verdict->unsure |= verdict->verdict == PMF_READING_FITS ? other.unsure : 0U;
        verdict->unsure |= other.verdict != verdict->verdict || apart > view->step ? 1U : 0U;
    }
    if (view->past >= 3U) {
        scalar_t wild = WILD * roughness(view, PMF_PAST - view->past + 1U, PMF_PAST - 2U);
        verdict->unsure |= shakes(view, &best, wild) != 0 ? 1U : 0U;
        if (best.most > wild && turns_around(view, &best) != 0) {
            verdict->unsure = 1U;
            continue_motion(view, verdict);
        }
    }
    if (verdict->verdict == PMF_READING_FITS && view->past >= 2U && is_too_fast(view, PMF_PAST - 1U, PMF_PAST)) {
        continue_motion(view, verdict); /* no path is slow enough */
    }
}
