"""Compare the claims of `pmfid design SPEC RECORD` to many runs, on machines from 1 kg to 500 kg."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from pmfid.design.appraisal import USUAL, Choice, choose
from pmfid.design.body import simulate
from pmfid.design.calibration import DesignedRun, RunsEstimate, calibrate
from pmfid.design.problem import Limits, Problem
from pmfid.design.solver import solve
from pmfid.design.standard import standard_inputs
from pmfid.encoder import quantize
from pmfid.models.drive import Drive
from pmfid.simulation.drive import DriveParameters, Machine, drive_machine
from pmfid.types import Flags, Floats
from studies.paper.truth import table
from studies.sections import write_page

NAMES = ("mass", "viscous_friction", "coulomb_friction")
STARTS = 10
#: Largest relative error of the data sheet.
WRONG = 0.1
#: Position samples per interval of the input.
SAMPLES = 5
#: Seconds for the proof of a bound.
SECONDS = 10.0


def machine(
    values: tuple[float, float, float],
    gain: float,
    motion: tuple[float, float],
    highest: float,
    resolution: float,
    *,
    intervals: int = 40,
    min_speed: float = 0.01,
) -> Problem:
    """Return a motion forward from rest to rest; `motion` is (way [m], time [s]), `highest` bounds the input.

    `resolution` is in m per count.
    """
    way, duration = motion
    return Problem(
        Drive(gain),
        dict(zip(NAMES, values, strict=True)),
        NAMES,
        duration,
        intervals,
        Limits(input=highest, position=(0.0, way), min_speed=min_speed),
        resolution=resolution,
        end=(way, 0.0),
        samples_per_interval=SAMPLES,
    )


#: SI units; rotary: kg m2, N m s, N m, rad.
MACHINES = {
    "1 kg": machine((1.0, 8.0, 0.6), 2.0, (0.4, 2.0), 6.0, 22.75e-6),
    "10 kg": machine((10.0, 25.0, 6.0), 8.0, (0.6, 2.0), 6.0, 5e-6),
    "40 kg": machine((40.0, 80.0, 15.0), 20.0, (0.4, 2.0), 10.0, 30e-6),
    "500 kg": machine((500.0, 1500.0, 120.0), 150.0, (1.0, 4.0), 10.0, 70e-6),
    "rotary": machine((2e-3, 5e-3, 0.02), 0.1, (6.28, 1.0), 5.0, 2 * np.pi / 4096, min_speed=0.1),
    "spindle": machine((0.05, 0.02, 0.3), 1.0, (20.0, 2.0), 5.0, 2 * np.pi / 10000, min_speed=0.2),
    "8 kg, 2 mm": machine((8.0, 30.0, 4.0), 5.0, (0.5, 3.0), 10.0, 2e-3, intervals=60, min_speed=0.02),
    "150 kg, slow": machine((150.0, 900.0, 200.0), 60.0, (0.3, 5.0), 12.0, 10e-6, intervals=50, min_speed=0.005),
}
#: Machines that no setting was tuned on.
HELD_BACK = ("10 kg", "spindle", "8 kg, 2 mm")


@dataclass(frozen=True, eq=False)
class Claims:
    """The claims on runs of one input, relative to the true values.

    `errors` and claimed deviations `stds` are (runs, p). `inside` is whether the interval holds the truth (runs, p).
    `unmodelled` (runs,) is whether the fit doubts the model.
    """

    errors: Floats
    stds: Floats
    inside: Flags
    unmodelled: Flags

    @property
    def scatter(self) -> Floats:
        """The root mean square of the errors (p,)."""
        return np.asarray(np.sqrt(np.mean(self.errors**2, axis=0)))


def truth_of(problem: Problem, rng: np.random.Generator) -> dict[str, float]:
    """Return a machine within WRONG of its data sheet."""
    return {name: value * (1.0 + WRONG * rng.uniform(-1.0, 1.0)) for name, value in problem.nominal.items()}


def drive_of(problem: Problem) -> DriveParameters:
    """Return the nominal machine of a problem."""
    mass, viscous, coulomb = (problem.nominal[name] for name in NAMES)
    return DriveParameters(mass, viscous, coulomb, problem.drive.equation.input_gain)


def commissioned(problem: Problem, u: Floats, seed: int) -> tuple[RunsEstimate, dict[str, float]]:
    """Return the estimate from one run of a machine that differs from its data sheet, from a random encoder phase."""
    rng = np.random.default_rng(seed)
    truth = truth_of(problem, rng)
    motion = simulate(problem, u, truth)
    resolution = float(problem.resolution or 1.0)
    counts = quantize(motion.x + rng.uniform(0.0, resolution), resolution)
    run = DesignedRun(motion.u, np.asarray(counts * resolution, float), problem.dt / problem.samples_per_interval)
    return calibrate(problem, [run]), truth


def claims(problem: Problem, u: Floats, runs: int) -> Claims:
    """Return the claims on `runs` machines; run k has seed k."""
    errors, stds, inside, missing = [], [], [], []
    for seed in range(runs):
        known, truth = commissioned(problem, u, seed)
        std = known.std(problem.names)
        errors.append([known.parameters[name] / truth[name] - 1.0 for name in problem.names])
        stds.append([std[name] / truth[name] for name in problem.names])
        inside.append([known.interval[name][0] <= truth[name] <= known.interval[name][1] for name in problem.names])
        missing.append(known.unmodelled)
    return Claims(np.array(errors), np.array(stds), np.array(inside), np.array(missing))


def chosen(problem: Problem) -> Choice:
    """Return the first choice of `pmfid design SPEC RECORD`."""
    return choose(solve(problem, "D", starts=STARTS))


def honesty(runs: int) -> Iterator[list[str]]:
    """Yield rows on each machine and input; each figure is for m, d, F_c.

    The figures are: truth in the claimed interval, within 1.96 deviations, error over claimed deviation, deviation [%],
    and observed gain over the trapezoid.
    """
    for name, problem in MACHINES.items():
        choice = chosen(problem)
        usual = standard_inputs(problem, names=(USUAL,))[USUAL].u
        best = claims(problem, choice.design.u, runs)
        other = best if choice.name == USUAL else claims(problem, usual, runs)
        gain = _cell(other.scatter / best.scatter, 2)
        yield [name, choice.name.replace("_", " "), *_cells(best), gain]
        if other is not best:
            yield [name, USUAL, *_cells(other), ""]


def _cells(found: Claims) -> list[str]:
    ratio = np.sqrt(np.mean((found.errors / found.stds) ** 2, axis=0))
    within = np.mean(np.abs(found.errors) <= 1.96 * found.stds, axis=0)
    shares = [_cell(100 * found.inside.mean(axis=0), 0), _cell(100 * within, 0)]
    return [*shares, _cell(ratio, 2), _cell(100 * found.scatter, 4)]


def proofs() -> Iterator[list[str]]:
    """Yield rows: machine, criterion D, proved gap [%] after SECONDS of processor time, total seconds."""
    for name, problem in MACHINES.items():
        design = solve(problem, "D", starts=STARTS, certify=SECONDS)
        yield [name, f"{design.value:.4g}", f"{100 * (design.gap or 0.0):.1f} %", f"{design.solve_seconds:.1f}"]


def wrong_models(runs: int) -> Iterator[list[str]]:
    """Yield rows: machine, step [um], unmodelled effect, doubted runs, median errors over claimed deviations."""
    for name in ("1 kg", "40 kg"):
        for coarser in (1.0, 30.0):
            problem = replace(MACHINES[name], resolution=coarser * float(MACHINES[name].resolution or 1.0))
            u = standard_inputs(problem, names=(USUAL,))[USUAL].u
            for lack in ({}, {"stribeck": 0.3}, {"quadratic": 0.15}, {"dead_time": 0.3}):
                yield [name, f"{1e6 * float(problem.resolution or 0.0):g}", *_fit_unmodelled(problem, u, lack, runs)]


def _fit_unmodelled(problem: Problem, u: Floats, lack: dict[str, float], runs: int) -> list[str]:
    """Return a row; `lack` has Stribeck over Coulomb, quadratic over viscous friction at 0.3 m/s, dead time in
    samples.
    """
    dt, resolution = problem.dt / problem.samples_per_interval, float(problem.resolution or 1.0)
    sizes = {"stribeck": problem.nominal["coulomb_friction"], "quadratic": problem.nominal["viscous_friction"] / 0.3}
    axis = Machine(drive_of(problem), **{key: value * sizes.get(key, dt) for key, value in lack.items()})
    held = np.r_[np.repeat(u, problem.samples_per_interval), 0.0]
    ratios, missing = [], []
    for seed in range(runs):
        phase = np.random.default_rng(seed).uniform(0.0, resolution)
        run = drive_machine(axis, held, dt, resolution, phase=phase)
        known = calibrate(problem, [DesignedRun(run.u, np.asarray(run.counts * resolution, float), dt)])
        std = known.std(problem.names)
        ratios.append([abs(known.parameters[name] - problem.nominal[name]) / std[name] for name in problem.names])
        missing.append(known.unmodelled)
    what = ", ".join(f"{key.replace('_', ' ')} {value:g}" for key, value in lack.items()) or "nothing"
    return [what, f"{np.mean(missing):.0%}", _cell(np.median(ratios, axis=0), 1)]


def _cell(values: Floats, digits: int) -> str:
    return ", ".join(f"{value:.{digits}f}" for value in values)


INTRODUCTION = """
# Is what `pmfid design SPEC RECORD` claims true?

