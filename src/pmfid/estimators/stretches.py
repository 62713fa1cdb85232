"""Stretches of records: between gaps, and those with the most motion."""

from __future__ import annotations

import numpy as np

from pmfid.types import Counts, Floats


def liveliest(position: Counts | Floats, most: int) -> slice:
    """Return the `most` consecutive samples with the most motion, or all samples of a shorter record.

    `position` (n,) is the position at the samples in any unit.
    """
    if position.size <= most:
        return slice(0, position.size)
    travelled = np.r_[0, np.cumsum(np.abs(np.diff(position)))]
    start = int(np.argmax(travelled[most - 1 :] - travelled[: position.size - most + 1]))
    return slice(start, start + most)


def parts_of(u: Floats) -> list[slice]:
    """Return the parts of a record between gaps. In a gap, the input (n,) is not a number."""
    edges = np.flatnonzero(np.diff(np.r_[False, np.isfinite(u), False].astype(np.int8)))
    return [slice(first, last) for first, last in edges.reshape(-1, 2).tolist()]


def gaps_in(u: Floats) -> tuple[tuple[int, int], ...]:
    """Return the gaps of a record, each as its first sample and the first sample after it. In a gap, the input (n,)
    is not a number.
    """
    parts = parts_of(u)
    edges = [0, *(edge for part in parts for edge in (part.start, part.stop)), u.size]
    return tuple((a, b) for a, b in zip(edges[0::2], edges[1::2], strict=True) if b > a) if parts else ()
