/* The direct start: parameters without a first guess. Only pmf_redge.c includes this file.
 * SPDX-License-Identifier: Apache-2.0
 *
 * The second divided difference of the place over three edges of one way is linear in the parameters: it is the mean
 * acceleration with a triangular weight. The same difference of the double integral of the input, and of the integral
 * of the place, has the same weight. So mass x difference of place = difference of input - viscous x difference of the
 * integral of the place - half of the friction and of the offset. The input is the instrument of the mass, since a
 * line's error is in the difference of the place. */

static const real_t WAIT = PMF_R(20.0); /* samples between two edges of one way, in which a rest does little harm */
static const real_t SPAN = PMF_R(3.0); /* samples; shorter triples have less weight */
static const real_t SHORTEST =
    PMF_R(0.5); /* samples between two edges of a triple; an instant that is late counts too much then */
static const real_t FEWEST = PMF_R(20.0); /* triples */
static const real_t SOME = PMF_R(10.0); /* triples that show the mass */
static const real_t MOST_WEIGHT = PMF_R(1024.0);
static const uint32_t FEWEST_WAYS = 2U; /* ways with a triple */
static const real_t UNSURE = PMF_R(0.09); /* squared standard deviation of a force over the input, and of the mass */
static const real_t OVERLAP = PMF_R(4.0); /* triples for one that is independent of the others */
static const real_t ROUNDING = PMF_R(1e-4); /* of the squared target: errors of the integral of the place */

static real_t divide_twice(const pmf_mark_t *const *mark, real_t a, real_t b, real_t c)
{
    real_t before = mark[1]->t - mark[0]->t, after = mark[2]->t - mark[1]->t;
    return ((c - b) / after - (b - a) / before) / (before + after);
}

/* Give the sums half of their weight, before they fill the digits of a float. */
static void halve_sums(pmf_start_t *start)
{
    uint32_t i, j;
    for (i = 0; i < PMF_BODY; ++i) {
        for (j = 0; j < PMF_BODY; ++j) {
            start->cross[i][j] *= PMF_R(0.5);
            start->square[i][j] *= PMF_R(0.5);
            start->own[i][j] *= PMF_R(0.5);
        }
        start->target[i] *= PMF_R(0.5);
        start->own_target[i] *= PMF_R(0.5);
    }
    start->energy *= PMF_R(0.5);
    start->weight *= PMF_R(0.5);
}

static void add_triple(const pmf_redge_config_t *config, pmf_start_t *start, const pmf_mark_t *const *mark)
{
    real_t before = mark[1]->t - mark[0]->t, after = mark[2]->t - mark[1]->t, target, weight;
    real_t phi[PMF_BODY], zeta[PMF_BODY];
    uint32_t i, j;
    weight = (before < after ? before : after) / config->dt;
    if (weight < SHORTEST) {
        return;
    }
    weight *= weight;
    weight /= weight + SPAN * SPAN;
    target = config->input_gain * divide_twice(mark, mark[0]->pushed, mark[1]->pushed, mark[2]->pushed);
    phi[MASS] = divide_twice(mark, mark[0]->line, mark[1]->line, mark[2]->line);
    phi[VISCOUS] = zeta[VISCOUS] = divide_twice(mark, mark[0]->placed, mark[1]->placed, mark[2]->placed);
    phi[COULOMB] = zeta[COULOMB] = PMF_R(0.5) * start->way;
#if PMF_BODY > 3
    phi[OFFSET] = zeta[OFFSET] = PMF_R(0.5);
#endif
    zeta[MASS] = target;
    for (i = 0; i < PMF_BODY; ++i) {
        for (j = 0; j < PMF_BODY; ++j) {
            start->cross[i][j] += weight * zeta[i] * phi[j];
            start->square[i][j] += weight * zeta[i] * zeta[j];
            start->own[i][j] += weight * phi[i] * phi[j];
        }
        start->target[i] += weight * zeta[i] * target;
        start->own_target[i] += weight * phi[i] * target;
    }
    start->energy += weight * target * target;
    start->weight += weight;
    start->ways += start->counted == 0U ? 1U : 0U;
    start->counted = 1U;
    if (start->weight > MOST_WEIGHT) {
        halve_sums(start);
    }
}

static void begin_way(pmf_start_t *start)
{
    start->marks = start->counted = 0U;
    start->t = start->push = start->pushed = PMF_R(0.0);
}

/* Drop the first mark, and let time, place and integrals begin at the next one. The differences are without what is
 * linear in time. */
static void drop_first(pmf_start_t *start)
{
    pmf_mark_t from = start->mark[1], last = start->mark[PMF_MARKS - 1];
    real_t slope = (last.pushed - from.pushed) / (last.t - from.t);
    uint32_t i;
    for (i = 0; i + 1U < PMF_MARKS; ++i) {
        pmf_mark_t *mark = &start->mark[i];
        *mark = start->mark[i + 1U];
        mark->t -= from.t;
        mark->pushed -= from.pushed + slope * mark->t;
        mark->placed -= from.placed + from.line * mark->t;
        mark->line -= from.line;
    }
    start->t -= from.t;
    start->pushed -= from.pushed + slope * start->t;
    start->push -= slope;
    start->marks -= 1U;
}

/* Return 1 if the axis may have rested or reversed between two edges of one way. It had to be braked before and driven
 * again, so the input rose in its direction. From rest to the next edge, or to rest from the last one, it moves at the
 * largest acceleration or below. */
