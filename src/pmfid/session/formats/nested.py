"""Values inside values: structures, fields and rows by a dotted path."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

#: Structures deeper than this hold no columns.
DEEPEST = 16


def flatten_fields(arrays: Mapping[str, NDArray[np.generic]]) -> dict[str, object]:
    """Arrays by name; the fields of structured arrays by "name.field", at any depth."""
    return {path: found for name, array in arrays.items() for path, found in _fields(name, array, DEEPEST)}


def _fields(path: str, array: NDArray[np.generic], depth: int) -> Iterator[tuple[str, NDArray[np.generic]]]:
    if array.dtype.names is None or depth == 0:
        yield path, array
        return
    for name in array.dtype.names:
        field: NDArray[np.generic] = array[name]  # type: ignore[call-overload]
        if field.dtype == object and field.size == 1 and isinstance(field.item(), np.ndarray):
            field = field.item()  # of a MATLAB structure, each field is an array of its own
        yield from _fields(f"{path}.{name}".lstrip("."), field, depth - 1)
