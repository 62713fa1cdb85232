/* SPDX-License-Identifier: Apache-2.0 */
#include "body.h"
#include <math.h>
#include <string.h>

#define MOST_TURNS 16 /* stops within a part, after which the mass rests until the part ends */
static const double TAU = 6.283185307179586;

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

/* A force, and its derivatives by position, velocity and the constant p. */
typedef struct {
    double h, hx, hv, hp;
} value;

static value table_at(const pmf_force *f, double x)
{
    value r = {0, 0, 0, 0};
    double at = (x - f->p) / f->q;
    int i = (int)floor(at < 0 ? 0 : at > f->knots - 1 ? f->knots - 1 : at);
    if (at <= 0 || at >= f->knots - 1) {
        r.h = f->table[at <= 0 ? 0 : f->knots - 1];
        return r;
    }
    r.hx = (f->table[i + 1] - f->table[i]) / f->q;
    r.h = f->table[i] + (at - i) * f->q * r.hx;
    return r;
}

static value force_at(const pmf_force *f, double p, double x, double v, double s, double column)
{
    value r = {0, 0, 0, 0};
    double z, w;
    switch (f->kind) {
    case PMF_FORCE_STRIBECK:
        z = v / p;
        w = s * exp(-z * z);
        r.h = w;
        r.hv = -2 * z / p * w;
        r.hp = 2 * z * z / p * w;
        break;
    case PMF_FORCE_POWER:
        z = fabs(v) / f->q;
        if (p == 2) {
            r.h = s * z * z;
            r.hv = 2 * z / f->q;
        } else {
            r.h = s * pow(z, p);
            r.hp = z > 0 ? r.h * log(z) : 0;
            r.hv = z > 0 ? p * pow(z, p - 1) / f->q : 0;
        }
        break;
    case PMF_FORCE_WAVE:
    case PMF_FORCE_RUB:
        z = TAU / p;
        r.h = sin(z * x + f->q);
        r.hx = z * cos(z * x + f->q);
        r.hp = -r.hx * x / p;
        if (f->kind == PMF_FORCE_RUB) {
            r.h *= s;
            r.hx *= s;
            r.hp *= s;
        }
        break;
    case PMF_FORCE_SPRING:
        r.h = x;
        r.hx = 1;
        break;
    case PMF_FORCE_SPEED:
        r = table_at(f, fabs(v));
        r.h *= s;
        r.hv = r.hx;
        r.hx = 0;
        break;
    case PMF_FORCE_PLACE: r = table_at(f, x); break;
    case PMF_FORCE_RUB_PLACE:
        r = table_at(f, x);
        r.h *= s;
        r.hx *= s;
        break;
    case PMF_FORCE_COLUMN: r.h = column; break;
    case PMF_FORCE_COLUMN_FRICTION: r.h = s * column; break;
    case PMF_FORCE_COLUMN_VISCOUS:
        r.h = v * column;
        r.hv = column;
        break;
    }
    return r;
}

typedef struct {
    const pmf_body *b;
    const double *theta, *size; /* parameters, and sizes of the forces among them */
    double *p; /* (forces) constants, from the parameters if free */
    int w, late; /* number of parameters; index of the present input */
    double x, v, g; /* position, velocity, force of the input after its lag */
    double g_delay, g_lag; /* derivatives of g */
    double *dx, *dv; /* (w) derivatives */
    double *dn, *mx, *mv; /* (w) derivatives of the force; of the state in the middle of a part */
} state;

static double column_at(const state *t, const pmf_force *f, int i)
{
    return f->kind < PMF_FORCE_COLUMN ? 0 : t->b->column[(long)f->column * t->b->n + i];
}

/* Sum of the forces at (x, v) in direction s. */
static double sum_forces(const state *t, double x, double v, double s, int i)
{
    double sum = 0;
    for (int j = 0; j < t->b->forces; j++)
        if (t->size[j] != 0)
            sum += t->size[j] * force_at(t->b->force + j, t->p[j], x, v, s, column_at(t, t->b->force + j, i)).h;
    return sum;
}

/* Net force at rest: what remains of `drive` beyond friction, with its direction in *s; 0 if the mass rests. */
static double start_force(const state *t, double drive, int i, double *s)
{
    const double F = t->theta[PMF_BODY_COULOMB];
    double ahead = drive - F - sum_forces(t, t->x, 0, 1, i), back = drive + F - sum_forces(t, t->x, 0, -1, i);
    *s = ahead > 0 ? 1 : -1;
    if (ahead > 0 && back < 0)
        return *s = drive >= 0 ? 1 : -1, drive >= 0 ? ahead : back;
    return ahead > 0 ? ahead : back < 0 ? back : 0;
}

