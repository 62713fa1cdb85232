"""Web servers that answer, or do not answer, for the tests of sinks."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from tests.patience import PATIENCE


@dataclass
class Server:
    """The answers and the requests of a server.

    `answers` are the status codes of the next answers; the last one serves for all later answers. `got` holds headers
    and body of each request.
    """

    answers: list[int] = field(default_factory=lambda: [200])
    got: list[tuple[str, dict[str, str], bytes]] = field(default_factory=list)
    port: int = 0

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"


@contextmanager
def web_server(*answers: int, context: object = None) -> Iterator[Server]:
    """Start a server on a port of this machine; `context` is an SSLContext for https."""
    reported = Server(list(answers) or [200])

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            reported.got.append((self.path, dict(self.headers), body))
            status = reported.answers.pop(0) if len(reported.answers) > 1 else reported.answers[0]
            self.send_response(status)
            if 300 <= status < 400:
                self.send_header("Location", f"http://127.0.0.1:{reported.port}/elsewhere")
            self.send_header("Content-Length", "0")
            self.end_headers()

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    if context is not None:
        server.socket = context.wrap_socket(server.socket, server_side=True)  # type: ignore[attr-defined]
    reported.port = server.server_address[1]
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True)
    thread.start()
    try:
        yield reported
    finally:
        server.shutdown()
        server.server_close()
        thread.join(PATIENCE)


@contextmanager
def bad_server(says: bytes, every: float = 0.0) -> Iterator[int]:
    """Yield the port of a server that repeats a text with a pause, or never answers."""
    listening = socket.create_server(("127.0.0.1", 0))
    connections: list[socket.socket] = []
    ended = threading.Event()

    def serve() -> None:
        while not ended.is_set():
            try:
                connections.append(listening.accept()[0])
            except OSError:
                return
            threading.Thread(target=drip, args=(connections[-1],), daemon=True).start()

    def drip(connection: socket.socket) -> None:
        while says and not ended.is_set():
            try:
                connection.sendall(says)
            except OSError:
                return
            time.sleep(every)

    threading.Thread(target=serve, daemon=True).start()
    try:
        yield listening.getsockname()[1]
    finally:
        ended.set()
        for one in (listening, *connections):
            one.close()
