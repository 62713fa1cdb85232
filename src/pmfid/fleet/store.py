"""The folder of a history: what is done stays done. Files are whole or not there, and are named by what they came
from."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

from pmfid import __version__
from pmfid.durable.lock import NAME as LOCK
from pmfid.durable.lock import hold
from pmfid.errors import UsageError
from pmfid.fleet.survey import RowProblem, Survey
from pmfid.fleet.walk import RESULTS

if TYPE_CHECKING:
    import polars as pl

#: To be raised with every change of what a segment is, or of these files.
VERSION = 4
#: Of the folders in which rows are put aside during a call.
ASIDE = "aside-"


def digest(*parts: object) -> str:
    """The name of what is made of these."""
    return sha256(json.dumps([VERSION, __version__, *parts], default=str).encode()).hexdigest()[:32]


class Store:
    """A table and its problems for each key; folder: where they are, for one call at a time. Raises UsageError where
    the folder is a file, holds something else, cannot be written, or another call has it."""

    def __init__(self, folder: Path) -> None:
        check_folder(folder)
        self.folder = folder / "work"
        self._lock = hold(self.folder, "the folder of the history", "another call")
        for left in self.folder.glob(f"{ASIDE}*"):  # by a call that was killed
            remove(left)

    def close(self) -> None:
        """Another call may have the folder."""
        self._lock.close()

    def get(self, key: str) -> Survey | None:
        """What lies under a key; None: nothing, or nothing that this version writes."""
        import polars as pl

        try:
            problems = json.loads(self._problems_path(key).read_text(encoding="utf-8"))
            return Survey(
                pl.read_parquet(self.path(key), hive_partitioning=False), tuple(RowProblem(**raw) for raw in problems)
            )
        except Exception:  # not there, or damaged: computed again
            return None

    def put(self, key: str, rows: pl.DataFrame, problems: Sequence[RowProblem]) -> None:
        """Lays a table and its problems down. Raises UsageError where the disk is full."""
        text = json.dumps([asdict(one) for one in problems])
        whole(self._problems_path(key), lambda path: path.write_text(text, encoding="utf-8"))
        whole(self.path(key), lambda path: rows.write_parquet(path))

    def _problems_path(self, key: str) -> Path:
        return self.folder / f"{key}.json"

    def path(self, key: str) -> Path:
        """Where the table lies."""
        return self.folder / f"{key}.parquet"

    def keep(self, keys: Iterable[str]) -> None:
        """Removes all others: of parts that are gone, of other configurations, and what a killed call left half."""
        kept = set(keys)
        for path in self.folder.iterdir():
            if path.name.partition(".")[0] not in {*kept, LOCK} or path.suffix == ".part":
                remove(path)


def remove(path: Path) -> None:
    """A file or a folder that may be gone already."""
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


#: Files that a history writes into its folder.
OWN = RESULTS | {"fleet.html", "fleet.json"}


def check_folder(folder: Path) -> None:
    """Raises UsageError where the folder is a file, holds something else, or cannot be looked into."""
    try:
        inside = [path.name for path in folder.iterdir()]
    except FileNotFoundError:
        return
    except NotADirectoryError:
        raise UsageError(f"{folder}: is a file, or lies in one; give a folder for the history") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise UsageError(f"{folder}: {reason}; choose a folder that can be written") from None
    strangers = sorted(name for name in inside if name not in OWN)
    if strangers and "work" not in inside:
        raise UsageError(f"{folder}: holds other files, {strangers[0]} among them; give a new or empty folder")


def whole(path: Path, write: Callable[[Path], object]) -> None:
    """Writes a file in one step. Raises UsageError where that cannot be."""
    from polars.exceptions import PolarsError  # what its writers make of a full disk

    part = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        write(part)
        part.replace(path)
    except (OSError, PolarsError) as error:
        with suppress(OSError):
            part.unlink(missing_ok=True)
        reason = getattr(error, "strerror", None) or error
        raise UsageError(f"{path}: {reason}; make room, or choose another folder") from None
