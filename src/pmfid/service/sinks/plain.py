"""Rows and notices as plain numbers and names for texts and strict JSON."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import IO, Any

from pmfid.monitor.events import STATES
from pmfid.presentation import as_json
from pmfid.stream.outcome import EstimateRows, Notice


def row_objects(rows: EstimateRows) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the name of the axis and an object for JSON for each row of a block, in order."""
    names = ("number", "time", "u", "counts", "theta", "std", "innovation", "status")
    columns = [getattr(rows, name).tolist() for name in names]
    for axis, state, *values in zip(rows.axis.tolist(), rows.state.tolist(), *columns, strict=True):
        row = dict(zip(names, values, strict=True))
        for name in ("theta", "std"):
            row[name] = dict(zip(rows.group.names, row[name], strict=True))
        yield rows.group.axes[axis], {**row, "state": STATES[state]}


def notice_object(notice: Notice) -> dict[str, Any]:
    """Return a notice as an object for JSON.

    The object has axis, number and wall time, followed by the keys that `pmfid monitor --json` prints for the event.
    """
    return {"axis": notice.axis, "number": notice.number, "wall": notice.wall, **notice.what}


def json_line(notice: Notice) -> str:
    """Return a notice as one line of JSON."""
    return as_json(notice_object(notice))


@dataclass
class NoticeLog:
    """A sink that writes lines to a stream.

    `line` returns the line of a notice, or "" to leave the notice out.
    """

    stream: IO[str]
    line: Callable[[Notice], str] = json_line
    name: str = "log"
    takes_rows: bool = False
    events: frozenset[str] | None = None

    def open(self) -> None:
        pass

    def put(self, outcomes: list[EstimateRows | Notice]) -> None:
        lines = [self.line(one) for one in outcomes if isinstance(one, Notice)]
        text = "".join(f"{line}\n" for line in lines if line)
        if text:
            self.stream.write(text)
            self.stream.flush()

    def close(self) -> None:
        pass