One run each on {runs} simulated machines within {wrong:.0%} of their data sheet, from random phases of the encoder,
{samples} position samples per interval; unknown m, d, F_c, criterion D. The input is what `pmfid design SPEC RECORD`
runs first; below it the trapezoid. *Inside*: runs whose 95 % interval holds the truth. *1.96*: runs within N
deviations. *Error / claimed*: root mean square. *Gain*: error with the trapezoid over that with the chosen input. All
for m, d, F_c in turn; no setting was looked for with the machines {held}.
"""
PROOFS = """
## How near the optimum is

Proved gap after at most {seconds:g} s of the processor:
"""
WRONG_MODELS = """
## When the machine is not the model

The trapezoid on machines with more friction at rest (Stribeck, a part of F_c), drag that grows with the square of the
speed (a part of d at 0.3 m/s) or a dead time (samples). *Doubted*: share of runs in which the fit names a force that
the model lacks and that matters. The deviations contain such a force.
"""
HEADER = ("machine", "input", "inside [%]", "1.96 [%]", "error / claimed", "error [%]", "gain")


def page(runs: int = 100, few: int = 5) -> str:
    """Return the whole page; `few` is the number of runs of each wrong model."""
    held = "; ".join(HELD_BACK)
    lines = INTRODUCTION.format(runs=runs, wrong=WRONG, samples=SAMPLES, held=held).strip().splitlines()
    lines += ["", *table(HEADER, list(honesty(runs))), *PROOFS.format(seconds=SECONDS).splitlines(), ""]
    lines += [*table(("machine", "value of D", "gap", "time [s]"), list(proofs())), *WRONG_MODELS.splitlines(), ""]
    header = ("machine", "step [um]", "unmodelled effect", "doubted", "error / claimed m, d, F_c")
    lines += [*table(header, list(wrong_models(few)))]
    lines += [f"Written by `python -m studies.design_machines --out results/commissioning.md --runs {runs}`."]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    write_page(page, __doc__)
