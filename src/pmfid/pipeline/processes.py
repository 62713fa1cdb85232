"""The way from records of a transfer function to a result, and the search for its structure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from pmfid.config.axis import Axis, check_sampling
from pmfid.config.record import NO_ENCODER
from pmfid.diagnostics.free_run import FreeRun, process_run
from pmfid.diagnostics.processes import IGNORED, assess, check_known, doubts, findings_on, flags_on, search_notes
from pmfid.encoder import Encoder, fine_counts
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.base import Estimator
from pmfid.estimators.batch import BatchEstimator
from pmfid.estimators.cutoff import choose_prefilter_zeros
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.registry import ESTIMATORS, methods_for
from pmfid.estimators.srivc import SAME_PERIOD, SRIVC, choose_start_pole, make_problem, process_of
from pmfid.findings import make_notes, sort_findings
from pmfid.io.tables import Table
from pmfid.linear.experiment import Experiment
from pmfid.linear.order import DELAYS, ORDERS, UNSTABLE, OrderCandidate, Search, accepted_first, search_structure
from pmfid.models.transfer_function import TransferFunction
from pmfid.pipeline.checks.inputs import note_one_level
from pmfid.pipeline.guess.columns import step_of
from pmfid.pipeline.kinds import Kind, Progress, make_method, method_of
from pmfid.pipeline.result import ProcessResult, delay_of, expects_unstable
from pmfid.pipeline.stored import Stored
from pmfid.records.record import experiment_of, read_experiment
from pmfid.status import Status, status_findings
from pmfid.types import Floats

AUTOMATIC = "srivc"


class Processes(Kind[Sequence[Experiment]]):
    """Transfer functions, with one estimate from one or more records."""

    on_line: ClassVar[str] = "bcrls"

    def check_on_line(self, axis: Axis) -> None:
        if axis.record.hold != "zoh":
            raise UsageError(
                f"{axis.estimator.method} needs a held input, but [record] hold = {axis.record.hold!r} uses the next "
                'sample, which is not known yet; set hold = "zoh"'
            )

    def read(self, paths: Sequence[Path], axis: Axis) -> list[Experiment]:
        return [read_experiment(path, axis) for path in paths]

    def read_table(self, table: Table, axis: Axis) -> Sequence[Experiment]:
        return [experiment_of(table, axis)]

    def prepare_axis(self, data: Sequence[Experiment], axis: Axis) -> Axis:
        if axis.estimator.cutoff is not None:
            return axis
        cutoff = choose_start_pole(axis.model.make(), data)
        return axis.model_copy(update={"estimator": axis.estimator.model_copy(update={"cutoff": cutoff})})

    def name_and_samples(self, data: Sequence[Experiment]) -> tuple[str, int]:
        return ", ".join(experiment.name for experiment in data), sum(part.u.size for part in data)

    def free_runs(self, data: Sequence[Experiment], axis: Axis, theta: Floats) -> list[FreeRun]:
        resolution = axis.encoder.resolution
        encoder = None if resolution == NO_ENCODER else resolution / np.sqrt(12.0)
        return [process_run(_make_simulator(part, axis), theta, part, encoder) for part in data]

    def check_known(self, stored: Stored, data: Sequence[Experiment], axis: Axis) -> None:
        model = axis.model.make()
        if isinstance(model, TransferFunction) and not isinstance(model.dead_time, str):
            stored.check_known("dead_time", model.delay * data[0].period + model.dead_time)

    def estimate(self, data: Sequence[Experiment], axis: Axis, progress: Progress | None = None) -> ProcessResult:
        estimator = make_process_estimator(data, axis)
        method = estimator.method
        if isinstance(estimator, SRIVC):
            fit = estimator.fit_experiments(data)
            theta, cov, bits, explained = fit.theta, fit.theta_cov, fit.status, fit.explained
        else:
            (theta, cov, bits), explained = _from_counts(estimator, data), False
        problem = make_problem(estimator, data)
        scaled = theta[: problem.structure.size] / problem.structure.scale(problem.rate)
        checks = assess(problem, scaled, delay_of(estimator), estimator.encoder.resolution * explained)
        process = process_of(estimator, theta, cov)
        check_known(estimator, theta, cov, checks)
        std, unstable = np.sqrt(np.diagonal(cov)), expects_unstable(estimator)
        referenced = problem.referenced and isinstance(estimator, SRIVC)
        flags = flags_on(checks, process, referenced, unstable)
        found = [*findings_on(data, checks, process, flags, unstable), *doubts(estimator, theta, std, checks)]
        found += make_notes("reference", [IGNORED.format(method=method)] * (problem.referenced and not referenced))
        found += note_one_level([part.u for part in data], "the numerator scales with the gain")
        findings = sort_findings((*status_findings(bits), *found))
        counted = axis.record.output_kind == "counts"
        return ProcessResult(estimator, theta, std, findings, tuple(data), process, checks, counted)


def _make_simulator(experiment: Experiment, axis: Axis) -> SRIVC:
    """Return a method with the structure of the model and the time scale of an experiment."""
    dt, cutoff = experiment.period, axis.estimator.cutoff
    if cutoff is not None:
        check_sampling(axis, dt)
    return SRIVC(axis.model.make(), Encoder(axis.encoder.resolution), dt, cutoff or 0.2 / dt)


def make_process_estimator(experiments: Sequence[Experiment], axis: Axis) -> Estimator:
    """Return the configured estimator for the sample period of the first record."""
    model, dt = axis.model.make(), experiments[0].period
    check_sampling(axis, dt)
    if any(abs(experiment.period / dt - 1) > SAME_PERIOD for experiment in experiments):
        raise UsageError(
            "the records differ in their sample period; decimate the records to one period, or identify them one by one"
        )
    method = method_of(axis, AUTOMATIC)
    if method not in methods_for(model):
        raise UsageError(f"{method} does not suit a transfer function; use one of {', '.join(methods_for(model))}")
    cls = ESTIMATORS[method]
    estimator = make_method(cls, axis, Encoder(_resolution_of(experiments, axis)), dt)
    if cls.instrumental and axis.estimator.prefilter_zeros is None:
        encoder, counts = fine_counts(_plain(experiments, method).y)
        zeros = choose_prefilter_zeros(replace(estimator, encoder=encoder), experiments[0].u, counts)
        return replace(estimator, prefilter_zeros=zeros)
    return estimator


def _resolution_of(experiments: Sequence[Experiment], axis: Axis) -> float:
    """Return the resolution of the encoder, or without one the step of an output that a log has rounded."""
    if axis.encoder.resolution != NO_ENCODER:
        return axis.encoder.resolution
    outputs = np.concatenate([experiment.y for experiment in experiments])
    step, rounded = step_of(outputs[np.isfinite(outputs)])
    return step if rounded else NO_ENCODER


def _plain(experiments: Sequence[Experiment], method: str) -> Experiment:
    """Return the single record. Raises UsageError unless the record is complete and evenly spaced."""
    first = experiments[0]
    stretches = first.stretches()
    whole = len(stretches) == 1 and stretches[0].grid.uniform and stretches[0].rows.size == first.u.size
    if len(experiments) > 1 or not whole or not np.all(np.isfinite(first.u)) or first.hold != "zoh":
        raise UsageError(
            f"{method} needs one evenly spaced record without missing samples and with a held input; use srivc"
        )
    return first


def _from_counts(estimator: Estimator, experiments: Sequence[Experiment]) -> tuple[np.ndarray, np.ndarray, int]:
    """Return theta, covariance and status of a method that uses the kernel's columns."""
    record = _plain(experiments, estimator.method)
    if isinstance(estimator, BatchEstimator):
        fit = estimator.fit_output(record.u, record.y)
        return fit.theta, fit.theta_cov, fit.status
    if not isinstance(estimator, RecursiveEstimator):
        raise UsageError(f"{estimator.method} does not suit a transfer function")
    encoder, counts = fine_counts(record.y)
    track = replace(estimator, encoder=encoder).run(record.u, counts)
    last = int(track.status[-1])
    if last & Status.STARTING:
        raise NotIdentifiableError("the record ends before the first estimate; record longer, or raise the cutoff")
    occurred = int(np.bitwise_or.reduce(track.status)) & int(Status.INVALID_INPUT | Status.RESET)
    return track.theta[-1], np.diag(track.theta_std[-1] ** 2), occurred | (last & ~int(Status.SETTLING))


