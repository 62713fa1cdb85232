/* The controller of a servo: its force and its memories, with derivatives. Only body.c includes this file.
 * SPDX-License-Identifier: Apache-2.0 */
static const double LEAST_DELAY = 2e-5; /* [s] of a loop, so that its derivatives exist */

static double loop_delay(const state *t)
{
    return t->loop[PMF_LOOP_DELAY] > LEAST_DELAY ? t->loop[PMF_LOOP_DELAY] : LEAST_DELAY;
}

/* Force of the controller before its limit at x with memories s, for the goal g. */
static double free_force(const state *t, double x, double g, const double *s)
{
    double sum = t->loop[PMF_LOOP_GAIN] * (g - (x - loop_delay(t) * s[0]));
    for (int j = 0; j < t->b->forces; j++)
        if (in_loop(t->b->force + j))
            sum -= t->size[j] * s[1 + j];
    return sum;
}

/* Whether the controller acts. A switch of it is as late as the goals. */
static int is_on(const state *t)
{
    return !(t->b->on && t->b->on[t->late] == 0);
}

/* Force u within the limit at velocity v. Derivatives of the limit along dv (w) go to dq (w), if there is one. */
static double limit(const state *t, double u, double v, const double *dv, double *dq)
{
    double most = is_on(t) ? t->loop[PMF_LOOP_LIMIT] : 0;
    for (int j = 0; j < t->b->forces; j++) {
        const double along = u < 0 ? -t->b->force[j].q : t->b->force[j].q;
        if (t->b->force[j].kind != PMF_FORCE_SLOPE || along * v <= 0)
            continue;
        most = fmax(most - t->size[j] * along * v, 0);
        for (int k = 0; dq && k < t->w; k++)
            dq[k] -= t->size[j] * along * dv[k] + (k == PMF_BODY_BASE + j ? along * v : 0);
    }
    return u > most ? most : u < -most ? -most : u;
}

/* Drive at the present state: the input, or the controller's force with the input as goal. */
static double drive_now(const state *t, double g)
{
    return (t->loop ? limit(t, free_force(t, t->x, g, t->s), t->v, 0, 0) : g) - t->theta[PMF_BODY_OFFSET];
}

/* Force of the controller from a tick to the next. It acts on the nearest count and on the change of counts; s[0] is the
 * count of the last tick. With a lag of less than half a period, a part of the velocity is the true one. */
static double tick_force(state *t, double g)
{
    const double period = t->b->tick, seen = t->b->count * rint(t->x / t->b->count), apart = g - seen;
    const double change = (seen - t->s[0]) / period;
    double sum = t->loop[PMF_LOOP_GAIN] * apart, *s = t->s + 1;
    t->s[0] = seen;
    for (int j = 0; j < t->b->forces; j++, s++) {
        const int kind = t->b->force[j].kind;
        const double lag = t->p[j] / period, counted = fmin(2 * lag, 1);
        if (!in_loop(t->b->force + j))
            continue;
        *s += kind == PMF_LOOP_INTEGRAL ? -period * apart : (change - *s) / fmax(lag + 0.5, 1);
        sum -= t->size[j] * (kind == PMF_LOOP_INTEGRAL ? *s : counted * *s + (1 - counted) * t->v);
    }
    return limit(t, sum, t->v, 0, 0);
}

