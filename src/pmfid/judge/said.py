"""The verdict on an estimate of a machine: one for every command, Python and the report."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmfid.errors import NotIdentifiableError
from pmfid.estimators.adequacy import Adequacy
from pmfid.estimators.base import Estimator
from pmfid.findings import Finding
from pmfid.judge.drive import examine_estimate, judge, recent
from pmfid.judge.matter import NOISE_LIMIT, Matter, matter_of, weigh_findings
from pmfid.judge.spread import model_spread, spread_without_motion
from pmfid.types import Floats


@dataclass(frozen=True)
class Verdict:
    """What there is to say of an estimate of p parameters. judged: all that is found, whatever comes of it; spread
    (p,): by how much unmodelled effects may move it, NaN: not known; matter: whether that matters; adequacy: what the
    counts say on the model, None: nothing."""

    judged: tuple[Finding, ...]
    spread: Floats
    matter: Matter
    adequacy: Adequacy | None

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What matters with its size, and what does not as notes."""
        return weigh_findings(self.judged, self.matter)


def verdict(
    estimator: Estimator,
    u: NDArray[np.float64],
    counts: NDArray[np.int64],
    theta: Floats,
    std: Floats,
    known: Adequacy | None,
    tolerance: float,
) -> Verdict:
    """On an estimate theta (p,) with standard deviations std (p,) from u, counts: (n,). known: what the counts say on
    the model, where that is known; tolerance: relative error of a parameter that is of no matter."""
    found, spread = _spread(estimator, u, counts, theta, std, known)
    judged = judge(estimator, u, counts, theta, std, found)
    p = len(estimator.equation.names)
    shown = np.full(p, np.nan) if found is None else _estimate_shown_bias(found, theta[:p], std[:p], spread[:p])
    return Verdict(judged, spread, matter_of(estimator, theta, std, shown, tolerance), found)


def _estimate_shown_bias(found: Adequacy, theta: Floats, std: Floats, spread: Floats) -> Floats:
    """(p,) by how much what the record shows may move an estimate: of a model that it contradicts all but what no
    record of this input shows, which is reported once. Of any other only forces that it nearly shows, and by
    how much the estimate differs from the motion that fits: what would not show is in the interval."""
    p = theta.size
    if not found.adequate:
        return np.asarray(np.sqrt(np.maximum(spread**2 - found.unseen[:p] ** 2, 0.0)))
    apart = np.maximum((theta - (found.q * found.difference.scale)[:p]) ** 2 - std**2, 0.0)
    nearly = np.where(np.abs(found.z) > NOISE_LIMIT, found.size, 0.0)
    return np.asarray(np.sqrt(apart + found.moves[:p] ** 2 @ nearly**2))


def _spread(
    estimator: Estimator,
    u: NDArray[np.float64],
    counts: NDArray[np.int64],
    theta: Floats,
    std: Floats,
    known: Adequacy | None,
) -> tuple[Adequacy | None, Floats]:
    """What the counts say on the model, if anything, and by how much unmodelled effects may move the estimate (p,)."""
    part = recent(estimator, u.size)
    try:
        found = examine_estimate(estimator, u, counts, theta, known)
    except NotIdentifiableError:
        return None, spread_without_motion(estimator, u[part], counts[part], theta)
    if found is None:
        return None, np.full(theta.size, np.nan)
    return found, model_spread(estimator, u[part], counts[part], theta, std, found)
