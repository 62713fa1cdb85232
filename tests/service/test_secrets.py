"""No secret of a plant appears in a log, row, page, metric, message, file or checkpoint, whatever fails."""

from __future__ import annotations

import http.client
import os
import re
import shutil
import signal
import subprocess
from base64 import b64encode
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlsplit

import pytest

from pmfid.service.broker import PLACE
from pmfid.service.plant import SINKS, SOURCES, load_plant
from pmfid.service.run import Service
from pmfid.service.sinks.plain import NoticeLog, json_line
from pmfid.service.web.config import PageConfig
from pmfid.stream.sentences import notice_line
from tests.patience import PATIENCE
from tests.service.broker import Broker, needs_broker, stopped_brokers  # noqa: F401 a fixture
from tests.service.feed import standard_input
from tests.service.loopback import until
from tests.service.test_serve import Acting, called, folder  # noqa: F401 a fixture
from tests.service.web_servers import Server, web_server

pytest.importorskip("paho.mqtt.client", reason="paho-mqtt is not installed: pip install 'pmfid[serve]'")
PASSWD = shutil.which("mosquitto_passwd")

#: Variables and files -> secrets, all different; their receivers refuse those with WRONG.
SECRETS = {
    "PAGE_TOKEN": "page-token-Zq81kd93mvLx0",
    "BROKER_PASSWORD": "broker-Xe63+hb75/mtJv",
    "wrong.password": "WRONG-source-Vr54ga66lsIu",
    "HOOK_SECRET": "Bearer hook-Sy36ey48jqGs",
    "HOOK_URL": "http://127.0.0.1:{web}/hook-path-Ri27dx39ipFr",
    "down.secret": "Bearer down-Qo18cw20hoEq",
    "down.url": "http://127.0.0.1:9/down-path-Pl09bv11gnDp",
    "ANGRY_SECRET": "Bearer WRONG-angry-Ok90au02fmCo",
    "phone.password": "broker-Xe63+hb75/mtJv",
    "SINK_PASSWORD": "WRONG-sink-Lg63xr75cjZl",
}
#: Wrong tokens that a client sends.
GUESSES = ("page-token-Zq81kd93mvLx1", "Kf54wq66biYk-guessed-by-nobody")

PLANT = """
[service]
name = "hall"
state = "state"
window = 0.0
every = 0.1
silence = 2.0
[page]
port = 0
token = "env:PAGE_TOKEN"
[axes.x1]
config = "axis.toml"
[sources.log]
kind = "stdin"
axis = "x1"
[sources.broker]
kind = "mqtt"
port = {broker}
user = "me"
password = "env:BROKER_PASSWORD"
topics = ["in/#"]
[sources.refused]
kind = "mqtt"
port = {broker}
user = "me"
password = "file:wrong.password"
topics = ["in/#"]
[sinks.hook]
kind = "webhook"
url = "env:HOOK_URL"
secret = "env:HOOK_SECRET"
events = ["alarm", "cleared", "source", "sink", "serving", "reload", "gap", "state"]
[sinks.down]
kind = "webhook"
url = "file:down.url"
secret = "file:down.secret"
[sinks.angry]
kind = "webhook"
url = "http://127.0.0.1:{angry}/"
secret = "env:ANGRY_SECRET"
[sinks.phone]
kind = "mqtt"
port = {broker}
user = "me"
password = "file:phone.password"
[sinks.wrong]
kind = "mqtt"
port = {broker}
user = "me"
password = "env:SINK_PASSWORD"
"""


def test_the_plant_has_every_key_that_names_a_secret() -> None:
    sections = {"page": PageConfig, **SOURCES, **SINKS}
    fields = [pair for made in sections.values() for pair in made.model_fields.items()]
    keys = {key for key, one in fields if PLACE in str(one.description)}
    assert keys == {"token", "password", "url", "secret"}
    assert keys == set(re.findall(r'(\w+) = "(?:env|file):', PLANT))


