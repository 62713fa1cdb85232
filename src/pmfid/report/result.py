"""The report of a result."""

from __future__ import annotations

import io
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np

from pmfid.diagnostics.processes import search_notes
from pmfid.errors import PmfidError
from pmfid.estimators.base import Simulating
from pmfid.linear.order import Search
from pmfid.linear.process import Process
from pmfid.models.equation import Equation
from pmfid.pipeline.conclusion import conclude
from pmfid.pipeline.processes import search_json
from pmfid.pipeline.result import DriveResult, ProcessResult, Result, findings_lines, parameter_header, parameter_rows
from pmfid.records.record import Record
from pmfid.report.figures import (
    COLOURS,
    FIGURES_POINTS,
    GREY,
    decimation,
    estimate_figure,
    open_figure,
    plain_ticks,
    residual_figure,
    signals_figure,
    status_figure,
)
from pmfid.report.html import write_bytes, write_page
from pmfid.report.page import ResultPage, Section
from pmfid.report.validation import run_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Frequencies from a tenth of the slowest to ten times the fastest corner, and time constants of a step response.
RESULT_DECADES = 1.0
RESULT_SETTLING = 8.0
#: Number of structures in the table of a search.
RESULT_ROWS = 15

HOW_TO_READ = (
    "std: scatter of the value between records of this length. model spread: largest effect on the value of friction, "
    "a load or a dead time outside the model; a longer record would not show this effect. 95 %: the interval of the "
    "parameter, including both."
)


def write_result(out: Path, result: Result) -> None:
    """Write report.html, result.json and, for a recursive method on a machine, track.parquet into the folder `out`.

    A track.parquet of an earlier run is removed.
    """
    out.mkdir(parents=True, exist_ok=True)
    track, said = out / "track.parquet", conclude(result)
    if not track.is_dir():
        track.unlink(missing_ok=True)
    if isinstance(result, DriveResult):
        _write_track(track, result)
        title, sections = f"{result.record.name}: {result.estimator.method}", _drive_sections(out, result)
    else:
        title = f"transfer function: {result.estimator.method}"
        sections = _process_sections(cast(ProcessResult, result))
    lead = said.sentence, said.action
    write_page(out, ResultPage("report", title, result.to_dict(), sections, lead, data="result"))


def _drive_sections(out: Path, result: DriveResult) -> list[Section]:
    """Return the sections of a machine. Two masses are also written into the folder `out`, for MuJoCo."""
    text, table = "\n\n".join(findings_lines(result, notes=False)), (parameter_header(result), parameter_rows(result))
    sections, masses = [Section("Parameters", text, table)], result.two_masses
    if masses is not None:
        (out / "two_masses.xml").write_text(masses.to_mjcf(), encoding="utf-8")
        rows = [(one.controller or "any", one.name, one.value, one.unit) for one in masses.settings()]
        sections.append(Section("Settings of controllers", table=(("controller", "setting", "value", "unit"), rows)))
    return [*sections, _model_check(result), _drive_notes(result), *_figures(result)]


def _write_track(path: Path, result: DriveResult) -> None:
    import polars as pl

    track = result.track
    if track is None:
        return
    columns: dict[str, np.ndarray] = {"t": result.record.times}
    for i, name in enumerate(track.names):
        columns |= {name: track.theta[:, i], f"{name}_std": track.theta_std[:, i]}
    columns |= {"innovation": track.innovation, "status": track.status}
    buffer = io.BytesIO()
    pl.DataFrame(columns).write_parquet(buffer)
    write_bytes(path, buffer.getvalue())


def _model_check(result: DriveResult) -> Section:
    """Return the section on the motion that the input alone gives."""
    heading, own = "Model check: simulated from the input alone", result.estimator.equation.motion
    try:
        run = result.free_run()
    except PmfidError as error:
        return Section(heading, f"This check is not possible: {error}.")
    text = (
        f"Fit: {'–' if run.fit is None else f'{run.fit:.2f} %'}. The simulated motion departs from the measured one by "
        f"at most {run.largest:.2g} {own.travel}, root mean square {run.rmse:.2g} {own.travel}; rounding to the steps "
        f"of the encoder alone gives {run.encoder:.2g} {own.travel}."
    )
    return Section(
        heading,
        "\n\n".join([text, *(f"Note: {note}." for note in run.notes)]),
        figure=lambda: run_figure(run, own.travel),
    )


def _drive_notes(result: DriveResult) -> Section:
    estimator = result.estimator
    zeros = ", ".join(f"{zero:.3g}" for zero in estimator.zeros)
    text = (
        f"{result.record.u.size} samples, dt = {result.record.dt:.6g} s, "
        f"resolution {result.record.resolution:.4g} per count. "
        f"Filters: order {estimator.order}, cutoff {estimator.cutoff:g} rad/s"
        + (f", pre-filter zeros {zeros} rad/s" if zeros else "")
        + f". Relative error of the filtered equation: {100 * result.relative_error:.3g} %."
    )
    return Section(
        "Notes and settings", "\n\n".join([HOW_TO_READ, *findings_lines(result, notes=True), text]), folded=True
    )


