"""Times between the samples of an uneven clock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.errors import UsageError
from pmfid.kernel.structures import constants_of
from pmfid.types import Floats

#: Longest step of a clock in sample periods. A longer step is a gap.
LONGEST = constants_of(None)["PMF_LONGEST"]
#: Value of `steps` for samples that arrive with the time since their predecessor.
GIVEN: Literal["given"] = "given"


@dataclass(frozen=True, eq=False)
class SampleSteps:
    """Times `before` (n,) between each sample and its predecessor [s], all positive. The first time is a period."""

    before: Floats

    def __eq__(self, other: object) -> bool:
        return isinstance(other, SampleSteps) and np.array_equal(self.before, other.before)

    def __hash__(self) -> int:
        return hash(self.before.tobytes())

    def __repr__(self) -> str:
        return f"SampleSteps for {self.before.size} samples"

    @cached_property
    def after(self) -> Floats:
        """Times (n,) from each sample to the next [s]."""
        return np.append(self.before[1:], self.before[:1])

    def weights(self, dt: float) -> Floats:
        """Return the weight (n,) of each row of columns for an integral over time, in sample periods dt [s]. A row is
        one sample late. The weight of a row is half the sum of the steps before and after the sample."""
        step = np.minimum(np.append(dt, self.before) / dt, LONGEST)
        return np.asarray((step[:-1] + step[1:]) / 2)

    def part(self, first: int, last: int) -> SampleSteps:
        """Return the steps of the samples first to last - 1."""
        return SampleSteps(self.before[first:last])


#: Argument `steps` of an estimator.
StepsOption = SampleSteps | Sequence[float] | NDArray[np.floating[Any]] | Literal["given"] | None


def read_steps(steps: StepsOption) -> SampleSteps | Literal["given"] | None:
    """Return the argument `steps` of an estimator. Raises UsageError for anything but None, "given" and positive
    numbers.
    """
    if steps is None or isinstance(steps, SampleSteps):
        return steps
    if isinstance(steps, str):
        if steps == GIVEN:
            return GIVEN
    else:
        found = check_steps(steps)
        if found.size:
            return SampleSteps(found)
    raise UsageError(
        f'steps must be the time from the previous sample to each sample in s, or "given" on-line, got {steps!r}'
    )


def check_steps(steps: ArrayLike) -> Floats:
    """Return the steps (n,) [s] as floats. Raises UsageError for anything but positive finite numbers."""
    try:
        found = np.ascontiguousarray(steps, dtype=np.float64)
    except (TypeError, ValueError):
        found = np.zeros(1)
    if found.ndim != 1 or not np.all((found > 0) & (found < np.inf)):
        raise UsageError(
            "steps must be positive and finite: the time from the previous sample to each sample in s, (n,)"
        )
    return found
