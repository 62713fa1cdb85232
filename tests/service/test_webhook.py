"""Alarms by POST: each once, within a time limit, only to the given address, and without secrets in notices."""

from __future__ import annotations

import json
import math
import ssl
import subprocess
from functools import partial
from pathlib import Path
from shutil import which

import pytest

from pmfid.errors import UsageError
from pmfid.service.context import RefusedError
from pmfid.service.sinks.webhook import WebhookSection, WebhookSink
from tests.patience import PATIENCE
from tests.refusals import refused
from tests.service.feed import Host, alarm, notice, queue_of, until
from tests.service.web_servers import bad_server, web_server
from tests.tuned import set_tuning

TOKEN = "Bearer s3cret-of-the-hall"


def hook(folder: Path, url: str, **keys: object) -> WebhookSink:
    sink = WebhookSection(url=url, **keys).make("hook", Host(folder))  # type: ignore[arg-type]
    sink.open()
    return sink


def test_an_alarm_is_posted_as_json(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOOK_SECRET", TOKEN)
    with web_server() as server:
        sink = hook(tmp_path, f"{server.url}/in?a=1", secret="env:HOOK_SECRET", secret_header="X-Token")
        sink.put([alarm(7, std=math.inf), notice(1_700_000_000_000_000, "acknowledged", alarm=7, note='"<é>')])
    (path, headers, body), (_, others, other) = server.got
    assert path == "/in?a=1"
    assert headers["X-Token"] == TOKEN
    assert headers["Content-Type"] == "application/json"
    assert headers["Idempotency-Key"] != others["Idempotency-Key"]
    reported = json.loads(body)
    assert reported["service"] == "hall-3"
    assert (reported["axis"], reported["number"], reported["event"], reported["parameter"]) == (
        "x1",
        7,
        "alarm",
        "mass",
    )
    assert (reported["relative"], reported["std"]) == (0.2, None)
    assert (json.loads(other)["alarm"], json.loads(other)["note"]) == (7, '"<é>')


def test_each_alarm_goes_out_once_whatever_fails_between(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    set_tuning(monkeypatch, "pmfid.service.sinks.queued", first_pause=0.01)
    host = Host(tmp_path)
    # the second alarm is tried three times, the third is refused because of its content, once
    with web_server(200, 500, 503, 200, 422, 200) as server:
        outlet = queue_of(WebhookSection(url=server.url), "hook", host)
        for number in (1, 2, 3, 4, 5):
            outlet.notice(alarm(number))
        outlet.start()
        assert until(lambda: len(server.got) == 7)
        assert outlet.close(PATIENCE)
    numbers = [json.loads(body)["number"] for _, _, body in server.got]
    assert numbers == [1, 2, 2, 2, 3, 4, 5]
    assert host.count("pmfid_refused_total", sink="hook") == 1
    assert [reported.get("problem") for reported in host.reported] == [
        "the server refuses the message with HTTP status 500",
        None,
        "refused: the server refuses the message with HTTP status 422",
    ]


def test_another_address_is_not_followed(tmp_path: Path) -> None:
    with web_server(302) as server:
        refused(("302 with another address", lambda: hook(tmp_path, server.url).put([alarm(1)])), kind=OSError)
        assert [path for path, _, _ in server.got] == ["/"]


@pytest.mark.parametrize(("status", "error"), [(400, RefusedError), (401, OSError), (404, OSError), (429, OSError)])
def test_what_is_about_the_alarm_is_refused_and_all_else_may_pass(
    tmp_path: Path, status: int, error: type[Exception]
) -> None:
    with web_server(status) as server:
        refused((f"(answers|HTTP status) {status}", lambda: hook(tmp_path, server.url).put([alarm(1)])), kind=error)


@pytest.mark.parametrize(("says", "every"), [(b"", 0.0), (b"H", 0.02)])
def test_a_server_that_never_ends_its_answer_costs_bounded_time(tmp_path: Path, says: bytes, every: float) -> None:
    with bad_server(says, every) as port:
        sink = hook(tmp_path, f"http://127.0.0.1:{port}", timeout_s=0.15)
        refused((r"did not answer completely within 0\.15 s", lambda: sink.put([alarm(1)])), kind=OSError)


@pytest.mark.skipif(which("openssl") is None, reason="there is no openssl on this machine to make a certificate")
def test_certificates_are_verified(tmp_path: Path) -> None:
    cert, key = tmp_path / "cert.pem", tmp_path / "key.pem"
    made = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
    made += ["-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost", "-days", "2"]
    subprocess.run([*made, "-keyout", key, "-out", cert], check=True, capture_output=True)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(cert, key)
    with web_server(context=context) as server:
        unknown = hook(tmp_path, f"https://localhost:{server.port}")
        other_name = hook(tmp_path, f"https://127.0.0.1:{server.port}", ca="cert.pem")
        refused(
            *(("CERTIFICATE_VERIFY_FAILED", partial(sink.put, [alarm(1)])) for sink in (unknown, other_name)),
            kind=OSError,
        )
        assert server.got == []
        hook(tmp_path, f"https://localhost:{server.port}", ca="cert.pem").put([alarm(1)])
    assert len(server.got) == 1


@pytest.mark.parametrize(
    ("url", "secret", "problem"),
    [
        ("ftp://example.org", None, "does not start with http:// or https://"),
        ("http://[::1", None, "does not start with http:// or https://"),
        ("https://exa mple.org", None, "does not start with http:// or https://"),
        ("https://example.org/\r\nX-Bad: 1", None, "does not start with http:// or https://"),
        ("https://me:hidden@example.org", None, "contains a user name"),
        ("http://example.org", TOKEN, "another machine without encryption"),
        ("https://example.org", f"{TOKEN}\r\nX-Bad: 1", "not a single line of plain text"),
        ("https://example.org", "", "empty"),
    ],
)
def test_addresses_and_secrets_that_cannot_be_are_refused_without_being_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, url: str, secret: str | None, problem: str
) -> None:
    keys = {}
    if secret is not None:
        monkeypatch.setenv("HOOK_SECRET", secret)
        keys = {"secret": "env:HOOK_SECRET"}
    with pytest.raises(UsageError, match=problem) as error:
        hook(tmp_path, url, **keys)
    assert "s3cret" not in str(error.value)
    assert "hidden" not in str(error.value)
