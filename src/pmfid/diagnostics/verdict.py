"""The verdict on an estimate of a drive by any method, from a comparison with the fit of the same samples."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pmfid.diagnostics.drives import NOISE_REMEDY, NOISE_SEEN, recent
from pmfid.diagnostics.matter import Matter, matter_of, sizes, weigh_findings
from pmfid.errors import NotIdentifiableError, UsageError
from pmfid.estimators.base import Estimator
from pmfid.estimators.configuration import like
from pmfid.estimators.known import CONTRADICTED
from pmfid.estimators.ls import LS
from pmfid.estimators.motion_fit import MotionFit
from pmfid.estimators.recursive import RLS
from pmfid.estimators.sample_steps import SampleSteps
from pmfid.findings import MOVE, Finding, sort_findings
from pmfid.fit.compare import NORMAL_95
from pmfid.fit.findings import findings_of
from pmfid.fit.fit import Fitted
from pmfid.types import Counts, Floats


@dataclass(frozen=True)
class Verdict:
    """All findings on an estimate with p parameters.

    `judged` holds all findings, whether or not they matter. `spread` (p,) is the shift by unmodelled effects and by the
    method itself, or NaN if unknown. `matter` is the possible error of the parameters. `fitted` is the fit of the same
    samples, or None.
    """

    judged: tuple[Finding, ...]
    spread: Floats
    matter: Matter
    fitted: Fitted | None

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The findings that matter, with the size of the possible error, and all others as notes."""
        return weigh_findings(self.judged, self.matter)


def verdict(estimator: Estimator, u: Floats, counts: Counts, theta: Floats, std: Floats, tolerance: float) -> Verdict:
    """Judge an estimate theta (p,) with standard deviations std (p,) from u (n,) and counts (n,).

    `tolerance` is the negligible relative error of a parameter. With forgetting, the last three memories are judged.
    """
    p = len(estimator.equation.names)
    spread, judged, fitted = np.full(theta.size, np.nan), [*_check_sizes(estimator, theta, std)], None
    if not estimator.equation.without_simulation:
        try:
            fitted = fit_again(estimator, u, counts)
        except NotIdentifiableError as error:
            spread[:p] = np.abs(theta[:p])
            judged.append(Finding("unmodelled", "no motion of the model follows the counts", MOVE, detail=f"{error}."))
            if isinstance(estimator, LS | RLS):
                judged.append(Finding("uncertain", NOISE_SEEN, NOISE_REMEDY))
    if fitted is not None:
        spread[:p] = _spread(fitted, theta[:p], std[:p])
        judged += _compare(estimator, fitted, theta[:p], std[:p], tolerance)
    matter = matter_of(estimator, theta, std, spread[:p], tolerance)
    return Verdict(sort_findings(judged), spread, matter, fitted)


def fit_again(estimator: Estimator, u: Floats, counts: Counts) -> Fitted:
    """Return the fit of the samples that determine an estimate, with the same model."""
    part = recent(estimator, u.size)
    first = u[part].size - u.size
    steps = estimator.steps
    if isinstance(steps, SampleSteps):
        steps = steps.part(steps.before.size + first, steps.before.size) if first else steps
    if not np.any(np.diff(counts[part])):
        raise NotIdentifiableError(f"the axis does not move in these samples; {MOVE}")
    try:
        method = like(MotionFit, estimator, prefilter_zeros=None, precision="float64", steps=steps)
    except UsageError as error:
        raise NotIdentifiableError(str(error)) from None
    return _examine(method, u[part].tobytes(), counts[part].tobytes())


@lru_cache(maxsize=1)
def _examine(method: MotionFit, u: bytes, counts: bytes) -> Fitted:
    """Return the fit of inputs and counts (n,), which all methods of one record share."""
    return method.examine(np.frombuffer(u, np.float64).copy(), np.frombuffer(counts, np.int64).copy())


def _spread(fitted: Fitted, theta: Floats, std: Floats) -> Floats:
    """Return the root mean square shift (p,): the distance to the fit beyond noise, and the half length of the fit."""
    p = theta.size
    half = fitted.half[:p] / NORMAL_95
    apart = np.maximum((theta - fitted.theta[:p]) ** 2 - std**2, 0.0)
    return np.asarray(np.sqrt(apart + half**2))


def _compare(estimator: Estimator, fitted: Fitted, theta: Floats, std: Floats, tolerance: float) -> Iterator[Finding]:
    """Yield the findings of the fit, and each parameter in which the estimate contradicts the fit."""
    p, equation = theta.size, estimator.equation
    size = sizes(estimator, fitted.theta)
    names, positive = fitted.problem.machine.names, np.append(equation.positive, np.zeros(size.size - p, bool))
    yield from findings_of(fitted, names, positive, size, tolerance)
    half = fitted.half[:p] / NORMAL_95
    for name, value, better, own, bar, scale in zip(names, theta, fitted.theta[:p], std, half, size, strict=False):
        apart = abs(value - better)
        if not apart > tolerance * scale:
            continue
        if apart > CONTRADICTED * np.hypot(own, bar):
            sentence = f"{name} = {value:.4g} is biased by the method: the fit gives {better:.4g}"
            yield Finding("biased", sentence, 'set method = "auto"')
        elif apart > max(own, bar):
            sentence = f"the std of {name} leaves out the method's own error, about {100 * apart / scale:.2g} %"
            yield Finding("std_too_small", sentence, 'set method = "auto"')


def _check_sizes(estimator: Estimator, theta: Floats, std: Floats) -> Iterator[Finding]:
    equation = estimator.equation
    for name, value, deviation, positive in zip(equation.names, theta, std, equation.positive, strict=False):
        if positive and value + CONTRADICTED * deviation < 0:
            yield Finding(
                "implausible", f"{name} is negative", "check sign and scale of the input and the encoder", "wrong"
            )
        elif positive and deviation > 0.5 * abs(value):
            sentence = f"the error of {name} may exceed half its value"
            yield Finding("uncertain", sentence, "excite the axis more, or try another cutoff")
