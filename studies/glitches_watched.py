"""Study the effect of counter jumps, wrong readings and spikes on the monitor, as a page:
`python -m studies.glitches_watched --out results/glitches_watched.md`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from pmfid.encoder import Encoder
from pmfid.estimators.iv import RIV
from pmfid.models.drive import Drive
from pmfid.monitor.calibration import Calibration, calibrate
from pmfid.monitor.events import Alarm, Outlier, Watch
from pmfid.monitor.monitor import Monitor
from pmfid.simulation import Schedule, position_control
from pmfid.types import Counts, Floats
from studies.glitches import CUTOFF, KINDS, Spoiled, sizes_of, spoil_at
from studies.machines import AXES, Axis, truth
from studies.monitoring.axis import random_stop_and_go
from studies.paper.truth import table
from studies.sections import write_page

WATCHED = ("cart", "rotary", "gantry")
INCREMENTS, MEMORY = 1024, 100  # [samples]
#: Earliest and latest fault, delay of the mass step after it, and the time to find the step [s].
FAULT, LATER, FOUND_WITHIN = (10.0, 15.0), 10.0, 5.0
MASS_STEP = 1.2
REFERENCE, HOURS = 600.0, 2.0  # length of the calibration record [s], hours of its replays


@dataclass(frozen=True)
class Heard:
    """False alarms, whether the mass step was reported with its size, and the samples reported as outliers."""

    alarms: int
    found: bool
    reported: int


@dataclass(frozen=True)
class Watched:
    """A run with and without faults. A mistake of the run without faults is no effect of the faults."""

    faulty: Heard
    clean: Heard
    faults: int


def _record(axis: Axis, schedule: Schedule, seconds: float, rng: np.random.Generator) -> tuple[Floats, Counts]:
    reference = random_stop_and_go(round(seconds / axis.dt), rng, (axis.stroke, axis.move, axis.dwell), axis.dt)
    resolution = _resolution(axis)
    kp, kd, u_max = (axis.control[name] for name in ("kp", "kd", "u_max"))
    phase = resolution * rng.random()
    motion, counts = position_control(
        schedule, reference, axis.dt, kp=kp, kd=kd, u_max=u_max, resolution=resolution, phase=phase
    )
    return motion.u, counts


def _resolution(axis: Axis) -> float:
    return axis.resolution * 4096 / INCREMENTS


def _riv(axis: Axis, initial: bool) -> RIV:
    plain = RIV(
        Drive(axis.drive.input_gain), Encoder(_resolution(axis)), axis.dt, CUTOFF / axis.dt, forgetting=1 - 1 / MEMORY
    )
    return replace(plain, initial=dict(zip(plain.names, truth(axis).tolist(), strict=True))) if initial else plain


@cache
def _calibration(name: str) -> Calibration:
    axis = AXES[name]
    u, counts = _record(axis, Schedule(((0.0, axis.drive),)), REFERENCE, np.random.default_rng(7))
    return calibrate(_riv(axis, initial=False), truth(axis), u, counts, hours=HOURS)


def _spoiled(kind: str, u: Floats, counts: Counts, first: int, dt: float, rng: np.random.Generator) -> Spoiled | None:
    """Return the record with the fault at the sample `first`, or at the next sample at rest. Glitches of the kind with
    1 % go from the fault to the end."""
    places = np.array([first])
    if kind == "1 % glitches":
        places = first + np.flatnonzero(rng.random(u.size - first) < 0.01)
    if kind == "jump at rest":
        rests = [k for k in range(first, first + round(4.0 / dt)) if np.ptp(counts[k - 20 : k + 1]) == 0]
        if not rests:
            return None
        places = np.array(rests[:1])
    return spoil_at(kind, u, counts, places, sizes_of(kind, places.size, rng))


def watched(name: str, kind: str, runs: int) -> Iterator[Watched]:
    """Yield runs with a fault, and after LATER a step of the mass."""
    axis, calibration = AXES[name], _calibration(name)
    for seed in range(runs):
        rng = np.random.default_rng([seed, KINDS.index(kind)])
        fault = rng.uniform(*FAULT)
        step = fault + LATER
        schedule = Schedule(((0.0, axis.drive), (step, replace(axis.drive, mass=MASS_STEP * axis.drive.mass))))
        u, counts = _record(axis, schedule, step + FOUND_WITHIN, rng)
        spoiled = _spoiled(kind, u, counts, round(fault / axis.dt), axis.dt, rng)
        if spoiled is None:
            continue
        faulty, clean = (_heard(axis, calibration, *log, step) for log in ((spoiled.u, spoiled.counts), (u, counts)))
        yield Watched(faulty, clean, spoiled.places.size)


def _heard(axis: Axis, calibration: Calibration, u: Floats, counts: Counts, step: float) -> Heard:
    """Return the monitor's events for u, counts (n,), in which the mass steps at the time `step` [s]."""
    monitor = Monitor(_riv(axis, initial=True), calibration, Watch())
    events = [event for a, b in zip(u.tolist(), counts.tolist(), strict=True) for event in monitor.step(a, b)[1]]
    alarms = [event for event in events if isinstance(event, Alarm)]
    right = [one for one in alarms if one.time > step and one.parameter == "mass" and 0.1 < one.relative < 0.3]
    return Heard(len(alarms) - len(right[:1]), bool(right), sum(isinstance(event, Outlier) for event in events))


def rows(runs: int) -> Iterator[list[str]]:
    """Yield rows: axis, fault, runs, reported outliers, and false alarms and found steps with and without the fault."""
    for name in WATCHED:
        for kind in KINDS:
            found = list(watched(name, kind, runs))
            reported, faults = sum(one.faulty.reported for one in found), sum(one.faults for one in found)
            row = [name, kind, str(len(found)), f"{reported} for {faults}"]
            for heard in ([one.faulty for one in found], [one.clean for one in found]):
                row += [str(sum(one.alarms for one in heard)), f"{sum(one.found for one in heard)} of {len(found)}"]
            print(" | ".join(row), flush=True)
            yield row


def page(runs: int = 50) -> str:
    """Return the page with `runs` runs of each fault."""
    return "\n".join(
        [
            "# Samples that no motion explains, under the monitor",
            "",
            f"Written by `python -m studies.glitches_watched`. `riv` with a memory of {MEMORY} samples, "
            f"{INCREMENTS} increments, stop-and-go whose strokes, times and dwells vary, thresholds from {HOURS:g} h "
            f"of replays of {REFERENCE:g} s. A fault of the sizes of [glitches](glitches.md) {FAULT[0]:g} to "
            f"{FAULT[1]:g} s after the start (1 % glitches: from there to the end), {LATER:g} s later the mass is "
            f"{MASS_STEP:g} times as large, {FOUND_WITHIN:g} s after that the record ends. Found: an alarm on the mass "
            "between +10 and +30 %; every other alarm is a false one, also one of the step that names another cause: "
            "the same run without the fault shows whose doing that is.",
            "",
            *table(
                [
                    "axis",
                    "fault",
                    "runs",
                    "samples reported",
                    "false alarms",
                    "steps found",
                    "without: false alarms",
                    "steps found",
                ],
                list(rows(runs)),
            ),
            "",
        ]
    )


if __name__ == "__main__":
    write_page(page, __doc__)
