"""Study: does the search name the terms that a drive has? `python -m studies.terms --out docs/terms.md`."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np

import pmfid
from pmfid.estimators.configuration import changed
from pmfid.paper.truth import Study, Task, table
from pmfid.session.terms import AMBIGUOUS, UNRESOLVED
from pmfid.simulation import Machine
from studies.friction_axes import BENCHES, FRICTIONS, stribeck
from studies.machines import MOTIONS, Axis, record_of
from studies.sections import Page, by_name

INCREMENTS = 1024
#: The rules of the search were chosen on runs of these, those of the scan for a pitch on the last two as well.
TUNED = ("cart", "rotary", "spindle", "motor", "gantry", "heavy")
#: Where a turn has a meaning.
TURNING = ("rotary", "spindle", "motor")
FIRST_SEED = 300
CLOSE = 0.1


def quadratic(axis: Axis) -> float:
    return 0.2 * axis.drive.viscous_friction / axis.speed


def late(axis: Axis) -> float:
    return 0.5 * axis.dt


def cogging(axis: Axis) -> dict[str, float]:
    return {"cogging": 0.3 * axis.drive.coulomb_friction, "cogging_pitch": axis.stroke / 12, "cogging_phase": 1.0}


def spring(axis: Axis) -> float:
    return axis.drive.coulomb_friction / axis.stroke


@dataclass(frozen=True)
class Truth:
    """A machine, the keys of [model] that it asks for, and what the search is told of periods."""

    machine: Callable[[Axis], Machine]
    keys: frozenset[str]
    told: Callable[[Axis], dict[str, Any]] = lambda axis: {"scan": False}


def _of(name: str, *keys: str) -> Truth:
    return Truth(FRICTIONS[name], frozenset(keys))


def _pair(first: Callable[[Axis], Machine], further: Callable[[Axis], dict[str, float]], *keys: str) -> Truth:
    return Truth(lambda axis: changed(first(axis), further(axis)), frozenset(keys))


TRUTHS: Mapping[str, Truth] = MappingProxyType(
    {
        "nothing": _of("nothing"),
        "nothing, with a scan": replace(_of("nothing"), told=lambda axis: {}),
        "Stribeck 20 %": _of("Stribeck 20 %", "stribeck"),
        "Stribeck 50 %": _of("Stribeck 50 %", "stribeck"),
        "quadratic 20 %": _of("quadratic 20 %", "quadratic"),
        "directional 15 %": _of("directional 15 %", "friction"),
        "dead time 0.5 T": Truth(lambda axis: Machine(axis.drive, dead_time=late(axis)), frozenset({"dead_time"})),
        "spring": Truth(lambda axis: Machine(axis.drive, stiffness=spring(axis)), frozenset({"spring"})),
        "gravity": Truth(
            lambda axis: Machine(axis.drive, gravity=0.5 * axis.drive.coulomb_friction, gravity_angle=0.5),
            frozenset({"gravity"}),
            lambda axis: {"scan": False, "turn": 2 * math.pi},
        ),
        "cogging, pitch given": Truth(
            lambda axis: changed(Machine(axis.drive), cogging(axis)),
            frozenset({"cogging"}),
            lambda axis: {"pitch": axis.stroke / 12},
        ),
        "cogging, scanned": Truth(
            lambda axis: changed(Machine(axis.drive), cogging(axis)), frozenset({"cogging"}), lambda axis: {}
        ),
        "Stribeck 50 %, dead time": _pair(
            FRICTIONS["Stribeck 50 %"], lambda axis: {"dead_time": late(axis)}, "stribeck", "dead_time"
        ),
        "Stribeck 50 %, quadratic": _pair(
            lambda axis: stribeck(axis, 0.5), lambda axis: {"quadratic": quadratic(axis)}, "stribeck", "quadratic"
        ),
        "quadratic, dead time": _pair(
            FRICTIONS["quadratic 20 %"], lambda axis: {"dead_time": late(axis)}, "quadratic", "dead_time"
        ),
        "directional, dead time": _pair(
            FRICTIONS["directional 15 %"], lambda axis: {"dead_time": late(axis)}, "friction", "dead_time"
        ),
    }
)


@dataclass(frozen=True)
class Named:
    """What one search has named. wrong: terms that the machine has not; missing: those that it has; worst: largest
    relative error of the parameters; status: of the search."""

    wrong: tuple[str, ...]
    missing: tuple[str, ...]
    worst: float
    status: tuple[str, ...]
    seconds: float


def tasks(seeds: int) -> list[Task]:
    """Each truth on every other bench, on the rest with the next seed, the motions in turn."""
    benches = list(BENCHES)
    return [
        (truth, bench, MOTIONS[(i + j + seed) % len(MOTIONS)], FIRST_SEED + seed)
        for seed in range(seeds)
        for i, truth in enumerate(TRUTHS)
        for j, bench in enumerate(benches)
        if (bench in TURNING if truth == "gravity" else (i + j + seed) % 2 == 0)
    ]


def work(truth: str, bench: str, motion: str, seed: int) -> Named | None:
    """None: refused."""
    from time import process_time

    axis, what = BENCHES[bench], TRUTHS[truth]
    machine = what.machine(axis)
    record = record_of(axis, machine, motion, INCREMENTS, seed)
    begin = process_time()
    try:
        found = pmfid.search_terms(
            record.u,
            record.counts,
            model=pmfid.Drive(axis.drive.input_gain),
            dt=axis.dt,
            cutoff=1 / (3 * axis.dt),
            encoder=pmfid.Encoder(record.resolution),
            **what.told(axis),
        )
    except pmfid.PmfidError:
        return None
    named = frozenset(found.added)
    names = [*found.model.equation.names, *(name for name, _ in found.model.equation.further)]
    values = dict(zip(names, found.chosen.trial.theta.tolist(), strict=True))
    errors = list(_errors(values, true_values(machine))) if named == what.keys else [math.nan]
    wrong, missing = (tuple(sorted(part)) for part in (named - what.keys, what.keys - named))
    return Named(wrong, missing, max(errors), found.status, process_time() - begin)


def true_values(machine: Machine) -> dict[str, float]:
    """By the names of parameters, those that the machine has; of waves their size."""
    drive, more = machine.drive, machine.asymmetry
    known = {"mass": drive.mass, "viscous_friction": drive.viscous_friction}
    known |= {"coulomb_friction": drive.coulomb_friction, "stribeck_friction": machine.stribeck}
    known |= {"stribeck_speed": machine.stribeck_speed, "quadratic_friction": machine.quadratic}
    known |= {"stiffness": machine.stiffness, "dead_time": machine.dead_time}
    known |= {"gravity": machine.gravity, "cogging": machine.cogging}
    for name in ("viscous_friction", "coulomb_friction"):
        known |= {f"{name}_forward": (1 + more) * known[name], f"{name}_backward": (1 - more) * known[name]}
    return known


def _errors(values: Mapping[str, float], known: Mapping[str, float]) -> Iterator[float]:
    waves = {name.removesuffix("_sin") for name in values if name.endswith("_sin")}
    sizes = {name: float(np.hypot(values[f"{name}_sin"], values[f"{name}_cos"])) for name in waves}
    for name, value in {**values, **sizes}.items():
        if name in known:
            yield abs(value / known[name] - 1)


def write(seeds: int, results: Mapping[Task, Any]) -> list[str]:
    lines = [
        "## Simulated axes",
        "",
        f"{len(BENCHES)} machines from 1e-5 kg m2 to 500 kg, sampled every 0.5 to 10 ms, {INCREMENTS} increments, the "
        f"motions in turn ({', '.join(MOTIONS)}), {seeds} seed(s). Held back: machines on which no rule of the search "
        f"was chosen (all but {', '.join(TUNED)}). Right: just the terms that the machine has. Within 10 %: of the "
        "right ones those of which every parameter is, the speed of Stribeck friction included. Told: of the wrong "
        f"ones those with `{UNRESOLVED}` or `{AMBIGUOUS}` in their status.",
        "",
    ]
    header = ["machines", "truth", "runs", "refused", "right", "within 10 %", "wrong: what it named", "told"]
    header += ["seconds, median"]
    rows = [_row(truth, held_back, results) for held_back in (False, True) for truth in TRUTHS]
    return [*lines, *table(header, [row for row in rows if row])]


def _row(truth: str, held_back: bool, results: Mapping[Task, Any]) -> list[str]:
    runs = {task: found for task, found in results.items() if task[0] == truth and (task[1] not in TUNED) == held_back}
    if not runs:
        return []
    found = [one for one in runs.values() if one is not None]
    right = [one for one in found if not one.wrong and not one.missing]
    bad = {task: one for task, one in runs.items() if one is not None and (one.wrong or one.missing)}
    said = "; ".join(f"{task[1]} {task[2]}: {_difference(one)}" for task, one in bad.items())
    told = sum(bool({UNRESOLVED, AMBIGUOUS} & set(one.status)) for one in bad.values())
    return [
        "held back" if held_back else "others",
        truth,
        f"{len(runs)}",
        f"{len(runs) - len(found)}",
        f"{len(right)}",
        f"{sum(one.worst <= CLOSE for one in right)}",
        said or "–",
        f"{told} of {len(bad)}" if bad else "–",
        f"{np.median([one.seconds for one in found]):.1f}" if found else "–",
    ]


def _difference(one: Named) -> str:
    return " ".join([*(f"+{key}" for key in one.wrong), *(f"-{key}" for key in one.missing)])


STUDY = Study("simulated", tasks, work, write)
INTRODUCTION = """\
`pmfid terms` begins with the model of AXIS.toml and adds one term at a time: Stribeck, quadratic or directional
friction, a load, a spring, a dead time or a lag, and, where a turn or a pitch is given or found, gravity and cogging. A
term is proposed by its score test at the best fit so far, and kept if the likelihood ratio is beyond chance and free
runs over parts of the record that it was not fitted to are no worse. In the end a term goes that the others have made
superfluous.

A pitch that is not given is looked for where the model does not explain every count: by score tests of the simulated
position and by a balance of forces at the measured places, each over up to 150 pitches of the travel. From the peaks of
both, least squares move the pitch, too. Moves that are all alike hardly tell a pitch of the travel more or less; then
the neighbours are tried as well, and the edges of the counts decide."""
PAGE = Page("terms", "Which terms does a drive have?", INTRODUCTION, by_name(STUDY), 1)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the study and writes the page; returns the exit code."""
    return PAGE.main(__doc__, arguments)


if __name__ == "__main__":
    sys.exit(main())
