"""Standard inputs for comparison with a design."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import pairwise

import numpy as np
from scipy.optimize import brentq

from pmfid.design.fisher import motion
from pmfid.design.oracle import Oracle
from pmfid.design.polytope import SOLVER_PRECISION, InputSet, input_set, nearest, violation
from pmfid.design.problem import InfeasibleError, Problem
from pmfid.types import Floats

#: Number of pulse periods in the whole motion, and number of intervals that hold one value of the PRBS.
STANDARD_PULSES = 4
STANDARD_CLOCK = 3
#: Highest frequency of multisine and chirp, as a fraction of the interval rate.
STANDARD_HIGHEST = 0.2
#: Numbers of intervals that hold one value, and highest frequencies as parts of the interval rate, for a ranking.
STANDARD_HOLDS = (1, 2, 4, 8, 16, 32)
STANDARD_HIGHESTS = (0.05, 0.1, 0.2, 0.4)
#: Parts of the reachable distance that legs with a free end try to cover.
STANDARD_SHARES = (1.0, 0.8, 0.6, 0.4, 0.2)
#: Largest peak velocity [m/s] in the search for a profile.
STANDARD_FASTEST = 1e6

__all__ = ["RISES", "SIGNALS", "Leg", "input_wish", "legs", "velocity_wish"]

#: Velocity profiles, each with the parts of a leg's time in which the velocity rises. The velocity falls in equal
#: parts. The usual part comes first. None is the curve of least jerk.
RISES: dict[str, tuple[float | None, ...]] = {
    "trapezoid": (1 / 3, 0.4, 0.25, 0.5, 0.15, 0.1),
    "s_curve": (None,),
}
SIGNALS = ("pulses", "prbs", "multisine", "chirp")


@dataclass(frozen=True)
class Leg:
    """A part of the motion in one `direction` (1 or -1), from node `first` to node `last`.

    `free` is true if the end of the leg is free.
    """

    first: int
    last: int
    direction: int
    free: bool


def legs(problem: Problem) -> list[Leg]:
    """Return the legs of the motion. Only the last leg may have a given end."""
    edges = [int(edge) for edge in np.flatnonzero(np.diff(np.r_[9, problem.sense, 9]))]
    moving = [(a, b) for a, b in pairwise(edges) if problem.sense[a]]
    last = moving[-1][1] if moving and problem.end[0] is not None else None
    return [Leg(a, b, problem.sense[a], b != last) for a, b in moving]


def velocity_wish(problem: Problem, leg: Leg, rise: float | None, peak: float) -> Floats:
    """Return the velocities (last - first + 1,) at the leg's nodes [m/s].

    The profile is a trapezoid that rises during the part `rise` of the time. If `rise` is None, the profile is the
    curve of least jerk (Flash and Hogan 1985). `peak` >= 0 [m/s] comes on top of the line between the velocities of
    start and end. Inside the leg the velocity never falls below the least speed.
    """
    tau = np.linspace(0.0, 1.0, leg.last - leg.first + 1)
    shape = 16 * (tau * (1 - tau)) ** 2 if rise is None else np.minimum(1.0, np.minimum(tau, 1 - tau) / rise)
    begin = leg.direction * problem.start[1] if leg.first == 0 else 0.0
    end = leg.direction * (problem.end[1] or 0.0) if leg.last == problem.intervals else 0.0
    speed = begin + (end - begin) * tau + peak * shape
    inside = slice(1, None if leg.last == problem.intervals and problem.end[1] is None else -1)
    speed[inside] = np.maximum(speed[inside], problem.limits.min_speed)
    return np.asarray(leg.direction * speed)


def input_wish(problem: Problem, name: str, low: float, high: float, rng: np.random.Generator) -> Floats:
    """Return an input (n,) between `low` and `high`, which is pulses, prbs, multisine (phases of Schroeder 1970) or
    chirp.
    """
    n = problem.intervals
    tones = int(STANDARD_HIGHEST * n)
    lengths = {"pulses": n / (2 * STANDARD_PULSES), "prbs": STANDARD_CLOCK}
    return np.asarray((high + low) / 2 + (high - low) / 2 * _signal_of(name, n, lengths.get(name, max(1, tones)), rng))


def standard_signals(problem: Problem, rng: np.random.Generator) -> Iterator[tuple[str, Floats]]:
    """Yield name and values (K,) of signals between -1 and 1, for several times and highest frequencies."""
    n = problem.intervals
    for length in STANDARD_HOLDS:
        for name in ("prbs", "pulses"):
            yield f"{name}, {length * problem.dt:.3g} s", _signal_of(name, n, length, rng)
    for tones in (max(1, int(part * n)) for part in STANDARD_HIGHESTS):
        for name in ("multisine", "chirp"):
            yield f"{name} to {tones / problem.horizon:.3g} Hz", _signal_of(name, n, tones, rng)


def _signal_of(name: str, samples: int, length: float, rng: np.random.Generator) -> Floats:
    """Return a signal (samples,) between -1 and 1. `length` is the number of samples that hold a value, or that of the
    periods of the highest tone.

    The crest factor of a multisine with the phases of Schroeder (1970) is about 1.7 for many tones.
    """
    tau = np.arange(samples) / samples
    if name == "pulses":
        return np.where(np.arange(samples) // length % 2 == 0, 1.0, -1.0)
    if name == "prbs":
        return np.repeat(rng.integers(0, 2, size=-(-samples // int(length))) * 2.0 - 1.0, int(length))[:samples]
    if name == "chirp":
        return np.asarray(np.cos(2 * np.pi * tau * (1 + (length - 1) * tau / 2)))
    k = np.arange(1, length + 1)
    total = np.cos(2 * np.pi * np.outer(tau, k) - np.pi * k * (k - 1) / length).sum(axis=1)
    return np.asarray(total / np.abs(total).max())


@dataclass(frozen=True, eq=False)
class StandardInput:
    """A standard input u (n,), held over each interval, and its motion.

    The position x and the velocity v at the nodes, each (n+1,), are the reference for position control. `bent` is true
    if the limits do not allow the profile itself, and u is the nearest allowed input instead.
    """

    name: str
    u: Floats
    x: Floats
    v: Floats
    bent: bool


def standard_inputs(problem: Problem, seed: int = 0, names: tuple[str, ...] = ()) -> dict[str, StandardInput]:
    """Return the standard inputs within the limits of a problem.

    The standard inputs are trapezoid, S-curve, least energy, least time, pulses, PRBS, multisine and chirp. The input
    "minimum_time" reaches the end of each leg as early as the limits allow. After the end of a leg the path continues
    at the least speed. If the limits do not allow a profile, the nearest input in the sum of squares replaces the
    profile.

    Parameters
    ----------
    problem
        Equation, parameters and limits.
    seed
        Seed of the PRBS.
    names
        Names of the wanted inputs. If empty, all inputs are returned.

    Returns
    -------
    dict of str to StandardInput
        The standard inputs by name, each with the input `u` (K,) [V], position `x` [m] and velocity `v` [m/s] at the
        nodes (K+1,), and `bent`, true if
        the profile was replaced.

    Raises
    ------
    InfeasibleError
        If no input meets the limits.

    Examples
    --------
    >>> from pmfid import Drive
    >>> from pmfid.design import Limits, Problem, standard_inputs
    >>> nominal = {"mass": 1.5, "viscous_friction": 6.0, "coulomb_friction": 0.6}
    >>> problem = Problem(
    ...     Drive(2.0), nominal, ("mass",), 2.0, 10, Limits(input=3.0, min_speed=0.01), resolution=1e-5, end=(0.4, 0.0)
    ... )
    >>> trapezoid = standard_inputs(problem, names=("trapezoid",))["trapezoid"]
    >>> trapezoid.u.shape, round(float(trapezoid.x[-1]), 3)
    ((10,), 0.4)
    """
    maker = _Maker(problem, input_set(problem), seed)
    found = {}
    for name in names or STANDARD:
        u, bent = _MAKERS[name](maker)
        found[name] = StandardInput(name, u, *motion(problem, u), bent)
    return found


@dataclass(frozen=True, eq=False)
class _Maker:
    """Data that the standard inputs of one problem share."""

    problem: Problem
    inputs: InputSet
    seed: int

    @cached_property
    def from_velocity(self) -> Floats:
        """Matrix (K, K) from velocities without their offset to the input of least norm."""
        return np.asarray(np.linalg.pinv(self.inputs.states[1, 1:]), float)

    def input_of(self, velocities: Floats) -> Floats:
        return np.asarray(self.from_velocity @ (velocities[1:] - self.inputs.offset[1, 1:]))

    def position_at(self, node: int, velocities: Floats) -> float:
        return float(self.inputs.states[0, node] @ self.input_of(velocities) + self.inputs.offset[0, node])

    @cached_property
    def reach(self) -> tuple[float, float]:
        """Lowest and highest position [m] that an input can reach."""
        oracle, position, offset = Oracle(self.inputs), self.inputs.states[0, 1:], self.inputs.offset[0, 1:]
        far = []
        for sign in (-1, 1):
            u = oracle.maximise(sign * position.sum(axis=0))
            far.append(sign * float(np.max(sign * (position @ u + offset))))
        return far[0], far[1]


def _profile(maker: _Maker, rises: tuple[float | None, ...]) -> tuple[Floats, bool]:
    """Return the first velocity profile that the limits allow, or the input nearest to the first profile."""
    path = legs(maker.problem)
    shares = STANDARD_SHARES if any(leg.free for leg in path) else STANDARD_SHARES[:1]
    wishes = [_velocities(maker, path, rise, share) for share in shares for rise in rises]
    for wish in wishes:
        u = maker.input_of(wish)
        if violation(maker.inputs, u) <= SOLVER_PRECISION:
            return u, False
    return nearest(maker.inputs, maker.input_of(wishes[0])), True


def _velocities(maker: _Maker, path: list[Leg], rise: float | None, share: float) -> Floats:
    """Return the velocities (K+1,) at the nodes, as high in each leg as its target needs."""
    problem = maker.problem
    wish = np.zeros(problem.intervals + 1)
    wish[0] = problem.start[1]
    for leg in path:
        target = _target(maker, leg, share)
        wish[leg.first : leg.last + 1] = velocity_wish(problem, leg, rise, _peak(maker, wish, leg, rise, target))
    return wish


def _target(maker: _Maker, leg: Leg, share: float) -> float:
    """Return the position [m] at which a leg shall end."""
    end, start = maker.problem.end[0], maker.problem.start[0]
    if end is not None and not leg.free:
        return end
    return start + share * (maker.reach[leg.direction > 0] - start)


def _peak(maker: _Maker, wish: Floats, leg: Leg, rise: float | None, target: float) -> float:
    """Return the peak velocity [m/s] with which the leg ends at the target [m], or 0 if no velocity does."""

    def find_excess(peak: float) -> float:
        trial = wish.copy()
        trial[leg.first : leg.last + 1] = velocity_wish(maker.problem, leg, rise, peak)
        return leg.direction * (maker.position_at(leg.last, trial) - target)

    high = 1.0
    while find_excess(high) < 0 and high < STANDARD_FASTEST:
        high *= 4
    return float(brentq(find_excess, 0.0, high, xtol=1e-15)) if find_excess(0.0) < 0 < find_excess(high) else 0.0


def _signal(maker: _Maker, name: str) -> tuple[Floats, bool]:
    """Return the signal over the whole range of the input, bent to the other limits."""
    low, high = maker.problem.limits.pair("input") or _range(maker)
    wish = input_wish(maker.problem, name, low, high, np.random.default_rng(maker.seed))
    if violation(maker.inputs, wish) <= SOLVER_PRECISION:
        return wish, False
    return nearest(maker.inputs, wish), True


def _range(maker: _Maker) -> tuple[float, float]:
    """Return the range of the input. Without a limit, the range is twice the least that the motion needs."""
    size = 2 * float(np.abs(nearest(maker.inputs, np.zeros(maker.problem.intervals))).max()) or 1.0
    return -size, size


def _least_energy(maker: _Maker) -> tuple[Floats, bool]:
    return _check_limits(maker, nearest(maker.inputs, np.zeros(maker.problem.intervals))), False


def _least_time(maker: _Maker) -> tuple[Floats, bool]:
    """Return the motion that is as far ahead as possible at every node, with the largest sum of the distances."""
    ahead = np.array(maker.problem.sense, float) @ maker.inputs.states[0, 1:]
    return _check_limits(maker, Oracle(maker.inputs).maximise(ahead)), False


def _check_limits(maker: _Maker, u: Floats) -> Floats:
    if not violation(maker.inputs, u) < 1e-5:
        raise InfeasibleError("no input meets all limits; relax one of them")
    return u


_MAKERS: dict[str, Callable[[_Maker], tuple[Floats, bool]]] = {
    **{name: partial(_profile, rises=rises) for name, rises in RISES.items()},
    "minimum_energy": _least_energy,
    "minimum_time": _least_time,
    **{name: partial(_signal, name=name) for name in SIGNALS},
}
#: Names of the standard inputs.
STANDARD = tuple(_MAKERS)
