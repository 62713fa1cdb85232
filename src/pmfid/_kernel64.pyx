# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False, freethreading_compatible=True
"""The binding of the C kernel in double precision. CMake renames its C to `_kernel32`, the kernel in single precision."""

from cpython.bytes cimport PyBytes_FromStringAndSize
from cpython.long cimport PyLong_AsUnsignedLongLongMask
from cpython.number cimport PyNumber_Index
from libc.math cimport sqrt
from libc.stdint cimport int64_t, uint32_t, uint64_t
from libc.string cimport memcpy, memset
cimport numpy as cnp
import numpy as np

from pmfid._arrays cimport source, target
from pmfid._estimate cimport OF_DOUBLE, OF_SINGLE, Estimate

IMPLAUSIBLE = "these numbers are no state of this configuration, whatever their checksum says"

cnp.import_array()

cdef extern from "pmf_internal.h":
    ctypedef double real_t
    enum:
        PMF_MAX_PARAMETERS
        PMF_MAX_COLUMNS
        PMF_BODY_ROLES
        PMF_MAX_SHAPES
        PMF_ROLES
        PMF_NO_PARAMETER
        PMF_SIGNALS
        PMF_AUXILIARY
        PMF_VELOCITY
        PMF_DIRECTION
        PMF_MOVING
        PMF_LATE_INPUT
        PMF_AHEAD
    # The structures list only the fields that are read here. Python fills a configuration by the names in pmf.h.
    ctypedef struct pmf_network_config_t:
        uint32_t n_columns
    ctypedef struct pmf_network_state_t:
        real_t column[PMF_MAX_COLUMNS]
    ctypedef struct pmf_auxiliary_config_t:
        real_t dt, input_gain
        uint32_t enabled
    ctypedef struct pmf_auxiliary_state_t:
        real_t parameter[PMF_ROLES]
        real_t velocity, position, step
    ctypedef struct pmf_encoder_config_t:
        real_t rate
        uint32_t guard
    ctypedef struct pmf_config_t:
        pmf_encoder_config_t encoder
        pmf_network_config_t network
        pmf_auxiliary_config_t auxiliary
    ctypedef struct pmf_estimate_t:
        real_t theta[PMF_MAX_PARAMETERS]
        real_t variance_factor[PMF_MAX_PARAMETERS]
        real_t inflation[PMF_MAX_PARAMETERS]
        real_t innovation, innovation_variance
    ctypedef struct pmf_recursion_state_t:
        real_t factor[PMF_MAX_PARAMETERS][PMF_MAX_PARAMETERS]
        real_t inverse_pivot[PMF_MAX_PARAMETERS]
        pmf_estimate_t estimate
    ctypedef struct pmf_state_t:
        uint32_t status
        pmf_network_state_t network
        pmf_recursion_state_t direct, instrument
    void pmf_init(const pmf_config_t *, pmf_state_t *) nogil
    uint32_t pmf_step(const pmf_config_t *, pmf_state_t *, real_t, uint32_t) nogil
    void pmf_set_step(const pmf_config_t *, pmf_state_t *, real_t) nogil
    uint32_t pmf_plausible(const pmf_config_t *, const pmf_state_t *) nogil
    void pmf_open(const pmf_config_t *, pmf_state_t *, uint32_t, real_t) nogil
    void pmf_rebase(pmf_state_t *, uint32_t) nogil
    void pmf_gap(const pmf_config_t *, pmf_state_t *, uint32_t) nogil
    void pmf_doubt(const pmf_config_t *, pmf_state_t *, uint32_t) nogil
    const pmf_estimate_t *pmf_estimate(const pmf_config_t *, const pmf_state_t *) nogil
    void pmf_clear(void *, uint32_t) nogil
    void pmf_auxiliary_step(const pmf_auxiliary_config_t *, pmf_auxiliary_state_t *, real_t *) nogil
    uint32_t pmf_parameters(const pmf_config_t *) nogil
    void pmf_clear_computed(const pmf_config_t *, pmf_state_t *) nogil
    void pmf_covariance_factor(const pmf_config_t *, const pmf_state_t *, real_t *) nogil

cdef extern from "many/pmf_straight.h":
    ctypedef uint32_t pmf_stepper_t(const pmf_config_t *, pmf_state_t *, real_t, uint32_t) noexcept nogil
    pmf_stepper_t *pmf_fastest_step(const pmf_config_t *) nogil
    pmf_stepper_t *pmf_fastest_filter(const pmf_config_t *) nogil

