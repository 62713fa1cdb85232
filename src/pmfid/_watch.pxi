# What a watch makes of the blocks of its axes: see `monitor.watching`. Part of _stage.pyx.

cdef extern from "pmf.h":
    enum:
        PMF_STARTING
        PMF_POOR_EXCITATION
        PMF_STANDSTILL

#: A block with less of the average information tells nothing.
cdef double INFORMATIVE = 0.05
#: Numbers of the states in which an axis is quiet, and the reason if nothing can be known, by its place in `watching.REASONS`.
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
    """Blocks that are still to wait, after one in which the filters settled all the time (lost) or not: there the
    simulated motion has lost the plant. While there are any, blocks count for nothing."""
    return _waiting_after(lost, waiting, wait)


cdef inline int64_t _waiting_after(bint lost, int64_t waiting, int64_t wait) noexcept nogil:
    return wait if lost else waiting - 1 if waiting > 1 else 0


cdef struct Plan:
    Py_ssize_t p, width
    Norm blocks
    Norm units
    Rule detector
    bint work
    double size
    const double *offset
    const double *limit
    double threshold, block_time
    int64_t silent_blocks


#: What is known of an axis: rows of `monitor.arrays.Watched`.
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
    if plan.work:
        _centre(plan.p, counted, counted + plan.p, plan.offset)
    return information


cdef inline bint _gather(const Plan *plan, const Own *own, const double *counted, double information, double time, double *unit) noexcept nogil:
    cdef Py_ssize_t i
    if own.members[0] == 0:
        own.begun[0] = time - plan.block_time
    if not plan.work:
        memcpy(unit, counted, plan.width * sizeof(double))
        return True
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
    cdef const double *score = unit
    cdef const double *square = unit + p + p * p
    cdef double weight
    _deviations(&plan.units, score, own.sigma, x)
    if plan.work:
        weight = _weight(p, x, plan.limit)
        for i in range(p):
            weighed[i] = score[i] * weight
        for i in range(p * p):
            weighed[p + i] = square[i] * weight
        _deviations(&plan.units, weighed, own.sigma, x)
        _expect(&plan.units, weighed + p, w)
    else:
        _expect(&plan.units, square, w)
    own.statistic[0] = _detect(&plan.detector, x, w, own.tolerance, own.detection)
    own.units[0] += 1
    return _information(&plan.units, square) if plan.work else _mean(w, p)


cdef inline bint _crossed(const Plan *plan, const Own *own, double information, uint32_t status) noexcept nogil:
    return own.statistic[0] > plan.threshold and information > INFORMATIVE and status & (PMF_STARTING | PMF_POOR_EXCITATION) == 0


cdef inline void _look(const Plan *plan, const Own *own, uint32_t status, uint8_t *wanted, uint8_t *reason) noexcept nogil:
    """The last that holds."""
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
    own.detection = all.detection + axis * _detection_size(plan)
    return own


cdef inline Py_ssize_t _detection_size(const Plan *plan) noexcept nogil:
    return plan.p * _rows_of(plan.detector.kind, plan.detector.window)


#: Where the units of the axes are kept, the last `places` of each in a ring.
cdef struct Ring:
    double *units
    double *begun
    Py_ssize_t places


cdef inline void _push(const Plan *plan, const Ring *ring, int64_t axis, int64_t units, const double *unit, double begun) noexcept nogil:
    cdef Py_ssize_t place = axis * ring.places + units % ring.places
    memcpy(ring.units + place * plan.width, unit, plan.width * sizeof(double))
    ring.begun[place] = begun


#: As they were, for an axis that turns out not to be quiet.
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
    memcpy(room + plan.width, own.detection, _detection_size(plan) * sizeof(double))
    return kept


