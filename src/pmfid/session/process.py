"""Transfer functions: from records as they come to a result, and the search for a structure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import chdtri

from pmfid.encoder import Encoder, fine_counts
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.base import Estimator, status_names
from pmfid.estimators.batch import BatchEstimator
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.registry import ESTIMATORS, methods_for
from pmfid.estimators.srivc import SAME_PERIOD, by_descent, fit_process, fixed_filters, make_problem
from pmfid.estimators.structure import DELAYS, ORDERS, Search, search_structure
from pmfid.estimators.zeros import choose_prefilter_zeros
from pmfid.linear.assess import Assessment, assess
from pmfid.linear.experiment import Experiment
from pmfid.linear.process import Process
from pmfid.linear.solve import Problem, Solution, solve
from pmfid.models.transfer_function import TransferFunction
from pmfid.session.config import NO_ENCODER, Axis, check_sampling
from pmfid.status import Status

AUTOMATIC = "srivc"
#: Methods that take several records, gaps, missing samples and uneven spacing.
FREE: dict[str, Callable[[Problem], Solution]] = {"srivc": solve, "iv": fixed_filters, "output-error": by_descent}
#: The input must not be correlated with the noise by more than chance for these to be consistent without reference.
FEEDBACK = (
    "the residual is correlated with later inputs, so the input has the noise in it, as a controller feeds it back: "
    "the estimate is biased; give the reference of the controller ([record] reference) to srivc, iv or output-error"
)
IGNORED = "{method} does not use the reference of the controller; srivc, iv and output-error do"
#: A record of noise alone is refused but for so many. Poles can be tuned to any of its frequencies: for each sample the
#: chance is a part of that.
CHANCE = 1e-2
#: Less of the output explained [%] is worth a sentence.
POOR_FIT = 10.0
#: An output so many robust standard deviations off, in so small a part of the samples, is an outlier.
FAR, FEW = 10.0, 0.01


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
        """Of the assessment [%]; None for an unstable process, whose simulation says nothing."""
        return None if np.any(self.process.poles.real > 0) else self.assessment.fit

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
            **values,
            "parameters": {
                name: {"value": float(value), "std": float(std), "unit": unit} for name, unit, value, std in rows
            },
            "poles": [[pole.real, pole.imag] for pole in process.poles.tolist()],
            "zeros": [[zero.real, zero.imag] for zero in process.zeros.tolist()],
            "gain": process.gain if np.isfinite(process.gain) else None,
            "time_constants": process.time_constants.tolist(),
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
    problem = make_problem(estimator, experiments)
    n_parameters = problem.structure.size
    delay = estimator.model.delay if isinstance(estimator.model, TransferFunction) else 0
    checks = assess(problem, theta[:n_parameters] / problem.structure.scale(problem.rate), delay)
    process = Process.of(problem.structure, theta, cov, delay * estimator.dt)
    _check_known(estimator, theta, cov, sum(part.size for part in checks.samples))
    std = np.sqrt(np.diagonal(cov))
    referenced = problem.referenced and method in FREE
    notes = [*_notes(experiments, checks, process, referenced), *_doubts(estimator, theta, std, checks)]
    notes += [IGNORED.format(method=method)] if problem.referenced and not referenced else []
    notes += Status(bits).advice
    flags = ["feedback"] if checks.feedback and not referenced else []
    status = (*status_names(bits), *flags)
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


def _check_known(estimator: Estimator, theta: np.ndarray, cov: np.ndarray, samples: int) -> None:
    """An estimate of nothing but noise is none, whatever its error bars."""
    variance = np.diagonal(cov)
    if not (np.all(np.isfinite(theta)) and np.all(np.isfinite(cov)) and np.all(variance > 0)):
        raise NotIdentifiableError(
            f"the uncertainty of the transfer function is beyond numbers ({estimator.method}): the records do not "
            "identify it; excite the process more, or use fewer poles and zeros"
        )
    if np.all(variance > theta**2):
        raise NotIdentifiableError(
            f"no parameter of the transfer function is known to its own size ({estimator.method}): the records do not "
            "identify it; excite the process more, or use fewer poles and zeros"
        )
    top = np.array([name.startswith("b") for name in estimator.names]).nonzero()[0]
    scale = np.sqrt(variance[top])
    correlation, scaled = cov[np.ix_(top, top)] / np.outer(scale, scale), theta[top] / scale
    if scaled @ np.linalg.pinv(correlation, hermitian=True) @ scaled < chdtri(top.size, CHANCE / samples):
        offset = "" if "offset" in estimator.names else "give offset = true in [model] where it has a constant, "
        raise NotIdentifiableError(
            f"the output hardly depends on the input ({estimator.method}): chance alone gives such a numerator; "
            f"check the columns, the dead time and for outliers, {offset}excite the process more, or use fewer poles "
            "and zeros"
        )


def _doubts(estimator: Estimator, theta: np.ndarray, std: np.ndarray, checks: Assessment) -> list[str]:
    """What there is to doubt in numbers that are there."""
    residual = np.concatenate(checks.residual)
    spread = 1.4826 * float(np.median(np.abs(residual - np.median(residual))))
    far = int(np.sum(np.abs(residual - np.median(residual)) > FAR * spread)) if spread > 0 else 0
    doubts = []
    unknown = [name for name, value, s in zip(estimator.names, theta, std, strict=True) if s > abs(value)]
    if unknown:
        doubts.append(f"not known to its own size: {', '.join(unknown)}; fewer poles or zeros may do")
    if 0 < far <= FEW * residual.size:
        doubts.append(
            f"{far} samples of the output are far off the others, and may decide everything: leave them empty"
        )
    if 0 <= checks.fit < POOR_FIT:
        doubts.append(f"the model explains {checks.fit:.2g} % of the output, no more")
    if "offset" not in estimator.names and abs(np.mean(residual)) > 0.5 * np.std(residual):
        doubts.append("the residual has a mean: give offset = true in [model]")
    return doubts


def _notes(experiments: Sequence[Experiment], checks: Assessment, process: Process, referenced: bool) -> list[str]:
    notes = []
    if checks.feedback and not referenced:
        notes.append(FEEDBACK)
    if not checks.independent:
        notes.append(
            "the residual is correlated with the input: another dead time, more poles or zeros, or another hold may "
            "explain more"
        )
    if np.any(process.poles.real > 0):
        notes.append("the transfer function is unstable: what it simulates, and so the fit, says nothing")
    missing = sum(int(np.sum(~np.isfinite(experiment.y))) for experiment in experiments)
    if missing:
        notes.append(f"{missing} samples of the output are missing")
    return notes


def search_order(experiments: Sequence[Experiment], axis: Axis, done: Callable[[float], None] | None = None) -> Search:
    """The structures with 1 to 5 poles, any number of zeros and dead times up to 5 samples, best first."""
    cutoff, offset = axis.estimator.cutoff, axis.model.offset
    check_sampling(axis, experiments[0].period)
    return search_structure(experiments, cutoff, orders=ORDERS, delays=DELAYS, offset=offset, done=done)


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


def search_notes(search: Search) -> list[str]:
    """What to mind before the best structure is taken."""
    best, notes = search.best, []
    if not best.settled:
        notes.append("no structure settled: the order is that of unfinished fits")
    if not best.white:
        notes.append(
            "what the best structure leaves is not white noise, but the criterion takes it for that and then prefers "
            "too many poles and zeros: take the smallest structure that fits nearly as well"
        )
    if best.fit < POOR_FIT:
        notes.append(f"the best structure explains {max(best.fit, 0.0):.2g} % of the output, no more: it may be chance")
    return notes
