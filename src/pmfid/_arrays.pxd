"""The data of NumPy arrays for C, in place of Cython's buffers and views, which take longer to compile than the rest."""

cimport numpy as cnp


cdef inline void *source(cnp.ndarray array, kind, tuple shape) except NULL:
    """Return the data of an array to read. Raises ValueError for another type or shape, and for gaps."""
    if array.dtype != kind or (<object> array).shape != shape or not cnp.PyArray_ISCARRAY_RO(array):
        raise ValueError(f"arrays must have shapes like {shape} of {getattr(kind, '__name__', kind)}, without gaps; got {array.dtype} {(<object> array).shape}")
    return cnp.PyArray_DATA(array)


cdef inline void *target(cnp.ndarray array, kind, tuple shape) except NULL:
    """Return the data of an array to write. Raises ValueError for a fixed array as well."""
    if not cnp.PyArray_ISWRITEABLE(array):
        raise ValueError("this array cannot be changed")
    return source(array, kind, shape)
