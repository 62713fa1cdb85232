"""Transfer functions: from records as they come to a result, and the search for a structure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pmfid.encoder import Encoder, fine_counts
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.base import Estimator, status_names
from pmfid.estimators.batch import BatchEstimator
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.registry import ESTIMATORS, methods_for
from pmfid.estimators.srivc import (
    SAME_PERIOD,
    by_descent,
    fit_process,
    fixed_filters,
    make_problem,
    process_of,
    with_dead_time,
)
from pmfid.estimators.zeros import choose_prefilter_zeros
from pmfid.judge.assess import Assessment, assess
from pmfid.judge.doubts import IGNORED, check_known, doubts, notes_on, search_notes
from pmfid.judge.verdict import flags_on
from pmfid.models.transfer_function import TransferFunction
from pmfid.session.config import NO_ENCODER, Axis, check_sampling
from pmfid.status import Status
from pmfid.transfer.experiment import Experiment
from pmfid.transfer.order import DELAYS, ORDERS, UNSTABLE, Candidate, Search, accepted_first, search_structure
from pmfid.transfer.process import Process
from pmfid.transfer.solve import Problem, Solution, solve

AUTOMATIC = "srivc"
#: Methods that take several records, gaps, missing samples and uneven spacing.
FREE: dict[str, Callable[[Problem], Solution]] = {"srivc": solve, "iv": fixed_filters, "output-error": by_descent}


@dataclass(frozen=True, eq=False)
class ProcessResult:
    """theta, theta_std: (p,); process: the transfer function; assessment: fit and residual tests over all records;
    notes: sentences for people; status: names of the bits that hold."""

    estimator: Estimator
    experiments: tuple[Experiment, ...]
    theta: np.ndarray
    theta_std: np.ndarray
    process: Process
    assessment: Assessment
    status: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def delay(self) -> int:
        model = self.estimator.model
        return model.delay if isinstance(model, TransferFunction) else 0

    @property
    def fit(self) -> float | None:
        """Of the assessment [%]; None for an unstable process that was not asked for: its simulation says nothing."""
        expected = isinstance(self.estimator.model, TransferFunction) and self.estimator.model.unstable
        return None if np.any(self.process.poles.real > 0) and not expected else self.assessment.fit

    @property
    def fit_text(self) -> str:
        return "fit unknown, unstable" if self.fit is None else f"fit {self.fit:.2f} %"

    def to_json(self) -> dict[str, Any]:
        """The object that `--json` prints; poles and zeros as [real, imaginary], fit in percent."""
        names, process, checks = self.estimator.names, self.process, self.assessment
        values = dict(zip(names, self.theta.tolist(), strict=True))
        rows = zip(names, self.estimator.units, self.theta, self.theta_std, strict=True)
        return {
            "model": self.estimator.model.kind,
            "method": self.estimator.method,
            "records": [experiment.name for experiment in self.experiments],
            "samples": sum(part.size for part in checks.samples),
            "dt": self.estimator.dt,
            "delay": self.delay,
            "dead_time": process.delay,
            **values,
            "parameters": {
                name: {"value": float(value), "std": float(std), "unit": unit} for name, unit, value, std in rows
            },
            "poles": [[pole.real, pole.imag] for pole in process.poles.tolist()],
            "zeros": [[zero.real, zero.imag] for zero in process.zeros.tolist()],
            "gain": process.gain if np.isfinite(process.gain) else None,
            "time_constants": [tau if np.isfinite(tau) else None for tau in process.time_constants.tolist()],
            "fit": self.fit,
            "residual": {"white": checks.white, "independent": checks.independent, "feedback": checks.feedback},
            "status": list(self.status),
            "notes": list(self.notes),
        }


def identify_process(experiments: Sequence[Experiment], axis: Axis) -> ProcessResult:
    """Identifies the transfer function of `axis` from one or more records.

    Raises UsageError for a method that cannot take the model or such records and NotIdentifiableError where the
    records cannot identify every parameter.
    """
    estimator = make_process_estimator(experiments, axis)
    method = estimator.method
    if method in FREE:
        fit = fit_process(estimator, experiments, FREE[method])
        theta, cov, bits = fit.theta, fit.theta_cov, fit.status
    else:
        theta, cov, bits = _from_counts(estimator, experiments)
    settled = with_dead_time(estimator, theta)
    problem = make_problem(settled, experiments)
    n_parameters = problem.structure.size
    delay = estimator.model.delay if isinstance(estimator.model, TransferFunction) else 0
    checks = assess(problem, theta[:n_parameters] / problem.structure.scale(problem.rate), delay)
    process = process_of(estimator, theta, cov)
    check_known(estimator, theta, cov, checks)
    std = np.sqrt(np.diagonal(cov))
    referenced = problem.referenced and method in FREE
    unstable = isinstance(estimator.model, TransferFunction) and estimator.model.unstable
    notes = [*notes_on(experiments, checks, process, referenced, unstable), *doubts(estimator, theta, std, checks)]
    notes += [IGNORED.format(method=method)] if problem.referenced and not referenced else []
    notes += Status(bits).advice
    status = (*status_names(bits), *flags_on(checks, process, referenced, unstable))
    return ProcessResult(estimator, tuple(experiments), theta, std, process, checks, status, tuple(notes))


def make_process_estimator(experiments: Sequence[Experiment], axis: Axis) -> Estimator:
    """The estimator that a configuration asks for, at the period of the first record."""
    model, config, dt = axis.model.make(), axis.estimator, experiments[0].period
    check_sampling(axis, dt)
    if any(abs(experiment.period / dt - 1) > SAME_PERIOD for experiment in experiments):
        raise UsageError("the records differ in their sample period; decimate them to one, or identify them one by one")
    method = AUTOMATIC if config.method == "auto" else config.method
    if method not in methods_for(model):
        raise UsageError(f"{method} is not for a transfer function; use one of {', '.join(methods_for(model))}")
    cls = ESTIMATORS[method]
    options: dict[str, Any] = {"order": config.order, "precision": config.precision}
    options |= {"discretization": config.discretization, "prefilter_zeros": config.prefilter_zeros}
    if issubclass(cls, RecursiveEstimator):
        options |= {"forgetting": config.forgetting, "forgetting_scheme": config.forgetting_scheme}
    if method in ("known-step", "rknown-step"):
        if axis.encoder.resolution == NO_ENCODER:
            raise UsageError(f"{method} needs the step of the encoder or converter; give [encoder] resolution")
        options["noise_std"] = axis.encoder.resolution / np.sqrt(12.0)
    estimator = cls(model, Encoder(axis.encoder.resolution), dt, config.cutoff, **options)
    if cls.instrumental and config.prefilter_zeros is None:
        encoder, counts = fine_counts(_plain(experiments, method).y)
        zeros = choose_prefilter_zeros(replace(estimator, encoder=encoder), experiments[0].u, counts)
        return replace(estimator, prefilter_zeros=zeros)
    return estimator


def _plain(experiments: Sequence[Experiment], method: str) -> Experiment:
    """The only record, evenly spaced and complete."""
    first = experiments[0]
    stretches = first.stretches()
    whole = len(stretches) == 1 and stretches[0].grid.uniform and stretches[0].rows.size == first.u.size
    if len(experiments) > 1 or not whole or not np.all(np.isfinite(first.u)) or first.hold != "zoh":
        raise UsageError(
            f"{method} takes one evenly spaced record without gaps or missing samples and with a held input; "
            f"use {', '.join(FREE)}"
        )
    return first


def _from_counts(estimator: Estimator, experiments: Sequence[Experiment]) -> tuple[np.ndarray, np.ndarray, int]:
    """theta, covariance and status of a method on the kernel's columns."""
    record = _plain(experiments, estimator.method)
    if isinstance(estimator, BatchEstimator):
        fit = estimator.fit_output(record.u, record.y)
        return fit.theta, fit.theta_cov, fit.status
    if not isinstance(estimator, RecursiveEstimator):
        raise UsageError(f"{estimator.method} is not for a transfer function")
    encoder, counts = fine_counts(record.y)
    track = replace(estimator, encoder=encoder).run(record.u, counts)
    last = int(track.status[-1])
    if last & Status.STARTING:
        raise NotIdentifiableError("the record ends before there is an estimate; record longer, or raise the cutoff")
    occurred = int(np.bitwise_or.reduce(track.status)) & int(Status.INVALID_INPUT | Status.RESET)
    return track.theta[-1], np.diag(track.theta_std[-1] ** 2), occurred | (last & ~int(Status.SETTLING))


