# The watch over the blocks of many axes for `monitor.watching`. Part of _stage.pyx.

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
        own.state = <uint8_t *> _table(watched.state, np.uint8, (n,))
        own.waiting, own.silence = <int64_t *> _table(watched.waiting, np.int64, (n,)), <int64_t *> _table(watched.silence, np.int64, (n,))
        own.members, own.units = <int64_t *> _table(watched.members, np.int64, (n,)), <int64_t *> _table(watched.units, np.int64, (n,))
        own.opened, own.begun = <double *> _table(watched.opened, np.float64, (n,)), <double *> _table(watched.begun, np.float64, (n,))
        own.statistic = <double *> _table(watched.statistic, np.float64, (n,))
        own.opening = <double *> _table(watched.opening, np.float64, (n, self.plan.width))
        own.detection = <double *> _table(watched.detection, np.float64, (n, self.detection.rows, p))
        own.line = <double *> _table(watched.line, np.float64, (n, 2, p))
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
        """Return the part of one axis's block (1, width) that counts, and its information."""
        cdef Own own = self._one(watched)
        cdef cnp.ndarray found = np.empty((1, self.plan.width))
        information = _inform(&self.plan, &own, lost, <double *> _table(block, np.float64, (1, self.plan.width)), <double *> cnp.PyArray_DATA(found))
        return found, information

    def whole(self, watched, cnp.ndarray block not None, double information, double time):
        """Add a block (1, width) at time [s] to one axis. Returns whether it completes a unit, and the unit (1, width).
        """
        cdef Own own = self._one(watched)
        cdef cnp.ndarray unit = np.empty((1, self.plan.width))
        done = _gather(&self.plan, &own, <double *> _table(block, np.float64, (1, self.plan.width)), information, time, <double *> cnp.PyArray_DATA(unit))
        return done, unit

    def counted(self, watched, disturbed, cnp.ndarray unit not None):
        """Store a unit (1, width) of one axis and update the statistic. Returns the information of the unit."""
        cdef Own own = self._one(watched)
        cdef Ring ring = self._ring(disturbed, 1)
        cdef const double *numbers = <double *> _table(unit, np.float64, (1, self.plan.width))
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
        cdef const double *own_blocks = <double *> _table(blocks, np.float64, (k, most, self.plan.width))
        cdef const uint8_t *own_lost = <uint8_t *> _table(lost, np.uint8, (k, most))
        cdef const uint32_t *own_status = <uint32_t *> _table(status, np.uint32, (k, n))
        cdef const int64_t *begins = <int64_t *> _table(samples, np.int64, (k,))
        cdef const int64_t *fills = <int64_t *> _table(filled, np.int64, (k,))
        cdef const int64_t *rows = <int64_t *> _table(index, np.int64, (k,))
        wanted, reason = np.zeros((k, most), np.uint8), np.zeros((k, most), np.uint8)
        cdef uint8_t *states = <uint8_t *> _table(wanted, np.uint8, (k, most))
        cdef uint8_t *reasons = <uint8_t *> _table(reason, np.uint8, (k, most))
        crossed, room = np.zeros(k, np.bool_), np.empty(self.plan.width + 2 * self.plan.p + _detection_size(&self.plan))
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
