"""Consecutive tables of blocks, and the axes of these blocks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pmfid.stream.delivery import Delivery, Table
from pmfid.stream.groups import Group, Seat

__all__ = ["Seating", "Seatings", "Tables"]

#: Most names of tables whose seating is cached.
MOST_NAMES = 2**17

#: The groups of the blocks of a table, and the numbers (k,) of their axes in the group, -1 for axes of other groups.
Seating = list[tuple[Group, NDArray[np.int64]]]


@dataclass
class Tables:
    """Tables of blocks of the same length that follow one another, and the deliveries that brought them."""

    tables: list[Table] = field(default_factory=list)
    deliveries: list[Delivery] = field(default_factory=list)

    def may_put(self, table: Table) -> bool:
        """Whether the blocks of the table have the same length."""
        return not self.tables or self.tables[0].counts.shape[1] == table.counts.shape[1]

    def put(self, table: Table, delivery: Delivery) -> None:
        """Appends a table."""
        self.tables.append(table)
        self.deliveries.append(delivery)

    @property
    def size(self) -> int:
        """Number of blocks."""
        return sum(len(table.axes) for table in self.tables)

    def list_block_deliveries(self) -> list[Delivery]:
        """The delivery of each block."""
        pairs = zip(self.tables, self.deliveries, strict=True)
        return [delivery for table, delivery in pairs for _ in table.axes]

    def split(self) -> Iterator[Tables]:
        """Each table by itself."""
        for table, delivery in zip(self.tables, self.deliveries, strict=True):
            yield Tables([table], [delivery])


@dataclass
class Seatings:
    """seats: all axes, by name."""

    seats: Mapping[str, Seat]
    _known: dict[tuple[str, ...], Seating | None] = field(default_factory=dict, init=False)
    _names: int = field(default=0, init=False)

    def seat_tables(self, tables: Sequence[tuple[str, ...]]) -> Seating | None:
        """The seating of consecutive tables with these names; None if an axis occurs twice."""
        seatings = [self._get_seating(names) for names in tables]
        if len(seatings) == 1:
            return seatings[0]
        whole = [one for one in seatings if one is not None]
        return None if len(whole) < len(seatings) else _join_seatings(whole, [len(names) for names in tables])

    def _get_seating(self, names: tuple[str, ...]) -> Seating | None:
        if names not in self._known:
            if self._names > MOST_NAMES:
                self._known, self._names = {}, 0
            self._known[names] = self._find_seating(names)
            self._names += len(names)
        return self._known[names]

    def _find_seating(self, names: tuple[str, ...]) -> Seating | None:
        if len(set(names)) < len(names):
            return None
        found: dict[int, tuple[Group, NDArray[np.int64]]] = {}
        for row, name in enumerate(names):
            seat = self.seats.get(name)
            if seat is not None:
                place = found.setdefault(id(seat.group), (seat.group, np.full(len(names), -1, np.int64)))
                place[1][row] = seat.index
        return list(found.values())


def _join_seatings(parts: Sequence[Seating], sizes: Sequence[int]) -> Seating | None:
    """One seating of tables of these sizes; None if an axis occurs twice."""
    found = Seating()
    for group in {id(group): group for part in parts for group, _ in part}.values():
        own = [next((index for one, index in part if one is group), None) for part in parts]
        index = np.concatenate([np.full(n, -1) if at is None else at for at, n in zip(own, sizes, strict=True)])
        known = index[index >= 0]
        if np.unique(known).size < known.size:
            return None
        found.append((group, index))
    return found
