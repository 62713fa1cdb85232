"""Block scores: what the samples of a short time say of a deviation from reference parameters.

The model is simulated with the reference theta0, so nothing here follows the estimate. The error of the filtered
equation, e = z - phi^T theta0, is gathered with the instruments, in blocks longer than the memory of the filters:

    S_b = sum zeta e,   E S_b = W_b (theta - theta0),   W_b = sum zeta phi^T

Estimates with forgetting remember for hundreds of samples; blocks remember but their neighbour (an encoder's error is
differentiated, hence a correlation of -0.3 to -0.4 with it and none beyond).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pmfid.estimators.auxiliary import make_auxiliary_kernel
from pmfid.estimators.base import Estimator
from pmfid.kernel.saved import take_guard
from pmfid.status import Status
from pmfid.types import Flags, Floats

if TYPE_CHECKING:
    from pmfid._kernel64 import Kernel


#: Samples with one of these say nothing of the plant.
UNUSABLE = int(Status.SETTLING | Status.INVALID_INPUT | Status.COUNT_JUMP)
#: Nor does an axis that a friction at rest holds, which the model lacks, while its model creeps on.
UNUSABLE_AT_REST = UNUSABLE | int(Status.STANDSTILL)

#: After so many of its time constants the model's velocity is the plant's; at most so many blocks are waited.
START_TIME_CONSTANTS, MOST_START_BLOCKS = 4.0, 60
#: Samples whose columns are in memory at once.
CHUNK = 50_000


@dataclass(frozen=True)
class Blocks:
    """n blocks of p parameters. score: (n, p) S_b; cross: (n, p, p) W_b; square: (n, p, p) sum zeta zeta^T."""

    score: Floats
    cross: Floats
    square: Floats

    def __getitem__(self, part: slice) -> Blocks:
        return Blocks(self.score[part], self.cross[part], self.square[part])

    def __add__(self, other: Blocks) -> Blocks:
        return Blocks(self.score + other.score, self.cross + other.cross, self.square + other.square)

    def __sub__(self, other: Blocks) -> Blocks:
        return Blocks(self.score - other.score, self.cross - other.cross, self.square - other.square)

    def total(self) -> Blocks:
        """All as one block."""
        return Blocks(*(part.sum(axis=0, keepdims=True) for part in (self.score, self.cross, self.square)))

    @classmethod
    def joined(cls, parts: Iterable[Blocks]) -> Blocks:
        """One after the other."""
        score, cross, square = zip(*((part.score, part.cross, part.square) for part in parts), strict=True)
        return cls(np.concatenate(score), np.concatenate(cross), np.concatenate(square))


def block_samples(estimator: Estimator) -> int:
    """Samples of a block: the filters have forgotten what was before the one before it."""
    return estimator.settle_samples


def reference_kernel(estimator: Estimator, theta: Sequence[float]) -> tuple[Kernel, int]:
    """A kernel whose auxiliary model keeps theta (p,), and its first instrumental column."""
    return make_auxiliary_kernel(estimator, 1.0, list(theta), adapt=False)


def start_blocks(estimator: Estimator, theta: Floats) -> int:
    """Blocks that count for nothing after a start or a gap, while the model's velocity is not yet that of the plant: it
    comes near with the plant's own time constant, mass over viscous friction."""
    mass, viscous = estimator.equation.role_values(theta)[:2]
    time = START_TIME_CONSTANTS * mass / max(viscous, 1e-300)
    return 1 + min(MOST_START_BLOCKS, math.ceil(time / (block_samples(estimator) * estimator.dt)))


def silenced(blocks: Blocks, disturbed: Flags, waiting: int, wait: int) -> tuple[Blocks, int]:
    """The blocks without what they say within `wait` blocks after a disturbed one, and how many more are to wait.

    disturbed: (n,); waiting: of blocks before these.
    """
    used = np.empty(disturbed.size)
    for k, bad in enumerate(disturbed):
        waiting = wait if bad else max(0, waiting - 1)
        used[k] = float(waiting == 0)
    return Blocks(
        blocks.score * used[:, None], blocks.cross * used[:, None, None], blocks.square * used[:, None, None]
    ), waiting


