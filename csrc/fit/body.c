/* SPDX-License-Identifier: Apache-2.0 */
#include "body.h"
#include <math.h>
#include <string.h>

enum { MOST_PARTS = 10000 }; /* of an interval */
enum { MOST_TURNS = 16 }; /* stops within a part, after which the mass rests until the part ends */
enum { RECALLED = 8 }; /* arguments of `phi` that parts and halves share; a power of two */

/* (1 - exp(-z)) / z, (z - 1 + exp(-z)) / z^2 and their derivatives. */
typedef struct {
    double e, p1, p2, q1, q2;
} phi;

static phi phi_of(double z)
{
    phi f;
    f.e = exp(-z);
    if (fabs(z) < 0.05) {
        f.p1 = 1 - z / 2 * (1 - z / 3 * (1 - z / 4 * (1 - z / 5 * (1 - z / 6))));
        f.p2 = 0.5 * (1 - z / 3 * (1 - z / 4 * (1 - z / 5 * (1 - z / 6 * (1 - z / 7)))));
        f.q1 = -0.5 + z / 3 * (1 - 3 * z / 8 * (1 - 4 * z / 15 * (1 - 5 * z / 24)));
        f.q2 = -1.0 / 6 + z / 12 * (1 - 3 * z / 10 * (1 - 2 * z / 9 * (1 - 5 * z / 28)));
    } else {
        f.p1 = (1 - f.e) / z;
        f.p2 = (1 - f.p1) / z;
        f.q1 = (f.e - f.p1) / z;
        f.q2 = (-f.q1 - f.p2) / z;
    }
    return f;
}

/* First moment of a force about its mean in a part of an interval, with its derivatives by delay and lag. */
typedef struct {
    double value, by_delay, by_lag;
} moment;

typedef struct {
    const pmf_body *b;
    const double *theta, *size; /* parameters, and sizes of the forces among them */
    double *p; /* (forces) constants, from the parameters if free */
    int w, late; /* number of derivatives; index of the present input */
    double z[RECALLED]; /* arguments of `f` */
    phi f[RECALLED];
    int last; /* place of the last new argument */
    double x, v, g; /* position, velocity, force of the input after its lag */
    double g_delay, g_lag; /* derivatives of g */
    moment m1; /* of the input's force */
    double gx, gv; /* slopes of the forces by position and velocity at the last net force */
    double *dx, *dv; /* (w) derivatives */
    double *dn, *mx, *mv; /* (w) derivatives of the force; of the state in the middle of a part */
    const double *loop; /* parameters of the controller */
    int loaded; /* whether a friction is in proportion to the load */
    double *s, *ms, *ds, *dms; /* (1 + forces) memories of the controller; (1 + forces, w) derivatives */
    double *dq, *dT; /* (w) derivatives of the controller's force; of the load */
} state;

static const phi *recall(state *t, double z)
{
    for (int k = t->last; k > t->last - RECALLED; k--)
        if (z == t->z[k & (RECALLED - 1)])
            return t->f + (k & (RECALLED - 1));
    t->last = (t->last + 1) & (RECALLED - 1);
    t->z[t->last] = z, t->f[t->last] = phi_of(z);
    return t->f + t->last;
}

static int is_load_friction(const pmf_force *f)
{
    return f->kind == PMF_FORCE_LOAD || f->kind == PMF_FORCE_LOAD_STRIBECK;
}

static int in_loop(const pmf_force *f)
{
    return f->kind >= PMF_LOOP_FILTERED;
}

/* Whether a force is a load, which does not depend on the motion's direction. */
static int is_load(const pmf_force *f)
{
    return f->kind == PMF_FORCE_WAVE || f->kind == PMF_FORCE_SPRING || f->kind == PMF_FORCE_PLACE ||
           f->kind == PMF_FORCE_COLUMN;
}

static double column_at(const state *t, const pmf_force *f, int i)
{
    return f->kind < PMF_FORCE_COLUMN || f->kind > PMF_FORCE_COLUMN_VISCOUS
               ? 0
               : t->b->column[(long)f->column * t->b->n + i];
}

