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
    """Return the root mean square shift (p,) that unmodelled effects may cause in an estimate theta (p,).

    The estimate has the standard deviations std (p,) and comes from u (n,) and counts (n,). The shift of an unknown
    that is no parameter of the equation is NaN. `found` is the adequacy of the model on the same record. If the counts
    contradict the model, each required force enters with its estimated size.
    """
    spread = np.full(theta.size, np.nan)
    equation = slice(0, len(estimator.equation.names))
    twin = like(IV, estimator, prefilter_zeros=None)
    best = found.q[equation] * found.difference.scale[equation]
    columns = twin.columns_at(best, u, counts)
    with np.errstate(all="ignore"):  # effects without a finite shift do not count
        largest = _largest(list(_views(estimator, twin, columns, theta[equation], std[equation], best, found)))
        spread[equation] = np.sqrt(largest + found.unseen[: largest.size] ** 2)
    return spread


def spread_without_motion(estimator: Estimator, u: Floats, counts: NDArray[np.int64], theta: Floats) -> Floats:
    """Return the shift (p,) by unmodelled effects if no motion of the model can be fitted to the counts.

    Without a fitted motion, no single effect can be identified. Therefore the shift is the contradiction between parts
    of the record. If the parts give no estimate, the shift is as large as the estimate itself.
    """
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
    """Return the largest mean square (p,) of all views, without values that are not finite."""
    each = np.array(views)
    return np.asarray(np.max(np.where(np.isfinite(each), each, 0.0), axis=0))


def _views(
    estimator: Estimator, twin: IV, columns: Columns, theta: Floats, std: Floats, best: Floats, found: Adequacy
) -> Iterator[Floats]:
    """Yield the mean squares (p,) of the shift, one array for each method of estimation."""
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
    yield from _contradictions(twin, columns, found.difference.read_velocity(found.q))


def _kinds_of_force(found: Adequacy) -> Iterator[list[int]]:
    """Yield the indices of the candidates of each kind.

    All candidates of a kind are the same force, tested at several speeds or sizes. A machine has only one force of each
    kind.
    """
    names = [candidate.name for candidate in found.forces]
    for name in dict.fromkeys(names):
        yield [k for k, other in enumerate(names) if other == name]


def _contradictions(twin: IV, columns: Columns, velocity: Floats) -> Iterator[Floats]:
    """Yield the mean squares (p,) by which parts of a record, split along its mean velocities (n,), contradict each
    other.
    """
    for part in _parts(twin, columns, velocity):
        first, second = _solve_part(twin, columns, part), _solve_part(twin, columns, ~part)
        if first is not None and second is not None:
            share = _share(columns, part)
            yield np.maximum((first[0] - second[0]) ** 2 - first[1] - second[1], 0.0) * share * (1 - share)


def _own_moves(found: Adequacy, twin: IV, columns: Columns, follows: bool) -> Floats:
    """Return the shift of the estimate (p, k) for a unit of each force.

    The shift follows from the best motion of the model or from the instruments.
    """
    if not follows:
        with suppress(NotIdentifiableError):
            return force_moves(found, twin, columns)
    return found.moves


def believed_squares(found: Adequacy) -> Floats:
    """Return the mean squares (k,) of the coefficients of the forces, given the record and plausible sizes in machines.

    If the counts contradict the model, the weight of a force is its explained part, divided by the explained part of
    the best force. All weights are scaled by the part of the misfit that the best force explains. Random noise of the
    force has no single cause, and is already in the standard deviation. A force without a plausible size counts only if
    it explains nearly as much as the best force.
    """
    prior = np.array([candidate.plausible for candidate in found.forces])
    squares = believed_square(found.size, found.size_std, prior)
    if not found.missed:
        return np.where(prior > 0, squares, 0.0) * (1.0 if found.follows else found.explained)
    explained = np.minimum(found.gain / found.gain[found.missed[0]], 1.0)
    asked = np.where(explained > ESTIMATOR_TUNING.adequacy_nearly, found.size**2, 0.0)
    return np.where(prior > 0, squares * explained, asked) * found.explained


