# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False, freethreading_compatible=True
"""Recursions outside the kernel: a first-order stage, the inputs of a monitored axis, and what is made of its blocks."""

from cpython.long cimport PyLong_AsUnsignedLongLongMask
from cpython.number cimport PyNumber_Index
from libc.math cimport INFINITY, fabs, isfinite
from libc.stdint cimport int64_t, uint64_t
cimport numpy as cnp
import numpy as np

cnp.import_array()

include "_detect.pxi"
include "_watch.pxi"


def first_order(signal, double a, double b0, double b1=0.0, double memory=0.0):
    """Answer (n,) of (b0 + b1 z^-1) / (1 - a z^-1) to a signal (n,), and its memory after the last sample.

    memory: what b1 and a have left of the samples before, 0 from rest. The bits are those of `scipy.signal.lfilter`,
    which takes longer to import than most signals to filter.
    """
    cdef const double[::1] x = np.ascontiguousarray(signal, dtype=np.float64)
    found = np.empty(x.shape[0])
    cdef double[::1] y = found
    cdef Py_ssize_t k
    for k in range(x.shape[0]):
        y[k] = memory + b0 * x[k]
        memory = b1 * x[k] + a * y[k]
    return found, memory


def follow_states(phis, nows, changes, const double[:, :] w, const double[:, :] start):
    """States (n, channels, N) from start (n, channels): x[k+1] = phi x[k] + now w[k] + change (w[k+1] - w[k]).

    phis (steps, n, n), nows and changes (steps, n) are of one step each, or of all (steps = 1); w: (channels, N).
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


#: Places in the whole numbers of an axis: the last counts, what is added to what its counter shows, the change of the
#: counts in the last sample, samples so far, whether the last one was lost, whether any was not, whether the input
#: changed in the last one that was not, how many of the counts that are kept follow one another up to the last, and
#: these, each at the number of its sample modulo KEPT.
cpdef enum:
    COUNTS = 0
    ZERO
    CHANGE
    SAMPLES
    LOST
    KNOWN
    CHANGED
    FRESH
    RECENT
    KEPT = 64
    WHOLE = 72
#: And in its real ones: the last input, what it usually changes by, in which part of the samples it stays the same, which
#: part of its changes come alone, and its mean square.
cpdef enum:
    INPUT = 0
    USUAL
    SAME
    ALONE
    POWER
    REAL
#: The part by which a sample counts in what is usual, and a change in how changes come.
cdef double LATELY = 0.01, SELDOM = 0.05
#: An input beyond it has no square.
cdef double MOST_INPUT = 1e150


cdef inline int64_t _sum(int64_t a, int64_t b) noexcept nogil:
    return <int64_t> (<uint64_t> a + <uint64_t> b)  # modulo 2^64, where C leaves the signed sum open


cdef inline void _learn(int64_t *whole, double *real, double u) noexcept nogil:
    """What an input that was not lost adds to what is usual; of the first samples each counts the same."""
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
    whole[CHANGE] = 0 if lost or whole[SAMPLES] == 0 else _sum(counts, -<uint64_t> whole[COUNTS])
    whole[LOST], whole[COUNTS] = lost, counts
    whole[SAMPLES] += 1
    whole[FRESH] = 1 if lost else min(whole[FRESH] + 1, <int64_t> KEPT)
    whole[RECENT + whole[SAMPLES] % KEPT] = counts
    if not lost:
        _learn(whole, real, u)
    return counts


cdef class Inputs:
    """What a monitored axis remembers of its samples, and the counts that its estimator gets.

    After a sample that was lost, u not finite, the counts go on from the last: whatever the counter did meanwhile, no
    speed explains it.
    """

    cdef int64_t _whole[WHOLE]
    cdef double _real[REAL]

    def __init__(self):
        self.numbers = np.zeros(WHOLE, np.int64), np.zeros(REAL)
        self._real[ALONE] = 1.0

    def step(self, double u, counts):
        """The counts of one sample; those of a lost one are not looked at. Raises TypeError for no integer."""
        cdef int64_t read = 0
        if isfinite(u):
            read = <int64_t> PyLong_AsUnsignedLongLongMask(PyNumber_Index(counts))
        return _follow(self._whole, self._real, u, read)

    def run(self, cnp.ndarray[double, mode="c"] u not None, cnp.ndarray[int64_t, mode="c"] counts not None):
        """The counts (n,) of many samples, u, counts: (n,)."""
        cdef Py_ssize_t k
        if u.shape[0] != counts.shape[0]:
            raise ValueError(f"u and counts must have one length, got {u.shape[0]} and {counts.shape[0]}")
        cdef cnp.ndarray[int64_t, mode="c"] found = np.empty(u.shape[0], np.int64)
        for k in range(u.shape[0]):
            found[k] = _follow(self._whole, self._real, u[k], counts[k])
        return found

    def rebase(self, counts):
        """The counter would have shown `counts` at the last sample. Raises TypeError for no integer."""
        cdef uint64_t read = PyLong_AsUnsignedLongLongMask(PyNumber_Index(counts))
        self._whole[ZERO] = _sum(self._whole[COUNTS], -read)

    def pass_over(self, int64_t samples):
        """Adds samples, of which nothing is known."""
        if samples <= 0:
            return
        self._whole[SAMPLES] += samples
        self._whole[FRESH] = 1
        self._whole[RECENT + self._whole[SAMPLES] % KEPT] = self._whole[COUNTS]

    def before(self, int64_t samples):
        """The counts a number of samples before the last, fewer than `fresh`."""
        return self._whole[RECENT + <uint64_t> (self._whole[SAMPLES] - samples) % KEPT]

    @property
    def fresh(self):
        """The number of kept counts that follow one another, the last among them."""
        return self._whole[FRESH]

    @property
    def counts(self):
        """The last, on the axis' own scale."""
        return self._whole[COUNTS]

    @property
    def zero(self):
        """What is added to what the counter shows."""
        return self._whole[ZERO]

    @property
    def change(self):
        """Of the counts in the last sample."""
        return self._whole[CHANGE]

    @property
    def samples(self):
        """So far, the lost ones among them."""
        return self._whole[SAMPLES]

    @property
    def lost(self):
        """Whether the last sample was."""
        return self._whole[LOST] != 0

    @property
    def input(self):
        """The last that was not lost."""
        return self._real[INPUT]

    @property
    def usual(self):
        """What the input changes by from sample to sample, of late."""
        return self._real[USUAL]

    @property
    def known(self):
        """Whether any sample was not lost."""
        return self._whole[KNOWN] != 0

    @property
    def same(self):
        """The part of the samples in which the input stays the same, of late."""
        return self._real[SAME]

    @property
    def alone(self):
        """The part of the input's changes before which it stayed the same, of late."""
        return self._real[ALONE]

    @property
    def power(self):
        """The mean square of the input, of late."""
        return self._real[POWER]

    @property
    def numbers(self):
        """All that, as arrays, whole and real."""
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
    """The counts (axes, n) that the estimators of many axes get, u, counts: (axes, n); whole (axes, WHOLE) and
    real (axes, REAL): the numbers of their `Inputs`, which go on. Raises ValueError for other shapes."""
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


