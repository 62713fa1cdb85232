"""The covariance that `calibrate` will have after one run of an input."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from pmfid.design.body import prior_of, separate, simulate
from pmfid.design.problem import Problem, parameters_of
from pmfid.fit.prediction import expect_covariance
from pmfid.types import Floats

#: Condition number of an information from which a parameter counts as open.
EXPECTED_OPEN = 1e12
#: Least number of machines, whose mean standard deviation is then known to 10 %.
EXPECTED_MACHINES = 16
#: Deviation of the machines' parameters from the data sheet, as a part of the nominal values.
EXPECTED_WRONG = 0.1


def expected_covariance(problem: Problem, u: ArrayLike) -> Floats | None:
    """Return the mean covariance (p, p) after one run of u (K,), or None if run and prior leave a parameter open.

    The parameters are the unknown and nuisance ones, in their own units. The mean is over machines around the nominal
    one, each with another phase of the encoder. A motion that is the best for the nominal values may come to rest on
    another machine, and bring a hundredth of the information.
    """
    prior = prior_of(problem, problem.names) * np.outer(problem.scale, problem.scale)
    slopes = _centre(simulate(problem, u).slopes * problem.scale)
    if np.linalg.cond(slopes.T @ slopes / problem.variance + prior) > EXPECTED_OPEN:
        return None
    machines = _machines(problem, prior)
    phases = (np.arange(len(machines)) + 0.5) / len(machines)
    each = [_covariance_of(problem, u, *pair, prior) for pair in zip(machines, phases.tolist(), strict=True)]
    return np.asarray(np.mean(each, axis=0) * np.outer(problem.scale, problem.scale))


def _covariance_of(problem: Problem, u: ArrayLike, parameters: Floats, phase: float, prior: Floats) -> Floats:
    """Return the covariance (p, p) of the scaled parameters for one machine, with the prior (p, p).

    Standard deviations of the size of the nominal values hold the parameters of a machine that rests.
    """
    motion = simulate(problem, u, dict(zip(problem.names, parameters.tolist(), strict=True)))
    slopes, known = motion.slopes * problem.scale, prior + np.eye(len(prior))
    if not problem.counted:
        return np.asarray(np.linalg.inv(_centre(slopes).T @ _centre(slopes) / problem.variance + known))
    count, (mixing, precision) = float(problem.resolution or 1.0), separate(known)
    covariance = expect_covariance(motion.x / count + phase, slopes / count @ mixing, precision)
    return np.asarray(mixing @ covariance @ mixing.T)


def _machines(problem: Problem, prior: Floats) -> Floats:
    """Return the parameters (m, p) of machines around the nominal one, with the variance of the prior (p, p) of the
    scaled parameters. Without a prior, a parameter is `EXPECTED_WRONG` of its value off."""
    nominal = np.array([problem.nominal[name] for name in problem.names])
    wrong = EXPECTED_WRONG * np.where(nominal != 0, np.abs(nominal) / problem.scale, 1.0)
    spread = np.linalg.cholesky(np.linalg.inv(prior + np.diag(wrong**-2.0)))
    corners = np.array(list(product((-1.0, 1.0), repeat=nominal.size)))
    corners = np.tile(corners, (-(-EXPECTED_MACHINES // len(corners)), 1))
    values = nominal + corners @ spread.T * problem.scale
    signs = parameters_of(problem.drive)
    lower = np.where([signs[name] for name in problem.names], 0.1 * np.abs(nominal), -np.inf)
    return np.asarray(np.maximum(values, lower))


def _centre(slopes: Floats) -> Floats:
    """Return slopes (n, p) without their means, which a shift of the unknown start position replaces."""
    return np.asarray(slopes - slopes.mean(axis=0))
