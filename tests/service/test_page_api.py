"""The data and the rights of the page, by requests to a page that is really served."""

from __future__ import annotations

import base64
from collections.abc import Iterator

import numpy as np
import pytest

from pmfid.monitor.events import STATES
from pmfid.service.web import board as board_module
from pmfid.service.web.board import Panel, Records
from tests.service.fake_engine import DT, FakePlant, troubled
from tests.service.loopback import Served, served
from tests.tuned import set_tuning


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


def test_news_begin_with_everything_and_go_on_with_changes(page: Served) -> None:
    first = page.json("/api/news")
    assert first["first"]
    assert [alarm["axis"] for alarm in first["alarms"]] == ["gantry-x2", "gantry-z"]
    assert first["alarms"][1]["note"].startswith("Seal was changed")
    assert first["alarms"][0]["text"] == "mass is 7.8 % higher than normal (+0.16 ± 0.011 kg)"
    assert first["alarms"][0]["size"] == "3.9 times the tolerance of 2 %"
    number = page.plant.tell("gripper", event="gap", missing=3)
    second = page.json(f"/api/news?since={first['version']}")
    assert not second["first"]
    (notice,) = second["notices"]
    assert (notice["number"], notice["text"]) == (number, "3 samples are missing before this one")
    assert (second["alarms"], second["groups"]) == ([], [])
    axis, deviation = (unpacked(first["groups"][0][name]) for name in ("axis", "deviation"))
    assert axis.tolist() == list(range(6))
    news = page.plant.board.news().groups[0]
    assert deviation.tolist() == news.deviation.astype("f4").tolist()


def test_every_row_of_an_axis_that_a_browser_looks_at_arrives_bit_by_bit(
    page: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    board = page.plant.board

    def ask(after: float) -> tuple[np.ndarray, np.ndarray]:
        answer = page.json(f"/api/news?axis=gantry-y&after={after:.0f}")
        assert answer["groups"] == []
        return unpacked(answer["rows"]["number"]), unpacked(answer["rows"]["theta"][0])

    number, theta = ask(-1)
    kept = board.follow("gantry-y", -1)
    assert kept is not None
    assert (number.tolist(), theta.tobytes()) == (kept[0]["number"].tolist(), kept[0]["theta"][:, 0].tobytes())
    assert board.list_followed() == {"gantry-y"}
    made = list[Records]()
    records = Panel.records
    monkeypatch.setattr(Panel, "records", lambda panel, rows: made.append(records(panel, rows)) or made[-1])  # type: ignore[func-returns-value]
    start, found = float(number[-1]), list[bytes]()
    for _ in range(2):
        page.plant.run(1.0)
        number, theta = ask(number[-1])
        found.append(theta.tobytes())
    mine = [rows for rows in made if rows.size == round(1.0 / DT)]
    assert b"".join(found) == np.concatenate(mine)["theta"][:, 0].tobytes()
    assert number[-1] - start == round(2.0 / DT)
    set_tuning(monkeypatch, board_module, board_looking=0.0)
    assert board.list_followed() == frozenset(), "who left costs nothing"
    assert page.json("/api/news?axis=nobody")["rows"] is None


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


@pytest.mark.parametrize(
    ("path", "method", "status"),
    [
        *(
            (f"/api/trends?{query}", "GET", 404)
            for query in ("group=9&axes=1", "axes=99", "axes=-1", "group=-1&axes=1", "axes=x", "axes=", "axes=9e9")
        ),
        *(
            (f"/api/news?{query}", "GET", 400)
            for query in ("since=x", "axis=gantry-y&after=", "axis=gantry-y&after=1.5")
        ),
        ("/api/plant", "DELETE", 405),
        ("/api/plant", "POST", 405),
        ("/api/alarms/1/acknowledge", "GET", 404),
    ],
)
def test_what_is_not_there_and_odd_methods_are_refused(page: Served, path: str, method: str, status: int) -> None:
    assert page.ask(path, method=method)[0] == status
