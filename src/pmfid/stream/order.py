"""Blocks of one axis in the order of their numbers: repeated blocks are dropped, early blocks wait.

The numbers alone decide, never the time of arrival: any order of the blocks within the window gives the same samples.
A hole becomes a gap of known length once the waiting blocks span more than the window; until then a lower number may
still come. Blocks for a gap are late. A higher epoch, and the first block of all, wait as long.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

from pmfid.stream.clock import Clock, period_fits
from pmfid.stream.delivery import Block
from pmfid.stream.positions import Column, PositionRow, Positions
from pmfid.types import Counts, Floats

__all__ = ["UNKNOWN_GAP", "ItemReport", "Order", "SamplePiece"]

#: In place of a number of missing samples: the sender restarted, and the number is unknown.
UNKNOWN_GAP = -1
#: Longest gap between two epochs [s], and most missing samples between two numbers.
LONGEST_GAP, MOST_MISSING = 3600.0, 2**40
#: Gaps that are remembered, to distinguish late samples from repeated ones.
GAPS = 32
#: Time without a new sample after which a sender is reported [s]: no broker repeats more.
NOTHING_NEW = 120.0
#: Remedy for a sender that restarted its numbers without a higher epoch.
REMEDY = (
    "Repeated samples do no harm. If the sender restarted, let it send a higher epoch, as the time of day in "
    'whole seconds; or use "Begin anew" on the page of the axis (POST /api/axis/NAME/anew): then its next samples are '
    "taken, whatever their epoch"
)


class SamplePiece(NamedTuple):
    """Samples to be stepped.

    lead: samples missing before the first, UNKNOWN_GAP if their number is unknown; apart: the sender and its counter
    restarted, so the samples on both sides share nothing; time: of sample `-offset` [s], or NaN; received:
    `time.monotonic()`; turn: number of its item since the start, which orders events; times: (n,) of the samples if
    they have their own.
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


@dataclass
class ItemReport:
    """The outcome of an item apart from its pieces.

    duplicate, late: samples that were dropped; refused: samples of another period; lines: number of lines without a
    sample, by their kind; events: objects for notices; stale: the remedy for a sender whose samples are all dropped;
    again: `stale` becomes a notice even if it was reported before.
    """

    duplicate: int = 0
    late: int = 0
    refused: int = 0
    lines: dict[str, int] = field(default_factory=dict)
    events: list[dict[str, object]] = field(default_factory=list)
    stale: str = ""
    again: bool = False


