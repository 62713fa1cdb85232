"""A page that is really served on this machine, and requests to it as any client could write them."""

from __future__ import annotations

import http.client
import json
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from pmfid.service.web.config import PageConfig
from pmfid.service.web.server import Page, serve
from tests.patience import PATIENCE
from tests.service.fake_engine import FakePlant


@dataclass(frozen=True)
class Served:
    """A plant with its page; `token` is the token that may write."""

    plant: FakePlant
    page: Page
    token: str

    @property
    def host(self) -> str:
        return urlsplit(self.page.url).netloc

    @property
    def address(self) -> tuple[str, int]:
        parts = urlsplit(self.page.url)
        return str(parts.hostname), int(parts.port or 0)

    def ask(
        self, path: str, *, method: str = "GET", token: str | None = "", body: bytes | None = None, **headers: str
    ) -> tuple[int, dict[str, str], bytes]:
        """Send a request and return (status, headers, body); token "" sends the right token, None sends none."""
        connection = http.client.HTTPConnection(*self.address, timeout=PATIENCE)
        given = {name.replace("_", "-"): value for name, value in headers.items()}
        if token is not None:
            given["authorization"] = f"Bearer {token or self.token}"
        try:
            connection.request(method, path, body, given)
            answer = connection.getresponse()
            return answer.status, {name.lower(): value for name, value in answer.getheaders()}, answer.read()
        finally:
            connection.close()

    def json(self, path: str) -> Any:
        status, _, body = self.ask(path)
        assert status == 200, body
        return json.loads(body)

    def post(self, path: str, content: object, token: str = "") -> int:
        body = json.dumps(content).encode()
        return self.ask(path, method="POST", token=token, body=body, content_type="application/json")[0]

    def raw(self, request: bytes) -> bytes:
        """Return the answer to these bytes, up to the end of the connection or a second of silence."""
        with socket.create_connection(self.address, timeout=PATIENCE) as line:
            line.sendall(request)
            return received(line)

    def counted(self, name: str, **labels: str) -> float:
        return self.plant.counters.values().get((f"pmfid_page_{name}_total", tuple(labels.items())), 0)


def received(line: socket.socket) -> bytes:
    """Return the bytes until the end of the connection, or until nothing follows the answer for a second."""
    found = b""
    try:
        while piece := line.recv(65536):
            found += piece
            line.settimeout(1.0)
    except (TimeoutError, ConnectionResetError):
        pass
    return found


@contextmanager
def served(plant: FakePlant, **config: Any) -> Iterator[Served]:
    """Serve the plant's page on a free port."""
    page = serve(
        PageConfig(port=0, **config), "hall-3", plant.board, plant.counters, plant,
        folder=Path.cwd(), reference=plant.reference, metrics=lambda: "pmfid_up 1\n",
    )  # fmt: skip
    try:
        yield Served(plant, page, page.start_url.partition("token=")[2])
    finally:
        page.stop()


def until(true: Callable[[], object], seconds: float = PATIENCE) -> bool:
    """Return whether the condition becomes true in time."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if true():
            return True
        time.sleep(0.02)
    return False
