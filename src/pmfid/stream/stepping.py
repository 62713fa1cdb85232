"""Steps of groups over the waiting blocks."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmfid.monitor.events import Event, FleetRows
from pmfid.pipeline.monitored.run import event_object
from pmfid.stream.delivery import join_ages, join_arrays
from pmfid.stream.groups import Group, Seat
from pmfid.stream.order import SamplePiece
from pmfid.stream.outcome import EstimateRows
from pmfid.types import Counts, Flags, Floats


@dataclass(frozen=True)
class Batch:
    """Samples of k axes that are stepped together.

    `index` (k,) has the numbers of the axes, each once. `u` and `counts` are (k, n), and `ages` are (k, n) or None.
    `time`, `offset` and `turn` (k,) are as in `SamplePiece`, and `received` is (k,). `pieces` has k pieces, or none for
    blocks of a table. No sample is missing before the blocks of a table, and their samples have no times of their own.
    """

    index: NDArray[np.int64]
    u: Floats
    counts: Counts
    ages: Floats | None
    time: Floats
    offset: NDArray[np.int64]
    turn: NDArray[np.int64]
    received: Floats
    pieces: tuple[SamplePiece, ...] = ()

    @classmethod
    def stack_pieces(cls, pairs: Sequence[tuple[Seat, SamplePiece]]) -> Batch:
        pieces = tuple(piece for _, piece in pairs)
        ages = [piece.ages for piece in pieces if piece.ages is not None]
        return cls(
            np.array([seat.index for seat, _ in pairs], np.int64),
            np.stack([piece.u for piece in pieces]),
            np.stack([piece.counts for piece in pieces]),
            np.stack(ages) if len(ages) == len(pieces) else None,
            np.array([piece.time for piece in pieces], np.float64),
            np.array([piece.offset for piece in pieces], np.int64),
            np.array([piece.turn for piece in pieces], np.int64),
            np.array([piece.received for piece in pieces], np.float64),
            pieces,
        )

    @classmethod
    def join(cls, parts: Sequence[Batch]) -> Batch:
        """Join batches without pieces, each of other axes, into one batch."""
        if len(parts) == 1:
            return parts[0]
        index, u, counts, time = join_arrays(parts, "index", "u", "counts", "time")
        offset, turn, received = join_arrays(parts, "offset", "turn", "received")
        return cls(index, u, counts, join_ages([part.ages for part in parts]), time, offset, turn, received)


@dataclass
class GroupQueue:
    """The waiting samples of one group.

    Batches of tables are stepped first, so such a batch may not contain an axis with waiting samples.
    """

    group: Group
    _tables: dict[int, list[Batch]] = field(default_factory=dict, init=False)
    _queues: dict[Seat, list[SamplePiece]] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        self.busy: Flags = np.zeros(len(self.group.seats), np.bool_)

    def put(self, batch: Batch) -> None:
        self.busy[batch.index] = True
        self._tables.setdefault(batch.counts.shape[1], []).append(batch)

    def queue(self, seat: Seat, pieces: Sequence[SamplePiece]) -> None:
        """Append pieces after all waiting samples of this axis."""
        self.busy[seat.index] = True
        self._queues.setdefault(seat, []).extend(pieces)

    def batches(self) -> Iterator[Batch]:
        """Yield all waiting samples in the fewest batches, with the samples of each axis in order."""
        for parts in self._tables.values():
            yield Batch.join(parts)
        depth, left = 0, list(self._queues.items())
        while left:
            by_length: dict[int, list[tuple[Seat, SamplePiece]]] = {}
            for seat, queue in left:
                by_length.setdefault(queue[depth].counts.size, []).append((seat, queue[depth]))
            yield from map(Batch.stack_pieces, by_length.values())
            depth += 1
            left = [one for one in left if len(one[1]) > depth]


@dataclass(frozen=True)
class FoundEvent:
    """An event of an axis.

    `turn` is the number of the item that brought the event. `sample` is the number of the sample, which orders events.
    """

    turn: int
    sample: int
    seat: Seat
    what: dict[str, Any]


@dataclass
class Stepped:
    """The result of a step of a group. `counted` has increments of counters."""

    rows: list[EstimateRows] = field(default_factory=list)
    found: list[FoundEvent] = field(default_factory=list)
    counted: Counter[str] = field(default_factory=Counter)


def step(waiting: GroupQueue, followed: frozenset[str] = frozenset(), now: float = 0.0) -> Stepped:
    """Step all waiting samples of a group.

    `followed` has the names of axes whose rows are all given out. `now` is the time of the step by the clock of
    `Silence` [s].
    """
    done = Stepped()
    for batch in waiting.batches():
        waiting.group.positions.heard[batch.index] = now
        _run(waiting.group, batch, followed, done)
    return done


def _run(group: Group, batch: Batch, followed: frozenset[str], done: Stepped) -> None:
    before = [
        (row, _report_interruption(group, int(batch.index[row]), piece))
        for row, piece in enumerate(batch.pieces)
        if piece.lead
    ]
    index, n = batch.index, batch.counts.shape[1]
    start = group.numbers[index]
    rows = group.fleet.run(index, batch.u, batch.counts, batch.ages if group.fleet.further else None)
    group.numbers[index] += n
    done.counted["pmfid_samples_total"] += batch.counts.size
    done.counted["pmfid_samples_without_input_total"] += int(np.count_nonzero(~np.isfinite(batch.u)))
    events = [(row, 0, event) for row, events in before for event in events]
    for row, k, event in [*events, *rows.events]:
        done.found.append(_build_event(group, batch, row, k, int(start[row]), event))
    chosen = _choose_samples(group, index, start, n, followed)
    if chosen[0].size:
        done.rows.append(_build_rows(group, batch, start, rows, chosen))


def _report_interruption(group: Group, index: int, piece: SamplePiece) -> list[Event]:
    """Report missing samples to the monitor, even if their number is unknown, as `pmfid monitor` does."""
    missing = max(1, piece.lead)
    group.numbers[index] += missing
    if piece.lead > 0 and not piece.apart:
        return group.fleet.fill_gap(index, missing, float(piece.u[0]), int(piece.counts[0]))
    return group.fleet.skip(index, missing)


def _build_event(group: Group, batch: Batch, row: int, k: int, start: int, event: Event) -> FoundEvent:
    """Return the event with its time. `start` is the number of samples before the piece."""
    number = np.array([start + k + 1])
    shift = float(_compute_times(group, batch, np.array([row]), np.array([k]), number)[0]) - (start + k) * group.dt
    seat = group.seats[int(batch.index[row])]
    return FoundEvent(int(batch.turn[row]), start + k, seat, event_object(event, group.kindred.names, shift))


Chosen = tuple[NDArray[np.int64], NDArray[np.int64]]


def _choose_samples(
    group: Group, index: NDArray[np.int64], start: NDArray[np.int64], n: int, followed: frozenset[str]
) -> Chosen:
    """Return rows and columns of the samples that are given out.

    Rows are made for all samples of followed axes, and for each sample number that is a multiple of the stride.
    """
    first = (-start - 1) % group.stride
    own = [row for row, k in enumerate(index.tolist()) if group.seats[k].name in followed] if followed else []
    if n <= group.stride and not own:
        (rows,) = np.nonzero(first < n)
        return rows, first[rows]
    mask = (np.arange(n) - first[:, None]) % group.stride == 0
    mask[own] = True
    rows, columns = np.nonzero(mask)
    return rows, columns


def _build_rows(group: Group, batch: Batch, start: NDArray[np.int64], found: FleetRows, chosen: Chosen) -> EstimateRows:
    rows, columns = chosen
    number = start[rows] + columns + 1
    return EstimateRows(
        group.kindred,
        batch.index[rows],
        number,
        _compute_times(group, batch, rows, columns, number),
        batch.u[chosen],
        batch.counts[chosen],
        found.theta[chosen],
        found.std[chosen],
        found.innovation[chosen],
        found.status[chosen],
        found.state[chosen],
        float(batch.received.max()),
    )


def _compute_times(
    group: Group,
    batch: Batch,
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
    number: NDArray[np.int64],
) -> Floats:
    """Return the times (m,) of samples by their rows and columns.

    A sample without its own time gets one from the time of its block, or from its number.
    """
    begun = batch.time[rows]
    times = np.where(np.isnan(begun), (number - 1) * group.dt, begun + (batch.offset[rows] + columns) * group.dt)
    for k, row in enumerate(rows.tolist() if batch.pieces else ()):
        own = batch.pieces[row].times
        times[k] = times[k] if own is None else own[columns[k]]
    return times
