"""The page's interface, and the streams of the browsers, packed once for all browsers."""

from __future__ import annotations

import asyncio
import io
import time
from base64 import b64encode
from collections import deque
from collections.abc import AsyncIterator, Callable, Mapping
from dataclasses import dataclass, field
from threading import Lock

import numpy as np
from numpy.typing import NDArray
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response, StreamingResponse
from starlette.routing import Route

from pmfid.errors import UsageError
from pmfid.monitor.events import STATES
from pmfid.records.record import Record
from pmfid.service.sinks.plain import as_json
from pmfid.service.tuning import TUNING
from pmfid.service.web.board import Board, News, Overview, Records
from pmfid.service.web.security import json_body
from pmfid.status import ADVICE, Status
from pmfid.stream.engine import StreamEngine
from pmfid.stream.outcome import Counters


def pack_array(array: NDArray[np.generic], kind: str) -> str:
    """Return an array as `kind:base64`, where the kind is f8, f4, i4, u4 or u1, little endian.

    NaN and infinity stay unchanged.
    """
    return f"{kind}:{b64encode(np.ascontiguousarray(array, '<' + kind).tobytes()).decode('ascii')}"


def pack_rows(rows: Records) -> dict[str, object]:
    """Return the columns of rows by name. The columns of theta and std are lists with one column for each parameter.

    Whole numbers are f8, exact to 2^53, because a browser computes with this type.
    """
    kinds = dict.fromkeys(("number", "time", "u", "counts", "innovation"), "f8") | {"status": "u4", "state": "u1"}
    columns = {name: [pack_array(column, "f8") for column in rows[name].T] for name in ("theta", "std")}
    return {**columns, **{name: pack_array(rows[name], kind) for name, kind in kinds.items()}}


def pack_overview(group: int, overview: Overview, start: float) -> dict[str, object]:
    """Return the changes in a group.

    `received` is in tenths of a second after `start`, by `time.monotonic()`.
    """
    kinds = {"axis": "i4", "value": "f4", "std": "f4", "deviation": "f4", "status": "u4", "state": "u1"}
    packed = {name: pack_array(getattr(overview, name), kind) for name, kind in kinds.items()}
    return {"group": group, "received": pack_array(np.round(10 * (overview.received - start)), "i4"), **packed}


def json_line(content: Mapping[str, object]) -> bytes:
    """Return one line of NDJSON. Numbers that JSON does not have become null."""
    return as_json(content).encode() + b"\n"


@dataclass
class Feed:
    """Every row of one axis for all its viewers.

    `rows` is the number of rows so far. `dropped` is the number of rows that the page took too late. `pieces` has
    lines, each with the number of earlier rows.
    """

    viewers: int = 0
    rows: int = 0
    dropped: int = 0
    pieces: deque[tuple[int, bytes]] = field(default_factory=lambda: deque(maxlen=TUNING.hub_pieces))
    _waiting: deque[Records] = field(default_factory=deque, init=False)
    _lock: Lock = field(default_factory=Lock, init=False)

    def put(self, rows: Records) -> int:
        """Take rows in the engine's thread, and return the number of older rows that are dropped for them."""
        with self._lock:
            self._waiting.append(rows)
            before, excess = self.dropped, sum(piece.size for piece in self._waiting) - TUNING.board_waiting
            while self.dropped - before < excess and len(self._waiting) > 1:
                self.dropped += self._waiting.popleft().size
            return self.dropped - before

    def take(self) -> None:
        """Write the rows since the last call, in the page's thread."""
        with self._lock:  # only for the swap, so that no browser delays the engine
            pieces, self._waiting = self._waiting, deque()
        if pieces:  # a changed configuration may have other parameters, so earlier rows are dropped
            rows = np.concatenate([piece for piece in pieces if piece.dtype == pieces[-1].dtype])
            self.pieces.append((self.rows, json_line({"kind": "rows", "dropped": self.dropped, **pack_rows(rows)})))
            self.rows += rows.size

    def get_lines_after(self, seen: int) -> tuple[int, list[bytes]]:
        """Return the number of missed rows, and the lines of the other rows, after the first `seen` rows."""
        waiting = [(before, line) for before, line in self.pieces if before >= seen]
        missed = waiting[0][0] - seen if waiting else 0
        return missed, [line for _, line in waiting]


