# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False, freethreading_compatible=True
"""One mass with friction and its exact derivatives (csrc/fit/body.h), and whitening (csrc/fit/whiten.h)."""

import numpy as np

cimport numpy as cnp
from libc.math cimport fabs
from libc.stdlib cimport calloc, free

cnp.import_array()

cdef extern from "fit/body.h":
    enum:
        PMF_BODY_BASE
        PMF_FORCE_STRIBECK, PMF_FORCE_SMOOTH, PMF_FORCE_POWER, PMF_FORCE_WAVE, PMF_FORCE_RUB, PMF_FORCE_SPRING
        PMF_FORCE_SPEED, PMF_FORCE_BEND, PMF_FORCE_BEND_EVEN, PMF_FORCE_PLACE, PMF_FORCE_RUB_PLACE
        PMF_FORCE_COLUMN, PMF_FORCE_COLUMN_FRICTION, PMF_FORCE_COLUMN_VISCOUS
        PMF_FORCE_LOAD, PMF_FORCE_LOAD_STRIBECK, PMF_LOOP_FILTERED, PMF_LOOP_INTEGRAL, PMF_FORCE_SLOPE
        PMF_LOOP_PARAMETERS
    ctypedef struct pmf_force:
        int kind, column, unknown, knots, load
        const double *table
        double p, q
    ctypedef struct pmf_body:
        int n, parts, forces, shapes, rows, side, coordinates, links
        const int *parameter
        const int *coordinate
        const double *slope
        const int *row
        const double *step
        const double *u
        const pmf_force *force
        const double *column
        double tick
        const double *on
        double count
    int pmf_body_work(const pmf_body *body)
    int pmf_body_run(const pmf_body *body, const double *theta, double *y, double *v, double *S, double *work) nogil

cdef extern from "fit/elastic.h":
    enum:
        PMF_ELASTIC_BASE
    int pmf_elastic_run(const pmf_body *body, const double *theta, double *y, double *v, double *S, double *work) nogil
    void pmf_elastic_drive(int n, int parts, double step, const double *x, const double *load, double *force) nogil

cdef extern from "fit/whiten.h":
    ctypedef struct pmf_wander:
        double rate, force_sd, force_memory, position_sd, position_memory
    double pmf_whiten(const pmf_wander *wander, int n, int w, const double *step, const double *variance, double *X,
                      double *work) nogil

BASE = PMF_BODY_BASE
#: Number of parameters of a controller, after the free constants of the forces: gain, limit, delay of the loop.
LOOP = PMF_LOOP_PARAMETERS
ELASTIC_BASE = PMF_ELASTIC_BASE
KINDS = {
    "stribeck": PMF_FORCE_STRIBECK, "smooth": PMF_FORCE_SMOOTH, "power": PMF_FORCE_POWER, "wave": PMF_FORCE_WAVE, "rub": PMF_FORCE_RUB,
    "spring": PMF_FORCE_SPRING, "speed": PMF_FORCE_SPEED, "bend": PMF_FORCE_BEND, "bend_even": PMF_FORCE_BEND_EVEN, "place": PMF_FORCE_PLACE,
    "rub_place": PMF_FORCE_RUB_PLACE,
    "column": PMF_FORCE_COLUMN, "column_friction": PMF_FORCE_COLUMN_FRICTION,
    "column_viscous": PMF_FORCE_COLUMN_VISCOUS,
    "load": PMF_FORCE_LOAD, "load_stribeck": PMF_FORCE_LOAD_STRIBECK,
    "loop_filtered": PMF_LOOP_FILTERED, "loop_integral": PMF_LOOP_INTEGRAL, "slope": PMF_FORCE_SLOPE,
}


cdef pack(list forces, Py_ssize_t columns, pmf_force *list_):
    """Write tuples (kind, column, free, table, p, q, load), whose tables must outlive the list."""
    cdef cnp.ndarray[double, mode="c"] table
    for k, (kind, column, is_free, values, p, q, load) in enumerate(forces):
        table = values
        list_[k].kind, list_[k].column, list_[k].unknown, list_[k].knots = kind, column, is_free, table.shape[0]
        list_[k].table, list_[k].p, list_[k].q, list_[k].load = <double *>table.data, p, q, load
        if PMF_FORCE_COLUMN <= kind <= PMF_FORCE_COLUMN_VISCOUS and not 0 <= column < columns:
            raise ValueError(f"force {k} has no column {column}")