class Order:
    """Blocks of one axis. dt: sample period [s]; window: samples for which an early block waits; place: row of its
    numbers, left out: a row of its own.

    epoch, expected: of the next sample, epoch -1 before the first; held: blocks that wait, by epoch and number;
    idle: number of consecutive repeated samples, and the number that was expected meanwhile.
    """

    __slots__ = ("_held", "clock", "dt", "gaps", "idle", "place", "window")
    epoch, expected = Column[int]("epoch"), Column[int]("expected")
    wrong_period, _waiting = Column[bool]("wrong_period"), Column[bool]("waits")

    def __init__(self, dt: float, window: int, place: PositionRow | None = None) -> None:
        self.dt, self.window = dt, window
        self.place = place or PositionRow(Positions.fresh(1), 0)
        self._held: list[Block] = []
        self.gaps: list[tuple[int, int]] = []
        self.clock = Clock(dt, self.place)
        self.idle = 0, 0

    @property
    def held(self) -> tuple[Block, ...]:
        return tuple(self._held)

    def hold(self, at: int, block: Block) -> None:
        """Inserts a block at position `at` of the waiting blocks."""
        self._held.insert(at, block)
        self._waiting = True

    def take(self, block: Block, received: float, turn: int, pieces: list[SamplePiece]) -> ItemReport | None:
        """Appends the samples that can be stepped to `pieces`; returns None for the expected block without a notice."""
        n = block.counts.size
        if (
            n
            and block.epoch == self.epoch
            and block.first == self.expected
            and not self._held
            and period_fits(block.dt, self.dt)
        ):
            self.expected = block.first + n
            pieces.append(SamplePiece(0, False, block.u, block.counts, block.time, 0, received, turn))
            event = self.clock.look(block.first, self.expected, block.time)
            return None if event is None else ItemReport(events=[event])
        return self._sort_block(block, received, turn, pieces)

    def _sort_block(self, block: Block, received: float, turn: int, pieces: list[SamplePiece]) -> ItemReport:
        verdict = ItemReport()
        n = block.counts.size
        if not period_fits(block.dt, self.dt):
            return self._refuse(block, verdict)
        if n == 0:
            return verdict
        if block.epoch < self.epoch:
            verdict.late += n
            verdict.stale = f"{n} samples of epoch {block.epoch} came when epoch {self.epoch} had begun. {REMEDY}"
            return verdict
        if block.epoch == self.epoch and block.end <= self.expected:
            self._count_old(block.first, block.end, verdict)
            self._note_repetition(block, verdict)
            return verdict
        if self._hold(block, verdict):
            self._release(received, turn, pieces, verdict)
        return verdict

    def _refuse(self, block: Block, verdict: ItemReport) -> ItemReport:
        verdict.refused += block.counts.size
        if not self.wrong_period:
            self.wrong_period = True
            problem = (
                f"its samples come every {block.dt:.6g} s, the reference has {self.dt:.6g} s: send with that period, "
                "or take a reference with this one"
            )
            verdict.events.append({"event": "period", "problem": problem})
        return verdict

    def _count_old(self, first: int, end: int, verdict: ItemReport) -> None:
        """Counts old samples: samples of a gap are late, the others are repeated."""
        late = sum(max(0, min(end, b) - max(first, a)) for a, b in self.gaps)
        verdict.late += late
        verdict.duplicate += end - first - late

    def _note_repetition(self, block: Block, verdict: ItemReport) -> None:
        """Reports a sender that repeats samples for NOTHING_NEW seconds, and again at each doubling of that time."""
        before = self.idle[0] if self.idle[1] == self.expected else 0
        now, most = before + block.counts.size, NOTHING_NEW / self.dt
        self.idle = now, self.expected
        verdict.again = int(now / most).bit_length() > int(before / most).bit_length()
        if verdict.again:
            verdict.stale = (
                f"{now * self.dt:.0f} s of samples in a row that were there before: number {block.first} of epoch "
                f"{block.epoch}, and {self.expected} is the next. {REMEDY}"
            )

    def _hold(self, block: Block, verdict: ItemReport) -> bool:
        """Inserts a block into the waiting blocks, by epoch and number; False for a block that waits already."""
        key = (block.epoch, block.first)
        at = len(self._held)
        while at and (self._held[at - 1].epoch, self._held[at - 1].first) > key:
            at -= 1
        before = self._held[at - 1] if at else None
        if before is not None and before.epoch == block.epoch and before.end >= block.end:
            verdict.duplicate += block.counts.size
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
        """Samples missing before the first waiting block: 0 for none, None while the block has to wait."""
        if block.epoch == self.epoch and block.first <= self.expected:
            return 0
        if self._must_wait(block):
            return None
        if block.epoch == self.epoch:
            missing = block.first - self.expected
            return missing if missing <= MOST_MISSING else UNKNOWN_GAP
        return self._count_epoch_gap(block)

    def _must_wait(self, block: Block) -> bool:
        """Whether lower numbers may still come: the waiting blocks of no epoch span more than the window."""
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

    def _count_epoch_gap(self, block: Block) -> int:
        ahead = block.time - self.clock.expected
        if self.epoch >= 0 and 0 <= ahead <= LONGEST_GAP:
            return max(1, round(ahead / self.dt))
        return UNKNOWN_GAP

    def _give(
        self, block: Block, lead: int, received: float, turn: int, pieces: list[SamplePiece], verdict: ItemReport
    ) -> None:
        fresh, apart = self.epoch < 0, block.epoch != self.epoch
        if apart:
            self._begin(block, fresh, verdict)
        elif lead:
            self.gaps = [*self.gaps, (self.expected, block.first)][-GAPS:]
            verdict.events.append({"event": "gap", "time": block.time, "missing": block.first - self.expected})
        known = min(max(0, self.expected - block.first), block.counts.size)
        if known:
            self._count_old(block.first, block.first + known, verdict)
        if known == block.counts.size:
            return
        if (event := self.clock.look(block.first, block.end, block.time)) and not apart:
            verdict.events.append(event)
        self.expected = block.end
        u, counts = (block.u[known:], block.counts[known:]) if known else (block.u, block.counts)
        pieces.append(SamplePiece(0 if fresh else lead, apart, u, counts, block.time, known, received, turn))

    def _begin(self, block: Block, fresh: bool, verdict: ItemReport) -> None:
        """Begins a higher epoch, or the first one."""
        if not fresh:
            ahead = block.time - self.clock.expected
            jump = ahead if math.isfinite(ahead) else None
            verdict.events.append({"event": "epoch", "epoch": block.epoch, "time": block.time, "jump": jump})
        self.epoch, self.expected = block.epoch, block.first
        self.gaps = [(0, block.first)] if block.first else []
        self.clock.reset()
