"""Deliveries on their way from the sources to the engine: bounded, so that a source waits rather than memory grows."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from threading import Condition
from time import monotonic

from pmfid.stream.crash import crash_point
from pmfid.stream.delivery import Delivery

__all__ = ["Inbox"]

#: Most deliveries that wait, and most items in them: beyond, the sources wait.
MOST, MOST_ITEMS = 8192, 8192
#: Items that the engine takes at once, apart from those of the last delivery. They fit into the processor's cache; more
#: items would be stepped more slowly, and a backlog would remain.
AT_ONCE = 1024
#: Time over which deliveries are collected [s]: it fills the arrays, and the delay does not show.
TICK = 0.025


class Inbox:
    """`put` by the threads of the sources, `take_deliveries` by the engine's."""

    def __init__(self) -> None:
        self._waiting: deque[Delivery] = deque()
        self._items = 0
        self._open = True
        self._changed = Condition()
        self._last = 0.0

    def put(self, delivery: Delivery) -> bool:
        """Hands over a delivery; waits while the inbox is full. False, without the delivery, once it is closed."""
        with self._changed:
            while self._open and self._full:
                self._changed.wait()
            if not self._open:
                return False
            self._waiting.append(delivery)
            self._items += delivery.size
            if len(self._waiting) == 1 or self._enough:
                self._changed.notify_all()
        crash_point("inbox.taken")
        return True

    @property
    def _full(self) -> bool:
        return len(self._waiting) >= MOST or self._items >= MOST_ITEMS

    @property
    def _enough(self) -> bool:
        return self._items >= AT_ONCE or self._full

    def take_deliveries(self, timeout: float) -> list[Delivery]:
        """The oldest deliveries, at the earliest TICK after the last ones, or as soon as AT_ONCE items wait; none after
        `timeout` [s]."""
        with self._changed:
            if not self._waiting and self._open:
                self._changed.wait_for(lambda: self._waiting or not self._open, timeout)
            if self._waiting and self._open and not self._enough:
                rest = self._last + TICK - monotonic()
                self._changed.wait_for(lambda: self._enough or not self._open, max(0.0, rest))
            deliveries = list(self._pop_first())
            self._changed.notify_all()
        if deliveries:
            self._last = monotonic()
        return deliveries

    def _pop_first(self) -> Iterator[Delivery]:
        items = 0
        while self._waiting and items < AT_ONCE:
            delivery = self._waiting.popleft()
            items += delivery.size
            self._items -= delivery.size
            yield delivery

    def __len__(self) -> int:
        return len(self._waiting)

    @property
    def closed(self) -> bool:
        """Whether the inbox is closed and empty."""
        return not self._open and not self._waiting

    def close(self) -> None:
        """Refuses further deliveries; the waiting ones can still be taken."""
        with self._changed:
            self._open = False
            self._changed.notify_all()