def motion_figure(record: Record, equation: Equation) -> Figure:
    """Draw input and velocity of a record. An input of unknown unit is drawn as the force of the equation."""
    velocity = np.gradient(record.counts * record.resolution, record.times)
    u, unit = record.u, record.input_unit
    if not unit:
        u, unit = equation.input_gain * record.u, equation.motion.force
    return signals_figure(record.times, u, velocity, input_unit=unit, velocity_unit=equation.motion.speed)


def _figures(result: DriveResult) -> list[Section]:
    record, own = result.record, result.estimator.equation.motion
    t = record.times
    sections = [Section("Input and motion", figure=lambda: motion_figure(record, result.estimator.equation))]
    track = result.track
    if track is not None:
        sections.insert(0, Section("Estimates", figure=lambda: estimate_figure(t, track, None)))
        sections.append(Section("Status", figure=lambda: status_figure(t, track.status)))
    method = result.estimator
    follows = isinstance(method, Simulating) and not method.instrumental  # such a method has no filtered equation
    if result.fit is not None and not follows:
        used, residual = t[record.u.size - result.fit.samples :], result.fit.residual
        draw = partial(residual_figure, used, residual, unit=own.force)
        sections.append(Section("Residual of the filtered equation", figure=draw))
    return sections


def _process_sections(result: ProcessResult) -> list[Section]:
    notes = "\n\n".join(findings_lines(result, notes=True))
    return [
        Section("Parameters", _describe_process(result), (parameter_header(result), parameter_rows(result))),
        *(
            []
            if result.fit is None
            else [Section("Measured and simulated output", figure=partial(output_figure, result))]
        ),
        *([Section("Notes", notes, folded=True)] if notes else []),
        Section("Poles, zeros, gain", ROOTS, (("", "value", "std", ""), result.process.rows)),
        Section("Frequency response", BAND, figure=lambda: bode_of(result.process, result.estimator.dt)),
        Section("Step response", BAND, figure=lambda: step_figure(result.process)),
        Section("Residual", _residual_text(result), figure=lambda: correlation_figure(result)),
    ]


BAND = "Band: two standard deviations."
ROOTS = "Poles and zeros in rad/s, their standard deviations of real and imaginary part. Time constant: 1 / |pole|."


def _describe_process(result: ProcessResult) -> str:
    text = f"{result.name}: {result.samples} samples. {result.fit_text.capitalize()}."
    return "\n\n".join([text, *findings_lines(result, notes=False)])


def _residual_text(result: ProcessResult) -> str:
    checks = result.assessment
    parts = [
        "white" if checks.white else "not white, because the noise is coloured or an effect is outside the model",
        "not correlated with the input"
        if checks.independent
        else "correlated with the input, because the model is too small",
    ]
    parts += ["correlated with later inputs: feedback"] if checks.feedback else []
    return f"The residual is {'; '.join(parts)}. Grey: bounds for 99 % of the values of an independent residual."


def output_figure(result: ProcessResult) -> Figure:
    """Draw the measured and simulated output of every record over time."""
    records, checks = result.experiments, result.assessment
    parts = list(zip(checks.records, checks.samples, checks.simulated, strict=True))
    with open_figure(2.2 * len(records), len(records)) as (figure, panels):
        for row, (experiment, axes) in enumerate(zip(records, panels, strict=True)):
            shown = decimation(experiment.y)
            axes.plot(experiment.times[shown], experiment.y[shown], color=GREY, label="measured")
            for record, samples, simulated in parts:
                if record == row:
                    kept = decimation(simulated)
                    t = experiment.times[samples[kept]]
                    axes.plot(t, simulated[kept], color=COLOURS[0], label="simulated")
            axes.set_ylabel(f"y, {experiment.name}")
        axes.set_xlabel("time [s]")
        handles, labels = axes.get_legend_handles_labels()
        figure.legend(handles[:2], labels[:2], loc="outside upper right", ncols=2)
    return figure


def bode_of(process: Process, dt: float) -> Figure:
    """Draw magnitude and phase over frequency with two standard deviations, up to half the sampling frequency.

    The sample period dt is in s.
    """
    corners = np.abs(np.r_[process.poles, process.zeros])
    corners = corners[corners > 0]
    nyquist = np.pi / dt
    low, high = (
        np.log10(np.min(corners)) - RESULT_DECADES,
        min(np.log10(np.max(corners)) + RESULT_DECADES, np.log10(nyquist)),
    )
    w = np.logspace(low, max(high, low + RESULT_DECADES), FIGURES_POINTS)
    G, magnitude, phase = process.frequency_response(w)
    size, angle = 20 * np.log10(np.abs(G)), np.unwrap(np.angle(G))
    with open_figure(5.0, 2, sharex=True) as (figure, (upper, lower)):
        _draw_band(upper, w, size, 2 * 20 / np.log(10) * magnitude)
        upper.set_ylabel("magnitude [dB]")
        _draw_band(lower, w, np.degrees(angle), 2 * np.degrees(phase))
        lower.set_ylabel("phase [degrees]")
        lower.set_xlabel("frequency [rad/s]")
        upper.set_xscale("log")
        plain_ticks(lower.xaxis)
    return figure


