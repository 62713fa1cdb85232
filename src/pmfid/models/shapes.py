"""Forces of a given form and an unknown size: friction at a speed or along the travel, and forces at a place.

A wave and a square are computed. All others are tables that the kernel reads on straight lines between evenly spaced
knots (csrc/pmf_shapes.h), so that a new form is one class here. A force of the form s and the coefficient c is
c s(|v|) sign(v), as friction, or c s(x); x counts from the first sample on.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from pmfid.deprecation import rename_method
from pmfid.errors import UsageError
from pmfid.kernel.configuration import ShapeTable
from pmfid.types import Floats

#: Straight pieces of Stribeck's friction.
PIECES = 64
#: Stribeck speeds beyond which nothing is left of that friction: exp(-16).
FADED = 4.0
#: In place of a number that is to be found.
ESTIMATE: Literal["estimate"] = "estimate"
#: Knots of a table of the user's own.
MOST_KNOTS = 200
SMALLEST, LARGEST = 1e-12, 1e12


class Shape(ABC):
    """A form. `of_speed`: it depends on the speed, else on the place. `free`: it has a parameter that is to be found.
    `positive`: no machine has a negative coefficient."""

    of_speed: bool = False
    free: bool = False
    positive: bool = False

    @abstractmethod
    def table(self) -> ShapeTable:
        """The form as the kernel reads it. Raises UsageError if a parameter of it is not known yet."""

    @property
    @abstractmethod
    def reads(self) -> str:
        """The form, for people."""

    def size(self, speed: float) -> float:
        """The largest value of the form at speeds up to this one."""
        table = self.table()
        return speed**2 if table.of == "square" else float(np.max(np.abs(table.knots)))

    def evaluate(self, place: ArrayLike) -> Floats:
        """The form (n,) at speeds or places (n,), as the kernel reads it."""
        table, at = self.table(), np.asarray(place, np.float64)
        if table.of == "square":
            return np.asarray(at**2)
        x = (at - table.start) / table.step
        if table.of == "wave":
            return np.asarray(np.sin(2 * math.pi * x))
        return np.interp(x, np.arange(len(table.knots)), table.knots)

    at = rename_method("at", "evaluate")


@dataclass(frozen=True)
class Stribeck(Shape):
    """exp(-(v / speed)^2): friction at rest beyond Coulomb's, falling with the speed.

    Parameters
    ----------
    speed : float or "estimate"
        > 0 [unit of y per s].

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
            raise UsageError("the Stribeck speed is not known yet: output-error and interval find it; or give it")
        step = FADED / PIECES
        speeds = step * np.arange(PIECES + 1)
        # the mean over every piece is the form's mean: straight lines between its own values lie on one side of it
        bend = (4 * speeds**2 - 2) * step**2 / 12
        knots = np.exp(-(speeds**2)) * (1 - bend)
        return ShapeTable("speed", tuple(knots.tolist()), step=step * self.speed, positive=self.positive)

    @property
    def reads(self) -> str:
        speed = self.speed if isinstance(self.speed, str) else f"{self.speed:.9g}"
        return f"exp(-(x'/{speed})^2)"


@dataclass(frozen=True)
class Square(Shape):
    """v^2: friction that grows more than linearly, as in air or oil.

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
    """sin or cos of 2 pi x / period: gravity on a rotary axis (period: a turn), cogging (its pitch), a harmonic of the
    travel.

    Parameters
    ----------
    period : float
        > 0 [unit of y].
    cosine : bool
        cos in place of sin.

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
    """A form along the travel, known but for its size.

    Parameters
    ----------
    start : float
        Place of the first value [unit of y].
    step : float
        Distance of the values [unit of y].
    values : sequence of float (k,)
        2 to 200. The first and last hold beyond.

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
            raise UsageError(f"a table has 2 to {MOST_KNOTS} finite values, got {len(self.values)} from {self.start}")
        if not any(self.values):
            raise UsageError("a table of zeros is no form: give the force at each place, in any unit")

    def table(self) -> ShapeTable:
        return ShapeTable("place", tuple(self.values), self.start, self.step)

    @property
    def reads(self) -> str:
        return f"(table of {len(self.values)} places)"


def _length(name: str, value: object, unit: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not SMALLEST <= value <= LARGEST:
        raise UsageError(f"{name} must be a number above 0, got {value!r}; give it in {unit}")
    return float(value)
