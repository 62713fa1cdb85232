"""Shards of a fleet: handles, states, and their files."""

from __future__ import annotations

import json
import os
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.durable import CheckpointFolder, DamagedError, crash_point, map_file, put, sync_folder
from pmfid.errors import UsageError
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.runner import Runner, SampleBlock
from pmfid.kernel.saved import OLDER, fleet_head
from pmfid.kernel.structures import whole_words

if TYPE_CHECKING:
    from pmfid._kernel64 import ManyKernel

__all__ = ["LAST", "Handles"]

#: Axes that a place has had before its last one; after the last one the place stays empty, for its number would recur.
LAST = 2**31 - 1
_BITS, _PLACE = 32, 2**32 - 1


class Handles:
    """The places of all axes. before: (places,) axes that each has had before; taken: (places,) whether it has one."""

    def __init__(self, places: int = 0) -> None:
        self.before = np.zeros(places, np.uint32)
        self.taken = np.zeros(places, np.bool_)

    def grow(self, places: int) -> None:
        """Adds places."""
        self.before = np.concatenate([self.before, np.zeros(places, np.uint32)])
        self.taken = np.concatenate([self.taken, np.zeros(places, np.bool_)])

    def take(self, places: NDArray[np.int64]) -> NDArray[np.int64]:
        """Gives free places to axes; their handles."""
        self.taken[places] = True
        return self.make_handles(places)

    def make_handles(self, places: NDArray[np.int64]) -> NDArray[np.int64]:
        """Handles of the axes that have these places."""
        return (self.before[places].astype(np.int64) << _BITS) | places

    def release(self, places: NDArray[np.int64]) -> None:
        """The axes of these places are gone: their handles are refused from now on."""
        self.taken[places] = False
        self.before[places] += 1

    def free(self, first: int, end: int) -> NDArray[np.int64]:
        """Places in a range that an axis may have."""
        own = slice(first, end)
        return first + np.flatnonzero(~self.taken[own] & (self.before[own] <= LAST))

    def places(self, handles: ArrayLike) -> NDArray[np.int64]:
        """(k,) places of axes. Raises UsageError for what is no handle, for an axis that is gone or never was, and for
        one that comes twice."""
        numbers = np.asarray(handles)
        if numbers.ndim != 1 or (numbers.size and numbers.dtype.kind not in "iu"):
            raise UsageError(
                f"handles must be those that `add` gave, (k,) integers; got {numbers.dtype} {numbers.shape}"
            )
        numbers = numbers.astype(np.int64)
        places = numbers & _PLACE
        known = (numbers >= 0) & (places < self.taken.size)
        known[known] = self.make_handles(places[known]) == numbers[known]
        known[known] = self.taken[places[known]]
        if not known.all():
            self._refuse(int(numbers[np.argmin(known)]))
        seen = np.zeros(self.taken.size, np.bool_)
        seen[places] = True
        if np.count_nonzero(seen) < places.size:
            raise UsageError("an axis comes twice in handles: its samples follow one another, in two calls")
        return places

    def _refuse(self, handle: int) -> None:
        place, before = handle & _PLACE, handle >> _BITS
        if handle >= 0 and place < self.taken.size and before < self.before[place]:
            raise UsageError(f"axis {handle} was removed; `handles()` has those that are there")
        raise UsageError(f"there is no axis {handle}; `handles()` has those that are there")


class ShardGroup:
    """A configuration. runner: that it came with; identity: distinguishes its states from others; older: in the version
    before; start: (bytes,) the state in which axes begin where nothing else is said."""

    def __init__(self, runner: Runner[RecursiveEstimator]) -> None:
        self.runner = runner
        self.start = state_of(runner)
        self.identity, self.older = identity_of(runner), identity_of(runner, OLDER)
        self._idle: SimpleQueue[ManyKernel] = SimpleQueue()
        self.fastest_way = _many(runner).fastest_way

    def borrow(self) -> ManyKernel:
        """A kernel of the configuration, which a thread has for itself until it gives it back."""
        try:
            return self._idle.get_nowait()
        except Empty:
            return _many(self.runner)

    def give_back(self, kernel: ManyKernel) -> None:
        """It is free again."""
        kernel.hold(self.start[None])
        self._idle.put(kernel)


def _many(runner: Runner[RecursiveEstimator]) -> ManyKernel:
    return runner.kernel.many(1, whole_words(runner.precision))


def state_of(runner: Runner[RecursiveEstimator]) -> NDArray[np.uint8]:
    """(bytes,) the present state, packed."""
    return np.array(_many(runner).states[0])


