"""JSON and line protocol bring the same values to an axis as a pipe of CSV."""

from __future__ import annotations

import json
import math
import re
import tracemalloc
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from pmfid.config.axis import Axis, load_axis
from pmfid.pipeline.monitored.lines import LineParser
from pmfid.pipeline.monitored.timeline import Line
from pmfid.service.wire.messages import MOST_POINTS, Messages, Readers, parse_line
from pmfid.stream.blocks import encode
from pmfid.stream.delivery import Block, Item, Lines, Unusable

AXIS = """
[record]
input = "u"
output = "x"
time = "t"
{record}
[encoder]
resolution = "22.75 um"
[model]
input_gain = "2.0 N/V"
"""


def axis(folder: Path, record: str = "") -> Axis:
    path = folder / "axis.toml"
    path.write_text(AXIS.format(record=record))
    return load_axis(path)


@pytest.fixture
def messages(tmp_path: Path) -> Messages:
    return Messages(Readers({"x1": axis(tmp_path), "x 2": axis(tmp_path)}.get))


def lines_of(items: list[Item], name: str = "x1") -> list[Line]:
    assert all(isinstance(item, Lines) and item.axis == name for item in items), items
    return [line for item in items for line in item.lines]


def same(one: Line, other: Line) -> bool:
    pairs = zip((one.time, one.u, one.counts), (other.time, other.u, other.counts), strict=True)
    return all(np.array_equal(a, b, equal_nan=True) for a, b in pairs) and bool(one.problem) == bool(other.problem)


Value = float | int | bool | str


def format_line(measurement: str, tags: Mapping[str, str], values: Mapping[str, Value], time_ns: int) -> str:
    """Return a line as InfluxDB's clients write it."""
    head = [escaped(measurement, ", "), *(f"{escaped(key)}={escaped(value)}" for key, value in tags.items())]
    return f"{','.join(head)} {','.join(f'{escaped(key)}={written(v)}' for key, v in values.items())} {time_ns}"


def written(value: Value) -> str:
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    if isinstance(value, bool):
        return "true" if value else "false"
    return f"{value}i" if isinstance(value, int) else repr(value)


def escaped(name: str, special: str = ",= ") -> str:
    """Escape a name; a backslash that would escape the next character becomes a slash, because it cannot be written."""
    return re.sub(rf"([{special}])", r"\\\1", re.sub(rf"\\(?=[{special}]|$)", "/", name))


ROWS = [
    (0.0, 1.5, 0.001),
    (0.01, -2.0, 22.75e-6 * 7),
    (0.02, 0.1 + 0.2, -3e-3),
    (1e9 + 0.03, 0, 1),
    (0.04, 1e308, 1e300),
]


@pytest.mark.parametrize(
    ("record", "names"),
    [
        ("", ("t", "u", "x")),
        ('time_unit = "ms"\ninput_scale = -3.7', ("t", "u", "x")),
        ("", ("t [ms]", "u [mV]", "x [mm]")),
        ('output_kind = "counts"', ("t", "u", "x")),
    ],
)
def test_fields_are_scaled_as_columns_of_a_pipe(tmp_path: Path, record: str, names: tuple[str, ...]) -> None:
    config = axis(tmp_path, record)
    parser, form = LineParser(",".join(names).encode(), config), Messages(Readers({"x1": config}.get))
    expected = [parser(",".join(map(repr, row)).encode()) for row in ROWS]
    rows = [dict(zip(names, row, strict=True)) for row in ROWS]
    texts = [format_line("x1", {}, row, 0) for row in rows]
    for data in (
        json.dumps([{"axis": "x1", **row} for row in rows]),
        "\n".join(json.dumps({"axis": "x1", **row}) for row in rows),
        json.dumps({"axis": "x1", **{name: [row[name] for row in rows] for name in names}}),
        "\n".join(texts),
    ):
        found = lines_of(list(form.items(data.encode())))
        assert len(found) == len(ROWS)
        assert all(line is not None and same(line, one) for line, one in zip(expected, found, strict=True))


def test_what_telegraf_makes_of_two_nodes_is_a_sample(messages: Messages) -> None:
    """The line is the output of `inputs.opcua` after `merge`, as in docs/howto/service.md."""
    data = b'drive,axis=x1 Quality="OK (0x0)",u=1.5,x=0.001,t=1 1700000000050000000\n'
    (line,) = lines_of(list(messages.items(data)))
    assert (line.u, line.counts, line.problem) == (1.5, 43, "")


