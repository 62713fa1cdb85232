"""Samples in JSON: an object with the fields of [record], several in an array or a line each, or one of columns."""

from __future__ import annotations

import json
from collections.abc import Iterator
from itertools import islice

from pmfid.service.delivery import Unusable
from pmfid.service.wire.points import MOST_POINTS, Point

__all__ = ["AXIS_KEY", "decode"]

#: The key of an object that names the axis.
AXIS_KEY = "axis"


def decode(data: bytes, axis: str = "") -> list[Point | Unusable]:
    """The samples of a message. axis: whose they are; "": the objects say so by AXIS_KEY."""
    points = list(islice(_points(data, axis), MOST_POINTS + 1))
    if len(points) > MOST_POINTS:
        points[-1] = Unusable("json", f"more than {MOST_POINTS} samples in one message: the others are not looked at")
    return points


def _points(data: bytes, axis: str) -> Iterator[Point | Unusable]:
    try:
        yield from _of_value(json.loads(data), axis)
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
            yield from _of_value(json.loads(text), axis)
        except (ValueError, RecursionError) as error:
            yield _unreadable(error)


def _unreadable(error: Exception) -> Unusable:
    return Unusable("json", f"this is no JSON: {str(error)[:200]}")


def _of_value(value: object, axis: str) -> Iterator[Point | Unusable]:
    for one in value if isinstance(value, list) else [value]:
        if isinstance(one, dict):
            yield from _of_object(one, axis)
        else:
            yield Unusable("json", "a sample must be an object with the fields of [record]")


def _of_object(fields: dict[str, object], axis: str) -> Iterator[Point | Unusable]:
    named = axis or fields.get(AXIS_KEY)
    if not (isinstance(named, str) and named):
        yield Unusable("axis", f'an object without its axis: give "{AXIS_KEY}"')
        return
    columns = {name: column for name, column in fields.items() if isinstance(column, list)}
    if not columns:
        yield Point(named, fields)
        return
    if len({len(column) for column in columns.values()}) > 1:
        yield Unusable("json", "columns of different lengths", named)
        return
    for row in zip(*columns.values(), strict=True):
        yield Point(named, {**fields, **dict(zip(columns, row, strict=True))})
