"""Named, seeded runs of the laboratory cart: the same name and seed give the same bytes."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from pmfid.simulation.control import position_control
from pmfid.simulation.drive import (
    Counts,
    DriveParameters,
    Motion,
    Schedule,
    check_number,
    check_whole,
    quantize,
    simulate_drive,
)
from pmfid.simulation.signals import prbs, stop_and_go

CART = DriveParameters(mass=1.07, viscous_friction=12.8, coulomb_friction=0.8, input_gain=2.0)
CART_LOADED = replace(CART, mass=1.44)
CART_DT = 0.01
CART_INCREMENTS = 4096
CART_RESOLUTION = 22.75e-6


@dataclass(frozen=True)
class Recipe:
    """What a scenario does: open loop or position control, constant mass or a step half-way."""

    summary: str
    closed_loop: bool
    mass_step: bool


SCENARIOS: Mapping[str, Recipe] = MappingProxyType(
    {
        "prbs": Recipe("random binary input of 3 V, constant mass", False, False),
        "mass-step": Recipe("random binary input of 3 V, mass 1.07 to 1.44 kg half-way", False, True),
        "stop-and-go": Recipe("position control through the encoder, moves and dwells", True, False),
        "stop-and-go-mass-step": Recipe("stop-and-go, mass 1.07 to 1.44 kg half-way", True, True),
    }
)


@dataclass(frozen=True, eq=False)
class Scenario:
    """A run and its truth: motion and counts (n,), resolution [m per count], dt [s], parameters over time."""

    name: str
    motion: Motion
    counts: Counts
    resolution: float
    dt: float
    schedule: Schedule


def resolution_of(increments: int) -> float:
    """Return the cart's travel per count [m] for an encoder of `increments` per turn."""
    check_whole("increments", increments, 1, np.inf, "give the counts per turn of the encoder")
    return CART_RESOLUTION * CART_INCREMENTS / increments


def make_scenario(name: str, *, seed: int = 0, increments: int = CART_INCREMENTS, duration: float = 30.0) -> Scenario:
    """Return the scenario `name` (a key of SCENARIOS) of `duration` [s], encoder of `increments` per turn.

    The seed draws the start phase on the encoder lattice and the random input; the input does not depend on
    `increments`. Raises ValueError for an unknown name and for values out of range.
    """
    if name not in SCENARIOS:
        raise ValueError(f"unknown scenario {name!r}; choose one of: {', '.join(SCENARIOS)}")
    check_whole("seed", seed, 0, np.inf, "any whole number from 0 on will do")
    check_number("duration", duration, above=CART_DT, remedy="give the length of the run in seconds")
    rng = np.random.default_rng(seed)
    resolution = resolution_of(increments)
    phase = resolution * rng.random()
    schedule = _schedule(SCENARIOS[name], duration)
    run = _stop_and_go if SCENARIOS[name].closed_loop else _prbs
    motion, counts = run(schedule, round(duration / CART_DT), resolution, phase, rng)
    return Scenario(name, motion, counts, resolution, CART_DT, schedule)


def _schedule(recipe: Recipe, duration: float) -> Schedule:
    if recipe.mass_step:
        return Schedule(((0.0, CART), (duration / 2.0, CART_LOADED)))
    return Schedule(((0.0, CART),))


def _prbs(
    schedule: Schedule, samples: int, resolution: float, phase: float, rng: np.random.Generator
) -> tuple[Motion, Counts]:
    u = prbs(samples, clock=10, amplitude=3.0, rng=rng)
    motion = simulate_drive(schedule, u, CART_DT)
    return motion, quantize(motion.x, resolution, phase)


def _stop_and_go(
    schedule: Schedule, samples: int, resolution: float, phase: float, rng: np.random.Generator
) -> tuple[Motion, Counts]:
    # The closed loop draws nothing more from rng: its only random number is the start phase.
    reference = stop_and_go(samples, CART_DT, stroke=0.2, move_time=0.8, dwell_time=0.5)
    return position_control(
        schedule, reference, CART_DT, kp=200.0, kd=5.0, u_max=6.0, resolution=resolution, phase=phase
    )


def write_csv(scenario: Scenario, path: str | Path) -> None:
    """Write the columns t [s], u [V], counts; floats read back to the same bits, lines end in a line feed.

    Raises OSError if the file can't be written.
    """
    motion = scenario.motion
    with open(path, "w", encoding="ascii", newline="\n") as file:
        file.write("t,u,counts\n")
        for t, u, count in zip(motion.t.tolist(), motion.u.tolist(), scenario.counts.tolist(), strict=True):
            file.write(f"{t!r},{u!r},{count}\n")
