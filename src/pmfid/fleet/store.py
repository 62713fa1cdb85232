"""The folder of a history: what is done stays done. Files are whole or not there, and are named by what they came
from."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

from pmfid import __version__
from pmfid.errors import UsageError
from pmfid.fleet.survey import Problem, Survey

if TYPE_CHECKING:
    import polars as pl

#: To be raised with every change of what a segment is, or of these files.
VERSION = 3
#: Of the folders in which rows are put aside during a call.
ASIDE = "aside-"


def digest(*parts: object) -> str:
    """The name of what is made of these."""
    return sha256(json.dumps([VERSION, __version__, *parts], default=str).encode()).hexdigest()[:32]


class Store:
    """A table and its problems for each key; folder: where they are. Raises UsageError where the folder is a file or
    holds something else."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "work"
        if folder.exists() and not folder.is_dir():
            raise UsageError(f"{folder}: is a file; give a folder for the history")
        strangers = [path.name for path in folder.iterdir() if path.name not in OWN] if folder.is_dir() else []
        if strangers and not self.folder.is_dir():
            raise UsageError(f"{folder}: holds other files, {strangers[0]} among them; give a new or empty folder")
        self.folder.mkdir(parents=True, exist_ok=True)
        for left in self.folder.glob(f"{ASIDE}*"):  # by a call that was killed
            remove(left)

    def get(self, key: str) -> Survey | None:
        """What lies under a key; None: nothing, or nothing that this version writes."""
        import polars as pl

        try:
            told = json.loads(self._told(key).read_text(encoding="utf-8"))
            return Survey(
                pl.read_parquet(self.path(key), hive_partitioning=False), tuple(Problem(**raw) for raw in told)
            )
        except Exception:  # not there, or damaged: made anew
            return None

    def put(self, key: str, rows: pl.DataFrame, problems: Sequence[Problem]) -> None:
        """Lays a table and its problems down. Raises UsageError where the disk is full."""
        text = json.dumps([asdict(one) for one in problems])
        whole(self._told(key), lambda path: path.write_text(text, encoding="utf-8"))
        whole(self.path(key), lambda path: rows.write_parquet(path))

    def _told(self, key: str) -> Path:
        return self.folder / f"{key}.json"

    def path(self, key: str) -> Path:
        """Where the table lies."""
        return self.folder / f"{key}.parquet"

    def keep(self, keys: Iterable[str]) -> None:
        """Removes all others: of parts that are gone, of other configurations, and what a killed call left half."""
        kept = set(keys)
        for path in self.folder.iterdir():
            if path.name.partition(".")[0] not in kept or path.suffix == ".part":
                remove(path)


def remove(path: Path) -> None:
    """A file or a folder that may be gone already."""
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


#: Files that a history writes into its folder.
OWN = {"work", "periods.parquet", "axes.parquet", "problems.parquet", "fleet.html", "fleet.json"}


def whole(path: Path, write: Callable[[Path], object]) -> None:
    """Writes a file in one step. Raises UsageError where that cannot be."""
    part = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        write(part)
        part.replace(path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise UsageError(f"{path}: {error.strerror or error}; make room, or choose another folder") from None
