"""The data and the rights of the page, by requests to a page that is really served."""

from __future__ import annotations

import asyncio
import base64
import json
from collections.abc import Iterator

import numpy as np
import pytest

from pmfid.errors import UsageError
from pmfid.monitor.events import STATES
from pmfid.records.record import Record
from pmfid.service.web.api import Feed, Hub, csv_of, json_line, pack_array, pack_rows
from pmfid.service.web.board import Board, Records, row_type
from pmfid.stream.outcome import Counters, Kindred
from tests.service.fake_engine import DT, FakePlant, troubled
from tests.service.loopback import Served, served, until

ODD_NAME = 'x/../<img src=x onerror="alert(1)">?#%2f'


@pytest.fixture(scope="module")
def page() -> Iterator[Served]:
    with served(troubled(12)) as found:
        yield found


def unpacked(text: str) -> np.ndarray:
    kind, _, data = text.partition(":")
    return np.frombuffer(base64.b64decode(data), "<" + kind)


def test_the_plant_is_described(page: Served) -> None:
    plant = page.json("/api/plant")
    assert plant["name"] == "hall-3"
    assert plant["states"] == list(STATES)
    assert [group["axes"] for group in plant["groups"]] == [list(group.axes) for group in page.plant.groups]
    assert plant["groups"][0]["nominal"] == [2.05, 5.4, 1.9]
    assert {"bit", "name", "advice"} == set(plant["status"][0])


def test_an_overview_begins_with_everything_and_goes_on_with_changes(page: Served) -> None:
    with page.stream("/api/stream") as lines:
        first = next(lines)
        assert first["first"]
        assert [alarm["axis"] for alarm in first["alarms"]] == ["gantry-x2", "gantry-z"]
        assert first["alarms"][1]["note"].startswith("Seal was changed")
        number = page.plant.tell("gripper", event="gap", missing=3)
        second = next(line for line in lines if line["notices"])
        assert not second["first"]
        assert [notice["number"] for notice in second["notices"]] == [number]
        assert second["alarms"] == []
    axis, deviation = (unpacked(first["groups"][0][name]) for name in ("axis", "deviation"))
    assert axis.tolist() == list(range(6))
    news = page.plant.board.news().groups[0]
    assert deviation.tolist() == news.deviation.astype("f4").tolist()


def test_lines_come_when_nothing_happens_so_that_silence_means_trouble(page: Served) -> None:
    with page.stream("/api/stream") as lines:
        now = [next(lines)["now"] for _ in range(3)]
    assert now[2] > now[0]


def test_one_axis_is_streamed_bit_by_bit(page: Served) -> None:
    board = page.plant.board
    with page.stream("/api/stream?axis=gantry-y") as lines:
        assert next(lines)["groups"] == []
        assert until(lambda: board.list_followed() == {"gantry-y"})
        mine = list[Records]()
        put = page.page._api.hub._feeds["gantry-y"].put
        board.follow("gantry-y", lambda rows: mine.append(rows) or put(rows))  # type: ignore[func-returns-value]
        page.plant.run(2.0)
        found: list[bytes] = []
        while sum(map(len, found)) < 8 * round(2.0 / DT):
            message = next(lines)
            if message["kind"] == "rows":
                found.append(unpacked(message["theta"][0]).tobytes())
    assert b"".join(found) == np.concatenate(mine)["theta"][:, 0].tobytes()
    assert until(lambda: board.list_followed() == frozenset()), "who left costs nothing"


def test_history_trends_and_reference(page: Served) -> None:
    history = page.json("/api/axis/gantry-y/history")
    kept = page.plant.board.history("gantry-y")
    assert kept is not None
    assert unpacked(history["time"]).tolist() == kept["time"].tolist()
    trends = page.json("/api/trends?group=0&axes=3,1")
    assert unpacked(trends["trends"]).size == 2 * trends["points"]
    status, headers, body = page.ask("/api/axis/gantry-y/reference.csv")
    assert (status, headers["content-type"].partition(";")[0]) == (200, "text/csv")
    lines = body.decode().splitlines()
    assert lines[0] == "t,u,counts"
    assert len(lines) == 3001


