"""Access to the page: requests as an attacker would write them, to a page that is really served."""

from __future__ import annotations

import io
import socket
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from starlette.datastructures import Headers

from pmfid.service.plant import Plant, ServiceSection
from pmfid.service.run import Service
from pmfid.service.sinks.plain import NoticeLog
from pmfid.service.tuning import TUNING
from pmfid.service.web.board import Board
from pmfid.service.web.config import PageConfig
from pmfid.service.web.security import Token, load_token
from pmfid.service.web.server import serve
from pmfid.stream.outcome import Counters
from tests.refusals import refused
from tests.service.fake_engine import FakePlant
from tests.service.loopback import Served, received, served, until

SCRIPT = "<script>alert(1)</script>"


@pytest.fixture(scope="module")
def page() -> Iterator[Served]:
    plant = FakePlant(12)
    plant.run(5)
    with served(plant) as found:
        yield found


# --- host names and origins -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", ["/", "/api/plant", "/metrics", "/healthz", "/no-such-file"])
@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:{port}", "127.0.0.1", "127.0.0.1:1", "127.0.0.1.evil:{port}"]
)
def test_another_host_is_refused_whatever_is_asked_for(page: Served, path: str, host: str) -> None:
    before = page.counted("refused", reason="host")
    status, _, _ = page.ask(path, host=host.format(port=page.address[1]))
    assert status == 421
    assert page.counted("refused", reason="host") == before + 1


FOREIGN = ("http://evil.example", "null", "http://127.0.0.1:1", "http://localhost", "")
ACKNOWLEDGE = "/api/alarms/1/acknowledge"
STYLED, OWN = {"sec_fetch_mode": "no-cors"}, {"sec_fetch_mode": "navigate"}
#: The path of a request, its headers ({port}, {host} and {token} are those of the page), and the status of the answer.
#: What a browser calls another site or port may follow a link alone; the token counts in its header alone.
ASKED: list[tuple[str, dict[str, str | None], int]] = [
    *(("/api/plant", {"host": host}, 200) for host in ("localhost:{port}", "LOCALHOST:{port}", "[::1]:{port}")),
    *(("/api/plant", {"origin": origin}, 403) for origin in FOREIGN),
    *((ACKNOWLEDGE, {"origin": origin, "method": "POST"}, 403) for origin in FOREIGN),
    ("/api/plant", {"origin": "http://{host}"}, 200),
    *(("/style.css", {"sec_fetch_site": site, **STYLED}, 403) for site in ("cross-site", "same-site")),
    *(("/", {"sec_fetch_site": site, **OWN}, 200) for site in ("cross-site", "same-site")),
    *(("/api/plant", {"sec_fetch_site": site, **OWN, "token": None}, 401) for site in ("cross-site", "same-site")),
    ("/api/plant?token={token}", {"token": None}, 401),
    ("/api/plant", {"token": None, "cookie": "token={token}"}, 401),
    ("/api/plant", {"token": None, "authorization": "Basic {token}"}, 401),
    ("/api/plant", {"token": None, "authorization": "bearer {token}"}, 200),
]


@pytest.mark.parametrize(("path", "headers", "status"), ASKED)
def test_hosts_origins_and_tokens(page: Served, path: str, headers: dict[str, str | None], status: int) -> None:
    own = {"port": page.address[1], "host": page.host, "token": page.token}
    written = {name: text and text.format(**own) for name, text in headers.items()}
    body = b"{}" if path == ACKNOWLEDGE else b""
    assert page.ask(path.format(**own), body=body, **written)[0] == status


# --- tokens -----------------------------------------------------------------------------------------------------------

CLOSED = [
    *("/api/plant", "/api/news", "/api/news?axis=gantry-y", "/api/trends?group=0&axes=1", "/metrics"),
    *("/api/none",),
]


@pytest.mark.parametrize("path", CLOSED)
@pytest.mark.parametrize("token", [None, "wrong", "x" * 43])
def test_nothing_of_the_plant_without_the_token(page: Served, path: str, token: str | None) -> None:
    status, headers, body = page.ask(path, token=token)
    assert status == 401
    assert headers["www-authenticate"] == "Bearer"
    assert b"gantry" not in body


