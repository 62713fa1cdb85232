"""The way from a record of a drive to a result."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from pmfid.config.axis import Axis, check_sampling
from pmfid.diagnostics.free_run import FreeRun, drive_run
from pmfid.diagnostics.verdict import Verdict, verdict
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.auto import AUTO, choose
from pmfid.estimators.base import Estimator, Simulating
from pmfid.estimators.batch import BatchEstimator, check_identifiable
from pmfid.estimators.configuration import like
from pmfid.estimators.cutoff import choose_cutoff, choose_prefilter_zeros
from pmfid.estimators.iv import IV, RIV
from pmfid.estimators.known import Known, Posterior
from pmfid.estimators.ls import LS
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.registry import ESTIMATORS
from pmfid.estimators.results import Columns, Track, join_tracks
from pmfid.estimators.stretches import gaps_in, parts_of
from pmfid.findings import MOVE, Finding, advise, codes, make_notes, sort_findings
from pmfid.io.tables import Table
from pmfid.models.shapes import Square
from pmfid.pipeline import checks
from pmfid.pipeline.checks.inputs import note_one_level
from pmfid.pipeline.fitted import identify_by_fit, make_fit, uses_fit
from pmfid.pipeline.kinds import Kind, Progress, make_method, method_of
from pmfid.pipeline.known import finds_gain, known_of, put_together, set_any_gain, set_gain, try_both_signs
from pmfid.pipeline.result import DriveResult
from pmfid.pipeline.stored import Stored
from pmfid.records.joining import join_records, make_even
from pmfid.records.outliers import repair_as_configured
from pmfid.records.record import Record, read_record, record_of
from pmfid.status import Status, status_findings
from pmfid.types import Floats

if TYPE_CHECKING:
    from pmfid._estimate import Estimate

DRIVES_CHUNK = 100_000
#: Greatest part of the motion that a valid simulation leaves unexplained.
DRIVES_FOLLOWED = 0.2

#: Samples of a record over which the parameters' correlation counts as constant.
KNOWN_PIECE = 200


class Drives(Kind[Record]):
    """Machines with friction and user-defined equations, which have one record of counts."""

    on_line: ClassVar[str] = "riv"

    def read(self, paths: Sequence[Path], axis: Axis) -> Record:
        place_matters = axis.model.make().equation.place_matters
        return join_records([read_record(path, axis) for path in paths], place_matters)

    def read_table(self, table: Table, axis: Axis) -> Record:
        return record_of(table, axis)

    def name_and_samples(self, data: Record) -> tuple[str, int]:
        return data.name, int(data.u.size)

    def prepare_axis(self, data: Record, axis: Axis) -> Axis:
        axis = match_kind(data, axis)
        if axis.estimator.cutoff is not None or data.counts.size == 0:
            return axis
        known = repair_as_configured(make_even(data), axis).record.measured
        either = [set_gain(axis, 1.0), set_gain(axis, -1.0)] if finds_gain(axis) else [axis]
        models = [one.model.make() for one in either]
        encoder, forgetting = axis.encoder.make_encoder(data.resolution), axis.estimator.forgetting
        with _name_gaps(known):
            cutoff = choose_cutoff(models, encoder, data.dt, known.u, known.counts, forgetting)
        return axis.model_copy(update={"estimator": axis.estimator.model_copy(update={"cutoff": cutoff})})

    def settle_axis(self, data: Record, axis: Axis) -> Axis:
        return match_kind(data, axis) if uses_fit(axis) else self.prepare_axis(data, axis)

    def check_record(self, data: Record, axis: Axis) -> tuple[Finding, ...]:
        return checks.check_record(data, axis) or repair_as_configured(data, axis).findings

    def estimate(self, data: Record, axis: Axis, progress: Progress | None = None) -> DriveResult:
        _check_steps(data, axis)
        known = repair_as_configured(data, axis)
        if uses_fit(axis):
            result = try_both_signs(axis, lambda own: identify_by_fit(data, own, axis))
        else:
            used = known.record.measured
            with _name_gaps(used):
                result = try_both_signs(axis, lambda own: _identify_by_method(used, own, axis, progress))
            result = replace(result, record=known.record)
        result = replace(result, theta_std=np.hypot(result.theta_std, _period_errors(result, data, axis)))
        scaling = "the gain was estimated" if finds_gain(axis) else "all parameters scale with the gain"
        return result.with_findings(*known.findings, *_clock_findings(data), *note_one_level([data.u], scaling))

    def free_runs(self, data: Record, axis: Axis, theta: Floats) -> list[FreeRun]:
        known, axis = repair_as_configured(data, axis), match_kind(data, axis)
        run = drive_run(make_fit(axis, data), theta, known.record.u, known.record.counts, data.name, known.used)
        return [replace(run, notes=(*filter(None, (known.sentence,)), *run.notes))]

    def check_known(self, stored: Stored, data: Record, axis: Axis) -> None:
        equation = axis.model.make().equation
        stored.check_known("input_gain", equation.input_gain)
        stored.check_equation(equation.text)

    def unit_of_output(self, axis: Axis) -> str:
        return axis.model.make().equation.motion.travel if axis.model.kind == "drive" else ""


def _identify_by_method(data: Record, axis: Axis, asked: Axis, progress: Progress | None) -> DriveResult:
    """Return the result of the method in `axis`. The configured axis `asked` contains the prior information."""
    estimator, reason = make_estimator(axis, data), ""
    restarts = _describe_restarts(data, estimator)
    if axis.estimator.method == AUTO:
        estimator, reason = choose(estimator, data.u, data.counts, axis.estimator.forgetting)
    result = _estimate(estimator, data, asked, progress)
    _check_known(result)
    return result.with_findings(*make_notes("method", [*restarts, *([f"auto chose {reason}"] if reason else [])]))


def _describe_restarts(record: Record, estimator: Estimator) -> list[str]:
    """Return a note on the samples that gaps cost, or no note without gaps."""
    gaps, settle = len(gaps_in(record.u)), estimator.settle_samples
    if not gaps:
        return []
    settle *= 2 if isinstance(estimator, Simulating) else 1
    left = sum(max(0, part.stop - part.start - settle) for part in parts_of(record.u)) / record.u.size
    return [
        f"the filters of {estimator.method} restart after each of {gaps} gaps, which leaves {left:.0%} of the samples; "
        f'method = "auto" uses them all'
    ]


@contextmanager
def _name_gaps(record: Record) -> Iterator[None]:
    """Name the gaps of a record in an error of a method whose filters restart after each gap."""
    try:
        yield
    except NotIdentifiableError as error:
        if not (gaps := len(gaps_in(record.u))):
            raise
        remedy = f'the filters restart after each of {gaps} gaps, and method = "auto" estimates through gaps'
        raise NotIdentifiableError(f"{error}. Advice: {remedy}") from error


def match_kind(record: Record, axis: Axis) -> Axis:
    """Return the axis as a rotary axis if the file says that its output is an angle.

    Raises UsageError if parameters of a linear axis are known.
    """
    if not record.rotary or axis.model.kind != "drive" or axis.model.axis == "rotary":
        return axis
    if axis.estimator.given or axis.estimator.prior or axis.monitor.nominal:
        raise UsageError(
            'the file has an angle for output: write [model] axis = "rotary", and inertia in place of a known mass'
        )
    return axis.model_copy(update={"model": axis.model.model_copy(update={"axis": "rotary"})})


def _check_steps(record: Record, axis: Axis) -> None:
    """Raise UsageError for a method or model that needs even samples if the record has others."""
    if record.steps is None or uses_fit(axis):
        return
    estimator = _construct(set_any_gain(axis), replace(record, steps=None))
    known = isinstance(estimator, RecursiveEstimator) and bool(axis.estimator.given or axis.estimator.prior)
    try:
        _construct(set_any_gain(axis), record)
    except UsageError:
        known = True
    if known:
        raise UsageError(
            f"the steps of the clock vary by {record.jitter:.0%}, and {estimator.method} with these settings needs "
            'even samples; set [estimator] method = "auto" without forgetting, which takes each step as it was, or log '
            "at a fixed rate"
        )


def make_estimator(axis: Axis, record: Record) -> Estimator:
    """Return the configured estimator for the record's sample period and resolution."""
    estimator = _construct(axis, record)
    if type(estimator).instrumental and axis.estimator.prefilter_zeros is None:
        return replace(estimator, prefilter_zeros=choose_prefilter_zeros(estimator, record.u, record.counts))
    return estimator


