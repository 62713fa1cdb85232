"""The figure of each kind of result, as `plot` of it gives it: that of the report which says most at a glance."""

from __future__ import annotations

import io
from functools import singledispatch
from typing import cast

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from pmfid._estimate import Estimate
from pmfid.errors import PmfidError, UsageError
from pmfid.estimators.friction_curve import FrictionCurve
from pmfid.estimators.known import Posterior, Seen
from pmfid.estimators.results import Fit
from pmfid.estimators.track import Track, Tracks
from pmfid.judge.correlations import make_balance
from pmfid.monitor.monitor import Monitor
from pmfid.report.check_figures import simulation_figure
from pmfid.report.figures import estimate_figure, figure_style, residual_figure
from pmfid.report.friction import curve_figure
from pmfid.report.monitored_figures import calibration_figure
from pmfid.report.notebook_figures import SAMPLES, bars_figure, experiment_figure, fleet_figure, with_samples
from pmfid.report.process import bode_of, output_figure, step_figure
from pmfid.report.record import motion_figure
from pmfid.report.terms import friction_figure
from pmfid.report.validation import horizon_figure, run_figure
from pmfid.session.result import DriveResult, ProcessResult
from pmfid.session.terms import TermSearch
from pmfid.session.validation import Validation
from pmfid.transfer.experiment import Experiment
from pmfid.transfer.process import Process

#: Of a figure in a notebook: 9 inches are 900 pixels.
DPI = 100


class Drawing(Figure):
    """A figure that a notebook shows by itself, also where nobody has imported pyplot."""

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        with figure_style():
            self.savefig(buffer, format="png", dpi=DPI)
        return buffer.getvalue()


def figure_of(shown: object, **options: object) -> Drawing:
    """The figure of a result; options: the keywords of the function for its kind below. Raises UsageError for others,
    and for what has no figure."""
    try:
        figure = _draw(shown, **options)
    except TypeError as error:
        if "unexpected keyword" in str(error):
            raise UsageError(f"the figure of {type(shown).__name__} has no such option: {error}") from None
        raise
    figure.__class__ = Drawing  # whoever made it
    return cast(Drawing, figure)


@singledispatch
def _draw(shown: object) -> Figure:
    raise UsageError(f"{type(shown).__name__} has no figure; plot what was estimated")


@_draw.register
def _drive(result: DriveResult) -> Figure:
    """The estimates over time of a recursive method, else how the simulation follows the motion; where nothing can be
    simulated, the motion."""
    if result.track is not None:
        return estimate_figure(np.arange(result.samples) * result.record.dt, result.track)
    try:
        theta = result.theta[: len(result.estimator.names)]  # without a gain of the input that was found
        balance = make_balance(result.estimator, result.record.u, result.record.counts, theta)
    except PmfidError:
        balance = None
    if balance is None:
        return motion_figure(result.record, result.estimator.equation.motion.speed)
    return simulation_figure(balance)


@_draw.register
def _process_result(result: ProcessResult) -> Figure:
    """Measured and simulated output; of an unstable process the frequency response."""
    return bode_of(result.process, result.estimator.dt) if result.fit is None else output_figure(result)


@_draw.register
def _fit(fit: Fit, t: ArrayLike | None = None) -> Figure:
    """The residual; t: (n,) times of the samples in use [s], None: their numbers."""
    time = np.arange(fit.residual.size) if t is None else t
    figure = residual_figure(time, fit.residual, unit="unit of the target")
    return with_samples(figure) if t is None else figure


@_draw.register
def _track(track: Track, t: ArrayLike | None = None, nominal: dict[str, ArrayLike] | None = None) -> Figure:
    """The estimates; t: (n,) times [s], None: numbers of the samples; nominal: values by name to compare with."""
    figure = estimate_figure(np.arange(track.status.size) if t is None else t, track, nominal)
    return with_samples(figure) if t is None else figure


@_draw.register
def _tracks(tracks: Tracks, t: ArrayLike | None = None) -> Figure:
    """The estimates of all axes; t: (m,) times of the samples that were kept [s], None: their numbers."""
    return fleet_figure(tracks.samples if t is None else t, tracks, SAMPLES if t is None else "time [s]")


@_draw.register(Posterior)
@_draw.register(Seen)
@_draw.register(Estimate)
def _bars(shown: Posterior | Seen | Estimate) -> Figure:
    """The parameters with two standard deviations."""
    columns = shown.to_frame()
    return bars_figure(*(columns[name].to_list() for name in ("parameter", "unit", "value", "std")))


@_draw.register
def _curve(found: FrictionCurve) -> Figure:
    return curve_figure(found)


@_draw.register
def _terms(found: TermSearch) -> Figure:
    return friction_figure(found)


@_draw.register
def _validation(found: Validation, record: int | None = None) -> Figure:
    """Measured and simulated output of a record, by its number; None: of a single one, or the errors of all."""
    if record is None and len(found.runs) > 1:
        return horizon_figure(found)
    return run_figure(found.runs[record or 0], found.unit)


@_draw.register
def _process(process: Process, dt: float | None = None) -> Figure:
    """The step response; with a sample period [s] the frequency response up to half its rate."""
    return step_figure(process) if dt is None else bode_of(process, dt)


@_draw.register
def _experiment(experiment: Experiment) -> Figure:
    return experiment_figure(experiment)


@_draw.register
def _monitor(monitor: Monitor) -> Figure:
    """False alarms over the threshold, of each detector."""
    return calibration_figure(monitor.calibration.tails, monitor.watch.detector, monitor.watch.mtbf_hours)
