# The recursion over edges, for the kernels of both precisions.

from libc.math cimport INFINITY, NAN, sqrt

cdef extern from "edges/pmf_redge.h":
    enum:
        PMF_BODY
        PMF_FOLLOWED
    ctypedef struct pmf_redge_config_t:
        real_t dt, resolution, input_gain, tick, memory, finest
        uint32_t lines, sign, parameters
    ctypedef struct pmf_line_t:
        real_t weight
    ctypedef struct pmf_redge_state_t:
        real_t covariance[PMF_FOLLOWED][PMF_FOLLOWED]
        real_t theta[PMF_BODY]
        real_t variance[PMF_BODY]
        real_t innovation
        uint32_t running, status
    void pmf_redge_init(const pmf_redge_config_t *, pmf_redge_state_t *, pmf_line_t *)
    void pmf_redge_expect(const pmf_redge_config_t *, pmf_redge_state_t *, const real_t *)
    uint32_t pmf_redge_plausible(const pmf_redge_config_t *, const pmf_redge_state_t *, const pmf_line_t *)
    uint32_t pmf_redge_step(const pmf_redge_config_t *, pmf_redge_state_t *, pmf_line_t *, real_t, uint32_t, real_t)

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
        cdef Py_ssize_t first = PMF_FOLLOWED - PMF_BODY
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
        cdef Py_ssize_t n = u.shape[0], p = self.config.parameters, k, i
        theta, variance = np.empty((n, p)), np.empty((n, p))
        innovation, known, status = np.empty(n), np.empty(n), np.empty(n, np.uint32)
        cdef double[:, ::1] thetas = theta, variances = variance
        cdef double[::1] innovations = innovation, knowns = known
        cdef uint32_t[::1] bits = status
        for k in range(n):
            bits[k] = pmf_redge_step(&self.config, &self.state, self._lines, <real_t> u[k],
                                     <uint32_t> <uint64_t> counts[k], <real_t> ages[k])
            innovations[k], knowns[k] = self.state.innovation, 1.0 if self.state.running else 0.0
            for i in range(p):
                thetas[k, i], variances[k, i] = self.state.theta[i], self.state.variance[i]
        return theta, variance, innovation, known, status
