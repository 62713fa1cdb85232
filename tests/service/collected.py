"""Collect the output of an engine by axis and number, and the output of one monitor for the same samples."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from pmfid.monitor.events import STATES
from pmfid.monitor.fleet import MonitorFleet
from pmfid.pipeline.monitored.run import event_object
from pmfid.stream.groups import Prepared
from pmfid.stream.outcome import EstimateRows, Notice
from pmfid.stream.timeline import Sample

#: Bits of theta, std, innovation, status and state.
Bits = tuple[Any, ...]


@dataclass
class Collected:
    """An outlet that collects rows by axis and number, and notices by number; a repeated row must be the same."""

    rows_of: dict[tuple[str, int], Bits] = field(default_factory=dict)
    notices: dict[int, tuple[str, dict[str, Any]]] = field(default_factory=dict)
    twice: int = 0

    def rows(self, rows: EstimateRows) -> None:
        for k in range(rows.axis.size):
            key = rows.group.axes[rows.axis[k]], int(rows.number[k])
            bits = (
                rows.theta[k].tobytes(),
                rows.std[k].tobytes(),
                float(rows.innovation[k]),
                int(rows.status[k]),
                STATES[rows.state[k]],
            )
            self.twice += key in self.rows_of
            assert self.rows_of.setdefault(key, bits) == bits, f"{key} is another row than before"

    def notice(self, notice: Notice) -> None:
        if notice.axis:
            entry = notice.axis, notice.what
            assert self.notices.setdefault(notice.number, entry) == entry, f"{notice} is another than before"

    def of(self, axis: str) -> list[tuple[int, Bits]]:
        """Return the rows of an axis in their order."""
        return sorted((number, bits) for (name, number), bits in self.rows_of.items() if name == axis)

    def events(self, axis: str, *kinds: str) -> list[dict[str, Any]]:
        """Return the events of an axis in their order."""
        found = [what for _, (name, what) in sorted(self.notices.items()) if name == axis]
        return [what for what in found if what["event"] in kinds]


def monitored(prepared: Prepared, samples: Iterable[Sample]) -> tuple[list[Bits], list[dict[str, Any]]]:
    """Return rows and events of a monitor that takes the samples one by one."""
    fleet = MonitorFleet(prepared.setup.monitor, 0)
    fleet.add(1)
    monitor, rows, reported = fleet.monitor(0), list[Bits](), list[dict[str, Any]]()
    for sample in samples:
        events = monitor.fill_gap(sample.missing, sample.u, sample.counts) if sample.missing else []
        events += monitor.skip(1) if sample.jump and not sample.missing else []
        estimate, now = monitor.step(sample.u, sample.counts, sample.further)
        shown = monitor.apply_known(estimate)
        bits = shown.theta.tobytes(), shown.theta_std.tobytes(), shown.innovation, shown.status, monitor.state
        rows.append(bits)
        shift = sample.time - (monitor.samples - 1) * monitor.estimator.dt
        reported += [event_object(event, monitor.names, shift) for event in (*events, *now)]
    return rows, reported
