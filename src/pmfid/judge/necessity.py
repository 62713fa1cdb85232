"""Is the input needed, is each pole needed? Likelihood ratios for noise of any colour.

Poles can be tuned to any frequency of the noise, and the best of many wins: so a ratio counts only beyond what chance
gives in a part of its cases that falls with the number of samples.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from pmfid.judge.causality import ResidualStretch, estimate_residual_noise
from pmfid.transfer.confidence import covariance, places
from pmfid.transfer.noise import fit_noise, whiten_columns
from pmfid.transfer.prewhitening import prewhiten_problem
from pmfid.transfer.sensitivity import Structure
from pmfid.transfer.solve import ProcessPoint, ProcessProblem, descend, first_guess, refine, visit
from pmfid.types import Floats

#: A record of noise alone passes but so often.
CHANCE = 1e-2
#: A model is judged once a step would lower its sum of squares by less than this part.
SETTLED = 1e-6
#: An estimate is moved that far by the colour of the noise in so small a part of the cases.
ELSEWHERE = 1e-3


def depends_on_input(problem: ProcessProblem, point: ProcessPoint) -> bool:
    """Does the answer to the input explain more of the output than chance? The start and a constant may do their part
    without it."""
    first, last = problem.structure.free, problem.structure.free + problem.structure.m + 1
    without = np.r_[point.theta[:first], np.zeros(last - first), point.theta[last:]]
    rest = visit(problem, without, np.zeros_like(point.initial))
    alone = rest.error
    if problem.structure.offset:
        constant = rest.zeta[:, problem.structure.linear - 1]
        alone = alone - constant * float(constant @ alone) / max(float(constant @ constant), 1e-300)
    noise, place = fit_noise(point.error, places(problem)), places(problem)
    both = whiten_columns(noise, np.column_stack([point.error, alone]), place)
    left, whole = (float(np.sum(column**2)) for column in both[noise.coefficients.size :].T)
    return _reduces_residual(whole, left, point.error.size, problem.structure.size)


@dataclass(frozen=True)
class Second:
    """A second look at an estimate. surplus: one pole and one zero less do as well, so nothing determines them;
    moved: whitening of the noise moves the estimate by more than its standard errors allow (Hausman 1978), so the
    estimate has taken noise for dynamics."""

    surplus: bool
    moved: bool


def second_look(problem: ProcessProblem, point: ProcessPoint) -> Second:
    """A second look at the estimate of a point, for noise of any colour.

    A pole can settle on a resonance of the noise, and the residual no longer rings. The colour is therefore estimated
    from the residual of a model with one pole less, without what recent inputs explain."""
    structure = problem.structure
    smaller = Structure(max(structure.n - 1, 1), max(structure.m - 1, 0), structure.offset)
    plain = Structure(structure.n, structure.m, structure.offset)
    if problem.referenced or structure != plain:  # what is known of the poles and the dead time is no matter of noise
        return Second(False, False)
    with np.errstate(all="ignore"):
        try:
            rest = point if smaller == structure else _settle_fit(replace(problem, structure=smaller))
            noise = estimate_residual_noise(pair_inputs(problem, rest.error), rest.zeta)
            if noise is None:
                return Second(False, False)
            white = prewhiten_problem(problem, noise)
            factor = float(np.sum(noise.whitener)) if structure.offset and white is not problem else 1.0
            scale = np.r_[np.ones(structure.size - 1), factor]
            start = visit(white, point.theta * scale, np.zeros((len(white.stretches), structure.n)))
            full = descend(white, start, SETTLED).point
            surplus = structure.n > 1 and not _reduces_residual(
                _settle_fit(replace(white, structure=smaller)).cost, full.cost, point.error.size, 2
            )
            return Second(surplus, _exceeds_chance(full.theta / scale - point.theta, covariance(point, problem)))
        except (np.linalg.LinAlgError, ValueError):
            return Second(False, False)


def _exceeds_chance(difference: Floats, cov: Floats) -> bool:
    """Is a difference (p,) too large for its covariance (p, p)?"""
    size = np.sqrt(np.diagonal(cov))
    scaled = difference / size
    distance = scaled @ np.linalg.pinv(cov / np.outer(size, size), hermitian=True) @ scaled
    return bool(distance > chdtri(difference.size, ELSEWHERE))


def _settle_fit(problem: ProcessProblem) -> ProcessPoint:
    found = refine(problem, first_guess(problem, 1.0), SETTLED)
    return found.point if found.settled else descend(problem, found.point, SETTLED).point


def pair_inputs(problem: ProcessProblem, error: Floats) -> list[ResidualStretch]:
    """The residual (N,) of all stretches, split and paired with the inputs."""
    ends = np.cumsum([stretch.rows.size for stretch in problem.stretches])
    parts = zip(problem.stretches, np.split(error, ends[:-1]), strict=True)
    return [ResidualStretch(stretch.inputs, part, stretch.rows) for stretch, part in parts]


def _reduces_residual(whole: float, left: float, samples: int, unknowns: int) -> bool:
    """Is a sum of squares `left` less than `whole` by more than `unknowns` parameters gain by chance?"""
    ratio = samples * np.log(max(whole, 1e-300) / max(left, 1e-300))
    return bool(ratio > chdtri(unknowns, CHANCE / samples))
