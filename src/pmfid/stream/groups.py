"""Groups of monitors that step together."""

from __future__ import annotations

import math
import struct
from bisect import insort
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from hashlib import blake2b, file_digest, sha256
from operator import attrgetter
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pmfid.config.axis import Axis, load_axis
from pmfid.errors import UsageError
from pmfid.monitor.events import Event
from pmfid.monitor.fleet import MonitorFleet
from pmfid.pipeline.monitored.setup import VERSION, Setup, set_up
from pmfid.stream.delivery import Lines
from pmfid.stream.order import UNKNOWN_GAP, Column, ItemReport, Order, PositionRow, Positions, SamplePiece
from pmfid.stream.outcome import Kindred
from pmfid.stream.timeline import REPEATED, Line, Sample, Saved, SavedFields, Timeline
from pmfid.stream.tuning import TUNING

_LINE = struct.Struct("<ddq")


@dataclass
class Timed(SavedFields):
    """A converter from lines to samples.

    `dt` is the sample period [s]. `window` is the time for which lines wait for older lines [s]. 0 means that no line
    waits. `timed` is true if the lines have a time. Each other line follows the preceding line after dt.

    A line has no number, so only its content reveals a repetition. The digests of the last lines survive a restart, for
    a source that then repeats lines. Without these digests, consecutive old lines would look like a clock that was set
    back.
    """

    dt: float
    window: float
    timed: bool
    _held: list[Line] = field(default_factory=list, init=False)
    _newest: float = field(default=-math.inf, init=False)
    _late_in_row: int = field(default=0, init=False)
    _latest: float = field(default=-math.inf, init=False)
    _stamped: int = field(default=0, init=False)  # number of lines without a time
    _doubtful: int = field(default=0, init=False)  # number of consecutive samples that are needed before any is used

    def __post_init__(self) -> None:
        self._grid = Timeline(self.dt)
        self._recent: deque[str] = deque(maxlen=TUNING.groups_known)  # digests of lines
        self._before: frozenset[str] = frozenset()  # digests from before the restart
        self._until = -math.inf  # latest time among the digests from before the restart

    def take(self, item: Lines, received: float, turn: int, pieces: list[SamplePiece]) -> ItemReport:
        """Append the samples that are known now to `pieces`."""
        verdict, samples = ItemReport(), list[Sample]()
        for given in item.lines:
            if self.timed and self._is_repeated(given):
                verdict.lines[REPEATED] += 1
                continue
            for line in self._sort_line(given) if self.timed else [self._stamp(given)]:
                samples += self._samples(line, verdict)
        pieces += _join_samples(samples, received, turn, verdict)
        return verdict

    def _stamp(self, line: Line) -> Line:
        self._stamped += 1
        return replace(line, time=(self._stamped - 1) * self.dt)

    def _is_repeated(self, line: Line) -> bool:
        """Return whether a line already came before the restart."""
        # With fewer than 64 bits, one line in some thousand restarts would be taken for another line, and lost.
        digest = blake2b(_LINE.pack(line.time, line.u, line.counts), digest_size=8).hexdigest()
        if self._before and not line.time > self._until and digest in self._before:
            return True
        self._recent.append(digest)
        self._latest = max(self._latest, line.time)
        return False

    def _sort_line(self, line: Line) -> list[Line]:
        """Return the lines that are older than the newest line by the window."""
        if not self.window or math.isnan(line.time):
            return [line]
        if line.time < self._newest - self.window:
            return self._take_late(line)
        self._late_in_row = 0
        self._newest = max(self._newest, line.time)
        insort(self._held, line, key=attrgetter("time"))
        due = 0
        while due < len(self._held) and (
            self._held[due].time <= self._newest - self.window or len(self._held) - due > TUNING.groups_most
        ):
            due += 1
        ready, self._held = self._held[:due], self._held[due:]
        return ready

    def _take_late(self, line: Line) -> list[Line]:
        """Pass a late line to the timeline, which classifies the line. `timeline_late` late lines reveal a clock set
        back."""
        self._late_in_row += 1
        if self._late_in_row < TUNING.timeline_late:
            return [line]
        held, self._held = self._held, []
        self._newest, self._late_in_row = line.time, 0
        return [*held, line]

    def _samples(self, line: Line, verdict: ItemReport) -> list[Sample]:
        try:
            found = self._grid.take(line)
        except UsageError as error:
            if not self._doubtful:
                verdict.events.append({"event": "period", "problem": str(error)})
            self._grid, self._doubtful = Timeline(self.dt), TUNING.groups_probation
            verdict.dropped["refused"] += 1
            return []
        samples = [one for one in found if isinstance(one, Sample)]
        for one in found:
            if not isinstance(one, Sample):
                verdict.lines[one.kind] += 1
                verdict.events.append({"event": one.kind, "time": one.time, "problem": one.problem})
        return self._check_probation(samples, verdict) if self._doubtful and samples else samples

    def _check_probation(self, samples: list[Sample], verdict: ItemReport) -> list[Sample]:
        """Refuse samples after lines of another period, until enough samples fit."""
        verdict.dropped["refused"] += len(samples)
        self._doubtful = max(0, self._doubtful - len(samples))
        if self._doubtful:
            return []
        last = samples[-1]
        verdict.dropped["refused"] -= 1
        return [Sample(last.time, last.u, last.counts, 0, math.inf, last.further)]

    def save_state(self) -> Saved:
        """Return the state for JSON with NaN and infinity."""
        held, grid = [line.as_list() for line in self._held], self._grid.save_state()
        return super().save_state() | {"timed": self.timed, "recent": list(self._recent), "held": held, "grid": grid}

    def restore(self, saved: Saved) -> None:
        """Restore a saved state. Raises KeyError, TypeError or ValueError for anything else."""
        super().restore(saved | {"held": [Line(*entry) for entry in saved["held"]]})
        self.timed = bool(saved["timed"])
        self._recent.extend(map(str, saved["recent"]))
        self._before, self._until = frozenset(self._recent), self._latest
        self._grid = Timeline(self.dt)
        self._grid.restore(saved["grid"])