cdef extern from "many/pmf_many.h":
    ctypedef struct pmf_rows_t:
        const unsigned char *start
        int64_t axis, sample
        uint32_t size
    ctypedef struct pmf_many_t:
        uint32_t way
        pmf_rows_t input
        pmf_rows_t counts
        uint64_t samples, every, kept
        double *theta
        double *variance_factor
        double *inflation
        double *innovation
        double *innovation_variance
        uint32_t *status
    ctypedef struct pmf_layout_t:
        uint32_t packed_size, lane_words
    ctypedef struct pmf_scoring_t:
        uint32_t first, parameters, size, left_out, disturbed
    ctypedef struct pmf_scored_t:
        const double *input
        const double *theta
        const int64_t *counts
        uint64_t samples
        double *sums
        uint32_t *progress
        uint64_t kept
        double *blocks
        unsigned char *lost
    void pmf_pack(const pmf_layout_t *, const pmf_state_t *, unsigned char *) nogil
    void pmf_unpack(const pmf_layout_t *, const unsigned char *, pmf_state_t *) nogil
    uint32_t pmf_many_way() nogil
    void pmf_many_run(const pmf_config_t *, const pmf_layout_t *, const pmf_many_t *, uint64_t, uint64_t,
                      unsigned char *) nogil
    void pmf_score_axis(const pmf_config_t *, const pmf_scoring_t *, const pmf_scored_t *, uint64_t, pmf_state_t *) nogil
    void pmf_many_scores(const pmf_config_t *, const pmf_layout_t *, const pmf_scoring_t *, const pmf_scored_t *,
                         uint64_t, unsigned char *) nogil


cdef _set_scoring(pmf_scoring_t *scoring, numbers, uint32_t columns):
    """Store the numbers of a scoring. Raises ValueError if they exceed the columns."""
    scoring.first, scoring.parameters, scoring.size, scoring.left_out, scoring.disturbed = numbers
    if not 1 <= scoring.parameters <= PMF_MAX_PARAMETERS or scoring.size < 1 or \
            <uint64_t> scoring.first + 2 * scoring.parameters + 1 > columns:
        raise ValueError(f"there are {columns} columns, got {numbers}")


cdef _set_blocks(pmf_scored_t *many, const pmf_scoring_t *scoring, tuple axes, u, counts, theta, sums, progress):
    """Store samples and sums of the axes, whose numbers may be () or (axes,). Returns new arrays of blocks and lost."""
    cdef Py_ssize_t n = np.shape(u)[len(axes)], p = scoring.parameters, width = p + 2 * p * p, filled, kept
    many.input = <const double *> source(u, np.float64, (*axes, n))
    many.counts = <const int64_t *> source(counts, np.int64, (*axes, n))
    many.theta = <const double *> source(theta, np.float64, (*axes, p))
    many.sums = <double *> target(sums, np.float64, (*axes, width))
    many.progress = <uint32_t *> target(progress, np.uint32, (*axes, 2))
    filled = progress[..., 0].max(initial=0)
    if filled >= scoring.size:
        raise ValueError(f"a block has {scoring.size} samples, got one with {filled} and more to come")
    kept = (filled + n) // scoring.size if progress.size else 0
    blocks, lost = np.zeros((*axes, kept, width)), np.zeros((*axes, kept), np.uint8)
    many.samples, many.kept = n, kept
    many.blocks, many.lost = <double *> _numbers(blocks), <unsigned char *> _numbers(lost)
    return blocks, lost


