"""The page of a monitored run: in two seconds, what happened; below, why it is believed."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pmfid.monitor.calibration import Calibration
from pmfid.report.html import Section, svg, write_report
from pmfid.report.monitored_figures import RunData, calibration_figure, run_figure
from pmfid.session.monitored.run import MonitoredRun, Notice, RunHistory
from pmfid.session.monitored.setup import Setup

SHOWN_ALARMS = 200


def write_monitored(path: Path, name: str, setup: Setup, run: MonitoredRun, history: RunHistory) -> None:
    """Writes one self-contained HTML file on a run. Raises OSError if it cannot be written."""
    sections = [_verdict(setup, run)]
    if len(history.rows) > 1:
        sections.append(
            Section("The run", _run_text(history, setup), svg=svg(run_figure(run_data(setup, run, history))))
        )
    sections.append(_calibration(setup))
    write_report(path, f"{name}: {_headline(run)}", sections)


def run_data(setup: Setup, run: MonitoredRun, history: RunHistory) -> RunData:
    """The columns that the figure shows."""
    time, u, counts, theta, std, innovation, status, state = zip(*history.rows, strict=True)
    estimator = setup.monitor.estimator
    t = np.array(time)
    position = np.array(counts) * estimator.encoder.resolution
    return RunData(
        setup.monitor.names,
        setup.monitor.units,
        t,
        np.array(u),
        _velocity(position, t),
        np.array(theta),
        np.array(std),
        np.array(innovation),
        np.array(status),
        np.array(state),
        setup.reported,
        run.alarms,
        setup.monitor.estimator.equation.motion,
    )


def _velocity(position: np.ndarray, t: np.ndarray) -> np.ndarray:
    """(n,); a clock that was set may give two samples the same time."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.gradient(position, t))


def _headline(run: MonitoredRun) -> str:
    if not run.alarms:
        return "no alarm"
    first, more = run.alarms[0], len(run.alarms) - 1
    what = f"{first['parameter'].replace('_', ' ')} {100 * first['relative']:+.1f} % at {first['changed_at']:.1f} s"
    return what + (f", and {more} more alarm{'s' * (more > 1)}" if more else "")


def _verdict(setup: Setup, run: MonitoredRun) -> Section:
    lines = [f"{run.samples} samples, {run.samples * setup.monitor.estimator.dt:.1f} s."]
    if run.bad_lines or run.repeated_lines:
        lines.append(f"{run.bad_lines} lines could not be used, {run.repeated_lines} came again or too late.")
    if run.clock_jumps:
        lines.append(f"The clock was set {run.clock_jumps} times.")
    if run.outliers:
        lines.append(f"{run.outliers} jumps of the counts or the input were left out.")
    if run.problem:
        lines.append(f"The run ended: {run.problem}.")
    if run.missing:
        lines.append(f"{run.missing} samples are missing, in {run.gaps} gaps.")
    text = "\n\n".join([" ".join(lines), *(f"Note: {note}." for note in setup.notes)])
    if not run.alarms:
        return Section("No alarm", text)
    head = ("alarm [s]", "since [s]", "parameter", "change [%]", "change", "std", "unit", "settled on")
    rows = [_alarm_row(run, alarm) for alarm in run.alarms[:SHOWN_ALARMS]]
    return Section("Alarms", text, (head, rows))


def _alarm_row(run: MonitoredRun, alarm: Notice) -> list[str]:
    """With the value that the parameter settled on before the next alarm, if it did."""
    later = [event for event in run.events if event["event"] in ("settled", "alarm") and event["time"] > alarm["time"]]
    found = later[0]["parameters"].get(alarm["parameter"]) if later and later[0]["event"] == "settled" else None
    return [
        f"{alarm['time']:.2f}",
        f"{alarm['changed_at']:.2f}",
        alarm["parameter"].replace("_", " "),
        f"{100 * alarm['relative']:+.1f}",
        f"{alarm['change']:+.4g}",
        f"{alarm['std']:.1g}",
        alarm["unit"],
        f"{found['value']:.4g} ± {found['std']:.1g}" if found else "–",
    ]


def _run_text(history: RunHistory, setup: Setup) -> str:
    estimator = setup.monitor.estimator
    text = (
        f"Estimates by {estimator.method}, memory {estimator.dt / (1 - estimator.forgetting):.3g} s, with two standard "
        "deviations; orange lines: alarms; dotted: when the change began to show."
    )
    return text + (f" One row of {history.stride} is shown." if history.stride > 1 else "")


def _describe_hours(calibration: Calibration) -> str:
    hours = calibration.record_hours
    return f"drawn from the {hours:.2g} h of the reference record" if hours else "simulated"


def _calibration(setup: Setup) -> Section:
    watch, calibration = setup.monitor.watch, setup.calibration
    asked = sorted({1.0, watch.mtbf_hours})
    rows = [
        [name, *(f"{tail.threshold(hours):.3g}" for hours in asked), f"{tail.slope:.3g}"]
        for name, tail in calibration.tails.items()
    ]
    head = ("detector", *(f"threshold for {hours:g} h" for hours in asked), "slope of the tail")
    noise = ", ".join(f"{value:.2f}" for value in calibration.noise)
    text = (
        f"In use: {watch.detector}, mean time between false alarms {watch.mtbf_hours:g} h for a machine exactly at its "
        f"reference; deviations within {100 * watch.tolerance:g} % are no alarm, so false ones are rarer still. "
        f"{calibration.hours:.3g} h of normal work were {_describe_hours(calibration)}; points: the largest values of "
        "the statistic there, lines: fits that give the thresholds. Noise of the reference record over the noise of "
        f"the simulation, by parameter: {noise}."
    )
    figure = calibration_figure(calibration.tails, watch.detector, watch.mtbf_hours)
    return Section("Thresholds", text, (head, rows), svg(figure))