def test_a_time_next_to_the_fields_serves_where_none_of_them_is_one(messages: Messages) -> None:
    data = b"cart,axis=x1,line=3 u=1.5,x=0.001 1700000000123456789\nx1 x=0.002,u=2i\nx1 x=1,u=1,t=5 1700000000000000000"
    first, second, third = lines_of(list(messages.items(data)))
    assert (first.time, first.u, first.counts) == (1700000000.123456789, 1.5, 43)
    assert math.isnan(second.time)
    assert "no field 't'" in second.problem
    assert third.time == 5.0


@pytest.mark.parametrize(
    ("precision", "stamp"), [("ns", 2 * 10**18), ("us", 2 * 10**15), ("ms", 2 * 10**12), ("s", 2 * 10**9)]
)
def test_timestamps_have_a_precision(tmp_path: Path, precision: str, stamp: int) -> None:
    form = Messages(Readers({"x1": axis(tmp_path)}.get), precision=precision)
    (line,) = lines_of(list(form.items(f"x1 u=1,x=2 {stamp}".encode())))
    assert line.time == 2e9


def test_an_axis_without_a_time_takes_none(tmp_path: Path) -> None:
    config = axis(tmp_path)
    config = config.model_copy(update={"record": config.record.model_copy(update={"time": None, "dt": 0.01})})
    form = Messages(Readers({"x1": config}.get))
    (line,) = lines_of(list(form.items(b"x1 u=1,x=2 5")))
    assert math.isnan(line.time)
    assert line.u == 1.0
    (line,) = lines_of(list(form.items(b'{"axis": "x1", "u": null, "x": 2}')))
    assert "not a number" in line.problem


@pytest.mark.parametrize(
    ("field", "problem"),
    [
        ("null", "not a number"),
        ("true", "not a number"),
        ("[]", ""),
        ('"a"', "convert"),
        ("NaN", "finite"),
        ("1e400", "finite"),
        ("9" * 400, "too large"),
    ],
)
def test_a_value_that_is_none_is_a_lost_sample(messages: Messages, field: str, problem: str) -> None:
    items = list(messages.items(f'{{"axis": "x1", "t": 3, "x": 1, "u": {field}}}'.encode()))
    if not problem:  # a column without rows
        assert items == []
        return
    (line,) = lines_of(items)
    assert line.time == 3.0
    assert math.isnan(line.u)
    assert problem in line.problem


