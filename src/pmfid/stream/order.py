"""The order of blocks, decided by their numbers."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from pmfid.monitor.rows import RowArrays, rows_of
from pmfid.stream.delivery import Block
from pmfid.stream.tuning import TUNING
from pmfid.types import Counts, Flags, Floats

T = TypeVar("T", int, float, bool)


@dataclass
class Positions(RowArrays):
    """The state of the numbers and clocks of many senders, in columns (axes,).

    `epoch` and `expected` belong to the next sample; the epoch is -1 before the first one. `time` is the time of sample
    `number` by the sender's clock [s], NaN while unknown. `start` and `first` are time and number at which the
    measurement of the clock's rate began. `wrong_rate` is true if the last measured rate was outside its tolerance.
    `wrong_period` is true after a notice on samples of another period. `waits` is true if some blocks are early.
    `heard` is the time of the last used samples by the clock of `Silence` [s], NaN without samples. `alarm` is the
    number of the alarm on the silence of the axis or of its source, or 0. `source` is the number that `Silence` gives
    to the source of the last item, or -1. `seat` and `notices` belong to `Seat`.
    """

    epoch: NDArray[np.int64] = field(metadata=rows_of(kind=np.int64, start=-1))
    expected: NDArray[np.int64] = field(metadata=rows_of(kind=np.int64))
    time: Floats = field(metadata=rows_of(start=math.nan))
    number: NDArray[np.int64] = field(metadata=rows_of(kind=np.int64))
    start: Floats = field(metadata=rows_of(start=math.nan))
    first: NDArray[np.int64] = field(metadata=rows_of(kind=np.int64))
    wrong_rate: Flags = field(metadata=rows_of(kind=np.bool_))
    wrong_period: Flags = field(metadata=rows_of(kind=np.bool_))
    waits: Flags = field(metadata=rows_of(kind=np.bool_, saved=False))
    heard: Floats = field(metadata=rows_of(start=math.nan, saved=False))
    alarm: NDArray[np.int64] = field(metadata=rows_of(kind=np.int64))
    source: NDArray[np.int64] = field(metadata=rows_of(kind=np.int64, start=-1, saved=False))
    seat: NDArray[np.int64] = field(metadata=rows_of(kind=np.int64))
    notices: NDArray[np.int64] = field(metadata=rows_of(kind=np.int64))

    def add(self, axes: int) -> None:
        """Add rows of axes without any data."""
        vars(self).update(vars(self.join_rows(Positions.empty(axes))))

    def forget(self, index: int) -> None:
        """Reset the numbers and the clock of an axis."""
        here, fresh = slice(index, index + 1), Positions.empty(1)
        for name in ("heard", "alarm", "source", "seat", "notices"):
            setattr(fresh, name, getattr(self, name)[here])
        self.put(here, fresh)

    def restore(self, saved: Positions) -> None:
        """Continue from a saved state. Axes that were silent are silent until new data arrive."""
        saved.heard[saved.alarm != 0] = -math.inf
        vars(self).update(vars(saved))

    def remove(self, index: Sequence[int]) -> None:
        """Remove rows. The other rows keep their order."""
        left = np.delete(np.arange(self.epoch.size), list(index))
        vars(self).update(vars(self.take_rows(left)))


class PositionRow:
    """The row of an axis, which moves up when other axes are removed."""

    __slots__ = ("index", "positions")

    def __init__(self, positions: Positions, index: int) -> None:
        self.positions, self.index = positions, index


class Column(Generic[T]):
    """An attribute of an object with a `place`, kept in a column of its positions."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __get__(self, one: object, kind: type | None = None) -> T:
        place: PositionRow = one.place  # type: ignore[attr-defined]
        found: T = getattr(place.positions, self._name).item(place.index)
        return found

    def __set__(self, one: object, value: T) -> None:
        place: PositionRow = one.place  # type: ignore[attr-defined]
        getattr(place.positions, self._name)[place.index] = value


#: The tests apply to one block with a number, or to the blocks of many axes with one number each.
Real = float | Floats
Whole = int | NDArray[np.int64]
Answer = bool | Flags