/* Sum of the forces at velocity v in direction s, under a drive that has the constant load already. */
static double sum_forces(const state *t, double v, double s, int i, double drive)
{
    double sum = 0, load = t->theta[PMF_BODY_OFFSET], motor = drive + load;
    for (int j = 0; t->loaded && j < t->b->forces; j++) {
        const pmf_force *f = t->b->force + j;
        if (is_load(f))
            load += t->size[j] * pmf_force_at(f, t->p[j], t->x, 0, 1, column_at(t, f, i)).h;
        else if (f->kind == PMF_FORCE_COLUMN_VISCOUS)
            motor -= t->size[j] * v * column_at(t, f, i);
    }
    for (int j = 0; j < t->b->forces; j++) {
        const pmf_force *f = t->b->force + j;
        const double column = is_load_friction(f) ? fabs(motor + (1 - f->q) * load) : column_at(t, f, i);
        if (t->size[j] != 0 && !in_loop(f))
            sum += t->size[j] * pmf_force_at(f, t->p[j], t->x, v, s, column).h;
    }
    return sum;
}

#include "controller.inl"

static void swap(double **a, double **b)
{
    double *c = *a;
    *a = *b;
    *b = c;
}

/* The mass rests for h seconds. */
static void rest(state *t, double h, double g, double g_delay, double g_lag)
{
    memset(t->dv, 0, t->w * sizeof *t->dv);
    if (!t->loop)
        return;
    carry_memories(t, h, g, g_delay, g_lag, t->x, 0, t->dx, t->dv, t->x, 0, t->dx, t->dv);
    swap(&t->s, &t->ms);
    swap(&t->ds, &t->dms);
}

/* Net force at rest: what remains of `drive` beyond friction, with its direction in *s; 0 if the mass rests. */
static double start_force(const state *t, double drive, int i, double *s)
{
    const double F = t->theta[PMF_BODY_COULOMB];
    double ahead = drive - F - sum_forces(t, 0, 1, i, drive), back = drive + F - sum_forces(t, 0, -1, i, drive);
    *s = ahead > 0 ? 1 : -1;
    if (ahead > 0 && back < 0)
        return *s = drive >= 0 ? 1 : -1, drive >= 0 ? ahead : back;
    return ahead > 0 ? ahead : back < 0 ? back : 0;
}

/* Friction under motor and load, with its slopes by both. Its own derivatives leave dn (w). */
static double load_friction(state *t, double v, double s, double motor, double load, double *by_motor, double *by_load)
{
    double sum = 0;
    int shape = PMF_BODY_BASE + t->b->forces;
    for (int j = 0; j < t->b->forces; j++) {
        const pmf_force *f = t->b->force + j;
        if (is_load_friction(f)) {
            const double T = motor + (1 - f->q) * load, size = fabs(T), a = t->size[j];
            const pmf_push r = pmf_force_at(f, t->p[j], 0, v, s, 1);
            const double by_T = T > 0 ? a * r.h : -a * r.h;
            sum += a * r.h * size;
            t->dn[PMF_BODY_BASE + j] -= r.h * size;
            if (f->unknown)
                t->dn[shape] -= a * r.hp * size;
            *by_motor += by_T;
            *by_load += (1 - f->q) * by_T;
            t->gv += a * r.hv * size;
        }
        shape += f->unknown;
    }
    return sum;
}

/* Net force without viscous friction in direction s at (x, v); its derivatives dn (w) along (dx, dv). The derivatives
 * of the drive are dq (w) with a controller and zero without. */
