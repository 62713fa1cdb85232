"""States of many axes on their way: out of shards, into shards, and to and from the folder of `pmfid serve`."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pmfid.errors import UsageError, did_you_mean
from pmfid.fleet.stream.shard import StreamPlan, shard_of
from pmfid.stream.checkpoint import Saved, Snapshot, read_snapshot
from pmfid.stream.moved import body_from, body_of, join_groups
from pmfid.stream.vault import Vault

if TYPE_CHECKING:
    from pmfid.monitor.monitor import Monitor
    from pmfid.stream.groups import Pace, Prepared

__all__ = ["States"]


@dataclass(frozen=True)
class States:
    """What is known of axes of one configuration: checkpoints of its shards, or of a service."""

    snapshots: tuple[Snapshot, ...]
    digest: str

    @classmethod
    def from_bodies(cls, bodies: Mapping[int, bytes], digest: str) -> States:
        """States in the bodies of shards, by number. Raises UsageError if one of them is of another configuration."""
        try:
            found = cls(tuple(read_snapshot(bodies[number]) for number in sorted(bodies)), digest)
        except ValueError as error:
            raise UsageError(f"a state cannot be read: {error}; read it with the version that wrote it") from None
        if not found.groups:
            raise UsageError("the states are of another configuration; give the AXIS.toml that they were made with")
        return found

    @classmethod
    def from_monitors(cls, monitors: Mapping[str, Monitor], prepared: Prepared, pace: Pace) -> States:
        """States of axes with monitors of their own, or with an estimator whose state comes from firmware. Monitoring
        of a firmware axis restarts, because firmware has no monitor. Raises UsageError for monitors of another
        configuration."""
        try:
            return cls.from_bodies({0: body_from(monitors, prepared, pace)}, prepared.digest)
        except ValueError as error:
            raise UsageError(f"{error}") from None

    @classmethod
    def from_folder(cls, folder: Path, digest: str) -> States:
        """Of the last checkpoint in the folder of a service. Raises UsageError where there is none, or another service
        has it."""
        if not folder.is_dir():
            raise UsageError(f"{folder}: is no folder of states; give [service] state of a PLANT.toml")
        vault = Vault(folder)
        problems = list[dict[str, Any]]()
        found = vault.load(read_snapshot, problems.append)
        vault.close()
        if found is None:
            raise UsageError(f"{folder}: holds no checkpoint that is whole; give [service] state of a PLANT.toml")
        if not any(group.digest == digest for group in found.groups):
            raise UsageError(f"{folder}: its states are of another configuration; give the AXIS.toml that made them")
        return cls((found,), digest)

    @property
    def groups(self) -> list[Saved]:
        """Of this configuration."""
        return [group for one in self.snapshots for group in one.groups if group.digest == self.digest]

    @property
    def axes(self) -> list[str]:
        """Names, sorted."""
        return sorted(name for group in self.groups for name in group.axes)

    def only(self, names: Sequence[str]) -> list[str]:
        """These names; all where none is given. Raises UsageError for one that is not there."""
        known = self.axes
        for name in names:
            if name not in known:
                raise UsageError(f"there is no axis {name!r} in these states{did_you_mean(name, known)}")
        return list(names) or known

    def monitor(self, axis: str, prepared: Prepared, pace: Pace) -> Monitor:
        """A monitor that goes on where an axis stands. Raises UsageError for one that is not there."""
        self.only([axis])
        group = next(group for group in self.groups if axis in group.axes)
        return group.restore_group(prepared, pace).fleet.monitor(group.axes.index(axis))

    def bodies(self, plan: StreamPlan) -> dict[int, bytes]:
        """The bodies of shards that go on with these axes."""
        parts: dict[int, set[str]] = {}
        for name in self.axes:
            parts.setdefault(shard_of(name, plan.shards), set()).add(name)
        return {number: self._body(plan.prepared, plan.pace, names) for number, names in sorted(parts.items())}

    def write(self, folder: Path, prepared: Prepared, pace: Pace, names: Sequence[str] = ()) -> int:
        """The states of some axes, all where no name is given, as the checkpoint of a service with [service] state =
        that folder, which goes on with them; how many. Raises UsageError where another service has the folder."""
        chosen = self.only(names)
        vault = Vault(folder)
        try:
            vault.load(read_snapshot, lambda problem: None)  # the new snapshot follows the present ones
            vault.write([self._body(prepared, pace, set(chosen))])
        except OSError as error:
            raise UsageError(f"{folder}: {error.strerror}; make room, or choose another folder") from None
        finally:
            vault.close()
        return len(chosen)

    def _body(self, prepared: Prepared, pace: Pace, names: Collection[str]) -> bytes:
        alarms = [alarm for one in self.snapshots for alarm in one.alarms]
        numbered = max(one.numbered for one in self.snapshots)
        try:
            whole = join_groups(self.groups, prepared)
            return body_of(whole, prepared, pace, names, alarms, numbered)
        except ValueError as error:
            raise UsageError(f"the states cannot be used: {error}; give the AXIS.toml that made them") from None
