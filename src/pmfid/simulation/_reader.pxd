"""An incremental encoder, read once per sample, with displaced lines, jittering edges and missed edges."""

from libc.float cimport DBL_MAX
from libc.math cimport fabs, floor, log, log1p
from libc.stdint cimport int64_t, uint64_t

# Neighbouring integers beyond 2**53 are not separate doubles, so that a count would be arbitrary.
cdef enum: COUNT_BITS = 53


cdef struct Reader:
    double resolution, phase     # m per count, m
    const double *lines          # line k of a turn is at k + lines[k] counts
    int64_t line_count
    const double *shift          # shift of the scale in each sample [counts], or NULL
    double log_seen              # log(1 - probability of a missed edge)
    uint64_t random              # state of SplitMix64
    double until_missed          # number of edges up to the next missed edge
    int64_t level, lost
    bint started


cdef inline double uniform(Reader *reader) noexcept nogil:
    """Return a random number in (0, 1), the upper 53 bits of SplitMix64 (Steele, Lea and Flood 2014)."""
    cdef uint64_t z
    reader.random += <uint64_t>0x9E3779B97F4A7C15
    z = reader.random
    z = (z ^ (z >> 30)) * <uint64_t>0xBF58476D1CE4E5B9
    z = (z ^ (z >> 27)) * <uint64_t>0x94D049BB133111EB
    return ((z ^ (z >> 31)) >> 11) * (1.0 / 9007199254740992.0) + 5e-17


cdef inline double next_missed(Reader *reader) noexcept nogil:
    """Return the number of edges up to and including the next missed one, geometric by inversion."""
    return DBL_MAX if reader.log_seen == 0.0 else 1.0 + floor(log(uniform(reader)) / reader.log_seen)


cdef inline Reader make_reader(double resolution, double phase, const double *lines, int64_t line_count,
                               const double *shift, double missed, uint64_t seed) noexcept nogil:
    cdef Reader reader
    reader.resolution, reader.phase = resolution, phase
    reader.lines, reader.line_count, reader.shift = lines, line_count, shift
    reader.log_seen = log1p(-missed)
    reader.random = seed
    reader.level = reader.lost = 0
    reader.started = False
    reader.until_missed = next_missed(&reader)
    return reader


cdef inline bint readable(Reader *reader, double x) noexcept nogil:
    return fabs((x + reader.phase) / reader.resolution) <= <double>(<int64_t>1 << COUNT_BITS)


cdef inline double line_error(Reader *reader, double line) noexcept nogil:
    cdef int64_t k = <int64_t>line % reader.line_count
    return reader.lines[k + reader.line_count if k < 0 else k]


cdef inline int64_t level_of(Reader *reader, double x, Py_ssize_t sample) noexcept nogil:
    """Return the number of the last line below x."""
    cdef double place = (x + reader.phase) / reader.resolution, level
    if reader.shift != NULL:
        place += reader.shift[sample]
    level = floor(place)
    if place < level + line_error(reader, level):
        level -= 1.0
    elif place >= level + 1.0 + line_error(reader, level + 1.0):
        level += 1.0
    return <int64_t>level


cdef inline int64_t read(Reader *reader, double x, Py_ssize_t sample) noexcept nogil:
    """Return the count at x. Some edges since the last sample are missed."""
    cdef int64_t level = level_of(reader, x, sample), side
    cdef double edges
    if not reader.started:
        reader.level, reader.started = level, True
    side = 1 if level > reader.level else -1
    edges = fabs(<double>(level - reader.level))
    while reader.until_missed <= edges:
        edges -= reader.until_missed
        reader.lost += side
        reader.until_missed = next_missed(reader)
    reader.until_missed -= edges
    reader.level = level
    return level - reader.lost
