"""Records of each model that a drive may have, from random machines, to measure the cost of one `identify`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from pmfid import Drive, Encoder
from pmfid.pipeline.result import Result
from pmfid.simulation import Machine
from pmfid.types import Counts, Floats
from studies.term_machines import KINDS, TERMS, bench_of, record_of

SAMPLES = 10_000
#: Samples of a long record.
MANY = 1_000_000
#: Options of `Drive`, and the terms of the machine that need them.
MODELS: Mapping[str, tuple[Mapping[str, object], tuple[str, ...]]] = {
    "plain": ({}, ()),
    "gravity": ({"gravity": True}, ("gravity",)),
    "stribeck": ({"stribeck": "estimate"}, ("stribeck",)),
    "directional": ({"friction": "directional"}, ("offset",)),
    "quadratic": ({"quadratic": True}, ("quadratic",)),
    "cogging": ({}, ("cogging",)),
    "spring": ({"spring": True, "offset": True}, ("spring",)),
    "dead_time": ({"dead_time": "estimate"}, ("dead_time",)),
    "all": (
        {
            "gravity": True,
            "stribeck": "estimate",
            "friction": "directional",
            "quadratic": True,
            "spring": True,
            "dead_time": "estimate",
        },
        ("gravity", "stribeck", "offset", "quadratic", "spring", "dead_time"),
    ),
}
#: The kind of machine of each seed; machines of odd seeds move under position control.
SEEDS = {0: "cart", 1: "gantry", 2: "rotor", 3: "slide", 4: "spindle", 5: "press"}


@dataclass(frozen=True)
class Case:
    """A record with its right model and its machine."""

    u: Floats
    counts: Counts
    dt: float
    resolution: float
    model: Drive
    machine: Machine


def make_case(name: str, seed: int, samples: int = SAMPLES) -> Case:
    """Return the record of a machine for this model."""
    rng = np.random.default_rng([31, list(MODELS).index(name), seed])
    options, terms = MODELS[name]
    options, values = dict(options), dict[str, float]()
    bench = bench_of(KINDS[SEEDS[seed]], "multisine" if seed % 2 else "prbs", rng)
    bench = replace(bench, samples=samples)
    if "gravity" in terms:  # strokes of a turn and more
        ramp = float(np.sqrt(3 / (1.2 * bench.force / bench.drive.mass)))
        speed = 0.6 * bench.force / bench.drive.mass * ramp
        scale = speed / bench.speed
        drive = replace(bench.drive, viscous_friction=bench.drive.viscous_friction / scale)
        clock = max(2, round(ramp / (4 * bench.dt)))
        bench = replace(bench, drive=drive, speed=speed, stroke=3.0, clock=clock, resolution=bench.resolution * scale)
        values |= {"gravity": 0.2 * bench.force, "gravity_angle": float(rng.uniform(0, 6))}
        options["axis"] = "rotary"
    for term in terms:
        if term != "gravity":
            values |= TERMS[term](bench, rng)
    if "cogging" in terms:
        options["cogging"] = values["cogging_pitch"]
    machine = Machine(replace(bench.drive, offset=values.pop("offset", 0.0)), **values)
    record = record_of(bench, machine, "multisine" if seed % 2 else "prbs", rng)
    model = Drive(bench.drive.input_gain, **options)  # type: ignore[arg-type]
    return Case(record.u, record.counts, bench.dt, record.resolution, model, machine)


def identify_case(case: Case, **settings: object) -> Result:
    """Identify the case with `auto` and full judgement."""
    from pmfid import identify

    return identify(case.u, case.counts, model=case.model, dt=case.dt, encoder=Encoder(case.resolution), **settings)