def search_order(experiments: Sequence[Experiment], axis: Axis, done: Callable[[float], None] | None = None) -> Search:
    """The structures with 1 to 5 poles, any number of zeros and dead times up to 5 samples, best first."""
    cutoff, offset = axis.estimator.cutoff, axis.model.offset
    check_sampling(axis, experiments[0].period)
    found = search_structure(experiments, cutoff, orders=ORDERS, delays=DELAYS, offset=offset, done=done)
    return accepted_first(found, lambda candidate: refusal(experiments, axis, candidate))


def refusal(experiments: Sequence[Experiment], axis: Axis, candidate: Candidate) -> str:
    """Why there is no estimate of a structure, or none to recommend; "" where there is one."""
    places = {"n": candidate.n, "m": candidate.m, "delay": candidate.delay}
    model = axis.model.model_copy(update={"kind": "transfer_function", **places})
    try:
        result = identify_process(experiments, axis.model_copy(update={"model": model}))
    except NotIdentifiableError as error:
        return str(error)
    return UNSTABLE if "unstable" in result.status else ""


def search_json(search: Search) -> dict[str, Any]:
    """The object that `pmfid order --json` prints."""
    rows = [
        {
            "n": row.n,
            "m": row.m,
            "delay": row.delay,
            "criterion": row.bic - search.best.bic,
            "fit": row.fit,
            "condition": row.condition,
            "settled": row.settled,
            "white": row.white,
            "refused": row.refused or None,
        }
        for row in search.candidates
    ]
    best = rows[0]
    return {
        "best": {key: best[key] for key in ("n", "m", "delay")},
        "candidates": rows,
        "skipped": search.skipped,
        "notes": search_notes(search),
    }
