# Block scores and detectors. Each axis is computed alone and in a fixed order, so that the bits do not depend on other
# axes. Part of _stage.pyx.

from libc.math cimport copysign, sqrt
from libc.stdint cimport uint8_t, uint32_t
from libc.string cimport memcpy, memmove, memset

#: Largest number of parameters of an estimator.
cdef enum:
    MOST = 16

cpdef enum:
    CUSUM
    PAGE_HINKLEY
    GLR
    CHI_SQUARE

#: Additional variance of a sum of blocks, in units of its information. Differentiation of the encoder's error causes
#: it, so that it matters only for few blocks.
EDGE = 1.0
cdef double _EDGE = EDGE



def _numbers(array):
    return np.ascontiguousarray(array, np.float64)


cdef inline double *_data(cnp.ndarray array):
    return <double *> cnp.PyArray_DATA(array)


cdef int _check(bint fits) except -1:
    if not fits:
        raise ValueError("the arrays do not fit each other")
    return 0


cdef void *_table(cnp.ndarray array, kind, tuple shape) except NULL:
    """Return the data of an array. Raises ValueError for another type or shape, and for gaps."""
    if array.dtype != kind or np.shape(array) != shape or not array.flags.carray:
        raise ValueError(f"there must be {np.dtype(kind)} {shape} without gaps, got {array.dtype} {np.shape(array)}")
    return cnp.PyArray_DATA(array)


cdef bint _fit(cnp.ndarray places, n):
    return places.size == 0 or (places.min() >= 0 and places.max() < n)


cdef inline double _larger(double a, double b) noexcept nogil:
    """Return the larger number, or NaN if either is NaN."""
    return b if b > a or b != b else a


# --- scores: see `monitor.scores` and `monitor.work` ------------------------------------------------------------------


cdef struct Norm:
    Py_ssize_t p
    const double *inverse
    const double *energy


cdef inline void _deviations(const Norm *norm, const double *score, const double *sigma, double *x) noexcept nogil:
    cdef Py_ssize_t p = norm.p, i, j
    cdef double total
    for i in range(p):
        total = score[0] * norm.inverse[i * p]
        for j in range(1, p):
            total += score[j] * norm.inverse[i * p + j]
        x[i] = total / sigma[i]


cdef inline void _expect(const Norm *norm, const double *square, double *w) noexcept nogil:
    cdef Py_ssize_t p = norm.p, i, j, k
    cdef const double *row
    cdef double total
    for i in range(p):
        row = norm.inverse + i * p
        total = square[0] * (row[0] * row[0])
        for k in range(1, p):
            total += square[k] * (row[0] * row[k])
        for j in range(1, p):
            for k in range(p):
                total += square[j * p + k] * (row[j] * row[k])
        w[i] = total / norm.energy[i]


cdef inline double _mean(const double *w, Py_ssize_t p) noexcept nogil:
    cdef double total = w[0]
    cdef Py_ssize_t i
    for i in range(1, p):
        total += w[i]
    return total / p


cdef inline double _information(const Norm *norm, const double *square) noexcept nogil:
    cdef double w[MOST]
    _expect(norm, square, w)
    return _mean(w, norm.p)


cdef inline void _centre(Py_ssize_t p, double *score, const double *cross, const double *offset) noexcept nogil:
    cdef Py_ssize_t i, j
    cdef double total
    for i in range(p):
        total = cross[i * p] * offset[0]
        for j in range(1, p):
            total += cross[i * p + j] * offset[j]
        score[i] -= total


cdef inline double _weight(Py_ssize_t p, const double *x, const double *limit) noexcept nogil:
    cdef double most = 1.0
    cdef Py_ssize_t i
    for i in range(p):
        most = _larger(most, fabs(x[i]) / limit[i])
    return 1 / most


