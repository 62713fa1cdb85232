"""Design, run, estimate, and design again: the remedy for a poor first guess (paper, section II)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pmfid.design.calibration import Calibration, Run, calibrate
from pmfid.design.problem import InfeasibleError, Problem
from pmfid.design.result import Design
from pmfid.design.simulated import simulate
from pmfid.design.solver import solve
from pmfid.errors import UsageError

__all__ = ["Commissioning", "Experiment", "Round", "redesign", "sequential", "simulated_experiment"]

#: Makes the run of a design: on a machine, from a file, or simulated.
Experiment = Callable[[Design], Run]


@dataclass(frozen=True, eq=False)
class Round:
    """run: an experiment; known: what all runs so far say after it; design: what the run was made for, None where that
    is not recorded."""

    run: Run
    known: Calibration
    design: Design | None = None


@dataclass(frozen=True, eq=False)
class Commissioning:
    """Rounds so far, the standard deviations {unknown parameter: its unit} that are wanted, and the next design, None
    where it is not needed or was not asked for."""

    problem: Problem
    wanted: Mapping[str, float]
    rounds: tuple[Round, ...]
    next: Design | None = None

    @property
    def reached(self) -> bool:
        """Whether every wanted standard deviation is reached; False without a round or a wish."""
        return bool(self.rounds and self.wanted) and reached(self.problem, self.rounds[-1].known, self.wanted)

    def to_json(self) -> dict[str, Any]:
        """The object that `--json` prints."""
        return {
            "reached": self.reached,
            "wanted": dict(self.wanted),
            "rounds": [self._round(each) for each in self.rounds],
            "next": None if self.next is None else {"value": self.next.value, "predicted_std": self.next.predicted_std},
        }

    def _round(self, each: Round) -> dict[str, Any]:
        std = each.known.std(self.problem.names)
        values = {name: {"value": each.known.parameters[name], "std": std[name]} for name in self.problem.names}
        travel = float(each.run.y[-1] - each.run.y[0])
        return {"parameters": values, "inflation": each.known.inflation, "travel": travel}


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
) -> Commissioning:
    """Rounds of design, experiment and estimate until every wanted standard deviation is reached, at most `rounds`.

    wanted: {unknown parameter: standard deviation, its unit}; empty: all the rounds. The first design is for the
    problem's nominal values and prior; the prior belongs to the nominal values as an earlier estimate does. Raises
    UsageError for a wrong `wanted`, and as `solve`, `calibrate` and the experiment do.
    """
    _check_wanted(problem, wanted, rounds)
    done: list[Round] = []
    current = problem
    while len(done) < rounds and not (done and wanted and reached(problem, done[-1].known, wanted)):
        design = solve(current, criterion, combination=combination, starts=starts, seed=seed + len(done))
        run = experiment(design)
        known = calibrate(problem, [*(each.run for each in done), run])
        done.append(Round(run, known, design))
        current = known.update(problem)
    return Commissioning(problem, wanted, tuple(done))


def redesign(
    problem: Problem,
    runs: Sequence[Run],
    wanted: Mapping[str, float],
    *,
    criterion: str = "D",
    combination: Mapping[str, float] | None = None,
    starts: int = 20,
    seed: int = 0,
) -> Commissioning:
    """What recorded runs say, and the design of the next one where they do not yet say enough.

    Without a wanted standard deviation there is always a next design. Raises as `sequential` does.
    """
    _check_wanted(problem, wanted, 1)
    rounds = (Round(runs[-1], calibrate(problem, runs)),) if runs else ()
    state = Commissioning(problem, wanted, rounds)
    if state.reached:
        return state
    current = rounds[-1].known.update(problem) if rounds else problem
    try:
        found = solve(current, criterion, combination=combination, starts=starts, seed=seed + len(runs))
    except InfeasibleError as error:
        if not rounds:
            raise
        said = ", ".join(f"{name} = {rounds[-1].known.parameters[name]:.6g}" for name in problem.names)
        raise InfeasibleError(f"the runs say {said}; with that {error}", error.relaxations) from None
    return replace(state, next=found)


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
