"""A monitored run, which converts samples to estimates and events."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

from pmfid._estimate import Estimate
from pmfid.errors import UsageError
from pmfid.estimators.facts import INPUT_GAIN
from pmfid.estimators.known import Seen
from pmfid.monitor.edges import EdgeMonitor
from pmfid.monitor.events import Change, Event, Outlier, Settled, StateChange
from pmfid.monitor.monitor import Monitor
from pmfid.pipeline.monitored.rows import RowSink
from pmfid.pipeline.monitored.timeline import BAD, COMMENT, REPEATED, Found, Sample, Skipped
from pmfid.pipeline.tuning import TUNING
from pmfid.types import Floats

#: A monitor, of counts or of edges.
Monitored = Monitor | EdgeMonitor
#: A notice for JSON, with texts, numbers and tables by key.
Notice = dict[str, Any]
Tell = Callable[[Notice], None]
#: Time, u, counts, theta, std, innovation, status bits and state of one sample.
Row = tuple[float, float, int, Floats, Floats, float, int, str]
#: Callback with each sample, its estimate and the monitor's state.
Observer = Callable[[Sample, Estimate | Seen, str], None]


@dataclass
class RunHistory:
    """The curves of the report in bounded memory.

    A row holds time, u, counts, theta, std, innovation, status bits and state of every `stride`th sample. Status bits
    and the largest innovation also cover the samples between two rows.
    """

    stride: int = field(default=1, init=False)
    rows: list[Row] = field(default_factory=list, init=False)
    _taken: int = field(default=0, init=False)

    def __call__(self, sample: Sample, estimate: Estimate | Seen, state: str) -> None:
        """Add a sample with its estimate and the monitor's state."""
        if self._taken % self.stride == 0:
            if len(self.rows) >= TUNING.most_rows:
                self.rows, self.stride = self.rows[::2], 2 * self.stride
            theta, std = estimate.theta, estimate.theta_std
            row = (sample.time, sample.u, sample.counts, theta, std, estimate.innovation, estimate.status, state)
            self.rows.append(row)
        else:
            time, u, counts, theta, std, innovation, status, _ = self.rows[-1]
            largest = max(innovation, estimate.innovation, key=abs)
            self.rows[-1] = (time, u, counts, theta, std, largest, status | estimate.status, state)
        self._taken += 1


@dataclass
class MonitoredRun:
    """The totals of a run and its first run_kept events, as for JSON.

    `bad_lines` counts unusable lines. `repeated_lines` counts lines that came twice or too late. `comments` includes
    repeated headers. `gaps` counts gaps in the times, and `missing` counts the samples in these gaps. `clock_jumps`
    counts how often the clock was set. `outliers` counts samples that no motion explains. `problem` is the error that
    ended the run, or an empty text.
    """

    samples: int = 0
    bad_lines: int = 0
    repeated_lines: int = 0
    comments: int = 0
    gaps: int = 0
    missing: int = 0
    clock_jumps: int = 0
    outliers: int = 0
    problem: str = ""
    events: list[Notice] = field(default_factory=list)

    @property
    def alarms(self) -> list[Notice]:
        return [event for event in self.events if event["event"] == "alarm"]

    def totals(self) -> dict[str, int]:
        """Return all totals by name."""
        names = ("samples", "bad_lines", "repeated_lines", "comments", "gaps", "missing", "clock_jumps", "outliers")
        return {**{name: getattr(self, name) for name in names}, "alarms": len(self.alarms)}


def list_skipped(event: Notice) -> list[str]:
    """Return texts with the numbers of skipped lines, from the totals."""
    parts = [
        f"{event[name]} {word}{'s' * (event[name] != 1)}"
        for name, word in (("bad_lines", "bad line"), ("repeated_lines", "repeated line"), ("comments", "comment"))
        if event[name]
    ]
    if event["missing"]:
        parts.append(f"{event['missing']} samples missing in {event['gaps']} gaps")
    if event["clock_jumps"]:
        parts.append(f"clock jumped {event['clock_jumps']} times")
    if event["outliers"]:
        parts.append(f"{event['outliers']} jump{'s' * (event['outliers'] != 1)} left out")
    return parts


