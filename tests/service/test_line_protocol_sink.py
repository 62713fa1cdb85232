"""Line protocol to files, pipes, sockets and web servers: what is read back is what was estimated."""

from __future__ import annotations

import errno
import math
import os
import socket
import threading
from dataclasses import replace
from pathlib import Path
from typing import IO

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pmfid.errors import UsageError
from pmfid.service.outcome import Rows
from pmfid.service.sinks import RefusedError, line_targets
from pmfid.service.sinks.line_protocol import LineProtocolSection, LineProtocolSink
from pmfid.service.sinks.line_targets import Target, packed
from pmfid.service.wire.line_protocol import Measured, parse_line
from tests.service.feed import Host, alarm, block, kindred, notice
from tests.service.test_sqlite_sink import full_at
from tests.service.web_servers import web_server

GROUP = kindred(2)


class Kept(Target):
    def __init__(self) -> None:
        self.lines: list[bytes] = []

    def open(self) -> None:
        pass

    def send(self, lines: list[bytes]) -> None:
        self.lines += lines

    def close(self) -> None:
        pass


def sink_to(to: str, folder: Path, **keys: object) -> LineProtocolSink:
    sink = LineProtocolSection(to=to, **keys).make("lines", Host(folder))  # type: ignore[arg-type]
    sink.open()
    return sink


def put_often(sink: LineProtocolSink, rows: Rows) -> None:
    for _ in range(1000):
        sink.put([rows])


def read_line(file: IO[bytes]) -> Measured:
    return parse_line(file.readline().decode().removesuffix("\n"))


def parsed(data: bytes) -> list[Measured]:
    assert data.endswith(b"\n")
    return [parse_line(line.decode()) for line in data[:-1].split(b"\n")]


def test_a_row_is_a_point(tmp_path: Path) -> None:
    sink = sink_to("out/rows.lp", tmp_path)
    rows = block(GROUP, 5)
    sink.put([replace(rows, std=np.array([[0.5, math.inf], [0.5, 0.25]]), time=np.array([1.7e9 + 0.25, math.nan]))])
    sink.close()
    first, second = parsed((tmp_path / "out" / "rows.lp").read_bytes())
    assert first == Measured(
        "pmfid",
        {"service": "hall-3", "config": "cart.toml", "axis": "x0", "state": "watching"},
        {
            "u": 2.5,
            "innovation": 0.125,
            "counts": 35,
            "status": 2,
            "number": 5,
            "mass": 5.0,
            "mass_std": 0.5,
            "friction": 5.25,
        },
        1_700_000_000_250_000_000,
    )
    assert second.time_ns is None
    assert second.fields["friction_std"] == 0.25


def test_a_notice_is_an_event(tmp_path: Path) -> None:
    kept = Kept()
    LineProtocolSink("a", "hall-3", kept).put([alarm(7), notice(8, "sink", axis="", problem='a "b"\nc', lost={"a": 1})])
    one, other = parsed(b"".join(kept.lines))
    assert (one.measurement, one.tags) == ("pmfid_event", {"service": "hall-3", "axis": "x1", "event": "alarm"})
    assert (one.fields["number"], one.fields["relative"], one.fields["parameter"]) == (7, 0.2, "mass")
    assert one.time_ns == 1_700_000_007_000_000_000
    assert other.tags == {"service": "hall-3", "event": "sink"}
    assert other.fields == {"number": 8, "problem": 'a "b" c', "lost": '{"a":1}'}


@given(st.text(min_size=1, max_size=8), st.text(min_size=1, max_size=8), st.floats())
def test_any_name_and_any_value_stay_within_their_line(axis: str, name: str, value: float) -> None:
    kept = Kept()
    group = replace(kindred(1, config="a b,c=.toml", names=(name, "mass")), axes=(axis,))
    rows = block(group)
    LineProtocolSink("a", "hall-3", kept).put([replace(rows, theta=np.array([[value, 2.0]]))])
    (point,) = parsed(b"".join(kept.lines).decode().encode())
    assert point.measurement == "pmfid"
    assert point.tags["config"] == "a b,c=.toml"
    assert point.fields["mass"] == (2.0 if name != "mass" else point.fields["mass"])
    assert math.isfinite(value) == any(type(v) is float and v == value for v in point.fields.values()) or value in (
        0.5,
        0.125,
        2.0,
        0.01,
        0.0125,
    )
    assert point.time_ns == 1_000_000_000_010_000_000


def test_a_full_disk_leaves_whole_lines(tmp_path: Path) -> None:
    path = tmp_path / "rows.lp"
    sink = sink_to("rows.lp", tmp_path)
    sink.put([block(GROUP, 1)])
    size = path.stat().st_size
    with full_at(size + 500), pytest.raises(OSError, match="File too large"):
        sink.put([block(GROUP, 2, samples=20)])
    assert path.stat().st_size == size
    sink.open()
    sink.put([block(GROUP, 2, samples=20)])
    sink.close()
    assert [point.fields["number"] for point in parsed(path.read_bytes())][::2] == list(range(1, 22))


def test_a_line_that_a_kill_cut_off_spoils_no_other(tmp_path: Path) -> None:
    path = tmp_path / "rows.lp"
    path.write_bytes(b"pmfid,axis=x0 mass=1.0 17\npmfid,axis=x0 ma")
    sink = sink_to("rows.lp", tmp_path)
    sink.put([block(GROUP, 1)])
    sink.close()
    assert path.read_bytes().startswith(b"pmfid,axis=x0 mass=1.0 17\npmfid,axis=x0 ma\npmfid,axis=x0")


