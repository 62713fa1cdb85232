/* SPDX-License-Identifier: Apache-2.0 */
#include "elastic.h"
#include <math.h>
#include <string.h>

#define ORDER 14 /* most terms of the series, whose error is 1e-12 within REACH */
#define REACH 1.0 /* largest product of a step and the fastest rate */
#define MOST_STEPS 10 /* steps within an interval; a faster pair counts as an overflow */
/* Stops and starts within a step, after which friction keeps its direction until the step ends. */
#define MOST_TURNS 32
#define LENGTHS 6 /* of steps with matrices of their own */
#define OFTEN 8 /* steps of one length after which its matrices pay */
#define INPUTS 5 /* of a step: v, x2 - x, v2 and both forces */
#define SOURCES 6 /* parameters that multiply the state */

static const int MASS[2] = {PMF_BODY_MASS, PMF_ELASTIC_MASS};
static const int VISCOUS[2] = {PMF_BODY_VISCOUS, PMF_ELASTIC_VISCOUS};
static const int COULOMB[2] = {PMF_BODY_COULOMB, PMF_ELASTIC_COULOMB};

static const int SOURCE[SOURCES] = {PMF_BODY_MASS,       PMF_BODY_VISCOUS,      PMF_ELASTIC_MASS,
                                    PMF_ELASTIC_VISCOUS, PMF_ELASTIC_STIFFNESS, PMF_ELASTIC_DAMPING};

typedef double series[4][ORDER + 1]; /* of x, v, x2, v2 */

/* Derivatives after a step of h seconds without stops and starts, from those before: of the state by v, x2 - x and v2,
 * by the forces, and by the parameters that multiply the state, for each of the inputs. */
typedef struct {
    double h, state[4][3], force[4][2], source[4][INPUTS][SOURCES];
    int hits;
} flight;

typedef struct {
    const pmf_body *b;
    const double *theta, *size; /* parameters, and sizes of the forces among them */
    double *p; /* (forces) constants, from the parameters if free */
    int w, late, slopes; /* number of parameters; index of the present input; whether derivatives are asked for */
    int order; /* number of terms of the series */
    int side[2]; /* direction of each mass, 0 at rest */
    int touch; /* side of the gap that touches, 0 within the gap; without a gap 1 */
    double k, c, bias; /* stiffness, damping and force at twist 0 of the present contact */
    double z[4]; /* x, v, x2, v2 */
    double *dz[4], *mid[4],
        *term[4]; /* (w) derivatives of the state, in the middle of a step, and of a power of time */
    double *dn[2]; /* (w) derivatives of the forces on each mass */
    double net[2], light[2]; /* forces of the present series; one over each mass */
    flight (*flights)[LENGTHS]; /* by the directions of both masses, and whether they touch */
} pair;

/* Let the masses touch at one side of the gap, or at none. */
static void touch_at(pair *t, int side)
{
    t->touch = side;
    t->k = side ? t->theta[PMF_ELASTIC_STIFFNESS] : 0;
    t->c = side ? t->theta[PMF_ELASTIC_DAMPING] : 0;
    t->bias = -0.5 * side * t->k * t->theta[PMF_ELASTIC_PLAY];
}

static double column_at(const pair *t, const pmf_force *f, int i)
{
    return f->kind < PMF_FORCE_COLUMN ? 0 : t->b->column[(long)f->column * t->b->n + i];
}

static double drag(const pair *t, int side)
{
    return t->theta[VISCOUS[side]] + (side ? 0 : t->side[0] * t->theta[PMF_BODY_DIRECTIONAL]);
}

/* Sum of friction and further forces on a mass at rest that is about to move in direction s. */
static double hold(const pair *t, int side, double s, int i)
{
    double sum = s * t->theta[COULOMB[side]];
    for (int j = 0; j < t->b->forces; j++) {
        const pmf_force *f = t->b->force + j;
        if (f->load == side && t->size[j] != 0)
            sum += t->size[j] * pmf_force_at(f, t->p[j], t->z[2 * side], 0, s, column_at(t, f, i)).h;
    }
    return sum;
}

