"""The assignment of axes to groups at the start, after a restart, and after a change of PLANT.toml."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from threading import Event
from typing import TypeVar

from pmfid.config.axis import Axis, load_axis
from pmfid.errors import PmfidError
from pmfid.estimators.fleet import processors
from pmfid.service.context import Tell
from pmfid.stream.engine import StreamEngine
from pmfid.stream.groups import Group, Pace, Prepared, prepare

Made = TypeVar("Made")


@dataclass
class Configurations:
    """The configurations of a plant, each calibrated once. `baselines` are those of `prepare`.

    A configuration that fails is reported, and only its own axes are lost.
    """

    tell: Tell
    baselines: Mapping[str, str] = field(default_factory=dict)
    _known: dict[Path, tuple[str, Prepared]] = field(default_factory=dict, init=False)
    _stamps: dict[Path, str] = field(default_factory=dict, init=False)
    _stopped: Event = field(default_factory=Event, init=False)
    _pool: ThreadPoolExecutor = field(
        default_factory=lambda: ThreadPoolExecutor(processors(), "calibration"), init=False
    )

    def read(self, axes: Mapping[str, Path]) -> dict[Path, Axis]:
        """Return the content of each usable AXIS.toml.

        Raises PmfidError or OSError if the only file has never been usable.
        """
        paths = dict.fromkeys(axes.values())
        found = {path: self._try(path, partial(self._read, path), only=len(paths) == 1) for path in paths}
        return {path: axis for path, axis in found.items() if axis is not None}

    def _read(self, path: Path) -> Axis:
        axis = load_axis(path)
        self._stamps[path] = _stamp(path, axis)
        return axis

    def calibrate(self, configs: Mapping[Path, Axis]) -> Iterator[tuple[Path, Prepared | None]]:
        """Yield the calibration of each configuration that was read as soon as it is ready, or None if it fails.

        Several configurations are calibrated by threads on all cores, and equal ones once. Raises PmfidError or OSError
        if the only configuration has never been usable.
        """
        stamps = {path: self._stamps[path] for path in configs}
        due = [path for path in configs if path not in self._known or self._known[path][0] != stamps[path]]
        yield from ((path, self._known[path][1]) for path in configs if path not in due)
        equal: dict[str, list[Path]] = {}
        for path in due:
            equal.setdefault(stamps[path], []).append(path)
        if self._stopped.is_set():
            return
        futures = {
            self._pool.submit(prepare, paths[0], configs[paths[0]], self.baselines): paths for paths in equal.values()
        }
        for future in as_completed(futures):
            if self._stopped.is_set():
                return
            first, stamp = futures[future][0], stamps[futures[future][0]]
            prepared = self._try(first, future.result, only=len(configs) == 1)
            for each in futures[future]:
                yield each, prepared and self._keep(replace(prepared, path=each), stamp)

    def _keep(self, prepared: Prepared, stamp: str) -> Prepared:
        """Keep and report a calibrated configuration."""
        self._known[prepared.path] = stamp, prepared
        self.tell({"event": "configuration", "config": prepared.path.name, "notes": list(prepared.setup.notes)})
        return prepared

    def load_all(self, axes: Mapping[str, Path]) -> dict[str, Prepared]:
        """Return the configuration of each axis that has a usable one, by the axis' name.

        If the present configuration of an axis fails, the previous one holds.
        """
        loaded = dict(self.calibrate(self.read(axes)))
        earlier = {path: prepared for path, (_, prepared) in self._known.items()}
        found = {name: loaded.get(path) or earlier.get(path) for name, path in axes.items()}
        return {name: prepared for name, prepared in found.items() if prepared is not None}

    def stop(self) -> None:
        """Begin no further calibration."""
        self._stopped.set()
        self._pool.shutdown(wait=False, cancel_futures=True)

    def _try(self, path: Path, make: Callable[[], Made], only: bool) -> Made | None:
        """Return the result of `make`, or None after an error that has been reported."""
        try:
            return make()
        except (PmfidError, OSError) as error:
            before = path in self._known
            if only and not before:
                raise
            left = (
                "the axes of this file keep their previous configuration"
                if before
                else "the service does not watch the axes of this file"
            )
            self.tell({"event": "configuration", "config": path.name, "problem": f"{error}; {left}"})
            return None


def _stamp(path: Path, axis: Axis) -> str:
    """Return a text that changes with the configuration and with its reference record."""
    reference = axis.monitor.reference
    status = None if reference is None else (path.parent / reference).stat()
    state = status and (status.st_size, status.st_mtime_ns, status.st_ino)
    return f"{axis.model_dump_json(warnings=False)} {state}"


def arrange_groups(groups: Iterable[Group], axes: Mapping[str, Prepared], pace: Pace) -> tuple[list[Group], list[str]]:
    """Return the groups for these axes, and the names of axes without a history.

    An axis in a group with the same configuration stays in this group with its state.
    """
    present = {group.prepared.digest: group for group in groups}
    wanted: dict[str, tuple[Prepared, list[str]]] = {}
    for name, prepared in axes.items():
        wanted.setdefault(prepared.digest, (prepared, []))[1].append(name)
    made, fresh = list[Group](), list[str]()
    for digest, (prepared, names) in wanted.items():
        group = present.get(digest) or Group(prepared, pace)
        here, kept = set(names), {seat.name for seat in group.seats}
        group.remove([seat.index for seat in group.seats if seat.name not in here])
        new = [name for name in names if name not in kept]
        group.add(new)
        made.append(group)
        fresh += new
    return made, fresh


def tell_configurations(engine: StreamEngine, reported: Container[str] = ()) -> None:
    """Report the present configurations, except those `reported`, to the sinks.

    The history of the service shows a configuration that differs from the last one.
    """
    for group in engine.groups:
        if (digest := group.prepared.digest) not in reported:
            nominal = dict(zip(group.kindred.names, group.kindred.nominal.tolist(), strict=True))
            content = {"config": group.kindred.config, "digest": digest, "nominal": nominal}
            engine.notices.publish_own("", {"event": "configuration", **content})
