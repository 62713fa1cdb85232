"""Machines that the drive's equation does not describe: richer friction, dead time, force noise."""

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import ArrayLike

from pmfid.simulation._machine import simulate
from pmfid.simulation.checks import check_number, check_signal, check_whole
from pmfid.simulation.drive import DriveParameters
from pmfid.types import Counts, Floats

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
