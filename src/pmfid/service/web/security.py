"""The token of the page, and the hosts and origins of requests."""

from __future__ import annotations

import asyncio
import json
import os
import secrets
from collections.abc import Iterable
from dataclasses import dataclass, field
from hashlib import sha256
from hmac import compare_digest
from pathlib import Path
from typing import Any

from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from pmfid.errors import UsageError
from pmfid.service.broker import read_secret
from pmfid.service.tuning import TUNING
from pmfid.service.web.config import PageConfig
from pmfid.stream.outcome import Counters


@dataclass(frozen=True)
class Token:
    """The token of the page, which never appears in a printed form of this object.

    `made` is true if this start made the token. The start line may then show the token.
    """

    text: str = field(repr=False)
    made: bool = False

    def opens(self, headers: Headers) -> bool:
        """Return whether a request has the token in its only header `Authorization`.

        The duration of the comparison reveals nothing about the token, because both digests are equally long.
        """
        scheme, _, given = ",".join(headers.getlist("authorization")).partition(" ")
        digests = [sha256(text.encode()).digest() for text in (given.strip(), self.text)]
        return compare_digest(*digests) and scheme.lower() == "bearer"


def load_token(config: PageConfig, folder: Path) -> Token:
    """Return the token that [page] names, or a new token. Names of files are relative to `folder`. Raises
    UsageError."""
    if config.token is None:
        return Token(secrets.token_urlsafe(32), made=True)
    where = f"[page] token = {config.token!r}"
    try:
        token = read_secret(config.token, folder)
    except UsageError as error:
        raise UsageError(f"{where}: {error}") from None
    token = token.strip()
    if len(token) < TUNING.security_shortest or not token.isascii() or not token.isprintable() or " " in token:
        raise UsageError(
            f"{where} does not contain a token: {TUNING.security_shortest} or more letters and digits, "
            'without spaces; make one with: python -c "import secrets; print(secrets.token_urlsafe(32))"'
        )
    return Token(token)


def keep_token(token: str, folder: Path | None) -> str:
    """Keep a new token outside the log, and return a sentence with the place of the token.

    `folder` is the folder of the checkpoints. Only the user of the service can read its file page.token.
    """
    if folder is None:
        return "the token of this start appears only on a terminal; set your own with [page] token"
    path = folder / "page.token"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        path.unlink(missing_ok=True)
        file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(file, "w", encoding="ascii") as stream:
            stream.write(f"{token}\n")
    except OSError as error:
        return f"{path} cannot be written: {error.strerror}; set your own token with [page] token"
    return f"open the page with #token=... after its address; the file {path} contains the token of this start"


HEADERS = {
    "content-security-policy": (
        "default-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'; object-src 'none'; "
        "require-trusted-types-for 'script'; trusted-types 'none'"
    ),
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "permissions-policy": "camera=(), geolocation=(), microphone=()",
}


class Refusal(Exception):  # noqa: N818  it is answered, not raised to anyone
    """Raised for a request that is refused.

    `reason` is the word for counters, `status` the HTTP status. `problem` is a sentence that repeats no content of the
    request.
    """

    def __init__(self, reason: str, status: int, problem: str) -> None:
        super().__init__(problem)
        self.reason, self.status, self.problem = reason, status, problem


def hosts_of(address: str, port: int, more: Iterable[str]) -> frozenset[str]:
    """Return the accepted values of Host in small letters, which are names of the address and configured names."""
    literal = f"[{address}]" if ":" in address else address
    names = {literal}
    if address in ("127.0.0.1", "::1", "localhost"):
        names |= {"127.0.0.1", "localhost", "[::1]"}
    found = {f"{name}:{port}" for name in names if name not in ("0.0.0.0", "[::]")}
    if port in (80, 443):
        found |= {host.rpartition(":")[0] for host in found}
    return frozenset(found | {host.lower() for host in more})


@dataclass
class Guard:
    """A guard that refuses forbidden requests, and passes on the others.

    `closed` has the prefixes of paths that need a token. All other paths are files without data of the plant.
    """

    app: ASGIApp
    hosts: frozenset[str]
    token: Token
    counters: Counters
    closed: tuple[str, ...] = ("/api/", "/metrics")

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        answer = _with_headers(send, scope["path"].startswith(self.closed))
        try:
            headers = Headers(scope=scope)
            self._check_origin(headers)
            length = headers.get("content-length", "0")  # this check comes before the body is read
            if not length.isdecimal() or int(length[:20]) > TUNING.largest_body:
                raise Refusal("size", 413, f"a request must have at most {TUNING.largest_body} bytes")
            if scope["path"].startswith(self.closed) and not self.token.opens(headers):
                raise Refusal(
                    "token", 401, "the page needs a token: open the address that pmfid serve printed at its start"
                )
        except Refusal as refusal:
            self.counters.add("pmfid_page_refused_total", reason=refusal.reason)
            await _build_answer(refusal)(scope, receive, answer)
            return
        await self.app(scope, receive, answer)

    def _check_origin(self, headers: Headers) -> None:
        """Check Host and Origin of a request.

        The header Host reveals a foreign name for this address (DNS rebinding), the header Origin a foreign page.
        """
        hosts = headers.getlist("host")
        if len(hosts) != 1 or hosts[0].lower() not in self.hosts:
            raise Refusal(
                "host",
                421,
                "the page is not available under this host name; add the name to hosts in [page] of PLANT.toml",
            )
        origins = headers.getlist("origin")
        own = {f"{scheme}://{hosts[0].lower()}" for scheme in ("http", "https")}  # a proxy may speak TLS
        foreign = len(origins) > 1 or not {origin.lower() for origin in origins} <= own
        from_here = headers.get("sec-fetch-site", "none") in ("same-origin", "none")  # same-site means another port
        if foreign or not (from_here or headers.get("sec-fetch-mode") == "navigate"):
            raise Refusal("origin", 403, "requests from another web page are refused")


def _build_answer(refusal: Refusal) -> JSONResponse:
    """Build the answer to a refused request. The connection then ends, and further data on it are not read."""
    headers = {"connection": "close"}
    if refusal.status == 401:
        headers["www-authenticate"] = "Bearer"
    return JSONResponse({"problem": refusal.problem}, refusal.status, headers)


def _with_headers(send: Send, private: bool) -> Send:
    async def answer(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            for name, value in HEADERS.items():
                headers[name] = value
            headers["cache-control"] = "no-store" if private else "no-cache"
        await send(message)

    return answer


async def json_body(request: Request) -> dict[str, Any]:
    """Return the object in a body. Raises HTTPException for a body that is no object, too large or too slow."""
    if request.headers.get("content-type", "").partition(";")[0].strip() != "application/json":
        raise HTTPException(415, "the body must be JSON, with content-type: application/json")
    try:
        body = b""
        async with asyncio.timeout(TUNING.slowest_body):
            async for piece in request.stream():  # a body without a length is counted during its arrival
                body += piece
                if len(body) > TUNING.largest_body:
                    size = f"a request must have at most {TUNING.largest_body} bytes"
                    raise HTTPException(413, size, {"connection": "close"})
        found = json.loads(body)
    except (TimeoutError, ClientDisconnect):
        raise HTTPException(408, "the request took too long") from None
    except (ValueError, RecursionError):
        raise HTTPException(400, "the request is not valid JSON") from None
    if not isinstance(found, dict):
        raise HTTPException(400, "the request must be a JSON object")
    return found
