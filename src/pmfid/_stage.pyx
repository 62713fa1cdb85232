# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False, freethreading_compatible=True
"""Recursions outside the C kernel: a first-order stage, the inputs of a monitored axis, its scores and detectors, and
the wrong counts of a record.
"""

from cpython.long cimport PyLong_AsUnsignedLongLongMask
from cpython.number cimport PyNumber_Index
from libc.math cimport INFINITY, fabs, isfinite
from libc.stdint cimport int64_t, uint64_t
cimport numpy as cnp
import numpy as np

cnp.import_array()

include "_detect.pxi"
include "_watch.pxi"

cdef extern from "many/pmf_outliers.h":
    ctypedef struct pmf_outliers_t:
        uint64_t samples
        double step
        double speed
        const double *time
        int64_t *count
        int64_t *moved
        unsigned char *wrong
    void pmf_find_outliers(const pmf_outliers_t *record) nogil


def find_outliers(counts, times, double step, double speed=0.0):
    """Find the counts (n,) that no motion explains, at increasing times (n,) [sample periods].

    `step` is the size of the rounding error [counts], at least 1. `speed` is the highest possible speed [counts per
    sample period], or 0 if it is unknown. Returns the counts without wrong readings and without
    shifts of the counter's zero (n,), the wrong readings (n,) bool, and the shift at each sample (n,) [counts].
    """
    found, moved = np.array(counts, dtype=np.int64), np.empty(len(counts), np.int64)
    wrong = np.empty(len(counts), np.uint8)
    cdef int64_t[::1] count = found, shift = moved
    cdef unsigned char[::1] flag = wrong
    cdef const double[::1] time = np.ascontiguousarray(times, dtype=np.float64)
    cdef pmf_outliers_t record
    if time.shape[0] != count.shape[0]:
        raise ValueError(f"counts and times must have the same length, got {count.shape[0]} and {time.shape[0]}")
    if count.shape[0] > 0:
        record.samples, record.step, record.speed, record.time = count.shape[0], step, speed, &time[0]
        record.count, record.moved, record.wrong = &count[0], &shift[0], &flag[0]
        with nogil:
            pmf_find_outliers(&record)
    return found, wrong.astype(bool), moved


def first_order(signal, double a, double b0, double b1=0.0, double memory=0.0):
    """Filter a signal (n,) by (b0 + b1 z^-1) / (1 - a z^-1). Returns the output (n,) and the final memory.

    `memory` is the contribution of b1 and a from earlier samples, and 0 from rest. The bits are those of
    `scipy.signal.lfilter`. SciPy's import takes longer than the filtering of most signals.
    """
    cdef const double[::1] x = np.ascontiguousarray(signal, dtype=np.float64)
    found = np.empty(x.shape[0])
    cdef double[::1] y = found
    cdef Py_ssize_t k
    for k in range(x.shape[0]):
        y[k] = memory + b0 * x[k]
        memory = b1 * x[k] + a * y[k]
    return found, memory


def products(signals):
    """Return the sums (c, c) over time of the products of all pairs of signals (c, n).

    A BLAS adds in an order that depends on the processor. This function adds from the first sample to the last.
    """
    cdef const double[:, ::1] x = np.ascontiguousarray(signals, dtype=np.float64)
    cdef Py_ssize_t c = x.shape[0], i, j, k
    cdef double total
    found = np.empty((c, c))
    cdef double[:, ::1] sums = found
    for i in range(c):
        for j in range(i, c):
            total = 0.0
            for k in range(x.shape[1]):
                total += x[i, k] * x[j, k]
            sums[i, j] = sums[j, i] = total
    return found


def follow_states(phis, nows, changes, const double[:, :] w, const double[:, :] start):
    """Return states (n, channels, N) from `start` (n, channels) by x[k+1] = phi x[k] + now w[k] + change (w[k+1] -
    w[k]).

    `phis` (steps, n, n), `nows` and `changes` (steps, n) have a row for each step, or one row for all. The inputs `w`
    are (channels, N).
    """
    cdef const double[:, :, ::1] phi = np.ascontiguousarray(phis)
    cdef const double[:, ::1] now = np.ascontiguousarray(nows), change = np.ascontiguousarray(changes)
    cdef Py_ssize_t n = phi.shape[1], channels = w.shape[0], k, c, i, j, apart = phi.shape[0] > 1
    found = np.empty((n, channels, w.shape[1]))
    cdef double[:, :, ::1] states = found
    cdef double[:, ::1] x = np.array(start.T, order="C")
    cdef double[::1] moved = np.empty(n)
    cdef double total, slope
    cdef const double *row
    states[:, :, 0] = start
    for k in range(w.shape[1] - 1):
        for c in range(channels):
            slope = w[c, k + 1] - w[c, k]
            for i in range(n):
                row = &phi[k * apart, i, 0]
                total = now[k * apart, i] * w[c, k] + change[k * apart, i] * slope
                for j in range(n):
                    total += row[j] * x[c, j]
                moved[i] = total
                states[i, c, k + 1] = total
            x[c, :] = moved
    return found