/* Force on a mass by the input and the spring. */
static double pull(const pair *t, int side, double drive)
{
    const double tie = t->k * (t->z[0] - t->z[2]) + t->c * (t->z[1] - t->z[3]) + t->bias;
    return side ? tie : drive - tie;
}

/* Net force on a mass at rest, with its direction in *s; 0 if the mass stays at rest. */
static double start_force(const pair *t, int side, double drive, int i, int *s)
{
    const double force = pull(t, side, drive);
    const double ahead = force - hold(t, side, 1, i), back = force - hold(t, side, -1, i);
    *s = ahead > 0 && (back >= 0 || force >= 0) ? 1 : back < 0 ? -1 : 0;
    return *s > 0 ? ahead : *s < 0 ? back : 0;
}

/* Force on a moving mass without drag and spring, at the state z; its derivatives along dz go to dn. */
static double net_force(pair *t, int side, const double z[4], double drive, int i, double *const dz[4])
{
    const pmf_body *b = t->b;
    const int s = t->side[side];
    const double sign = side ? 1 : -1; /* of the tie */
    double net = (side ? 0 : drive) - s * t->theta[COULOMB[side]] + sign * t->bias, gx = 0, gv = 0, *dn = t->dn[side];
    int shape = PMF_ELASTIC_BASE + b->forces;
    memset(dn, 0, t->w * sizeof *dn);
    for (int j = 0; j < b->forces; j++) {
        const pmf_force *f = b->force + j;
        const int constant = f->unknown ? shape++ : 0;
        if (f->load != side)
            continue;
        pmf_push r = pmf_force_at(f, t->p[j], z[2 * side], z[2 * side + 1], s, column_at(t, f, i));
        dn[PMF_ELASTIC_BASE + j] = -r.h;
        if (f->unknown)
            dn[constant] = -t->size[j] * r.hp;
        net -= t->size[j] * r.h;
        gx += t->size[j] * r.hx;
        gv += t->size[j] * r.hv;
    }
    if (gx != 0 || gv != 0)
        for (int k = 0; k < t->w; k++)
            dn[k] -= gx * dz[2 * side][k] + gv * dz[2 * side + 1][k];
    dn[COULOMB[side]] -= s;
    if (t->bias != 0) {
        dn[PMF_ELASTIC_STIFFNESS] -= sign * 0.5 * t->touch * t->theta[PMF_ELASTIC_PLAY];
        dn[PMF_ELASTIC_PLAY] -= sign * 0.5 * t->touch * t->k;
    }
    if (!side)
        dn[PMF_BODY_OFFSET] -= 1;
    return net;
}

/* Series of the motion under constant forces `net`. */
static void expand(pair *t, const double net[2], series c)
{
    const double k = t->k, damping = t->c, d1 = drag(t, 0), d2 = drag(t, 1);
    const double m1 = t->side[0] ? t->light[0] : 0, m2 = t->side[1] ? t->light[1] : 0;
    double f1 = net[0], f2 = net[1];
    t->net[0] = f1, t->net[1] = f2;
    for (int r = 0; r < 4; r++)
        c[r][0] = t->z[r];
    for (int j = 0; j < t->order; j++, f1 = f2 = 0) {
        const double tie = k * (c[0][j] - c[2][j]) + damping * (c[1][j] - c[3][j]), part = 1.0 / (j + 1);
        c[0][j + 1] = c[1][j] * part;
        c[2][j + 1] = c[3][j] * part;
        c[1][j + 1] = (f1 - tie - d1 * c[1][j]) * m1 * part;
        c[3][j + 1] = (f2 + tie - d2 * c[3][j]) * m2 * part;
    }
}

static double value_at(const double *c, int order, double h, double *slope)
{
    double sum = 0, rise = 0;
    for (int j = order; j >= 0; j--) {
        rise = rise * h + sum;
        sum = sum * h + c[j];
    }
    *slope = rise;
    return sum;
}

