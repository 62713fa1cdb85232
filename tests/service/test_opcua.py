"""OPC UA from a real server: values with its time, and arrays that are numbered."""

from __future__ import annotations

import asyncio
import socket
import threading
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from pydantic import Field

from pmfid.errors import UsageError
from pmfid.service.delivery import Lines, Unusable
from pmfid.service.sources.opcua import OpcuaSection, OpcuaSource
from pmfid.session.toml_file import FileSection, validated
from tests.service.engine import FakeEngine, wait_for
from tests.service.test_lines import axis

pytestmark = [
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
]
NOON = datetime(2026, 3, 4, 12, tzinfo=UTC)
ARRAYS = {"number": "ns=2;s=number", "u": "ns=2;s=us", "counts": "ns=2;s=counts"}


class Controller:
    """A server with a node for each name, in a thread of its own."""

    def __init__(self) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.url = f"opc.tcp://127.0.0.1:{free.getsockname()[1]}"
        self._ready = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._run()), daemon=True)
        self._thread.start()
        assert self._ready.wait(20)

    async def _run(self) -> None:
        from asyncua import Server, ua

        server = Server()
        await server.init()
        server.set_endpoint(self.url)
        server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
        await server.register_namespace("drive")
        self._nodes = {
            name: await server.nodes.objects.add_variable(f"ns=2;s={name}", name, value)
            for name, value in {"u": 1.5, "x": 0.0, "number": 0, "us": [0.0], "counts": [0]}.items()
        }
        self._loop, self._stop = asyncio.get_running_loop(), asyncio.Event()
        async with server:
            self._ready.set()
            await self._stop.wait()

    def write(self, time: datetime, **values: Any) -> None:
        from asyncua import ua

        async def written() -> None:
            for name, value in values.items():
                await self._nodes[name].write_value(ua.DataValue(ua.Variant(value), SourceTimestamp=time))

        asyncio.run_coroutine_threadsafe(written(), self._loop).result(10)

    def end(self) -> None:
        self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join(10)


@pytest.fixture
def controller() -> Iterator[Controller]:
    controller = Controller()
    yield controller
    controller.end()


def opcua(engine: FakeEngine, folder: Path, url: str, **axes: object) -> OpcuaSource:
    section = OpcuaSection.model_validate({"kind": "opcua", "url": url, "period": 0.01, "axes": axes})
    return OpcuaSource("plc", section, {"x1": axis(folder), "x2": axis(folder)}, engine.tell)


@pytest.mark.long
def test_values_have_the_time_of_the_server_and_arrays_their_numbers(controller: Controller, tmp_path: Path) -> None:
    engine = FakeEngine()
    plc = opcua(
        engine,
        tmp_path,
        controller.url,
        x1={"nodes": {"u": "ns=2;s=u", "x": "ns=2;s=x"}},
        x2={"nodes": ARRAYS, "dt": 0.002},
    )
    thread = engine.running(plc)
    assert wait_for(lambda: engine.blocks)
    for k in range(1, 4):
        controller.write(NOON + timedelta(seconds=k), u=float(k), x=0.001 * k)
        assert wait_for(lambda k=k: latest(engine).time == NOON.timestamp() + k)
        controller.write(NOON, us=[float(k), 0.5], counts=[k, k + 1])
        controller.write(NOON, number=2 * k)
        assert wait_for(lambda k=k: engine.blocks[-1].first == 2 * k)
    controller.write(NOON, number=1)
    assert wait_for(lambda: engine.blocks[-1].first == 1)
    controller.write(NOON, us=[1.0], number=9)
    assert wait_for(lambda: any(isinstance(item, Unusable) for item in engine.items))
    plc.stop()
    thread.join(10)
    assert not thread.is_alive()
    line = latest(engine)
    assert (line.u, line.counts) == (3.0, 131)
    blocks = [block for block in engine.blocks if block.first in (2, 4, 6)]
    assert [(b.axis, b.epoch, b.first, b.u.tolist(), b.counts.tolist(), b.dt) for b in blocks] == [
        ("x2", 0, 2 * k, [float(k), 0.5], [k, k + 1], 0.002) for k in (1, 2, 3)
    ]
    assert engine.blocks[-1].epoch == 1, "numbers that go back begin anew"
    assert engine.deliveries[-1].mark == {"x2/epoch": 1, "x2/number": 1}
    unusable = next(item for item in engine.items if isinstance(item, Unusable))
    assert unusable.reason == "length"

    engine = FakeEngine()
    again = opcua(engine, tmp_path, controller.url, x2={"nodes": ARRAYS, "dt": 0.002})
    controller.write(NOON, us=[1.0, 2.0], number=7)
    thread = threading.Thread(target=again.run, args=(engine.take, {"x2/epoch": 4, "x2/number": 9}), daemon=True)
    thread.start()
    assert wait_for(lambda: engine.blocks)
    again.stop()
    thread.join(10)
    assert engine.blocks[0].epoch == 5


