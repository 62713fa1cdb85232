"""The folder of a stream, and its states."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from uuid import uuid4

from pmfid.durable import NAME as LOCK
from pmfid.durable import hold
from pmfid.errors import UsageError, did_you_mean
from pmfid.fleet.store import whole
from pmfid.fleet.stream.shard import COUNTS, ESTIMATE, NOTICE, StreamPlan, shard_of
from pmfid.stream.checkpoint import Saved, Snapshot, body_from, body_of, join_groups, read_snapshot
from pmfid.stream.vault import Vault, crash_point

if TYPE_CHECKING:
    import polars as pl

    from pmfid.monitor.monitor import Monitor
    from pmfid.stream.groups import Pace, Prepared

__all__ = ["States"]


@dataclass(frozen=True)
class States:
    """What is known of axes of one configuration: checkpoints of its shards, or of a service."""

    snapshots: tuple[Snapshot, ...]
    digest: str

    @classmethod
    def from_bodies(cls, bodies: Mapping[int, bytes], digest: str) -> States:
        """States in the bodies of shards, by number. Raises UsageError if one of them is of another configuration."""
        try:
            found = cls(tuple(read_snapshot(bodies[number]) for number in sorted(bodies)), digest)
        except ValueError as error:
            raise UsageError(f"a state cannot be read: {error}; read it with the version that wrote it") from None
        if not found.groups:
            raise UsageError("the states are of another configuration; give the AXIS.toml that they were made with")
        return found

    @classmethod
    def from_monitors(cls, monitors: Mapping[str, Monitor], prepared: Prepared, pace: Pace) -> States:
        """States of axes with monitors of their own, or with an estimator whose state comes from firmware. Monitoring
        of a firmware axis restarts, because firmware has no monitor. Raises UsageError for monitors of another
        configuration."""
        try:
            return cls.from_bodies({0: body_from(monitors, prepared, pace)}, prepared.digest)
        except ValueError as error:
            raise UsageError(f"{error}") from None

    @classmethod
    def from_folder(cls, folder: Path, digest: str) -> States:
        """Of the last checkpoint in the folder of a service. Raises UsageError where there is none, or another service
        has it."""
        if not folder.is_dir():
            raise UsageError(f"{folder}: is no folder of states; give [service] state of a PLANT.toml")
        vault = Vault(folder)
        problems = list[dict[str, Any]]()
        found = vault.load(read_snapshot, problems.append)
        vault.close()
        if found is None:
            raise UsageError(f"{folder}: holds no checkpoint that is whole; give [service] state of a PLANT.toml")
        if not any(group.digest == digest for group in found.groups):
            raise UsageError(f"{folder}: its states are of another configuration; give the AXIS.toml that made them")
        return cls((found,), digest)

    @property
    def groups(self) -> list[Saved]:
        """Of this configuration."""
        return [group for one in self.snapshots for group in one.groups if group.digest == self.digest]

    @property
    def axes(self) -> list[str]:
        """Names, sorted."""
        return sorted(name for group in self.groups for name in group.axes)

    def only(self, names: Sequence[str]) -> list[str]:
        """These names; all where none is given. Raises UsageError for one that is not there."""
        known = self.axes
        for name in names:
            if name not in known:
                raise UsageError(f"there is no axis {name!r} in these states{did_you_mean(name, known)}")
        return list(names) or known

    def monitor(self, axis: str, prepared: Prepared, pace: Pace) -> Monitor:
        """A monitor that goes on where an axis stands. Raises UsageError for one that is not there."""
        self.only([axis])
        group = next(group for group in self.groups if axis in group.axes)
        return group.restore_group(prepared, pace).fleet.monitor(group.axes.index(axis))

    def bodies(self, plan: StreamPlan) -> dict[int, bytes]:
        """The bodies of shards that go on with these axes."""
        parts: dict[int, set[str]] = {}
        for name in self.axes:
            parts.setdefault(shard_of(name, plan.shards), set()).add(name)
        return {number: self._body(plan.prepared, plan.pace, names) for number, names in sorted(parts.items())}

    def write(self, folder: Path, prepared: Prepared, pace: Pace, names: Sequence[str] = ()) -> int:
        """The states of some axes, all where no name is given, as the checkpoint of a service with [service] state =
        that folder, which goes on with them; how many. Raises UsageError where another service has the folder."""
        chosen = self.only(names)
        vault = Vault(folder)
        try:
            vault.load(read_snapshot, lambda problem: None)  # the new snapshot follows the present ones
            vault.write([self._body(prepared, pace, set(chosen))])
        except OSError as error:
            raise UsageError(f"{folder}: {error.strerror}; make room, or choose another folder") from None
        finally:
            vault.close()
        return len(chosen)

    def _body(self, prepared: Prepared, pace: Pace, names: Collection[str]) -> bytes:
        alarms = [alarm for one in self.snapshots for alarm in one.alarms]
        numbered = max(one.numbered for one in self.snapshots)
        try:
            whole = join_groups(self.groups, prepared)
            return body_of(whole, prepared, pace, names, alarms, numbered)
        except ValueError as error:
            raise UsageError(f"the states cannot be used: {error}; give the AXIS.toml that made them") from None


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
