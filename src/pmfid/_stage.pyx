# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False, freethreading_compatible=True
"""Recursions outside the C kernel: a first-order stage, inputs of a monitored axis, scores and detectors, and wrong
counts of a record. Each axis is computed alone and in a fixed order. Its bits do not depend on others."""

from cpython.long cimport PyLong_AsUnsignedLongLongMask
from cpython.number cimport PyNumber_Index
from libc.math cimport INFINITY, fabs, isfinite, sqrt
from libc.stdint cimport int64_t, uint8_t, uint32_t, uint64_t
from libc.string cimport memcpy, memmove, memset
cimport numpy as cnp
import numpy as np

from pmfid._arrays cimport source, target

cnp.import_array()

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
        cdef Py_ssize_t p = self.norm.p, n = len(score), k
        scores, sizes, found = _numbers(score), _numbers(np.broadcast_to(sigma, np.shape(score))), np.empty((n, p))
        cdef const double *of = <double *> source(scores, np.float64, (n, p))
        cdef const double *size = _data(sizes)
        cdef double *x = _data(found)
        for k in range(n):
            _deviations(&self.norm, of + k * p, size + k * p, x + k * p)
        return found

    def expect(self, square):
        """Return the information w (n, p) on each parameter from squares (n, p, p)."""
        cdef Py_ssize_t p = self.norm.p, n = len(square), k
        squares, found = _numbers(square), np.empty((n, p))
        cdef const double *of = <double *> source(squares, np.float64, (n, p, p))
        cdef double *w = _data(found)
        for k in range(n):
            _expect(&self.norm, of + k * p * p, w + k * p)
        return found

    def information(self, square):
        """Return the mean information (n,) over the parameters from squares (n, p, p)."""
        w = self.expect(square)
        found = np.empty(len(w))
        cdef Py_ssize_t n = len(w), k
        cdef const double *of = _data(w)
        cdef double *mean = _data(found)
        for k in range(n):
            mean[k] = _mean(of + k * self.norm.p, self.norm.p)
        return found


def centred(score, cross, offset):
    """Subtract the effect of a constant offset (p,) from scores (n, p). The products `cross` are (n, p, p)."""
    found, crosses, off = np.array(score, np.float64, order="C"), _numbers(cross), _numbers(offset)
    cdef Py_ssize_t n = len(found), p = off.size, k
    cdef double *scores = <double *> target(found, np.float64, (n, p))
    cdef const double *of = <double *> source(crosses, np.float64, (n, p, p))
    _check(p > 0)
    for k in range(n):
        _centre(p, scores + k * p, of + k * p * p, _data(off))
    return found


def weights(x, limit):
    """Return weights (n,) of units with deviations x (n, p). A deviation beyond the limit (p,) reduces a weight."""
    deviations, limits, found = _numbers(x), _numbers(limit), np.empty(len(x))
    cdef Py_ssize_t n = len(found), p = limits.size, k
    cdef const double *of = <double *> source(deviations, np.float64, (n, p))
    cdef double *weight = _data(found)
    _check(p > 0)
    for k in range(n):
        weight[k] = _weight(p, of + k * p, _data(limits))
    return found


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
        cdef Py_ssize_t n = np.shape(x)[0], m = np.shape(x)[1], p = self.rule.p, k, b
        xs, ws, tolerances, found = _numbers(x), _numbers(w), _numbers(tolerance), np.empty((n, m))
        cdef const double *deviation = <double *> source(xs, np.float64, (n, m, p))
        cdef const double *information = <double *> source(ws, np.float64, (n, m, p))
        cdef const double *tolerated = <double *> source(tolerances, np.float64, (n, p))
        cdef double *own = <double *> target(state, np.float64, (n, self.rows, p))
        cdef double *statistic = _data(found)
        with nogil:
            for k in range(n):
                for b in range(k * m, (k + 1) * m):
                    statistic[b] = _detect(&self.rule, deviation + b * p, information + b * p, tolerated + k * p, own + k * self.rows * p)
        return found


