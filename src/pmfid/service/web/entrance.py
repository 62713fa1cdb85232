"""Where connections come in: as many as there may be, and one that proves nothing makes room for the next one."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import ssl
from collections.abc import Callable

from pmfid.service.web.connection import Guarded
from pmfid.stream.counters import Counters

__all__ = ["Entrance", "most_connections"]

#: Time for a TLS handshake [s], and a pause where the system has no file left for a connection [s].
HANDSHAKE, NO_FILE = 5.0, 0.1


def most_connections(wanted: int) -> int:
    """As many as wanted, but at most half of the files that the process may open: sources, sinks and checkpoints need
    theirs."""
    try:
        import resource
    except ImportError:  # a system without such a limit
        return wanted
    files, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return wanted if files == resource.RLIM_INFINITY else min(wanted, files // 2)


class Entrance:
    """most: connections at once.

    A new connection takes the place of the oldest one without an accepted token; only then of one with a token, and
    only while that waits for a request.
    """

    def __init__(self, listener: socket.socket, most: int, counters: Counters) -> None:
        self._listener, self._most, self._counters = listener, most, counters
        self._guests: dict[socket.socket, tuple[Guarded, asyncio.Task[None]]] = {}  # in the order in which they came

    async def run(self, tls: ssl.SSLContext | None, make: Callable[[], Guarded]) -> None:
        """Until it is cancelled; then the listener is closed. make: the protocol of a connection."""
        loop = asyncio.get_running_loop()
        self._listener.setblocking(False)
        try:
            while True:
                try:
                    line, _ = await loop.sock_accept(self._listener)
                except OSError:
                    self._make_room()
                    await asyncio.sleep(NO_FILE)
                    continue
                self._admit(line, tls, make)
                await asyncio.sleep(0)  # what came before is read before the next one is let in
        finally:
            self._listener.close()

    def _admit(self, line: socket.socket, tls: ssl.SSLContext | None, make: Callable[[], Guarded]) -> None:
        if len(self._guests) < self._most or self._make_room():
            guest = make()
            self._guests[line] = guest, asyncio.create_task(self._host(line, guest, tls))
        else:
            self._count_refusal()
            line.close()

    async def _host(self, line: socket.socket, guest: Guarded, tls: ssl.SSLContext | None) -> None:
        """From the handshake to the end of a connection."""
        loop, timeout = asyncio.get_running_loop(), None if tls is None else HANDSHAKE
        try:
            await loop.connect_accepted_socket(lambda: guest, line, ssl=tls, ssl_handshake_timeout=timeout)
            await guest.gone.wait()
        except OSError:  # of the handshake
            line.close()
        finally:
            self._guests.pop(line, None)

    def _make_room(self) -> bool:
        """Whether a connection had to go."""
        unproved = (line for line, (guest, _) in self._guests.items() if not guest.proved)
        idle = (line for line, (guest, _) in self._guests.items() if guest.idle)
        line = next(unproved, None) or next(idle, None)
        if line is None:
            return False
        guest, _ = self._guests.pop(line)
        self._count_refusal()
        if guest.transport is not None:
            guest.transport.abort()
        else:
            with contextlib.suppress(OSError):  # the other side was faster
                line.shutdown(socket.SHUT_RDWR)
        return True

    def _count_refusal(self) -> None:
        self._counters.add("pmfid_page_refused_total", reason="connections")
