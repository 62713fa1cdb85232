"""Messages and pipes with binary blocks, JSON or line protocol, identified by their first bytes.

The messages become blocks and lines of their axes.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from typing import Literal

from pmfid.config.axis import Axis
from pmfid.errors import UsageError
from pmfid.pipeline.monitored.lines import FieldReader
from pmfid.pipeline.monitored.timeline import Line
from pmfid.pipeline.tuning import TUNING as PIPELINE_TUNING
from pmfid.service.context import FindAxis
from pmfid.stream import blocks
from pmfid.stream.blocks import MAGIC
from pmfid.stream.delivery import Block, Item, Lines, Unusable, split_tables


@dataclass
class LineSplitter:
    """The whole lines of a stream. A line of more than `longest_line` bytes is left out.

    With `cut`, the stream may begin in the middle of a line, so the first line is left out as well.
    """

    cut: bool = False
    _rest: bytes = field(default=b"", init=False)

    def feed(self, data: bytes) -> list[bytes]:
        """Return the lines that end in `data`, without their ends."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        if lines and self.cut:
            self.cut = False
            del lines[0]
        if len(self._rest) > PIPELINE_TUNING.longest_line:
            self._rest, self.cut = b"", True
        return [line for line in lines if len(line) <= PIPELINE_TUNING.longest_line]


#: Largest number of items in one message. Further items are ignored.
MOST_POINTS = 20_000


@dataclass(frozen=True)
class Point:
    """A sample as received.

    `axis` is the name, `fields` has the values by name. `time` is the time outside the fields [s], or NaN.
    """

    axis: str
    fields: Mapping[str, object]
    time: float = math.nan


@dataclass(frozen=True)
class PointColumns:
    """Samples of one axis as columns.

    `fields` has lists of at least `rows` values. A value that is no list holds for all rows.
    """

    axis: str
    fields: Mapping[str, object]
    rows: int


@dataclass
class Readers:
    """The readers of each axis's fields, according to [record] in AXIS.toml.

    `find` is called for each sample, because the axis may change. Axes that share an object share a reader.
    """

    find: FindAxis
    _made: dict[int, tuple[Axis, FieldReader]] = field(default_factory=dict, init=False)

    def items(self, points: Iterable[Point | PointColumns | Unusable]) -> list[Lines | Unusable]:
        """Return the lines of each axis, with consecutive lines of an axis together."""
        found: list[Lines | Unusable] = []
        for axis, group in groupby(points, lambda point: None if isinstance(point, Unusable) else point.axis):
            some = list(group)
            found += [point for point in some if isinstance(point, Unusable)]
            if axis is not None:
                found.append(self._lines(axis, [point for point in some if not isinstance(point, Unusable)]))
        return found

    def _lines(self, axis: str, points: list[Point | PointColumns]) -> Lines | Unusable:
        config = self.find(axis)
        if config is None:
            return Unusable("axis", f"the plant has no axis {axis[:64]!r}", axis[:64])
        try:
            reader = self._reader(config)
        except UsageError as error:
            return Unusable("axis", str(error), axis)
        lines: list[Line] = []
        for point in points:
            if isinstance(point, PointColumns):
                lines += reader.rows(point.fields, point.rows)
            else:
                lines.append(reader(point.fields, point.time))
        return Lines(axis, lines)

    def _reader(self, config: Axis) -> FieldReader:
        if id(config) not in self._made:
            self._made[id(config)] = config, FieldReader(config)  # the kept object keeps its id
        return self._made[id(config)][1]


#: The key of an object that names the axis.
AXIS_KEY = "axis"


def decode_json(data: bytes, axis: str = "") -> list[Point | PointColumns | Unusable]:
    """Return the samples of a message. `axis` names the axis. With "", the objects name the axis by AXIS_KEY."""
    found: list[Point | PointColumns | Unusable] = []
    left = MOST_POINTS
    for item in _parse_json(data, axis):
        rows = item.rows if isinstance(item, PointColumns) else 1
        if rows > left:
            if isinstance(item, PointColumns) and left:
                found.append(replace(item, rows=left))
            found.append(
                Unusable("json", f"more than {MOST_POINTS} samples in one message: the service ignores the others")
            )
            break
        found.append(item)
        left -= rows
    return found


