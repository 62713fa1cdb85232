/* An axis and its controller, for studies/fleet_kinds.py: an integrator that shares nothing with pmfid.
 * Between two steps of h the force is constant and the linear part exact; dry friction stops, it does not turn.
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>

typedef struct {
    double mass, viscous, coulomb, offset, gain;              /* kg, N s/m, N, N, N per unit of u */
    double stribeck, stribeck_speed, quadratic, cogging, pitch; /* N, m/s, N s2/m2, N, m */
    double limit, backward;                                   /* of u; Coulomb friction backward, relative */
    double stiffness, damping, resolution;                    /* controller: u per m, u s per m; 0: open loop */
    double change_mass, change_friction, change_gain, change_time; /* factors from a time [s] on */
} machine_t;

static double friction(const machine_t *m, double v, double way)
{
    double dry = m->coulomb * (way < 0 ? m->backward : 1.0);
    if (m->stribeck != 0.0) {
        dry += m->stribeck * exp(-(v / m->stribeck_speed) * (v / m->stribeck_speed));
    }
    return dry + m->quadratic * v * v;
}

/* ticks of the controller, `steps` of h each, whose input acts `late` steps later; every N ticks a row is logged.
 * target, speed: (ticks,) of the position [m, m/s], or the input itself. Returns the rows. */
long run(const machine_t *given, long ticks, long steps, double h, long late, long every, const double *target,
         const double *speed, double *u_log, long *counts_log)
{
    static double queue[4096];
    machine_t m = *given;
    double x = 0.37 * m.resolution, v = 0.0, before = 0.0, seen = 0.0;
    long tick, step, at = 0, rows = 0, count;
    for (step = 0; step < 4096; ++step) {
        queue[step] = 0.0;
    }
    for (tick = 0; tick < ticks; ++tick) {
        double u = target[tick], y, a, e, b;
        if (tick == (long)(m.change_time / (h * (double)steps)) && m.change_time > 0.0) {
            m.mass *= m.change_mass;
            m.viscous *= m.change_friction, m.coulomb *= m.change_friction, m.stribeck *= m.change_friction;
            m.gain *= m.change_gain;
        }
        count = (long)floor(x / m.resolution);
        y = (double)count * m.resolution;
        if (m.stiffness != 0.0) {
            seen += 0.5 * ((y - before) / (h * (double)steps) - seen);
            before = y;
            u = floor(1e3 * (m.stiffness * (target[tick] - y) + m.damping * (speed[tick] - seen)) + 0.5) * 1e-3;
        }
        if (tick % every == 0) {
            u_log[rows] = u;
            counts_log[rows++] = count;
        }
        a = m.viscous / m.mass, e = exp(-a * h), b = (1.0 - e) / a;
        for (step = 0; step < steps; ++step) {
            double force, free, dry, next;
            queue[at % 4096] = u;
            force = m.gain * fmax(-m.limit, fmin(m.limit, queue[(at + 4096 - late) % 4096])) - m.offset;
            ++at;
            force -= m.cogging != 0.0 ? m.cogging * sin(6.283185307179586 * x / m.pitch) : 0.0;
            free = v * e + force / m.mass * b;
            dry = friction(&m, v, free) / m.mass * b;
            next = fabs(free) <= dry ? 0.0 : free - copysign(dry, free);
            if (v * next < 0.0 || (v != 0.0 && next == 0.0)) {
                next = v * next < 0.0 ? 0.0 : next; /* it comes to rest first */
            }
            x += 0.5 * h * (v + next);
            v = next;
        }
    }
    return rows;
}
