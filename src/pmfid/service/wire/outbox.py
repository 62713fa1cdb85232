"""Messages on their way to a broker, and those that it may still forget."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

__all__ = ["Outbox"]


@dataclass
class _Message:
    """payload: blocks; acknowledged: when the broker last said that it has it [s], infinite before; open: not
    acknowledged on this connection."""

    payload: bytes
    acknowledged: float = math.inf
    open: bool = True


@dataclass
class Outbox:
    """Keeps a message until it is acknowledged and the connection has held for `keep` [s] since; at most `most` bytes,
    beyond which the oldest go: dropped counts those that were never acknowledged. clock: gives the time [s]."""

    keep: float
    most: int
    clock: Callable[[], float] = time.monotonic
    dropped: int = 0
    _log: deque[_Message] = field(default_factory=deque, init=False)
    _sent: dict[int, _Message] = field(default_factory=dict, init=False)
    _bytes: int = field(default=0, init=False)
    _next: int = field(default=0, init=False)
    _open: int = field(default=0, init=False)
    _room: int = field(default=0, init=False)

    @property
    def settled(self) -> bool:
        """Whether all is acknowledged."""
        return not self._open

    def take(self, payload: bytes) -> None:
        """A new message."""
        self._log.append(_Message(payload))
        self._bytes += len(payload)
        self._open += 1
        self._forget()

    def begin(self, room: int) -> None:
        """Begins a connection that allows `room` messages under way: all kept messages are sent again, in order."""
        self._room, self._next, self._sent = room, 0, {}
        for message in self._log:
            message.open = True
        self._open = len(self._log)

    def end(self) -> None:
        """The connection is over: nothing goes out, and nothing becomes safe."""
        self._room = 0

    def pump(self, publish: Callable[[bytes], int]) -> bool:
        """Publishes messages while there is room, and notes their numbers. Returns whether there were any."""
        before = self._next
        while self._next < len(self._log) and len(self._sent) < self._room:
            message = self._log[self._next]
            self._sent[publish(message.payload)] = message
            self._next += 1
        return self._next > before

    def note_acknowledged(self, number: int) -> None:
        """The broker has a message."""
        message = self._sent.pop(number, None)
        if message is not None:
            self._open -= message.open
            message.open, message.acknowledged = False, self.clock()
        self._forget()

    def _forget(self) -> None:
        while self._log and (self._is_safe(self._log[0]) or self._bytes > self.most):
            message = self._log.popleft()
            self._bytes -= len(message.payload)
            self._open -= message.open
            message.open = False
            self._next = max(0, self._next - 1)
            self.dropped += math.isinf(message.acknowledged)

    def _is_safe(self, message: _Message) -> bool:
        return self._room > 0 and not message.open and message.acknowledged + self.keep < self.clock()
