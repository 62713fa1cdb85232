"""Many axes watched as a stream, with a shard of the engine, its tables, the folder of results, and states.

The package `pmfid.fleet.spark` keeps the state of each shard.
"""

from __future__ import annotations

import json
import os
import zlib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass, field
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any
from uuid import uuid4

import numpy as np
import polars as pl

from pmfid.durable import NAME as LOCK
from pmfid.durable import crash_point, hold
from pmfid.errors import UsageError, did_you_mean
from pmfid.fleet.store import whole
from pmfid.monitor.events import STATES
from pmfid.stream import blocks
from pmfid.stream.blocks import HEADER, MAGIC
from pmfid.stream.checkpoint import Saved, Snapshot, body_from, body_of, join_groups, read_snapshot, snapshot
from pmfid.stream.delivery import Block, Delivery, Item, Table, Unusable, split_tables
from pmfid.stream.engine import StreamEngine
from pmfid.stream.groups import Group, Pace, Prepared
from pmfid.stream.outcome import Counters, EstimateRows, Notice
from pmfid.stream.store import Vault
from pmfid.stream.tuning import TUNING as STREAM_TUNING

if TYPE_CHECKING:
    from pmfid.pipeline.monitored.run import Monitored
    from pmfid.stream.groups import Pace, Prepared


SOURCE = "stream"


def shard_of(axis: str, shards: int) -> int:
    """Return the shard of an axis, which is the CRC-32 of the name in UTF-8, modulo the number of shards."""
    return zlib.crc32(axis.encode("utf-8", "replace")) % shards


@dataclass(frozen=True)
class StreamPlan:
    """The properties that all shards have in common. `shards` is the number of shards."""

    prepared: Prepared
    pace: Pace
    shards: int


@dataclass
class Outcomes:
    """An outlet that collects the outcomes of a batch."""

    estimates: list[EstimateRows] = field(default_factory=list)
    notices: list[Notice] = field(default_factory=list)

    def rows(self, rows: EstimateRows) -> None:
        self.estimates.append(rows)

    def notice(self, notice: Notice) -> None:
        self.notices.append(notice)


class StreamShard:
    """The shard `number` of a plan after the batch whose state is `body`, or None before the first batch.

    Raises ValueError for bytes that no shard of this plan has saved.
    """

    def __init__(self, plan: StreamPlan, number: int, body: bytes | None = None) -> None:
        self.plan, self.number = plan, number
        self.outcomes, self.counters = Outcomes(), Counters()
        self._engine = StreamEngine(self.counters, [self.outcomes])
        self._group = Group(plan.prepared, plan.pace)
        if body is not None:
            self._go_on(body)

    def _go_on(self, body: bytes) -> None:
        found = read_snapshot(body)
        own = [group for group in found.groups if group.digest == self.plan.prepared.digest]
        if len(own) != len(found.groups) or len(own) > 1:
            raise ValueError("the state belongs to another configuration")
        found.restore(self._engine)
        self._group = own[0].restore_group(self.plan.prepared, self.plan.pace) if own else self._group
        self._engine.set_groups([self._group])

    def take(self, messages: Iterable[bytes]) -> None:
        """Process the blocks of a batch, where each message has one or several binary blocks. New axes begin."""
        items = [item for data in _sort_messages(messages) for item in blocks.items(data)]
        checked = self._check_names(items)
        self._add(checked)
        self._engine.process([Delivery(SOURCE, checked)])
        self._engine.tick(0.0)

    def _check_names(self, items: Sequence[Item]) -> list[Item]:
        """Refuse blocks of an axis that belongs to another shard, because the axis would have two states."""
        wrong = {name for name in _names(items) if shard_of(name, self.plan.shards) != self.number}
        if not wrong:
            return list(items)
        checked = list[Item]()
        for one in split_tables(items):
            if isinstance(one, Block) and one.axis in wrong:
                name = one.axis[:64]
                problem = (
                    f"a row of another axis contains a block of {name!r}; write the name of the block into the "
                    "column axis"
                )
                checked.append(Unusable("name", problem, name))
            else:
                checked.append(one)
        return checked

    def _add(self, items: Sequence[Item]) -> None:
        """Add new axes, with numbers that no other shard gives."""
        fresh = sorted(name for name in _names(items) if self._engine.seat(name) is None)
        if not fresh:
            return
        known = len(self._group.seats)
        self._group.add(fresh)
        last, shards = self._engine.numbered, self.plan.shards
        last += (self.number + 1 - last) % shards or shards
        for k, seat in enumerate(self._group.seats[known:]):
            seat.number = last + k * shards
        self._engine.numbered = self._group.seats[-1].number
        self._engine.set_groups([self._group])

    def save_state(self) -> bytes:
        """Return the state, which is the body of a checkpoint of `pmfid serve`."""
        return b"".join(snapshot(self._engine))

    def count_samples(self) -> dict[str, float]:
        """Return the numbers of stepped and missing samples in this batch, and of refused samples by reason."""
        found: dict[str, float] = {}
        for (name, labels), value in self.counters.values().items():
            kind = next((text for label, text in labels if label in ("reason", "event")), "")
            if name in _COUNTED:
                key = _COUNTED[name] + kind
                found[key] = found.get(key, 0) + value
        return found


