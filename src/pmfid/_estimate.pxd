"""The estimate after a sample. Kernels of both precisions store doubles in an estimate."""

cdef extern from "pmf_sizes.h":
    enum:
        PMF_MAX_PARAMETERS

# Content of `_factor`: P, or the factor L of the inverse of P, with 1 / D on its diagonal, in double or single
# precision.
cdef enum Form:
    FORMED = 0
    OF_DOUBLE
    OF_SINGLE

cdef class Estimate:
    cdef double _theta[PMF_MAX_PARAMETERS]
    cdef double _factor[PMF_MAX_PARAMETERS * PMF_MAX_PARAMETERS] # P, or L and 1 / D until P is read
    cdef Form _form
    cdef double _diagonal[PMF_MAX_PARAMETERS]
    cdef double _inflation[PMF_MAX_PARAMETERS]
    cdef Py_ssize_t _n
    cdef tuple _names
    cdef readonly double innovation
    cdef readonly double innovation_variance
    cdef readonly unsigned int status
    cdef void _form_factor(self) noexcept
    cdef double _scale(self, Py_ssize_t i) noexcept
