"""Motion of many axes by the classical Runge-Kutta method, with stops located inside a step.

The program integrates M axes at once and shares no code with the bodies of the package. Any consistent units will do.

    m v' = f - d v - (F + S exp(-(v / v_s)^2) + q v^2) sign(v) - load - k x - w sin(2 pi x / period + phase) - p
    lag f' = shape(u(t - delay)) - f,      p = stiffness z(x - y) + damping (v - y') in contact,      m2 y'' = p - d2 y'
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Value = Floats | float


@dataclass(frozen=True)
class Axes:
    """M axes. Each field is an array (M,), or a number for all axes."""

    mass: Value
    viscous: Value
    coulomb: Value
    stribeck: Value = 0.0  # S, the friction at rest beyond Coulomb friction
    stribeck_speed: Value = 1.0
    quadratic: Value = 0.0
    coulomb_asymmetry: Value = 0.0  # friction forward is larger by this factor - 1, and backward smaller
    viscous_asymmetry: Value = 0.0
    load: Value = 0.0
    spring: Value = 0.0
    wave: Value = 0.0
    period: Value = 1.0
    phase: Value = 0.0
    delay: Value = 0.0  # of the input [samples], 0 to 1, a whole number of substeps
    lag: Value = 0.0  # of the force, in the unit of time; 0 for all axes or for none
    dead_zone: Value = 0.0
    bending: Value = 0.0  # the gain falls by bending |u|
    limit: Value = np.inf
    second_mass: Value = 0.0
    second_viscous: Value = 0.0
    stiffness: Value = 0.0
    damping: Value = 0.0
    gap: Value = 0.0  # free travel between the masses, for all axes or for none
    eccentricity: Value = 0.0  # the encoder shows x + eccentricity sin(2 pi x / turn + runout)
    turn: Value = 1.0
    runout: Value = 0.0

    @property
    def active(self) -> frozenset[str]:
        """The names of the fields that are not zero."""
        return frozenset(field.name for field in fields(self) if np.any(getattr(self, field.name)))

    def take(self, index: NDArray[np.intp]) -> Axes:
        """Return some of the axes."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return replace(self, **{name: value[index] for name, value in values.items() if np.ndim(value)})


@dataclass(frozen=True)
class Excitation:
    """Input of M axes over n samples: u = clip(feed + kp (reference - counts) - kd (speed in counts), -top, top).

    All arrays are (n, M); kp, kd, window and top are (M,). The speed is the difference of counts over `window` samples.
    `step` is the time from each sample to the next one. `push` is a force that the input does not contain, and
    `friction` multiplies Coulomb friction.
    """

    feed: Floats
    step: Floats
    reference: Floats
    kp: Floats
    kd: Floats
    window: NDArray[np.intp]
    top: Floats
    push: Floats
    friction: Floats


@dataclass(frozen=True)
class Motion:
    """Input, counts, acting force, position and velocity at each sample, all (n, M)."""

    u: Floats
    counts: Floats
    force: Floats
    x: Floats
    v: Floats


def shape_input(axes: Axes, u: Floats) -> Floats:
    """Return the force of an amplifier with a dead zone, a falling gain and a limit."""
    size = np.maximum(np.abs(u) - axes.dead_zone, 0.0) * (1.0 - axes.bending * np.abs(u))
    return np.asarray(np.sign(u) * np.minimum(size, axes.limit))


def measure(axes: Axes, x: Floats) -> Floats:
    """Return the position that the encoder shows before it rounds."""
    return x + axes.eccentricity * np.sin(2 * np.pi * x / axes.turn + axes.runout)


