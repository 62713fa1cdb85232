"""Arrays with one row for each axis."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import fields
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from pmfid._stage import put_rows
from pmfid.types import Places

#: Largest number of samples and blocks in a state.
MOST = 2**60


def rows_of(*sizes: int | str, kind: type = np.float64, start: float = 0, saved: bool = True) -> dict[str, Any]:
    """Return the metadata of an array with a row of these sizes for each axis, filled with `start`.

    `RowArrays.empty` gets the sizes that are names. An array that is derived from others is not `saved`.
    """
    return {"sizes": sizes, "kind": kind, "start": start, "saved": saved}


class RowArrays:
    """Arrays, or groups of such arrays, with one row for each axis, as the fields of a dataclass."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @classmethod
    def empty(cls, axes: int, **sizes: int) -> Self:
        """Return the rows of axes without any data. All fields have the metadata of `rows_of`."""
        declared = {one.name: one.metadata for one in fields(cls)}
        return cls(
            **{
                name: np.full((axes, *(sizes.get(str(size), size) for size in one["sizes"])), one["start"], one["kind"])
                for name, one in declared.items()
            }
        )

    def _map(self, act: Callable[..., NDArray[Any]], *others: Self) -> Self:
        """Return the results of `act` for each array, with the same arrays of `others` as further arguments."""
        found = {}
        for name, part in vars(self).items():
            more = [getattr(one, name) for one in others]
            found[name] = part._map(act, *more) if isinstance(part, RowArrays) else act(part, *more)
        return type(self)(**found)

    def list_saved(self) -> Iterator[tuple[str, NDArray[np.generic]]]:
        """Yield the arrays that are saved, by name."""
        for one in fields(self):
            part = getattr(self, one.name)
            if isinstance(part, RowArrays):
                yield from part.list_saved()
            elif one.metadata.get("saved", True):
                yield one.name, part

    @property
    def axes(self) -> int:
        """Number of rows."""
        return len(next(self.list_saved())[1])

    @property
    def row_type(self) -> np.dtype[np.void]:
        """Data type of the saved arrays of one axis."""
        return np.dtype(
            [(f"{k} {name}", part.dtype, part.shape[1:]) for k, (name, part) in enumerate(self.list_saved())]
        )

    def take_rows(self, index: Places | slice) -> Self:
        """Return some rows, as copies for an array of numbers and as views for a slice."""
        if isinstance(index, slice):
            return self._map(lambda part: part[index])
        return self._map(lambda part: part.take(index, axis=0))

    def put(self, index: Places | slice, rows: Self) -> None:
        """Overwrite some rows."""
        for name, part in vars(self).items():
            if isinstance(part, RowArrays):
                part.put(index, getattr(rows, name))
            elif isinstance(index, slice):
                part[index] = getattr(rows, name)
            else:
                put_rows(part, index, getattr(rows, name))

    def copy_rows(self) -> Self:
        """Return a copy of all rows."""
        return self._map(np.copy)

    def repeat_rows(self, times: int) -> Self:
        """Return the rows, each repeated `times` times."""
        return self._map(lambda part: np.repeat(part, times, axis=0))

    def join_rows(self, other: Self) -> Self:
        """Return these rows, followed by the rows of `other`."""
        return self._map(lambda *parts: np.concatenate(parts), other)