def _join_samples(samples: list[Sample], received: float, turn: int, verdict: ItemReport) -> list[SamplePiece]:
    pieces, begun = list[SamplePiece](), 0
    for k, sample in enumerate(samples):
        if sample.missing or sample.jump:
            pieces += _piece(samples[begun:k], received, turn)
            begun = k
            verdict.events.append(_interruption(sample))
    return pieces + _piece(samples[begun:], received, turn)


def _interruption(sample: Sample) -> dict[str, object]:
    if sample.missing:
        return {"event": "gap", "time": sample.time, "missing": sample.missing}
    return {"event": "clock", "time": sample.time, "jump": sample.jump if math.isfinite(sample.jump) else None}


def _piece(samples: list[Sample], received: float, turn: int) -> list[SamplePiece]:
    if not samples:
        return []
    lead = samples[0].missing or (UNKNOWN_GAP if samples[0].jump else 0)
    u, counts = np.array([s.u for s in samples]), np.array([s.counts for s in samples], np.int64)
    times, ages = np.array([s.time for s in samples]), np.array([s.further for s in samples])
    return [SamplePiece(lead, False, u, counts, math.nan, 0, received, turn, times, ages)]


@dataclass(frozen=True)
class Prepared:
    """A calibrated configuration from the AXIS.toml at `path`.

    `digest` is a hash of the text of AXIS.toml and the bytes of its reference, on which the monitors depend. Numbers
    that follow from them are no part of the hash, because a linear algebra rounds by the kind of processor.
    """

    path: Path
    axis: Axis
    setup: Setup
    digest: str

    @property
    def dt(self) -> float:
        return self.setup.monitor.estimator.dt


def prepare(path: Path, given: Axis | None = None, baselines: Mapping[str, str] | None = None) -> Prepared:
    """Read a configuration, and calibrate it unless its baseline is known.

    `given` is the content of AXIS.toml if it was already read. `baselines` maps digests of configurations to the
    baselines of an earlier run. Raises UsageError or NotIdentifiableError as `set_up` does.
    """
    axis = load_axis(path) if given is None else given
    digest = _digest(path, axis)
    return Prepared(path, axis, set_up(axis, path.parent, None, (baselines or {}).get(digest)), digest)


