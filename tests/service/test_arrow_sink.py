"""Tables of estimates: streams that survive being cut anywhere, Parquet that is whole or not there."""

from __future__ import annotations

import errno
import os
import shutil
from pathlib import Path

import polars as pl
import pytest

from pmfid.service.sinks import arrow, durable, stream_file
from pmfid.service.sinks.arrow import ArrowSection, ArrowSink
from pmfid.service.sinks.ipc import frame_of, messages_of, read_stream, whole
from pmfid.service.sinks.stream_file import StreamFile, turn_into_parquet
from tests.service.feed import Host, block, kindred, until
from tests.service.kills import killed_after
from tests.service.test_sqlite_sink import full_at

GROUP = kindred(3)


def opened(folder: Path, host: Host | None = None, **keys: float) -> ArrowSink:
    sink = ArrowSection(folder=folder.name, **keys).make("rows", host or Host(folder.parent))
    sink.open()
    return sink


def parquet(folder: Path) -> pl.DataFrame:
    """All rows of all Parquet files."""
    return pl.concat([pl.read_parquet(path) for path in sorted(folder.glob("*.parquet"))])


def left(folder: Path) -> list[str]:
    return sorted(path.suffix for path in folder.iterdir())


@pytest.fixture(scope="module")
def stream() -> tuple[bytes, list[int]]:
    """Four batches, and where each ends."""
    frames = [frame_of([block(GROUP, first, samples=2)]) for first in (1, 3, 5, 7)]
    data, ends = messages_of(frames[0])[0], []
    for frame in frames:
        data += messages_of(frame)[1]
        ends.append(len(data))
    return data, ends


# --- streams ----------------------------------------------------------------------------------------------------------


def test_a_table_has_the_rows_as_they_were(tmp_path: Path) -> None:
    renamed = kindred(2, names=("time", "mass"))
    frame = frame_of([block(renamed, 5), block(renamed, 6)])
    assert frame.columns[:7] == ["axis", "number", "time", "u", "counts", "time_", "mass"]
    assert frame["axis"].to_list() == ["x0", "x1", "x0", "x1"]
    assert frame["number"].to_list() == [5, 5, 6, 6]
    assert frame["time_"].to_list() == [5.0, 5.001, 6.0, 6.001]
    assert frame["mass_std"].to_list() == pytest.approx([0.0525, 0.05251, 0.0625, 0.06251])
    assert frame["state"].to_list() == ["watching"] * 4


def test_a_stream_cut_at_any_byte_gives_all_rows_before_it(tmp_path: Path, stream: tuple[bytes, list[int]]) -> None:
    data, ends = stream
    path = tmp_path / "cut.arrows"
    sizes = {*range(0, len(data) + 1, 5), *(end + off for end in ends for off in (-1, 0, 1))} - {len(data) + 1}
    for size in sorted(sizes):
        kept = whole(data[:size])
        assert kept <= size
        batches = sum(end <= size for end in ends)
        assert kept == (ends[batches - 1] if batches else whole(data[: min(size, ends[0] - 1)]))
        if size % 100 == 0 or size in ends:
            path.write_bytes(data[:size])
            frame = read_stream(path)
            assert frame.height == 6 * batches
            assert not batches or frame["number"].max() == 2 * batches


def test_a_damaged_stream_is_an_error_or_rows(tmp_path: Path, stream: tuple[bytes, list[int]]) -> None:
    path, rows, errors = tmp_path / "a.arrows", 0, 0
    for place in range(0, len(stream[0]), 41):
        data = bytearray(stream[0])
        data[place] ^= 0x55
        path.write_bytes(data)
        try:
            rows += read_stream(path).height
        except ValueError:
            errors += 1
    assert rows > 100
    assert errors > 10


def test_what_is_no_stream_is_said(tmp_path: Path) -> None:
    path = tmp_path / "a.arrows"
    path.write_bytes(b"time,mass\n1,2\n")
    with pytest.raises(ValueError, match="no stream"):
        read_stream(path)
    path.write_bytes(bytes(1000))  # a file whose content the power took
    assert read_stream(path).is_empty()


# --- the sink ---------------------------------------------------------------------------------------------------------