def _construct(axis: Axis, record: Record) -> Estimator:
    check_sampling(axis, record.dt)
    equation = axis.model.make().equation
    first = "bcls" if equation.without_simulation else "fit" if equation.further else "iv"
    cls = ESTIMATORS[method_of(axis, first)]
    return make_method(cls, axis, axis.encoder.make_encoder(record.resolution), record.dt, record.steps)


def _check_known(result: DriveResult) -> None:
    """Raise NotIdentifiableError for a mass below its standard deviation, or for parameters that explain nothing."""
    _check_sizes(result.estimator, result.theta, result.theta_std, advise(result.findings))
    if not np.isfinite(result.relative_error):
        raise NotIdentifiableError(advise(result.findings))


def _check_sizes(estimator: Estimator, theta: Floats, theta_std: Floats, advice: str = MOVE) -> None:
    """Raise NotIdentifiableError, with advice, if the mass is below its standard deviation."""
    leading = estimator.equation.leading
    mass, std = theta[leading], theta_std[leading]
    if not np.all(np.isfinite((*theta, *theta_std))):
        raise NotIdentifiableError(f"a parameter or its standard deviation is not finite; {MOVE}")
    if not std < mass:
        name = estimator.names[leading]
        raise NotIdentifiableError(
            f"{name} comes out as {mass:.3g} with a standard deviation of {std:.2g}. Advice: {advice}"
        )


