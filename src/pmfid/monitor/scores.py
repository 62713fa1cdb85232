"""Scores of blocks."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pmfid._stage import Norms, waiting_after
from pmfid.estimators.auxiliary import make_auxiliary_kernel
from pmfid.estimators.base import Estimator
from pmfid.kernel.saved import set_model, take_guard
from pmfid.monitor.tuning import TUNING
from pmfid.status import Status
from pmfid.types import Floats

if TYPE_CHECKING:
    from pmfid._kernel64 import Kernel

#: Status bits of samples that are not used.
UNUSABLE = int(Status.SETTLING | Status.SAMPLE_REJECTED)
#: Status bits for an axis with unmodelled static friction, which rests while its model still creeps.
UNUSABLE_AT_REST = UNUSABLE | int(Status.STANDSTILL)


@dataclass(frozen=True)
class Blocks:
    """The sums of n blocks for p parameters, which are `score` S_b (n, p), `cross` W_b (n, p, p) and `square` Z_b (n,
    p, p).

    The matrix Z_b is the sum of zeta zeta^T.
    """

    score: Floats
    cross: Floats
    square: Floats

    def __getitem__(self, part: slice) -> Blocks:
        return Blocks(self.score[part], self.cross[part], self.square[part])

    @classmethod
    def concatenate(cls, parts: Iterable[Blocks]) -> Blocks:
        """Join the blocks of all parts in order."""
        score, cross, square = zip(*((part.score, part.cross, part.square) for part in parts), strict=True)
        return cls(np.concatenate(score), np.concatenate(cross), np.concatenate(square))

    @classmethod
    def from_rows(cls, rows: Floats, p: int) -> Blocks:
        """Return blocks as views of rows (n, p + 2 p^2) with all their numbers."""
        ends = p, p + p * p
        cross, square = (part.reshape(len(rows), p, p) for part in (rows[:, ends[0] : ends[1]], rows[:, ends[1] :]))
        return cls(rows[:, :p], cross, square)


def block_samples(estimator: Estimator) -> int:
    """Return the number of samples in a block.

    After one whole block, the filters have forgotten everything before it.
    """
    return estimator.settle_samples


def reference_kernel(estimator: Estimator, theta: Sequence[float]) -> tuple[Kernel, int]:
    """Return a kernel whose auxiliary model keeps theta (p,), and the kernel's first instrumental column."""
    return make_auxiliary_kernel(estimator, 1.0, list(theta), adapt=False)


def start_blocks(estimator: Estimator, theta: Floats) -> int:
    """Return the number of blocks that do not count after a start or a gap.

    The velocity of the model converges to the velocity of the plant with the plant's own time constant, mass over
    viscous friction.
    """
    mass, viscous = estimator.equation.role_values(theta)[:2]
    time = TUNING.start_time_constants * mass / max(viscous, 1e-300)
    return 1 + min(TUNING.most_start_blocks, math.ceil(time / (block_samples(estimator) * estimator.dt)))


@dataclass(frozen=True)
class Scoring:
    """The configuration of the kernel that makes blocks.

    `first` is the column of phi, z, zeta. `parameters` is p. `size` is the number of samples in a block. `left_out` has
    the status bits of samples that do not count, UNUSABLE included.
    """

    first: int
    parameters: int
    size: int
    left_out: int = UNUSABLE

    @property
    def numbers(self) -> tuple[int, int, int, int, int]:
        return self.first, self.parameters, self.size, self.left_out, UNUSABLE

    @property
    def width(self) -> int:
        """Number of values in a block."""
        return self.parameters * (1 + 2 * self.parameters)

    def start(self, axes: int = 1) -> tuple[Floats, NDArray[np.uint32]]:
        """Return the empty sums (axes, width) of the open blocks, and the counters (axes, 2) of their samples.

        The counters are the number of samples and the number of disturbed samples.
        """
        return np.zeros((axes, self.width)), np.zeros((axes, 2), np.uint32)


def scores(
    estimator: Estimator, theta: Floats, u: Floats, counts: NDArray[np.int64], left_out: int = UNUSABLE
) -> Blocks:
    """Return all whole blocks of u, counts (n,) at the reference theta (p,). `left_out` is as in `Scoring`."""
    return ScoreFilter(estimator, theta, left_out=left_out).run(u, counts)


