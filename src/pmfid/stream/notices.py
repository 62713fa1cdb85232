"""Notices, and silence as an alarm."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pmfid.errors import list_some
from pmfid.stream.groups import Group, Seat
from pmfid.stream.outcome import AlarmRecord, Alarms, Counters, Notice, Outlet
from pmfid.stream.tuning import TUNING
from pmfid.types import Flags


@dataclass
class Notices:
    """Notices on their way to the outlets, and all alarms with their later course.

    Notices on the data of an axis are numbered in the data's order, starting from the axis's number. Data that repeat
    after a restart give the old numbers in any order of the axes. Notices of the service have no such order, so a clock
    numbers them.
    """

    outlets: Sequence[Outlet]
    alarms: Alarms = field(default_factory=Alarms)
    wall: Callable[[], float] = time.time
    _own: int = field(default=TUNING.notices_own, init=False)

    def publish_event(self, seat: Seat, what: dict[str, Any]) -> Notice:
        """Publish an event in the data of an axis."""
        seat.notices += 1
        return self._give(Notice(seat.name, seat.number * TUNING.of_axis + seat.notices, self.wall(), what))

    def publish_own(self, axis: str, what: dict[str, Any]) -> Notice:
        """Publish an event of the service itself."""
        wall = self.wall()
        self._own = max(self._own + 1, int(1e6 * wall))
        return self._give(Notice(axis, self._own, wall, what))

    @property
    def last(self) -> int:
        """Number of the last notice of the service itself."""
        return self._own

    def _give(self, notice: Notice) -> Notice:
        self.alarms.take(notice)
        for outlet in self.outlets:
            outlet.notice(notice)
        return notice


Key = tuple[str, str]


class Taker(Protocol):
    """A sink that takes rows from a queue."""

    name: str

    def works(self, since: float) -> bool | None:
        """Return whether the sink takes its outcomes, or None if this is unknown.

        A failure that began after `since` (`time.monotonic()`) does not count yet.
        """
        ...


@dataclass
class Silence:
    """A monitor of silence that raises and clears alarms.

    An axis whose source is silent has no alarm of its own: the alarm of the source names its axes.

    `limit` is the time after which silence is an alarm [s]. 0 raises no alarm. `sources` has the names of the expected
    sources, `sinks` the watched sinks. `tick` advances the clock, whose time is `now` [s]. An alarm lasts until its
    source, its sink or the last of its axes is back. The alarms of a checkpoint restore this object after a restart.
    """

    notices: Notices
    counters: Counters
    limit: float = 0.0
    sources: Sequence[str] = ()
    sinks: Sequence[Taker] = ()
    now: float = field(default=0.0, init=False)
    _open: dict[int, Notice | AlarmRecord] = field(default_factory=dict, init=False)
    _alarms: dict[Key, int] = field(default_factory=dict, init=False)  # alarms of sources and sinks
    _heard: dict[Key, float] = field(default_factory=dict, init=False)
    _numbers: dict[str, int] = field(default_factory=dict, init=False)  # sources that have delivered
    _ticked: float | None = field(default=None, init=False)
    _looked: float = field(default=-math.inf, init=False)
    _looked_at: float = field(default=-math.inf, init=False)  # by the clock of `tick`

    def restore(self, alarms: Iterable[AlarmRecord]) -> None:
        """Restore the alarms of a checkpoint. Their axes, sources and sinks are silent until new data arrive."""
        self._open = {one.number: one for one in alarms if "silent" in one.what and one.cleared is None}
        named = [(number, one.what) for number, one in self._open.items() if one.what["silent"] in ("source", "sink")]
        self._alarms = {(str(what["silent"]), str(what["name"])): number for number, what in named}
        self._heard = dict.fromkeys(self._alarms, -math.inf)

    def tick(self, at: float) -> None:
        """Advance the clock to `at` [s] of a monotonic clock."""
        if self._ticked is not None:
            self.now += min(at - self._ticked, TUNING.longest_pause)
        self._ticked = at

    def note_delivery(self, source: str) -> None:
        """Note that a source has handed over a delivery."""
        self._heard["source", source] = self.now
        self.number_source(source)

    def number_source(self, source: str) -> int:
        """Return the number of a source that delivers."""
        return self._numbers.setdefault(source, len(self._numbers))

    def look(self, groups: Sequence[Group]) -> bool:
        """Raise and clear alarms if a test is due, and return whether any alarm changed."""
        if self.now - self._looked < TUNING.notices_look:
            return False
        before = self.notices.last
        self._look_at_others(groups)
        self._look_at_axes(groups)
        self._clear(groups)
        self._count(groups)
        self._looked, self._looked_at = self.now, self._ticked or self._looked_at
        return self.notices.last != before

    # --- axes ---------------------------------------------------------------------------------------------------------

    def _look_at_axes(self, groups: Sequence[Group]) -> None:
        found = [(group, self._find_silent(group)) for group in groups]
        if sum(index.size for _, index in found) > TUNING.most_names:
            self._raise_for_many(found)
            return
        for group, index in found:
            for k in index.tolist():
                group.positions.alarm[k] = self._raise("axis", group.kindred.axes[k])

    def _find_silent(self, group: Group) -> NDArray[np.int64]:
        """Return the numbers of the silent axes that need an alarm, and clear the alarm of axes that are back."""
        known = group.positions
        known.heard[np.isnan(known.heard)] = self.now
        silent = self.now - known.heard > max(self.limit or math.inf, TUNING.notices_periods * group.dt)
        known.alarm[~silent] = 0
        own = silent & (known.alarm == 0)
        for source in self.sources:
            here = own & self._delivers(source, group)
            number, heard = self._alarms.get(("source", source)), self._heard["source", source]
            if number:
                known.alarm[here] = number
            # The source itself may be silent if its last delivery is nearer to the data of the axis than to now.
            waits = known.heard > 2 * heard - self.now
            own &= np.logical_not(here & (waits | bool(number)))
        return np.flatnonzero(own)

    def _delivers(self, source: str, group: Group) -> Flags:
        """Return whether a source delivers the axes of a group (axes,). A source that never delivered anything may be
        the source of the axes without any data.
        """
        return np.asarray(group.positions.source == self._numbers.get(source, -1))

    def _raise_for_many(self, found: Sequence[tuple[Group, NDArray[np.int64]]]) -> None:
        names = [group.kindred.axes[k] for group, index in found for k in index.tolist()]
        number = self._raise("axes", f"{len(names)} axes", axes=names[: TUNING.most_names])
        for group, index in found:
            group.positions.alarm[index] = number

    # --- sources and sinks --------------------------------------------------------------------------------------------

    def _look_at_others(self, groups: Sequence[Group]) -> None:
        for sink in self.sinks:
            works = sink.works(self._looked_at)
            if works or (works is None and ("sink", sink.name) not in self._alarms):
                self._heard["sink", sink.name] = self.now
        here = [*(("source", name) for name in self.sources), *(("sink", sink.name) for sink in self.sinks)]
        silent = [key for key in here if self.now - self._heard.setdefault(key, self.now) > (self.limit or math.inf)]
        for key in self._alarms.keys() - set(silent):
            self._forgive(self._alarms[key], groups)
        self._alarms = {key: self._alarms.get(key) or self._raise_for(key, groups) for key in silent}

    def _raise_for(self, key: Key, groups: Sequence[Group]) -> int:
        """Raise the alarm of a sink, or of a source with the names of its axes."""
        kind, name = key
        here = [(group, self._delivers(name, group) & (group.positions.alarm == 0)) for group in groups]
        axes = [group.kindred.axes[k] for group, own in here for k in np.flatnonzero(own).tolist()]
        if kind == "sink" or not axes:
            return self._raise(kind, name)
        count = "1 axis has" if len(axes) == 1 else f"{len(axes)} axes have"
        covered = f", so {count} no data ({list_some(axes)})"
        number = self._raise(kind, name, covered, axes=axes[: TUNING.most_names])
        for group, own in here:
            group.positions.alarm[own] = number
        return number

    def _forgive(self, number: int, groups: Sequence[Group]) -> None:
        """Give the axes of a source that is back the usual time until their silence is an alarm of their own."""
        for group in groups:
            here = group.positions.alarm == number
            group.positions.alarm[here], group.positions.heard[here] = 0, self.now

    # --- alarms -------------------------------------------------------------------------------------------------------

    def _raise(self, kind: str, name: str, covered: str = "", **more: object) -> int:
        what = {"event": "alarm", "silent": kind, "name": name, "seconds": self.limit, **more}
        problem = _PROBLEMS[kind].format(name=name, limit=self.limit, covered=covered)
        notice = self.notices.publish_own(name if kind == "axis" else "", {**what, "problem": problem})
        self._open[notice.number] = notice
        return notice.number

    def _clear(self, groups: Sequence[Group]) -> None:
        """Clear the alarms whose axes, source or sink are back."""
        if not self._open:
            return
        left = set(self._alarms.values())
        for group in groups:
            left.update(np.unique(group.positions.alarm).tolist())
        for number in sorted(self._open.keys() - left):
            alarm = self._open.pop(number)
            what = {key: alarm.what[key] for key in ("silent", "name")}
            seconds = round(max(self.notices.wall() - alarm.wall, 0.0) + alarm.what["seconds"], 1)
            self.notices.publish_own(alarm.axis, {"event": "cleared", "alarm": number, **what, "seconds": seconds})

    def _count(self, groups: Sequence[Group]) -> None:
        for group in groups:
            silent = int(np.count_nonzero(group.positions.alarm))
            self.counters.put("pmfid_axes_silent", silent, group=group.kindred.config)
        for name in self.sources:
            self.counters.put("pmfid_source_silent", float(("source", name) in self._alarms), source=name)
        for sink in self.sinks:
            self.counters.put("pmfid_sink_silent", float(("sink", sink.name) in self._alarms), sink=sink.name)


_PROBLEMS = {
    "axis": "no usable sample for {limit:g} s; check its sender and the source",
    "axes": "no usable sample of {name} for {limit:g} s; check their senders and the source",
    "source": "the source {name} delivered nothing for {limit:g} s{covered}; check its connection and its senders",
    "sink": "the sink {name} accepted nothing for {limit:g} s; check its destination, because alarms wait for it",
}
