"""Machines with friction: from a record and a configuration to a result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from pmfid.encoder import Encoder
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.auto import AUTO, Choice, choose, first_choice
from pmfid.estimators.base import Estimator
from pmfid.estimators.batch import BatchEstimator
from pmfid.estimators.configuration import like, made
from pmfid.estimators.identifiable import check_identifiable
from pmfid.estimators.iv import RIV
from pmfid.estimators.ls import LS
from pmfid.estimators.output_error import OE
from pmfid.estimators.plants import plant_of
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.registry import ESTIMATORS
from pmfid.estimators.results import Columns
from pmfid.estimators.track import Track
from pmfid.estimators.zeros import choose_prefilter_zeros
from pmfid.judge.drive import judge
from pmfid.judge.free_run import FreeRun, drive_run
from pmfid.session.config import Axis, check_sampling
from pmfid.session.diagnosis import check_direction, diagnose
from pmfid.session.kinds import Kind, Progress, method_of, settings, simulator
from pmfid.session.outliers import Believed, believed
from pmfid.session.records import Record, read_record
from pmfid.session.result import DriveResult
from pmfid.session.stored import Stored
from pmfid.status import Status, status_names
from pmfid.types import Floats

CHUNK = 100_000


class Drives(Kind[Record]):
    """Machines with friction, and equations of the user's own: one record of counts."""

    on_line: ClassVar[str] = "riv"

    def read(self, paths: Sequence[Path], axis: Axis, quantize: float | None = None) -> Record:
        if len(paths) > 1:
            raise UsageError("several records make one estimate of a transfer function only; give one record")
        return read_record(paths[0], axis, quantize)

    def name_and_samples(self, data: Record) -> tuple[str, int]:
        return data.name, int(data.u.size)

    def check(self, data: Record, axis: Axis) -> None:
        mistake = check_direction(_believed(data, axis).record, axis)
        if mistake:
            raise UsageError(mistake)

    def mistake(self, data: Record, axis: Axis) -> str:
        known = _believed(data, axis)
        return diagnose(known.record, axis) or known.told

    def estimate(self, data: Record, axis: Axis, progress: Progress | None = None) -> DriveResult:
        known = _believed(data, axis)
        result = self._estimate(known.record, axis, progress)
        status = tuple(dict.fromkeys((*known.status, *result.status)))
        return replace(result, status=status, notes=tuple(filter(None, (known.told, *result.notes))))

    def free_runs(self, data: Record, axis: Axis, theta: Floats) -> list[FreeRun]:
        known = _believed(data, axis)
        method = simulator(axis, data.dt, data.resolution)
        run = drive_run(method, theta, known.record.u, known.record.counts, data.name)
        return [replace(run, notes=(*filter(None, (known.told,)), *run.notes))]

    def check_known(self, stored: Stored, data: Record, axis: Axis) -> None:
        stored.check_known("input_gain", axis.model.make().equation.input_gain)

    def unit_of_output(self, axis: Axis) -> str:
        return "m" if axis.model.kind == "drive" else ""

    def _estimate(self, data: Record, axis: Axis, progress: Progress | None) -> DriveResult:
        estimator, reason, choice = make_estimator(axis, data), "", None
        if axis.estimator.method == AUTO and axis.estimator.forgetting == 1:
            choice = first_choice(estimator, data.u, data.counts)
            estimator, reason = choice.estimator, choice.reason
        elif axis.estimator.method == AUTO:
            estimator, reason = choose(estimator, data.u, data.counts, axis.estimator.forgetting)
        result = _estimate(estimator, data, axis, progress, choice)
        _check_known(result)
        return replace(result, notes=(f"auto chose {reason}", *result.notes)) if reason else result


def _believed(record: Record, axis: Axis) -> Believed:
    return believed(record) if axis.encoder.guard and plant_of(axis.model.make().equation).rests else Believed(record)


def make_estimator(axis: Axis, record: Record) -> Estimator:
    """The estimator that a configuration asks for, at the record's sample period and resolution."""
    check_sampling(axis, record.dt)
    model = axis.model.make()
    cls = ESTIMATORS[method_of(axis, "bcls" if model.equation.without_simulation else "iv")]
    known = axis.encoder
    encoder = Encoder(
        record.resolution, standstill_time=known.standstill_time, max_speed=known.max_speed, guard=known.guard
    )
    own = {"model": model, "encoder": encoder, "dt": record.dt, "cutoff": axis.estimator.cutoff}
    estimator = made(cls, own | settings(axis, cls))
    if cls.instrumental and axis.estimator.prefilter_zeros is None:
        return replace(estimator, prefilter_zeros=choose_prefilter_zeros(estimator, record.u, record.counts))
    return estimator