class Hub:
    """The hub of all streams, one for the page, in the page's event loop.

    The times of the page count from `start` by `time.monotonic()`.
    """

    def __init__(self, board: Board, counters: Counters) -> None:
        self._board, self._counters = board, counters
        self.start = time.monotonic()
        self._feeds: dict[str, Feed] = {}
        self._written: dict[tuple[int, int, bool], tuple[int, bytes]] = {}
        self._tick = asyncio.Condition()
        self._ticks = 0
        self.ended = False

    async def run(self) -> None:
        while True:
            await asyncio.sleep(TUNING.hub_tick)
            async with self._tick:
                self._ticks += 1
                for feed in self._feeds.values():
                    feed.take()
                self._tick.notify_all()

    async def stop(self) -> None:
        """End all streams."""
        async with self._tick:
            self.ended = True
            self._tick.notify_all()

    async def _wait(self, ticks: int) -> bool:
        """Wait for a number of ticks. Returns False at the end."""
        until = self._ticks + ticks
        async with self._tick:
            await self._tick.wait_for(lambda: self.ended or self._ticks >= until)
        return not self.ended

    def _changes(self, since: int, groups: bool) -> tuple[int, bytes]:
        """Return a version and a line with the changes. All browsers that ask in one tick share the line."""
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
        """Yield the lines of the stream of all axes.

        A line comes at every turn, so silence means that the service has ended.
        """
        many = sum(len(group.axes) for group in self._board.groups) > TUNING.hub_many
        version = 0
        while True:
            version, line = self._changes(version, True)
            yield line
            if not await self._wait(TUNING.overview_of_many if many else TUNING.hub_overview):
                return

    async def axis(self, name: str) -> AsyncIterator[bytes]:
        """Yield the lines for one axis, with every row of the axis and all notices."""
        if name not in self._feeds:
            self._feeds[name] = Feed()
            self._board.follow(name, self._feeds[name].put)
        feed = self._feeds[name]
        feed.viewers += 1
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
            feed.viewers -= 1
            if not feed.viewers:
                self._board.leave(name)
                del self._feeds[name]


NO_AXIS = "no axis has this name; PLANT.toml may have changed"