def period_fits(period: Real, dt: float) -> Answer:
    """Return whether a sender has the sample period of the configuration."""
    return (period - dt <= TUNING.order_period * dt) & (dt - period <= TUNING.order_period * dt)


def clock_runs(off: Real) -> Answer:
    """Return whether a clock with this deviation [s] was never set. An unknown deviation gives False."""
    return (off <= TUNING.order_set) & (-off <= TUNING.order_set)


def rate_is_due(samples: Whole, time: Real) -> Answer:
    """Return whether the rate of a clock is tested after `samples` samples and `time` seconds."""
    return (samples >= TUNING.rate_samples) & (time >= TUNING.rate_time)


def rate_fits(rate: Real) -> Answer:
    """Return whether the rate of a clock is within its tolerance."""
    return (rate - 1 <= TUNING.order_rate) & (1 - rate <= TUNING.order_rate)


class Clock:
    """A comparison of the sender's clock with its numbers.

    `dt` is the sample period [s]. `expected` is the time of sample `number` [s], NaN while unknown. `start` and `first`
    are time and number at which the measurement of the rate began. `wrong_rate` is true if the last measured rate was
    outside its tolerance.
    """

    __slots__ = ("dt", "place")
    expected, number = Column[float]("time"), Column[int]("number")
    start, first = Column[float]("start"), Column[int]("first")
    wrong_rate = Column[bool]("wrong_rate")

    def __init__(self, dt: float, place: PositionRow) -> None:
        self.dt, self.place = dt, place

    def reset(self) -> None:
        self.expected, self.number, self.start, self.first, self.wrong_rate = math.nan, 0, math.nan, 0, False

    def look(self, first: int, end: int, time: float) -> dict[str, object] | None:
        """Test the clock at the next block. Returns a notice object if the clock was set or its rate is wrong."""
        if math.isnan(time):
            return None
        off = time - self.expected - (first - self.number) * self.dt
        self.expected, self.number = time + (end - first) * self.dt, end
        if not clock_runs(off):
            self.start, self.first = time, first
            return None if math.isnan(off) else {"event": "clock", "time": time, "jump": off}
        if rate_is_due(first - self.first, time - self.start):
            return self._rate(first, time)
        return None

    def _rate(self, first: int, time: float) -> dict[str, object] | None:
        rate = (time - self.start) / ((first - self.first) * self.dt)
        self.start, self.first = time, first
        wrong, known = not rate_fits(rate), self.wrong_rate
        self.wrong_rate = wrong
        if not wrong or known:
            return None
        period = rate * self.dt
        problem = f"a sample takes {period:.6g} s by the sender's clock, but {self.dt:.6g} s by the configuration"
        return {"event": "clock", "time": time, "jump": 0.0, "rate": rate, "problem": problem}


#: A gap of unknown length, because the sender restarted.
UNKNOWN_GAP = -1
#: Remedy for a sender that restarted its numbers without a higher epoch.
REMEDY = (
    "Repeated samples do no harm. If the sender has restarted, let it send a higher epoch, for "
    'example the time of day in whole seconds. Or use "Begin anew" on the page of the axis (POST '
    "/api/axis/NAME/anew): the service then accepts the next samples of the axis, whatever their "
    "epoch"
)


class SamplePiece(NamedTuple):
    """Samples to be stepped.

    `lead` is the number of samples missing before the first one, or UNKNOWN_GAP. `apart` is true if the sender and its
    counter restarted, so that the samples on both sides share nothing. `time` is the time of sample `-offset` [s], or
    NaN. `received` is `time.monotonic()`. `turn` is the number of the item since the start, which orders events.
    `times` (n,) has the times of the samples if the samples have times of their own. `ages` (n,) is as in `Block`.
    """

    lead: int
    apart: bool
    u: Floats
    counts: Counts
    time: float
    offset: int
    received: float
    turn: int
    times: Floats | None = None
    ages: Floats | None = None


