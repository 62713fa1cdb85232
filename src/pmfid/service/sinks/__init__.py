"""Where estimates and alarms go: one file for each kind of sink."""

from __future__ import annotations

from typing import Protocol

from pmfid.errors import PmfidError
from pmfid.stream.outcome import Notice, Rows

__all__ = ["RefusedError", "Sink"]


class RefusedError(PmfidError):
    """What a sink raises for an outcome that it will never take, as where a server says that it is none: it is dropped
    and counted, and the others go on."""


class Sink(Protocol):
    """Runs in a thread of its own, behind a bounded queue (`sinks/queued.py`) that drops the oldest rows when it is
    full and counts them, and keeps notices as long as it can: what waits for a broken sink never delays an estimate.

    name: in PLANT.toml. `put` writes what is given, in order; an OSError, which errors of its library are turned into,
    is told once, and all that was given is tried again after a pause with `open` before it. While nothing comes
    `put` is called with nothing, first at the start and then every few seconds. `close` writes what can still be
    written.
    """

    name: str

    def open(self) -> None: ...

    def put(self, outcomes: list[Rows | Notice]) -> None: ...

    def close(self) -> None: ...
