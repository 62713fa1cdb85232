"""Checkpoints of a sharded fleet.

Every shard has two files, its sides. A checkpoint writes the shards that have changed to the sides that the last one
does not use, has them synced, and then puts a list of all sides in use into a `CheckpointFolder`, which replaces the
older of its two by a rename. Until that rename the last checkpoint is whole, after it the new one. Files are mapped to
be read, not to be written: a full disk is then an error and no signal, and no state that is half stepped reaches the
disk.
"""

from __future__ import annotations

import json
import os
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pmfid.durable.crash import crash_point
from pmfid.durable.envelope import DamagedError, map_file, put, sync_folder
from pmfid.durable.vault import CheckpointFolder
from pmfid.estimators.sharded.handles import LAST, Handles
from pmfid.estimators.sharded.shard import Shard, ShardGroup

__all__ = [
    "MOST",
    "MOST_OF_SHARD",
    "POINTS",
    "Each",
    "Listed",
    "Listing",
    "place_of",
    "read_listing",
    "read_shard",
    "write",
]

#: Points of `crash` that a checkpoint passes, before the vault's points.
POINTS = ("shard.half", "shard.written", "shard.synced", "shards.synced")
#: No fleet has more places, and no shard: what a file says is not believed beyond that.
MOST, MOST_OF_SHARD = 2**28, 2**20
#: _SHARD: number of a shard and its rows, after the identity of its configuration.
_LENGTH, _SHARD = struct.Struct("<Q"), struct.Struct("<II")
#: Bytes of a place in a list: axes before, whether there is one.
_PLACE = 5
#: Does something with all of some shards.
Each = Callable[[Callable[[Shard], None], Sequence[Shard]], None]


@dataclass(frozen=True)
class Listed:
    """A shard in a checkpoint. identity: of its configuration; the others as in `Shard`."""

    identity: bytes
    rows: int
    side: int
    sequence: int

    def __post_init__(self) -> None:
        if not (self.rows > 0 and self.side in (0, 1) and self.sequence > 0):
            raise ValueError("a shard in it is none")


@dataclass(frozen=True)
class Listing:
    """A checkpoint. size: places of a shard; mark: what whoever made it stored with it."""

    sequence: int
    size: int
    shards: list[Listed]
    handles: Handles
    mark: object


def place_of(folder: Path, number: int, side: int) -> Path:
    """The file of a side."""
    return folder / f"shard-{number:06}-{side}"


def write(
    vault: CheckpointFolder, shards: Sequence[Shard], handles: Handles, mark: object, each: Each, sync: bool
) -> int:
    """A checkpoint; the bytes of states that it wrote. sync: it shall outlive the power as well. Raises OSError, and
    TypeError for a mark that JSON does not know."""
    sequence, changed = vault.sequence + 1, [shard for shard in shards if shard.changed]
    listing = [_describe_shard(shard, sequence) for shard in shards]
    body = _body(shards[0].size if shards else 0, listing, handles, mark)
    each(lambda shard: _write_shard(vault.folder, shard, sequence, sync), changed)
    if sync:
        each(lambda shard: _sync_shard(vault.folder, shard), [one for one in shards if not (one.changed or one.synced)])
        sync_folder(vault.folder)
    crash_point("shards.synced")
    vault.write(body)
    for shard in changed:
        shard.side, shard.sequence, shard.changed, shard.synced = 1 - shard.side, sequence, False, sync
    return sum(shard.used.nbytes for shard in changed)


def _describe_shard(shard: Shard, sequence: int) -> tuple[str, int, int, int]:
    side, own = (1 - shard.side, sequence) if shard.changed else (shard.side, shard.sequence)
    return shard.group.identity.hex(), shard.rows, side, own


def _body(size: int, shards: list[tuple[str, int, int, int]], handles: Handles, mark: object) -> list[bytes]:
    text = json.dumps({"size": size, "shards": shards, "mark": mark}).encode()
    return [_LENGTH.pack(len(text)), text, handles.before.astype("<u4").tobytes(), handles.taken.tobytes()]