def test_forms_are_reported_by_content_and_a_topic_of_one_axis_is_of_no_other(messages: Messages) -> None:
    block = encode(Block("x1", 0, 0, 0.0, 0.01, np.zeros(2), np.zeros(2, int)))
    assert isinstance(messages.items(block)[0], Block)
    assert isinstance(messages.items(block, "x1")[0], Block)
    refused = messages.items(block, "x 2")[0]
    assert isinstance(refused, Unusable)
    assert refused.reason == "name"
    assert lines_of(list(messages.items(b'{"axis": "x1", "t": 0, "u": 1, "x": 1}', "x 2")), "x 2")
    assert lines_of(list(messages.items(b"x\\ 2 t=0,u=1,x=1")), "x 2")
    assert lines_of(list(messages.items(b"x1 t=0,u=1,x=1", "x 2")), "x 2")


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b'{"t": 1}', "axis"),
        (b'{"axis": 5, "t": 1}', "axis"),
        (b'{"axis": "y", "t": 1}', "axis"),
        (b"y t=1,u=1,x=1", "axis"),
        (b"[1, 2]", "json"),
        (b'{"axis": "x1", "t": [1], "u": [1, 2]}', "json"),
        (b"{", "json"),
        (b"[" * 100_000, "json"),
        (b"[" + b"9" * 5000 + b"]", "json"),
        (b"\xff\xfe", "line"),
        (b"x1", "line"),
        (b"x1 u", "line"),
        (b"x1 u=", "line"),
        (b'x1 u="open', "line"),
        (b"x1,tag u=1", "line"),
        (b"x1 u=1 5.5", "line"),
        (b"x1 u=1 " + b"9" * 30, "line"),
        (b"x1 u=nan", "line"),
        (b"x1 u=1_0", "line"),
        (b",a=b u=1", "line"),
        (bytes(2**20 + 1), "oversized"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_what_cannot_be_used_says_why(messages: Messages, data: bytes, reason: str) -> None:
    found = messages.items(data)
    assert found
    assert all(isinstance(item, Unusable) and item.reason == reason and len(item.problem) < 300 for item in found)


@pytest.mark.parametrize("data", [b"\n".join([b"x"] * 30_000), b"[" + b"1," * 30_000 + b"1]", b"{}\n" * 30_000])
def test_a_message_of_many_small_mistakes_is_cut(messages: Messages, data: bytes) -> None:
    found = messages.items(data)
    assert len(found) == MOST_POINTS + 1
    assert "ignores the others" in found[-1].problem


def test_columns_take_no_more_memory_for_the_fields_that_nobody_reads(tmp_path: Path) -> None:
    """Rows times keys of one message can be far more than its bytes."""
    form = Messages(Readers({"x1": axis(tmp_path)}.get))
    spare = {f"k{k}": 0 for k in range(20_000)}
    data = json.dumps({"axis": "x1", "t": [*range(20_000)], "u": [0] * 20_000, "x": 0, **spare}).encode()
    tracemalloc.start()
    try:
        found = lines_of(list(form.items(data)))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert [line.time for line in found] == [*range(20_000)]
    assert peak < 100 * len(data)


def test_columns_beyond_the_most_samples_are_cut(messages: Messages) -> None:
    rows = [*range(15_000)]
    data = json.dumps([{"axis": "x1", "t": rows, "u": 1, "x": 1}] * 2).encode()
    *_, lines, last = messages.items(data)
    assert len(lines_of([lines])) == MOST_POINTS
    assert isinstance(last, Unusable)
    assert "ignores the others" in last.problem


def test_a_message_that_a_reader_fails_at_is_counted(messages: Messages, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr("pmfid.service.wire.messages.decode_json", fail)
    (item,) = messages.items(b"{}")
    assert isinstance(item, Unusable)
    assert item.reason == "error"
    assert "MemoryError" in item.problem


@pytest.mark.parametrize("seed", range(3))
def test_hostile_bytes_never_raise(messages: Messages, seed: int) -> None:
    rng = np.random.default_rng(seed)
    good = [
        b'[{"axis": "x1", "t": 1, "u": 2.5, "x": "7"}]',
        b'x1,a=b\\ c t=1,u="\\"",x=3i 17',
        b"x1 t=1,u=2,x=3 4\n" * 3,
    ]
    for _ in range(400):
        data = bytearray(good[rng.integers(3)])
        for _ in range(int(rng.integers(1, 6))):
            at = int(rng.integers(len(data) + 1))
            data[at : at + int(rng.integers(3))] = rng.choice(
                [b"\\", b'"', b",", b"=", b" ", b"[", b"}", b"\n", rng.bytes(2)]
            )
        assert all(isinstance(item, Lines | Unusable) for item in messages.items(bytes(data)))


texts = st.text('ab\\,= "#µ\0', min_size=1, max_size=6)
fields = st.floats(allow_nan=False, allow_infinity=False) | st.integers(-(2**63), 2**63 - 1) | st.booleans() | texts


def slashed(text: object) -> object:
    """Replace each backslash by a slash, as the escaped line has it."""
    return text.replace("\\", "/") if isinstance(text, str) else text


@settings(max_examples=80)
@given(texts, st.dictionaries(texts, texts, max_size=3), st.dictionaries(texts, fields, min_size=1), st.integers(-5, 5))
@example("\\=", {}, {"=": 0.0}, 0)
@example("a\\", {"b\\": "c\\", "d": "\\,"}, {"e\\=": 1.0, "f": "\\"}, 5)
def test_what_is_written_is_read_again(
    measurement: str, tags: dict[str, str], values: dict[str, Value], time_ns: int
) -> None:
    assume(len(set(map(slashed, [*tags, *values]))) == len([*tags, *values]))
    read = parse_line(format_line(measurement, tags, values, time_ns))
    assert slashed(read.measurement) == slashed(measurement)
    assert {slashed(key): slashed(value) for key, value in read.tags.items()} == {
        slashed(key): slashed(value) for key, value in tags.items()
    }
    assert {slashed(key): value for key, value in read.fields.items()} == {
        slashed(key): value for key, value in values.items()
    }
    assert read.time_ns == time_ns


def test_what_a_line_looks_like() -> None:
    line = 'pmfid\\ axis,axis=x\\,1 mass=1.07,n=3i,s="a \\"b\\"",ok=true 17'
    values: dict[str, Value] = {"mass": 1.07, "n": 3, "s": 'a "b"', "ok": True}
    assert format_line("pmfid axis", {"axis": "x,1"}, values, 17) == line
    assert parse_line(line).fields == values
