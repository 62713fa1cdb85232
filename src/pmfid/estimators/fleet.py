"""Fleets: many axes at once, as the machines of a plant or the runs of a simulation study."""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.errors import UsageError, whole_number
from pmfid.estimators.configuration import integer_counts, numbers
from pmfid.estimators.recursive import RecursiveEstimator
from pmfid.estimators.results import Tracks
from pmfid.kernel.saved import fleet_layout, load_fleet, save_fleet
from pmfid.types import Floats, Numbers

#: The number of axes that a thread takes at once is a multiple of this number, the size of the kernel's largest
#: vector.
FLEET_GROUP = 16
#: Pieces of work for each thread. Smaller pieces shorten the wait for the last thread.
FLEET_PIECES = 4
#: Less work than this [axes times samples] is not worth a second thread.
FLEET_SMALL = 20_000

N = TypeVar("N", bound=np.number)
E = TypeVar("E", bound=RecursiveEstimator)
#: Arrays of theta, the diagonal of P, its inflation, the innovation, its variance, and the status.
Results = tuple[Floats, Floats, Floats, Floats, Floats, NDArray[np.uint32]]


def processors() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _tables(u: ArrayLike, counts: ArrayLike, axes: int) -> tuple[NDArray[np.floating], NDArray[np.integer]]:
    u_table: NDArray[np.floating] = _make_readable(numbers("u", u), (np.float32, np.float64), np.float64)
    counts_table: NDArray[np.integer] = _make_readable(integer_counts(counts), (np.int32, np.int64), np.int64)
    fits = counts_table.ndim == 2 and counts_table.shape[0] == axes
    if not fits or u_table.shape not in (counts_table.shape, counts_table.shape[1:]):
        raise UsageError(
            f"counts must be ({axes}, n), with one row for each axis, and u the same, or (n,) for all "
            f"axes; got {counts_table.shape} and {u_table.shape}"
        )
    return np.broadcast_to(u_table, counts_table.shape), counts_table


def _room(axes: int, kept: int, p: int) -> Results:
    shape = (axes, kept)
    try:
        theta, factor, inflation = (np.empty((*shape, p)) for _ in range(3))
        return theta, factor, inflation, np.empty(shape), np.empty(shape), np.empty(shape, np.uint32)
    except MemoryError:
        raise UsageError(
            f"{kept} estimates of {axes} axes do not fit into memory; keep fewer with a larger `every`"
        ) from None


def kept_samples(samples: int, every: int | None) -> NDArray[np.int64]:
    """Return the numbers of the samples with kept estimates: every `every`-th sample, and the last."""
    last = np.arange(samples)[-1:]
    return last if every is None else np.union1d(np.arange(every - 1, samples, every), last)


def _make_readable(array: Numbers, readable: tuple[type[N], ...], other: type[N]) -> NDArray[N]:
    """Return the array itself if the kernel can read it, or else a copy of type `other`."""
    native = array.dtype.type if array.dtype.type in readable else other
    return np.require(array, np.dtype(native), ["ALIGNED"])


