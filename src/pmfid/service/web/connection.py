"""Connections, and limits of their number and time."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import ssl
from collections.abc import Callable
from typing import Any, ClassVar

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

from pmfid.service.tuning import TUNING
from pmfid.stream.outcome import Counters

#: States of a request that is whole.
WHOLE = (h11.DONE, h11.MUST_CLOSE, h11.CLOSED, h11.ERROR)


class Guarded(H11Protocol):
    """The protocol of uvicorn within limits, which counts the connections that the limits end.

    `gone` is set at the end of the connection.
    """

    counters: ClassVar[Counters]

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.access_log = False  # any handler of the process overrides uvicorn's own switch
        self._deadline: asyncio.TimerHandle | None = None
        self._stuck: asyncio.TimerHandle | None = None
        self._proved = False
        self.gone = asyncio.Event()

    @property
    def proved(self) -> bool:
        """Whether a request on this connection had a valid token."""
        return self._proved or (self.scope is not None and self.scope.get("may") is not None)

    @property
    def idle(self) -> bool:
        return self.cycle is None or self.cycle.response_complete

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._expect()

    def on_response_complete(self) -> None:
        self._proved = self.proved  # the next request has its own scope
        super().on_response_complete()

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        if self.conn.their_state in WHOLE:
            self._forget_deadline()
        elif self._deadline is None and not self.transport.is_closing():
            self._expect()

    def _expect(self) -> None:
        """Limit the time of the whole request, because a byte every few seconds would keep a connection open."""
        self._deadline = self.loop.call_later(TUNING.connection_request, self._end)

    def _forget_deadline(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None

    def pause_writing(self) -> None:
        super().pause_writing()
        self._watch()

    def resume_writing(self) -> None:
        super().resume_writing()
        self._forget_stuck()

    def _watch(self) -> None:
        size = self.transport.get_write_buffer_size()
        self._stuck = self.loop.call_later(TUNING.connection_stuck, self._look, size)

    def _look(self, before: int) -> None:
        """End a stuck connection. A slow connection is not stuck while the amount of waiting data falls."""
        if self.transport.get_write_buffer_size() < before:
            self._watch()
        else:
            self.counters.add("pmfid_page_browsers_dropped_total")
            self.transport.abort()

    def _forget_stuck(self) -> None:
        if self._stuck is not None:
            self._stuck.cancel()
            self._stuck = None

    def send_400_response(self, msg: str) -> None:
        self.counters.add("pmfid_page_refused_total", reason="invalid")
        super().send_400_response(msg)

    def _end(self) -> None:
        self.counters.add("pmfid_page_refused_total", reason="slow")
        self.transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        self._forget_deadline()
        self._forget_stuck()
        super().connection_lost(exc)
        self.gone.set()


def most_connections(wanted: int) -> int:
    """Return the wanted number of connections, but at most half of the files that the process may open.

    Sources, sinks and checkpoints need the other half.
    """
    try:
        import resource
    except ImportError:  # Windows has no such module
        return wanted
    files, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return wanted if files == resource.RLIM_INFINITY else min(wanted, files // 2)


class Entrance:
    """The entrance for connections, with at most `most` connections at a time.

    A new connection replaces the oldest one without an accepted token. If all have a token, it replaces one that waits
    for a request.
    """

    def __init__(self, listener: socket.socket, most: int, counters: Counters) -> None:
        self._listener, self._most, self._counters = listener, most, counters
        self._guests: dict[socket.socket, tuple[Guarded, asyncio.Task[None]]] = {}  # in the order of arrival

    async def run(self, tls: ssl.SSLContext | None, make: Callable[[], Guarded]) -> None:
        """Accept connections until cancelled, then close the listener. `make` returns the protocol of a connection."""
        loop = asyncio.get_running_loop()
        self._listener.setblocking(False)
        try:
            while True:
                try:
                    line, _ = await loop.sock_accept(self._listener)
                except OSError:
                    self._make_room()
                    await asyncio.sleep(TUNING.no_file)
                    continue
                self._admit(line, tls, make)
                await asyncio.sleep(0)  # pending data are read before the next connection is accepted
        finally:
            self._listener.close()

    def _admit(self, line: socket.socket, tls: ssl.SSLContext | None, make: Callable[[], Guarded]) -> None:
        if len(self._guests) < self._most or self._make_room():
            guest = make()
            self._guests[line] = guest, asyncio.create_task(self._host(line, guest, tls))
        else:
            self._counters.add("pmfid_page_refused_total", reason="connections")
            line.close()

    async def _host(self, line: socket.socket, guest: Guarded, tls: ssl.SSLContext | None) -> None:
        """Serve a connection from the handshake to its end."""
        loop, timeout = asyncio.get_running_loop(), None if tls is None else TUNING.connection_handshake
        try:
            await loop.connect_accepted_socket(lambda: guest, line, ssl=tls, ssl_handshake_timeout=timeout)
            await guest.gone.wait()
        except OSError:  # the handshake failed
            line.close()
        finally:
            self._guests.pop(line, None)

    def _make_room(self) -> bool:
        """Return whether a connection was closed for a new one."""
        unproved = (line for line, (guest, _) in self._guests.items() if not guest.proved)
        idle = (line for line, (guest, _) in self._guests.items() if guest.idle)
        line = next(unproved, None) or next(idle, None)
        if line is None:
            return False
        guest, _ = self._guests.pop(line)
        self._counters.add("pmfid_page_refused_total", reason="connections")
        if guest.transport is not None:
            guest.transport.abort()
        else:
            with contextlib.suppress(OSError):  # the client has closed the connection first
                line.shutdown(socket.SHUT_RDWR)
        return True
