"""Estimates as tables: streams of Arrow while they grow, since a Parquet file that is cut off is lost whole; each
finished one becomes Parquet."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from math import inf
from pathlib import Path
from typing import ClassVar, Literal

from pydantic import Field

from pmfid.service.outcome import Kindred, Notice, Rows
from pmfid.service.sinks.ipc import frame_of
from pmfid.service.sinks.queued import Tell, problem_of
from pmfid.service.sinks.section import Host, SinkSection
from pmfid.service.sinks.stream_file import SUFFIX, StreamFile, turn_into_parquet
from pmfid.session.model_config import Name, Positive

__all__ = ["ArrowSection", "ArrowSink"]

#: Of a stream: the configuration of its axes and the names of their parameters.
Key = tuple[str, tuple[str, ...]]

#: s until a Parquet file that could not be made is tried again.
RETRY = 60.0


class ArrowSection(SinkSection):
    """[sinks.NAME] with kind = "arrow"."""

    events_wanted: ClassVar[frozenset[str] | None] = frozenset()
    pace: ClassVar[float] = 1.0

    kind: Literal["arrow"] = Field("arrow", description='"arrow"')
    folder: Name = Field(description='the folder of the tables, as "rows"')
    rotate_mb: Positive = Field(32.0, description="the size in MB at which a stream becomes Parquet")
    rotate_s: Positive = Field(3600.0, description="the age in s at which a stream becomes Parquet")
    sync_s: float = Field(5.0, ge=0, description="the time in s between two syncs to the disk")

    def make(self, name: str, context: Host) -> ArrowSink:
        """The sink, not yet open."""
        return ArrowSink(name, context.folder / self.folder, self, context.tell)


class ArrowSink:
    """A stream for each configuration of axes, as these have parameters of their own.

    `put` writes all rows, or none of them. A kill leaves streams that are readable up to the last whole message;
    the next start makes Parquet of them. Rows may come again after a restart: axis and number tell.
    """

    def __init__(self, name: str, folder: Path, section: ArrowSection, tell: Tell) -> None:
        self.name = name
        self._folder, self._section, self._tell = folder, section, tell
        self._streams: dict[Key, StreamFile] = {}
        self._finished: list[Path] | None = None  # streams to be turned into Parquet; None before the first `open`
        self._synced = self._tried = -inf
        self._problem = ""

    def open(self) -> None:
        """Raises OSError where the folder cannot be made."""
        self._folder.mkdir(parents=True, exist_ok=True)
        if self._finished is None:
            self._finished = sorted(self._folder.glob(f"*{SUFFIX}"))

    def put(self, outcomes: list[Rows | Notice]) -> None:
        """Raises OSError where the rows cannot be written: then none of them are."""
        self._look_for_files()
        before = {key: stream.size for key, stream in self._streams.items()}
        try:
            for blocks in _by_group(outcomes):
                self._stream_of(blocks[0].group).append(frame_of(blocks))
            self._sync()
        except OSError:
            self._take_back(before)
            raise
        self._rotate()
        self._make_parquet()

    def _look_for_files(self) -> None:
        """A stream that someone removed is told, and another one begun, so that no more rows go the same way."""
        for key, stream in list(self._streams.items()):
            if not stream.path.exists():
                self._streams.pop(key).close()
                problem = f"{stream.path.name} was removed, with its rows"
                self._tell({"event": "sink", "sink": self.name, "works": True, "problem": problem})

    def _stream_of(self, group: Kindred) -> StreamFile:
        key = group.config, group.names
        if key not in self._streams:
            self._streams[key] = StreamFile(self._folder, group.config)
        return self._streams[key]

    def _take_back(self, before: Mapping[Key, int]) -> None:
        """Leaves in the streams what they had; one that cannot be cut ends, as nothing behind a cut message is read."""
        for key, stream in list(self._streams.items()):
            try:
                stream.cut(before.get(key, 0))
            except OSError:
                self._finish(key)

    def _sync(self) -> None:
        now = time.monotonic()
        if now - self._synced >= self._section.sync_s:
            for stream in self._streams.values():
                stream.sync()
            self._synced = now

    def _rotate(self) -> None:
        size, age = 1e6 * self._section.rotate_mb, self._section.rotate_s
        for key, stream in list(self._streams.items()):
            if stream.size >= size or time.monotonic() - stream.began >= age:
                self._finish(key)

    def _finish(self, key: Key) -> None:
        stream = self._streams.pop(key)
        stream.close()
        self._finished = [*(self._finished or []), stream.path]
        self._tried = -inf

    def _make_parquet(self) -> None:
        """Of all finished streams. What fails does not hold up what comes: the rows are safe where they are."""
        if not self._finished or time.monotonic() - self._tried < RETRY:
            return
        self._tried = time.monotonic()
        for path in list(self._finished):
            try:
                turn_into_parquet(path)
            except OSError as error:
                self._say(problem_of(error))
                return
            except ValueError as error:
                self._say(str(error))
            self._finished.remove(path)
        self._problem = ""

    def _say(self, problem: str) -> None:
        if problem != self._problem:
            self._problem = problem
            told = f"no Parquet is made of a stream, its rows stay in it: {problem}"
            self._tell({"event": "sink", "sink": self.name, "works": True, "problem": told})

    def close(self) -> None:
        """Makes Parquet of all that was written."""
        for key in list(self._streams):
            self._finish(key)
        self._tried = -inf
        self._make_parquet()


def _by_group(outcomes: Iterable[Rows | Notice]) -> list[list[Rows]]:
    """Rows of the same group together, in their order."""
    found: dict[int, list[Rows]] = {}
    for rows in outcomes:
        if isinstance(rows, Rows):
            found.setdefault(id(rows.group), []).append(rows)
    return list(found.values())
