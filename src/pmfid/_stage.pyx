# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False, freethreading_compatible=True
"""A first-order stage over a whole signal: what a network has, off-line."""

import numpy as np


def first_order(signal, double a, double b0, double b1=0.0, double memory=0.0):
    """Answer (n,) of (b0 + b1 z^-1) / (1 - a z^-1) to a signal (n,), and its memory behind the last sample.

    memory: what b1 and a have left of the samples before, 0 from rest. The bits are those of `scipy.signal.lfilter`,
    which takes longer to import than most signals to filter.
    """
    cdef const double[::1] x = np.ascontiguousarray(signal, dtype=np.float64)
    found = np.empty(x.shape[0])
    cdef double[::1] y = found
    cdef Py_ssize_t k
    for k in range(x.shape[0]):
        y[k] = memory + b0 * x[k]
        memory = b1 * x[k] + a * y[k]
    return found, memory
