"""What one sample left, for the kernels of both precisions: their numbers are doubles here, which holds either."""

cdef extern from "pmf_sizes.h":
    enum:
        PMF_MAX_PARAMETERS

cdef class Estimate:
    cdef double _theta[PMF_MAX_PARAMETERS]
    cdef double _factor[PMF_MAX_PARAMETERS * PMF_MAX_PARAMETERS]
    cdef double _diagonal[PMF_MAX_PARAMETERS]
    cdef double _inflation[PMF_MAX_PARAMETERS]
    cdef Py_ssize_t _n
    cdef tuple _names
    cdef readonly double innovation
    cdef readonly double innovation_variance
    cdef readonly unsigned int status
    cdef double _scale(self, Py_ssize_t i) noexcept