@dataclass
class Api:
    """The interface of the page.

    `name` is the name of the service. The other fields are arguments of `server.serve`.
    """

    name: str
    board: Board
    counters: Counters
    hub: Hub
    engine: StreamEngine
    reference: Callable[[str], Record | None]
    metrics: Callable[[], str] | None
    alive: Callable[[], bool]

    def routes(self) -> list[Route]:
        """Return the routes. Names of axes may contain any characters, even slashes, because they are never opened
        as files.
        """
        return [
            Route("/api/plant", self.plant),
            Route("/api/stream", self.stream),
            Route("/api/trends", self.trends),
            Route("/api/axis/{axis:path}/history", self.history),
            Route("/api/axis/{axis:path}/reference.csv", self.reference_csv),
            Route("/api/axis/{axis:path}/reference", self.refer, methods=["POST"]),
            Route("/api/axis/{axis:path}/anew", self.restart_numbers, methods=["POST"]),
            Route("/api/alarms/{number:int}/acknowledge", self.acknowledge, methods=["POST"]),
            Route("/metrics", self.prometheus),
            Route("/healthz", self.health),
        ]

    async def plant(self, request: Request) -> Response:
        """Answer with the plant, whose content changes only with its layout."""
        content = {
            "name": self.name,
            "layout": self.board.layout,
            "every": self.board.every,
            "states": list(STATES),
            "status": [{"bit": int(bit), "name": str(bit.name).lower(), "advice": ADVICE[bit]} for bit in Status],
            "groups": [{**vars(group), "nominal": group.nominal.tolist()} for group in self.board.groups],
            "referred": self.board.list_referred(),
        }
        return Response(json_line(content), media_type="application/json")

    async def stream(self, request: Request) -> Response:
        axis = request.query_params.get("axis")
        if axis is not None:
            self._find_axis(axis)
        if request.method == "HEAD":
            return Response(media_type=LineResponse.media_type)
        return LineResponse(self.hub.overview() if axis is None else self.hub.axis(axis))

    async def trends(self, request: Request) -> Response:
        """Answer `?group=0&axes=3,17` with the trends of these axes, in this order."""
        try:
            axes = [int(part) for part in request.query_params.get("axes", "").split(",")[: TUNING.api_trends]]
            group = int(request.query_params.get("group", "0"))
            if min([group, *axes]) < 0:
                raise IndexError
            interval, trends = self.board.trends(group, np.array(axes, np.int64))
        except (ValueError, IndexError, OverflowError):
            raise HTTPException(404, "no axis has this name") from None
        content = {"interval": interval, "points": trends.shape[1], "trends": pack_array(trends, "f4")}
        return Response(json_line(content), media_type="application/json")

    def _find_axis(self, axis: str) -> str:
        """Return the name of the axis. Raises HTTPException for an unknown axis."""
        if self.board.group_of(axis) is None:
            raise HTTPException(404, NO_AXIS)
        return axis

    async def history(self, request: Request) -> Response:
        rows = self.board.history(request.path_params["axis"])
        if rows is None:
            raise HTTPException(404, NO_AXIS)
        line = await run_in_threadpool(lambda: json_line({"kind": "history", **pack_rows(rows)}))
        return Response(line, media_type="application/json")

    async def reference_csv(self, request: Request) -> Response:
        axis = self._find_axis(request.path_params["axis"])
        try:
            record = await run_in_threadpool(self.reference, axis)
        except (UsageError, OSError):  # the message contains names of files on the machine
            raise HTTPException(404, "the reference record cannot be read; the log of the service says why") from None
        if record is None:
            raise HTTPException(
                404, "this axis has no reference record: name one in [monitor] reference of its AXIS.toml"
            )
        return Response(await run_in_threadpool(csv_of, record), media_type="text/csv")

    async def refer(self, request: Request) -> Response:
        axis = self._find_axis(request.path_params["axis"])
        return _answer_command(self.engine.refer(axis))

    async def restart_numbers(self, request: Request) -> Response:
        axis = self._find_axis(request.path_params["axis"])
        return _answer_command(self.engine.restart_numbers(axis))

    async def acknowledge(self, request: Request) -> Response:
        note = (await json_body(request)).get("note", "")
        if not isinstance(note, str) or len(note) > TUNING.api_note:
            raise HTTPException(400, f"a note must be a text of at most {TUNING.api_note} characters")
        number = request.path_params["number"]
        if self.board.alarm(number) is None:
            raise HTTPException(404, "no alarm has this number")
        return _answer_command(self.engine.acknowledge(number, note.strip()))

    async def prometheus(self, request: Request) -> Response:
        if self.metrics is None:
            raise HTTPException(404, "this service has no metrics")
        text = await run_in_threadpool(self.metrics)
        return PlainTextResponse(text, media_type="text/plain; version=0.0.4")

    async def health(self, request: Request) -> Response:
        alive = self.alive()
        return PlainTextResponse("ok\n" if alive else "the engine does not run\n", 200 if alive else 503)


def _answer_command(taken: bool) -> Response:
    if not taken:
        raise HTTPException(503, "the service is too busy at the moment; try again")
    return JSONResponse({"taken": True}, 202)


class LineResponse(StreamingResponse):
    """A response of NDJSON, which no proxy shall buffer."""

    media_type = "application/x-ndjson"

    def __init__(self, lines: AsyncIterator[bytes]) -> None:
        super().__init__(lines, headers={"x-accel-buffering": "no"})


def csv_of(record: Record) -> bytes:
    """Return the reference record of an axis for the page, with the columns t [s] from 0, u and counts.

    A long record is cut to its beginning, because a comparison needs every sample.
    """
    n = min(record.u.size, TUNING.api_rows)
    table = np.column_stack([record.dt * np.arange(n), record.u[:n], record.counts[:n]])
    text = io.StringIO()
    np.savetxt(text, table, fmt=["%.9g", "%.9g", "%d"], delimiter=",", header="t,u,counts", comments="")
    return text.getvalue().encode("ascii")