def test_one_token_in_one_header_opens_the_page() -> None:
    def opens(*headers: str) -> bool:
        return Token("w" * 30).opens(Headers(raw=[(b"authorization", header.encode()) for header in headers]))

    assert not any(opens(header) for header in ("", "Bearer", "Bearer ", "Bearer  ", "Basic " + "w" * 30, "w" * 30))
    assert opens("Bearer " + "w" * 30)
    assert not opens(*["Bearer " + "w" * 30] * 2)


def test_files_are_open_and_hold_no_token(page: Served) -> None:
    for path in ("/", "/app.js", "/vendor/uPlot.iife.min.js", "/vendor/uPlot-LICENSE.txt"):
        status, _, body = page.ask(path, token=None)
        assert status == 200
        assert page.token.encode() not in body


# --- sizes and times --------------------------------------------------------------------------------------------------


def _head(page: Served, path: str, *lines: str) -> bytes:
    head = [f"POST {path} HTTP/1.1", f"Host: {page.host}", f"Authorization: Bearer {page.token}"]
    return "\r\n".join([*head, "Content-Type: application/json", *lines, "", ""]).encode()


def _flood(page: Served, head: bytes, piece: bytes) -> tuple[int, bytes]:
    """Return the number of accepted bytes of at most 64 MB, and the answer."""
    sent = 0
    with socket.create_connection(page.address, timeout=2) as line:
        line.sendall(head)
        try:
            while sent < 64e6:
                line.sendall(piece)
                sent += len(piece)
        except OSError:
            pass
        return sent, received(line)


def test_a_body_of_a_gigabyte_is_refused_before_it_is_read(page: Served) -> None:
    answer = page.raw(_head(page, "/api/axis/gantry-y/reference", "Content-Length: 1000000000"))
    assert answer.startswith(b"HTTP/1.1 413 ")
    assert b"connection: close" in answer.lower()
    sent, _ = _flood(page, _head(page, "/api/axis/gantry-y/reference", "Content-Length: 1000000000"), b"x" * 65536)
    assert sent < 16e6, "what the sockets of both sides hold, and no more"


def test_a_body_without_a_length_is_counted_while_it_comes(page: Served) -> None:
    number = page.plant.alarm("gantry-y")
    head = _head(page, f"/api/alarms/{number}/acknowledge", "Transfer-Encoding: chunked")
    answer = page.raw(head + b"2000\r\n" + b" " * 0x2000 + b"\r\n")
    assert answer.startswith(b"HTTP/1.1 413 ")
    sent, _ = _flood(page, head, b"4000\r\n" + b" " * 0x4000 + b"\r\n")
    assert sent < 16e6


def test_a_browser_that_looks_at_an_axis_keeps_a_bounded_part_of_its_rows() -> None:
    with served(FakePlant(2)) as page:
        assert page.ask("/api/news?axis=gantry-x1")[0] == 200
        for _ in range(100):
            page.plant.run(10.0)
        (followed,) = page.plant.board._followed.values()
        assert sum(piece.size for piece in followed.pieces) <= TUNING.board_rows


# --- paths and reflected text -----------------------------------------------------------------------------------------

OUT = [
    *("/../server.py", "/../../../../../../../../etc/passwd", "/%2e%2e/server.py", "/..%2fserver.py"),
    *("/..%5cserver.py", "/vendor/../../server.py", "/./../server.py", "//etc/passwd", "/%00"),
    *("/style.css%00.txt", "/static/style.css", "/vendor", "/api/axis/../../../etc/passwd/reference.csv"),
    *("/api/axis/%2fetc%2fpasswd/reference.csv",),
]


@pytest.mark.parametrize("path", OUT)
def test_no_path_leads_out(page: Served, path: str) -> None:
    status, _, body = page.ask(path)
    assert status == 404
    assert b"import" not in body
    assert b"root:" not in body


