"""Messages through a real Mosquitto: acknowledged when durable, and never lost in a kill or a pause."""

from __future__ import annotations

import json
import subprocess
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from paho.mqtt.publish import multiple, single

from pmfid.service.sources.mqtt import MqttSource, MqttSourceSection
from pmfid.stream.blocks import encode
from pmfid.stream.delivery import Block, Lines, Unusable
from tests.patience import PATIENCE
from tests.service.broker import Broker, needs_broker, stopped_brokers  # noqa: F401 a fixture
from tests.service.engine import FakeEngine, wait_for
from tests.service.test_lines import axis

pytestmark = [needs_broker, pytest.mark.usefixtures("stopped_brokers")]


@pytest.fixture(scope="module")
def broker(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Broker]:
    broker = Broker(tmp_path_factory.mktemp("broker")).start()
    yield broker
    broker.stop()


def source(engine: FakeEngine, broker: Broker, client: str, *topics: str, **options: object) -> MqttSource:
    section = MqttSourceSection(
        kind="mqtt", port=broker.port, topics=topics or (f"{client}/#",), client=client, **options
    )
    return MqttSource("hall", section, {}.get, engine.tell)


def stop(running: MqttSource, thread: threading.Thread) -> None:
    running.stop()
    running.stop()
    thread.join(PATIENCE)
    assert not thread.is_alive()


def connected(running: MqttSource) -> bool:
    return wait_for(lambda: running.subscribed)


def numbers(blocks: list[Block]) -> list[int]:
    return [block.first for block in blocks]


def send(broker: Broker, topic: str, samples: int, epoch: int = 3, **options: object) -> None:
    """Publish one message for each block of one sample, until the broker has acknowledged all of them."""
    blocks = (Block("x1", epoch, k, 5.0 + 0.01 * k, 0.01, np.array([float(k)]), np.array([k])) for k in range(samples))
    multiple([(topic, encode(block), 1, False) for block in blocks], "127.0.0.1", broker.port, **options)


def test_a_message_is_acknowledged_when_it_is_durable(broker: Broker) -> None:
    engine = FakeEngine()
    hall = source(engine, broker, "durable", receive_maximum=5)
    thread = engine.running(hall)
    assert connected(hall)
    send(broker, "durable/a", 12)
    assert wait_for(lambda: len(engine.blocks) == 5)
    assert not wait_for(lambda: len(engine.blocks) > 5, 0.2), "more than receive_maximum came unacknowledged"
    engine.checkpoint()
    assert wait_for(lambda: len(engine.blocks) == 12)
    stop(hall, thread)

    hall = source(engine, broker, "durable", receive_maximum=50)
    thread = engine.running(hall)
    assert wait_for(lambda: len(engine.blocks) == 19), "what was not durable comes again"
    assert numbers(engine.blocks) == [*range(12), *range(5, 12)]
    assert [(block.epoch, block.u[0], block.counts[0], block.dt) for block in engine.blocks[:2]] == [
        (3, 0.0, 0, 0.01),
        (3, 1.0, 1, 0.01),
    ]
    assert [block.time for block in engine.blocks[:3]] == pytest.approx([5.0, 5.01, 5.02])
    engine.checkpoint()
    wait_for(lambda: False, 1.0)  # the acknowledgements leave in another thread
    stop(hall, thread)

    hall = source(engine, broker, "durable")
    thread = engine.running(hall)
    assert connected(hall)
    assert not wait_for(lambda: len(engine.blocks) > 19, 0.2), "what was acknowledged came again"
    stop(hall, thread)


def test_back_pressure_does_not_read_on(broker: Broker) -> None:
    engine = FakeEngine(slow=0.05)
    hall = source(engine, broker, "pressure")
    thread = engine.running(hall)
    assert connected(hall)
    send(broker, "pressure/a", 20)
    assert len(engine.blocks) < 20, "the broker takes what the service does not"
    assert wait_for(lambda: len(engine.blocks) == 20)
    assert numbers(engine.blocks) == list(range(20))
    engine.ends = True
    send(broker, "pressure/a", 1, epoch=4)
    thread.join(PATIENCE)
    assert not thread.is_alive(), "a source ends when nothing is taken any more"


