"""A sink that publishes rows and events to an MQTT broker."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from functools import partial
from threading import Event
from typing import TYPE_CHECKING, Any, Literal
from urllib.parse import quote

from pydantic import Field

from pmfid.monitor.events import STATES
from pmfid.presentation import as_json
from pmfid.service.broker import BrokerSection, Text, new_client
from pmfid.service.context import Context
from pmfid.service.sinks.plain import notice_object, row_objects
from pmfid.service.sinks.queued import SinkSection
from pmfid.service.tuning import TUNING
from pmfid.stream.outcome import EstimateRows, Notice
from pmfid.stream.sentences import notice_sentence

if TYPE_CHECKING:
    from paho.mqtt.client import Client, MQTTMessageInfo


class BrokerLink:
    """A connection to a broker, one at a time. Each connection has its own client.

    `new` makes a client that is not connected. `address` and `keepalive` [s] belong to the broker. `will` is the topic
    and text that the broker publishes, retained, when the connection ends without a farewell. All methods raise OSError
    for errors that may pass.
    """

    def __init__(
        self, new: Callable[[], Client], address: tuple[str, int], keepalive: int, will: tuple[str, bytes]
    ) -> None:
        self._new, self._address, self._keepalive, self._will = new, address, keepalive, will
        self._client: Client | None = None
        self._connected, self._ended = Event(), Event()
        self._problem = ""
        self._acknowledged: list[MQTTMessageInfo] = []  # messages of quality of service 1 without an acknowledgement
        self._last: MQTTMessageInfo | None = None

    def open(self) -> None:
        """End the last connection, connect again, and wait until the broker accepts."""
        self.drop()
        client = self._client = self._new()
        self._connected, self._ended, self._problem = Event(), Event(), ""
        client.on_connect, client.on_disconnect = self._on_connect, self._on_disconnect
        client.on_publish = self._on_publish
        client.will_set(self._will[0], self._will[1], qos=1, retain=True)
        try:
            client.connect(*self._address, keepalive=self._keepalive)
            client.loop_start()
            if not self._connected.wait(TUNING.answer):
                raise OSError("the broker does not answer")
            self.check()
        except BaseException:
            self.drop()
            raise

    # Callbacks of an older client, which is about to end, must not affect the present client.

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

    def check(self) -> Client:
        """Return the client. Raises OSError if the connection has ended, or if a message was refused."""
        if self._problem or self._client is None or self._ended.is_set():
            raise OSError(self._problem or "the sink is not connected to the broker")
        return self._client

    def publish(self, topic: str, payload: bytes, qos: int, retain: bool = False) -> None:
        """Hand over a message, whose result `flush` reports."""
        info = self.check().publish(topic, payload, qos, retain)
        if info.rc != 0:
            raise OSError(self._problem or "the connection to the broker ended")
        self._last = info
        if qos:
            self._acknowledged.append(info)

    def flush(self) -> None:
        """Wait until all published messages are sent, and acknowledged if that was requested."""
        waiting, self._acknowledged = self._acknowledged, []
        end = time.monotonic() + TUNING.answer
        for info in [*waiting, *([self._last] if self._last is not None else [])]:
            while not info.is_published():
                self.check()
                if time.monotonic() > end:
                    raise OSError(f"the broker has not acknowledged all messages within {TUNING.answer:g} s")
                info.wait_for_publish(0.05)
        self._last = None
        self.check()

    def drop(self) -> None:
        """End the connection with a farewell, so that the broker publishes no will."""
        client, self._client = self._client, None
        self._acknowledged, self._last = [], None
        if client is not None:
            client.disconnect()
            client.loop_stop()


ONLINE, OFFLINE = b"online", b"offline"


class MqttSinkSection(SinkSection, BrokerSection):
    """[sinks.NAME] with kind = "mqtt"."""

    kind: Literal["mqtt"] = Field("mqtt", description='"mqtt"')
    prefix: Text = Field(
        "pmfid", pattern="^[^#+\\x00]+$", description='the first levels of all topics, for example "pmfid"'
    )
    estimates: Literal["axis", "batch", "off"] = Field(
        "axis",
        description='"axis" for one message per row, "batch" for messages with many axes, "off" for no estimates',
    )
    qos: Literal[0, 1] = Field(0, description="the quality of service (QoS) of estimates, 0 or 1; alarms always have 1")

    def make(self, name: str, context: Context) -> MqttSink:
        """Return the sink, not yet open. Raises UsageError without paho-mqtt, and for missing secrets."""
        base = f"{self.prefix}/{quote(context.name, safe='')}"
        new = partial(new_client, self, context.folder, f"pmfid-{context.name}-{name}")
        new()  # this call reports errors at the start
        link = BrokerLink(new, self.address, self.keepalive, (f"{base}/status", OFFLINE))
        return MqttSink(name, base, link, self)


class MqttSink:
    """A sink that publishes to topics below prefix and service.

    The topics are `status` (retained; `offline` is the last will), `estimates/AXIS` and `alarms/AXIS` (retained, empty
    after the alarm). Alarms on silence have `alarms/AXIS/silent`, `alarms/_source/NAME/silent` and
    `alarms/_sink/NAME/silent`. Rows of many axes go to `batches/CONFIG`, events to `events`. After an error or a
    restart, messages may repeat. Numbers identify repeated messages.
    """

    events: frozenset[str] | None = None

    def __init__(self, name: str, base: str, link: BrokerLink, section: MqttSinkSection) -> None:
        self.name = name
        self.takes_rows = section.estimates != "off"
        self._base, self._link, self._section = base, link, section
        self._standing: dict[str, tuple[int, bytes]] = {}  # topic -> number and message that the broker retains

    def open(self) -> None:
        """Connect, and publish all messages that the broker shall retain.

        A killed broker may have lost a retained message, or retain an outdated message again.
        """
        self._link.open()
        self._link.publish(f"{self._base}/status", ONLINE, 1, retain=True)
        for topic, (_, payload) in self._standing.items():
            self._link.publish(topic, payload, 1, retain=True)
        self._link.flush()

    def put(self, outcomes: list[EstimateRows | Notice]) -> None:
        """Publish the outcomes. Raises OSError if the connection has ended, or if an acknowledgement is missing."""
        self._link.check()
        for one in outcomes:
            if isinstance(one, Notice):
                self._notice(one)
            elif self._section.estimates == "batch":
                for batch in batches_of(one):
                    topic = self._topic("batches", one.group.config)
                    self._link.publish(topic, as_json(batch).encode(), self._section.qos)
            else:
                for axis, row in row_objects(one):
                    topic, payload = self._topic("estimates", axis), as_json(row).encode()
                    self._link.publish(topic, payload, self._section.qos)
        self._link.flush()

    def _topic(self, what: str, of: str) -> str:
        """Return a topic in which any name takes exactly one level."""
        return f"{self._base}/{what}/{quote(of, safe='')}"

    def _notice(self, notice: Notice) -> None:
        payload, topic = (
            as_json(notice_object(notice) | {"text": notice_sentence(notice)}).encode(),
            self._alarm_topic(notice),
        )
        if notice.what.get("event") == "alarm":
            self._retain(topic, notice.number, payload)
        elif self._takes_back(notice, topic):
            self._retain(topic, notice.number, b"")
        self._link.publish(f"{self._base}/events", payload, 1)

    def _alarm_topic(self, notice: Notice) -> str:
        """Return the topic on which an alarm is retained.

        Silence has its own topic, because it may come and go during another alarm. No name of an axis begins with "_".
        """
        kind = notice.what.get("silent")
        if kind is None:
            return self._topic("alarms", notice.axis)
        if kind == "axis":
            return f"{self._topic('alarms', notice.axis)}/silent"
        name = f"{notice.what.get('alarm', notice.number)}" if kind == "axes" else str(notice.what["name"])
        return f"{self._topic('alarms', f'_{kind}')}/{quote(name, safe='')}/silent"

    def _retain(self, topic: str, number: int, payload: bytes) -> None:
        self._standing[topic] = number, payload
        self._link.publish(topic, payload, 1, retain=True)

    def _takes_back(self, notice: Notice, topic: str) -> bool:
        """Return whether the alarm of a topic is over. An alarm that was raised before this start is unknown here."""
        if notice.what.get("event") == "acknowledged":
            standing, named = self._standing.get(topic), notice.axis or "silent" in notice.what
            return bool(named) and (standing is None or not standing[1] or standing[0] == notice.what["alarm"])
        return notice.what.get("event") == "cleared"

    def close(self) -> None:
        """Publish that the service is offline, and end the connection."""
        try:
            self._link.publish(f"{self._base}/status", OFFLINE, 1, retain=True)
            self._link.flush()
        finally:
            self._link.drop()


def batches_of(rows: EstimateRows) -> Iterator[dict[str, Any]]:
    """Yield objects for JSON with columns of up to `mqtt_batch` rows each. The columns theta and std are lists of
    lists.
    """
    named = ("number", "time", "u", "counts", "theta", "std", "innovation", "status")
    for start in range(0, rows.axis.size, TUNING.mqtt_batch):
        part = slice(start, start + TUNING.mqtt_batch)
        columns = {name: getattr(rows, name)[part].tolist() for name in named}
        states, axes = rows.state[part].tolist(), rows.axis[part].tolist()
        yield {
            "config": rows.group.config,
            "names": list(rows.group.names),
            "axis": [rows.group.axes[axis] for axis in axes],
            **columns,
            "state": [STATES[state] for state in states],
        }