def gather(
    columns: Floats, status: NDArray[np.uint32], theta: Floats, size: int, left_out: int = UNUSABLE
) -> tuple[Blocks, Flags]:
    """Whole blocks of `size` samples from phi, z, zeta in columns (n, 2 p + 1), and (n,) where one has none but
    unusable samples: there the filters settle, and the simulated motion has lost the plant. left_out: status of samples
    that count for nothing, UNUSABLE among it."""
    p, n = theta.size, columns.shape[0] // size
    rows = columns[: n * size].reshape(n, size, columns.shape[1])
    zeta = np.where((status[: n * size].reshape(n, size, 1) & left_out) == 0, rows[..., p + 1 : 2 * p + 1], 0.0)
    error = rows[..., p] - rows[..., :p] @ theta
    turned = zeta.transpose(0, 2, 1)
    disturbed = np.all((status[: n * size].reshape(n, size) & UNUSABLE) != 0, axis=1)
    return Blocks((turned @ error[..., None])[..., 0], turned @ rows[..., :p], turned @ zeta), disturbed


def scores(
    estimator: Estimator, theta: Floats, u: Floats, counts: NDArray[np.int64], left_out: int = UNUSABLE
) -> Blocks:
    """All whole blocks of u, counts: (n,) at reference theta (p,); left_out: as in `gather`."""
    kernel, first = reference_kernel(estimator, list(theta))
    size, wait, parts = block_samples(estimator), start_blocks(estimator, theta), []
    waiting = wait
    chunk = size * max(1, CHUNK // size)
    for start in range(0, u.size, chunk):
        columns, status = kernel.filter(u[start : start + chunk], counts[start : start + chunk])
        found = gather(columns[:, first : first + 2 * theta.size + 1], status, theta, size, left_out)
        blocks, waiting = silenced(*found, waiting, wait)
        parts.append(blocks)
    return Blocks.joined(parts)


class ScoreFilter:
    """The same blocks, sample by sample."""

    def __init__(
        self, estimator: Estimator, theta: Floats, before: ScoreFilter | None = None, left_out: int = UNUSABLE
    ) -> None:
        """before: of the same axis with another reference, whose guard knows the motion; left_out: as in `gather`."""
        self.theta, self._left_out = theta, left_out
        self._kernel, self._first = reference_kernel(estimator, list(theta))
        if before is not None:
            take_guard(self._kernel, before._kernel, estimator.precision)
        size = block_samples(estimator)
        self._rows = np.empty((size, 2 * theta.size + 1))
        self._status = np.empty(size, np.uint32)
        self._wait = self._waiting = start_blocks(estimator, theta)
        self._u, self._count, self._filled = np.empty(1), np.empty(1, np.int64), 0

    def doubt(self, samples: int) -> None:
        """So many samples from now on count for nothing."""
        self._kernel.doubt(samples)

    def step(self, u: float, count: int) -> Blocks | None:
        """One sample; the block that it completes, or None."""
        self._u[0], self._count[0] = u, count
        columns, status = self._kernel.filter(self._u, self._count)
        row = self._filled
        self._rows[row] = columns[0, self._first : self._first + self._rows.shape[1]]
        self._status[row] = status[0]
        self._filled = (row + 1) % self._status.size
        if self._filled:
            return None
        found = gather(self._rows, self._status, self.theta, self._status.size, self._left_out)
        block, self._waiting = silenced(*found, self._waiting, self._wait)
        return block


@dataclass(frozen=True)
class Scale:
    """What makes scores comparable: x = R^-1 S / sigma is, for each parameter, a deviation in standard deviations.

    inverse: (p, p), R^-1, R the mean W_b of normal work; energy: (p,) mean of diag(R^-1 Z_b R^-T); sigma: (p,)
    standard deviation of a block's deviation [unit of theta] in normal work.
    """

    inverse: Floats
    energy: Floats
    sigma: Floats

    def standardise(self, blocks: Blocks) -> tuple[Floats, Floats]:
        """x (n, p): deviations; w (n, p): the information in them, 1 on average, 0 at standstill.

        A parameter that deviates by d standard deviations has E x = d w, variance of x about w.
        """
        energy = np.einsum("ij,njk,ik->ni", self.inverse, blocks.square, self.inverse)
        return blocks.score @ self.inverse.T / self.sigma, energy / self.energy

    def information(self, blocks: Blocks) -> Floats:
        """(n,) that blocks tell of all parameters, in average blocks."""
        return np.asarray(self.standardise(blocks)[1].mean(axis=1))


def make_scale(blocks: Blocks) -> Scale:
    """The scale of the blocks of normal work; sigma about a deviation of zero."""
    inverse = np.linalg.inv(blocks.cross.mean(axis=0))
    unscaled = Scale(inverse, np.ones(len(inverse)), np.ones(len(inverse)))
    x, w = unscaled.standardise(blocks)
    return Scale(inverse, w.mean(axis=0), np.sqrt((x**2).mean(axis=0)))