def test_a_topic_may_name_the_axis_and_messages_have_any_form(broker: Broker, tmp_path: Path) -> None:
    engine = FakeEngine()
    hall = replace(source(engine, broker, "named", "named/{axis}/data", "other/+"), axis={"x1": axis(tmp_path)}.get)
    thread = engine.running(hall)
    assert connected(hall)
    block = encode(Block("x1", 0, 0, 0.0, 0.01, np.zeros(2), np.zeros(2, int)))
    texts = [
        json.dumps({"t": 0, "u": 1, "x": 1}),
        json.dumps([{"t": 1, "u": 1, "x": 1}]),
        json.dumps({"axis": "x1", "t": 2, "u": 1, "x": 1}),
    ]
    for topic, payload in (
        ("named/x1/data", block),
        ("named/x2/data", block),
        ("other/x2", block),
        ("named/x1/data", texts[0]),
        ("named/x1/data", texts[1]),
        ("other/x1", texts[2]),
        ("other/x1", b"\xff\x00"),
        ("other/x1", b""),
    ):
        single(topic, payload, qos=1, hostname="127.0.0.1", port=broker.port)
    assert wait_for(lambda: len(engine.deliveries) == 8)
    stop(hall, thread)
    kinds = [(type(item), getattr(item, "reason", item.axis)) for item in engine.items]
    assert kinds == [
        (Block, "x1"),
        (Unusable, "name"),
        (Block, "x1"),
        (Lines, "x1"),
        (Lines, "x1"),
        (Lines, "x1"),
        (Unusable, "json"),
    ]


# --- rights -----------------------------------------------------------------------------------------------------------


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # paho leaves a refused socket open
def test_tls_with_a_password_out_of_a_file(tmp_path: Path) -> None:
    def run(*words: str) -> None:
        subprocess.run(words, cwd=tmp_path, check=True, capture_output=True)

    key = "req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days 2 -keyout key.pem -out ca.pem"
    run("openssl", *key.split(), "-subj", "/CN=127.0.0.1", "-addext", "subjectAltName=IP:127.0.0.1")
    (tmp_path / "users").write_text("hall:s3cret words\n")
    (tmp_path / "secret").write_text("s3cret words\n")
    (tmp_path / "wrong").write_text("other\n")
    for name in ("secret", "wrong"):
        (tmp_path / name).chmod(0o600)
    run("mosquitto_passwd", "-U", "users")
    lines = ("password_file {}/users", "certfile {}/ca.pem", "keyfile {}/key.pem", "allow_anonymous false")
    more = "\n".join(line.format(tmp_path) for line in lines)
    safe = Broker(tmp_path, more)
    safe.start()
    engine = FakeEngine()
    options = {"ca": "ca.pem", "user": "hall", "password": "file:secret"}
    hall = replace(source(engine, safe, "tls", **options), folder=tmp_path)
    thread = engine.running(hall)
    assert connected(hall), engine.problems()
    trust = {"auth": {"username": "hall", "password": "s3cret words"}, "tls": {"ca_certs": str(tmp_path / "ca.pem")}}
    send(safe, "tls/a", 1, **trust)
    assert wait_for(lambda: len(engine.blocks) == 1)
    stop(hall, thread)
    for change in ({"password": "file:wrong"}, {"ca": None, "tls": True}):
        engine = FakeEngine()
        hall = replace(source(engine, safe, "tls", **(options | change)), folder=tmp_path)
        thread = engine.running(hall)
        assert wait_for(lambda engine=engine: engine.reported)
        stop(hall, thread)
        assert not hall.subscribed
        assert "Not authorized" in engine.problems()[0] or "certificate verify failed" in engine.problems()[0]
        assert "s3cret" not in str(engine.reported) + repr(hall)
    safe.stop()


def test_a_topic_that_the_broker_refuses_is_reported(broker: Broker) -> None:
    """Mosquitto's own access lists refuse no subscription, but its plugins and other brokers do."""
    from paho.mqtt.packettypes import PacketTypes
    from paho.mqtt.reasoncodes import ReasonCode

    engine = FakeEngine()
    hall = source(engine, broker, "refused", "mine/#", "theirs/#")
    granted = hall._on_subscribe
    answers = [ReasonCode(PacketTypes.SUBACK, identifier=code) for code in (1, 0x87)]
    hall._on_subscribe = lambda client, data, mid, _, properties: granted(client, data, mid, answers, properties)
    thread = engine.running(hall)
    assert wait_for(lambda: engine.reported)
    stop(hall, thread)
    assert engine.problems()[0] == "the broker refuses the topic theirs/# (Not authorized)"
