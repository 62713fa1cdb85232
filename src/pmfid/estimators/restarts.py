"""Motions that restart after the gaps of a record, each with the start that fits it.

The starts are no unknowns of the fit but functions of its parameters, as in variable projection (Golub and Pereyra
1973): position and speed after a gap are the least squares solution for that part of the record at any parameters.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from pmfid.types import Floats

#: Turns of the search for the speed after a gap, and the part of its prior standard deviation at which a step ends the
#: search: the motion is linear within that.
TURNS, SMALL = 30, 1e-3
#: A step that leads to no better motion is tried once more as this part of itself.
SHORTER = 0.25
#: Step of the difference quotient by that speed, as a part of the same.
STEP = 0.1
#: Parameters, start velocity, force on top -> position from 0 and velocity, as `Difference.motion`.
Motion = Callable[[Floats, float, Floats | None], tuple[Floats, Floats]]


@dataclass
class Restart:
    """Part `part` of a record after a gap: position y (n,) of its counts, of variance `white`; the speed of the counts
    and its standard deviation [unit of y per s].

    The next search begins at the last result: the speed, and the effect (n,) of the speed on the position, about its
    mean.
    """

    part: slice
    y: Floats
    white: float
    shown: float
    known: float
    motion: Motion
    speed: float = field(init=False)
    effect: Floats = field(default_factory=lambda: np.zeros(0), init=False)

    def __post_init__(self) -> None:
        self.speed = self.shown

    def best(self, parameters: Floats, force: Floats | None) -> tuple[Floats, Floats]:
        """Position and velocity (n,) from the start of least squares."""
        prior = self.white / self.known**2
        if self.effect.size == 0:
            self.effect = self._effect_at(self.shown, parameters, force)
        fresh, found = True, self._from(self.speed, parameters, force)
        step = self._step(found.apart, prior)
        for _ in range(TURNS):
            if abs(step) < SMALL * self.known:
                return found.position + step * self.effect, found.velocity
            tried = self._from(self.speed + step, parameters, force)
            if self._sum_squares(tried, self.speed + step, prior) < self._sum_squares(found, self.speed, prior):
                self.speed, found, fresh = self.speed + step, tried, True
                step = self._step(found.apart, prior)
            elif fresh:  # after a stop the position moves with the speed otherwise than where the effect was taken
                self.effect, fresh = self._effect_at(self.speed, parameters, force), False
                step = self._step(found.apart, prior)
            else:
                step *= SHORTER
        return found.position, found.velocity

    def _from(self, speed: float, parameters: Floats, force: Floats | None) -> _Moved:
        position, velocity = self.motion(parameters, speed, force)
        level = float(np.mean(self.y - position))
        return _Moved(position + level, velocity, self.y - position - level)

    def _effect_at(self, speed: float, parameters: Floats, force: Floats | None) -> Floats:
        sides = (self.motion(parameters, speed + side * STEP * self.known, force)[0] for side in (1.0, -1.0))
        effect = np.subtract(*sides) / (2 * STEP * self.known)
        return np.asarray(effect - np.mean(effect))

    def _step(self, apart: Floats, prior: float) -> float:
        power = float(self.effect @ self.effect) + prior
        return (float(apart @ self.effect) + prior * (self.shown - self.speed)) / power

    def _sum_squares(self, moved: _Moved, speed: float, prior: float) -> float:
        return float(moved.apart @ moved.apart) + prior * (self.shown - speed) ** 2


@dataclass(frozen=True, eq=False)
class _Moved:
    """Position and velocity (n,) from a start, and what is left of the counts' (n,)."""

    position: Floats
    velocity: Floats
    apart: Floats
