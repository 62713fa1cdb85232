"""Likelihood of positions that an encoder rounds, and the estimate that maximises the likelihood.

A position x is logged as k steps if x + noise rounds to k. A simulated position within half a step of the logged one is
as good as any other, so a long standstill counts once. Least squares count each of its equal samples. The noise is
normal with the standard deviation `scatter`, and contains the unmodelled effects. Deviations and scatters are in steps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pmfid.actuators.problem import ServoProblem
from pmfid.actuators.tuning import TUNING
from pmfid.estimators.likelihood import count_likelihood, log_probability
from pmfid.types import Floats


@dataclass(frozen=True)
class RoundedFit:
    """The likelihood at coordinates `z` (p + 2,): derivatives (n, p + 2) [steps] and deviations (n,) [steps]."""

    jacobian: Floats
    deviation: Floats
    scatter: float

    @property
    def misfit(self) -> float:
        """Factor of the standard errors for unmodelled effects, which move the estimate by their scatter."""
        return max(measure_persistence(self.deviation, self.scatter) / TUNING.least_scatter, 1.0)

    @property
    def curvature(self) -> Floats:
        """Second derivatives (p + 2, p + 2) of the negative logarithm of the likelihood."""
        return np.asarray((self.jacobian * compute_weight(self.deviation, self.scatter)[:, None]).T @ self.jacobian)

    @property
    def scores(self) -> Floats:
        """Gradient of the negative logarithm of the likelihood by sample (n, p + 2)."""
        return np.asarray(self.jacobian * compute_score(self.deviation, self.scatter)[:, None])

    def shift(self, change: Floats) -> Floats:
        """Return the change (p + 2,) of the estimate if the simulated position changes by `change` (n,) [steps].

        The weights are mean slopes of the score over the change, because the score is flat within half a step.
        """
        change = np.nan_to_num(np.clip(change, -TUNING.widest, TUNING.widest), nan=TUNING.widest)
        moved = compute_score(self.deviation + change, self.scatter) - compute_score(self.deviation, self.scatter)
        tiny = np.abs(change) < 1e-6
        slope = np.where(tiny, compute_weight(self.deviation, self.scatter), moved / np.where(tiny, 1.0, change))
        return -solve_scaled((self.jacobian * slope[:, None]).T @ self.jacobian, self.jacobian.T @ moved)


def measure_correlation(residual: Floats) -> float:
    """Return the correlation of a residual (n,) from one sample to the next, within [0, 0.999]."""
    centred = residual - residual.mean()
    return float(np.clip(centred[1:] @ centred[:-1] / max(centred @ centred, 1e-300), 0.0, 0.999))


def measure_independence(residual: Floats) -> float:
    """Return the part of correlated samples (n,) that counts as independent (Bayley and Hammersley 1946)."""
    rho = measure_correlation(residual)
    return (1 - rho) / (1 + rho)


def measure_persistence(deviation: Floats, scatter: float) -> float:
    """Return the scatter [steps] if deviations (n,) [steps] persist from one sample to the next, and 0 if not."""
    return scatter if measure_correlation(deviation) > TUNING.correlated else 0.0


def compute_cost(deviation: Floats, scatter: float) -> float:
    """Return the negative logarithm of the likelihood."""
    return -float(log_probability(_measure_size(deviation), scatter).sum())


def _measure_size(deviation: Floats) -> Floats:
    """Return the sizes (n,) of deviations, limited to what the likelihood computes without an overflow."""
    return np.minimum(np.abs(deviation), TUNING.widest)


def compute_score(deviation: Floats, scatter: float) -> Floats:
    """Return the derivative (n,) of the cost by the deviation."""
    return np.asarray(np.sign(deviation) * count_likelihood(_measure_size(deviation), scatter)[1])


def compute_weight(deviation: Floats, scatter: float) -> Floats:
    """Return the second derivative (n,) of the cost by the deviation."""
    _, slope, bend = count_likelihood(_measure_size(deviation), scatter)
    return np.clip(slope**2 + bend, 0.0, scatter**-2)


def find_scatter(deviation: Floats) -> float:
    """Return the scatter [steps] that maximises the likelihood, and at least `TUNING.least_scatter`.

    Deviations of about one size count together, by their mean.
    """
    from scipy.optimize import minimize_scalar  # slow to import

    size = _measure_size(deviation)
    fine = np.log1p(size / TUNING.least_scatter)
    bins = (fine * (TUNING.bins / max(float(fine.max()), 1e-9))).astype(int)
    count = np.bincount(bins)
    mean = np.bincount(bins, weights=size)[count > 0] / count[count > 0]
    count = count[count > 0]

    def cost(scatter: float) -> float:
        return -float(count @ log_probability(mean, scatter))

    if cost(1.05 * TUNING.least_scatter) > cost(TUNING.least_scatter):
        return TUNING.least_scatter
    low = np.log(TUNING.least_scatter)
    high = max(np.log(2 * float(np.sqrt(np.mean(size**2))) + 1e-9), low + 0.1)
    found = minimize_scalar(
        lambda log: cost(float(np.exp(log))), bounds=(low, high), method="bounded", options={"xatol": 0.05}
    )
    return float(np.exp(found.x))


def solve_scaled(matrix: Floats, right: Floats) -> Floats:
    """Solve a symmetric system (p, p). A coordinate without any effect has the solution 0."""
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    scaled = np.linalg.pinv(matrix / np.outer(scale, scale), rcond=1e-10, hermitian=True)
    return np.asarray((scaled @ (right.T / scale).T).T / scale).T


def invert_curvature(curvature: Floats) -> Floats:
    """Invert a symmetric matrix (p, p). A direction that the log hardly shows keeps a very large variance.

    A coordinate without any effect has the variance 0.
    """
    scale = np.sqrt(np.maximum(np.diag(curvature), 1e-300))
    size, axes = np.linalg.eigh(curvature / np.outer(scale, scale))
    inverse = (axes / np.maximum(size, TUNING.least_information * size[-1])) @ axes.T
    return np.asarray(np.where(np.diag(curvature) > 0, 1 / scale, 0.0) * (inverse / scale).T)


def evaluate_rounded(problem: ServoProblem, z: Floats) -> RoundedFit:
    """Return the likelihood at coordinates (p + 2,)."""
    step = problem.servo.resolution
    deviation = problem.residual(z) / step
    return RoundedFit(problem.linearise(z)[1] / step, deviation, find_scatter(deviation))


def _update_slope(slope: Floats, step: Floats, change: Floats) -> Floats:
    """Return derivatives (n, q) that agree with the change (n,) of the residual over a step (q,), after Broyden."""
    weighted = step * np.square(slope).sum(axis=0)
    return slope + np.outer(change - slope @ step, weighted / max(float(step @ weighted), 1e-300))


def sharpen(problem: ServoProblem, z: Floats) -> Floats:
    """Return the coordinates (p + 2,) of the largest likelihood, from least squares `z` on, by damped Newton steps."""
    step, slope, fresh = problem.servo.resolution, None, True
    deviation = problem.residual(z) / step
    for _ in range(TUNING.newton_steps):
        if slope is None:
            slope, fresh = problem.linearise(z)[1] / step, True
        now = RoundedFit(slope, deviation, find_scatter(deviation))
        move = -solve_scaled(now.curvature + TUNING.newton_ridge * slope.T @ slope, now.scores.sum(axis=0))
        cost = compute_cost(deviation, now.scatter)
        for part in 0.5 ** np.arange(6 if fresh else 2):
            moved = problem.residual(z + part * move) / step
            gain = cost - compute_cost(moved, now.scatter)
            if gain > 0:
                slope = _update_slope(slope, part * move, moved - deviation)
                z, deviation = z + part * move, moved
                break
        if gain < TUNING.newton_gain:
            if fresh:
                return z
            slope = None
        fresh = False
    return z


def measure_cost(problem: ServoProblem, z: Floats) -> float:
    """Return the negative logarithm of the likelihood at coordinates (p + 2,), with the likeliest scatter."""
    deviation = problem.residual(z) / problem.servo.resolution
    return compute_cost(deviation, find_scatter(deviation))
