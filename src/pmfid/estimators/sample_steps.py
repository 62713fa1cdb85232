"""The times between the samples of an uneven clock."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from pmfid.errors import UsageError
from pmfid.kernel.structures import constants_of
from pmfid.types import Floats

#: Sample periods; a longer step is a gap, not the clock.
LONGEST = constants_of(None)["PMF_LONGEST"]
#: Each sample comes with the time since the last one.
GIVEN: Literal["given"] = "given"


@dataclass(frozen=True, eq=False)
class SampleSteps:
    """before: (n,) time of each sample since the one before [s], > 0; the first one is a period."""

    before: Floats

    def __eq__(self, other: object) -> bool:
        return isinstance(other, SampleSteps) and np.array_equal(self.before, other.before)

    def __hash__(self) -> int:
        return hash(self.before.tobytes())

    def __repr__(self) -> str:
        return f"SampleSteps of {self.before.size} samples"

    @cached_property
    def after(self) -> Floats:
        """(n,) time from each sample to the next [s]."""
        return np.append(self.before[1:], self.before[:1])

    def weights(self, dt: float) -> Floats:
        """(n,) half of the steps before and after each row of columns, which is one sample late, in sample periods dt
        [s]: a sum over rows is then an integral over time."""
        step = np.minimum(np.append(dt, self.before) / dt, LONGEST)
        return np.asarray((step[:-1] + step[1:]) / 2)

    def part(self, first: int, last: int) -> SampleSteps:
        """Of samples first to last - 1."""
        return SampleSteps(self.before[first:last])


def read_steps(steps: object) -> SampleSteps | Literal["given"] | None:
    """The argument `steps` of an estimator. Raises UsageError for anything but None, "given" and positive numbers."""
    if steps is None or isinstance(steps, SampleSteps):
        return steps
    if isinstance(steps, str):
        if steps == GIVEN:
            return GIVEN
    else:
        found = check_steps(steps)  # type: ignore[arg-type]
        if found.size:
            return SampleSteps(found)
    raise UsageError(
        f'steps must be the time of each sample since the one before in s, or "given" on-line, got {steps!r}'
    )


def check_steps(steps: ArrayLike) -> Floats:
    """(n,) positive numbers [s]. Raises UsageError for anything else."""
    try:
        found = np.ascontiguousarray(steps, dtype=np.float64)
    except (TypeError, ValueError):
        found = np.zeros(1)
    if found.ndim != 1 or not np.all((found > 0) & (found < np.inf)):
        raise UsageError("steps must be positive and finite, the time of each sample since the one before in s, (n,)")
    return found
