"""POST to one address: bounded in time, certificates verified, never sent on to another address."""

from __future__ import annotations

import http.client
import ssl
from collections.abc import Mapping
from pathlib import Path
from threading import Timer
from urllib.parse import SplitResult, urlsplit

from pmfid.errors import UsageError
from pmfid.service.secrets import is_here
from pmfid.service.sinks import RefusedError

__all__ = ["Poster", "check_address"]

#: Answers that are about what was sent, and will be the same next time.
ABOUT_CONTENT = (400, 413, 414, 415, 422, 431)
#: Bytes of an answer that are read.
MOST_ANSWER = 1 << 16


def check_address(url: str, secret: str | None, label: str) -> SplitResult:
    """The parts of an address. Raises UsageError for what is none, for a user or password in it, and for a secret that
    would go unencrypted to another machine; label: of the section, for messages. No message shows the address: it may
    be a secret."""
    try:
        parts = urlsplit(url)
        host, _ = parts.hostname, parts.port
    except ValueError:
        parts, host = SplitResult("", "", "", "", ""), None
    if parts.scheme not in ("http", "https") or not host or not url.isascii() or not url.isprintable() or " " in url:
        raise UsageError(f"{label}: the address is none of http:// or https://; give one as https://example.org/alarms")
    if parts.username is not None:
        raise UsageError(f"{label}: the address holds a user; give a header by secret_env or secret_file in its place")
    if secret is not None and not (secret.isascii() and secret.isprintable() and secret):
        raise UsageError(f"{label}: the secret is empty, or no line of plain text; correct it")
    if secret is not None and parts.scheme == "http" and not is_here(host):
        raise UsageError(f"{label}: a secret is not sent to another machine by http; give an address with https")
    return parts


class Poster:
    """Posts to one address. headers: sent each time; timeout: s for a whole exchange; ca: file of the trusted
    certificates, None for the certificates of the system. Raises UsageError if the file cannot be read."""

    def __init__(
        self, address: SplitResult, headers: Mapping[str, str], timeout: float, ca: Path | None = None
    ) -> None:
        self._address, self._headers, self._timeout = address, dict(headers), timeout
        self._target = (address.path or "/") + (f"?{address.query}" if address.query else "")
        self._connection: http.client.HTTPConnection | None = None
        self._context: ssl.SSLContext | None = None
        if address.scheme == "https":
            try:
                self._context = ssl.create_default_context(cafile=None if ca is None else str(ca))
            except (OSError, ssl.SSLError):
                raise UsageError(f"the certificates in {ca} cannot be read; correct the name of the file") from None

    def post(self, body: bytes, headers: Mapping[str, str]) -> None:
        """Sends it; the connection stays open until `close`. Raises OSError for what may pass, and RefusedError where
        the server will not take what was sent."""
        connection = self._connection = self._connection or self._connect()
        late: list[bool] = []
        watch = Timer(self._timeout, _cut, (connection, late))
        watch.daemon = True
        watch.start()
        try:
            connection.request("POST", self._target, body, {**self._headers, **headers})
            answer = connection.getresponse()
            if len(answer.read(MOST_ANSWER)) == MOST_ANSWER or late:  # the status is all that counts
                self.close()
        except (OSError, http.client.HTTPException) as error:
            self.close()
            raise _build_os_error(error, bool(late), self._timeout) from None
        finally:
            watch.cancel()
        _judge(answer.status)

    def _connect(self) -> http.client.HTTPConnection:
        host, port = str(self._address.hostname), self._address.port
        if self._context is not None:
            return http.client.HTTPSConnection(host, port, timeout=self._timeout, context=self._context)
        return http.client.HTTPConnection(host, port, timeout=self._timeout)

    def close(self) -> None:
        """Closes the connection; the next `post` opens another one."""
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.close()


def _cut(connection: http.client.HTTPConnection, late: list[bool]) -> None:
    """Ends an exchange that takes too long, also where a byte comes now and then."""
    late.append(True)
    socket = connection.sock
    if socket is not None:
        try:
            socket.shutdown(2)
        except OSError:
            return


def _build_os_error(error: OSError | http.client.HTTPException, late: bool, timeout: float) -> OSError:
    if late or isinstance(error, TimeoutError):
        return OSError(f"no whole answer within {timeout:g} s")
    if isinstance(error, OSError) and error.strerror:
        return OSError(error.strerror)
    return OSError(f"the connection ended without an answer ({type(error).__name__})")


def _judge(status: int) -> None:
    if 200 <= status < 300:
        return
    if 300 <= status < 400:
        raise OSError(f"the server answers {status} and another address, which is not followed; give that address")
    if status in ABOUT_CONTENT:
        raise RefusedError(f"the server answers {status}")
    raise OSError(f"the server answers {status}")
