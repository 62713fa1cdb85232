"""Files of one identification: the report, the numbers, the track."""

from __future__ import annotations

import io
import os
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from pmfid.models.axes import LINEAR
from pmfid.report.figures import estimate_figure, residual_figure, signals_figure, status_figure
from pmfid.report.files import replace_file, write_json
from pmfid.report.html import Section, svg, write_report
from pmfid.report.model_checks import model_checks
from pmfid.session.parameters import findings_lines, parameter_header, parameter_rows
from pmfid.session.records import Record
from pmfid.session.result import DriveResult
from pmfid.session.row_file import fresh

HOW_TO_READ = (
    "std: how far the value varies from record to record of this length. model spread: how far friction, a load or a "
    "dead time that the model lacks may move it, which no longer record would show. 95 %: between these values the "
    "parameter is with both."
)


def write_drive(out: Path, result: DriveResult) -> None:
    """Writes report.html, result.json and, for a recursive method, track.parquet into the folder `out`.

    A track.parquet that is there stays under another name, track-2.parquet and so on: it is of an earlier run, or has
    nothing to do with this program.
    """
    out.mkdir(parents=True, exist_ok=True)
    track = out / "track.parquet"
    if os.path.lexists(track) and not track.is_dir():
        track.rename(fresh(track))
    write_json(out / "result.json", result.to_json())
    if result.track is not None:
        _write_track(track, result)
    title = f"{result.record.name}: {result.estimator.method}"
    write_report(out / "report.html", title, [_parameters(result), *_figures(result), *model_checks(result)])


def _write_track(path: Path, result: DriveResult) -> None:
    import polars as pl

    track = result.track
    if track is None:
        return
    columns: dict[str, np.ndarray] = {"t": np.arange(track.status.size) * result.record.dt}
    for i, name in enumerate(track.names):
        columns |= {name: track.theta[:, i], f"{name}_std": track.theta_std[:, i]}
    columns |= {"innovation": track.innovation, "status": track.status}
    buffer = io.BytesIO()
    pl.DataFrame(columns).write_parquet(buffer)
    replace_file(path, buffer.getvalue())


def _parameters(result: DriveResult) -> Section:
    estimator = result.estimator
    zeros = ", ".join(f"{zero:.3g}" for zero in estimator.zeros)
    text = (
        f"{result.record.u.size} samples, dt = {result.record.dt:.6g} s, "
        f"resolution {result.record.resolution:.4g} per count. "
        f"Filters: order {estimator.order}, cutoff {estimator.cutoff:g} rad/s"
        + (f", pre-filter zeros {zeros} rad/s" if zeros else "")
        + f". Relative error of the filtered equation: {100 * result.relative_error:.3g} %."
    )
    text = "\n\n".join([text, HOW_TO_READ, *findings_lines(result)])
    return Section("Parameters", text, (parameter_header(result), parameter_rows(result)))


def motion_figure(record: Record, speed: str = LINEAR.speed) -> Figure:
    """Input and velocity of a record; speed: its unit."""
    velocity = np.gradient(record.counts * record.resolution, record.dt)
    signals = signals_figure(np.arange(record.u.size) * record.dt, record.u, velocity, velocity_unit=speed)
    signals.axes[0].set_ylabel("input u")  # no record says in which unit
    return signals


def _figures(result: DriveResult) -> list[Section]:
    record, own = result.record, result.estimator.equation.motion
    t = np.arange(record.u.size) * record.dt
    sections = [Section("Input and motion", svg=svg(motion_figure(record, own.speed)))]
    if result.track is not None:
        sections.insert(0, Section("Estimates", svg=svg(estimate_figure(t, result.track, None))))
        sections.append(Section("Status", svg=svg(status_figure(t, result.track.status))))
    if result.fit is not None:
        used = t[record.u.size - result.fit.samples :]
        figure = residual_figure(used, result.fit.residual, unit=own.force)
        sections.append(Section("Residual of the filtered equation", svg=svg(figure)))
    return sections