cdef class Norms:
    """The scale of scores, from `monitor.scores.Scale`. Raises ValueError for shapes that do not fit."""

    cdef Norm norm
    cdef object _inverse, _energy

    def __init__(self, inverse, energy):
        self._inverse, self._energy = _numbers(inverse), _numbers(energy)
        self.norm.p = self._energy.size
        if not 1 <= self.norm.p <= MOST or self._inverse.shape != (self.norm.p, self.norm.p):
            raise ValueError(f"the inverse has the shape {self._inverse.shape} for {self.norm.p} parameters")
        self.norm.inverse, self.norm.energy = _data(self._inverse), _data(self._energy)

    def deviations(self, score, sigma):
        """Return the deviations x (n, p) of scores (n, p), with standard deviations sigma (p,) or (n, p)."""
        cdef const double[:, ::1] scores = _numbers(score)
        cdef double[:, ::1] found = np.empty(np.shape(score))
        cdef const double[:, ::1] sizes = _numbers(np.broadcast_to(sigma, np.shape(score)))
        cdef Py_ssize_t k
        _check(scores.shape[1] == self.norm.p)
        for k in range(scores.shape[0]):
            _deviations(&self.norm, &scores[k, 0], &sizes[k, 0], &found[k, 0])
        return np.asarray(found)

    def expect(self, square):
        """Return the information w (n, p) on each parameter from squares (n, p, p)."""
        cdef const double[:, :, ::1] squares = _numbers(square)
        cdef double[:, ::1] found = np.empty(np.shape(square)[:2])
        cdef Py_ssize_t k
        _check(squares.shape[1] == self.norm.p and squares.shape[2] == self.norm.p)
        for k in range(squares.shape[0]):
            _expect(&self.norm, &squares[k, 0, 0], &found[k, 0])
        return np.asarray(found)

    def information(self, square):
        """Return the mean information (n,) over the parameters from squares (n, p, p)."""
        cdef const double[:, ::1] w = self.expect(square)
        cdef double[::1] found = np.empty(w.shape[0])
        cdef Py_ssize_t k
        for k in range(w.shape[0]):
            found[k] = _mean(&w[k, 0], self.norm.p)
        return np.asarray(found)


def centred(score, cross, offset):
    """Subtract the effect of a constant offset (p,) from scores (n, p). The products `cross` are (n, p, p)."""
    cdef double[:, ::1] found = np.array(score, np.float64, order="C")
    cdef const double[:, :, ::1] crosses = _numbers(cross)
    cdef const double[::1] off = _numbers(offset)
    cdef Py_ssize_t p = off.shape[0], k
    _check(p > 0 and found.shape[1] == p and np.shape(cross) == (found.shape[0], p, p))
    for k in range(found.shape[0]):
        _centre(p, &found[k, 0], &crosses[k, 0, 0], &off[0])
    return np.asarray(found)


def weights(x, limit):
    """Return weights (n,) of units with deviations x (n, p). Only a deviation beyond the limit (p,) reduces a weight.
    """
    cdef const double[:, ::1] deviations = _numbers(x)
    cdef const double[::1] limits = _numbers(limit)
    cdef double[::1] found = np.empty(len(x))
    cdef Py_ssize_t k
    _check(limits.shape[0] > 0 and deviations.shape[1] == limits.shape[0])
    for k in range(deviations.shape[0]):
        found[k] = _weight(limits.shape[0], &deviations[k, 0], &limits[0])
    return np.asarray(found)


# --- detectors: see `monitor.detectors` -------------------------------------------------------------------------------


cdef struct Rule:
    int kind
    Py_ssize_t p, window
    double drift, memory
    const double *precision


cdef inline double _two_sided(const double *apart, const double *allowed, double *up, double *down, Py_ssize_t p) noexcept nogil:
    cdef double most = 0.0, above, below
    cdef Py_ssize_t i
    for i in range(p):
        above, below = up[i] + apart[i] - allowed[i], down[i] - apart[i] - allowed[i]
        up[i], down[i] = 0.0 if above <= 0 else above, 0.0 if below <= 0 else below
        most = _larger(_larger(most, up[i]), down[i])
    return most


