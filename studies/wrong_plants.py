"""Plants that the drive's model does not describe: the cart with unmodelled effects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from pmfid.simulation import (
    CART,
    CART_DT,
    Machine,
    control_machine,
    drive_machine,
    prbs,
    resolution_of,
    stop_and_go,
)
from studies.paper.truth import CartRecord

KP, KD, U_MAX = 200.0, 5.0, 6.0  # control of the scenario "stop-and-go"
#: Unmodelled effect -> the plant; the first plant has none, so that the simulation itself can be judged.
PLANTS: Mapping[str, Machine] = MappingProxyType(
    {
        "nothing": Machine(CART),
        "Stribeck friction": Machine(CART, stribeck=0.4),
        "quadratic friction": Machine(CART, quadratic=6.4),
        "load spring": Machine(CART, stiffness=5.0),
        "input gain": Machine(replace(CART, input_gain=1.1 * CART.input_gain)),
        "input delay": Machine(CART, dead_time=0.5 * CART_DT),
        "small input delay": Machine(CART, dead_time=0.1 * CART_DT),
    }
)
DESCRIPTIONS: Mapping[str, str] = MappingProxyType(
    {
        "nothing": "the right model in the same simulation",
        "Stribeck friction": "0.4 N more at rest (Coulomb: 0.8 N), gone by exp(-(v / 0.02 m/s)²)",
        "quadratic friction": "6.4 N s²/m² v |v| besides 12.8 N s/m: a fifth more at 0.4 m/s",
        "load spring": "5 N/m about the start",
        "input gain": "2.2 N/V where the model has 2: every parameter is 1/1.1 of the truth, -9.1 %",
        "input delay": "5 ms, half a sample",
        "small input delay": "1 ms, a tenth of a sample",
    }
)


def wrong_record(plant: Machine, scenario: str, seed: int, increments: int, samples: int = 3000) -> CartRecord:
    """Return the scenario "prbs" or "stop-and-go" with another plant and the same random numbers."""
    rng = np.random.default_rng(seed)
    resolution = resolution_of(increments)
    phase = resolution * rng.random()
    if scenario == "prbs":
        u = prbs(samples, clock=10, amplitude=3.0, rng=rng)
        run = drive_machine(plant, u, CART_DT, resolution, phase=phase)
    else:
        reference = stop_and_go(samples, CART_DT, stroke=0.2, move_time=0.8, dwell_time=0.5)
        run = control_machine(plant, reference, CART_DT, resolution, kp=KP, kd=KD, u_max=U_MAX, phase=phase)
    return CartRecord(run.u, run.counts, resolution)
