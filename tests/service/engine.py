"""A stand-in for the engine in tests of a source: it keeps deliveries and calls `done` as a checkpoint would."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from threading import Thread
from typing import Any

from pmfid.service.context import Source
from pmfid.stream.delivery import Block, Delivery, Lines, Unusable, split_tables
from tests.patience import PATIENCE


@dataclass
class FakeEngine:
    """A stand-in for the engine.

    `deliveries` are all deliveries so far, and `reported` are the notices. `reached` is the end of the latest block of
    each axis. After `ends` the engine accepts no more, and `slow` is the time of a delivery [s].
    """

    deliveries: list[Delivery] = field(default_factory=list)
    reported: list[dict[str, Any]] = field(default_factory=list)
    reached: dict[str, int] = field(default_factory=dict)
    ends: bool = False
    slow: float = 0.0
    _durable: int = 0

    def take(self, delivery: Delivery) -> bool:
        if self.slow:
            time.sleep(self.slow)
        if not self.ends:
            self.deliveries.append(delivery)
            for item in split_tables(delivery.items):
                if isinstance(item, Block):
                    self.reached[item.axis] = max(item.end, self.reached.get(item.axis, 0))
        return not self.ends

    def checkpoint(self) -> None:
        deliveries = self.deliveries[self._durable :]
        self._durable += len(deliveries)
        for delivery in deliveries:
            if delivery.done is not None:
                delivery.done()

    @property
    def items(self) -> list[Block | Lines | Unusable]:
        return [item for delivery in list(self.deliveries) for item in split_tables(delivery.items)]

    @property
    def blocks(self) -> list[Block]:
        return [item for item in self.items if isinstance(item, Block)]

    def tell(self, what: dict[str, Any]) -> None:
        self.reported.append(what)

    def problems(self) -> list[str]:
        return [one["problem"] for one in self.reported]

    def running(self, source: Source) -> Thread:
        """Start the source's thread and return it."""
        thread = Thread(target=source.run, args=(self.take,), daemon=True)
        thread.start()
        return thread


def wait_for(condition: Callable[[], object], seconds: float = PATIENCE) -> bool:
    """Return whether a condition becomes true in time."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.005)
    return bool(condition())
