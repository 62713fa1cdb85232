"""What a service is asked for by signals."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType

from pmfid.session.monitored.stream import caught

__all__ = ["Signals"]


@dataclass
class Signals:
    """What was asked for by a signal."""

    stop: bool = False
    reload: bool = False

    @contextmanager
    def handled(self) -> Iterator[Signals]:
        """SIGINT and SIGTERM end the service, SIGHUP reads PLANT.toml again."""
        with caught(self._handle):
            yield self

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if number in (signal.SIGINT, signal.SIGTERM):
            self.stop = True
        else:
            self.reload = True