def last_flags(cnp.ndarray[uint32_t, ndim=2, mode="c"] status not None, cnp.ndarray[double, ndim=2, mode="c"] u not None,
               cnp.ndarray[uint32_t, mode="c"] flagged not None, uint32_t mask):
    """The rows of status and u, (axes, n), with a bit of the mask in a sample that was not lost; flagged (axes,) becomes
    the status of the last of those. Raises ValueError for other shapes."""
    cdef Py_ssize_t axes = u.shape[0], n = u.shape[1], axis, k
    _check(np.shape(status) == (axes, n) and flagged.shape[0] == axes)
    cdef cnp.ndarray[unsigned char, mode="c"] found = np.zeros(axes, np.uint8)
    with nogil:
        for axis in range(axes):
            for k in range(n):
                if isfinite(u[axis, k]):
                    flagged[axis] = status[axis, k]
                    found[axis] |= status[axis, k] & mask != 0
    return np.flatnonzero(found)


def bars(cnp.ndarray factor not None, cnp.ndarray variance not None, cnp.ndarray inflation not None, found=None):
    """Standard deviations (..., p) by variance factors (..., p), scaled by the inflation (..., p) once it is known, and
    variances (...,) of innovations; infinite where there are none yet. found: to be filled with them, None: a new one.
    Raises ValueError for other shapes, and for arrays with gaps."""
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
    """Other numbers for some rows `index` (k,) of a table, from rows (k, ...) of the same type. Raises ValueError for
    other shapes or places, and for arrays with gaps."""
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