def identity_of(runner: Runner[RecursiveEstimator], version: int | None = None) -> bytes:
    """The prefix of a configuration's states: it identifies kernel, layout and configuration. version: an older one."""
    many = _many(runner)
    head = fleet_head(many, runner.precision)
    head["axes"] = 0
    if version is not None:
        head["version"], head["size"] = version, many.older_size(version, whole_words(runner.precision))
    return head.tobytes()[:-4]  # without the checksum


@dataclass(eq=False)
class Shard:
    """Up to `size` axes. number: its own in the fleet; rows: places that have been in use; changed: since the last
    checkpoint; side, sequence: the file that holds it in the last checkpoint, if there is one; synced: the disk is
    known to have that file."""

    group: ShardGroup
    number: int
    size: int
    rows: int = 0
    changed: bool = False
    side: int = 1
    sequence: int = 0
    synced: bool = False
    #: (size, bytes); unused rows have no memory yet.
    states: NDArray[np.uint8] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self.states = np.zeros((self.size, self.group.start.size), np.uint8)

    @property
    def used(self) -> NDArray[np.uint8]:
        """(rows, bytes) the states."""
        return self.states[: self.rows]

    def begin(self, rows: NDArray[np.int64], start: NDArray[np.uint8]) -> None:
        """Axes begin in these rows."""
        self.states[_span(rows)] = start
        self.rows = max(self.rows, int(rows.max()) + 1)
        self.changed = True


def _span(rows: NDArray[np.int64]) -> slice | NDArray[np.int64]:
    """Ascending rows, as a slice where they follow one another."""
    first, end = int(rows[0]), int(rows[-1]) + 1
    return slice(first, end) if end - first == rows.size else rows


@dataclass(frozen=True)
class ShardPiece:
    """Axes of a shard that a thread steps at once. rows: (k,) ascending; at: where they are in the tables."""

    shard: Shard
    rows: NDArray[np.int64]
    at: slice

    def run(self, work: SampleBlock, way: int) -> None:
        """Run the shard's part of a call."""
        span = _span(self.rows)
        states = self.shard.states[span]
        results = tuple(result[self.at] for result in work.results)
        kernel = self.shard.group.borrow()
        kernel.hold(states)
        kernel.run(work.u[self.at], work.counts[self.at], 0, self.rows.size, work.every, results, way)
        self.shard.group.give_back(kernel)
        if not isinstance(span, slice):  # then they are copies
            self.shard.states[span] = states


#: Points of `crash` that a checkpoint passes, before the vault's points.
POINTS = ("shard.half", "shard.written", "shard.synced", "shards.synced")
#: No fleet has more places, and no shard: what a file says is not believed beyond that.
MOST, MOST_OF_SHARD = 2**28, 2**20
#: _SHARD: number of a shard and its rows, after the identity of its configuration.
_LENGTH, _SHARD = struct.Struct("<Q"), struct.Struct("<II")
#: Bytes of a place in a list: axes before, whether there is one.
_PLACE_BYTES = 5
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
    """A checkpoint. size: places of a shard; mark: what the caller stored with the checkpoint."""

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
    if len(table) != _PLACE_BYTES * places:
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
    if (len(found.body) - len(head)) % max(listed.rows, 1):
        raise DamagedError("it has states of another number of axes")
    states = np.frombuffer(found.body, np.uint8, offset=len(head)).reshape(listed.rows, -1)
    states = _convert_states(shard, states, older=listed.identity == shard.group.older)
    if not _plausible(shard.group, states):
        raise DamagedError("these numbers are no states of its configuration, whatever their checksum says")
    shard.states[: listed.rows] = states
    shard.rows, shard.side, shard.sequence = listed.rows, listed.side, listed.sequence


def _convert_states(shard: Shard, states: NDArray[np.uint8], *, older: bool) -> NDArray[np.uint8]:
    """Raises DamagedError if a state has another number of bytes."""
    if older:
        kernel, shard.changed = shard.group.borrow(), True
        try:
            states = kernel.repack(states, OLDER, whole_words(shard.group.runner.precision))
        except ValueError as error:
            raise DamagedError(str(error)) from None
        finally:
            shard.group.give_back(kernel)
    if states.shape[1] != shard.states.shape[1]:
        raise DamagedError("it has states of another number of axes")
    return states


def _plausible(group: ShardGroup, states: NDArray[np.uint8]) -> bool:
    kernel = group.borrow()
    kernel.hold(states)
    fine = kernel.plausible()
    group.give_back(kernel)
    return fine
