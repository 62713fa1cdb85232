"""Notices: their numbers and their outlets."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from pmfid.stream.alarms import AlarmRecord, Alarms
from pmfid.stream.groups import Seat
from pmfid.stream.outcome import Notice, Outlet

__all__ = ["Notices"]

#: Smallest number of a notice of the service: microseconds since 1970, beyond the numbers of all axes; and the
#: number of notices reserved for each axis.
OWN, OF_AXIS = 10**15, 10**9


@dataclass
class Notices:
    """Notices on their way to the outlets.

    Notices on the data of an axis are numbered in the order of the data, from the number of the axis on. Data that
    come again after a restart give the same numbers, in whatever order the axes come. Notices of the service have no
    such order, so a clock numbers them. alarms: all alarms and their later course.
    """

    outlets: Sequence[Outlet]
    alarms: Alarms = field(default_factory=Alarms)
    wall: Callable[[], float] = time.time
    _own: int = field(default=OWN, init=False)

    def publish_event(self, seat: Seat, what: dict[str, Any]) -> Notice:
        """Publishes an event in the data of an axis."""
        seat.notices += 1
        return self._give(Notice(seat.name, seat.number * OF_AXIS + seat.notices, self.wall(), what))

    def publish_own(self, axis: str, what: dict[str, Any]) -> Notice:
        """Publishes an event of the service itself."""
        wall = self.wall()
        self._own = max(self._own + 1, int(1e6 * wall))
        return self._give(Notice(axis, self._own, wall, what))

    @property
    def last(self) -> int:
        """Number of the last notice of the service itself."""
        return self._own

    def restore(self, alarms: Sequence[AlarmRecord]) -> None:
        """Restores the alarms of a checkpoint."""
        self.alarms = Alarms()
        for notice in self.replay_alarms(alarms):
            self.alarms.take(notice)

    @staticmethod
    def replay_alarms(alarms: Sequence[AlarmRecord]) -> list[Notice]:
        """Notices that lead to these alarms, for readers that need the alarms without new notices."""
        notices = list[Notice]()
        for alarm in alarms:
            notices.append(Notice(alarm.axis, alarm.number, alarm.wall, alarm.what))
            if alarm.settled is not None:
                notices.append(Notice(alarm.axis, alarm.number, alarm.wall, {"event": "settled", **alarm.settled}))
            if alarm.acknowledged is not None:
                what = {"event": "acknowledged", "alarm": alarm.number, "note": alarm.note}
                notices.append(Notice(alarm.axis, alarm.number, alarm.acknowledged, what))
            if alarm.cleared is not None:
                what = {"event": "cleared", "alarm": alarm.number}
                notices.append(Notice(alarm.axis, alarm.number, alarm.cleared, what))
        return notices

    def _give(self, notice: Notice) -> Notice:
        self.alarms.take(notice)
        for outlet in self.outlets:
            outlet.notice(notice)
        return notice
