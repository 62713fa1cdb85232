"""Collect the output of an engine by axis and number, and the output of `pmfid monitor` for the same samples."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pmfid.monitor.events import STATES
from pmfid.monitor.fleet import MonitorFleet
from pmfid.pipeline.monitored.run import watch
from pmfid.pipeline.monitored.timeline import Sample
from pmfid.stream.groups import Prepared
from pmfid.stream.outcome import EstimateRows, Notice

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


@dataclass
class _Sink:
    """A sink for the rows of `pmfid monitor`, as bits."""

    names: int
    rows: list[Bits] = field(default_factory=list)
    path: Path | None = None
    lost = 0

    def write(self, row: tuple[float | int | str, ...]) -> None:
        import numpy as np

        q = self.names
        theta, std = np.array(row[1 : 1 + q], float), np.array(row[1 + q : 1 + 2 * q], float)
        self.rows.append((theta.tobytes(), std.tobytes(), *row[1 + 2 * q :]))

    def close(self) -> None: ...


def monitored(prepared: Prepared, samples: Iterable[Sample]) -> tuple[list[Bits], list[dict[str, Any]]]:
    """Return rows and events of `pmfid monitor` for the samples."""
    fleet = MonitorFleet(prepared.setup.monitor, 0)
    fleet.add(1)
    monitor = fleet.monitor(0)
    sink, reported = _Sink(len(monitor.names)), list[dict[str, Any]]()
    watch(samples, monitor, sink, reported.append)
    return sink.rows, reported
