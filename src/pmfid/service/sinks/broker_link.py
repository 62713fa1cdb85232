"""A connection to a broker that publishes, and reports its end."""

from __future__ import annotations

import time
from collections.abc import Callable
from threading import Event
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from paho.mqtt.client import Client, MQTTMessageInfo

__all__ = ["BrokerLink"]

#: s that the broker has to take the connection, and to acknowledge what was published.
ANSWER = 10.0


class BrokerLink:
    """One connection at a time, each with a client of its own.

    new: makes a client that is not connected; address, keepalive [s]: of the broker; will: topic and text that the
    broker publishes, retained, when the connection ends without a farewell. All methods raise OSError for what may
    pass.
    """

    def __init__(
        self, new: Callable[[], Client], address: tuple[str, int], keepalive: int, will: tuple[str, bytes]
    ) -> None:
        self._new, self._address, self._keepalive, self._will = new, address, keepalive, will
        self._client: Client | None = None
        self._connected, self._ended = Event(), Event()
        self._problem = ""
        self._acknowledged: list[MQTTMessageInfo] = []  # still to be, of quality of service 1
        self._last: MQTTMessageInfo | None = None

    def open(self) -> None:
        """Ends the last connection, connects again, and waits until the broker agrees."""
        self.drop()
        client = self._client = self._new()
        self._connected, self._ended, self._problem = Event(), Event(), ""
        client.on_connect, client.on_disconnect = self._on_connect, self._on_disconnect
        client.on_publish = self._on_publish
        client.will_set(self._will[0], self._will[1], qos=1, retain=True)
        try:
            client.connect(*self._address, keepalive=self._keepalive)
            client.loop_start()
            if not self._connected.wait(ANSWER):
                raise OSError("the broker does not answer")
            self._check()
        except BaseException:
            self.drop()
            raise

    # Callbacks of an older client, which comes to its end, must not speak for the present one.

    def _on_connect(self, client: Client, data: object, flags: object, reason: Any, properties: object) -> None:
        if client is self._client:
            self._problem = f"the broker refuses the connection: {reason}" if reason.is_failure else ""
            self._connected.set()

    def _on_disconnect(self, client: Client, data: object, flags: object, reason: Any, properties: object) -> None:
        if client is self._client:
            self._problem = self._problem or f"the connection to the broker ended: {reason}"
            self._ended.set()
            self._connected.set()

    def _on_publish(self, client: Client, data: object, number: int, reason: Any, properties: object) -> None:
        if client is self._client and reason.is_failure:
            self._problem = f"the broker refuses a message: {reason}"

    def _check(self) -> Client:
        if self._problem or self._client is None or self._ended.is_set():
            raise OSError(self._problem or "there is no connection to the broker")
        return self._client

    def check(self) -> None:
        """Raises OSError where the connection has ended, or a message was refused."""
        self._check()

    def publish(self, topic: str, payload: bytes, qos: int, retain: bool = False) -> None:
        """Hands over a message; `flush` reports its result."""
        info = self._check().publish(topic, payload, qos, retain)
        if info.rc != 0:
            raise OSError(self._problem or "the connection to the broker ended")
        self._last = info
        if qos:
            self._acknowledged.append(info)

    def flush(self) -> None:
        """Waits until all that was published is on its way, and acknowledged where that was asked for."""
        waiting, self._acknowledged = self._acknowledged, []
        end = time.monotonic() + ANSWER
        for info in [*waiting, *([self._last] if self._last is not None else [])]:
            while not info.is_published():
                self._check()
                if time.monotonic() > end:
                    raise OSError(f"the broker has not taken all within {ANSWER:g} s")
                info.wait_for_publish(0.05)
        self._last = None
        self._check()

    def drop(self) -> None:
        """Ends the connection; the broker then knows that it was meant, and publishes no will."""
        client, self._client = self._client, None
        self._acknowledged, self._last = [], None
        if client is not None:
            client.disconnect()
            client.loop_stop()
