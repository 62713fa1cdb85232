"""A drive with viscous and Coulomb friction under a given input."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import isfinite

import numpy as np
from numpy.typing import ArrayLike

from pmfid.simulation._plant import simulate_open_loop
from pmfid.simulation.checks import check_number, check_signal, sample_times
from pmfid.simulation.encoder import quantize as quantize  # the way to it before it had a file of its own
from pmfid.types import Floats

Columns = tuple[Floats, Floats, Floats, Floats, Floats]


@dataclass(frozen=True)
class DriveParameters:
    """Parameters of mass x'' + viscous_friction x' + coulomb_friction sign(x') + offset = input_gain u.

    mass > 0 [kg], viscous_friction >= 0 [N s/m], coulomb_friction >= 0 [N], input_gain [N/V], offset [N]: a
    constant load force. Paper eq. 37, but coulomb_friction is a force here, an acceleration there.
    Raises ValueError for a value outside its range.
    """

    mass: float
    viscous_friction: float
    coulomb_friction: float
    input_gain: float
    offset: float = 0.0

    def __post_init__(self) -> None:
        check_number("mass", self.mass, above=0.0, remedy="give the moving mass in kg")
        for name in ("viscous_friction", "coulomb_friction"):
            value = getattr(self, name)
            if not (isfinite(value) and value >= 0.0):
                raise ValueError(f"{name} must be finite and >= 0, got {value}; friction opposes the motion, 0 is none")
        check_number("input_gain", self.input_gain, remedy="give the force per unit of input in N/V")
        check_number("offset", self.offset, remedy="give the constant load force in N, 0 for none")


@dataclass(frozen=True)
class Schedule:
    """Drive parameters that change: `changes` are pairs (time [s], parameters valid from then on).

    The first time is 0, times increase. A change takes effect at the first sample at or after its time; the
    velocity does not jump. ramps: for each change the time [s] >= 0 over which the parameters move to the new ones
    along a straight line, a new value every sample; () is no ramp anywhere, the first is 0. A ramp ends before the
    next change. Raises ValueError for times out of order.
    """

    changes: tuple[tuple[float, DriveParameters], ...]
    ramps: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "changes", tuple((time, parameters) for time, parameters in self.changes))
        times = [time for time, _ in self.changes]
        if not times or times[0] != 0.0:
            raise ValueError(f"schedule must start at time 0, got {times[:1]}; begin with (0.0, parameters)")
        for before, after in pairwise(times):
            check_number("schedule time", after, above=before, remedy="sort the changes by time, each once")
        object.__setattr__(self, "ramps", tuple(self.ramps) or (0.0,) * len(times))
        self._check_ramps([*times, np.inf])

    def _check_ramps(self, times: list[float]) -> None:
        if len(self.ramps) != len(self.changes) or self.ramps[0] != 0.0:
            raise ValueError(f"ramps must be one time per change, the first 0, got {self.ramps}; leave out for none")
        for ramp, (begin, end) in zip(self.ramps, pairwise(times), strict=True):
            if not 0.0 <= ramp <= end - begin:
                raise ValueError(f"ramp must be >= 0 and end before the next change, got {ramp}; give a time in s")

    def sample(self, t: ArrayLike, dt: float) -> Columns:
        """Return mass, viscous and Coulomb friction, input gain and offset at the instants `t`, each (n,)."""
        # k*dt may fall a rounding error short of the time meant.
        times = np.array([time for time, _ in self.changes]) - 1e-6 * dt
        index = np.searchsorted(times, t, side="right") - 1
        table = np.array([_row(p) for _, p in self.changes])
        values = table[index]
        for i in np.flatnonzero(self.ramps):
            on = index == i
            part = np.clip((np.asarray(t)[on] - self.changes[i][0]) / self.ramps[i], 0.0, 1.0)
            values[on] = table[i - 1] + part[:, None] * (table[i] - table[i - 1])
        mass, viscous, coulomb, input_gain, offset = np.ascontiguousarray(values.T)
        return mass, viscous, coulomb, input_gain, offset


def _row(p: DriveParameters) -> tuple[float, ...]:
    return p.mass, p.viscous_friction, p.coulomb_friction, p.input_gain, p.offset


Drive = DriveParameters | Schedule | Sequence[tuple[float, DriveParameters]]


def make_schedule(parameters: Drive) -> Schedule:
    """Return `parameters` as a Schedule; constant parameters hold from time 0 on."""
    if isinstance(parameters, Schedule):
        return parameters
    if isinstance(parameters, DriveParameters):
        return Schedule(((0.0, parameters),))
    return Schedule(tuple(parameters))


@dataclass(frozen=True, eq=False)
class Motion:
    """The true motion at t = k dt, each field (n,): t [s], u [V], x [m], v [m/s], and for the interval that
    starts at k `direction` in [-1, 1], (time moving forward - time moving backward) / dt, and `moving` in
    [0, 1], time moving / dt.
    """

    t: Floats
    u: Floats
    x: Floats
    v: Floats
    direction: Floats
    moving: Floats


def make_motion(dt: float, u: Floats, x: Floats, v: Floats, direction: Floats, moving: Floats) -> Motion:
    """Return the plant's result, x and v (n + 1,), as a Motion (n,); raise ValueError if it overflowed."""
    if not (np.isfinite(x).all() and np.isfinite(v).all()):
        raise ValueError("the motion leaves the range of floating point; check the units of parameters and input")
    return Motion(sample_times(u.size, dt), u, x[:-1], v[:-1], direction, moving)


def simulate_drive(parameters: Drive, u: ArrayLike, dt: float, x0: float = 0.0, v0: float = 0.0) -> Motion:
    """Return the motion under the input `u` (n,) [V], held over each interval of `dt` [s] > 0.

    Exact up to rounding: stops, reversals and break-aways are solved for inside the interval. Starts at
    position x0 [m] with velocity v0 [m/s]. Raises ValueError for wrong arguments. Paper eq. 37.

    >>> cart = DriveParameters(mass=2.0, viscous_friction=0.0, coulomb_friction=1.0, input_gain=1.0)
    >>> motion = simulate_drive(cart, [3.0, 0.0, 0.0, 0.0], dt=1.0)  # 1 m/s^2, then -0.5 m/s^2 to rest
    >>> [float(x) for x in motion.x], [float(m) for m in motion.moving]
    ([0.0, 0.5, 1.25, 1.5], [1.0, 1.0, 1.0, 0.0])
    """
    check_number("dt", dt, above=0.0, remedy="give the sample period in seconds")
    check_number("x0", x0, remedy="give the start position in m")
    check_number("v0", v0, remedy="give the start velocity in m/s")
    signal = check_signal("u", u)
    columns = make_schedule(parameters).sample(sample_times(signal.size, dt), dt)
    return make_motion(dt, signal, *simulate_open_loop(signal, dt, *columns, x0, v0))
