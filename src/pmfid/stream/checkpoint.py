"""Checkpoints of the engine."""

from __future__ import annotations

import json
import struct
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pmfid.errors import UsageError
from pmfid.kernel.saved import seal_parts
from pmfid.monitor.saved import read, write_states
from pmfid.stream.blocks import encode, items
from pmfid.stream.delivery import Block, split_tables
from pmfid.stream.engine import StreamEngine
from pmfid.stream.groups import Group, Pace, Prepared, Seat
from pmfid.stream.order import Positions
from pmfid.stream.outcome import Notice

_LENGTH = struct.Struct("<Q")


@dataclass(frozen=True)
class Draft:
    """A checkpoint without the checksums of its states, which take longer than a copy of the states.

    `text` is the JSON object. For each group, `states` has the pieces of its state, `seats` the bytes of its positions,
    and `held` its waiting blocks.
    """

    text: bytes
    states: list[list[bytes]]
    seats: list[bytes]
    held: list[list[Block]]

    def chunks(self) -> list[bytes | memoryview]:
        """Return the whole checkpoint, each part after its length. Any thread may call this function."""
        found: list[bytes | memoryview] = [_LENGTH.pack(len(self.text)), self.text]
        for state, seats, held in zip(self.states, self.seats, self.held, strict=True):
            for pieces in (seal_parts(state), [seats], [encode(block) for block in held]):
                found += [_LENGTH.pack(sum(map(len, pieces))), *pieces]
        return found


def draft(engine: StreamEngine) -> Draft:
    """Return the checkpoint of the engine between two ticks. Another thread completes the checkpoint while the engine
    runs.
    """
    states = [[bytes(part) for part in group.fleet.unsealed_state()] for group in engine.groups]
    packed = [write_states(group.positions, 0) for group in engine.groups]
    waits = [(group, np.flatnonzero(group.positions.waits).tolist()) for group in engine.groups]
    held = [[block for k in index for block in group.seats[k].order.held] for group, index in waits]
    groups = list[dict[str, Any]]()
    for group in engine.groups:
        seats = {str(seat.index): rare for seat in group.seats if (rare := _collect_rare(seat))}
        names, prepared = [seat.name for seat in group.seats], group.prepared
        head = {"digest": prepared.digest, "baseline": prepared.setup.baseline, "axes": names}
        groups.append({**head, "seats": seats})
    text = json.dumps(
        {
            "wall": time.time(),
            "numbered": engine.numbered,
            "unwritten": {
                sink: [[notice.axis, notice.number, notice.wall, notice.what] for notice in some]
                for sink, some in engine.unwritten().items()
                if some
            },
            "groups": groups,
        }
    ).encode()
    return Draft(text, states, packed, held)


def _collect_rare(seat: Seat) -> dict[str, Any]:
    """Return the data that only some axes have."""
    timed = None if seat.timed is None else seat.timed.save_state()
    found = {"gaps": seat.order.gaps, "told": seat.notice_counts, "timed": timed, "referred": seat.referred}
    return {name: value for name, value in found.items() if value}


@dataclass(frozen=True)
class Saved:
    """A group in a checkpoint.

    `baseline` has the nominal values and thresholds of the group. `axes` has the names of the axes, `state` the state
    of their fleet. `seats` has the bytes of their positions. `held` has the waiting blocks. `rare` maps the number of
    an axis to data that only some axes have.
    """

    digest: str
    baseline: str
    axes: tuple[str, ...]
    state: bytes
    seats: bytes
    held: bytes
    rare: Mapping[str, Any]

    def restore_group(self, prepared: Prepared, pace: Pace) -> Group:
        """Restore the group from its saved state. Raises ValueError for a state of no group with the baseline of
        `prepared`.
        """
        group = Group(prepared, pace)
        try:
            group.restore(self.axes, self.state)
            positions = read(self.seats, Positions.empty(1), 0)
            if positions.axes != len(self.axes):
                raise ValueError(f"it has the numbers of {positions.axes} axes for {len(self.axes)} axes")
            group.positions.restore(positions)
            for index, rare in self.rare.items():
                _restore_rare(group.seats[int(index)], rare)
            _restore_held(group.seats, self.held)
        except (UsageError, KeyError, TypeError, IndexError, AttributeError, struct.error, OverflowError) as error:
            raise ValueError(str(error)) from None
        return group


@dataclass(frozen=True)
class Snapshot:
    """The content of a checkpoint.

    `wall` is the time of the checkpoint in seconds since 1970. `numbered` is the last number that an axis got. `alarms`
    are the notices of all alarms. `unwritten` maps the name of a sink to alarms that the sink did not have yet.
    """

    wall: float
    numbered: int
    alarms: Sequence[Notice]
    unwritten: dict[str, list[Notice]]
    groups: list[Saved]

    def restore(self, engine: StreamEngine) -> None:
        """Restore the part of the engine outside its groups."""
        engine.numbered = self.numbered
        for notice in self.alarms:
            engine.notices.alarms.take(notice)
        engine.silence.restore(engine.notices.alarms.all())

    def axes(self) -> Iterable[str]:
        return (name for group in self.groups for name in group.axes)


def read_snapshot(body: bytes, alarms: Sequence[Notice] = ()) -> Snapshot:
    """Read the checkpoint in the bytes of `Draft.chunks`, to which the notices of alarms belong.

    Raises ValueError for other bytes.
    """
    try:
        text, *parts = _split_parts(body)
        raw = json.loads(text)
        groups = [
            Saved(one["digest"], one["baseline"], tuple(one["axes"]), state, seats, held, one["seats"])
            for one, state, seats, held in zip(raw["groups"], parts[::3], parts[1::3], parts[2::3], strict=True)
        ]
        unwritten = {sink: [Notice(*entry) for entry in some] for sink, some in raw["unwritten"].items()}
        return Snapshot(float(raw["wall"]), int(raw["numbered"]), alarms, unwritten, groups)
    except (KeyError, TypeError, AttributeError, IndexError, struct.error, RecursionError) as error:
        raise ValueError(f"this version of pmfid cannot read it as a checkpoint: {error!r}") from None


def _split_parts(body: bytes) -> list[bytes]:
    found, place = list[bytes](), 0
    while place < len(body):
        (length,) = _LENGTH.unpack_from(body, place)
        place += _LENGTH.size
        found.append(body[place : place + length])
        place += length
    if place != len(body):
        raise ValueError("the lengths of its parts do not add up to the length of the file")
    return found


def _restore_rare(seat: Seat, rare: Mapping[str, Any]) -> None:
    seat.order.gaps = [(int(a), int(b)) for a, b in rare.get("gaps", ())]
    seat.notice_counts = {str(kind): int(times) for kind, times in rare.get("told", {}).items()}
    if "referred" in rare:
        seat.referred = tuple(map(float, rare["referred"]))
    if "timed" in rare:
        seat.lines(bool(rare["timed"]["timed"])).restore(rare["timed"])


def _restore_held(seats: Sequence[Seat], held: bytes) -> None:
    known = {seat.name: seat.order for seat in seats} if held else {}
    for block in split_tables(items(held)):
        if not isinstance(block, Block):
            raise ValueError("its waiting blocks cannot be read")
        order = known[block.axis]
        order.hold(len(order.held), block)