cdef inline void _take_back(const Plan *plan, const Own *own, const Before *kept, const double *room) noexcept nogil:
    own.state[0], own.waiting[0], own.silence[0] = kept.state, kept.waiting, kept.silence
    own.members[0], own.units[0], own.opened[0] = kept.members, kept.units, kept.opened
    own.begun[0], own.statistic[0] = kept.begun, kept.statistic
    memcpy(own.opening, room, plan.width * sizeof(double))
    memcpy(own.detection, room + plan.width, _detection_size(plan) * sizeof(double))


#: A piece of samples of an axis: its blocks, the status of all samples, the place of the first block's last one.
cdef struct Piece:
    const double *blocks
    const uint8_t *lost
    const uint32_t *status
    int64_t samples, place, size, whole
    double dt


cdef inline bint _go_on(const Plan *plan, const Own *own, const Ring *ring, int64_t axis, const Piece *piece, uint8_t *wanted, uint8_t *reason) noexcept nogil:
    """Whether the axis crosses the threshold: then it stops there. What was pushed until then is what a monitor by
    itself will push at these places."""
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
    """The numbers of a watch. norms, seen: of blocks and of units; work: None, or size, offset (p,) and limit (p,) of
    units of work; threshold: of the statistic; block_time [s]; silent_blocks: without information after which nothing
    can be known. All arrays are those of `monitor.arrays`. Raises ValueError where the shapes do not fit."""

    cdef Plan plan
    cdef object _kept
    cdef readonly Detection detection

    def __init__(self, Norms norms not None, Norms seen not None, Detection detection not None, work, double threshold, double block_time, int64_t silent_blocks):
        p = norms.norm.p
        _check(seen.norm.p == p and detection.rule.p == p)
        self.detection = detection
        self.plan.p, self.plan.width, self.plan.work = p, p + 2 * p * p, work is not None
        self.plan.blocks, self.plan.units, self.plan.detector = norms.norm, seen.norm, detection.rule
        self._kept = norms, seen
        if work is not None:
            self.plan.size, offset, limit = work[0], _numbers(work[1]), _numbers(work[2])
            _check(offset.shape == limit.shape == (p,))
            self.plan.offset, self.plan.limit = _data(offset), _data(limit)
            self._kept = norms, seen, offset, limit
        self.plan.threshold, self.plan.block_time, self.plan.silent_blocks = threshold, block_time, silent_blocks

    cdef Own _hold(self, watched) except *:
        cdef Own own
        n, p = len(watched.state), self.plan.p
        own.state = <uint8_t *> _table(watched.state, np.uint8, (n,))
        own.waiting, own.silence = <int64_t *> _table(watched.waiting, np.int64, (n,)), <int64_t *> _table(watched.silence, np.int64, (n,))
        own.members, own.units = <int64_t *> _table(watched.members, np.int64, (n,)), <int64_t *> _table(watched.units, np.int64, (n,))
        own.opened, own.begun = <double *> _table(watched.opened, np.float64, (n,)), <double *> _table(watched.begun, np.float64, (n,))
        own.statistic = <double *> _table(watched.statistic, np.float64, (n,))
        own.opening = <double *> _table(watched.opening, np.float64, (n, self.plan.width))
        own.detection = <double *> _table(watched.detection, np.float64, (n, self.detection.rows, p))
        own.wait = <int64_t *> _table(watched.wait, np.int64, (n,))
        own.sigma, own.tolerance = <double *> _table(watched.sigma, np.float64, (n, p)), <double *> _table(watched.tolerance, np.float64, (n, p))
        return own

    cdef Ring _ring(self, disturbed, axes) except *:
        cdef Ring ring
        ring.places = np.shape(disturbed.units)[1]
        ring.units = <double *> _table(disturbed.units, np.float64, (axes, ring.places, self.plan.width))
        ring.begun = <double *> _table(disturbed.begun, np.float64, (axes, ring.places))
        return ring

    def informed(self, watched, cnp.ndarray block not None, bint lost):
        """One axis: a block (1, width), as far as it counts, and its information."""
        cdef Own own = self._one(watched)
        cdef cnp.ndarray found = np.empty((1, self.plan.width))
        information = _inform(&self.plan, &own, lost, <double *> _table(block, np.float64, (1, self.plan.width)), <double *> cnp.PyArray_DATA(found))
        return found, information

    def whole(self, watched, cnp.ndarray block not None, double information, double time):
        """One axis: whether a block that counts, (1, width), completes a unit, and the unit (1, width). time: of it."""
        cdef Own own = self._one(watched)
        cdef cnp.ndarray unit = np.empty((1, self.plan.width))
        done = _gather(&self.plan, &own, <double *> _table(block, np.float64, (1, self.plan.width)), information, time, <double *> cnp.PyArray_DATA(unit))
        return done, unit

    def counted(self, watched, disturbed, cnp.ndarray unit not None):
        """One axis: keeps a unit (1, width), takes it into the statistic; its information."""
        cdef Own own = self._one(watched)
        cdef Ring ring = self._ring(disturbed, 1)
        cdef const double *numbers = <double *> _table(unit, np.float64, (1, self.plan.width))
        _push(&self.plan, &ring, 0, own.units[0], numbers, own.begun[0])
        return _count(&self.plan, &own, numbers)

    def crossed(self, watched, double information, uint32_t status):
        """One axis: whether a suspicion begins."""
        cdef Own own = self._one(watched)
        return _crossed(&self.plan, &own, information, status)

    def looked(self, watched, uint32_t status):
        """One axis: the state that it should be in, whether there is anything to tell from, and why, as a place in
        `watching.REASONS`."""
        cdef Own own = self._one(watched)
        cdef uint8_t wanted, reason
        _look(&self.plan, &own, status, &wanted, &reason)
        return wanted, reason

    cdef Own _one(self, watched) except *:
        _check(len(watched.state) == 1)
        return self._hold(watched)

    def run(self, watched, disturbed, index, scored, status, samples, filled, int64_t size, double dt):
        """Pieces of n samples of k quiet axes, the rows index (k,) of what is known of all. scored: blocks
        (k, most, width) and lost (k, most) of `ManyKernel.score`; status: (k, n); samples: (k,) before the piece;
        filled: (k,) samples of the block under way then; size: of a block. Returns (k, most) the states after each
        block, the last one again where an axis has fewer, and why, as places in `watching.REASONS`; and (k,) which axes
        crossed the threshold: of these nothing that is known has changed. Releases the interpreter meanwhile."""
        blocks, lost = scored
        k, n, most = len(index), np.shape(status)[1], np.shape(lost)[1]
        cdef Own all = self._hold(watched)
        cdef Ring ring = self._ring(disturbed, len(watched.state))
        cdef Piece piece
        cdef const double *own_blocks = <double *> _table(blocks, np.float64, (k, most, self.plan.width))
        cdef const uint8_t *own_lost = <uint8_t *> _table(lost, np.uint8, (k, most))
        cdef const uint32_t *own_status = <uint32_t *> _table(status, np.uint32, (k, n))
        cdef const int64_t *begins = <int64_t *> _table(samples, np.int64, (k,))
        cdef const int64_t *fills = <int64_t *> _table(filled, np.int64, (k,))
        cdef const int64_t *rows = <int64_t *> _table(index, np.int64, (k,))
        wanted, reason = np.zeros((k, most), np.uint8), np.zeros((k, most), np.uint8)
        cdef uint8_t *states = <uint8_t *> _table(wanted, np.uint8, (k, most))
        cdef uint8_t *reasons = <uint8_t *> _table(reason, np.uint8, (k, most))
        crossed, room = np.zeros(k, np.bool_), np.empty(self.plan.width + _detection_size(&self.plan))
        cdef uint8_t *over = <uint8_t *> _table(crossed, np.bool_, (k,))
        cdef double *kept = <double *> _table(room, np.float64, room.shape)
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