def test_a_file_that_is_renamed_or_removed_is_made_anew(tmp_path: Path) -> None:
    path = tmp_path / "rows.lp"
    sink = sink_to("rows.lp", tmp_path)
    sink.put([block(GROUP, 1)])
    path.rename(tmp_path / "rows.lp.1")
    sink.put([block(GROUP, 2)])
    path.rename(tmp_path / "rows.lp.2")
    sink.put([block(GROUP, 3)])
    sink.close()
    names = ("rows.lp.1", "rows.lp.2", "rows.lp")
    assert [parsed((tmp_path / name).read_bytes())[0].fields["number"] for name in names] == [1, 2, 3]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
def test_a_device_that_is_full_is_an_error_that_may_pass(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="No space left on device") as error:
        sink_to("/dev/full", tmp_path).put([alarm(1)])
    assert error.value.errno == errno.ENOSPC


def test_standard_output_has_nothing_else(tmp_path: Path, capfdbinary: pytest.CaptureFixture[bytes]) -> None:
    sink = sink_to("stdout", tmp_path)
    sink.put([block(GROUP, 1, samples=2)])
    sink.close()
    assert [point.fields["number"] for point in parsed(capfdbinary.readouterr().out)] == [1, 1, 2, 2]


def test_tcp_and_the_end_of_its_connection(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        sink = sink_to(f"tcp://127.0.0.1:{server.getsockname()[1]}", tmp_path)
        sink.put([block(GROUP, 1)])
        connection, _ = server.accept()
        with connection, connection.makefile("rb") as file:
            assert read_line(file).tags["axis"] == "x0"
            assert read_line(file).tags["axis"] == "x1"
        with pytest.raises(OSError, match="closed by the other side"):
            put_often(sink, block(GROUP, 2))
        sink.open()
        sink.put([block(GROUP, 3)])
        connection, _ = server.accept()
        with connection, connection.makefile("rb") as file:
            assert read_line(file).fields["number"] == 3
        sink.close()


def test_a_reader_that_stops_reading_is_an_error_in_bounded_time(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        sink = sink_to(f"tcp://127.0.0.1:{server.getsockname()[1]}", tmp_path, timeout_s=0.1)
        with pytest.raises(TimeoutError):
            put_often(sink, block(GROUP, 2, samples=1000))
        sink.close()


def test_udp_has_whole_lines_in_bounded_datagrams(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.settimeout(20)
        sink = sink_to(f"udp://127.0.0.1:{listener.getsockname()[1]}", tmp_path, largest=700)
        sink.put([block(GROUP, 1, samples=10)])
        points: list[Measured] = []
        while len(points) < 20:
            data = listener.recv(65536)
            assert len(data) <= 700
            points += parsed(data)
        sink.close()
    sink.open()
    sink.put([block(GROUP, 1)])  # nobody listens
    sink.put([block(GROUP, 1)])
    sink.close()
    assert [point.fields["number"] for point in points] == [n for n in range(1, 11) for _ in range(2)]


def test_a_line_too_long_for_any_datagram_holds_up_no_other(tmp_path: Path) -> None:
    host = Host(tmp_path)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.settimeout(20)
        outlet = LineProtocolSection(to=f"udp://127.0.0.1:{listener.getsockname()[1]}").outlet("lines", host)
        outlet.notice(notice(1, "source", problem="x" * 100_000))
        outlet.notice(alarm(2))
        outlet.start()
        assert parsed(listener.recv(65536))[0].fields["number"] == 2
        assert outlet.close(20)
    assert host.count("pmfid_refused_total", sink="lines") == 1
    assert "too long for a datagram" in host.told[0]["problem"]


def test_http_with_the_token_of_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(line_targets, "MOST_POSTED", 1000)
    (tmp_path / "token").write_text("abc-123\n")
    (tmp_path / "token").chmod(0o600)
    with web_server(204) as server:
        sink = sink_to(f"{server.url}/api/v2/write?org=a&bucket=b", tmp_path, token_file="token")
        sink.put([block(GROUP, 1, samples=10), alarm(1)])
        sink.close()
    assert {path for path, _, _ in server.got} == {"/api/v2/write?org=a&bucket=b"}
    assert {headers["Authorization"] for _, headers, _ in server.got} == {"Token abc-123"}
    assert len(server.got) > 3
    assert len(parsed(b"".join(body for _, _, body in server.got))) == 21


def test_what_the_database_will_not_take_is_refused(tmp_path: Path) -> None:
    with web_server(400) as server, pytest.raises(RefusedError, match="answers 400"):
        sink_to(server.url, tmp_path).put([alarm(1)])


@pytest.mark.parametrize(
    ("to", "problem"),
    [("udp://127.0.0.1", "no host and port"), ("tcp://a:b", "no host and port"), ("ftp://a/b", "none of http://")],
)
def test_an_address_that_is_none_is_told(tmp_path: Path, to: str, problem: str) -> None:
    with pytest.raises(UsageError, match=problem):
        sink_to(to, tmp_path)


@given(st.lists(st.binary(min_size=1, max_size=30)), st.integers(1, 60))
def test_lines_are_packed_in_order_and_whole(lines: list[bytes], most: int) -> None:
    parts = list(packed(lines, most))
    assert b"".join(parts) == b"".join(lines)
    assert all(len(part) <= max(most, max(map(len, lines))) for part in parts)


def test_a_pipe_that_nobody_reads_holds_up_only_its_sink(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    got: list[bytes] = []

    def read() -> None:
        with open(tmp_path / "pipe", "rb") as file:
            got.append(file.readline())

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    host = Host(tmp_path)
    outlet = LineProtocolSection(to="pipe", queue_rows=100).outlet("lines", host)
    outlet.start()
    for number in range(1, 500):
        outlet.rows(block(GROUP, number))
    reader.join(20)
    outlet.close(20)
    assert parse_line(got[0].decode().removesuffix("\n")).tags["axis"] == "x0"