/* Force of the controller at (x, v) with memories s, and its derivatives dq (w). */
static double loop_force(state *t, double x, double v, double g, double g_delay, double g_lag, const double *dx,
                         const double *dv, const double *s, const double *ds)
{
    const double kp = t->loop[PMF_LOOP_GAIN], D = loop_delay(t), u = free_force(t, x, g, s);
    const int at = (int)(t->loop - t->theta);
    double *dq = t->dq, used;
    memset(dq, 0, t->w * sizeof *dq);
    dq[at + PMF_LOOP_LIMIT] = 1;
    used = limit(t, u, v, dv, dq);
    if (used != u || !is_on(t)) {
        for (int k = 0; k < t->w; k++)
            dq[k] *= (used > 0) - (used < 0);
        return used;
    }
    for (int k = 0; k < t->w; k++)
        dq[k] = -kp * (dx[k] - D * ds[k]);
    dq[at + PMF_LOOP_GAIN] += g - (x - D * s[0]);
    dq[at + PMF_LOOP_DELAY] += kp * s[0];
    dq[PMF_BODY_DELAY] += kp * g_delay;
    dq[PMF_BODY_LAG] += kp * g_lag;
    for (int j = 0; j < t->b->forces; j++)
        if (in_loop(t->b->force + j)) {
            const double a = t->size[j], *d = ds + (size_t)(1 + j) * t->w;
            for (int k = 0; a != 0 && k < t->w; k++)
                dq[k] -= a * d[k];
            dq[PMF_BODY_BASE + j] -= s[1 + j];
        }
    return used;
}

/* A number that moves from a to b along a line, with derivatives da (w) and db (w). */
typedef struct {
    double a, b;
    const double *da, *db;
} ramp;

/* One lag with time constant tau over h, with an input of 2 p - r; `row` is that of tau or -1. */
static double carry_lag(state *t, double tau, double share, int row, double h, double s, const ramp *p, const ramp *r,
                        const double *ds, double *out)
{
    const double z = h / (tau > LEAST_DELAY / 2 ? tau : LEAST_DELAY / 2);
    const phi f = *recall(t, z);
    const double by_a = f.p1 - f.e, by_b = 1 - f.p1, a = 2 * p->a - r->a, b = 2 * p->b - r->b;
    for (int k = 0; k < t->w; k++)
        out[k] = f.e * ds[k] + by_a * (2 * p->da[k] - r->da[k]) + by_b * (2 * p->db[k] - r->db[k]);
    if (row >= 0)
        out[row] += share * (-f.e * s + a * (f.q1 + f.e) - b * f.q1) * -z * z / h;
    return f.e * s + by_a * a + by_b * b;
}

/* Carry the memories over h, from (x0, v0) to (x1, v1), into ms and dms. */
static void carry_memories(state *t, double h, double g, double g_delay, double g_lag, double x0, double v0,
                           const double *dx0, const double *dv0, double x1, double v1, const double *dx1,
                           const double *dv1)
{
    const double D = loop_delay(t), *s = t->s, *ds = t->ds;
    const ramp speed = {v0, v1, dv0, dv1};
    double *ms = t->ms, *dms = t->dms;
    const int w = t->w, at = (int)(t->loop - t->theta);
    int shape = PMF_BODY_BASE + t->b->forces;
    ms[0] = carry_lag(t, D / 2, 0.5, at + PMF_LOOP_DELAY, h, s[0], &speed, &speed, ds, dms);
    for (int j = 0; j < t->b->forces; j++) {
        const pmf_force *f = t->b->force + j;
        const double *own = ds + (size_t)(1 + j) * w;
        double *out = dms + (size_t)(1 + j) * w;
        if (f->kind == PMF_LOOP_FILTERED) {
            const ramp seen = {s[0], ms[0], ds, dms};
            ms[1 + j] = carry_lag(t, t->p[j], 1, f->unknown ? shape : -1, h, s[1 + j], &seen, &speed, own, out);
        } else if (f->kind == PMF_LOOP_INTEGRAL) { /* minus the integral of the error */
            const int on = is_on(t);
            const double half = h / 2;
            ms[1 + j] = on ? s[1 + j] + half * (x0 + x1 - D * (s[0] + ms[0]) - 2 * g) : 0;
            for (int k = 0; k < w; k++)
                out[k] = on ? own[k] + half * (dx0[k] + dx1[k] - D * (ds[k] + dms[k])) : 0;
            if (on) {
                out[at + PMF_LOOP_DELAY] -= half * (s[0] + ms[0]);
                out[PMF_BODY_DELAY] -= h * g_delay;
                out[PMF_BODY_LAG] -= h * g_lag;
            }
        }
        shape += f->unknown;
    }
}
