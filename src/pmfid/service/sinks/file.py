"""Estimates and events as lines of JSON in a growing file, for one machine without a broker."""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import Literal, Self

from pydantic import Field, model_validator

from pmfid.config.model import Name
from pmfid.service.context import Context
from pmfid.service.sinks.plain import as_json, notice_object, row_objects
from pmfid.service.sinks.queued import SinkSection
from pmfid.stream.outcome import EstimateRows, Notice


class FileSinkSection(SinkSection):
    """[sinks.NAME] with kind = "file"."""

    kind: Literal["file"] = Field("file", description='"file"')
    path: Name = Field(description='the file to write, for example "estimates.jsonl"')
    rows: bool = Field(True, description="false to write events only, without estimates")
    events: bool = Field(True, description="false to write estimates only, for example for a program that reads tables")

    @model_validator(mode="after")
    def _has_something(self) -> Self:
        if not (self.rows or self.events):
            raise ValueError("rows and events are both false, so the file would stay empty; set one of them to true")
        return self

    def wants_rows(self) -> bool:
        return self.rows

    def wants_events(self) -> frozenset[str] | None:
        return None if self.events else frozenset()

    def make(self, name: str, context: Context) -> FileSink:
        return FileSink(name, context.folder / self.path)


class FileSink:
    """A sink that writes a line of JSON for each row and each notice. The line of a notice has an `event`.

    If the file was renamed or removed, for example by a rotation of logs, it is made again. After an error or a
    restart, lines may repeat. Axis and number identify repeated lines.
    """

    def __init__(self, name: str, path: Path) -> None:
        self.name = name
        self._path, self._file = path, -1

    def open(self) -> None:
        """Open the file. Raises OSError if the file cannot be made."""
        self.close()
        self._path.parent.mkdir(parents=True, exist_ok=True)
        # Without O_NONBLOCK, the sink could not give up a named pipe without a reader.
        flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | getattr(os, "O_BINARY", 0) | getattr(os, "O_NONBLOCK", 0)
        self._file = os.open(self._path, flags, 0o666)
        os.set_blocking(self._file, True)
        self._end_line()

    def _end_line(self) -> None:
        """End a line that a kill cut off, so that the cut line spoils no other line."""
        if not stat.S_ISREG(os.fstat(self._file).st_mode):
            return
        with open(self._path, "rb") as file:
            if file.seek(0, os.SEEK_END) > 0:
                file.seek(-1, os.SEEK_END)
                if file.read(1) != b"\n":
                    _write_all(self._file, b"\n")

    def put(self, outcomes: list[EstimateRows | Notice]) -> None:
        """Write the outcomes. Raises OSError if the lines cannot be written. A regular file has none of these lines
        after the error."""
        try:
            there = os.path.samestat(os.stat(self._path), os.fstat(self._file))
        except FileNotFoundError:
            there = False
        if not there:
            self.open()
        state = os.fstat(self._file)
        try:
            _write_all(self._file, "".join(_lines(one) for one in outcomes).encode())
        except OSError:
            if stat.S_ISREG(state.st_mode):
                os.ftruncate(self._file, state.st_size)
            raise

    def close(self) -> None:
        file, self._file = self._file, -1
        if file >= 0:
            os.close(file)


def _lines(outcome: EstimateRows | Notice) -> str:
    if isinstance(outcome, Notice):
        return f"{as_json(notice_object(outcome))}\n"
    return "".join(f"{as_json({'axis': axis, **row})}\n" for axis, row in row_objects(outcome))


def _write_all(file: int, data: bytes) -> None:
    """Write all data. Bytes that were written before an OSError stay in the file."""
    left = memoryview(data)
    while left:
        left = left[os.write(file, left) :]
