# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False, freethreading_compatible=True
"""The estimate after a sample, in one class for both precisions of the kernel."""

cimport cython
cimport numpy as cnp
from libc.math cimport INFINITY, sqrt

from pmfid.errors import place_of
from pmfid.presentation import Parameters, figure_of, frame_of, plain, remarks_of
from pmfid.status import status_names

cnp.import_array()


cdef inline object _vector(const double *source, Py_ssize_t n):
    cdef cnp.npy_intp shape = n
    cdef object array = cnp.PyArray_SimpleNew(1, &shape, cnp.NPY_DOUBLE)
    cdef double *target = <double *> cnp.PyArray_DATA(<cnp.ndarray> array)
    cdef Py_ssize_t i
    for i in range(n):
        target[i] = source[i]
    return array


cdef _fill(double *target, source):
    for i, value in enumerate(source):
        target[i] = value


ctypedef fused real:
    float
    double


cdef void _form_covariance(real one, double *factor, Py_ssize_t n) noexcept:
    """Compute P = (L D L^T)^-1 in place. The precision is that of `one`, and the operations are those of the kernel."""
    cdef real lower[PMF_MAX_PARAMETERS * PMF_MAX_PARAMETERS]
    cdef real x[PMF_MAX_PARAMETERS]
    cdef Py_ssize_t i, j, k, column
    for i in range(n * n):
        lower[i] = <real> factor[i]
    for column in range(n):
        for i in range(n):
            x[i] = one if i == column else one - one
            for k in range(i):
                x[i] -= lower[i * n + k] * x[k]
        for i in range(n):
            x[i] *= lower[i * n + i]
        for j in range(n - 1, -1, -1):
            for k in range(j + 1, n):
                x[j] -= lower[k * n + j] * x[k]
        for i in range(n):
            factor[i * n + column] = x[i] if i >= column else factor[column * n + i]


@cython.no_gc  # a tuple of names forms no reference cycle
@cython.freelist(8)
cdef class Estimate:
    """The estimate after one sample. Later samples do not change it, and it can be copied and pickled.

    Attributes
    ----------
    names : tuple of str
        Names of the p parameters.
    theta : ndarray (p,)
        Parameters. `estimate["mass"]` returns one of them.
    theta_cov : ndarray (p, p)
        Covariance of the parameters.
    theta_std : ndarray (p,)
        Standard errors of the parameters.
    innovation : float
        Error of the equation before the update [unit of the target].
    innovation_variance : float
        Variance of the innovation.
    status : int
        `Status` bits. `status_names` are their names.

    Examples
    --------
    >>> from pmfid import RLS, Drive, Encoder
    >>> estimate = RLS(Drive(1.0), Encoder(1e-5), 0.001, 50.0).step(0.5, 0)
    >>> estimate.names, estimate.status_names
    (('mass', 'viscous_friction', 'coulomb_friction'), ('starting', 'settling'))
    """

    def __init__(self):
        raise TypeError("an Estimate is what the step of a recursive estimator returns; it is not made by hand")

    @property
    def theta(self):
        return _vector(self._theta, self._n)

    @property
    def theta_cov(self):
        cdef cnp.npy_intp[2] shape = [self._n, self._n]
        cdef object array = cnp.PyArray_SimpleNew(2, shape, cnp.NPY_DOUBLE)
        cdef double *target = <double *> cnp.PyArray_DATA(<cnp.ndarray> array)
        cdef Py_ssize_t n = self._n, i, j
        self._form_factor()
        for i in range(n):
            for j in range(n):
                if self.innovation_variance == 0.0:  # without any innovation, nothing is known
                    target[i * n + j] = INFINITY if i == j else 0.0
                else:
                    target[i * n + j] = self.innovation_variance * self._factor[i * n + j] * \
                        (sqrt(self._scale(i)) * sqrt(self._scale(j)))
        return array

    cdef void _form_factor(self) noexcept:
        if self._form == OF_DOUBLE:
            _form_covariance(<double> 1.0, self._factor, self._n)
        elif self._form == OF_SINGLE:
            _form_covariance(<float> 1.0, self._factor, self._n)
        self._form = FORMED

    cdef inline double _scale(self, Py_ssize_t i) noexcept:
        return self._inflation[i] if self._inflation[i] > 0.0 else 1.0

    @property
    def theta_std(self):
        cdef double std[PMF_MAX_PARAMETERS]
        cdef Py_ssize_t i
        for i in range(self._n):
            std[i] = sqrt(self._diagonal[i] * self.innovation_variance * self._scale(i))
            if self.innovation_variance == 0.0:
                std[i] = INFINITY
        return _vector(std, self._n)

    def __getitem__(self, name):
        """Return one parameter. Raises UnknownParameterError, a KeyError that lists the names."""
        return float(self._theta[place_of(name, self._names)])

    @property
    def names(self):
        return self._names

    @property
    def units(self):
        """Empty units. The estimator, not a sample, has the units of the parameters."""
        return ("",) * self._n

    @property
    def status_names(self):
        return tuple(status_names(self.status))

    def _parameters(self):
        names = self._names or tuple(f"parameter {i + 1}" for i in range(self._n))  # a bare kernel has no names
        return Parameters(names, self.units, self.theta, self.theta_std)

    # A cdef class cannot derive from `Presentable`, so that these methods repeat the interface of other results.
    def summary(self):
        """Return the summary for a reader."""
        return self._parameters().summary("the estimate of a sample", remarks_of(self.status_names))

    def __repr__(self):
        return self.summary().text

    def _repr_html_(self):
        return self.summary().html

    def to_dict(self):
        """Return the estimate as nested dicts of text and numbers for JSON. Infinite numbers and NaN become None."""
        return {"parameters": self._parameters().content, "innovation": plain(self.innovation),
                "status": list(self.status_names)}

    def to_frame(self):
        """Return a polars DataFrame with a row for each parameter."""
        return frame_of(self._parameters().columns)

    def plot(self, **options):
        """Return a matplotlib Figure of the parameters with their standard errors."""
        return figure_of(self, **options)

    def __reduce__(self):
        self._form_factor()
        vectors = self.theta, _vector(self._factor, self._n * self._n), _vector(self._diagonal, self._n)
        return _restored, (self._names, *vectors, _vector(self._inflation, self._n), self.innovation,
                           self.innovation_variance, self.status)


def _restored(names, theta, factor, diagonal, inflation, innovation, innovation_variance, status):
    """Return an estimate from its parts, for pickle and copy."""
    cdef Estimate estimate = Estimate.__new__(Estimate)
    if len(theta) > PMF_MAX_PARAMETERS or not len(theta) == len(diagonal) == len(inflation) or \
            len(factor) != len(theta) ** 2:
        raise ValueError("these are not the parts of an estimate")
    estimate._names, estimate._n = names, len(theta)
    _fill(estimate._theta, theta)
    _fill(estimate._factor, factor)
    _fill(estimate._diagonal, diagonal)
    _fill(estimate._inflation, inflation)
    estimate.innovation, estimate.innovation_variance, estimate.status = innovation, innovation_variance, status
    return estimate
