# Binding of the C kernel, compiled as `_kernel64` and `_kernel32`.

from cpython.bytes cimport PyBytes_FromStringAndSize
from cpython.long cimport PyLong_AsUnsignedLongLongMask
from cpython.number cimport PyNumber_Index
from libc.stdint cimport int64_t, uint32_t, uint64_t
from libc.string cimport memcpy, memset
cimport numpy as cnp
import numpy as np

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


cdef _check_blocks(const pmf_scoring_t *scoring, progress, shapes, expected):
    if shapes != expected:
        raise ValueError(f"the arrays must have the shapes {expected}, got {shapes}")
    if progress.size and progress[..., 0].max() >= scoring.size:
        raise ValueError(f"a block has {scoring.size} samples, got one with {progress[..., 0].max()} and more to come")


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
    max_parameters = PMF_MAX_PARAMETERS

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

    cdef _check_steps(self, given):
        """Raise ValueError for steps if the kernel takes the clock for even."""
        if given is not None and not self.config.encoder.rate > 0:
            raise ValueError("this estimator takes the clock for even; make it with steps=\"given\"")

    def step(self, double u, counts, dt=None):
        """Process one sample and return the `Estimate`. `counts` is an integer of any size.

        `dt` is the time since the last sample [s]. None stands for the sample period. Raises TypeError for other
        counts, and ValueError for a `dt` if the kernel takes the clock for even.
        """
        cdef uint64_t count = PyLong_AsUnsignedLongLongMask(PyNumber_Index(counts))
        if dt is not None:
            self._check_steps(dt)
            pmf_set_step(&self.config, &self.state, <real_t> <double> dt)
        self._step(&self.config, &self.state, <real_t> u, <uint32_t> count)
        return self._snapshot()

    def estimate(self):
        """Return the present estimate."""
        return self._snapshot()

    def run(self, cnp.ndarray[double, mode="c"] u not None, cnp.ndarray[int64_t, mode="c"] counts not None,
            cnp.ndarray[double, mode="c"] steps=None):
        """Process the samples u, counts (n,), and return theta, the diagonal of P, its inflation, the innovation, its
        variance and the status.

        The first three results are (n, p), the others (n,). `steps` (n,) are the times between samples [s]. None stands
        for an even clock.
        """
        self._check_steps(steps)
        cdef const double *step = NULL if steps is None else <const double *> _numbers(steps)
        cdef Py_ssize_t n = u.shape[0], p = pmf_parameters(&self.config), k, i
        # NumPy asks for pages of 2 MB in blocks of 4 MB. Fresh small pages take as long as a third of the steps.
        tables, pairs = np.split(np.empty(n * (3 * p + 2)), [3 * n * p])
        cdef cnp.ndarray[double, ndim=2, mode="c"] theta, factor, inflation
        cdef cnp.ndarray[double, mode="c"] innovation, variance
        theta, factor, inflation = tables.reshape(3, n, p)
        innovation, variance = pairs.reshape(2, n)
        cdef cnp.ndarray[uint32_t, mode="c"] status = np.empty(n, np.uint32)
        cdef const pmf_estimate_t *last
        with nogil:
            for k in range(n):
                if step != NULL:
                    pmf_set_step(&self.config, &self.state, <real_t> step[k])
                status[k] = self._step(&self.config, &self.state, <real_t> u[k], <uint32_t> counts[k])
                last = pmf_estimate(&self.config, &self.state)
                for i in range(p):
                    theta[k, i] = last.theta[i]
                    factor[k, i] = last.variance_factor[i]
                    inflation[k, i] = last.inflation[i]
                innovation[k] = last.innovation
                variance[k] = last.innovation_variance
        return theta, factor, inflation, innovation, variance, status

    def filter(self, cnp.ndarray[double, mode="c"] u not None, cnp.ndarray[int64_t, mode="c"] counts not None,
               cnp.ndarray[double, mode="c"] steps=None):
        """Run encoder and filters alone on a whole record, with the arguments of `run`. Returns columns (n, c) and
        status (n,), in time with the samples. The guard judges the last samples with a motion that continues."""
        self._check_steps(steps)
        cdef const double *step = NULL if steps is None else <const double *> _numbers(steps)
        cdef Py_ssize_t n = u.shape[0], c = self.config.network.n_columns, k, i
        cdef cnp.ndarray[double, ndim=2, mode="c"] columns = np.empty((n, c))
        cdef cnp.ndarray[uint32_t, mode="c"] status = np.empty(n, np.uint32)
        cdef pmf_stepper_t *filtered = pmf_fastest_filter(&self.config)
        cdef Py_ssize_t ahead = PMF_AHEAD if self.config.encoder.guard != 0 else 0, last
        cdef int64_t steady = counts[n - 1] - counts[n - 2] if n > 1 else 0
        cdef uint32_t found
        with nogil:
            for k in range(n + ahead if n > 0 else 0):
                last = k if k < n else n - 1
                if step != NULL:
                    pmf_set_step(&self.config, &self.state, <real_t> step[last])
                found = filtered(&self.config, &self.state, <real_t> u[last],
                                 <uint32_t> (counts[last] + (k - last) * steady))
                if k >= ahead:
                    status[k - ahead] = found
                    for i in range(c):
                        columns[k - ahead, i] = self.state.network.column[i]
        return columns, status

    def score(self, cnp.ndarray[double, mode="c"] u not None, cnp.ndarray[int64_t, mode="c"] counts not None, scoring,
              cnp.ndarray[double, mode="c"] theta not None, cnp.ndarray[double, mode="c"] sums not None,
              cnp.ndarray[uint32_t, mode="c"] progress not None):
        """Sum scores in blocks for one axis. `ManyKernel.score` documents the arguments."""
        cdef pmf_scoring_t numbers
        cdef pmf_scored_t many
        _set_scoring(&numbers, scoring, self.config.network.n_columns)
        cdef Py_ssize_t n = u.shape[0], p = numbers.parameters, width = p + 2 * p * p
        _check_blocks(&numbers, progress, (counts.shape[0], theta.shape[0], sums.shape[0], progress.shape[0]), (n, p, width, 2))
        cdef Py_ssize_t kept = (progress[0] + n) // numbers.size
        cdef cnp.ndarray[double, ndim=2, mode="c"] blocks = np.empty((kept, width))
        cdef cnp.ndarray[unsigned char, mode="c"] lost = np.empty(kept, np.uint8)
        many.input, many.counts, many.theta = <double *> _numbers(u), <int64_t *> _numbers(counts), <double *> _numbers(theta)
        many.sums, many.progress, many.samples = <double *> _numbers(sums), <uint32_t *> _numbers(progress), n
        many.kept, many.blocks, many.lost = kept, <double *> _numbers(blocks), <unsigned char *> _numbers(lost)
        with nogil:
            pmf_score_axis(&self.config, &numbers, &many, 0, &self.state)
        return blocks, lost

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
    """Raise ValueError unless the tables are (axes, n) and the results have exactly one place for each kept estimate.
    """
    if u.ndim != 2 or u.shape != counts.shape or u.shape[0] != axes:
        raise ValueError(f"u and counts must be ({axes}, n), got {u.shape} and {counts.shape}")
    if u.dtype not in (np.float32, np.float64) or counts.dtype not in (np.int32, np.int64):
        raise ValueError(f"u must be float32 or float64 and counts int32 or int64, got {u.dtype} and {counts.dtype}")
    samples = u.shape[1]
    kept = -(-samples // every) if every else min(samples, 1)
    shapes = [(axes, kept, parameters)] * 3 + [(axes, kept)] * 3
    if [np.shape(result) for result in results] != shapes:
        raise ValueError(f"the results must have shapes {shapes}, got {[np.shape(result) for result in results]}")
    for result, kind in zip(results, (np.float64,) * 5 + (np.uint32,), strict=True):
        if type(result) is not np.ndarray or result.dtype != kind or not result.flags.carray:
            raise ValueError(f"the results must be arrays of float64, the last of uint32, without gaps; got {result!r}")


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
        cdef cnp.ndarray[unsigned char, ndim=2, mode="c"] taken = np.array(states, np.uint8, order="C", ndmin=2)
        cdef Py_ssize_t axis
        cdef pmf_state_t state
        if np.shape(states) != self.states.shape:
            raise ValueError(f"the states have the shape {self.states.shape}, got {np.shape(states)}")
        pmf_clear(&state, sizeof(state))
        for axis in range(taken.shape[0]):
            pmf_unpack(&self.layout, &taken[axis, 0], &state)
            if pmf_plausible(&self.config, &state) == 0:
                raise ValueError(IMPLAUSIBLE)
        self.states[:] = taken

    def hold(self, cnp.ndarray[unsigned char, ndim=2, mode="c"] states not None):
        """Replace the states by an array (axes, bytes) of the same configuration with any number of axes. Later calls
        change this array. Raises ValueError for a wrong shape."""
        if states.shape[1] != self.layout.packed_size or not states.flags.aligned:
            raise ValueError(f"a state has {self.layout.packed_size} bytes, got {states.shape[1]}")
        self.states = states

    def plausible(self):
        """Return whether samples could have made all states. The call releases the interpreter."""
        cdef cnp.ndarray[unsigned char, ndim=2, mode="c"] states = self.states
        cdef Py_ssize_t axis
        cdef pmf_state_t state
        cdef uint32_t fine = 1
        cdef Py_ssize_t axes = states.shape[0], size = self.layout.packed_size
        cdef const unsigned char *first = <const unsigned char *> cnp.PyArray_DATA(states)
        with nogil:
            pmf_clear(&state, sizeof(state))
            for axis in range(axes):
                pmf_unpack(&self.layout, first + axis * size, &state)
                fine &= pmf_plausible(&self.config, &state)
        return fine != 0

    def store(self, Kernel kernel, Py_ssize_t axis):
        """Copy the state of a kernel of the same configuration to an axis."""
        cdef cnp.ndarray[unsigned char, ndim=2, mode="c"] states = self.states
        pmf_pack(&self.layout, &kernel.state, &states[axis, 0])

    def gap(self, Py_ssize_t axis, counts):
        """Report lost samples of an axis before a sample that reads `counts`."""
        cdef uint64_t count = PyLong_AsUnsignedLongLongMask(PyNumber_Index(counts))
        cdef cnp.ndarray[unsigned char, ndim=2, mode="c"] states = self.states
        cdef pmf_state_t state
        pmf_clear(&state, sizeof(state))
        pmf_unpack(&self.layout, &states[axis, 0], &state)
        pmf_gap(&self.config, &state, <uint32_t> count)
        pmf_pack(&self.layout, &state, &states[axis, 0])

    def score(self, cnp.ndarray[double, ndim=2, mode="c"] u not None, cnp.ndarray[int64_t, ndim=2, mode="c"] counts not None,
              scoring, cnp.ndarray[double, ndim=2, mode="c"] theta not None,
              cnp.ndarray[double, ndim=2, mode="c"] sums not None,
              cnp.ndarray[uint32_t, ndim=2, mode="c"] progress not None):
        """Run encoder and filters on u, counts (axes, n), and sum scores in blocks.

        `scoring` holds the first column, the number p of parameters, the samples of a block, the status of samples to
        leave out, and the status of disturbed samples. `theta` is (axes, p). `sums` (axes, p + 2 p^2) and `progress`
        (axes, 2) hold each unfinished block and are updated. Returns the complete blocks (axes, most, p + 2 p^2), and
        whether all samples of a block were disturbed (axes, most). The call releases the interpreter. Raises ValueError
        for arrays of other shapes.
        """
        cdef pmf_scoring_t numbers
        cdef pmf_scored_t many
        cdef cnp.ndarray[unsigned char, ndim=2, mode="c"] states = self.states
        _set_scoring(&numbers, scoring, self.config.network.n_columns)
        cdef Py_ssize_t axes = states.shape[0], n = u.shape[1], p = numbers.parameters, width = p + 2 * p * p
        shapes = [np.shape(table) for table in (u, counts, theta, sums, progress)]
        _check_blocks(&numbers, progress, shapes, [(axes, n), (axes, n), (axes, p), (axes, width), (axes, 2)])
        cdef Py_ssize_t kept = (int(progress[:, 0].max()) + n) // numbers.size if axes else 0
        cdef cnp.ndarray[double, ndim=3, mode="c"] blocks = np.zeros((axes, kept, width))
        cdef cnp.ndarray[unsigned char, ndim=2, mode="c"] lost = np.zeros((axes, kept), np.uint8)
        many.input, many.counts, many.theta = <double *> _numbers(u), <int64_t *> _numbers(counts), <double *> _numbers(theta)
        many.sums, many.progress, many.samples = <double *> _numbers(sums), <uint32_t *> _numbers(progress), n
        many.kept, many.blocks, many.lost = kept, <double *> _numbers(blocks), <unsigned char *> _numbers(lost)
        with nogil:
            pmf_many_scores(&self.config, &self.layout, &numbers, &many, axes, <unsigned char *> cnp.PyArray_DATA(states))
        return blocks, lost

    @property
    def side_by_side(self):
        """Whether vectors can compute this configuration."""
        return self.layout.lane_words > 0

    def load(self, Kernel kernel, Py_ssize_t axis):
        """Copy the state of an axis to a kernel of the same configuration."""
        cdef cnp.ndarray[unsigned char, ndim=2, mode="c"] states = self.states
        pmf_clear(&kernel.state, sizeof(pmf_state_t))
        pmf_unpack(&self.layout, &states[axis, 0], &kernel.state)

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


def simulate(parameters, double input_gain, double dt, cnp.ndarray[double, mode="c"] u not None, double velocity=0.0):
    """Simulate the body of the on-line model under a held input u (n,), from position 0.

    `parameters` (k,) are mass, viscous friction forward and backward, Coulomb friction forward and backward, offset and
    stiffness. Missing parameters are 0. `velocity` is that of the start. A spring is slack at the start.

    Returns the mean velocity, the signed moving fraction and the moving fraction (n,). Raises ValueError for too many
    parameters.
    """
    cdef pmf_auxiliary_config_t config
    cdef pmf_auxiliary_state_t state
    cdef real_t signal[PMF_SIGNALS + PMF_MAX_SHAPES]
    cdef Py_ssize_t k
    if len(parameters) > PMF_BODY_ROLES:
        raise ValueError(f"the model takes {PMF_BODY_ROLES} parameters, got {len(parameters)}")
    pmf_clear(&config, sizeof(config))
    pmf_clear(&state, sizeof(state))
    pmf_clear(signal, sizeof(signal))
    config.dt, config.input_gain, state.velocity = dt, input_gain, velocity
    for k, parameter in enumerate(parameters):
        state.parameter[k] = parameter
    cdef cnp.ndarray[double, ndim=2, mode="c"] means = np.empty((3, u.shape[0]))
    for k in range(u.shape[0]):
        signal[PMF_LATE_INPUT] = <real_t> u[k]
        pmf_auxiliary_step(&config, &state, signal)
        means[0, k] = signal[PMF_AUXILIARY + PMF_VELOCITY]
        means[1, k] = signal[PMF_AUXILIARY + PMF_DIRECTION]
        means[2, k] = signal[PMF_AUXILIARY + PMF_MOVING]
    return means[0], means[1], means[2]
