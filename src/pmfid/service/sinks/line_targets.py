"""Where lines go: a file, standard output, TCP, UDP, HTTP."""

from __future__ import annotations

import errno
import os
import socket
import stat
from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path

from pmfid.service.sinks import RefusedError
from pmfid.service.sinks.durable import write_all
from pmfid.service.sinks.posting import Poster

__all__ = ["FileTarget", "HttpTarget", "Target", "TcpTarget", "UdpTarget"]

#: Bytes of one POST, about.
MOST_POSTED = 500_000


class Target(ABC):
    """Takes lines with their ends. All raise OSError for what may pass."""

    @abstractmethod
    def open(self) -> None: ...

    @abstractmethod
    def send(self, lines: list[bytes]) -> None: ...

    @abstractmethod
    def close(self) -> None:
        """The target can be opened again."""


class FileTarget(Target):
    """A file that grows; None: standard output. All lines are written, or none of them where it is a file. One that was
    renamed or removed, as by who rotates logs, is made anew."""

    def __init__(self, path: Path | None) -> None:
        self._path, self._file = path, -1

    def open(self) -> None:
        if self._path is None:
            self._file = os.dup(1)
        else:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            # without O_NONBLOCK a named pipe that nobody reads could not be given up
            flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | getattr(os, "O_BINARY", 0) | getattr(os, "O_NONBLOCK", 0)
            self._file = os.open(self._path, flags, 0o666)
            os.set_blocking(self._file, True)
            self._end_line()

    def _end_line(self) -> None:
        """A line that a kill cut off gets its end, so that it spoils no other."""
        path = self._path
        if path is None or not stat.S_ISREG(os.fstat(self._file).st_mode):
            return
        with open(path, "rb") as file:
            if file.seek(0, os.SEEK_END) > 0:
                file.seek(-1, os.SEEK_END)
                if file.read(1) != b"\n":
                    write_all(self._file, b"\n")

    def _is_there(self) -> bool:
        """Whether the file that is open is still the one of that name."""
        try:
            return self._path is None or os.path.samestat(os.stat(self._path), os.fstat(self._file))
        except FileNotFoundError:
            return False

    def send(self, lines: list[bytes]) -> None:
        if not self._is_there():
            self.close()
            self.open()
        state = os.fstat(self._file)
        try:
            write_all(self._file, b"".join(lines))
        except OSError:
            if stat.S_ISREG(state.st_mode):
                os.ftruncate(self._file, state.st_size)
            raise

    def close(self) -> None:
        file, self._file = self._file, -1
        if file >= 0:
            os.close(file)


class TcpTarget(Target):
    """A server that takes lines."""

    def __init__(self, address: tuple[str, int], timeout: float, largest: int) -> None:
        self._address, self._timeout = address, timeout
        self._socket: socket.socket | None = None

    def open(self) -> None:
        self._socket = socket.create_connection(self._address, self._timeout)

    def send(self, lines: list[bytes]) -> None:
        opened = _open(self._socket)
        opened.setblocking(False)
        try:
            # whoever sends lines back, or has closed the connection, is not listening: a write alone would not tell
            if opened.recv(4096) == b"":
                raise ConnectionResetError(104, "Connection closed by the other side")
        except BlockingIOError:
            pass
        opened.settimeout(self._timeout)
        opened.sendall(b"".join(lines))

    def close(self) -> None:
        opened, self._socket = self._socket, None
        if opened is not None:
            opened.close()


class UdpTarget(TcpTarget):
    """Datagrams with as many whole lines as fit; whether anyone listens makes no difference. A line that is too large
    for one goes alone; RefusedError where that is more than the system takes."""

    def __init__(self, address: tuple[str, int], timeout: float, largest: int) -> None:
        super().__init__(address, timeout, largest)
        self._largest = largest

    def open(self) -> None:
        family, kind, protocol, _, address = socket.getaddrinfo(*self._address, type=socket.SOCK_DGRAM)[0]
        self._socket = socket.socket(family, kind, protocol)
        self._socket.connect(address)

    def send(self, lines: list[bytes]) -> None:
        opened = _open(self._socket)
        for datagram in packed(lines, self._largest):
            try:
                opened.send(datagram)
            except ConnectionRefusedError:  # of the datagram before
                continue
            except OSError as error:
                if error.errno == errno.EMSGSIZE:
                    raise RefusedError(f"a line of {len(datagram)} bytes is too long for a datagram") from None
                raise


class HttpTarget(Target):
    """InfluxDB's and Telegraf's listener."""

    def __init__(self, poster: Poster) -> None:
        self._poster = poster

    def open(self) -> None:
        """It connects when there is something to send."""

    def send(self, lines: list[bytes]) -> None:
        try:
            for body in packed(lines, MOST_POSTED):
                self._poster.post(body, {"Content-Type": "text/plain; charset=utf-8"})
        finally:
            self._poster.close()

    def close(self) -> None:
        self._poster.close()


def _open(opened: socket.socket | None) -> socket.socket:
    if opened is None:
        raise OSError("it is not open")
    return opened


def packed(lines: list[bytes], most: int) -> Iterator[bytes]:
    """Lines put together to so many bytes; a longer one alone."""
    waiting: list[bytes] = []
    size = 0
    for line in lines:
        if waiting and size + len(line) > most:
            yield b"".join(waiting)
            waiting, size = [], 0
        waiting.append(line)
        size += len(line)
    if waiting:
        yield b"".join(waiting)
