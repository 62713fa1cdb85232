"""Notices: their numbers, and to whom they go."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from pmfid.stream.alarms import AlarmRecord, Alarms
from pmfid.stream.groups import Seat
from pmfid.stream.outcome import Notice, Outlet

__all__ = ["Notices"]

#: Numbers of what the service says of itself begin here: microseconds since 1970, which none of the others reach. Each
#: axis has so many for itself.
OWN, OF_AXIS = 10**15, 10**9


@dataclass
class Notices:
    """Notices on their way to the outlets.

    What the data of an axis say is numbered in their order, behind the number of the axis: what data that come again
    after a restart say gets the same numbers again, in whatever order the axes come. What the service says of itself
    has no such order, so its numbers are those of a clock. alarms: as people deal with them.
    """

    outlets: Sequence[Outlet]
    alarms: Alarms = field(default_factory=Alarms)
    wall: Callable[[], float] = time.time
    _own: int = field(default=OWN, init=False)

    def publish_event(self, seat: Seat, what: dict[str, Any]) -> Notice:
        """Of the data of an axis."""
        seat.notices += 1
        return self._give(Notice(seat.name, seat.number * OF_AXIS + seat.notices, self.wall(), what))

    def publish_own(self, axis: str, what: dict[str, Any]) -> Notice:
        """Of the service itself."""
        wall = self.wall()
        self._own = max(self._own + 1, int(1e6 * wall))
        return self._give(Notice(axis, self._own, wall, what))

    @property
    def last(self) -> int:
        """Number of the last notice of the service itself."""
        return self._own

    def restore(self, alarms: Sequence[AlarmRecord]) -> None:
        """Goes on with the alarms of a checkpoint."""
        self.alarms = Alarms()
        for notice in self.replay_alarms(alarms):
            self.alarms.take(notice)

    @staticmethod
    def replay_alarms(alarms: Sequence[AlarmRecord]) -> list[Notice]:
        """Notices that lead to these alarms; for who must know them without being told anew."""
        found = list[Notice]()
        for alarm in alarms:
            found.append(Notice(alarm.axis, alarm.number, alarm.wall, alarm.what))
            if alarm.settled is not None:
                found.append(Notice(alarm.axis, alarm.number, alarm.wall, {"event": "settled", **alarm.settled}))
            if alarm.acknowledged is not None:
                what = {"event": "acknowledged", "alarm": alarm.number, "note": alarm.note}
                found.append(Notice(alarm.axis, alarm.number, alarm.acknowledged, what))
            if alarm.cleared is not None:
                what = {"event": "cleared", "alarm": alarm.number}
                found.append(Notice(alarm.axis, alarm.number, alarm.cleared, what))
        return found

    def _give(self, notice: Notice) -> Notice:
        self.alarms.take(notice)
        for outlet in self.outlets:
            outlet.notice(notice)
        return notice