static uint32_t may_have_rested(const pmf_redge_config_t *config, const pmf_start_t *start, real_t gap, real_t input)
{
    real_t force = absolute(config->input_gain * input) + absolute(start->theta[COULOMB]);
    uint32_t fast = gap * gap * force < PMF_R(2.0) * start->theta[MASS] ? 1U : 0U;
    return start->rose != 0U && gap > WAIT * config->dt && fast == 0U ? 1U : 0U;
}

/* Take an edge at `line` counts after the edge before, in the direction of `way`; 0 is the same line again. */
static void mark_edge(const pmf_redge_config_t *config, pmf_start_t *start, real_t line, real_t way, real_t input)
{
    pmf_mark_t next = {PMF_R(0.0), PMF_R(0.0), PMF_R(0.0), PMF_R(0.0)};
    const pmf_mark_t *mark[3];
    uint32_t apart, i;
    if (start->marks == PMF_MARKS) {
        drop_first(start);
    }
    if (start->marks != 0U) {
        const pmf_mark_t *last = &start->mark[start->marks - 1U];
        real_t gap = start->t - last->t;
        if (!(line * way > PMF_R(0.0)) || !(gap > PMF_R(0.0)) || way != start->way ||
            may_have_rested(config, start, gap, input) != 0U) {
            begin_way(start);
        } else {
            next.t = start->t;
            next.line = last->line + line;
            next.pushed = start->pushed;
            next.placed = last->placed + PMF_R(0.5) * (last->line + next.line) * gap;
        }
    }
    if (start->marks == 0U) {
        begin_way(start);
    }
    start->way = way;
    start->rose = 0U;
    start->mark[start->marks] = next;
    start->marks += 1U;
    for (apart = 1U; 2U * apart < start->marks; apart *= 2U) {
        for (i = 0; i < 3U; ++i) {
            mark[i] = &start->mark[start->marks - 1U - (2U - i) * apart];
        }
        add_triple(config, start, mark);
    }
}

/* Invert the first n rows and columns of a matrix by Gauss' elimination; return 0 if the matrix is singular. */
static uint32_t invert(real_t matrix[PMF_BODY][PMF_BODY], uint32_t n, real_t inverse[PMF_BODY][PMF_BODY])
{
    real_t a[PMF_BODY][2 * PMF_BODY];
    uint32_t i, j, k;
    for (i = 0; i < n; ++i) {
        for (j = 0; j < n; ++j) {
            a[i][j] = matrix[i][j];
            a[i][n + j] = i == j ? PMF_R(1.0) : PMF_R(0.0);
        }
    }
    for (i = 0; i < n; ++i) {
        uint32_t most = i;
        for (k = i + 1U; k < n; ++k) {
            most = absolute(a[k][i]) > absolute(a[most][i]) ? k : most;
        }
        if (!(absolute(a[most][i]) > PMF_R(0.0))) {
            return 0U;
        }
        for (j = i; j < 2U * n; ++j) {
            real_t swapped = a[i][j];
            a[i][j] = a[most][j];
            a[most][j] = swapped;
        }
        for (k = 0; k < n; ++k) {
            real_t ratio = a[k][i] / a[i][i];
            for (j = i; j < 2U * n && k != i; ++j) {
                a[k][j] -= ratio * a[i][j];
            }
        }
    }
    for (i = 0; i < n; ++i) {
        for (j = 0; j < n; ++j) {
            inverse[i][j] = a[i][n + j] / a[i][i];
        }
    }
    return 1U;
}

/* Return the variance of parameter i of n, of instrumental variables. */
static real_t variance_of(const pmf_start_t *start, real_t inverse[PMF_BODY][PMF_BODY], uint32_t n, real_t noise,
                          uint32_t i)
{
    real_t sum = PMF_R(0.0);
    uint32_t j, k;
    for (j = 0; j < n; ++j) {
        for (k = 0; k < n; ++k) {
            sum += inverse[i][j] * start->square[j][k] * inverse[i][k];
        }
    }
    return sum * noise * OVERLAP;
}

/* Solve for n parameters; return 1 if each force is known well enough to begin with. */
static uint32_t is_started(pmf_start_t *start, uint32_t n)
{
    real_t inverse[PMF_BODY][PMF_BODY], noise, power;
    uint32_t i, j, known;
    if (start->weight < SOME || start->ways < FEWEST_WAYS || invert(start->cross, n, inverse) == 0U) {
        return 0U;
    }
    for (i = 0; i < n; ++i) {
        start->theta[i] = PMF_R(0.0);
        for (j = 0; j < n; ++j) {
            start->theta[i] += inverse[i][j] * start->target[j];
        }
    }
    if (!(start->theta[MASS] > PMF_R(0.0))) {
        return 0U;
    }
    noise = start->energy;
    for (i = 0; i < n; ++i) {
        noise -= PMF_R(2.0) * start->theta[i] * start->own_target[i];
        for (j = 0; j < n; ++j) {
            noise += start->theta[i] * start->theta[j] * start->own[i][j];
        }
    }
    power = start->energy / start->weight;
    noise = (noise > PMF_R(0.0) ? noise : PMF_R(0.0)) / start->weight + ROUNDING * power;
    known = start->weight < FEWEST ? 0U : 1U;
    known &= variance_of(start, inverse, n, noise, MASS) < UNSURE * start->theta[MASS] * start->theta[MASS] ? 1U : 0U;
    for (i = 0; i < n; ++i) {
        real_t force = start->own[i][i] / start->weight;
        known &= variance_of(start, inverse, n, noise, i) * force < UNSURE * power ? 1U : 0U;
    }
    return known;
}
