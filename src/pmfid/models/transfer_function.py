"""Model of a linear process with one input and one output."""

from __future__ import annotations

from dataclasses import dataclass, replace
from numbers import Integral
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmfid.errors import UsageError
from pmfid.models.equation import DEAD_TIME, ESTIMATE, Equation, Term, check_late

MAX_ORDER = 6
MAX_DELAY = 20


@dataclass(frozen=True)
class TransferFunction:
    """Model of a process: y^(n) + a_{n-1} y^(n-1) + ... + a_0 y = b_m u^(m) + ... + b_0 u [+ offset]  (paper eq. 6).

    Parameters
    ----------
    n : int
        Order of the denominator, 1 to 6.
    m : int
        Order of the numerator, 0 to n. With m = n, a part of the input acts on the output directly. A held input acts
        from its own sample on: y[k] depends on u[k - delay].
    delay : int
        Dead time of the input in whole samples, 0 to 20.
    offset : bool
        If True, a constant on the right-hand side is unknown as well. The output without input is then offset / a_0.
    initial_conditions : bool
        If True, the state at the first sample is unknown as well (paper eq. 10). The filters then need no time to
        settle, and every sample counts.
    integrators : int
        Number of poles that are known to be at 0, from 0 to n, for every method off-line. The denominator is
        s^integrators (s^(n-integrators) + ...) and has no coefficients below a{integrators}. The fit then includes the
        first value of the output and its drift. With integrators, the offset is a constant force, which makes the
        output a ramp or a parabola.
    unstable : bool
        If True, poles may be in the right half-plane, as in a process that only its controller stabilises. The record
        must then contain the reference of the controller. Growing modes are computed backward in time, which equals the
        predictor with mirrored poles (Forssell and Ljung 2000).
    dead_time : float or "estimate"
        Dead time of the input [s], which need not be a whole number of samples, in place of `delay`. "estimate" makes
        the dead time an unknown from 0 to 20 samples, for `SRIVC`.

    Raises
    ------
    UsageError
        A value is outside these bounds.

    Notes
    -----
    The parameters are a0 to a{n-1}, b0 to b{m} [, offset] [, dead_time] [, start0 to start{n-1}].

    The parameters start0 to start{n-1} describe the state of the plant at the first sample. Each start parameter is a
    coefficient of one derivative of the filters' impulse response and has no physical meaning. The position of the
    encoder counts from count zero.

    Only the methods that simulate, `SRIVC` and `IV`, accept m = n, `unstable` and `dead_time`.

    Examples
    --------
    >>> from pmfid import TransferFunction
    >>> TransferFunction(2, 1).equation.names
    ('a0', 'a1', 'b0', 'b1')
    """

    kind: ClassVar[str] = "transfer_function"

    n: int
    m: int
    delay: int = 0
    offset: bool = False
    initial_conditions: bool = False
    integrators: int = 0
    unstable: bool = False
    dead_time: float | Literal["estimate"] = 0.0

    def __post_init__(self) -> None:
        _check_whole("n", self.n, 1, MAX_ORDER, "the order of the denominator")
        _check_whole("m", self.m, 0, self.n, "the order of the numerator, at most the order of the denominator")
        late = "the dead time in whole samples; shift the input for a longer dead time"
        _check_whole("delay", self.delay, 0, MAX_DELAY, late)
        _check_whole("integrators", self.integrators, 0, self.n, "how many of the n poles are at 0")
        self._check_late()

    def _check_late(self) -> None:
        value = self.dead_time
        check_late(DEAD_TIME, value)
        if value and self.delay:
            whole = "" if value == ESTIMATE else ", and give the whole dead time in s as dead_time"
            raise UsageError(f"delay = {self.delay} and dead_time = {value!r} are both given: leave delay out{whole}")

    @property
    def only_simulated(self) -> str:
        """Reason why only methods that simulate whole records accept the model. The text is empty if all methods do."""
        if self.m == self.n:
            return "the numerator is of the order of the denominator (m = n)"
        if self.integrators == self.n:
            return "all poles are known (integrators = n)"
        return "the dead time is not a whole number of samples (dead_time)" if self.dead_time else ""

    @property
    def equation(self) -> Equation:
        unknown = [Term("process_output", i, f"a{i}", power_unit(i - self.n)) for i in range(self.integrators, self.n)]
        unknown += [Term("process_input", j, f"b{j}", power_unit(j - self.n), -1.0) for j in range(self.m + 1)]
        if self.offset:
            unknown.append(Term("constant", 0, "offset", power_unit(-self.n), -1.0))
        if self.initial_conditions:
            unknown += [Term("start", i, f"start{i}", "", -1.0) for i in range(self.n)]
        known = (Term("process_output", self.n, coefficient=-1.0),)
        further = ((DEAD_TIME, "s"),) if self.dead_time == ESTIMATE else ()
        return Equation(tuple(unknown), known, self.delay, self.only_simulated, further)

    @property
    def symmetric(self) -> TransferFunction:
        return self

    @property
    def simple(self) -> TransferFunction:
        return self

    def replace_dead_time(self, seconds: float | Literal["estimate"]) -> TransferFunction:
        return replace(self, dead_time=seconds)

    def replace_lag(self, seconds: float | Literal["estimate"]) -> TransferFunction:
        if not seconds:
            return self
        raise UsageError("a lag of a linear process is one of its poles: leave lag out, and increase n by 1")

    def split(self, theta: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the numerator (m+1,) and the denominator (n+1,) in descending powers of s, from theta (p,).

        The first coefficient of the denominator is 1.
        """
        theta, free = np.asarray(theta, float), self.n - self.integrators
        a, b = theta[:free], theta[free : free + self.m + 1]
        return b[::-1].copy(), np.r_[1.0, a[::-1], np.zeros(self.integrators)]


def _check_whole(name: str, value: object, low: int, high: int, what: str) -> None:
    if isinstance(value, bool) or not isinstance(value, Integral) or not low <= value <= high:  # type: ignore[operator]
        raise UsageError(f"{name} must be a whole number from {low} to {high}, got {value!r}: it is {what}")


def power_unit(power: int) -> str:
    """Return the unit of a coefficient a_i if y and u have equal units."""
    return f"s^{power}"
