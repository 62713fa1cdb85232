"""Rows and notices as plain values for texts: numbers and names in place of arrays, strict JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from typing import Any, NamedTuple

from pmfid.monitor.events import STATES
from pmfid.stream.outcome import EstimateRows, Notice

__all__ = ["Row", "alarm_of", "as_json", "notice_object", "row_object", "single_rows"]


class Row(NamedTuple):
    """One row of one axis; theta, std: (q,) as lists; state: its name."""

    axis: str
    number: int
    time: float
    u: float
    counts: int
    theta: list[float]
    std: list[float]
    innovation: float
    status: int
    state: str


def single_rows(rows: EstimateRows) -> Iterator[Row]:
    """The rows of a block one by one, in order."""
    columns = (rows.axis, rows.number, rows.time, rows.u, rows.counts, rows.theta, rows.std, rows.innovation)
    lists = [column.tolist() for column in (*columns, rows.status, rows.state)]
    for axis, number, time, u, counts, theta, std, innovation, status, state in zip(*lists, strict=True):
        name = rows.group.axes[axis]
        yield Row(name, number, time, u, counts, theta, std, innovation, status, STATES[state])


def row_object(row: Row, names: tuple[str, ...]) -> dict[str, Any]:
    """For JSON. names: of the parameters."""
    return {
        "number": row.number,
        "time": row.time,
        "u": row.u,
        "counts": row.counts,
        "theta": dict(zip(names, row.theta, strict=True)),
        "std": dict(zip(names, row.std, strict=True)),
        "innovation": row.innovation,
        "status": row.status,
        "state": row.state,
    }


def notice_object(notice: Notice) -> dict[str, Any]:
    """For JSON: what `pmfid monitor --json` prints for the event, with its axis, number and wall time in front."""
    return {"axis": notice.axis, "number": notice.number, "wall": notice.wall} | {
        # an acknowledgement has a number of its own besides the number of its alarm
        {"number": "alarm"}.get(key, key): value
        for key, value in notice.what.items()
    }


def alarm_of(notice: Notice) -> int | None:
    """The number of the alarm that a notice acknowledges."""
    number = notice.what.get("alarm", notice.what.get("number"))
    return number if isinstance(number, int) else None


def as_json(value: object) -> str:
    """On one line; a number that is not finite becomes null, which JSON has no other word for."""
    try:
        return json.dumps(value, allow_nan=False, separators=(",", ":"), default=_plain)
    except ValueError:
        return json.dumps(_finite(value), allow_nan=False, separators=(",", ":"), default=_plain)


def _finite(value: object) -> object:
    if isinstance(value, dict):
        return {key: _finite(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(one) for one in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


def _plain(value: object) -> object:
    """Of NumPy's numbers and arrays the ones that JSON knows; of all else its text."""
    listed = getattr(value, "tolist", None)
    return str(value) if listed is None else _finite(listed())