def _parse_json(data: bytes, axis: str) -> Iterator[Point | PointColumns | Unusable]:
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


def _read_value(value: object, axis: str) -> Iterator[Point | PointColumns | Unusable]:
    for one in value if isinstance(value, list) else [value]:
        if isinstance(one, dict):
            yield from _read_object(one, axis)
        else:
            yield Unusable("json", "a sample must be an object with the fields of [record]")


def _read_object(fields: dict[str, object], axis: str) -> Iterator[Point | PointColumns | Unusable]:
    named = axis or fields.get(AXIS_KEY)
    if not (isinstance(named, str) and named):
        yield Unusable("axis", f'the sample does not name its axis: give "{AXIS_KEY}"')
        return
    sizes = {len(column) for column in fields.values() if isinstance(column, list)}
    if not sizes:
        yield Point(named, fields)
    elif len(sizes) > 1:
        yield Unusable("json", "the columns have different lengths", named)
    elif rows := sizes.pop():
        yield PointColumns(named, fields, rows)


#: Largest size of a message if nothing else is configured [bytes].
LARGEST = 2**20

Form = Literal["auto", "block", "json", "line"]


@dataclass(frozen=True)
class Messages:
    """A reader of messages.

    `readers` interpret the fields. `form` is the form of all messages. With "auto" each message reveals its form. `tag`
    names the axis in line protocol, and `precision` is the unit of its time stamps. `largest` is the largest size of a
    message [bytes].
    """

    readers: Readers
    form: Form = "auto"
    tag: str = "axis"
    precision: Precision = "ns"
    largest: int = LARGEST

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
        form = self.form
        if form == "auto" and data.startswith(MAGIC):
            form = "block"
        elif form == "auto":
            form = "json" if data.lstrip()[:1] in (b"{", b"[") else "line"
        if form == "block":
            found = blocks.items(data)
            return [_check_axis(item, axis) for item in split_tables(found)] if axis else found
        if form == "json":
            return self.readers.items(decode_json(data, axis))
        return self.readers.items(decode_lines(data, axis, self.tag, self.precision))


def _check_axis(item: Block | Lines | Unusable, axis: str) -> Block | Lines | Unusable:
    """Refuse a block of another axis than the axis of its topic, because a sender may have rights for one topic
    only."""
    if isinstance(item, Block) and item.axis != axis:
        return Unusable(
            "name", f"a block of axis {item.axis!r} arrived under the name of axis {axis[:64]!r}", axis[:64]
        )
    return item


Precision = Literal["ns", "us", "ms", "s"]
#: Nanoseconds in each unit of the time stamps.
PRECISIONS: Mapping[Precision, int] = {"ns": 1, "us": 10**3, "ms": 10**6, "s": 10**9}

Field = float | int | bool | str

# A backslash escapes any next character. No pattern therefore reads a character in two ways, and the time for a line
# depends only on its length.
_NAME = re.compile(r"(?:[^\\, ]|\\.)+", re.DOTALL)
_KEY = re.compile(r"((?:[^\\,= ]|\\.)+)=", re.DOTALL)
_TAG_VALUE = re.compile(r"(?:[^\\,= ]|\\.)+", re.DOTALL)
_TEXT = re.compile(r'"((?:[^\\"]|\\.)*)"', re.DOTALL)
_PLAIN = re.compile(r"[^, ]+")
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_WHOLE = re.compile(r"([-+]?\d{1,20})[iu]")
_STAMP = re.compile(r" +([-+]?\d{1,19}) *")
_TRUTH = {text: value for value in (True, False) for text in (str(value), str(value).lower(), str(value).upper())}
_TRUTH |= {"t": True, "T": True, "f": False, "F": False}


