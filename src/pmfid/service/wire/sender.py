"""Samples of many axes to a broker, for gateways and tests: numbered, in blocks, many blocks in a message.

A message is kept until it is acknowledged, and for some time after it: a killed broker forgets messages that it had not
saved yet. After every new connection all kept messages are sent again, in order; a receiver knows the numbers.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Event, Lock, Thread
from typing import TYPE_CHECKING

from numpy.typing import ArrayLike

from pmfid.errors import UsageError
from pmfid.service.broker import BrokerSection, new_client, pauses
from pmfid.service.wire.numbering import Numbering
from pmfid.service.wire.outbox import Outbox

if TYPE_CHECKING:
    from paho.mqtt.client import Client, ConnectFlags, DisconnectFlags
    from paho.mqtt.properties import Properties
    from paho.mqtt.reasoncodes import ReasonCode

__all__ = ["Sender"]

#: Messages under way that the broker has not acknowledged, where it does not ask for less.
_UNDER_WAY = 100
#: Answer of the broker to a message without a subscriber, which is lost.
_NOBODY = 0x10
#: Pause between two attempts to connect, at most [s].
_LONGEST_PAUSE = 5.0


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

    def __enter__(self) -> Sender:
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
        """As `flush`, and ends the connection."""
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
        waiting, retry = pauses(longest=_LONGEST_PAUSE), 0.0
        while not self._closed:
            if self._client is None and time.monotonic() >= retry:
                retry = time.monotonic() + next(waiting)
                self._connect()
            self._handle_events()
            if self._since + self._delay < time.monotonic():
                with self._lock:
                    self._complete()
            if self._client is not None and self._outbox.pump(self._publisher(self._client)):
                waiting = pauses(longest=_LONGEST_PAUSE)
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
            self._events.put(lambda: self._begin(client, min(room, _UNDER_WAY)))

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
        if reason.is_failure or reason.value == _NOBODY:
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
