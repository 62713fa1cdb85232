"""Numbers by which axes are called. A place is used again after a removal, a number never: the number holds how many
axes the place has had before."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.errors import UsageError

__all__ = ["LAST", "Handles"]

#: Axes that a place has had before its last one; after the last one the place stays empty, for its number would recur.
LAST = 2**31 - 1
_BITS, _PLACE = 32, 2**32 - 1


class Handles:
    """The places of all axes. before: (places,) axes that each has had before; taken: (places,) whether it has one."""

    def __init__(self, places: int = 0) -> None:
        self.before = np.zeros(places, np.uint32)
        self.taken = np.zeros(places, np.bool_)

    def grow(self, places: int) -> None:
        """Adds places."""
        self.before = np.concatenate([self.before, np.zeros(places, np.uint32)])
        self.taken = np.concatenate([self.taken, np.zeros(places, np.bool_)])

    def take(self, places: NDArray[np.int64]) -> NDArray[np.int64]:
        """Gives free places to axes; their handles."""
        self.taken[places] = True
        return self.make_handles(places)

    def make_handles(self, places: NDArray[np.int64]) -> NDArray[np.int64]:
        """Handles of the axes that have these places."""
        return (self.before[places].astype(np.int64) << _BITS) | places

    def release(self, places: NDArray[np.int64]) -> None:
        """The axes of these places are gone: their handles are refused from now on."""
        self.taken[places] = False
        self.before[places] += 1

    def free(self, first: int, end: int) -> NDArray[np.int64]:
        """Places in a range that an axis may have."""
        own = slice(first, end)
        return first + np.flatnonzero(~self.taken[own] & (self.before[own] <= LAST))

    def places(self, handles: ArrayLike) -> NDArray[np.int64]:
        """(k,) places of axes. Raises UsageError for what is no handle, for an axis that is gone or never was, and for
        one that comes twice."""
        numbers = np.asarray(handles)
        if numbers.ndim != 1 or (numbers.size and numbers.dtype.kind not in "iu"):
            raise UsageError(
                f"handles must be those that `add` gave, (k,) integers; got {numbers.dtype} {numbers.shape}"
            )
        numbers = numbers.astype(np.int64)
        places = numbers & _PLACE
        known = (numbers >= 0) & (places < self.taken.size)
        known[known] = self.make_handles(places[known]) == numbers[known]
        known[known] = self.taken[places[known]]
        if not known.all():
            self._refuse(int(numbers[np.argmin(known)]))
        seen = np.zeros(self.taken.size, np.bool_)
        seen[places] = True
        if np.count_nonzero(seen) < places.size:
            raise UsageError("an axis comes twice in handles: its samples follow one another, in two calls")
        return places

    def _refuse(self, handle: int) -> None:
        place, before = handle & _PLACE, handle >> _BITS
        if handle >= 0 and place < self.taken.size and before < self.before[place]:
            raise UsageError(f"axis {handle} was removed; `handles()` has those that are there")
        raise UsageError(f"there is no axis {handle}; `handles()` has those that are there")
