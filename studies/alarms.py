"""Compare alarms to the truth, on random machines and on benches: `python -m studies.alarms --out PAGE.md`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
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

#: Parameter and factor of each change; runs use the changes in turn.
CHANGES = (
    ("mass", 1.2),
    ("mass", 0.8),
    ("viscous_friction", 1.3),
    ("coulomb_friction", 1.4),
    ("input_gain", 0.85),
    ("mass", 1.4),
)
#: Limits of Coulomb friction on random machines, as a fraction of the force.
LEAST, MOST = 0.05, 0.6
#: Times in moves: length of the calibration record, earliest change and its variation, and time after the change.
REFERENCE, BEFORE, VARIED, AFTER = 400, 40, 3, 25
#: Memory of the estimator in moves, simulated hours of the calibration, and increments per turn on the benches.
MEMORY, HOURS, INCREMENTS = 1.5, 1.0, 1024


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

    def record(self, schedule: Schedule, moves: float, rng: np.random.Generator) -> tuple[Floats, Counts]:
        """Return input and counts (n,), from a random encoder phase."""
        n, phase = round(moves * self.move / self.dt), self.resolution * rng.random()
        if self.volt > 0:
            u = prbs(n, clock=self.clock, amplitude=self.volt, rng=rng)
            return u, quantize(simulate_drive(schedule, u, self.dt).x, self.resolution, phase)
        reference = random_stop_and_go(n, rng, (self.stroke, self.move, self.dwell), self.dt)
        motion, counts = position_control(
            schedule, reference, self.dt, **self.control, resolution=self.resolution, phase=phase
        )
        return motion.u, counts

    def estimator(self) -> RIV:
        drive = self.drive
        initial = {name: getattr(drive, name) for name in ("mass", "viscous_friction", "coulomb_friction")}
        model, encoder = Drive(drive.input_gain), Encoder(self.resolution)
        return RIV(
            model, encoder, self.dt, 0.5 / self.dt, forgetting=1 - self.dt / (MEMORY * self.move), initial=initial
        )

    def calibration(self) -> Calibration:
        u, counts = self.record(Schedule(((0.0, self.drive),)), REFERENCE, np.random.default_rng(7))
        estimator = self.estimator()
        assert estimator.initial is not None
        return calibrate(estimator, np.array(list(estimator.initial.values())), u, counts, hours=HOURS)


@dataclass(frozen=True)
class Said:
    """The first alarm after a change, or None; `delay` is in moves, and `size` is the true relative change."""

    change: str
    size: float
    alarm: Alarm | None
    delay: float
    before: int

    @property
    def right(self) -> bool:
        """Return whether the alarm names the right cause and no other."""
        return self.alarm is not None and self.alarm.parameter == self.change and not self.alarm.others

    @property
    def bars(self) -> float:
        """Return the error of the size, divided by its bar."""
        alarm = self.alarm
        assert alarm is not None
        return abs(alarm.relative - self.size) / (alarm.std * abs(alarm.relative / alarm.change))


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


def said(machine: Watched, calibration: Calibration, change: tuple[str, float], seed: int) -> Said:
    """Return the monitor's alarm for one change."""
    (name, factor), rng = change, np.random.default_rng([seed, 3])
    moves = BEFORE + VARIED * rng.random()
    after = replace(machine.drive, **{name: factor * getattr(machine.drive, name)})
    when = moves * machine.move
    u, counts = machine.record(Schedule(((0.0, machine.drive), (when, after))), moves + AFTER, rng)
    rows = Monitor(machine.estimator(), calibration, Watch()).run(u, counts)
    alarms = [event for _, _, event in rows.events if isinstance(event, Alarm)]
    found = [alarm for alarm in alarms if alarm.time >= when]
    delay = (found[0].time - when) / machine.move if found else np.inf
    return Said(name, factor - 1, found[0] if found else None, delay, len(alarms) - len(found))


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


def causes_rows(runs: int) -> Iterator[list[str]]:
    """Yield a row for each bench."""
    for name in AXES:
        machine = bench(name)
        calibration = machine.calibration()
        found = [said(machine, calibration, CHANGES[seed % len(CHANGES)], seed) for seed in range(runs)]
        row = [name, *_cells(found)]
        print(" | ".join(row), flush=True)
        yield row


def _cells(found: list[Said]) -> list[str]:
    reported = [one for one in found if one.alarm is not None]
    named = [one for one in reported if one.alarm and one.alarm.parameter == one.change]
    open_ = sum(bool(one.alarm and one.alarm.others) for one in reported)
    bars = np.array([one.bars for one in named])
    delay = f"{np.median([one.delay for one in reported]):.1f}" if reported else ""
    right = sum(one.right for one in reported)
    counts = [len(found), len(reported), right, len(reported) - right - open_, open_]
    within = f"{np.sum(bars <= 2)} of {bars.size}"
    return [*map(str, counts), within, f"{bars.max(initial=0):.1f}", delay, str(sum(one.before for one in found))]


HEADER = MappingProxyType(
    dict.fromkeys(("runs", "alarms", "right cause", "wrong", "open", "size within 2 bars", "worst", "delay", "before"))
)
TEXT = """
# What an alarm says

One change in each run: {changes}.
`riv` with a memory of {memory} moves, detector `glr`, tolerance 2 %, calibrated
from {reference} moves of normal work. *Right cause*: named alone; *wrong*: another one named alone; *open*: several are
named, as the samples do not tell them apart. *Size*: of the alarms whose first cause is the right one. *Delay*: median,
in moves; *before*: alarms before the change.

## Sizes, by what Coulomb friction takes of the force

Machines drawn at random: 0.5 to 500 kg, time constants of 0.08 to 1 s, half of them under position control, half
under a binary input. {refused} could not be calibrated.
"""
CAUSES = """
## Causes, on the benches

Moves to and fro that vary at random, position control through {increments} increments per turn. A run without an alarm
has none within {after} moves after the change: 40 % of the spindle's Coulomb friction are 0.4 % of its force. If the
delay is more than ten moves, the monitor learns from the record (units of work, see [monitoring](monitoring.md)).
"""


def page(runs: int = 100, first: int = 0) -> str:
    found, refused = sizes(runs, first)
    changes = ", ".join(f"{name.replace('_', ' ')} {100 * factor - 100:+.0f} %" for name, factor in CHANGES)
    text = TEXT.format(changes=changes, memory=MEMORY, reference=REFERENCE, refused=refused)
    lines = [*text.strip().splitlines(), "", *table(["Coulomb friction", *HEADER], list(sizes_rows(found)))]
    print("\n".join(lines), flush=True)
    lines += [
        *CAUSES.format(increments=INCREMENTS, after=AFTER).splitlines(),
        "",
        *table(["bench", *HEADER], list(causes_rows(runs))),
    ]
    lines += ["", f"Written by `python -m studies.alarms --out results/alarms.md --runs {runs} --first {first}`."]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    write_page(page, __doc__)
