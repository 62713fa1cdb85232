"""Simulated drives under an open-loop input and under position control."""

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

    Parameters
    ----------
    mass
        Moving mass [kg], > 0.
    viscous_friction
        Force per velocity [N s/m], >= 0.
    coulomb_friction
        Constant force against the motion [N], >= 0. In paper eq. 37 this parameter is an acceleration.
    input_gain
        Force per unit of input [N/V].
    offset
        Constant load force [N].

    Raises
    ------
    ValueError
        If a value is outside its range.

    Examples
    --------
    >>> from pmfid.simulation import DriveParameters
    >>> cart = DriveParameters(mass=1.07, viscous_friction=12.8, coulomb_friction=0.8, input_gain=2.0)
    >>> cart.mass, cart.offset
    (1.07, 0.0)
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
    """Drive parameters that change over time.

    A change takes effect at the first sample at or after its time. The velocity does not jump.

    Parameters
    ----------
    changes
        Pairs (time [s], parameters valid from then on). The first time is 0, and times increase.
    ramps
        Duration [s] >= 0 of each change. During a ramp the parameters move along a straight line, with a new value at
        every sample. The first ramp is 0, and () means no ramp. A ramp ends before the next change.

    Raises
    ------
    ValueError
        If times or ramps are out of order.

    Examples
    --------
    >>> from pmfid.simulation import CART, CART_LOADED, Schedule
    >>> schedule = Schedule(((0.0, CART), (2.0, CART_LOADED)), ramps=(0.0, 1.0))
    >>> mass, viscous, coulomb, input_gain, offset = schedule.sample([0.0, 2.5, 4.0], dt=0.01)
    >>> mass.round(3).tolist()
    [1.07, 1.255, 1.44]
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
            raise ValueError(
                f"ramps must be one time per change, the first 0, got {self.ramps}; leave ramps out if no "
                "change is gradual"
            )
        for ramp, (begin, end) in zip(self.ramps, pairwise(times), strict=True):
            if not 0.0 <= ramp <= end - begin:
                raise ValueError(f"ramp must be >= 0 and end before the next change, got {ramp}; give a time in s")

    def sample(self, t: ArrayLike, dt: float) -> Columns:
        """Return mass, viscous and Coulomb friction, input gain and offset at the instants `t`, each (n,)."""
        # The product k*dt may fall a rounding error short of the intended time.
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
    """Return `parameters` as a Schedule. Constant parameters hold from time 0."""
    if isinstance(parameters, Schedule):
        return parameters
    if isinstance(parameters, DriveParameters):
        return Schedule(((0.0, parameters),))
    return Schedule(tuple(parameters))


@dataclass(frozen=True, eq=False)
class Motion:
    """The true motion of a simulated drive, at the instants t = k dt.

    Attributes
    ----------
    t
        (n,) time [s].
    u
        (n,) input [V].
    x
        (n,) position [m].
    v
        (n,) velocity [m/s].
    direction
        (n,) in [-1, 1], for the interval that starts at sample k: (time moving forward - time moving backward) / dt.
    moving
        (n,) in [0, 1], for the interval that starts at sample k: time moving / dt.

    Examples
    --------
    >>> from pmfid.simulation import DriveParameters, simulate_drive
    >>> cart = DriveParameters(mass=2.0, viscous_friction=0.0, coulomb_friction=1.0, input_gain=1.0)
    >>> motion = simulate_drive(cart, [3.0, 0.0, 0.0, 0.0], dt=1.0)
    >>> motion.v.round(6).tolist(), motion.direction.round(6).tolist()
    ([0.0, 1.0, 0.5, 0.0], [1.0, 1.0, 1.0, 0.0])
    """

    t: Floats
    u: Floats
    x: Floats
    v: Floats
    direction: Floats
    moving: Floats


def make_motion(dt: float, u: Floats, x: Floats, v: Floats, direction: Floats, moving: Floats) -> Motion:
    """Return a Motion (n,) from the plant's input and states x and v (n + 1,).

    Raises ValueError if the motion leaves the range of floating point.
    """
    if not (np.isfinite(x).all() and np.isfinite(v).all()):
        raise ValueError("the motion leaves the range of floating point; check the units of parameters and input")
    return Motion(sample_times(u.size, dt), u, x[:-1], v[:-1], direction, moving)


def simulate_drive(parameters: Drive, u: ArrayLike, dt: float, x0: float = 0.0, v0: float = 0.0) -> Motion:
    """Simulate the motion of a drive under a given input.

    The result is exact up to rounding, because stops, reversals and break-aways are solved inside the interval.

    Parameters
    ----------
    parameters
        `DriveParameters`, a `Schedule`, or pairs (time [s], parameters).
    u
        (n,) input [V], held over each interval.
    dt
        Sample period [s], > 0.
    x0, v0
        Position [m] and velocity [m/s] at the start.

    Returns
    -------
    Motion
        True motion at the samples, (n,) each.

    Raises
    ------
    ValueError
        If an argument is out of range, or the motion leaves the range of floating point.

    References
    ----------
    Paper eq. 37.

    Examples
    --------
    The drive accelerates with 1 m/s^2, then brakes with 0.5 m/s^2 to rest.

    >>> from pmfid.simulation import DriveParameters, simulate_drive
    >>> cart = DriveParameters(mass=2.0, viscous_friction=0.0, coulomb_friction=1.0, input_gain=1.0)
    >>> motion = simulate_drive(cart, [3.0, 0.0, 0.0, 0.0], dt=1.0)
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
    """Simulate a drive under PD control, whose controller sees only the encoder.

    Parameters
    ----------
    parameters
        Parameters of the drive; see `simulate_drive`.
    reference
        (n,) position to follow [m].
    dt
        Sample period [s], > 0.
    kp, kd
        Gains of the controller, >= 0 [V/m, V s/m].
    u_max
        Largest input [V], > 0.
    resolution
        Travel per count [m], > 0.
    phase
        Start position on the encoder lattice [m].
    bits
        Width of the returned register in bits. The controller itself counts without overflow.
    faults
        Faults of the encoder.

    Returns
    -------
    tuple of Motion and ndarray
        True motion, and the counts (n,).

    Raises
    ------
    ValueError
        If an argument is out of range.

    Notes
    -----
    y_k = resolution * counts_k,  counts_k = floor((x_k + phase) / resolution)   (paper eq. 3), or with `faults`
    u_k = kp (reference_k - y_k) - kd (y_k - y_{k-1}) / dt, limited to +-u_max, y_{-1} = y_0.

    The drive starts at rest at x = 0. The controller has no integral part, so friction leaves an error of up to
    coulomb_friction / (input_gain kp).

    Examples
    --------
    >>> from pmfid.simulation import CART, CART_CONTROL, CART_DT, CART_RESOLUTION, position_control, s_curve
    >>> reference = s_curve(200, CART_DT, stroke=0.2, move_time=0.8)
    >>> motion, counts = position_control(CART, reference, CART_DT, **CART_CONTROL, resolution=CART_RESOLUTION)
    >>> bool(abs(motion.x[-1] - 0.2) < CART.coulomb_friction / (CART.input_gain * CART_CONTROL["kp"]))
    True
    """
    _check_lattice(dt, resolution, phase)
    for name, gain in (("kp", kp), ("kd", kd)):
        if not (np.isfinite(gain) and gain >= 0.0):
            raise ValueError(
                f"{name} must be finite and >= 0, got {gain}; for a reversed motor, reverse the sign of input_gain"
            )
    check_number("u_max", u_max, above=0.0, remedy="give the largest input in V")
    target = check_signal("reference", reference)
    columns = make_schedule(parameters).sample(sample_times(target.size, dt), dt)
    x, v, direction, moving, u, counts = simulate_position_control(
        target, dt, *columns, 0.0, 0.0, kp, kd, u_max, resolution, phase, *faults.draw(target.size)
    )
    return make_motion(dt, u, x, v, direction, moving), wrap_counts(counts, bits)


