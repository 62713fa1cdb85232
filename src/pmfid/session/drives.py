"""Machines with friction: from a record and a configuration to a result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from pmfid.encoder import Encoder
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.adequacy import Adequacy
from pmfid.estimators.auto import AUTO, Choice, choose, first_choice
from pmfid.estimators.base import Estimator
from pmfid.estimators.batch import BatchEstimator
from pmfid.estimators.configuration import like, made
from pmfid.estimators.identifiable import check_identifiable
from pmfid.estimators.iv import IV, RIV
from pmfid.estimators.ls import LS
from pmfid.estimators.output_error import OE
from pmfid.estimators.plants import plant_of
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.registry import ESTIMATORS
from pmfid.estimators.results import Columns
from pmfid.estimators.track import Track
from pmfid.estimators.zeros import choose_prefilter_zeros
from pmfid.judge.drive import examined, judge, recent
from pmfid.judge.free_run import FreeRun, drive_run
from pmfid.judge.spread import model_spread
from pmfid.models.drive import EquationModel
from pmfid.models.equation import LATE
from pmfid.session.config import Axis, check_sampling
from pmfid.session.diagnosis import check_direction, diagnose
from pmfid.session.kinds import Kind, Progress, method_of, settings, simulator
from pmfid.session.outliers import Believed, believed
from pmfid.session.records import Record, read_record
from pmfid.session.result import DriveResult
from pmfid.session.stored import Stored
from pmfid.status import Status, status_names
from pmfid.types import Counts, Floats

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
        mistake = check_direction(believed_of(data, axis).record, axis)
        if mistake:
            raise UsageError(mistake)

    def mistake(self, data: Record, axis: Axis) -> str:
        known = believed_of(data, axis)
        return diagnose(known.record, axis) or known.told

    def estimate(self, data: Record, axis: Axis, progress: Progress | None = None) -> DriveResult:
        known = believed_of(data, axis)
        result = self._estimate(known.record, axis, progress)
        status = tuple(dict.fromkeys((*known.status, *result.status)))
        return replace(result, status=status, notes=tuple(filter(None, (known.told, *result.notes))))

    def free_runs(self, data: Record, axis: Axis, theta: Floats) -> list[FreeRun]:
        known = believed_of(data, axis)
        method = simulator(axis, data.dt, data.resolution)
        run = drive_run(method, theta, known.record.u, known.record.counts, data.name)
        return [replace(run, notes=(*filter(None, (known.told,)), *run.notes))]

    def check_known(self, stored: Stored, data: Record, axis: Axis) -> None:
        equation = axis.model.make().equation
        stored.check_known("input_gain", equation.input_gain)
        stored.check_equation(equation.text)

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


def believed_of(record: Record, axis: Axis) -> Believed:
    return believed(record) if axis.encoder.guard and plant_of(axis.model.make().equation).rests else Believed(record)


def make_estimator(axis: Axis, record: Record) -> Estimator:
    """The estimator that a configuration asks for, at the record's sample period and resolution."""
    check_sampling(axis, record.dt)
    model = axis.model.make()
    first = "bcls" if model.equation.without_simulation else "output-error" if model.equation.further else "iv"
    cls = ESTIMATORS[method_of(axis, first)]
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
    seen = like(LS, batch, model=batch.model.simple, prefilter_zeros=None) if _by_motion(estimator) else batch
    columns = seen.columns(record.u, record.counts)
    check_identifiable(columns, seen.names, seen.least_part)
    if isinstance(estimator, RecursiveEstimator):
        return _recursive(estimator, record, columns, progress)
    fit = choice.fit if choice else batch.fit(record.u, record.counts)
    asked = all_known(estimator, record, fit.theta, fit.theta_std)
    known, spread = _spread(asked[0], record, asked[3], asked[4], choice.adequacy if choice else None)
    spread = np.r_[spread, np.full(fit.theta.size - spread.size, np.nan)]  # of parameters it is not linear in
    flags, notes = judge(*asked, known)
    if axis.estimator.window is not None and not isinstance(estimator, OE):
        notes = (*notes, f'{estimator.method} simulates no windows: window is not used; set method = "output-error"')
    if axis.estimator.forgetting < 1 and axis.estimator.method != AUTO:
        notes = (*notes, f"{estimator.method} is an off-line method: forgetting is not used")
    notes = (*record.notes, *fit.notes, *notes, *Status(fit.status).advice)
    status = tuple(dict.fromkeys((*status_names(fit.status), *flags)))  # both may tell of a jump
    found = fit.theta, fit.theta_std, status, notes
    return DriveResult(estimator, *found, record, fit.relative_error, fit=fit, model_spread=spread)