@dataclass(frozen=True)
class Measured:
    """The content of a line. `time_ns` counts nanoseconds since 1970, or is None without a time stamp."""

    measurement: str
    tags: Mapping[str, str]
    fields: Mapping[str, Field]
    time_ns: int | None


def decode_lines(data: bytes, axis: str = "", tag: str = "axis", precision: Precision = "ns") -> list[Point | Unusable]:
    """Return the samples of lines. With `axis` = "", the tag with the given name, or else the measurement, names
    the axis.
    """
    texts = data.decode("utf-8", "replace").split("\n", MOST_POINTS)
    found: list[Point | Unusable] = []
    if len(texts) > MOST_POINTS and texts.pop().strip():
        found.append(Unusable("line", f"more than {MOST_POINTS} lines in one message: the service ignores the others"))
    return [*_parse_lines(texts, axis, tag, precision), *found]


def _parse_lines(texts: list[str], axis: str, tag: str, precision: Precision) -> Iterator[Point | Unusable]:
    for text in texts:
        line = text.strip(" \r\t")
        if not line or line.startswith("#"):
            continue
        try:
            measured = parse_line(line, precision)
        except ValueError as error:
            yield Unusable("line", str(error))
            continue
        time = math.nan if measured.time_ns is None else measured.time_ns / 10**9
        yield Point(axis or measured.tags.get(tag, measured.measurement), measured.fields, time)


def parse_line(line: str, precision: Precision = "ns") -> Measured:
    """Return the content of a line. Raises ValueError with a sentence for text that is no line protocol."""
    measurement = _NAME.match(line)
    if measurement is None:
        raise ValueError("a line must begin with the name of its measurement")
    tags, place = _tags(line, measurement.end())
    fields, place = _fields(line, place)
    stamp = _STAMP.fullmatch(line, place)
    if stamp is None and line[place:].strip():
        raise ValueError(f"{line[place : place + 40]!r} is no time stamp: a time stamp must be a whole number")
    time_ns = int(stamp[1]) * PRECISIONS[precision] if stamp else None
    return Measured(_plain(measurement[0], ", "), tags, fields, time_ns)


def _tags(line: str, place: int) -> tuple[dict[str, str], int]:
    tags = {}
    while line.startswith(",", place):
        key = _KEY.match(line, place + 1)
        value = _TAG_VALUE.match(line, key.end()) if key else None
        if key is None or value is None:
            raise ValueError(f"{line[place + 1 : place + 40]!r} is no tag: a tag must have the form key=value")
        tags[_plain(key[1])] = _plain(value[0])
        place = value.end()
    return tags, place


def _fields(line: str, place: int) -> tuple[dict[str, Field], int]:
    """Return the fields of a line, which begin after spaces, and the position of their end."""
    if not line.startswith(" ", place):
        raise ValueError("a line must have fields after its measurement and tags")
    while line.startswith(" ", place):
        place += 1
    fields: dict[str, Field] = {}
    while True:
        key = _KEY.match(line, place)
        if key is None:
            raise ValueError(f"{line[place : place + 40]!r} is no field: a field must have the form key=value")
        fields[_plain(key[1])], place = _value(line, key.end())
        if not line.startswith(",", place):
            return fields, place
        place += 1


def _value(line: str, place: int) -> tuple[Field, int]:
    if text := _TEXT.match(line, place):
        return re.sub(r'\\(["\\])', r"\1", text[1]), text.end()
    plain = _PLAIN.match(line, place)
    word = plain[0] if plain else ""
    end = place + len(word)
    if _NUMBER.fullmatch(word):
        return float(word), end
    if whole := _WHOLE.fullmatch(word):
        return int(whole[1]), end
    if word in _TRUTH:
        return _TRUTH[word], end
    raise ValueError(f"{word[:40]!r} is no value: a value is a number, 12i, true, false, or a text in quotes")


def _plain(name: str, special: str = ",= ") -> str:
    """Return a name without its escapes. A backslash before another character is a plain backslash."""
    return re.sub(rf"\\([{special}])", r"\1", name) if "\\" in name else name
