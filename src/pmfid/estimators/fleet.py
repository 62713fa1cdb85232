"""Many axes at once: a fleet of machines, or the runs of a simulation study."""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.errors import UsageError, whole_number
from pmfid.estimators.base import integer_counts, numbers
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.runner import Runner
from pmfid.estimators.track import Track
from pmfid.kernel.structures import whole_words
from pmfid.types import Floats, Numbers

N = TypeVar("N", bound=np.number)
#: theta, diagonal of P, its inflation, innovation, its variance, status.
Results = tuple[Floats, Floats, Floats, Floats, Floats, NDArray[np.uint32]]

#: Axes that a thread takes at a time are a multiple of this: no vector of the kernel holds more.
GROUP = 16
#: Pieces of work for each thread, so that none waits long for the last one.
PIECES = 4
#: Less work than this [axes times samples] is not worth a second thread.
SMALL = 20_000


@dataclass(frozen=True)
class Tracks(Track):
    """Estimates of many axes: a `Track` whose arrays have the axis in front.

    theta, variance_factor, inflation: (axes, m, p); innovation, innovation_variance, status: (axes, m), where m is the
    number of samples that were kept; samples: (m,) their numbers. `tracks["mass"]` is (axes, m).
    """

    samples: NDArray[np.int64]

    def axis(self, index: int) -> Track:
        """The track of one axis."""
        return Track(
            self.names,
            self.units,
            self.theta[index],
            self.variance_factor[index],
            self.inflation[index],
            self.innovation[index],
            self.innovation_variance[index],
            self.status[index],
        )