def _spread(
    estimator: Estimator, record: Record, theta: Floats, std: Floats, known: Adequacy | None
) -> tuple[Adequacy | None, Floats]:
    """What the counts say on the model, if anything, and by how much what it lacks may move the estimate (p,), NaN
    where that is not known. known: the former, where it is known."""
    unknown = np.full(theta.size, np.nan)
    try:
        found = examined(estimator, record.u, record.counts, theta, known)
    except NotIdentifiableError:
        return None, unknown
    if found is None:
        return None, unknown
    part = recent(estimator, record.u.size)
    return found, model_spread(estimator, record.u[part], record.counts[part], theta, std, found)


def all_known(
    estimator: Estimator, record: Record, theta: Floats, std: Floats
) -> tuple[Estimator, Floats, Counts, Floats, Floats]:
    """What `judge` asks, with the parameters that the equation is not linear in known as they were found."""
    equation = estimator.equation
    p = len(equation.names)
    if not equation.further:
        return estimator, record.u, record.counts, theta, std
    found = like(type(estimator), estimator, model=EquationModel(equation.known_at(theta[p:])))
    return found, record.u, record.counts, theta[:p], std[:p]


def _by_motion(estimator: Estimator) -> bool:
    """Are there regressors that only a simulated motion gives?"""
    return any(term.shape is not None and term.shape.of_speed for term in estimator.equation.shaped)


def _batch_twin(estimator: Estimator) -> BatchEstimator:
    """The off-line method on the same columns."""
    if isinstance(estimator, BatchEstimator):
        return estimator
    if isinstance(estimator, RIV):
        if _by_motion(estimator):
            return like(IV, estimator, prefilter_zeros=None)
        model = estimator.model.at_dead_time(0.0) if late_of(estimator) is not None else estimator.model
        return like(LS, estimator, model=model, prefilter_zeros=None)
    twin = like(ESTIMATORS["bcls" if estimator.instrumental else "ls"], estimator)
    if not isinstance(twin, BatchEstimator):
        raise UsageError(f"{estimator.method} has no off-line method beside it")
    return twin


def late_of(estimator: Estimator) -> int | None:
    """The parameter that is the dead time, where it is to be found."""
    return estimator.equation.roles[LATE]


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
    late, free = late_of(estimator), track.theta
    if _by_motion(estimator):
        simulating = like(IV, estimator, prefilter_zeros=None, precision="float64")
        columns = simulating.columns_at(theta, record.u, record.counts)
    elif late is not None:  # the equation at the dead time that was found, which has no unknown for it
        known = estimator.model.at_dead_time(max(0.0, float(theta[late])))
        columns = like(LS, estimator, model=known, prefilter_zeros=None).columns(record.u, record.counts)
        free = np.delete(free, late, axis=1)
    relative = _relative_error(columns, free, track.status)
    occurred = int(np.bitwise_or.reduce(track.status)) & int(Status.INVALID_INPUT | Status.COUNT_JUMP | Status.RESET)
    closer = Status.UNMODELLED | Status.FEEDBACK | Status.DEAD_TIME  # `judge` looks closer at these
    held = occurred | (last & ~int(Status.SETTLING | closer))
    adequacy, spread = _spread(estimator, record, theta, std, None)
    flags, notes = judge(estimator, record.u, record.counts, theta, std, adequacy)
    status = tuple(dict.fromkeys((*status_names(held), *flags)))
    notes = (*record.notes, *notes, *Status(held).advice)
    return DriveResult(estimator, theta, std, status, notes, record, relative, track=track, model_spread=spread)


def _relative_error(columns: Columns, theta: Floats, status: NDArray[np.uint32]) -> float:
    """Of the filtered equation, each sample with the estimate of its time."""
    known = columns.used & ((status & (Status.SETTLING | Status.STARTING)) == 0)
    rows = known[columns.used]
    z = columns.z[rows]
    with np.errstate(over="ignore", invalid="ignore"):  # of a track that has diverged: infinite is right, and no result
        residual = z - np.sum(columns.phi[rows] * theta[known], axis=1)
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
