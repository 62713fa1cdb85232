"""Block scores: the evidence of the samples of a short time for a deviation from reference parameters.

The model is simulated with the reference theta0, so nothing here follows the estimate. The error of the filtered
equation, e = z - phi^T theta0, is gathered with the instruments, in blocks longer than the memory of the filters:

    S_b = sum zeta e,   E S_b = W_b (theta - theta0),   W_b = sum zeta phi^T

Estimates with forgetting correlate over hundreds of samples; a block correlates with its neighbours only. The encoder's
error is differentiated, so this correlation is -0.3 to -0.4.
"""

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
from pmfid.kernel.saved import take_guard
from pmfid.status import Status
from pmfid.types import Floats

if TYPE_CHECKING:
    from pmfid._kernel64 import Kernel


#: Status bits of samples that are not used.
UNUSABLE = int(Status.SETTLING | Status.SAMPLE_REJECTED)
#: The same for an axis with unmodelled static friction: the axis rests while its model creeps on.
UNUSABLE_AT_REST = UNUSABLE | int(Status.STANDSTILL)

#: Time until the model's velocity is the plant's, in the plant's time constants, and the most blocks of it.
START_TIME_CONSTANTS, MOST_START_BLOCKS = 4.0, 60


@dataclass(frozen=True)
class Blocks:
    """n blocks of p parameters. score: (n, p) S_b; cross: (n, p, p) W_b; square: (n, p, p) sum zeta zeta^T."""

    score: Floats
    cross: Floats
    square: Floats

    def __getitem__(self, part: slice) -> Blocks:
        return Blocks(self.score[part], self.cross[part], self.square[part])

    @classmethod
    def concatenate(cls, parts: Iterable[Blocks]) -> Blocks:
        """The blocks of all parts in order."""
        score, cross, square = zip(*((part.score, part.cross, part.square) for part in parts), strict=True)
        return cls(np.concatenate(score), np.concatenate(cross), np.concatenate(square))

    @classmethod
    def from_rows(cls, rows: Floats, p: int) -> Blocks:
        """Blocks as views of rows (n, p + 2 p^2) of all their numbers."""
        ends = p, p + p * p
        cross, square = (part.reshape(len(rows), p, p) for part in (rows[:, ends[0] : ends[1]], rows[:, ends[1] :]))
        return cls(rows[:, :p], cross, square)

    @property
    def rows(self) -> Floats:
        """(n, p + 2 p^2) all their numbers."""
        return np.concatenate([part.reshape(len(part), -1) for part in (self.score, self.cross, self.square)], axis=1)


def block_samples(estimator: Estimator) -> int:
    """Samples of a block: the filters have forgotten what was before the one before it."""
    return estimator.settle_samples


def reference_kernel(estimator: Estimator, theta: Sequence[float]) -> tuple[Kernel, int]:
    """A kernel whose auxiliary model keeps theta (p,), and its first instrumental column."""
    return make_auxiliary_kernel(estimator, 1.0, list(theta), adapt=False)


def start_blocks(estimator: Estimator, theta: Floats) -> int:
    """Blocks that count for nothing after a start or a gap, until the model's velocity is the plant's velocity.

    It converges with the plant's own time constant, mass over viscous friction.
    """
    mass, viscous = estimator.equation.role_values(theta)[:2]
    time = START_TIME_CONSTANTS * mass / max(viscous, 1e-300)
    return 1 + min(MOST_START_BLOCKS, math.ceil(time / (block_samples(estimator) * estimator.dt)))


@dataclass(frozen=True)
class Scoring:
    """Configuration of the kernel for blocks. first: column of phi, z, zeta; parameters: p; size: samples of a
    block; left_out: status of samples that count for nothing, UNUSABLE among it."""

    first: int
    parameters: int
    size: int
    left_out: int = UNUSABLE

    @property
    def numbers(self) -> tuple[int, int, int, int, int]:
        return self.first, self.parameters, self.size, self.left_out, UNUSABLE

    @property
    def width(self) -> int:
        """Numbers of a block."""
        return width_of(self.parameters)

    def start(self, axes: int = 1) -> tuple[Floats, NDArray[np.uint32]]:
        """The sums (axes, width) of the blocks under way, and (axes, 2) their samples and how many were disturbed."""
        return np.zeros((axes, self.width)), np.zeros((axes, 2), np.uint32)


def width_of(p: int) -> int:
    """Numbers of a block of p parameters."""
    return p + 2 * p * p


