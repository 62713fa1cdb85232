"""An estimation that is under way: the state of a recursive estimator, apart from its configuration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import Field
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Protocol, Self, TypeVar

from numpy.typing import ArrayLike

from pmfid.errors import UsageError
from pmfid.estimators.arguments import check_arrays, integer_counts
from pmfid.estimators.configuration import configuration_of, construct_estimator
from pmfid.estimators.side_by_side import SideBySide
from pmfid.estimators.track import Track, Tracks

if TYPE_CHECKING:
    from pmfid._estimate import Estimate
    from pmfid._kernel64 import Kernel


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

    def step(self, u: float, counts: int) -> Estimate:
        """One sample: the input applied from now on, the count read now.

        The estimate has theta (p,), theta_cov (p, p), theta_std (p,), innovation, innovation_variance and status.
        A value that is not finite is flagged in the status and never enters. Raises TypeError for counts that are no
        integer.
        """
        return self.kernel.step(u, counts)

    def run(self, u: ArrayLike, counts: ArrayLike) -> Track:
        """Many samples at once, from the present state; u, counts: (n,). The same bits as `step` in a loop.

        Raises UsageError where the arrays differ in length or the counts are no integers.
        """
        return Track(self.names, self.units, *self.kernel.run(*check_arrays(u, counts)))

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
