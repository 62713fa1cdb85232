"""Lines of text from a logger in a pipe: the header, comments, and the values of a line."""

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