def scores(
    estimator: Estimator, theta: Floats, u: Floats, counts: NDArray[np.int64], left_out: int = UNUSABLE
) -> Blocks:
    """All whole blocks of u, counts: (n,) at reference theta (p,); left_out: as in `Scoring`."""
    return ScoreFilter(estimator, theta, left_out=left_out).run(u, counts)


class ScoreFilter:
    """The blocks of one axis, in pieces of any number of samples."""

    def __init__(
        self, estimator: Estimator, theta: Floats, before: ScoreFilter | None = None, left_out: int = UNUSABLE
    ) -> None:
        """before: of the same axis with another reference, whose guard knows the motion; left_out: as in `Scoring`."""
        self.theta = np.array(theta, np.float64)
        self.kernel, first = reference_kernel(estimator, self.theta.tolist())
        if before is not None:
            take_guard(self.kernel, before.kernel, estimator.precision)
        self.scoring = Scoring(first, self.theta.size, block_samples(estimator), left_out)
        self.sums, self.progress = self.scoring.start()
        self.wait = self.waiting = start_blocks(estimator, self.theta)
        self._u, self._count = np.empty(1), np.empty(1, np.int64)

    @property
    def missing(self) -> int:
        """Samples until the block under way is whole."""
        return self.scoring.size - int(self.progress[0, 0])

    def rows(self, u: Floats, counts: NDArray[np.int64]) -> tuple[Floats, NDArray[np.uint8]]:
        """The blocks (m, width) that samples u, counts: (n,) complete, and (m,) whether all of one were disturbed."""
        return self.kernel.score(u, counts, self.scoring.numbers, self.theta, self.sums[0], self.progress[0])

    def sample(self, u: float, count: int) -> tuple[Floats | None, NDArray[np.uint8]]:
        """The same of one sample; None: the block is not whole yet."""
        self._u[0], self._count[0] = u, count
        rows, lost = self.rows(self._u, self._count)
        return (rows if len(rows) else None), lost

    def run(self, u: Floats, counts: NDArray[np.int64]) -> Blocks:
        """The same; blocks while the filter waits are set to 0."""
        rows, lost = self.rows(np.ascontiguousarray(u), np.ascontiguousarray(counts))
        used = np.empty(len(rows))
        for k in range(len(rows)):
            self.waiting = waiting_after(bool(lost[k]), self.waiting, self.wait)
            used[k] = self.waiting == 0
        return Blocks.from_rows(rows * used[:, None], self.theta.size)

    def doubt(self, samples: int) -> None:
        """The next `samples` samples count for nothing."""
        self.kernel.doubt(samples)

    def step(self, u: float, count: int) -> Blocks | None:
        """One sample; the block that it completes, or None."""
        self._u[0], self._count[0] = u, count
        found = self.run(self._u, self._count)
        return found if len(found.score) else None


@dataclass(frozen=True)
class Scale:
    """What makes scores comparable: x = R^-1 S / sigma is, for each parameter, a deviation in standard deviations.

    inverse: (p, p), R^-1, R the mean W_b of normal work; energy: (p,) mean of diag(R^-1 Z_b R^-T); sigma: (p,)
    standard deviation of a block's deviation [unit of theta] in normal work, or (n, p) that of each block.
    """

    inverse: Floats
    energy: Floats
    sigma: Floats

    @property
    def norms(self) -> Norms:
        """Kernel of the methods below."""
        return Norms(self.inverse, self.energy)

    def standardise(self, blocks: Blocks) -> tuple[Floats, Floats]:
        """x (n, p): deviations; w (n, p): the information in them, 1 on average, 0 at standstill.

        A parameter that deviates by d standard deviations has E x = d w, variance of x about w.
        """
        return self.norms.deviations(blocks.score, self.sigma), self.norms.told(blocks.square)

    def information(self, blocks: Blocks) -> Floats:
        """(n,) information of blocks on all parameters, in average blocks."""
        return self.norms.information(blocks.square)


def make_scale(blocks: Blocks) -> Scale:
    """The scale of the blocks of normal work; sigma about a deviation of zero."""
    inverse = np.linalg.inv(blocks.cross.mean(axis=0))
    unscaled = Scale(inverse, np.ones(len(inverse)), np.ones(len(inverse)))
    x, w = unscaled.standardise(blocks)
    return Scale(inverse, w.mean(axis=0), np.sqrt((x**2).mean(axis=0)))
