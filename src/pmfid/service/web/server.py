"""The page's server."""

from __future__ import annotations

import logging
import mimetypes
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from threading import Thread

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Mount
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp
from uvicorn import Config, Server

from pmfid.errors import UsageError
from pmfid.records.record import Record
from pmfid.service.tuning import TUNING
from pmfid.service.web.api import Api
from pmfid.service.web.board import Board
from pmfid.service.web.config import PageConfig
from pmfid.service.web.security import Guard, Token, hosts_of, load_token
from pmfid.stream.engine import StreamEngine
from pmfid.stream.outcome import Counters


def make_app(api: Api, hosts: frozenset[str], token: Token) -> ASGIApp:
    """Return the application inside the guard, which serves the files of the page and the API."""
    mimetypes.add_type("text/javascript", ".js")  # the type must not depend on the system
    files = StaticFiles(directory=Path(__file__).parent / "static", html=True)

    inner = Starlette(
        routes=[*api.routes(), Mount("/", files)],
        exception_handlers={HTTPException: _answer_error, Exception: _answer_error},
    )
    return Guard(inner, hosts, token, api.counters)


async def _answer_error(request: Request, error: Exception) -> Response:
    """Answer an error with a sentence that contains no text of the request."""
    if isinstance(error, HTTPException):
        return JSONResponse({"problem": error.detail}, error.status_code, error.headers)
    return JSONResponse({"problem": "the service could not answer; its log contains the reason"}, 500)


@dataclass
class Page:
    """A page in service.

    `url` is the address without the token. `made_token` is the token that this start made, or None for a configured
    token. `notes` has sentences with information on the page.
    """

    url: str
    made_token: str | None = field(repr=False)
    notes: tuple[str, ...]
    _server: Server
    _api: Api
    _thread: Thread

    @property
    def start_url(self) -> str:
        """The address with the token if this start made the token. An address with a token may go to a terminal, never
        to a log."""
        return f"{self.url}#token={self.made_token}" if self.made_token else self.url

    def stop(self) -> None:
        """End the thread, within seconds. This method may be called twice."""
        self._server.should_exit = True
        self._thread.join(TUNING.answer)


def serve(
    config: PageConfig,
    name: str,
    board: Board,
    counters: Counters,
    engine: StreamEngine,
    *,
    folder: Path,
    reference: Callable[[str], Record | None] = lambda axis: None,
    metrics: Callable[[], str] | None = None,
    alive: Callable[[], bool] = lambda: True,
) -> Page:
    """Start to serve the page, before the engine's thread starts.

    `name` is the name of the service, `folder` the folder of PLANT.toml. `reference` returns the record of normal work
    of an axis by its name. The function `reference` is called on request, in its own thread, and may raise UsageError.
    `metrics` returns text for Prometheus. `alive` returns whether the engine is alive, for health checks. Raises
    UsageError if the address is not available, a token is missing, or the extra is not installed.
    """
    token = load_token(config, folder)
    board.keep(1e6 * config.history_mb)
    listener = _listener(config)
    port = listener.getsockname()[1]
    api = Api(name, board, counters, engine, reference, metrics, alive)
    server = _server(make_app(api, hosts_of(config.address, port, config.hosts), token))
    thread = Thread(target=lambda: server.run([listener]), name="page", daemon=True)
    thread.start()
    end = time.monotonic() + TUNING.answer
    while not server.started and thread.is_alive() and time.monotonic() < end:
        time.sleep(0.01)
    if not server.started:
        raise UsageError("the page did not start; the log contains the reason")
    shown = f"[{config.address}]" if ":" in config.address else config.address
    url = f"http://{config.hosts[0] if config.hosts else f'{shown}:{port}'}/"
    return Page(url, token.text if token.made else None, _notes(config, token), server, api, thread)


def _listener(config: PageConfig) -> socket.socket:
    family = socket.AF_INET6 if ":" in config.address else socket.AF_INET
    try:
        return socket.create_server((config.address, config.port), family=family)
    except (OSError, OverflowError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise UsageError(
            f"the page cannot be served on {config.address}:{config.port}: {reason}; choose another port "
            "in [page] of PLANT.toml, or 0 for any free port"
        ) from None


def _server(app: ASGIApp) -> Server:
    """Return a server without a log of requests. Failures of the page are logged with their trace."""
    logging.getLogger("uvicorn.error").addFilter(lambda record: record.exc_info is not None)
    logging.getLogger("uvicorn.access").disabled = True  # any handler of the process overrides `access_log`
    return Server(
        Config(
            app,
            loop="asyncio",
            http="h11",
            ws="none",
            lifespan="off",
            log_config=None,
            access_log=False,
            proxy_headers=False,
            server_header=False,
            timeout_keep_alive=20,
            timeout_graceful_shutdown=1,
            h11_max_incomplete_event_size=16384,
        )
    )


def _notes(config: PageConfig, token: Token) -> tuple[str, ...]:
    notes = []
    if not config.local:
        notes.append(
            f"other machines can reach the page at {config.address}, and its token is sent unencrypted: put a proxy "
            "with TLS before the page"
        )
    if not token.made:
        notes.append("open the page with #token=... and your token after its address")
    return tuple(notes)
