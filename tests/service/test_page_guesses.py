"""Guesses of a token are slowed down by address; a client with a token is never slowed down."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import pytest

from pmfid.service.tuning import TUNING
from pmfid.service.web import security
from pmfid.service.web.security import Brake
from tests.service.chromium import chromium, tab
from tests.service.fake_engine import FakePlant
from tests.service.loopback import Served, served
from tests.tuned import set_tuning


@dataclass
class Clock:
    now: float = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def page() -> Iterator[Served]:
    with served(FakePlant(2)) as found:
        yield found


def test_who_guesses_is_asked_to_wait_and_who_knows_gets_in(page: Served) -> None:
    answers = [page.ask("/api/plant", token=f"guess-{k}") for k in range(TUNING.security_free + 5)]
    assert [status for status, _, _ in answers] == [401] * TUNING.security_free + [429] * 5
    _, headers, body = answers[-1]
    assert 0 < int(headers["retry-after"]) <= TUNING.security_window
    assert b"too many wrong tokens" in body
    assert b"guess" not in body
    assert page.counted("refused", reason="guesses") == 5
    for path in ("/api/plant", "/metrics"):
        assert page.ask(path)[0] == 200, "the right token, from the same address, in the same second"
    assert page.post("/api/axis/gantry-x1/anew", {}) == 202
    assert page.ask("/api/plant", token=None)[0] == 401, "none at all is no guess"
    assert page.ask("/healthz", token=None)[0] == 200


def test_guesses_of_every_form_count(page: Served) -> None:
    head = f"GET /api/plant HTTP/1.1\r\nHost: {page.host}\r\nConnection: close\r\n"
    forms = ["Basic YTpi", "Bearer", "Bearer x\r\nAuthorization: Bearer y", f"Digest {page.token}", "x" * 5000]
    found = [page.raw(f"{head}Authorization: {form}\r\n\r\n".encode()).split()[1] for form in 3 * forms]
    assert found == [b"401"] * TUNING.security_free + [b"429"] * (3 * len(forms) - TUNING.security_free)


def test_a_person_with_a_wrong_token_too_often_can_still_type_the_right_one(page: Served) -> None:
    for k in range(TUNING.security_free):
        page.ask("/api/plant", token=f"guess-{k}")
    with chromium() as browser, tab(browser) as there:
        there.goto(f"{page.page.url}#token=wrong")
        there.wait_for_selector("form.token .problem")
        assert "too many wrong tokens were sent; try again in" in there.inner_text("form.token .problem")
        there.fill("#token", page.token)
        there.click("form.token button")
        there.wait_for_selector(".rows .row[data-kind]")


def test_the_time_to_wait_ends_and_begins_again() -> None:
    clock = Clock()
    one = Brake(clock)
    assert [one.wrong("192.0.2.7") for _ in range(TUNING.security_free)] == [0.0] * TUNING.security_free
    clock.now = 20.0
    assert one.wrong("192.0.2.7") == TUNING.security_window - 20.0
    assert one.wrong("192.0.2.8") == 0.0, "another address"
    clock.now = TUNING.security_window
    assert [one.wrong("192.0.2.7") for _ in range(TUNING.security_free + 1)] == [0.0] * TUNING.security_free + [
        TUNING.security_window
    ]


def test_an_address_of_the_same_network_is_the_same_one() -> None:
    one = Brake(Clock())
    assert max(one.wrong(f"2001:db8::{k:x}") for k in range(TUNING.security_free)) == 0.0
    assert one.wrong("2001:db8::ffff%eth0") > 0
    assert one.wrong("2001:db8:0:1::1") == 0.0
    assert one.wrong("") == 0.0


def test_memory_is_bounded_and_the_latest_are_known(monkeypatch: pytest.MonkeyPatch) -> None:
    set_tuning(monkeypatch, security, security_addresses=100)
    one = Brake(Clock())
    for _ in range(TUNING.security_free):
        one.wrong("192.0.2.7")
    for k in range(5000):
        one.wrong(f"10.0.{k // 256}.{k % 256}")
        if k % 50 == 0:
            assert one.wrong("192.0.2.7") > 0, "who goes on is not forgotten for others"
    assert len(one._wrong) == 100