#: Counters that a batch reports, and their names in the report.
_COUNTED = {
    "pmfid_samples_total": "samples",
    "pmfid_samples_missing_total": "missing",
    "pmfid_samples_dropped_total": "dropped_",
    "pmfid_unusable_total": "unusable_",
}


def _names(items: Sequence[Item]) -> set[str]:
    found = set[str]()
    for item in items:
        found.update(item.axes if isinstance(item, Table) else [item.axis] if isinstance(item, Block) else [])
    return found


def _sort_messages(messages: Iterable[bytes]) -> list[bytes]:
    """Sort messages by epoch and first number, and join messages of one form, so that one call reads them."""
    keyed = sorted((_key(data), data) for data in messages)
    return [b"".join(data for _, data in some) for _, some in groupby(keyed, lambda pair: pair[0])]


def _key(data: bytes) -> tuple[Any, ...]:
    """Return the sort key of a message. A message that is no block has its own bytes, because its end is unknown."""
    if len(data) < HEADER.size or not data.startswith(MAGIC):
        return (2**64, 0, 0, 0, 0, 0, data)
    _, version, flags, samples, epoch, letters, first, _, _ = HEADER.unpack_from(data)
    return (epoch, first, version, flags, samples, letters, len(data).to_bytes(8, "big"))


#: Kinds of rows, in the column `row`.
ESTIMATE, NOTICE, COUNTS = "estimate", "notice", "counts"


def columns_of(plan: StreamPlan) -> dict[str, str]:
    """Return the name and the Spark type of each column.

    The column `number` has the samples of the axis so far. For a notice it has the number of the notice of that axis,
    or 0 if the notice does not concern data. The column "told" has JSON, for a notice the line that `pmfid monitor
    --json` prints.
    """
    names = plan.prepared.setup.monitor.names
    return {
        **{"row": "string", "axis": "string", "number": "long", "time": "double", "u": "double", "counts": "long"},
        **{column: "double" for name in names for column in (name, f"{name}_std")},
        **{"innovation": "double", "status": "long", "state": "string", "told": "string"},
    }


def table_of(shard: StreamShard) -> pl.DataFrame:
    """Return everything that a batch of a shard gave, in the columns of `columns_of`."""
    types = {"string": pl.String, "long": pl.Int64, "double": pl.Float64}
    schema = {name: types[kind] for name, kind in columns_of(shard.plan).items()}
    frames = [_estimates(rows) for rows in shard.outcomes.estimates]
    frames += [_notice(one) for one in shard.outcomes.notices]
    frames.append(pl.DataFrame({"row": [COUNTS], "axis": [""], "told": [json.dumps(shard.count_samples())]}))
    found = pl.concat([pl.DataFrame(schema=schema), *frames], how="diagonal")
    return found.with_columns(pl.col("number", "counts", "status").fill_null(0))


def _estimates(rows: EstimateRows) -> pl.DataFrame:
    axes, states = np.array(rows.group.axes, object), np.array(STATES, object)
    own = {
        "row": [ESTIMATE] * rows.axis.size,
        "axis": axes[rows.axis].tolist(),
        "number": rows.number,
        "time": rows.time,
        "u": rows.u,
        "counts": rows.counts,
    }
    for k, name in enumerate(rows.group.names):
        own[name], own[f"{name}_std"] = rows.theta[:, k], rows.std[:, k]
    rest = {"status": rows.status.astype(np.int64), "state": states[rows.state].tolist()}
    return pl.DataFrame({**own, "innovation": rows.innovation, **rest})