def _check_lattice(dt: float, resolution: float, phase: float) -> None:
    check_number("dt", dt, above=0.0, remedy="give the sample period in seconds")
    check_number("resolution", resolution, above=0.0, remedy="give the travel per count in m")
    check_number("phase", phase, remedy="give the start position on the encoder lattice in m")


#: Runge-Kutta steps in each sample, before and after the input switches.
STEPS = 10
#: Constants of a machine for the integration.
_BODY = ("mass", "viscous", "coulomb", "gain", "offset", "stribeck", "stribeck_speed", "quadratic", "asymmetry",
         "stiffness", "gravity", "gravity_angle", "cogging", "cogging_pitch", "cogging_phase", "uneven",
         "uneven_period")  # fmt: skip


@dataclass(frozen=True)
class Machine:
    """A drive with effects beyond the model m x'' + d x' + F_c sign(x') [+ offset] = input_gain u.

    Parameters
    ----------
    drive
        Parameters of the model. A rotary axis has rad, kg m2 and N m in place of m, kg and N.
    stribeck
        Friction at rest beyond Coulomb friction [N], >= 0. This part of the friction falls with exp(-(v /
        stribeck_speed)^2).
    stribeck_speed
        Speed at which the Stribeck friction has fallen to 1/e [m/s], > 0.
    quadratic
        Friction per v |v| [N s^2/m^2], >= 0.
    asymmetry
        Difference of the friction in both directions, in (-1, 1). The friction is multiplied by 1 + asymmetry forward,
        and by 1 - asymmetry backward.
    stiffness
        Stiffness [N/m] >= 0 of a spring without force at x = 0.
    gravity, gravity_angle
        Gravity of a rotary axis: gravity [N m] >= 0, times sin(x + gravity_angle). The angle is in rad.
    cogging, cogging_pitch, cogging_phase
        Cogging force: cogging [N] >= 0, times sin(2 pi x / cogging_pitch + cogging_phase). The pitch is in m, the phase
        in rad.
    uneven, uneven_period
        Friction that varies with the position: uneven [N], times sin(2 pi x / uneven_period). The variation is at most
        the Coulomb friction. The period is in m.
    dead_time
        Dead time of the input [s], >= 0, not necessarily a whole number of samples.
    lag
        Time constant of a first-order lag of the input [s], >= 0. The output of the lag is averaged over each
        integration step.
    force_noise
        Standard deviation of a random force [N], >= 0, independent in each sample.

    Raises
    ------
    ValueError
        If a value is out of range.

    Examples
    --------
    >>> from pmfid.simulation import CART, Machine
    >>> machine = Machine(CART, stribeck=0.4, dead_time=0.004)
    >>> machine.drive.mass, machine.stribeck, machine.cogging
    (1.07, 0.4, 0.0)
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
            raise ValueError(
                f"uneven must be at most Coulomb friction, got {self.uneven}; lower it, because friction never drives "
                "the axis"
            )
        if not -1.0 < self.asymmetry < 1.0:
            raise ValueError(f"asymmetry must be in (-1, 1), got {self.asymmetry}; 0 is none")


@dataclass(frozen=True, eq=False)
class MachineRun:
    """The result of a simulated machine: u [V], counts, true x [m] and true v [m/s] at the samples, each (n,)."""

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
    """Simulate the motion and the counts of a machine under a given input.

    Parameters
    ----------
    machine
        The drive and its further effects. The machine starts at rest at x = 0.
    u
        (n,) input [V], held over each dt.
    dt
        Sample period [s], > 0.
    resolution
        Travel per count [m], > 0.
    phase
        Start position on the encoder lattice [m]. The counts are floor((x + phase) / resolution).
    rng
        Random generator of the force noise.
    steps
        Integration steps in each sample, >= 1.

    Returns
    -------
    MachineRun
        Input `u`, `counts`, and the true `x` [m] and `v` [m/s], (n,) each.

    Raises
    ------
    ValueError
        If an argument is out of range, or a machine with force noise has no `rng`.

    Examples
    --------
    With a dead time of one sample, the position at the second sample is still 0.

    >>> from pmfid.simulation import CART, CART_DT, Machine, drive_machine
    >>> run = drive_machine(Machine(CART, dead_time=CART_DT), [3.0, 3.0, 3.0], CART_DT, resolution=1e-5)
    >>> run.counts.tolist()
    [0, 0, 23]
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
    """Simulate a machine under position control through its encoder.

    Parameters
    ----------
    machine, dt, resolution, phase, rng, steps
        See `drive_machine`.
    reference
        (n,) position to follow [m].
    kp, kd
        Gains kp > 0 [V/m] and kd >= 0 [V s/m] of the controller; see `position_control`.
    u_max
        Largest input [V], > 0.

    Returns
    -------
    MachineRun
        Input, counts, true position and true velocity; see `drive_machine`.

    Raises
    ------
    ValueError
        If a gain or another argument is out of range.

    Examples
    --------
    >>> from pmfid.simulation import CART, CART_CONTROL, CART_DT, Machine, control_machine, s_curve
    >>> reference = s_curve(200, CART_DT, stroke=0.2, move_time=0.8)
    >>> machine = Machine(CART, stribeck=0.3)
    >>> run = control_machine(machine, reference, CART_DT, 1e-5, **CART_CONTROL)
    >>> round(float(run.x[-1]), 2)
    0.2
    """
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
    _check_lattice(dt, resolution, phase)
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
