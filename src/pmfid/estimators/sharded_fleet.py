"""A fleet of shards, with checkpoints on disk."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.durable import CheckpointFolder, DamagedError, Event, set_aside
from pmfid.errors import UsageError, whole_number
from pmfid.estimators import shards as stored
from pmfid.estimators.fleet import runner_of
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.results import Tracks
from pmfid.estimators.runner import Runner, SampleBlock, threads
from pmfid.estimators.shards import (
    Each,
    Handles,
    Listing,
    Shard,
    ShardGroup,
    ShardPiece,
    identity_of,
    place_of,
    read_listing,
    read_shard,
    state_of,
)
from pmfid.estimators.tuning import TUNING

__all__ = ["Restored", "restored_from"]


@dataclass(frozen=True)
class Restored:
    """The state with which a fleet began.

    `sequence` is the number of the checkpoint; 0 means no checkpoint. `mark` was stored with the checkpoint. `damaged`
    lists incomplete files that were set aside, with reasons. `lost` (k,) are the handles of the axes that were
    therefore reset.
    """

    sequence: int
    mark: object
    damaged: tuple[str, ...]
    lost: NDArray[np.int64]


@dataclass(frozen=True)
class Taken:
    """The shards of a checkpoint. `broken` maps the numbers of damaged shards, which are reset, to the reason."""

    listing: Listing
    shards: list[Shard]
    broken: Mapping[int, str]


@dataclass(frozen=True)
class Content:
    """The whole content of a fleet. `size` is the number of places in a shard."""

    restored: Restored
    size: int
    shards: list[Shard]
    handles: Handles


def restored_from(vault: CheckpointFolder, groups: Mapping[bytes, ShardGroup], each: Each) -> Content | None:
    """Return the content of the newest complete checkpoint.

    If no checkpoint is complete, the function resets the damaged shards of the newest one. The function returns None if
    no checkpoint exists. `groups` maps identities to configurations. Raises UsageError for axes of a configuration
    outside `groups`.
    """
    reports = list[Event]()
    readable = _listings(vault, reports.append)
    for listing in readable:
        taken = _take_shards(listing, vault.folder, groups, each)
        for number, problem in taken.broken.items():
            _say(place_of(vault.folder, number, listing.shards[number].side), problem, reports.append)
        if not taken.broken:
            return _content(taken, reports)
    if readable:
        return _content(_take_shards(readable[0], vault.folder, groups, each), reports)
    lost = Restored(0, None, _sentences(reports), np.zeros(0, np.int64))
    return Content(lost, 0, [], Handles()) if reports else None


def _listings(vault: CheckpointFolder, tell: Callable[[Event], None]) -> list[Listing]:
    """Return the listings of the readable checkpoints, the newest first."""
    readable = list[Listing]()
    for found in vault.whole(tell):
        try:
            readable.append(read_listing(found.sequence, bytes(found.body)))
        except ValueError as error:
            set_aside(found.path, str(error), tell)
    return readable


def _take_shards(listing: Listing, folder: Path, groups: Mapping[bytes, ShardGroup], each: Each) -> Taken:
    broken: dict[int, str] = {}
    shards = list[Shard]()
    known = {older: one for one in groups.values() for older in one.older} | dict(groups)
    for number, listed in enumerate(listing.shards):
        if listed.identity not in known:
            raise UsageError(
                f"{folder} contains axes whose configuration matches none of the {len(groups)} given "
                "estimators; give every estimator that added axes, as in ShardedFleet(folder, [estimator]), "
                "or choose another folder"
            )
        shards.append(Shard(known[listed.identity], number, listing.size))

    def read(shard: Shard) -> None:
        listed = listing.shards[shard.number]
        try:
            read_shard(folder, listed, shard)
        except DamagedError as error:
            broken[shard.number] = str(error)
            shard.begin(np.arange(listed.rows), shard.group.start)

    each(read, shards)
    return Taken(listing, shards, dict(sorted(broken.items())))


def _say(path: Path, problem: str, tell: Callable[[Event], None]) -> None:
    """Report a damaged file, and set the file aside if it exists."""
    if path.exists():
        set_aside(path, problem, tell)
    else:
        tell({"event": "checkpoint", "damaged": path.name, "problem": problem})


def _content(taken: Taken, reports: Sequence[Mapping[str, Any]]) -> Content:
    listing, places = taken.listing, np.flatnonzero(taken.listing.handles.taken)
    lost = places[np.isin(places // max(1, listing.size), list(taken.broken))]
    restored = Restored(listing.sequence, listing.mark, _sentences(reports), listing.handles.make_handles(lost))
    return Content(restored, listing.size, taken.shards, listing.handles)


def _sentences(reports: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    return tuple(f"{one['damaged']}: {one['problem']}" for one in reports)


T = TypeVar("T")
Estimator = RecursiveEstimator | Runner[RecursiveEstimator]


class ShardedFleet:
    """Axes of any number of configurations, in shards that are stepped and saved separately.

    Each axis has the bits that its estimator alone would give. `add` gives each axis a handle, a number that no other
    axis ever gets. After `remove`, another axis may use the place in memory. Only one thread at a time may use a fleet.

    Parameters
    ----------
    folder : path, optional
        Folder of the checkpoints, for one fleet at a time. The fleet resumes from the last complete checkpoint; see
        `restored`. A fleet without a folder has no checkpoints.
    estimators : iterable of recursive estimators
        Configurations, among them those of the axes in the folder.
    shard : int
        Number of axes in a shard of a new folder.
    workers : int, optional
        Number of threads. The default is the number of processors.

    Raises
    ------
    UsageError
        A number is invalid, an estimator is not recursive, the folder cannot be used, or `estimators` omits the
        configuration of an axis in the folder.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid import RLS, Drive, Encoder, ShardedFleet
    >>> fleet = ShardedFleet()
    >>> handles = fleet.add(RLS(Drive(1.0), Encoder(1e-5), 0.001, 50.0), axes=3)
    >>> tracks = fleet.run(handles, np.zeros((3, 10)), np.zeros((3, 10), int), every=10)
    >>> fleet.axes, tracks.theta.shape
    (3, (3, 1, 3))
    """

    def __init__(
        self,
        folder: str | os.PathLike[str] | None = None,
        estimators: Iterable[Estimator] = (),
        *,
        shard: int = TUNING.sharded_fleet_shard,
        workers: int | None = None,
    ) -> None:
        self.workers = threads(workers)
        self._size = whole_number("shard", shard, 1, "it is the number of axes in a shard")
        if self._size > stored.MOST_OF_SHARD:
            raise UsageError(f"shard must be at most {stored.MOST_OF_SHARD}, got {shard}")
        self._groups: dict[bytes, ShardGroup] = {}
        self._shards: list[Shard] = []
        self._handles = Handles()
        for estimator in estimators:
            self._group(runner_of(estimator))
        self._vault = None if folder is None else CheckpointFolder(Path(folder))
        self.restored: Restored | None = None
        self._closed = False
        if self._vault is not None:
            self._begin(self._vault)

    def _begin(self, vault: CheckpointFolder) -> None:
        try:
            found = restored_from(vault, self._groups, self._each)
        except BaseException:
            vault.close()
            raise
        if found is not None:
            self.restored, self._size = found.restored, found.size or self._size
            self._shards, self._handles = found.shards, found.handles

    def __repr__(self) -> str:
        folder = None if self._vault is None else str(self._vault.folder)
        return f"ShardedFleet({folder!r}, {list(self.estimators)!r}, shard={self._size}, workers={self.workers})"

    @property
    def axes(self) -> int:
        """The number of axes."""
        return int(np.count_nonzero(self._handles.taken))

    @property
    def estimators(self) -> tuple[RecursiveEstimator, ...]:
        """The configurations, as new estimators."""
        return tuple(group.runner.estimator for group in self._groups.values())

    def handles(self, estimator: Estimator | None = None) -> NDArray[np.int64]:
        """Return the handles (k,) of all axes, or of those with an estimator's configuration. The handles are in the
        order of the places in memory, in which `run` is fastest."""
        places = np.flatnonzero(self._handles.taken)
        if estimator is not None:
            identity = identity_of(runner_of(estimator))
            own = np.array([shard.group.identity == identity for shard in self._shards], np.bool_)
            places = places[own[places // self._size]] if places.size else places
        return self._handles.make_handles(places)

    # --- addition and removal of axes
    # -----------------------------------------------------------------------------------

    def add(self, estimator: Estimator, axes: int = 1) -> NDArray[np.int64]:
        """Add axes in the present state of an estimator or `Runner`, and return their handles (axes,). Raises
        UsageError for an invalid number, an estimator that is not recursive, and more axes than the memory holds."""
        runner = runner_of(estimator)
        number = whole_number("axes", axes, 0, "it is the number of axes to add")
        if number > stored.MOST - self._size * (len(self._shards) + 1):
            raise UsageError(
                f"a fleet has at most {stored.MOST} places, so {axes} more axes do not fit; use another fleet"
            )
        group, start = self._group(runner), state_of(runner)
        try:
            places = self._places_for(group, number)
            for shard, rows in self._split_by_shard(places):
                shard.begin(rows, start)
        except MemoryError:
            raise UsageError(f"the states of {axes} axes do not fit into memory; process fewer at a time") from None
        return self._handles.take(places)

    def remove(self, handles: ArrayLike) -> None:
        """Remove these axes. The fleet refuses handles of removed axes, even after other axes have taken their places.
        The memory of removed axes stays for new axes. Raises UsageError for an unknown or repeated axis.
        """
        self._handles.release(self._handles.places(handles))

    def _group(self, runner: Runner[RecursiveEstimator]) -> ShardGroup:
        return self._groups.setdefault(identity_of(runner), ShardGroup(runner))

    def _places_for(self, group: ShardGroup, axes: int) -> NDArray[np.int64]:
        """Return free places for new axes of a configuration: first places that were in use, then new shards."""
        found, left = [np.zeros(0, np.int64)], axes
        for shard in self._shards:
            if left and shard.group is group:
                found.append(self._handles.free(shard.number * self._size, (shard.number + 1) * self._size)[:left])
                left -= found[-1].size
        first = len(self._shards)
        more = [Shard(group, first + k, self._size) for k in range(-(-left // self._size))]
        self._handles.grow(self._size * len(more))
        self._shards += more
        return np.concatenate([*found, np.arange(left) + first * self._size])

    def _split_by_shard(self, places: NDArray[np.int64]) -> list[tuple[Shard, NDArray[np.int64]]]:
        """Return the shards and rows of ascending places."""
        if not places.size:
            return []
        numbers = places // self._size
        parts = np.split(places % self._size, np.flatnonzero(np.diff(numbers)) + 1)
        return [(self._shards[number], rows) for number, rows in zip(np.unique(numbers), parts, strict=True)]

    # --- samples ------------------------------------------------------------------------------------------------------

    def run(self, handles: ArrayLike, u: ArrayLike, counts: ArrayLike, *, every: int | None = None) -> Tracks:
        """Process the next n samples of the axes `handles` (k,), which are distinct and have the same configuration.

        u is (k, n), or (n,) for the same input on all axes; counts are (k, n). `Fleet.run` describes `every` and the
        types that need no copy. The estimates are in the order of the handles. Raises UsageError for an unknown or
        repeated axis, for several configurations, and like `Fleet.run`.
        """
        places = self._handles.places(handles)
        runner = self._only(places).runner
        work = SampleBlock.from_arguments(u, counts, every, places.size, len(runner.names))
        order = None if np.all(np.diff(places) > 0) else np.argsort(places)
        if work.samples.size and order is None:
            self._run(places, work)
        elif work.samples.size:
            self._run(places[order], replace(work, u=work.u[order], counts=work.counts[order]))
        return work.tracks(runner.names, runner.units, None if order is None else np.argsort(order))

    def _only(self, places: NDArray[np.int64]) -> ShardGroup:
        """Return the only configuration of these places. Raises UsageError for several configurations."""
        numbers: list[int] = np.unique(places // self._size).tolist()
        found = {self._shards[number].group.identity for number in numbers}
        if len(found) != 1:
            raise UsageError(
                f"one call accepts axes of one configuration only, got axes of {len(found)}; run each "
                "configuration on its own, `handles(estimator)` lists its axes"
            )
        return self._shards[numbers[0]].group

    def _run(self, places: NDArray[np.int64], work: SampleBlock) -> None:
        """Process the samples of ascending places."""
        pieces, at = list[ShardPiece](), 0
        for shard, rows in self._split_by_shard(places):
            shard.changed = True
            for first in range(0, rows.size, TUNING.sharded_fleet_piece):
                part = rows[first : first + TUNING.sharded_fleet_piece]
                pieces.append(ShardPiece(shard, part, slice(at, at + part.size)))
                at += part.size
        way = pieces[0].shard.group.fastest_way
        self._each(lambda piece: piece.run(work, way), pieces, worth=work.counts.size >= TUNING.runner_small)

    def _each(self, action: Callable[[T], None], some: Sequence[T], worth: bool = True) -> None:
        """Apply an action to each element, in several threads if the work is `worth` them."""
        if self.workers == 1 or not worth:
            for one in some:
                action(one)
            return
        with ThreadPoolExecutor(self.workers) as pool:
            list(pool.map(action, some))

    def axis(self, handle: int) -> RecursiveEstimator:
        """Return a new estimator in the state of one axis. `get_state` of the estimator returns the state that firmware
        and Python share. Raises UsageError for an unknown axis."""
        shard, row = self._row(handle)
        single, kernel = shard.group.runner.estimator, shard.group.borrow()
        kernel.hold(shard.states[row : row + 1])
        kernel.load(single.runner.kernel, 0)
        shard.group.give_back(kernel)
        return single

    def gap(self, handle: int, counts: int) -> None:
        """Restart one axis after lost samples, from its next sample with these counts. Raises as `Fleet.gap`."""
        shard, row = self._row(handle)
        shard.group.runner.estimator.check_gaps()
        kernel = shard.group.borrow()
        kernel.hold(shard.states[row : row + 1])
        kernel.gap(0, counts)
        shard.group.give_back(kernel)
        shard.changed = True

    def _row(self, handle: int) -> tuple[Shard, int]:
        number = whole_number("handle", handle, None, "it is the value that `add` returned")
        if not -(2**63) <= number < 2**63:
            raise UsageError(f"no axis has the handle {number}; `handles()` lists all axes")
        place = int(self._handles.places([number])[0])
        return self._shards[place // self._size], place % self._size

    # --- checkpoints --------------------------------------------------------------------------------------------------

    def checkpoint(self, mark: object = None, *, sync: bool = True) -> int:
        """Write the shards that have changed since the last checkpoint, and return the number of written bytes.

        After the return, the disk has the whole present fleet. After an earlier kill, the disk has the last checkpoint.

        `mark` is a JSON value that is stored with the checkpoint, for example the number of samples read. If `sync` is
        True, the method waits for the disk, and the checkpoint survives a loss of power. If `sync` is False, the
        checkpoint survives only the process, and its checksum reveals damage by a loss of power. Raises OSError if the
        disk refuses the checkpoint; the last checkpoint stays valid. Raises UsageError without a folder, after `close`,
        or for a mark that JSON cannot hold.
        """
        if self._vault is None:
            raise UsageError("this fleet has no folder for checkpoints; give a folder, as in ShardedFleet('state')")
        if self._closed:
            raise UsageError(
                "this fleet was closed, and another fleet may use its folder; open it again with ShardedFleet"
            )
        try:
            json.dumps(mark)
        except (TypeError, ValueError, RecursionError) as error:
            raise UsageError(f"mark must be a value that JSON can hold, got {type(mark).__name__}: {error}") from None
        return stored.write(self._vault, self._shards, self._handles, mark, self._each, sync)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Release the folder for another fleet. The method writes nothing, and the fleet refuses `checkpoint` from now
        on. A `with` statement calls the method at its end."""
        self._closed = True
        if self._vault is not None:
            self._vault.close()
