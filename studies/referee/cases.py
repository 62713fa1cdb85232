"""Records of random machines, with the true parameters in SI units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pmfid.types import Floats
from studies.referee.machines import Machine, draw_machine
from tests.oracles.axis import Axes, Excitation, Motion, simulate_axes

PARAMETERS = ("mass", "viscous", "coulomb")
#: Effects on the input, which may be a gain in a record: with two levels of the input they are nothing else.
OF_INPUT = ("dead zone", "bending", "saturation")
#: Steps of the integrator per sample, and those of the kinds with fast forces.
SUBSTEPS, FAST_SUBSTEPS = 10, 30
FAST = ("cogging", "backlash", "second mass")


@dataclass(frozen=True)
class Case:
    """A record and its truth.

    u (n,) is the input, and counts (n,) is NaN where a count is missing. t (n,) are the instants [s] of an uneven
    clock, or None. `resolution` is in m or rad per count, and `input_gain` in N or N m per unit of u. `seen_gain` is
    the gain of a bent input in this record, relative to its slope: sum(u force) / sum(u^2).
    """

    kind: str
    motion: str
    index: int
    u: Floats
    counts: Floats
    dt: float
    t: Floats | None
    resolution: float
    rotary: bool
    input_gain: float
    truth: Mapping[str, float]
    seen_gain: float
    facts: Mapping[str, float]


def make_cases(seed: int, kind: str, indices: Sequence[int]) -> list[Case]:
    """Simulate machines of one kind."""
    machines = [draw_machine(seed, kind, index) for index in indices]
    fields = sorted({name for m in machines for name in m.effect} - {"push", "friction"})
    values = {
        "mass": np.array([m.pace.mass for m in machines]),
        "viscous": np.array([m.pace.viscous for m in machines]),
        "coulomb": np.array([m.pace.coulomb for m in machines]),
    } | {name: np.array([m.effect[name] for m in machines]) for name in fields}
    substeps = FAST_SUBSTEPS if kind in FAST else SUBSTEPS
    zero = np.array([machine.zero for machine in machines])
    motion = simulate_axes(Axes(**values), excite(machines), zero, substeps)
    return [make_case(machine, motion, column) for column, machine in enumerate(machines)]


def excite(machines: Sequence[Machine]) -> Excitation:
    """Stack the commands of machines; shorter ones are filled up."""
    n = max(machine.step.size for machine in machines)

    def stack(rows: Sequence[Floats], value: float) -> Floats:
        return np.array([np.r_[row, np.full(n - row.size, value)] for row in rows]).T

    commands = [machine.command for machine in machines]
    return Excitation(
        feed=stack([command.feed for command in commands], 0.0),
        step=stack([machine.step for machine in machines], 1.0),
        reference=stack([command.reference for command in commands], 0.0),
        kp=np.array([command.kp for command in commands]),
        kd=np.array([command.kd for command in commands]),
        window=np.array([command.window for command in commands]),
        top=np.ones(len(machines)),
        push=stack([np.zeros(m.step.size) + m.effect.get("push", 0.0) for m in machines], 0.0),
        friction=stack([np.zeros(m.step.size) + m.effect.get("friction", 1.0) for m in machines], 1.0),
    )


def make_case(machine: Machine, motion: Motion, column: int) -> Case:
    """Cut one record, and scale it to SI units."""
    scale, pace = machine.scale, machine.pace
    log = slice(machine.first, machine.step.size)
    u, counts, force = (signal[log, column] for signal in (motion.u, motion.counts, motion.force))
    resolution = scale.turn / machine.increments
    top_force = scale.mass * resolution / (pace.mass * scale.dt**2)
    friction = np.mean(
        np.broadcast_to(machine.effect.get("friction", 1.0), machine.step.shape)[log][:-1]
    )  # the last sample's force acts after the record
    uneven = bool(np.ptp(machine.step) > 0)
    missing = machine.missing
    return Case(
        machine.kind,
        machine.motion,
        machine.index,
        u * scale.top,
        np.where(missing, np.nan, counts),
        scale.dt,
        scale.dt * np.r_[0.0, np.cumsum(machine.step[log])[:-1]] if uneven else None,
        resolution,
        scale.rotary,
        top_force / scale.top,
        {
            "mass": scale.mass,
            "viscous": pace.viscous * top_force * scale.dt / resolution,
            "coulomb": pace.coulomb * top_force * float(friction),
        },
        float(u[:-1] @ force[:-1] / (u[:-1] @ u[:-1])) if machine.kind in OF_INPUT else 1.0,
        {
            "samples": u.size,
            "increments": machine.increments,
            "dt": scale.dt,
            "uneven": int(uneven),
            "missing": int(missing.sum()),
            "counts_per_sample": float(np.sqrt(np.mean(np.diff(counts) ** 2))),
            "time_constant": pace.time_constant,
            "clock": pace.clock,
            "friction_share": pace.coulomb,
        }
        | read_disc(machine, counts[0]),
    )


def read_disc(machine: Machine, first: float) -> dict[str, float]:
    """Return amplitude [counts] and phase at the first count of a disc that is eccentric, or NaN for any other disc."""
    effect = machine.effect
    if "runout" not in effect:
        return {"eccentricity": np.nan, "phase": np.nan}
    phase = effect["runout"] + 2 * np.pi / effect["turn"] * (first + 0.5 - machine.zero)
    return {"eccentricity": float(effect["eccentricity"]), "phase": float(phase)}
