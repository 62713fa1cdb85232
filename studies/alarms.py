"""Compare alarms to the truth, on random machines and on benches: `python -m studies.alarms --out PAGE.md`."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from types import MappingProxyType
from typing import Any

import numpy as np

from pmfid.encoder import Encoder
from pmfid.errors import PmfidError
from pmfid.estimators.iv import RIV
from pmfid.models.drive import Drive
from pmfid.monitor.calibration import Calibration, calibrate
from pmfid.monitor.events import Alarm, Watch
from pmfid.monitor.monitor import Monitor
from pmfid.simulation import DriveParameters, Schedule, position_control, prbs, quantize, simulate_drive
from pmfid.types import Counts, Floats
from studies.machines import AXES
from studies.monitoring.axis import random_stop_and_go
from studies.paper.truth import table
from studies.sections import write_page

#: Parameters and factors of each change; runs use the changes in turn.
CHANGES: tuple[Mapping[str, float], ...] = (
    {"mass": 1.2},
    {"mass": 0.8},
    {"viscous_friction": 1.3},
    {"coulomb_friction": 1.4},
    {"input_gain": 0.85},
    {"mass": 1.4},
    {"encoder_scale": 0.25},
)
#: Parameters of a machine.
NAMES = ("mass", "viscous_friction", "coulomb_friction")
#: Benches on which several parameters change, and limits of the factors (or of their inverses).
SEVERAL, FACTORS = ("cart", "rotary", "stage", "gantry"), (1.06, 1.4)
NAMED: tuple[Mapping[str, float], ...] = (
    {"viscous_friction": 1.15, "coulomb_friction": 1.15},
    {"mass": 1.1, "coulomb_friction": 1.1},
)
#: Limits of Coulomb friction on random machines, as a fraction of the force.
LEAST, MOST = 0.05, 0.6
#: Times in moves: length of the calibration record, earliest change and its variation, and time after the change.
REFERENCE, BEFORE, VARIED, AFTER = 400, 40, 3, 60
#: Memory of the estimator in moves, and increments per turn on the benches.
MEMORY, INCREMENTS = 1.5, 1024


@dataclass(frozen=True)
class Watched:
    """A machine under the monitor.

    With `volt` = 0, position control (`kp`, `kd`, `u_max`) makes moves of `stroke` [m or rad] in `move` [s], with
    dwells of `dwell` [s]. With `volt` > 0, the input is binary with this amplitude, held for `clock` samples.
    """

    drive: DriveParameters
    dt: float
    resolution: float
    stroke: float
    move: float
    dwell: float
    control: Mapping[str, Any]
    volt: float = 0.0
    clock: int = 1

    def record(
        self, schedule: Schedule, moves: float, rng: np.random.Generator, scale: tuple[float, float] = (0.0, 1.0)
    ) -> tuple[Floats, Counts]:
        """Return input and counts (n,), from a random encoder phase. From a time [s] on, the encoder has a scale."""
        n, phase = round(moves * self.move / self.dt), self.resolution * rng.random()
        if self.volt > 0:
            motion = simulate_drive(schedule, prbs(n, clock=self.clock, amplitude=self.volt, rng=rng), self.dt)
        else:
            reference = random_stop_and_go(n, rng, (self.stroke, self.move, self.dwell), self.dt)
            control = {**self.control, "resolution": self.resolution, "phase": phase}
            motion, _ = position_control(schedule, reference, self.dt, **control)
        k = min(round(scale[0] / self.dt), n - 1)
        seen = np.where(np.arange(n) < k, motion.x, motion.x[k] + scale[1] * (motion.x - motion.x[k]))
        return np.array(motion.u), quantize(seen, self.resolution, phase)

    def estimator(self) -> RIV:
        drive = self.drive
        initial = {name: getattr(drive, name) for name in NAMES}
        model, encoder = Drive(drive.input_gain), Encoder(self.resolution)
        return RIV(
            model, encoder, self.dt, 0.5 / self.dt, forgetting=1 - self.dt / (MEMORY * self.move), initial=initial
        )

    def calibration(self) -> Calibration:
        u, counts = self.record(Schedule(((0.0, self.drive),)), REFERENCE, np.random.default_rng(7))
        estimator = self.estimator()
        assert estimator.initial is not None
        return calibrate(estimator, np.array(list(estimator.initial.values())), u, counts)


@dataclass(frozen=True)
class Said:
    """The first alarm after changes by these factors, or None; `delay` is in moves."""

    truth: Mapping[str, float]
    alarm: Alarm | None
    delay: float
    before: int

    @property
    def named(self) -> bool:
        """Return whether the alarm names the right set of parameters first."""
        return self.alarm is not None and self._is_truth(self.alarm.causes)

    @property
    def right(self) -> bool:
        """Return whether the alarm names the right set of parameters, and no other."""
        return self.named and self.alarm is not None and not self.alarm.others

    @property
    def open(self) -> bool:
        """Return whether the right set is one of several that the alarm names."""
        sets = (
            [] if self.alarm is None else [self.alarm.causes, *(set(one.split(" and ")) for one in self.alarm.others)]
        )
        return not self.right and any(self._is_truth(one) for one in sets)

    def _is_truth(self, causes: Collection[str]) -> bool:
        kinds = {"viscous_friction", "coulomb_friction"}
        return {part for one in causes for part in (kinds if one == "friction" else {one})} == set(self.truth)

    @property
    def bars(self) -> float:
        """Return the largest error of a size, divided by its bar."""
        assert self.alarm is not None
        true = {**self.truth, "friction": float(np.mean([self.truth.get(name, 1.0) for name in NAMES[1:]]))}
        return max(abs(one.relative + 1 - true[one.parameter]) / one.relative_std for one in self.alarm.changes)


def drawn_changes(seed: int) -> Mapping[str, float]:
    """Return two parameters with random factors. Each fourth pair is one of two that were once misread."""
    rng = np.random.default_rng([seed, 91])
    if seed % 4 == 3:
        return NAMED[seed // 4 % 2]
    sizes = np.exp(rng.choice([-1, 1], 2) * rng.uniform(np.log(FACTORS[0]), np.log(FACTORS[1]), 2))
    return dict(zip(rng.choice(NAMES, 2, replace=False).tolist(), sizes.tolist(), strict=True))


def drawn(seed: int) -> tuple[Watched, float]:
    """Return a random machine, and the fraction of its force that Coulomb friction takes."""
    rng = np.random.default_rng([seed, 77])
    mass, settling, move, stroke = 10 ** rng.uniform(-0.3, 2.7), 10 ** rng.uniform(-1.1, 0), *rng.uniform(0.4, 0.6, 2)
    move, stroke, part, gain = 2.5 * move, stroke - 0.3, rng.uniform(LEAST, MOST), 10 ** rng.uniform(-0.5, 1.5)
    viscous = mass / settling
    rest = float(np.hypot(3.85 * mass * stroke / move**2, 1.875 * viscous * stroke / move))
    force = rest / (1 - part)
    fast = rng.uniform(12, 24) / move
    control = {
        "kp": mass * fast**2 / gain,
        "kd": max(0.0, 1.6 * fast * mass - viscous) / gain,
        "u_max": 3 * force / gain,
    }
    drive = DriveParameters(mass, viscous, part * force, gain)
    volt = 1.2 * force / gain * (seed % 2)
    dt, resolution = move / int(rng.integers(60, 160)), stroke / 10 ** rng.uniform(3.2, 4.2)
    return Watched(
        drive, dt, resolution, stroke, move, rng.uniform(0.2, 0.6), control, volt, int(rng.integers(8, 20))
    ), part


def bench(name: str) -> Watched:
    """Return an axis of the study of wrong models."""
    axis = AXES[name]
    return Watched(
        axis.drive, axis.dt, axis.resolution * 4096 / INCREMENTS, axis.stroke, axis.move, axis.dwell, axis.control
    )


def said(machine: Watched, calibration: Calibration, factors: Mapping[str, float], seed: int) -> Said:
    """Return the monitor's alarm for changes by some factors."""
    rng = np.random.default_rng([seed, 3])
    moves = BEFORE + VARIED * rng.random()
    changed = {
        name: factor * getattr(machine.drive, name) for name, factor in factors.items() if name != "encoder_scale"
    }
    when = moves * machine.move
    plant = Schedule(((0.0, machine.drive), (when, replace(machine.drive, **changed))))
    u, counts = machine.record(plant, moves + AFTER, rng, (when, factors.get("encoder_scale", 1.0)))
    rows = Monitor(machine.estimator(), calibration, Watch()).run(u, counts)
    alarms = [event for _, _, event in rows.events if isinstance(event, Alarm)]
    found = [alarm for alarm in alarms if alarm.time >= when]
    delay = (found[0].time - when) / machine.move if found else np.inf
    return Said(factors, found[0] if found else None, delay, len(alarms) - len(found))