#: Indices of an axis's integers. COUNTS to SAMPLES hold the last counts, the shift of the counter, and the number of
#: samples. LOST, KNOWN and CHANGED say whether the last sample was lost, whether any
#: input is known, and whether the last known input changed. FRESH is the number of consecutive kept counts. The kept
#: counts begin at RECENT, each at its sample number modulo KEPT.
cpdef enum:
    COUNTS = 0
    ZERO
    SAMPLES
    LOST
    KNOWN
    CHANGED
    FRESH
    RECENT
    KEPT = 64
    WHOLE = 71
#: Indices of an axis's real numbers: the last input, the mean size of its changes, the share of samples without a
#: change, the share of isolated changes, and the mean square.
cpdef enum:
    INPUT = 0
    USUAL
    SAME
    ALONE
    POWER
    REAL
#: Weight of a sample in the means of the input, and weight of a change in the share of isolated changes.
cdef double LATELY = 0.01, SELDOM = 0.05
#: The square of a larger input overflows.
cdef double MOST_INPUT = 1e150


cdef inline int64_t _sum(int64_t a, int64_t b) noexcept nogil:
    return <int64_t> (<uint64_t> a + <uint64_t> b)  # C leaves the overflow of a signed sum undefined


cdef inline void _learn(int64_t *whole, double *real, double u) noexcept nogil:
    """Update the statistics of the input by a known sample. The first samples have equal weight."""
    cdef double share = 1.0 / whole[SAMPLES], apart = fabs(u - real[INPUT])
    cdef bint changed = u != real[INPUT]
    share = share if share > LATELY else LATELY
    if fabs(u) < MOST_INPUT:
        real[POWER] += share * (u * u - real[POWER])
    if whole[KNOWN] and isfinite(apart):
        real[USUAL] += share * (apart - real[USUAL])
        real[SAME] += share * ((0.0 if changed else 1.0) - real[SAME])
        if changed:
            real[ALONE] += SELDOM * ((0.0 if whole[CHANGED] else 1.0) - real[ALONE])
        whole[CHANGED] = changed
    whole[KNOWN], real[INPUT] = 1, u


cdef inline int64_t _follow(int64_t *whole, double *real, double u, int64_t counts) noexcept nogil:
    cdef bint lost = not isfinite(u)
    if whole[LOST] and not lost:
        whole[ZERO] = _sum(whole[COUNTS], -<uint64_t> counts)
    counts = whole[COUNTS] if lost else _sum(counts, whole[ZERO])
    whole[LOST], whole[COUNTS] = lost, counts
    whole[SAMPLES] += 1
    whole[FRESH] = 1 if lost else min(whole[FRESH] + 1, <int64_t> KEPT)
    whole[RECENT + whole[SAMPLES] % KEPT] = counts
    if not lost:
        _learn(whole, real, u)
    return counts


cdef class Inputs:
    """The recent samples of a monitored axis, and the counts for its estimator.

    A sample with an input that is not finite is lost. The counts resume from their last value after a lost sample,
    because no speed explains a change during the loss.
    """

    cdef int64_t _whole[WHOLE]
    cdef double _real[REAL]

    def __init__(self):
        self.numbers = np.zeros(WHOLE, np.int64), np.zeros(REAL)
        self._real[ALONE] = 1.0

    def step(self, double u, counts):
        """Return the estimator's counts for one sample. Counts of a lost sample are ignored. Raises TypeError unless
        the counts are an integer."""
        cdef int64_t read = 0
        if isfinite(u):
            read = <int64_t> PyLong_AsUnsignedLongLongMask(PyNumber_Index(counts))
        return _follow(self._whole, self._real, u, read)

    def rebase(self, counts):
        """Set the counter's reading at the last sample. Raises TypeError unless the reading is an integer."""
        cdef uint64_t read = PyLong_AsUnsignedLongLongMask(PyNumber_Index(counts))
        self._whole[ZERO] = _sum(self._whole[COUNTS], -read)

    def pass_over(self, int64_t samples):
        """Add unknown samples."""
        if samples <= 0:
            return
        self._whole[SAMPLES] += samples
        self._whole[FRESH] = 1
        self._whole[RECENT + self._whole[SAMPLES] % KEPT] = self._whole[COUNTS]

    def before(self, int64_t samples):
        """Return the counts `samples` samples before the last one, with samples < `fresh`."""
        return self._whole[RECENT + <uint64_t> (self._whole[SAMPLES] - samples) % KEPT]

    @property
    def fresh(self):
        """The number of consecutive kept counts, including the last."""
        return self._whole[FRESH]

    @property
    def counts(self):
        """The last counts on the axis's own scale."""
        return self._whole[COUNTS]

    @property
    def zero(self):
        """The difference between the axis's scale and the counter."""
        return self._whole[ZERO]

    @property
    def samples(self):
        """The number of samples so far, including lost samples."""
        return self._whole[SAMPLES]

    @property
    def lost(self):
        """Whether the last sample was lost."""
        return self._whole[LOST] != 0

    @property
    def input(self):
        """The last known input."""
        return self._real[INPUT]

    @property
    def usual(self):
        """The recent mean size of the change of the input from sample to sample."""
        return self._real[USUAL]

    @property
    def known(self):
        """Whether any input is known."""
        return self._whole[KNOWN] != 0

    @property
    def same(self):
        """The recent share of samples in which the input stays the same."""
        return self._real[SAME]

    @property
    def alone(self):
        """The recent share of isolated changes among the input's changes."""
        return self._real[ALONE]

    @property
    def power(self):
        """The recent mean square of the input."""
        return self._real[POWER]

    @property
    def numbers(self):
        """The integers and the real numbers of the object, as two arrays."""
        return np.array([self._whole[i] for i in range(WHOLE)], np.int64), np.array([self._real[i] for i in range(REAL)])

    @numbers.setter
    def numbers(self, numbers):
        whole, real = numbers
        for i in range(WHOLE):
            self._whole[i] = whole[i]
        for i in range(REAL):
            self._real[i] = real[i]


