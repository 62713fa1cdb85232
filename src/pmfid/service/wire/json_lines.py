"""Samples in JSON: an object with the fields of [record], several in an array or a line each, or one of columns."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace

from pmfid.service.wire.points import MOST_POINTS, Point, PointColumns
from pmfid.stream.delivery import Unusable

__all__ = ["AXIS_KEY", "decode"]

#: The key of an object that names the axis.
AXIS_KEY = "axis"


def decode(data: bytes, axis: str = "") -> list[Point | PointColumns | Unusable]:
    """The samples of a message. axis: whose they are; "": the objects say so by AXIS_KEY."""
    found: list[Point | PointColumns | Unusable] = []
    left = MOST_POINTS
    for item in _points(data, axis):
        rows = item.rows if isinstance(item, PointColumns) else 1
        if rows > left:
            if isinstance(item, PointColumns) and left:
                found.append(replace(item, rows=left))
            found.append(
                Unusable("json", f"more than {MOST_POINTS} samples in one message: the others are not looked at")
            )
            break
        found.append(item)
        left -= rows
    return found


def _points(data: bytes, axis: str) -> Iterator[Point | PointColumns | Unusable]:
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
    return Unusable("json", f"this is no JSON: {str(error)[:200]}")


def _read_value(value: object, axis: str) -> Iterator[Point | PointColumns | Unusable]:
    for one in value if isinstance(value, list) else [value]:
        if isinstance(one, dict):
            yield from _read_object(one, axis)
        else:
            yield Unusable("json", "a sample must be an object with the fields of [record]")


def _read_object(fields: dict[str, object], axis: str) -> Iterator[Point | PointColumns | Unusable]:
    named = axis or fields.get(AXIS_KEY)
    if not (isinstance(named, str) and named):
        yield Unusable("axis", f'an object without its axis: give "{AXIS_KEY}"')
        return
    sizes = {len(column) for column in fields.values() if isinstance(column, list)}
    if not sizes:
        yield Point(named, fields)
    elif len(sizes) > 1:
        yield Unusable("json", "columns of different lengths", named)
    elif rows := sizes.pop():
        yield PointColumns(named, fields, rows)