def sizes(runs: int, first: int) -> tuple[list[tuple[float, Said]], int]:
    """Return alarms on random machines, each with its fraction of Coulomb friction, and the number of failed
    calibrations.
    """
    found, refused = list[tuple[float, Said]](), 0
    for seed in range(first, first + runs):
        machine, part = drawn(seed)
        try:
            found.append((part, said(machine, machine.calibration(), CHANGES[seed // 2 % len(CHANGES)], seed)))
        except PmfidError:
            refused += 1
    return found, refused


def sizes_rows(found: list[tuple[float, Said]]) -> Iterator[list[str]]:
    """Yield a row for each range of Coulomb friction."""
    limits = (LEAST, 0.15, 0.3, 0.45, MOST)
    for low, high in (*pairwise(limits), (LEAST, MOST)):
        yield [f"{100 * low:.0f} to {100 * high:.0f} %", *_cells([one for part, one in found if low <= part < high])]


def causes_rows(
    names: Iterable[str], seeds: range, changes: Callable[[int], Mapping[str, float]]
) -> Iterator[list[str]]:
    """Yield a row for each bench, and one for all."""
    every = list[Said]()
    for name in names:
        machine = bench(name)
        calibration = machine.calibration()
        found = [said(machine, calibration, changes(seed), seed) for seed in seeds]
        every += found
        row = [name, *_cells(found)]
        print(" | ".join(row), flush=True)
        yield row
    yield ["all", *_cells(every)]


def _cells(found: list[Said]) -> list[str]:
    reported = [one for one in found if one.alarm is not None]
    bars = np.array([one.bars for one in reported if one.named])
    delay = f"{np.median([one.delay for one in reported]):.1f}" if reported else ""
    right, open_ = sum(one.right for one in found), sum(one.open for one in found)
    counts = [len(found), len(reported), right, open_, len(reported) - right - open_]
    within = f"{np.sum(bars <= 3)} of {bars.size}"
    return [*map(str, counts), within, f"{bars.max(initial=0):.1f}", delay, str(sum(one.before for one in found))]


HEADER = MappingProxyType(
    dict.fromkeys(
        ("runs", "alarms", "right cause", "one of", "wrong", "sizes within 3 bars", "worst", "delay", "before")
    )
)
TEXT = """
# What an alarm says

One change in each run: {changes}.
`riv` with a memory of {memory} moves, tolerance 2 %, calibrated
from {reference} moves of normal work. *Right cause*: named alone; *one of*: several are named, as the samples do not
tell them apart, and the right one is among them; *wrong*: it is not. *Sizes*: of the alarms whose first cause is the
right one. *Delay*: median, in moves; *before*: alarms before the change.

## Sizes, by what Coulomb friction takes of the force

Machines drawn at random: 0.5 to 500 kg, time constants of 0.08 to 1 s, half of them under position control, half
under a binary input. {refused} could not be calibrated.
"""
CAUSES = """
## Causes, on the benches

Moves to and fro that vary at random, position control through {increments} increments per turn. A run without an alarm
has none within {after} moves after the change: 40 % of the spindle's Coulomb friction are 0.4 % of its force. If the
delay is more than ten moves, the monitor learns from the record (units of work, see docs/howto/monitoring.md).
"""
PAIRS = """
## Two parameters at once, on the benches

Two of mass, viscous and Coulomb friction change at the same moment, by 6 to 40 % up or down; each fourth pair is both
frictions +15 %, or mass and Coulomb friction +10 %. Friction as a whole counts as both frictions.
"""


def page(runs: int = 100, first: int = 0) -> str:
    found, refused = sizes(runs, first)
    single = [(name.replace("_", " "), 100 * factor - 100) for one in CHANGES for name, factor in one.items()]
    changes, seeds = ", ".join(f"{name} {size:+.0f} %" for name, size in single), range(first, first + runs)
    text = TEXT.format(changes=changes, memory=MEMORY, reference=REFERENCE, refused=refused)
    lines = [*text.strip().splitlines(), "", *table(["Coulomb friction", *HEADER], list(sizes_rows(found)))]
    print("\n".join(lines), flush=True)
    lines += [
        *CAUSES.format(increments=INCREMENTS, after=AFTER).splitlines(),
        "",
        *table(["bench", *HEADER], list(causes_rows(AXES, seeds, lambda seed: CHANGES[seed % len(CHANGES)]))),
        *PAIRS.splitlines(),
        "",
        *table(["bench", *HEADER], list(causes_rows(SEVERAL, seeds, drawn_changes))),
    ]
    lines += ["", f"Written by `python -m studies.alarms --out results/alarms.md --runs {runs} --first {first}`."]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    write_page(page, __doc__)
