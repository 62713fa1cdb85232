"""Lines of text, and what their fields mean."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TypeGuard

from pmfid.config.axis import Axis
from pmfid.config.record import Sections, conversion
from pmfid.errors import UsageError, did_you_mean
from pmfid.io.csv_text import SEPARATORS, are_units, split
from pmfid.io.tables import whole_name
from pmfid.pipeline.monitored.timeline import Line
from pmfid.pipeline.tuning import TUNING
from pmfid.records.clock import time_factor

__all__ = ["MAX_COUNT", "MOST_TIME", "FieldReader", "Reading", "check_streamed"]

#: Limit of counts: above it, neighbouring whole numbers are no longer separate doubles.
MAX_COUNT = 2.0**53
#: Largest time stamp [s], also for one that is in ns by mistake: in samples it must stay a number.
MOST_TIME = 1e30

#: A value as a text, and as JSON and line protocol have it.
Value = float | str


def check_streamed(axis: Axis) -> None:
    """Raises UsageError for a configuration whose columns cannot be read one sample at a time."""
    if isinstance(axis.record.input_scale, str):
        raise UsageError(f"[record] input_scale = {axis.record.input_scale!r} names a variable; a pipe needs a number")
    if axis.record.output_kind == "velocity" or axis.encoder.range is not None:
        raise UsageError("a pipe needs counts, or positions that do not wrap: unwrap or integrate the output before")


class Reading:
    """From the values of input and output, and perhaps of time, to a `Line`.

    names: of their columns, perhaps with units. Raises UsageError for units that contradict the configuration, and for
    a configuration that cannot be read one sample at a time.
    """

    def __init__(self, axis: Axis, names: tuple[str, ...]) -> None:
        config = axis.record
        check_streamed(axis)
        units = conversion(Sections(config, axis.encoder, axis.model), *names[:2])
        self._scale = float(config.input_scale) * units.u
        self._step = axis.encoder.resolution / units.y if config.output_kind == "position" else None
        self._unit = time_factor(config.model_copy(update={"time": names[2] if len(names) == 3 else None}))

    def time(self, value: Value) -> float:
        """A time stamp [s]; dates and times of day ignore the unit of [record]. Raises ValueError for any other
        text."""
        try:
            time = self._unit * float(value)
        except ValueError:
            time = _moment(str(value).strip())
        if not abs(time) < MOST_TIME:
            raise ValueError("a time that is not finite, or beyond all clocks")
        return time

    def line(self, u: Value, output: Value, time: float = math.nan) -> Line:
        """The line of values at a time [s], NaN for none. A value that cannot be used is the line's problem if there is
        a time; without a time, it raises ValueError or OverflowError."""
        try:
            scaled, place = self._scale * float(u), float(output)
            if not (math.isfinite(scaled) and math.isfinite(place)):
                raise ValueError("a value that is not finite")
            return Line(time, scaled, self._count(place))
        except (ValueError, OverflowError) as error:
            if math.isnan(time):
                raise
            return Line(time, math.nan, 0, str(error))

    def _count(self, value: float) -> int:
        """The count of an output; a position slightly below a step belongs to it, as in a record."""
        counts = math.floor(value / self._step + 1e-6) if self._step else round(value)
        if abs(counts) >= MAX_COUNT or (self._step is None and abs(counts - value) > 1e-6):
            raise ValueError(f"counts must be whole numbers below 2**53, got {value:.9g}")
        return counts


class FieldReader:
    """Fields by name, as of JSON or line protocol, to a `Line`; [record] names input, output and time.

    Raises UsageError for a configuration that cannot be read one sample at a time.
    """

    def __init__(self, axis: Axis) -> None:
        config = axis.record
        self._wanted = (config.input, config.output, *([config.time] if config.time else []))
        self._axis = axis
        self._readings = {self._wanted: Reading(axis, self._wanted)}

    def __call__(self, fields: Mapping[str, object], stamp: float = math.nan) -> Line:
        """The line of some fields; never raises, the line has the problem. stamp: time outside of the fields [s], used
        if [record] names a time that is no field."""
        try:
            return self._line(fields, stamp)
        except (ValueError, OverflowError, UsageError) as error:
            return Line(math.nan, math.nan, 0, str(error)[: TUNING.most_letters])

    def rows(self, columns: Mapping[str, object], size: int) -> Iterator[Line]:
        """The first `size` samples of columns by name; a value that is no list is the same in each. Never raises."""
        names = {whole_name(columns, name) for name in self._wanted}
        used = {name: columns[name] for name in names if name in columns}
        for k in range(size):
            yield self({name: column[k] if isinstance(column, list) else column for name, column in used.items()})

    def _line(self, fields: Mapping[str, object], stamp: float) -> Line:
        names = tuple(whole_name(fields, name) for name in self._wanted)
        timed = len(names) == 3
        stamped = timed and names[2] not in fields and abs(stamp) < MOST_TIME
        reading = self._reading(names[:2] if stamped else names)
        time = stamp if stamped else reading.time(_value(fields, names[2])) if timed else math.nan
        try:
            line = reading.line(_value(fields, names[0]), _value(fields, names[1]), time)
        except (ValueError, OverflowError) as error:
            line = Line(time, math.nan, 0, str(error))
        return Line(line.time, line.u, line.counts, line.problem[: TUNING.most_letters])

    def _reading(self, names: tuple[str, ...]) -> Reading:
        if names not in self._readings:
            if len(self._readings) >= TUNING.most_readings:
                self._readings.clear()
            self._readings[names] = Reading(self._axis, names)
        return self._readings[names]


def _value(fields: Mapping[str, object], name: str) -> Value:
    """The value of a field. Raises ValueError if the field is missing, or is neither number nor text."""
    if name not in fields:
        raise ValueError(f"there is no field {name!r}")
    value = fields[name]
    if not _is_value(value):
        raise ValueError(f"the field {name!r} is no number")
    return value


def _is_value(value: object) -> TypeGuard[Value]:
    return isinstance(value, int | float | str) and not isinstance(value, bool)


def _moment(text: str) -> float:
    """Seconds since 1970 of a date with a time, and since midnight of a time of day, both in ISO 8601."""
    day = "" if "-" in text[1:] else "1970-01-01 "
    try:
        moment = datetime.fromisoformat(day + text)
    except ValueError:
        raise ValueError(f"{text!r} is no time") from None
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


#: Beginnings of comments.
COMMENTS = ("#", "%", "//", ";")


@dataclass(frozen=True)
class _Header:
    """The separator of lines, the names of the columns, and the places of the wanted columns."""

    separator: str
    names: tuple[str, ...]
    places: tuple[int, ...]


class LineParser:
    """Reads u, counts and, if [record] names it, the time from lines with the separators and decimal signs of files.

    header: the first line. Raises UsageError if a column of [record] is missing in it.
    """

    def __init__(self, header: bytes, axis: Axis) -> None:
        check_streamed(axis)
        config, self._axis = axis.record, axis
        self._wanted = [config.input, config.output] + ([config.time] if config.time else [])
        self._read_header(_likeliest(_text(header), self._wanted))

    def _read_header(self, header: _Header) -> None:
        for name, place in zip(self._wanted, header.places, strict=True):
            if place < 0:
                known = ", ".join(header.names[:30])
                hint = did_you_mean(name, header.names)
                raise UsageError(f"standard input has no column {name!r}; it has {known}{hint}")
            if header.names.count(header.names[place]) > 1:
                raise UsageError(f"standard input has two columns {name!r}; rename one of them")
        self._reading = Reading(self._axis, tuple(header.names[place] for place in header.places))
        self._header = header

    def __call__(self, line: bytes) -> Line | None:
        """The values of a line; None for a comment, for units, and for a header, which a logger writes on each
        start."""
        text = _text(line)
        if _is_comment(text) and not (self._header.separator == ";" and text.startswith(";")):
            return None
        try:
            return self._values(self._cells(text))
        except (ValueError, OverflowError) as error:
            if self._is_header(text) or _are_units(split(text, self._header.separator)):
                return None
            return Line(math.nan, math.nan, 0, str(error))

    def _is_header(self, text: str) -> bool:
        """Uses a line as the header of the next lines if it has the columns."""
        if not all(name in text for name in self._wanted):
            return False
        header = _likeliest(text, self._wanted)
        if min(header.places) < 0:
            return False
        try:
            self._read_header(header)
        except UsageError:  # of other units, or with a column twice: the next lines are read as the previous ones
            return False
        return True

    def _cells(self, text: str) -> list[str]:
        separator = self._header.separator
        plain = separator != " " and '"' not in text
        cells = text.split(separator) if plain else split(text, separator)
        if len(cells) != len(self._header.names):
            raise ValueError(f"{len(cells)} cells in place of {len(self._header.names)}")
        found = [cells[place] for place in self._header.places]
        return found if separator == "," and plain else [cell.replace(",", ".") for cell in found]

    def _values(self, cells: list[str]) -> Line:
        time = self._reading.time(cells[2]) if len(cells) == 3 else math.nan
        return self._reading.line(cells[0], cells[1], time)


def is_comment(line: bytes) -> bool:
    """Is a line empty or a comment?"""
    return _is_comment(_text(line))


def _is_comment(text: str) -> bool:
    return not text or text.startswith(COMMENTS)


def _text(line: bytes) -> str:
    text = line.decode("utf-8", "replace").strip(" \r\n\ufeff")
    return text.replace("\r", " ") if "\r" in text else text  # some loggers end lines inside with it


def _are_units(fields: Sequence[str]) -> bool:
    """Is this a row of units, with at least one real unit? Empty cells and ones may be a damaged line of data."""
    return are_units(fields) and any(field.strip("-1%") for field in fields)


def _likeliest(text: str, wanted: Sequence[str]) -> _Header:
    """The line as a header, with the separator that gives most of the wanted columns. Spaces, which may be inside
    names, come last."""
    readings = [_header(text, separator, wanted) for separator in SEPARATORS]
    return max(readings, key=_columns_in)


def _columns_in(header: _Header) -> tuple[int, bool, int]:
    return sum(place >= 0 for place in header.places), header.separator != " ", len(header.names)


def _header(text: str, separator: str, wanted: Sequence[str]) -> _Header:
    names = tuple(split(text, separator))
    places = (whole_name(dict.fromkeys(names), name) for name in wanted)
    return _Header(separator, names, tuple(names.index(name) if name in names else -1 for name in places))