def run(list forces not None, cnp.ndarray[double, mode="c"] step not None, cnp.ndarray[double, mode="c"] u not None,
        cnp.ndarray[int, mode="c"] row not None, cnp.ndarray[double, ndim=2, mode="c"] columns not None,
        cnp.ndarray[double, mode="c"] theta not None, int parts, object lift, double tick=0.0,
        cnp.ndarray[double, mode="c"] on=None, bint elastic=False, bint load=False, double count=0.0):
    """Return positions, velocities (rows,) and derivatives (rows, p), and the number of finite rows.

    forces: tuples (kind, column, free, table, p, q, load). step, u: (n,). row: (rows,) rising, 0 to n. columns: (c, n).
    theta: (w,). lift: derivatives (w, p) of theta by the coordinates, or None, and p is 0. A controller moves the body in parts of at most `tick`
    [s], if that is positive. u is then its goal, and it is off where `on` (n,) is 0. With a `count` of the encoder, it
    acts in ticks, at which `on` is 1, or -1 while it is off. An `elastic` body has two masses and no controller, and
    shows its `load` or the motor.
    """
    cdef Py_ssize_t n = step.shape[0], rows = row.shape[0], size = len(forces)
    cdef int shapes = sum(bool(force[2]) for force in forces), done
    cdef Py_ssize_t base = PMF_ELASTIC_BASE if elastic else PMF_BODY_BASE
    cdef Py_ssize_t w = base + size + shapes + (PMF_LOOP_PARAMETERS if tick > 0.0 else 0)
    if n < 1 or rows < 1 or u.shape[0] != n or theta.shape[0] != w or columns.shape[1] != n or parts < 1:
        raise ValueError(f"lengths of step, u, columns or theta do not fit: {n}, {u.shape[0]}, {columns.shape[1]}, "
                         f"{theta.shape[0]} for {w} parameters")
    if on is not None and on.shape[0] != n:
        raise ValueError(f"on must have {n} values, got {on.shape[0]}")
    if row[0] < 0 or row[rows - 1] > n or np.any(np.diff(row) <= 0):
        raise ValueError("row must rise from 0 to n at most")
    y, v = np.full(rows, np.inf), np.full(rows, np.inf)
    slopes = lift is not None
    lift = np.zeros((w, 0)) if lift is None else lift
    if lift.shape[0] != w:
        raise ValueError(f"lift must have {w} rows, got {lift.shape[0]}")
    S = np.zeros((rows, lift.shape[1]))
    places = np.nonzero(lift)
    cdef cnp.ndarray[int, mode="c"] parameter = places[0].astype(np.intc)
    cdef cnp.ndarray[int, mode="c"] coordinate = places[1].astype(np.intc)
    cdef cnp.ndarray[double, mode="c"] links = np.ascontiguousarray(lift[places], dtype=np.float64)
    cdef cnp.ndarray[double, mode="c"] yy = y
    cdef cnp.ndarray[double, mode="c"] vv = v
    cdef cnp.ndarray[double, ndim=2, mode="c"] SS = S
    cdef cnp.ndarray[double, mode="c"] work
    cdef pmf_force *list_ = <pmf_force *>calloc(size + 1, sizeof(pmf_force))
    cdef pmf_body body
    cdef double *slope = <double *>SS.data if slopes else NULL
    if list_ == NULL:
        raise MemoryError
    try:
        pack(forces, columns.shape[0], list_)
        body.n, body.parts, body.forces, body.shapes, body.rows = n, parts, size, shapes, rows
        body.row, body.step, body.u = <int *>row.data, <double *>step.data, <double *>u.data
        body.force, body.column = list_, <double *>columns.data
        body.tick, body.on = tick, <double *>on.data if on is not None else NULL
        body.side, body.count = load, count
        body.coordinates, body.links = lift.shape[1], links.shape[0]
        body.parameter, body.coordinate = <int *>parameter.data, <int *>coordinate.data
        body.slope = <double *>links.data
        work = np.empty(15 * w if elastic else pmf_body_work(&body))
        with nogil:
            if elastic:
                done = pmf_elastic_run(&body, <double *>theta.data, <double *>yy.data, <double *>vv.data, slope,
                                       <double *>work.data)
            else:
                done = pmf_body_run(&body, <double *>theta.data, <double *>yy.data, <double *>vv.data, slope,
                                    <double *>work.data)
    finally:
        free(list_)
    return y, v, S, done