static double net_force(state *t, double x, double v, double s, double drive, int i, const double *dx, const double *dv)
{
    const pmf_body *b = t->b;
    double net = drive - s * t->theta[PMF_BODY_COULOMB], load = t->theta[PMF_BODY_OFFSET], motor = drive + load;
    double of_load = 0, of_motor = 0, by_motor = 0, by_load = 0, *dn = t->dn, *dT = t->dT; /* dT at a fixed position */
    int shape = PMF_BODY_BASE + b->forces;
    t->gx = t->gv = 0;
    memset(dn, 0, t->w * sizeof *dn);
    memset(dT, 0, t->w * sizeof *dT);
    for (int j = 0; j < b->forces; j++) {
        const pmf_force *f = b->force + j;
        const int own = shape;
        const double a = t->size[j];
        shape += f->unknown;
        if (in_loop(f) || is_load_friction(f))
            continue;
        const pmf_push r = pmf_force_at(f, t->p[j], x, v, s, column_at(t, f, i));
        dn[PMF_BODY_BASE + j] -= r.h;
        if (f->unknown)
            dn[own] -= a * r.hp;
        net -= a * r.h;
        t->gx += a * r.hx;
        t->gv += a * r.hv;
        if (t->loaded && f->kind == PMF_FORCE_COLUMN_VISCOUS) {
            motor -= a * r.h;
            of_motor += a * r.hv;
            if (t->loop) /* the drag is in front of the gear, as the motor is */
                dn[PMF_BODY_BASE + j] += r.h, t->dq[PMF_BODY_BASE + j] -= r.h;
        }
        if (t->loaded && is_load(f)) {
            load += a * r.h;
            of_load += a * r.hx;
            dT[PMF_BODY_BASE + j] += r.h;
            if (f->unknown)
                dT[own] += a * r.hp;
        }
    }
    dn[PMF_BODY_COULOMB] -= s, dn[PMF_BODY_OFFSET] -= 1, dT[PMF_BODY_OFFSET] += 1;
    if (t->loaded)
        net -= load_friction(t, v, s, motor, load, &by_motor, &by_load);
    const double by_x = t->gx + by_load * of_load, by_v = t->gv - by_motor * of_motor;
    if (t->loop || t->loaded || by_x != 0 || by_v != 0)
        for (int k = 0; k < t->w; k++)
            dn[k] += (1 - by_motor) * t->dq[k] - by_load * dT[k] - by_x * dx[k] - by_v * dv[k];
    return net;
}

/* Move for h seconds from the state at a net force with a first moment about its mean, which keeps the momentum; the
 * new state goes to (*x, *v, dx, dv). */
static void advance(state *t, double net, moment m1, double s, double h, double *x, double *v, double *dx, double *dv)
{
    const double m = t->theta[PMF_BODY_MASS], d = t->theta[PMF_BODY_VISCOUS] + s * t->theta[PMF_BODY_DIRECTIONAL];
    const double a = net / m, z = d * h / m, v0 = t->v;
    const phi f = *recall(t, z);
    const double hp = h * f.p1, mp = hp / m, mq = h * h * f.p2 / m;
    const double vm = (1 - f.e) / (m * h), xm = -f.p1 / m;
    const double vz = -v0 * f.e + a * h * f.q1 + m1.value / (m * h) * f.e;
    const double xz = v0 * h * f.q1 + a * h * h * f.q2 - m1.value / m * f.q1;
    const double *dn = t->dn, *sx = t->dx, *sv = t->dv;
    for (int k = 0; k < t->w; k++) {
        double old = sv[k];
        dx[k] = sx[k] + old * hp + dn[k] * mq;
        dv[k] = old * f.e + dn[k] * mp;
    }
    dx[PMF_BODY_MASS] -= a * mq + (m1.value * xm + xz * z) / m;
    dv[PMF_BODY_MASS] -= a * mp + (m1.value * vm + vz * z) / m;
    dx[PMF_BODY_VISCOUS] += xz * h / m;
    dv[PMF_BODY_VISCOUS] += vz * h / m;
    dx[PMF_BODY_DIRECTIONAL] += xz * s * h / m;
    dv[PMF_BODY_DIRECTIONAL] += vz * s * h / m;
    if (m1.value != 0) {
        dx[PMF_BODY_DELAY] += m1.by_delay * xm, dx[PMF_BODY_LAG] += m1.by_lag * xm;
        dv[PMF_BODY_DELAY] += m1.by_delay * vm, dv[PMF_BODY_LAG] += m1.by_lag * vm;
    }
    *x = t->x + v0 * hp + net * mq + m1.value * xm;
    *v = v0 * f.e + net * mp + m1.value * vm;
}