/* Zero in (a, b) of a series that falls, or of its slope that rises. */
static double zero_of(const double *c, int order, double a, double b, int of_slope)
{
    for (int turn = 0; turn < 60 && b - a > 1e-15 * b; turn++) {
        double rise, middle = 0.5 * (a + b), value = value_at(c, order, middle, &rise);
        if (!of_slope && rise < 0) { /* Newton's method where it stays inside */
            const double next = middle - value / rise;
            if (next > a && next < b) {
                double r, v = value_at(c, order, next, &r);
                if (v > 0)
                    a = next;
                else
                    b = next;
                continue;
            }
        }
        if ((of_slope ? -rise : value) > 0)
            a = middle;
        else
            b = middle;
    }
    return b;
}

/* First time in (0, h] at which a series that starts at 0 or above falls below 0; HUGE_VAL if it does not. */
static double first_zero(const double *c, int order, double h)
{
    double power = h, far = 0, a = 0, slope = c[1];
    for (int j = 1; j <= order; j++, power *= h)
        far += fabs(c[j]) * power;
    if (c[0] > far)
        return HUGE_VAL;
    far = -1e-13 * (far + fabs(c[0]));
    for (int part = 1; part <= 4; part++) {
        double rise, b = h * part / 4;
        if (value_at(c, order, b, &rise) < far)
            return zero_of(c, order, a, b, 0);
        if (slope < 0 && rise > 0) {
            double flat, low = zero_of(c, order, a, b, 1);
            if (value_at(c, order, low, &flat) < far)
                return zero_of(c, order, a, low, 0);
        }
        a = b, slope = rise;
    }
    return HUGE_VAL;
}

/* Time until a mass stops or starts within h, with the direction of a start in *s. */
static double next_turn(const pair *t, int side, series c, double drive, double h, int i, int *s)
{
    double g[ORDER + 1], first = HUGE_VAL;
    if (t->side[side]) {
        *s = 0;
        for (int j = 0; j <= t->order; j++)
            g[j] = t->side[side] * c[2 * side + 1][j];
        return first_zero(g, t->order, h);
    }
    for (int way = -1; way <= 1; way += 2) {
        for (int j = 0; j <= t->order; j++) {
            const double tie = t->k * (c[0][j] - c[2][j]) + t->c * (c[1][j] - c[3][j]) + (j ? 0 : t->bias);
            g[j] = way * (side ? -tie : tie);
        }
        g[0] += way * (hold(t, side, way, i) - (side ? 0 : drive));
        const double time = first_zero(g, t->order, h);
        if (time < first)
            first = time, *s = way;
    }
    return first;
}

/* Time until the masses touch or part within h, with the next side of the gap in *side. */
static double next_touch(const pair *t, series c, double h, int *side)
{
    const double half = 0.5 * t->theta[PMF_ELASTIC_PLAY];
    double g[ORDER + 1], first = HUGE_VAL;
    if (half == 0)
        return first;
    for (int way = -1; way <= 1; way += 2) {
        if (t->touch && way != t->touch)
            continue;
        for (int j = 0; j <= t->order; j++)
            g[j] = (t->touch ? way : -way) * (c[0][j] - c[2][j]);
        g[0] += t->touch ? -half : half;
        const double time = first_zero(g, t->order, h);
        if (time < first)
            first = time, *side = t->touch ? 0 : way;
    }
    return first;
}