def test_rows_of_groups_become_parquet_at_the_end(tmp_path: Path) -> None:
    folder = tmp_path / "rows"
    sink = opened(folder)
    other = kindred(2, "../odd name;.toml", ("gain",))
    sink.put([block(GROUP, 1), block(other, 1), block(GROUP, 2, samples=2)])
    moved = kindred(2)  # the same configuration with other axes, as after PLANT.toml changed
    sink.put([block(moved, 9)])
    assert left(folder) == [".arrows", ".arrows"]
    sink.close()
    assert left(folder) == [".parquet", ".parquet"]
    names = sorted(path.name for path in folder.iterdir())
    assert [name.split("-")[0] for name in names] == ["_odd_name_", "cart"]
    cart = pl.read_parquet(folder / names[1])
    assert cart["number"].to_list() == [1] * 3 + [2] * 3 + [3] * 3 + [9] * 2
    assert cart["axis"].to_list() == ["x0", "x1", "x2"] * 3 + ["x0", "x1"]
    assert pl.read_parquet(folder / names[0]).columns[5:7] == ["gain", "gain_std"]


def test_axes_keep_their_names_where_a_group_has_changed(tmp_path: Path) -> None:
    folder = tmp_path / "rows"
    sink = opened(folder)
    renamed = kindred(2)
    renamed = type(renamed)(**{**renamed.__dict__, "axes": ("y0", "y1")})
    sink.put([block(GROUP, 1), block(renamed, 2)])
    sink.close()
    assert parquet(folder)["axis"].to_list() == ["x0", "x1", "x2", "y0", "y1"]


