"""Webhooks."""

from __future__ import annotations

import http.client
import ssl
from collections.abc import Mapping
from contextlib import suppress
from functools import partial
from hashlib import sha256
from pathlib import Path
from threading import Timer
from time import monotonic
from typing import Annotated, ClassVar, Literal
from urllib.parse import SplitResult, urlsplit

from pydantic import AfterValidator, Field

from pmfid.config.model import Name, Positive
from pmfid.errors import UsageError, did_you_mean, printable
from pmfid.presentation import as_json
from pmfid.service.broker import PLACE, Place, is_here, is_place, read_secret
from pmfid.service.context import Context, RefusedError
from pmfid.service.sinks.plain import notice_object
from pmfid.service.sinks.queued import QueueLimits, SinkSection
from pmfid.stream.outcome import EstimateRows, Notice
from pmfid.stream.sentences import notice_sentence

#: Answers to the content of a request, which another attempt would not change.
ABOUT_CONTENT = (400, 413, 414, 415, 422, 431)


def check_address(url: str, secret: str | None, label: str) -> SplitResult:
    """Return the parts of an address.

    Raises UsageError for an invalid address, for a user or password in the address, and for a secret that would go
    unencrypted to another machine. `label` is the name of the section in messages. No message contains the address,
    because it may be a secret.
    """
    try:
        parts = urlsplit(url)
        host, _ = parts.hostname, parts.port
    except ValueError:
        parts, host = SplitResult("", "", "", "", ""), None
    if parts.scheme not in ("http", "https") or not host or not url.isascii() or not url.isprintable() or " " in url:
        raise UsageError(
            f"{label}: the address does not start with http:// or https://; give one such as https://example.org/alarms"
        )
    if parts.username is not None:
        raise UsageError(
            f"{label}: the address contains a user name; remove the name, and put it into a header with the key secret"
        )
    if secret is not None and not (secret.isascii() and secret.isprintable() and secret):
        raise UsageError(f"{label}: the secret is empty, or is not a single line of plain text; correct it")
    if secret is not None and parts.scheme == "http" and not is_here(host):
        raise UsageError(
            f"{label}: pmfid does not send a secret to another machine without encryption; give an address with https"
        )
    return parts


class Poster:
    """A client that posts to one address.

    `headers` are sent with every request. `timeout` is the time for a whole exchange [s]. `ca` is the file of the
    trusted certificates. None takes the certificates of the system. Raises UsageError if the file cannot be read.
    """

    def __init__(
        self, address: SplitResult, headers: Mapping[str, str], timeout: float, ca: Path | None = None
    ) -> None:
        self._headers, self._timeout = dict(headers), timeout
        self._target = (address.path or "/") + (f"?{address.query}" if address.query else "")
        host, port = str(address.hostname), address.port
        self._connect = partial(http.client.HTTPConnection, host, port, timeout=timeout)
        if address.scheme == "https":
            try:
                context = ssl.create_default_context(cafile=None if ca is None else str(ca))
            except (OSError, ssl.SSLError):
                raise UsageError(f"the certificates in {ca} cannot be read; correct the file name") from None
            self._connect = partial(http.client.HTTPSConnection, host, port, timeout=timeout, context=context)

    def post(self, body: bytes, headers: Mapping[str, str]) -> None:
        """Send the body by a new connection. Only the status of the answer counts.

        Raises OSError for errors that may pass, and RefusedError if the server will not take the content.
        """
        connection, end = self._connect(), monotonic() + self._timeout
        watch = Timer(self._timeout, _cut, (connection,))
        watch.daemon = True
        watch.start()
        try:
            connection.request("POST", self._target, body, {**self._headers, **headers})
            status = connection.getresponse().status
        except (OSError, http.client.HTTPException) as error:
            raise _build_os_error(error, monotonic() >= end, self._timeout) from None
        finally:
            watch.cancel()
            connection.close()
        if 300 <= status < 400:
            redirected = f"the server answers {status} with another address, and pmfid does not follow it"
            raise OSError(f"{redirected}; give that address in url")
        if not 200 <= status < 300:
            kind = RefusedError if status in ABOUT_CONTENT else OSError
            raise kind(f"the server refuses the message with HTTP status {status}")


def _cut(connection: http.client.HTTPConnection) -> None:
    """End an exchange that takes too long, even if single bytes still arrive."""
    if connection.sock is not None:
        with suppress(OSError):
            connection.sock.shutdown(2)


