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

#: Largest number of previous axes of a place. A place with as many previous axes stays empty, because its handle would
#: recur.
LAST = 2**31 - 1
_BITS, _PLACE = 32, 2**32 - 1


class Handles:
    """The places of all axes. `before` (places,) is the number of previous axes of each place, and `taken` (places,)
    marks the places in use."""

    def __init__(self, places: int = 0) -> None:
        self.before = np.zeros(places, np.uint32)
        self.taken = np.zeros(places, np.bool_)

    def grow(self, places: int) -> None:
        """Add places."""
        self.before = np.concatenate([self.before, np.zeros(places, np.uint32)])
        self.taken = np.concatenate([self.taken, np.zeros(places, np.bool_)])

    def take(self, places: NDArray[np.int64]) -> NDArray[np.int64]:
        """Mark free places as taken and return the handles of their new axes."""
        self.taken[places] = True
        return self.make_handles(places)

    def make_handles(self, places: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the handles of the axes at these places."""
        return (self.before[places].astype(np.int64) << _BITS) | places

    def release(self, places: NDArray[np.int64]) -> None:
        """Free these places. Their axes' handles are refused from now on."""
        self.taken[places] = False
        self.before[places] += 1

    def free(self, first: int, end: int) -> NDArray[np.int64]:
        """Return the usable free places of a range."""
        own = slice(first, end)
        return first + np.flatnonzero(~self.taken[own] & (self.before[own] <= LAST))

    def places(self, handles: ArrayLike) -> NDArray[np.int64]:
        """Return the places (k,) of axes. Raises UsageError for invalid, removed and repeated handles."""
        numbers = np.asarray(handles)
        if numbers.ndim != 1 or (numbers.size and numbers.dtype.kind not in "iu"):
            raise UsageError(
                f"handles must be the integers that `add` returned, (k,); got {numbers.dtype} {numbers.shape}"
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
            raise UsageError("handles contains an axis twice; pass later samples of an axis in a second call")
        return places

    def _refuse(self, handle: int) -> None:
        place, before = handle & _PLACE, handle >> _BITS
        if handle >= 0 and place < self.taken.size and before < self.before[place]:
            raise UsageError(f"axis {handle} was removed; `handles()` lists all axes")
        raise UsageError(f"no axis has the handle {handle}; `handles()` lists all axes")


class ShardGroup:
    """One configuration of axes.

    `runner` is the runner from which the configuration came. `identity` distinguishes its states from those of other
    configurations, and `older` has the version for each identity in an earlier version. `start` (bytes,) is the default
    state of new axes.
    """

    def __init__(self, runner: Runner[RecursiveEstimator]) -> None:
        self.runner = runner
        self.start = state_of(runner)
        self.identity = identity_of(runner)
        self.older = {identity_of(runner, version): version for version in OLDER}
        self._idle: SimpleQueue[ManyKernel] = SimpleQueue()
        self.fastest_way = _many(runner).fastest_way

    def borrow(self) -> ManyKernel:
        """Return a kernel of the configuration, which one thread owns until `give_back`."""
        try:
            return self._idle.get_nowait()
        except Empty:
            return _many(self.runner)

    def give_back(self, kernel: ManyKernel) -> None:
        """Return a borrowed kernel to the group."""
        kernel.hold(self.start[None])
        self._idle.put(kernel)


def _many(runner: Runner[RecursiveEstimator]) -> ManyKernel:
    return runner.kernel.many(1, whole_words(runner.precision))


def state_of(runner: Runner[RecursiveEstimator]) -> NDArray[np.uint8]:
    """Return the present state (bytes,), packed."""
    return np.array(_many(runner).states[0])


def identity_of(runner: Runner[RecursiveEstimator], version: int | None = None) -> bytes:
    """Return the prefix of a configuration's states, which identifies kernel, layout and configuration. `version`
    selects an older version."""
    many = _many(runner)
    head = fleet_head(many, runner.precision)
    head["axes"] = 0
    if version is not None:
        head["version"], head["size"] = version, many.older_size(version, whole_words(runner.precision))
    return head.tobytes()[:-4]  # removes the checksum


@dataclass(eq=False)
class Shard:
    """Up to `size` axes of one configuration.

    `number` identifies the shard in the fleet, and `rows` counts the places that have been in use. `changed` is True if
    the shard differs from the last checkpoint. `side` and `sequence` identify the file of the shard in the last
    checkpoint. `synced` is True if the disk surely has that file.
    """

    group: ShardGroup
    number: int
    size: int
    rows: int = 0
    changed: bool = False
    side: int = 1
    sequence: int = 0
    synced: bool = False
    #: states (size, bytes); unused rows have no memory yet
    states: NDArray[np.uint8] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self.states = np.zeros((self.size, self.group.start.size), np.uint8)

    @property
    def used(self) -> NDArray[np.uint8]:
        """The states (rows, bytes) of the used rows."""
        return self.states[: self.rows]

    def begin(self, rows: NDArray[np.int64], start: NDArray[np.uint8]) -> None:
        """Put axes in the state `start` into these rows."""
        self.states[_span(rows)] = start
        self.rows = max(self.rows, int(rows.max()) + 1)
        self.changed = True


def _span(rows: NDArray[np.int64]) -> slice | NDArray[np.int64]:
    """Return ascending rows, as a slice if they are consecutive."""
    first, end = int(rows[0]), int(rows[-1]) + 1
    return slice(first, end) if end - first == rows.size else rows


@dataclass(frozen=True)
class ShardPiece:
    """Axes of a shard that a thread steps at once. `rows` (k,) are ascending, and `at` is the place of the rows in the
    tables.
    """

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
        if not isinstance(span, slice):  # other indices made copies
            self.shard.states[span] = states


#: Points of `crash` in a checkpoint before those of the vault.
POINTS = ("shard.half", "shard.written", "shard.synced", "shards.synced")
#: Largest numbers of places in a fleet and in a shard. A file with larger numbers is damaged.
MOST, MOST_OF_SHARD = 2**28, 2**20
#: _SHARD packs the number of a shard and its rows, and follows the configuration's identity.
_LENGTH, _SHARD = struct.Struct("<Q"), struct.Struct("<II")
#: Bytes of a place in a list: the number of previous axes, and a flag for the present axis.
_PLACE_BYTES = 5
#: Function that applies an action to each of several shards.
Each = Callable[[Callable[[Shard], None], Sequence[Shard]], None]


@dataclass(frozen=True)
class Listed:
    """A shard in a checkpoint. `identity` is that of the configuration; `Shard` describes the other fields."""

    identity: bytes
    rows: int
    side: int
    sequence: int

    def __post_init__(self) -> None:
        if not (self.rows > 0 and self.side in (0, 1) and self.sequence > 0):
            raise ValueError("one of its shards is damaged")


@dataclass(frozen=True)
class Listing:
    """The content list of a checkpoint. `size` is the number of places in a shard, and `mark` is the caller's value."""

    sequence: int
    size: int
    shards: list[Listed]
    handles: Handles
    mark: object


def place_of(folder: Path, number: int, side: int) -> Path:
    """Return the path of one side of a shard."""
    return folder / f"shard-{number:06}-{side}"


def write(
    vault: CheckpointFolder, shards: Sequence[Shard], handles: Handles, mark: object, each: Each, sync: bool
) -> int:
    """Write a checkpoint and return the number of written bytes of states. If `sync` is True, the checkpoint survives a
    loss of power. Raises OSError, and TypeError for a mark that JSON cannot hold."""
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
    """Write the side that the last checkpoint does not use, so that a failed write leaves that checkpoint complete."""
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
    """Force a shard's file to the disk if an earlier checkpoint or another process did not wait for the disk."""
    with open(place_of(folder, shard.number, shard.side), "r+b") as file:
        os.fsync(file.fileno())
    shard.synced = True


# --- reading --------------------------------------------------------------------------------------------------------


def read_listing(sequence: int, body: bytes) -> Listing:
    """Return the listing that `write` put into the vault. Raises ValueError for other content."""
    try:
        (length,) = _LENGTH.unpack_from(body)
        raw = json.loads(body[_LENGTH.size : _LENGTH.size + length])
        size = raw["size"]
        shards = [Listed(bytes.fromhex(one[0]), *(int(number) for number in one[1:])) for one in raw["shards"]]
        places = size * len(shards)
        if not (size in range(MOST_OF_SHARD + 1) and places <= MOST and all(one.rows <= size for one in shards)):
            raise ValueError("it has more places than any fleet can have")
        handles = _handles(body[_LENGTH.size + length :], places)
        for number, one in enumerate(shards):
            if handles.taken[number * size + one.rows : (number + 1) * size].any():
                raise ValueError("rows that are marked as unused contain axes")
        return Listing(sequence, size, shards, handles, raw["mark"])
    except (KeyError, TypeError, IndexError, struct.error, RecursionError, OverflowError) as error:
        raise ValueError(f"it is not a checkpoint of a sharded fleet: {error!r}") from None


def _handles(table: bytes, places: int) -> Handles:
    if len(table) != _PLACE_BYTES * places:
        raise ValueError("the lengths of its parts do not add up to the length of the file")
    handles = Handles(places)
    handles.before[:] = np.frombuffer(table, "<u4", places)
    taken = np.frombuffer(table, np.uint8, places, 4 * places)
    if np.any(taken > 1) or np.any(handles.before > LAST + 1):
        raise ValueError("its places are not valid")
    handles.taken[:] = taken
    return handles


def read_shard(folder: Path, listed: Listed, shard: Shard) -> None:
    """Load a shard's content from a checkpoint.

    Raises DamagedError, without a change of the shard, if the file is missing, incomplete or from another shard or
    checkpoint. Numbers that no sample could have made raise the error, too.
    """
    path = place_of(folder, shard.number, listed.side)
    try:
        found = map_file(path)
    except OSError as error:
        raise DamagedError(error.strerror or str(error)) from None
    head = listed.identity + _SHARD.pack(shard.number, listed.rows)
    if found.sequence != listed.sequence or bytes(found.body[: len(head)]) != head:
        raise DamagedError("it belongs to another checkpoint or shard")
    if (len(found.body) - len(head)) % max(listed.rows, 1):
        raise DamagedError("it has states for a different number of axes")
    states = np.frombuffer(found.body, np.uint8, offset=len(head)).reshape(listed.rows, -1)
    states = _convert_states(shard, states, shard.group.older.get(listed.identity))
    if not _plausible(shard.group, states):
        raise DamagedError("these numbers cannot be states of its configuration, although their checksum is right")
    shard.states[: listed.rows] = states
    shard.rows, shard.side, shard.sequence = listed.rows, listed.side, listed.sequence


def _convert_states(shard: Shard, states: NDArray[np.uint8], older: int | None) -> NDArray[np.uint8]:
    """Return the states of an earlier version, if any, in the present version. Raises DamagedError if a state has an
    unexpected number of bytes."""
    if older is not None:
        kernel, shard.changed = shard.group.borrow(), True
        try:
            states = kernel.repack(states, older, whole_words(shard.group.runner.precision))
        except ValueError as error:
            raise DamagedError(str(error)) from None
        finally:
            shard.group.give_back(kernel)
    if states.shape[1] != shard.states.shape[1]:
        raise DamagedError("it has states for a different number of axes")
    return states


def _plausible(group: ShardGroup, states: NDArray[np.uint8]) -> bool:
    kernel = group.borrow()
    kernel.hold(states)
    fine = kernel.plausible()
    group.give_back(kernel)
    return fine