def _check_known(result: DriveResult) -> None:
    """A mass that is not known to its own size, or is negative, is no estimate, nor is one of a model that simulates
    another motion."""
    leading = result.estimator.equation.leading
    mass, std = result.theta[leading], result.theta_std[leading]
    numbers = (*result.theta, *result.theta_std, result.relative_error)
    if not np.all(np.isfinite(numbers)):
        raise NotIdentifiableError(
            "a parameter, or how well it is known, is beyond numbers: this record cannot identify it "
            "(record a motion with reversals and varying speed)"
        )
    advice = "; ".join(result.notes) or "record a motion with reversals and varying speed"
    if not std < mass:
        raise NotIdentifiableError(
            f"{result.estimator.names[leading]} comes out as {mass:.3g} with a standard deviation of {std:.2g}: this "
            f"record cannot identify it ({advice})"
        )
    if "not_followed" in result.status:
        raise NotIdentifiableError(f"this record does not fit the model: {advice}")


def _estimate(
    estimator: Estimator, record: Record, axis: Axis, progress: Progress | None, choice: Choice | None
) -> DriveResult:
    batch = _batch_twin(estimator)
    columns = batch.columns(record.u, record.counts)
    check_identifiable(columns, batch.names, batch.least_part)
    if isinstance(estimator, RecursiveEstimator):
        return _recursive(estimator, record, columns, progress)
    fit = choice.fit if choice else batch.fit(record.u, record.counts)
    known = choice.adequacy if choice else None
    flags, notes = judge(estimator, record.u, record.counts, fit.theta, fit.theta_std, known)
    if axis.estimator.window is not None and not isinstance(estimator, OE):
        notes = (*notes, f'{estimator.method} simulates no windows: window is not used; set method = "output-error"')
    if axis.estimator.forgetting < 1 and axis.estimator.method != AUTO:
        notes = (*notes, f"{estimator.method} is an off-line method: forgetting is not used")
    notes = (*record.notes, *fit.notes, *notes, *Status(fit.status).advice)
    status = tuple(dict.fromkeys((*status_names(fit.status), *flags)))  # both may tell of a jump
    return DriveResult(estimator, fit.theta, fit.theta_std, status, notes, record, fit.relative_error, fit=fit)


def _batch_twin(estimator: Estimator) -> BatchEstimator:
    """The off-line method on the same columns."""
    if isinstance(estimator, BatchEstimator):
        return estimator
    if isinstance(estimator, RIV):
        return like(LS, estimator, prefilter_zeros=None)
    twin = like(ESTIMATORS["bcls" if estimator.instrumental else "ls"], estimator)
    if not isinstance(twin, BatchEstimator):
        raise UsageError(f"{estimator.method} has no off-line method beside it")
    return twin


def _recursive(
    estimator: RecursiveEstimator, record: Record, columns: Columns, progress: Progress | None
) -> DriveResult:
    track = _run(estimator, record, progress)
    last = int(track.status[-1])
    if last & Status.STARTING:
        raise NotIdentifiableError(
            "the record ends before there is an estimate: too little motion for every parameter; record longer"
        )
    theta, std = track.theta[-1], track.theta_std[-1]
    relative = _relative_error(columns, track)
    occurred = int(np.bitwise_or.reduce(track.status)) & int(Status.INVALID_INPUT | Status.COUNT_JUMP | Status.RESET)
    held = occurred | (last & ~int(Status.SETTLING | Status.UNMODELLED | Status.FEEDBACK))  # `judge` looks closer
    flags, notes = judge(estimator, record.u, record.counts, theta, std)
    status = tuple(dict.fromkeys((*status_names(held), *flags)))
    notes = (*record.notes, *notes, *Status(held).advice)
    return DriveResult(estimator, theta, std, status, notes, record, relative, track=track)


def _relative_error(columns: Columns, track: Track) -> float:
    """Of the filtered equation, each sample with the estimate of its time."""
    known = columns.used & ((track.status & (Status.SETTLING | Status.STARTING)) == 0)
    rows = known[columns.used]
    z = columns.z[rows]
    with np.errstate(over="ignore", invalid="ignore"):  # of a track that has diverged: infinite is right, and no result
        residual = z - np.sum(columns.phi[rows] * track.theta[known], axis=1)
        return float(np.linalg.norm(residual) / np.linalg.norm(z))


def _run(estimator: RecursiveEstimator, record: Record, progress: Progress | None) -> Track:
    """Over the record in chunks: the same numbers as in one piece."""
    n, parts = record.u.size, []
    for start in range(0, n, CHUNK):
        part = slice(start, start + CHUNK)
        parts.append(estimator.run(record.u[part], record.counts[part]))
        if progress is not None:
            progress(min(1.0, (start + CHUNK) / n))
    fields = ("theta", "variance_factor", "inflation", "innovation", "innovation_variance", "status")
    joined = {name: np.concatenate([getattr(part, name) for part in parts]) for name in fields}
    return Track(parts[0].names, parts[0].units, **joined)
