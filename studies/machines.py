"""Machines, motions and encoders of the study of wrong models; no estimator is tuned to them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from pmfid.simulation import (
    CART,
    DriveParameters,
    Machine,
    control_machine,
    drive_machine,
    multisine,
    position_control,
    prbs,
    quantize,
    simulate_drive,
    stop_and_go,
)
from pmfid.types import Floats
from studies.paper.truth import CartRecord

MOTIONS = ("prbs", "stop-and-go", "multisine")
#: Relative difference of the stroke between two experiments.
OTHERWISE = 0.02
TONES = (0.3, 0.7, 1.3, 2.1)  # tones of the reference, relative to the frequency of a move and its rest


@dataclass(frozen=True)
class Axis:
    """A machine with its bench.

    `dt` is the sample period [s], and `volt` the input of the open loop [V] with its `clock` [samples]. Position
    control has `kp`, `kd` and `u_max`. Moves of `stroke` [m or rad] last `move`, rests `dwell` [s]. Further fields are
    the travel per count of 4096 increments, and the speed over which Stribeck friction falls.
    """

    drive: DriveParameters
    dt: float
    samples: int
    volt: float
    clock: int
    control: Mapping[str, float]
    stroke: float
    move: float
    dwell: float
    resolution: float
    stribeck_speed: float

    @property
    def speed(self) -> float:
        """The largest speed of a move."""
        return 1.875 * self.stroke / self.move


def _control(kp: float, kd: float, u_max: float) -> Mapping[str, float]:
    return MappingProxyType({"kp": kp, "kd": kd, "u_max": u_max})


TURN = 2 * np.pi / 4096
AXES: Mapping[str, Axis] = MappingProxyType(
    {
        "cart": Axis(CART, 0.01, 3000, 3.0, 10, _control(200, 5, 6), 0.2, 0.8, 0.5, 22.75e-6, 0.02),
        "rotary": Axis(
            DriveParameters(2e-3, 6e-3, 0.03, 0.4),
            0.005, 3000, 1.0, 10, _control(1.2, 0.05, 3), 6.0, 0.6, 0.3, TURN, 0.5,
        ),
        "spindle": Axis(
            DriveParameters(1.6e-4, 2e-4, 0.004, 0.05),
            0.001, 6000, 0.6, 20, _control(0.35, 0.006, 3), 20.0, 0.25, 0.1, TURN, 2.0,
        ),
        "stage": Axis(
            DriveParameters(6.3, 9.0, 2.6, 3.34),
            0.00667, 4000, 4.0, 12, _control(160, 22, 8), 0.3, 1.1, 0.4, 22e-6, 0.02,
        ),
        "gantry": Axis(
            DriveParameters(37.0, 80.0, 15.0, 1.0),
            0.004, 6000, 60.0, 25, _control(9000, 900, 400), 0.3, 0.9, 0.3, 20e-6, 0.03,
        ),
        "heavy": Axis(
            DriveParameters(500.0, 3000.0, 80.0, 35.0),
            0.008, 4000, 40.0, 25, _control(500, 150, 150), 0.8, 2.0, 0.5, 40e-6, 0.03,
        ),
    }
)  # fmt: skip

#: Unmodelled effect -> the machine with it; the first machine has none.
WRONG: Mapping[str, Callable[[Axis], Machine]] = MappingProxyType(
    {
        "nothing": lambda axis: Machine(axis.drive),
        "Stribeck 30 %": lambda axis: Machine(
            axis.drive, stribeck=0.3 * axis.drive.coulomb_friction, stribeck_speed=axis.stribeck_speed
        ),
        "quadratic 15 %": lambda axis: Machine(
            axis.drive, quadratic=0.15 * axis.drive.viscous_friction / axis.speed
        ),
        "directional 15 %": lambda axis: Machine(axis.drive, asymmetry=0.15),
        "dead time 0.3 T": lambda axis: Machine(axis.drive, dead_time=0.3 * axis.dt),
    }
)  # fmt: skip


def truth(axis: Axis) -> np.ndarray:
    """Return mass, viscous and Coulomb friction (3,)."""
    return np.array([axis.drive.mass, axis.drive.viscous_friction, axis.drive.coulomb_friction])


def machine_record(axis: Axis, wrong: str, motion: str, increments: int, seed: int) -> CartRecord:
    """Simulate one run of the axis; the simulation of the right machine is exact."""
    return record_of(axis, WRONG[wrong](axis), motion, increments, seed)


def record_of(axis: Axis, machine: Machine, motion: str, increments: int, seed: int) -> CartRecord:
    """Simulate one run of a machine on the bench of an axis."""
    rng = np.random.default_rng([seed, 7])
    resolution = axis.resolution * 4096 / increments
    phase = resolution * rng.random()
    if motion == "prbs":
        u = prbs(axis.samples, clock=axis.clock, amplitude=axis.volt, rng=rng)
        return CartRecord(u, driven_counts(axis, machine, u, resolution, phase), resolution)
    if motion == "stop-and-go":
        # otherwise a controller would park the axis at the same count edge after each move, whatever its phase
        stroke = axis.stroke * (1 + OTHERWISE * rng.uniform(-1, 1))
        reference = stop_and_go(axis.samples, axis.dt, stroke, axis.move, axis.dwell)
    else:
        tones = np.array(TONES) / (axis.move + axis.dwell)
        reference = multisine(axis.samples, axis.dt, tones, axis.stroke / 2, rng)
    return controlled_record(axis, machine, reference, resolution, phase)


def driven_counts(
    axis: Axis, machine: Machine, u: Floats, resolution: float, phase: float, rng: np.random.Generator | None = None
) -> NDArray[np.int64]:
    """Return the counts (n,) under an input u (n,); the simulation is exact for a machine with only the model's
    terms.
    """
    if machine == Machine(machine.drive):
        return quantize(simulate_drive(machine.drive, u, axis.dt).x, resolution, phase)
    return drive_machine(machine, u, axis.dt, resolution, phase=phase, rng=rng).counts


def controlled_record(
    axis: Axis,
    machine: Machine,
    reference: Floats,
    resolution: float,
    phase: float,
    rng: np.random.Generator | None = None,
) -> CartRecord:
    """Simulate one run under position control along a reference (n,). The simulation is exact as in `driven_counts`."""
    (kp, kd, u_max), dt = (axis.control[name] for name in ("kp", "kd", "u_max")), axis.dt
    if machine == Machine(machine.drive):
        moved, counts = position_control(
            machine.drive, reference, dt, kp=kp, kd=kd, u_max=u_max, resolution=resolution, phase=phase
        )
        return CartRecord(moved.u, counts, resolution)
    run = control_machine(machine, reference, dt, resolution, kp=kp, kd=kd, u_max=u_max, phase=phase, rng=rng)
    return CartRecord(run.u, run.counts, resolution)