def _notice(notice: Notice) -> pl.DataFrame:
    number = 0 if notice.number >= STREAM_TUNING.notices_own else notice.number % STREAM_TUNING.of_axis
    columns = {"row": [NOTICE], "axis": [notice.axis], "number": [number], "told": [json.dumps(notice.what)]}
    time = notice.what.get("time")
    return pl.DataFrame({**columns, "time": pl.Series([time], dtype=pl.Float64)})


@dataclass(frozen=True)
class States:
    """States of axes with one configuration, from checkpoints of shards or of a service."""

    snapshots: tuple[Snapshot, ...]
    digest: str

    @classmethod
    def from_bodies(cls, bodies: Mapping[int, bytes], digest: str) -> States:
        """Read the states in the bodies of shards, by number. Raises UsageError for a state of another
        configuration."""
        try:
            found = cls(tuple(read_snapshot(bodies[number]) for number in sorted(bodies)), digest)
        except ValueError as error:
            raise UsageError(f"a state cannot be read: {error}; read it with the version that wrote it") from None
        if not found.groups:
            raise UsageError("the states belong to another configuration; give the AXIS.toml that they were made with")
        return found

    @classmethod
    def from_monitors(cls, monitors: Mapping[str, Monitored], prepared: Prepared, pace: Pace) -> States:
        """Return the states of axes with their own monitors, or with an estimator whose state comes from firmware.

        Monitoring of a firmware axis restarts, because firmware has no monitor. Raises UsageError for monitors of
        another configuration.
        """
        try:
            return cls.from_bodies({0: body_from(monitors, prepared, pace)}, prepared.digest)
        except ValueError as error:
            raise UsageError(f"{error}") from None

    @classmethod
    def from_folder(cls, folder: Path, digest: str) -> States:
        """Read the states of the last checkpoint in the folder of a service.

        Raises UsageError if no checkpoint exists, or if another service uses the folder.
        """
        if not folder.is_dir():
            raise UsageError(
                f"{folder}: this is not a folder with states; give the folder in [service] state of a PLANT.toml"
            )
        with closing(Vault(folder)) as vault:
            found = vault.load(read_snapshot, lambda problem: None)
        if found is None:
            raise UsageError(
                f"{folder}: contains no complete checkpoint; give the folder in [service] state of a PLANT.toml"
            )
        if not any(group.digest == digest for group in found.groups):
            raise UsageError(f"{folder}: its states belong to another configuration; give the AXIS.toml that made them")
        return cls((found,), digest)

    @property
    def groups(self) -> list[Saved]:
        return [group for one in self.snapshots for group in one.groups if group.digest == self.digest]

    @property
    def axes(self) -> list[str]:
        return sorted(name for group in self.groups for name in group.axes)

    def only(self, names: Sequence[str]) -> list[str]:
        """Return these names, or all names if none is given. Raises UsageError for an unknown name."""
        known = self.axes
        for name in names:
            if name not in known:
                raise UsageError(f"these states do not contain the axis {name!r}{did_you_mean(name, known)}")
        return list(names) or known

    def monitor(self, axis: str, prepared: Prepared, pace: Pace) -> Monitored:
        """Return a monitor that continues from the state of an axis. Raises UsageError for an unknown axis."""
        self.only([axis])
        group = next(group for group in self.groups if axis in group.axes)
        return group.restore_group(prepared, pace).fleet.monitor(group.axes.index(axis))

    def bodies(self, plan: StreamPlan) -> dict[int, bytes]:
        """Return the bodies of shards that continue with these axes."""
        parts: dict[int, set[str]] = {}
        for name in self.axes:
            parts.setdefault(shard_of(name, plan.shards), set()).add(name)
        return {number: self._body(plan.prepared, plan.pace, names) for number, names in sorted(parts.items())}

    def write(self, folder: Path, prepared: Prepared, pace: Pace, names: Sequence[str] = ()) -> int:
        """Write the states of some axes as the checkpoint of a service with this folder as [service] state.

        If no name is given, all axes are written. Returns the number of axes. Raises UsageError if another service uses
        the folder.
        """
        chosen = self.only(names)
        with closing(Vault(folder)) as vault:
            try:
                vault.load(read_snapshot, lambda problem: None)  # the new snapshot follows the present ones
                vault.write([self._body(prepared, pace, set(chosen))])
            except OSError as error:
                raise UsageError(
                    f"{folder}: {error.strerror or error}; free some space, or choose another folder"
                ) from None
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
#: Remedies for a setting that differs from the checkpoint.
REMEDIES = {
    "config": "give the previous configuration and reference, or new folders for --checkpoint and --out",
    "shards": "this number divides the state into parts; give the previous number",
    "window": "give the previous value, or new folders for --checkpoint and --out",
    "every": "give the previous value, or new folders for --checkpoint and --out",
    "layout": "continue with the version of pmfid that wrote the checkpoint, or give new folders for "
    "--checkpoint and --out",
    "source": "the checkpoint is a position in the previous source; give that source, or new folders for "
    "--checkpoint and --out",
}


