/* SPDX-License-Identifier: Apache-2.0 */
#include "body.h"
#include <math.h>

static const double TAU = 6.283185307179586;

static pmf_push table_at(const pmf_force *f, double x)
{
    pmf_push r = {0, 0, 0, 0};
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

pmf_push pmf_force_at(const pmf_force *f, double p, double x, double v, double s, double column)
{
    pmf_push r = {0, 0, 0, 0};
    double z, w;
    switch (f->kind) {
    case PMF_FORCE_STRIBECK:
    case PMF_FORCE_LOAD_STRIBECK:
        z = v / p;
        w = s * exp(-z * z) * (f->kind == PMF_FORCE_STRIBECK ? 1 : column);
        r.h = w;
        r.hv = -2 * z / p * w;
        r.hp = 2 * z * z / p * w;
        break;
    case PMF_FORCE_SMOOTH:
        z = fabs(v) / p;
        w = exp(-2 * z);
        r.h = -2 * s * w / (1 + w);
        r.hv = 4 * w / ((1 + w) * (1 + w)) / p;
        r.hp = -s * z * r.hv;
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
        break;
    case PMF_FORCE_SPRING:
        r.h = x - f->q;
        r.hx = 1;
        break;
    case PMF_FORCE_SPEED:
        r = table_at(f, fabs(v));
        r.h *= s;
        r.hv = r.hx;
        r.hx = 0;
        break;
    case PMF_FORCE_BEND:
    case PMF_FORCE_BEND_EVEN:
        z = fabs(v);
        w = z <= f->p ? 0 : z < f->q ? (z - f->p) / (f->q - f->p) : 1;
        r.h = s * (w < 1 ? 0.5 * w * (z - f->p) : z - 0.5 * (f->p + f->q));
        r.hv = w;
        break;
    case PMF_FORCE_PLACE:
    case PMF_FORCE_RUB_PLACE: r = table_at(f, x); break;
    case PMF_FORCE_COLUMN: r.h = column; break;
    case PMF_FORCE_LOAD: /* the column is the force through the gear */
    case PMF_FORCE_COLUMN_FRICTION: r.h = s * column; break;
    case PMF_FORCE_COLUMN_VISCOUS:
        r.h = v * column;
        r.hv = column;
        break;
    }
    if (f->kind == PMF_FORCE_RUB || f->kind == PMF_FORCE_RUB_PLACE || f->kind == PMF_FORCE_BEND_EVEN)
        r.h *= s, r.hx *= s, r.hv *= s, r.hp *= s;
    return r;
}
