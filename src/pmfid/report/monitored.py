"""The report of a monitored run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pmfid.estimators.redge import REdge
from pmfid.models.axes import LINEAR, Units
from pmfid.monitor.chance import Chance
from pmfid.monitor.edges import EdgeMonitor
from pmfid.monitor.events import CANNOT_TELL, SETTLING, STARTING, STATES, SUSPICIOUS, WATCHING
from pmfid.monitor.monitor import Monitor
from pmfid.pipeline.monitored.run import MonitoredRun, Notice
from pmfid.pipeline.monitored.setup import Setup
from pmfid.report.figures import (
    COLOURS,
    GREY,
    MAGENTA,
    _finish_time,
    _label,
    _legend,
    _line,
    draw_estimate,
    open_figure,
    plain_ticks,
    stretches,
)
from pmfid.report.html import write_report
from pmfid.report.page import Section
from pmfid.status import Status
from pmfid.types import Flags, Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHOWN_ALARMS = 200
#: Largest number of rows in the figures.
MONITORED_ROWS = 8000

#: Rows of the strip from the top, with states of the monitor, then status bits of the estimate.
COLOUR_OF = {WATCHING: COLOURS[2], SUSPICIOUS: COLOURS[1], SETTLING: COLOURS[3], CANNOT_TELL: GREY, STARTING: GREY}
STRIP_BITS = {
    "poor excitation": Status.POOR_EXCITATION,
    "standstill": Status.STANDSTILL,
    "fallback": Status.FALLBACK,
    "unmodelled": Status.UNMODELLED,
    "bad input": Status.SAMPLE_REJECTED | Status.RESET,
}


@dataclass(frozen=True)
class RunData:
    """The data of a monitored run, with n rows of p parameters.

    `t` [s], `u`, `velocity` and `innovation` are (n,). `theta` and `std` are (n, p). `status` (n,) has bits, `state`
    (n,) words. `nominal` is (p,). `alarms` have the form for JSON.
    """

    names: Sequence[str]
    units: Sequence[str]
    t: Floats
    u: Floats
    velocity: Floats
    theta: Floats
    std: Floats
    innovation: Floats
    status: NDArray[np.uint32]
    state: NDArray[np.str_]
    nominal: Floats
    alarms: Sequence[Notice]
    motion: Units = LINEAR


def run_figure(data: RunData) -> Figure:
    """Draw the estimates with nominal values, a strip of states and status bits, input, motion and innovation."""
    p, strip = len(data.names), _strip_rows(data)
    heights = [1.9] * p + [0.25 + 0.2 * len(strip)] + [1.1] * 3
    with open_figure(1.1 + sum(heights), p + 4, sharex=True, height_ratios=heights) as (figure, panels):
        for i in range(p):
            _estimate_panel(panels[i], data, i)
        _strip_panel(panels[p], data.t, strip)
        signals = (("input", data.u, "unit of u"), ("velocity", data.velocity, data.motion.speed))
        for axes, (name, values, unit) in zip(
            panels[p + 1 :], (*signals, ("innovation", data.innovation, data.motion.force)), strict=True
        ):
            _line(axes, data.t, values, lw=0.8, color=COLOURS[0])
            axes.set_ylabel(_label(name, unit))
            _show_accepted(axes, values, data.status)
        trusted = np.abs(data.innovation[_select_trusted(data)])
        spread = 1.5 * np.percentile(trusted, 99.9) if trusted.size else 0.0
        if spread > 0:
            panels[-1].set_ylim(-spread, spread)
        for axes in panels:
            for alarm in data.alarms[:200]:
                axes.axvline(alarm["time"], color=COLOURS[1], lw=1.6, label="alarm", zorder=3)
                axes.axvline(alarm["changed_at"], color=COLOURS[1], lw=1.2, ls=":", label="change", zorder=3)
        figure.align_ylabels(panels)
        _finish_time(panels[-1], data.t)
        _legend(figure, panels)
    return figure


def _estimate_panel(axes: Axes, data: RunData, i: int) -> None:
    known = (data.status & Status.STARTING) == 0
    theta = np.where(known, data.theta[:, i], np.nan)
    draw_estimate(axes, data.t, theta, np.where(known, data.std[:, i], np.nan))
    axes.axhline(data.nominal[i], color=MAGENTA, ls="--", lw=1.2, label="nominal")
    axes.set_ylabel(_label(data.names[i], data.units[i]).replace(" friction", "\nfriction"))
    _limits(axes, theta[_select_trusted(data)], float(data.nominal[i]))


def _select_trusted(data: RunData) -> Flags:
    """Return the samples (n,) at which the estimate is neither starting nor settling after an alarm."""
    doubtful = Status.NOT_AN_ESTIMATE
    return np.asarray(((data.status & doubtful) == 0) & (data.state != SUSPICIOUS))


def _show_accepted(axes: Axes, values: Floats, status: NDArray[np.uint32]) -> None:
    """Set the range of the axis without samples that were left out, for example at a jump of the counts.

    The neighbours of a sample that was left out are also left out, because their difference quotients use the sample.
    With these samples, all others would look flat.
    """
    left_out = np.pad((status & Status.SAMPLE_REJECTED) != 0, 1)
    shown = values[~(left_out[:-2] | left_out[1:-1] | left_out[2:]) & np.isfinite(values)]
    if 0 < shown.size < values.size:
        margin = max(0.05 * float(np.ptp(shown)), 1e-12)
        axes.set_ylim(float(shown.min()) - margin, float(shown.max()) + margin)


def _limits(axes: Axes, values: Floats, nominal: float) -> None:
    values = values[np.isfinite(values)]
    low, high = np.percentile(values, (1, 99)) if values.size else (nominal, nominal)
    low, high = min(float(low), nominal), max(float(high), nominal)
    margin = max(0.15 * (high - low), 0.05 * abs(nominal), 1e-12)
    axes.set_ylim(low - margin, high + margin)


def _strip_rows(data: RunData) -> list[tuple[str, str, Flags]]:
    """Return label, colour and flags (n,) of the rows that occur."""
    rows = [(state, colour, data.state == state) for state, colour in COLOUR_OF.items()]
    rows += [
        (name, COLOURS[4 if name == "standstill" else 1], (data.status & int(bits)) != 0)
        for name, bits in STRIP_BITS.items()
    ]
    return [row for row in rows if np.any(row[2])]


def _strip_panel(axes: Axes, t: Floats, rows: Sequence[tuple[str, str, Flags]]) -> None:
    for k, (_, colour, flags) in enumerate(rows):
        axes.broken_barh(stretches(t, flags), (k - 0.38, 0.76), color=colour, lw=0)
    axes.set_yticks(range(len(rows)), [name for name, _, _ in rows], fontsize=9)
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.grid(axis="y", visible=False)


def chance_figure(chance: Chance, mtbf_hours: float) -> Figure:
    """Draw the rate of false alarms over the threshold, relative to the threshold for `mtbf_hours`."""
    with open_figure(3.4) as (figure, (axes,)):
        unit = chance.threshold(mtbf_hours)
        line = np.linspace(unit / 2, unit * 1.2, 40)
        axes.semilogy(line / unit, [chance.rate(one) for one in line.tolist()], color=COLOURS[0], label="false alarms")
        plain_ticks(axes.yaxis)
        axes.axhline(1 / mtbf_hours, color=MAGENTA, ls="--", lw=1.2, label=f"one in {mtbf_hours:g} h")
        axes.axvline(1.0, color=GREY, lw=0.8)
        axes.set_xlabel("statistic / threshold in use [-]")
        axes.set_ylabel("false alarms [1/h]")
        figure.legend(loc="outside upper center", ncols=5)
    return figure


def write_monitored(path: Path, setup: Setup, run: MonitoredRun) -> None:
    """Write one self-contained HTML file on a run. Raises OSError if the file cannot be written."""
    sections = [_verdict(setup, run)]
    if run.record.u.size > 1:
        stride = -(-run.record.u.size // MONITORED_ROWS)
        sections.append(
            Section("The run", _run_text(stride, setup), figure=lambda: run_figure(run_data(setup, run, stride)))
        )
    sections.append(_describe_threshold(setup.monitor))
    write_report(path, f"{run.record.name}: {_headline(run)}", sections)


def run_data(setup: Setup, run: MonitoredRun, stride: int) -> RunData:
    """Return the columns that the figure shows, with one row of `stride`.

    The status bits and the largest innovation also belong to the samples between two rows.
    """
    estimator, record, rows = setup.monitor.estimator, run.record, run.rows
    shown = np.arange(0, record.u.size, stride)
    t = record.times[shown]
    high, low = (extreme.reduceat(rows.innovation[0], shown) for extreme in (np.maximum, np.minimum))
    return RunData(
        run.names,
        setup.monitor.units,
        t,
        record.u[shown],
        np.gradient(record.counts[shown] * estimator.encoder.resolution, t),
        rows.theta[0, shown],
        rows.std[0, shown],
        np.where(high > -low, high, low),
        np.bitwise_or.reduceat(rows.status[0], shown),
        np.array(STATES)[rows.state[0, shown]],
        setup.reported,
        run.alarms,
        estimator.equation.motion,
    )


def _headline(run: MonitoredRun) -> str:
    if not run.alarms:
        return "no alarm"
    first, more = run.alarms[0], len(run.alarms) - 1
    changes = [
        f"{one['parameter'].replace('_', ' ')} {100 * one['relative']:+.1f} %"
        for one in (first, *first.get("further", ()))
    ]
    what = f"{' and '.join(changes)} at {first['changed_at']:.1f} s"
    return what + (f", and {more} more alarm{'s' * (more > 1)}" if more else "")


def _verdict(setup: Setup, run: MonitoredRun) -> Section:
    totals = [f"{run.record.u.size} samples", f"{run.record.u.size * run.record.dt:.1f} s"]
    totals += [f"{run.outliers} jump{'s' * (run.outliers != 1)} left out"] if run.outliers else []
    text = "\n\n".join([f"{', '.join(totals)}.", *(f"Note: {note}." for note in setup.notes)])
    if not run.alarms:
        return Section("No alarm", text)
    head = ("alarm [s]", "since [s]", "parameter", "change [%]", "change", "std", "unit", "settled on", "or")
    rows = [row for alarm in run.alarms[:SHOWN_ALARMS] for row in _alarm_rows(run, alarm)]
    return Section("Alarms", text, (head, rows))


def _alarm_rows(run: MonitoredRun, alarm: Notice) -> list[list[str]]:
    """Return a row for each change of an alarm, with its last value before the next alarm."""
    later = [event for event in run.events if event["event"] in ("settled", "alarm") and event["time"] > alarm["time"]]
    before = list(takewhile(lambda event: event["event"] == "settled", later))
    settled = before[-1]["parameters"] if before else {}
    others = alarm.get("others", "").replace("_", " ")
    return [
        [
            f"{alarm['time']:.2f}",
            f"{alarm['changed_at']:.2f}",
            change["parameter"].replace("_", " "),
            f"{100 * change['relative']:+.1f}",
            f"{change['change']:+.4g}",
            f"{change['std']:.1g}",
            change["unit"],
            f"{found['value']:.4g} ± {found['std']:.1g}" if found else "–",
            others,
        ]
        for change in (alarm, *alarm.get("further", ()))
        for found in [settled.get(change["parameter"])]
    ]


def _run_text(stride: int, setup: Setup) -> str:
    estimator = setup.monitor.estimator
    rate = estimator.rate if isinstance(estimator, REdge) else 1 - estimator.forgetting
    text = (
        f"Estimates by {estimator.method}, memory {estimator.dt / rate:.3g} s, with two standard deviations; orange "
        "lines: alarms; dotted lines: visible start of the change."
    )
    return text + (f" One row of {stride} is shown." if stride > 1 else "")


def _describe_threshold(monitor: Monitor | EdgeMonitor) -> Section:
    if isinstance(monitor, Monitor):
        return _calibration(monitor)
    text = (
        f"A deviation is an alarm beyond {100 * monitor.watch.tolerance:g} % and {monitor.threshold:.3g} standard "
        f"errors, which chance exceeds once in {monitor.watch.mtbf_hours:g} h."
    )
    return Section("Threshold", text)


def _calibration(monitor: Monitor) -> Section:
    watch, calibration = monitor.watch, monitor.calibration
    asked = sorted({1.0, 24.0, watch.mtbf_hours, 1000.0})
    rows = [[f"{hours:g}", f"{calibration.chance.threshold(hours):.3g}"] for hours in asked]
    noise, hours = ", ".join(f"{value:.2f}" for value in calibration.noise), calibration.record_hours
    source = f"the scatter of {hours:.2g} h of the reference record" if hours else "the noise of the encoder"
    text = (
        f"Mean time between false alarms {watch.mtbf_hours:g} h for a machine exactly at its "
        f"reference; deviations within {100 * watch.tolerance:g} % are no alarm, so false ones are rarer still. "
        f"The thresholds follow from {source}. Noise of the reference record over the noise of the simulation, by "
        f"parameter: {noise}."
    )
    head = ("time between false alarms [h]", "threshold")
    return Section("Threshold", text, (head, rows), lambda: chance_figure(calibration.chance, watch.mtbf_hours))
