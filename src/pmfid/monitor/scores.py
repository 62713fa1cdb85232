"""Scores of blocks."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pmfid._stage import ALONE, CHANGED, FRESH, KNOWN, LOST, POWER, SAME, SAMPLES, USUAL, Norms, waiting_after
from pmfid.estimators.auxiliary import make_auxiliary_kernel
from pmfid.estimators.base import Estimator
from pmfid.kernel.saved import set_model, take_guard
from pmfid.monitor.rows import RowArrays, rows_of
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
        return width_of(self.parameters)

    def start(self, axes: int = 1) -> tuple[Floats, NDArray[np.uint32]]:
        """Return the empty sums (axes, width) of the open blocks, and the counters (axes, 2) of their samples.

        The counters are the number of samples and the number of disturbed samples.
        """
        return np.zeros((axes, self.width)), np.zeros((axes, 2), np.uint32)


def width_of(p: int) -> int:
    """Return the number of values in a block of p parameters."""
    return p + 2 * p * p


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

    @property
    def missing(self) -> int:
        """Number of samples until the open block is whole."""
        return self.scoring.size - int(self.progress[0, 0])

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


@dataclass
class Sampled(RowArrays):
    """The state of an axis that changes with each sample.

    `whole` and `real` belong to its `Inputs`. `flagged` is the status of the last sample that was not lost. `warmer`
    (n, 2) are the temperature of the open block and the last known one, above the mean of normal work. `estimator` and
    `filter` are the packed states of the kernels. `sums` and `progress` belong to the open block (see `Scoring`).
    """

    whole: NDArray[np.int64]
    real: Floats
    flagged: NDArray[np.uint32]
    warmer: Floats
    estimator: NDArray[np.uint8]
    filter: NDArray[np.uint8]
    sums: Floats
    progress: NDArray[np.uint32]

    @property
    def samples(self) -> NDArray[np.int64]:
        """Number of samples so far (n,), lost samples included."""
        return self.whole[:, SAMPLES]

    @property
    def yes_or_no(self) -> NDArray[np.int64]:
        """Flags (n, 3), 1 or 0, of the last samples.

        The first flag means a lost last sample, the second that any sample was not lost. The third means that the input
        changed in the last sample that was not lost.
        """
        return self.whole[:, [LOST, KNOWN, CHANGED]]

    @property
    def fresh(self) -> NDArray[np.int64]:
        """Number of kept counts that follow one another, (n,)."""
        return self.whole[:, FRESH]

    @property
    def sizes(self) -> Floats:
        """Usual change of the input from sample to sample, and mean square of the input, (n, 2), not negative."""
        return self.real[:, [USUAL, POWER]]

    @property
    def shares(self) -> Floats:
        """Share of samples with an unchanged input, and share of single changes among all changes, (n, 2), from 0 to
        1."""
        return self.real[:, [SAME, ALONE]]


@dataclass
class Watched(RowArrays):
    """The state of an axis that changes with each block.

    `theta` (n, p) is the reference, `state` the number in `STATES`. `waiting` is the number of blocks that do not
    count. `silence` is the number of blocks since the last one with information. The open unit has the information
    `opened`, the sum `opening` (n, width), the blocks `members` and the time `begun`. `detection` is the state of the
    detector, and `units` the number of units with this reference. `line` (n, 2, p) has the sums of a line through zero:
    over all units with this reference, their number times x, and its square times w. `wait`, `sigma` and `tolerance`
    are derived from the reference.
    """

    theta: Floats = field(metadata=rows_of("p"))
    state: NDArray[np.uint8] = field(metadata=rows_of(kind=np.uint8))
    waiting: NDArray[np.int64] = field(metadata=rows_of(kind=np.int64))
    silence: NDArray[np.int64] = field(metadata=rows_of(kind=np.int64))
    opened: Floats = field(metadata=rows_of())
    opening: Floats = field(metadata=rows_of("width"))
    members: NDArray[np.int64] = field(metadata=rows_of(kind=np.int64))
    begun: Floats = field(metadata=rows_of())
    detection: Floats = field(metadata=rows_of("starts", "p"))
    statistic: Floats = field(metadata=rows_of())
    units: NDArray[np.int64] = field(metadata=rows_of(kind=np.int64))
    line: Floats = field(metadata=rows_of(2, "p"))
    wait: NDArray[np.int64] = field(metadata=rows_of(kind=np.int64, saved=False))
    sigma: Floats = field(metadata=rows_of("p", saved=False))
    tolerance: Floats = field(metadata=rows_of("p", saved=False))


@dataclass
class Disturbed(RowArrays):
    """The data of an axis that alarms use and change.

    `units` (n, look_back, width) is a ring with the last units, and `begun` (n, look_back) has their times. `gathered`
    is the information since the suspicion or the alarm. `suspected` is the number of units since the suspicion, and
    `crossed` the statistic at the suspicion. `refined` is true if the estimate is already the model. `before` (n, p) is
    the reference before the change. `settled` (n, width) is the sum of the blocks relative to this model. `gain` is the
    input gain over the gain of the estimator. `by_gain` is true after an alarm on the input gain. `cause` identifies
    parameter and direction of the last alarm, or is 0. `since` is the time of the reference [s]. `slow` (n, p) times a
    change of the parameters is the relative change of the last alarm's cause, while this change goes on slowly;
    otherwise `slow` is 0. `rate` is the relative change per hour at the last alarm if it was slow, otherwise 0.
    `grown` is the number of units that had the deviation of the last alarm before it, by the line.
    """

    units: Floats = field(metadata=rows_of(TUNING.look_back, "width"))
    begun: Floats = field(metadata=rows_of(TUNING.look_back))
    gathered: Floats = field(metadata=rows_of())
    suspected: NDArray[np.int64] = field(metadata=rows_of(kind=np.int64))
    crossed: Floats = field(metadata=rows_of())
    refined: NDArray[np.uint8] = field(metadata=rows_of(kind=np.uint8))
    before: Floats = field(metadata=rows_of("p"))
    settled: Floats = field(metadata=rows_of("width"))
    gain: Floats = field(metadata=rows_of(start=1))
    by_gain: NDArray[np.uint8] = field(metadata=rows_of(kind=np.uint8))
    cause: NDArray[np.int64] = field(metadata=rows_of(kind=np.int64))
    since: Floats = field(metadata=rows_of())
    slow: Floats = field(metadata=rows_of("p"))
    rate: Floats = field(metadata=rows_of())
    grown: Floats = field(metadata=rows_of())

    def recent(self, axis: int, units: int) -> tuple[Floats, Floats]:
        """Return the last units (m, width) of an axis and their times (m,), in order.

        `units` is the number of all units so far.
        """
        order = np.arange(max(0, units - TUNING.look_back), units) % TUNING.look_back
        return self.units[axis, order], self.begun[axis, order]