def believed_square(size: Floats, std: Floats, plausible: Floats) -> Floats:
    """Return the mean squares (k,) of coefficients with estimates `size` (k,) and standard deviations `std` (k,).

    `plausible` (k,) is the usual size of each force. In a given machine, a force may also be absent.
    """
    prior, variance = plausible**2, std**2
    share = prior / (prior + variance)
    evidence = (np.log(variance / (prior + variance)) + share * (size / std) ** 2) / 2
    weight = 1 / (1 + np.exp(-np.clip(evidence, -TUNING.most_evidence, TUNING.most_evidence)) / TUNING.verdict_odds)
    return np.asarray(weight * (share * variance + (share * size) ** 2))


def _parts(twin: IV, columns: Columns, velocity: Floats) -> Iterator[NDArray[np.bool_]]:
    """Yield a mark for the first half of the used samples, for the fast samples and for the forward samples."""
    n = columns.z.size
    yield np.arange(n) < n // 2
    velocity = filter_force(velocity, twin, columns.used.size)[columns.used]
    speed = np.abs(velocity)
    yield speed > np.median(speed)
    yield velocity > 0


def _share(columns: Columns, part: NDArray[np.bool_]) -> Floats:
    """Return the part (p,) of the information on each parameter that the first part of the record contains.

    If the values in both parts differ, the variance of the estimate from both is share (1 - share) times the squared
    difference.
    """
    scaled = columns.phi / np.linalg.norm(columns.phi, axis=0)
    inside, outside = (1 / np.diagonal(np.linalg.pinv(phi.T @ phi)) for phi in (scaled[part], scaled[~part]))
    return np.asarray(inside / (inside + outside))


def _solve_part(twin: IV, columns: Columns, part: NDArray[np.bool_]) -> tuple[Floats, Floats] | None:
    """Return the estimate (p,) and its variances (p,) from a part of the used samples, or None if the part
    identifies nothing.
    """
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
    """All findings on an estimate with p parameters.

    `judged` holds all findings, whether or not they matter. `spread` (p,) is the shift that unmodelled effects may
    cause, or NaN if unknown. `matter` is the possible error of the parameters. `adequacy` says how the model agrees
    with the counts, or is None.
    """

    judged: tuple[Finding, ...]
    spread: Floats
    matter: Matter
    adequacy: Adequacy | None

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The findings that matter, with the size of the possible error, and all others as notes."""
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
    """Judge an estimate theta (p,) with standard deviations std (p,) from u (n,) and counts (n,).

    `known` is the adequacy of the model if it has been computed before. `tolerance` is the negligible relative error of
    a parameter.
    """
    found, spread = _spread(estimator, u, counts, theta, std, known)
    judged = judge(estimator, u, counts, theta, std, found)
    found = found if isinstance(found, Adequacy) else None
    p = len(estimator.equation.names)
    shown = np.full(p, np.nan) if found is None else _estimate_shown_bias(found, theta[:p], std[:p], spread[:p])
    return Verdict(judged, spread, matter_of(estimator, theta, std, shown, tolerance), found)


def _estimate_shown_bias(found: Adequacy, theta: Floats, std: Floats, spread: Floats) -> Floats:
    """Return the shift (p,) that the visible effects in the record may cause in an estimate.

    If the counts contradict the model, the shift excludes effects that no record with the same input shows. A separate
    finding reports effects that do not show in a record. If the model is adequate, the shift contains forces that are
    nearly visible and the distance to the best motion. Effects that do not show in the record are covered by the
    interval.
    """
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
    """Return the examination of the model on the counts and the shift (p,) that unmodelled effects may cause."""
    part = recent(estimator, u.size)
    try:
        found = examine_estimate(estimator, u, counts, theta, known)
    except NotIdentifiableError as error:
        return error, spread_without_motion(estimator, u[part], counts[part], theta)
    if found is None:
        return None, np.full(theta.size, np.nan)
    return found, model_spread(estimator, u[part], counts[part], theta, std, found)
