"""Line protocol, as InfluxDB and Telegraf write it: `measurement,tag=x field=1.5,other=2i 1700000000000000000`."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

from pmfid.service.wire.points import MOST_POINTS, Point
from pmfid.stream.delivery import Unusable

__all__ = ["PRECISIONS", "Measured", "Precision", "decode", "parse_line"]

Precision = Literal["ns", "us", "ms", "s"]
#: Unit of the timestamps -> ns.
PRECISIONS: Mapping[Precision, int] = {"ns": 1, "us": 10**3, "ms": 10**6, "s": 10**9}

Field = float | int | bool | str

# A backslash takes the next character with it, whatever that is: so no pattern reads a character in two ways, and a
# line takes time by its length alone.
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
    """The content of a line. time_ns: since 1970, None without a timestamp."""

    measurement: str
    tags: Mapping[str, str]
    fields: Mapping[str, Field]
    time_ns: int | None


def decode(data: bytes, axis: str = "", tag: str = "axis", precision: Precision = "ns") -> list[Point | Unusable]:
    """The samples of lines. axis: whose they are; "": the tag that is called so says it, or else the measurement."""
    texts = data.decode("utf-8", "replace").split("\n", MOST_POINTS)
    found: list[Point | Unusable] = []
    if len(texts) > MOST_POINTS and texts.pop().strip():
        found.append(Unusable("line", f"more than {MOST_POINTS} lines in one message: the others are not looked at"))
    return [*_points(texts, axis, tag, precision), *found]


def _points(texts: list[str], axis: str, tag: str, precision: Precision) -> Iterator[Point | Unusable]:
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
    """The content of a line. Raises ValueError with a sentence for other text than line protocol."""
    measurement = _NAME.match(line)
    if measurement is None:
        raise ValueError("a line must begin with the name of its measurement")
    tags, place = _tags(line, measurement.end())
    fields, place = _fields(line, place)
    stamp = _STAMP.fullmatch(line, place)
    if stamp is None and line[place:].strip():
        raise ValueError(f"{line[place : place + 40]!r} is no timestamp: it must be a whole number")
    time_ns = int(stamp[1]) * PRECISIONS[precision] if stamp else None
    return Measured(_plain(measurement[0], ", "), tags, fields, time_ns)


def _tags(line: str, place: int) -> tuple[dict[str, str], int]:
    tags = {}
    while line.startswith(",", place):
        key = _KEY.match(line, place + 1)
        value = _TAG_VALUE.match(line, key.end()) if key else None
        if key is None or value is None:
            raise ValueError(f"{line[place + 1 : place + 40]!r} is no tag: it must read key=value")
        tags[_plain(key[1])] = _plain(value[0])
        place = value.end()
    return tags, place


def _fields(line: str, place: int) -> tuple[dict[str, Field], int]:
    """The fields of a line, which begin after spaces, and the position of their end."""
    if not line.startswith(" ", place):
        raise ValueError("a line must have fields after its measurement and tags")
    while line.startswith(" ", place):
        place += 1
    fields: dict[str, Field] = {}
    while True:
        key = _KEY.match(line, place)
        if key is None:
            raise ValueError(f"{line[place : place + 40]!r} is no field: it must read key=value")
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
    raise ValueError(f"{word[:40]!r} is no value: a number, 12i, true, false, or a text in quotes")


def _plain(name: str, special: str = ",= ") -> str:
    """A name without its escapes; a backslash before anything else is one."""
    return re.sub(rf"\\([{special}])", r"\1", name) if "\\" in name else name
