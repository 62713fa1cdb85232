"""A crowd of silent connections: the page and its health check still answer others."""

from __future__ import annotations

import asyncio
import os
import ssl
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from shutil import which
from socket import create_connection, socket

import pytest

from pmfid.service.web.connection import most_connections
from tests.patience import PATIENCE
from tests.service.fake_engine import FakePlant
from tests.service.loopback import Served, served, until

#: Connections of the crowd.
CROWD = 1000

#: Arguments: host, port, number of connections, text that each sends, and number of closed ones that return in a
#: second.
CLIENT = """
import resource, select, socket, sys, time
host, port, many, says, again = sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), sys.argv[4].encode(), int(sys.argv[5])
soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
resource.setrlimit(resource.RLIMIT_NOFILE, (min(hard, max(soft, many + 100)), hard))
def one():
    line = socket.create_connection((host, port), timeout=900)
    line.sendall(says)
    return line
lines = [one() for _ in range(many)]
print("there", flush=True)
watched = select.epoll()
by_number = {}
def watch(line):
    by_number[line.fileno()] = line
    watched.register(line, select.EPOLLIN | select.EPOLLHUP)
for line in lines: watch(line)
watched.register(0, select.EPOLLIN)
while True:
    for number, _ in watched.poll():
        if number == 0: sys.exit()
        watched.unregister(number)
        by_number.pop(number).close()
        if again:
            time.sleep(1 / again)
            watch(one())
"""


@contextmanager
def crowd(page: Served, many: int = CROWD, says: str = "", again: int = 0) -> Iterator[None]:
    """Open the connections from another process, which has enough file descriptors for them."""
    words = [*map(str, page.address), str(many), says, str(again)]
    command = [sys.executable, "-c", CLIENT, *words]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stdout.readline() == b"there\n"
        yield
        process.stdin.close()


def check_health(page: Served, times: int, pause: float = 0.02) -> None:
    """Check some answers about the health, each with its own connection."""
    for _ in range(times):
        assert page.ask("/healthz", token=None)[0] == 200
        time.sleep(pause)


@pytest.fixture(scope="module")
def page() -> Iterator[Served]:
    with served(FakePlant(2)) as found:
        yield found


@pytest.mark.parametrize(
    ("says", "again"), [("", 0), ("GET / HT", 0), ("GET /healthz HTTP/1.1\r\nHost: {host}\r\n\r\n", 0), ("", 300)]
)
def test_a_crowd_without_a_token_shuts_neither_page_nor_health(page: Served, says: str, again: int) -> None:
    with page.stream("/api/stream") as lines:
        next(lines)
        with crowd(page, says=says.format(host=page.host), again=again):
            check_health(page, 1)  # the answer shows that all earlier connections are accepted
            check_health(page, 25)
            assert page.ask("/api/plant")[0] == 200
            assert page.ask("/")[0] == 200
            for _ in range(4):
                assert next(lines)["kind"] == "news", "who looks already is not thrown out"


def test_the_crowd_costs_a_bounded_number_of_files(page: Served) -> None:
    with crowd(page):
        assert len(page.page._server.server_state.connections) <= 256 + 64
        assert until(lambda: page.counted("refused", reason="connections") >= CROWD - 256 - 64)
    assert until(lambda: len(page.page._server.server_state.connections) == 0)


def test_a_connection_with_a_token_keeps_its_place(page: Served) -> None:
    with create_connection(page.address, timeout=PATIENCE) as line:
        request = f"GET /api/plant HTTP/1.1\r\nHost: {page.host}\r\nAuthorization: Bearer {page.token}\r\n\r\n".encode()
        for _ in range(2):
            line.sendall(request)
            answer = b""
            while not answer.endswith(b"}\n"):
                answer += line.recv(65536)
            assert answer.startswith(b"HTTP/1.1 200 ")
            with crowd(page, 500):
                assert page.ask("/healthz", token=None)[0] == 200


def test_half_of_the_files_are_for_the_page(monkeypatch: pytest.MonkeyPatch) -> None:
    resource = pytest.importorskip("resource", reason="this system has no limit of files")
    for files, most in ((1024, 320), (400, 200), (resource.RLIM_INFINITY, 320)):
        monkeypatch.setattr(resource, "getrlimit", lambda _, files=files: (files, files))
        assert most_connections(320) == most


def test_without_a_file_left_the_page_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    failures, kind = [OSError(24, "Too many open files")] * 3, asyncio.SelectorEventLoop
    own = kind.sock_accept

    async def failing(self: asyncio.SelectorEventLoop, listener: socket) -> tuple[socket, object]:
        if failures:
            raise failures.pop()
        return await own(self, listener)

    monkeypatch.setattr(kind, "sock_accept", failing)
    with served(FakePlant(2)) as there:
        assert there.ask("/healthz", token=None)[0] == 200
    assert failures == []


@pytest.mark.skipif(which("openssl") is None, reason="there is no openssl on this machine to make a certificate")
def test_a_crowd_that_never_shakes_hands_does_not_shut_a_page_with_tls(tmp_path: Path) -> None:
    cert, key = tmp_path / "cert.pem", tmp_path / "key.pem"
    made = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
    made += ["-subj", "/CN=localhost", "-addext", "subjectAltName=IP:127.0.0.1", "-days", "2"]
    subprocess.run([*made, "-keyout", key, "-out", cert], check=True, capture_output=True)
    context = ssl.create_default_context(cafile=str(cert))
    with served(FakePlant(2), certificate=str(cert), key=str(key)) as there:
        greet(there, context)
        with crowd(there, says="\x16"):
            greet(there, context)  # the answer shows that all earlier connections are accepted
            greet(there, context)
            if Path("/proc/self/fd").exists():
                assert len(os.listdir("/proc/self/fd")) < 256 + 64 + 100


def greet(there: Served, context: ssl.SSLContext) -> None:
    """Check some answers about the health over TLS, each with its own connection."""
    for _ in range(10):
        with (
            create_connection(there.address, timeout=PATIENCE) as raw,
            context.wrap_socket(raw, server_hostname="127.0.0.1") as line,
        ):
            line.sendall(f"GET /healthz HTTP/1.1\r\nHost: {there.host}\r\n\r\n".encode())
            assert line.recv(100).startswith(b"HTTP/1.1 200 ")
