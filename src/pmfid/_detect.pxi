# Block scores and detectors. Each axis is computed alone and in a fixed order, so that the bits do not depend on other
# axes. Part of _stage.pyx.

from libc.math cimport sqrt
from libc.stdint cimport uint8_t, uint32_t
from libc.string cimport memcpy, memmove, memset

#: Largest number of parameters of an estimator.
cdef enum:
    MOST = 16

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


# --- the detector: see `monitor.detector` -----------------------------------------------------------------------------


cdef struct Rule:
    Py_ssize_t p, window


#: A smaller ratio differs by more than rounding.
cdef double SMALLER = 1 - 1e-12


cdef inline double _detect(const Rule *rule, const double *x, const double *w, const double *tolerance, double *state) noexcept nogil:
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


cdef class Detection:
    """The detector of changes in p parameters, which compares `window` starts. Its state is (rows, p).

    Raises ValueError for numbers that do not fit.
    """

    cdef Rule rule
    cdef readonly Py_ssize_t rows

    def __init__(self, Py_ssize_t p, Py_ssize_t window):
        if not (1 <= p <= MOST and window >= 1):
            raise ValueError(f"no detector with {p} parameters and window {window}")
        self.rule.p, self.rule.window, self.rows = p, window, 2 * window

    def run(self, state, x, w, tolerance):
        """Return the statistic (n, m) after each of m blocks of n axes. Deviations x and informations w are (n, m, p),
        and tolerances are (n, p). The states (n, rows, p) are updated."""
        cdef double[:, :, ::1] own
        cdef const double[:, :, ::1] xs = _numbers(x), ws = _numbers(w)
        cdef const double[:, ::1] tolerances = _numbers(tolerance)
        cdef double[:, ::1] found
        cdef Py_ssize_t k, b, n = xs.shape[0], m = xs.shape[1], p = self.rule.p
        _check(np.shape(state) == (n, self.rows, p) and np.shape(w) == (n, m, p) == np.shape(x) and np.shape(tolerance) == (n, p))
        own, found = state, np.empty((n, m))
        with nogil:
            for k in range(n):
                for b in range(m):
                    found[k, b] = _detect(&self.rule, &xs[k, b, 0], &ws[k, b, 0], &tolerances[k, 0], &own[k, 0, 0])
        return np.asarray(found)
