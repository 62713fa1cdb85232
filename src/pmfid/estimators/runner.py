"""Runners, which own the state of the kernel for one axis or many."""

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
#: Arrays of theta, the diagonal of P, its inflation, the innovation, its variance, and the status.
Results = tuple[Floats, Floats, Floats, Floats, Floats, NDArray[np.uint32]]


@dataclass(frozen=True)
class SampleBlock:
    """The next samples of several axes, and arrays for the kept estimates.

    `u` and `counts` (axes, n) have types that the kernel reads. `every` is the number of samples between two kept
    estimates; 0 keeps the last estimate alone. `samples` (m,) are the numbers of the samples with kept estimates.
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
        """Return the block for the arguments of `Fleet.run`. Raises as `Fleet.run`."""
        u_table, counts_table = _tables(u, counts, axes)
        if every is not None:
            every = whole_number("every", every, 1, "None keeps only the last estimate")
            every = min(every, max(1, counts_table.shape[1]))
        samples = kept_samples(counts_table.shape[1], every)
        return cls(u_table, counts_table, every or 0, samples, _room(axes, samples.size, parameters))

    def tracks(self, names: tuple[str, ...], units: tuple[str, ...], order: NDArray[np.int64] | None = None) -> Tracks:
        """Return the kept estimates. `order` (axes,) sorts the rows, and None keeps their order."""
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


def threads(workers: int | None) -> int:
    """Return the number of threads. None means all processors. Raises UsageError for an invalid number."""
    remedy = "it is the number of threads; None uses one thread for each processor"
    return processors() if workers is None else whole_number("workers", workers, 1, remedy)


class SideBySide:
    """Many axes that start from the present state of a kernel. The kernel itself does not change.

    `names` and `units` belong to the kernel's parameters. `Fleet` describes `axes` and `workers`. Raises UsageError for
    invalid numbers and for more axes than the memory holds.
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
            raise UsageError(f"the states of {axes} axes do not fit into memory; process fewer at a time") from None
        self._way = self.kernel.fastest_way

    def run(self, u: ArrayLike, counts: ArrayLike, every: int | None = None) -> Tracks:
        """Process the next n samples of every axis. `Fleet.run` describes the arguments and errors."""
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


def processors() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class RunnerEstimator(Protocol):
    """Part of a `RecursiveEstimator` that a runner uses: the configuration and the start of an estimation."""

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]  # marks a dataclass

    @property
    def names(self) -> tuple[str, ...]: ...
    @property
    def units(self) -> tuple[str, ...]: ...
    @property
    def precision(self) -> str: ...
    def start(self, state: bytes | None = None) -> Runner[Self]:
        """Return an independent runner."""
        ...


E = TypeVar("E", bound=RunnerEstimator)


