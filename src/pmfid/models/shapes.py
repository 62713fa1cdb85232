"""Forces with a given form and an unknown size, such as friction at a speed or a place, and forces at a place.

The kernel computes a wave and a square. Every other form is a table of evenly spaced knots with straight lines between
the knots (csrc/pmf_shapes.inl). A new form is therefore one class in this module. A force with the form s and the
coefficient c is c s(|v|) sign(v), as friction, or c s(x). The position x counts from the first sample.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from pmfid.elementary import exp
from pmfid.errors import UsageError
from pmfid.kernel.configuration import ShapeTable
from pmfid.types import Floats

#: Number of straight pieces in the table of Stribeck friction.
PIECES = 64
#: Speed, in multiples of the Stribeck speed, above which Stribeck friction has vanished to exp(-16).
FADED = 4.0
#: Setting for a parameter that pmfid estimates.
ESTIMATE: Literal["estimate"] = "estimate"
#: Largest number of knots in a user's own table.
MOST_KNOTS = 200
SMALLEST, LARGEST = 1e-12, 1e12


class Shape(ABC):
    """Form of a force. `of_speed` is True if the form depends on the speed, and False if it depends on the place.
    `free` is True if the form has an unknown parameter. `positive` is True if no machine has a negative coefficient."""

    of_speed: bool = False
    free: bool = False
    positive: bool = False

    @abstractmethod
    def table(self) -> ShapeTable:
        """Return the table that the kernel reads. Raises UsageError if a parameter of the form is unknown."""

    @property
    @abstractmethod
    def reads(self) -> str:
        """Text of the form for people."""

    def size(self, speed: float) -> float:
        """Return the largest value of the form at speeds up to `speed`."""
        table = self.table()
        return speed**2 if table.of == "square" else float(np.max(np.abs(table.knots)))

    def evaluate(self, place: ArrayLike) -> Floats:
        """Return the values of the form (n,) at speeds or places (n,), as the kernel computes them."""
        table, at = self.table(), np.asarray(place, np.float64)
        if table.of == "square":
            return np.asarray(at**2)
        x = (at - table.start) / table.step
        if table.of == "wave":
            return np.asarray(np.sin(2 * math.pi * x))
        return np.interp(x, np.arange(len(table.knots)), table.knots)


@dataclass(frozen=True)
class Stribeck(Shape):
    """Stribeck friction exp(-(v / speed)^2), the part of the friction at rest that falls with the speed.

    Parameters
    ----------
    speed : float or "estimate"
        Stribeck speed [unit of y per s], > 0.

    Examples
    --------
    >>> from pmfid import Stribeck
    >>> Stribeck(0.1).speed
    0.1
    """

    speed: float | Literal["estimate"]

    of_speed = True
    positive = True

    def __post_init__(self) -> None:
        if self.speed != ESTIMATE:
            object.__setattr__(self, "speed", _length("the Stribeck speed", self.speed, "unit of y per s"))

    @property
    def free(self) -> bool:  # type: ignore[override]
        return self.speed == ESTIMATE

    def table(self) -> ShapeTable:
        if isinstance(self.speed, str):
            raise UsageError("the Stribeck speed is unknown: give the speed, or use fit to estimate it")
        step = FADED / PIECES
        speeds = [step * k for k in range(PIECES + 1)]
        # The mean over each piece equals the form's mean. Straight lines between the form's own values would lie on one
        # side of the form.
        knots = tuple(exp(-v * v) * (1 - (4 * v * v - 2) * step * step / 12) for v in speeds)
        return ShapeTable("speed", knots, step=step * self.speed, positive=self.positive)

    @property
    def reads(self) -> str:
        speed = self.speed if isinstance(self.speed, str) else f"{self.speed:.9g}"
        return f"exp(-(x'/{speed})^2)"


@dataclass(frozen=True)
class Square(Shape):
    """Quadratic friction v^2, which grows faster than the speed, as in air or oil.

    Examples
    --------
    >>> from pmfid import Square
    >>> Square()
    Square()
    """

    of_speed = True
    positive = True

    def table(self) -> ShapeTable:
        return ShapeTable("square", positive=self.positive)

    @property
    def reads(self) -> str:
        return "x'^2"


@dataclass(frozen=True)
class Wave(Shape):
    """Force with sin or cos of 2 pi x / period.

    Gravity on a rotary axis is a wave with the period of one turn. Cogging and a harmonic of the travel are further
    waves.

    Parameters
    ----------
    period : float
        Length of one period [unit of y], > 0.
    cosine : bool
        If True, the force is a cosine; if False, a sine.

    Examples
    --------
    >>> from pmfid import Wave
    >>> Wave(0.01, cosine=True)
    Wave(period=0.01, cosine=True)
    """

    period: float
    cosine: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "period", _length("the period", self.period, "unit of y"))

    def table(self) -> ShapeTable:
        return ShapeTable("wave", start=-self.period / 4 if self.cosine else 0.0, step=self.period)

    @property
    def reads(self) -> str:
        return f"{'cos' if self.cosine else 'sin'}({2 * math.pi / self.period:.9g} x)"


@dataclass(frozen=True)
class Along(Shape):
    """A force of known form along the travel and of unknown size.

    Parameters
    ----------
    start : float
        Place of the first value [unit of y].
    step : float
        Distance between neighbouring values [unit of y].
    values : sequence of float (k,)
        Values of the form, 2 to 200 of them. Before the first place and after the last, the end values hold.

    Examples
    --------
    >>> from pmfid import Along
    >>> Along(0.0, 0.01, (0.0, 1.0, 0.5)).step
    0.01
    """

    start: float
    step: float
    values: Sequence[float]

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", tuple(float(value) for value in self.values))
        _length("the step of a table", self.step, "unit of y")
        if not 2 <= len(self.values) <= MOST_KNOTS or not np.all(np.isfinite([self.start, *self.values])):
            raise UsageError(
                f"a table needs a finite start and 2 to {MOST_KNOTS} finite values, got start = {self.start} and "
                f"{len(self.values)} values"
            )
        if not any(self.values):
            raise UsageError("a table of zeros has no form: give the force at each position, in any unit")

    def table(self) -> ShapeTable:
        return ShapeTable("place", tuple(self.values), self.start, self.step)

    @property
    def reads(self) -> str:
        return f"(table of {len(self.values)} places)"


def _length(name: str, value: object, unit: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not SMALLEST <= value <= LARGEST:
        raise UsageError(f"{name} must be a number above 0, got {value!r}; give it in {unit}")
    return float(value)
