"""Study of an unknown input gain with a known mass.

`python -m studies.known_mass --out results/known_mass.md`
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

import pmfid
from pmfid.diagnostics.tuning import TUNING
from pmfid.pipeline.result import Result
from pmfid.simulation import Schedule, prbs, quantize, simulate_drive
from pmfid.simulation.scenarios import change_parameters
from studies.friction_axes import BENCHES
from studies.machines import Axis, machine_record
from studies.paper.truth import CartRecord, Study, Task, table
from studies.sections import Page, by_name

#: Motion and encoder of each machine.
OFF_LINE = tuple(
    (bench, motion, increments)
    for (bench, motion), increments in zip(
        [(bench, motion) for motion in ("prbs", "stop-and-go") for bench in BENCHES],
        (4096, 256, 1024, 512, 2048, 1024, 4096, 512, 512, 1024, 4096, 256, 1024, 2048, 1024, 256),
        strict=True,
    )
)
METHODS = ("iv", "auto")
SEEDS, PART_OF_AUTO = 40, 4
#: Fraction of the force after the slip; fractions of the run before the slip, of the drift, and of the memory.
SLIPPED, BEFORE, DRIFT, MEMORY = 0.7, 1 / 3, 1 / 3, 0.06
LENGTH = 3


def estimated(axis: Axis, record: CartRecord, **settings: Any) -> Result:
    """Identify the gain with a given mass."""
    return pmfid.identify(
        record.u,
        record.counts,
        model=pmfid.Drive("estimate"),
        encoder=pmfid.Encoder(record.resolution),
        dt=axis.dt,
        cutoff=1 / (3 * axis.dt),
        given={"mass": axis.drive.mass},
        **settings,
    )


def off_line_tasks(seeds: int) -> list[Task]:
    return [
        (*case, method, seed)
        for case in OFF_LINE
        for method in METHODS
        for seed in range(seeds if method == "iv" else max(1, seeds // PART_OF_AUTO))
    ]


def off_line(bench: str, motion: str, increments: int, method: str, seed: int) -> tuple[float, float, float, str]:
    """Return the relative error of the gain, its standard deviation, its half interval, and the status."""
    axis = BENCHES[bench]
    record = machine_record(axis, "nothing", motion, increments, 500 + seed)
    result, gain = estimated(axis, record, method=method), axis.drive.input_gain
    half = TUNING.normal_95 * result.theta_std[-1]
    if result.interval_95 is not None and np.all(np.isfinite(result.interval_95[-1])):
        half = float(np.ptp(result.interval_95[-1])) / 2
    return result["input_gain"] / gain - 1, result.theta_std[-1] / gain, half / gain, ", ".join(result.status)


def write_off_line(seeds: int, results: Mapping[Task, Any]) -> list[str]:
    rows = []
    for case in OFF_LINE:
        for method in METHODS:
            runs = [found for task, found in results.items() if task[:4] == (*case, method)]
            error, std, half = np.array([run[:3] for run in runs]).T
            said = [word for run in runs for word in run[3].split(", ") if word]
            flags = ", ".join(f"{word} {said.count(word)}" for word in dict.fromkeys(said))
            rows.append(
                [
                    *map(str, case),
                    f"`{method}`",
                    str(len(runs)),
                    f"{100 * error.mean():+.3f} ± {100 * error.std():.3f}",
                    f"{100 * np.max(np.abs(error)):.3f}",
                    f"{100 * np.mean(np.abs(error) < TUNING.normal_95 * std):.0f}",
                    f"{100 * np.mean(np.abs(error) < half):.0f}",
                    flags or "–",
                ]
            )
    head = ["machine", "motion", "increments", "method", "runs", "gain: error [%]", "largest [%]"]
    return [
        "## Off-line",
        "",
        "Error of the gain, mean ± standard deviation over the seeds; covered: within 1.96 standard deviations, and "
        "within `interval_95`, which holds what the model may lack as well; flags: how many runs have them. The first "
        "estimate is with a gain of 1, whatever the machine's is.",
        "",
        *table([*head, "std covers [%]", "interval covers [%]", "flags"], rows),
    ]


def slipped(axis: Axis, drift: bool, seed: int) -> CartRecord:
    """Simulate a random binary input with 1024 increments; the belt slips after a third of the run, at once or
    slowly.
    """
    rng, n = np.random.default_rng([seed, 11]), LENGTH * axis.samples
    duration, resolution = n * axis.dt, 4 * axis.resolution
    steps = change_parameters(axis.drive, BEFORE * duration, input_gain=SLIPPED * axis.drive.input_gain).changes
    u = prbs(n, clock=axis.clock, amplitude=axis.volt, rng=rng)
    x = simulate_drive(Schedule(steps, (0.0, DRIFT * duration if drift else 0.0)), u, axis.dt).x
    return CartRecord(u, quantize(x, resolution, resolution * rng.random()), resolution)


def on_line_tasks(seeds: int) -> list[Task]:
    return [(bench, drift, seed) for bench in BENCHES for drift in (False, True) for seed in range(seeds)]


def on_line(bench: str, drift: bool, seed: int) -> tuple[float, ...]:
    """Return the relative error of the gain and its standard deviation, before the slip and at the end."""
    axis = BENCHES[bench]
    record, forgetting = slipped(axis, drift, seed), 1 - 1 / (MEMORY * LENGTH * axis.samples)
    encoder = pmfid.Encoder(record.resolution)
    riv = pmfid.RIV(pmfid.Drive(1.0), encoder, axis.dt, 1 / (3 * axis.dt), forgetting=forgetting)
    belt = pmfid.Known(riv, given={"mass": axis.drive.mass}, find_gain=True)
    track = belt.run(riv, record.u, record.counts)
    found: list[float] = []
    for sample, part in ((int(BEFORE * record.u.size) - 2, 1.0), (-1, SLIPPED)):
        true = part * axis.drive.input_gain
        found += [track["input_gain"][sample] / true - 1, track.theta_std[sample, -1] / true]
    return tuple(found)


def write_on_line(seeds: int, results: Mapping[Task, Any]) -> list[str]:
    rows = []
    for bench in BENCHES:
        for drift in (False, True):
            runs = np.array([found for task, found in results.items() if task[:2] == (bench, drift)])
            cells = []
            for error, std in (runs[:, :2].T, runs[:, 2:].T):
                cells += [f"{100 * error.mean():+.2f} ± {100 * error.std():.2f}", f"{100 * np.median(std):.2f}"]
                cells.append(f"{100 * np.mean(np.abs(error) < TUNING.normal_95 * std):.0f}")
            rows.append([bench, "drift" if drift else "step", *cells])
    head = ["machine", "slip", "before: error [%]", "std [%]", "covered [%]", "after: error [%]", "std [%]"]
    return [
        "## On-line: a belt that slips",
        "",
        f"`riv`, {seeds} seeds, random binary input, 1024 increments; the memory is {100 * MEMORY:g} % of the run. "
        f"After a third of it {100 * SLIPPED:g} % of the force arrive, at once or coming over another third; before "
        "that, and at the end. std: the median.",
        "",
        *table([*head, "covered [%]"], rows),
    ]


INTRODUCTION = """\
The equation of a machine, mass x'' + friction = gain u, tells ratios alone: with another gain the same motion has all
forces in proportion. Whoever knows one of them, the mass from a scale or a drawing, has the gain from it:
`input_gain = "estimate"` in [model] and `given = { mass = 1.25 }` in [estimator].

- **The error of the gain is that of the mass**, relative, and so is its error bar. A wrong value in `given` is in no
  error bar: 1 % more mass is 1 % more gain, and nothing shows it. Where the value has an error, give a prior in its
  place, `prior = { mass = [1.25, 0.02] }`.
- **Two known forces can contradict each other**: the status then has `prior_contradicted`, and a note says by how much.
- **Under position control** through a coarse encoder the std is too short here as it is for every mass, and the status
  says `feedback`; `interval_95` holds.
- **On-line** a slipping belt is a gain that falls while the mass stays; `pmfid monitor` names it, and never the mass.
"""
PAGE = Page(
    "known_mass",
    "Known mass, unknown gain",
    INTRODUCTION,
    by_name(
        Study("off-line", off_line_tasks, off_line, write_off_line),
        Study("on-line", on_line_tasks, on_line, write_on_line),
    ),
    SEEDS,
    {"on-line": 0.5},
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study, write the page, and return the exit code."""
    return PAGE.main(__doc__, arguments)


if __name__ == "__main__":
    sys.exit(main())