def _check_error(estimator: Estimator, relative: float, judgement: Verdict) -> list[Finding]:
    """Return a note if the error of the filtered equation exceeds the input.

    The steps of a coarse encoder in the acceleration can cause a large error even at the right parameters. Raises
    NotIdentifiableError if no simulated motion confirms the parameters.
    """
    if not relative > 1:
        return []
    sentence, fitted = f"the filtered equation leaves {100 * relative:.3g} % of the input", judgement.fitted
    if fitted is not None and fitted.left < DRIVES_FOLLOWED:
        left = 100 * fitted.left
        return make_notes(
            "relative_error",
            [f"{sentence} unexplained, by the encoder's steps; the motion of the fit leaves only {left:.2g} %"],
        )
    if fitted is not None or estimator.equation.without_simulation or "unmodelled" in codes(judgement.judged):
        advice = advise(judgement.judged, "check columns and scales of input and output, or lower the cutoff")
        raise NotIdentifiableError(f"{sentence} unexplained, more than a model without motion. Advice: {advice}")
    return []


def _estimate(estimator: Estimator, record: Record, axis: Axis, progress: Progress | None) -> DriveResult:
    batch = _batch_twin(estimator)
    seen = like(LS, batch, model=batch.model.simple, prefilter_zeros=None) if _needs_simulation(estimator) else batch
    columns = seen.columns(record.u, record.counts)
    check_identifiable(columns, seen.names, seen.least_part)
    known = known_of(axis, estimator)
    if isinstance(estimator, RecursiveEstimator):
        return _recursive(estimator, record, columns, progress, known, axis)
    fit = batch.fit(record.u, record.counts)
    if known is not None and known.find_gain:
        before = estimator.equation.input_gain
        known, there = known.rescale(fit)
        estimator, residual = known.estimator, fit.residual * known.estimator.equation.input_gain / before
        fit = replace(fit, theta=there.theta, theta_cov=there.theta_cov, residual=residual)
    if known is None:  # a refused estimate needs no judgement
        _check_sizes(estimator, fit.theta, fit.theta_std)
    judgement = verdict(estimator, record.u, record.counts, fit.theta, fit.theta_std, axis.estimator.tolerance)
    spread = judgement.spread
    unused = []
    if axis.estimator.forgetting < 1 and axis.estimator.method != AUTO:
        unused.append(f"{estimator.method} is an off-line method and does not use forgetting")
    notes = make_notes("record", record.notes) + make_notes("method", fit.notes) + make_notes("unused", unused)
    notes += _check_error(estimator, fit.relative_error, judgement)
    findings = sort_findings((*status_findings(fit.status), *judgement.findings, *notes))
    found = fit.theta, fit.theta_std, findings
    result = DriveResult(estimator, *found, record, fit.relative_error, judgement.matter, fit=fit, model_spread=spread)
    return result if known is None else put_together(result, known, axis, known.combine(fit, spread))


def _clock_findings(record: Record) -> tuple[Finding, ...]:
    """Return a finding on a clock that drifts."""
    if not record.drifts:
        return ()
    varies = f"the steps of the clock vary by {record.jitter:.0%}"
    sentence = f"{varies} and drift, and the record does not show which clock is right"
    return (Finding("uneven_clock", sentence, "log the times at which the drive takes the samples"),)


def _period_errors(result: DriveResult, record: Record, axis: Axis) -> Floats:
    """Return the standard errors (p,) from the sample period.

    A parameter with an nth derivative is proportional to the nth power of the period. Known parameters pass their share
    on to the others.
    """
    equation = result.estimator.equation
    powers = [2 if isinstance(term.shape, Square) else term.derivative for term in equation.unknown]
    powers += [1] * (result.theta.size - len(powers))  # times and the Stribeck speed
    if axis.estimator.given or axis.estimator.prior:
        powers = [2] * result.theta.size
    return np.asarray(powers) * record.dt_error * np.abs(result.theta)


