"""The board is an outlet with the present state of the plant, which the page reads from its own thread."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from threading import Lock
from time import monotonic

import numpy as np
from numpy.typing import NDArray

from pmfid.service.tuning import TUNING
from pmfid.stream.outcome import AlarmRecord, Alarms, EstimateRows, Kindred, Notice
from pmfid.stream.tuning import TUNING as STREAM_TUNING
from pmfid.types import Floats

#: Rows as an array of `row_type`.
Records = NDArray[np.void]


def row_type(parameters: int) -> np.dtype[np.void]:
    """Return the data type of a stored row, with the fields of `EstimateRows` in little endian, as for browsers."""
    return np.dtype(
        [
            *(("number", "<i8"), ("time", "<f8"), ("u", "<f8"), ("counts", "<i8")),
            *(("theta", "<f8", (parameters,)), ("std", "<f8", (parameters,))),
            *(("innovation", "<f8"), ("status", "<u4"), ("state", "u1")),
        ]
    )


@dataclass(frozen=True)
class Overview:
    """Changes in a group, for m axes.

    `axis` (m,) is the number within the group. `received` (m,) is `time.monotonic()` of the last data. `value`, `std`
    and `deviation` (m,) belong to the leading parameter. The deviation is relative to nominal. `status` and `state` are
    as in `EstimateRows`.
    """

    axis: NDArray[np.int64]
    received: Floats
    value: Floats
    std: Floats
    deviation: Floats
    status: NDArray[np.uint32]
    state: NDArray[np.uint8]


@dataclass
class Panel:
    """The panel of one group.

    `depth` is the number of kept rows of each axis. `every` is the time between two rows [s]. The board holds its lock
    around every call of a panel, because threads must not call a panel together.
    """

    group: Kindred
    depth: int
    every: float

    def __post_init__(self) -> None:
        k = len(self.group.axes)
        self.interval = max(TUNING.panel_finest, TUNING.panel_rows * self.every, TUNING.panel_rows * self.group.dt)
        self.depth = min(max(self.depth, TUNING.panel_fewest), TUNING.board_rows)
        self.place = {name: i for i, name in enumerate(self.group.axes)}
        self.nominal = np.tile(np.asarray(self.group.nominal, float), (k, 1))
        self.last: Records = np.zeros(k, row_type(len(self.group.names)))
        self.received = np.full(k, np.nan)
        self._changed = np.zeros(k, np.int64)
        self._kept: Records = np.zeros((k, self.depth), self.last.dtype)
        self._rows = np.zeros(k, np.int64)
        self._kept_at = np.full(k, np.nan)
        self._trend = np.full((k, TUNING.panel_points), np.nan, np.float32)
        self._bin, self._bin_end = 0, -np.inf

    @property
    def leading(self) -> int:
        """Index of the first parameter whose deviations can be measured."""
        usable = np.flatnonzero(self.group.nominal)
        return int(usable[0]) if usable.size else 0

    def list_referred(self) -> dict[int, list[float]]:
        """Return the axes whose reference differs from the reference of the group, with their references."""
        own = np.flatnonzero((self.nominal != self.group.nominal).any(axis=1))
        return {int(axis): self.nominal[axis].tolist() for axis in own}

    def records(self, rows: EstimateRows) -> Records:
        """Return the rows as stored rows (m,)."""
        found: Records = np.empty(rows.axis.size, self.last.dtype)
        for name in found.dtype.names or ():
            found[name] = getattr(rows, name)
        return found

    def update(self, rows: EstimateRows, records: Records, version: int) -> None:
        """Take the latest row of each axis. `version` is the version of the board, for `overview`."""
        last = np.full(self.last.size, -1, np.int64)  # rows of an axis come in the order of time
        last[rows.axis] = np.arange(rows.axis.size)
        axis = np.flatnonzero(last >= 0)
        new = records[last[axis]]
        self.last[axis] = new
        self.received[axis] = rows.received
        self._changed[axis] = version
        self._turn(rows.received)
        self._trend[axis, self._bin] = self.deviation(axis, new)
        since = new["time"] - self._kept_at[axis]
        due = ~((since >= 0) & (since < 0.999 * self.every))
        axis, new = axis[due], new[due]
        self._kept[axis, self._rows[axis] % self.depth] = new
        self._rows[axis] += 1
        self._kept_at[axis] = new["time"]

    def deviation(self, axis: NDArray[np.int64], rows: Records) -> Floats:
        """Return the relative deviation (m,) of the leading parameter of these axes from nominal, NaN without an
        estimate.
        """
        lead = self.leading
        nominal = self.nominal[axis, lead]
        known = np.isfinite(rows["std"][:, lead]) & (nominal != 0)
        ratio = rows["theta"][:, lead] / np.where(nominal == 0, 1.0, nominal)
        return np.asarray(np.where(known, ratio - 1.0, np.nan), float)

    def _turn(self, now: float) -> None:
        """Advance to the next point of the trend when it is due.

        A full trend keeps every second point. A trend of a day drops its first points.
        """
        if self._bin_end == -np.inf:
            self._bin_end = now + self.interval
        steps = int(max(0.0, np.floor((now - self._bin_end) / self.interval) + 1))
        if steps > 2 * TUNING.panel_points:  # no data for longer than the whole trend
            self._bin_end += (steps - TUNING.panel_points) * self.interval
            steps = TUNING.panel_points
        for _ in range(steps):
            self._bin_end += self.interval
            self._bin += 1
            if self._bin == TUNING.panel_points:
                self._make_room()

    def _make_room(self) -> None:
        if self.interval < TUNING.panel_coarsest:
            odd, even = self._trend[:, 1::2], self._trend[:, ::2]
            self._trend[:, : TUNING.panel_points // 2] = np.where(np.isnan(odd), even, odd)
            self.interval *= 2
            self._bin = TUNING.panel_points // 2
        else:
            self._trend[:, :-1] = self._trend[:, 1:]
            self._bin = TUNING.panel_points - 1
        self._trend[:, self._bin :] = np.nan

    def trend(self, axis: NDArray[np.int64]) -> NDArray[np.float32]:
        """Return the deviations (m, points) of the leading parameter, one for each `interval` seconds, the last for
        now.
        """
        return self._trend[axis, : self._bin + 1]

    def history(self, axis: int) -> Records:
        """Return the kept rows of one axis, oldest first."""
        rows, depth = int(self._rows[axis]), self.depth
        if rows <= depth:
            return self._kept[axis, :rows].copy()
        start = rows % depth
        return np.concatenate([self._kept[axis, start:], self._kept[axis, :start]])

    def overview(self, since: int) -> Overview:
        """Return the overview of the axes that changed after version `since`. 0 gives all axes with data."""
        axis = np.flatnonzero(self._changed > since)
        rows = self.last[axis]
        lead = self.leading
        return Overview(
            axis,
            self.received[axis],
            rows["theta"][:, lead],
            rows["std"][:, lead],
            self.deviation(axis, rows),
            rows["status"],
            rows["state"],
        )

    def adopt(self, other: Panel, version: int) -> None:
        """Adopt the rows of axes with equal names and parameters, and their trends if the points in time are equal."""
        if other.group.names != self.group.names:
            return
        common = [name for name in self.group.axes if name in other.place]
        mine = np.array([self.place[name] for name in common], np.int64)
        theirs = np.array([other.place[name] for name in common], np.int64)
        seen = ~np.isnan(other.received[theirs])
        self.last[mine], self.received[mine] = other.last[theirs], other.received[theirs]
        own = np.array([(other.nominal[j] != other.group.nominal).any() for j in theirs], bool)
        self.nominal[mine[own]] = other.nominal[theirs[own]]
        self._changed[mine[seen]] = version
        if self._bin_end == -np.inf:
            self.interval, self._bin, self._bin_end = other.interval, other._bin, other._bin_end
        if (self.interval, self._bin, self._bin_end) == (other.interval, other._bin, other._bin_end):
            self._trend[mine] = other._trend[theirs]
        for i, j in zip(mine[seen].tolist(), theirs[seen].tolist(), strict=True):
            rows = other.history(j)[-self.depth :]
            self._kept[i, : rows.size], self._rows[i] = rows, rows.size
            self._kept_at[i] = other._kept_at[j]


@dataclass(frozen=True)
class News:
    """Changes since a version.

    `version` is the version for the next request. `layout` rises when groups change. `groups` is in the order of the
    board. `notices` and `alarms` are new or changed, oldest first.
    """

    version: int
    layout: int
    groups: list[Overview]
    notices: list[Notice]
    alarms: list[AlarmRecord]


@dataclass
class Followed:
    """Every row of an axis since a browser looks at it. `asked` is the time of its last request [s]."""

    asked: float
    pieces: deque[Records] = field(default_factory=deque)

    def put(self, rows: Records) -> None:
        """Append rows. The oldest rows go above `board_waiting`, and at once if the axis began again."""
        last = self.pieces[-1] if self.pieces else rows[:0]
        if last.dtype != rows.dtype or (last.size and rows["number"][0] <= last["number"][-1]):
            self.pieces.clear()
        self.pieces.append(rows)
        while len(self.pieces) > 1 and sum(piece.size for piece in self.pieces) > TUNING.board_rows:
            self.pieces.popleft()


class Board:
    """The board of all `groups`.

    `budget` is the number of bytes for the history of all axes. `every` is the time between two kept rows [s]. The
    engine's thread calls `rows`, `notice`, `arrange` and `list_followed`. Any thread may call the other methods. A
    reader holds the lock while it copies arrays, which takes less than a millisecond with 10 000 axes. A reader never
    holds the lock while it writes to a browser.
    """

    def __init__(self, groups: Sequence[Kindred], *, budget: float = 64e6, every: float = 1.0) -> None:
        self._budget, self.every = budget, every
        self._lock = Lock()
        self._version, self._layout = 0, 0
        self._panels: list[Panel] = []
        self._alarms = Alarms()
        self._notices: deque[tuple[int, Notice]] = deque(maxlen=STREAM_TUNING.outcome_most)
        self._changed: deque[tuple[int, int]] = deque(
            maxlen=STREAM_TUNING.outcome_most
        )  # version, and number of an alarm
        self._followed: dict[str, Followed] = {}
        self.arrange(groups)

    # --- for the engine ---

    def arrange(self, groups: Sequence[Kindred], referred: Mapping[str, Sequence[float]] | None = None) -> None:
        """Replace the groups. The rows of an axis stay unless its parameters change.

        `referred` maps an axis to its reference (q,), if the axis does not have the reference of its group. None leaves
        the references unchanged.
        """
        share = self._budget / max(1, sum(len(one.axes) * row_type(len(one.names)).itemsize for one in groups))
        panels = [Panel(group, int(share), self.every) for group in groups]
        with self._lock:
            self._version += 1
            for panel in panels:
                for old in self._panels:
                    panel.adopt(old, self._version)
                if referred is not None:
                    panel.nominal[:] = panel.group.nominal
                    for name in referred.keys() & panel.place.keys():
                        panel.nominal[panel.place[name]] = referred[name]
            self._panels, self._layout = panels, self._layout + 1
            self._by_group = {id(panel.group): panel for panel in panels}
            self._by_axis = {name: panel for panel in panels for name in panel.place}

    def keep(self, budget: float) -> None:
        """Set the number of bytes for the history, before the engine's thread starts."""
        self._budget = budget
        self.arrange(self.groups)

    def rows(self, rows: EstimateRows) -> None:
        if rows.axis.size == 0:
            return
        panel = self._by_group[id(rows.group)]
        records = panel.records(rows)
        with self._lock:
            self._version += 1
            panel.update(rows, records, self._version)
            for name, followed in self._followed.items():
                own = records[rows.axis == panel.place.get(name, -1)]
                if own.size:
                    followed.put(own)

    def notice(self, notice: Notice) -> None:
        with self._lock:
            self._version += 1
            self._notices.append((self._version, notice))
            self._changed.extend((self._version, alarm.number) for alarm in self._alarms.take(notice))
            if notice.what.get("event") == "reference" and "problem" not in notice.what:
                panel, normal = self._by_axis.get(notice.axis), notice.what.get("nominal", {})
                if panel is not None and normal.keys() == set(panel.group.names):
                    panel.nominal[panel.place[notice.axis]] = [normal[name] for name in panel.group.names]
                    self._layout += 1

    def list_followed(self) -> frozenset[str]:
        """Return the names of the axes that a browser looks at, whose rows are all given out."""
        if self._followed:
            with self._lock:
                late = monotonic() - TUNING.board_looking
                self._followed = {name: one for name, one in self._followed.items() if one.asked > late}
        return frozenset(self._followed)

    # --- for the page ---

    @property
    def groups(self) -> tuple[Kindred, ...]:
        return tuple(panel.group for panel in self._panels)

    @property
    def layout(self) -> int:
        """Number that rises whenever groups, or the reference of an axis, change."""
        return self._layout

    def news(self, since: int = 0, groups: bool = True) -> News:
        """Return the changes after version `since`, or everything for 0.

        With `groups`, the changes include the axes in addition to notices and alarms.
        """
        with self._lock:
            overviews = [panel.overview(since) for panel in self._panels] if groups else []
            notices = [notice for version, notice in self._notices if version > since]
            if since == 0:
                alarms = self._alarms.all()
            else:
                numbers = dict.fromkeys(number for version, number in self._changed if version > since)
                alarms = [alarm for number in numbers if (alarm := self._alarms.get(number))]
            return News(self._version, self._layout, overviews, notices, alarms)

    def list_referred(self) -> list[dict[int, list[float]]]:
        """Return the axes of each group with their own reference, by number, and this reference."""
        with self._lock:
            return [panel.list_referred() for panel in self._panels]

    def alarm(self, number: int) -> AlarmRecord | None:
        """Return the alarm with this notice number, or None if unknown."""
        with self._lock:
            return self._alarms.get(number)

    def group_of(self, axis: str) -> Kindred | None:
        """Return the group of an axis, or None for an unknown axis."""
        with self._lock:
            panel = self._by_axis.get(axis)
            return panel.group if panel else None

    def follow(self, axis: str, after: int) -> tuple[Records, float] | None:
        """Return the rows of an axis after its sample `after`, oldest first, and `time.monotonic()` of the last data.

        From the first call on, these are all rows of the axis, if the next call comes within `board_looking`. Older
        rows are the kept ones. An axis that began again has only samples before `after`, and all its rows are returned.
        Returns None for an unknown axis.
        """
        with self._lock:
            panel = self._by_axis.get(axis)
            if panel is None:
                return None
            followed = self._followed.setdefault(axis, Followed(0.0))
            followed.asked = monotonic()
            place = panel.place[axis]
            row = panel.last[place]
            after = after if after <= row["number"] else -1
            live = [piece for piece in followed.pieces if piece.dtype == row.dtype]
            if not live or after + 1 < live[0]["number"][0]:
                kept = panel.history(place)
                live = [kept[kept["number"] < live[0]["number"][0]] if live else kept, *live]
            rows = np.concatenate([piece[piece["number"] > after] for piece in live])
            return rows, float(panel.received[place])

    def trends(self, group: int, axes: NDArray[np.int64]) -> tuple[float, NDArray[np.float32]]:
        """Return the time between two points [s], and the relative deviations (m, points) of the leading parameter.

        The last point is for now. Raises IndexError for an unknown group or axis.
        """
        with self._lock:
            panel = self._panels[group]
            return panel.interval, panel.trend(axes)