# --- the watch over the blocks of many axes: see `monitor.watching` ---------------------------------------------------


cdef extern from "pmf.h":
    enum:
        PMF_STARTING
        PMF_POOR_EXCITATION
        PMF_STANDSTILL

#: Least information of a block that counts, as a fraction of the average block.
cdef double INFORMATIVE = 0.05
#: Numbers of the states of a quiet axis, and indices in `watching.REASONS` why an axis cannot be judged.
cdef enum:
    STARTING = 0
    WATCHING = 1
    CANNOT_TELL = 2
cdef enum:
    NOTHING
    NO_START
    NO_EXCITATION
    AT_REST
    SILENT


def waiting_after(bint lost, int64_t waiting, int64_t wait):
    """Return the number of blocks still to wait. A lost block, in which the filters settled all the time, restarts the
    wait. Blocks do not count during the wait, because the simulated motion has lost the plant."""
    return _waiting_after(lost, waiting, wait)


cdef inline int64_t _waiting_after(bint lost, int64_t waiting, int64_t wait) noexcept nogil:
    return wait if lost else waiting - 1 if waiting > 1 else 0


cdef struct Plan:
    Py_ssize_t p, width
    Norm blocks
    Norm units
    Rule detector
    double size
    const double *offset
    const double *limit
    double threshold, block_time
    int64_t silent_blocks


#: The data of an axis: one row of `monitor.states.Watched`.
cdef struct Own:
    uint8_t *state
    int64_t *waiting
    int64_t *silence
    int64_t *members
    int64_t *units
    double *opened
    double *begun
    double *statistic
    double *opening
    double *detection
    double *line
    const int64_t *wait
    const double *sigma
    const double *tolerance


cdef inline double _inform(const Plan *plan, const Own *own, bint lost, const double *block, double *counted) noexcept nogil:
    cdef double used, information
    cdef Py_ssize_t i
    own.waiting[0] = _waiting_after(lost, own.waiting[0], own.wait[0])
    used = 1.0 if own.waiting[0] == 0 else 0.0
    for i in range(plan.width):
        counted[i] = block[i] * used
    information = _information(&plan.blocks, counted + plan.p * (1 + plan.p))
    own.silence[0] = 0 if information > INFORMATIVE else own.silence[0] + 1
    _centre(plan.p, counted, counted + plan.p, plan.offset)
    return information


cdef inline bint _gather(const Plan *plan, const Own *own, const double *counted, double information, double time, double *unit) noexcept nogil:
    cdef Py_ssize_t i
    if own.members[0] == 0:
        own.begun[0] = time - plan.block_time
    for i in range(plan.width):
        own.opening[i] = unit[i] = counted[i] if own.members[0] == 0 else own.opening[i] + counted[i]
    own.opened[0] += information
    own.members[0] += 1
    if not own.opened[0] >= plan.size:
        return False
    own.members[0], own.opened[0] = 0, 0.0
    memset(own.opening, 0, plan.width * sizeof(double))
    return True


cdef inline double _count(const Plan *plan, const Own *own, const double *unit) noexcept nogil:
    cdef double weighed[MOST * (1 + MOST)]
    cdef double x[MOST]
    cdef double w[MOST]
    cdef Py_ssize_t p = plan.p, i
    cdef double place = own.units[0] + 1
    cdef const double *score = unit
    cdef const double *square = unit + p + p * p
    cdef double weight
    _deviations(&plan.units, score, own.sigma, x)
    weight = _weight(p, x, plan.limit)
    for i in range(p):
        weighed[i] = score[i] * weight
    for i in range(p * p):
        weighed[p + i] = square[i] * weight
    _deviations(&plan.units, weighed, own.sigma, x)
    _expect(&plan.units, weighed + p, w)
    own.statistic[0] = _detect(&plan.detector, x, w, own.tolerance, own.detection)
    for i in range(p):  # sums for a line through zero at the reference
        own.line[i] += place * x[i]
        own.line[p + i] += place * place * w[i]
    own.units[0] += 1
    return _information(&plan.units, square)