def test_metrics_and_health(page: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    assert page.ask("/metrics")[2] == b"pmfid_up 1\n"
    assert page.ask("/healthz", token=None)[::2] == (200, b"ok\n")
    monkeypatch.setattr(page.page._api, "alive", lambda: False)
    assert page.ask("/healthz", token=None)[::2] == (503, b"the engine does not run\n")


def test_an_alarm_is_acknowledged_with_a_note(page: Served) -> None:
    number = page.plant.alarm("gantry-y")
    assert page.post(f"/api/alarms/{number}/acknowledge", {"note": " belt is new "}) == 202
    alarm = page.plant.board.alarm(number)
    assert alarm is not None
    assert alarm.note == "belt is new"


def test_an_axis_is_set_as_reference() -> None:
    plant = FakePlant(2)
    plant.run(3)
    with served(plant) as page:
        assert page.post("/api/axis/gantry-x1/reference", {}) == 202
        (group, _) = page.json("/api/plant")["referred"]
        assert list(group) == ["0"]
        assert page.post("/api/axis/nobody/reference", {}) == 404


@pytest.mark.parametrize(
    ("number", "body", "kind", "status"),
    [
        ("1", b"{", "application/json", 400),
        ("1", b"[]", "application/json", 400),
        ("1", b'{"note": 3}', "application/json", 400),
        ("1", b"[" * 4000, "application/json", 400),
        ("1", b'{"note": "' + b"x" * 501 + b'"}', "application/json", 400),
        ("1", b"note=x", "application/x-www-form-urlencoded", 415),
        ("1", b'{"note": "\xff"}', "application/json", 400),
        ("999", b"{}", "application/json", 404),
        ("-1", b"{}", "application/json", 405),
        ("1" * 30, b"{}", "application/json", 404),
    ],
)
def test_what_is_no_acknowledgement(page: Served, number: str, body: bytes, kind: str, status: int) -> None:
    found, _, _ = page.ask(f"/api/alarms/{number}/acknowledge", method="POST", body=body, content_type=kind)
    assert found == status


def test_an_engine_that_has_no_room_is_reported(page: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page.plant, "acknowledge", lambda number, note: False)
    monkeypatch.setattr(page.plant, "refer", lambda axis: False)
    assert page.post("/api/alarms/1/acknowledge", {}) == 503
    assert page.post("/api/axis/gantry-y/reference", {}) == 503


def test_the_head_of_a_stream_ends(page: Served) -> None:
    status, headers, body = page.ask("/api/stream", method="HEAD")
    assert (status, headers["content-type"], body) == (200, "application/x-ndjson", b"")


@pytest.mark.parametrize(
    ("path", "method", "status"),
    [
        *(
            (f"/api/trends?{query}", "GET", 404)
            for query in ("group=9&axes=1", "axes=99", "axes=-1", "group=-1&axes=1", "axes=x", "axes=", "axes=9e9")
        ),
        ("/api/plant", "DELETE", 405),
        ("/api/plant", "POST", 405),
        ("/api/alarms/1/acknowledge", "GET", 404),
    ],
)
def test_what_is_not_there_and_odd_methods_are_refused(page: Served, path: str, method: str, status: int) -> None:
    assert page.ask(path, method=method)[0] == status


def test_a_reference_that_cannot_be_read_names_no_file(page: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(axis: str) -> Record:
        raise UsageError("/secret/place/normal.csv: no such file")

    monkeypatch.setattr(page.page._api, "reference", broken)
    status, _, body = page.ask("/api/axis/gantry-y/reference.csv")
    assert status == 404
    assert b"secret" not in body
    monkeypatch.setattr(page.page._api, "reference", lambda axis: None)
    assert page.ask("/api/axis/gantry-y/reference.csv")[0] == 404


def test_a_name_may_hold_anything() -> None:
    group = Kindred("c.toml", ("m",), ("kg",), 0.01, np.ones(1), (ODD_NAME,))
    plant = FakePlant(1)
    plant.board.arrange([group])
    with served(plant) as page:
        quoted = "".join(f"%{byte:02x}" for byte in ODD_NAME.encode())
        assert page.json(f"/api/axis/{quoted}/history")["kind"] == "history"
        assert page.json("/api/plant")["groups"][0]["axes"] == [ODD_NAME]
        with page.stream(f"/api/stream?axis={quoted}") as lines:
            assert next(lines)["kind"] == "news"


def test_files_that_a_browser_has_are_not_sent_again(page: Served) -> None:
    _, headers, body = page.ask("/app.js", token=None)
    status, _, again = page.ask("/app.js", token=None, if_none_match=headers["etag"])
    assert (status, again) == (304, b"")
    assert body


# --- written data -----------------------------------------------------------------------------------------------


def test_numbers_that_json_does_not_have_are_null_in_objects_and_exact_in_arrays() -> None:
    line = json_line({"a": float("nan"), "b": [np.float64(1.5), float("inf")], "c": np.int64(3)})
    assert json.loads(line) == {"a": None, "b": [1.5, None], "c": 3}
    values = np.array([np.nan, np.inf, -0.0, 0.1])
    assert unpacked(pack_array(values, "f8")).tobytes() == values.tobytes()


def test_rows_of_any_layout_are_packed() -> None:
    plant, pieces = FakePlant(2), list[Records]()
    plant.board.follow("gantry-x1", lambda rows: pieces.append(rows) or 0)  # type: ignore[func-returns-value]
    plant.run(2)
    rows = np.concatenate(pieces)
    columns = pack_rows(rows[::2])
    assert unpacked(str(columns["number"])).tolist() == rows["number"][::2].tolist()


def test_an_input_that_is_lost_stays_so_in_the_reference() -> None:
    record = Record(np.array([1.0, np.nan]), np.array([3, -4]), 0.5, 1.0, (), "r.csv")
    assert csv_of(record) == b"t,u,counts\n0,1,3\n0.5,nan,-4\n"


def test_who_reads_slowly_misses_rows_and_is_reported_how_many() -> None:
    plant, feed = FakePlant(2), Feed()
    plant.board.follow("gantry-x1", feed.put)
    for _ in range(100):
        plant.run(1.0)
        feed.take()
    missed, lines = feed.get_lines_after(0)
    assert len(lines) == 60
    assert missed == 40 * round(1 / DT)
    assert feed.get_lines_after(feed.rows) == (0, [])
    nearly = feed.get_lines_after(feed.rows - round(1 / DT))
    assert (nearly[0], len(nearly[1])) == (0, 1)


def test_rows_that_nobody_takes_cost_bounded_memory_and_are_counted() -> None:
    feed, piece = Feed(), np.zeros(10_000, row_type(2))
    assert sum(feed.put(piece) for _ in range(8)) == feed.dropped == 30_000
    feed.put(np.zeros(5, row_type(3)))  # another configuration
    feed.take()
    assert (feed.rows, json.loads(feed.pieces[0][1])["dropped"]) == (5, 40_000)


def test_two_hundred_browsers_are_written_for_once() -> None:
    """The page composes its data once in a turn for any number of readers."""
    plant = troubled(12)
    looks = []
    news = plant.board.news

    async def look() -> None:
        hub = Hub(plant.board, Counters())
        plant.board.news = lambda *args: looks.append(args) or news(*args)  # type: ignore[method-assign, func-returns-value]
        running = asyncio.create_task(hub.run())
        browsers = [hub.overview() for _ in range(200)]
        for _ in range(3):
            lines = await asyncio.gather(*(anext(browser) for browser in browsers))
            assert len({id(line) for line in lines}) == 1
            plant.run(1.0)
        running.cancel()
        await hub.stop()
        assert [await anext(browser, None) for browser in browsers] == [None] * 200

    asyncio.run(look())
    assert len(looks) == 3


def test_the_stream_of_an_axis_ends_with_the_service() -> None:
    plant = FakePlant(2)

    async def look() -> list[bytes]:
        hub = Hub(plant.board, Counters())
        running = asyncio.create_task(hub.run())
        lines = hub.axis("gantry-x1")
        found = [await anext(lines)]
        await hub.stop()
        found += [line async for line in lines]
        running.cancel()
        return found

    assert len(asyncio.run(look())) == 1
    assert isinstance(plant.board, Board)
    assert plant.board.list_followed() == frozenset()
