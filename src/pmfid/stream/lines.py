"""Lines of text and the values of their fields."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import TypeGuard

from pmfid.config.axis import Axis
from pmfid.config.record import Sections, conversion
from pmfid.errors import UsageError, did_you_mean
from pmfid.io.csv_text import SEPARATORS, are_units, is_data, split
from pmfid.io.tables import whole_name
from pmfid.pipeline.edges import takes_edges
from pmfid.records.clock import time_factor
from pmfid.records.edge_ages import age_factor
from pmfid.stream.timeline import Line
from pmfid.stream.tuning import TUNING
from pmfid.types import COUNT_LIMIT

#: Largest time stamp [s]. The limit allows a stamp in ns by mistake, and keeps its number of samples finite.
MOST_TIME = 1e30

#: Value of a field as text or as a number.
Value = float | str


def check_streamed(axis: Axis) -> None:
    """Raise UsageError if the configured columns cannot be read one sample at a time."""
    if isinstance(axis.record.input_scale, str):
        raise UsageError(f"[record] input_scale = {axis.record.input_scale!r} names a variable; a pipe needs a number")
    if axis.record.known_force:
        raise UsageError("[record] known_force is for records; subtract the force from the input before the pipe")
    if axis.record.output_kind == "velocity" or axis.encoder.range is not None:
        raise UsageError(
            "a pipe needs counts, or positions that do not wrap: integrate the velocity or unwrap the position before "
            "the pipe"
        )


def wanted_columns(axis: Axis) -> tuple[str, ...]:
    """Return the columns of input, output, time if there is one, and the `further` one if it is used."""
    config, further = axis.record, further_column(axis)
    return (config.input, config.output, *([config.time] if config.time else []), *([further] if further else []))


def further_column(axis: Axis) -> str | None:
    """Return the column of a monitor beyond input and output: the age of the last edge, or the temperature."""
    return axis.encoder.edge_age if takes_edges(axis) else axis.record.friction_temperature


class Reading:
    """A reader that converts the values of input, output, time and the further column to a `Line`.

    `names` are those of `wanted_columns`, which may have units. The name of the time may be missing. Raises UsageError
    if a unit contradicts the configuration, or if the configuration cannot be read one sample at a time.
    """

    def __init__(self, axis: Axis, names: tuple[str, ...]) -> None:
        config = axis.record
        check_streamed(axis)
        units = conversion(Sections(config, axis.encoder, axis.model), *names[:2])
        self._scale = float(config.input_scale) * units.u
        self._step = axis.encoder.resolution / units.y if config.output_kind == "position" else None
        further = age_factor(names[-1], axis.encoder.tick) if takes_edges(axis) else 1.0
        self._further = None if further_column(axis) is None else further
        timed = len(names) == (3 if self._further is None else 4)
        self._unit = time_factor(config.model_copy(update={"time": names[2] if timed else None}))

    def time(self, value: Value) -> float:
        """Return a time stamp [s]. Dates and times of day ignore the unit of [record].

        Raises ValueError for any other text.
        """
        try:
            time = self._unit * float(value)
        except ValueError:
            time = _moment(str(value).strip())
        if not abs(time) < MOST_TIME:
            raise ValueError("a time that is not finite, or larger than any clock shows")
        return time

    def line(self, u: Value, output: Value, time: float = math.nan, further: object = math.nan) -> Line:
        """Return the line of values at a time [s], where NaN stands for no time.

        A `further` value that is not a number is none: the estimator flags an edge without its age, and a monitor
        keeps the last temperature.

        If a line with a time has an invalid value, the line stores the problem. Without a time, an invalid value raises
        ValueError or OverflowError.
        """
        try:
            scaled, place = self._scale * float(u), float(output)
            if not (math.isfinite(scaled) and math.isfinite(place)):
                raise ValueError("a value that is not finite")
            return Line(time, scaled, self._count(place), further=self._read_further(further))
        except (ValueError, OverflowError) as error:
            if math.isnan(time):
                raise
            return Line(time, math.nan, 0, str(error))

    def _read_further(self, value: object) -> float:
        try:
            return math.nan if self._further is None or not _is_value(value) else self._further * float(value)
        except ValueError:
            return math.nan

    def _count(self, value: float) -> int:
        """Return the count of an output. A position that is a count with few decimals is far from the next count."""
        counts = math.floor(value / self._step + 0.25) if self._step else round(value)
        if abs(counts) >= COUNT_LIMIT or (self._step is None and abs(counts - value) > 1e-6):
            raise ValueError(f"counts must be whole numbers below 2**53, got {value:.9g}")
        return counts


class FieldReader:
    """A reader that converts named fields of JSON to a `Line`.

    [record] names the fields of input, output and time. Raises UsageError if the configuration cannot be read one
    sample at a time.
    """

    def __init__(self, axis: Axis) -> None:
        self._wanted, self._axis = wanted_columns(axis), axis
        self._timed, self._further = bool(axis.record.time), further_column(axis) is not None
        self._readings = {self._wanted: Reading(axis, self._wanted)}

    def __call__(self, fields: Mapping[str, object], stamp: float = math.nan) -> Line:
        """Return the line of some fields. An invalid field raises nothing, because the line stores the problem.

        `stamp` is a time outside of the fields [s]. The function uses `stamp` if [record] names a time that is not a
        field.
        """
        try:
            return self._line(fields, stamp)
        except (ValueError, OverflowError, UsageError) as error:
            return Line(math.nan, math.nan, 0, str(error)[: TUNING.most_letters])

    def rows(self, columns: Mapping[str, object], size: int) -> Iterator[Line]:
        """Yield the first `size` samples of columns by name, without an exception.

        A value that is not a list is repeated in each sample.
        """
        names = {whole_name(columns, name) for name in self._wanted}
        used = {name: columns[name] for name in names if name in columns}
        for k in range(size):
            yield self({name: column[k] if isinstance(column, list) else column for name, column in used.items()})

    def _line(self, fields: Mapping[str, object], stamp: float) -> Line:
        names, timed = tuple(whole_name(fields, name) for name in self._wanted), self._timed
        stamped = timed and names[2] not in fields and abs(stamp) < MOST_TIME
        reading = self._reading((*names[:2], *names[3:]) if stamped else names)
        time = stamp if stamped else reading.time(_value(fields, names[2])) if timed else math.nan
        try:
            further = fields.get(names[-1]) if self._further else None
            line = reading.line(_value(fields, names[0]), _value(fields, names[1]), time, further)
        except (ValueError, OverflowError) as error:
            line = Line(time, math.nan, 0, str(error))
        return replace(line, problem=line.problem[: TUNING.most_letters]) if line.problem else line

    def _reading(self, names: tuple[str, ...]) -> Reading:
        if names not in self._readings:
            if len(self._readings) >= TUNING.most_readings:
                self._readings.clear()
            self._readings[names] = Reading(self._axis, names)
        return self._readings[names]


def _value(fields: Mapping[str, object], name: str) -> Value:
    """Return the value of a field. Raises ValueError if the field is missing, or is neither number nor text."""
    if name not in fields:
        raise ValueError(f"there is no field {name!r}")
    value = fields[name]
    if not _is_value(value):
        raise ValueError(f"the field {name!r} is not a number")
    return value


def _is_value(value: object) -> TypeGuard[Value]:
    return isinstance(value, int | float | str) and not isinstance(value, bool)


def _moment(text: str) -> float:
    """Return the seconds since 1970 of a date with a time, or since midnight of a time of day, both in ISO 8601."""
    day = "" if "-" in text[1:] else "1970-01-01 "
    try:
        moment = datetime.fromisoformat(day + text)
    except ValueError:
        raise ValueError(f"{text!r} is not a time") from None
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
    """A parser that reads u, counts, and the time and the further column, if they are used, from lines of text.

    The lines may have the separators and decimal signs of files. `header` is the first line. Raises UsageError if the
    header does not have a column of [record].
    """

    def __init__(self, header: bytes, axis: Axis) -> None:
        check_streamed(axis)
        self._axis, self._wanted = axis, list(wanted_columns(axis))
        self._timed, self._further = bool(axis.record.time), further_column(axis) is not None
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
        """Return the values of a line, or None for a comment, a row of units or a header.

        A logger writes a header at each start.
        """
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
        """Return whether a line has the columns of a header, and use such a line as the new header."""
        if not all(name in text for name in self._wanted):
            return False
        header = _likeliest(text, self._wanted)
        if min(header.places) < 0:
            return False
        try:
            self._read_header(header)
        except UsageError:  # a header with other units or a repeated column leaves the previous header valid
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
        time = self._reading.time(cells[2]) if self._timed else math.nan
        return self._reading.line(cells[0], cells[1], time, cells[-1] if self._further else None)


@dataclass
class Beginning:
    """The search for the header, which is the first line with the columns.

    Earlier lines, such as the name of the logger, are skipped. A line of data ends the search. `problem` says why no
    line so far is the header.
    """

    axis: Axis
    problem: UsageError = field(
        default_factory=lambda: UsageError(
            "standard input is empty: write the header with the names of the columns first"
        ),
        init=False,
    )
    _lines: int = field(default=0, init=False)

    def take(self, line: bytes) -> LineParser | None:
        """Return the parser for the next lines if this line is the header.

        Raises UsageError if no header can follow.
        """
        if _is_comment(_text(line)):
            return None
        self._lines += 1
        data = is_data(line.decode("utf-8", "replace"))
        try:
            return LineParser(line, self.axis)
        except UsageError as error:
            self.problem = self.problem if data and self._lines > 1 else error
        if data or self._lines >= TUNING.first_lines:
            raise self.problem
        return None


def _is_comment(text: str) -> bool:
    return not text or text.startswith(COMMENTS)


def _text(line: bytes) -> str:
    text = line.decode("utf-8", "replace").strip(" \r\n\ufeff")
    return text.replace("\r", " ") if "\r" in text else text  # some loggers write a carriage return inside a line


def _are_units(fields: Sequence[str]) -> bool:
    """Return whether the fields are a row of units with at least one real unit.

    A row with only empty cells and the unit 1 may be a damaged line of data.
    """
    return are_units(fields) and any(field.strip("-1%") for field in fields)


def _likeliest(text: str, wanted: Sequence[str]) -> _Header:
    """Return the line as a header, with the separator that gives most of the wanted columns.

    Spaces come last, because names may contain spaces.
    """
    readings = [_header(text, separator, wanted) for separator in SEPARATORS]
    return max(readings, key=lambda one: (sum(k >= 0 for k in one.places), one.separator != " ", len(one.names)))


def _header(text: str, separator: str, wanted: Sequence[str]) -> _Header:
    names = tuple(split(text, separator))
    places = (whole_name(dict.fromkeys(names), name) for name in wanted)
    return _Header(separator, names, tuple(names.index(name) if name in names else -1 for name in places))
