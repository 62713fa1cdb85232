"""A store of finished work."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path

import polars as pl

from pmfid import __version__
from pmfid.durable import NAME as LOCK
from pmfid.durable import hold
from pmfid.errors import UsageError
from pmfid.fleet.plan import RowProblem, Survey
from pmfid.fleet.rows import ASIDE
from pmfid.fleet.segments import Segments
from pmfid.fleet.source import RESULTS

#: Version of segments and of these files. Every change of either must raise this number.
VERSION = 4


def digest(*parts: object) -> str:
    """Return a name for the result of these inputs."""
    return sha256(json.dumps([VERSION, __version__, *parts], default=str).encode()).hexdigest()[:32]


class Store:
    """A store with a table and its problems for each key.

    Only one call at a time uses `folder`. Raises UsageError if the folder is a file, contains other things, cannot be
    written, or is in use by another call.
    """

    def __init__(self, folder: Path) -> None:
        check_folder(folder)
        self.folder = folder / "work"
        self._lock = hold(self.folder, "the folder of the history", "another call")
        for left in self.folder.glob(f"{ASIDE}*"):  # left by a killed call
            remove(left)

    def close(self) -> None:
        self._lock.close()

    def get(self, key: str) -> Survey | None:
        """Return the value of a key, or None if the store has no value that this version could have written."""
        try:
            problems = json.loads(self._problems_path(key).read_text(encoding="utf-8"))
            return Survey(
                pl.read_parquet(self.path(key), hive_partitioning=False), tuple(RowProblem(**raw) for raw in problems)
            )
        except Exception:  # a missing or damaged value is computed again
            return None

    def put(self, key: str, rows: pl.DataFrame, problems: Sequence[RowProblem]) -> None:
        """Store a table and its problems. Raises UsageError if the disk is full."""
        text = json.dumps([asdict(one) for one in problems])
        whole(self._problems_path(key), lambda path: path.write_text(text, encoding="utf-8"))
        whole(self.path(key), lambda path: rows.write_parquet(path))

    def _problems_path(self, key: str) -> Path:
        return self.folder / f"{key}.json"

    def path(self, key: str) -> Path:
        return self.folder / f"{key}.parquet"

    def keep(self, keys: Iterable[str]) -> None:
        """Remove all other values, which are values of missing parts, values of other configurations, and incomplete
        values.
        """
        kept = set(keys)
        for path in self.folder.iterdir():
            if path.name.partition(".")[0] not in {*kept, LOCK} or path.suffix == ".part":
                remove(path)


def remove(path: Path) -> None:
    """Remove a file or a folder, which may no longer exist."""
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


#: Files that a history writes into its folder.
OWN = RESULTS | {"fleet.html", "fleet.json"}


def check_folder(folder: Path) -> None:
    """Raise UsageError if the folder is a file, contains other things, or cannot be listed."""
    try:
        inside = [path.name for path in folder.iterdir()]
    except FileNotFoundError:
        return
    except NotADirectoryError:
        raise UsageError(f"{folder}: this path, or a part of it, is a file; give a folder for the history") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise UsageError(f"{folder}: {reason}; choose a writable folder") from None
    strangers = sorted(name for name in inside if name not in OWN)
    if strangers and "work" not in inside:
        raise UsageError(f"{folder}: contains other files, for example {strangers[0]}; give an empty or new folder")


def whole(path: Path, write: Callable[[Path], object]) -> None:
    """Write a file in one step. Raises UsageError if the file cannot be written."""
    from polars.exceptions import PolarsError  # the error that polars raises for a full disk

    part = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        write(part)
        part.replace(path)
    except (OSError, PolarsError) as error:
        with suppress(OSError):
            part.unlink(missing_ok=True)
        reason = getattr(error, "strerror", None) or error
        raise UsageError(f"{path}: {reason}; free some space, or choose another folder") from None


@dataclass(frozen=True)
class Kept:
    """A table, in memory or on the disk, and its problems."""

    here: pl.DataFrame | None
    path: Path | None
    problems: tuple[RowProblem, ...]

    def rows(self) -> pl.DataFrame:
        """Return the table. Raises UsageError if the table has disappeared from the disk."""
        if self.here is not None:
            return self.here
        if self.path is None or not self.path.exists():
            raise UsageError("the estimates were deleted from the folder; run pmfid fleet history again")
        return pl.read_parquet(self.path, hive_partitioning=False)


class Keep:
    """The store of a history, or none.

    `keys` has all requested keys, and `reused` counts the keys that the store had.
    """

    def __init__(self, store: Store | None) -> None:
        self._store = store
        self.keys: list[str] = []
        self.reused = 0

    @property
    def lasting(self) -> bool:
        return self._store is not None

    def fetch(
        self, keys: Sequence[str], make: Callable[[Sequence[int]], Iterator[Survey | Segments]], *, here: bool = False
    ) -> Iterator[Kept]:
        """Yield the table of each key, in order.

        `make` is called once with the indices of the missing keys, and yields their tables in order. The new tables are
        stored one by one. With `here`, the tables are also kept in memory. Raises UsageError if the disk is full.
        """
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

    def _put(self, key: str, found: Survey | Segments, here: bool) -> Kept:
        if self._store is None:
            return Kept(found.rows, None, found.problems)
        self._store.put(key, found.rows, found.problems)
        return Kept(found.rows if here else None, self._store.path(key), found.problems)