def forms(secret: str) -> set[bytes]:
    """Return the encodings of a secret; of an address or a header only the secret part counts."""
    bare = secret.rpartition("/")[2] if secret.startswith("http") else secret.removeprefix("Bearer ")
    encoded = b64encode(bare.encode()).rstrip(b"=")
    return {bare.encode(), quote(bare, safe="").encode(), encoded, b64encode(f"me:{bare}".encode()).rstrip(b"=")}


def found_in(content: bytes) -> list[str]:
    """Return the names of the secrets that appear in the content."""
    whole = SECRETS | {f"guess {k}": guess for k, guess in enumerate(GUESSES)}
    return [name for name, secret in whole.items() if any(form in content for form in forms(secret))]


def test_the_search_finds_a_secret_in_each_form() -> None:
    for name, secret in SECRETS.items():
        for form in forms(secret):
            assert name in found_in(b"x" + form + b"\n")


@dataclass
class Running:
    """A plant in its folder, with a broker and servers; `seen` holds each output by its place."""

    place: Path
    web: Server
    angry: Server
    broker: Broker
    seen: dict[str, bytes] = field(default_factory=dict)

    def acting(self, form: Any) -> Acting:
        text = StringIO()
        return Acting(Service(lambda: load_plant(self.place / "plant.toml"), NoticeLog(text, form)), text)

    def ask(self, acting: Acting, path: str, token: str | None, method: str = "GET") -> int:
        """Send a request and keep the page's answer."""
        page = acting.service._page
        assert page is not None
        connection = http.client.HTTPConnection(urlsplit(page.url).netloc, timeout=PATIENCE)
        headers = {"content-type": "application/json"} | ({} if token is None else {"authorization": f"Bearer {token}"})
        connection.request(method, path, b'{"note": "seen"}' if method == "POST" else None, headers)
        answer = connection.getresponse()
        self.seen[f"{method} {path} by {token}"] = str(answer.getheaders()).encode() + answer.read()
        connection.close()
        return answer.status


@pytest.fixture
def running(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Running]:  # noqa: F811
    place = folder / "secrets"
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir()
    for name in ("axis.toml", "normal.csv"):
        (place / name).write_text((folder / name).read_text())
    with ExitStack() as stack:
        web, angry = stack.enter_context(web_server()), stack.enter_context(web_server(401))
        for name, secret in SECRETS.items():
            value = secret.format(web=web.port)
            if name.isupper():
                monkeypatch.setenv(name, value)
            else:
                (place / name).write_text(f"{value}\n")
                (place / name).chmod(0o600)
        (place / "mosquitto").mkdir()
        assert PASSWD is not None
        subprocess.run(
            [PASSWD, "-b", "-c", place / "mosquitto" / "users", "me", SECRETS["BROKER_PASSWORD"]],
            check=True,
            capture_output=True,
        )
        (place / "mosquitto" / "users").chmod(0o644)
        broker = Broker(place / "mosquitto", f"password_file {place / 'mosquitto' / 'users'}\n").start()
        text = PLANT.replace("{broker}", str(broker.port)).replace("{web}", str(web.port))
        (place / "plant.toml").write_text(text.replace("{angry}", str(angry.port)))
        yield Running(place, web, angry, broker)


PATHS = (
    *("/", "/app.js", "/healthz", "/metrics", "/none", "/api/plant", "/api/news", "/api/news?axis=x1"),
    *("/api/axis/x1/reference.csv", "/api/trends?group=0&axes=0", "/api/alarms/1/acknowledge"),
)


