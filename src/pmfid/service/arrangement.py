"""The assignment of axes to groups at the start, after a restart, and after a change of PLANT.toml.

This module also keeps the history of configurations, which is part of a checkpoint and goes to the sinks.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from time import monotonic, time

from pmfid.config.axis import Axis, load_axis
from pmfid.errors import PmfidError
from pmfid.pipeline.edges import EdgeSetup
from pmfid.records.record import Record
from pmfid.service.context import Tell
from pmfid.service.tuning import TUNING
from pmfid.stream.engine import StreamEngine
from pmfid.stream.groups import Group, Pace, Prepared, prepare


@dataclass
class Configurations:
    """The configurations of a plant, calibrated one after the other, each once.

    A configuration that fails is reported, and only its own axes are lost. `record` is the record on which the only
    axis is watched, or None if samples come from a source.
    """

    tell: Tell
    record: Record | None = None
    _known: dict[Path, tuple[str, Prepared]] = field(default_factory=dict, init=False)

    def load_all(self, axes: Mapping[str, Path]) -> dict[str, Prepared]:
        """Return the configuration of each axis that has a usable one, by the axis' name.

        If the present configuration of an axis fails, the previous one holds. Raises PmfidError or OSError if the only
        configuration has never been usable.
        """
        paths = dict.fromkeys(axes.values())
        loaded = {path: self._load_one(path, only=len(paths) == 1) for path in paths}
        return {name: prepared for name, path in axes.items() if (prepared := loaded[path]) is not None}

    def _load_one(self, path: Path, only: bool) -> Prepared | None:
        before = self._known.get(path)
        try:
            axis = load_axis(path)
            # The text changes with the configuration and with its reference record.
            reference = axis.monitor.reference
            status = None if reference is None else (path.parent / reference).stat()
            state = status and (status.st_size, status.st_mtime_ns, status.st_ino)
            stamp = f"{axis.model_dump_json(warnings=False)} {state}"
            if before is None or before[0] != stamp:
                self._known[path] = stamp, self._calibrate(path, axis)
            return self._known[path][1]
        except (PmfidError, OSError) as error:
            if only and before is None:
                raise
            left = (
                "the service does not watch the axes of this file"
                if before is None
                else "the axes of this file keep their previous configuration"
            )
            self.tell({"event": "configuration", "config": path.name, "problem": f"{error}; {left}"})
            return None if before is None else before[1]

    def _calibrate(self, path: Path, axis: Axis) -> Prepared:
        reported = [monotonic()]

        def progress(part: float) -> None:
            if monotonic() - reported[0] > TUNING.arrangement_progress:
                reported[0] = monotonic()
                self.tell({"event": "calibration", "config": path.name, "part": part})

        made = prepare(path, self.record, progress, axis)
        what = {
            "event": "configuration",
            "config": path.name,
            "cached": isinstance(made.setup, EdgeSetup) or made.setup.cached,
        }
        self.tell({**what, "notes": list(made.setup.notes)})
        return made


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


def remember(engine: StreamEngine) -> None:
    """Append new configurations to the history, with the time."""
    known = {entry["digest"] for entry in engine.history[-TUNING.arrangement_recent :]}
    for group in engine.groups:
        if group.prepared.digest not in known:
            entry = {"wall": time(), "config": group.kindred.config, "digest": group.prepared.digest}
            nominal = dict(zip(group.kindred.names, group.kindred.nominal.tolist(), strict=True))
            engine.history.append({**entry, "nominal": nominal})
    del engine.history[: -TUNING.arrangement_most]


def tell_configurations(engine: StreamEngine) -> None:
    """Report the present configurations to the sinks, which keep a configuration that differs from the last one."""
    present = {group.prepared.digest for group in engine.groups}
    for entry in engine.history:
        if entry["digest"] in present:
            content = {key: entry[key] for key in ("config", "digest", "nominal")}
            engine.notices.publish_own("", {"event": "configuration", **content})
