# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""The drive with Coulomb friction, solved from event to event without a time step or an integration error.

    m v' = force - d v - F_c sign(v),    force = input_gain u - offset, constant over a sample;
    v = 0 and |force| <= F_c: stands still

The equation is paper eq. 37, but F_c is a force in newton here and an acceleration there. This module checks the
lengths of the arrays, the callers check the values.
"""

import numpy as np

cimport numpy as cnp
from libc.math cimport expm1, fabs, log1p
from libc.stdint cimport int64_t, uint64_t

from pmfid.simulation._reader cimport Reader, make_reader, read, readable

cnp.import_array()


cdef struct Parameters:
    double mass, viscous, coulomb


cdef struct State:
    double x, v          # m, m/s
    double direction     # (time moving forward - time moving backward) / dt of the last interval
    double moving        # time moving / dt of the last interval


cdef inline double ramp_factor(double z) noexcept nogil:
    """Return (z - 1 + exp(-z)) / z**2 for 0 <= z."""
    cdef double total
    cdef int k
    if z > 0.5:
        return (z + expm1(-z)) / (z * z)
    # The closed form loses digits for small z (relative error 1e-16 / z). The first term that this series leaves
    # out is 0.5**14 / 16! = 3e-18.
    total = 1.0
    for k in range(15, 2, -1):
        total = 1.0 - z * total / k
    return 0.5 * total


cdef inline void glide(State *state, double push, double time, Parameters p) noexcept nogil:
    """Move for `time` under m v' = push - d v, without an event inside."""
    cdef double z = p.viscous / p.mass * time
    cdef double fall = expm1(-z)
    cdef double mean = -fall / z if z > 0.0 else 1.0
    cdef double acceleration = push / p.mass
    state.x += time * (mean * state.v + acceleration * time * ramp_factor(z))
    state.v += fall * state.v + acceleration * time * mean


cdef inline double time_to_stop(double speed, double brake, Parameters p) noexcept nogil:
    """Return the time until m v' = -brake - d v, v(0) = speed > 0, brake > 0, reaches v = 0."""
    cdef double q = p.viscous * speed / brake
    if q > 1.0:
        return p.mass / p.viscous * log1p(q)
    return p.mass * speed / brake * (log1p(q) / q if q > 0.0 else 1.0)


cdef void advance(State *state, double force, double dt, Parameters p) noexcept nogil:
    """Move for one interval with constant force.

    At most one event occurs, so the motion has at most two pieces. Let the cart move with sign `side`.
    (a) If side*force >= F_c, v tends to (force - side F_c)/d, which is zero or has the sign of v. The velocity does
    not cross zero, so no event occurs. A cart that breaks away from v = 0 has side*force > F_c and belongs here.
    (b) If side*force < F_c, v falls monotonically and crosses zero once. If |force| <= F_c, the cart then sticks for
    the rest of the interval, because the force is constant. If side*force < -F_c, the cart reverses; with -side for
    side this is case (a), so no further event occurs.
    """
    cdef double side, brake, first
    state.direction = 0.0
    state.moving = 0.0
    if state.v == 0.0 and fabs(force) <= p.coulomb:
        return
    side = 1.0 if state.v > 0.0 or (state.v == 0.0 and force > 0.0) else -1.0
    brake = p.coulomb - side * force
    first = time_to_stop(fabs(state.v), brake, p) if brake > 0.0 else dt
    state.moving = 1.0
    if first >= dt:
        glide(state, -side * brake, dt, p)
        # If the cart stops just at the end of the interval, rounding can carry the velocity past zero.
        if side * state.v < 0.0:
            state.v = 0.0
        state.direction = side
        return
    glide(state, -side * brake, first, p)
    state.v = 0.0
    if fabs(force) > p.coulomb:
        glide(state, force + side * p.coulomb, dt - first, p)
        state.direction = side * ((first - (dt - first)) / dt)
    else:
        state.moving = first / dt
        state.direction = side * state.moving


cdef int check_lengths(Py_ssize_t n, Py_ssize_t a, Py_ssize_t b, Py_ssize_t c, Py_ssize_t d, Py_ssize_t e) except -1:
    if not n == a == b == c == d == e:
        raise ValueError(f"parameter arrays must have the length of the signal, {n}, got {a}, {b}, {c}, {d}, {e}")
    return 0


def simulate_open_loop(cnp.ndarray[double, mode="c"] u not None, double dt, cnp.ndarray[double, mode="c"] mass not None,
                       cnp.ndarray[double, mode="c"] viscous not None, cnp.ndarray[double, mode="c"] coulomb not None,
                       cnp.ndarray[double, mode="c"] input_gain not None, cnp.ndarray[double, mode="c"] offset not None,
                       double x0, double v0):
    """Simulate the motion under the input u (n,), held over each dt, in SI units.

    Returns x, v (n + 1,), direction and moving (n,).
    """
    cdef Py_ssize_t n = u.shape[0], k
    check_lengths(n, mass.shape[0], viscous.shape[0], coulomb.shape[0], input_gain.shape[0], offset.shape[0])
    out = np.empty(n + 1), np.empty(n + 1), np.empty(n), np.empty(n)
    cdef cnp.ndarray[double, mode="c"] x = out[0]
    cdef cnp.ndarray[double, mode="c"] v = out[1]
    cdef cnp.ndarray[double, mode="c"] direction = out[2]
    cdef cnp.ndarray[double, mode="c"] moving = out[3]
    cdef State state = State(x0, v0, 0.0, 0.0)
    with nogil:
        for k in range(n):
            x[k] = state.x
            v[k] = state.v
            advance(&state, input_gain[k] * u[k] - offset[k], dt, Parameters(mass[k], viscous[k], coulomb[k]))
            direction[k] = state.direction
            moving[k] = state.moving
        x[n] = state.x
        v[n] = state.v
    return out


