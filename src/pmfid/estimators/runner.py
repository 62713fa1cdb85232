"""Runners, which own the state of the kernel for one axis or many."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import Field
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from pmfid.errors import UsageError
from pmfid.estimators.configuration import check_arrays, configuration_of, construct_estimator
from pmfid.estimators.results import Track
from pmfid.estimators.sample_steps import check_steps
from pmfid.types import Floats

if TYPE_CHECKING:
    from pmfid._estimate import Estimate
    from pmfid._kernel64 import Kernel

N = TypeVar("N", bound=np.number)


def processors() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class RunnerEstimator(Protocol):
    """Part of a `RecursiveEstimator` that runners and fleets use: its configuration, and the start of an estimation."""

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]  # marks a dataclass

    @property
    def names(self) -> tuple[str, ...]: ...
    @property
    def units(self) -> tuple[str, ...]: ...
    @property
    def precision(self) -> str: ...
    def check_gaps(self) -> None: ...
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

    @property
    def spaced(self) -> bool:
        """Whether the samples come with their own times."""
        return self._configuration["steps"] is not None

    def _steps_of(self, steps: ArrayLike | None, samples: int) -> Floats | None:
        asked = self.spaced
        found = None if steps is None else check_steps(steps)
        if asked != (found is not None) or (found is not None and found.size != samples):
            raise UsageError(
                'steps (n,) belong to an estimator that is made with steps="given": give one step for each '
                "sample, or leave steps out for any other estimator"
            )
        return found

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