/* Time until the velocity is zero under a net force against the motion. */
static double time_to_stop(const state *t, double net, double s)
{
    const double m = t->theta[PMF_BODY_MASS], d = t->theta[PMF_BODY_VISCOUS] + s * t->theta[PMF_BODY_DIRECTIONAL];
    double w = -t->v * d / net;
    if (w <= -1)
        return HUGE_VAL;
    return -t->v * m / net * (fabs(w) < 1e-4 ? 1 - w / 2 + w * w / 3 : log1p(w) / w);
}

static const moment NO_MOMENT = {0, 0, 0};

/* Move for h seconds without a stop, with forces that are a quadratic of time: its value `net` and slope are those at
 * the start, and the third number is the force in the middle. The derivatives take the force in the middle alone.
 * Returns 0, and leaves the state, if the mass stops. */
static int move_without_stop(state *t, int i, double s, double net, double drive, double g_delay, double g_lag,
                             double h)
{
    const double d = t->theta[PMF_BODY_VISCOUS] + s * t->theta[PMF_BODY_DIRECTIONAL], half = h / 2;
    const double rise = 12 * t->m1.value / (h * h * h),
                 begin = net - rise * half; /* the input rises through its mean */
    const double slope = -(t->gx * t->v + t->gv * (begin - d * t->v) / t->theta[PMF_BODY_MASS]);
    moment m1 = {(rise + slope) * half * half * half / 12, 0, 0};
    double x, v, middle;
    advance(t, begin + (rise + slope) * half / 2, m1, s, half, &x, &v, t->mx, t->mv);
    if (s * v <= 0)
        return 0;
    middle = net_force(t, x, v, s, drive, i, t->mx, t->mv);
    t->dn[PMF_BODY_DELAY] += g_delay;
    t->dn[PMF_BODY_LAG] += g_lag;
    m1 = t->m1;
    m1.value += h * h * ((middle - net) / 3 - h * slope / 12);
    advance(t, (4 * middle - net) / 3 - h * slope / 6, m1, s, h, &x, &v, t->mx, t->mv);
    if (s * v <= 0)
        return 0;
    t->x = x, t->v = v;
    swap(&t->dx, &t->mx);
    swap(&t->dv, &t->mv);
    return 1;
}

/* Move for `left` seconds in sample i. The input is g, with derivatives by delay and lag. */
static void move(state *t, int i, double g, double g_delay, double g_lag, double left)
{
    for (int turn = 0; left > 0; turn++) {
        double s = t->v > 0 ? 1 : -1, drive = t->loop && t->v != 0 ? 0 : drive_now(t, g), net, step = left, x, v;
        const double offset = t->theta[PMF_BODY_OFFSET];
        int stops = 0;
        if (t->v == 0 && (turn > MOST_TURNS || start_force(t, drive, i, &s) == 0)) {
            rest(t, left, g, g_delay, g_lag);
            return;
        }
        if (t->loop)
            drive = loop_force(t, t->x, t->v, g, g_delay, g_lag, t->dx, t->dv, t->s, t->ds) - offset;
        net = net_force(t, t->x, t->v, s, drive, i, t->dx, t->dv);
        if (t->b->forces && !t->loop && turn == 0) {
            if (move_without_stop(t, i, s, net, drive, g_delay, g_lag, left))
                return;
            net = net_force(t, t->x, t->v, s, drive, i, t->dx, t->dv);
        }
        if (t->b->forces || t->loop) { /* forces in the middle of the part */
            double half = left / 2;
            if (s * net < 0 && t->v != 0)
                half = fmin(left, time_to_stop(t, net, s)) / 2;
            advance(t, net, NO_MOMENT, s, half, &x, &v, t->mx, t->mv);
            if (s * v < 0)
                v = 0;
            if (t->loop) {
                carry_memories(t, half, g, g_delay, g_lag, t->x, t->v, t->dx, t->dv, x, v, t->mx, t->mv);
                drive = loop_force(t, x, v, g, g_delay, g_lag, t->mx, t->mv, t->ms, t->dms) - offset;
            }
            net = net_force(t, x, v, s, drive, i, t->mx, t->mv);
        }
        if (!t->loop) {
            t->dn[PMF_BODY_DELAY] += g_delay;
            t->dn[PMF_BODY_LAG] += g_lag;
        }
        if (t->v != 0 && s * net < 0) {
            const double stop = time_to_stop(t, net, s);
            stops = stop < step;
            step = fmin(stop, step);
        } else if (t->v == 0 && s * net <= 0) { /* forces in the middle stop the start */
            rest(t, left, g, g_delay, g_lag);
            return;
        }
        if (t->loop) {
            advance(t, net, NO_MOMENT, s, step, &x, &v, t->mx, t->mv);
            carry_memories(t, step, g, g_delay, g_lag, t->x, t->v, t->dx, t->dv, x, stops ? 0 : v, t->mx, t->mv);
            swap(&t->s, &t->ms);
            swap(&t->ds, &t->dms);
            swap(&t->dx, &t->mx);
            swap(&t->dv, &t->mv);
        } else
            advance(t, net, turn || stops ? NO_MOMENT : t->m1, s, step, &x, &v, t->dx, t->dv);
        t->x = x;
        t->v = v;
        left -= step;
        if (stops) { /* a stop moves in time: derivatives of the velocity scale with the acceleration */
            double side, after = (t->v = 0, start_force(t, drive_now(t, g), i, &side)), ratio = after / net;
            for (int k = 0; k < t->w; k++)
                t->dv[k] *= ratio;
        }
    }
}

