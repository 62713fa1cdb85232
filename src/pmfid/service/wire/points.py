"""Samples with named fields, as JSON and line protocol have them, become lines of their axes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import groupby

from pmfid.config.axis import Axis
from pmfid.errors import UsageError
from pmfid.pipeline.monitored.lines import FieldReader
from pmfid.pipeline.monitored.timeline import Line
from pmfid.service.context import Axes
from pmfid.stream.delivery import Lines, Unusable

__all__ = ["MOST_POINTS", "Point", "PointColumns", "Readers"]

#: Of one message; what is beyond is not looked at.
MOST_POINTS = 20_000


@dataclass(frozen=True)
class Point:
    """A sample as it came. axis: its name; fields: by name; time: outside the fields [s], NaN without one."""

    axis: str
    fields: Mapping[str, object]
    time: float = math.nan


@dataclass(frozen=True)
class PointColumns:
    """Samples of one axis as columns. fields: lists of at least `rows` values; any other value holds for all rows."""

    axis: str
    fields: Mapping[str, object]
    rows: int


@dataclass
class Readers:
    """The readers of the fields of each axis, by the [record] of its AXIS.toml.

    axes: by name, looked at for each sample, so that it may change; axes that share an object share a reader.
    """

    axes: Axes
    _made: dict[int, tuple[Axis, FieldReader]] = field(default_factory=dict, init=False)

    def items(self, points: Iterable[Point | PointColumns | Unusable]) -> list[Lines | Unusable]:
        """Lines of each axis, those that follow one another together."""
        found: list[Lines | Unusable] = []
        for axis, group in groupby(points, lambda point: None if isinstance(point, Unusable) else point.axis):
            if axis is None:
                found += (point for point in group if isinstance(point, Unusable))
                continue
            found.append(self._lines(axis, [point for point in group if not isinstance(point, Unusable)]))
        return found

    def _lines(self, axis: str, points: list[Point | PointColumns]) -> Lines | Unusable:
        config = self.axes.get(axis)
        if config is None:
            return Unusable("axis", f"there is no axis {axis[:64]!r}", axis[:64])
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
            self._made[id(config)] = config, FieldReader(config)  # kept, so that no other object gets its id
        return self._made[id(config)][1]
