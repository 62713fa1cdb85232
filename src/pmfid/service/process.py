"""The process of a service and its system: signals, systemd, and that it stood still."""

from __future__ import annotations

import os
import signal
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from time import monotonic
from types import FrameType
from typing import Any

from pmfid.pipeline.monitored.stream import catch_signals
from pmfid.service.tuning import TUNING
from pmfid.stream.commands import Counters

__all__ = ["PauseWatch", "SignalRequests", "notify"]


@dataclass
class SignalRequests:
    """Requests by signals."""

    stop: bool = False
    reload: bool = False

    @contextmanager
    def catch(self) -> Iterator[SignalRequests]:
        """SIGINT and SIGTERM end the service, SIGHUP reads PLANT.toml again."""
        with catch_signals(self._handle):
            yield self

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if number in (signal.SIGINT, signal.SIGTERM):
            self.stop = True
        else:
            self.reload = True


@dataclass
class PauseWatch:
    """Reports pauses of the whole process, the only explanation for late estimates. `look` is called regularly."""

    tell: Callable[[dict[str, Any]], None]
    counters: Counters
    _looked: float = field(default_factory=monotonic, init=False)

    def look(self) -> None:
        """Tests the time since the last call."""
        now = monotonic()
        stood, self._looked = now - self._looked, now
        if stood > TUNING.process_stood:
            problem = f"the service stood still for {stood:.0f} s: it was stopped, or its machine had no time for it"
            self.tell({"event": "paused", "seconds": round(stood, 1), "problem": problem})
            self.counters.add("pmfid_paused_seconds_total", stood)


def notify(state: str) -> None:
    """Sends a state as sd_notify(3) does, as "READY=1"; does nothing without a listener."""
    address = os.environ.get("NOTIFY_SOCKET", "")
    if not address:
        return
    with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as channel:
        channel.connect("\0" + address[1:] if address.startswith("@") else address)
        channel.send(state.encode())