@pytest.mark.parametrize("path", [f"/{SCRIPT}", f"/api/axis/{SCRIPT}/reference.csv", f"/api/trends?axes={SCRIPT}"])
def test_nothing_that_was_sent_comes_back(page: Served, path: str) -> None:
    answer = page.raw(
        f"GET {path} HTTP/1.1\r\nHost: {page.host}\r\nAuthorization: Bearer {page.token}\r\n"
        f"X-Odd: {SCRIPT}\r\nConnection: close\r\n\r\n".encode()
    )
    assert answer.startswith(b"HTTP/1.1 404 ")
    assert b"alert" not in answer


@pytest.mark.parametrize("path", ["/", "/app.js", "/api/plant", "/api/none", "/metrics", "/healthz", "/none"])
@pytest.mark.parametrize("token", ["", None])
def test_every_answer_has_its_guards(page: Served, path: str, token: str | None) -> None:
    _, headers, _ = page.ask(path, token=token)
    assert headers["content-security-policy"].startswith("default-src 'self';")
    assert "frame-ancestors 'none'" in headers["content-security-policy"]
    assert "unsafe" not in headers["content-security-policy"]
    assert headers["x-content-type-options"] == "nosniff"
    assert headers["x-frame-options"] == "DENY"
    assert headers["referrer-policy"] == "no-referrer"
    assert "server" not in headers
    assert "set-cookie" not in headers
    assert not {name for name in headers if name.startswith("access-control-")}
    assert headers["cache-control"] == ("no-store" if path.startswith(("/api", "/metrics")) else "no-cache")


def test_what_fails_inside_says_nothing_of_the_inside_but_to_the_log(
    page: Served, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(page.plant.board, "list_referred", lambda: 1 / 0)
    status, _, body = page.ask("/api/plant")
    assert status == 500
    assert b"ZeroDivision" not in body
    assert b"Traceback" not in body
    assert until(lambda: "ZeroDivisionError" in caplog.text)


# --- configuration ----------------------------------------------------------------------------------------------------


def test_another_address_asks_for_two_decisions() -> None:
    refused(
        ("file:page.token", lambda: PageConfig(address="0.0.0.0")),
        ("hosts = ", lambda: PageConfig(address="0.0.0.0", token="env:T")),
    )
    config = PageConfig(address="0.0.0.0", token="env:T", hosts=("hall.example:8127",))
    assert not config.local
    assert PageConfig(address="::1").local
    assert not PageConfig(address="192.0.2.7", token="env:T").local


def test_a_page_for_others_says_so_and_shows_no_token(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PAGE_TOKEN", "a-token-of-our-own-0123456789")
    config = PageConfig(address="0.0.0.0", port=0, token="env:PAGE_TOKEN", hosts=("hall.example:8127",))
    page = serve(config, "hall-3", Board([]), Counters(), FakePlant(1), folder=tmp_path)
    page.stop()
    page.stop()
    assert page.start_url == "http://hall.example:8127/"
    assert any("other machines" in note for note in page.notes)
    assert any("unencrypted" in note for note in page.notes)
    assert not any("0123456789" in note for note in page.notes)


def test_what_cannot_be_served_is_reported(page: Served, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NO_TOKEN", raising=False)
    taken = PageConfig(port=page.address[1])
    refused(
        (
            "token = 'env:NO_TOKEN': the environment variable NO_TOKEN is not set",
            lambda: load_token(PageConfig(token="env:NO_TOKEN"), tmp_path),
        ),
        ("cannot be read", lambda: load_token(PageConfig(token="file:none"), tmp_path)),
        (
            "choose another port",
            lambda: serve(taken, "hall-3", Board([]), Counters(), FakePlant(1), folder=tmp_path),
        ),
    )
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    monkeypatch.delitem(sys.modules, "pmfid.service.web.server")
    plant = Plant(tmp_path, ServiceSection(), {}, {})
    refused(
        (r"pip install 'pmfid\[serve\]'", lambda: Service(lambda: plant, NoticeLog(io.StringIO()))._serve_page(plant))
    )
