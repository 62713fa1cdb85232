"""Deliveries on their way from the sources to the engine: bounded, so that a source waits rather than memory grows."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from threading import Condition
from time import monotonic

from pmfid.stream.crash import crash_point
from pmfid.stream.delivery import Delivery

__all__ = ["Inbox"]

#: Deliveries that wait at most, and items in them: a source waits while there are as many.
MOST, MOST_ITEMS = 8192, 8192
#: Items that the engine takes at once, but for those of the last delivery: what is stepped stays in the processor's
#: cache; more would be stepped more slowly, and a delay never made up for.
AT_ONCE = 1024
#: The engine takes what came in so much time at once [s]: arrays are filled, and nobody sees the delay.
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
        """Hands over; waits while the inbox is full. False once it is closed: then nothing was taken."""
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
        """What came first, at the earliest TICK after the last call returned some, or as soon as there is enough;
        nothing after `timeout` [s]."""
        with self._changed:
            if not self._waiting and self._open:
                self._changed.wait_for(lambda: self._waiting or not self._open, timeout)
            if self._waiting and self._open and not self._enough:
                rest = self._last + TICK - monotonic()
                self._changed.wait_for(lambda: self._enough or not self._open, max(0.0, rest))
            found = list(self._first())
            self._changed.notify_all()
        if found:
            self._last = monotonic()
        return found

    def _first(self) -> Iterator[Delivery]:
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
        """Whether it takes no more and is empty."""
        return not self._open and not self._waiting

    def close(self) -> None:
        """Takes no more; what waits can still be taken."""
        with self._changed:
            self._open = False
            self._changed.notify_all()