def _build_os_error(error: OSError | http.client.HTTPException, late: bool, timeout: float) -> OSError:
    if late or isinstance(error, TimeoutError):
        return OSError(f"the server did not answer completely within {timeout:g} s")
    if isinstance(error, OSError) and error.strerror:
        return OSError(error.strerror)
    return OSError(f"the server closed the connection without an answer ({type(error).__name__})")


#: All events of a service. A misspelt event would never be sent.
EVENTS = (
    *("alarm", "acknowledged", "settled", "cleared", "state", "outlier", "gap", "clock", "epoch", "period", "late"),
    "duplicate",
    *("unusable", "bad line", "repeated line", "reference", "anew", "source", "sink", "dropped", "checkpoint"),
    *("configuration", "calibration", "reload", "serving", "ended"),
)


def _check_events(events: tuple[str, ...]) -> tuple[str, ...]:
    for event in events:
        if event not in EVENTS:
            raise ValueError(
                f"no event has the name {event!r}; the events are {', '.join(EVENTS)}{did_you_mean(event, EVENTS)}"
            )
    return events


class WebhookSection(SinkSection):
    """[sinks.NAME] with kind = "webhook"."""

    limits: ClassVar[QueueLimits] = QueueLimits(take=1)
    kind: Literal["webhook"] = Field("webhook", description='"webhook"')
    url: Name = Field(
        description=f'the address, for example "https://example.org/alarms"; a secret address has a place, {PLACE}'
    )
    format: Literal["json", "text"] = Field(
        "json",
        description='"json" for an object with all fields, and with a sentence in the field text; "text" for this '
        "sentence alone, which ntfy shows on a phone",
    )
    # The field is not strict, because TOML has lists and a frozen object needs a tuple.
    events: Annotated[tuple[Name, ...], Field(strict=False, min_length=1), AfterValidator(_check_events)] = Field(
        ("alarm", "cleared"), description='the events to send, for example ["alarm", "settled", "acknowledged"]'
    )
    secret_header: Annotated[str, Field(pattern=r"^[A-Za-z0-9-]{1,100}$")] = Field(
        "Authorization", description='the name of the header that carries the secret, by default "Authorization"'
    )
    secret: Place | None = Field(None, repr=False, description=f"the place of the whole value of that header, {PLACE}")
    timeout_s: Positive = Field(5.0, description="the time limit in s for a request and its answer, for example 5.0")
    ca: Name | None = Field(
        None, description="the file of the certificates to trust; by default the certificates of the operating system"
    )

    def make(self, name: str, context: Context) -> WebhookSink:
        """Return the sink, not yet open. Raises UsageError for an invalid address or secret."""
        label, folder = f"[sinks.{name}]", context.folder
        url = read_secret(self.url, folder) if is_place(self.url) else self.url
        value = None if self.secret is None else read_secret(self.secret, folder)
        address = check_address(url.strip(), value, label)
        headers = {"User-Agent": "pmfid"} | ({} if value is None else {self.secret_header: value})
        ca = None if self.ca is None else folder / Path(self.ca)
        poster = Poster(address, headers, self.timeout_s, ca)
        return WebhookSink(name, context.name, poster, self.format == "json", frozenset(self.events))


class WebhookSink:
    """A sink that sends notices, which its queue gives it one by one, so that an error repeats no other notice.

    A notice that repeats after a restart is sent again with its old `Idempotency-Key`.
    """

    takes_rows = False

    def __init__(self, name: str, service: str, poster: Poster, as_json: bool, events: frozenset[str] | None) -> None:
        self.name, self.events = name, events
        self._service, self._poster, self._json = service, poster, as_json

    def open(self) -> None:
        pass

    def put(self, outcomes: list[EstimateRows | Notice]) -> None:
        """Send the notices.

        Raises OSError if the server does not answer or has a problem, and RefusedError if it will not take a notice.
        """
        for notice in outcomes:
            if isinstance(notice, Notice):
                self._send(notice)

    def _send(self, notice: Notice) -> None:
        key = sha256(as_json([self._service, notice.axis, notice.number, notice.what]).encode()).hexdigest()[:32]
        text = notice_sentence(notice)
        body = as_json({"service": self._service, **notice_object(notice), "text": text}) if self._json else text
        kind = "application/json" if self._json else "text/plain; charset=utf-8"
        self._poster.post(printable(body).encode(), {"Content-Type": kind, "Idempotency-Key": key})

    def close(self) -> None:
        pass
