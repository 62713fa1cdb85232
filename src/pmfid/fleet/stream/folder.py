"""The folder that a stream writes: a file of each kind for each batch, so that a batch that comes again takes the place
of itself."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING
from uuid import uuid4

from pmfid.durable.lock import NAME as LOCK
from pmfid.durable.lock import hold
from pmfid.errors import UsageError
from pmfid.fleet.store import whole
from pmfid.fleet.stream.tables import COUNTS, ESTIMATE, NOTICE
from pmfid.stream.crash import crash_point

if TYPE_CHECKING:
    import polars as pl

__all__ = ["Folder", "StreamSettings", "open_folder"]

SETTINGS, STREAM = "pmfid.json", "stream.json"
#: What a user can do where a setting is not that of the checkpoint.
REMEDIES = {
    "config": "give the configuration and the reference of before, or new folders for --checkpoint and --out",
    "shards": "the state is shared out by it; give it as before",
    "window": "give it as before, or new folders for --checkpoint and --out",
    "every": "give it as before, or new folders for --checkpoint and --out",
    "layout": "go on with the version that wrote it, or take new folders for --checkpoint and --out",
    "source": "where it stands holds for that one only; give it, or new folders for --checkpoint and --out",
}


@dataclass(frozen=True)
class StreamSettings:
    """What may not change between two starts. config: digest of the configuration; window, every: [s]; layout: of the
    state in the store, 2 since shards have keys and are packed."""

    config: str
    shards: int
    window: float
    every: float
    source: str
    layout: int = 2


@contextmanager
def open_folder(checkpoint: Path, out: Path, settings: StreamSettings) -> Iterator[Folder]:
    """The folder of results that belongs to a checkpoint; both are created if new, and locked for one stream.
    Raises UsageError if one of them belongs to another stream, to other settings or to a running stream, or cannot be
    created."""
    if checkpoint.resolve() == out.resolve():
        raise UsageError(f"{out}: is the checkpoint; give a folder of its own for --out")
    if _read(checkpoint / SETTINGS) is None and _holds(checkpoint, LOCK):
        raise UsageError(f"{checkpoint}: is no checkpoint of pmfid fleet stream; give a new or empty folder")
    with closing(hold(checkpoint, "--checkpoint", "another stream")):
        number = _begin_stream(checkpoint, settings)
        try:
            _result(out, number, settings)
        except OSError as error:
            raise UsageError(f"{out}: {error.strerror}; choose a folder that can be written for --out") from None
        yield Folder(out)


def _result(out: Path, number: str, settings: StreamSettings) -> None:
    """The folder of the results of the stream of this number."""
    known = _read(out / STREAM)
    if known is None and _holds(out):
        raise UsageError(f"{out}: holds something else; give a new or empty folder for the results")
    if known is not None and known.get("stream") != number:
        raise UsageError(
            f"{out}: holds the results of another stream; give a new folder, or the checkpoint of that one"
        )
    for kind in Folder.KINDS:
        (out / kind).mkdir(parents=True, exist_ok=True)
        for part in (out / kind).glob("*.part"):  # of a process that was killed
            part.unlink(missing_ok=True)
    if known is None:
        whole(out / STREAM, lambda path: path.write_text(json.dumps({"stream": number, **asdict(settings)})))


def _holds(folder: Path, *known: str) -> bool:
    """Whether a folder holds anything but what is known, or is none."""
    try:
        return any(path.name not in known and path.suffix != ".part" for path in folder.iterdir())
    except FileNotFoundError:
        return False
    except OSError:
        return True


def _begin_stream(checkpoint: Path, settings: StreamSettings) -> str:
    """The number of the stream of a checkpoint."""
    known = _read(checkpoint / SETTINGS)
    if known is None:
        known = {"stream": uuid4().hex, **asdict(settings)}
        whole(checkpoint / SETTINGS, lambda path: path.write_text(json.dumps(known)))
    for name, value in asdict(settings).items():
        if known.get(name) != value:
            shown = "" if name == "config" else f" (now {value}, then {known.get(name)})"
            raise UsageError(f"{checkpoint}: was begun with another {name}{shown}: {REMEDIES[name]}")
    return str(known.get("stream"))


def _read(path: Path) -> dict[str, object] | None:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except NotADirectoryError:
        return None
    except (OSError, ValueError) as error:
        raise UsageError(f"{path}: cannot be read: {error}; give another folder") from None
    return found if isinstance(found, dict) else {}


@dataclass(frozen=True)
class Folder:
    """estimates/, notices/: a Parquet file for each batch; batches/: its counts as JSON, written last: what has none is
    not yet whole."""

    path: Path
    KINDS = ("estimates", "notices", "batches")

    def write(self, batch: int, table: pl.DataFrame) -> None:
        """The rows of a batch, in place of those from before. Raises UsageError where the disk takes none."""
        import polars as pl

        crash_point("stream.given")
        order = pl.col("axis", "number", "told")
        estimates = table.filter(pl.col("row") == ESTIMATE).drop("row", "told").sort("axis", "number")
        notices = table.filter(pl.col("row") == NOTICE).select("axis", "number", "time", "told").sort(order)
        self._put("estimates", batch, ".parquet", estimates.write_parquet)
        crash_point("stream.half")
        self._put("notices", batch, ".parquet", notices.write_parquet)
        counts = {"batch": batch, "estimates": estimates.height, "notices": notices.height, **_counts(table)}
        self._put("batches", batch, ".json", lambda path: path.write_text(json.dumps(counts)))
        crash_point("stream.written")

    def _put(self, kind: str, batch: int, suffix: str, write: Callable[[Path], object]) -> None:
        def durable(path: Path) -> None:
            write(path)
            crash_point("stream.part")
            with open(path, "rb+") as file:
                os.fsync(file.fileno())

        whole(self.path / kind / f"batch-{batch:010d}{suffix}", durable)


def _counts(table: pl.DataFrame) -> dict[str, int]:
    """Sums over the shards."""
    found: dict[str, int] = {}
    for text in table.filter(table["row"] == COUNTS)["told"].to_list():
        for name, value in json.loads(text).items():
            found[name] = found.get(name, 0) + int(value)
    return found
