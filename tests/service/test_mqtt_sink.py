"""Estimates and alarms at a broker: retained messages, withdrawn messages, and a broker that is killed."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from pmfid.service.broker import new_client
from pmfid.service.sinks import queued
from pmfid.service.sinks.mqtt import BrokerLink, MqttSink, MqttSinkSection
from pmfid.service.sinks.queued import Queued
from tests.patience import PATIENCE
from tests.service.broker import Broker, needs_broker, stopped_brokers  # noqa: F401
from tests.service.feed import Host, alarm, block, kindred, notice, queue_of, until
from tests.tuned import set_tuning

pytest.importorskip("paho.mqtt.client", reason="paho-mqtt is not installed: pip install 'pmfid[serve]'")
GROUP = kindred(2)


class Link(BrokerLink):
    """A broker that keeps each message: (topic, payload, qos, retained)."""

    def __init__(self) -> None:
        self.got: list[tuple[str, bytes, int, bool]] = []
        self.problem = ""

    def open(self) -> None:
        self.problem = ""

    def check(self) -> None:
        if self.problem:
            raise OSError(self.problem)

    def publish(self, topic: str, payload: bytes, qos: int, retain: bool = False) -> None:
        self.check()
        self.got.append((topic, payload, qos, retain))

    def flush(self) -> None:
        self.check()

    def drop(self) -> None:
        self.got.append(("dropped", b"", 0, False))

    def retained(self) -> dict[str, bytes]:
        return {topic: payload for topic, payload, _, retain in self.got if retain}


def sink_of(link: Link, **keys: object) -> MqttSink:
    sink = MqttSink("m", "pmfid/hall-3", link, MqttSinkSection(**keys))  # type: ignore[arg-type]
    sink.open()
    return sink


# --- published messages -----------------------------------------------------------------------------------------------


ALARM = "pmfid/hall-3/alarms/x1"


@pytest.mark.parametrize(
    ("event", "over"),
    [
        (notice(9, "acknowledged", alarm=2), True),
        (notice(9, "acknowledged", alarm=1), False),  # of an older alarm
        (notice(9, "acknowledged", axis="x0", alarm=2), False),
        (notice(9, "settled"), False),
    ],
)
def test_an_alarm_stays_until_it_is_taken_back(event: Any, over: bool) -> None:
    link = Link()
    sink = sink_of(link)
    sink.put([alarm(1), alarm(2), event])
    assert (link.retained()[ALARM] == b"") == over
    before = dict(link.retained())
    link.got.clear()
    sink.open()  # the broker may have lost all messages, even the end of the alarm
    assert link.retained() == before


# --- with Mosquitto ---------------------------------------------------------------------------------------------------


@dataclass
class Listener:
    """A subscriber to all topics; `got` holds (topic, payload, retained)."""

    broker: Broker
    got: list[tuple[str, bytes, bool]] = field(default_factory=list)

    def __enter__(self) -> Listener:
        self.client = new_client(self.broker.section, Path(), f"listener-{time.monotonic()}")
        self.client.on_message = lambda client, data, message: self.got.append(
            (message.topic, message.payload, message.retain)
        )
        self.client.on_connect = lambda client, *rest: client.subscribe("#", qos=1)
        subscribed: list[bool] = []
        self.client.on_subscribe = lambda *rest: subscribed.append(True)
        self.client.connect("127.0.0.1", self.broker.port)
        self.client.loop_start()
        assert until(lambda: subscribed)
        return self

    def __exit__(self, *_: object) -> None:
        self.client.disconnect()
        self.client.loop_stop()

    def last(self, topic: str) -> bytes | None:
        return next((payload for name, payload, _ in reversed(self.got) if name == topic), None)


@pytest.fixture
def broker(tmp_path: Path, stopped_brokers: None) -> Broker:  # noqa: F811
    folder = tmp_path / "broker"
    folder.mkdir()
    return Broker(folder).start()


@pytest.fixture
def started(tmp_path: Path, broker: Broker, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Queued]]:
    set_tuning(monkeypatch, queued, first_pause=0.05)
    set_tuning(monkeypatch, queued, longest_pause=0.1)
    set_tuning(monkeypatch, queued, queued_idle=0.05)
    running: list[Queued] = []

    def start(host: Host, **keys: object) -> Queued:
        section = MqttSinkSection(port=broker.port, **keys)  # type: ignore[arg-type]
        running.append(queue_of(section, "m", host))
        running[-1].start()
        return running[-1]

    yield start
    for one in running:
        one.close(5)


STATUS = "pmfid/hall-3/status"


@needs_broker
def test_a_broker_gets_all_and_keeps_the_alarm(tmp_path: Path, broker: Broker, started: Callable[..., Queued]) -> None:
    outlet = started(Host(tmp_path))
    with Listener(broker) as listener:
        for number in range(1, 101):
            outlet.rows(block(GROUP, number))
        outlet.notice(alarm(7))
        assert until(lambda: listener.last(ALARM))
        assert until(lambda: sum(topic.endswith("estimates/x0") for topic, *_ in listener.got) == 100)
        estimates = [json.loads(text)["number"] for topic, text, _ in listener.got if topic.endswith("estimates/x0")]
        assert estimates == list(range(1, 101))
    with Listener(broker) as late:
        assert until(lambda: late.last(ALARM) and late.last(STATUS))
        assert sorted((topic, retained) for topic, _, retained in late.got) == [(ALARM, True), (STATUS, True)]
        outlet.notice(notice(8, "acknowledged", alarm=7, note="seen"))
        assert until(lambda: late.last(ALARM) == b"")
        assert outlet.close(PATIENCE)
        assert until(lambda: late.last(STATUS) == b"offline")
    with Listener(broker) as later:
        assert until(lambda: later.got)
        assert [topic for topic, *_ in later.got] == [STATUS]


@needs_broker
def test_a_connection_that_breaks_is_the_last_will_and_comes_again_by_itself(
    tmp_path: Path, broker: Broker, started: Callable[..., Queued]
) -> None:
    host = Host(tmp_path)
    outlet = started(host)
    with Listener(broker) as listener:
        assert until(lambda: listener.last(STATUS) == b"online")
        seen = len(listener.got)
        outlet._sink._link._client.socket().shutdown(2)  # type: ignore[attr-defined]
        assert until(lambda: len(listener.got) >= seen + 2)
        assert [payload for topic, payload, _ in listener.got[seen:] if topic == STATUS] == [b"offline", b"online"]
    assert until(lambda: len(host.reported) == 2)
    assert [reported["works"] for reported in host.reported] == [False, True]


@needs_broker
def test_a_broker_that_lost_everything_is_reported_the_alarms_again(
    tmp_path: Path, broker: Broker, started: Callable[..., Queued]
) -> None:
    host = Host(tmp_path)
    outlet = started(host)
    outlet.notice(alarm(7))
    assert until(lambda: outlet._sink._standing)  # type: ignore[attr-defined]
    broker.kill()
    for path in broker.folder.glob("mosquitto.db*"):
        path.unlink()
    assert until(lambda: host.reported)
    outlet.notice(alarm(8, axis="x0"))
    broker.start()
    with Listener(broker) as listener:
        assert until(lambda: listener.last(ALARM) and listener.last(ALARM.replace("x1", "x0")))
        assert json.loads(listener.last(ALARM) or b"")["number"] == 7
    assert host.count("pmfid_dropped_notices_total", sink="m") == 0


@needs_broker
@pytest.mark.long
def test_no_alarm_is_lost_whatever_becomes_of_the_broker(
    tmp_path: Path, broker: Broker, started: Callable[..., Queued]
) -> None:
    """Alarms of many axes come while the broker is killed repeatedly and forgets all unsaved messages."""
    host = Host(tmp_path)
    outlet = started(host)
    for number in range(300):
        outlet.notice(alarm(number, axis=f"x{number}"))
        if number % 50 == 25:
            broker.kill()
            outlet.notice(alarm(1000 + number, axis=f"y{number}"))
            time.sleep(0.02)
            broker.start()
        time.sleep(0.003)
    assert until(lambda: host.count("pmfid_sink_working", sink="m") == 1)
    assert outlet.close(PATIENCE)
    with Listener(broker) as listener:
        assert until(lambda: sum("/alarms/" in topic for topic, *_ in listener.got) >= 306)
        assert listener.last(STATUS) == b"offline"
    assert host.count("pmfid_sink_errors_total", sink="m") >= 6
    assert host.count("pmfid_dropped_notices_total", sink="m") == 0
