# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False, freethreading_compatible=True
"""The drive with Coulomb friction, solved from event to event without a time step or an integration error.

    m v' = force - d v - F_c sign(v),    force = input_gain u - offset, constant over a sample;
    v = 0 and |force| <= F_c: stands still

The equation is paper eq. 37, but F_c is a force in newton here and an acceleration there. This module checks the
lengths of the arrays, the callers check the values.
"""

import numpy as np

cimport numpy as cnp
from libc.stdint cimport int64_t, uint64_t

from pmfid.simulation._body cimport Parameters, State, advance
from pmfid.simulation._reader cimport Reader, make_reader, read, readable

cnp.import_array()


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