cdef class Kernel:
    """A configured kernel with its state.

    `config` is a `pmf_config_t` of the module's sizes as bytes. `pmfid.kernel.configuration` and `raw_config` make this
    argument, and check that the kernel has room. `names` are the names of the parameters. Raises ValueError for a wrong
    number of bytes.
    """

    cdef pmf_config_t config
    cdef pmf_state_t state
    cdef pmf_stepper_t *_step
    cdef public tuple names

    dtype = np.dtype(np.float32 if sizeof(real_t) == 4 else np.float64)

    def __init__(self, bytes config not None):
        self.names = ()
        if len(config) != sizeof(pmf_config_t):
            raise ValueError(f"a configuration has {sizeof(pmf_config_t)} bytes, got {len(config)}")
        memcpy(&self.config, <const char *> config, sizeof(pmf_config_t))
        self._step = pmf_fastest_step(&self.config)
        pmf_init(&self.config, &self.state)

    @property
    def straight(self):
        """Whether a step runs straight code for this method and network. False selects the general code."""
        return self._step != pmf_step

    @straight.setter
    def straight(self, bint wanted):
        self._step = pmf_fastest_step(&self.config) if wanted else pmf_step

    def reset(self):
        """Return to the state before the first sample."""
        pmf_init(&self.config, &self.state)

    def open(self, double keep, int parameter=-1):
        """Multiply the information on a parameter (all parameters for -1) by `keep` in (0, 1]. The estimate stays."""
        pmf_open(&self.config, &self.state, PMF_NO_PARAMETER if parameter < 0 else parameter, <real_t> keep ** 0.5)

    def rebase(self, counts):
        """Set the counter's reading at the last sample, an integer of any size. Raises TypeError for other types."""
        cdef uint64_t count = PyLong_AsUnsignedLongLongMask(PyNumber_Index(counts))
        pmf_rebase(&self.state, <uint32_t> count)

    def gap(self, counts):
        """Report lost samples before a sample that reads `counts`, an integer of any size. Raises TypeError for other
        types."""
        cdef uint64_t count = PyLong_AsUnsignedLongLongMask(PyNumber_Index(counts))
        pmf_gap(&self.config, &self.state, <uint32_t> count)

    def doubt(self, uint32_t samples):
        """Report that the last sample was a guess. The estimate skips `samples` samples, at most the settling time."""
        pmf_doubt(&self.config, &self.state, samples)

    cdef Estimate _snapshot(self):
        cdef Estimate estimate = Estimate.__new__(Estimate)
        cdef Py_ssize_t n = pmf_parameters(&self.config), i, j
        cdef const pmf_estimate_t *last = pmf_estimate(&self.config, &self.state)
        cdef real_t factor[PMF_MAX_PARAMETERS * PMF_MAX_PARAMETERS]
        cdef const pmf_recursion_state_t *recursion = &self.state.direct
        if self.config.auxiliary.enabled:
            recursion = &self.state.instrument
        estimate._n, estimate._names = n, self.names
        for i in range(n):
            estimate._theta[i], estimate._diagonal[i] = last.theta[i], last.variance_factor[i]
            estimate._inflation[i] = last.inflation[i]
        if last == &recursion.estimate:  # P is computed when it is read
            estimate._form = OF_DOUBLE if sizeof(real_t) == sizeof(double) else OF_SINGLE
            for i in range(n):
                for j in range(i):
                    estimate._factor[i * n + j] = recursion.factor[i][j]
                estimate._factor[i * n + i] = recursion.inverse_pivot[i]
        else:
            pmf_covariance_factor(&self.config, &self.state, factor)
            for i in range(n * n):
                estimate._factor[i] = factor[i]
        estimate.innovation = last.innovation
        estimate.innovation_variance = last.innovation_variance
        estimate.status = self.state.status
        return estimate

    cdef _check_steps(self):
        """Raise ValueError if the kernel takes the clock for even."""
        if not self.config.encoder.rate > 0:
            raise ValueError("this estimator takes the clock for even; make it with steps=\"given\"")

    cdef const double *_steps(self, cnp.ndarray given, Py_ssize_t n) except? NULL:
        """Return the data of the steps (n,), or NULL for None."""
        if given is None:
            return NULL
        self._check_steps()
        return <const double *> source(given, np.float64, (n,))

    def step(self, double u, counts, dt=None):
        """Process one sample and return the `Estimate`. `counts` is an integer of any size.

        `dt` is the time since the last sample [s]. None stands for the sample period. Raises TypeError for other
        counts, and ValueError for a `dt` if the kernel takes the clock for even.
        """
        cdef uint64_t count = PyLong_AsUnsignedLongLongMask(PyNumber_Index(counts))
        if dt is not None:
            self._check_steps()
            pmf_set_step(&self.config, &self.state, <real_t> <double> dt)
        self._step(&self.config, &self.state, <real_t> u, <uint32_t> count)
        return self._snapshot()

    def estimate(self):
        """Return the present estimate."""
        return self._snapshot()

    def run(self, cnp.ndarray u not None, cnp.ndarray counts not None, cnp.ndarray steps=None):
        """Process the samples u, counts (n,), and return theta, the diagonal of P, its inflation, the innovation, its
        variance and the status.

        The first three results are (n, p), the others (n,). `steps` (n,) are the times between samples [s]. None stands
        for an even clock.
        """
        cdef Py_ssize_t n = u.size, p = pmf_parameters(&self.config), k, i
        cdef const double *step = self._steps(steps, n)
        cdef const double *given = <const double *> source(u, np.float64, (n,))
        cdef const int64_t *count = <const int64_t *> source(counts, np.int64, (n,))
        # NumPy asks for pages of 2 MB in blocks of 4 MB. Fresh small pages take as long as a third of the steps.
        tables, pairs = np.split(np.empty(n * (3 * p + 2)), [3 * n * p])
        status = np.empty(n, np.uint32)
        cdef double *theta = <double *> _numbers(tables)
        cdef double *factor = theta + n * p
        cdef double *inflation = factor + n * p
        cdef double *innovation = inflation + n * p
        cdef double *variance = innovation + n
        cdef uint32_t *bits = <uint32_t *> _numbers(status)
        cdef const pmf_estimate_t *last
        with nogil:
            for k in range(n):
                if step != NULL:
                    pmf_set_step(&self.config, &self.state, <real_t> step[k])
                bits[k] = self._step(&self.config, &self.state, <real_t> given[k], <uint32_t> count[k])
                last = pmf_estimate(&self.config, &self.state)
                for i in range(p):
                    theta[k * p + i] = last.theta[i]
                    factor[k * p + i] = last.variance_factor[i]
                    inflation[k * p + i] = last.inflation[i]
                innovation[k] = last.innovation
                variance[k] = last.innovation_variance
        return (*tables.reshape(3, n, p), *pairs.reshape(2, n), status)

    def filter(self, cnp.ndarray u not None, cnp.ndarray counts not None, cnp.ndarray steps=None):
        """Run encoder and filters alone on a whole record, with the arguments of `run`. Returns columns (n, c) and
        status (n,), in time with the samples. The guard judges the last samples with a motion that continues."""
        cdef Py_ssize_t n = u.size, c = self.config.network.n_columns, k, i
        cdef const double *step = self._steps(steps, n)
        cdef const double *given = <const double *> source(u, np.float64, (n,))
        cdef const int64_t *count = <const int64_t *> source(counts, np.int64, (n,))
        columns, status = np.empty((n, c)), np.empty(n, np.uint32)
        cdef double *column = <double *> _numbers(columns)
        cdef uint32_t *bits = <uint32_t *> _numbers(status)
        cdef pmf_stepper_t *filtered = pmf_fastest_filter(&self.config)
        cdef Py_ssize_t ahead = PMF_AHEAD if self.config.encoder.guard != 0 else 0, last
        cdef int64_t steady = count[n - 1] - count[n - 2] if n > 1 else 0
        cdef uint32_t found
        with nogil:
            for k in range(n + ahead if n > 0 else 0):
                last = k if k < n else n - 1
                if step != NULL:
                    pmf_set_step(&self.config, &self.state, <real_t> step[last])
                found = filtered(&self.config, &self.state, <real_t> given[last],
                                 <uint32_t> (count[last] + (k - last) * steady))
                if k >= ahead:
                    bits[k - ahead] = found
                    for i in range(c):
                        column[(k - ahead) * c + i] = self.state.network.column[i]
        return columns, status

    def score(self, cnp.ndarray u not None, cnp.ndarray counts not None, scoring, cnp.ndarray theta not None,
              cnp.ndarray sums not None, cnp.ndarray progress not None):
        """Sum scores in blocks for one axis. `ManyKernel.score` documents the arguments."""
        cdef pmf_scoring_t numbers
        cdef pmf_scored_t many
        _set_scoring(&numbers, scoring, self.config.network.n_columns)
        results = _set_blocks(&many, &numbers, (), u, counts, theta, sums, progress)
        with nogil:
            pmf_score_axis(&self.config, &numbers, &many, 0, &self.state)
        return results

    def many(self, Py_ssize_t axes, bytes layout):
        """Return `axes` axes in the present state. `layout` comes from `pmfid.kernel.saved.fleet_layout`."""
        return ManyKernel(self, axes, layout)

    def raw_config(self):
        """Return the configuration as the bytes of a `pmf_config_t` with the module's sizes."""
        return PyBytes_FromStringAndSize(<char *> &self.config, sizeof(pmf_config_t))

    def raw_state(self, bint kept=False):
        """Return the bytes of the state. With `kept` the values that each step computes again are zero."""
        cdef pmf_state_t state = self.state
        if kept:
            pmf_clear_computed(&self.config, &state)
        return PyBytes_FromStringAndSize(<char *> &state, sizeof(pmf_state_t))

    def kept_bytes(self):
        """Return 1 for each byte of a state, but 0 for the values that each step computes again."""
        cdef pmf_state_t state
        memset(&state, 1, sizeof(pmf_state_t))
        pmf_clear_computed(&self.config, &state)
        return PyBytes_FromStringAndSize(<char *> &state, sizeof(pmf_state_t))

    def set_raw_state(self, bytes state):
        """Restore the state from bytes of `raw_state` in the same configuration.

        Raises ValueError for a wrong number of bytes or values that no sample could have made. The state then stays.
        """
        cdef pmf_state_t taken
        if len(state) != sizeof(pmf_state_t):
            raise ValueError(f"a state has {sizeof(pmf_state_t)} bytes, got {len(state)}")
        memcpy(&taken, <char *> state, sizeof(pmf_state_t))
        if pmf_plausible(&self.config, &taken) == 0:
            raise ValueError(IMPLAUSIBLE)
        memcpy(&self.state, &taken, sizeof(pmf_state_t))


