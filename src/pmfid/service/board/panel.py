"""The last row of every axis of a group, its trend and its history, in arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmfid.service.tuning import TUNING
from pmfid.stream.outcome import EstimateRows, Kindred
from pmfid.types import Floats

__all__ = ["Overview", "Panel", "Records", "row_bytes", "row_type"]


#: Rows as an array of `row_type`.
Records = NDArray[np.void]


def row_type(parameters: int) -> np.dtype[np.void]:
    """A row as it is kept: the fields of `EstimateRows`, little endian as they are sent."""
    return np.dtype(
        [
            ("number", "<i8"),
            ("time", "<f8"),
            ("u", "<f8"),
            ("counts", "<i8"),
            ("theta", "<f8", (parameters,)),
            ("std", "<f8", (parameters,)),
            ("innovation", "<f8"),
            ("status", "<u4"),
            ("state", "u1"),
        ]
    )


def row_bytes(group: Kindred) -> int:
    """Size of a row of an axis [bytes]."""
    return row_type(len(group.names)).itemsize


@dataclass(frozen=True)
class Overview:
    """Changes in a group. axis: (m,) number within it; received: (m,) `time.monotonic()` of their last data; value,
    std, deviation: (m,) of the leading parameter, the last relative to nominal; status, state: as in `EstimateRows`."""

    axis: NDArray[np.int64]
    received: Floats
    value: Floats
    std: Floats
    deviation: Floats
    status: NDArray[np.uint32]
    state: NDArray[np.uint8]


@dataclass
class Panel:
    """Of one group. depth: rows kept of each axis; every: time between two of them [s]. Not safe from several threads:
    the board holds its lock around every call."""

    group: Kindred
    depth: int
    every: float = 1.0

    def __post_init__(self) -> None:
        k = len(self.group.axes)
        self.interval = max(TUNING.panel_finest, TUNING.panel_rows * self.every, TUNING.panel_rows * self.group.dt)
        self.depth = min(max(self.depth, TUNING.panel_fewest), TUNING.panel_most)
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
        """The first parameter that deviations can be measured of."""
        usable = np.flatnonzero(self.group.nominal)
        return int(usable[0]) if usable.size else 0

    def refer(self, axis: int, normal: Sequence[float]) -> None:
        """Sets the reference (q,) of an axis."""
        self.nominal[axis] = normal

    def refer_only(self, referred: Mapping[str, Sequence[float]]) -> None:
        """Sets the references (q,) of these axes, and the reference of the group for all others."""
        self.nominal[:] = self.group.nominal
        for name in referred.keys() & self.place.keys():
            self.refer(self.place[name], referred[name])

    def list_referred(self) -> dict[int, list[float]]:
        """Axes whose reference differs from the reference of the group, and their references."""
        own = np.flatnonzero((self.nominal != self.group.nominal).any(axis=1))
        return {int(axis): self.nominal[axis].tolist() for axis in own}

    def records(self, rows: EstimateRows) -> Records:
        """(m,) the rows as they are kept."""
        found: Records = np.empty(rows.axis.size, self.last.dtype)
        for name in found.dtype.names or ():
            found[name] = getattr(rows, name)
        return found

    def update(self, rows: EstimateRows, records: Records, version: int) -> None:
        """Takes the latest row of each axis; version: of the board, for `overview`."""
        axis, latest = _latest(rows.axis, self.last.size)
        new = records[latest]
        self.last[axis] = new
        self.received[axis] = rows.received
        self._changed[axis] = version
        self._turn(rows.received)
        self._trend[axis, self._bin] = self.deviation(axis, new)
        since = new["time"] - self._kept_at[axis]
        due = ~((since >= 0) & (since < 0.999 * self.every))
        self._keep(axis[due], new[due])

    def _keep(self, axis: NDArray[np.int64], new: Records) -> None:
        self._kept[axis, self._rows[axis] % self.depth] = new
        self._rows[axis] += 1
        self._kept_at[axis] = new["time"]

    def deviation(self, axis: NDArray[np.int64], rows: Records) -> Floats:
        """(m,) of the leading parameter of these axes, relative to nominal; NaN without an estimate."""
        lead = self.leading
        nominal = self.nominal[axis, lead]
        known = np.isfinite(rows["std"][:, lead]) & (nominal != 0)
        ratio = rows["theta"][:, lead] / np.where(nominal == 0, 1.0, nominal)
        return np.asarray(np.where(known, ratio - 1.0, np.nan), float)

    def _turn(self, now: float) -> None:
        """Goes on to the next point of the trend when its time has come; a full trend is made half as fine, and once
        it is a day long, it forgets its first points."""
        if self._bin_end == -np.inf:
            self._bin_end = now + self.interval
        steps = int(max(0.0, np.floor((now - self._bin_end) / self.interval) + 1))
        if steps > 2 * TUNING.panel_points:  # nothing came for longer than the trend is
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
        """(m, points so far) deviations of the leading parameter, one for each `interval` seconds, the last of now."""
        return self._trend[axis, : self._bin + 1]

    def history(self, axis: int) -> Records:
        """The rows that are kept of one axis, oldest first."""
        rows, depth = int(self._rows[axis]), self.depth
        if rows <= depth:
            return self._kept[axis, :rows].copy()
        start = rows % depth
        return np.concatenate([self._kept[axis, start:], self._kept[axis, :start]])

    def overview(self, since: int) -> Overview:
        """Of the axes that changed after version `since`; 0: of all that have ever had data."""
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
        """Takes over what is known of axes of the same names and parameters, and their trends where they have the same
        points in time."""
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


def _latest(axis: NDArray[np.int64], k: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(axes, place of the last row of each); rows of an axis come in the order of time."""
    last = np.full(k, -1, np.int64)
    last[axis] = np.arange(axis.size)
    axes = np.flatnonzero(last >= 0)
    return axes, last[axes]