cdef inline bint _crossed(const Plan *plan, const Own *own, double information, uint32_t status) noexcept nogil:
    return own.statistic[0] > plan.threshold and information > INFORMATIVE and status & (PMF_STARTING | PMF_POOR_EXCITATION) == 0


cdef inline void _look(const Plan *plan, const Own *own, uint32_t status, uint8_t *wanted, uint8_t *reason) noexcept nogil:
    """Find the new state and its reason. The last condition that holds decides."""
    wanted[0], reason[0] = own.state[0], NOTHING
    if own.silence[0] == 0:
        wanted[0] = WATCHING
    if own.silence[0] >= plan.silent_blocks:
        wanted[0], reason[0] = CANNOT_TELL, AT_REST if status & PMF_STANDSTILL else SILENT
    if status & PMF_POOR_EXCITATION:
        wanted[0], reason[0] = CANNOT_TELL, NO_EXCITATION
    if status & PMF_STARTING:
        wanted[0], reason[0] = STARTING, NO_START


cdef inline Own _of(const Plan *plan, const Own *all, int64_t axis) noexcept nogil:
    cdef Own own
    own.state, own.waiting, own.silence = all.state + axis, all.waiting + axis, all.silence + axis
    own.members, own.units, own.opened = all.members + axis, all.units + axis, all.opened + axis
    own.begun, own.statistic, own.wait = all.begun + axis, all.statistic + axis, all.wait + axis
    own.opening, own.sigma = all.opening + axis * plan.width, all.sigma + axis * plan.p
    own.tolerance = all.tolerance + axis * plan.p
    own.detection, own.line = all.detection + axis * _detection_size(plan), all.line + axis * 2 * plan.p
    return own


cdef inline Py_ssize_t _detection_size(const Plan *plan) noexcept nogil:
    return plan.p * 2 * plan.detector.window


#: Units of the axes, with the last `places` units of each axis in a ring.
cdef struct Ring:
    double *units
    double *begun
    Py_ssize_t places


cdef inline void _push(const Plan *plan, const Ring *ring, int64_t axis, int64_t units, const double *unit, double begun) noexcept nogil:
    cdef Py_ssize_t place = axis * ring.places + units % ring.places
    memcpy(ring.units + place * plan.width, unit, plan.width * sizeof(double))
    ring.begun[place] = begun


#: Earlier values of an axis, for the case that the axis is not quiet.
cdef struct Before:
    uint8_t state
    int64_t waiting, silence, members, units
    double opened, begun, statistic


cdef inline Before _before(const Plan *plan, const Own *own, double *room) noexcept nogil:
    cdef Before kept
    kept.state, kept.waiting, kept.silence = own.state[0], own.waiting[0], own.silence[0]
    kept.members, kept.units, kept.opened = own.members[0], own.units[0], own.opened[0]
    kept.begun, kept.statistic = own.begun[0], own.statistic[0]
    memcpy(room, own.opening, plan.width * sizeof(double))
    memcpy(room + plan.width, own.line, 2 * plan.p * sizeof(double))
    memcpy(room + plan.width + 2 * plan.p, own.detection, _detection_size(plan) * sizeof(double))
    return kept


cdef inline void _take_back(const Plan *plan, const Own *own, const Before *kept, const double *room) noexcept nogil:
    own.state[0], own.waiting[0], own.silence[0] = kept.state, kept.waiting, kept.silence
    own.members[0], own.units[0], own.opened[0] = kept.members, kept.units, kept.opened
    own.begun[0], own.statistic[0] = kept.begun, kept.statistic
    memcpy(own.opening, room, plan.width * sizeof(double))
    memcpy(own.line, room + plan.width, 2 * plan.p * sizeof(double))
    memcpy(own.detection, room + plan.width + 2 * plan.p, _detection_size(plan) * sizeof(double))


#: Samples of an axis in one piece: its blocks, the status of all samples, and the index of the first block's last
#: sample.
cdef struct Piece:
    const double *blocks
    const uint8_t *lost
    const uint32_t *status
    int64_t samples, place, size, whole
    double dt