@pytest.mark.skipif(PASSWD is None, reason="mosquitto_passwd is not installed")
@needs_broker
@pytest.mark.usefixtures("stopped_brokers")
@pytest.mark.parametrize("form", [pytest.param(json_line, marks=pytest.mark.long), notice_line], ids=["json", "text"])
def test_no_secret_comes_out_anywhere(
    folder: Path,  # noqa: F811
    running: Running,
    form: Any,
    capfd: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
) -> None:
    place, acting = running.place, running.acting(form)
    rows = (folder / "run.csv").read_text().splitlines(keepends=True)

    def counted(name: str, **labels: str) -> float:
        return acting.service.counters.values().get((name, tuple(sorted(labels.items()))), 0.0)

    def is_unusable_counted() -> bool:
        keys = acting.service.counters.values()
        return any(dict(labels).get("source") == "broker" for name, labels in keys if name == "pmfid_unusable_total")

    def operate(publish: Callable[[], None]) -> None:
        send("".join(rows[:900]))
        acting.samples(800)
        assert until(lambda: publish() or is_unusable_counted()), "what comes before the source subscribes is lost"
        for path in PATHS:
            for token in (SECRETS["PAGE_TOKEN"], None, *GUESSES):
                running.ask(acting, path, token)
        for token in (*GUESSES, SECRETS["PAGE_TOKEN"]):
            running.ask(acting, "/api/axis/x1/anew", token, "POST")
        assert running.ask(acting, "/api/plant", SECRETS["PAGE_TOKEN"]) == 200
        assert until(lambda: counted("pmfid_sink_silent", sink="down") == 1), "alarms of silence are among it"
        _reload_of(place)
        assert until(lambda: "reload" in acting.text.getvalue() or "read again" in acting.text.getvalue())
        for sink in ("down", "angry", "wrong"):
            assert counted("pmfid_sink_working", sink=sink) == 0
        for sink in ("hook", "phone"):
            assert counted("pmfid_sink_working", sink=sink) == 1
        values = acting.service.counters.values()
        assert values["pmfid_source_working", (("source", "refused"),)] == 0.0
        running.ask(acting, "/metrics", SECRETS["PAGE_TOKEN"])
        running.ask(acting, "/api/news", SECRETS["PAGE_TOKEN"])

    with standard_input() as send, listening(running.broker) as (got, publish):
        acting.act(lambda: operate(publish))
    messages = b"\n".join(got)
    out, err = capfd.readouterr()
    seen = running.seen | {
        "log": acting.text.getvalue().encode(),
        "stdout": out.encode(),
        "stderr": err.encode(),
        "logging": caplog.text.encode(),
        "messages": messages,
        "posted": b"\n".join(body for _, _, body in [*running.web.got, *running.angry.got]),
    }
    own = {place / name for name in SECRETS} | {place / "mosquitto" / "users"}
    seen |= {str(path): path.read_bytes() for path in place.rglob("*") if path.is_file() and path not in own}
    assert sum(len(content) for content in seen.values()) > 300_000
    assert {name: found for name, content in seen.items() if (found := found_in(content))} == {}
    _were_used(running, seen, messages)


def _reload_of(place: Path) -> None:
    """Reload a plant that cannot be read."""
    text = (place / "plant.toml").read_text()
    (place / "plant.toml").write_text(text.replace('kind = "webhook"', 'kind = "webhok"'))
    os.kill(os.getpid(), signal.SIGHUP)


@contextmanager
def listening(broker: Broker) -> Iterator[tuple[list[bytes], Callable[[], None]]]:
    """Yield all published messages, and a function that publishes a message without samples."""
    from paho.mqtt import client as mqtt
    from paho.mqtt.enums import CallbackAPIVersion

    got: list[bytes] = []
    listener = mqtt.Client(CallbackAPIVersion.VERSION2, "listener")
    listener.on_message = lambda client, data, message: got.append(message.topic.encode() + b" " + message.payload)
    listener.connect("127.0.0.1", broker.port)
    listener.subscribe("#")
    listener.loop_start()
    yield got, lambda: listener.publish("in/x1", b"no samples at all", 1).wait_for_publish(10)
    listener.loop_stop()


def _were_used(running: Running, seen: dict[str, bytes], messages: bytes) -> None:
    """Check that every secret was used; otherwise its absence would prove nothing."""
    assert SECRETS["HOOK_SECRET"] in [headers.get("Authorization") for _, headers, _ in running.web.got]
    assert SECRETS["ANGRY_SECRET"] in [headers["Authorization"] for _, headers, _ in running.angry.got]
    assert any(path.endswith("hook-path-Ri27dx39ipFr") for path, _, _ in running.web.got)
    assert b"pmfid/hall/status online" in messages
    names = [Path(name).name for name in seen]
    assert "pmfid.sqlite" in names
    for what in ("refused", "down", "angry", "wrong"):
        assert what.encode() in seen["log"], "its failure is reported"
