# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False, freethreading_compatible=True
"""A servo under position commands: the loop samples the position, the body moves exactly between two ticks.

    torque = clip(kp (goal(t - delay) - y) - kd w, -limit, limit),    y: position at t - loop_delay, w: its velocity
    inertia v' = torque - force(t) - offset - gravity sin(x - angle) - viscous v - quadratic v |v| - friction sign(v)
    friction = coulomb + stribeck exp(-|v| / stribeck_speed) + load_friction |torque + force(t) + offset + gravity sin(x - angle)|

Friction and gravity are constant between two ticks. This module checks lengths, the callers check the values.
"""

import numpy as np

cimport numpy as cnp
from libc.math cimport ceil, cos, exp, expm1, fabs, fmax, fmin, rint, sin
from libc.stdlib cimport free, malloc
from libc.string cimport memcpy, memset

from pmfid.simulation._body cimport Parameters, State, advance, ramp_factor
from pmfid.simulation._slopes cimport WIDTH, Columns, Curve, Drive, Servo, Slopes, Tick, add, carry

cnp.import_array()


cdef struct Past:
    # The positions at the last ticks, when these were, and the derivatives of the positions or NULL.
    double *time
    double *position
    double *slope
    Py_ssize_t size, head, count


cdef inline void remember(Past *past, double time, double position, const double *slope) noexcept nogil:
    past.head = past.head + 1 if past.head + 1 < past.size else 0
    past.time[past.head] = time
    past.position[past.head] = position
    if past.slope != NULL:
        memcpy(past.slope + past.head * WIDTH, slope, WIDTH * sizeof(double))
    if past.count < past.size:
        past.count += 1


cdef inline double recall(const Past *past, double time, double *slope, Py_ssize_t age) noexcept nogil:
    """Return the position at `time`, interpolated between ticks and held before the oldest one.

    The derivatives of this position, that by the age in column `age`, are written into `slope` if `past` has any.
    """
    cdef Py_ssize_t later = past.head, earlier = past.head, k
    cdef double span, part = 0.0, speed = 0.0
    for k in range(past.count):
        if past.time[earlier] <= time:
            span = past.time[later] - past.time[earlier]
            if span > 0.0:
                part = (time - past.time[earlier]) / span
                speed = (past.position[later] - past.position[earlier]) / span
            break
        later = earlier
        earlier = earlier - 1 if earlier > 0 else past.size - 1
    else:
        earlier = later
    if past.slope != NULL:
        for k in range(WIDTH):
            slope[k] = (1.0 - part) * past.slope[earlier * WIDTH + k] + part * past.slope[later * WIDTH + k]
        add(slope, age, -speed)
    return past.position[earlier] + part * (past.position[later] - past.position[earlier])


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
    return most if torque > most else (-most if torque < -most else torque)  # faster than fmin and fmax


cdef inline void add_part(Drive *mean, double part, double goal, double torque, double most) noexcept nogil:
    """Add a part of the tick to its mean torque."""
    cdef double limited = limit(torque, most)
    mean.torque += part * limited
    if limited == torque:
        mean.gain += part * goal
        mean.free += part
    else:
        mean.most += part if torque > 0.0 else -part


cdef inline Drive find_drive(const double *t, const double *goal, Py_ssize_t n, Py_ssize_t *at, double start,
                             double span, double kp, double rest, double most) noexcept nogil:
    """Return the mean of the limited torque kp goal - rest while the goal is that of [start, start + span].

    The mean of the torque, unlike the torque at the mean goal, depends smoothly on `start` even at the limit. `at` is
    the sample whose goal holds at `start`.
    """
    cdef Drive mean = Drive(0.0, 0.0, 0.0, 0.0, 0.0)
    cdef double now = start, end = start + span, until
    cdef Py_ssize_t k
    while at[0] + 1 < n and t[at[0] + 1] <= start:
        at[0] += 1
    k = at[0]
    if k + 1 >= n or t[k + 1] >= end:
        add_part(&mean, 1.0, goal[k], kp * goal[k] - rest, most)
        return mean
    while now < end:
        until = t[k + 1] if k + 1 < n and t[k + 1] < end else end
        add_part(&mean, (until - now) / span, goal[k], kp * goal[k] - rest, most)
        now = until
        k += 1
    mean.start = (limit(kp * goal[k - 1] - rest, most) - limit(kp * goal[at[0]] - rest, most)) / span
    return mean