cdef inline bint _go_on(const Plan *plan, const Own *own, const Ring *ring, int64_t axis, const Piece *piece, uint8_t *wanted, uint8_t *reason) noexcept nogil:
    """Process blocks until the axis crosses the threshold, and return whether it does. The units in the ring are then
    those that a single monitor pushes to the same places."""
    cdef double counted[MOST * (1 + 2 * MOST)]
    cdef double unit[MOST * (1 + 2 * MOST)]
    cdef double information
    cdef int64_t b, place
    for b in range(piece.whole):
        place = piece.place + b * piece.size
        information = _inform(plan, own, piece.lost[b], piece.blocks + b * plan.width, counted)
        if _gather(plan, own, counted, information, (piece.samples + place) * piece.dt, unit):
            _look(plan, own, piece.status[place], wanted + b, reason + b)
            own.state[0] = wanted[b]
            _push(plan, ring, axis, own.units[0], unit, own.begun[0])
            information = _count(plan, own, unit)
            if _crossed(plan, own, information, piece.status[place]):
                return True
        else:
            _look(plan, own, piece.status[place], wanted + b, reason + b)
            own.state[0] = wanted[b]
    return False


cdef class Watcher:
    """The watch over axes of one configuration, with arrays of `monitor.states`.

    `norms` and `seen` scale blocks and units. `work` holds the size, the offset (p,) and the limit (p,) of units.
    `threshold` applies to the statistic. `block_time` is in [s]. After `silent_blocks` blocks without
    information an axis cannot be judged. Raises ValueError for shapes that do not fit.
    """

    cdef Plan plan
    cdef object _kept
    cdef readonly Detection detection

    def __init__(self, Norms norms not None, Norms seen not None, Detection detection not None, work, double threshold, double block_time, int64_t silent_blocks):
        p = norms.norm.p
        _check(seen.norm.p == p and detection.rule.p == p)
        self.detection = detection
        self.plan.p, self.plan.width = p, p + 2 * p * p
        self.plan.blocks, self.plan.units, self.plan.detector = norms.norm, seen.norm, detection.rule
        self.plan.size, offset, limit = work[0], _numbers(work[1]), _numbers(work[2])
        _check(offset.shape == limit.shape == (p,))
        self.plan.offset, self.plan.limit = _data(offset), _data(limit)
        self._kept = norms, seen, offset, limit
        self.plan.threshold, self.plan.block_time, self.plan.silent_blocks = threshold, block_time, silent_blocks

    cdef Own _hold(self, watched) except *:
        cdef Own own
        n, p = len(watched.state), self.plan.p
        own.state = <uint8_t *> target(watched.state, np.uint8, (n,))
        own.waiting, own.silence = <int64_t *> target(watched.waiting, np.int64, (n,)), <int64_t *> target(watched.silence, np.int64, (n,))
        own.members, own.units = <int64_t *> target(watched.members, np.int64, (n,)), <int64_t *> target(watched.units, np.int64, (n,))
        own.opened, own.begun = <double *> target(watched.opened, np.float64, (n,)), <double *> target(watched.begun, np.float64, (n,))
        own.statistic = <double *> target(watched.statistic, np.float64, (n,))
        own.opening = <double *> target(watched.opening, np.float64, (n, self.plan.width))
        own.detection = <double *> target(watched.detection, np.float64, (n, self.detection.rows, p))
        own.line = <double *> target(watched.line, np.float64, (n, 2, p))
        own.wait = <int64_t *> target(watched.wait, np.int64, (n,))
        own.sigma, own.tolerance = <double *> target(watched.sigma, np.float64, (n, p)), <double *> target(watched.tolerance, np.float64, (n, p))
        return own

    cdef Ring _ring(self, disturbed, axes) except *:
        cdef Ring ring
        ring.places = np.shape(disturbed.units)[1]
        ring.units = <double *> target(disturbed.units, np.float64, (axes, ring.places, self.plan.width))
        ring.begun = <double *> target(disturbed.begun, np.float64, (axes, ring.places))
        return ring

    def informed(self, watched, cnp.ndarray block not None, bint lost):
        """Return the part of one axis's block (1, width) that counts, and its information."""
        cdef Own own = self._one(watched)
        cdef cnp.ndarray found = np.empty((1, self.plan.width))
        information = _inform(&self.plan, &own, lost, <double *> target(block, np.float64, (1, self.plan.width)), <double *> cnp.PyArray_DATA(found))
        return found, information

    def whole(self, watched, cnp.ndarray block not None, double information, double time):
        """Add a block (1, width) at time [s] to one axis. Returns whether it ends a unit, and the unit (1, width)."""
        cdef Own own = self._one(watched)
        cdef cnp.ndarray unit = np.empty((1, self.plan.width))
        done = _gather(&self.plan, &own, <double *> target(block, np.float64, (1, self.plan.width)), information, time, <double *> cnp.PyArray_DATA(unit))
        return done, unit

    def counted(self, watched, disturbed, cnp.ndarray unit not None):
        """Store a unit (1, width) of one axis and update the statistic. Returns the information of the unit."""
        cdef Own own = self._one(watched)
        cdef Ring ring = self._ring(disturbed, 1)
        cdef const double *numbers = <double *> target(unit, np.float64, (1, self.plan.width))
        _push(&self.plan, &ring, 0, own.units[0], numbers, own.begun[0])
        return _count(&self.plan, &own, numbers)

    def crossed(self, watched, double information, uint32_t status):
        """Return whether a suspicion begins on one axis."""
        cdef Own own = self._one(watched)
        return _crossed(&self.plan, &own, information, status)

    def looked(self, watched, uint32_t status):
        """Return the new state of one axis, and the reason as an index in `watching.REASONS`."""
        cdef Own own = self._one(watched)
        cdef uint8_t wanted, reason
        _look(&self.plan, &own, status, &wanted, &reason)
        return wanted, reason

    cdef Own _one(self, watched) except *:
        _check(len(watched.state) == 1)
        return self._hold(watched)

    def run(self, watched, disturbed, index, scored, status, samples, filled, int64_t size, double dt):
        """Process a piece of n samples on k quiet axes, which are the rows `index` (k,) of all axes.

        `scored` holds blocks (k, most, width) and lost (k, most) from `ManyKernel.score`. `status` is (k, n). `samples`
        (k,) were processed before the piece, `filled` (k,) of them in the unfinished block. `size` is the number of
        samples in a block. Returns the states and the reasons (k, most) after each block, and which axes (k,) crossed
        the threshold. Shorter rows repeat their last state. The data of an axis that crossed stay unchanged. The call
        releases the interpreter.
        """
        blocks, lost = scored
        k, n, most = len(index), np.shape(status)[1], np.shape(lost)[1]
        cdef Own all = self._hold(watched)
        cdef Ring ring = self._ring(disturbed, len(watched.state))
        cdef Piece piece
        cdef const double *own_blocks = <double *> target(blocks, np.float64, (k, most, self.plan.width))
        cdef const uint8_t *own_lost = <uint8_t *> target(lost, np.uint8, (k, most))
        cdef const uint32_t *own_status = <uint32_t *> target(status, np.uint32, (k, n))
        cdef const int64_t *begins = <int64_t *> target(samples, np.int64, (k,))
        cdef const int64_t *fills = <int64_t *> target(filled, np.int64, (k,))
        cdef const int64_t *rows = <int64_t *> target(index, np.int64, (k,))
        wanted, reason = np.zeros((k, most), np.uint8), np.zeros((k, most), np.uint8)
        cdef uint8_t *states = <uint8_t *> target(wanted, np.uint8, (k, most))
        cdef uint8_t *reasons = <uint8_t *> target(reason, np.uint8, (k, most))
        crossed, room = np.zeros(k, np.bool_), np.empty(self.plan.width + 2 * self.plan.p + _detection_size(&self.plan))
        cdef uint8_t *over = <uint8_t *> target(crossed, np.bool_, (k,))
        cdef double *kept = <double *> target(room, np.float64, room.shape)
        _check(size > 0 and _fit(index, len(watched.state)) and _fit(filled, size) and (k == 0 or (filled.max() + n) // size <= most))
        cdef Py_ssize_t axes = k, length = n, places = most, row, block
        piece.dt, piece.size = dt, size
        with nogil:
            for row in range(axes):
                piece.blocks, piece.lost = own_blocks + row * places * self.plan.width, own_lost + row * places
                piece.status, piece.samples = own_status + row * length, begins[row]
                piece.place, piece.whole = size - 1 - fills[row], (fills[row] + length) // size
                over[row] = _run(&self.plan, &all, &ring, rows[row], &piece, states + row * places, reasons + row * places, kept)
                for block in range(piece.whole, places):
                    states[row * places + block] = all.state[rows[row]]
        return wanted, reason, crossed


cdef inline bint _run(const Plan *plan, const Own *all, const Ring *ring, int64_t axis, const Piece *piece, uint8_t *wanted, uint8_t *reason, double *room) noexcept nogil:
    cdef Own own = _of(plan, all, axis)
    cdef Before kept = _before(plan, &own, room)
    cdef bint crossed = _go_on(plan, &own, ring, axis, piece, wanted, reason)
    if crossed:
        _take_back(plan, &own, &kept, room)
    return crossed


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
    cdef Py_ssize_t n = len(counts)
    cdef pmf_outliers_t record
    found, moved, wrong, time = np.array(counts, np.int64), np.empty(n, np.int64), np.empty(n, np.uint8), _numbers(times)
    if len(time) != n:
        raise ValueError(f"counts and times must have the same length, got {n} and {len(time)}")
    record.samples, record.step, record.speed, record.time = n, step, speed, <double *> source(time, np.float64, (n,))
    record.count, record.moved = <int64_t *> target(found, np.int64, (n,)), <int64_t *> target(moved, np.int64, (n,))
    record.wrong = <unsigned char *> target(wrong, np.uint8, (n,))
    if n > 0:
        with nogil:
            pmf_find_outliers(&record)
    return found, wrong.astype(bool), moved


def first_order(signal, double a, double b0, double b1=0.0, double memory=0.0):
    """Filter a signal (n,) by (b0 + b1 z^-1) / (1 - a z^-1). Returns the output (n,) and the final memory.

    `memory` is the contribution of b1 and a from earlier samples, and 0 from rest. The bits are those of
    `scipy.signal.lfilter`. SciPy's import takes longer than the filtering of most signals.
    """
    given = _numbers(signal)
    cdef Py_ssize_t n = given.size, k
    found = np.empty(n)
    cdef const double *x = <double *> source(given, np.float64, (n,))
    cdef double *y = _data(found)
    for k in range(n):
        y[k] = memory + b0 * x[k]
        memory = b1 * x[k] + a * y[k]
    return found, memory


def products(signals):
    """Return the sums (c, c) over time of the products of all pairs of signals (c, n).

    A BLAS adds in an order that depends on the processor. This function adds from the first sample to the last.
    """
    given = _numbers(signals)
    cdef Py_ssize_t c = np.shape(given)[0], n = np.shape(given)[1], i, j, k
    cdef double total
    found = np.empty((c, c))
    cdef const double *x = <double *> source(given, np.float64, (c, n))
    cdef double *sums = _data(found)
    for i in range(c):
        for j in range(i, c):
            total = 0.0
            for k in range(n):
                total += x[i * n + k] * x[j * n + k]
            sums[i * c + j] = sums[j * c + i] = total
    return found


def follow_states(phis, nows, changes, inputs, start):
    """Return states (n, channels, N) from `start` (n, channels) by x[k+1] = phi x[k] + now w[k] + change (w[k+1] -
    w[k]).

    `phis` (steps, n, n), `nows` and `changes` (steps, n) have a row for each step, or one row for all. The inputs are
    (channels, N).
    """
    transitions, at, by, given = _numbers(phis), _numbers(nows), _numbers(changes), _numbers(inputs)
    cdef Py_ssize_t n = np.shape(phis)[1], channels = len(given), size = given.shape[1], k, c, i, j, place
    cdef Py_ssize_t steps = len(transitions)
    _check(steps == 1 or steps >= size - 1)
    found = np.empty((n, channels, size))
    found[:, :, 0] = start
    cdef const double *phi = <double *> source(transitions, np.float64, (steps, n, n))
    cdef const double *now = <double *> source(at, np.float64, (steps, n))
    cdef const double *change = <double *> source(by, np.float64, (steps, n))
    cdef const double *w = <double *> source(given, np.float64, (channels, size))
    cdef double *states = _data(found)
    cdef double total, slope
    for k in range(size - 1):
        place = k * n if steps > 1 else 0
        for c in range(channels):
            slope = w[c * size + k + 1] - w[c * size + k]
            for i in range(n):
                total = now[place + i] * w[c * size + k] + change[place + i] * slope
                for j in range(n):
                    total += phi[(place + i) * n + j] * states[(j * channels + c) * size + k]
                states[(i * channels + c) * size + k + 1] = total
    return found


#: Indices of an axis's integers. COUNTS to SAMPLES hold the last counts, the shift of the counter, and the number of
#: samples. LOST, KNOWN and CHANGED say whether the last sample was lost, any input is known, and the last known input
#: changed. FRESH is the number of consecutive kept counts. These begin at RECENT, each at its number modulo KEPT.
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

    A sample with an input that is not finite is lost. Counts resume from their last value after it: no speed is known.
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


def follow_many(cnp.ndarray whole not None, cnp.ndarray real not None, cnp.ndarray u not None, cnp.ndarray counts not None):
    """Return the estimators' counts (axes, n) for samples u, counts (axes, n) of many axes.

    `whole` (axes, WHOLE) and `real` (axes, REAL) are the `numbers` of the axes' `Inputs`, and are updated. Raises
    ValueError for other shapes.
    """
    axes, n = np.shape(u)
    found = np.empty((axes, n), np.int64)
    cdef const double *given = <double *> source(u, np.float64, (axes, n))
    cdef const int64_t *count = <int64_t *> source(counts, np.int64, (axes, n))
    cdef int64_t *wholes = <int64_t *> target(whole, np.int64, (axes, WHOLE))
    cdef double *reals = <double *> target(real, np.float64, (axes, REAL))
    cdef int64_t *followed = <int64_t *> target(found, np.int64, (axes, n))
    cdef Py_ssize_t many = axes, samples = n, axis, k
    with nogil:
        for axis in range(many):
            for k in range(axis * samples, (axis + 1) * samples):
                followed[k] = _follow(wholes + axis * WHOLE, reals + axis * REAL, given[k], count[k])
    return found


def bars(cnp.ndarray factor not None, cnp.ndarray variance not None, cnp.ndarray inflation not None, found=None):
    """Return standard errors (..., p) from variance factors (..., p), inflations (..., p) and innovation variances
    (...,).

    An inflation of zero does not scale, and a variance of zero gives infinity. `found` is an array for the results.
    Raises ValueError for other shapes and arrays with gaps.
    """
    std = np.empty(np.shape(factor)) if found is None else found
    shape = np.shape(factor)
    cdef const double *factors = <double *> source(factor, np.float64, shape)
    cdef const double *inflations = <double *> source(inflation, np.float64, shape)
    cdef const double *variances = <double *> source(variance, np.float64, shape[: factor.ndim - 1])
    cdef double *bar = <double *> target(std, np.float64, shape)
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
    cdef const int64_t *places = <int64_t *> target(index, np.int64, (size,))
    shape = np.shape(rows)[1:]
    cdef char *to = <char *> target(table, rows.dtype, (n, *shape))
    cdef const char *start = <char *> target(rows, rows.dtype, (size, *shape))
    cdef Py_ssize_t row = rows.nbytes // size if size else 0
    _check(_fit(index, n))
    with nogil:
        for k in range(size):
            memcpy(to + places[k] * row, start + k * row, row)
