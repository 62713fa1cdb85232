"""Compare alarms to the truth, on random machines and on benches: `python -m studies.alarms --out PAGE.md`."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise, product
from typing import Any

import numpy as np

from pmfid.encoder import Encoder
from pmfid.errors import PmfidError
from pmfid.estimators.iv import RIV
from pmfid.models.drive import Drive
from pmfid.monitor.calibration import Calibration, calibrate
from pmfid.monitor.events import Alarm, Settled, Watch
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
#: Causes and sizes of the changes on the benches.
CAUSES = (*NAMES, "input_gain", "encoder_scale")
SIZES = (0.05, 0.1, 0.2)
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
    """The first alarm after changes by these factors, or None, and the judgement with its new reference.

    `delay` is in moves. `before` and `more` count the alarms before the change and after the first alarm.
    """

    truth: Mapping[str, float]
    alarm: Alarm | None
    settled: Settled | None
    delay: float
    before: int
    more: int

    def judge(self, event: Alarm | Settled) -> str:
        """Return "right" if an event names the right set of parameters first, "one of" if it is another of the sets,
        and "wrong" otherwise."""
        sets = [{one.parameter for one in event.changes}, *(set(one.split(" and ")) for one in event.others)]
        places = [k for k, one in enumerate(sets) if self._is_truth(one)]
        return "wrong" if not places else "one of" if places[0] else "right"

    def _is_truth(self, causes: Collection[str]) -> bool:
        kinds = {"viscous_friction", "coulomb_friction"}
        return {part for one in causes for part in (kinds if one == "friction" else {one})} == set(self.truth)

    def bars(self, event: Alarm | Settled) -> float:
        """Return the largest error of a size, divided by its bar."""
        true = {**self.truth, "friction": float(np.mean([self.truth.get(name, 1.0) for name in NAMES[1:]]))}
        return max(abs(one.relative + 1 - true[one.parameter]) / one.relative_std for one in event.changes)


def drawn_changes(seed: int) -> Iterator[Mapping[str, float]]:
    """Yield each cause with each size, and each pair of causes with random sizes. The directions are random."""
    rng = np.random.default_rng([seed, 91])
    for cause, size in product(CAUSES, SIZES):
        yield {cause: 1 + size * rng.choice([-1, 1])}
    for pair in combinations(CAUSES, 2):
        yield dict(zip(pair, 1 + rng.choice([-1, 1], 2) * rng.choice(SIZES, 2), strict=True))


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
    events = [event for *_, event in Monitor(machine.estimator(), calibration, Watch()).run(u, counts).events]
    alarms = [event for event in events if isinstance(event, Alarm)]
    after = [alarm for alarm in alarms if alarm.time >= when]
    alarm = after[0] if after else None
    values = [event for event in events if isinstance(event, Settled) and alarm and event.time > alarm.time]
    delay = np.inf if alarm is None else (alarm.time - when) / machine.move
    judged = values[0] if values else None
    return Said(factors, alarm, judged, delay, len(alarms) - len(after), max(0, len(after) - 1))


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


def causes_rows(seeds: range) -> Iterator[list[str]]:
    """Yield a row for each bench, for single causes and pairs, and for all."""
    every = list[Said]()
    for name in AXES:
        machine = bench(name)
        calibration = machine.calibration()
        changes = [(seed, one) for seed in seeds for one in drawn_changes(seed)]
        every += [said(machine, calibration, one, 100 * seed + k) for k, (seed, one) in enumerate(changes)]
        row = [name, *_cells(every[-len(changes) :])]
        print(" | ".join(row), flush=True)
        yield row
    for number, title in ((1, "single"), (2, "pairs")):
        yield [title, *_cells([one for one in every if len(one.truth) == number])]
    yield ["all", *_cells(every)]


def _cells(found: list[Said]) -> list[str]:
    reported = [one for one in found if one.alarm is not None]
    delay = f"{np.median([one.delay for one in reported]):.1f}" if reported else ""
    further = [str(sum(getattr(one, name) for one in found)) for name in ("before", "more")]
    first = _judged([(one, one.alarm) for one in found if one.alarm is not None])
    last = _judged([(one, one.settled) for one in found if one.settled is not None])
    return [str(len(found)), str(len(reported)), *first, *last, delay, *further]


def _judged(pairs: Sequence[tuple[Said, Alarm | Settled]]) -> list[str]:
    """Return the numbers of right sets, of right ones among several, and of wrong ones, and the errors of sizes."""
    words = [one.judge(event) for one, event in pairs]
    bars = np.array([one.bars(event) for one, event in pairs if one.judge(event) == "right"])
    numbers = " / ".join(str(words.count(word)) for word in ("right", "one of", "wrong"))
    return [numbers, f"{np.sum(bars <= 3)} of {bars.size}, {bars.max(initial=0):.1f}"]


HEADER = ("runs", "alarms", "cause", "sizes", "cause, settled", "sizes, settled", "delay", "before", "more")
TEXT = """
# What an alarm says

`riv` with a memory of {memory} moves, tolerance 2 %, calibrated from {reference} moves of normal work. *Cause*: the
right set of changes named first / among others / not named. Sets with the same effect are among them. *Sizes*: of
the right sets, those within three standard errors, and the largest error in standard errors. *Settled*: the same,
when the new values are known. *Delay*: median, in moves; *before* and *more*: alarms before the change and after the
first alarm.

## Sizes, by what Coulomb friction takes of the force

Machines drawn at random: 0.5 to 500 kg, time constants of 0.08 to 1 s, half of them under position control, half
under a binary input. Changes: {changes}. {refused} could not be calibrated.
"""
BENCHES = """
## Causes, on the benches

Each cause by 5, 10 and 20 % up or down, and each pair of causes. Moves to and fro that vary at random, position control
through {increments} increments per turn. A run without an alarm has none within {after} moves after the change.
"""


def page(runs: int = 100, first: int = 0) -> str:
    found, refused = sizes(runs, first)
    single = [(name.replace("_", " "), 100 * factor - 100) for one in CHANGES for name, factor in one.items()]
    changes = ", ".join(f"{name} {size:+.0f} %" for name, size in single)
    text = TEXT.format(changes=changes, memory=MEMORY, reference=REFERENCE, refused=refused)
    lines = [*text.strip().splitlines(), "", *table(["Coulomb friction", *HEADER], list(sizes_rows(found)))]
    print("\n".join(lines), flush=True)
    lines += [
        *BENCHES.format(increments=INCREMENTS, after=AFTER).splitlines(),
        "",
        *table(["bench", *HEADER], list(causes_rows(range(first, first + max(1, runs // 25))))),
    ]
    lines += ["", f"Written by `python -m studies.alarms --out results/alarms.md --runs {runs} --first {first}`."]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    write_page(page, __doc__)
