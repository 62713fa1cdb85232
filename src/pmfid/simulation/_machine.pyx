# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False, freethreading_compatible=True
"""A drive whose friction is not Coulomb and viscous, by Runge-Kutta of fourth order with fixed steps.

    m v' = input_gain u(t - dead_time) + noise - offset - held(x) - sign(v) friction(|v|, sign(v), x)

The caller checks the values, this module the lengths. If the velocity changes its sign in a step, the step ends where
a straight line through both velocities is zero. The motion then goes on from rest.
"""

import numpy as np

cimport numpy as cnp
from libc.math cimport M_PI, exp, fabs, floor, sin
from libc.stdint cimport int64_t

cnp.import_array()


cdef struct Body:
    double mass, viscous, coulomb, gain, offset
    double stribeck, stribeck_speed, quadratic, asymmetry, stiffness
    double gravity, gravity_angle, cogging, cogging_pitch, cogging_phase, uneven, uneven_period


cdef struct State:
    double x, v, lagged


cdef inline double held(const Body *body, double x) noexcept nogil:
    """Return the force [N] that acts on the body at a position x against the input."""
    cdef double total = body.stiffness * x
    if body.gravity != 0.0:
        total += body.gravity * sin(x + body.gravity_angle)
    if body.cogging != 0.0:
        total += body.cogging * sin(2.0 * M_PI * x / body.cogging_pitch + body.cogging_phase)
    return total


cdef inline double friction(const Body *body, double speed, double side, double x) noexcept nogil:
    """Return the friction [N] at a speed >= 0 in the direction `side`, at a position x."""
    cdef double total = body.coulomb + (body.viscous + body.quadratic * speed) * speed
    if body.stribeck != 0.0:
        total += body.stribeck * exp(-(speed / body.stribeck_speed) ** 2)
    if body.uneven != 0.0:
        total += body.uneven * sin(2.0 * M_PI * x / body.uneven_period)
    return total * (1.0 + side * body.asymmetry)


cdef inline double acceleration(const Body *body, double force, double x, double v, double side) noexcept nogil:
    cdef double speed = side * v
    return (force - held(body, x) - side * friction(body, speed if speed > 0.0 else 0.0, side, x)) / body.mass


cdef void step(const Body *body, State *state, double force, double h) noexcept nogil:
    """Move for h seconds under a constant force."""
    cdef double side, drive, a1, a2, a3, a4, x, v, end, part
    cdef int turn
    for turn in range(2):
        x, v = state.x, state.v
        drive = force - held(body, x)
        side = 1.0 if v > 0.0 or (v == 0.0 and drive > 0.0) else -1.0
        if v == 0.0 and fabs(drive) <= friction(body, 0.0, side, x):
            return
        a1 = acceleration(body, force, x, v, side)
        a2 = acceleration(body, force, x + 0.5 * h * v, v + 0.5 * h * a1, side)
        a3 = acceleration(body, force, x + 0.5 * h * v + 0.25 * h * h * a1, v + 0.5 * h * a2, side)
        a4 = acceleration(body, force, x + h * v + 0.5 * h * h * a2, v + h * a3, side)
        end = v + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
        if side * end > 0.0:
            state.x = x + h * v + h * h / 6.0 * (a1 + a2 + a3)
            state.v = end
            return
        if v == 0.0:
            return
        part = v / (v - end)
        state.x = x + 0.5 * part * h * v
        state.v = 0.0
        h = (1.0 - part) * h


cdef void advance(const Body *body, State *state, double u, double noise, double lag, double time, int steps) noexcept nogil:
    """Move for `time` seconds under the input u after its lag, and under the force noise [N]."""
    cdef double h = time / steps, mean = u, apart, left = exp(-h / lag) if lag > 0.0 else 0.0
    cdef int i
    for i in range(steps):
        if lag > 0.0:
            apart = state.lagged - u
            mean = u + apart * (1.0 - left) * lag / h
            state.lagged = u + apart * left
        step(body, state, body.gain * mean + noise - body.offset, h)


def simulate(cnp.ndarray[double, mode="c"] command not None, double dt, dict parameters, double dead_time, double lag,
             cnp.ndarray[double, mode="c"] noise not None, int steps, double kp, double kd, double u_max, double resolution, double phase, double x0, double v0):
    """Simulate the motion under the command (n,): return x, v, u (n,) and counts (n,) int64.

    For kp = 0 the command is the input u [V]. Otherwise the command is the reference [m] of the controller
    u_k = clip(kp (reference_k - y_k) - kd (y_k - y_{k-1}) / dt, -u_max, u_max), y = resolution counts.
    `noise` (n,) [N] is held over each interval. The switch of a delayed input divides an interval into at most two
    parts; `steps` is the number of Runge-Kutta steps for each part.
    """
    cdef Py_ssize_t n = command.shape[0], k
    if noise.shape[0] != n:
        raise ValueError(f"noise must have the length of the command, {n}, got {noise.shape[0]}")
    cdef Body body = parameters
    cdef State state = State(x0, v0, 0.0)
    cdef Py_ssize_t whole = <Py_ssize_t>floor(dead_time / dt)
    cdef double late = dead_time - whole * dt, place, y, previous = 0.0, older, newer
    cdef bint in_range = True
    out = np.empty(n), np.empty(n), np.empty(n), np.empty(n, dtype=np.int64)
    cdef cnp.ndarray[double, mode="c"] x = out[0]
    cdef cnp.ndarray[double, mode="c"] v = out[1]
    cdef cnp.ndarray[double, mode="c"] u = out[2]
    cdef cnp.ndarray[int64_t, mode="c"] counts = out[3]
    with nogil:
        for k in range(n):
            x[k], v[k] = state.x, state.v
            place = floor((state.x + phase) / resolution)
            in_range = fabs(place) <= 9007199254740992.0
            if not in_range:
                break
            counts[k] = <int64_t>place
            u[k] = command[k]
            if kp != 0.0:
                y = resolution * counts[k]
                if k == 0:
                    previous = y
                u[k] = max(-u_max, min(u_max, kp * (command[k] - y) - kd * (y - previous) / dt))
                previous = y
            older = u[k - whole - 1] if k > whole else 0.0
            newer = u[k - whole] if k >= whole else 0.0
            if late > 0.0:
                advance(&body, &state, older, noise[k], lag, late, steps)
            advance(&body, &state, newer, noise[k], lag, dt - late, steps)
    if not in_range:
        raise ValueError("the motion leaves 2**53 counts; check the units of parameters, input and resolution")
    return out
