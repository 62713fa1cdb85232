"""What an input and an encoder show, from the derivatives of the body."""

from __future__ import annotations

import numpy as np

from pmfid.fit.posterior import STEPS, allowed_region
from pmfid.fit.problem import FitProblem
from pmfid.fit.shooting import settle_starts
from pmfid.fit.solve import START, root_of_rows
from pmfid.fit.starts import soften
from pmfid.fit.within import information_rows, stack, start_precision
from pmfid.types import Floats

#: Steps of the walk of a prediction, whose standard deviations have an error of about 7 %.
FEW_STEPS = STEPS // 5


def expect_covariance(x: Floats, slopes: Floats, precision: Floats) -> Floats:
    """Return the covariance (p, p) of a fit that explains the counts of a motion x (n,) [counts].

    `slopes` (n, p) are the derivatives of x, and `precision` (p,) those of the parameters' prior. The start position is
    unknown. The counts leave a region of parameters, which is several times smaller than least squares say.
    """
    J, precision = np.column_stack([slopes, np.ones(x.size)]), np.append(precision, START[0])
    root = root_of_rows(information_rows(J, precision))
    bound, rng, prior = np.full(x.size, 0.5), np.random.default_rng(1), (precision, np.zeros(precision.size))
    _, covariance = allowed_region(x - np.floor(x) - 0.5, J, bound, root, rng, prior, FEW_STEPS)
    return covariance[:-1, :-1]


def predict_fit(problem: FitProblem, theta: Floats) -> Floats:
    """Return the relative standard errors (p,) of least squares on the counts of a record, for the machine at theta."""
    q = problem.start(theta)
    starts = settle_starts(problem, soften(problem.stretches), q, problem.first_starts())
    J = stack(problem.linearise(q, starts))[1]
    root = root_of_rows(information_rows(J, np.append(np.zeros(q.size), start_precision(starts))))
    std: Floats = np.linalg.norm(root[: q.size], axis=1)
    relative = np.isin(range(q.size), problem.machine.logs)
    return np.where(relative, std, std / np.abs(theta))
