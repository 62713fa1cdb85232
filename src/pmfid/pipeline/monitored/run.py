"""A record under a monitor, with its estimates and events."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pmfid.estimators.facts import INPUT_GAIN
from pmfid.monitor.edges import EdgeMonitor
from pmfid.monitor.events import STATES, Change, Event, FleetRows, Outlier, Settled, StateChange
from pmfid.monitor.monitor import Monitor
from pmfid.records.record import Record

if TYPE_CHECKING:
    import polars as pl

#: Largest number of outliers that are reported one by one.
MOST_NOTICES = 10

#: An event for JSON, with texts, numbers and tables by key.
Notice = dict[str, Any]


@dataclass(frozen=True)
class MonitoredRun:
    """A record of n samples under a monitor.

    `names` belong to the q reported parameters. `rows` has the estimates of one axis. `events` are as for JSON, in the
    order of time, with the first `MOST_NOTICES` outliers. `outliers` counts all samples that no motion explains.
    """

    record: Record
    names: tuple[str, ...]
    rows: FleetRows
    events: tuple[Notice, ...]
    outliers: int

    @property
    def alarms(self) -> list[Notice]:
        return [event for event in self.events if event["event"] == "alarm"]

    @property
    def totals(self) -> dict[str, int]:
        """The numbers of samples, outliers and alarms."""
        return {"samples": self.record.u.size, "outliers": self.outliers, "alarms": len(self.alarms)}

    def to_frame(self) -> pl.DataFrame:
        """Return a table with a row for each sample."""
        import polars as pl

        rows = self.rows
        columns: dict[str, object] = {"t": self.record.times}
        for values, end in ((rows.theta, ""), (rows.std, "_std")):
            columns |= {f"{name}{end}": values[0, :, i] for i, name in enumerate(self.names)}
        columns |= {
            "innovation": rows.innovation[0],
            "status": rows.status[0],
            "state": np.array(STATES)[rows.state[0]],
        }
        return pl.DataFrame(columns)


def watch(record: Record, monitor: Monitor | EdgeMonitor) -> MonitoredRun:
    """Run the monitor over a record."""
    further = {"": None, "ages": record.ages, "temperature": record.temperature}[monitor.further]
    rows = monitor.run(record.u, record.counts, further)
    events, outliers = _note_temperature(record, monitor), 0
    for *_, event in rows.events:
        outliers += isinstance(event, Outlier)
        if outliers <= MOST_NOTICES or not isinstance(event, Outlier):
            events.append(event_object(event, monitor.names))
    return MonitoredRun(record, monitor.names, rows, tuple(sorted(events, key=lambda event: event["time"])), outliers)


def _note_temperature(record: Record, monitor: Monitor | EdgeMonitor) -> list[Notice]:
    """Return an event for the first temperature that the reference does not have, if there is one."""
    warmth = monitor.calibration.warmth if isinstance(monitor, Monitor) else None
    if warmth is None or record.temperature is None:
        return []
    beyond = np.flatnonzero((record.temperature < warmth.span[0]) | (record.temperature > warmth.span[1]))
    if not beyond.size:
        return []
    span = " to ".join(f"{end:.4g}" for end in warmth.span)
    problem = (
        f"{record.temperature[beyond[0]]:.4g} is beyond {span} of the reference, and the effect on friction is "
        "extrapolated"
    )
    return [{"event": "temperature", "time": float(beyond[0]) * record.dt, "problem": problem}]


def event_object(event: Event, names: tuple[str, ...], shift: float = 0.0) -> Notice:
    """Return the object that `--json` prints, with times shifted by `shift` [s]."""
    if isinstance(event, StateChange):
        return {"event": "state", "time": event.time + shift, "state": event.state, "reason": event.reason}
    if isinstance(event, Settled):
        return {
            "event": "settled",
            "time": event.time + shift,
            "parameters": _format_settled(event, names),
            **({} if event.rate is None else {"rate": event.rate}),
            **({"changes": [_format_change(one) for one in event.changes]} if event.changes else {}),
            **({"others": ", or ".join(event.others)} if event.others else {}),
        }
    if isinstance(event, Outlier):
        return {"event": "outlier", "time": event.time + shift, "signal": event.signal}
    return {
        "event": "alarm",
        "time": event.time + shift,
        **_format_change(event.changes[0]),
        "changed_at": event.changed_at + shift,
        "statistic": event.statistic,
        "threshold": event.threshold,
        "tolerance": event.tolerance,
        "advice": event.advice,
        **({"further": [_format_change(one) for one in event.changes[1:]]} if event.changes[1:] else {}),
        **({"others": ", or ".join(event.others)} if event.others else {}),
    }


def _format_change(change: Change) -> Notice:
    return {
        "parameter": change.parameter,
        "direction": "up" if change.change > 0 else "down",
        "change": change.change,
        "std": change.std,
        "unit": change.unit,
        "relative": change.relative,
    }


def _format_settled(event: Settled, names: tuple[str, ...]) -> dict[str, dict[str, float | None]]:
    """Return value, standard deviation and relative change by name.

    After an alarm of the input gain, the gain comes first, and the other values use the present gain.
    """
    gain = {} if event.gain is None else {INPUT_GAIN: event.gain}
    factor = event.gain[0] / event.gain[2] if event.gain else 1.0
    own = zip((factor * event.theta).tolist(), (factor * event.std).tolist(), event.before.tolist(), strict=True)
    return {
        name: {"value": value, "std": std, "change": value / before - 1 if before else None}
        for name, (value, std, before) in (gain | dict(zip(names, own, strict=True))).items()
    }
