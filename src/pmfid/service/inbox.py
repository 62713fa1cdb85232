"""Deliveries on their way from the sources to the engine: bounded, so that a source waits rather than memory grows."""

from __future__ import annotations

from threading import Condition
from time import monotonic

from pmfid.service.crash import crash_point
from pmfid.service.delivery import Delivery

__all__ = ["Inbox"]

#: Deliveries that wait at most, and items in them: a source waits while there are as many. What the engine takes at
#: once stays in the processor's cache; more would be stepped more slowly, and a delay never made up for.
MOST, MOST_ITEMS = 8192, 8192
#: The engine takes what came in so much time at once [s]: arrays are filled, and nobody sees the delay.
TICK = 0.025


class Inbox:
    """`put` by the threads of the sources, `taken` by the engine's."""

    def __init__(self) -> None:
        self._waiting: list[Delivery] = []
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
            if len(self._waiting) == 1 or self._full:
                self._changed.notify_all()
        crash_point("inbox.taken")
        return True

    @property
    def _full(self) -> bool:
        return len(self._waiting) >= MOST or self._items >= MOST_ITEMS

    def taken(self, timeout: float) -> list[Delivery]:
        """All that came, at the earliest TICK after the last call returned some, or as soon as the inbox is full;
        nothing after `timeout` [s]."""
        with self._changed:
            if not self._waiting and self._open:
                self._changed.wait_for(lambda: self._waiting or not self._open, timeout)
            if self._waiting and self._open and not self._full:
                rest = self._last + TICK - monotonic()
                self._changed.wait_for(lambda: self._full or not self._open, max(0.0, rest))
            found, self._waiting, self._items = self._waiting, [], 0
            self._changed.notify_all()
        if found:
            self._last = monotonic()
        return found

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
