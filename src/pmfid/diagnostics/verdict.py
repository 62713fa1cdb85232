"""The verdict on an estimate of a drive, in words that every command shares."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pmfid.diagnostics.drives import Examined, examine_estimate, judge, recent
from pmfid.diagnostics.matter import Matter, matter_of, weigh_findings
from pmfid.diagnostics.tuning import TUNING
from pmfid.errors import NotIdentifiableError
from pmfid.estimators.adequacy import Adequacy, filter_force, force_moves
from pmfid.estimators.base import Estimator
from pmfid.estimators.configuration import like
from pmfid.estimators.iv import IV
from pmfid.estimators.least_squares import solve_with_instruments
from pmfid.estimators.output_error import Following
from pmfid.estimators.results import Columns
from pmfid.estimators.tuning import TUNING as ESTIMATOR_TUNING
from pmfid.estimators.uncertainty import scatter
from pmfid.findings import Finding
from pmfid.types import Floats


def model_spread(
    estimator: Estimator, u: Floats, counts: NDArray[np.int64], theta: Floats, std: Floats, found: Adequacy
) -> Floats:
    """(p,) root mean square by which unmodelled effects may move an estimate theta (p,) with standard deviations std
    (p,) from u, counts: (n,); NaN for what is no parameter of the equation.

    found: adequacy of the model on the same record. If the counts contradict the model, a force that they ask for
    counts at the size that they ask for.
    """
    spread = np.full(theta.size, np.nan)
    equation = slice(0, len(estimator.equation.names))
    twin = like(IV, estimator, prefilter_zeros=None)
    best = found.q[equation] * found.difference.scale[equation]
    columns = twin.columns_at(best, u, counts)
    with np.errstate(all="ignore"):  # a view beyond numbers shows nothing
        largest = _largest(list(_views(estimator, twin, columns, theta[equation], std[equation], best, found)))
        spread[equation] = np.sqrt(largest + found.unseen[: largest.size] ** 2)
    return spread


def spread_without_motion(estimator: Estimator, u: Floats, counts: NDArray[np.int64], theta: Floats) -> Floats:
    """The same where no motion of the model can be fitted to the counts, so that no effect is singled out: by the
    parts of the record alone, and by as much as the estimate itself where these say nothing either."""
    p = len(estimator.equation.names)
    spread, twin = np.full(theta.size, np.nan), like(IV, estimator, prefilter_zeros=None)
    at = np.where(estimator.equation.positive, np.maximum(theta[:p], 0.0), theta[:p])
    velocity = np.diff(counts, append=counts[-1]) * (estimator.encoder.resolution / estimator.intervals)
    views = list[Floats]()
    with np.errstate(all="ignore"), suppress(NotIdentifiableError):
        views += _contradictions(twin, twin.columns_at(at, u, counts), velocity)
    spread[:p] = np.sqrt(_largest(views or [theta[:p] ** 2]))
    return spread


def _largest(views: Sequence[Floats]) -> Floats:
    """(p,) of mean squares; a view beyond numbers shows nothing."""
    each = np.array(views)
    return np.asarray(np.max(np.where(np.isfinite(each), each, 0.0), axis=0))


def _views(
    estimator: Estimator, twin: IV, columns: Columns, theta: Floats, std: Floats, best: Floats, found: Adequacy
) -> Iterator[Floats]:
    """Mean squares (p,), one for each way to look at it."""
    follows = isinstance(estimator, Following)
    squares = _own_moves(found, twin, columns, follows)[: theta.size] ** 2 * believed_squares(found)
    yield sum((np.max(squares[:, own], axis=1) for own in _kinds_of_force(found)), start=np.zeros(theta.size))
    yield np.maximum((theta - best) ** 2 - std**2, 0.0)
    if found.adequate or (follows and found.follows):
        return
    whole = _solve_part(twin, columns, np.ones(columns.z.size, dtype=bool))
    if whole is None:
        return
    if follows:
        yield np.maximum((whole[0] - theta) ** 2 - whole[1] - std**2, 0.0)
    yield from _contradictions(twin, columns, found.difference.motion(found.q)[1])


def _kinds_of_force(found: Adequacy) -> Iterator[list[int]]:
    """Indices of the candidates of each kind: one force tested at several speeds or sizes, of which a machine has
    one."""
    names = [candidate.name for candidate in found.forces]
    for name in dict.fromkeys(names):
        yield [k for k, other in enumerate(names) if other == name]


def _contradictions(twin: IV, columns: Columns, velocity: Floats) -> Iterator[Floats]:
    """Mean squares (p,) by which parts of a record contradict each other, along its mean velocities (n,)."""
    for part in _parts(twin, columns, velocity):
        first, second = _solve_part(twin, columns, part), _solve_part(twin, columns, ~part)
        if first is not None and second is not None:
            share = _share(columns, part)
            yield np.maximum((first[0] - second[0]) ** 2 - first[1] - second[1], 0.0) * share * (1 - share)


def _own_moves(found: Adequacy, twin: IV, columns: Columns, follows: bool) -> Floats:
    """(p, k) by how much the estimate moves for a unit of each force: by the best motion, or by instruments."""
    if not follows:
        with suppress(NotIdentifiableError):
            return force_moves(found, twin, columns)
    return found.moves


def believed_squares(found: Adequacy) -> Floats:
    """(k,) mean squares of the coefficients of the forces, as the record and what is plausible in machines say.

    Where the model is contradicted, a force counts by its part of what the one explains that explains most, and that
    by its part of all that is wrong: noise of the force has no single cause, and is in the standard deviation. One that
    is tested for, but not supposed, counts only where it explains nearly as much as the first.
    """
    prior = np.array([candidate.plausible for candidate in found.forces])
    squares = believed_square(found.size, found.size_std, prior)
    if not found.missed:
        return np.where(prior > 0, squares, 0.0) * (1.0 if found.follows else found.explained)
    explained = np.minimum(found.gain / found.gain[found.missed[0]], 1.0)
    asked = np.where(explained > ESTIMATOR_TUNING.adequacy_nearly, found.size**2, 0.0)
    return np.where(prior > 0, squares * explained, asked) * found.explained


def believed_square(size: Floats, std: Floats, plausible: Floats) -> Floats:
    """(k,) mean squares of coefficients that a record finds to be size (k,) with standard deviations std (k,), where a
    machine has one of the plausible size (k,) or none."""
    prior, variance = plausible**2, std**2
    share = prior / (prior + variance)
    evidence = (np.log(variance / (prior + variance)) + share * (size / std) ** 2) / 2
    weight = 1 / (1 + np.exp(-np.clip(evidence, -TUNING.most_evidence, TUNING.most_evidence)) / TUNING.verdict_odds)
    return np.asarray(weight * (share * variance + (share * size) ** 2))


def _parts(twin: IV, columns: Columns, velocity: Floats) -> Iterator[NDArray[np.bool_]]:
    """Which of the samples in use are in one of the two parts: the first half, fast, forward."""
    n = columns.z.size
    yield np.arange(n) < n // 2
    velocity = filter_force(velocity, twin, columns.used.size)[columns.used]
    speed = np.abs(velocity)
    yield speed > np.median(speed)
    yield velocity > 0


def _share(columns: Columns, part: NDArray[np.bool_]) -> Floats:
    """(p,) of the information on each parameter that both parts have the part that the first one has: as many of two
    different values are in the estimate from both, which so scatter by share (1 - share) of the square between them."""
    scaled = columns.phi / np.linalg.norm(columns.phi, axis=0)
    inside, outside = (1 / np.diagonal(np.linalg.pinv(phi.T @ phi)) for phi in (scaled[part], scaled[~part]))
    return np.asarray(inside / (inside + outside))


def _solve_part(twin: IV, columns: Columns, part: NDArray[np.bool_]) -> tuple[Floats, Floats] | None:
    """Estimate (p,) from a part of the samples in use, and its variances (p,); None if the part identifies nothing."""
    own = replace(columns, phi=columns.phi[part], z=columns.z[part], zeta=columns.zeta[part])
    if not (np.all(np.any(own.zeta != 0, axis=0)) and np.all(np.any(own.phi != 0, axis=0))):
        return None
    try:
        theta, gain = solve_with_instruments(own)
    except NotIdentifiableError:
        return None
    scores = columns.zeta * (part * (columns.z - columns.phi @ theta))[:, None]
    return theta, np.diagonal(scatter(scores @ gain.T, ESTIMATOR_TUNING.instruments_lasting * twin.settle_samples))


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
    """Judge an estimate theta (p,) with standard deviations std (p,) from u, counts: (n,). known: what the counts say
    on the model, if that is known; tolerance: negligible relative error of a parameter."""
    found, spread = _spread(estimator, u, counts, theta, std, known)
    judged = judge(estimator, u, counts, theta, std, found)
    found = found if isinstance(found, Adequacy) else None
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
    nearly = np.where(np.abs(found.z) > TUNING.noise_limit, found.size, 0.0)
    return np.asarray(np.sqrt(apart + found.moves[:p] ** 2 @ nearly**2))


def _spread(
    estimator: Estimator,
    u: NDArray[np.float64],
    counts: NDArray[np.int64],
    theta: Floats,
    std: Floats,
    known: Adequacy | None,
) -> tuple[Examined, Floats]:
    """What the counts say on the model, if anything, and by how much unmodelled effects may move the estimate (p,)."""
    part = recent(estimator, u.size)
    try:
        found = examine_estimate(estimator, u, counts, theta, known)
    except NotIdentifiableError as error:
        return error, spread_without_motion(estimator, u[part], counts[part], theta)
    if found is None:
        return None, np.full(theta.size, np.nan)
    return found, model_spread(estimator, u[part], counts[part], theta, std, found)