cdef inline void *_numbers(cnp.ndarray array):
    return cnp.PyArray_DATA(array)


cdef _set_rows(pmf_rows_t *rows, cnp.ndarray table):
    rows.start = <const unsigned char *> cnp.PyArray_DATA(table)
    rows.axis, rows.sample, rows.size = table.strides[0], table.strides[1], table.itemsize


cdef _check_tables(u, counts, results, axes, parameters, every):
    """Raise ValueError unless tables are (axes, n) and the results have exactly one place for each kept estimate."""
    if u.ndim != 2 or u.shape != counts.shape or u.shape[0] != axes:
        raise ValueError(f"u and counts must be ({axes}, n), got {u.shape} and {counts.shape}")
    if u.dtype not in (np.float32, np.float64) or counts.dtype not in (np.int32, np.int64):
        raise ValueError(f"u must be float32 or float64 and counts int32 or int64, got {u.dtype} and {counts.dtype}")
    samples = u.shape[1]
    kept = -(-samples // every) if every else min(samples, 1)
    shapes = [(axes, kept, parameters)] * 3 + [(axes, kept)] * 3
    for result, kind, shape in zip(results, (np.float64,) * 5 + (np.uint32,), shapes, strict=True):
        target(result, kind, shape)


cdef class ManyKernel:
    """Many axes with the configuration and the present state of one `Kernel`.

    `states` (axes, bytes) uint8 are packed. The argument `way` of methods selects how axes are computed. 0 computes one
    axis after the other. 1 to 3 use vectors of 16, 32 or 64 bytes. A way that the processor does not support acts as 0.
    """

    cdef pmf_config_t config
    cdef pmf_layout_t layout
    cdef object _start
    cdef readonly object states

    fastest_way = pmf_many_way()
    #: The version of packed states.
    packing = 6

    def __init__(self, Kernel kernel, Py_ssize_t axes, bytes layout not None):
        self.config = kernel.config
        if len(layout) > sizeof(pmf_layout_t):
            raise ValueError("a state has more words than a layout holds; raise PMF_MAX_WORDS in csrc/many/pmf_many.h")
        memcpy(&self.layout, <const char *> layout, len(layout))
        cdef cnp.ndarray own = np.zeros(self.layout.packed_size, np.uint8)
        pmf_pack(&self.layout, &kernel.state, <unsigned char *> cnp.PyArray_DATA(own))
        self._start = own
        self.states = np.tile(own, (axes, 1))

    def reset(self):
        """Return all axes to their first state."""
        self.states[:] = self._start

    def raw_config(self):
        """Return the configuration as the bytes of a `pmf_config_t` with the module's sizes."""
        return PyBytes_FromStringAndSize(<char *> &self.config, sizeof(pmf_config_t))

    def set_states(self, states):
        """Restore the states (axes, bytes) uint8 of the same configuration.

        Raises ValueError for a wrong shape or values that no sample could have made. The states then stay.
        """
        taken = np.array(states, np.uint8, order="C")
        if not self._plausible(<const unsigned char *> source(taken, np.uint8, self.states.shape)):
            raise ValueError(IMPLAUSIBLE)
        self.states[:] = taken

    def hold(self, cnp.ndarray states not None):
        """Replace the states by an array (axes, bytes) of the same configuration with any number of axes. Later calls
        change this array. Raises ValueError for a wrong shape."""
        target(states, np.uint8, (len(states), self.layout.packed_size))
        self.states = states

    cdef bint _plausible(self, const unsigned char *states) except -1:
        cdef pmf_state_t state
        cdef uint32_t fine = 1
        cdef Py_ssize_t axes = len(self.states), size = self.layout.packed_size, axis
        with nogil:
            pmf_clear(&state, sizeof(state))
            for axis in range(axes):
                pmf_unpack(&self.layout, states + axis * size, &state)
                fine &= pmf_plausible(&self.config, &state)
        return fine != 0

    cdef unsigned char *_row(self, Py_ssize_t axis) except NULL:
        if not 0 <= axis < len(self.states):
            raise IndexError(f"there are {len(self.states)} axes, got {axis}")
        return <unsigned char *> _numbers(self.states) + axis * self.layout.packed_size

    def plausible(self):
        """Return whether samples could have made all states. The call releases the interpreter."""
        return self._plausible(<unsigned char *> _numbers(self.states))

    def store(self, Kernel kernel, Py_ssize_t axis):
        """Copy the state of a kernel of the same configuration to an axis."""
        pmf_pack(&self.layout, &kernel.state, self._row(axis))

    def gap(self, Py_ssize_t axis, counts):
        """Report lost samples of an axis before a sample that reads `counts`."""
        cdef uint64_t count = PyLong_AsUnsignedLongLongMask(PyNumber_Index(counts))
        cdef pmf_state_t state
        pmf_clear(&state, sizeof(state))
        pmf_unpack(&self.layout, self._row(axis), &state)
        pmf_gap(&self.config, &state, <uint32_t> count)
        pmf_pack(&self.layout, &state, self._row(axis))

    def score(self, cnp.ndarray u not None, cnp.ndarray counts not None, scoring, cnp.ndarray theta not None,
              cnp.ndarray sums not None, cnp.ndarray progress not None):
        """Run encoder and filters on u, counts (axes, n), and sum scores in blocks.

        `scoring` holds the first column, the number p of parameters, the samples of a block, the status of samples to
        leave out, and the status of disturbed samples. `theta` is (axes, p). `sums` (axes, p + 2 p^2) and `progress`
        (axes, 2) hold each unfinished block and are updated. Returns the complete blocks (axes, most, p + 2 p^2), and
        whether all samples of a block were disturbed (axes, most). The call releases the interpreter. Raises ValueError
        for arrays of other shapes.
        """
        cdef pmf_scoring_t numbers
        cdef pmf_scored_t many
        cdef uint64_t axes = len(self.states)
        cdef unsigned char *states = <unsigned char *> _numbers(self.states)
        _set_scoring(&numbers, scoring, self.config.network.n_columns)
        results = _set_blocks(&many, &numbers, (axes,), u, counts, theta, sums, progress)
        with nogil:
            pmf_many_scores(&self.config, &self.layout, &numbers, &many, axes, states)
        return results

    @property
    def side_by_side(self):
        """Whether vectors can compute this configuration."""
        return self.layout.lane_words > 0

    def load(self, Kernel kernel, Py_ssize_t axis):
        """Copy the state of an axis to a kernel of the same configuration."""
        pmf_clear(&kernel.state, sizeof(pmf_state_t))
        pmf_unpack(&self.layout, self._row(axis), &kernel.state)

    def run(self, cnp.ndarray u, cnp.ndarray counts, Py_ssize_t first, Py_ssize_t end, uint64_t every, results, uint32_t way):
        """Process samples u (axes, n; float32 or float64) and counts (axes, n; int32 or int64) for the axes `first` to
        `end`.

        Both arrays may have any strides. The call fills `results` with every `every`-th estimate and the last one.
        `results` are theta, variance_factor and inflation (axes, kept, p), then innovation, innovation_variance and
        status (axes, kept). The call releases the interpreter. Raises ValueError for arrays of other shapes or types,
        because C does not check them.
        """
        cdef pmf_many_t many
        cdef unsigned char *states
        _check_tables(u, counts, results, self.states.shape[0], pmf_parameters(&self.config), every)
        if self.states.shape[1] != self.layout.packed_size or not 0 <= first <= end <= self.states.shape[0]:
            raise ValueError(f"there are {self.states.shape[0]} axes, got {first} to {end}")
        if u.shape[1] == 0 or first == end:
            return
        _set_rows(&many.input, u)
        _set_rows(&many.counts, counts)
        many.way, many.samples, many.every, many.kept = way, u.shape[1], every, results[0].shape[1]
        many.theta, many.variance_factor = <double *> _numbers(results[0]), <double *> _numbers(results[1])
        many.inflation, many.innovation = <double *> _numbers(results[2]), <double *> _numbers(results[3])
        many.innovation_variance, many.status = <double *> _numbers(results[4]), <uint32_t *> _numbers(results[5])
        states = <unsigned char *> _numbers(self.states)
        with nogil:
            pmf_many_run(&self.config, &self.layout, &many, first, end, states)


def simulate(parameters, double input_gain, double dt, cnp.ndarray u not None, double velocity=0.0):
    """Simulate the body of the on-line model under a held input u (n,), from position 0.

    `parameters` (k,) are mass, viscous friction forward and backward, Coulomb friction forward and backward, offset and
    stiffness. Missing parameters are 0. `velocity` is that of the start. A spring is slack at the start.

    Returns the mean velocity, the signed moving fraction and the moving fraction (n,). Raises ValueError for too many
    parameters.
    """
    cdef pmf_auxiliary_config_t config
    cdef pmf_auxiliary_state_t state
    cdef real_t signal[PMF_SIGNALS + PMF_MAX_SHAPES]
    cdef Py_ssize_t n = u.size, k
    cdef const double *given = <const double *> source(u, np.float64, (n,))
    if len(parameters) > PMF_BODY_ROLES:
        raise ValueError(f"the model takes {PMF_BODY_ROLES} parameters, got {len(parameters)}")
    pmf_clear(&config, sizeof(config))
    pmf_clear(&state, sizeof(state))
    pmf_clear(signal, sizeof(signal))
    config.dt, config.input_gain, state.velocity = dt, input_gain, velocity
    for k, parameter in enumerate(parameters):
        state.parameter[k] = parameter
    means = np.empty((3, n))
    cdef double *mean = <double *> _numbers(means)
    for k in range(n):
        signal[PMF_LATE_INPUT] = <real_t> given[k]
        pmf_auxiliary_step(&config, &state, signal)
        mean[k] = signal[PMF_AUXILIARY + PMF_VELOCITY]
        mean[n + k] = signal[PMF_AUXILIARY + PMF_DIRECTION]
        mean[2 * n + k] = signal[PMF_AUXILIARY + PMF_MOVING]
    return tuple(means)


cdef extern from "edges/pmf_redge.h":
    enum:
        PMF_BODY
        PMF_EDGE_UNKNOWNS
    ctypedef struct pmf_redge_config_t:
        real_t dt, resolution, input_gain, tick, memory, finest
        uint32_t lines, sign, parameters
    ctypedef struct pmf_line_t:
        real_t sum
    ctypedef struct pmf_redge_state_t:
        real_t covariance[PMF_EDGE_UNKNOWNS][PMF_EDGE_UNKNOWNS]
        real_t theta[PMF_BODY]
        real_t variance[PMF_BODY]
        real_t innovation
        uint32_t running, status
    void pmf_redge_init(const pmf_redge_config_t *, pmf_redge_state_t *, pmf_line_t *)
    void pmf_redge_expect(const pmf_redge_config_t *, pmf_redge_state_t *, const real_t *)
    uint32_t pmf_redge_plausible(const pmf_redge_config_t *, const pmf_redge_state_t *, const pmf_line_t *)
    uint32_t pmf_redge_step(const pmf_redge_config_t *, pmf_redge_state_t *, pmf_line_t *, real_t, uint32_t, real_t) nogil

#: Samples of axes (k, n), and their results: theta and variances (k, n, p), innovations, variances, status bits (k, n).
cdef struct EdgeRows:
    Py_ssize_t axes, samples, parameters
    const double *u
    const int64_t *counts
    const double *ages
    double *theta
    double *variance
    double *innovation
    double *known
    uint32_t *status

cdef tuple _fill_rows(EdgeRows *rows, u, counts, ages, Py_ssize_t parameters):
    """Set the rows to samples u, counts, ages (k, n) and to new arrays of results, and return these arrays."""
    shape = k, n = np.shape(u)
    results = (np.empty((k, n, parameters)), np.empty((k, n, parameters)), np.empty(shape), np.empty(shape),
               np.empty(shape, np.uint32))
    rows.axes, rows.samples, rows.parameters = k, n, parameters
    rows.u, rows.ages = <double *> source(u, np.float64, shape), <double *> source(ages, np.float64, shape)
    rows.counts = <int64_t *> source(counts, np.int64, shape)
    rows.theta, rows.variance, rows.innovation = <double *> _numbers(results[0]), <double *> _numbers(results[1]), <double *> _numbers(results[2])
    rows.known, rows.status = <double *> _numbers(results[3]), <uint32_t *> _numbers(results[4])
    return results

cdef void _run_edges(const pmf_redge_config_t *config, pmf_redge_state_t *state, pmf_line_t *lines, const EdgeRows *rows,
                     Py_ssize_t axis) noexcept nogil:
    """Take the samples of an axis, and write its results."""
    cdef Py_ssize_t k, i
    for k in range(axis * rows.samples, (axis + 1) * rows.samples):
        rows.status[k] = pmf_redge_step(config, state, lines, <real_t> rows.u[k], <uint32_t> <uint64_t> rows.counts[k],
                                        <real_t> rows.ages[k])
        rows.innovation[k] = state.innovation
        rows.known[k] = 1.0 if state.running else 0.0
        for i in range(rows.parameters):
            rows.theta[k * rows.parameters + i] = state.theta[i]
            rows.variance[k * rows.parameters + i] = state.variance[i]

cdef class EdgeKernel:
    """The recursion over edges with its state, and the sums of its lines.

    names: of mass, viscous and Coulomb friction, and the offset if there is one. The other arguments are the fields of `pmf_redge_config_t`.
    """

    cdef pmf_redge_config_t config
    cdef pmf_redge_state_t state
    cdef cnp.ndarray lines
    cdef pmf_line_t *_lines
    cdef tuple names

    def __init__(self, tuple names not None, double dt, double resolution, double input_gain, double tick, double memory,
                 uint32_t lines, uint32_t sign):
        self.names = names
        self.config.dt, self.config.resolution, self.config.input_gain = dt, resolution, input_gain
        self.config.tick, self.config.memory = tick, memory
        self.config.lines, self.config.sign, self.config.parameters = lines, sign, len(names)
        self.config.finest = 3e-4 if sizeof(real_t) == 4 else 1e-6
        self.lines = np.zeros((max(lines, 1), sizeof(pmf_line_t)), np.uint8)
        self._lines = <pmf_line_t *> cnp.PyArray_DATA(self.lines)
        self.reset()

    def reset(self):
        """Return to the state before the first sample."""
        pmf_redge_init(&self.config, &self.state, self._lines)

    def expect(self, theta not None):
        """Begin again at the next edges, from given parameters (p,)."""
        cdef real_t[PMF_BODY] given
        cdef Py_ssize_t i
        for i in range(self.config.parameters):
            given[i] = <double> theta[i]
        pmf_redge_expect(&self.config, &self.state, given)

    def raw_config(self):
        """Return the bytes of the configuration."""
        return PyBytes_FromStringAndSize(<char *> &self.config, sizeof(pmf_redge_config_t))

    def raw_state(self):
        """Return the bytes of the state and of the lines."""
        return PyBytes_FromStringAndSize(<char *> &self.state, sizeof(pmf_redge_state_t)) + self.lines.tobytes()

    def set_raw_state(self, bytes data not None):
        """Take the bytes of `raw_state`; raises ValueError for other bytes, and keeps the present state."""
        cdef const char *lines = <const char *> data + sizeof(pmf_redge_state_t)
        cdef pmf_redge_state_t state
        if len(data) != sizeof(pmf_redge_state_t) + self.lines.size:
            raise ValueError(f"a state has {sizeof(pmf_redge_state_t) + self.lines.size} bytes, got {len(data)}")
        memcpy(&state, <const char *> data, sizeof(pmf_redge_state_t))
        if not pmf_redge_plausible(&self.config, &state, <const pmf_line_t *> lines):
            raise ValueError("the numbers are not a state of the recursion over edges")
        self.state = state
        memcpy(self._lines, lines, self.lines.size)

    cdef double _covariance(self, Py_ssize_t i, Py_ssize_t j) noexcept:
        """Return the covariance of two parameters, with their widened variances."""
        cdef Py_ssize_t first = PMF_EDGE_UNKNOWNS - PMF_BODY
        cdef double own = self.state.covariance[first + i][first + i], other = self.state.covariance[first + j][first + j]
        if i == j:
            return self.state.variance[i]
        if not (own > 0.0 and other > 0.0):
            return 0.0
        return self.state.covariance[first + i][first + j] / sqrt(own * other) * \
            sqrt(<double> self.state.variance[i]) * sqrt(<double> self.state.variance[j])

    def estimate(self):
        """Return the present estimate."""
        cdef Estimate estimate = Estimate.__new__(Estimate)
        cdef Py_ssize_t i, j
        cdef Py_ssize_t n = self.config.parameters
        estimate._n, estimate._names = n, self.names
        for i in range(n):
            estimate._theta[i], estimate._diagonal[i] = self.state.theta[i], self.state.variance[i]
            for j in range(n):
                estimate._factor[i * n + j] = self._covariance(i, j)
        estimate.innovation = self.state.innovation
        estimate.innovation_variance = 1.0 if self.state.running else 0.0
        estimate.status = self.state.status
        return estimate

    def step(self, double u, counts, double age):
        """Take a sample and return the `Estimate`; age is NaN without an edge since the last sample."""
        cdef uint64_t count = PyLong_AsUnsignedLongLongMask(PyNumber_Index(counts))
        pmf_redge_step(&self.config, &self.state, self._lines, <real_t> u, <uint32_t> count, <real_t> age)
        return self.estimate()

    def run(self, cnp.ndarray u not None, cnp.ndarray counts not None, cnp.ndarray ages not None):
        """Take n samples; return theta and variances (n, p), innovations, their variances and status bits (n,)."""
        cdef EdgeRows rows
        results = _fill_rows(&rows, u[None], counts[None], ages[None], self.config.parameters)
        with nogil:
            _run_edges(&self.config, &self.state, self._lines, &rows, 0)
        return tuple([array[0] for array in results])

    def run_many(self, cnp.ndarray states not None, cnp.ndarray u not None, cnp.ndarray counts not None,
                 cnp.ndarray ages not None):
        """Take n samples of k axes with this configuration, one axis after the other, without the interpreter lock.

        states (k, bytes) are those of `raw_state`, and change in place. Return the arrays of `run` with k rows. Raises
        ValueError for states of another size.
        """
        cdef Py_ssize_t axis, size = sizeof(pmf_redge_state_t) + self.lines.size
        cdef EdgeRows rows
        results = _fill_rows(&rows, u, counts, ages, self.config.parameters)
        cdef unsigned char *state = <unsigned char *> target(states, np.uint8, (rows.axes, size))
        with nogil:
            for axis in range(rows.axes):
                _run_edges(&self.config, <pmf_redge_state_t *> (state + axis * size),
                           <pmf_line_t *> (state + axis * size + sizeof(pmf_redge_state_t)), &rows, axis)
        return results
