"""The way from a record to the result of the fit (`pmfid.fit`), which is the off-line method of first choice."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from pmfid.config.axis import Axis
from pmfid.diagnostics.matter import Matter, sizes
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.auto import AUTO
from pmfid.estimators.base import Estimator
from pmfid.estimators.configuration import like
from pmfid.estimators.edges import EdgeFit
from pmfid.estimators.motion_fit import MotionFit
from pmfid.findings import MOVE, make_notes, sort_findings
from pmfid.fit.compare import NORMAL_95
from pmfid.fit.findings import findings_of, widen
from pmfid.fit.fit import Fitted
from pmfid.fit.likelihood import Intervals
from pmfid.fit.second_mass import PairTrial, SecondMass, find_second_mass, try_second_mass
from pmfid.pipeline.known import known_of, put_together
from pmfid.pipeline.result import DriveResult
from pmfid.records.gaps import bridge_input
from pmfid.records.outliers import repair_as_configured
from pmfid.records.record import Record
from pmfid.types import Floats

#: Note on inputs that the fit treats as unknown.
RESTARTED = "the motion restarts after each lost input that its neighbours do not determine"


class SecondMassError(NotIdentifiableError):
    """Error for a record that two masses explain, and one mass does not. `second` describes them."""

    def __init__(self, second: SecondMass, rotary: bool) -> None:
        what = second.describe("rad" if rotary else "m").removesuffix(",")
        super().__init__(
            f"no motion of one mass follows the record, and one of two masses does: {what}. Advice: {second.remedy}"
        )
        self.second = second


def uses_fit(axis: Axis) -> bool:
    """Return whether the fit estimates the parameters of a configuration."""
    method = axis.estimator.method == MotionFit.method or (
        axis.estimator.method == AUTO and axis.estimator.forgetting == 1
    )
    equation = axis.model.make().equation
    return method and (equation.elastic or not equation.without_simulation)


def make_fit(axis: Axis, record: Record) -> MotionFit:
    """Return the method for a record. Its cutoff only serves the figures."""
    return MotionFit(
        axis.model.make(),
        axis.encoder.make_encoder(record.resolution),
        record.dt,
        axis.estimator.cutoff or 0.2 / record.dt,
        steps=record.steps,
    )


def identify_by_fit(record: Record, axis: Axis, asked: Axis) -> DriveResult:
    """Return the result of the fit. The configured axis `asked` contains the prior information.

    Raises NotIdentifiableError if no motion of the model follows the record.
    """
    try:
        method, fitted, remarks = _examine(record, axis)
    except NotIdentifiableError:
        _refuse_second_mass(record, axis)
        raise
    fit = method.summarise(fitted)
    if not fitted.follows:
        _refuse_second_mass(record, axis)
        raise NotIdentifiableError(
            f"no motion of the model follows the measured motion; {fit.relative_error:.0%} of the motion stays "
            f"unexplained. Advice: check input_gain, sign and scale of input and output, and [encoder] bits"
        )
    size, second = sizes(method, fit.theta), None
    if may_have_second_mass(axis) and np.any(fitted.scale_reach(size) > axis.estimator.tolerance):
        with np.errstate(all="ignore"):
            trial = fitted.trial or PairTrial(replace(fitted.whole, candidates=()))
            second = try_second_mass(fitted.whole, fitted.solution.q, trial)
    if second is not None:
        fitted = widen(fitted, second)
    known = known_of(asked, method)
    estimator: Estimator = method
    if known is not None and known.find_gain:
        known, scaled = known.rescale(fit)
        estimator, fit = known.estimator, replace(fit, theta=scaled.theta, theta_cov=scaled.theta_cov)
    spread = _spread(fitted, fit.theta_std)
    equation = estimator.equation
    size = sizes(estimator, fit.theta)
    positive = np.append(equation.positive, [one in equation.second for one in equation.further]).astype(bool)
    findings = list(findings_of(fitted, estimator.names, positive, size, axis.estimator.tolerance, second))
    notes = make_notes("record", record.notes) + make_notes("method", remarks)
    matter = _matter(fitted, estimator.names, size, axis.estimator.tolerance)
    result = DriveResult(
        estimator,
        fit.theta,
        fit.theta_std,
        sort_findings((*findings, *notes)),
        record,
        fit.relative_error,
        matter,
        fit=fit,
        forces=fitted.weighed,
        second=second,
        explained=isinstance(fitted.likelihood, Intervals) or not fitted.likelihood.wanders,
        model_spread=spread,
    )
    if result.coupling is not None:
        result = result.with_findings(*make_notes("coupling", result.coupling.lines))
    if known is None:
        _check_mass(result, record.rotary)
        return result
    return put_together(result, known, axis, known.combine(fit, spread))


def _examine(record: Record, axis: Axis) -> tuple[MotionFit, Fitted, tuple[str, ...]]:
    """Return the method, its fit and notes. The fit uses the ages of edges if the record has ages."""
    method, known = make_fit(axis, record), repair_as_configured(record, axis)
    repaired, used, remarks = known.record, known.used, tuple[str, ...]()
    warmth, elastic = record.temperature, may_have_second_mass(axis)
    if record.ages is not None and record.ages.size == record.u.size:
        edges = like(EdgeFit, method, lines=axis.encoder.lines, tick=axis.encoder.tick)
        try:
            return edges, *edges.examine_edges(repaired.u, repaired.counts, record.ages, used, warmth)
        except NotIdentifiableError as error:
            remarks = (f"the ages of edges are not used: {str(error).partition('; ')[0]}",)
    spiky = np.isfinite(repaired.u) & (record.u != repaired.u)
    ends = np.append(known.shifted[1:], False)  # the last sample before each shift of the zero
    u = bridge_input(repaired.u)
    if np.any(spiky | ends) or u is not repaired.u:
        with suppress(NotIdentifiableError):
            cut = np.where(spiky | ends, np.nan, repaired.u)
            fitted = method.examine(cut, repaired.counts, used, warmth, elastic)
            return method, fitted, (*remarks, RESTARTED) if np.any(spiky) else remarks
    return method, method.examine(u, repaired.counts, used, warmth, elastic), remarks


def may_have_second_mass(axis: Axis) -> bool:
    """Return whether the model is that of a rigid axis, and a second mass does not exclude one of its terms."""
    if axis.model.kind != "drive" or axis.model.body != "rigid":
        return False
    try:
        axis.model.model_copy(update={"body": "two-mass"}).make()
    except UsageError:
        return False
    return True


def _refuse_second_mass(record: Record, axis: Axis) -> None:
    """Raise SecondMassError if two masses explain a record that one mass does not follow."""
    if not may_have_second_mass(axis):
        return
    method, known, second = make_fit(axis, record), repair_as_configured(record, axis), None
    with suppress(NotIdentifiableError):
        problem = method.problem(known.record.u, known.record.counts, known.used)
        with np.errstate(all="ignore"):
            second = find_second_mass(problem)
    if second is not None:
        raise SecondMassError(second, record.rotary)


def _spread(fitted: Fitted, std: Floats) -> Floats:
    """Return the spread (p,) that widens normal intervals of the standard errors std (p,) to those of the fit.

    The standard errors may have another gain of the input than the fit.
    """
    own = np.sqrt(np.diag(fitted.covariance))
    return np.asarray(np.sqrt(np.maximum((fitted.half / NORMAL_95) ** 2 - own**2, 0.0)) * (std / own))


def _matter(fitted: Fitted, names: tuple[str, ...], size: Floats, tolerance: float) -> Matter:
    part = fitted.half / size
    worst = int(np.argmax(part))
    own = np.sqrt(np.diag(fitted.covariance))
    beyond = bool(np.any(fitted.half > np.maximum(tolerance * size, 2 * NORMAL_95 * own)))
    return Matter(names[worst], float(part[worst]), beyond)


def _check_mass(result: DriveResult, rotary: bool) -> None:
    leading = result.estimator.equation.leading
    mass, std = result.theta[leading], result.theta_std[leading]
    if not std < mass:
        if result.second is not None:
            raise SecondMassError(result.second, rotary)
        raise NotIdentifiableError(
            f"{result.names[leading]} comes out as {mass:.3g} with a standard deviation of {std:.2g}. Advice: {MOVE}"
        )