class Runner(Generic[E]):
    """The state that a recursive estimator has gathered. Samples change no other object.

    `estimator.start()` makes a runner. Copies by `copy.deepcopy`, `pickle` and process pools continue from the present
    state with the same bits and share nothing with the original. A runner is equal only to itself.
    """

    def __init__(self, estimator: E, kernel: Kernel) -> None:
        # keeping the estimator, which has its own runner, would keep both objects alive
        self._type: type[E] = type(estimator)
        self._configuration = configuration_of(estimator)
        self.names, self.units, self.precision = estimator.names, estimator.units, estimator.precision
        self.kernel = kernel
        kernel.names = self.names
        # an instance attribute saves a look-up in Python at each call
        self.__dict__["step"] = kernel.step

    @property
    def estimator(self) -> E:
        """A new estimator with the same configuration."""
        return construct_estimator(self._type, self._configuration)

    def __repr__(self) -> str:
        return f"Runner({self.estimator!r})"

    def __reduce__(self) -> tuple[object, ...]:
        return _resume_runner, (self._type, self._configuration, self.get_state())

    def step(self, u: float, counts: int, dt: float | None = None) -> Estimate:
        """Process one sample and return the estimate.

        `u` is the input from now on, and `counts` is the present count. `dt` is the time since the last sample [s] for
        an estimator with `steps`; None takes the sample period. The estimate has theta (p,), theta_cov (p, p),
        theta_std (p,), innovation, innovation_variance and status. The status flags a non-finite value, which never
        enters the estimate. Raises TypeError for a count that is no integer.
        """
        return self.kernel.step(u, counts, dt)

    def run(self, u: ArrayLike, counts: ArrayLike, steps: ArrayLike | None = None) -> Track:
        """Process samples u and counts (n,) from the present state, with the same bits as `step` in a loop.

        `steps` (n,) are the times between consecutive samples [s], for an estimator with `steps`. Raises UsageError if
        the arrays differ in length, if the counts are no integers, or if `steps` does not suit the estimator.
        """
        u, counts = check_arrays(u, counts)
        return Track(self.names, self.units, *self.kernel.run(u, counts, self._steps_of(steps, u.size)))

    def _steps_of(self, steps: ArrayLike | None, samples: int) -> Floats | None:
        asked = self._configuration["steps"] is not None
        found = None if steps is None else check_steps(steps)
        if asked != (found is not None) or (found is not None and found.size != samples):
            raise UsageError(
                'steps (n,) belong to an estimator that is made with steps="given": give one step for each '
                "sample, or leave steps out for any other estimator"
            )
        return found

    def run_many(self, u: ArrayLike, counts: ArrayLike, *, every: int | None = None) -> Tracks:
        """Run many axes at once, each from the present state, which does not change.

        u is (axes, n), or (n,) for the same input on all axes; counts are (axes, n). The result has the last estimate
        of each axis, or one estimate for every `every` samples and the last. Each axis has the bits of `run`. A `Fleet`
        can continue with further samples. Raises UsageError like `Fleet.run`.
        """
        table = integer_counts(counts)
        return self.side_by_side(max(1, table.shape[0]) if table.ndim else 1).run(u, table, every)

    def side_by_side(self, axes: int, workers: int | None = None) -> SideBySide:
        """Return axes that start from the present state. `Fleet` describes the arguments and errors."""
        if self._configuration["steps"] is not None:
            raise UsageError(
                "many axes at once need evenly spaced samples: run each axis on its own, or make the "
                "estimator without the argument steps"
            )
        return SideBySide(self.kernel, self.precision, self.names, self.units, axes, workers)

    @property
    def estimate(self) -> Estimate:
        """The present `Estimate`."""
        return self.kernel.estimate()

    def open_memory(self, keep: float, parameter: str | None = None) -> None:
        """Reduce the weight of the gathered information to the part `keep` in (0, 1], after a change of the plant.

        `parameter` is the name of the changed parameter. The information on the other parameters, given its value,
        stays. None reduces all information. The estimate stays and its variance grows (covariance reset in information
        form, Goodwin and Sin 1984). Filters and auxiliary model continue. Raises UsageError for an invalid `keep` or an
        unknown parameter.
        """
        if not isinstance(keep, Real) or not 0 < keep <= 1:
            raise UsageError(f"keep must be in (0, 1], got {keep!r}; with 0.001 new samples dominate at once")
        if parameter is not None and parameter not in self.names:
            raise UsageError(f"parameter must be one of {list(self.names)} or None, got {parameter!r}")
        self.kernel.open(keep, -1 if parameter is None else self.names.index(parameter))

    def rebase(self, counts: int) -> None:
        """Follow a counter that was set to another value, as in a homing.

        `counts` is the new counter's value for the last sample. The estimate stays. Without `rebase`, the estimator
        flags the jump and loses one sample of motion (`Encoder.guard`).
        """
        self.kernel.rebase(counts)

    def gap(self, counts: int) -> None:
        """Restart filters and auxiliary model after lost samples, from the next sample with these counts.

        The information stays. For a gap of few samples, a linear interpolation of input and counts is better. If the
        input may have leapt in the gap, call `doubt` first. Raises TypeError for counts that are no integer.
        """
        self.kernel.gap(counts)

    def doubt(self, samples: int) -> None:
        """Mark the next `samples` samples as guesses, from which nothing is learnt.

        `doubt` suits a gap in which the input switched. In slow motion the estimator skips some further samples, at
        most the settling time of the filters, with the status `SETTLING`. Filters and auxiliary model continue. Raises
        UsageError for a negative or fractional number.
        """
        if isinstance(samples, bool) or not isinstance(samples, Integral) or not samples >= 0:
            raise UsageError(f"samples must be a whole number of at least 0, got {samples!r}")
        self.kernel.doubt(min(int(samples), 2**31))

    def reset(self) -> None:
        """Forget all samples."""
        self.kernel.reset()

    def get_state(self) -> bytes:
        """Return the whole state as bytes, with a version and checksums. `set_state` of a runner with the same
        configuration continues from this state, and so does exported firmware."""
        from pmfid.kernel.saved import save_state

        return save_state(self.kernel, self.precision)

    def set_state(self, state: bytes) -> None:
        """Continue from a saved state.

        Raises UsageError, without a change of the runner, for a damaged state and for a state of another configuration.
        Numbers that no sample could have made are refused even with a correct checksum.
        """
        from pmfid.kernel.saved import load_state

        load_state(self.kernel, self.precision, state)


def _resume_runner(cls: type[E], configuration: Mapping[str, object], state: bytes) -> Runner[E]:
    return construct_estimator(cls, configuration).start(state)
