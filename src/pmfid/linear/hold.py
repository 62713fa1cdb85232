"""Was the input held between the samples, or did it run in straight lines? A record can tell where the process is fast.

Both models have the same unknowns and are not nested (Vuong 1989): however far they are from each other, the right one
loses by so much, in twice the logarithm of the likelihood, at most with the chance of a normal deviate of its root.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from pmfid.linear.noise import Noise
from pmfid.linear.prewhitening import prewhitened
from pmfid.linear.solve import Point, Problem, descend, visit

#: The other hold is better where so few records with the right one would say so, at the worst.
CHANCE = 1e-4
#: A model is judged once a step would lower its sum of squares by less than this part.
SETTLED = 1e-6


def other_hold_is_better(problem: Problem, point: Point, noise: Noise | None) -> bool:
    """Does the record follow a model with the other hold of its input, at any parameters, better than chance explains?

    point: the estimate; noise: its colour beside the input. No, where the spacing lets no filter whiten the noise, and
    where a reference says that the sum of squares is no measure."""
    if noise is None or problem.referenced:
        return False
    white = prewhitened(problem, noise)
    if white is problem and noise.coefficients.size:
        return False
    with np.errstate(all="ignore"):
        try:
            mine, other = (_least(part, point.theta, noise) for part in (white, _turned(white)))
        except (np.linalg.LinAlgError, ValueError):
            return False
    samples = sum(stretch.rows.size for stretch in white.stretches)
    return bool(samples * np.log(max(mine, 1e-300) / max(other, 1e-300)) > chdtri(1, 2 * CHANCE))


def _turned(problem: Problem) -> Problem:
    return replace(problem, stretches=tuple(replace(stretch, held=not stretch.held) for stretch in problem.stretches))


def _least(problem: Problem, theta: NDArray[np.float64], noise: Noise) -> float:
    """The least sum of squares near theta (p,) of the problem before the filter."""
    theta = theta.copy()
    if problem.structure.offset:
        theta[problem.structure.linear - 1] *= float(np.sum(noise.whitener))
    start = visit(problem, theta, np.zeros((len(problem.stretches), problem.structure.n)))
    return descend(problem, start, SETTLED).point.cost
