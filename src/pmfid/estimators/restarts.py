"""Motions that begin anew behind the gaps of a record, each with the start that fits it.

The starts are no unknowns of the fit but functions of its parameters, as in variable projection (Golub and Pereyra
1973): position and speed behind a gap are those of least squares over that part of the record, whatever else is tried.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from pmfid.types import Floats

#: Speeds behind a gap are looked for in so many turns, until a step is this part of what is known beforehand: within
#: that the motion is linear.
TURNS, SMALL = 30, 1e-3
#: Step of the difference quotient by that speed, as a part of the same.
STEP = 0.1
#: Parameters, start velocity, force on top -> position from 0 and velocity, as `Difference.motion`.
Motion = Callable[[Floats, float, Floats | None], tuple[Floats, Floats]]


@dataclass
class Restart:
    """Part `part` of a record behind a gap: position y (n,) of its counts, of variance `white`; the speed that they
    show, and the standard deviation to which they do [unit of y per s].

    What is found once is where the next search begins: the speed, and how far the position moves with it (n,), about
    its mean.
    """

    part: slice
    y: Floats
    white: float
    shown: float
    known: float
    motion: Motion
    speed: float = field(init=False)
    effect: Floats | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        self.speed = self.shown

    def best(self, parameters: Floats, force: Floats | None) -> tuple[Floats, Floats]:
        """Position and velocity (n,) from the start of least squares."""
        if self.effect is None:
            sides = (self.motion(parameters, self.shown + side * STEP * self.known, force)[0] for side in (1.0, -1.0))
            effect = np.subtract(*sides) / (2 * STEP * self.known)
            self.effect = np.asarray(effect - np.mean(effect))
        prior = self.white / self.known**2
        power = float(self.effect @ self.effect) + prior
        for _ in range(TURNS):
            position, velocity = self.motion(parameters, self.speed, force)
            apart = self.y - position
            step = (float(apart @ self.effect) + prior * (self.shown - self.speed)) / power
            self.speed += step
            if abs(step) < SMALL * self.known:
                break
        return position + step * self.effect + np.mean(apart), velocity
