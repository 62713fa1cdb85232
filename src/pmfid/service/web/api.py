"""The page's interface. Browsers ask for the changes since their last request."""

from __future__ import annotations

import io
import time
from base64 import b64encode
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.routing import Route

from pmfid.errors import UsageError
from pmfid.monitor.events import STATES
from pmfid.presentation import as_json
from pmfid.records.record import Record
from pmfid.service.tuning import TUNING
from pmfid.service.web.board import Board, Overview, Records
from pmfid.service.web.security import json_body
from pmfid.status import ADVICE, Status
from pmfid.stream.engine import StreamEngine
from pmfid.stream.outcome import AlarmRecord, Counters
from pmfid.stream.sentences import describe_cause, describe_size, describe_values, sentence


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


NO_AXIS = "no axis has this name; PLANT.toml may have changed"


@dataclass
class Api:
    """The interface of the page.

    `name` is the name of the service. The times of the page count from `start` by `time.monotonic()`. The other fields
    are arguments of `server.serve`.
    """

    name: str
    board: Board
    counters: Counters
    engine: StreamEngine
    reference: Callable[[str], Record | None]
    metrics: Callable[[], str] | None
    alive: Callable[[], bool]
    start: float = field(default_factory=time.monotonic, init=False)

    def routes(self) -> list[Route]:
        """Return the routes. Names of axes may contain any characters, even slashes, because they are never opened
        as files.
        """
        return [
            Route("/api/plant", self.plant),
            Route("/api/news", self.news),
            Route("/api/trends", self.trends),
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
        return _answer(content)

    async def news(self, request: Request) -> Response:
        """Answer `?since=5` with the changes since the version 5 of the board, and 0 with everything.

        With `&axis=NAME&after=800`, the answer has the rows of this axis after its sample 800 in place of the groups,
        or null for an axis that a reload has removed.
        """
        axis = request.query_params.get("axis")
        try:
            since, after = (
                int(request.query_params.get(key, start)) for key, start in (("since", "0"), ("after", "-1"))
            )
            content = await run_in_threadpool(self._news, max(since, 0), axis)
            if axis is not None:
                content["rows"] = await run_in_threadpool(self._rows, axis, after)
        except (ValueError, OverflowError):
            raise HTTPException(400, "since and after must be whole numbers") from None
        return _answer(content)

    def _news(self, since: int, axis: str | None) -> dict[str, object]:
        news = self.board.news(since, axis is None)
        changed = [(i, group) for i, group in enumerate(news.groups) if group.axis.size]
        notices = news.notices[-TUNING.api_notices :]
        return {
            "version": news.version,
            "first": since == 0,
            "layout": news.layout,
            "now": round(10 * (time.monotonic() - self.start)),
            "groups": [pack_overview(i, group, self.start) for i, group in changed],
            "notices": [
                {**n.what, "axis": n.axis, "number": n.number, "wall": n.wall, "text": text}
                for n in notices
                if (text := sentence(n.what))
            ],
            "alarms": [_describe(alarm) for alarm in news.alarms],
            "counters": [[name, dict(labels), value] for (name, labels), value in self.counters.values().items()],
        }

    def _rows(self, axis: str, after: int) -> dict[str, object] | None:
        found = self.board.follow(axis, after)
        return found and pack_rows(found[0]) | {"received": 10 * (found[1] - self.start)}

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
        return _answer(content)

    def _find_axis(self, axis: str) -> str:
        """Return the name of the axis. Raises HTTPException for an unknown axis."""
        if self.board.group_of(axis) is None:
            raise HTTPException(404, NO_AXIS)
        return axis

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


def _describe(alarm: AlarmRecord) -> dict[str, object]:
    """Return an alarm with its sentences."""
    course = {key: value for key, value in vars(alarm).items() if key != "what"}
    texts = {"text": describe_cause(alarm.what), "size": describe_size(alarm.what)}
    return {**alarm.what, **course, **texts, "now": alarm.settled and describe_values(alarm.settled)}


def _answer(content: dict[str, object]) -> Response:
    """Return JSON. Numbers that JSON does not have become null."""
    return Response(as_json(content), media_type="application/json")


def _answer_command(taken: bool) -> Response:
    if not taken:
        raise HTTPException(503, "the service is too busy at the moment; try again")
    return JSONResponse({"taken": True}, 202)


def csv_of(record: Record) -> bytes:
    """Return the reference record of an axis for the page, with the columns t [s] from 0, u and counts.

    A long record is cut to its beginning, because a comparison needs every sample.
    """
    n = min(record.u.size, TUNING.board_rows)
    table = np.column_stack([record.dt * np.arange(n), record.u[:n], record.counts[:n]])
    text = io.StringIO()
    np.savetxt(text, table, fmt=["%.9g", "%.9g", "%d"], delimiter=",", header="t,u,counts", comments="")
    return text.getvalue().encode("ascii")
