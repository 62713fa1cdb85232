"""One file with a stream of Arrow while it grows, and how a finished one becomes Parquet."""

from __future__ import annotations

import io
import os
import re
import time
from contextlib import suppress
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

from pmfid.durable.lock import lock
from pmfid.service.sinks.durable import replace_durably, write_all
from pmfid.service.sinks.ipc import messages_of, read_stream

if TYPE_CHECKING:
    import polars as pl

__all__ = ["SUFFIX", "StreamFile", "turn_into_parquet"]

SUFFIX = ".arrows"
#: Behind the name of a stream that cannot be read.
DAMAGED = ".damaged"


class StreamFile:
    """A new file, named by the time at which it began, which only this process writes. size: in bytes, of the messages
    that are whole; began: `time.monotonic()`."""

    def __init__(self, folder: Path, config: str) -> None:
        name = re.sub(r"[^A-Za-z0-9._-]", "_", config.removesuffix(".toml"))[-100:].strip(".") or "_"
        began = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
        self.began, self.size = time.monotonic(), 0
        self._file = -1
        for number in count():
            self.path = folder / f"{name}-{began}-{number}{SUFFIX}"
            if self.path.with_suffix(".parquet").exists():
                continue
            try:
                self._file = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o666)
            except FileExistsError:
                continue
            # whoever turned the empty file into nothing before it was locked must not have the rows, too
            if lock(self._file) and self.path.exists():
                break
            self.close()

    def append(self, frame: pl.DataFrame) -> None:
        """Writes the rows of a table. Raises OSError; then `cut` takes back what was written of them."""
        schema, batches = messages_of(frame)
        data = batches if self.size else schema + batches
        write_all(self._file, data)
        self.size += len(data)

    def cut(self, size: int) -> None:
        """Back to so many bytes. Raises OSError."""
        os.ftruncate(self._file, size)
        os.lseek(self._file, size, os.SEEK_SET)
        self.size = size

    def sync(self) -> None:
        """Everything is on the disk. Raises OSError."""
        os.fsync(self._file)

    def close(self) -> None:
        """Nothing more comes."""
        file, self._file = self._file, -1
        if file >= 0:
            os.close(file)


def turn_into_parquet(stream: Path) -> None:
    """Makes a Parquet file of a finished stream, beside it and at once whole, and removes the stream. One that another
    process still writes stays as it is.

    Raises OSError where there is no room or no right to write, ValueError where it cannot be read: then it gets another
    name. In both cases nothing is lost.
    """
    with open(stream, "rb") as file:
        if not lock(file.fileno()):
            return
        target = stream.with_suffix(".parquet")
        if not target.exists():  # else it was made whole, and a kill came before the stream was removed
            try:
                frame = read_stream(stream)
            except ValueError:
                with suppress(OSError):
                    stream.rename(stream.with_name(stream.name + DAMAGED))
                raise
            if frame.height:
                replace_durably(target, _parquet(frame))
        stream.unlink()


def _parquet(frame: pl.DataFrame) -> bytes:
    data = io.BytesIO()
    frame.write_parquet(data, compression="zstd")
    return data.getvalue()
