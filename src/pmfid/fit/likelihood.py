"""Likelihoods of the residuals: a Gaussian with a disturbance that wanders, and the intervals of the counts."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pmfid._body import whiten
from pmfid.fit.problem import ObservedStretch, ResidualBlock
from pmfid.types import Floats

#: Variance of the rounding of a count [counts^2].
ROUNDING = 1 / 12


@dataclass(frozen=True, eq=False)
class Gaussian:
    """White errors of known variance, times `scale`, and a force or an error of the position that wanders.

    `rate` is viscous friction over mass [1/s]. `force` has the standard deviation [counts/s^2] and the time constant
    [s] of an Ornstein-Uhlenbeck process, and `position` those of an error of the position [counts]. The lines of the
    encoder have errors of standard deviation `spread` [counts]. Each line has one error at all its edges (Fuller and
    Battese 1974), which a disturbance that wanders hides.
    """

    stretches: Sequence[ObservedStretch]
    rate: float = 0.0
    force: tuple[float, float] = (0.0, 1.0)
    position: tuple[float, float] = (0.0, 1.0)
    scale: float = 1.0
    spread: float = 0.0

    @property
    def wanders(self) -> bool:
        return self.force[0] > 0 or self.position[0] > 0

    @property
    def rounded_cost(self) -> float:
        """The largest cost that rounding alone leaves without a disturbance: 1/2 an observation, and three standard
        deviations of the sum. Observations in a row that show one count may all have one error."""
        ends = [np.flatnonzero(np.diff(one.y, prepend=np.nan, append=np.nan) != 0) for one in self.stretches]
        runs = np.concatenate([np.diff(k) for k in ends])
        return float(0.5 * np.sum(runs) + 3 * np.sqrt(0.2 * np.sum(runs**2))) / self.scale

    def with_wander(self, kind: str, wander: tuple[float, float]) -> Gaussian:
        """Return the noise with another wandering force or position."""
        return replace(self, force=wander) if kind == "force" else replace(self, position=wander)

    def __call__(self, blocks: Sequence[ResidualBlock]) -> tuple[float, list[ResidualBlock]]:
        weighted = [self._weigh(stretch, block) for stretch, block in zip(self.stretches, blocks, strict=True)]
        return 0.5 * sum(float(block.e @ block.e) for block in weighted), weighted

    def _weigh(self, stretch: ObservedStretch, block: ResidualBlock) -> ResidualBlock:
        size = math.sqrt(self.scale)
        if not self.wanders:
            weight = 1 / np.sqrt(stretch.variance) / size
            if not self._lines(stretch):
                return block.weigh(block.e * weight, weight)
        rows = np.column_stack([block.e, block.K, block.J])
        self._whiten(rows, stretch)
        rows /= size
        first = 1 + block.K.shape[1]
        return ResidualBlock(rows[:, 0], rows[:, first:], rows[:, 1:first])

    def _lines(self, stretch: ObservedStretch) -> bool:
        return self.spread > 0 and stretch.line is not None

    def _whiten(self, rows: Floats, stretch: ObservedStretch) -> float:
        """Whiten rows (k, w) in place, and return the sum of the logarithms of their variances."""
        variance = stretch.variance
        if not self._lines(stretch):
            return float(whiten(rows, stretch.signed_steps, variance, self.rate, self.force, self.position))
        if self.wanders:
            variance = np.where(stretch.counted, variance, variance + self.spread**2)
            return float(whiten(rows, stretch.signed_steps, variance, self.rate, self.force, self.position))
        rows /= np.sqrt(variance)[:, None]
        assert stretch.line is not None
        return _share_lines(rows, stretch.line, 1 / np.sqrt(variance), self.spread) + float(np.sum(np.log(variance)))

    def evidence(self, errors: Sequence[Floats]) -> tuple[float, float]:
        """Return the log likelihood of residuals (k,) for each stretch at the best scale of at least 1, and the
        scale."""
        squares, logs, count = 0.0, 0.0, 0
        for stretch, e in zip(self.stretches, errors, strict=True):
            if self.wanders or self._lines(stretch):
                rows = np.ascontiguousarray(e[:, None]).copy()
                logs += self._whiten(rows, stretch)
                squares += float(np.sum(rows**2))
            else:
                logs += float(np.sum(np.log(stretch.variance)))
                squares += float(np.sum(e**2 / stretch.variance))
            count += e.size
        scale = max(1.0, squares / count)
        return -0.5 * (squares / scale + count * math.log(2 * math.pi * scale) + logs), scale


def _share_lines(rows: Floats, line: NDArray[np.intp], weight: Floats, spread: float) -> float:
    """Whiten rows (k, w) of unit errors in place for the common error of each line, and return the sum of the
    logarithms of the variances that the lines add."""
    edges = np.flatnonzero(line >= 0)
    _, line = np.unique(line[edges], return_inverse=True)
    weight = weight[edges]
    power = np.bincount(line, weight**2)
    mean = np.array([np.bincount(line, weight * column) for column in rows[edges].T]).T / power[:, None]
    part = 1 - 1 / np.sqrt(1 + spread**2 * power)
    rows[edges] -= (part[:, None] * mean)[line] * weight[:, None]
    return float(np.sum(np.log1p(spread**2 * power)))


#: Time constants of a wandering disturbance, in mean steps; the last one is a tenth of the record.
MEMORIES = (3.0, 30.0)
#: Observations that decide on the noise.
MOST_ROWS = 6_000


def noise_of(
    stretches: Sequence[ObservedStretch],
    errors: Sequence[Floats],
    rate: float,
    kinds: Sequence[str] = ("force", "position"),
    spread: float = 0.0,
) -> Gaussian:
    """Return the noise of maximum likelihood for residuals (k,) [counts] of each stretch.

    A disturbance has two parameters and enters if it gains more than their cost by Schwarz (1978).
    """
    chosen = _thin(stretches, errors)
    parts, residuals = [one for one, _ in chosen], [e for _, e in chosen]
    plain = Gaussian(parts, rate, spread=spread)
    best, (top, scale) = plain, plain.evidence(residuals)
    step = float(np.mean([np.mean(one.steps) for one in parts]))
    rows = sum(e.size for e in residuals)
    cost = math.log(rows)
    for memory in (*(m * step for m in MEMORIES), rows * step / 10):
        for kind in kinds:
            unit = 1 / min(memory, 30 * step) ** 2 if kind == "force" else 1.0
            size, value, times = _largest(plain, kind, unit, memory, residuals)
            if value - cost > top:
                best, top, scale = plain.with_wander(kind, (size, memory)), value - cost, times
    return replace(best, stretches=stretches, scale=scale)


def _largest(
    plain: Gaussian, kind: str, unit: float, memory: float, errors: Sequence[Floats]
) -> tuple[float, float, float]:
    """Return the size of maximum likelihood, its log likelihood and the scale, to a fifth of an octave."""

    def value(log: float) -> float:
        return plain.with_wander(kind, (unit * math.exp(log), memory)).evidence(errors)[0]

    deviation = float(np.clip(np.std(np.concatenate(errors)), 0.01, 1e5))
    size = unit * math.exp(climb(value, 2.0 * round(0.5 * math.log(deviation)), (-6.0, 12.0)))
    return size, *plain.with_wander(kind, (size, memory)).evidence(errors)


def climb(value: Callable[[float], float], start: float, ends: tuple[float, float]) -> float:
    """Return the place between two ends at which a function with one maximum is largest, to an eighth. The steps from
    the start are 2 until they lead down, and then half as long again and again."""
    known, step, top = {start: value(start)}, 2.0, start
    while step > 0.1:
        near = [x for x in (top - step, top + step) if ends[0] <= x <= ends[1] and x not in known]
        known |= {x: value(x) for x in near}
        top, step = max(known, key=known.__getitem__), step if near else step / 2
    return top


def _thin(stretches: Sequence[ObservedStretch], errors: Sequence[Floats]) -> list[tuple[ObservedStretch, Floats]]:
    """Return stretches and residuals with at most about `MOST_ROWS` observations, evenly chosen. A piece of a record
    would begin with the residual of an unknown start state."""
    every = -(-sum(e.size for e in errors) // MOST_ROWS)
    if every <= 1:
        return list(zip(stretches, errors, strict=True))
    chosen = [np.arange(e.size) % every == 0 for e in errors]
    return [(one.keep(rows), e[rows]) for one, e, rows in zip(stretches, errors, chosen, strict=True)]


@dataclass(frozen=True, eq=False)
class Intervals:
    """Counts as intervals: the position is in its count, but for a white error of `spread` counts.

    The likelihood of a residual e is Phi((1/2 - e) / spread) - Phi((-1/2 - e) / spread), which is log-concave. Rows
    that are no counts have the Gaussian likelihood of their variance.
    """

    stretches: Sequence[ObservedStretch]
    spread: float

    def __call__(self, blocks: Sequence[ResidualBlock]) -> tuple[float, list[ResidualBlock]]:
        cost, weighted = 0.0, []
        for stretch, block in zip(self.stretches, blocks, strict=True):
            value, slope, curvature = interval_terms(block.e, self.spread)
            if not np.all(stretch.counted):
                other, v = ~stretch.counted, stretch.variance
                value[other] = -0.5 * (block.e[other] ** 2 / v[other] + np.log(2 * np.pi * v[other]))
                slope[other], curvature[other] = -block.e[other] / v[other], 1 / v[other]
            root = np.sqrt(curvature)
            weighted.append(block.weigh(-slope / root, root))
            cost -= float(np.sum(value))
        return cost, weighted


def interval_terms(e: Floats, spread: float) -> tuple[Floats, Floats, Floats]:
    """Return the log likelihood (k,) of residuals e (k,) [counts], its derivative and minus its second derivative."""
    from scipy.special import log_ndtr

    x = np.abs(e)
    a, b = (0.5 - x) / spread, (-0.5 - x) / spread
    upper, lower = log_ndtr(a), log_ndtr(b)
    value = upper + np.log1p(-np.exp(lower - upper))
    pa, pb = (np.exp(np.minimum(-0.5 * z * z - value, 600.0)) / math.sqrt(2 * math.pi) for z in (a, b))
    slope = (pb - pa) / spread
    curvature = slope**2 + (a * pa - b * pb) / spread**2
    return value, slope * np.sign(e), np.maximum(curvature, 1e-12)