def test_streams_rotate_by_size_and_by_age(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "rows"
    sink = opened(folder, rotate_mb=0.005)
    for number in range(1, 101):
        sink.put([block(GROUP, number)])
    files = list(folder.glob("*.parquet"))
    assert len(files) > 5
    sink.close()
    assert sorted(parquet(folder)["number"].to_list()) == sorted(3 * list(range(1, 101)))
    old = opened(folder, rotate_s=1000.0)
    old.put([block(GROUP, 1)])
    before = left(folder)
    monkeypatch.setattr(arrow.time, "monotonic", lambda clock=arrow.time.monotonic: clock() + 1001)
    old.put([])  # nothing comes, and it is old all the same
    assert (before.count(".arrows"), left(folder).count(".arrows")) == (1, 0)


def test_a_full_disk_leaves_all_rows_or_none(tmp_path: Path) -> None:
    folder = tmp_path / "rows"
    sink = opened(folder)
    sink.put([block(GROUP, 1)])
    (path,) = folder.glob("*.arrows")
    size = path.stat().st_size
    other = kindred(2, "other.toml", ("gain",))
    with full_at(size + 3000), pytest.raises(OSError, match="File too large"):
        sink.put([block(other, 2), block(GROUP, 2, samples=100)])
    assert path.stat().st_size == size
    sink.open()
    sink.put([block(other, 2), block(GROUP, 2, samples=100)])
    sink.close()
    by_name = {path.name.split("-")[0]: pl.read_parquet(path) for path in folder.glob("*.parquet")}
    assert by_name["cart"]["number"].to_list()[::3] == list(range(1, 102))
    assert by_name["other"]["number"].to_list() == [2, 2]


def test_a_stream_that_cannot_be_cut_back_ends_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "rows"
    sink = opened(folder)
    sink.put([block(GROUP, 1)])

    def refuse(file: int, size: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    def half(file: int, data: bytes) -> None:
        os.write(file, data[: len(data) // 2])
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(stream_file.os, "ftruncate", refuse)
        patch.setattr(stream_file, "write_all", half)
        with pytest.raises(OSError, match="No space"):
            sink.put([block(GROUP, 2)])
    sink.put([block(GROUP, 2)])
    sink.close()
    assert parquet(folder)["number"].to_list() == [1, 1, 1, 2, 2, 2]


def test_a_stream_that_someone_removed_is_told_and_begun_anew(tmp_path: Path) -> None:
    folder, host = tmp_path / "rows", Host(tmp_path)
    sink = opened(folder, host)
    sink.put([block(GROUP, 1)])
    next(folder.iterdir()).unlink()
    sink.put([block(GROUP, 2)])
    sink.close()
    assert parquet(folder)["number"].to_list() == [2, 2, 2]
    assert ["was removed" in told["problem"] for told in host.told] == [True]


def test_parquet_that_cannot_be_made_holds_up_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, host = tmp_path / "rows", Host(tmp_path)

    def full(path: Path, data: bytes) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    sink = opened(folder, host, rotate_mb=1e-6)
    with monkeypatch.context() as patch:
        patch.setattr(stream_file, "replace_durably", full)
        sink.put([block(GROUP, 1)])
        sink.put([block(GROUP, 2)])
    assert left(folder) == [".arrows", ".arrows"]
    assert len(host.told) == 1
    assert "No space left on device" in host.told[0]["problem"]
    sink.close()
    assert left(folder) == [".parquet", ".parquet"]
    assert sorted(parquet(folder)["number"].to_list()) == [1, 1, 1, 2, 2, 2]


def test_behind_its_queue_a_disk_that_is_full_for_a_while_costs_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pmfid.service.sinks.queued.FIRST_PAUSE", 0.01)
    monkeypatch.setattr(ArrowSection, "pace", 0.0)
    host, folder = Host(tmp_path), tmp_path / "rows"
    real = os.write

    def write(file: int, data: bytes) -> int:
        if not full:
            return real(file, data)
        raise OSError(errno.ENOSPC, "No space left on device")

    full = True
    monkeypatch.setattr(durable.os, "write", write)
    outlet = ArrowSection(folder="rows").outlet("rows", host)
    outlet.start()
    for number in range(1, 21):
        outlet.rows(block(GROUP, number))
    assert until(lambda: host.count("pmfid_sink_errors_total", sink="rows") > 2)
    full = False
    assert until(lambda: len(host.told) == 2)
    assert outlet.close(20)
    assert host.told[0]["problem"] == "No space left on device"
    assert parquet(folder)["number"].to_list()[::3] == list(range(1, 21))
    assert host.count("pmfid_dropped_rows_total", sink="rows") == 0


# --- after a kill -----------------------------------------------------------------------------------------------------


WRITER = """
import sys
from pathlib import Path
from tests.service.feed import block, kindred
from tests.service.test_arrow_sink import opened
sink = opened(Path(sys.argv[1]), rotate_mb=float(sys.argv[2]))
group = kindred(3)
for number in range(1, 10**6):
    sink.put([block(group, number)])
    print(number, flush=True)
"""


@pytest.mark.long
@pytest.mark.parametrize(("lines", "rotate"), [(30, 0.02), (20, 64.0)])
def test_after_a_kill_the_next_start_makes_parquet_of_all_that_was_put(
    tmp_path: Path, lines: int, rotate: float
) -> None:
    folder = tmp_path / "rows"
    last = int(killed_after(WRITER, lines, str(folder), str(rotate))[-1])
    assert ".arrows" in left(folder) or rotate < 1
    sink = opened(folder)
    sink.put([block(GROUP, 10**7)])
    sink.close()
    assert set(left(folder)) == {".parquet"}
    numbers = sorted(set(parquet(folder)["number"].to_list()) - {10**7})
    assert numbers in (list(range(1, last + 1)), list(range(1, last + 2)))
    assert parquet(folder).height == 3 * len(numbers) + 3, "nothing twice"


def test_a_kill_at_any_step_of_making_parquet_loses_and_doubles_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each call to the system may be the last: what is on the disk then goes through another start."""

    class Killed(BaseException):
        pass

    original = tmp_path / "original"
    sink = opened(original)
    sink.put([block(GROUP, 1, samples=50)])
    for stream in sink._streams.values():
        stream.close()
    steps = 0
    while True:
        steps += 1
        folder = tmp_path / f"rows{steps}"
        shutil.copytree(original, folder)
        calls = [0]

        def dying(real, calls=calls, steps=steps):  # type: ignore[no-untyped-def]
            def call(*args: object, **kwargs: object) -> object:
                calls[0] += 1
                if calls[0] == steps:
                    raise Killed
                return real(*args, **kwargs)

            return call

        with monkeypatch.context() as patch:
            for name in ("open", "write", "fsync", "close", "replace", "unlink"):
                patch.setattr(os, name, dying(getattr(os, name)))
            try:
                turn_into_parquet(next(folder.glob("*.arrows")))
            except Killed:
                killed = True
            else:
                killed = False
        opened(folder).close()
        assert left(folder) in ([".parquet"], [".part", ".parquet"])
        assert parquet(folder)["number"].to_list()[::3] == list(range(1, 51))
        if not killed:
            break
    assert steps > 6


def test_a_stream_that_another_service_writes_is_left_alone(tmp_path: Path) -> None:
    folder = tmp_path / "rows"
    folder.mkdir()
    live = StreamFile(folder, "cart.toml")
    live.append(frame_of([block(GROUP, 1)]))
    opened(folder).close()
    assert left(folder) == [".arrows"]
    live.append(frame_of([block(GROUP, 2)]))
    live.close()
    opened(folder).close()
    assert parquet(folder)["number"].to_list() == [1, 1, 1, 2, 2, 2]


def test_a_stream_that_nobody_can_read_is_set_aside_and_told(tmp_path: Path) -> None:
    folder, host = tmp_path / "rows", Host(tmp_path)
    folder.mkdir()
    (folder / "bad.arrows").write_bytes(b"no stream at all")
    sink = opened(folder, host)
    sink.put([block(GROUP, 1)])
    sink.close()
    assert (folder / "bad.arrows.damaged").read_bytes() == b"no stream at all"
    assert parquet(folder).height == 3
    assert "bad.arrows is no stream of Arrow" in host.told[0]["problem"]
