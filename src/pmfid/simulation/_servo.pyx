# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False, freethreading_compatible=True
"""A servo under position commands: the loop samples the position, the body moves exactly between two ticks.

    torque = clip(kp (goal(t - delay) - y) - kd w, -limit, limit),    y: position at t - loop_delay, w: its velocity
    inertia v' = torque - force(t) - offset - gravity sin(x - angle) - viscous v - quadratic v |v| - friction sign(v)
    friction = coulomb + stribeck exp(-|v| / stribeck_speed) + load_friction |torque + force(t) + offset + gravity sin(x - angle)|

Friction and gravity are constant between two ticks. This module checks lengths, the callers check the values.
"""

import numpy as np

cimport numpy as cnp
from libc.math cimport ceil, exp, expm1, fabs, fmax, fmin, rint, sin
from libc.stdlib cimport free, malloc

from pmfid.simulation._body cimport Parameters, State, advance, ramp_factor

cnp.import_array()


cdef struct Servo:
    double inertia, viscous, coulomb, kp, kd, torque_limit, delay, loop_delay, gravity, gravity_angle, offset
    double stribeck, stribeck_speed, load_friction, quadratic


cdef struct Past:
    # The positions at the last ticks, and when these were.
    double *time
    double *position
    Py_ssize_t size, head, count


cdef inline void remember(Past *past, double time, double position) noexcept nogil:
    past.head = past.head + 1 if past.head + 1 < past.size else 0
    past.time[past.head] = time
    past.position[past.head] = position
    if past.count < past.size:
        past.count += 1


cdef inline double recall(const Past *past, double time) noexcept nogil:
    """Return the position at `time`, interpolated between ticks and held before the oldest one."""
    cdef Py_ssize_t later = past.head, earlier = past.head, k
    cdef double span
    for k in range(past.count):
        if past.time[earlier] <= time:
            span = past.time[later] - past.time[earlier]
            if span <= 0.0:
                return past.position[earlier]
            return past.position[earlier] + (time - past.time[earlier]) / span * (past.position[later] - past.position[earlier])
        later = earlier
        earlier = earlier - 1 if earlier > 0 else past.size - 1
    return past.position[later]


cdef struct Glide:
    # What a motion of the time h without an event needs of its exponential, for one rate = viscous / mass.
    double rate, h, fall, mean, ramp


cdef inline void move(State *state, double force, double h, Parameters p, Glide *glide) noexcept nogil:
    """Move for one interval like `advance`, without its exponentials where the last ones fit and no event occurs.

    The velocity crosses zero at most once in an interval, so an interval that keeps its sign has no event.
    """
    cdef double rate = p.viscous / p.mass, z, push, acceleration, v
    cdef double side = 1.0 if state.v > 0.0 or (state.v == 0.0 and force > 0.0) else -1.0
    if state.v == 0.0 and fabs(force) <= p.coulomb:
        return
    if rate != glide.rate or h != glide.h:
        z = rate * h
        glide.rate, glide.h, glide.fall = rate, h, expm1(-z)
        glide.mean, glide.ramp = -glide.fall / z if z > 0.0 else 1.0, ramp_factor(z)
    push = -side * (p.coulomb - side * force)
    acceleration = push / p.mass
    v = state.v + (glide.fall * state.v + acceleration * h * glide.mean)
    if side * v > 0.0:
        state.x += h * (glide.mean * state.v + acceleration * h * glide.ramp)
        state.v = v
    else:
        advance(state, force, h, p)


cdef inline double limit(double torque, double most) noexcept nogil:
    return fmax(-most, fmin(torque, most))


cdef inline double mean_torque(const double *t, const double *goal, Py_ssize_t n, Py_ssize_t *at, double start, double span,
                               double kp, double rest, double most) noexcept nogil:
    """Return the mean of the limited torque kp goal - rest while the goal is that of [start, start + span].

    The mean of the torque, unlike the torque at the mean goal, depends smoothly on `start` even at the limit. `at` is
    the sample whose goal holds at `start`.
    """
    cdef double total = 0.0, now = start, end = start + span, until
    cdef Py_ssize_t k
    while at[0] + 1 < n and t[at[0] + 1] <= start:
        at[0] += 1
    k = at[0]
    if k + 1 >= n or t[k + 1] >= end:
        return limit(kp * goal[k] - rest, most)
    while now < end:
        until = fmin(t[k + 1], end) if k + 1 < n else end
        total += (until - now) * limit(kp * goal[k] - rest, most)
        now = until
        k += 1
    return total / span


