"""Alarms and what people do with them: raised, acknowledged with a note, settled at a new value."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from pmfid.stream.outcome import Notice

__all__ = ["AlarmRecord", "Alarms"]

#: Alarms that are kept; beyond, the oldest that is acknowledged or over goes first.
MOST = 2000


@dataclass(frozen=True)
class AlarmRecord:
    """An alarm and its later course.

    number: of its notice; wall: seconds since 1970; what: the object that `pmfid monitor --json` prints; note,
    acknowledged: the text of the acknowledgement and its time, None before; settled: the new values once they are
    known, as in "settled"; cleared: time at which a silent axis, source or sink was back, None before.
    """

    axis: str
    number: int
    wall: float
    what: dict[str, Any]
    note: str = ""
    acknowledged: float | None = None
    settled: dict[str, Any] | None = None
    cleared: float | None = None

    def to_dict(self) -> dict[str, Any]:
        return {
            **self.what,
            "axis": self.axis,
            "number": self.number,
            "wall": self.wall,
            "note": self.note,
            "acknowledged": self.acknowledged,
            "settled": self.settled,
            "cleared": self.cleared,
        }


@dataclass
class Alarms:
    """All alarms by number, in the order of their notices."""

    _all: dict[int, AlarmRecord] = field(default_factory=dict, init=False)

    def take(self, notice: Notice) -> list[AlarmRecord]:
        """Applies a notice. Returns the changed alarms; a repeated notice changes none."""
        what = notice.what
        if what.get("event") == "alarm":
            return self._raise(notice)
        if what.get("event") == "acknowledged":
            known = what.get("alarm", what.get("number"))
            return self._change(known, note=str(what.get("note", "")), acknowledged=notice.wall)
        if what.get("event") == "cleared":
            return self._change(what.get("alarm"), cleared=notice.wall)
        if what.get("event") == "settled":
            return self._settle(notice)
        return []

    def _raise(self, notice: Notice) -> list[AlarmRecord]:
        if notice.number in self._all:
            return []
        self._all[notice.number] = AlarmRecord(notice.axis, notice.number, notice.wall, notice.what)
        if len(self._all) > MOST:
            over = (n for n, one in self._all.items() if not one.acknowledged is one.cleared is None)
            del self._all[next(over, next(iter(self._all)))]
        return [self._all[notice.number]] if notice.number in self._all else []

    def _change(self, number: object, **changed: Any) -> list[AlarmRecord]:
        alarm = self._all.get(number) if isinstance(number, int) else None
        if alarm is None:
            return []
        self._all[alarm.number] = replace(alarm, **changed)
        return [self._all[alarm.number]]

    def _settle(self, notice: Notice) -> list[AlarmRecord]:
        """Settles the alarms of the axis that have no new values yet."""
        new_values = {"time": notice.what.get("time"), "parameters": notice.what.get("parameters", {})}
        of_axis = [alarm for alarm in self._all.values() if alarm.axis == notice.axis]
        open_ones = [alarm for alarm in of_axis if alarm.settled is None and "silent" not in alarm.what]
        for alarm in open_ones:
            self._all[alarm.number] = replace(alarm, settled=new_values)
        return [self._all[alarm.number] for alarm in open_ones]

    def all(self) -> list[AlarmRecord]:
        """Oldest first."""
        return list(self._all.values())

    def get(self, number: int) -> AlarmRecord | None:
        return self._all.get(number)