def _needs_simulation(estimator: Estimator) -> bool:
    """Return whether the equation has regressors that only a simulated motion gives."""
    return any(term.shape is not None and term.shape.of_speed for term in estimator.equation.shaped)


def _batch_twin(estimator: Estimator) -> BatchEstimator:
    """Return the off-line method for the columns of an on-line method."""
    if isinstance(estimator, BatchEstimator):
        return estimator
    if isinstance(estimator, RIV):
        if _needs_simulation(estimator):
            return like(IV, estimator, prefilter_zeros=None)
        return like(LS, estimator, prefilter_zeros=None)
    twin = like(ESTIMATORS["bcls" if estimator.instrumental else "ls"], estimator)
    if not isinstance(twin, BatchEstimator):
        raise UsageError(f"the method {estimator.method} has no off-line counterpart; use another method")
    return twin


def _recursive(
    estimator: RecursiveEstimator,
    record: Record,
    columns: Columns,
    progress: Progress | None,
    known: Known | None,
    axis: Axis,
) -> DriveResult:
    method: Estimator = estimator
    # the record is repaired, and without the guard each estimate is in time with its sample
    estimator = replace(estimator, encoder=replace(estimator.encoder, guard=False))
    track, reported = _run(estimator, record, progress, known)
    last = int(track.status[-1])
    if last & Status.STARTING:
        raise NotIdentifiableError(
            "the record ends before its motion determines every parameter, so no estimate exists; record longer"
        )
    theta, std = track.theta[-1], track.theta_std[-1]
    if _needs_simulation(estimator):
        simulating = like(IV, estimator, prefilter_zeros=None, precision="float64")
        columns = simulating.columns_at(theta, record.u, record.counts)
    relative = _relative_error(columns, track.theta, track.status)
    occurred = int(np.bitwise_or.reduce(track.status)) & int(Status.SAMPLE_REJECTED | Status.RESET)
    held = occurred | (last & ~int(Status.SETTLING | Status.DISTORTED | Status.STANDSTILL))
    last_estimate: Estimate | Posterior = estimator.estimate
    if known is not None and known.find_gain:
        known, last_estimate = known.rescale(last_estimate)
        method, theta, std = known.estimator, last_estimate.theta, last_estimate.theta_std
    judgement = verdict(method, record.u, record.counts, theta, std, axis.estimator.tolerance)
    notes = make_notes("record", record.notes) + _check_error(method, relative, judgement)
    findings = sort_findings((*status_findings(held), *judgement.findings, *notes))
    found = method, theta, std, findings, record, relative, judgement.matter
    result = DriveResult(*found, track=reported, model_spread=judgement.spread)
    return (
        result if known is None else put_together(result, known, axis, known.combine(last_estimate, judgement.spread))
    )


def _relative_error(columns: Columns, theta: Floats, status: NDArray[np.uint32]) -> float:
    """Return the relative error of the filtered equation, with the estimate at the time of each sample."""
    known = columns.used & ((status & (Status.SETTLING | Status.STARTING)) == 0)
    rows = known[columns.used]
    z = columns.z[rows]
    with np.errstate(over="ignore", invalid="ignore"):  # a diverged track has an infinite error and no result
        residual = z - np.sum(columns.phi[rows] * theta[known], axis=1)
        return float(np.linalg.norm(residual) / np.linalg.norm(z))


def _run(
    estimator: RecursiveEstimator, record: Record, progress: Progress | None, known: Known | None
) -> tuple[Track, Track]:
    """Return the tracks of a run over the record, without and with prior information.

    A run in several chunks gives the numbers of a single run. In a gap the estimate does not change.
    """
    n, parts, reported = record.u.size, list[Track](), list[Track]()
    chunk = DRIVES_CHUNK if known is None else KNOWN_PIECE
    edges = [0, *(edge for gap in gaps_in(record.u) for edge in gap), n]
    for place, (first, last) in enumerate(pairwise(edges)):
        if place % 2 == 1:
            parts.append(parts[-1].repeat_last(last - first, Status.SETTLING))
            reported.append(reported[-1].repeat_last(last - first, Status.SETTLING))
            estimator.gap(int(record.counts[last]))
            continue
        for start in range(first, last, chunk):
            part = slice(start, min(start + chunk, last))
            steps = None if record.steps is None else record.steps.before[part]
            parts.append(estimator.run(record.u[part], record.counts[part], steps))
            reported.append(parts[-1] if known is None else known.track(parts[-1], estimator.estimate))
            if progress is not None:
                progress(part.stop / n)
    return join_tracks(parts), join_tracks(reported)
