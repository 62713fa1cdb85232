"""Tables of blocks that came one behind the other, and whose blocks they are."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pmfid.stream.delivery import Delivery, Table
from pmfid.stream.groups import Group, Seat

__all__ = ["Seating", "Seatings", "Tables"]

#: Names in tables of which it is remembered whose they are.
MOST_NAMES = 2**17

#: The groups that blocks of a table are of, and the numbers (k,) of their axes there, -1 for those of others.
Seating = list[tuple[Group, NDArray[np.int64]]]


@dataclass
class Tables:
    """Tables of blocks of the same length that follow one another, and the deliveries that brought them."""

    tables: list[Table] = field(default_factory=list)
    deliveries: list[Delivery] = field(default_factory=list)

    def may_put(self, table: Table) -> bool:
        """Whether it has the same form."""
        return not self.tables or self.tables[0].counts.shape[1] == table.counts.shape[1]

    def put(self, table: Table, delivery: Delivery) -> None:
        """One more."""
        self.tables.append(table)
        self.deliveries.append(delivery)

    @property
    def size(self) -> int:
        """Blocks in them."""
        return sum(len(table.axes) for table in self.tables)

    def list_block_deliveries(self) -> list[Delivery]:
        """The delivery of each block."""
        pairs = zip(self.tables, self.deliveries, strict=True)
        return [delivery for table, delivery in pairs for _ in table.axes]

    def split(self) -> Iterator[Tables]:
        """Each by itself."""
        for table, delivery in zip(self.tables, self.deliveries, strict=True):
            yield Tables([table], [delivery])


@dataclass
class Seatings:
    """seats: all axes, by name."""

    seats: Mapping[str, Seat]
    _known: dict[tuple[str, ...], Seating | None] = field(default_factory=dict, init=False)
    _names: int = field(default=0, init=False)

    def seat_tables(self, tables: Sequence[tuple[str, ...]]) -> Seating | None:
        """Of tables of these names, one behind the other; None where an axis comes twice."""
        found = [self._get_seating(names) for names in tables]
        if len(found) == 1:
            return found[0]
        whole = [one for one in found if one is not None]
        return None if len(whole) < len(found) else _join_seatings(whole, [len(names) for names in tables])

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
    """That of tables of such sizes; None where an axis comes twice."""
    found = Seating()
    for group in {id(group): group for part in parts for group, _ in part}.values():
        own = [next((index for one, index in part if one is group), None) for part in parts]
        index = np.concatenate([np.full(n, -1) if at is None else at for at, n in zip(own, sizes, strict=True)])
        known = index[index >= 0]
        if np.unique(known).size < known.size:
            return None
        found.append((group, index))
    return found
