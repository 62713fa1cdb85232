"""Friction that follows a slow column, such as a temperature or a load.

At the temperature T the parameters are theta (1 + rate (T - mean)), so that a lost preload keeps the rate. The
reference model of a monitor has these parameters, because a model with other friction reverses at other instants. The
blocks of a record of normal work give the rate, by the moment equations of their scores and of their scores times
T - mean.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pmfid.errors import UsageError
from pmfid.estimators.base import Estimator
from pmfid.monitor.cause import FRICTION
from pmfid.monitor.scores import UNUSABLE, Blocks, ScoreFilter, block_samples, start_blocks
from pmfid.monitor.tuning import TUNING
from pmfid.types import Counts, Flags, Floats


@dataclass(frozen=True)
class Warmth:
    """The relative change `rate` (p,) of the parameters per unit of a temperature, from its `mean` in normal work. The
    `span` has the lowest and the highest temperature of normal work."""

    mean: float
    span: tuple[float, float]
    rate: Floats

    def factor(self, warmer: float) -> Floats:
        """Return the parameters (p,) at a temperature above the mean, relative to those at the mean."""
        return np.maximum(1 + self.rate * warmer, TUNING.warmth_least)

    def scores(
        self,
        estimator: Estimator,
        theta: Floats,
        u: Floats,
        counts: Counts,
        temperature: Floats,
        left_out: int = UNUSABLE,
    ) -> Blocks:
        """Return all whole blocks of u, counts, temperature (n,), for parameters theta (p,) at the mean temperature.

        `left_out` is as in `Scoring`.
        """
        scoring, size, blocks = ScoreFilter(estimator, theta, left_out=left_out), block_samples(estimator), []
        for start in range(0, u.size, size):
            scoring.move(theta * self.factor(float(temperature[max(0, start - 1)]) - self.mean))
            blocks.append(scoring.run(u[start : start + size], counts[start : start + size]))
        return Blocks.concatenate(blocks)


def find_warmth(
    estimator: Estimator, theta: Floats, u: Floats, counts: Counts, temperature: Floats
) -> tuple[Warmth, Floats]:
    """Return how friction follows the temperature (n,) of a record u, counts (n,), and the parameters (p,) at its mean.

    The search starts from the parameters theta (p,) of the whole record. Raises UsageError for a temperature that does
    not vary.
    """
    if not np.ptp(temperature) > 0:
        raise UsageError(
            "friction_temperature does not vary in the reference record, so the monitor cannot learn its effect: "
            "record a warm-up, or drop the key"
        )
    start, size = start_blocks(estimator, theta), block_samples(estimator)
    span = float(np.min(temperature)), float(np.max(temperature))
    warmth = Warmth(float(np.mean(temperature)), span, np.zeros(theta.size))
    moves = np.array([FRICTION in name for name in estimator.names[: theta.size]])
    for _ in range(TUNING.warmth_passes):
        blocks = warmth.scores(estimator, theta, u, counts, temperature)[start:]
        ends = np.arange(start, start + len(blocks.score)) * size - 1
        step, slope = _solve(blocks, temperature[ends] - warmth.mean, moves)
        slope += warmth.rate * theta
        theta = theta + step
        warmth = replace(warmth, rate=np.divide(slope, theta, out=np.zeros(theta.size), where=theta != 0))
    return warmth, theta


def _solve(blocks: Blocks, warmer: Floats, moves: Flags) -> tuple[Floats, Floats]:
    """Return the change (p,) of parameters and of the slopes (p,) of those that move, from temperatures (n,)."""
    powers = np.column_stack([np.ones(warmer.size), warmer])
    free, p = np.append(np.ones(moves.size, bool), moves), moves.size
    left = np.einsum("na,nb,nij->aibj", powers, powers, blocks.cross).reshape(2 * p, 2 * p)
    change = np.zeros(2 * p)
    change[free] = np.linalg.solve(left[np.ix_(free, free)], (powers.T @ blocks.score).ravel()[free])
    return change[:p], change[p:]