def simulate_servo(cnp.ndarray[double, mode="c"] t not None, cnp.ndarray[double, mode="c"] goal not None,
                   cnp.ndarray[double, mode="c"] values not None, double period, double resolution, double x0, double v0,
                   cnp.ndarray[double, mode="c"] force=None):
    """Simulate a servo whose goal (n,) [rad] is held from each time t (n,) [s] to the next.

    `values` (15,) are the parameters in the order of `Servo`, `period` is the longest time between two ticks [s], and
    `resolution` the step of the encoder within the loop [rad], 0 for none. `force` (n,) [N m] is a torque against the motor
    at t, linear in between. Returns the positions and the torques (n,)
    at t, and the part of all ticks at which the torque is limited.
    """
    cdef Py_ssize_t n = t.shape[0], k, j, parts, at = 0, ticks = 0, limited = 0
    if n < 2 or goal.shape[0] != n or values.shape[0] != 15:
        raise ValueError(f"t, goal must have the same length of at least 2, got {n}, {goal.shape[0]}; "
                         f"values must be 15, got {values.shape[0]}")
    if force is not None and force.shape[0] != n:
        raise ValueError(f"force must be as long as t, {n}, got {force.shape[0]}")
    out = np.empty(n), np.empty(n)
    cdef cnp.ndarray[double, mode="c"] x = out[0]
    cdef cnp.ndarray[double, mode="c"] torque = out[1]
    cdef const double *loads = <const double *>cnp.PyArray_DATA(force) if force is not None else NULL
    cdef Servo p = (<Servo *>cnp.PyArray_DATA(values))[0]
    cdef const double *times = <const double *>cnp.PyArray_DATA(t)
    cdef const double *goals = <const double *>cnp.PyArray_DATA(goal)
    cdef State state = State(x0, v0, 0.0, 0.0)
    cdef Past past
    cdef Glide glide = Glide(-1.0, 0.0, 0.0, 0.0, 0.0)
    cdef double h, now, y, before = x0 - v0 * period, w, push = 0.0, load, friction, speed
    past.size = <Py_ssize_t>fmin(2.0 * p.loop_delay / period + 4.0, 1e6)
    past.head, past.count = -1, 0
    past.time = <double *>malloc(2 * past.size * sizeof(double))
    if past.time == NULL:
        raise MemoryError
    past.position = past.time + past.size
    with nogil:
        for k in range(n):
            x[k] = state.x
            torque[k] = push
            if k + 1 == n:
                break
            parts = <Py_ssize_t>fmax(ceil((times[k + 1] - times[k]) / period - 1e-6), 1.0)
            h = (times[k + 1] - times[k]) / parts
            for j in range(parts):
                now = times[k] + j * h
                y = state.x
                if p.loop_delay > 0.0:
                    remember(&past, now, state.x)
                    y = recall(&past, now - p.loop_delay)
                if resolution > 0.0:
                    y = resolution * rint(y / resolution)
                w = (y - before) / h
                before = y
                push = mean_torque(times, goals, n, &at, now - p.delay, h, p.kp, p.kp * y + p.kd * w, p.torque_limit)
                ticks += 1
                limited += fabs(push) >= p.torque_limit
                speed = fabs(state.v)
                load = p.offset
                if p.gravity != 0.0:
                    load += p.gravity * sin(state.x + 0.5 * h * state.v - p.gravity_angle)
                if loads != NULL:
                    load += loads[k] + (loads[k + 1] - loads[k]) * (j + 0.5) / parts
                friction = p.coulomb + p.load_friction * fabs(push + load)
                if p.stribeck != 0.0:
                    friction += p.stribeck * exp(-speed / p.stribeck_speed)
                move(&state, push - load, h,
                     Parameters(p.inertia, p.viscous + p.quadratic * speed, fmax(friction, 0.0)), &glide)
    free(past.time)
    return out[0], out[1], limited / <double>ticks
