"""Axes of one configuration: calibrated once, stepped together."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pmfid.monitor.events import Event
from pmfid.monitor.fleet import MonitorFleet
from pmfid.session.config import Axis, load_axis
from pmfid.session.monitored.setup import Setup, set_up
from pmfid.session.records import Record
from pmfid.stream.order import Order
from pmfid.stream.outcome import Kindred
from pmfid.stream.positions import PositionRow, Positions
from pmfid.stream.timed import Timed

__all__ = ["Group", "Pace", "Prepared", "Seat", "prepare"]

#: Number of notices of a kind, such as bad lines and gaps, that an axis gets one by one. Later notices come after
#: twice as many events each.
EACH_NOTICE = 10


@dataclass(frozen=True)
class Prepared:
    """A calibrated configuration. path: of AXIS.toml; digest: of all settings that its monitors depend on."""

    path: Path
    axis: Axis
    setup: Setup
    digest: str

    @property
    def dt(self) -> float:
        return self.setup.monitor.estimator.dt


def prepare(
    path: Path, record: Record | None = None, progress: Callable[[float], None] | None = None, given: Axis | None = None
) -> Prepared:
    """Reads and calibrates a configuration; record: on which its only axis is watched; given: the content of AXIS.toml
    if already read. Raises UsageError or NotIdentifiableError as `set_up` does."""
    axis = load_axis(path) if given is None else given
    setup = set_up(axis, path.parent, record, progress)
    digest = sha256(f"{axis.model_dump_json(warnings=False)} {setup.path.name} {setup.nominal.tolist()}".encode())
    return Prepared(path, axis, setup, digest.hexdigest())


@dataclass(frozen=True)
class Pace:
    """window: time for which early blocks wait for earlier ones [s]; every: time between two rows [s], 0: all rows."""

    window: float = 0.5
    every: float = 1.0


class Seat:
    """One axis in its group.

    order, timed: of its blocks and its lines; number: its own in the service, 0 before it has one; notices: number of
    its notices; notice_counts: number of events of each kind that `may_tell` limits; referred: (q,) reference set by
    hand, None: the reference of its configuration.
    """

    __slots__ = ("_place", "group", "name", "notice_counts", "notices", "number", "order", "referred", "timed")

    def __init__(self, group: Group, index: int, name: str) -> None:
        self.group, self.name, self._place = group, name, PositionRow(group.positions, index)
        self.order = Order(group.dt, round(group.pace.window / group.dt), self._place)
        self.timed: Timed | None = None
        self.number, self.notices = 0, 0
        self.notice_counts: dict[str, int] = {}
        self.referred: tuple[float, ...] | None = None

    @property
    def index(self) -> int:
        """Number of the axis in the group."""
        return self._place.index

    def move(self, index: int) -> None:
        """Changes the number after the removal of other axes."""
        self._place.index = index

    def lines(self, timed: bool) -> Timed:
        """The converter of its lines to samples; timed: the first lines have a time."""
        if self.timed is None:
            self.timed = Timed(self.group.dt, self.group.pace.window, timed)
        return self.timed

    def restart_numbers(self) -> tuple[int, list[Event]]:
        """Accepts any next number as the first one, after a gap of unknown length. Returns the number of waiting
        samples, which are dropped, and the events of the monitor."""
        dropped = sum(block.counts.size for block in self.order.held)
        self._place.positions.forget(self.index)
        self.order = Order(self.group.dt, self.order.window, self._place)
        if not self.group.numbers[self.index]:
            return dropped, []
        self.group.numbers[self.index] += 1
        return dropped, self.group.fleet.skip(self.index, 1)

    def may_tell(self, kind: str) -> bool:
        """Counts an event of a kind. Returns whether it becomes a notice; the count alone decides, so a restart changes
        nothing."""
        times = self.notice_counts[kind] = self.notice_counts.get(kind, 0) + 1
        rounds, rest = divmod(times, EACH_NOTICE)
        return times <= EACH_NOTICE or (rest == 0 and rounds.bit_count() == 1)


@dataclass
class Group:
    """Axes of one configuration. seats: by number; numbers: (axes,) samples of each so far; positions: state of the
    numbers and clocks of their senders."""

    prepared: Prepared
    pace: Pace
    seats: list[Seat] = field(default_factory=list, init=False)
    numbers: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64), init=False)
    positions: Positions = field(default_factory=lambda: Positions.fresh(0), init=False)

    def __post_init__(self) -> None:
        self.dt = self.prepared.dt
        self.fleet = MonitorFleet(self.prepared.setup.monitor, 0)
        self.stride = max(1, round(self.pace.every / self.dt))
        self.kindred = self._build_kindred()

    def add(self, names: Iterable[str]) -> None:
        """Adds axes without a history."""
        fresh = list(names)
        if not fresh:
            return
        start = len(self.seats)
        self.fleet.add(len(fresh))
        self.positions.add(len(fresh))
        self.seats += [Seat(self, start + k, name) for k, name in enumerate(fresh)]
        self.numbers = np.concatenate([self.numbers, np.zeros(len(fresh), np.int64)])
        self.kindred = self._build_kindred()

    def remove(self, gone: Sequence[int]) -> None:
        """Removes these axes; the others go on."""
        if not len(gone):
            return
        self.fleet.remove(np.array(gone, np.int64))
        left = set(gone)
        self.seats = [seat for seat in self.seats if seat.index not in left]
        self.numbers = np.delete(self.numbers, list(gone))
        self.positions.remove(gone)
        for k, seat in enumerate(self.seats):
            seat.move(k)
        self.kindred = self._build_kindred()

    def restore(self, names: Sequence[str], state: bytes) -> None:
        """Restores axes from the saved state of their fleet. Raises UsageError for a state of another fleet."""
        self.fleet.set_state(state)
        self.positions.add(len(names))
        self.seats = [Seat(self, k, name) for k, name in enumerate(names)]
        self.numbers = np.array(self.fleet.samples(), np.int64)
        self.kindred = self._build_kindred()

    def _build_kindred(self) -> Kindred:
        axis, setup, monitor = self.prepared.axis, self.prepared.setup, self.prepared.setup.monitor
        rotary = axis.model.axis == "rotary"
        force = ("N m" if rotary else "N") if axis.model.input_gain == 1 else ""
        return Kindred(
            self.prepared.path.name,
            monitor.names,
            monitor.units,
            self.dt,
            setup.reported,
            tuple(seat.name for seat in self.seats),
            force,
            monitor.estimator.encoder.resolution,
            "rad" if rotary else "m",
        )
