"""What browsers get, packed once for all."""

from __future__ import annotations

import asyncio
import json
import time
from base64 import b64encode
from collections import deque
from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pmfid.presentation import plain
from pmfid.service.board import Board, News, Overview, Subscription
from pmfid.service.board.panel import Records
from pmfid.service.tuning import TUNING
from pmfid.stream.commands import Counters

__all__ = ["json_line", "pack_array", "pack_overview", "pack_rows"]


def pack_array(array: NDArray[np.generic], kind: str) -> str:
    """`kind:base64`; kind: f8, f4, i4, u4 or u1, little endian. NaN and infinity stay what they are."""
    return f"{kind}:{b64encode(np.ascontiguousarray(array, '<' + kind).tobytes()).decode('ascii')}"


def pack_rows(rows: Records) -> dict[str, object]:
    """Columns of rows by name; of theta and std a list with one for each parameter. Whole numbers are f8, exact to
    2^53, which is what a browser computes with."""
    columns: dict[str, object] = {
        name: pack_array(rows[name], "f8") for name in ("number", "time", "u", "counts", "innovation")
    }
    for name in ("theta", "std"):
        columns[name] = [pack_array(column, "f8") for column in rows[name].T]
    return {**columns, "status": pack_array(rows["status"], "u4"), "state": pack_array(rows["state"], "u1")}


def pack_overview(group: int, overview: Overview, start: float) -> dict[str, object]:
    """Changes in a group; received: in tenths of a second after `start`, by `time.monotonic()`."""
    return {
        "group": group,
        "axis": pack_array(overview.axis, "i4"),
        "received": pack_array(np.round(10 * (overview.received - start)), "i4"),
        "value": pack_array(overview.value, "f4"),
        "std": pack_array(overview.std, "f4"),
        "deviation": pack_array(overview.deviation, "f4"),
        "status": pack_array(overview.status, "u4"),
        "state": pack_array(overview.state, "u1"),
    }


def json_line(content: Mapping[str, object]) -> bytes:
    """One line of NDJSON; numbers that JSON does not have are null."""
    try:
        text = json.dumps(content, allow_nan=False, separators=(",", ":"))
    except (TypeError, ValueError):
        text = json.dumps(plain(content), allow_nan=False, separators=(",", ":"))
    return text.encode() + b"\n"


@dataclass
class Feed:
    """The rows of one axis for all its viewers. rows: number of rows so far; dropped: number of rows that the board
    could not keep; pieces: (rows before it, line)."""

    subscription: Subscription
    viewers: int = 0
    rows: int = 0
    dropped: int = 0
    pieces: deque[tuple[int, bytes]] = field(default_factory=lambda: deque(maxlen=TUNING.hub_pieces))

    def take(self) -> None:
        """Appends the rows since the last call."""
        rows, dropped = self.subscription.take()
        self.dropped += dropped
        if rows is not None:
            line = json_line({"kind": "rows", "dropped": self.dropped, **pack_rows(rows)})
            self.pieces.append((self.rows, line))
            self.rows += rows.size

    def get_lines_after(self, seen: int) -> tuple[int, list[bytes]]:
        """(missed rows, lines of the other rows) after the first `seen` rows."""
        waiting = [(before, line) for before, line in self.pieces if before >= seen]
        missed = waiting[0][0] - seen if waiting else 0
        return missed, [line for _, line in waiting]


class Hub:
    """One for the page, in its event loop. start: `time.monotonic()` that the page's times count from."""

    def __init__(self, board: Board, counters: Counters) -> None:
        self._board, self._counters = board, counters
        self.start = time.monotonic()
        self._feeds: dict[str, Feed] = {}
        self._written: dict[tuple[int, int, bool], tuple[int, bytes]] = {}
        self._tick = asyncio.Condition()
        self._ticks = 0
        self.streams = 0
        self.ended = False

    async def run(self) -> None:
        """Until it is cancelled."""
        while True:
            await asyncio.sleep(TUNING.hub_tick)
            async with self._tick:
                self._ticks += 1
                for feed in self._feeds.values():
                    feed.take()
                self._tick.notify_all()

    async def stop(self) -> None:
        """Ends all streams."""
        async with self._tick:
            self.ended = True
            self._tick.notify_all()

    async def _wait(self, ticks: int) -> bool:
        """Waits for a number of ticks; False at the end."""
        until = self._ticks + ticks
        async with self._tick:
            await self._tick.wait_for(lambda: self.ended or self._ticks >= until)
        return not self.ended

    def _changes(self, since: int, groups: bool) -> tuple[int, bytes]:
        """(version, line) of what changed; the same for all browsers that ask for it in the same tick."""
        key = since, self._ticks, groups
        if key not in self._written:
            while len(self._written) >= TUNING.hub_written:
                del self._written[next(iter(self._written))]
            news = self._board.news(since, groups)
            self._written[key] = news.version, json_line(self._content(news, since == 0))
        return self._written[key]

    def _content(self, news: News, first: bool) -> dict[str, object]:
        changed = [(i, group) for i, group in enumerate(news.groups) if group.axis.size]
        counters = self._counters.values()
        return {
            "kind": "news",
            "first": first,
            "layout": news.layout,
            "now": round(10 * (time.monotonic() - self.start)),
            "groups": [pack_overview(i, group, self.start) for i, group in changed],
            "notices": [
                {"axis": n.axis, "number": n.number, "wall": n.wall, **n.what}
                for n in news.notices[-TUNING.hub_notices :]
            ],
            "alarms": [alarm.to_dict() for alarm in news.alarms],
            "counters": [[name, dict(labels), value] for (name, labels), value in counters.items()],
        }

    async def overview(self) -> AsyncIterator[bytes]:
        """Lines of the stream of all axes; one comes at every turn, so that silence means that the service is gone."""
        many = sum(len(group.axes) for group in self._board.groups) > TUNING.hub_many
        version = 0
        while True:
            version, line = self._changes(version, True)
            yield line
            if not await self._wait(TUNING.overview_of_many if many else TUNING.hub_overview):
                return

    async def axis(self, name: str) -> AsyncIterator[bytes]:
        """Lines of the stream of one axis: every row, and news without the other axes."""
        feed = self._join(name)
        try:
            seen, version, turn = feed.rows, 0, 0
            while True:
                if turn % TUNING.hub_overview == 0:
                    version, line = self._changes(version, False)
                    yield line
                (missed, lines), seen = feed.get_lines_after(seen), feed.rows
                if missed:
                    self._counters.add("pmfid_page_rows_missed_total", missed)
                    yield json_line({"kind": "missed", "rows": missed})
                for line in lines:
                    yield line
                turn += 1
                if not await self._wait(1):
                    return
        finally:
            self._leave(name, feed)

    def _join(self, name: str) -> Feed:
        feed = self._feeds.get(name)
        if feed is None:
            feed = self._feeds[name] = Feed(self._board.follow(name))
        feed.viewers += 1
        return feed

    def _leave(self, name: str, feed: Feed) -> None:
        feed.viewers -= 1
        if not feed.viewers:
            feed.subscription.close()
            self._feeds.pop(name, None)
