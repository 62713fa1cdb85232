"""Sources and sinks, and the part of the service that they may use."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from pmfid.config.axis import Axis
from pmfid.config.toml_file import FileSection
from pmfid.errors import PmfidError, UsageError
from pmfid.stream.delivery import Delivery
from pmfid.stream.outcome import Counters, EstimateRows, Notice

#: A function that hands a delivery to the engine, and waits while the inbox is full. The function returns False once
#: the service ends. After False the source returns, and the delivery counts as not received.
Take = Callable[[Delivery], bool]
#: A function that returns the present AXIS.toml of an axis by its name, or None for an unknown axis.
FindAxis = Callable[[str], Axis | None]
#: A function that makes a notice of the service from an object with "event", from any thread.
Tell = Callable[[dict[str, Any]], None]


class Source(Protocol):
    """A source of deliveries, which runs in its own thread.

    `name` is the name in PLANT.toml. `run` hands data over until the source ends, `stop` is called or `take` returns
    False. After an error `run` connects again by itself, with growing pauses. `tell` reports the error as an object
    with "event": "source", "source": name, "problem": ... `stop` may be called from any thread, at any
    time, twice.
    """

    name: str

    def run(self, take: Take) -> None: ...

    def stop(self) -> None: ...


#: What a sink receives.
Outcome = EstimateRows | Notice


class RefusedError(PmfidError):
    """Raised by a sink for an outcome that it will never take, for example if a server rejects its content.

    The outcome is dropped and counted, and the other outcomes are delivered.
    """


class Sink(Protocol):
    """A receiver of outcomes, which runs in its own thread after a bounded queue (`sinks/queued.py`).

    A full queue drops and counts its oldest rows, and keeps notices as long as possible. A broken sink therefore never
    delays an estimate.

    `name` is the name in PLANT.toml. `takes_rows` is true for a sink that takes rows. `events` has the events of the
    notices that it takes. None means all. `put` writes outcomes in order. `put` raises OSError, also for errors of its
    library. The error is reported once, and all outcomes are tried again after a pause and `open`. While no outcome
    waits, `put` is called with an empty list, first at the start and then every few seconds. `close` writes the
    remaining outcomes if possible.
    """

    name: str
    takes_rows: bool
    events: frozenset[str] | None

    def open(self) -> None: ...

    def put(self, outcomes: list[Outcome]) -> None: ...

    def close(self) -> None: ...


@dataclass(frozen=True)
class Context:
    """The part of the service that sources and sinks may use.

    `name` is the name of the service. `folder` is the folder of PLANT.toml, to which names of files are relative.
    `counters` and `tell` belong to the service.
    """

    name: str
    folder: Path
    counters: Counters
    tell: Tell
    axis: FindAxis

    def require(self, axis: str) -> Axis:
        """Return the present AXIS.toml of an axis. Raises UsageError for an axis that is not in the plant."""
        found = self.axis(axis)
        if found is None:
            raise UsageError(f"the plant has no axis {axis!r}; give the name of a section [axes.NAME]")
        return found


class SourceSection(FileSection):
    """The key `kind` of [sources.NAME], and the keys of this kind."""

    def make(self, name: str, context: Context) -> Source:
        """Return the source, not yet running. Raises UsageError for errors that the file alone does not show."""
        raise NotImplementedError
