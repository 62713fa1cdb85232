"""The page's interface."""

from __future__ import annotations

import asyncio
import io
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.routing import Route
from starlette.types import Receive, Scope, Send

from pmfid.errors import UsageError
from pmfid.monitor.events import STATES
from pmfid.records.record import Record
from pmfid.service.board import Board
from pmfid.service.tuning import TUNING
from pmfid.service.web.hub import Hub, json_line, pack_array, pack_rows
from pmfid.service.web.security import json_body
from pmfid.status import ADVICE, Status
from pmfid.stream.commands import Counters
from pmfid.stream.outcome import Kindred

__all__ = ["Acts"]


class Acts(Protocol):
    """No command waits; each returns False if the queue of commands is full. A `Notice` reports its result:
    "acknowledged" with "alarm" (the number) and "note", "reference", or the event of `restart_numbers`."""

    def acknowledge(self, number: int, note: str) -> bool:
        """Acknowledges the alarm with this notice number."""
        ...

    def refer(self, axis: str) -> bool:
        """Makes the present parameters of the axis its reference."""
        ...

    def restart_numbers(self, axis: str) -> bool:
        """Has the next samples of the axis taken whatever their numbers."""
        ...


@dataclass
class Api:
    """name: of the service; streams: that may be open at once; the others as `server.serve` is given them."""

    name: str
    board: Board
    counters: Counters
    hub: Hub
    acts: Acts
    reference: Callable[[str], Record | None]
    metrics: Callable[[], str] | None
    alive: Callable[[], bool]
    streams: int

    def routes(self) -> list[Route]:
        """Names of axes may hold anything, slashes included: they are looked up, never opened."""
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
        """The plant: content that changes only with its layout."""
        content = {
            "name": self.name,
            "may": request.scope["may"],
            "layout": self.board.layout,
            "every": self.board.every,
            "states": list(STATES),
            "status": [{"bit": int(bit), "name": str(bit.name).lower(), "advice": ADVICE[bit]} for bit in Status],
            "groups": [_group(group) for group in self.board.groups],
            "referred": self.board.list_referred(),
        }
        return Response(json_line(content), media_type="application/json")

    async def stream(self, request: Request) -> Response:
        axis = request.query_params.get("axis")
        if axis is not None:
            self._find_group(axis)
        if request.method == "HEAD":
            return Response(media_type=LineResponse.media_type)
        if self.hub.streams >= self.streams:
            self.counters.add("pmfid_page_refused_total", reason="streams")
            raise HTTPException(503, "as many browsers look already as [page] browsers allows")
        return LineResponse(self.hub, self.hub.overview() if axis is None else self.hub.axis(axis))

    async def trends(self, request: Request) -> Response:
        """`?group=0&axes=3,17`: their trends, in this order."""
        try:
            axes = [int(part) for part in request.query_params.get("axes", "").split(",")[: TUNING.api_trends]]
            group = int(request.query_params.get("group", "0"))
            if min([group, *axes]) < 0:
                raise IndexError
            interval, trends = self.board.trends(group, np.array(axes, np.int64))
        except (ValueError, IndexError, OverflowError):
            raise HTTPException(404, "there is no such axis") from None
        content = {"interval": interval, "points": trends.shape[1], "trends": pack_array(trends, "f4")}
        return Response(json_line(content), media_type="application/json")

    def _find_group(self, axis: str) -> Kindred:
        group = self.board.group_of(axis)
        if group is None:
            raise HTTPException(404, "there is no axis of that name; PLANT.toml may have changed")
        return group

    async def history(self, request: Request) -> Response:
        rows = self.board.history(request.path_params["axis"])
        if rows is None:
            raise HTTPException(404, "there is no axis of that name; PLANT.toml may have changed")
        line = await run_in_threadpool(lambda: json_line({"kind": "history", **pack_rows(rows)}))
        return Response(line, media_type="application/json")

    async def reference_csv(self, request: Request) -> Response:
        axis = request.path_params["axis"]
        self._find_group(axis)
        try:
            record = await run_in_threadpool(self.reference, axis)
        except (UsageError, OSError):  # the sentence names files of the machine
            raise HTTPException(404, "the reference record cannot be read; the log of the service says why") from None
        if record is None:
            raise HTTPException(
                404, "this axis has no reference record: [monitor] reference of its AXIS.toml names one"
            )
        return Response(await run_in_threadpool(csv_of, record), media_type="text/csv")

    async def refer(self, request: Request) -> Response:
        axis = request.path_params["axis"]
        self._find_group(axis)
        return _answer_command(self.acts.refer(axis))

    async def restart_numbers(self, request: Request) -> Response:
        axis = request.path_params["axis"]
        self._find_group(axis)
        return _answer_command(self.acts.restart_numbers(axis))

    async def acknowledge(self, request: Request) -> Response:
        note = (await json_body(request)).get("note", "")
        if not isinstance(note, str) or len(note) > TUNING.api_note:
            raise HTTPException(400, f"a note is a text of {TUNING.api_note} characters at most")
        number = request.path_params["number"]
        if self.board.alarm(number) is None:
            raise HTTPException(404, "there is no alarm of that number")
        return _answer_command(self.acts.acknowledge(number, note.strip()))

    async def prometheus(self, request: Request) -> Response:
        if self.metrics is None:
            raise HTTPException(404, "there are no metrics")
        text = await run_in_threadpool(self.metrics)
        return PlainTextResponse(text, media_type="text/plain; version=0.0.4")

    async def health(self, request: Request) -> Response:
        alive = self.alive()
        return PlainTextResponse("ok\n" if alive else "the engine stands still\n", 200 if alive else 503)