/* Derivatives of the state after h seconds of a series, from those before. */
static void follow(const pair *t, series c, double h, double *const to[4])
{
    const double k = t->k, damping = t->c, d1 = drag(t, 0), d2 = drag(t, 1);
    const double m1 = t->side[0] ? t->light[0] : 0, m2 = t->side[1] ? t->light[1] : 0;
    double *restrict x1 = t->term[0], *restrict v1 = t->term[1], *restrict x2 = t->term[2], *restrict v2 = t->term[3];
    const double *restrict n1 = t->dn[0], *restrict n2 = t->dn[1];
    double power = 1;
    for (int r = 0; r < 4; r++) {
        memcpy(t->term[r], t->dz[r], t->w * sizeof(double));
        if (to[r] != t->dz[r])
            memcpy(to[r], t->dz[r], t->w * sizeof(double));
    }
    for (int j = 0; j < t->order; j++) {
        const double scale = h / (j + 1), f1 = scale * m1, f2 = scale * m2, once = j ? 0 : 1;
        for (int q = 0; q < t->w; q++) {
            const double tie = k * (x1[q] - x2[q]) + damping * (v1[q] - v2[q]);
            const double a1 = f1 * (once * n1[q] - tie - d1 * v1[q]), a2 = f2 * (once * n2[q] + tie - d2 * v2[q]);
            x1[q] = scale * v1[q];
            x2[q] = scale * v2[q];
            v1[q] = a1;
            v2[q] = a2;
        }
        /* power is h^j */
        const double g1 = f1 * power, g2 = f2 * power, twist = c[0][j] - c[2][j], slip = c[1][j] - c[3][j];
        v1[PMF_BODY_MASS] -= g1 * (j + 1) * c[1][j + 1];
        v2[PMF_ELASTIC_MASS] -= g2 * (j + 1) * c[3][j + 1];
        v1[PMF_BODY_VISCOUS] -= g1 * c[1][j];
        v1[PMF_BODY_DIRECTIONAL] -= g1 * t->side[0] * c[1][j];
        v2[PMF_ELASTIC_VISCOUS] -= g2 * c[3][j];
        if (t->touch) {
            v1[PMF_ELASTIC_STIFFNESS] -= g1 * twist;
            v2[PMF_ELASTIC_STIFFNESS] += g2 * twist;
            v1[PMF_ELASTIC_DAMPING] -= g1 * slip;
            v2[PMF_ELASTIC_DAMPING] += g2 * slip;
        }
        power *= h;
        for (int r = 0; r < 4; r++) {
            double *restrict sum = to[r];
            const double *restrict term = t->term[r];
            for (int q = 0; q < t->w; q++)
                sum[q] += term[q];
        }
    }
}

/* Find the matrices of a step from the motion at each unit input. */
static void find_flight(const pair *t, flight *f)
{
    double room[10][PMF_ELASTIC_BASE];
    pair u = *t;
    u.w = PMF_ELASTIC_BASE;
    for (int r = 0; r < 4; r++)
        u.dz[r] = room[r], u.term[r] = room[4 + r];
    u.dn[0] = room[8], u.dn[1] = room[9];
    for (int i = 0; i <= INPUTS; i++) {
        const double net[2] = {i == 3, i == 4};
        series c;
        memset(room, 0, sizeof room);
        for (int r = 0; r < 4; r++)
            u.z[r] = r == i + 1;
        if (i == INPUTS)
            room[1][0] = room[2][1] = room[3][2] = room[8][3] = room[9][4] = 1;
        expand(&u, net, c);
        follow(&u, c, f->h, u.dz);
        for (int r = 0; r < 4; r++)
            if (i < INPUTS)
                for (int k = 0; k < SOURCES; k++)
                    f->source[r][i][k] = room[r][SOURCE[k]];
            else
                memcpy(f->state[r], room[r], sizeof f->state[r]), memcpy(f->force[r], room[r] + 3, sizeof f->force[r]);
    }
}

/* Matrices of a step of h seconds if steps of this length are frequent, otherwise null. */
static const flight *flight_of(const pair *t, double h)
{
    flight *f = t->flights[3 * t->side[0] + t->side[1] + 4 + (t->touch ? 0 : 9)], *rare = f, *end = f + LENGTHS;
    for (; f < end && fabs(f->h - h) > 1e-9 * h; f++)
        if (f->hits < rare->hits)
            rare = f;
    if (f < end && f->hits < OFTEN && ++f->hits == OFTEN)
        find_flight(t, f);
    else if (f == end && rare->hits < OFTEN)
        rare->h = h, rare->hits = 0;
    return f < end && f->hits == OFTEN ? f : NULL;
}

