"""Rows, events, alarms and counters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from threading import Lock
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pmfid.stream.tuning import TUNING
from pmfid.types import Floats


@dataclass(frozen=True)
class Kindred:
    """Axes of one configuration, which are stepped together.

    `config` is the name of their AXIS.toml. `names` and `units` belong to the q parameters in rows. `dt` is the sample
    period [s]. `nominal` (q,) has the normal values. `axes` has the names in PLANT.toml, by the number within the
    group. `input_unit` is the unit of u. `resolution` is the travel of one count [position_unit].
    """

    config: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    dt: float
    nominal: Floats
    axes: tuple[str, ...]
    input_unit: str = ""
    resolution: float = 1.0
    position_unit: str = "counts"


@dataclass(frozen=True)
class EstimateRows:
    """Estimates of a group's axes, with m rows in the order of time for each axis.

    `axis` (m,) is the number within the group. `number` (m,) is the number of the axis' samples so far, including this
    one. `time` (m,) is the time by the axis' clock [s]. `u`, `counts`, `innovation` and `status` (bits of `Status`) are
    (m,). `theta` and `std` are (m, q), and `std` is infinite while nothing is known. `state` (m,) is the number of the
    state in `monitor.events.STATES`. `received` is `time.monotonic()` of the delivery that brought the latest of these
    samples.
    """

    group: Kindred
    axis: NDArray[np.int64]
    number: NDArray[np.int64]
    time: Floats
    u: Floats
    counts: NDArray[np.int64]
    theta: Floats
    std: Floats
    innovation: Floats
    status: NDArray[np.uint32]
    state: NDArray[np.uint8]
    received: float = 0.0


@dataclass(frozen=True)
class Notice:
    """An event of one axis, or of the service if `axis` is "".

    `number` identifies the notice. Later notices of an axis have higher numbers. After a restart, a notice on repeated
    data has its former number, which identifies the repetition. `wall` is the time of the event in seconds since 1970.
    `what` is the object that `pmfid monitor --json` prints for an event (alarm, state, settled, outlier, gap, clock,
    ...). Events of the service (late, duplicate, unusable, dropped, checkpoint, acknowledged, reference, source, sink)
    have this form, too.
    """

    axis: str
    number: int
    wall: float
    what: dict[str, Any]

    @property
    def urgent(self) -> bool:
        """Whether a person waits for the notice, because an alarm begins, changes or ends."""
        return self.what.get("event") in URGENT


#: Events of alarms. All other events are dropped first.
URGENT = ("alarm", "acknowledged", "settled", "cleared")


class Outlet(Protocol):
    """A receiver of outcomes. The engine's thread calls both methods, so neither may wait for anything."""

    def rows(self, rows: EstimateRows) -> None: ...

    def notice(self, notice: Notice) -> None: ...


@dataclass(frozen=True)
class AlarmRecord:
    """An alarm and its later course.

    `number` is the number of its notice. `wall` is a time in seconds since 1970. `what` is the object that `pmfid
    monitor --json` prints. `note` and `acknowledged` are text and time of the acknowledgement. The time is None without
    an acknowledgement. `settled` has the new values once they are known. `cleared` is the time at which a silent axis,
    source or sink was back, or None.
    """

    axis: str
    number: int
    wall: float
    what: dict[str, Any]
    note: str = ""
    acknowledged: float | None = None
    settled: dict[str, Any] | None = None
    cleared: float | None = None


@dataclass
class Alarms:
    """All alarms by number, in the order of their notices."""

    _all: dict[int, AlarmRecord] = field(default_factory=dict, init=False)

    def take(self, notice: Notice) -> list[AlarmRecord]:
        """Apply a notice, and return the changed alarms. A repeated notice changes no alarm."""
        what, event = notice.what, notice.what.get("event")
        if event == "alarm":
            return self._raise(notice)
        if event == "acknowledged":
            return self._change(what.get("alarm"), note=str(what.get("note", "")), acknowledged=notice.wall)
        if event == "cleared":
            return self._change(what.get("alarm"), cleared=notice.wall)
        return self._settle(notice) if event == "settled" else []

    def _raise(self, notice: Notice) -> list[AlarmRecord]:
        if notice.number in self._all:
            return []
        self._all[notice.number] = AlarmRecord(notice.axis, notice.number, notice.wall, notice.what)
        if len(self._all) > TUNING.outcome_most:
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
        """Settle the alarms of the axis that have no new values yet, and the last alarm again if its change goes on."""
        what = notice.what
        new_values: dict[str, Any] = {key: value for key, value in what.items() if key != "event"}
        own = [one for one in self._all.values() if one.axis == notice.axis and "silent" not in one.what]
        last = own[-1:] if what.get("rate") else []
        open_ones = [alarm for alarm in own if alarm.settled is None or alarm in last]
        for alarm in open_ones:
            self._all[alarm.number] = replace(alarm, settled=new_values)
        return [self._all[alarm.number] for alarm in open_ones]

    def all(self) -> list[AlarmRecord]:
        """Return all alarms, oldest first."""
        return list(self._all.values())

    def get(self, number: int) -> AlarmRecord | None:
        return self._all.get(number)


#: Sorted pairs of label and value.
Labels = tuple[tuple[str, str], ...]


@dataclass
class Counters:
    """Totals that only grow (`add`), and levels that are set (`put`).

    The names follow Prometheus, for example "pmfid_samples_total". Labels have few values, such as sources, sinks,
    reasons and groups, but never axes.
    """

    _values: dict[tuple[str, Labels], float] = field(default_factory=dict, init=False)
    _lock: Lock = field(default_factory=Lock, init=False)

    def add(self, name: str, amount: float = 1, **labels: str) -> None:
        key = name, tuple(sorted(labels.items()))
        with self._lock:
            self._values[key] = self._values.get(key, 0) + amount

    def put(self, name: str, value: float, **labels: str) -> None:
        with self._lock:
            self._values[name, tuple(sorted(labels.items()))] = value

    def values(self) -> Mapping[tuple[str, Labels], float]:
        with self._lock:
            return dict(self._values)