def follow_many(cnp.ndarray[int64_t, ndim=2, mode="c"] whole not None, cnp.ndarray[double, ndim=2, mode="c"] real not None,
                cnp.ndarray[double, ndim=2, mode="c"] u not None, cnp.ndarray[int64_t, ndim=2, mode="c"] counts not None):
    """Return the estimators' counts (axes, n) for samples u, counts (axes, n) of many axes.

    `whole` (axes, WHOLE) and `real` (axes, REAL) are the `numbers` of the axes' `Inputs`, and are updated. Raises
    ValueError for other shapes.
    """
    cdef Py_ssize_t axes = u.shape[0], n = u.shape[1], axis, k
    shapes = [np.shape(table) for table in (counts, whole, real)]
    if shapes != [(axes, n), (axes, WHOLE), (axes, REAL)]:
        raise ValueError(f"the arrays must have the shapes {[(axes, n), (axes, WHOLE), (axes, REAL)]}, got {shapes}")
    cdef cnp.ndarray[int64_t, ndim=2, mode="c"] found = np.empty((axes, n), np.int64)
    with nogil:
        for axis in range(axes):
            for k in range(n):
                found[axis, k] = _follow(&whole[axis, 0], &real[axis, 0], u[axis, k], counts[axis, k])
    return found


def bars(cnp.ndarray factor not None, cnp.ndarray variance not None, cnp.ndarray inflation not None, found=None):
    """Return standard errors (..., p) from variance factors (..., p), inflations (..., p) and innovation variances
    (...,).

    An inflation of zero is unknown, and does not scale. A standard error without an innovation variance is
    infinite. `found` is an array for the results. Raises ValueError for other shapes and arrays with gaps.
    """
    std = np.empty(np.shape(factor)) if found is None else found
    shape = np.shape(factor)
    cdef const double *factors = <double *> _table(factor, np.float64, shape)
    cdef const double *inflations = <double *> _table(inflation, np.float64, shape)
    cdef const double *variances = <double *> _table(variance, np.float64, shape[: factor.ndim - 1])
    cdef double *bar = <double *> _table(std, np.float64, shape)
    cdef Py_ssize_t n = variance.size, p = factor.shape[factor.ndim - 1], k, i
    with nogil:
        for k in range(n):
            for i in range(k * p, (k + 1) * p):
                bar[i] = sqrt(factors[i] * variances[k] * (inflations[i] if inflations[i] > 0 else 1.0)) if variances[k] > 0 else INFINITY
    return std


def put_rows(cnp.ndarray table not None, cnp.ndarray index not None, cnp.ndarray rows not None):
    """Replace the rows `index` (k,) of a table by `rows` (k, ...) of the same type. Raises ValueError for other
    shapes, wrong indices and arrays with gaps."""
    cdef Py_ssize_t size = rows.shape[0], n = table.shape[0], k
    cdef const int64_t *places = <int64_t *> _table(index, np.int64, (size,))
    shape = np.shape(rows)[1:]
    cdef char *to = <char *> _table(table, rows.dtype, (n, *shape))
    cdef const char *start = <char *> _table(rows, rows.dtype, (size, *shape))
    cdef Py_ssize_t row = rows.nbytes // size if size else 0
    _check(_fit(index, n))
    with nogil:
        for k in range(size):
            memcpy(to + places[k] * row, start + k * row, row)