/* Add what the parameters and forces themselves change within a step. */
static void add_sources(const pair *t, const flight *f, double *const to[4])
{
    const double input[INPUTS] = {t->z[1], t->z[2] - t->z[0], t->z[3], t->net[0], t->net[1]};
    for (int r = 0; r < 4; r++) {
        double sum[SOURCES] = {0}, *out = to[r];
        const double f1 = f->force[r][0], f2 = f->force[r][1], *n1 = t->dn[0], *n2 = t->dn[1];
        for (int i = 0; i < INPUTS; i++)
            for (int k = 0; k < SOURCES; k++)
                sum[k] += f->source[r][i][k] * input[i];
        for (int k = 0; k < SOURCES; k++)
            out[SOURCE[k]] += sum[k];
        out[PMF_BODY_DIRECTIONAL] += t->side[0] * sum[1];
        if (t->b->forces) {
            for (int q = 0; q < t->w; q++)
                out[q] += f1 * n1[q] + f2 * n2[q];
        } else {
            out[PMF_BODY_COULOMB] += f1 * n1[PMF_BODY_COULOMB];
            out[PMF_BODY_OFFSET] += f1 * n1[PMF_BODY_OFFSET];
            out[PMF_ELASTIC_COULOMB] += f2 * n2[PMF_ELASTIC_COULOMB];
            out[PMF_ELASTIC_STIFFNESS] += f1 * n1[PMF_ELASTIC_STIFFNESS] + f2 * n2[PMF_ELASTIC_STIFFNESS];
            out[PMF_ELASTIC_PLAY] += f1 * n1[PMF_ELASTIC_PLAY] + f2 * n2[PMF_ELASTIC_PLAY];
        }
    }
}

/* Derivatives of the state after h seconds of a series, from those before. */
static void carry(pair *t, series c, double h, double *to[4])
{
    const flight *f = flight_of(t, h);
    const double *x1 = t->dz[0], *v1 = t->dz[1], *x2 = t->dz[2], *v2 = t->dz[3];
    if (!f) {
        follow(t, c, h, to);
        return;
    }
    double **out = to == t->dz ? t->term : to;
    for (int r = 0; r < 4; r++) {
        const double *restrict v = v1, *restrict w = v2, *restrict x = x1, *restrict y = x2;
        const double a = f->state[r][0], b = f->state[r][1], d = f->state[r][2], keep = r % 2 == 0;
        double *restrict sum = out[r];
        for (int q = 0; q < t->w; q++)
            sum[q] = keep * x[q] + a * v[q] + b * (y[q] - x[q]) + d * w[q];
    }
    add_sources(t, f, out);
    for (int r = 0; r < 4 && to == t->dz; r++) {
        double *const before = t->dz[r];
        t->dz[r] = t->term[r], t->term[r] = before;
    }
}

/* Series of the next step of h seconds, with forces in its middle. */
static void plan(pair *t, int i, double drive, double h, series c)
{
    double net[2], z[4], s;
    for (int side = 0; side < 2; side++)
        net[side] =
            t->side[side] ? net_force(t, side, t->z, drive, i, t->dz) : (memset(t->dn[side], 0, t->w * sizeof s), 0);
    expand(t, net, c);
    if (!t->b->forces)
        return;
    for (int side = 0, way; side < 2; side++)
        h = fmin(h, next_turn(t, side, c, drive, h, i, &way));
    h = fmin(h, next_touch(t, c, h, &(int){0}));
    if (t->slopes)
        carry(t, c, h / 2, t->mid);
    for (int r = 0; r < 4; r++)
        z[r] = value_at(c[r], t->order, h / 2, &s);
    for (int side = 0; side < 2; side++)
        if (t->side[side]) {
            z[2 * side + 1] = t->side[side] * z[2 * side + 1] > 0 ? z[2 * side + 1] : 0;
            net[side] = net_force(t, side, z, drive, i, t->mid);
        }
    expand(t, net, c);
}

/* A mass stops: the stop moves in time, so that the derivatives of its velocity scale with the acceleration. */
static void stop(pair *t, int side, double drive, double slowing, int i)
{
    double *dv = t->dz[2 * side + 1], ratio;
    t->z[2 * side + 1] = 0;
    ratio = start_force(t, side, drive, i, &t->side[side]) / t->theta[MASS[side]] / slowing;
    for (int k = 0; k < t->w; k++)
        dv[k] = t->side[side] ? dv[k] * ratio : 0;
}

