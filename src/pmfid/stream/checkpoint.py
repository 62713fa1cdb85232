"""Checkpoints of the engine."""

from __future__ import annotations

import json
import struct
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmfid.errors import UsageError
from pmfid.monitor.saved import seal_parts
from pmfid.stream.delivery import Block
from pmfid.stream.engine import StreamEngine
from pmfid.stream.groups import Group, Pace, Prepared, Seat
from pmfid.stream.outcome import AlarmRecord, Notice

_LENGTH = struct.Struct("<Q")
#: State of the numbers and the clock of each axis.
SEAT = np.dtype(
    [
        *(("epoch", "<i8"), ("expected", "<i8"), ("time", "<f8"), ("number", "<i8"), ("start", "<f8")),
        *(("first", "<i8"), ("seat", "<i8"), ("notices", "<i8"), ("wrong_rate", "u1"), ("wrong_period", "u1")),
    ]
)
#: Fields of SEAT that are columns of `Positions`.
_COLUMNS = tuple(name for name in SEAT.names or () if name not in ("seat", "notices"))
#: Head of each block that waits for earlier blocks. The samples of the block follow, u as float64, counts
#: as int64, and in a group with edge times the ages as float64.
HELD = np.dtype(
    [("seat", "<i8"), ("epoch", "<i8"), ("first", "<i8"), ("time", "<f8"), ("dt", "<f8"), ("samples", "<i8")]
)


@dataclass(frozen=True)
class Draft:
    """A checkpoint without the checksums of its states, which take longer than a copy of the states.

    `text` is the JSON object. `states` and `others` have the parts of each group, where the state of a group has
    several pieces.
    """

    text: bytes
    states: list[list[bytes]]
    others: list[list[bytes]]

    def chunks(self) -> list[bytes | memoryview]:
        """Return the whole checkpoint. Any thread may call this function."""
        found: list[bytes | memoryview] = [_LENGTH.pack(len(self.text)), self.text]
        for state, own in zip(self.states, self.others, strict=True):
            found += [*seal_parts(state), *own]
        return found


def snapshot(engine: StreamEngine) -> list[bytes | memoryview]:
    """Return the checkpoint of the engine between two ticks."""
    return draft(engine).chunks()


def draft(engine: StreamEngine) -> Draft:
    """Return the checkpoint of the engine between two ticks. Another thread completes the checkpoint while the engine
    runs.
    """
    states = [[bytes(part) for part in group.fleet.unsealed_state()] for group in engine.groups]
    others = [[_pack_seats(group).tobytes(), _pack_held(group)] for group in engine.groups]
    groups = list[dict[str, Any]]()
    for group, state, own in zip(engine.groups, states, others, strict=True):
        seats = {str(seat.index): rare for seat in group.seats if (rare := _collect_rare(seat))}
        for index in np.flatnonzero(group.positions.alarm).tolist():
            seats.setdefault(str(index), {})["silent"] = int(group.positions.alarm[index])
        names, parts = [seat.name for seat in group.seats], [sum(map(len, state)), *map(len, own)]
        prepared = group.prepared
        head = {"digest": prepared.digest, "baseline": prepared.setup.baseline, "axes": names}
        groups.append({**head, "seats": seats, "parts": parts})
    text = json.dumps(
        {
            "wall": time.time(),
            "numbered": engine.numbered,
            "history": engine.history,
            "alarms": [vars(alarm) for alarm in engine.notices.alarms.all()],
            "unwritten": {
                sink: [[notice.axis, notice.number, notice.wall, notice.what] for notice in some]
                for sink, some in engine.unwritten().items()
                if some
            },
            "groups": groups,
        }
    ).encode()
    return Draft(text, states, others)


def _pack_seats(group: Group) -> NDArray[np.void]:
    found = np.zeros(len(group.seats), SEAT)
    for name in _COLUMNS:
        found[name] = getattr(group.positions, name)
    found["seat"] = [seat.number for seat in group.seats]
    found["notices"] = [seat.notices for seat in group.seats]
    return found


def _collect_rare(seat: Seat) -> dict[str, Any]:
    """Return the data that only some axes have."""
    timed = None if seat.timed is None else seat.timed.save_state()
    found = {"gaps": seat.order.gaps, "told": seat.notice_counts, "timed": timed, "referred": seat.referred}
    return {name: value for name, value in found.items() if value}


def _pack_held(group: Group) -> bytes:
    waiting = np.flatnonzero(group.positions.waits).tolist()
    pairs = [(index, block) for index in waiting for block in group.seats[index].order.held]
    heads = [(index, b.epoch, b.first, b.time, b.dt, b.counts.size) for index, b in pairs]
    ages = [block.ages for _, block in pairs if group.fleet.takes_ages and block.ages is not None]
    u, counts = [block.u for _, block in pairs], [block.counts for _, block in pairs]
    return _write_held([np.array(heads, HELD)], u, counts, ages)


def _write_held(
    heads: Sequence[np.ndarray], u: Sequence[np.ndarray], counts: Sequence[np.ndarray], ages: Sequence[np.ndarray]
) -> bytes:
    """Return waiting blocks as bytes: their number, their heads, all u, all counts, and ages if there are any.

    No blocks give no bytes.
    """
    number = sum(map(len, heads))
    kinds = ((heads, HELD), (u, "<f8"), (counts, "<i8"), (ages, "<f8"))
    whole = (np.concatenate(parts).astype(kind) for parts, kind in kinds if parts)
    return b"".join([_LENGTH.pack(number), *(part.tobytes() for part in whole)]) if number else b""