def _write_shard(folder: Path, shard: Shard, sequence: int, sync: bool) -> None:
    """Writes the side that the last checkpoint does not use: a failed write leaves the last checkpoint whole."""
    path = place_of(folder, shard.number, 1 - shard.side)
    head = shard.group.identity + _SHARD.pack(shard.number, shard.rows)
    number = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_BINARY", 0), 0o666)
    with os.fdopen(number, "r+b") as file:
        put(file, sequence, [head, shard.used.reshape(-1).data], "shard.half")
        file.truncate()
        file.flush()
        crash_point("shard.written")
        if sync:
            os.fsync(file.fileno())
    crash_point("shard.synced")


def _sync_shard(folder: Path, shard: Shard) -> None:
    """What an earlier checkpoint wrote without waiting for the disk, or another process did."""
    with open(place_of(folder, shard.number, shard.side), "r+b") as file:
        os.fsync(file.fileno())
    shard.synced = True


# --- and back ---------------------------------------------------------------------------------------------------------


def read_listing(sequence: int, body: bytes) -> Listing:
    """What `write` put into the vault. Raises ValueError for anything else."""
    try:
        (length,) = _LENGTH.unpack_from(body)
        raw = json.loads(body[_LENGTH.size : _LENGTH.size + length])
        size = raw["size"]
        shards = [Listed(bytes.fromhex(one[0]), *(int(number) for number in one[1:])) for one in raw["shards"]]
        places = size * len(shards)
        if not (size in range(MOST_OF_SHARD + 1) and places <= MOST and all(one.rows <= size for one in shards)):
            raise ValueError("its places are more than any fleet has")
        handles = _handles(body[_LENGTH.size + length :], places)
        for number, one in enumerate(shards):
            if handles.taken[number * size + one.rows : (number + 1) * size].any():
                raise ValueError("it has axes in rows that nobody has used")
        return Listing(sequence, size, shards, handles, raw["mark"])
    except (KeyError, TypeError, IndexError, struct.error, RecursionError, OverflowError) as error:
        raise ValueError(f"it is no checkpoint of a sharded fleet: {error!r}") from None


def _handles(table: bytes, places: int) -> Handles:
    if len(table) != _PLACE * places:
        raise ValueError("its parts do not fill it")
    handles = Handles(places)
    handles.before[:] = np.frombuffer(table, "<u4", places)
    taken = np.frombuffer(table, np.uint8, places, 4 * places)
    if np.any(taken > 1) or np.any(handles.before > LAST + 1):
        raise ValueError("its places are none")
    handles.taken[:] = taken
    return handles


def read_shard(folder: Path, listed: Listed, shard: Shard) -> None:
    """Gives a shard what it had in a checkpoint. Raises DamagedError, and leaves it as it was, where the file is not
    there or not whole, is of another shard or checkpoint, or has numbers that no sample could have made."""
    path = place_of(folder, shard.number, listed.side)
    try:
        found = map_file(path)
    except OSError as error:
        raise DamagedError(error.strerror or str(error)) from None
    head = listed.identity + _SHARD.pack(shard.number, listed.rows)
    if found.sequence != listed.sequence or bytes(found.body[: len(head)]) != head:
        raise DamagedError("it is of another checkpoint or shard")
    width = shard.states.shape[1]
    if len(found.body) != len(head) + listed.rows * width:
        raise DamagedError("it has states of another number of axes")
    states = np.frombuffer(found.body, np.uint8, offset=len(head)).reshape(listed.rows, width)
    if not _plausible(shard.group, states):
        raise DamagedError("these numbers are no states of its configuration, whatever their checksum says")
    shard.states[: listed.rows] = states
    shard.rows, shard.side, shard.sequence = listed.rows, listed.side, listed.sequence


def _plausible(group: ShardGroup, states: NDArray[np.uint8]) -> bool:
    kernel = group.borrow()
    kernel.hold(states)
    fine = kernel.plausible()
    group.give_back(kernel)
    return fine
