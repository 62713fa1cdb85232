"""Messages and pipes with binary blocks or JSON, identified by their first bytes.

The messages become blocks and lines of their axes.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby

from pmfid.config.axis import Axis
from pmfid.errors import UsageError
from pmfid.service.context import FindAxis
from pmfid.stream import blocks
from pmfid.stream.blocks import MAGIC
from pmfid.stream.delivery import Block, Item, Lines, Unusable, split_tables
from pmfid.stream.lines import FieldReader
from pmfid.stream.timeline import Line
from pmfid.stream.tuning import TUNING


@dataclass
class LineSplitter:
    """The whole lines of a stream. A line of more than `longest_line` bytes is left out."""

    _cut: bool = field(default=False, init=False)
    _rest: bytes = field(default=b"", init=False)

    def feed(self, data: bytes) -> list[bytes]:
        """Return the lines that end in `data`, without their ends."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        if lines and self._cut:
            self._cut = False
            del lines[0]
        if len(self._rest) > TUNING.longest_line:
            self._rest, self._cut = b"", True
        return [line for line in lines if len(line) <= TUNING.longest_line]


#: Largest number of items in one message. Further items are ignored.
MOST_POINTS = 20_000


@dataclass(frozen=True)
class Point:
    """One sample, or samples of one axis, as received.

    `axis` is the name, `fields` has the values by name. With a number of `rows`, the fields are columns: lists with a
    value for each row, or a value that holds for all rows. `time` is the time outside the fields [s], or NaN.
    """

    axis: str
    fields: Mapping[str, object]
    rows: int | None = None
    time: float = math.nan


#: The key of an object that names the axis.
AXIS_KEY = "axis"
_NAMELESS = Unusable("axis", f'the sample does not name its axis: give "{AXIS_KEY}"')


def decode_json(data: bytes, axis: str = "") -> Iterator[Point | Unusable]:
    """Yield the samples of a message. `axis` names the axis. With "", the objects name the axis by AXIS_KEY."""
    left = MOST_POINTS
    for item in _parse_json(data, axis):
        rows = 1 if isinstance(item, Unusable) or item.rows is None else item.rows
        if rows > left:
            if isinstance(item, Point) and item.rows and left:
                yield replace(item, rows=left)
            yield Unusable("json", f"more than {MOST_POINTS} samples in one message: the service ignores the others")
            return
        yield item
        left -= rows


def _parse_json(data: bytes, axis: str) -> Iterator[Point | Unusable]:
    if not data.strip():
        return
    try:
        yield from _read_value(json.loads(data), axis)
        return
    except (ValueError, RecursionError) as error:
        texts = data.split(b"\n", MOST_POINTS + 1)
        if len(texts) == 1:
            yield _unreadable(error)
            return
    for text in texts:
        if not text.strip():
            continue
        try:
            yield from _read_value(json.loads(text), axis)
        except (ValueError, RecursionError) as error:
            yield _unreadable(error)


def _unreadable(error: Exception) -> Unusable:
    return Unusable("json", f"the message is not valid JSON: {str(error)[:200]}")


def _read_value(value: object, axis: str) -> Iterator[Point | Unusable]:
    for one in value if isinstance(value, list) else [value]:
        if isinstance(one, dict):
            yield from _read_object(one, axis)
        else:
            yield Unusable("json", "a sample must be an object with the fields of [record]")


def _read_object(fields: dict[str, object], axis: str) -> Iterator[Point | Unusable]:
    nested, tags = fields.get("fields"), fields.get("tags")
    if isinstance(nested, dict) and isinstance(tags, dict):
        yield _read_metric(fields, nested, axis or tags.get(AXIS_KEY, fields.get("name")))
        return
    named = axis or fields.get(AXIS_KEY)
    if not (isinstance(named, str) and named):
        yield _NAMELESS
        return
    sizes = {len(column) for column in fields.values() if isinstance(column, list)}
    if not sizes:
        yield Point(named, fields)
    elif len(sizes) > 1:
        yield Unusable("json", "the columns have different lengths", named)
    elif rows := sizes.pop():
        yield Point(named, fields, rows)


def _read_metric(metric: Mapping[str, object], fields: dict[str, object], axis: object) -> Point | Unusable:
    """Return the sample of an object of Telegraf, whose fields are nested and whose time stamp counts nanoseconds."""
    if not (isinstance(axis, str) and axis):
        return _NAMELESS
    stamp = metric.get("timestamp")
    known = isinstance(stamp, int | float) and not isinstance(stamp, bool) and abs(stamp) < 10**30
    return Point(axis, fields, time=float(stamp) / 10**9 if known else math.nan)  # type: ignore[arg-type]


#: Largest size of a message if nothing else is configured [bytes].
LARGEST = 2**20


@dataclass
class Messages:
    """A reader of messages, according to [record] in the AXIS.toml of their axes.

    `find` is called for each sample, because the axis may change. Axes that share an object share a reader. The
    first bytes of a message reveal its form. `largest` is the largest size of a message [bytes].
    """

    find: FindAxis
    largest: int = LARGEST
    _readers: dict[int, tuple[Axis, FieldReader]] = field(default_factory=dict, init=False)

    def items(self, data: bytes, axis: str = "") -> Sequence[Item]:
        """Return the items of a message, without an exception.

        `axis` is the only axis that the message may contain. "" allows any axis.
        """
        if len(data) > self.largest:
            return [Unusable("oversized", f"the message has {len(data)} bytes, more than {self.largest}", axis[:64])]
        try:
            return self._items(data, axis)
        except Exception as error:  # without an acknowledgement the broker would repeat the message for ever
            return [Unusable("error", f"{type(error).__name__}: {str(error)[:200]}; it is left out", axis[:64])]

    def _items(self, data: bytes, axis: str) -> Sequence[Item]:
        if not data.startswith(MAGIC):
            return self._join_points(decode_json(data, axis))
        found = blocks.items(data)
        return [_check_axis(item, axis) for item in split_tables(found)] if axis else found

    def _join_points(self, points: Iterable[Point | Unusable]) -> list[Item]:
        """Return the lines of each axis, with consecutive lines of an axis together."""
        found = list[Item]()
        for axis, some in groupby(points, lambda point: None if isinstance(point, Unusable) else point.axis):
            own = list(some)
            found += [point for point in own if isinstance(point, Unusable)]
            if axis is not None:
                found.append(self._read_lines(axis, [point for point in own if isinstance(point, Point)]))
        return found

    def _read_lines(self, axis: str, points: Iterable[Point]) -> Lines | Unusable:
        config = self.find(axis)
        if config is None:
            return Unusable("axis", f"the plant has no axis {axis[:64]!r}", axis[:64])
        try:
            if id(config) not in self._readers:
                self._readers[id(config)] = config, FieldReader(config)  # the kept object keeps its id
        except UsageError as error:
            return Unusable("axis", str(error), axis)
        read, lines = self._readers[id(config)][1], list[Line]()
        for point in points:
            single = point.rows is None
            lines += [read(point.fields, point.time)] if single else read.rows(point.fields, point.rows or 0)
        return Lines(axis, lines)


def _check_axis(item: Block | Lines | Unusable, axis: str) -> Block | Lines | Unusable:
    """Refuse a block of another axis than the axis of its topic, because a sender may have rights for one topic
    only."""
    if isinstance(item, Block) and item.axis != axis:
        return Unusable(
            "name", f"a block of axis {item.axis!r} arrived under the name of axis {axis[:64]!r}", axis[:64]
        )
    return item