/* Net force without viscous friction in direction s at (x, v); its derivatives dn (w) along (dx, dv). */
static double net_force(state *t, double x, double v, double s, double drive, int i, const double *dx, const double *dv)
{
    const pmf_body *b = t->b;
    double net = drive - s * t->theta[PMF_BODY_COULOMB], gx = 0, gv = 0, *dn = t->dn;
    int shape = PMF_BODY_BASE + b->forces;
    memset(dn, 0, t->w * sizeof *dn);
    for (int j = 0; j < b->forces; j++) {
        value r = force_at(b->force + j, t->p[j], x, v, s, column_at(t, b->force + j, i));
        double a = t->size[j];
        dn[PMF_BODY_BASE + j] = -r.h;
        if (b->force[j].unknown)
            dn[shape++] = -a * r.hp;
        net -= a * r.h;
        gx += a * r.hx;
        gv += a * r.hv;
    }
    if (gx != 0 || gv != 0)
        for (int k = 0; k < t->w; k++)
            dn[k] -= gx * dx[k] + gv * dv[k];
    dn[PMF_BODY_COULOMB] -= s;
    dn[PMF_BODY_OFFSET] -= 1;
    return net;
}

/* Move for h seconds from the state at a constant net force; the new state goes to (*x, *v, dx, dv). */
static void advance(const state *t, double net, double s, double h, double *x, double *v, double *dx, double *dv)
{
    const double m = t->theta[PMF_BODY_MASS], d = t->theta[PMF_BODY_VISCOUS] + s * t->theta[PMF_BODY_DIRECTIONAL];
    const double a = net / m, z = d * h / m, v0 = t->v;
    const phi f = phi_of(z);
    const double hp = h * f.p1, mp = hp / m, mq = h * h * f.p2 / m;
    const double vz = -v0 * f.e + a * h * f.q1, xz = v0 * h * f.q1 + a * h * h * f.q2;
    const double *dn = t->dn, *sx = t->dx, *sv = t->dv;
    for (int k = 0; k < t->w; k++) {
        double old = sv[k];
        dx[k] = sx[k] + old * hp + dn[k] * mq;
        dv[k] = old * f.e + dn[k] * mp;
    }
    dx[PMF_BODY_MASS] -= a * mq + xz * z / m;
    dv[PMF_BODY_MASS] -= a * mp + vz * z / m;
    dx[PMF_BODY_VISCOUS] += xz * h / m;
    dv[PMF_BODY_VISCOUS] += vz * h / m;
    dx[PMF_BODY_DIRECTIONAL] += xz * s * h / m;
    dv[PMF_BODY_DIRECTIONAL] += vz * s * h / m;
    *x = t->x + v0 * hp + net * mq;
    *v = v0 * f.e + net * mp;
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

/* Move for `left` seconds in sample i. The force of the input is g, with derivatives by delay and lag. */
static void move(state *t, int i, double g, double g_delay, double g_lag, double left)
{
    const double offset = t->theta[PMF_BODY_OFFSET];
    for (int turn = 0; left > 0; turn++) {
        double s = t->v > 0 ? 1 : -1, drive = g - offset, net, step = left, x, v;
        int stops = 0;
        if (t->v == 0 && (turn > MOST_TURNS || start_force(t, drive, i, &s) == 0)) {
            memset(t->dv, 0, t->w * sizeof *t->dv);
            return;
        }
        net = net_force(t, t->x, t->v, s, drive, i, t->dx, t->dv);
        if (t->b->forces) { /* forces in the middle of the part */
            double half = left / 2;
            if (s * net < 0 && t->v != 0) {
                double stop = time_to_stop(t, net, s);
                if (stop < left)
                    half = stop / 2;
            }
            advance(t, net, s, half, &x, &v, t->mx, t->mv);
            if (s * v < 0)
                v = 0;
            net = net_force(t, x, v, s, drive, i, t->mx, t->mv);
        }
        t->dn[PMF_BODY_DELAY] += g_delay;
        t->dn[PMF_BODY_LAG] += g_lag;
        if (t->v != 0 && s * net < 0) {
            double stop = time_to_stop(t, net, s);
            if (stop < step) {
                step = stop;
                stops = 1;
            }
        } else if (t->v == 0 && s * net <= 0) { /* forces in the middle stop the start */
            memset(t->dv, 0, t->w * sizeof *t->dv);
            return;
        }
        advance(t, net, s, step, &x, &v, t->dx, t->dv);
        t->x = x;
        t->v = v;
        left -= step;
        if (stops) { /* a stop moves in time: derivatives of the velocity scale with the acceleration */
            double side, after = (t->v = 0, start_force(t, drive, i, &side)), ratio = after / net;
            for (int k = 0; k < t->w; k++)
                t->dv[k] *= ratio;
        }
    }
}

/* The input switches to `next`: derivatives by the delay, and by a lag of zero, which is a delay to first order. */
static void switch_input(state *t, int i, double before, double next)
{
    const double lag = t->theta[PMF_BODY_LAG], offset = t->theta[PMF_BODY_OFFSET], m = t->theta[PMF_BODY_MASS];
    double s, change = before - next;
    if (lag > 0) {
        t->g_delay += change / lag;
        return;
    }
    if (t->v == 0)
        change = start_force(t, before - offset, i, &s) - start_force(t, next - offset, i, &s);
    t->dv[PMF_BODY_DELAY] += change / m;
    t->dv[PMF_BODY_LAG] += change / m;
}

/* Move for h seconds with one input. */
static void move_part(state *t, int i, double h)
{
    const double lag = t->theta[PMF_BODY_LAG], u = t->b->u[t->late];
    double z, away;
    phi f;
    if (!(lag > 0)) {
        move(t, i, u, 0, 0, h);
        return;
    }
    z = h / lag;
    f = phi_of(z);
    away = t->g - u;
    move(t, i, u + away * f.p1, t->g_delay * f.p1, t->g_lag * f.p1 - away * f.q1 * z / lag, h);
    t->g = u + away * f.e;
    t->g_delay *= f.e;
    t->g_lag = t->g_lag * f.e + away * f.e * z / lag;
}

/* Move through interval i, in equal parts that end where the input switches. `wait` is the time to the next switch. */
static void move_interval(state *t, int i, int parts, double *wait)
{
    const double h = t->b->step[i] / parts, small = 1e-9 * h;
    for (int part = 0; part < parts; part++)
        for (double left = h; left > small;) {
            while (*wait <= small && t->late + 1 < t->b->n) {
                switch_input(t, i, t->b->u[t->late], t->b->u[t->late + 1]);
                t->late++;
                *wait += t->b->step[t->late];
            }
            double step = *wait < left && t->late + 1 < t->b->n ? *wait : left;
            move_part(t, i, step);
            left -= step;
            *wait -= step;
        }
}

int pmf_body_run(const pmf_body *b, const double *theta, double *y, double *v, double *S, double *work)
{
    const int w = PMF_BODY_BASE + b->forces + b->shapes, lags = theta[PMF_BODY_LAG] > 0;
    /* the mean of a lagging force acts in each part, so that its position has an error of the second order */
    const int parts = lags ? 8 * b->parts : b->forces ? b->parts : 1;
    double wait = b->step[0] + theta[PMF_BODY_DELAY];
    state t = {0};
    t.b = b, t.theta = theta, t.size = theta + PMF_BODY_BASE, t.w = w;
    t.x = theta[PMF_BODY_X0], t.v = theta[PMF_BODY_V0], t.g = b->u[0];
    t.dx = work, t.dv = work + w, t.dn = work + 2 * w, t.mx = work + 3 * w, t.mv = work + 4 * w, t.p = work + 5 * w;
    memset(work, 0, 6 * w * sizeof *work);
    for (int j = 0, shape = PMF_BODY_BASE + b->forces; j < b->forces; j++)
        t.p[j] = b->force[j].unknown ? theta[shape++] : b->force[j].p;
    t.dx[PMF_BODY_X0] = 1;
    t.dv[PMF_BODY_V0] = 1;
    for (int i = 0, k = 0; k < b->rows; i++) {
        if (!(fabs(t.x) < 1e150 && fabs(t.v) < 1e150))
            return k;
        if (i == b->row[k]) {
            y[k] = t.x;
            if (v)
                v[k] = t.v;
            if (S)
                memcpy(S + (size_t)k * w, t.dx, w * sizeof *S);
            k++;
        }
        if (i < b->n)
            move_interval(&t, i, parts, &wait);
    }
    return b->rows;
}