class ScoreFilter:
    """A filter that makes the blocks of one axis from pieces of any length."""

    def __init__(
        self, estimator: Estimator, theta: Floats, before: ScoreFilter | None = None, left_out: int = UNUSABLE
    ) -> None:
        """Take over the guard of `before`, a filter of the same axis with another reference.

        The guard holds the last samples. `left_out` is as in `Scoring`.
        """
        self.theta, self._precision = np.array(theta, np.float64), estimator.precision
        self.kernel, first = reference_kernel(estimator, self.theta.tolist())
        if before is not None:
            take_guard(self.kernel, before.kernel, estimator.precision)
        self.scoring = Scoring(first, self.theta.size, block_samples(estimator), left_out)
        self.sums, self.progress = self.scoring.start()
        self.wait = self.waiting = start_blocks(estimator, self.theta)
        self._now, self._roles = self.theta, estimator.equation.role_values
        self._u, self._count = np.empty(1), np.empty(1, np.int64)

    def rows(self, u: Floats, counts: NDArray[np.int64]) -> tuple[Floats, NDArray[np.uint8]]:
        """Return the blocks (m, width) that samples u, counts (n,) complete.

        The second result (m,) is true for a block with only disturbed samples.
        """
        return self.kernel.score(u, counts, self.scoring.numbers, self._now, self.sums[0], self.progress[0])

    def move(self, theta: Floats) -> None:
        """Simulate with theta (p,) from now on, and measure deviations from it. The reference stays."""
        if not np.array_equal(theta, self._now):
            self._now = np.array(theta)
            set_model(self.kernel, self._roles(theta), self._precision)

    def sample(self, u: float, count: int) -> tuple[Floats | None, NDArray[np.uint8]]:
        """Add one sample. Returns None while the block is incomplete."""
        self._u[0], self._count[0] = u, count
        rows, lost = self.rows(self._u, self._count)
        return (rows if len(rows) else None), lost

    def run(self, u: Floats, counts: NDArray[np.int64]) -> Blocks:
        """Return the scores of blocks, which are 0 while the filter waits."""
        rows, lost = self.rows(np.ascontiguousarray(u), np.ascontiguousarray(counts))
        used = np.empty(len(rows))
        for k in range(len(rows)):
            self.waiting = waiting_after(bool(lost[k]), self.waiting, self.wait)
            used[k] = self.waiting == 0
        return Blocks.from_rows(rows * used[:, None], self.theta.size)

    def doubt(self, samples: int) -> None:
        """Leave the next `samples` samples out."""
        self.kernel.doubt(samples)


@dataclass(frozen=True)
class Scale:
    """The scale of comparable scores x = R^-1 S / sigma, in standard deviations of each parameter.

    `inverse` (p, p) is R^-1, with R the mean W_b of normal work. `energy` (p,) is the mean of diag(R^-1 Z_b R^-T).
    `sigma` (p,) is the standard deviation of a block's deviation in normal work [unit of theta]. A `sigma` (n, p) has a
    value for each block.
    """

    inverse: Floats
    energy: Floats
    sigma: Floats

    @property
    def norms(self) -> Norms:
        """Kernel of the methods of this class."""
        return Norms(self.inverse, self.energy)

    def standardise(self, blocks: Blocks) -> tuple[Floats, Floats]:
        """Return the deviations x (n, p) and their information w (n, p), which is 1 on average and 0 at standstill.

        A parameter that deviates by d standard deviations gives x the mean d w and a variance of about w.
        """
        return self.norms.deviations(blocks.score, self.sigma), self.norms.expect(blocks.square)

    def information(self, blocks: Blocks) -> Floats:
        """Return the information (n,) of blocks on all parameters, in average blocks."""
        return self.norms.information(blocks.square)


def make_scale(blocks: Blocks) -> Scale:
    """Return the scale from blocks of normal work, with sigma about a deviation of zero."""
    inverse = np.linalg.inv(blocks.cross.mean(axis=0))
    unscaled = Scale(inverse, np.ones(len(inverse)), np.ones(len(inverse)))
    x, w = unscaled.standardise(blocks)
    return Scale(inverse, w.mean(axis=0), np.sqrt((x**2).mean(axis=0)))