def simulate_position_control(cnp.ndarray[double, mode="c"] reference not None, double dt, cnp.ndarray[double, mode="c"] mass not None,
                              cnp.ndarray[double, mode="c"] viscous not None, cnp.ndarray[double, mode="c"] coulomb not None,
                              cnp.ndarray[double, mode="c"] input_gain not None, cnp.ndarray[double, mode="c"] offset not None,
                              double x0, double v0, double kp, double kd, double u_max, double resolution,
                              double phase, cnp.ndarray[double, mode="c"] lines not None, cnp.ndarray[double, mode="c"] shift not None,
                              double missed, uint64_t seed):
    """Simulate PD control through the encoder, in SI units.

    Returns x, v (n + 1,), direction, moving, u (n,) and counts (n,) int64.
    y_k = resolution counts_k, counts as in `read_encoder`,
    u_k = clip(kp (reference_k - y_k) - kd (y_k - y_{k-1}) / dt, -u_max, u_max), y_{-1} = y_0.
    """
    cdef Py_ssize_t n = reference.shape[0], k
    check_lengths(n, mass.shape[0], viscous.shape[0], coulomb.shape[0], input_gain.shape[0], offset.shape[0])
    out = np.empty(n + 1), np.empty(n + 1), np.empty(n), np.empty(n), np.empty(n), np.empty(n, dtype=np.int64)
    cdef cnp.ndarray[double, mode="c"] x = out[0]
    cdef cnp.ndarray[double, mode="c"] v = out[1]
    cdef cnp.ndarray[double, mode="c"] direction = out[2]
    cdef cnp.ndarray[double, mode="c"] moving = out[3]
    cdef cnp.ndarray[double, mode="c"] u = out[4]
    cdef cnp.ndarray[int64_t, mode="c"] counts = out[5]
    cdef State state = State(x0, v0, 0.0, 0.0)
    cdef double y, previous = 0.0
    cdef bint in_range = True
    cdef Reader reader = new_reader(n, resolution, phase, lines, shift, missed, seed)
    with nogil:
        for k in range(n):
            x[k] = state.x
            v[k] = state.v
            in_range = readable(&reader, state.x)
            if not in_range:
                break
            counts[k] = read(&reader, state.x, k)
            y = resolution * counts[k]
            if k == 0:
                previous = y
            u[k] = max(-u_max, min(u_max, kp * (reference[k] - y) - kd * (y - previous) / dt))
            previous = y
            advance(&state, input_gain[k] * u[k] - offset[k], dt, Parameters(mass[k], viscous[k], coulomb[k]))
            direction[k] = state.direction
            moving[k] = state.moving
        x[n] = state.x
        v[n] = state.v
    if not in_range:
        raise ValueError(f"position {state.x} m at sample {k} is beyond 2**53 counts of {resolution} m; "
                         "use a larger resolution or a smaller motion")
    return out


cdef Reader new_reader(Py_ssize_t n, double resolution, double phase, cnp.ndarray lines, cnp.ndarray shift,
                       double missed, uint64_t seed) except *:
    """`lines` and `shift` are contiguous arrays of doubles."""
    if lines.shape[0] < 1 or shift.shape[0] not in (0, n):
        raise ValueError(f"lines must not be empty, shift must have length 0 or {n}, got {shift.shape[0]}")
    return make_reader(resolution, phase, <const double *>cnp.PyArray_DATA(lines), lines.shape[0],
                       <const double *>cnp.PyArray_DATA(shift) if shift.shape[0] else NULL, missed, seed)


def read_encoder(cnp.ndarray[double, mode="c"] x not None, double resolution, double phase,
                 cnp.ndarray[double, mode="c"] lines not None, cnp.ndarray[double, mode="c"] shift not None, double missed,
                 uint64_t seed):
    """Counts (n,) int64 of positions x (n,) [m], within 2**53 counts.

    lines (m,): by how much each line of a turn lies off its place [counts]; shift (n,) or (0,): of the whole
    scale at a sample [counts]; missed: probability that an edge is not counted; seed: of that.
    """
    cdef Py_ssize_t n = x.shape[0], k
    out = np.empty(n, dtype=np.int64)
    cdef cnp.ndarray[int64_t, mode="c"] counts = out
    cdef Reader reader = new_reader(n, resolution, phase, lines, shift, missed, seed)
    with nogil:
        for k in range(n):
            counts[k] = read(&reader, x[k], k)
    return out
