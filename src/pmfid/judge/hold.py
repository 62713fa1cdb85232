"""Was the input held between the samples, or did it run in straight lines? A record can tell where the process is fast.

Both models have the same unknowns and are not nested (Vuong 1989): however far they are from each other, the right one
loses by x, in twice the logarithm of the likelihood, at most with the probability of a normal deviate of sqrt(x).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from pmfid.transfer.noise import Noise
from pmfid.transfer.prewhitening import prewhiten_problem
from pmfid.transfer.solve import ProcessPoint, ProcessProblem, descend, visit

#: The other hold is better where so few records with the right one would say so, at the worst.
CHANCE = 1e-4
#: Two values of a parameter are far apart from this number of standard errors on.
FAR = 2.0
#: A model is judged once a step would lower its sum of squares by less than this part.
SETTLED = 1e-6


@dataclass(frozen=True)
class Hold:
    """better: the record follows a model with the other hold of its input, at any parameters, better than chance
    explains. hidden: the record does not tell the two holds apart, and a parameter differs between them by many
    standard errors."""

    better: bool = False
    hidden: bool = False


def look_at_hold(problem: ProcessProblem, point: ProcessPoint, noise: Noise | None) -> Hold:
    """Which hold has the input, and does it matter? point: the estimate; noise: colour of the residual without the
    input. No finding if the spacing lets no filter whiten the noise, or if a reference makes the sum of squares no
    measure."""
    if noise is None or problem.referenced:
        return Hold()
    white = prewhiten_problem(problem, noise)
    if white is problem and noise.coefficients.size:
        return Hold()
    with np.errstate(all="ignore"):
        try:
            mine, other = (_best(part, point.theta, noise) for part in (white, _swap_hold(white)))
            far = _far_apart(mine, other)
        except (np.linalg.LinAlgError, ValueError):
            return Hold()
    samples = sum(stretch.rows.size for stretch in white.stretches)
    gained = samples * np.log(max(mine.cost, 1e-300) / max(other.cost, 1e-300))
    worth = chdtri(1, 2 * CHANCE)
    return Hold(bool(gained > worth), bool(abs(gained) <= worth and far))


def _far_apart(mine: ProcessPoint, other: ProcessPoint) -> bool:
    """Does a parameter differ by more than its standard errors explain?"""
    size = np.maximum(np.linalg.norm(mine.zeta, axis=0), 1e-300)
    scaled = mine.zeta / size
    variances = np.diag(np.linalg.inv(scaled.T @ scaled)) / size**2 * mine.cost / mine.error.size
    return bool(np.any((mine.theta - other.theta) ** 2 > FAR**2 * variances))


def _swap_hold(problem: ProcessProblem) -> ProcessProblem:
    return replace(problem, stretches=tuple(replace(stretch, held=not stretch.held) for stretch in problem.stretches))


def _best(problem: ProcessProblem, theta: NDArray[np.float64], noise: Noise) -> ProcessPoint:
    """Where the sum of squares is least near theta (p,) of the problem before the filter."""
    theta = theta.copy()
    if problem.structure.offset:
        theta[problem.structure.linear - 1] *= float(np.sum(noise.whitener))
    start = visit(problem, theta, np.zeros((len(problem.stretches), problem.structure.n)))
    return descend(problem, start, SETTLED).point