/* The input switches: derivatives by the delay, and by a lag of zero, which is a delay to first order. */
static void switch_input(state *t, int i)
{
    const double lag = t->theta[PMF_BODY_LAG], m = t->theta[PMF_BODY_MASS], *u = t->b->u + t->late;
    const double change = u[0] - u[1], old = drive_now(t, u[0]);
    double s = t->v > 0 ? 1 : -1, new, by;
    t->late++;
    if (lag > 0) {
        t->g_delay += change / lag;
        return;
    }
    for (int j = 0; j < t->b->forces; j++)
        if (t->b->force[j].kind == PMF_LOOP_INTEGRAL)
            t->ds[(size_t)(1 + j) * t->w + PMF_BODY_DELAY] -= change;
    new = drive_now(t, u[1]);
    if (t->v == 0)
        by = start_force(t, old, i, &s) - start_force(t, new, i, &s);
    else
        by = old - new - (t->loaded ? sum_forces(t, t->v, s, i, old) - sum_forces(t, t->v, s, i, new) : 0);
    t->dv[PMF_BODY_DELAY] += by / m;
    t->dv[PMF_BODY_LAG] += by / m;
}

/* Move for h seconds with one input, whose force approaches it. */
static void move_lagging(state *t, int i, double u, double h)
{
    const double lag = t->theta[PMF_BODY_LAG], z = h / lag, away = t->g - u;
    const phi f = phi_of(z);
    const double arm = h * h * (f.p1 / 2 - f.p2);
    if (!t->loop) {
        t->m1.value = away * arm;
        t->m1.by_delay = t->g_delay * arm;
        t->m1.by_lag = t->g_lag * arm - away * h * h * (f.q1 / 2 - f.q2) * z / lag;
    }
    move(t, i, u + away * f.p1, t->g_delay * f.p1, t->g_lag * f.p1 - away * f.q1 * z / lag, h);
    t->g = u + away * f.e;
    t->g_delay *= f.e;
    t->g_lag = t->g_lag * f.e + away * f.e * z / lag;
}

/* Move for h seconds with one input. Where the mass may stop or start under a lag, 32 cuts of the part find the
 * instant, because a mean of the force moves it. */
static void move_part(state *t, int i, double h)
{
    const double u = t->b->u[t->late], most = fmax(fabs(u), fabs(t->g)) + t->theta[PMF_BODY_COULOMB];
    const int cuts = t->loop || fabs(t->v) * t->theta[PMF_BODY_MASS] > most * h ? 1 : 32;
    if (!(t->theta[PMF_BODY_LAG] > 0))
        move(t, i, u, 0, 0, h);
    else
        for (int cut = 0; cut < cuts; cut++)
            move_lagging(t, i, u, h / cuts);
}