def step_figure(process: Process) -> Figure:
    """Draw the step response with two standard deviations."""
    speeds = np.abs(process.poles.real[process.poles != 0])
    fastest = float(np.max(np.abs(process.poles), initial=0.0)) or 1.0  # integrators alone have no time constant
    slowest = float(np.max(1 / np.maximum(speeds, 1e-3 * fastest), initial=1 / fastest))
    t = np.linspace(0, RESULT_SETTLING * slowest + 2 * process.delay, FIGURES_POINTS)
    y, std = process.step_response(t)
    with open_figure(2.6) as (figure, (axes,)):
        _draw_band(axes, t, y, 2 * std)
        axes.set_xlabel("time [s]")
        axes.set_ylabel("response to a unit step")
    return figure


def correlation_figure(result: ProcessResult) -> Figure:
    """Draw the autocorrelation of the residual, its correlation with the input, and their bounds."""
    checks, lags = result.assessment, np.arange(result.assessment.autocorrelation.size)
    whose = "reference" if any(e.reference is not None for e in result.experiments) else "input"
    parts = (
        (lags, checks.autocorrelation, checks.autocorrelation_bound, "residual"),
        (checks.lags, checks.cross, checks.cross_bound, f"residual and {whose}"),
    )
    with open_figure(4.2, 2) as (figure, panels):
        for axes, (lags, values, bound, label) in zip(panels, parts, strict=True):
            axes.axhspan(-bound, bound, color="#DDDDDD")
            axes.vlines(lags, 0, values, color=COLOURS[0])
            axes.plot(lags, values, "o", color=COLOURS[0], markersize=3)
            axes.set_ylabel(f"correlation,\n{label}")
        axes.set_xlabel("lag [samples]; negative: the input comes later")
    return figure


def _draw_band(axes: Axes, x: np.ndarray, y: np.ndarray, half: np.ndarray) -> None:
    axes.fill_between(x, y - half, y + half, color=COLOURS[0], alpha=0.25, linewidth=0)
    axes.plot(x, y, color=COLOURS[0])


#: Headings of the columns of `search_rows`.
SEARCH_HEADER = ("n", "m", "delay", "criterion", "fit [%]", "condition")


def search_rows(search: Search) -> list[list[str]]:
    """Return the rows of the best structures, with the criterion as the distance from the best."""
    return [
        [
            str(row.n),
            str(row.m),
            str(row.delay),
            f"{row.bic - search.best.bic:.1f}",
            f"{row.fit:.2f}",
            f"{row.condition:.1e}" + ("" if row.settled else " (not settled)") + (" (refused)" if row.refused else ""),
        ]
        for row in search.candidates[:RESULT_ROWS]
    ]


def search_figure(search: Search) -> Figure:
    """Draw the criterion of the best structure of each size, labelled with the structure."""
    best: dict[int, int] = {}
    for index, row in enumerate(search.candidates):
        best.setdefault(row.n + row.m + 1, index)
    sizes = sorted(best)
    values = [search.candidates[best[size]].bic - search.best.bic for size in sizes]
    with open_figure(3.0) as (figure, (axes,)):
        axes.plot(sizes, values, "o-", color=COLOURS[0])
        for size, value in zip(sizes, values, strict=True):
            row = search.candidates[best[size]]
            place = f"{row.n}, {row.m}, {row.delay}"
            halo = {"facecolor": "white", "edgecolor": "none", "pad": 0.6, "alpha": 0.8}
            axes.annotate(place, (size, value), (0, 7), textcoords="offset points", ha="center", bbox=halo)
        axes.set_yscale("symlog", linthresh=10)
        plain_ticks(axes.yaxis)
        axes.margins(y=0.25)
        axes.set_xlabel("parameters; above the point: n, m, delay of the best such structure")
        axes.set_ylabel("criterion above the best")
    return figure


def search_page(search: Search, name: str) -> ResultPage:
    """Return the page of a search for the structure of a transfer function."""
    text = (
        f"{search.samples} samples, {len(search.candidates)} structures fitted, {search.skipped} skipped because they "
        "cannot be better. Criterion: Schwarz (1978), after the whitening filter of the noise, as the distance from "
        "the best structure. A smaller criterion is better; a difference below about 10 is not significant. Refused: "
        "pmfid identify gives no estimate, or a pole that the record does not determine. Condition: condition number "
        "of the scaled sensitivities, large if poles and zeros nearly cancel."
    )
    notes, best = search_notes(search), search.best
    text = "\n\n".join([text, *(f"Note: {note}." for note in notes)])
    table = (SEARCH_HEADER, search_rows(search))
    sections = [Section("Structures", text, table), Section("Criterion", figure=lambda: search_figure(search))]
    remarks = [f"best for [model]: n = {best.n}, m = {best.m}, delay = {best.delay}"]
    remarks += [f"note: {note}" for note in notes]
    return ResultPage("order", f"{name}: poles, zeros and dead time", search_json(search), sections, remarks=remarks)