def _group(group: Kindred) -> dict[str, object]:
    return {
        "config": group.config,
        "names": group.names,
        "units": group.units,
        "dt": group.dt,
        "nominal": group.nominal.tolist(),
        "axes": group.axes,
        "input_unit": group.input_unit,
        "resolution": group.resolution,
        "position_unit": group.position_unit,
    }


def _answer_command(taken: bool) -> Response:
    if not taken:
        raise HTTPException(503, "the service has too much to do at the moment; try again")
    return JSONResponse({"taken": True}, 202)


class LineResponse(Response):
    """A response of NDJSON that ends when the browser leaves, which only `receive` reports."""

    media_type = "application/x-ndjson"

    def __init__(self, hub: Hub, lines: AsyncIterator[bytes]) -> None:
        super().__init__()
        self._hub, self._lines = hub, lines

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        self._hub.streams += 1
        writing = asyncio.create_task(self._write(send))
        leaving = asyncio.create_task(_wait_for_leave(receive))
        try:
            done, _ = await asyncio.wait({writing, leaving}, return_when=asyncio.FIRST_COMPLETED)
            if writing in done:
                writing.result()
        finally:
            self._hub.streams -= 1
            for task in (writing, leaving):
                task.cancel()
            await asyncio.gather(writing, leaving, return_exceptions=True)

    async def _write(self, send: Send) -> None:
        kind = [(b"content-type", b"application/x-ndjson"), (b"x-accel-buffering", b"no")]
        await send({"type": "http.response.start", "status": 200, "headers": kind})
        async for line in self._lines:
            await send({"type": "http.response.body", "body": line, "more_body": True})
        await send({"type": "http.response.body", "body": b"", "more_body": False})


async def _wait_for_leave(receive: Receive) -> None:
    while (await receive())["type"] != "http.disconnect":
        pass


def csv_of(record: Record) -> bytes:
    """The reference record of an axis, as the page compares with it: columns t [s] from 0, u and counts; of a long
    record its beginning, for a comparison needs every sample."""
    n = min(record.u.size, TUNING.api_rows)
    table = np.column_stack([record.dt * np.arange(n), record.u[:n], record.counts[:n]])
    text = io.StringIO()
    np.savetxt(text, table, fmt=["%.9g", "%.9g", "%d"], delimiter=",", header="t,u,counts", comments="")
    return text.getvalue().encode("ascii")
