"""Scores of blocks."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, fields
from functools import cache
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from pmfid._stage import ALONE, CHANGED, FRESH, KNOWN, LOST, POWER, SAME, SAMPLES, USUAL, Norms, put_rows, waiting_after
from pmfid.estimators.auxiliary import make_auxiliary_kernel
from pmfid.estimators.base import Estimator
from pmfid.kernel.saved import take_guard
from pmfid.monitor.tuning import TUNING
from pmfid.status import Status
from pmfid.types import Floats, Places

if TYPE_CHECKING:
    from pmfid._kernel64 import Kernel

#: Status bits of samples that are not used.
UNUSABLE = int(Status.SETTLING | Status.SAMPLE_REJECTED)
#: The scores for an axis with unmodelled static friction: the axis rests while its model still creeps.
UNUSABLE_AT_REST = UNUSABLE | int(Status.STANDSTILL)


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
    time = TUNING.start_time_constants * mass / max(viscous, 1e-300)
    return 1 + min(TUNING.most_start_blocks, math.ceil(time / (block_samples(estimator) * estimator.dt)))


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
        """Adds one sample. Returns None while the block is incomplete."""
        self._u[0], self._count[0] = u, count
        rows, lost = self.rows(self._u, self._count)
        return (rows if len(rows) else None), lost

    def run(self, u: Floats, counts: NDArray[np.int64]) -> Blocks:
        """The scores of blocks, which are 0 while the filter waits."""
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
        return self.norms.deviations(blocks.score, self.sigma), self.norms.expect(blocks.square)

    def information(self, blocks: Blocks) -> Floats:
        """(n,) information of blocks on all parameters, in average blocks."""
        return self.norms.information(blocks.square)


def make_scale(blocks: Blocks) -> Scale:
    """The scale of the blocks of normal work; sigma about a deviation of zero."""
    inverse = np.linalg.inv(blocks.cross.mean(axis=0))
    unscaled = Scale(inverse, np.ones(len(inverse)), np.ones(len(inverse)))
    x, w = unscaled.standardise(blocks)
    return Scale(inverse, w.mean(axis=0), np.sqrt((x**2).mean(axis=0)))


#: Arrays that are derived from others and are not saved.
DERIVED = {"saved": False}


class RowArrays:
    """Arrays with the same number of rows, one row for each axis."""

    __dataclass_fields__: dict[str, object]

    def parts(self, saved_only: bool = False) -> Iterator[tuple[str, NDArray[np.generic]]]:
        """The arrays by name."""
        return ((name, getattr(self, name)) for name in _names(type(self), saved_only))  # type: ignore[arg-type]  # a class has a hash

    def take_rows(self, index: Places | slice) -> Self:
        """Some rows: an array of numbers gives copies, a slice gives views."""
        if isinstance(index, slice):
            return type(self)(**{name: part[index] for name, part in self.parts()})
        return type(self)(**{name: part.take(index, axis=0) for name, part in self.parts()})

    def put(self, index: Places | slice, rows: Self) -> None:
        """Overwrites some rows."""
        for name, part in self.parts():
            if isinstance(index, slice):
                part[index] = getattr(rows, name)
            else:
                put_rows(part, index, getattr(rows, name))

    def copy_rows(self) -> Self:
        """A copy of all rows."""
        return type(self)(**{name: part.copy() for name, part in self.parts()})

    def repeat_rows(self, times: int) -> Self:
        """Each row, `times` times."""
        return type(self)(**{name: np.repeat(part, times, axis=0) for name, part in self.parts()})

    def join_rows(self, other: Self) -> Self:
        """These rows, followed by the rows of `other`."""
        return type(self)(**{name: np.concatenate([part, getattr(other, name)]) for name, part in self.parts()})


@cache
def _names(kind: type[RowArrays], saved_only: bool) -> tuple[str, ...]:
    return tuple(one.name for one in fields(kind) if one.metadata.get("saved", True) or not saved_only)  # type: ignore[arg-type]


@dataclass
class Sampled(RowArrays):
    """What the samples of an axis change. whole, real: of its `Inputs`; flagged: status of the last sample that was not
    lost; estimator, filter: states of the kernels, packed; sums, progress: of the block under way, see `Scoring`."""

    whole: NDArray[np.int64]
    real: Floats
    flagged: NDArray[np.uint32]
    estimator: NDArray[np.uint8]
    filter: NDArray[np.uint8]
    sums: Floats
    progress: NDArray[np.uint32]

    @property
    def samples(self) -> NDArray[np.int64]:
        """(n,) so far, the lost ones among them."""
        return self.whole[:, SAMPLES]

    @property
    def yes_or_no(self) -> NDArray[np.int64]:
        """(n, 3) 1 or 0: whether the last sample was lost, any was not, the input changed in the last that was not."""
        return self.whole[:, [LOST, KNOWN, CHANGED]]

    @property
    def fresh(self) -> NDArray[np.int64]:
        """(n,) counts that are kept and follow one another."""
        return self.whole[:, FRESH]

    @property
    def sizes(self) -> Floats:
        """(n, 2), not negative: what the input changes by from sample to sample, and its mean square."""
        return self.real[:, [USUAL, POWER]]

    @property
    def shares(self) -> Floats:
        """(n, 2) from 0 to 1: samples in which the input stays the same, and its changes that come alone."""
        return self.real[:, [SAME, ALONE]]


@dataclass
class Watched(RowArrays):
    """What the blocks of an axis change. theta: (n, p) reference; state: number of `STATES`; waiting: blocks that count
    for nothing; silence: blocks since the last one with information; opened: information of the unit under way,
    opening: its sum (n, width), members: its blocks, begun: its time; detection: of the detector; units: so far with
    this reference. wait, sigma, tolerance: of the reference."""

    theta: Floats
    state: NDArray[np.uint8]
    waiting: NDArray[np.int64]
    silence: NDArray[np.int64]
    opened: Floats
    opening: Floats
    members: NDArray[np.int64]
    begun: Floats
    detection: Floats
    statistic: Floats
    units: NDArray[np.int64]
    wait: NDArray[np.int64] = field(metadata=DERIVED)
    sigma: Floats = field(metadata=DERIVED)
    tolerance: Floats = field(metadata=DERIVED)

    @classmethod
    def empty(cls, axes: int, p: int, detection: int) -> Watched:
        """`axes` axes that have no reference yet."""
        none, nowhere, vector = np.zeros(axes), np.zeros(axes, np.int64), np.zeros((axes, p))
        return cls(
            theta=vector,
            state=np.zeros(axes, np.uint8),
            waiting=nowhere,
            silence=nowhere.copy(),
            opened=none,
            opening=np.zeros((axes, width_of(p))),
            members=nowhere.copy(),
            begun=none.copy(),
            detection=np.zeros((axes, detection, p)),
            statistic=none.copy(),
            units=nowhere.copy(),
            wait=nowhere.copy(),
            sigma=vector.copy(),
            tolerance=vector.copy(),
        )


@dataclass
class Disturbed(RowArrays):
    """Data that alarms use and change. units: (n, look_back, width) the last, in a ring; begun: (n, look_back) their
    times; gathered: information since the suspicion, or since the alarm; suspected: units since the suspicion; crossed:
    the statistic at it; refined: whether the estimate is the model already; before: (n, p) the reference until then;
    settled: (n, width) sum of the blocks relative to that model; gain: of the input, over that of the estimator;
    by_gain: whether the alarm was of the gain of the input."""

    units: Floats
    begun: Floats
    gathered: Floats
    suspected: NDArray[np.int64]
    crossed: Floats
    refined: NDArray[np.uint8]
    before: Floats
    settled: Floats
    gain: Floats
    by_gain: NDArray[np.uint8]

    @classmethod
    def empty(cls, axes: int, p: int) -> Disturbed:
        """`axes` axes without an alarm."""
        width = width_of(p)
        return cls(
            np.zeros((axes, TUNING.look_back, width)),
            np.zeros((axes, TUNING.look_back)),
            np.zeros(axes),
            np.zeros(axes, np.int64),
            np.zeros(axes),
            np.zeros(axes, np.uint8),
            np.zeros((axes, p)),
            np.zeros((axes, width)),
            np.ones(axes),
            np.zeros(axes, np.uint8),
        )

    def recent(self, axis: int, units: int) -> tuple[Floats, Floats]:
        """The last units (m, width) of an axis and their times (m,), in order; units: number of all so far."""
        order = np.arange(max(0, units - TUNING.look_back), units) % TUNING.look_back
        return self.units[axis, order], self.begun[axis, order]
