"""The page and its interface as one application. The files of the page are read once, by their names, so that no
request is ever a path."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route
from starlette.types import ASGIApp

from pmfid.service.web.api import Api
from pmfid.service.web.security import Guard
from pmfid.service.web.tokens import Tokens

__all__ = ["make_app"]

KINDS = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
    ".txt": "text/plain; charset=utf-8",
}


def make_app(api: Api, hosts: frozenset[str], tokens: Tokens) -> ASGIApp:
    """The application inside the guard: files of the page, and the API."""
    files = page_files()

    async def file(request: Request) -> Response:
        found = files.get(request.url.path)
        if found is None:
            raise HTTPException(404, "there is no such file")
        known = request.headers.get("if-none-match") == found.tag
        headers = {"etag": found.tag}
        return Response(None, 304, headers) if known else Response(found.content, 200, headers, found.kind)

    @contextlib.asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        running = asyncio.create_task(api.hub.run())
        yield
        running.cancel()

    inner = Starlette(
        routes=[*api.routes(), Route("/{path:path}", file)],
        exception_handlers={HTTPException: _problem, Exception: _failure},
        lifespan=lifespan,
    )
    return Guard(inner, hosts, tokens, api.counters)


async def _problem(request: Request, error: Exception) -> Response:
    """A sentence; nothing of the request is in it."""
    if not isinstance(error, HTTPException):
        return await _failure(request, error)
    return JSONResponse({"problem": error.detail}, error.status_code, error.headers)


async def _failure(request: Request, error: Exception) -> Response:
    return JSONResponse({"problem": "the service could not answer; its log says why"}, 500)


@dataclass(frozen=True)
class PageFile:
    """content, its media type, and the tag by which a browser knows that it has it already."""

    content: bytes
    kind: str
    tag: str


def page_files() -> dict[str, PageFile]:
    """Name, as "/style.css", -> file; "/" is the page. Links that lead out of the folder are left out."""
    root = (Path(__file__).parent / "static").resolve()
    found = {}
    for path in sorted(root.rglob("*")):
        inside = path.resolve().is_relative_to(root) and path.is_file()
        if inside and path.suffix in KINDS:
            content = path.read_bytes()
            tag = f'"{sha256(content).hexdigest()[:16]}"'
            found["/" + path.relative_to(root).as_posix()] = PageFile(content, KINDS[path.suffix], tag)
    if "/index.html" in found:
        found["/"] = found["/index.html"]
    return found
