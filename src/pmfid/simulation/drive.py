"""Simulated drives, open loop and controlled."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from math import isfinite

import numpy as np
from numpy.typing import ArrayLike

from pmfid.simulation._machine import simulate
from pmfid.simulation._plant import simulate_open_loop, simulate_position_control
from pmfid.simulation.encoder import (
    NO_FAULTS,
    Faults,
    check_number,
    check_signal,
    check_whole,
    sample_times,
    wrap_counts,
)
from pmfid.simulation.encoder import quantize as quantize
from pmfid.types import Counts, Floats

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


def position_control(
    parameters: Drive,
    reference: ArrayLike,
    dt: float,
    *,
    kp: float,
    kd: float,
    u_max: float,
    resolution: float,
    phase: float = 0.0,
    bits: int | None = None,
    faults: Faults = NO_FAULTS,
) -> tuple[Motion, Counts]:
    """Return the motion and the counts (n,) of a drive whose PD controller sees only the encoder.

    y_k = resolution * counts_k,  counts_k = floor((x_k + phase) / resolution)   (paper eq. 3), or with `faults`
    u_k = kp (reference_k - y_k) - kd (y_k - y_{k-1}) / dt, limited to +-u_max, y_{-1} = y_0

    reference (n,) [m]; dt > 0 [s]; kp >= 0 [V/m]; kd >= 0 [V s/m]; u_max > 0 [V]; resolution > 0 [m];
    phase [m]. bits: width of the register that is returned; the controller itself counts on. Starts at rest at
    x = 0. There is no integral part: friction leaves an error of up to
    coulomb_friction / (input_gain kp). Raises ValueError for wrong arguments.
    """
    check_number("dt", dt, above=0.0, remedy="give the sample period in seconds")
    for name, gain in (("kp", kp), ("kd", kd)):
        if not (np.isfinite(gain) and gain >= 0.0):
            raise ValueError(f"{name} must be finite and >= 0, got {gain}; reverse input_gain for a reversed motor")
    check_number("u_max", u_max, above=0.0, remedy="give the largest input in V")
    check_number("resolution", resolution, above=0.0, remedy="give the travel per count in m")
    check_number("phase", phase, remedy="give the start position on the encoder lattice in m")
    target = check_signal("reference", reference)
    columns = make_schedule(parameters).sample(sample_times(target.size, dt), dt)
    x, v, direction, moving, u, counts = simulate_position_control(
        target, dt, *columns, 0.0, 0.0, kp, kd, u_max, resolution, phase, *faults.draw(target.size)
    )
    return make_motion(dt, u, x, v, direction, moving), wrap_counts(counts, bits)


#: Runge-Kutta steps per sample, on each side of the input's switch.
STEPS = 10
#: What the integration knows of a machine as constants.
_BODY = ("mass", "viscous", "coulomb", "gain", "offset", "stribeck", "stribeck_speed", "quadratic", "asymmetry",
         "stiffness", "gravity", "gravity_angle", "cogging", "cogging_pitch", "cogging_phase", "uneven",
         "uneven_period")  # fmt: skip


@dataclass(frozen=True)
class Machine:
    """A drive with effects beyond the model m x'' + d x' + F_c sign(x') [+ offset] = input_gain u; SI units.

    drive: parameters of the model. stribeck: friction [N] at rest beyond Coulomb's, which falls with
    exp(-(v / stribeck_speed)^2), stribeck_speed [m/s] > 0; quadratic: [N s^2/m^2], v |v|; asymmetry: friction is
    1 + asymmetry times as large forward and 1 - asymmetry backward, within (-1, 1); stiffness: of a spring at rest at
    x = 0 [N/m]; gravity: [N], times sin(x + gravity_angle), of a rotary axis; cogging: [N], times sin(2 pi x /
    cogging_pitch + cogging_phase); uneven: friction beyond Coulomb's [N], times sin(2 pi x / uneven_period), and no
    larger than that; dead_time: of the input [s] >= 0, any part of a sample; lag: time constant of a first-order lag of
    the input [s] >= 0, whose output is averaged over each step of the integration; force_noise: standard deviation
    [N] >= 0 of a random force, independent in each sample. A rotary axis: rad, kg m2, N m.

    Raises ValueError for a value out of range.
    """

    drive: DriveParameters
    stribeck: float = 0.0
    stribeck_speed: float = 0.02
    quadratic: float = 0.0
    asymmetry: float = 0.0
    stiffness: float = 0.0
    gravity: float = 0.0
    gravity_angle: float = 0.0
    cogging: float = 0.0
    cogging_pitch: float = 0.01
    cogging_phase: float = 0.0
    uneven: float = 0.0
    uneven_period: float = 0.1
    dead_time: float = 0.0
    lag: float = 0.0
    force_noise: float = 0.0

    def __post_init__(self) -> None:
        check_number("stribeck_speed", self.stribeck_speed, above=0.0, remedy="give the speed in m/s")
        for name in ("cogging_pitch", "uneven_period"):
            check_number(name, getattr(self, name), above=0.0, remedy="give the length in m")
        for name in ("gravity_angle", "cogging_phase"):
            check_number(name, getattr(self, name), remedy="give the angle in rad")
        for name in ("stribeck", "quadratic", "stiffness", "gravity", "cogging", "uneven", "dead_time", "lag",
                     "force_noise"):  # fmt: skip
            value = getattr(self, name)
            if not 0.0 <= value < np.inf:
                raise ValueError(f"{name} must be finite and >= 0, got {value}; 0 is none")
        if self.uneven > self.drive.coulomb_friction:
            raise ValueError(f"uneven must be at most Coulomb friction, got {self.uneven}; friction never drives")
        if not -1.0 < self.asymmetry < 1.0:
            raise ValueError(f"asymmetry must be in (-1, 1), got {self.asymmetry}; 0 is none")


@dataclass(frozen=True, eq=False)
class MachineRun:
    """What a machine did: u [V], counts, and the true x [m], v [m/s] at the samples, each (n,)."""

    u: Floats
    counts: Counts
    x: Floats
    v: Floats


def drive_machine(
    machine: Machine,
    u: ArrayLike,
    dt: float,
    resolution: float,
    *,
    phase: float = 0.0,
    rng: np.random.Generator | None = None,
    steps: int = STEPS,
) -> MachineRun:
    """The motion under the input u (n,) [V], held over each dt [s], and the counts floor((x + phase) / resolution).

    rng: draws the force noise; steps: of the integration in each sample. Starts at rest at x = 0. Raises ValueError for
    wrong arguments.
    """
    return _run(machine, check_signal("u", u), dt, resolution, phase, rng, steps, kp=0.0, kd=0.0, u_max=0.0)


def control_machine(
    machine: Machine,
    reference: ArrayLike,
    dt: float,
    resolution: float,
    *,
    kp: float,
    kd: float,
    u_max: float,
    phase: float = 0.0,
    rng: np.random.Generator | None = None,
    steps: int = STEPS,
) -> MachineRun:
    """The same under position control through the encoder along a reference (n,) [m]; see `position_control`."""
    check_number("kp", kp, above=0.0, remedy="give the gain in V/m")
    check_number("kd", kd, above=-1e-300, remedy="give the gain in V s/m, 0 for none")
    check_number("u_max", u_max, above=0.0, remedy="give the largest input in V")
    target = check_signal("reference", reference)
    return _run(machine, target, dt, resolution, phase, rng, steps, kp=kp, kd=kd, u_max=u_max)


def _run(
    machine: Machine,
    command: Floats,
    dt: float,
    resolution: float,
    phase: float,
    rng: np.random.Generator | None,
    steps: int,
    **control: float,
) -> MachineRun:
    check_number("dt", dt, above=0.0, remedy="give the sample period in seconds")
    check_number("resolution", resolution, above=0.0, remedy="give the travel per count in m")
    check_number("phase", phase, remedy="give the start position on the encoder lattice in m")
    check_whole("steps", steps, 1, np.inf, "give the steps of the integration per sample")
    if machine.force_noise and rng is None:
        raise ValueError("a machine with force noise needs rng=np.random.default_rng(seed)")
    noise = np.zeros(command.size) if rng is None else machine.force_noise * rng.standard_normal(command.size)
    x, v, u, counts = simulate(
        command, dt, _body(machine), machine.dead_time, machine.lag, noise, steps, **control, resolution=resolution,
        phase=phase, x0=0.0, v0=0.0,
    )  # fmt: skip
    if not (np.isfinite(x).all() and np.isfinite(v).all()):
        raise ValueError("the motion leaves the range of floating point; check the units of parameters and input")
    return MachineRun(u, counts, x, v)


def _body(machine: Machine) -> dict[str, float]:
    drive = machine.drive
    values = asdict(machine) | {"mass": drive.mass, "viscous": drive.viscous_friction, "gain": drive.input_gain}
    values |= {"coulomb": drive.coulomb_friction, "offset": drive.offset}
    return {name: values[name] for name in _BODY}
