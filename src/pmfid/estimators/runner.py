"""Runners own the state of the kernel, for one axis or many."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import Field, dataclass
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.errors import UsageError, whole_number
from pmfid.estimators.configuration import check_arrays, configuration_of, construct_estimator, integer_counts, numbers
from pmfid.estimators.results import Track, Tracks
from pmfid.estimators.sample_steps import check_steps
from pmfid.estimators.tuning import TUNING
from pmfid.kernel.structures import whole_words
from pmfid.types import Floats, Numbers

if TYPE_CHECKING:
    from pmfid._estimate import Estimate
    from pmfid._kernel64 import Kernel

N = TypeVar("N", bound=np.number)
#: theta, diagonal of P, its inflation, innovation, its variance, status.
Results = tuple[Floats, Floats, Floats, Floats, Floats, NDArray[np.uint32]]


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

        if self.workers == 1 or counts.size < TUNING.runner_small:
            run(range(self.axes))
            return
        with ThreadPoolExecutor(self.workers) as pool:
            list(pool.map(run, self._pieces()))

    def _pieces(self) -> Iterator[range]:
        size = -(-self.axes // (self.workers * TUNING.runner_pieces))
        size = -(-size // TUNING.runner_group) * TUNING.runner_group
        return (range(start, min(start + size, self.axes)) for start in range(0, self.axes, size))


def _processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class RunnerEstimator(Protocol):
    """What a runner knows of its estimator (`RecursiveEstimator`): the configuration, and how one is begun with it."""

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]  # a dataclass

    @property
    def names(self) -> tuple[str, ...]: ...
    @property
    def units(self) -> tuple[str, ...]: ...
    @property
    def precision(self) -> str: ...
    def start(self, state: bytes | None = None) -> Runner[Self]:
        """An estimation of its own."""
        ...


E = TypeVar("E", bound=RunnerEstimator)


class Runner(Generic[E]):
    """What a recursive estimator has gathered from the samples so far, and the only object that samples change.

    `estimator.start()` makes one. Copies, also by `copy.deepcopy`, `pickle` and process pools, go on from the present
    state with the same bits and share nothing with the original. Two runners are equal only if they are one.
    """

    def __init__(self, estimator: E, kernel: Kernel) -> None:
        # not the estimator itself, which has a runner of its own: the two would keep each other alive
        self._type: type[E] = type(estimator)
        self._configuration = configuration_of(estimator)
        self.names, self.units, self.precision = estimator.names, estimator.units, estimator.precision
        self.kernel = kernel
        kernel.names = self.names
        # bound here so that a call costs no look-up in Python
        self.__dict__["step"] = kernel.step

    @property
    def estimator(self) -> E:
        """The configuration, as a new estimator."""
        return construct_estimator(self._type, self._configuration)

    def __repr__(self) -> str:
        return f"Runner({self.estimator!r})"

    def __reduce__(self) -> tuple[object, ...]:
        return _resume_runner, (self._type, self._configuration, self.get_state())

    def step(self, u: float, counts: int, dt: float | None = None) -> Estimate:
        """One sample: the input applied from now on, the count read now; dt: time since the last sample [s], of an
        estimator with `steps`; None: the sample period.

        The estimate has theta (p,), theta_cov (p, p), theta_std (p,), innovation, innovation_variance and status.
        A value that is not finite is flagged in the status and never enters. Raises TypeError for counts that are no
        integer.
        """
        return self.kernel.step(u, counts, dt)

    def run(self, u: ArrayLike, counts: ArrayLike, steps: ArrayLike | None = None) -> Track:
        """Many samples at once, from the present state; u, counts: (n,); steps: (n,) time of each sample since the one
        before [s], of an estimator with `steps`. The same bits as `step` in a loop.

        Raises UsageError if the arrays differ in length, the counts are no integers, or steps are given to an
        estimator without or not given to one with `steps`.
        """
        u, counts = check_arrays(u, counts)
        return Track(self.names, self.units, *self.kernel.run(u, counts, self._steps_of(steps, u.size)))

    def _steps_of(self, steps: ArrayLike | None, samples: int) -> Floats | None:
        asked = self._configuration["steps"] is not None
        found = None if steps is None else check_steps(steps)
        if asked != (found is not None) or (found is not None and found.size != samples):
            raise UsageError(
                "an estimator made with steps takes steps (n,), one for each sample; one without takes "
                'none: make it with steps="given"'
            )
        return found

    def run_many(self, u: ArrayLike, counts: ArrayLike, *, every: int | None = None) -> Tracks:
        """Many axes at once, each from the present state, which itself does not change.

        u: (axes, n), or (n,) the same for all; counts: (axes, n). The result has the last estimate of each axis, or
        one in `every` samples as well. Each axis has the bits of `run`. To go on with further samples use a `Fleet`.
        Raises UsageError like `Fleet.run`.
        """
        table = integer_counts(counts)
        return self.side_by_side(max(1, table.shape[0]) if table.ndim else 1).run(u, table, every)

    def side_by_side(self, axes: int, workers: int | None = None) -> SideBySide:
        """Axes from the present state; arguments and errors of `Fleet`, which keeps them."""
        if self._configuration["steps"] is not None:
            raise UsageError(
                "many axes at once take an even clock: run each by itself, or make the estimator without steps"
            )
        return SideBySide(self.kernel, self.precision, self.names, self.units, axes, workers)

    @property
    def estimate(self) -> Estimate:
        """The present `Estimate`."""
        return self.kernel.estimate()

    def open_memory(self, keep: float, parameter: str | None = None) -> None:
        """After a change of the plant: only the part `keep` in (0, 1] of what was gathered counts from now on.

        parameter: what changed; what is known of the others for a given value of it stays. None: all. The estimate
        stays where it is and its variance grows (covariance reset, Goodwin and Sin 1984, in information form); filters
        and auxiliary model go on. Raises UsageError for another keep or an unknown parameter.
        """
        if not isinstance(keep, Real) or not 0 < keep <= 1:
            raise UsageError(f"keep must be in (0, 1], got {keep!r}; 0.001 lets new samples prevail at once")
        if parameter is not None and parameter not in self.names:
            raise UsageError(f"parameter must be one of {list(self.names)} or None, got {parameter!r}")
        self.kernel.open(keep, -1 if parameter is None else self.names.index(parameter))

    def rebase(self, counts: int) -> None:
        """The counter was set to another value, as in a homing: it would have read `counts` at the last sample.

        The estimate stays. Without this call a jump beyond the motion limits of the axis is found and flagged, and the
        motion in its sample is lost (`Encoder.guard`).
        """
        self.kernel.rebase(counts)

    def gap(self, counts: int) -> None:
        """Samples were lost, and the next one has these counts. Filters and auxiliary model restart with its motion.
        The information stays. A gap of a few samples is better stepped through, with input and counts on the straight
        lines between its neighbours; call `doubt` before, if the input may have leapt in it. Raises TypeError for
        counts that are no integer."""
        self.kernel.gap(counts)

    def doubt(self, samples: int) -> None:
        """The next `samples` samples are guesses, as in a gap in which the input switched: nothing is learnt from them.
        In slow motion some further samples are left out, at most as many as the filters take to settle. The status is
        `SETTLING` then. Filters and auxiliary model go on. Raises UsageError for a number that is negative or no
        integer."""
        if isinstance(samples, bool) or not isinstance(samples, Integral) or not samples >= 0:
            raise UsageError(f"samples must be a whole number from 0 on, got {samples!r}")
        self.kernel.doubt(min(int(samples), 2**31))

    def reset(self) -> None:
        """Forgets all samples."""
        self.kernel.reset()

    def get_state(self) -> bytes:
        """The whole state, with a version and checksums; `set_state` of a runner with the same configuration, or the
        firmware exported from it, continues from it."""
        from pmfid.kernel.saved import save_state

        return save_state(self.kernel, self.precision)

    def set_state(self, state: bytes) -> None:
        """Continues from a saved state. Raises UsageError, and stays as it was, for one of another configuration, a
        damaged one, and numbers that no sample could have made, whatever their checksum."""
        from pmfid.kernel.saved import load_state

        load_state(self.kernel, self.precision, state)


def _resume_runner(cls: type[E], configuration: Mapping[str, object], state: bytes) -> Runner[E]:
    return construct_estimator(cls, configuration).start(state)
