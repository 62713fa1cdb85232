"""Random machines of the study of terms: none, one or two terms beyond viscous and Coulomb friction."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from types import MappingProxyType

import numpy as np

from pmfid.simulation import (
    DriveParameters,
    Machine,
    control_machine,
    drive_machine,
    multisine,
    prbs,
    stop_and_go,
)
from studies.paper.truth import CartRecord

MOTIONS = ("prbs", "stop-and-go", "multisine")
SAMPLES = (3000, 4500)
#: Tones of the reference over the bandwidth of the controller.
TONES = np.array([0.05, 0.12, 0.21, 0.33])


@dataclass(frozen=True)
class Kind:
    """Machines of one kind: approximate mass [kg or kg m2] and sample period [s].

    Further fields are the ranges of Coulomb and viscous friction, as fractions of the motor's force, and of the counts
    per sample at the usual speed.
    """

    mass: float
    dt: float
    coulomb: tuple[float, float]
    viscous: tuple[float, float]
    counts: tuple[float, float]


KINDS: Mapping[str, Kind] = MappingProxyType(
    {
        "cart": Kind(1.5, 0.01, (0.1, 0.4), (0.1, 0.3), (2, 20)),
        "table": Kind(0.5, 0.005, (0.05, 0.2), (0.05, 0.2), (1, 10)),
        "rotor": Kind(2e-3, 0.002, (0.05, 0.3), (0.1, 0.4), (0.5, 5)),
        "slide": Kind(6.0, 0.005, (0.2, 0.4), (0.05, 0.3), (2, 20)),
        "gantry": Kind(40.0, 0.004, (0.1, 0.3), (0.1, 0.3), (2, 20)),
        "spindle": Kind(2e-4, 0.001, (0.05, 0.2), (0.1, 0.4), (0.5, 5)),
        "motor": Kind(1e-5, 0.0005, (0.05, 0.3), (0.05, 0.3), (0.3, 3)),
        "press": Kind(500.0, 0.01, (0.1, 0.3), (0.1, 0.4), (5, 40)),
        "lift": Kind(150.0, 0.008, (0.1, 0.3), (0.05, 0.2), (3, 30)),
        "arm": Kind(3.0, 0.002, (0.1, 0.4), (0.05, 0.2), (1, 10)),
    }
)
#: Kinds on which no rule of the search was chosen.
HELD_BACK = ("table", "slide", "spindle", "press", "arm")
#: Keys of [model] -> fields of the machine, drawn around the usual motion.
Draw = Callable[["Bench", np.random.Generator], dict[str, float]]
TERMS: Mapping[str, Draw] = MappingProxyType(
    {
        "dead_time": lambda b, rng: {"dead_time": b.dt * rng.uniform(0.4, 3.0)},
        "lag": lambda b, rng: {"lag": b.dt * rng.uniform(0.6, 4.0)},
        "stribeck": lambda b, rng: {
            "stribeck": b.drive.coulomb_friction * rng.uniform(0.25, 0.6),
            "stribeck_speed": b.speed * rng.uniform(0.08, 0.3),
        },
        "quadratic": lambda b, rng: {"quadratic": b.drive.viscous_friction / b.speed * rng.uniform(0.2, 0.6)},
        "offset": lambda b, rng: {"offset": b.drive.coulomb_friction * rng.uniform(0.15, 0.4)},
        "friction": lambda b, rng: {"asymmetry": rng.uniform(0.1, 0.25)},
        "spring": lambda b, rng: {"stiffness": b.force / b.stroke * rng.uniform(0.05, 0.2)},
        "cogging": lambda b, rng: {
            "cogging": b.drive.coulomb_friction * rng.uniform(0.3, 0.6),
            "cogging_pitch": b.stroke / rng.uniform(6, 15),
            "cogging_phase": rng.uniform(0, 6),
        },
    }
)
#: Pairs that are left out. No record separates the first pair, and a spring brings an offset. In the other pairs, the
#: machine scales all friction by the direction, the model only viscous and Coulomb friction.
SAME = ({"offset", "friction"}, {"offset", "spring"}, {"friction", "quadratic"}, {"friction", "stribeck"})
#: Steps of the integration in each sample: fewer steps move the frictions by several error bars.
STEPS = 50
PAIRS = tuple(pair for pair in combinations(TERMS, 2) if set(pair) not in SAME)
NONE, ONE, TWO = 12, 24, 24


@dataclass(frozen=True)
class Bench:
    """A drive and its motion: sample period dt [s], samples, motor's force, usual speed, stroke, clock [samples],
    resolution.
    """

    drive: DriveParameters
    dt: float
    samples: int
    force: float
    speed: float
    stroke: float
    clock: int
    resolution: float


def truths() -> list[tuple[str, ...]]:
    """Return the terms of each machine of the study."""
    names, order = list(TERMS), np.random.default_rng(29).permutation(len(PAIRS))
    ones = [(names[k % len(names)],) for k in range(ONE)]
    return [*[()] * NONE, *ones, *(PAIRS[k] for k in order[:TWO])]


def kind_of(number: int) -> str:
    """Return the kind of a machine: all kinds by turns, in the next round with other terms."""
    return list(KINDS)[(number + number // len(KINDS)) % len(KINDS)]


def bench_of(kind: Kind, motion: str, rng: np.random.Generator) -> Bench:
    mass, gain = kind.mass * rng.uniform(0.5, 2), float(10 ** rng.uniform(-1, 1))
    force, clock = mass * rng.uniform(5, 20), int(rng.integers(12, 30))
    ramp = clock * kind.dt if motion == "prbs" else 4 * clock * kind.dt
    speed = 0.6 * force / mass * ramp
    stroke = 2 * speed * ramp
    coulomb, viscous = (force * rng.uniform(*part) for part in (kind.coulomb, kind.viscous))
    drive = DriveParameters(mass, viscous / speed, coulomb, gain)
    resolution = speed * kind.dt / float(np.exp(rng.uniform(*np.log(kind.counts))))
    return Bench(drive, kind.dt, int(rng.integers(*SAMPLES)), force, speed, stroke, clock, resolution)


def machine_of(number: int, seed: int) -> tuple[Bench, Machine, CartRecord, str]:
    """One machine of the study, its record and the kind of its motion."""
    rng = np.random.default_rng([29, seed, number])
    # the search for a pitch does not cover a random walk over thousands of pitches
    motions = MOTIONS[1:] if "cogging" in truths()[number] else MOTIONS
    motion = motions[int(rng.integers(len(motions)))]
    bench = bench_of(KINDS[kind_of(number)], motion, rng)
    values: dict[str, float] = {}
    for name in truths()[number]:
        values |= TERMS[name](bench, rng)
    machine = Machine(replace(bench.drive, offset=values.pop("offset", 0.0)), **values)
    return bench, machine, record_of(bench, machine, motion, rng), motion


def record_of(bench: Bench, machine: Machine, motion: str, rng: np.random.Generator) -> CartRecord:
    n, dt, gain, phase = bench.samples, bench.dt, bench.drive.input_gain, bench.resolution * rng.random()
    if motion == "prbs":
        u = prbs(n, clock=bench.clock, amplitude=bench.force / abs(gain), rng=rng)
        run = drive_machine(machine, u, dt, bench.resolution, phase=phase, steps=STEPS)
        return CartRecord(u, run.counts, bench.resolution)
    move = 1.875 * bench.stroke / bench.speed / 2
    if motion == "stop-and-go":
        reference = stop_and_go(n, dt, bench.stroke, move, 0.5 * move)
    else:
        reference = multisine(n, dt, TONES / (0.35 * move), bench.stroke / 2, rng)
    fast = 0.08 / dt
    stiff = bench.drive.mass / gain
    run = control_machine(
        machine,
        reference,
        dt,
        bench.resolution,
        kp=stiff * fast**2,
        kd=1.4 * stiff * fast,
        u_max=2 * bench.force / gain,
        phase=phase,
        steps=STEPS,
    )
    return CartRecord(run.u, run.counts, bench.resolution)
