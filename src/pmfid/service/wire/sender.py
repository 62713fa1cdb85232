"""A sender that keeps messages that a broker may lose."""

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
    """Samples u, counts and ages (n,) that wait for their block.

    `first` is the number of the first sample, and `time` its time [s]. `edges` is true once ages were given.
    """

    first: int = 0
    time: float = math.nan
    u: Floats = field(default_factory=lambda: np.zeros(0))
    counts: Counts = field(default_factory=lambda: np.zeros(0, np.int64))
    ages: Floats = field(default_factory=lambda: np.zeros(0))
    edges: bool = False


@dataclass
class Numbering:
    """A numbering of each axis's samples from 0, which also makes blocks from the samples.

    `dt` is the sample period [s], `epoch` the epoch of all blocks. `samples` is the number of samples in a block.
    Raises UsageError for a number of samples that no receiver takes.
    """

    dt: float
    epoch: int
    samples: int
    _axes: dict[str, _Axis] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        if not 1 <= self.samples <= MOST_SAMPLES:
            raise UsageError(f"a block must have 1 to {MOST_SAMPLES} samples, got {self.samples}; give another number")

    def add(
        self, axis: str, u: ArrayLike, counts: ArrayLike, time: float, ages: ArrayLike | None = None
    ) -> list[bytes]:
        """Add samples u, counts, ages (n,), or a single sample, and return the full blocks.

        The samples follow the last ones. `time` is the time of the first sample [s], or NaN. `ages` are as in
        `Sender.add`. Raises UsageError for values that no block takes.
        """
        u, counts = np.atleast_1d(np.asarray(u, np.float64)), np.atleast_1d(np.asarray(counts, np.int64))
        if u.ndim != 1 or u.shape != counts.shape:
            raise UsageError(f"u and counts must have the same length, got {u.shape} and {counts.shape}")
        given = np.full(u.shape, np.nan) if ages is None else np.atleast_1d(np.asarray(ages, np.float64))
        if given.shape != u.shape:
            raise UsageError(f"u and ages must have the same length, got {u.shape} and {given.shape}")
        block = Block(axis, self.epoch, 0, time, self.dt, u, counts)
        if u.size and (problem := problem_of(block, u, counts)) is not None:
            raise UsageError(f"a receiver would refuse these samples: {problem.problem}")
        waiting = self._axes.setdefault(axis, _Axis())
        if not waiting.u.size:
            waiting.time = time
        waiting.edges |= ages is not None
        waiting.u, waiting.counts = np.append(waiting.u, u), np.append(waiting.counts, counts)
        waiting.ages = np.append(waiting.ages, given)
        return list(self._blocks(axis, waiting, whole=True))

    def skip(self, axis: str, samples: int) -> list[bytes]:
        """Leave numbers of an axis out, and return the block of its waiting samples before them, if any."""
        waiting = self._axes.setdefault(axis, _Axis())
        made = list(self._blocks(axis, waiting, whole=False))
        waiting.first += samples
        return made

    def rest(self) -> list[bytes]:
        """Return blocks of all waiting samples."""
        return [block for axis, waiting in self._axes.items() for block in self._blocks(axis, waiting, whole=False)]

    @property
    def waits(self) -> bool:
        return any(waiting.u.size for waiting in self._axes.values())

    def _blocks(self, axis: str, waiting: _Axis, whole: bool) -> Iterator[bytes]:
        """Yield blocks of the waiting samples. With `whole`, a last block that is not full keeps waiting."""
        u, counts, begin = waiting.u, waiting.counts, 0
        while u.size - begin >= (self.samples if whole else 1):
            part = slice(begin, begin + self.samples)
            ages = waiting.ages[part] if waiting.edges else None
            block = Block(axis, self.epoch, waiting.first, waiting.time, self.dt, u[part], counts[part], ages)
            begin = begin + block.counts.size
            waiting.first += block.counts.size
            waiting.time += block.counts.size * self.dt
            yield encode(block)
        waiting.u, waiting.counts, waiting.ages = u[begin:], counts[begin:], waiting.ages[begin:]


@dataclass
class _Message:
    """A message of blocks.

    `acknowledged` is the time of the last acknowledgement [s], infinite before the first acknowledgement. `open` is
    true without an acknowledgement on the present connection.
    """

    payload: bytes
    acknowledged: float = math.inf
    open: bool = True