def simulate_servo(cnp.ndarray[double, mode="c"] t not None, cnp.ndarray[double, mode="c"] goal not None,
                   cnp.ndarray[double, mode="c"] values not None, double period, double resolution, double x0,
                   double v0, cnp.ndarray[double, mode="c"] force=None, cnp.ndarray[Py_ssize_t, mode="c"] columns=None):
    """Simulate a servo whose goal (n,) [rad] is held from each time t (n,) [s] to the next.

    `values` (15,) are the parameters in the order of `Servo`, `period` is the longest time between two ticks [s], and
    `resolution` the step of the encoder within the loop [rad], 0 for none. `force` (n,) [N m] is a torque against the
    motor at t, linear in between. Returns the positions and the torques (n,) at t, the part of all ticks at which the
    torque is limited, and the derivatives (n, columns) of the positions by x0, v0 and those parameters that have a
    column in `columns` (17,), which is -1 for all others. Without `columns` the derivatives are None.
    """
    cdef Py_ssize_t n = t.shape[0], k, j, parts, at = 0, ticks = 0, limited = 0, width = 0
    if n < 2 or goal.shape[0] != n or values.shape[0] != 15:
        raise ValueError(f"t, goal must have the same length of at least 2, got {n}, {goal.shape[0]}; "
                         f"values must be 15, got {values.shape[0]}")
    if force is not None and force.shape[0] != n:
        raise ValueError(f"force must be as long as t, {n}, got {force.shape[0]}")
    if columns is not None and (columns.shape[0] != 17 or columns.max() >= WIDTH - 1 or resolution > 0.0):
        raise ValueError("derivatives need 17 columns of at most 16, and a loop without encoder steps")
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
    cdef Slopes slopes
    cdef Curve curve = Curve(-1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    cdef Columns own
    cdef double *found = NULL
    if columns is not None:
        width = columns.max() + 1
        slope = np.empty((n, width))
        found = <double *>cnp.PyArray_DATA(slope)
        own = (<Columns *>cnp.PyArray_DATA(columns))[0]
        memset(&slopes, 0, sizeof(Slopes))
        slopes.width = width + width % 2
        add(slopes.x, columns[15], 1.0)
        add(slopes.before, columns[15], 1.0)
        add(slopes.v, columns[16], 1.0)
        add(slopes.before, columns[16], -period)
    cdef double h, now, before = x0 - v0 * period, load
    cdef Tick tick
    tick.drive.torque = tick.exponential = tick.sine = tick.cosine = 0.0
    past.size = <Py_ssize_t>fmin(2.0 * p.loop_delay / period + 4.0, 1e6)
    past.head, past.count, past.slope = -1, 0, NULL
    past.time = <double *>malloc((2 + (WIDTH if found != NULL else 0)) * past.size * sizeof(double))
    if past.time == NULL:
        raise MemoryError
    past.position = past.time + past.size
    if found != NULL:
        past.slope = past.time + 2 * past.size
    with nogil:
        for k in range(n):
            x[k] = state.x
            torque[k] = tick.drive.torque
            if found != NULL:
                memcpy(found + k * width, slopes.x, width * sizeof(double))
            if k + 1 == n:
                break
            parts = <Py_ssize_t>fmax(ceil((times[k + 1] - times[k]) / period - 1e-6), 1.0)
            h = (times[k + 1] - times[k]) / parts
            tick.h = h
            for j in range(parts):
                now = times[k] + j * h
                tick.y = state.x
                if found != NULL:
                    memcpy(slopes.y, slopes.x, WIDTH * sizeof(double))
                if p.loop_delay > 0.0 or found != NULL and own.loop_delay >= 0:
                    remember(&past, now, state.x, slopes.x)
                    tick.y = recall(&past, now - p.loop_delay, slopes.y, own.loop_delay)
                if resolution > 0.0:
                    tick.y = resolution * rint(tick.y / resolution)
                tick.w = (tick.y - before) / h
                before = tick.y
                tick.drive = find_drive(times, goals, n, &at, now - p.delay, h, p.kp, p.kp * tick.y + p.kd * tick.w,
                                        p.torque_limit)
                ticks += 1
                limited += fabs(tick.drive.torque) >= p.torque_limit
                tick.v = state.v
                load = p.offset
                if p.gravity != 0.0:
                    tick.sine = sin(state.x + 0.5 * h * state.v - p.gravity_angle)
                    load += p.gravity * tick.sine
                    if found != NULL:
                        tick.cosine = p.gravity * cos(state.x + 0.5 * h * state.v - p.gravity_angle)
                if loads != NULL:
                    load += loads[k] + (loads[k + 1] - loads[k]) * (j + 0.5) / parts
                tick.sum, tick.force = tick.drive.torque + load, tick.drive.torque - load
                tick.friction = p.coulomb + p.load_friction * fabs(tick.sum)
                if p.stribeck != 0.0:
                    tick.exponential = exp(-fabs(state.v) / p.stribeck_speed)
                    tick.friction += p.stribeck * tick.exponential
                if tick.friction < 0.0:
                    tick.friction = 0.0
                if found != NULL:
                    carry(&slopes, &tick, p, &own, &curve)
                move(&state, tick.force, h,
                     Parameters(p.inertia, p.viscous + p.quadratic * fabs(tick.v), tick.friction), &glide)
    free(past.time)
    return out[0], out[1], limited / <double>ticks, slope if found != NULL else None
