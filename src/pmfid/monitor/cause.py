"""The sets of changes that explain a deviation, compared by their marginal likelihood.

`compare` is a function of the information on the parameters and of the score. A set of changes contains parameters, the
input gain, the scale of the encoder, or all frictions together. Sizes are relative.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from pmfid.estimators.facts import INPUT_GAIN, forces_of
from pmfid.models.equation import COULOMB_BACKWARD, COULOMB_FORWARD, Equation
from pmfid.monitor.events import ENCODER_SCALE, Change
from pmfid.monitor.scores import Blocks
from pmfid.monitor.tuning import TUNING
from pmfid.types import Floats

#: A dry guide has more friction of every kind.
FRICTION = "friction"

TINY = float(np.finfo(float).tiny)


@dataclass(frozen=True)
class ChangeEvidence:
    """A recursive estimate theta (p,) from the samples since the suspicion, and the covariance (p, p) of its error."""

    theta: Floats
    covariance: Floats


@dataclass(frozen=True)
class Candidates:
    """The changes that are possible.

    `names` (p,) are the parameters, and `sizes` (p,) their values to which changes are relative. `free` (p,) is true
    for parameters that may change. `scales` has the effect of each common factor on the relative parameters (p,).
    """

    names: tuple[str, ...]
    sizes: tuple[float, ...]
    free: tuple[bool, ...]
    scales: tuple[tuple[str, tuple[float, ...]], ...]

    @property
    def directions(self) -> dict[str, Floats]:
        """The effect of each change on the relative parameters (p,). Common factors come first."""
        unit = np.eye(len(self.names))
        single = {name: unit[i] for i, name in enumerate(self.names) if self.free[i]}
        return {name: np.array(way) for name, way in self.scales} | single


@dataclass(frozen=True)
class Explanation:
    """Sets of changes that explain alike, because they move the parameters in the same space.

    `log_odds` is the logarithm of the posterior probability, except for a constant. `spread` is the most likely prior
    standard deviation of the changes.
    """

    sets: tuple[tuple[str, ...], ...]
    log_odds: float
    spread: float


@dataclass(frozen=True)
class Cause:
    """The changes that explain a deviation best, the largest first, and the sets that explain it as well.

    `deviation` (p,) is the effect of the changes on the parameters. `best` has the changes, and `rest` are the sets
    with other effects, the most likely first.
    """

    changes: tuple[Change, ...]
    deviation: Floats
    best: Explanation
    rest: tuple[Explanation, ...]

    @property
    def near(self) -> tuple[Explanation, ...]:
        """The sets with other effects that the evidence does not exclude."""
        return self.find_within(TUNING.cause_strong)

    def find_within(self, odds: float) -> tuple[Explanation, ...]:
        return tuple(one for one in self.rest if self.best.log_odds - one.log_odds < math.log(odds))

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(one.parameter for one in self.changes)

    @property
    def others(self) -> tuple[str, ...]:
        """All other sets that explain the deviation as well."""
        sets = [*self.best.sets[1:], *(one for each in self.near for one in each.sets)]
        return tuple(" and ".join(one) for one in sets)

    @property
    def size(self) -> float:
        """Largest relative change."""
        return max(abs(one.relative) for one in self.changes)

    @property
    def largest(self) -> float:
        """Largest relative change within three standard errors."""
        return max(abs(one.relative) + 3 * one.relative_std for one in self.changes)

    def is_open(self, growth: float) -> bool:
        """Return whether `growth` times the information may exclude a further set.

        Logarithms of odds grow in proportion to the information. Between one change and several the evidence decides,
        however small the odds are now.
        """
        single = len(self.names) == 1
        return any(
            single
            or len(one.sets[0]) == 1
            or (self.best.log_odds - one.log_odds) * growth > math.log(TUNING.cause_clear)
            for one in self.find_within(TUNING.cause_clear)
        )


def candidates_of(equation: Equation, theta: Floats, information: Floats, fixed: Collection[str] = ()) -> Candidates:
    """Return the possible changes of the parameters theta (p,) of an equation, except the constant ones in `fixed`.

    Changes are relative to theta. Changes of a force that may have either sign are relative to Coulomb friction if that
    is larger. If the reference is 0, they are relative to the value that has as much effect as all other parameters, by
    the information (p, p).
    """
    terms, names = equation.unknown, equation.names
    coulomb = max(equation.role_values(theta)[COULOMB_FORWARD : COULOMB_BACKWARD + 1])
    signed = [
        not one and term.signal in ("moving", "place") for one, term in zip(equation.positive, terms, strict=True)
    ]
    sizes = np.maximum(np.abs(theta), np.where(signed, coulomb, 0.0))
    effect = math.sqrt(max(float(theta @ information @ theta), 0.0)) / np.sqrt(
        np.maximum(np.diagonal(information), TINY)
    )
    sizes = np.where(sizes > 0, sizes, np.maximum(effect, TINY))
    part = theta / sizes
    frictions = [one and i != equation.leading for i, one in enumerate(equation.positive)]
    forces = forces_of(equation)
    affected = {INPUT_GAIN: [name in forces for name in names]}
    if not equation.shaped:
        affected[ENCODER_SCALE] = [term.facts.measured for term in terms]
    if sum(part[frictions] > 0) > 1:
        affected[FRICTION] = frictions
    scales = tuple((name, tuple((part * flags).tolist())) for name, flags in affected.items())
    return Candidates(names, tuple(sizes.tolist()), tuple(name not in fixed for name in names), scales)


def compare(information: Floats, score: Floats, candidates: Candidates, tolerance: float) -> list[Explanation]:
    """Return the sets of changes, the most likely first.

    `information` (p, p) and `score` (p,) belong to the deviation d of the relative parameters: the likelihood of d is
    exp(score^T d - d^T information d / 2). A change c along the directions V of a set has the prior N(0, spread^2), and
    every free parameter deviates by N(0, (tolerance / 2)^2) without a change. The marginal likelihood of a set is then
    closed, with Q = spread^2 V V^T + (tolerance / 2)^2 I:

        log L = score^T Q (I + information Q)^-1 score / 2 - log det(I + information Q) / 2.
    """
    spaces = _spaces(candidates.names, candidates.free, candidates.scales)
    effect = np.array([space @ space.T for _, space in spaces])
    prior = _normal(candidates, tolerance) + np.square(TUNING.cause_spreads)[:, None, None, None] * effect
    matrix = np.eye(len(score)) + information @ prior
    fit = np.linalg.solve(matrix, score[:, None])[..., 0]
    logs = (np.einsum("i,skij,skj->sk", score, prior, fit) - np.linalg.slogdet(matrix)[1]) / 2
    further = np.array([space.shape[1] - 1 for _, space in spaces])
    odds = np.logaddexp.reduce(logs, axis=0) + math.log(TUNING.cause_further) * further
    spread = np.array(TUNING.cause_spreads)[np.argmax(logs, axis=0)]
    order = np.argsort(-odds, kind="stable")
    return [Explanation(spaces[k][0], float(odds[k]), float(spread[k])) for k in order.tolist()]


def measure(
    information: Floats, score: Floats, candidates: Candidates, names: Sequence[str], spread: float, tolerance: float
) -> tuple[Floats, Floats]:
    """Return the relative changes (k,) of a set and their standard deviations, from the posterior of `compare`.

    Parameters may deviate within the tolerance in addition. The change of a parameter contains this deviation.
    """
    wide = [name for name in candidates.directions if name in names]
    mean, covariance = _posterior(information, score, candidates, wide, spread, tolerance)
    sizes, steps = _changes(mean, wide, candidates), 1e-6 * np.eye(mean.size)
    slope = np.array([(_changes(mean + step, wide, candidates) - sizes) / 1e-6 for step in steps])
    stds = np.sqrt(np.maximum(np.einsum("ik,ij,jk->k", slope, covariance, slope), 0.0))
    order = [wide.index(name) for name in names]
    return sizes[order], stds[order]


def explain(
    evidence: ChangeEvidence, theta: Floats, equation: Equation, tolerance: float, fixed: Collection[str] = ()
) -> Cause:
    """Return the changes from the reference theta (p,) that explain an estimate best.

    `tolerance` is the relative deviation that is no change. Parameters in `fixed` are constant.
    """
    information, score, candidates = _relative(evidence, theta, equation, fixed)
    best, *rest = compare(information, score, candidates, tolerance)
    names, spread = best.sets[0], best.spread
    best = replace(best, sets=(*best.sets, *_find_equal_pair(names, candidates)))
    sizes = zip(names, *measure(information, score, candidates, names, spread, tolerance), strict=True)
    changes = [_change(name, size, std, candidates, equation) for name, size, std in sizes]
    mean = _posterior(information, score, candidates, names, spread, tolerance)[0][: len(names)]
    effect = mean @ np.array([candidates.directions[name] for name in names])
    order = sorted(changes, key=lambda one: -abs(one.relative))
    return Cause(tuple(order), effect * candidates.sizes, best, tuple(rest))


def _find_equal_pair(names: tuple[str, ...], candidates: Candidates) -> list[tuple[str, ...]]:
    """Return the two parameters whose equal changes are the same as a scale of the encoder, if this is the only change.

    No evidence separates the two causes, however rare equal changes are.
    """
    scale = dict(candidates.scales).get(ENCODER_SCALE, ())
    moved = tuple(name for name, part in zip(candidates.names, scale, strict=False) if part)
    return [moved] if names == (ENCODER_SCALE,) and len(moved) == 2 else []


def start_of(blocks: Blocks, deviation: Floats, latest: int) -> int:
    """Return the index of the first block that shows a deviation (p,), at most `latest`.

    For the sums S, W, Z of the blocks from a start and v the deviation, the generalised likelihood ratio (Willsky and
    Jones 1976) is (v^T W^T Z^-1 S)^2 / (v^T W^T Z^-1 W v), except for the noise. Among equal starts the last counts,
    because no block before it shows the change.
    """
    S, W, Z = (np.cumsum(part[::-1], axis=0)[::-1] for part in (blocks.score, blocks.cross, blocks.square))
    unit = np.sqrt(np.maximum(np.diagonal(Z[0]), TINY))
    moved = (W @ deviation) / unit
    weighted = np.einsum("nij,nj->ni", np.linalg.pinv(Z / np.outer(unit, unit), rcond=1e-6, hermitian=True), moved)
    match = np.einsum("ni,ni->n", weighted, S / unit)
    ratio = match**2 / np.maximum(np.einsum("ni,ni->n", weighted, moved), TINY)
    late = ratio[latest::-1]
    return len(late) - 1 - int(np.argmax(late >= (1 - 1e-9) * late.max()))


def _relative(
    evidence: ChangeEvidence, theta: Floats, equation: Equation, fixed: Collection[str]
) -> tuple[Floats, Floats, Candidates]:
    """Return information (p, p) and score (p,) of the relative parameters, and the possible changes."""
    std = np.sqrt(np.maximum(np.diagonal(evidence.covariance), TINY))
    precision = np.linalg.pinv(evidence.covariance / np.outer(std, std), hermitian=True) / np.outer(std, std)
    candidates = candidates_of(equation, theta, precision, fixed)
    size = np.array(candidates.sizes)
    information = precision * np.outer(size, size)
    return information, information @ ((evidence.theta - theta) / size), candidates


def _normal(candidates: Candidates, tolerance: float) -> Floats:
    """Return the prior covariance (p, p) of deviations that are no change."""
    return np.diag(np.where(candidates.free, (tolerance / 2) ** 2, 0.0))


def _posterior(
    information: Floats,
    score: Floats,
    candidates: Candidates,
    names: Sequence[str],
    spread: float,
    tolerance: float,
) -> tuple[Floats, Floats]:
    """Return mean (k + p,) and covariance of the changes along the directions of a set, and of further deviations."""
    p = len(score)
    effect = np.hstack([np.array([candidates.directions[name] for name in names]).T, np.eye(p)])
    prior = np.diag(np.r_[np.full(len(names), spread**2), np.diagonal(_normal(candidates, tolerance))])
    seen = effect @ prior
    matrix = np.eye(p) + information @ seen @ effect.T
    mean = seen.T @ np.linalg.solve(matrix, score)
    return mean, prior - seen.T @ np.linalg.solve(matrix, information @ seen)


def _changes(along: Floats, names: Sequence[str], candidates: Candidates) -> Floats:
    """Return the relative changes (k,) of a set from its parts `along` (k + p,) of a deviation.

    Common factors come first in `names`. Every factor applies to the parameters that the ones before it have changed.
    """
    scales, factor, found = dict(candidates.scales), np.ones(len(candidates.names)), []
    for name, size in zip(names, along[: len(names)], strict=True):
        if name in scales:
            affected = np.array(scales[name]) != 0
            grown = max(1 + size / factor[affected][0], 0.01)
            factor = np.where(affected, grown * factor, factor)
            found.append((grown if name == FRICTION else 1 / grown) - 1)
        else:
            i = candidates.names.index(name)
            found.append((size + along[len(names) + i]) / factor[i])
    return np.array(found)


def _change(name: str, relative: float, std: float, candidates: Candidates, equation: Equation) -> Change:
    """Return a change with its unit."""
    if name not in candidates.names:
        scale = equation.input_gain if name == INPUT_GAIN else 1.0
        return Change(name, "", float(relative * scale), float(std * abs(scale)), float(relative))
    i = candidates.names.index(name)
    size = candidates.sizes[i]
    return Change(name, equation.units[i], float(relative * size), float(std * size), float(relative))


@cache
def _spaces(
    names: tuple[str, ...], free: tuple[bool, ...], scales: tuple[tuple[str, tuple[float, ...]], ...]
) -> tuple[tuple[tuple[tuple[str, ...], ...], Floats], ...]:
    """Return the sets of changes by the space (p, k) of their effect.

    The sets are the single changes, all pairs, and all parameters together. Friction as a whole and one of its kinds
    are no pair, because two kinds are.
    """
    ways = Candidates(names, (), free, scales).directions
    parameters = tuple(name for name in ways if name in names)
    frictions = {name for name, part in zip(names, dict(scales).get(FRICTION, ()), strict=False) if part}
    pairs = [one for one in itertools.combinations(ways, 2) if not (FRICTION in one and frictions & set(one))]
    sets = [*((name,) for name in ways), *pairs, *([parameters] if len(parameters) > 2 else [])]
    found = list[tuple[list[tuple[str, ...]], Floats]]()
    for one in sorted(sets, key=lambda one: len(set(one) - set(parameters))):
        space = np.array([ways[name] for name in one]).T
        rank = np.linalg.matrix_rank(space)
        same = [(alike, np.hstack([other, space])) for alike, other in found if other.shape == space.shape]
        like = [alike for alike, both in same if np.linalg.matrix_rank(both, tol=1e-9) == rank]
        if rank == len(one) and like:
            like[0].append(one)
        elif rank == len(one):
            found.append(([one], space))
    return tuple((tuple(alike), space) for alike, space in found)
