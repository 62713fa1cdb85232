"""Machines with partly unmodelled friction under the monitor: normal work, and growing friction."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import pairwise
from types import MappingProxyType

import numpy as np

from pmfid.encoder import Encoder
from pmfid.estimators.iv import IV, RIV
from pmfid.models.drive import Drive
from pmfid.monitor.calibration import Calibration, calibrate
from pmfid.simulation import Machine, control_machine
from pmfid.types import Counts, Floats
from studies.friction_axes import stribeck
from studies.machines import Axis
from studies.monitoring.axis import random_stop_and_go

#: Machines of the study. The first machine served to choose the constants of the units of work.
MACHINES = ("cart", "slide", "heavy")
HELD_BACK = ("slide", "heavy")
#: Factor of the axis's resolution for 1024 increments.
COARSER = 4
#: Memory of the estimate [s].
MEMORY = 1.0
REFERENCE_HOURS = 1.0
#: Number of steps in which friction grows, each while the axis rests.
STEPS = 30

FRICTIONS: Mapping[str, Callable[[Axis], Machine]] = MappingProxyType(
    {
        "Stribeck 20 %": lambda axis: stribeck(axis, 0.2),
        "cogging 20 %": lambda axis: Machine(
            axis.drive, cogging=0.2 * axis.drive.coulomb_friction, cogging_pitch=axis.stroke / 8.3
        ),
        "force noise 5 %": lambda axis: Machine(axis.drive, force_noise=0.05 * usual_force(axis)),
    }
)


def usual_force(axis: Axis) -> float:
    """Return the root mean square of the input's force in normal work [N]."""
    u, _ = normal_work(axis, Machine(axis.drive), 99, 0.1)
    return axis.drive.input_gain * float(np.sqrt(np.mean(u**2)))


def normal_work(axis: Axis, machine: Machine, seed: int, hours: float) -> tuple[Floats, Counts]:
    """Return input and counts (n,) of moves in both directions, each varied at random, under position control."""
    rng, resolution = np.random.default_rng([seed, 5]), COARSER * axis.resolution
    reference = _reference(axis, hours * 3600, rng)
    run = control_machine(
        machine, reference, axis.dt, resolution, **axis.control, phase=resolution * rng.random(), rng=rng, steps=3
    )
    return run.u, run.counts


def growing(
    axis: Axis, machine: Machine, seed: int, seconds: float, growth: float, begin: float, ramp: float
) -> tuple[Floats, Counts]:
    """Return input and counts (n,) while all friction grows by the fraction `growth` from `begin` on in `ramp` [s]."""
    rng, resolution = np.random.default_rng([seed, 6]), COARSER * axis.resolution
    reference, phase = _reference(axis, seconds, rng), resolution * rng.random()
    cuts = [0, *(_rest(reference, round(time / axis.dt)) for time in begin + ramp * np.arange(STEPS) / STEPS)]
    place, u, counts = 0.0, [], []
    for k, (first, last) in enumerate(pairwise([*cuts, reference.size])):
        worn = _worn(machine, 1 + growth * k / STEPS, place)
        run = control_machine(
            worn,
            reference[first : last + 1],
            axis.dt,
            resolution,
            **axis.control,
            phase=phase + place,
            rng=rng,
            steps=3,
        )
        u.append(run.u[: last - first])
        counts.append(run.counts[: last - first])
        place += float(run.x[-1])
    return np.concatenate(u), np.concatenate(counts)


def _worn(machine: Machine, factor: float, place: float) -> Machine:
    """Return the machine with all friction larger by a factor, in coordinates from its place of rest [m]."""
    drive = machine.drive
    grown = replace(
        drive, viscous_friction=factor * drive.viscous_friction, coulomb_friction=factor * drive.coulomb_friction
    )
    turned = machine.cogging_phase + 2 * math.pi * place / machine.cogging_pitch
    return replace(machine, drive=grown, stribeck=factor * machine.stribeck, cogging_phase=turned)


def _rest(reference: Floats, index: int) -> int:
    """Return the last sample of the first rest of a reference after an index."""
    still = np.diff(reference[index:]) == 0
    return index + int(np.flatnonzero(still[:-1] & ~still[1:])[0]) + 1


def _reference(axis: Axis, seconds: float, rng: np.random.Generator) -> Floats:
    return random_stop_and_go(round(seconds / axis.dt), rng, (axis.stroke, axis.move, axis.dwell), axis.dt)


def learned(axis: Axis, machine: Machine, seed: int, hours: float) -> tuple[RIV, Calibration]:
    """Return estimator and calibration from an hour of normal work; the parameters come from `iv`, as in `pmfid
    monitor`.
    """
    u, counts = normal_work(axis, machine, seed, REFERENCE_HOURS)
    encoder, model = Encoder(COARSER * axis.resolution), Drive(axis.drive.input_gain)
    cutoff, forgetting = 0.5 / axis.dt, 1 - axis.dt / MEMORY
    theta = IV(model, encoder, axis.dt, cutoff).fit(u, counts).theta
    initial = dict(zip(IV(model, encoder, axis.dt, cutoff).names, theta.tolist(), strict=True))
    estimator = RIV(model, encoder, axis.dt, cutoff, forgetting=forgetting, initial=initial)
    return estimator, calibrate(estimator, theta, u, counts, hours=hours)
