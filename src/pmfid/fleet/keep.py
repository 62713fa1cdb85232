"""What a call makes, or finds made by an earlier one: each under the name of what it came from."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from pmfid.errors import UsageError
from pmfid.fleet.store import Store
from pmfid.fleet.survey import RowProblem

if TYPE_CHECKING:
    import polars as pl


class TableWithProblems(Protocol):
    """A table and its problems."""

    @property
    def rows(self) -> pl.DataFrame:
        """The table."""
        ...

    @property
    def problems(self) -> tuple[RowProblem, ...]:
        """What could not be used."""
        ...


@dataclass(frozen=True)
class Kept:
    """A table, here or on the disk, and its problems."""

    here: pl.DataFrame | None
    path: Path | None
    problems: tuple[RowProblem, ...]

    def rows(self) -> pl.DataFrame:
        """The table. Raises UsageError where it has gone from the disk since."""
        import polars as pl

        if self.here is not None:
            return self.here
        if self.path is None or not self.path.exists():
            raise UsageError("what was estimated is gone from the folder; run it again")
        return pl.read_parquet(self.path, hive_partitioning=False)


class Keep:
    """The folder of a history, or none; keys: all that were asked for; reused: how many were there."""

    def __init__(self, store: Store | None) -> None:
        self._store = store
        self.keys: list[str] = []
        self.reused = 0

    @property
    def lasting(self) -> bool:
        """Whether another call will find it."""
        return self._store is not None

    def fetch(
        self, keys: Sequence[str], make: Callable[[Sequence[int]], Iterator[TableWithProblems]], *, here: bool = False
    ) -> Iterator[Kept]:
        """The table of each key, in their order. make: called once with the indices of the missing keys, yields their
        tables in order, which are stored one by one. here: in memory, too. Raises UsageError if the disk is full."""
        self.keys += keys
        there = [self._there(key, here) for key in keys]
        made = make([k for k, one in enumerate(there) if one is None])
        for key, one in zip(keys, there, strict=True):
            yield self._put(key, next(made), here) if one is None else one

    def _there(self, key: str, here: bool) -> Kept | None:
        found = None if self._store is None else self._store.get(key)
        if self._store is None or found is None:
            return None
        self.reused += 1
        return Kept(found.rows if here else None, self._store.path(key), found.problems)

    def _put(self, key: str, found: TableWithProblems, here: bool) -> Kept:
        if self._store is None:
            return Kept(found.rows, None, found.problems)
        self._store.put(key, found.rows, found.problems)
        return Kept(found.rows if here else None, self._store.path(key), found.problems)
