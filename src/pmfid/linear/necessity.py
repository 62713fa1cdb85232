"""Is the input needed, is each pole needed? Likelihood ratios for noise of any colour.

Poles can be tuned to any frequency of the noise, and the best of many wins: so a ratio counts only beyond what chance
gives in a part of its cases that falls with the number of samples.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from pmfid.linear.confidence import places
from pmfid.linear.noise import Noise, fit_noise, whitened
from pmfid.linear.prewhitening import prewhitened
from pmfid.linear.sensitivity import Structure
from pmfid.linear.solve import Point, Problem, descend, first_guess, refine, visit

Floats = NDArray[np.float64]

#: A record of noise alone passes but so often.
CHANCE = 1e-2
#: A model is judged once a step would lower its sum of squares by less than this part.
SETTLED = 1e-6


def residual_noise(problem: Problem, point: Point) -> Noise:
    """The colour of what a point of the iteration leaves."""
    size = np.linalg.norm(point.zeta, axis=0)
    Q = np.linalg.qr(point.zeta / np.where(size > 0, size, 1.0))[0]
    return fit_noise(point.error, places(problem), Q)


def depends_on_input(problem: Problem, point: Point) -> bool:
    """Does the answer to the input explain more of the output than chance? The start and a constant may do their part
    without it."""
    n, m = problem.structure.n, problem.structure.m
    a = point.theta[:n]
    without = np.r_[a, np.zeros(m + 1), point.theta[n + m + 1 :]]
    rest = visit(problem, without, np.zeros_like(point.initial))
    alone = rest.error
    if problem.structure.offset:
        constant = rest.zeta[:, -1]
        alone = alone - constant * float(constant @ alone) / max(float(constant @ constant), 1e-300)
    noise, place = fit_noise(point.error, places(problem)), places(problem)
    both = whitened(noise, np.column_stack([point.error, alone]), place)
    left, whole = (float(np.sum(column**2)) for column in both[noise.coefficients.size :].T)
    return _beyond(whole, left, point.error.size, problem.structure.size)


def surplus_pole(problem: Problem, point: Point) -> bool:
    """Would one pole and one zero less do as well? Then nothing tells where they are, whatever the bars."""
    structure = problem.structure
    if structure.n < 2 or problem.referenced:
        return False
    noise = residual_noise(problem, point)
    white = prewhitened(problem, noise)
    theta = point.theta.copy()
    if structure.offset and white is not problem:
        theta[-1] *= np.sum(noise.whitener)
    smaller = replace(white, structure=Structure(structure.n - 1, max(structure.m - 1, 0), structure.offset))
    with np.errstate(all="ignore"):
        try:
            full = descend(white, visit(white, theta, np.zeros((len(white.stretches), structure.n))), SETTLED)
            less = refine(smaller, first_guess(smaller, 1.0), SETTLED)
            if not less.settled:
                less = descend(smaller, less.point, SETTLED)
        except (np.linalg.LinAlgError, ValueError):
            return False
    return not _beyond(less.point.cost, full.point.cost, point.error.size, 2)


def _beyond(whole: float, left: float, samples: int, unknowns: int) -> bool:
    """Is a sum of squares `left` less than `whole` by more than so many unknowns gain by chance?"""
    ratio = samples * np.log(max(whole, 1e-300) / max(left, 1e-300))
    return bool(ratio > chdtri(unknowns, CHANCE / samples))
