"""What a service is asked for by signals."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType

__all__ = ["Signals"]


@dataclass
class Signals:
    """What was asked for by a signal."""

    stop: bool = False
    reload: bool = False

    @contextmanager
    def handled(self) -> Iterator[Signals]:
        """SIGINT and SIGTERM end the service, SIGHUP reads PLANT.toml again."""
        hangup = getattr(signal, "SIGHUP", None)
        numbers = [signal.SIGINT, signal.SIGTERM, *([hangup] if hangup is not None else [])]
        before = {number: signal.signal(number, self._handle) for number in numbers}
        try:
            yield self
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if number in (signal.SIGINT, signal.SIGTERM):
            self.stop = True
        else:
            self.reload = True
