"""From a record and a configuration to a result: what ties the rooms together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pmfid.encoder import Encoder
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.auto import AUTO, Choice, choose, first_choice
from pmfid.estimators.base import Estimator, like, status_names
from pmfid.estimators.batch import LS, BatchEstimator, Columns, Fit, check_identifiable
from pmfid.estimators.iv import RIV
from pmfid.estimators.recursive import RecursiveEstimator, Track
from pmfid.estimators.registry import ESTIMATORS
from pmfid.estimators.zeros import choose_prefilter_zeros
from pmfid.judge.drive import judge
from pmfid.session.config import Axis, check_sampling
from pmfid.session.diagnosis import check_direction, diagnose
from pmfid.session.records import Record
from pmfid.status import Status

#: Called with the part of the record that is done, 0 to 1.
Progress = Callable[[float], None]

CHUNK = 100_000
#: Flags of results that a mistake in the columns may explain.
SUSPICIOUS = {"implausible", "uncertain", "count_jump", "fallback"}


@dataclass(frozen=True)
class Result:
    """Parameters of a record. theta, theta_std: (p,); relative_error: of the filtered equation at theta;
    status: names of the bits that hold for the result; notes: sentences for people; fit or track: the details."""

    estimator: Estimator
    record: Record
    theta: np.ndarray
    theta_std: np.ndarray
    relative_error: float
    status: tuple[str, ...]
    notes: tuple[str, ...]
    fit: Fit | None = None
    track: Track | None = None

    def to_json(self) -> dict[str, Any]:
        """The object that `--json` prints."""
        estimator = self.estimator
        rows = zip(estimator.names, estimator.units, self.theta, self.theta_std, strict=True)
        return {
            "model": estimator.model.kind,
            "method": estimator.method,
            "samples": int(self.record.u.size),
            "dt": self.record.dt,
            "parameters": {
                name: {"value": float(value), "std": float(std), "unit": unit} for name, unit, value, std in rows
            },
            "fit": {"relative_error": self.relative_error},
            "prefilter_zeros": list(estimator.zeros),
            "status": list(self.status),
            "notes": list(self.notes),
        }


def make_estimator(axis: Axis, record: Record) -> Estimator:
    """The estimator that a configuration asks for, at the record's sample period and resolution."""
    check_sampling(axis, record.dt)
    config = axis.estimator
    model = axis.model.make()
    automatic = "bcls" if model.equation.without_simulation else "iv"
    cls = ESTIMATORS[automatic if config.method == AUTO else config.method]
    options: dict[str, Any] = {"order": config.order, "discretization": config.discretization}
    options |= {"precision": config.precision, "prefilter_zeros": config.prefilter_zeros}
    if issubclass(cls, RecursiveEstimator):
        options |= {"forgetting": config.forgetting, "forgetting_scheme": config.forgetting_scheme}
    known = axis.encoder
    encoder = Encoder(
        record.resolution, standstill_time=known.standstill_time, max_speed=known.max_speed, guard=known.guard
    )
    estimator = cls(model, encoder, record.dt, config.cutoff, **options)
    if cls.instrumental and config.prefilter_zeros is None:
        zeros = choose_prefilter_zeros(estimator, record.u, record.counts)
        return cls(model, encoder, record.dt, config.cutoff, **(options | {"prefilter_zeros": zeros}))
    return estimator


def identify(record: Record, axis: Axis, progress: Progress | None = None) -> Result:
    """Estimates the parameters of a record; `progress` is called while a recursive method runs.

    Raises UsageError for a configuration that does not fit the record and NotIdentifiableError where the record
    cannot identify every parameter, with the mistake that explains it, where `diagnose` finds one, in front.
    """
    mistake = check_direction(record, axis)
    if mistake:
        raise UsageError(mistake)
    try:
        result = estimate(record, axis, progress)
    except NotIdentifiableError as error:
        raise explained(error, diagnose(record, axis)) from None
    mistake = diagnose(record, axis) if SUSPICIOUS & set(result.status) else ""
    return replace(result, notes=tuple(dict.fromkeys((mistake, *result.notes)))) if mistake else result


def explained(error: NotIdentifiableError, mistake: str) -> NotIdentifiableError:
    """The same error with the mistake that led to it, if there is one, in front."""
    return NotIdentifiableError(f"{mistake}; as the record is read now: {error}") if mistake else error


def estimate(record: Record, axis: Axis, progress: Progress | None = None) -> Result:
    """As `identify`, and raises as that does, but looks for no mistake in the columns."""
    estimator, reason, choice = make_estimator(axis, record), "", None
    if axis.estimator.method == AUTO and axis.estimator.forgetting == 1:
        choice = first_choice(estimator, record.u, record.counts)
        estimator, reason = choice.estimator, choice.reason
    elif axis.estimator.method == AUTO:
        estimator, reason = choose(estimator, record.u, record.counts, axis.estimator.forgetting)
    result = _identify(estimator, record, axis, progress, choice)
    _check_known(result)
    return replace(result, notes=(f"auto chose {reason}", *result.notes)) if reason else result


def _check_known(result: Result) -> None:
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


def _identify(
    estimator: Estimator, record: Record, axis: Axis, progress: Progress | None, choice: Choice | None
) -> Result:
    batch = _batch_twin(estimator)
    columns = batch.columns(record.u, record.counts)
    check_identifiable(columns, batch.names, batch.least_part)
    if isinstance(estimator, RecursiveEstimator):
        return _recursive(estimator, record, columns, progress)
    fit = choice.fit if choice else batch.fit(record.u, record.counts)
    known = choice.adequacy if choice else None
    flags, notes = judge(estimator, record.u, record.counts, fit.theta, fit.theta_std, known)
    if axis.estimator.forgetting < 1 and axis.estimator.method != AUTO:
        notes = (*notes, f"{estimator.method} is an off-line method: forgetting is not used")
    notes = (*record.notes, *notes, *Status(fit.status).advice)
    status = tuple(dict.fromkeys((*status_names(fit.status), *flags)))  # both may tell of a jump
    return Result(estimator, record, fit.theta, fit.theta_std, fit.relative_error, status, notes, fit=fit)


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


def _recursive(estimator: RecursiveEstimator, record: Record, columns: Columns, progress: Progress | None) -> Result:
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
    return Result(estimator, record, theta, std, relative, status, notes, track=track)


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
