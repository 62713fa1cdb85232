"""Any linear process with one input and one output."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Integral
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.errors import UsageError
from pmfid.models.equation import Equation, Term

MAX_ORDER = 6
MAX_DELAY = 20


@dataclass(frozen=True)
class TransferFunction:
    """y^(n) + a_{n-1} y^(n-1) + ... + a_0 y = b_m u^(m) + ... + b_0 u [+ offset]  (paper eq. 6, n > m).

    n: order of the denominator, 1 to 6; m: order of the numerator, 0 to n - 1. delay: dead time of the input in whole
    samples, 0 to 20. offset: a constant on the right-hand side is unknown, too; the output without input is then
    offset / a_0. initial_conditions: so is the state at the first sample (paper eq. 10); the filters need not settle
    then and every sample counts.
    Parameters: a0 to a{n-1}, b0 to b{m} [, offset] [, start0 to start{n-1}]; the last are what stood in the plant
    at the start, the coefficients of the derivatives of the filters' impulse response, and of no meaning by themselves.
    The position of the encoder counts from count zero. Raises UsageError for values outside these bounds.
    """

    kind: ClassVar[str] = "transfer_function"

    n: int
    m: int
    delay: int = 0
    offset: bool = False
    initial_conditions: bool = False

    def __post_init__(self) -> None:
        _check_whole("n", self.n, 1, MAX_ORDER, "the order of the denominator")
        _check_whole("m", self.m, 0, self.n - 1, "the order of the numerator, less than that of the denominator")
        late = "the dead time in whole samples; for a longer one shift the input"
        _check_whole("delay", self.delay, 0, MAX_DELAY, late)

    @property
    def equation(self) -> Equation:
        unknown = [Term("process_output", i, f"a{i}", power_unit(i - self.n)) for i in range(self.n)]
        unknown += [Term("process_input", j, f"b{j}", power_unit(j - self.n), -1.0) for j in range(self.m + 1)]
        if self.offset:
            unknown.append(Term("constant", 0, "offset", power_unit(-self.n), -1.0))
        if self.initial_conditions:
            unknown += [Term("start", i, f"start{i}", "", -1.0) for i in range(self.n)]
        return Equation(tuple(unknown), (Term("process_output", self.n, coefficient=-1.0),), self.delay)

    @property
    def symmetric(self) -> TransferFunction:
        return self

    def split(self, theta: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Numerator (m+1,) and denominator (n+1,) in descending powers of s, the first of these 1, from theta (p,)."""
        theta = np.asarray(theta, float)
        a, b = theta[: self.n], theta[self.n : self.n + self.m + 1]
        return b[::-1].copy(), np.r_[1.0, a[::-1]]


def _check_whole(name: str, value: object, low: int, high: int, what: str) -> None:
    if isinstance(value, bool) or not isinstance(value, Integral) or not low <= value <= high:  # type: ignore[operator]
        raise UsageError(f"{name} must be a whole number from {low} to {high}, got {value!r}: it is {what}")


def power_unit(power: int) -> str:
    """The unit of a_i for y and u in the same unit."""
    return f"s^{power}"
