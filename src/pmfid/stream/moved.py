"""Joins and splits the axes of checkpoints, which then go on in another process."""

from __future__ import annotations

import struct
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from pmfid.errors import UsageError
from pmfid.monitor.fleet import MonitorFleet
from pmfid.monitor.monitor import Monitor
from pmfid.stream.alarms import AlarmRecord
from pmfid.stream.checkpoint import HELD, Saved, Snapshot, snapshot
from pmfid.stream.counters import Counters
from pmfid.stream.engine import StreamEngine
from pmfid.stream.groups import Group, Pace, Prepared

__all__ = ["body_from", "body_of", "join_groups", "keep_axes"]

_LENGTH = struct.Struct("<Q")


def join_groups(groups: Sequence[Saved], prepared: Prepared) -> Saved:
    """One group of the axes of several groups, in order. Raises ValueError for states of another configuration, or for
    an axis that occurs twice."""
    axes = tuple(name for group in groups for name in group.axes)
    if len(set(axes)) < len(axes):
        raise ValueError("an axis comes twice")
    fleet = MonitorFleet(prepared.setup.monitor, 0)
    starts = [0, *np.cumsum([len(group.axes) for group in groups]).tolist()]
    try:
        for group in groups:
            fleet.join(group.state)
    except UsageError as error:
        raise ValueError(str(error)) from None
    pairs = list(zip(groups, starts, strict=False))
    rare = {str(int(k) + start): own for group, start in pairs for k, own in group.rare.items()}
    seats = np.concatenate([group.seats for group in groups])
    return Saved(groups[0].digest, axes, fleet.get_state(), seats, _join_held(groups, starts), rare)


def _join_held(groups: Sequence[Saved], starts: Sequence[int]) -> bytes:
    """The waiting blocks of all groups, with the new numbers of their axes."""
    parts: list[tuple[bytes, bytes, bytes]] = []
    number = 0
    for group, start in zip(groups, starts, strict=False):
        if not group.held:
            continue
        (own,) = _LENGTH.unpack_from(group.held)
        heads = np.frombuffer(group.held, HELD, own, _LENGTH.size).copy()
        heads["seat"] += start
        u_at = _LENGTH.size + heads.nbytes
        counts_at = u_at + 8 * int(heads["samples"].sum())
        parts.append((heads.tobytes(), group.held[u_at:counts_at], group.held[counts_at:]))
        number += own
    return b"".join([_LENGTH.pack(number), *(part[k] for k in range(3) for part in parts)]) if parts else b""


def keep_axes(group: Group, names: Collection[str]) -> Group:
    """Removes all other axes from the group, and returns the group."""
    group.remove([seat.index for seat in group.seats if seat.name not in names])
    return group


def body_of(
    saved: Saved, prepared: Prepared, pace: Pace, names: Collection[str], alarms: Sequence[AlarmRecord], numbered: int
) -> bytes:
    """The body of a checkpoint of some axes of a group, and of their alarms. Raises ValueError for a state that no
    group has saved."""
    engine = StreamEngine(Counters())
    here = [alarm for alarm in alarms if alarm.axis in names]
    Snapshot(0.0, numbered, {}, [], here, {}, []).restore(engine)
    engine.set_groups([keep_axes(saved.restore_group(prepared, pace), names)])
    return b"".join(snapshot(engine))


def body_from(monitors: Mapping[str, Monitor], prepared: Prepared, pace: Pace) -> bytes:
    """The body of a checkpoint in which axes go on with these monitors. The first number to arrive for an axis,
    whatever it is, follows its last sample. Raises ValueError for monitors of another configuration."""
    fleet, group = MonitorFleet(prepared.setup.monitor, 0), Group(prepared, pace)
    try:
        for monitor in monitors.values():
            fleet.join(monitor.get_state())
        group.restore(list(monitors), fleet.get_state())
    except UsageError as error:
        raise ValueError(str(error)) from None
    engine = StreamEngine(Counters())
    engine.set_groups([group])
    return b"".join(snapshot(engine))
