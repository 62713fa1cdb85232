"""Motion of two masses on a spring by the classical Runge-Kutta method, with located stops, starts and contacts.

m v' = f - p - d v - F sign(v),   m2 v2' = p - d2 v2 - F2 sign(v2),   p = k (x - x2) + c (v - v2)

With a gap, p acts while the masses touch, beyond half of it, and the twist counts from there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class TwoMasses:
    """Motor, its viscous and Coulomb friction, load, its frictions, stiffness and damping of the spring, and a gap."""

    mass: float
    viscous: float
    coulomb: float
    load: float
    load_viscous: float
    load_coulomb: float
    stiffness: float
    damping: float
    gap: float = 0.0

    def side(self, state: Floats) -> int:
        """Return the side of the gap that touches, 0 within the gap, and 1 without a gap."""
        twist = state[0] - state[2]
        return 1 if self.gap == 0 or twist > self.gap / 2 else -1 if twist < -self.gap / 2 else 0

    def pull(self, state: Floats, force: float, side: int | None = None) -> tuple[float, float]:
        """Return the forces on both masses by input and spring."""
        side = self.side(state) if side is None else side
        beyond = state[0] - state[2] - side * self.gap / 2
        spring = (self.stiffness * beyond + self.damping * (state[1] - state[3])) * abs(side)
        return force - spring, spring

    def directions(self, state: Floats, force: float) -> list[int]:
        """Return the direction of each mass, 0 at rest, and the side of the gap that touches."""
        masses = zip(state[1::2], self.pull(state, force), (self.coulomb, self.load_coulomb), strict=True)
        ways = [int(np.sign(pull if v == 0 else v)) if v != 0 or abs(pull) > hold else 0 for v, pull, hold in masses]
        return [*ways, self.side(state)]

    def rates(self, state: Floats, force: float, way: list[int]) -> Floats:
        motor, load = self.pull(state, force, way[2])
        first = (motor - self.viscous * state[1] - way[0] * self.coulomb) / self.mass if way[0] else 0.0
        second = (load - self.load_viscous * state[3] - way[1] * self.load_coulomb) / self.load if way[1] else 0.0
        return np.array([state[1], first, state[3], second])

    def step(self, state: Floats, force: float, way: list[int], h: float) -> Floats:
        a = self.rates(state, force, way)
        b = self.rates(state + h / 2 * a, force, way)
        c = self.rates(state + h / 2 * b, force, way)
        d = self.rates(state + h * c, force, way)
        return np.asarray(state + h / 6 * (a + 2 * b + 2 * c + d))

    def margin(self, state: Floats, force: float, way: list[int], k: int) -> float:
        """Return what is left before mass k stops or starts, or the contact changes (k = 2), negative beyond that."""
        if k == 2:
            twist = state[0] - state[2]
            return float(way[2] * twist - self.gap / 2 if way[2] else self.gap / 2 - abs(twist))
        if way[k]:
            return float(way[k] * state[2 * k + 1])
        return (self.coulomb, self.load_coulomb)[k] - abs(self.pull(state, force, way[2])[k])

    def advance(self, state: Floats, force: float, h: float) -> Floats:
        """Return the state after h seconds, through at most a few stops and starts."""
        way = self.directions(state, force)
        for _ in range(6):
            end = self.step(state, force, way, h)
            turned = [k for k in range(3 if self.gap else 2) if self.margin(end, force, way, k) < 0]
            if not turned or h <= 0:
                return end
            first, k = min((self.find_turn(state, force, way, h, k), k) for k in turned)
            state, h = self.step(state, force, way, first), h - first
            if k < 2 and way[k]:
                state[2 * k + 1] = 0.0
            way = self.directions(state, force)
        return state

    def find_turn(self, state: Floats, force: float, way: list[int], h: float, k: int) -> float:
        """Return the time just after mass k stops or starts, or the contact changes, by bisection."""
        low, high = 0.0, h
        for _ in range(30):
            middle = (low + high) / 2
            beyond = self.margin(self.step(state, force, way, middle), force, way, k) < 0
            low, high = (low, middle) if beyond else (middle, high)
        return high


def simulate_two_masses(pair: TwoMasses, u: Floats, step: float, start: Floats, substeps: int = 50) -> Floats:
    """Return the states (n + 1, 4), which are x, v, x2, v2, under a held input u (n,)."""
    states, state = [start], start
    for force in u.tolist():
        for _ in range(substeps):
            state = pair.advance(state, force, step / substeps)
        states.append(state)
    return np.array(states)
