"""Intake of deliveries."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmfid.stream.delivery import Block, Delivery, Lines, Table, Unusable
from pmfid.stream.groups import Group, Seat
from pmfid.stream.order import ItemReport, Positions, SamplePiece, clock_runs, period_fits, rate_fits, rate_is_due
from pmfid.stream.outcome import Counters
from pmfid.stream.stepping import Batch, FoundEvent, GroupQueue
from pmfid.types import Flags

#: Groups of a table's blocks. Each group has the numbers (k,) of its axes, and -1 for axes of other groups.
Seating = list[tuple[Group, NDArray[np.int64]]]


#: Consecutive tables of one form, and the deliveries of the tables.
Tables = list[tuple[Table, Delivery]]


#: Problem of blocks of version 1 for an axis with edge times.
WITHOUT_AGES = (
    "{!r} has [encoder] edge_age, but its blocks contain no ages of edges; send blocks of "
    "version 2 with ages, or remove edge_age"
)


def seat_names(names: Sequence[str], seats: Mapping[str, Seat]) -> Seating | None:
    """Return the seating of blocks of these axes, or None if an axis occurs twice."""
    if len(set(names)) < len(names):
        return None
    found = [seats.get(name) for name in names]
    groups = {id(seat.group): seat.group for seat in found if seat is not None}
    return [
        (group, np.array([seat.index if seat is not None and seat.group is group else -1 for seat in found], np.int64))
        for group in groups.values()
    ]


@dataclass
class Ordered:
    """The ordered content of some deliveries.

    The `rounds` are stepped one after the other. `found` has events for notices.
    """

    rounds: list[GroupQueue] = field(default_factory=list)
    found: list[FoundEvent] = field(default_factory=list)
    _last: dict[int, GroupQueue] = field(default_factory=dict)

    def put(self, group: Group, batch: Batch) -> None:
        """Append blocks of a table, each of another axis."""
        waiting = self.get_waiting(group)
        if waiting.busy[batch.index].any():  # samples of an axis wait already
            del self._last[id(group)]
            waiting = self.get_waiting(group)
        waiting.put(batch)

    def get_waiting(self, group: Group) -> GroupQueue:
        """Return the last queue of a group."""
        if id(group) not in self._last:
            self._last[id(group)] = GroupQueue(group)
            self.rounds.append(self._last[id(group)])
        return self._last[id(group)]


@dataclass
class Intake:
    """The intake, which assigns items to axes. `tell` receives notices on a source or an axis. `number_source` returns
    the number of a source, for `Positions`.

    `awaited` has the names of axes that will get a seat. Until then, their items are dropped and counted.
    """

    counters: Counters
    tell: Callable[[dict[str, Any], str], None]
    number_source: Callable[[str], int] = lambda source: -1
    seats: dict[str, Seat] = field(default_factory=dict, init=False)
    awaited: frozenset[str] = field(default=frozenset(), init=False)
    _unusable: set[tuple[str, str]] = field(default_factory=set, init=False)
    _turn: int = field(default=0, init=False)

    def take(self, deliveries: Iterable[Delivery]) -> Ordered:
        ordered, tables = Ordered(), Tables()
        for delivery in deliveries:
            for item in delivery.items:
                if not isinstance(item, Table) or (tables and tables[0][0].form != item.form):
                    self._settle(tables, ordered)
                    tables = []
                if isinstance(item, Table):
                    tables.append((item, delivery))
                else:
                    self._turn += 1
                    self._single(item, delivery, self._turn, ordered)
        self._settle(tables, ordered)
        return ordered

    # --- tables -------------------------------------------------------------------------------------------------------

    def _settle(self, tables: Tables, ordered: Ordered) -> None:
        """Order consecutive tables, all of them together if no axis occurs twice."""
        if not tables:
            return
        seating = seat_names([name for table, _ in tables for name in table.axes], self.seats)
        if seating is not None or len(tables) == 1:
            self._table(tables, seating or [], ordered)
            return
        for one in tables:
            self._settle([one], ordered)

    def _table(self, tables: Tables, seating: Seating, ordered: Ordered) -> None:
        """Take the expected blocks together, and the other blocks one by one. Each block counts as one item."""
        table = Table.join([table for table, _ in tables])
        size = len(table.axes)
        turns = np.arange(self._turn + 1, self._turn + 1 + size)
        sizes = [len(one.axes) for one, _ in tables]
        received = np.repeat([one.received for _, one in tables], sizes)
        sources = np.repeat([self.number_source(one.source) for _, one in tables], sizes)
        self._turn += size
        rest = np.ones(size, np.bool_)
        for group, index in seating:
            if group.fleet.further == "ages" and table.ages is None:
                continue  # each block is refused
            taken = take_expected(group.positions, group.dt, index, table)
            if taken.any():
                rows = slice(None) if taken.all() else np.flatnonzero(taken)
                group.positions.source[index[rows]] = sources[rows]
                at, offset = index[rows], np.zeros(np.count_nonzero(taken), np.int64)
                u, counts, time = table.u[rows], table.counts[rows], table.time[rows]
                fleet, ages = group.fleet, table.ages
                ages = ages[rows] if ages is not None and fleet.further else None
                ordered.put(group, Batch(at, u, counts, ages, time, offset, turns[rows], received[rows]))
                rest &= ~taken
        left = np.flatnonzero(rest).tolist()
        deliveries = [delivery for one, delivery in tables for _ in one.axes] if left else []
        for row in left:
            self._single(table.block(row), deliveries[row], int(turns[row]), ordered)

    # --- one by one ---------------------------------------------------------------------------------------------------

    def _single(self, item: Block | Lines | Unusable, delivery: Delivery, turn: int, ordered: Ordered) -> None:
        try:
            self._one(item, delivery, turn, ordered)
        except (TypeError, ValueError, ArithmeticError) as error:  # the source would repeat the item for ever
            problem = f"{type(error).__name__}: {error}; this delivery is skipped"
            self._refuse(delivery.source, Unusable("error", problem))

    def _one(self, item: Block | Lines | Unusable, delivery: Delivery, turn: int, ordered: Ordered) -> None:
        if isinstance(item, Unusable):
            self._refuse(delivery.source, item)
            return
        seat = self.seats.get(item.axis)
        if seat is None and item.axis in self.awaited:
            self.counters.add("pmfid_unusable_total", source=delivery.source, reason="calibrating")
            return
        if seat is None:
            problem = f"the plant has no axis {item.axis!r}; add it to PLANT.toml, or correct the name in the sender"
            self._refuse(delivery.source, Unusable("axis", problem, item.axis))
            return
        seat.group.positions.source[seat.index] = self.number_source(delivery.source)
        pieces = list[SamplePiece]()
        try:
            if isinstance(item, Block):
                if seat.group.fleet.further == "ages" and item.ages is None:
                    self._refuse(delivery.source, Unusable("ages", WITHOUT_AGES.format(item.axis), item.axis))
                    return
                verdict = seat.order.take(item, delivery.received, turn, pieces)
            else:
                timed = any(line.time == line.time for line in item.lines)
                lines = seat.lines(timed or bool(seat.group.prepared.axis.record.time))
                verdict = lines.take(item, delivery.received, turn, pieces)
        finally:  # an order gives out each piece only once
            if pieces:
                ordered.get_waiting(seat.group).queue(seat, pieces)
        if verdict is not None:
            self._judge(seat, verdict, turn, ordered.found)

    def _refuse(self, source: str, item: Unusable) -> None:
        self.counters.add("pmfid_unusable_total", source=source, reason=item.reason)
        if (source, item.reason) in self._unusable:
            return
        self._unusable.add((source, item.reason))
        self.tell({"event": "unusable", "source": source, "reason": item.reason, "problem": item.problem}, "")

    def _judge(self, seat: Seat, verdict: ItemReport, turn: int, found: list[FoundEvent]) -> None:
        """Count dropped samples and lines, and keep events for their turn."""
        group = seat.group.kindred.config
        for reason, number in verdict.dropped.items():
            self.counters.add("pmfid_samples_dropped_total", number, reason=reason, group=group)
        for kind, number in verdict.lines.items():
            self.counters.add("pmfid_lines_dropped_total", number, reason=kind, group=group)
        late = verdict.dropped["late"]
        if verdict.again or (late and seat.may_tell("late")):
            problem = (
                verdict.stale or f"{late} samples were discarded, because later samples had already been processed"
            )
            self.tell({"event": "late", "samples": late, "problem": problem}, seat.name)
        for what in verdict.events:
            self.counters.add("pmfid_events_total", event=str(what["event"]), group=group)
            if what["event"] == "gap":
                self.counters.add("pmfid_samples_missing_total", float(what["missing"]), group=group)  # type: ignore[arg-type]
            if seat.may_tell(str(what["event"])):
                found.append(FoundEvent(turn, -1, seat, what))


# --- expected blocks of many axes: taken at once ----------------------------------------------------------------------


def take_expected(positions: Positions, dt: float, index: NDArray[np.int64], table: Table) -> Flags:
    """Take the blocks of a table that are expected next and cause no notice.

    The function is `Order.take` for many axes. `index` (k,) has the axes, each at most once, and -1 for no axis.
    Returns whether each block was taken (k,).
    """
    n, known, first = table.counts.shape[1], positions, table.first
    samples, time = first - known.first[index], table.time - known.start[index]
    off = table.time - known.time[index] - (first - known.number[index]) * dt
    with np.errstate(invalid="ignore", divide="ignore"):
        measured = rate_is_due(samples, time)
        at_rate = np.logical_not(measured) | (rate_fits(time / (samples * dt)) & ~known.wrong_rate[index])
        quiet = np.isnan(table.time) | (clock_runs(off) & at_rate)
    next_one = (table.epoch == known.epoch[index]) & (first == known.expected[index]) & ~known.waits[index]
    taken: Flags = np.logical_and((index >= 0) & next_one & quiet, period_fits(table.dt, dt))
    known.expected[index[taken]] = table.first[taken] + n
    timed = taken & ~np.isnan(table.time)
    known.time[index[timed]], known.number[index[timed]] = table.time[timed] + n * dt, table.first[timed] + n
    renewed = timed & measured
    known.start[index[renewed]], known.first[index[renewed]] = table.time[renewed], table.first[renewed]
    return taken
