"""The figure of a result."""

from __future__ import annotations

import io
from collections.abc import Sequence
from functools import singledispatch
from typing import cast

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from pmfid._estimate import Estimate
from pmfid.design.appraisal import Appraisal
from pmfid.design.problem import Design
from pmfid.errors import PmfidError, UsageError
from pmfid.estimators.known import Posterior, Seen
from pmfid.estimators.results import Fit, Track, Tracks
from pmfid.linear.experiment import Experiment
from pmfid.linear.process import Process
from pmfid.monitor.monitor import Monitor
from pmfid.pipeline.encoders import EncoderChoice
from pmfid.pipeline.friction import FrictionCurve
from pmfid.pipeline.result import DriveResult, ProcessResult
from pmfid.pipeline.terms import TermSearch
from pmfid.pipeline.validation import Validation
from pmfid.report.design import motion_figure as designed_figure
from pmfid.report.design import motions_of
from pmfid.report.encoders import encoder_figure
from pmfid.report.figures import (
    COLOURS,
    GREY,
    _finish_time,
    _label,
    _line,
    _words,
    decimation,
    estimate_figure,
    figure_style,
    open_figure,
    residual_figure,
)
from pmfid.report.fleet import FLEET_LISTED
from pmfid.report.friction import curve_figure
from pmfid.report.monitored import chance_figure
from pmfid.report.result import bode_of, motion_figure, output_figure, step_figure
from pmfid.report.validation import horizon_figure, run_figure
from pmfid.status import Status

SAMPLES = "sample [-]"


def with_samples(figure: Figure) -> Figure:
    """Label the time of a figure as sample numbers, for results without a sample period."""
    for axes in figure.axes:
        if axes.get_xlabel() == "time [s]":
            axes.set_xlabel(SAMPLES)
    return figure


def bars_figure(names: Sequence[str], units: Sequence[str], theta: Sequence[float], std: Sequence[float]) -> Figure:
    """Draw each parameter on its own axis, with two standard deviations if they are known."""
    with open_figure(0.3 + 0.85 * len(names), len(names)) as (figure, panels):
        for axes, name, unit, value, bar in zip(panels, names, units, theta, std, strict=True):
            known = np.isfinite(bar)
            axes.errorbar(value, 0, xerr=2 * bar if known else None, fmt="o", color=COLOURS[0], capsize=4)
            axes.set_yticks([0], [_label(name, unit) if unit else _words(name)])
            axes.ticklabel_format(axis="x", useOffset=False)
            axes.locator_params(axis="x", nbins=6)
            axes.set_ylim(-1, 1)
            half = 3 * bar if known and bar > 0 else 0.1 * abs(value) or 1.0
            axes.set_xlim(value - half, value + half)
        figure.supxlabel("value, with two standard deviations", fontsize=10)
    return figure


def fleet_figure(t: ArrayLike, tracks: Tracks, label: str) -> Figure:
    """Draw the estimates of the first axes over t (m,), and the median of all axes."""
    time, single = np.asarray(t, float), np.size(t) == 1
    theta = np.where(tracks.has_status(Status.STARTING)[..., None], np.nan, tracks.theta)
    with open_figure(0.9 + 1.9 * len(tracks.names), len(tracks.names), sharex=True) as (figure, panels):
        for i, (axes, name, unit) in enumerate(zip(panels, tracks.names, tracks.units, strict=True)):
            for one in theta[:FLEET_LISTED, :, i]:
                _line(axes, time, one, color=GREY, lw=0.6, alpha=0.6, marker="." if single else None)
            middle, marker = np.median(theta[..., i], axis=0), "o" if single else None
            _line(axes, time, middle, color=COLOURS[0], label="median of all axes", marker=marker)
            axes.set_ylabel(_label(name, unit))
        _finish_time(panels[-1], time)
        panels[-1].set_xlabel(label)
        panels[0].legend(loc="lower left", bbox_to_anchor=(0, 1), borderaxespad=0.2)
    return figure


def experiment_figure(experiment: Experiment) -> Figure:
    """Draw input, output and reference over time."""
    signals = {"u": experiment.u, "y": experiment.y, "reference": experiment.reference}
    there = {name: values for name, values in signals.items() if values is not None}
    with open_figure(0.9 + 1.7 * len(there), len(there), sharex=True) as (figure, panels):
        for axes, (name, values) in zip(panels, there.items(), strict=True):
            shown = decimation(values)
            axes.plot(experiment.times[shown], values[shown], lw=0.8)
            axes.set_ylabel(name)
        _finish_time(panels[-1], experiment.times)
    return figure


