"""A record as a source, played as if it were measured now."""

from __future__ import annotations

import math
import os
import time
from dataclasses import dataclass, field
from pathlib import Path
from threading import Event
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from pmfid.config.axis import Axis
from pmfid.config.model import Name
from pmfid.records.record import Record, read_record
from pmfid.service.context import Context, Source, SourceSection, Take
from pmfid.service.tuning import TUNING
from pmfid.stream.delivery import Block, Delivery, Mark


def _usable(value: float) -> float:
    if value != 0 and not TUNING.record_slowest <= value <= TUNING.record_fastest:
        raise ValueError(f"a speed must be 0, or from {TUNING.record_slowest} to {TUNING.record_fastest:g}")
    return value


Speed = Annotated[float, AfterValidator(_usable)]


class RecordSource(SourceSection):
    """The keys of [sources.NAME] with kind = "record", for trials without a machine."""

    kind: Literal["record"] = Field(description='"record"')
    path: Name = Field(description='the record to play, for example "logs/x1.csv"')
    axis: Name = Field(description="the name of the axis that the record belongs to")
    speed: Speed = Field(1.0, description="the speed of the replay: 1.0 is real time, 0.0 is as fast as possible")

    def make(self, name: str, context: Context) -> Source:
        """Return the source. Raises UsageError for an axis that is not in the plant."""
        axis = context.require(self.axis)
        return Player(name, self.axis, context.folder / self.path, axis, self.speed)


@dataclass
class Player:
    """A record in blocks, as if it were measured now.

    `speed` is a multiple of the machine's speed. 0 means as fast as possible.
    """

    name: str
    axis: str
    path: Path
    config: Axis
    speed: float
    record: Record | None = None
    _stop: Event = field(default_factory=Event, init=False)

    def run(self, take: Take, mark: Mark | None) -> None:
        """Hand over all samples, or the samples after the mark."""
        record = read_record(self.path, self.config) if self.record is None else self.record
        status = os.stat(self.path)
        version, epoch, start = f"{status.st_size} {status.st_mtime_ns}", 0, 0
        if mark is not None:
            same = mark.get("version") == version
            epoch, start = int(mark["epoch"]) + (not same), int(mark["sample"]) if same else 0
        size = min(
            TUNING.record_block, max(1, round(TUNING.block_time / record.dt)) if self.speed else TUNING.record_block
        )
        begun = time.monotonic() - (start * record.dt / self.speed if self.speed else 0.0)
        for first in range(start, record.u.size, size):
            end = min(first + size, record.u.size)
            if self.speed and self._stop.wait(max(0.0, begun + end * record.dt / self.speed - time.monotonic())):
                return
            u, counts = record.u[first:end], record.counts[first:end]
            ages = None if record.ages is None else record.ages[first:end]
            block = Block(self.axis, epoch, first, math.nan, record.dt, u, counts, ages)
            position: Mark = {"version": version, "epoch": epoch, "sample": end}
            if self._stop.is_set() or not take(Delivery(self.name, (block,), None, position, time.monotonic())):
                return

    def stop(self) -> None:
        self._stop.set()
