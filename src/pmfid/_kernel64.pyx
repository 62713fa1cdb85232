# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False, freethreading_compatible=True
"""The kernel in double precision."""

include "_kernel.pxi"
include "_edges.pxi"