cdef inline double _sum_of(const Rule *rule, const double *x, const double *w, const double *tolerance, double *state) noexcept nogil:
    cdef double allowed[MOST]
    cdef Py_ssize_t p = rule.p, i
    for i in range(p):
        allowed[i] = (rule.drift + tolerance[i]) * w[i]
    return _two_sided(x, allowed, state, state + p, p)


cdef inline double _decay(double x) noexcept nogil:
    """Return exp(-x), x >= 0. The C library rounds by the kind of processor, and saved states keep the sums."""
    cdef double less = 0.0  # exp(-x) - 1
    cdef Py_ssize_t halvings = 0, k
    if not x < 800.0:
        return 0.0
    while x > 0.125:
        x *= 0.5
        halvings += 1
    for k in range(12, 0, -1):  # the first term that this series leaves out is 0.125**13 / 13! = 3e-22
        less = -x / k * (1.0 + less)
    for k in range(halvings):
        less *= 2.0 + less
    return 1.0 + less


cdef inline double _sum_about_mean(const Rule *rule, const double *x, const double *w, const double *tolerance, double *state) noexcept nogil:
    cdef double allowed[MOST]
    cdef double apart[MOST]
    cdef double *total = state + 2 * rule.p
    cdef double *weight = state + 3 * rule.p
    cdef double keep
    cdef Py_ssize_t p = rule.p, i
    for i in range(p):
        apart[i], allowed[i] = x[i] - w[i] * total[i] / weight[i], (rule.drift + tolerance[i]) * w[i]
        keep = _decay(w[i] / rule.memory)
        total[i], weight[i] = keep * total[i] + x[i], keep * weight[i] + w[i]
    return _two_sided(apart, allowed, state, state + p, p)


#: A smaller ratio differs by more than rounding.
cdef double SMALLER = 1 - 1e-12


cdef inline double _best_start(const Rule *rule, const double *x, const double *w, const double *tolerance, double *state) noexcept nogil:
    cdef Py_ssize_t p = rule.p, rows = rule.window * p, r, k, i
    cdef double *weights = state + rows
    cdef double most = 0.0, beyond, known
    memmove(state + p, state, (rows - p) * sizeof(double))
    memmove(weights + p, weights, (rows - p) * sizeof(double))
    for i in range(p):
        state[i] = weights[i] = 0.0
    for r in range(rule.window):
        k = r * p
        for i in range(p):
            state[k + i] += x[i]
            weights[k + i] += w[i]
            beyond = fabs(state[k + i]) - tolerance[i] * weights[k + i]
            beyond = 0.0 if beyond < 0 else beyond
            beyond, known = beyond * beyond, weights[k + i] + _EDGE
            if not beyond < SMALLER * most * known:  # below this value the slow division cannot raise the maximum
                most = _larger(most, beyond / known)
    return most / 2


cdef inline void _estimated(const Rule *rule, const double *x, const double *w, const double *tolerance, double *state, double *d) noexcept nogil:
    cdef double *weight = state + rule.p
    cdef double beyond
    cdef Py_ssize_t i
    for i in range(rule.p):
        state[i], weight[i] = rule.drift * state[i] + x[i], rule.drift * weight[i] + w[i]
        beyond = fabs(state[i]) - tolerance[i] * weight[i]
        d[i] = copysign(0.0 if beyond < 0 else beyond, state[i]) / sqrt(weight[i] + _EDGE)


cdef inline double _square_of(const Rule *rule, const double *d) noexcept nogil:
    cdef Py_ssize_t p = rule.p, i, j
    cdef double total = d[0] * rule.precision[0] * d[0]
    for j in range(1, p):
        total += d[0] * rule.precision[j] * d[j]
    for i in range(1, p):
        for j in range(p):
            total += d[i] * rule.precision[i * p + j] * d[j]
    return total