class Fleet:
    """Many axes with the configuration of one recursive estimator, each with a state of its own.

    Every axis gets the bits that the estimator alone would give; they are computed side by side, in vectors and on all
    processors. All start from the present state of `estimator`, or of a `Runner`, which itself does not change. A copy,
    by `copy`, `pickle` or a process pool, goes on with the same bits. axes: number, >= 1; workers: threads, >= 1; None:
    as many as there are processors. Raises UsageError for other numbers, for an estimator that is not recursive, and
    for more axes than the memory holds.
    """

    def __init__(self, estimator: RecursiveEstimator | Runner, axes: int, *, workers: int | None = None) -> None:
        if not isinstance(estimator, RecursiveEstimator | Runner):
            what = getattr(estimator, "method", type(estimator).__name__)
            raise UsageError(f"a fleet runs sample by sample, which {what} does not; use rls, bcrls, riv or rsrivc")
        first = estimator if isinstance(estimator, Runner) else estimator.runner
        self._source = first  # for its configuration: it may go on by itself
        self.axes = whole_number("axes", axes, 1, "it is the number of machines")
        remedy = "it is the number of threads; None: as many as there are processors"
        self.workers = _processors() if workers is None else whole_number("workers", workers, 1, remedy)
        try:
            self._kernel = first.kernel.many(self.axes, whole_words(first.precision))
        except (MemoryError, OverflowError, ValueError):
            raise UsageError(f"the states of {axes} axes do not fit the memory; take fewer at a time") from None
        self._first = self._kernel.states[:1].copy()
        self._way = self._kernel.fastest_way

    def __reduce__(self) -> tuple[object, ...]:
        return _resumed, (self.estimator, self._first, self.axes, self.workers, self.get_state())

    @property
    def estimator(self) -> RecursiveEstimator:
        """The configuration, as a new estimator."""
        return self._source.estimator

    def __repr__(self) -> str:
        return f"Fleet({self.estimator!r}, {self.axes}, workers={self.workers})"

    def run(self, u: ArrayLike, counts: ArrayLike, *, every: int | None = None) -> Tracks:
        """The next n samples of every axis, from its present state.

        u: (axes, n), or (n,) the same for all; counts: (axes, n). float32 or float64, int32 or int64 in any memory
        order are read in place. every: keep each so many samples' estimate, and the last one; None: the last one alone,
        whatever the number of samples. Raises UsageError where the arrays do not fit, the counts are no integers, or
        the memory does not hold what shall be kept.
        """
        u_table, counts_table = self._check(u, counts)
        if every is not None:
            every = whole_number("every", every, 1, "None keeps the last estimate alone")
            every = min(every, max(1, counts_table.shape[1]))
        samples = _kept(counts_table.shape[1], every)
        results = self._results(samples.size)
        if samples.size:
            self._run_all(u_table, counts_table, every or 0, results)
        theta, factor, inflation, innovation, variance, status = results
        names, units = self._source.names, self._source.units
        return Tracks(names, units, theta, factor, inflation, innovation, variance, status, samples)

    def axis(self, index: int) -> RecursiveEstimator:
        """A new estimator of the same configuration in the state of one axis."""
        index = whole_number("index", index, None, "it is the number of an axis")
        if not -self.axes <= index < self.axes:
            raise UsageError(f"there are {self.axes} axes, from 0 on; got {index}")
        single = self.estimator
        self._kernel.load(single.runner.kernel, index % self.axes)
        return single

    def reset(self) -> None:
        """Every axis back to the state in which the fleet was made."""
        self._kernel.reset()

    def get_state(self) -> bytes:
        """The states of all axes, with a version and checksums; `set_state` of a fleet of as many with the same
        configuration continues from them."""
        from pmfid.kernel.saved import save_fleet

        return save_fleet(self._kernel, self._source.precision)

    def set_state(self, state: bytes) -> None:
        """Continues from saved states. Raises UsageError, and stays as it was, for those of another configuration or
        number of axes, damaged ones, and numbers that no sample could have made."""
        from pmfid.kernel.saved import load_fleet

        load_fleet(self._kernel, self._source.precision, state)

    def _check(self, u: ArrayLike, counts: ArrayLike) -> tuple[NDArray[np.floating], NDArray[np.integer]]:
        u_table: NDArray[np.floating] = _in_place(numbers("u", u), (np.float32, np.float64), np.float64)
        counts_table: NDArray[np.integer] = _in_place(integer_counts(counts), (np.int32, np.int64), np.int64)
        fits = counts_table.ndim == 2 and counts_table.shape[0] == self.axes
        if not fits or u_table.shape not in (counts_table.shape, counts_table.shape[1:]):
            raise UsageError(
                f"counts must be ({self.axes}, n), an axis per row, and u the same or (n,) for all axes; got "
                f"{counts_table.shape} and {u_table.shape}"
            )
        return np.broadcast_to(u_table, counts_table.shape), counts_table

    def _results(self, kept: int) -> Results:
        shape, p = (self.axes, kept), len(self._source.names)
        try:
            theta, factor, inflation = (np.empty((*shape, p)) for _ in range(3))
            return theta, factor, inflation, np.empty(shape), np.empty(shape), np.empty(shape, np.uint32)
        except MemoryError:
            raise UsageError(
                f"{kept} estimates of {self.axes} axes do not fit the memory; keep fewer with a larger `every`"
            ) from None

    def _run_all(self, u: NDArray[np.floating], counts: NDArray[np.integer], every: int, results: Results) -> None:
        def run(piece: range) -> None:
            self._kernel.run(u, counts, piece.start, piece.stop, every, results, self._way)

        if self.workers == 1 or counts.size < SMALL:
            run(range(self.axes))
            return
        with ThreadPoolExecutor(self.workers) as pool:
            list(pool.map(run, self._pieces()))

    def _pieces(self) -> Iterator[range]:
        size = -(-self.axes // (self.workers * PIECES))
        size = -(-size // GROUP) * GROUP
        return (range(start, min(start + size, self.axes)) for start in range(0, self.axes, size))


def _resumed(estimator: RecursiveEstimator, first: NDArray[np.uint8], axes: int, workers: int, state: bytes) -> Fleet:
    runner = estimator.start()
    single = runner.kernel.many(1, whole_words(runner.precision))
    single.set_states(first)
    single.load(runner.kernel, 0)
    fleet = Fleet(runner, axes, workers=workers)
    fleet.set_state(state)
    return fleet


def _kept(samples: int, every: int | None) -> NDArray[np.int64]:
    """Numbers of the samples whose estimates are kept: every so many, and the last."""
    last = np.arange(samples)[-1:]
    return last if every is None else np.union1d(np.arange(every - 1, samples, every), last)


def _in_place(array: Numbers, readable: tuple[type[N], ...], other: type[N]) -> NDArray[N]:
    """The array itself where the kernel can read it, else a copy as type `other`."""
    native = array.dtype.type if array.dtype.type in readable else other
    return np.require(array, np.dtype(native), ["ALIGNED"])


def _processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
