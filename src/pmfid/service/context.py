"""Sources and sinks, and the part of the service that they may use."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from pmfid.config.axis import Axis
from pmfid.config.toml_file import FileSection
from pmfid.errors import PmfidError
from pmfid.stream.delivery import Delivery, Mark
from pmfid.stream.outcome import Counters, EstimateRows, Notice

#: Bytes that one call reads.
CHUNK = 65_536

#: Hands a delivery to the engine and waits while the inbox is full; False once the service ends: then the source
#: returns, and what was not taken counts as not received.
Take = Callable[[Delivery], bool]
#: The AXIS.toml of an axis by its name as it is now, None if there is no such axis.
FindAxis = Callable[[str], Axis | None]
#: Makes a notice of the service of an object with "event", from any thread.
Tell = Callable[[dict[str, Any]], None]


class Source(Protocol):
    """Runs in a thread of its own.

    name: in PLANT.toml. `run` hands over what comes until the source ends, `stop` is called or `take` says False; it
    connects again by itself after errors, with growing pauses, and tells them through `tell` (an object with "event":
    "source", "source": name, "problem": ...). mark: of the last checkpoint, None at the first start; what was handed
    over since is asked for again where that is possible. `stop` may be called from any thread, at any time, twice.
    """

    name: str

    def run(self, take: Take, mark: Mark | None) -> None: ...

    def stop(self) -> None: ...


class RefusedError(PmfidError):
    """Raised by a sink for an outcome that it will never take, for example if a server rejects its content. The
    outcome is dropped and counted, and the others go on."""


class Sink(Protocol):
    """Runs in a thread of its own, after a bounded queue (`sinks/queued.py`). A full queue drops and counts its oldest
    rows, and keeps notices as long as it can: a broken sink never delays an estimate.

    name: in PLANT.toml. `put` writes outcomes in order. It raises OSError, also for errors of its library: the error is
    reported once, and all outcomes are tried again after a pause and `open`. While no outcome waits, `put` is called
    with an empty list, first at the start and then every few seconds. `close` writes the rest if it can.
    """

    name: str

    def open(self) -> None: ...

    def put(self, outcomes: list[EstimateRows | Notice]) -> None: ...

    def close(self) -> None: ...


@dataclass(frozen=True)
class Context:
    """name: of the service; folder: of PLANT.toml, to which names of files are relative; state: folder of the
    checkpoints, None without checkpoints; counters, tell: of the service."""

    name: str
    folder: Path
    state: Path | None
    counters: Counters
    tell: Tell
    axis: FindAxis


@dataclass
class ProblemReport:
    """Reports a problem of a source once, and its end, as ""."""

    source: str
    tell: Tell
    _problem: str = field(default="", init=False)

    def say(self, problem: str) -> None:
        if problem != self._problem:
            self._problem = problem
            self.tell({"event": "source", "source": self.source, "problem": problem})


class SourceSection(FileSection):
    """[sources.NAME]: `kind` and what that kind needs."""

    def make(self, name: str, context: Context) -> Source:
        """The source, not yet running. Raises UsageError for what the file alone does not show."""
        raise NotImplementedError
