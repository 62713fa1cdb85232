# The recursion over edges, for the kernels of both precisions.

from libc.math cimport INFINITY, NAN, sqrt

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

cdef class EdgeResults:
    """Results of n samples of k axes: theta and variances (k, n, p), innovations, variances and status bits (k, n)."""

    cdef readonly tuple arrays
    cdef Py_ssize_t samples, parameters
    cdef double[:, :, ::1] theta, variance
    cdef double[:, ::1] innovation, known
    cdef uint32_t[:, ::1] status

    def __init__(self, Py_ssize_t axes, Py_ssize_t samples, Py_ssize_t parameters):
        self.samples, self.parameters = samples, parameters
        shape = axes, samples
        self.arrays = (np.empty((*shape, parameters)), np.empty((*shape, parameters)), np.empty(shape), np.empty(shape),
                       np.empty(shape, np.uint32))
        self.theta, self.variance, self.innovation, self.known, self.status = self.arrays

cdef void _run_edges(const pmf_redge_config_t *config, pmf_redge_state_t *state, pmf_line_t *lines, const double *u,
                     const int64_t *counts, const double *ages, EdgeResults results, Py_ssize_t axis) noexcept nogil:
    """Take the samples of an axis, and write its results."""
    cdef Py_ssize_t k, i
    for k in range(results.samples):
        results.status[axis, k] = pmf_redge_step(config, state, lines, <real_t> u[k], <uint32_t> <uint64_t> counts[k],
                                                 <real_t> ages[k])
        results.innovation[axis, k] = state.innovation
        results.known[axis, k] = 1.0 if state.running else 0.0
        for i in range(results.parameters):
            results.theta[axis, k, i], results.variance[axis, k, i] = state.theta[i], state.variance[i]

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

    def expect(self, const double[::1] theta not None):
        """Begin again at the next edges, from given parameters (p,)."""
        cdef real_t[PMF_BODY] given
        cdef Py_ssize_t i
        for i in range(self.config.parameters):
            given[i] = theta[i]
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

    def run(self, const double[::1] u, const int64_t[::1] counts, const double[::1] ages):
        """Take n samples; return theta and variances (n, p), innovations, their variances and status bits (n,)."""
        cdef EdgeResults results = EdgeResults(1, u.shape[0], self.config.parameters)
        if u.shape[0]:
            _run_edges(&self.config, &self.state, self._lines, &u[0], &counts[0], &ages[0], results, 0)
        return tuple(array[0] for array in results.arrays)

    def run_many(self, unsigned char[:, ::1] states not None, const double[:, ::1] u, const int64_t[:, ::1] counts,
                 const double[:, ::1] ages):
        """Take n samples of k axes with this configuration, one axis after the other, without the interpreter lock.

        states (k, bytes) are those of `raw_state`, and change in place. Return the arrays of `run` with k rows. Raises
        ValueError for states of another size.
        """
        cdef Py_ssize_t axis, size = sizeof(pmf_redge_state_t) + self.lines.size
        cdef EdgeResults results = EdgeResults(u.shape[0], u.shape[1], self.config.parameters)
        if states.shape[1] != size:
            raise ValueError(f"a state has {size} bytes, got {states.shape[1]}")
        if not u.shape[1]:
            return results.arrays
        with nogil:
            for axis in range(u.shape[0]):
                _run_edges(&self.config, <pmf_redge_state_t *> &states[axis, 0],
                           <pmf_line_t *> (&states[axis, 0] + sizeof(pmf_redge_state_t)), &u[axis, 0], &counts[axis, 0],
                           &ages[axis, 0], results, axis)
        return results.arrays