cdef inline double _detect(const Rule *rule, const double *x, const double *w, const double *tolerance, double *state) noexcept nogil:
    cdef double d[MOST]
    if rule.kind == CUSUM:
        return _sum_of(rule, x, w, tolerance, state)
    if rule.kind == PAGE_HINKLEY:
        return _sum_about_mean(rule, x, w, tolerance, state)
    if rule.kind == GLR:
        return _best_start(rule, x, w, tolerance, state)
    _estimated(rule, x, w, tolerance, state, d)
    return _square_of(rule, d)


cdef inline Py_ssize_t _rows_of(int kind, Py_ssize_t window) noexcept nogil:
    """Return the number of rows of a detector's state (rows, p)."""
    return 4 if kind == PAGE_HINKLEY else 2 * window


cdef class Detection:
    """A detector of changes in p parameters with a state (rows, p).

    `window` is the number of start times that `GLR` compares. `drift` is the allowance of `CUSUM` and `PAGE_HINKLEY`,
    and the discount of a block in `CHI_SQUARE`. `memory` belongs to `PAGE_HINKLEY`, and `precision` (p, p) to
    `CHI_SQUARE`. Raises ValueError for numbers that do not fit.
    """

    cdef Rule rule
    cdef object _precision
    cdef readonly Py_ssize_t rows

    def __init__(self, int kind, Py_ssize_t p, Py_ssize_t window=1, double drift=0.0, double memory=1.0, precision=()):
        self._precision = _numbers(precision if len(precision) else np.eye(p))
        if not (1 <= p <= MOST and window >= 1 and CUSUM <= kind <= CHI_SQUARE) or self._precision.shape != (p, p):
            raise ValueError(f"no detector {kind} with {p} parameters, window {window}, precision {self._precision.shape}")
        self.rule.kind, self.rule.p, self.rule.window, self.rule.drift = kind, p, window, drift
        self.rule.memory, self.rule.precision = memory, _data(self._precision)
        self.rows = _rows_of(kind, window)

    def _tables(self, state, x, w, tolerance):
        tables = state, _numbers(x), _numbers(w), _numbers(tolerance)
        n, m = np.shape(x)[:2]
        shapes = [(n, self.rows, self.rule.p), (n, m, self.rule.p), (n, m, self.rule.p), (n, self.rule.p)]
        _check([np.shape(table) for table in tables] == shapes)
        return tables

    def run(self, state, x, w, tolerance):
        """Return the statistic (n, m) after each of m blocks of n axes. Deviations x and informations w are (n, m, p),
        and tolerances are (n, p). The states (n, rows, p) are updated."""
        cdef double[:, :, ::1] own
        cdef const double[:, :, ::1] xs, ws
        cdef const double[:, ::1] tolerances
        cdef double[:, ::1] found
        cdef Py_ssize_t k, b
        own, xs, ws, tolerances = self._tables(state, x, w, tolerance)
        found = np.empty((xs.shape[0], xs.shape[1]))
        with nogil:
            for k in range(xs.shape[0]):
                for b in range(xs.shape[1]):
                    found[k, b] = _detect(&self.rule, &xs[k, b, 0], &ws[k, b, 0], &tolerances[k, 0], &own[k, 0, 0])
        return np.asarray(found)

    def deviations(self, state, x, w, tolerance):
        """Return the deviations d (n, m, p) of `CHI_SQUARE`, whose squares form the statistic. The arguments are those
        of `run`."""
        cdef double[:, :, ::1] own, found
        cdef const double[:, :, ::1] xs, ws
        cdef const double[:, ::1] tolerances
        cdef Py_ssize_t k, b
        _check(self.rule.kind == CHI_SQUARE)
        own, xs, ws, tolerances = self._tables(state, x, w, tolerance)
        found = np.empty((xs.shape[0], xs.shape[1], self.rule.p))
        for k in range(xs.shape[0]):
            for b in range(xs.shape[1]):
                _estimated(&self.rule, &xs[k, b, 0], &ws[k, b, 0], &tolerances[k, 0], &own[k, 0, 0], &found[k, b, 0])
        return np.asarray(found)
