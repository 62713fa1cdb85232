"""JSON brings the same values to an axis as a pipe of CSV."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from pmfid.config.axis import Axis, load_axis
from pmfid.service.wire.messages import Messages
from pmfid.stream.delivery import Item, Lines, Unusable
from pmfid.stream.lines import LineParser
from pmfid.stream.timeline import Line

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
    return Messages({"x1": axis(tmp_path), "x 2": axis(tmp_path)}.get)


def lines_of(items: list[Item], name: str = "x1") -> list[Line]:
    assert all(isinstance(item, Lines) and item.axis == name for item in items), items
    return [line for item in items for line in item.lines]


def same(one: Line, other: Line) -> bool:
    pairs = zip((one.time, one.u, one.counts), (other.time, other.u, other.counts), strict=True)
    return all(np.array_equal(a, b, equal_nan=True) for a, b in pairs) and bool(one.problem) == bool(other.problem)


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
    parser, form = LineParser(",".join(names).encode(), config), Messages({"x1": config}.get)
    expected = [parser(",".join(map(repr, row)).encode()) for row in ROWS]
    rows = [dict(zip(names, row, strict=True)) for row in ROWS]
    for data in (
        json.dumps([{"axis": "x1", **row} for row in rows]),
        "\n".join(json.dumps({"axis": "x1", **row}) for row in rows),
        json.dumps({"axis": "x1", **{name: [row[name] for row in rows] for name in names}}),
    ):
        found = lines_of(list(form.items(data.encode())))
        assert len(found) == len(ROWS)
        assert all(line is not None and same(line, one) for line, one in zip(expected, found, strict=True))


def metric(stamp: object, tags: Mapping[str, str], **fields: object) -> bytes:
    """Return a sample as Telegraf writes it."""
    return json.dumps({"fields": fields, "name": "x1", "tags": tags, "timestamp": stamp}).encode()


def test_a_time_next_to_the_fields_serves_where_none_of_them_is_one(messages: Messages) -> None:
    stamps = (1700000000123456789, None, 1700000000000000000)
    texts = [metric(stamp, {}, u=1.5, x=0.001, **({"t": 5} if k == 2 else {})) for k, stamp in enumerate(stamps)]
    first, second, third = lines_of(list(messages.items(b"\n".join(texts))))
    assert (first.time, first.u, first.counts) == (1700000000.123456789, 1.5, 44)
    assert math.isnan(second.time)
    assert "no field 't'" in second.problem
    assert third.time == 5.0


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


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b'{"t": 1}', "axis"),
        (b'{"axis": 5, "t": 1}', "axis"),
        (b'{"axis": "y", "t": 1}', "axis"),
        (b"[1, 2]", "json"),
        (b'{"axis": "x1", "t": [1], "u": [1, 2]}', "json"),
        (b"{", "json"),
        (b"[" * 100_000, "json"),
        (b"[" + b"9" * 5000 + b"]", "json"),
        (b"\xff\xfe", "json"),
        (b"x1 u=1", "json"),
        (b'{"fields": {}, "tags": {}, "name": 5}', "axis"),
        (b'{"fields": {"u": 1}, "tags": {"axis": ""}}', "axis"),
        (bytes(2**20 + 1), "oversized"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_what_cannot_be_used_says_why(messages: Messages, data: bytes, reason: str) -> None:
    found = messages.items(data)
    assert found
    assert all(isinstance(item, Unusable) and item.reason == reason and len(item.problem) < 300 for item in found)


@pytest.mark.parametrize("seed", range(3))
def test_hostile_bytes_never_raise(messages: Messages, seed: int) -> None:
    rng = np.random.default_rng(seed)
    good = [
        b'[{"axis": "x1", "t": 1, "u": 2.5, "x": "7"}]',
        metric(17, {"a": "b c"}, t=1, u='"', x=3),
        (metric(4, {}, t=1, u=2, x=3) + b"\n") * 3,
    ]
    for _ in range(400):
        data = bytearray(good[rng.integers(3)])
        for _ in range(int(rng.integers(1, 6))):
            at = int(rng.integers(len(data) + 1))
            data[at : at + int(rng.integers(3))] = rng.choice(
                [b"\\", b'"', b",", b"=", b" ", b"[", b"}", b"\n", rng.bytes(2)]
            )
        assert all(isinstance(item, Lines | Unusable) for item in messages.items(bytes(data)))