class Fleet(Generic[E]):
    """Many axes with the configuration of one recursive estimator. Each axis has its own state.

    The estimates of every axis equal those of the estimator alone, bit by bit. Vector instructions and threads compute
    many axes at once. A copy (`copy`, `pickle`, a process pool) continues with the same bits.

    Parameters
    ----------
    estimator : recursive estimator
        All axes start from the present state of the estimator, which does not change.
    axes : int
        Number of axes, >= 1.
    workers : int, optional
        Number of threads, >= 1. The default is the number of processors.

    Raises
    ------
    UsageError
        A number is outside these bounds, the estimator is not recursive, or the memory cannot hold them.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid import BCRLS, Drive, Encoder, Fleet, quantize
    >>> from pmfid.simulation import CART, CART_DT, CART_RESOLUTION, prbs, simulate_drive
    >>> u = np.array([prbs(1500, clock=10, amplitude=4.0, rng=np.random.default_rng(seed)) for seed in (1, 2)])
    >>> counts = np.array([quantize(simulate_drive(CART, one, CART_DT).x, CART_RESOLUTION) for one in u])
    >>> fleet = Fleet(BCRLS(Drive(CART.input_gain), Encoder(CART_RESOLUTION), CART_DT, 20.0), axes=2)
    >>> fleet.run(u, counts)["mass"][:, -1].round(2)
    array([1.07, 1.07])
    """

    def __init__(self, estimator: E, axes: int, *, workers: int | None = None) -> None:
        if not isinstance(estimator, RecursiveEstimator):
            what = getattr(estimator, "method", type(estimator).__name__)
            raise UsageError(f"a fleet runs sample by sample, and {what} does not; use rls, bcrls or riv")
        if estimator.steps is not None:
            raise UsageError(
                "many axes at once need evenly spaced samples: run each axis on its own, or make the "
                "estimator without the argument steps"
            )
        self.estimator: E = estimator
        self.axes = whole_number("axes", axes, 1, "it is the number of machines")
        remedy = "it is the number of threads; None uses one thread for each processor"
        self.workers = processors() if workers is None else whole_number("workers", workers, 1, remedy)
        try:
            self._kernel = estimator.kernel.many(self.axes, fleet_layout(estimator.kernel, estimator.precision))
        except (MemoryError, OverflowError, ValueError):
            raise UsageError(f"the states of {axes} axes do not fit into memory; process fewer at a time") from None
        self._way, self._first = self._kernel.fastest_way, self._kernel.states[:1].copy()

    def __reduce__(self) -> tuple[object, ...]:
        return _resume_fleet, (self.estimator, self._first, self.axes, self.workers, self.get_state())

    def __repr__(self) -> str:
        return f"Fleet({self.estimator!r}, {self.axes}, workers={self.workers})"

    def run(self, u: ArrayLike, counts: ArrayLike, *, every: int | None = None) -> Tracks:
        """Process the next n samples of every axis, from its present state, and return the estimates.

        `u` and `counts` are (axes, n); a `u` (n,) holds for all axes. Arrays of float32, float64, int32 or int64 are
        read in place, in any memory order. `every` is the number of samples from one kept estimate to the next. The
        last estimate is always kept, and None keeps only the last one. Raises UsageError if the arrays do not match,
        the counts are no integers, or the memory does not hold the kept estimates.
        """
        u_table, counts_table = _tables(u, counts, self.axes)
        n, names = counts_table.shape[1], self.estimator.names
        if every is not None:
            every = min(whole_number("every", every, 1, "None keeps only the last estimate"), max(1, n))
        samples = kept_samples(n, every)
        results = _room(self.axes, samples.size, len(names))
        if samples.size:
            self._run_all(u_table, counts_table, every or 0, results)
        return Tracks(names, self.estimator.units, *results, samples)

    def _run_all(self, u: NDArray[np.floating], counts: NDArray[np.integer], every: int, results: Results) -> None:
        def run(piece: range) -> None:
            self._kernel.run(u, counts, piece.start, piece.stop, every, results, self._way)

        if self.workers == 1 or counts.size < FLEET_SMALL:
            run(range(self.axes))
            return
        with ThreadPoolExecutor(self.workers) as pool:
            list(pool.map(run, self._pieces()))

    def _pieces(self) -> Iterator[range]:
        size = -(-self.axes // (self.workers * FLEET_PIECES))
        size = -(-size // FLEET_GROUP) * FLEET_GROUP
        return (range(start, min(start + size, self.axes)) for start in range(0, self.axes, size))

    def axis(self, index: int) -> E:
        """Return a new estimator of the same configuration in the state of one axis."""
        single = self.estimator.start()
        self._kernel.load(single.kernel, self._place(index))
        return single

    def gap(self, index: int, counts: int) -> None:
        """Report a gap in the samples of one axis; `counts` are those of its next sample.

        Raises TypeError if the counts are no integer. Raises UsageError if the axis does not exist, and for linear
        processes.
        """
        self.estimator.check_gaps()
        self._kernel.gap(self._place(index), counts)

    def _place(self, index: int) -> int:
        index = whole_number("index", index, None, "it is the number of an axis")
        if not -self.axes <= index < self.axes:
            raise UsageError(f"the axis must be from 0 to {self.axes - 1}; got {index}")
        return index % self.axes

    def reset(self) -> None:
        """Reset every axis to the state in which the fleet was made."""
        self._kernel.reset()

    def get_state(self) -> bytes:
        """Return the states of all axes, with a version and checksums.

        `set_state` of a fleet with the same configuration and number of axes continues from these states.
        """
        return save_fleet(self._kernel, self.estimator.precision)

    def set_state(self, state: bytes) -> None:
        """Continue from saved states.

        Raises UsageError, without any change of the fleet, if the states are damaged or impossible, or have another
        configuration or number of axes.
        """
        load_fleet(self._kernel, self.estimator.precision, state)


def _resume_fleet(estimator: E, first: NDArray[np.uint8], axes: int, workers: int, state: bytes) -> Fleet[E]:
    begun = estimator.start()
    single = begun.kernel.many(1, fleet_layout(begun.kernel, begun.precision))
    single.set_states(first)
    single.load(begun.kernel, 0)
    fleet = Fleet(begun, axes, workers=workers)
    fleet.set_state(state)
    return fleet