/* Move through interval i, in equal parts that end where the input switches. `wait` is the time to the next switch. */
static void move_interval(state *t, int i, double *wait)
{
    const pmf_body *b = t->b;
    const double plain = b->forces || t->theta[PMF_BODY_LAG] > 0 ? b->parts : 1;
    const int parts = (int)fmin(fmax(t->loop ? ceil(b->step[i] / b->tick - 1e-6) : plain, 1), MOST_PARTS);
    const double h = b->step[i] / parts, small = 1e-9 * h;
    for (int part = 0; part < parts; part++)
        for (double left = h; left > small;) {
            while (*wait <= small && t->late + 1 < t->b->n) {
                switch_input(t, i);
                *wait += t->b->step[t->late];
            }
            double step = *wait < left && t->late + 1 < t->b->n ? *wait : left;
            move_part(t, i, step);
            left -= step;
            *wait -= step;
        }
}

void pmf_body_chain(const pmf_body *b, const double *dx, double *row)
{
    for (int k = 0; k < b->links; k++)
        row[b->coordinate[k]] += b->slope[k] * dx[b->parameter[k]];
}

int pmf_body_work(const pmf_body *b)
{
    const int w = PMF_BODY_BASE + b->forces + b->shapes + PMF_LOOP_PARAMETERS;
    return w * (b->tick > 0 ? 10 + 2 * (1 + b->forces) : 8);
}

int pmf_body_run(const pmf_body *b, const double *theta, double *y, double *v, double *S, double *work)
{
    const int loops = b->tick > 0 ? PMF_LOOP_PARAMETERS : 0, full = PMF_BODY_BASE + b->forces + b->shapes + loops;
    const double *loop = theta + full - loops;
    const int w = S ? full : 0; /* without derivatives, only the few that have a name are written */
    double wait = b->step[0] + theta[PMF_BODY_DELAY], force = 0;
    state t = {0};
    memset(t.z, 0xff, sizeof t.z); /* NaN */
    t.b = b, t.theta = theta, t.size = theta + PMF_BODY_BASE, t.w = w;
    t.x = theta[PMF_BODY_X0], t.v = theta[PMF_BODY_V0], t.g = b->u[0];
    memset(work, 0, pmf_body_work(b) * sizeof *work);
    t.dx = work, t.dv = work + full, t.dn = work + 2 * full, t.mx = work + 3 * full, t.mv = work + 4 * full;
    t.p = work + 5 * full, t.dT = work + 6 * full, t.dq = work + 7 * full;
    if (loops) {
        t.loop = loop;
        t.s = t.dq + full, t.ms = t.s + full;
        t.ds = t.ms + full, t.dms = t.ds + (size_t)(1 + b->forces) * full;
        for (int j = 0; j <= b->forces; j++)
            if (j == 0 || b->force[j - 1].kind == PMF_LOOP_FILTERED) {
                t.s[j] = t.v;
                t.ds[(size_t)j * w + PMF_BODY_V0] = 1;
            }
        if (b->count > 0)
            t.s[0] = b->count * rint(t.x / b->count);
    }
    for (int j = 0, shape = PMF_BODY_BASE + b->forces; j < b->forces; j++)
        t.p[j] = b->force[j].unknown ? theta[shape++] : b->force[j].p, t.loaded |= is_load_friction(b->force + j);
    t.dx[PMF_BODY_X0] = t.dv[PMF_BODY_V0] = 1;
    for (int i = 0, k = 0; k < b->rows; i++) {
        if (!(fabs(t.x) < 1e150 && fabs(t.v) < 1e150))
            return k;
        if (i == b->row[k]) {
            y[k] = t.x;
            if (v)
                v[k] = t.v;
            if (S)
                pmf_body_chain(b, t.dx, S + (size_t)k * b->coordinates);
            k++;
        }
        if (i < b->n && b->count > 0) {
            t.loop = loop;
            force = b->on[i] > 0 ? tick_force(&t, b->u[i]) : b->on[i] < 0 ? 0 : force;
            t.loop = 0;
            move(&t, i, force, 0, 0, b->step[i]);
        } else if (i < b->n)
            move_interval(&t, i, &wait);
    }
    return b->rows;
}
