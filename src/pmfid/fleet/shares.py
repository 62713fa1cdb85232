"""Which samples make a segment: of long rests the ends alone, and few moves more than once.

An axis at rest is in equilibrium: a shorter rest is a motion that it might have made as well, and a longer one says no
more. So rests take no place in a segment, and a few moves from rest to rest may follow themselves, until the method's
model has settled; the standard errors count such moves once.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmfid.types import Counts, Flags, Floats

#: Quarters of a whole segment. What is left at the end of a piece is one if it has two; all of a piece, if it has one.
WHOLE, REST, LEAST = 4, 2, 1
#: Settling times of the filters from which on a rest is shortened, to two of them.
LONG = 4
#: Settling times that few moves take with the ends of the rests on both sides, at least: the filters see of a
#: shorter motion how it begins and ends alone, and repeated it has the same error again.
BETWEEN = 3


@dataclass(frozen=True)
class Share:
    """places: (n,) numbers of the samples of a segment; size: samples that they are repeated to, n or more."""

    places: NDArray[np.intp]
    size: int

    @property
    def repeats(self) -> float:
        """How often each sample is gone through."""
        return self.size / self.places.size

    def input(self, u: Floats) -> Floats:
        """(size,) of the record's (samples,)."""
        own = u[self.places]
        return own if own.size == self.size else np.resize(own, self.size)

    def counts(self, counts: Counts) -> Counts:
        """The same; a repetition begins where the one before ended."""
        own = counts[self.places]
        if own.size == self.size:
            return own
        again = np.arange(self.size) // own.size
        return np.asarray(np.resize(own, self.size) + again * (own[-1] - own[0]))


def shares_of(counts: Counts, settled: int, quarter: int, span: int) -> Iterator[Share]:
    """Of a part (n,) without a gap. settled: samples in which the filters settle; quarter: of a whole segment; span:
    samples that moves of one segment are apart, at most."""
    edges = np.r_[0, np.flatnonzero(np.diff(counts)) + 1, counts.size]
    long = np.flatnonzero(np.diff(edges) > LONG * settled)
    kept = np.ones(counts.size, bool)
    for k in long:
        kept[edges[k] + settled : edges[k + 1] - settled] = False
    middles = (edges[long] + edges[long + 1]) // 2
    for low, high in _groups(np.r_[0, middles, counts.size], kept, WHOLE * quarter, span):
        inside = np.flatnonzero(kept[low:high]) + low
        yield from _share_samples(inside, counts, low, high, settled, quarter)


def _groups(cuts: NDArray[np.intp], kept: Flags, enough: int, span: int) -> Iterator[tuple[int, int]]:
    """Between cuts (m,): as many as make a segment, or fit the span."""
    known = np.r_[0, np.cumsum(kept)]
    first = 0
    for k in range(1, cuts.size):
        last = k == cuts.size - 1
        full = known[cuts[k]] - known[cuts[first]] >= enough
        if last or full or cuts[k + 1] - cuts[first] > span:
            yield int(cuts[first]), int(cuts[k])
            first = k


def _share_samples(
    inside: NDArray[np.intp], counts: Counts, low: int, high: int, settled: int, quarter: int
) -> Iterator[Share]:
    """The segments of a group, low to high; inside: its samples with information."""
    whole = WHOLE * quarter
    rests = all(np.ptp(counts[part]) == 0 for part in (inside[:settled], inside[-settled:]))
    if inside.size >= whole or not rests:
        own = inside if inside.size >= quarter else np.arange(low, high)
        yield from (Share(own[part], part.stop - part.start) for part in _cut(own.size, quarter))
    elif np.ptp(counts[inside]) > 0 and inside.size >= BETWEEN * settled:
        yield Share(inside, whole)
    elif high - low >= quarter:
        yield Share(np.arange(low, low + quarter), quarter)


def _cut(samples: int, quarter: int) -> list[slice]:
    """Whole segments, and what is left; a whole number of quarters each, so that many have the same length."""
    size = WHOLE * quarter
    found = [slice(start, start + size) for start in range(0, samples - size + 1, size)]
    start = len(found) * size
    rest = (samples - start) // quarter
    return [*found, slice(start, start + rest * quarter)] if rest >= (REST if found else LEAST) else found