class Drawing(Figure):
    """A figure that a notebook shows by itself, even without an import of pyplot."""

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        with figure_style():
            self.savefig(buffer, format="png")
        return buffer.getvalue()


def figure_of(shown: object, **options: object) -> Drawing:
    """Return the figure of a result.

    `options` are the keywords of the function for the kind of the result in this module. Raises UsageError for other
    keywords, and for results without a figure.
    """
    try:
        figure = _draw(shown, **options)
    except TypeError as error:
        if "unexpected keyword" in str(error):
            raise UsageError(
                f"the figure of {type(shown).__name__} has no such option ({error}); leave the option out"
            ) from None
        raise
    figure.__class__ = Drawing  # figures of other functions get this class, too
    return cast(Drawing, figure)


@singledispatch
def _draw(shown: object) -> Figure:
    raise UsageError(f"{type(shown).__name__} has no figure; plot the result of an estimate")


@_draw.register
def _drive(result: DriveResult) -> Figure:
    """Draw the estimates of a recursive method over time, or the simulated and measured motion of another method.

    If nothing can be simulated, only the measured motion is drawn.
    """
    if result.track is not None:
        return estimate_figure(result.record.times, result.track)
    try:
        return run_figure(result.free_run(), result.estimator.equation.motion.travel)
    except PmfidError:
        return motion_figure(result.record, result.estimator.equation)


@_draw.register
def _process_result(result: ProcessResult) -> Figure:
    """Draw the measured and simulated output, or the frequency response of an unstable process."""
    return bode_of(result.process, result.estimator.dt) if result.fit is None else output_figure(result)


@_draw.register
def _fit(fit: Fit, t: ArrayLike | None = None) -> Figure:
    """Draw the residual over the times t (n,) of the samples in use [s], or over their numbers if t is None."""
    time = np.arange(fit.residual.size) if t is None else t
    figure = residual_figure(time, fit.residual, unit="unit of the target")
    return with_samples(figure) if t is None else figure


@_draw.register
def _track(track: Track, t: ArrayLike | None = None, nominal: dict[str, ArrayLike] | None = None) -> Figure:
    """Draw the estimates over the times t (n,) [s], or over the numbers of the samples if t is None.

    `nominal` has values for comparison by the names of the parameters.
    """
    figure = estimate_figure(np.arange(track.status.size) if t is None else t, track, nominal)
    return with_samples(figure) if t is None else figure


@_draw.register
def _tracks(tracks: Tracks, t: ArrayLike | None = None) -> Figure:
    """Draw the estimates of all axes over the times t (m,) of the kept samples [s], or over their numbers."""
    return fleet_figure(tracks.samples if t is None else t, tracks, SAMPLES if t is None else "time [s]")


@_draw.register(Posterior)
@_draw.register(Seen)
@_draw.register(Estimate)
def _bars(shown: Posterior | Seen | Estimate) -> Figure:
    """Draw the parameters with two standard deviations."""
    columns = shown.to_frame()
    return bars_figure(*(columns[name].to_list() for name in ("parameter", "unit", "value", "std")))


_draw.register(FrictionCurve, curve_figure)
_draw.register(EncoderChoice, encoder_figure)
_draw.register(Experiment, experiment_figure)


@_draw.register
def _terms(found: TermSearch) -> Figure:
    return _drive(found.result)


@_draw.register
def _validation(found: Validation, record: int | None = None) -> Figure:
    """Draw the measured and simulated output of one record, or the errors of all records.

    `record` is the number of the record. None means the only record, or all records.
    """
    if record is None and len(found.runs) > 1:
        return horizon_figure(found)
    return run_figure(found.runs[record or 0], found.unit)


@_draw.register
def _process(process: Process, dt: float | None = None) -> Figure:
    """Draw the step response. With a sample period [s], draw the frequency response up to half the sample rate."""
    return step_figure(process) if dt is None else bode_of(process, dt)


@_draw.register
def _design(design: Design) -> Figure:
    """Draw input and nominal motion, with the limits."""
    return designed_figure(design.problem, {"design": (design.u, design.x, design.v)})


@_draw.register
def _appraisal(appraisal: Appraisal) -> Figure:
    """Draw the figure of all inputs."""
    return designed_figure(appraisal.design.problem, motions_of(appraisal))


@_draw.register
def _monitor(monitor: Monitor) -> Figure:
    """Draw the rate of false alarms over the threshold."""
    return chance_figure(monitor.calibration.chance, monitor.watch.mtbf_hours)
