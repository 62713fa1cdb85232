"""A shard of the engine as a value, and its tables."""

from __future__ import annotations

import json
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np

from pmfid.monitor.events import STATES
from pmfid.stream import blocks
from pmfid.stream.blocks import HEADER, MAGIC
from pmfid.stream.checkpoint import read_snapshot, snapshot
from pmfid.stream.commands import Counters
from pmfid.stream.delivery import Block, Delivery, Item, Table, Unusable
from pmfid.stream.engine import StreamEngine
from pmfid.stream.groups import Group, Pace, Prepared
from pmfid.stream.outcome import EstimateRows, Notice
from pmfid.stream.tuning import TUNING as STREAM_TUNING

if TYPE_CHECKING:
    import polars as pl

__all__ = ["Outcomes", "StreamPlan", "StreamShard", "shard_of"]

SOURCE = "stream"


def shard_of(axis: str, shards: int) -> int:
    """The shard of an axis: CRC-32 of its name in UTF-8, modulo the number of shards."""
    return zlib.crc32(axis.encode("utf-8", "replace")) % shards


@dataclass(frozen=True)
class StreamPlan:
    """What all shards have in common. shards: how many there are."""

    prepared: Prepared
    pace: Pace
    shards: int


@dataclass
class Outcomes:
    """What a batch gave, as an outlet."""

    estimates: list[EstimateRows] = field(default_factory=list)
    notices: list[Notice] = field(default_factory=list)

    def rows(self, rows: EstimateRows) -> None:
        self.estimates.append(rows)

    def notice(self, notice: Notice) -> None:
        self.notices.append(notice)


class StreamShard:
    """Shard `number` of a plan after the batch whose state is `body`, None before the first. Raises ValueError for
    bytes that no shard of this plan has saved."""

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
            raise ValueError("the state is of another configuration")
        found.restore(self._engine)
        self._group = own[0].restore_group(self.plan.prepared, self.plan.pace) if own else self._group
        self._engine.set_groups([self._group])

    def take(self, messages: Iterable[bytes]) -> None:
        """The blocks of a batch, each message one or several of them in binary; axes that come for the first time
        begin."""
        items = [item for data in _sort_messages(messages) for item in blocks.items(data)]
        checked = self._check_names(items)
        self._add(checked)
        self._engine.process([Delivery(SOURCE, checked)])
        self._engine.tick(0.0)

    def _check_names(self, items: Sequence[Item]) -> list[Item]:
        """Refuses blocks under the name of an axis of another shard: such an axis would have two states."""
        wrong = {name for name in _names(items) if shard_of(name, self.plan.shards) != self.number}
        if not wrong:
            return list(items)
        single = [block for item in items for block in (item.blocks() if isinstance(item, Table) else [item])]
        return [_refuse_name(one) if isinstance(one, Block) and one.axis in wrong else one for one in single]

    def _add(self, items: Sequence[Item]) -> None:
        """Adds new axes, with numbers that no other shard gives."""
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
        """The state: the body of a checkpoint of `pmfid serve`."""
        return b"".join(snapshot(self._engine))

    def count_samples(self) -> dict[str, float]:
        """Numbers of samples of this batch: stepped, missing, and refused by reason."""
        found: dict[str, float] = {}
        for (name, labels), value in self.counters.values().items():
            kind = next((text for label, text in labels if label in ("reason", "event")), "")
            if name in _COUNTED:
                key = _COUNTED[name] + kind
                found[key] = found.get(key, 0) + value
        return found


#: Counters that a batch reports, and their names there.
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


def _refuse_name(block: Block) -> Unusable:
    problem = f"a block of {block.axis[:64]!r} came in a row of another axis; write its own name into the column axis"
    return Unusable("name", problem, block.axis[:64])


def _sort_messages(messages: Iterable[bytes]) -> list[bytes]:
    """Messages by epoch and first number, with messages of one form joined, so that they are read at once."""
    keyed = sorted((_key(data), data) for data in messages)
    return [b"".join(data for _, data in some) for _, some in groupby(keyed, lambda pair: pair[0])]


def _key(data: bytes) -> tuple[Any, ...]:
    """Of a message; of one that is no block its own bytes, for nobody knows where it ends."""
    if len(data) < HEADER.size or not data.startswith(MAGIC):
        return (2**64, 0, 0, 0, 0, 0, data)
    _, version, flags, samples, epoch, letters, first, _, _ = HEADER.unpack_from(data)
    return (epoch, first, version, flags, samples, letters, len(data).to_bytes(8, "big"))


#: What a row is, in the column `row`.
ESTIMATE, NOTICE, COUNTS = "estimate", "notice", "counts"


def columns_of(plan: StreamPlan) -> dict[str, str]:
    """Name -> type of Spark of each column. number: samples of the axis so far, of a notice its number of that axis,
    0 if it does not concern data; told: JSON, for a notice the line that `pmfid monitor --json` prints."""
    names = plan.prepared.setup.monitor.names
    return {
        **{"row": "string", "axis": "string", "number": "long", "time": "double", "u": "double", "counts": "long"},
        **{column: "double" for name in names for column in (name, f"{name}_std")},
        **{"innovation": "double", "status": "long", "state": "string", "told": "string"},
    }


def table_of(shard: StreamShard) -> pl.DataFrame:
    """All that a batch of a shard gave, with these columns."""
    import polars as pl

    types = {"string": pl.String, "long": pl.Int64, "double": pl.Float64}
    schema = {name: types[kind] for name, kind in columns_of(shard.plan).items()}
    frames = [_estimates(rows) for rows in shard.outcomes.estimates]
    frames += [_notice(one) for one in shard.outcomes.notices]
    frames.append(pl.DataFrame({"row": [COUNTS], "axis": [""], "told": [json.dumps(shard.count_samples())]}))
    found = pl.concat([pl.DataFrame(schema=schema), *frames], how="diagonal")
    return found.with_columns(pl.col("number", "counts", "status").fill_null(0))


def _estimates(rows: EstimateRows) -> pl.DataFrame:
    import polars as pl

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
    import polars as pl

    number = 0 if notice.number >= STREAM_TUNING.notices_own else notice.number % STREAM_TUNING.of_axis
    columns = {"row": [NOTICE], "axis": [notice.axis], "number": [number], "told": [json.dumps(notice.what)]}
    time = notice.what.get("time")
    return pl.DataFrame({**columns, "time": pl.Series([time], dtype=pl.Float64)})