@dataclass
class ItemReport:
    """The result of an item, apart from its pieces.

    `dropped` has the number of samples that were left out as "duplicate", "late" or, for another period, "refused".
    `lines` has the number of lines without a sample, by their kind. `events` are objects for notices. `stale` is the
    remedy for a sender whose samples are all dropped. If `again` is set, `stale` becomes a notice even if it was
    reported before.
    """

    dropped: Counter[str] = field(default_factory=Counter)
    lines: Counter[str] = field(default_factory=Counter)
    events: list[dict[str, object]] = field(default_factory=list)
    stale: str = ""
    again: bool = False


class Order:
    """The order of the blocks of one axis.

    `dt` is the sample period [s]. `window` is the number of samples for which an early block waits. `place` is the row
    of the axis' numbers. By default the axis has its own row. `epoch` and `expected` belong to the next sample; the
    epoch is -1 before the first one. `held` has the waiting blocks, by epoch and number. `idle` is the number of
    consecutive repeated samples, and the number that was expected meanwhile.
    """

    __slots__ = ("_held", "clock", "dt", "gaps", "idle", "place", "window")
    epoch, expected = Column[int]("epoch"), Column[int]("expected")
    wrong_period, _waiting = Column[bool]("wrong_period"), Column[bool]("waits")

    def __init__(self, dt: float, window: int, place: PositionRow | None = None) -> None:
        self.dt, self.window = dt, window
        self.place = place or PositionRow(Positions.empty(1), 0)
        self._held: list[Block] = []
        self.gaps: list[tuple[int, int]] = []
        self.clock = Clock(dt, self.place)
        self.idle = 0, 0

    @property
    def held(self) -> tuple[Block, ...]:
        return tuple(self._held)

    def hold(self, at: int, block: Block) -> None:
        """Insert a block at position `at` of the waiting blocks."""
        self._held.insert(at, block)
        self._waiting = True

    def take(self, block: Block, received: float, turn: int, pieces: list[SamplePiece]) -> ItemReport | None:
        """Append the samples that can be stepped to `pieces`. Returns None for the expected block without a notice."""
        next_one = block.epoch == self.epoch and block.first == self.expected and not self._held
        if next_one and block.counts.size and period_fits(block.dt, self.dt):
            self.expected = block.end
            pieces.append(SamplePiece(0, False, block.u, block.counts, block.time, 0, received, turn, None, block.ages))
            event = self.clock.look(block.first, self.expected, block.time)
            return None if event is None else ItemReport(events=[event])
        return self._sort_block(block, received, turn, pieces)

    def _sort_block(self, block: Block, received: float, turn: int, pieces: list[SamplePiece]) -> ItemReport:
        verdict = ItemReport()
        n = block.counts.size
        if not period_fits(block.dt, self.dt):
            self._refuse(block, verdict)
            return verdict
        if n == 0:
            return verdict
        if block.epoch < self.epoch:
            verdict.dropped["late"] += n
            verdict.stale = f"{n} samples of epoch {block.epoch} arrived after epoch {self.epoch} had begun. {REMEDY}"
            return verdict
        if block.epoch == self.epoch and block.end <= self.expected:
            self._count_old(block.first, block.end, verdict)
            self._note_repetition(block, verdict)
            return verdict
        if self._hold(block, verdict):
            self._release(received, turn, pieces, verdict)
        return verdict

    def _refuse(self, block: Block, verdict: ItemReport) -> None:
        verdict.dropped["refused"] += block.counts.size
        if not self.wrong_period:
            self.wrong_period = True
            problem = (
                f"the sample period of its blocks is {block.dt:.6g} s, but the reference has {self.dt:.6g} s: "
                "send blocks with the period of the reference, or record a reference with the period of the "
                "blocks"
            )
            verdict.events.append({"event": "period", "problem": problem})

    def _count_old(self, first: int, end: int, verdict: ItemReport) -> None:
        """Count old samples, which are late if they belong to a gap, and repeated in other cases."""
        late = sum(max(0, min(end, b) - max(first, a)) for a, b in self.gaps)
        verdict.dropped["late"] += late
        verdict.dropped["duplicate"] += end - first - late

    def _note_repetition(self, block: Block, verdict: ItemReport) -> None:
        """Report a sender that repeats samples for `nothing_new` seconds, and again at each doubling of this time."""
        before = self.idle[0] if self.idle[1] == self.expected else 0
        now, most = before + block.counts.size, TUNING.nothing_new / self.dt
        self.idle = now, self.expected
        verdict.again = int(now / most).bit_length() > int(before / most).bit_length()
        if verdict.again:
            verdict.stale = (
                f"samples for {now * self.dt:.0f} s in a row were repetitions: number {block.first} of epoch "
                f"{block.epoch} arrived, but number {self.expected} is expected. {REMEDY}"
            )

    def _hold(self, block: Block, verdict: ItemReport) -> bool:
        """Insert a block into the waiting blocks, by epoch and number. Returns False for a block that already waits."""
        key = (block.epoch, block.first)
        at = len(self._held)
        while at and (self._held[at - 1].epoch, self._held[at - 1].first) > key:
            at -= 1
        before = self._held[at - 1] if at else None
        if before is not None and before.epoch == block.epoch and before.end >= block.end:
            verdict.dropped["duplicate"] += block.counts.size
            return False
        self.hold(at, block)
        return True

    def _release(self, received: float, turn: int, pieces: list[SamplePiece], verdict: ItemReport) -> None:
        while self._held:
            block = self._held[0]
            lead = self._find_lead(block)
            if lead is None:
                return
            del self._held[0]
            self._waiting = bool(self._held)
            self._give(block, lead, received, turn, pieces, verdict)

    def _find_lead(self, block: Block) -> int | None:
        """Return the number of samples missing before the first waiting block, or None while the block has to wait."""
        if block.epoch == self.epoch and block.first <= self.expected:
            return 0
        if self._must_wait(block):
            return None
        if block.epoch == self.epoch:
            missing = block.first - self.expected
            return missing if missing * self.dt <= TUNING.longest_absence else UNKNOWN_GAP
        ahead = block.time - self.clock.expected
        follows = self.epoch >= 0 and 0 <= ahead <= TUNING.longest_gap
        return max(1, round(ahead / self.dt)) if follows else UNKNOWN_GAP

    def _must_wait(self, block: Block) -> bool:
        """Return whether lower numbers may still come, because each epoch's waiting blocks span at most the window."""
        if not self.window:
            return False
        start, end, epoch = block.first, block.end, block.epoch
        for other in self._held:
            if other.epoch != epoch:
                start, end, epoch = other.first, other.end, other.epoch
            end = max(end, other.end)
            if end - start > self.window:
                return False
        return True

    def _give(
        self, block: Block, lead: int, received: float, turn: int, pieces: list[SamplePiece], verdict: ItemReport
    ) -> None:
        fresh, apart = self.epoch < 0, block.epoch != self.epoch or lead == UNKNOWN_GAP
        if apart:
            self._begin(block, fresh, verdict)
        elif lead:
            self.gaps = [*self.gaps, (self.expected, block.first)][-TUNING.remembered :]
            verdict.events.append({"event": "gap", "time": block.time, "missing": block.first - self.expected})
        known = min(max(0, self.expected - block.first), block.counts.size)
        if known:
            self._count_old(block.first, block.first + known, verdict)
        if known == block.counts.size:
            return
        if (event := self.clock.look(block.first, block.end, block.time)) and not apart:
            verdict.events.append(event)
        self.expected = block.end
        u, counts, ages = block.u[known:], block.counts[known:], None if block.ages is None else block.ages[known:]
        lead = 0 if fresh else lead
        pieces.append(SamplePiece(lead, apart, u, counts, block.time, known, received, turn, None, ages))

    def _begin(self, block: Block, fresh: bool, verdict: ItemReport) -> None:
        """Begin a higher epoch, the first one, or numbers that do not follow the last ones."""
        if not fresh:
            ahead = block.time - self.clock.expected
            jump = ahead if math.isfinite(ahead) else None
            verdict.events.append({"event": "epoch", "epoch": block.epoch, "time": block.time, "jump": jump})
        self.epoch, self.expected = block.epoch, block.first
        self.gaps = [(0, block.first)] if block.first else []
        self.clock.reset()
