"""Samples of many axes to a broker, for gateways and tests: numbered, in blocks, many blocks in a message.

What the broker has not acknowledged is kept, and what it has for a while longer: a broker that is killed forgets what
it had not saved yet. After every new connection all of that is sent again, in order; a receiver knows the numbers.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Event, Lock, Thread
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from pmfid.errors import UsageError
from pmfid.service.broker import BrokerSection, new_client, pauses
from pmfid.service.delivery import Block
from pmfid.service.wire.blocks import MOST_SAMPLES, encode, problem_of

if TYPE_CHECKING:
    from paho.mqtt.client import Client, ConnectFlags, DisconnectFlags
    from paho.mqtt.properties import Properties
    from paho.mqtt.reasoncodes import ReasonCode

__all__ = ["Sender"]

#: Messages under way that the broker has not acknowledged, where it does not ask for less.
_UNDER_WAY = 100
#: What the broker answers where nobody has subscribed, so that the message is gone.
_NOBODY = 0x10


@dataclass
class _Axis:
    """Samples that wait for their block. first: number of the first; time: of the first [s]."""

    first: int = 0
    time: float = math.nan
    u: list[float] = field(default_factory=list)
    counts: list[int] = field(default_factory=list)


@dataclass
class _Message:
    """payload: blocks; acknowledged: when the broker last said that it has it [s], by `time.monotonic`, infinite
    before; open: not acknowledged on this connection."""

    payload: bytes
    acknowledged: float = math.inf
    open: bool = True


class Sender:
    """Sends samples of axes with the sample period dt [s] to a topic; a context manager, which flushes at its end.

    epoch: raised whenever the numbers begin anew, None: the time of day; samples: of a block; size: bytes of a message
    from which on it is sent; delay: after which it is sent at the latest [s]; keep: a message that is acknowledged is
    forgotten when the connection has held for so long since [s], which must be more than the broker's
    autosave_interval; most: bytes that are kept at most, beyond which the oldest messages are dropped, and counted in
    `dropped`. Methods may be called from any thread. Raises UsageError for sizes that no receiver takes, and without
    paho-mqtt.
    """

    def __init__(
        self,
        topic: str,
        dt: float,
        broker: BrokerSection | None = None,
        *,
        client: str = "",
        folder: Path | None = None,
        epoch: int | None = None,
        samples: int = 50,
        size: int = 2**16,
        delay: float = 0.2,
        keep: float = 60.0,
        most: int = 2**28,
    ) -> None:
        if not 1 <= samples <= MOST_SAMPLES:
            raise UsageError(f"a block has 1 to {MOST_SAMPLES} samples, got {samples}; give another number")
        self.topic, self.dt, self.dropped, self.problem = topic, dt, 0, ""
        self.epoch = int(time.time()) if epoch is None else epoch
        self._broker, self._folder, self._name = broker or BrokerSection(), folder or Path(), client
        self._samples, self._size, self._delay, self._keep, self._most = samples, size, delay, keep, most
        self._lock = Lock()
        self._axes: dict[str, _Axis] = {}
        self._blocks: list[bytes] = []
        self._since = math.inf
        self._events: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._log: deque[_Message] = deque()
        self._bytes = self._next = self._open = 0
        self._sent: dict[int, _Message] = {}
        self._client: Client | None = None
        self._idle, self._closed = Event(), False
        self._make_client()  # what cannot work is refused here
        self._thread = Thread(target=self._run, name="pmfid-sender", daemon=True)
        self._thread.start()

    def __enter__(self) -> Sender:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def add(self, axis: str, u: ArrayLike, counts: ArrayLike, time: float = math.nan) -> None:
        """Takes samples of an axis that follow its last ones: u, counts (n,) or one of each; time: of the first [s],
        NaN where there is none. Raises UsageError for what no block takes."""
        u, counts = np.atleast_1d(np.asarray(u, np.float64)), np.atleast_1d(np.asarray(counts, np.int64))
        problem = problem_of(Block(axis, self.epoch, 0, time, self.dt, u, counts), u, counts) if u.size else None
        if problem is not None or u.shape != counts.shape or u.ndim != 1:
            raise UsageError(
                problem.problem if problem else f"u and counts are not of one length: {u.shape}, {counts.shape}"
            )
        with self._lock:
            waiting = self._axes.setdefault(axis, _Axis())
            if not waiting.u:
                waiting.time = time
            waiting.u += u.tolist()
            waiting.counts += counts.tolist()
            while len(waiting.u) >= self._samples:
                self._block(axis, waiting, self._samples)
            if waiting.u:
                self._since = min(self._since, _now())

    def skip(self, axis: str, samples: int) -> None:
        """So many samples of an axis were lost before they came here: their numbers are left out."""
        with self._lock:
            waiting = self._axes.setdefault(axis, _Axis())
            if waiting.u:
                self._block(axis, waiting, len(waiting.u))
            waiting.first += samples

    def flush(self, timeout: float = 10.0) -> bool:
        """Sends what waits, and waits itself until the broker has acknowledged all of it; False if it has not within
        `timeout` [s]."""
        with self._lock:
            self._complete()
        self._idle.clear()
        self._events.put(self._settle)
        return self._idle.wait(timeout)

    def close(self, timeout: float = 10.0) -> bool:
        """As `flush`, and ends the connection."""
        done = self.flush(timeout)
        self._closed = True
        self._events.put(lambda: None)
        self._thread.join()
        return done

    def _block(self, axis: str, waiting: _Axis, n: int) -> None:
        """Makes a block of the first n samples that wait; with the lock."""
        u, counts = np.array(waiting.u[:n]), np.array(waiting.counts[:n], np.int64)
        block = Block(axis, self.epoch, waiting.first, waiting.time, self.dt, u, counts)
        del waiting.u[:n], waiting.counts[:n]
        waiting.first += n
        waiting.time += n * self.dt
        self._blocks.append(encode(block))
        self._since = min(self._since, _now())
        if sum(map(len, self._blocks)) >= self._size:
            self._message()

    def _complete(self) -> None:
        """Makes blocks and a message of all that waits; with the lock."""
        for axis, waiting in self._axes.items():
            if waiting.u:
                self._block(axis, waiting, len(waiting.u))
        if self._blocks:
            self._message()
        self._since = math.inf

    def _message(self) -> None:
        payload, self._blocks = b"".join(self._blocks), []
        self._events.put(lambda: self._take(payload))

    # what follows runs in the sender's own thread; paho's thread and the callers only leave events

    def _run(self) -> None:
        waiting, retry = pauses(longest=5.0), 0.0
        while not self._closed:
            if self._client is None and _now() >= retry:
                retry = _now() + next(waiting)
                self._connect()
            try:
                self._events.get(timeout=max(self._delay / 2, 0.01))()
                while True:
                    self._events.get_nowait()()
            except Empty:
                pass
            if self._since + self._delay < _now():
                with self._lock:
                    self._complete()
            if self._next:
                waiting = pauses(longest=5.0)
            self._pump()
        if self._client is not None:
            self._disconnect(self._client)

    def _make_client(self) -> Client:
        return new_client(self._broker, self._folder, self._name)

    def _connect(self) -> None:
        """A new client each time: one of paho's own would send again what it has, without regard to the order."""
        try:
            client = self._make_client()
        except UsageError as error:  # a file of the password that was there before
            self.problem = str(error)
            return
        client.max_inflight_messages_set(0)
        client.on_connect, client.on_publish, client.on_disconnect = self._on_connect, self._on_publish, self._on_lost
        try:
            client.connect(*self._broker.address, self._broker.keepalive)
        except (OSError, ValueError) as error:
            self.problem = f"no connection to {self._broker.host}: {error}"
            return
        self._client, self._room = client, 0
        client.loop_start()

    def _on_connect(
        self, client: Client, _: object, flags: ConnectFlags, reason: ReasonCode, properties: Properties | None
    ) -> None:
        room = getattr(properties, "ReceiveMaximum", 65535)
        if not reason.is_failure:
            self._events.put(lambda: self._begin(client, min(room, _UNDER_WAY)))

    def _on_publish(self, client: Client, _: object, mid: int, reason: ReasonCode, properties: Properties) -> None:
        self._events.put(lambda: self._acknowledged(client, mid, reason))

    def _on_lost(
        self, client: Client, _: object, flags: DisconnectFlags, reason: ReasonCode, properties: Properties | None
    ) -> None:
        self._events.put(lambda: self._lost(client, f"the connection ended: {reason}"))

    def _begin(self, client: Client, room: int) -> None:
        """All that is kept goes out again, from the oldest on."""
        if client is not self._client:
            return
        self._room, self._next, self._sent, self.problem = room, 0, {}, ""
        for message in self._log:
            message.open = True
        self._open = len(self._log)

    def _pump(self) -> None:
        """Publishes as many messages as may be under way."""
        if self._client is None:
            return
        while self._next < len(self._log) and len(self._sent) < self._room:
            message = self._log[self._next]
            info = self._client.publish(self.topic, message.payload, qos=1)
            self._sent[info.mid] = message
            self._next += 1

    def _take(self, payload: bytes) -> None:
        self._log.append(_Message(payload))
        self._bytes += len(payload)
        self._open += 1
        self._forget()

    def _acknowledged(self, client: Client, mid: int, reason: ReasonCode) -> None:
        message = self._sent.get(mid)
        if client is not self._client or message is None:
            return
        if reason.is_failure or reason.value == _NOBODY:
            self._lost(client, f"the broker does not take messages: {reason}")
            return
        del self._sent[mid]
        self._open -= message.open
        message.open = False
        message.acknowledged = _now()
        self._settle()

    def _settle(self) -> None:
        """Whether all is acknowledged, for `flush`."""
        if not self._open:
            self._idle.set()
        self._forget()

    def _lost(self, client: Client, problem: str) -> None:
        if client is self._client:
            self._client, self.problem = None, problem
            self._disconnect(client)

    def _disconnect(self, client: Client) -> None:
        client.disconnect()
        client.loop_stop()

    def _forget(self) -> None:
        """What has been acknowledged for long enough, on this connection: while it is down, the broker saves nothing.
        And the oldest messages where there is no more room."""
        while self._log and (self._is_safe(self._log[0]) or self._bytes > self._most):
            message = self._log.popleft()
            self._bytes -= len(message.payload)
            self._open -= message.open
            self._next = max(0, self._next - 1)
            self.dropped += math.isinf(message.acknowledged)

    def _is_safe(self, message: _Message) -> bool:
        return self._client is not None and not message.open and message.acknowledged + self._keep < _now()


def _now() -> float:
    return time.monotonic()