/* The masses touch or part: the force of the damping jumps at an instant that moves. A mass at rest may start. */
static void switch_touch(pair *t, int side, double drive, int i)
{
    const double way = side ? side : t->touch, slip = t->z[1] - t->z[3];
    const double jump = side ? t->theta[PMF_ELASTIC_DAMPING] : -t->theta[PMF_ELASTIC_DAMPING];
    double kick[2]; /* jumps of the accelerations over the slip */
    touch_at(t, side);
    for (int mass = 0; mass < 2; mass++)
        if (t->side[mass])
            kick[mass] = (mass ? jump : -jump) * t->light[mass];
        else
            kick[mass] = slip != 0 ? start_force(t, mass, drive, i, &t->side[mass]) * t->light[mass] / slip : 0;
    for (int k = 0; k < t->w; k++) {
        const double twist = t->dz[0][k] - t->dz[2][k] - (k == PMF_ELASTIC_PLAY ? 0.5 * way : 0);
        t->dz[1][k] += kick[0] * twist;
        t->dz[3][k] += kick[1] * twist;
    }
}

/* Move for `left` seconds in sample i. */
static void move(pair *t, int i, double left)
{
    const double drive = t->b->u[t->late] - t->theta[PMF_BODY_OFFSET];
    for (int side = 0; side < 2; side++) {
        const double v = t->z[2 * side + 1];
        if (v != 0)
            t->side[side] = v > 0 ? 1 : -1;
        else if (start_force(t, side, drive, i, &t->side[side]) == 0)
            memset(t->dz[2 * side + 1], 0, t->w * sizeof(double));
    }
    for (int turn = 0; left > 0; turn++) {
        series c;
        double step = left, slope[4];
        int turned = -1, way = 0, next = 0;
        plan(t, i, drive, left, c);
        for (int side = 0; side < 2 && turn < MOST_TURNS; side++) {
            int s = 0;
            const double time = next_turn(t, side, c, drive, left, i, &s);
            if (time < step || (time == step && turned < 0))
                step = time, turned = side, way = s;
        }
        const double gap = turn < MOST_TURNS ? next_touch(t, c, step, &next) : HUGE_VAL;
        if (gap < step)
            step = gap, turned = -1;
        if (t->slopes)
            carry(t, c, step, t->dz);
        for (int r = 0; r < 4; r++)
            t->z[r] = value_at(c[r], t->order, step, slope + r);
        left -= step;
        if (step == gap)
            switch_touch(t, next, drive, i);
        else if (turned >= 0 && t->side[turned])
            stop(t, turned, drive, slope[2 * turned + 1], i);
        else if (turned >= 0)
            t->side[turned] = way;
    }
}

/* The input switches: derivatives by the delay. */
static void switch_input(pair *t, int i, double before, double next)
{
    const double offset = t->theta[PMF_BODY_OFFSET];
    double change = before - next;
    int s;
    if (t->z[1] == 0)
        change = start_force(t, 0, before - offset, i, &s) - start_force(t, 0, next - offset, i, &s);
    t->dz[1][PMF_BODY_DELAY] += change / t->theta[PMF_BODY_MASS];
}

/* Move through interval i, in equal steps that end where the input switches. `wait` is the time to the next switch. */
static void move_interval(pair *t, int i, int steps, double *wait)
{
    const double h = t->b->step[i] / steps, small = 1e-9 * h;
    for (int part = 0; part < steps; part++)
        for (double left = h; left > small;) {
            while (*wait <= small && t->late + 1 < t->b->n) {
                switch_input(t, i, t->b->u[t->late], t->b->u[t->late + 1]);
                t->late++;
                *wait += t->b->step[t->late];
            }
            double step = *wait < left && t->late + 1 < t->b->n ? *wait : left;
            move(t, i, step);
            left -= step;
            *wait -= step;
        }
}

/* Terms of the series within a step, for its product with the fastest rate. */
static int order_of(double reach)
{
    double term = reach;
    int order = 1;
    while (order < ORDER && term > 1e-12)
        term *= reach / ++order;
    return order;
}

/* Fastest rate of the pair [1/s]. */
static double rate_of(const double *theta)
{
    const double m = 1 / theta[PMF_BODY_MASS], m2 = 1 / theta[PMF_ELASTIC_MASS], c = theta[PMF_ELASTIC_DAMPING];
    const double drag =
        fmax((theta[PMF_BODY_VISCOUS] + fabs(theta[PMF_BODY_DIRECTIONAL])) * m, theta[PMF_ELASTIC_VISCOUS] * m2);
    return sqrt(theta[PMF_ELASTIC_STIFFNESS] * (m + m2)) + c * (m + m2) + drag;
}