@dataclass(frozen=True)
class _Piece:
    """The constants of a substep: input force, further force, and factor of Coulomb friction, all (M,).

    `active` names the fields of `axes` that are not zero.
    """

    axes: Axes
    active: frozenset[str]
    target: Floats
    push: Floats
    friction: Floats

    def take(self, index: NDArray[np.intp]) -> _Piece:
        return _Piece(self.axes.take(index), self.active, self.target[index], self.push[index], self.friction[index])

    def drive(self, state: Floats) -> Floats:
        """Return the sum of all forces on the first mass except friction. The state is (x, v, f [, y, y'])."""
        axes, x = self.axes, state[0]
        total = state[2] + self.push - axes.load
        if "spring" in self.active:
            total = total - axes.spring * x
        if "wave" in self.active:
            total = total - axes.wave * np.sin(2 * np.pi * x / axes.period + axes.phase)
        return np.asarray(total - self.couple(state) if len(state) > 3 else total)

    def couple(self, state: Floats) -> Floats:
        """Return the force of the first mass on the second mass."""
        axes, twist = self.axes, state[0] - state[3]
        beyond = twist - np.clip(twist, -0.5 * axes.gap, 0.5 * axes.gap)
        if "gap" not in self.active:
            return np.asarray(axes.stiffness * beyond + axes.damping * (state[1] - state[4]))
        contact = np.minimum(np.abs(beyond) / (0.1 * axes.gap), 1.0)  # damping that begins softly needs no small step
        return np.asarray(axes.stiffness * beyond + axes.damping * (state[1] - state[4]) * contact)

    def level(self, speed: Value, side: Floats) -> Floats:
        """Return the size of dry and quadratic friction at a speed >= 0 in the direction `side`."""
        axes = self.axes
        size = axes.coulomb * self.friction
        if "stribeck" in self.active:
            size = size + axes.stribeck * np.exp(-((speed / axes.stribeck_speed) ** 2))
        if "quadratic" in self.active:
            size = size + axes.quadratic * speed * speed
        return size * (1.0 + axes.coulomb_asymmetry * side) if "coulomb_asymmetry" in self.active else size

    def find_direction(self, state: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Return the direction of motion, also of the motion that begins, and whether the axis moves."""
        drive = self.drive(state)
        side = np.where(state[1] != 0, np.sign(state[1]), np.sign(drive))
        return side, (state[1] != 0) | (np.abs(drive) > self.level(0.0, side))

    def rates(self, state: Floats, side: Floats, moves: NDArray[np.bool_]) -> Floats:
        axes, v = self.axes, state[1]
        viscous = axes.viscous
        if "viscous_asymmetry" in self.active:
            viscous = viscous * (1.0 + axes.viscous_asymmetry * side)
        rates = np.zeros_like(state)
        rates[0] = v
        rates[1] = moves * (self.drive(state) - viscous * v - side * self.level(v * side, side)) / axes.mass
        if "lag" in self.active:
            rates[2] = (self.target - state[2]) / axes.lag
        if len(state) > 3:
            rates[3] = state[4]
            rates[4] = (self.couple(state) - axes.second_viscous * state[4]) / axes.second_mass
        return rates

    def step(self, state: Floats, h: Floats, side: Floats, moves: NDArray[np.bool_]) -> Floats:
        """Return the state after the time h by the classical Runge-Kutta method, with one direction of friction."""
        first = self.rates(state, side, moves)
        second = self.rates(state + 0.5 * h * first, side, moves)
        third = self.rates(state + 0.5 * h * second, side, moves)
        fourth = self.rates(state + h * third, side, moves)
        return np.asarray(state + h / 6 * (first + 2 * (second + third) + fourth))

    def advance(self, state: Floats, h: Floats) -> Floats:
        """Return the state after the time h (M,), through at most one stop or break-away."""
        side, moves = self.find_direction(state)
        end = self.step(state, h, side, moves)
        over = np.flatnonzero(moves & (end[1] * side < 0))
        if over.size:
            end[:, over] = self.take(over).pass_stop(state[:, over], end[1, over], h[over], side[over])
        if not moves.all() and not self.active.isdisjoint(("lag", "second_mass")):  # else the force at rest is constant
            loose = np.flatnonzero(~moves & self.find_direction(end)[1])
            if loose.size:
                end[:, loose] = self.take(loose).break_away(state[:, loose], end[:, loose], h[loose])
        return end

    def break_away(self, state: Floats, last: Floats, h: Floats) -> Floats:
        """Return the state after the time h, in which the axis leaves its rest; it would be `last` at rest."""
        before, after = self.drive(state), self.drive(last)
        side = np.sign(after)
        level = self.level(0.0, side)
        start = h * np.clip((level - before * side) / (after * side - before * side), 0.0, 1.0)
        there = self.step(state, start, side, np.zeros(h.shape, bool))
        return self.step(there, h - start, side, np.ones(h.shape, bool))

    def pass_stop(self, state: Floats, last: Floats, h: Floats, side: Floats) -> Floats:
        """Return the state after the time h, in which the velocity reaches zero; it would be `last` without a stop."""
        moves = np.ones(h.shape, bool)
        stop = h * state[1] / (state[1] - last)
        for _ in range(3):  # Newton's method
            there = self.step(state, stop, side, moves)
            stop = np.clip(stop - there[1] / self.rates(there, side, moves)[1], 0.0, h)
        there = self.step(state, stop, side, moves)
        there[1] = 0.0
        side, moves = self.find_direction(there)
        end = self.step(there, h - stop, side, moves)
        end[1] = np.where(end[1] * side < 0, 0.0, end[1])
        return end


def simulate_axes(axes: Axes, excitation: Excitation, zero: Floats, substeps: int = 10) -> Motion:
    """Simulate M axes from rest; the count is floor(position + zero), so the unit of length is one count."""
    e, (n, size) = excitation, excitation.feed.shape
    u, counts, force, x, v = (np.zeros((n, size)) for _ in range(5))
    active = axes.active
    state = np.zeros((5 if "second_mass" in active else 3, size))
    columns, before = np.arange(size), np.zeros(size)
    for k in range(n):
        x[k], v[k] = state[0], state[1]
        counts[k] = np.floor(measure(axes, state[0]) + zero)
        speed = (counts[k] - counts[np.maximum(k - e.window, 0), columns]) / e.window
        u[k] = np.clip(e.feed[k] + e.kp * (e.reference[k] - counts[k]) - e.kd * speed, -e.top, e.top)
        force[k], h = shape_input(axes, u[k]), e.step[k] / substeps
        for part in range(substeps):
            target = np.where(part + 0.5 < np.asarray(axes.delay) * substeps, before, force[k])
            if "lag" not in active:
                state[2] = target
            state = _Piece(axes, active, target, e.push[k], e.friction[k]).advance(state, h)
        before = force[k]
    return Motion(u, counts, force, x, v)
