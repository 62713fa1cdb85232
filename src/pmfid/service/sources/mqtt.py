"""Messages of a broker by MQTT 5, each acknowledged when it is durable.

The broker repeats messages that the service loses. The session is persistent, has a fixed name, and uses quality of
service 1. The broker sends at most `receive_maximum` messages without an acknowledgement. The broker's number of
unacknowledged messages also limits the messages between two checkpoints.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import AfterValidator, Field

from pmfid.service.broker import BrokerSection, Text, new_client, pauses
from pmfid.service.context import Context, FindAxis, SourceSection, Take, Tell
from pmfid.service.tuning import TUNING
from pmfid.service.wire.messages import LARGEST, Messages
from pmfid.stream.delivery import Delivery

if TYPE_CHECKING:
    from paho.mqtt.client import Client, ConnectFlags, DisconnectFlags, MQTTMessage
    from paho.mqtt.properties import Properties
    from paho.mqtt.reasoncodes import ReasonCode


#: A level of a topic that names the axis.
AXIS_LEVEL = "{axis}"
#: Number of consecutive brief connections, and their longest duration [s], that reveal two services with one name. Two
#: services with one client name end each other's connections, which Mosquitto does not report. Later attempts have
#: growing pauses.
_TAKEN_OVER, _BRIEF = 3, 1.0


def _check_topics(texts: tuple[str, ...]) -> tuple[str, ...]:
    for text in texts:
        levels = text.split("/")
        mixed = (set("+#{}\0") & set(level) for level in levels if len(level) > 1 and level != AXIS_LEVEL)
        if not text or levels.count(AXIS_LEVEL) != ("{" in text) or "#" in levels[:-1] or any(mixed):
            signs = f"+ and {AXIS_LEVEL} must be whole levels, and # must be the last level"
            raise ValueError(f"{text!r} is not a valid topic: {signs}, for example {f'hall/{AXIS_LEVEL}/#'!r}")
    return texts


class MqttSourceSection(BrokerSection, SourceSection):
    """[sources.NAME] of kind "mqtt"."""

    kind: Literal["mqtt"] = Field(description='"mqtt"')
    topics: Annotated[tuple[str, ...], AfterValidator(_check_topics)] = Field(
        strict=False, min_length=1, description='the topics, for example ["hall/+/blocks"] or ["hall/{axis}/json"]'
    )
    client: Text | None = Field(None, description="the name of the session at the broker, different for each service")
    qos: Literal[0, 1] = Field(1, description="the quality of service: 1, or 0 if messages may be lost")
    session: int = Field(
        86400,
        ge=0,
        le=2**32 - 1,
        description="the time in s for which the broker keeps messages while the service is away",
    )
    receive_maximum: int = Field(
        20_000, ge=1, le=65535, description="the largest number of messages that wait for a checkpoint"
    )
    largest: int = Field(LARGEST, ge=1024, le=2**28, description="the largest size of a message in bytes")

    def make(self, name: str, context: Context) -> MqttSource:
        """Return the source. Raises UsageError if the client cannot be made."""
        client = self.client or f"pmfid-{context.name}-{name}"
        new_client(self, context.folder, client, acknowledges=True)  # this call reports errors at the start
        return MqttSource(name, self, context.axis, context.tell, context.folder, client)


@dataclass
class MqttSource:
    """A `Source` of messages.

    Names of files in the section are relative to `folder`. `client` is the name of the session if the section has none.
    `subscribed` is true while the source is subscribed.
    """

    name: str
    section: MqttSourceSection
    axis: FindAxis
    tell: Tell
    folder: Path = Path()
    client: str = "pmfid"
    subscribed: bool = field(default=False, init=False)
    _stopped: Event = field(default_factory=Event, init=False)
    _over: Event = field(default_factory=Event, init=False)
    _problem: str = field(default="", init=False)
    _said: str = field(default="", init=False)
    _failure: BaseException | None = field(default=None, init=False)
    _since: float = field(default=math.inf, init=False)
    _had_session: bool = field(default=False, init=False)

    def __post_init__(self) -> None:
        self._messages = Messages(self.axis, self.section.largest)

    def run(self, take: Take) -> None:
        """Take messages until `stop`. Raises UsageError for a section that cannot work."""
        waiting, brief = pauses(TUNING.answer), 0
        while not self._stopped.is_set():
            self._since = math.inf
            self._hold_connection(take)
            if self._failure is not None:
                raise self._failure
            if self._stopped.is_set():
                return
            lasted = time.monotonic() - self._since  # minus infinity without a subscription
            brief = brief + (0 < lasted < _BRIEF) if lasted < _BRIEF else 0
            if lasted > 0 and brief < _TAKEN_OVER:
                waiting = pauses(TUNING.answer)
            hint = f"; if another service uses the session {self._session!r} too, give each service its own client"
            self._say(self._problem + (hint if brief >= _TAKEN_OVER else ""))
            self._stopped.wait(next(waiting))

    def stop(self) -> None:
        """End `run`. Until its end, taken messages may still be acknowledged."""
        self._stopped.set()
        self._over.set()

    def _hold_connection(self, take: Take) -> None:
        """Hold one connection, from its beginning to its end."""
        section, self._problem = self.section, ""
        self._over.clear()
        client = new_client(section, self.folder, self._session, acknowledges=True)
        client.on_connect, client.on_subscribe = self._on_connect, self._on_subscribe
        client.on_disconnect = self._on_disconnect
        client.on_message = partial(self._on_message, take)
        try:
            client.connect(*section.address, section.keepalive, clean_start=False, properties=self._properties())
        except (OSError, ValueError) as error:
            self._problem = f"no connection to {section.host} port {section.address[1]}: {error}"
            return
        client.loop_start()
        if self._stopped.is_set():  # `stop` was called during the connection
            self._over.set()
        self._over.wait()
        self.subscribed = False
        client.disconnect()
        client.loop_stop()

    def _properties(self) -> Properties:
        from paho.mqtt.packettypes import PacketTypes
        from paho.mqtt.properties import Properties

        properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
        properties.SessionExpiryInterval = self.section.session
        properties.ReceiveMaximum = self.section.receive_maximum
        properties.MaximumPacketSize = self.section.largest + 65_536 + 64  # adds a topic and a few properties
        return properties

    def _on_connect(
        self, client: Client, _: object, flags: ConnectFlags, reason: ReasonCode, properties: Properties | None
    ) -> None:
        from paho.mqtt.subscribeoptions import SubscribeOptions

        if reason.is_failure:
            self._end(f"the broker refuses the connection: {reason}")
            return
        if self._had_session and not flags.session_present and self.section.session:
            self._say(
                "the broker has lost the session: messages that waited there are lost unless the senders repeat them"
            )
        self._had_session = True
        options = SubscribeOptions(self.section.qos, retainHandling=SubscribeOptions.RETAIN_DO_NOT_SEND)
        client.subscribe([(topic.replace(AXIS_LEVEL, "+"), options) for topic in self.section.topics])

    def _on_subscribe(
        self, client: Client, _: object, mid: int, reasons: list[ReasonCode], properties: Properties | None
    ) -> None:
        pairs = zip(self.section.topics, reasons, strict=False)
        refused = [f"{topic} ({reason})" for topic, reason in pairs if reason.is_failure]
        if refused:
            self._end(f"the broker refuses the topic {refused[0]}")
        else:
            self.subscribed, self._since = True, time.monotonic()
            self._say("")

    def _on_disconnect(
        self, client: Client, _: object, flags: DisconnectFlags, reason: ReasonCode, properties: Properties | None
    ) -> None:
        self._end(f"the connection to {self.section.host} ended: {reason}")

    def _on_message(self, take: Take, client: Client, _: object, message: MQTTMessage) -> None:
        try:
            items = self._messages.items(bytes(message.payload), self._axis_of(message.topic))
            # An acknowledgement on a closed connection has no effect. The message comes again, maybe under another
            # number.
            done = partial(client.ack, message.mid, 1) if message.qos == 1 else None
            if not take(Delivery(self.name, items, done, time.monotonic())):
                self.stop()
        except BaseException as error:  # paho's thread would end without a report
            self._failure = error
            self._over.set()

    def _axis_of(self, topic: str) -> str:
        """Return the axis that a topic names, or "" if the topic names none."""
        from paho.mqtt.client import topic_matches_sub

        for pattern in self.section.topics:
            if AXIS_LEVEL in pattern and topic_matches_sub(pattern.replace(AXIS_LEVEL, "+"), topic):
                return topic.split("/")[pattern.split("/").index(AXIS_LEVEL)]
        return ""

    @property
    def _session(self) -> str:
        return self.section.client or self.client

    def _say(self, problem: str) -> None:
        """Report a problem once, and its end as ""."""
        if problem != self._said:
            self._said = problem
            self.tell({"event": "source", "source": self.name, "problem": problem})

    def _end(self, problem: str) -> None:
        """End the connection. The first problem is reported."""
        self._problem = self._problem or problem
        self._over.set()