def drive_load(cnp.ndarray[double, mode="c"] x not None, double step, int parts,
               cnp.ndarray[double, ndim=2, mode="c"] loads not None):
    """Return the forces (g, n) of g loads on a motor that moves through x (parts (n - 1) + 1), per mass of the load.

    step: interval of x. loads: (g, 4) square of the rate, damping, drag and Coulomb friction, each per mass.
    """
    cdef Py_ssize_t n = (x.shape[0] - 1) // max(parts, 1) + 1, g = loads.shape[0], k
    if x.shape[0] < 1 or parts < 1 or loads.shape[1] != 4:
        raise ValueError("x needs a value, loads four columns, and parts at least 1")
    cdef cnp.ndarray[double, ndim=2, mode="c"] forces = np.empty((g, n))
    with nogil:
        for k in range(g):
            pmf_elastic_drive(n, parts, step, <double *>x.data, <double *>loads.data + 4 * k,
                              <double *>forces.data + n * k)
    return forces


def whiten(cnp.ndarray[double, ndim=2, mode="c"] X not None, cnp.ndarray[double, mode="c"] step not None,
           cnp.ndarray[double, mode="c"] variance not None, double rate, tuple force, tuple position):
    """Whiten the columns of X (n, w) in place, and return the sum of the logarithms of the innovation variances.

    step, variance: (n,). force, position: standard deviation and memory.
    """
    cdef Py_ssize_t n = X.shape[0], w = X.shape[1]
    cdef pmf_wander wander
    cdef double total
    cdef cnp.ndarray[double, mode="c"] work = np.empty(4 * w)
    if step.shape[0] != n or variance.shape[0] != n:
        raise ValueError(f"step and variance must have {n} values, got {step.shape[0]} and {variance.shape[0]}")
    wander.rate, wander.force_sd, wander.force_memory = rate, force[0], force[1]
    wander.position_sd, wander.position_memory = position[0], position[1]
    with nogil:
        total = pmf_whiten(&wander, n, w, <double *>step.data, <double *>variance.data, <double *>X.data,
                           <double *>work.data)
    return total


def walk(cnp.ndarray[double, mode="c"] e not None, cnp.ndarray[double, mode="c"] bound not None,
         cnp.ndarray[double, ndim=2, mode="c"] along not None, cnp.ndarray[double, mode="c"] pull not None,
         cnp.ndarray[double, ndim=2, mode="c"] bends not None, list chances, double far, draw):
    """Return the lengths (m,) of m steps, after each of which |e| <= bound (n,).

    Step k changes e (n,) by along[k] and the residual `pull` (p,) of a prior by bends[k]. Its length follows from
    `draw`, for the interval within `far` that the bounds leave.
    """
    cdef Py_ssize_t n = along.shape[1], p = bends.shape[1], i, k
    cdef double low, high, size, ahead, slope, curvature, length
    if e.shape[0] != n or bound.shape[0] != n or pull.shape[0] != p or bends.shape[0] != along.shape[0]:
        raise ValueError("residuals, bounds, directions and prior must fit each other")
    lengths = np.zeros(along.shape[0])
    for k in range(along.shape[0]):
        low, high, slope, curvature = -far, far, 0.0, 0.0
        for i in range(n):
            size, ahead = fabs(along[k, i]), e[i] if along[k, i] > 0.0 else -e[i]
            if bound[i] - ahead < high * size:
                high = (bound[i] - ahead) / size
            if bound[i] + ahead < -low * size:
                low = -(bound[i] + ahead) / size
        for i in range(p):
            slope, curvature = slope + pull[i] * bends[k, i], curvature + bends[k, i] * bends[k, i]
        length = draw(low, high, slope, curvature, chances[k]) if high > low else 0.0
        for i in range(n):
            e[i] += length * along[k, i]
        for i in range(p):
            pull[i] += length * bends[k, i]
        lengths[k] = length
    return lengths
