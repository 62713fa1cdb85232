"""A sender that keeps what a broker may forget."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Event, Lock, Thread
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import ArrayLike

from pmfid.errors import UsageError
from pmfid.service.broker import BrokerSection, new_client, pauses
from pmfid.service.tuning import TUNING
from pmfid.stream.blocks import MOST_SAMPLES, encode, problem_of
from pmfid.stream.delivery import Block
from pmfid.types import Counts, Floats

if TYPE_CHECKING:
    from paho.mqtt.client import Client, ConnectFlags, DisconnectFlags
    from paho.mqtt.properties import Properties
    from paho.mqtt.reasoncodes import ReasonCode


@dataclass
class _Axis:
    """Samples that wait for their block. first: number of the first sample; time: of it [s]; u, counts: (n,)."""

    first: int = 0
    time: float = math.nan
    u: Floats = field(default_factory=lambda: np.zeros(0))
    counts: Counts = field(default_factory=lambda: np.zeros(0, np.int64))


@dataclass
class Numbering:
    """Numbers the samples of each axis from 0 on, and makes blocks of them. dt: sample period [s]; epoch: of all
    blocks; samples: of a block. Raises UsageError for a number of samples that no receiver takes."""

    dt: float
    epoch: int
    samples: int
    _axes: dict[str, _Axis] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        if not 1 <= self.samples <= MOST_SAMPLES:
            raise UsageError(f"a block has 1 to {MOST_SAMPLES} samples, got {self.samples}; give another number")

    def add(self, axis: str, u: ArrayLike, counts: ArrayLike, time: float) -> list[bytes]:
        """The blocks that are full with samples u, counts (n,), or one of each, that follow the last ones; time: of the
        first [s], NaN for none. Raises UsageError for what no block takes."""
        u, counts = np.atleast_1d(np.asarray(u, np.float64)), np.atleast_1d(np.asarray(counts, np.int64))
        if u.ndim != 1 or u.shape != counts.shape:
            raise UsageError(f"u and counts are not of one length: {u.shape} and {counts.shape}")
        block = Block(axis, self.epoch, 0, time, self.dt, u, counts)
        if u.size and (problem := problem_of(block, u, counts)) is not None:
            raise UsageError(f"a receiver would refuse these samples: {problem.problem}")
        waiting = self._axes.setdefault(axis, _Axis())
        if not waiting.u.size:
            waiting.time = time
        waiting.u, waiting.counts = np.append(waiting.u, u), np.append(waiting.counts, counts)
        return list(self._blocks(axis, waiting, whole=True))

    def skip(self, axis: str, samples: int) -> list[bytes]:
        """Leaves numbers of an axis out. Returns the block of its waiting samples before them, if there is one."""
        waiting = self._axes.setdefault(axis, _Axis())
        made = list(self._blocks(axis, waiting, whole=False))
        waiting.first += samples
        return made

    def rest(self) -> list[bytes]:
        """Blocks of all that waits."""
        return [block for axis, waiting in self._axes.items() for block in self._blocks(axis, waiting, whole=False)]

    @property
    def waits(self) -> bool:
        return any(waiting.u.size for waiting in self._axes.values())

    def _blocks(self, axis: str, waiting: _Axis, whole: bool) -> Iterator[bytes]:
        """Blocks of what waits, but for the last one that is not full (whole)."""
        u, counts, begin = waiting.u, waiting.counts, 0
        while u.size - begin >= (self.samples if whole else 1):
            part = slice(begin, begin + self.samples)
            block = Block(axis, self.epoch, waiting.first, waiting.time, self.dt, u[part], counts[part])
            begin = begin + block.counts.size
            waiting.first += block.counts.size
            waiting.time += block.counts.size * self.dt
            yield encode(block)
        waiting.u, waiting.counts = u[begin:], counts[begin:]


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
        while self._log and (self._bytes > self.most or self._is_safe(self._log[0])):
            message = self._log.popleft()
            self._bytes -= len(message.payload)
            self._open -= message.open
            message.open = False
            self._next = max(0, self._next - 1)
            self.dropped += math.isinf(message.acknowledged)

    def _is_safe(self, message: _Message) -> bool:
        return self._room > 0 and not message.open and message.acknowledged + self.keep < self.clock()


class Sender:
    """Sends samples of axes with the sample period dt [s] to a topic; a context manager, which flushes at its end.

    epoch: raised whenever the numbers restart, None: the time of day; samples: of a block; size: bytes of a message
    from which on it is sent; delay: after which it is sent at the latest [s]; keep: a message that is acknowledged is
    forgotten when the connection has held for this time since [s], which must be more than the broker's
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
        self.topic, self.problem = topic, ""
        self._broker, self._folder, self._name = broker or BrokerSection(), folder or Path(), client
        self._size, self._delay = size, delay
        self._numbering = Numbering(dt, int(time.time()) if epoch is None else epoch, samples)
        self._outbox = Outbox(keep, most)
        self._lock = Lock()  # of what waits for its message
        self._blocks: list[bytes] = []
        self._bytes, self._since = 0, math.inf
        self._events: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._client: Client | None = None
        self._idle, self._closed = Event(), False
        self._make_client()  # what cannot work is refused here
        self._thread = Thread(target=self._run, name="pmfid-sender", daemon=True)
        self._thread.start()

    @property
    def dropped(self) -> int:
        """Messages that went without an acknowledgement, for want of room."""
        return self._outbox.dropped

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def add(self, axis: str, u: ArrayLike, counts: ArrayLike, time: float = math.nan) -> None:
        """Takes samples of an axis that follow its last ones: u, counts (n,) or one of each; time: of the first [s],
        NaN where there is none. Raises UsageError for what no block takes."""
        with self._lock:
            self._wait(self._numbering.add(axis, u, counts, time))

    def skip(self, axis: str, samples: int) -> None:
        """Leaves out the numbers of samples of an axis that were lost before they came here."""
        with self._lock:
            self._wait(self._numbering.skip(axis, samples))

    def flush(self, timeout: float = 10.0) -> bool:
        """Sends what waits, and waits itself until the broker has acknowledged all of it; False if it has not within
        `timeout` [s]."""
        with self._lock:
            self._complete()
        self._idle.clear()
        self._events.put(self._settle)
        return self._idle.wait(timeout)

    def close(self, timeout: float = 10.0) -> bool:
        """Flush, and end the connection."""
        done = self.flush(timeout)
        self._closed = True
        self._events.put(lambda: None)
        self._thread.join()
        return done

    def _wait(self, blocks: list[bytes]) -> None:
        """Blocks that wait until there are enough for a message; with the lock."""
        for block in blocks:
            self._blocks.append(block)
            self._bytes += len(block)
            if self._bytes >= self._size:
                self._message()
        if self._blocks or self._numbering.waits:
            self._since = min(self._since, time.monotonic())

    def _complete(self) -> None:
        """Makes a message of all that waits; with the lock."""
        self._wait(self._numbering.rest())
        if self._blocks:
            self._message()
        self._since = math.inf

    def _message(self) -> None:
        payload, self._blocks, self._bytes = b"".join(self._blocks), [], 0
        self._events.put(lambda: self._outbox.take(payload))

    # what follows runs in the sender's own thread; paho's thread and the callers only leave events

    def _run(self) -> None:
        waiting, retry = pauses(longest=TUNING.sender_longest_pause), 0.0
        while not self._closed:
            if self._client is None and time.monotonic() >= retry:
                retry = time.monotonic() + next(waiting)
                self._connect()
            self._handle_events()
            if self._since + self._delay < time.monotonic():
                with self._lock:
                    self._complete()
            if self._client is not None and self._outbox.pump(self._publisher(self._client)):
                waiting = pauses(longest=TUNING.sender_longest_pause)
        if self._client is not None:
            self._disconnect(self._client)

    def _handle_events(self) -> None:
        """Those that are there, or the next one if it comes soon."""
        try:
            self._events.get(timeout=max(self._delay / 2, 0.01))()
            while True:
                self._events.get_nowait()()
        except Empty:
            pass

    def _publisher(self, client: Client) -> Callable[[bytes], int]:
        return lambda payload: client.publish(self.topic, payload, qos=1).mid

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
        self._client = client
        client.loop_start()

    def _on_connect(
        self, client: Client, _: object, flags: ConnectFlags, reason: ReasonCode, properties: Properties | None
    ) -> None:
        room = getattr(properties, "ReceiveMaximum", 65535)
        if not reason.is_failure:
            self._events.put(lambda: self._begin(client, min(room, TUNING.under_way)))

    def _on_publish(self, client: Client, _: object, mid: int, reason: ReasonCode, properties: Properties) -> None:
        self._events.put(lambda: self._note_acknowledged(client, mid, reason))

    def _on_lost(
        self, client: Client, _: object, flags: DisconnectFlags, reason: ReasonCode, properties: Properties | None
    ) -> None:
        self._events.put(lambda: self._note_lost(client, f"the connection ended: {reason}"))

    def _begin(self, client: Client, room: int) -> None:
        if client is self._client:
            self._outbox.begin(room)
            self.problem = ""

    def _note_acknowledged(self, client: Client, mid: int, reason: ReasonCode) -> None:
        if client is not self._client:
            return
        if reason.is_failure or reason.value == TUNING.sender_nobody:
            self._note_lost(client, f"the broker does not take messages: {reason}")
            return
        self._outbox.note_acknowledged(mid)
        self._settle()

    def _settle(self) -> None:
        """Whether all is acknowledged, for `flush`."""
        if self._outbox.settled:
            self._idle.set()

    def _note_lost(self, client: Client, problem: str) -> None:
        if client is self._client:
            self._client, self.problem = None, problem
            self._outbox.end()
            self._disconnect(client)

    def _disconnect(self, client: Client) -> None:
        client.disconnect()
        client.loop_stop()