def _read_held(held: bytes) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray | None]:
    """Return the heads, all u, all counts and the ages of waiting blocks. Without ages, the last is None."""
    (number,) = _LENGTH.unpack_from(held)
    heads = np.frombuffer(held, HELD, number, _LENGTH.size)
    samples, place = int(heads["samples"].sum()), _LENGTH.size + heads.nbytes
    u, counts = np.frombuffer(held, "<f8", samples, place), np.frombuffer(held, "<i8", samples, place + 8 * samples)
    place += 16 * samples
    return heads, u, counts, np.frombuffer(held, "<f8", samples, place) if len(held) > place else None


@dataclass(frozen=True)
class Saved:
    """A group in a checkpoint.

    `baseline` has the nominal values and thresholds of the group. `axes` has the names of the axes, `state` the state
    of their fleet. `seats` is an array of SEAT. `held` has the
    waiting blocks. `rare` maps the number of an axis to data that only some axes have.
    """

    digest: str
    baseline: str
    axes: tuple[str, ...]
    state: bytes
    seats: NDArray[np.void]
    held: bytes
    rare: Mapping[str, Any]

    def restore_group(self, prepared: Prepared, pace: Pace) -> Group:
        """Restore the group from its saved state. Raises ValueError for a state that no group has saved."""
        group = Group(prepared.take_baseline(self.baseline), pace)
        try:
            group.restore(self.axes, self.state)
            for name in _COLUMNS:
                getattr(group.positions, name)[:] = self.seats[name]
            numbers = self.seats["seat"].tolist(), self.seats["notices"].tolist()
            for seat, *own in zip(group.seats, *numbers, strict=True):
                seat.number, seat.notices = own
                if str(seat.index) in self.rare:
                    _restore_rare(seat, self.rare[str(seat.index)])
            _restore_held(group.seats, self.held)
        except (UsageError, KeyError, TypeError, IndexError, AttributeError, struct.error, OverflowError) as error:
            raise ValueError(str(error)) from None
        return group


@dataclass(frozen=True)
class Snapshot:
    """The content of a checkpoint.

    `wall` is the time of the checkpoint in seconds since 1970. `numbered` is the last number that an axis got.
    `unwritten` maps the name of a sink to alarms that the sink did not have yet.
    """

    wall: float
    numbered: int
    history: list[dict[str, Any]]
    alarms: list[AlarmRecord]
    unwritten: dict[str, list[Notice]]
    groups: list[Saved]

    def restore(self, engine: StreamEngine) -> None:
        """Restore the part of the engine outside its groups."""
        engine.history, engine.numbered = self.history, self.numbered
        engine.notices.restore(self.alarms)
        engine.silence.restore(self.alarms)

    def axes(self) -> Iterable[str]:
        return (name for group in self.groups for name in group.axes)


def read_snapshot(body: bytes) -> Snapshot:
    """Read the checkpoint in the bytes of `snapshot`. Raises ValueError for other bytes."""
    try:
        (length,) = _LENGTH.unpack_from(body)
        place = _LENGTH.size + length
        raw = json.loads(body[_LENGTH.size : place])
        groups = list[Saved]()
        for one in raw["groups"]:
            own = list[bytes]()
            for size in one["parts"]:
                own.append(body[place : place + size])
                place += size
            seats = np.frombuffer(own[1], SEAT)
            groups.append(
                Saved(one["digest"], one["baseline"], tuple(one["axes"]), own[0], seats, own[2], one["seats"])
            )
        if place != len(body):
            raise ValueError("the lengths of its parts do not add up to the length of the file")
        alarms = [AlarmRecord(**alarm) for alarm in raw["alarms"]]
        unwritten = {sink: [Notice(*entry) for entry in some] for sink, some in raw["unwritten"].items()}
        history = list(raw["history"])
        return Snapshot(float(raw["wall"]), int(raw["numbered"]), history, alarms, unwritten, groups)
    except (KeyError, TypeError, AttributeError, IndexError, struct.error, RecursionError) as error:
        raise ValueError(f"this version of pmfid cannot read it as a checkpoint: {error!r}") from None


def _restore_rare(seat: Seat, rare: Mapping[str, Any]) -> None:
    seat.order.gaps = [(int(a), int(b)) for a, b in rare.get("gaps", ())]
    seat.notice_counts = {str(kind): int(times) for kind, times in rare.get("told", {}).items()}
    if "referred" in rare:
        seat.referred = tuple(map(float, rare["referred"]))
    if "timed" in rare:
        seat.lines(bool(rare["timed"]["timed"])).restore(rare["timed"])
    seat.group.positions.fall_silent(seat.index, int(rare.get("silent", 0)))


def _restore_held(seats: Sequence[Seat], held: bytes) -> None:
    if not held:
        return
    (heads, u, counts, ages), start = _read_held(held), 0
    for index, epoch, first, begun, dt, n in heads.tolist():
        seat, here = seats[index], slice(start, start + n)
        own = None if ages is None else ages[here]
        seat.order.hold(len(seat.order.held), Block(seat.name, epoch, first, begun, dt, u[here], counts[here], own))
        start += n
