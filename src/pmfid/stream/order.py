"""Blocks of one axis in the order of their numbers: what comes twice is dropped, what comes too early waits.

What is decided depends on the numbers alone, never on when something came: however the blocks of an axis change places
within the window, the samples that result are the same. A hole is believed once what waits reaches further than the
window behind its own begin, for until then a lower number may still come; then it is a gap of known length, and what
comes for it is late. A higher epoch, and the first block of all, wait as long.
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

#: In place of a number of missing samples: the sender began anew, nobody knows what lies between.
UNKNOWN_GAP = -1
#: Between two epochs more is not a gap [s], and between two numbers no drive has more [samples].
LONGEST_GAP, MOST_MISSING = 3600.0, 2**40
#: Gaps that are remembered, to tell what is late from what came twice.
GAPS = 32
#: A sender that for so long has nothing new [s] is told: no broker has as much to send again.
NOTHING_NEW = 120.0
#: What helps a sender whose numbers began anew where nobody could know it.
REMEDY = (
    "Old ones that come again do no harm. If the sender began anew, let it send a higher epoch, as the time of day in "
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
    """Blocks of one axis. dt: sample period [s]; window: samples that what comes too early waits for; place: where its
    numbers are kept, left out: on its own.

    epoch, expected: of the next sample, epoch -1 before the first; held: blocks that wait, by epoch and number;
    idle: samples in a row of which none was new, and what was expected meanwhile.
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
        """Has a block wait as number `at` of those that do."""
        self._held.insert(at, block)
        self._waiting = True

    def take(self, block: Block, received: float, turn: int, pieces: list[SamplePiece]) -> ItemReport | None:
        """Appends to `pieces` what can be stepped; None for the block that was expected."""
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
            told = self.clock.look(block.first, self.expected, block.time)
            return None if told is None else ItemReport(events=[told])
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
        """Counts samples that are of no use any more: those of a gap are late, the others came twice."""
        late = sum(max(0, min(end, b) - max(first, a)) for a, b in self.gaps)
        verdict.late += late
        verdict.duplicate += end - first - late

    def _note_repetition(self, block: Block, verdict: ItemReport) -> None:
        """A sender that sends known numbers for long is told that, then and each time that is doubled."""
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
        """Puts a block among those that wait, by epoch and number; False for one that waits there already."""
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
        """What is missing before the lowest that is held: 0 for nothing, None while it has to wait."""
        if block.epoch == self.epoch and block.first <= self.expected:
            return 0
        if self._must_wait(block):
            return None
        if block.epoch == self.epoch:
            missing = block.first - self.expected
            return missing if missing <= MOST_MISSING else UNKNOWN_GAP
        return self._count_epoch_gap(block)

    def _must_wait(self, block: Block) -> bool:
        """Whether lower numbers may still come: nothing that waits reaches further than the window behind its begin."""
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
        if (told := self.clock.look(block.first, block.end, block.time)) and not apart:
            verdict.events.append(told)
        self.expected = block.end
        u, counts = (block.u[known:], block.counts[known:]) if known else (block.u, block.counts)
        pieces.append(SamplePiece(0 if fresh else lead, apart, u, counts, block.time, known, received, turn))

    def _begin(self, block: Block, fresh: bool, verdict: ItemReport) -> None:
        """A higher epoch, or the first block of all."""
        if not fresh:
            ahead = block.time - self.clock.expected
            jump = ahead if math.isfinite(ahead) else None
            verdict.events.append({"event": "epoch", "epoch": block.epoch, "time": block.time, "jump": jump})
        self.epoch, self.expected = block.epoch, block.first
        self.gaps = [(0, block.first)] if block.first else []
        self.clock.reset()