def latest(engine: FakeEngine) -> Any:
    lines = [line for item in engine.items if isinstance(item, Lines) for line in item.lines]
    return lines[-1]


def test_a_server_that_is_not_there_is_told(tmp_path: Path) -> None:
    engine = FakeEngine()
    plc = opcua(engine, tmp_path, "opc.tcp://127.0.0.1:9", x1={"nodes": {"u": "ns=2;s=u", "x": "ns=2;s=x"}})
    thread = engine.running(plc)
    assert wait_for(lambda: engine.told)
    plc.stop()
    thread.join(10)
    assert not thread.is_alive()
    assert "opc.tcp://127.0.0.1:9 cannot be read" in engine.problems()[0]


class Plant(FileSection):
    source: OpcuaSection = Field(description="a source")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"nodes": ARRAYS}, "dt is for arrays"),
        ({"nodes": {"u": "a"}, "dt": 1.0}, "dt is for arrays"),
        ({"nodes": {**ARRAYS, "x": "a"}, "dt": 1.0}, "correct the names"),
        ({"nodes": {}}, "at least 1 item"),
    ],
)
def test_a_section_that_cannot_work_is_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        validated(Plant, {"source": {"kind": "opcua", "url": "a", "axes": {"x1": change}}})


FAR, NEAR, PASSWORD = "opc.tcp://plc.example:4840", "opc.tcp://127.0.0.1:4840", {"user": "u", "password_env": "A"}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"url": FAR, **PASSWORD}, "would reach plc.example unencrypted; give security"),
        ({"url": "opc.tcp://192.0.2.7:4840", "user": "u", "password_file": "a"}, "unencrypted; give security"),
        ({"url": NEAR, "password_env": "A"}, "give user"),
        ({"url": NEAR, **PASSWORD, "password_file": "a"}, "give one of them"),
        ({"url": "opc.tcp://me:hidden@127.0.0.1:4840"}, r"url = 'opc.tcp://\.\.\.@127.0.0.1:4840': it holds a user"),
    ],
)
def test_a_password_that_others_could_read_is_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(UsageError, match=message) as error:
        validated(Plant, {"source": {"kind": "opcua", "axes": {"x1": {"nodes": {"u": "a"}}}, **change}})
    assert "hidden" not in str(error.value)


@pytest.mark.parametrize(
    "change",
    [
        {"url": FAR, "security": "Basic256Sha256,SignAndEncrypt,cert.pem,key.pem"},
        {"url": FAR, "allow_plain_password": True},
        {"url": NEAR},
        {"url": "opc.tcp://[::1]:4840"},
    ],
)
def test_a_password_may_go_where_nobody_else_reads_it(change: dict[str, object]) -> None:
    section = {"kind": "opcua", "axes": {"x1": {"nodes": {"u": "a"}}}, **PASSWORD}
    assert validated(Plant, {"source": {**section, **change}}).source.user == "u"