def search_order(experiments: Sequence[Experiment], axis: Axis, done: Callable[[float], None] | None = None) -> Search:
    """Return the structures with 1 to 5 poles, any number of zeros and dead times up to 5 samples, best first."""
    axis = Processes().prepare_axis(experiments, axis)
    cutoff, offset = axis.estimator.pole, axis.model.offset
    check_sampling(axis, experiments[0].period)
    found = search_structure(experiments, cutoff, orders=ORDERS, delays=DELAYS, offset=offset, done=done)
    return accepted_first(found, lambda candidate: refusal(experiments, axis, candidate))


def refusal(experiments: Sequence[Experiment], axis: Axis, candidate: OrderCandidate) -> str:
    """Return the reason to refuse a structure, or an empty text.

    A reason is a missing estimate, or an estimate that is not recommended.
    """
    places = {"n": candidate.n, "m": candidate.m, "delay": candidate.delay}
    model = axis.model.model_copy(update={"kind": "transfer_function", **places})
    try:
        result = Processes().estimate(experiments, axis.model_copy(update={"model": model}))
    except NotIdentifiableError as error:
        return str(error)
    return UNSTABLE if "unstable" in result.status else ""


def search_json(search: Search) -> dict[str, object]:
    """Return the object that `pmfid terms --json` prints."""
    same = ("n", "m", "delay", "fit", "condition", "settled", "white")
    rows = [
        {key: getattr(row, key) for key in same}
        | {"criterion": row.bic - search.best.bic, "refused": row.refused or None}
        for row in search.candidates
    ]
    best = {key: rows[0][key] for key in same[:3]}
    return {"best": best, "candidates": rows, "skipped": search.skipped, "notes": search_notes(search)}