@dataclass(frozen=True)
class StreamSettings:
    """Settings that must not change between two starts.

    `config` is the digest of the configuration. `window` and `every` are in s. `layout` is the version of the stored
    states, which is 2 since shards have keys and are packed.
    """

    config: str
    shards: int
    window: float
    every: float
    source: str
    layout: int = 2


@contextmanager
def open_folder(checkpoint: Path, out: Path, settings: StreamSettings) -> Iterator[Folder]:
    """Open the folder of results that belongs to a checkpoint.

    The folders of checkpoint and results are created if new, and locked for one stream. Raises UsageError if a folder
    belongs to another stream, to other settings or to a running stream, or cannot be created.
    """
    if checkpoint.resolve() == out.resolve():
        raise UsageError(f"{out} is the folder of the checkpoint; give --out another folder")
    if _read(checkpoint / SETTINGS) is None and _holds(checkpoint, LOCK):
        raise UsageError(f"{checkpoint} is not a checkpoint of pmfid fleet stream; give an empty or new folder")
    with closing(hold(checkpoint, "--checkpoint", "another stream")):
        number = _begin_stream(checkpoint, settings)
        try:
            _result(out, number, settings)
        except OSError as error:
            raise UsageError(f"{out}: {error.strerror}; choose a writable folder for --out") from None
        yield Folder(out)


def _result(out: Path, number: str, settings: StreamSettings) -> None:
    """Check or create the folder with the results of the stream of this number."""
    known = _read(out / STREAM)
    if known is None and _holds(out):
        raise UsageError(f"{out}: contains other files; give an empty or new folder for the results")
    if known is not None and known.get("stream") != number:
        raise UsageError(
            f"{out}: contains the results of another stream; give a new folder, or the checkpoint of that stream"
        )
    for kind in Folder.KINDS:
        (out / kind).mkdir(parents=True, exist_ok=True)
        for part in (out / kind).glob("*.part"):  # left by a killed process
            part.unlink(missing_ok=True)
    if known is None:
        whole(out / STREAM, lambda path: path.write_text(json.dumps({"stream": number, **asdict(settings)})))


def _holds(folder: Path, *known: str) -> bool:
    """Return whether a folder contains unknown files, or is no folder."""
    try:
        return any(path.name not in known and path.suffix != ".part" for path in folder.iterdir())
    except FileNotFoundError:
        return False
    except OSError:
        return True


def _begin_stream(checkpoint: Path, settings: StreamSettings) -> str:
    known = _read(checkpoint / SETTINGS)
    if known is None:
        known = {"stream": uuid4().hex, **asdict(settings)}
        whole(checkpoint / SETTINGS, lambda path: path.write_text(json.dumps(known)))
    for name, value in asdict(settings).items():
        if known.get(name) != value:
            shown = "" if name == "config" else f" (now {value}, before {known.get(name)})"
            raise UsageError(f"{checkpoint}: the stream began with another {name}{shown}: {REMEDIES[name]}")
    return str(known.get("stream"))


def _read(path: Path) -> dict[str, object] | None:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError) as error:
        raise UsageError(f"{path}: cannot be read: {error}; give another folder") from None
    return found if isinstance(found, dict) else {}


@dataclass(frozen=True)
class Folder:
    """The folder of results, with one file for each batch in each of its folders.

    The folders estimates/ and notices/ have Parquet files. The folder batches/ has the counts of a batch as JSON. The
    counts are written last, so a batch without them is incomplete.
    """

    path: Path
    KINDS = ("estimates", "notices", "batches")

    def write(self, batch: int, table: pl.DataFrame) -> None:
        """Write the rows of a batch, in place of earlier rows. Raises UsageError if the disk refuses the rows."""
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
    found: dict[str, int] = {}
    for text in table.filter(table["row"] == COUNTS)["told"].to_list():
        for name, value in json.loads(text).items():
            found[name] = found.get(name, 0) + int(value)
    return found