@dataclass
class Outbox:
    """A store that keeps messages until they are safe.

    A message is safe if it is acknowledged and the connection has since held for `keep` [s]. The store has at most
    `most` bytes. Above this limit, the oldest messages are dropped. `dropped` counts the dropped messages that were
    never acknowledged. `clock` returns the time [s].
    """

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
    _proven: bool = field(default=False, init=False)

    @property
    def settled(self) -> bool:
        """Whether all messages are acknowledged."""
        return not self._open

    def take(self, payload: bytes) -> None:
        self._log.append(_Message(payload))
        self._bytes += len(payload)
        self._open += 1
        self._forget()

    def begin(self, room: int) -> None:
        """Begin a connection that allows `room` messages in transit. All kept messages are sent again, in order.

        The first message travels alone. A broker that has forgotten its sessions may have no receiver for this message
        but have a receiver for the next message, which would arrive after a hole.
        """
        self._room, self._next, self._sent = room, 0, {}
        self._proven = False
        for message in self._log:
            message.open = True
        self._open = len(self._log)

    def end(self) -> None:
        """Note the end of the connection, after which no message is sent or becomes safe."""
        self._room = 0

    def pump(self, publish: Callable[[bytes], int]) -> bool:
        """Publish messages while the connection has room, and note their numbers. Returns whether any message was
        published.
        """
        before = self._next
        while self._next < len(self._log) and len(self._sent) < (self._room if self._proven else min(self._room, 1)):
            message = self._log[self._next]
            self._sent[publish(message.payload)] = message
            self._next += 1
        return self._next > before

    def note_acknowledged(self, number: int) -> None:
        """Note that the broker has a message."""
        self._proven = True
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
    """A sender of samples with the period dt [s] to a topic. As a context manager it flushes at the end.

    `epoch` rises whenever the numbers restart. None takes the time of day. `samples` is the number of samples in a
    block. A message is sent at `size` bytes, at the latest after `delay` [s]. An acknowledged message is forgotten when
    the connection has since held for `keep` [s]. `keep` must be longer than the broker's autosave_interval. `most` is
    the largest number of kept bytes. Above this limit, the oldest messages are dropped and counted in `dropped`.
    Methods may be called from any thread. Raises UsageError for sizes that no receiver takes, and without paho-mqtt.
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
        self._lock = Lock()  # protects the blocks that wait for their message
        self._blocks: list[bytes] = []
        self._bytes, self._since = 0, math.inf
        self._events: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._client: Client | None = None
        self._idle, self._closed = Event(), False
        self._make_client()  # refuses settings that cannot work
        self._thread = Thread(target=self._run, name="pmfid-sender", daemon=True)
        self._thread.start()

    @property
    def dropped(self) -> int:
        """Number of messages that were dropped without an acknowledgement, for lack of room."""
        return self._outbox.dropped

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def add(
        self,
        axis: str,
        u: ArrayLike,
        counts: ArrayLike,
        time: float = math.nan,
        *,
        ages: ArrayLike | None = None,
    ) -> None:
        """Add the next samples u, counts (n,) of an axis, or a single sample.

        `time` is the time of the first sample [s], or NaN. `ages` (n,) is the time from the last edge of the encoder to
        the sample [s], NaN without an edge. Raises UsageError for values that no block takes.
        """
        with self._lock:
            self._wait(self._numbering.add(axis, u, counts, time, ages))

    def skip(self, axis: str, samples: int) -> None:
        """Leave out the numbers of samples of an axis that were lost before they reached the sender."""
        with self._lock:
            self._wait(self._numbering.skip(axis, samples))

    def flush(self, timeout: float = 10.0) -> bool:
        """Send all waiting samples, and wait until the broker has acknowledged them.

        Returns False if this takes longer than `timeout` [s].
        """
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
        """Collect blocks until they suffice for a message. The caller holds the lock."""
        for block in blocks:
            self._blocks.append(block)
            self._bytes += len(block)
            if self._bytes >= self._size:
                self._message()
        if self._blocks or self._numbering.waits:
            self._since = min(self._since, time.monotonic())

    def _complete(self) -> None:
        """Make a message of all waiting samples. The caller holds the lock."""
        self._wait(self._numbering.rest())
        if self._blocks:
            self._message()
        self._since = math.inf

    def _message(self) -> None:
        payload, self._blocks, self._bytes = b"".join(self._blocks), [], 0
        self._events.put(lambda: self._outbox.take(payload))

    # The methods below run in the sender's own thread. The thread of paho and the callers only leave events.

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
        """Handle the present events, or the next event if it comes soon."""
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
        """Connect with a new client each time, because paho's own client would repeat its messages in another order."""
        try:
            client = self._make_client()
        except UsageError as error:  # a missing file of the password
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
        self._events.put(lambda: self._note_lost(client, f"the connection to the broker ended: {reason}"))

    def _begin(self, client: Client, room: int) -> None:
        if client is self._client:
            self._outbox.begin(room)
            self.problem = ""

    def _note_acknowledged(self, client: Client, mid: int, reason: ReasonCode) -> None:
        if client is not self._client:
            return
        if reason.is_failure or reason.value == TUNING.sender_nobody:
            self._note_lost(client, f"the broker does not accept messages: {reason}")
            return
        self._outbox.note_acknowledged(mid)
        self._settle()

    def _settle(self) -> None:
        """Signal to `flush` that all messages are acknowledged."""
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
