"""Many states of one kernel side by side: in vectors, and on all processors."""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.errors import UsageError, whole_number
from pmfid.estimators.arguments import integer_counts, numbers
from pmfid.estimators.track import Tracks
from pmfid.kernel.structures import whole_words
from pmfid.types import Floats, Numbers

if TYPE_CHECKING:
    from pmfid._kernel64 import Kernel

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
class SampleBlock:
    """The next samples of some axes, and room for what is kept of their estimates.

    u, counts: (axes, n) as the kernel reads them; every: samples from one kept estimate to the next, 0: the last alone;
    samples: (m,) numbers of the samples with kept estimates.
    """

    u: NDArray[np.floating]
    counts: NDArray[np.integer]
    every: int
    samples: NDArray[np.int64]
    results: Results

    @classmethod
    def from_arguments(
        cls, u: ArrayLike, counts: ArrayLike, every: int | None, axes: int, parameters: int
    ) -> SampleBlock:
        """Arguments and errors of `Fleet.run`."""
        u_table, counts_table = _tables(u, counts, axes)
        if every is not None:
            every = whole_number("every", every, 1, "None keeps the last estimate alone")
            every = min(every, max(1, counts_table.shape[1]))
        samples = kept_samples(counts_table.shape[1], every)
        return cls(u_table, counts_table, every or 0, samples, _room(axes, samples.size, parameters))

    def tracks(self, names: tuple[str, ...], units: tuple[str, ...], order: NDArray[np.int64] | None = None) -> Tracks:
        """What was kept; order: (axes,) rows in which the axes shall come, None: as they are."""
        rows = slice(None) if order is None else order
        theta, factor, inflation, innovation, variance, status = self.results
        return Tracks(
            names, units, theta[rows], factor[rows], inflation[rows], innovation[rows], variance[rows], status[rows],
            self.samples,
        )  # fmt: skip


def _tables(u: ArrayLike, counts: ArrayLike, axes: int) -> tuple[NDArray[np.floating], NDArray[np.integer]]:
    u_table: NDArray[np.floating] = _make_readable(numbers("u", u), (np.float32, np.float64), np.float64)
    counts_table: NDArray[np.integer] = _make_readable(integer_counts(counts), (np.int32, np.int64), np.int64)
    fits = counts_table.ndim == 2 and counts_table.shape[0] == axes
    if not fits or u_table.shape not in (counts_table.shape, counts_table.shape[1:]):
        raise UsageError(
            f"counts must be ({axes}, n), an axis per row, and u the same or (n,) for all axes; got "
            f"{counts_table.shape} and {u_table.shape}"
        )
    return np.broadcast_to(u_table, counts_table.shape), counts_table


def _room(axes: int, kept: int, p: int) -> Results:
    shape = (axes, kept)
    try:
        theta, factor, inflation = (np.empty((*shape, p)) for _ in range(3))
        return theta, factor, inflation, np.empty(shape), np.empty(shape), np.empty(shape, np.uint32)
    except MemoryError:
        raise UsageError(
            f"{kept} estimates of {axes} axes do not fit the memory; keep fewer with a larger `every`"
        ) from None


def kept_samples(samples: int, every: int | None) -> NDArray[np.int64]:
    """Numbers of the samples whose estimates are kept: one in `every`, and the last."""
    last = np.arange(samples)[-1:]
    return last if every is None else np.union1d(np.arange(every - 1, samples, every), last)


def _make_readable(array: Numbers, readable: tuple[type[N], ...], other: type[N]) -> NDArray[N]:
    """The array itself where the kernel can read it, else a copy as type `other`."""
    native = array.dtype.type if array.dtype.type in readable else other
    return np.require(array, np.dtype(native), ["ALIGNED"])


def threads(workers: int | None) -> int:
    """Number of threads; None: as many as there are processors. Raises UsageError for what is no number of threads."""
    remedy = "it is the number of threads; None: as many as there are processors"
    return _processors() if workers is None else whole_number("workers", workers, 1, remedy)


class SideBySide:
    """Axes from the present state of a kernel, which itself does not change; names, units: of its parameters.

    axes, workers: see `Fleet`. Raises UsageError for other numbers, and for more axes than the memory holds.
    """

    def __init__(
        self,
        kernel: Kernel,
        precision: str,
        names: tuple[str, ...],
        units: tuple[str, ...],
        axes: int,
        workers: int | None = None,
    ) -> None:
        self.names, self.units = names, units
        self.axes = whole_number("axes", axes, 1, "it is the number of machines")
        self.workers = threads(workers)
        try:
            self.kernel = kernel.many(self.axes, whole_words(precision))
        except (MemoryError, OverflowError, ValueError):
            raise UsageError(f"the states of {axes} axes do not fit the memory; take fewer at a time") from None
        self._way = self.kernel.fastest_way

    def run(self, u: ArrayLike, counts: ArrayLike, every: int | None = None) -> Tracks:
        """The next n samples of every axis; arguments and errors of `Fleet.run`."""
        work = SampleBlock.from_arguments(u, counts, every, self.axes, len(self.names))
        if work.samples.size:
            self._run_all(work.u, work.counts, work.every, work.results)
        return work.tracks(self.names, self.units)

    def _run_all(self, u: NDArray[np.floating], counts: NDArray[np.integer], every: int, results: Results) -> None:
        def run(piece: range) -> None:
            self.kernel.run(u, counts, piece.start, piece.stop, every, results, self._way)

        if self.workers == 1 or counts.size < SMALL:
            run(range(self.axes))
            return
        with ThreadPoolExecutor(self.workers) as pool:
            list(pool.map(run, self._pieces()))

    def _pieces(self) -> Iterator[range]:
        size = -(-self.axes // (self.workers * PIECES))
        size = -(-size // GROUP) * GROUP
        return (range(start, min(start + size, self.axes)) for start in range(0, self.axes, size))


def _processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
