"""Send messages of samples to a broker that may be killed: a gateway to adapt.

    python examples/gateway.py      # sends ten seconds of a resting axis to the topic hall-3/blocks

A killed broker forgets the messages since its last save, even acknowledged ones. The gateway therefore keeps them for
a while, and sends them again after each new connection. The service recognises repeated samples by their numbers.
"""

from __future__ import annotations

import time
from collections import deque
from contextlib import suppress
from queue import Empty, Queue, SimpleQueue
from threading import Thread
from typing import Any

import numpy as np
import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion

from pmfid.stream.blocks import encode
from pmfid.stream.delivery import Block


class Gateway(Thread):
    """A sender of messages in order, one at a time. `send` may be called from any thread.

    `keep` is the time for which acknowledged messages are kept [s], longer than the broker's autosave_interval.
    """

    def __init__(self, topic: str, host: str = "127.0.0.1", port: int = 1883, keep: float = 60.0) -> None:
        super().__init__(daemon=True)
        self.topic, self.host, self.port, self.keep = topic, host, port, keep
        self.waiting: Queue[bytes] = Queue()  # `waiting.join()` returns when the broker has all messages
        self.kept: deque[list[Any]] = deque()  # [time of the acknowledgement or None, message]
        self.start()

    def send(self, message: bytes) -> None:
        self.waiting.put(message)

    def run(self) -> None:
        while True:
            with suppress(OSError, Empty):
                self._hold_connection()
            time.sleep(0.5)

    def _hold_connection(self) -> None:
        """Send all kept messages, then the new ones, until the connection ends. Raises OSError or Empty."""
        answers: SimpleQueue[Any] = SimpleQueue()  # reasons of the broker: of the connection, of messages, of the end
        client = mqtt.Client(CallbackAPIVersion.VERSION2, protocol=mqtt.MQTTv5, reconnect_on_failure=False)
        client.on_connect = client.on_publish = client.on_disconnect = lambda *given: answers.put(given[3])
        client.connect(self.host, self.port)
        client.loop_start()
        try:
            _check(answers.get(timeout=10))
            for entry in list(self.kept):
                self._publish(client, answers, entry)
            while True:
                self.kept.append([None, self.waiting.get()])
                self._publish(client, answers, self.kept[-1])
                while self.kept[0][0] < time.monotonic() - self.keep:
                    self.kept.popleft()
        finally:
            client.loop_stop()

    def _publish(self, client: mqtt.Client, answers: SimpleQueue[Any], entry: list[Any]) -> None:
        client.publish(self.topic, entry[1], qos=1)
        _check(answers.get(timeout=10))
        if entry[0] is None:
            self.waiting.task_done()
        entry[0] = time.monotonic()


def _check(reason: Any) -> None:
    """Raise OSError for any answer but success. The broker answers 16 for a message without a subscriber."""
    if reason.value:
        raise OSError(str(reason))


if __name__ == "__main__":
    gateway, epoch = Gateway("hall-3/blocks"), int(time.time())
    for first in range(0, 500, 25):
        block = Block("cart-00", epoch, first, time.time(), 0.02, np.zeros(25), np.zeros(25, np.int64))
        gateway.send(encode(block))
        time.sleep(0.5)
    gateway.waiting.join()
