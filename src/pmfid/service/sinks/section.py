"""The common keys of all sections of sinks, and the part of the service that a sink may use."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from pydantic import Field

from pmfid.service.sinks import Sink
from pmfid.service.sinks.queued import Queued, Tell
from pmfid.service.sinks.waiting import QueueLimits
from pmfid.session.toml_file import FileSection
from pmfid.stream.counters import Counters

__all__ = ["Host", "SinkSection"]


class Host(Protocol):
    """The service around a sink. name: of the service; folder: of PLANT.toml, to which names of files are relative;
    state: folder of the checkpoints, None without checkpoints; counters: those of the service;
    tell: receives notices of a sink, objects with "event": "sink", from any thread."""

    @property
    def name(self) -> str: ...

    @property
    def folder(self) -> Path: ...

    @property
    def state(self) -> Path | None: ...

    @property
    def counters(self) -> Counters: ...

    @property
    def tell(self) -> Tell: ...


class SinkSection(FileSection):
    """Keys that every [sinks.NAME] may have."""

    queue_rows: int = Field(100_000, ge=1, description="the number of rows that may wait; the oldest are dropped first")
    queue_mb: float = Field(64.0, gt=0, description="the size in MB of the rows that may wait, for example 64.0")
    queue_notices: int = Field(10_000, ge=1, description="the number of notices that may wait")

    def make(self, name: str, context: Host) -> Sink:
        """The sink, not yet open. Raises UsageError for what can be known to be wrong before, as a library that is not
        installed or a secret that is not there."""
        raise NotImplementedError

    def wants_rows(self) -> bool:
        """Whether rows are for this sink."""
        return True

    def wants_events(self) -> frozenset[str] | None:
        """Events that are for this sink; None for all."""
        return None

    def outlet(self, name: str, context: Host) -> Queued:
        """The queue of the sink, not yet started. Raises UsageError, as `make`."""
        limits = QueueLimits(self.queue_rows, int(1e6 * self.queue_mb), self.queue_notices)
        sink = self.make(name, context)
        return Queued(sink, context.counters, context.tell, limits, self.wants_rows(), self.wants_events())
