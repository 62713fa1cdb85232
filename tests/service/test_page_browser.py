"""The page in a browser: the shown data, the scripts that must not run, and the visitors without access."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pmfid.stream.outcome import Kindred
from tests.service.chromium import chromium, tab, until, violations
from tests.service.fake_engine import FakePlant, troubled
from tests.service.loopback import Served, served

HOSTILE = '"><img src=x onerror="window.hacked=1"><script>window.hacked=1</script>'
FORMULA = "=HYPERLINK(1)"


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as found:
        yield found


@pytest.fixture(scope="module")
def page() -> Iterator[Served]:
    with served(troubled(12)) as found:
        yield found


def at_overview(page: Any, served: Served) -> None:
    page.goto(served.page.start_url)
    page.wait_for_selector(".rows .row[data-kind]")


def at_axis(page: Any, served: Served, axis: str) -> None:
    at_overview(page, served)
    page.fill("#search", axis)  # rows out of sight are not in the page
    page.click(f"a.axis-name:text-is('{axis}')")
    page.wait_for_selector(".u-over")


def names(page: Any) -> list[str]:
    return [str(text) for text in page.locator(".rows .axis-name").all_inner_texts()]


def test_what_needs_someone_stands_first_and_a_new_alarm_comes_by_itself(browser: Any) -> None:
    plant = troubled(12)
    with served(plant) as there, tab(browser) as page:
        at_overview(page, there)
        plant.run(1.0)
        assert until(page, "document.querySelector('.tile[data-kind=alarm] .count').textContent === '1'")
        first = "[...document.querySelectorAll('.rows .axis-name')].slice(0, 2).map((one) => one.textContent).join()"
        assert until(page, f"{first} === 'gantry-x2,turntable'")
        plant.alarm("spindle-b", "inertia", "kg m2")
        assert until(page, "document.title.includes('2 alarms')")
        assert until(page, "document.querySelector('.rows .axis-name').textContent === 'spindle-b'"), "the newest first"
        assert "Alarm of spindle-b: inertia is 7.8\u00a0% higher than normal" in page.inner_text("#spoken")
        assert page.inner_text("#alarmed").split()[0] == "2"
        assert violations(page) == []


@pytest.mark.long
def test_the_token_leaves_the_address_at_once_and_survives_a_reload(browser: Any, page: Served) -> None:
    with tab(browser) as there:
        at_overview(there, page)
        assert there.url == page.page.url + "#/"
        there.click("a.axis-name >> nth=0")
        there.go_back()
        assert page.token not in there.url
        there.reload()
        there.wait_for_selector(".rows .row[data-kind]")
        assert there.context.cookies() == []
        there.evaluate("sessionStorage.clear()")
        there.goto(page.page.url + "#/")
        there.reload()
        there.wait_for_selector("form.token")
        assert violations(there) == []
        there.fill("#token", "wrong")
        there.click("form.token button")
        there.wait_for_selector("form.token")
        there.fill("#token", page.token)
        there.click("form.token button")
        there.wait_for_selector(".rows .row[data-kind]")


@pytest.mark.long
def test_an_alarm_is_acknowledged_with_a_note_by_keyboard_alone(browser: Any) -> None:
    plant = troubled(12)
    with served(plant) as there, tab(browser) as page:
        at_overview(page, there)
        page.focus(".card .strong")
        page.keyboard.press("Enter")
        page.keyboard.type("gripper was changed")
        assert violations(page) == []
        page.keyboard.press("Tab")
        page.keyboard.press("Tab")
        page.keyboard.press("Enter")
        assert until(page, "document.querySelectorAll('.card.alarm').length === 0")
        (alarm,) = [one for one in plant.board.news().alarms if one.axis == "gantry-x2"]
        assert alarm.note == "gripper was changed"


@pytest.mark.long
def test_one_axis_is_live_stands_still_and_gives_what_is_seen(browser: Any, tmp_path: Path) -> None:
    plant = troubled(12)
    with served(plant) as there, tab(browser) as page:
        at_axis(page, there, "gantry-x2")
        assert until(page, "document.querySelector('.value').textContent.startsWith('2.')")
        plant.run(2.0)
        assert until(page, "document.querySelector('.axis .pill').textContent === 'Alarm'")
        page.click("text=Pause")
        for _ in range(3):
            plant.run(1.0)
        assert until(page, "document.querySelector('.title .fine').textContent.includes('paused')")
        page.click(".spans button >> nth=1")
        with page.expect_download() as download:
            page.click("text=Save as CSV")
        lines = Path(download.value.path()).read_text().splitlines()
        assert lines[0].startswith("t [s],u [N],counts,mass [kg],mass_std [kg],")
        kept = plant.board.follow("gantry-x2", -1)
        assert kept is not None
        theta = dict(zip(kept[0]["time"].tolist(), kept[0]["theta"][:, 0].tolist(), strict=True))
        rows = [[float(cell) for cell in line.split(",")[:4]] for line in lines[2:]]
        assert len(rows) > 50
        assert all(theta[row[0]] == row[3] for row in rows if row[0] in theta), "to the last bit"
        page.click("text=Compare with reference")
        page.wait_for_selector(".compare tbody tr")
        reference, seen = (
            float(text.split()[0]) for text in page.locator(".compare tr >> nth=1 >> td").all_inner_texts()
        )
        record = plant.reference("gantry-x2")
        assert record is not None
        assert reference == pytest.approx(np.sqrt(np.mean(record.u**2)), rel=1e-3)
        inputs = np.array([float(line.split(",")[1]) for line in lines[1:]])
        assert seen == pytest.approx(np.sqrt(np.mean(inputs**2)), rel=0.02), "of every row, not of points"
        page.click("summary >> nth=0")
        page.wait_for_selector(".scrolled tbody tr")
        assert violations(page) == []


def test_script_in_a_name_a_unit_a_topic_and_a_note_does_not_run(browser: Any) -> None:
    plant = FakePlant(1)
    group = Kindred(
        HOSTILE + "c.toml",
        (FORMULA, HOSTILE),
        (HOSTILE, "N"),
        0.01,
        np.ones(2),
        (HOSTILE, "calm"),
        HOSTILE,
        1.0,
        HOSTILE,
    )
    plant.groups = [group]
    plant.board.arrange([group])
    plant.run(3.0)
    number = plant.alarm(HOSTILE, HOSTILE, HOSTILE)
    plant.tell("calm", event="source", source=HOSTILE, topic=HOSTILE, problem=HOSTILE)
    plant.tell(HOSTILE, event=HOSTILE, note=HOSTILE)
    with served(plant) as there, tab(browser) as page:
        at_overview(page, there)
        page.evaluate("document.querySelectorAll('details').forEach((one) => (one.open = true))")
        assert page.locator(".rows .axis-name").first.inner_text() == HOSTILE
        assert HOSTILE in page.inner_text(".log")
        page.click(".rows .axis-name >> nth=0")
        page.wait_for_selector(".u-over")
        plant.run(1.0)
        plant.acknowledge(number, HOSTILE)
        assert until(page, "document.querySelectorAll('.card.known').length === 1")
        assert HOSTILE in page.inner_text(".card.known")
        with page.expect_download() as download:
            page.click("text=Save as CSV")
        assert "/" not in download.value.suggested_filename
        assert f"\"'{FORMULA}" in Path(download.value.path()).read_text()
        assert page.evaluate("window.hacked") is None
        assert page.locator("main img, main script").count() == 0


# --- long tests -------------------------------------------------------------------------------------------------------

VIEWS = [(1440, "light"), (1440, "dark"), (768, "light"), (390, "light"), (390, "dark")]


@pytest.mark.long
@pytest.mark.parametrize(("width", "theme"), VIEWS)
def test_no_view_breaks_a_rule_of_accessibility_or_is_too_wide(
    browser: Any, page: Served, width: int, theme: str
) -> None:
    open_all = "document.querySelectorAll('details').forEach((one) => (one.open = true))"
    wide = "document.documentElement.scrollWidth"
    with tab(browser, width, 844, theme) as there:
        at_overview(there, page)
        for axis in (None, "feeder-2", "gantry-z", "turntable"):
            if axis is not None:
                at_axis(there, page, axis)
                there.click(".spans button >> nth=3")
                there.click("text=Compare with reference")
                there.wait_for_selector(".compare tbody tr")
            there.evaluate(open_all)
            there.wait_for_timeout(400)
            assert violations(there) == [], axis
            assert there.evaluate(wide) <= width, axis


@pytest.mark.long
def test_ten_thousand_axes_stay_usable(browser: Any) -> None:
    plant = troubled(10_000)
    with served(plant) as there, tab(browser) as page:
        at_overview(page, there)
        rows = page.locator(".rows .row")
        assert rows.count() < 60
        assert page.get_attribute(".axes", "aria-rowcount") == "10001"
        assert names(page)[:2] == ["cell-04711", "cell-00042"], "the newest alarm first"
        page.fill("#search", "04711")
        assert until(page, "document.querySelectorAll('.rows .row').length === 1")
        page.fill("#search", "")
        page.select_option("#sort", "deviation")
        assert until(page, "document.querySelectorAll('.rows .row').length > 1")
        page.evaluate("scrollTo(0, document.documentElement.scrollHeight)")
        assert until(page, "[...document.querySelectorAll('.rows .row')].some((one) => one.ariaRowIndex === '10001')")
        page.evaluate("scrollTo(0, 0)")
        page.select_option("#sort", "name")
        page.focus(".axis-name")
        for _ in range(40):
            page.keyboard.press("ArrowDown")
        assert page.evaluate("document.activeElement.textContent") == "cell-00040"
        plant.run(1.0)
        plant.alarm("cell-07777")
        assert until(page, "document.title.includes('3 alarms')")
        assert violations(page) == []


@pytest.mark.long
def test_a_lost_service_is_said_and_found_again(browser: Any) -> None:
    plant = troubled(12)
    with served(plant) as first:
        port, token = first.address[1], first.token
        with tab(browser) as page:
            at_axis(page, first, "gantry-y")
            first.page.stop()
            page.wait_for_selector("#lost:not([hidden])")
            assert "What you see is old" in page.inner_text("#lost")
            assert violations(page) == []
            with pytest.MonkeyPatch.context() as patch:
                patch.setenv("PAGE_TOKEN", token)
                again = _again(plant, port)
            assert until(page, "document.getElementById('lost').hidden")
            plant.run(1.0)
            assert until(page, "document.getElementById('connection').textContent === 'live'")
            again.stop()


def _again(plant: FakePlant, port: int) -> Any:
    from pmfid.service.web.config import PageConfig
    from pmfid.service.web.server import serve

    config = PageConfig(port=port, token="env:PAGE_TOKEN")
    return serve(config, "hall-3", plant.board, plant.counters, plant, folder=Path.cwd())
