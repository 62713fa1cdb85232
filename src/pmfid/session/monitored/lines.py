"""Lines of text as a logger writes them into a pipe: its header, comments, and the values of a line."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from pmfid.errors import UsageError, did_you_mean
from pmfid.session.config import Axis
from pmfid.session.formats.layout import SEPARATORS, are_units, split
from pmfid.session.monitored.reading import Reading, check_streamed
from pmfid.session.monitored.timeline import Line
from pmfid.session.tables import whole_name

#: How a line begins that is for people.
COMMENTS = ("#", "%", "//", ";")


@dataclass(frozen=True)
class _Header:
    """How lines are separated, the names of the columns, and the places of those that are wanted."""

    separator: str
    names: tuple[str, ...]
    places: tuple[int, ...]


class LineParser:
    """Takes u, counts and, where [record] names it, the time out of lines, separated and with a decimal sign as in a
    file.

    header: the first line. Raises UsageError where it lacks a column of [record].
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
        """What a line says; None of a comment, of units, and of a header: a logger that starts again writes its own."""
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
        """Takes a line for the header of those that follow, if it has the columns."""
        if not all(name in text for name in self._wanted):
            return False
        header = _likeliest(text, self._wanted)
        if min(header.places) < 0:
            return False
        try:
            self._read_header(header)
        except UsageError:  # of other units, or with a column twice: the lines behind it are read as those before
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
    """Whether a line is empty or begins as one for people does."""
    return _is_comment(_text(line))


def _is_comment(text: str) -> bool:
    return not text or text.startswith(COMMENTS)


def _text(line: bytes) -> str:
    text = line.decode("utf-8", "replace").strip(" \r\n\ufeff")
    return text.replace("\r", " ") if "\r" in text else text  # where one ends a line inside, as some loggers have it


def _are_units(fields: Sequence[str]) -> bool:
    """A row of units says one at least; what is empty or 1 may be a line of data that lost the rest."""
    return are_units(fields) and any(field.strip("-1%") for field in fields)


def _likeliest(text: str, wanted: Sequence[str]) -> _Header:
    """The line read as a header with the separator by which it has most of the columns; spaces, which may be inside of
    names, where no other has as many."""
    readings = [_header(text, separator, wanted) for separator in SEPARATORS]
    return max(readings, key=_columns_in)


def _columns_in(header: _Header) -> tuple[int, bool, int]:
    return sum(place >= 0 for place in header.places), header.separator != " ", len(header.names)


def _header(text: str, separator: str, wanted: Sequence[str]) -> _Header:
    names = tuple(split(text, separator))
    places = (whole_name(dict.fromkeys(names), name) for name in wanted)
    return _Header(separator, names, tuple(names.index(name) if name in names else -1 for name in places))