int pmf_elastic_run(const pmf_body *b, const double *theta, double *y, double *v, double *S, double *work)
{
    const int w = PMF_ELASTIC_BASE + b->forces + b->shapes, parts = b->forces ? b->parts : 1;
    const int shown = b->side ? 2 : 0, other = 2 - shown; /* places in the state */
    const double rate = rate_of(theta);
    double wait = b->step[0] + theta[PMF_BODY_DELAY];
    flight flights[18][LENGTHS];
    pair t = {0};
    for (int j = 0; j < 18 * LENGTHS; j++)
        flights[j / LENGTHS][j % LENGTHS].h = 0, flights[j / LENGTHS][j % LENGTHS].hits = -1;
    t.flights = flights;
    t.light[0] = 1 / theta[PMF_BODY_MASS], t.light[1] = 1 / theta[PMF_ELASTIC_MASS];
    t.b = b, t.theta = theta, t.size = theta + PMF_ELASTIC_BASE, t.w = w, t.slopes = S != NULL;
    for (int r = 0; r < 4; r++)
        t.dz[r] = work + r * w, t.mid[r] = work + (4 + r) * w, t.term[r] = work + (8 + r) * w;
    t.dn[0] = work + 12 * w, t.dn[1] = work + 13 * w, t.p = work + 14 * w;
    memset(work, 0, 15 * w * sizeof *work);
    t.z[shown] = theta[PMF_BODY_X0], t.z[shown + 1] = theta[PMF_BODY_V0];
    t.z[other] = t.z[shown] + theta[PMF_ELASTIC_TWIST], t.z[other + 1] = t.z[shown + 1] + theta[PMF_ELASTIC_SLIP];
    const double twist = t.z[0] - t.z[2], half = 0.5 * theta[PMF_ELASTIC_PLAY];
    touch_at(&t, half == 0 || twist > half ? 1 : twist < -half ? -1 : 0);
    for (int j = 0, shape = PMF_ELASTIC_BASE + b->forces; j < b->forces; j++)
        t.p[j] = b->force[j].unknown ? theta[shape++] : b->force[j].p;
    t.dz[0][PMF_BODY_X0] = t.dz[2][PMF_BODY_X0] = t.dz[other][PMF_ELASTIC_TWIST] = 1;
    t.dz[1][PMF_BODY_V0] = t.dz[3][PMF_BODY_V0] = t.dz[other + 1][PMF_ELASTIC_SLIP] = 1;
    for (int i = 0, k = 0; k < b->rows; i++) {
        if (!(fabs(t.z[0]) < 1e150 && fabs(t.z[1]) < 1e150 && fabs(t.z[2]) < 1e150 && fabs(t.z[3]) < 1e150))
            return k;
        if (i == b->row[k]) {
            y[k] = t.z[shown];
            if (v)
                v[k] = t.z[shown + 1];
            if (S)
                pmf_body_chain(b, t.dz[shown], S + (size_t)k * b->coordinates);
            k++;
        }
        if (i < b->n) {
            const double steps = ceil(b->step[i] * rate / REACH);
            if (!(steps <= MOST_STEPS))
                return k;
            if (i == 0 || b->step[i] != b->step[i - 1])
                t.order = order_of(b->step[i] * rate / fmax(steps, parts));
            move_interval(&t, i, steps > parts ? (int)steps : parts, &wait);
        }
    }
    return b->rows;
}

void pmf_elastic_drive(int n, int parts, double step, const double *x, const double load[4], double *force)
{
    const double keep = 1 / (1 + step * (load[1] + load[2])), rub = step * load[3];
    double y = x[0], v = 0, speed = 0;
    force[0] = 0;
    for (int i = 1; i < n; i++) {
        for (int part = 0; part < parts; part++, x++) {
            speed = (x[1] - x[0]) / step;
            v = (v + step * (load[0] * (x[0] - y) + load[1] * speed)) * keep;
            v = v > rub ? v - rub : v < -rub ? v + rub : 0;
            y += step * v;
        }
        force[i] = load[0] * (x[0] - y) + load[1] * (speed - v);
    }
}
