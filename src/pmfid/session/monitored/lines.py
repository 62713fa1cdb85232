"""Lines of CSV as a logger writes them into a pipe: its header, comments, and the values of a line."""

from __future__ import annotations

import math

from pmfid.errors import UsageError, did_you_mean
from pmfid.session.clock import time_factor
from pmfid.session.config import Axis
from pmfid.session.conversion import Sections, conversion
from pmfid.session.monitored.timeline import Line

#: Beyond it neighbouring whole numbers are no longer separate doubles.
_MAX_COUNT = 2.0**53
#: Of a stamp, in s, though it may be in ns by mistake: in samples it must stay a number.
_MOST_TIME = 1e30
#: How a line begins that is for people.
COMMENTS = ("#", "%", "//", ";")


class LineParser:
    """Takes u, counts and, where [record] names it, the time out of lines.

    header: the first line. Raises UsageError where it lacks a column of [record].
    """

    def __init__(self, header: bytes, axis: Axis) -> None:
        config = axis.record
        if isinstance(config.input_scale, str):
            raise UsageError(f"[record] input_scale = {config.input_scale!r} names a variable; a pipe needs a number")
        self._wanted = [config.input, config.output] + ([config.time] if config.time else [])
        if config.output_kind == "velocity" or axis.encoder.range is not None:
            raise UsageError("a pipe has positions that go on, or counts: unwrap or integrate the output before")
        units = conversion(Sections(axis.record, axis.encoder, axis.model), config.input, config.output)
        self._scale, self._unit = config.input_scale * units.u, time_factor(config)
        self._step = axis.encoder.resolution / units.y if config.output_kind == "position" else None
        self._read_header(_names(header))

    def _read_header(self, names: list[str]) -> None:
        for name in self._wanted:
            if name not in names:
                known = ", ".join(names[:30])
                raise UsageError(f"standard input has no column {name!r}; it has {known}{did_you_mean(name, names)}")
            if names.count(name) > 1:
                raise UsageError(f"standard input has two columns {name!r}; rename one of them")
        self._columns, self._width = [names.index(name) for name in self._wanted], len(names)

    def __call__(self, line: bytes) -> Line | None:
        """What a line says; None of a comment, and of a header: a logger that starts again writes its own."""
        if is_comment(line):
            return None
        try:
            return self._values(self._cells(line))
        except (ValueError, OverflowError) as error:
            names = _names(line)
            if set(self._wanted) <= set(names):
                self._read_header(names)
                return None
            return Line(math.nan, math.nan, 0, str(error))

    def _cells(self, line: bytes) -> list[str]:
        cells = line.decode("utf-8", "replace").split(",")
        if len(cells) != self._width:
            raise ValueError(f"{len(cells)} cells in place of {self._width}")
        return [cells[column] for column in self._columns]

    def _values(self, cells: list[str]) -> Line:
        time = self._unit * float(cells[2]) if len(cells) == 3 else math.nan
        if len(cells) == 3 and not abs(time) < _MOST_TIME:
            raise ValueError("a time that is not finite, or beyond all clocks")
        try:
            u, output = self._scale * float(cells[0]), float(cells[1])
            if not (math.isfinite(u) and math.isfinite(output)):
                raise ValueError("a value that is not finite")
            return Line(time, u, self._count(output))
        except (ValueError, OverflowError) as error:
            if math.isnan(time):
                raise
            return Line(time, math.nan, 0, str(error))

    def _count(self, value: float) -> int:
        """The count of an output; a position a hair below a step belongs to it, as in a record."""
        counts = math.floor(value / self._step + 1e-6) if self._step else round(value)
        if abs(counts) >= _MAX_COUNT or (self._step is None and abs(counts - value) > 1e-6):
            raise ValueError(f"counts must be whole numbers below 2**53, got {value:.9g}")
        return counts


def is_comment(line: bytes) -> bool:
    """Whether a line is empty or begins as one for people does."""
    text = line.decode("utf-8-sig", "replace").strip()
    return not text or text.startswith(COMMENTS)


def _names(line: bytes) -> list[str]:
    return [name.strip().strip('"') for name in line.decode("utf-8-sig", "replace").split(",")]
