"""What waits for the axes of a group, stepped: pieces of the same length at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmfid.monitor.events import Event
from pmfid.monitor.rows import FleetRows
from pmfid.service.groups import Group, Seat
from pmfid.service.order import Piece
from pmfid.service.outcome import Rows
from pmfid.session.monitored.run import event_object
from pmfid.types import Floats

__all__ = ["Found", "Stepped", "step"]

Pair = tuple[Seat, Piece]


@dataclass(frozen=True)
class Found:
    """An event of an axis. turn: of the item that brought it; sample: number of the sample, by which it is ordered."""

    turn: int
    sample: int
    seat: Seat
    what: dict[str, Any]


@dataclass
class Stepped:
    """What a step of a group gave; lost: samples without an input, among all."""

    rows: list[Rows] = field(default_factory=list)
    found: list[Found] = field(default_factory=list)
    samples: int = 0
    lost: int = 0


def step(group: Group, seats: Sequence[Seat], followed: frozenset[str] = frozenset()) -> Stepped:
    """Steps all that waits for these axes of a group, and empties their queues; followed: names of axes of which every
    row is wanted."""
    done, depth, waiting = Stepped(), 0, list(seats)
    while waiting:
        by_length: dict[int, list[Pair]] = {}
        for seat in waiting:
            piece = seat.queue[depth]
            by_length.setdefault(piece.counts.size, []).append((seat, piece))
        for pairs in by_length.values():
            _run(group, pairs, followed, done)
        depth += 1
        waiting = [seat for seat in waiting if len(seat.queue) > depth]
    for seat in seats:
        seat.queue.clear()
    return done


def _run(group: Group, pairs: Sequence[Pair], followed: frozenset[str], done: Stepped) -> None:
    """One piece of each of several axes, all of the same length."""
    before = {seat.index: _interrupted(group, seat, piece) for seat, piece in pairs if piece.lead}
    index = np.array([seat.index for seat, _ in pairs], np.int64)
    u = np.stack([piece.u for _, piece in pairs])
    counts = np.stack([piece.counts for _, piece in pairs])
    start = group.numbers[index]
    rows = group.fleet.run(index, u, counts)
    group.numbers[index] += counts.shape[1]
    done.samples += counts.size
    done.lost += int(np.count_nonzero(~np.isfinite(u)))
    for row, (seat, piece) in enumerate(pairs) if before else ():
        done.found += [_found(group, seat, piece, 0, int(start[row]), event) for event in before.get(seat.index, ())]
    for row, k, event in rows.events:
        seat, piece = pairs[row]
        done.found.append(_found(group, seat, piece, k, int(start[row]), event))
    chosen = _chosen(group, pairs, start, counts.shape[1], followed)
    if chosen[0].size:
        done.rows.append(_rows(group, pairs, index, start, u, counts, rows, chosen))


def _interrupted(group: Group, seat: Seat, piece: Piece) -> list[Event]:
    """Lets the monitor know that samples are missing, or that nobody knows how many, as `pmfid monitor` does."""
    missing = max(1, piece.lead)
    group.numbers[seat.index] += missing
    if 0 < piece.lead <= group.fleet.longest and not piece.apart:
        return group.fleet.between(seat.index, missing, float(piece.u[0]), int(piece.counts[0]))
    return group.fleet.skip(seat.index, missing)


def _found(group: Group, seat: Seat, piece: Piece, k: int, start: int, event: Event) -> Found:
    """start: samples before the piece."""
    since = (start + k) * group.dt
    shift = _time(piece, k, since, group.dt) - since
    return Found(piece.turn, start + k, seat, event_object(event, group.kindred.names, shift))


def _time(piece: Piece, k: int, since: float, dt: float) -> float:
    """Of sample k of a piece; since: by the number of samples [s]."""
    if piece.times is not None:
        return float(piece.times[k])
    return since if piece.time != piece.time else piece.time + (piece.offset + k) * dt


Chosen = tuple[NDArray[np.int64], NDArray[np.int64]]


def _chosen(group: Group, pairs: Sequence[Pair], start: NDArray[np.int64], n: int, followed: frozenset[str]) -> Chosen:
    """Rows and columns of the samples that are given out: those whose number is a multiple of the stride, and all of
    the axes that someone follows."""
    first = (-start - 1) % group.stride
    own = [row for row, (seat, _) in enumerate(pairs) if seat.name in followed] if followed else []
    if n <= group.stride and not own:
        (rows,) = np.nonzero(first < n)
        return rows, first[rows]
    mask = (np.arange(n) - first[:, None]) % group.stride == 0
    mask[own] = True
    rows, columns = np.nonzero(mask)
    return rows, columns


def _rows(
    group: Group,
    pairs: Sequence[Pair],
    index: NDArray[np.int64],
    start: NDArray[np.int64],
    u: Floats,
    counts: NDArray[np.int64],
    found: FleetRows,
    chosen: Chosen,
) -> Rows:
    rows, columns = chosen
    number = start[rows] + columns + 1
    return Rows(
        group.kindred,
        index[rows],
        number,
        _times(group, pairs, rows, columns, number),
        u[chosen],
        counts[chosen],
        found.theta[chosen],
        found.std[chosen],
        found.innovation[chosen],
        found.status[chosen],
        found.state[chosen],
        max(piece.received for _, piece in pairs),
    )


def _times(
    group: Group,
    pairs: Sequence[Pair],
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
    number: NDArray[np.int64],
) -> Floats:
    """(m,) times of the samples chosen, as `_time` has them."""
    begun = np.array([piece.time for _, piece in pairs])[rows]
    offset = np.array([piece.offset for _, piece in pairs])[rows]
    times = np.where(np.isnan(begun), (number - 1) * group.dt, begun + (offset + columns) * group.dt)
    for k in np.nonzero([pairs[row][1].times is not None for row in rows])[0].tolist():
        own = pairs[rows[k]][1].times
        times[k] = times[k] if own is None else own[columns[k]]
    return times