def header(monitor: Monitored) -> list[str]:
    """Return the column names of the estimates."""
    names = monitor.names
    return ["t", *names, *(f"{name}_std" for name in names), "innovation", "status", "state"]


def watch(
    found: Iterable[Found], monitor: Monitored, sink: RowSink | None, tell: Tell, observers: Sequence[Observer] = ()
) -> MonitoredRun:
    """Run the monitor over the samples. `tell` gets each event as an object for JSON, with the times of the samples.

    A UsageError in the samples ends the run without an exception, so that the results are still written.
    """
    run = MonitoredRun()
    try:
        for one in found:
            if isinstance(one, Skipped):
                _count_skipped(one, run, tell)
            else:
                _step(one, monitor, run, sink, tell, observers)
    except UsageError as error:
        run.problem = str(error)
    return run


def _step(
    sample: Sample,
    monitor: Monitored,
    run: MonitoredRun,
    sink: RowSink | None,
    tell: Tell,
    observers: Sequence[Observer],
) -> None:
    events = _count_interruption(sample, monitor, run, tell) if sample.missing or sample.jump else []
    if isinstance(monitor, Monitor):
        _compare_temperature(sample, monitor, run, tell)
    estimate, now = monitor.step(sample.u, sample.counts, sample.further)
    reported = monitor.apply_known(estimate)
    run.samples += 1
    if sink is not None:
        sink.write(_row(sample.time, reported, monitor.state))
    for observe in observers:
        observe(sample, reported, monitor.state)
    for event in [*events, *now]:
        if isinstance(event, Outlier):
            run.outliers += 1
            if run.outliers > TUNING.most_notices:
                continue
        shift = sample.time - (monitor.samples - 1) * monitor.estimator.dt
        notice = event_object(event, monitor.names, shift)
        if len(run.events) < TUNING.run_kept:
            run.events.append(notice)
        tell(notice)


def _compare_temperature(sample: Sample, monitor: Monitor, run: MonitoredRun, tell: Tell) -> None:
    """Report the first temperature that the reference does not have."""
    warmth, found = monitor.calibration.warmth, sample.further
    if warmth is None or not (found < warmth.span[0] or found > warmth.span[1]):
        return
    if not any(event["event"] == "temperature" for event in run.events):
        span = " to ".join(f"{end:.4g}" for end in warmth.span)
        problem = f"{found:.4g} is beyond {span} of the reference, and the effect on friction is extrapolated"
        run.events.append({"event": "temperature", "time": sample.time, "problem": problem})
        tell(run.events[-1])


def _count_skipped(line: Skipped, run: MonitoredRun, tell: Tell) -> None:
    """Count a line that is not a sample, and report the first such lines."""
    name = {BAD: "bad_lines", REPEATED: "repeated_lines", COMMENT: "comments"}[line.kind]
    setattr(run, name, getattr(run, name) + 1)
    if line.kind != COMMENT and getattr(run, name) <= TUNING.most_notices:
        tell({"event": line.kind, "time": line.time, "problem": line.problem})


def _count_interruption(sample: Sample, monitor: Monitored, run: MonitoredRun, tell: Tell) -> list[Event]:
    """Count and report a gap or a clock that was set, and pass it to the monitor."""
    if sample.missing:
        run.gaps += 1
        run.missing += sample.missing
        if run.gaps <= TUNING.most_notices:
            tell({"event": "gap", "time": sample.time, "missing": sample.missing})
        return monitor.fill_gap(sample.missing, sample.u, sample.counts)
    run.clock_jumps += 1
    if run.clock_jumps <= TUNING.most_notices:
        tell({"event": "clock", "time": sample.time, "jump": sample.jump})
    return monitor.skip(1)


def _row(time: float, estimate: Estimate | Seen, state: str) -> tuple[float | int | str, ...]:
    # Values are infinite before the first information.
    theta, std = estimate.theta.tolist(), estimate.theta_std.tolist()
    return (time, *theta, *std, estimate.innovation, estimate.status, state)


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