def _digest(path: Path, axis: Axis) -> str:
    digest = sha256(f"{VERSION} {axis.model_dump_json(warnings=False)}".encode())
    if axis.monitor.reference is not None:
        reference = path.parent / axis.monitor.reference
        for file in sorted(reference.rglob("*")) if reference.is_dir() else [reference]:
            if file.is_file():
                with file.open("rb") as content:
                    digest.update(file_digest(content, "sha256").digest())
    return digest.hexdigest()


@dataclass(frozen=True)
class Pace:
    """Times that set the pace of a group.

    `window` is the time for which early blocks wait for earlier ones [s]. `every` is the time between two rows [s]. 0
    gives all rows.
    """

    window: float
    every: float


class Seat:
    """An axis as a member of its group.

    `order` sorts the blocks of the axis, `timed` its lines. `number` is the number of the axis in the service, or 0
    before it has one. `notices` is the number of its notices. `notice_counts` has the number of events of each kind
    that `may_tell` limits. `referred` (q,) is a reference set by hand, or None for the reference of the configuration.
    """

    __slots__ = ("group", "name", "notice_counts", "order", "place", "referred", "timed")
    number, notices = Column[int]("seat"), Column[int]("notices")

    def __init__(self, group: Group, index: int, name: str) -> None:
        self.group, self.name, self.place = group, name, PositionRow(group.positions, index)
        self.order = Order(group.dt, round(group.pace.window / group.dt), self.place)
        self.timed: Timed | None = None
        self.notice_counts: dict[str, int] = {}
        self.referred: tuple[float, ...] | None = None

    @property
    def index(self) -> int:
        return self.place.index

    def lines(self, timed: bool) -> Timed:
        """Return the converter from lines of this axis to samples. `timed` is true if the first lines have a time."""
        if self.timed is None:
            self.timed = Timed(self.group.dt, self.group.pace.window, timed)
        return self.timed

    def restart_numbers(self) -> tuple[int, list[Event]]:
        """Accept any next number as the first one, after a gap of unknown length.

        Returns the number of waiting samples, which are dropped, and the events of the monitor.
        """
        dropped = sum(block.counts.size for block in self.order.held)
        self.place.positions.forget(self.index)
        self.order = Order(self.group.dt, self.order.window, self.place)
        if not self.group.numbers[self.index]:
            return dropped, []
        self.group.numbers[self.index] += 1
        return dropped, self.group.fleet.skip(self.index, 1)

    def may_tell(self, kind: str) -> bool:
        """Count an event of a kind, and return whether it becomes a notice.

        Only the count decides, so a restart changes nothing.
        """
        times = self.notice_counts[kind] = self.notice_counts.get(kind, 0) + 1
        rounds, rest = divmod(times, TUNING.each_notice)
        return times <= TUNING.each_notice or (rest == 0 and rounds.bit_count() == 1)


@dataclass
class Group:
    """The axes of one configuration.

    `seats` has the axes by their number. `numbers` (axes,) has the number of samples of each axis so far. `positions`
    is the state of the numbers and clocks of their senders.
    """

    prepared: Prepared
    pace: Pace
    seats: list[Seat] = field(default_factory=list, init=False)
    numbers: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64), init=False)
    positions: Positions = field(default_factory=lambda: Positions.empty(0), init=False)

    def __post_init__(self) -> None:
        self.dt = self.prepared.dt
        self.fleet = MonitorFleet(self.prepared.setup.monitor, 0)
        self.stride = max(1, round(self.pace.every / self.dt))
        self.kindred = self._build_kindred()

    def add(self, names: Iterable[str]) -> None:
        """Add axes without a history."""
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
        """Remove some axes. The other axes continue."""
        if not len(gone):
            return
        self.fleet.remove(np.array(gone, np.int64))
        left = set(gone)
        self.seats = [seat for seat in self.seats if seat.index not in left]
        self.numbers = np.delete(self.numbers, list(gone))
        self.positions.remove(gone)
        for k, seat in enumerate(self.seats):
            seat.place.index = k
        self.kindred = self._build_kindred()

    def restore(self, names: Sequence[str], state: bytes) -> None:
        """Restore axes from the saved state of their fleet. Raises UsageError for a state of another fleet."""
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
