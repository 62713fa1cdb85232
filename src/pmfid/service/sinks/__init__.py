"""Receivers of estimates and alarms: one file for each kind of sink."""

from __future__ import annotations

from typing import Protocol

from pmfid.errors import PmfidError
from pmfid.stream.outcome import EstimateRows, Notice

__all__ = ["RefusedError", "Sink"]


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
