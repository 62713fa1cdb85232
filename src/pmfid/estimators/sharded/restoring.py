"""What a sharded fleet begins with: the last checkpoint that is whole."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmfid.durable.envelope import DamagedError, Event, set_aside
from pmfid.durable.vault import CheckpointFolder
from pmfid.errors import UsageError
from pmfid.estimators.sharded.handles import Handles
from pmfid.estimators.sharded.shard import Shard, ShardGroup
from pmfid.estimators.sharded.stored import Each, Listing, place_of, read_listing, read_shard

__all__ = ["Restored", "restored_from"]


@dataclass(frozen=True)
class Restored:
    """What a fleet began with. sequence: number of the checkpoint, 0: none; mark: stored with it; damaged: files that
    were not whole and are set aside, each with its reason; lost: handles of axes that were reset for that reason."""

    sequence: int
    mark: object
    damaged: tuple[str, ...]
    lost: NDArray[np.int64]


@dataclass(frozen=True)
class Taken:
    """Shards as a checkpoint has them. broken: numbers of the damaged ones, which are reset, and the reason."""

    listing: Listing
    shards: list[Shard]
    broken: Mapping[int, str]


@dataclass(frozen=True)
class Content:
    """All that a fleet has. size: places of a shard."""

    restored: Restored
    size: int
    shards: list[Shard]
    handles: Handles


def restored_from(vault: CheckpointFolder, groups: Mapping[bytes, ShardGroup], each: Each) -> Content | None:
    """The newest checkpoint with whole shards only. If there is none, the newest checkpoint, with its damaged shards
    reset. None: there is no checkpoint. groups: the configurations by their identity. Raises UsageError for axes of
    another configuration."""
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
    """Of the checkpoints there are, the newest first."""
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
    for number, listed in enumerate(listing.shards):
        if listed.identity not in groups:
            raise UsageError(
                f"{folder} has axes of a configuration that is none of the {len(groups)} estimators given; give all "
                "with which axes were added, as in ShardedFleet(folder, [estimator]), or choose another folder"
            )
        shards.append(Shard(groups[listed.identity], number, listing.size))

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
    """Says that a file is not whole, and sets it aside if it is there."""
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
