"""Design, run, estimate, and design again: the remedy for a poor first guess (paper, section II)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pmfid.design.calibration import Calibration, Run, calibrate
from pmfid.design.problem import Problem
from pmfid.design.result import Design
from pmfid.design.simulated import simulate
from pmfid.design.solver import solve
from pmfid.errors import UsageError

__all__ = ["Experiment", "Round", "reached", "redesign", "sequential", "simulated_experiment"]

#: Makes the run of a design: on a machine, from a file, or simulated.
Experiment = Callable[[Design], Run]


@dataclass(frozen=True, eq=False)
class Round:
    """design: made with what was known before the run; known: what all runs so far say after it."""

    design: Design
    run: Run
    known: Calibration


def sequential(
    problem: Problem,
    experiment: Experiment,
    wanted: Mapping[str, float],
    *,
    criterion: str = "D",
    combination: Mapping[str, float] | None = None,
    rounds: int = 10,
    starts: int = 20,
    seed: int = 0,
) -> tuple[Round, ...]:
    """Rounds of design, experiment and estimate until every wanted standard deviation is reached, at most `rounds`.

    wanted: {unknown parameter: standard deviation, its unit}. The first design is for the problem's nominal values and
    prior; the prior belongs to the nominal values as an earlier estimate does. Raises UsageError for a wrong `wanted`,
    and as `solve`, `calibrate` and the experiment do.
    """
    _check_wanted(problem, wanted, rounds)
    done: list[Round] = []
    current = problem
    while len(done) < rounds and not (done and reached(problem, done[-1].known, wanted)):
        design = solve(current, criterion, combination=combination, starts=starts, seed=seed + len(done))
        run = experiment(design)
        known = calibrate(problem, [*(each.run for each in done), run])
        done.append(Round(design, run, known))
        current = known.update(problem)
    return tuple(done)


def redesign(
    problem: Problem,
    runs: Sequence[Run],
    *,
    criterion: str = "D",
    combination: Mapping[str, float] | None = None,
    starts: int = 20,
    seed: int = 0,
) -> tuple[Calibration, Design]:
    """What recorded runs say, and the design of the next one. Raises as `calibrate` and `solve` do."""
    known = calibrate(problem, runs)
    return known, solve(known.update(problem), criterion, combination=combination, starts=starts, seed=seed + len(runs))


def reached(problem: Problem, known: Calibration, wanted: Mapping[str, float]) -> bool:
    """Whether every wanted standard deviation is reached."""
    std = known.std(problem.names)
    return all(std[name] <= value for name, value in wanted.items())


def simulated_experiment(problem: Problem, truth: Mapping[str, float], rng: np.random.Generator) -> Experiment:
    """Runs on a drive with the true parameters {name: value}, missing ones nominal, with stiction and the encoder.

    The encoder starts at a random phase of its lattice; without a resolution the noise is normal with the problem's
    variance.
    """

    def run(design: Design) -> Run:
        motion = simulate(replace(design.problem, nominal=problem.nominal), design.u, truth)
        if problem.resolution is None:
            y = motion.x + rng.normal(0.0, np.sqrt(problem.variance), motion.x.size)
        else:
            phase = rng.uniform(0.0, problem.resolution)
            y = (np.floor((motion.x + phase) / problem.resolution) + 0.5) * problem.resolution
        return Run(motion.u, y, problem.dt / problem.samples_per_interval)

    return run


def _check_wanted(problem: Problem, wanted: Mapping[str, float], rounds: int) -> None:
    strangers = [name for name in wanted if name not in problem.unknown]
    if strangers:
        raise UsageError(f"{strangers[0]} is not among the unknown parameters, {', '.join(problem.unknown)}")
    if not all(np.isfinite(value) and value > 0 for value in wanted.values()):
        raise UsageError(f"wanted standard deviations must be positive and finite, got {dict(wanted)}")
    if rounds < 1:
        raise UsageError(f"rounds must be at least 1, got {rounds}")
