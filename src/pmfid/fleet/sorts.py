"""Does one type hold several sorts of machines? Spread over all of them would hide whoever differs from his own."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmfid.fleet.series import MEDIAN
from pmfid.types import Floats

#: Distance between the middles of two sorts, and width of the empty gap between them, in their own spreads.
APART, GAP = 5.0, 1.0
#: Part of the axes that is a sort, at least: fewer are odd ones.
PART = 0.1


def sorts_of(place: Floats, least: int, tolerance: float) -> list[NDArray[np.intp]]:
    """Members of each sort of axes at places (m, p), logarithms of their parameters over the median of the type.

    least: axes of a sort; tolerance: spread below which there is none. One sort, all, where no gap parts them."""
    found = [np.arange(len(place))]
    for column in place.T:
        found = [part for members in found for part in _split_sort(members, column, least, tolerance)]
    return found


def _split_sort(members: NDArray[np.intp], column: Floats, least: int, tolerance: float) -> list[NDArray[np.intp]]:
    """Splits the members by one parameter, repeatedly."""
    ordered = members[np.argsort(column[members], kind="stable")]
    values = column[ordered]
    least = max(least, int(np.ceil(PART * values.size)))
    places = np.arange(least, values.size - least + 1)
    if not places.size:
        return [members]
    k = int(places[np.argmax(values[places] - values[places - 1])])
    low, high = values[:k], values[k:]
    spread = max(tolerance, _spread(low), _spread(high))
    if high[0] - low[-1] < GAP * spread or np.median(high) - np.median(low) < APART * spread:
        return [members]
    parts = (np.sort(ordered[:k]), np.sort(ordered[k:]))
    return [part for one in parts for part in _split_sort(one, column, least, tolerance)]


def _spread(values: Floats) -> float:
    return float(np.median(np.abs(values - np.median(values))) / MEDIAN)
