"""Rounds of design, run and estimate, as the remedy for a poor first guess (paper, section II)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pmfid.design.appraisal import Choice, choose
from pmfid.design.body import simulate
from pmfid.design.calibration import DesignedRun, RunsEstimate, calibrate
from pmfid.design.problem import Design, InfeasibleError, Problem
from pmfid.design.ranking import rank
from pmfid.design.solver import solve
from pmfid.errors import UsageError
from pmfid.findings import Finding
from pmfid.fit.terms import SET

__all__ = ["Commissioning", "Experiment", "Round", "redesign", "sequential", "simulated_experiment"]


#: An experiment makes the run of a design on a machine, from a file, or by simulation.
Experiment = Callable[[Design], DesignedRun]


@dataclass(frozen=True, eq=False)
class Round:
    """A round with a run, the estimate `known` from all runs so far, and the design of the run, if known."""

    run: DesignedRun
    known: RunsEstimate
    design: Design | None = None


@dataclass(frozen=True, eq=False)
class Commissioning:
    """The rounds so far, and the choice of the next input.

    `wanted` maps each unknown parameter to its wanted standard deviation, in the parameter's unit. `choice` is None if
    the caller needs no next input, or asked for none.
    """

    problem: Problem
    wanted: Mapping[str, float]
    rounds: tuple[Round, ...]
    choice: Choice | None = None

    @property
    def next(self) -> Design | None:
        """Design of the next run, or None."""
        return None if self.choice is None else self.choice.design

    @property
    def doubts(self) -> tuple[str, ...]:
        """Findings against the estimate."""
        return tuple(_advise(one) for one in self._findings if one.severity != "note")

    @property
    def notes(self) -> tuple[str, ...]:
        """Effects that the intervals contain."""
        return tuple(one.text for one in self._findings if one.severity == "note")

    @property
    def _findings(self) -> tuple[Finding, ...]:
        return self.rounds[-1].known.findings if self.rounds else ()

    @property
    def reached(self) -> bool:
        """Whether every wanted standard deviation is reached, and no unmodelled effect matters.

        The value is False without a round or without a wanted deviation.
        """
        return bool(self.rounds and self.wanted) and is_reached(self.problem, self.rounds[-1].known, self.wanted)

    def to_json(self) -> dict[str, object]:
        """Return the object that `--json` prints."""
        return {
            "reached": self.reached,
            "wanted": dict(self.wanted),
            "rounds": [self._round(each) for each in self.rounds],
            "next": None if self.choice is None else self._next(self.choice),
            "doubts": list(self.doubts),
            "notes": list(self.notes),
        }

    @staticmethod
    def _next(choice: Choice) -> dict[str, object]:
        design = choice.design
        numbers: dict[str, object] = {"value": design.value, "predicted_std": design.predicted_std}
        expected = {name: std if np.isfinite(std) else None for name, std in choice.std.items()}
        return numbers | {"input": choice.name, "expected_std": expected}

    def _round(self, each: Round) -> dict[str, object]:
        std = each.known.std(self.problem.names)
        known = each.known
        values = {
            name: {"value": known.parameters[name], "std": std[name], "interval": list(known.interval[name])}
            for name in self.problem.names
        }
        travel = float(each.run.y[-1] - each.run.y[0])
        return {"parameters": values, "misfit": known.misfit, "travel": travel}


def sequential(
    problem: Problem,
    experiment: Experiment,
    wanted: Mapping[str, float],
    *,
    criterion: str = "D",
    rounds: int = 10,
    starts: int = 20,
    seed: int = 0,
) -> Commissioning:
    """Design, choose, run and estimate in rounds, until every wanted standard deviation is reached.

    The first design is for the problem's nominal values and prior. The prior counts as an earlier estimate with these
    nominal values.

    Parameters
    ----------
    problem
        Equation, parameters and limits.
    experiment
        Function that runs a `Design` and returns its `DesignedRun`, from a machine, a file, or `simulated_experiment`.
    wanted
        {unknown parameter: standard deviation in its unit}. If empty, all rounds are run.
    criterion, starts, seed
        Settings of `solve`.
    rounds
        Largest number of rounds, >= 1.

    Returns
    -------
    Commissioning
        Rounds so far, and `reached`; `rounds[-1].known` is the estimate from all runs.

    Raises
    ------
    UsageError
        If `wanted` or `rounds` is wrong. `solve`, `calibrate` and the experiment may raise other errors.

    References
    ----------
    Paper section II.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid import Drive
    >>> from pmfid.design import Limits, Problem, sequential, simulated_experiment
    >>> nominal = {"mass": 1.5, "viscous_friction": 6.0, "coulomb_friction": 0.6}
    >>> problem = Problem(
    ...     Drive(2.0), nominal, ("mass",), 2.0, 10, Limits(input=3.0, min_speed=0.01), resolution=1e-5, end=(0.4, 0.0)
    ... )
    >>> experiment = simulated_experiment(problem, {"mass": 1.8}, np.random.default_rng(0))
    >>> state = sequential(problem, experiment, {"mass": 0.01}, rounds=3, starts=3)
    >>> state.reached, round(state.rounds[-1].known.parameters["mass"], 2)
    (True, 1.8)
    """
    _check_wanted(problem, wanted, rounds)
    done: list[Round] = []
    current = problem
    while len(done) < rounds and not (done and wanted and is_reached(problem, done[-1].known, wanted)):
        design = _design(current, criterion, starts, seed + len(done))
        chosen = choose(design, seed).design
        run = experiment(chosen)
        known = calibrate(problem, [*(each.run for each in done), run])
        done.append(Round(run, known, chosen))
        current = known.update(problem)
    return Commissioning(problem, wanted, tuple(done))


def redesign(
    problem: Problem,
    runs: Sequence[DesignedRun],
    wanted: Mapping[str, float],
    *,
    criterion: str = "D",
    starts: int = 20,
    seed: int = 0,
) -> Commissioning:
    """Estimate from recorded runs, and design the next run if a wanted deviation is not yet reached.

    Without a wanted standard deviation, a next design always follows. Raises the errors of `sequential`.
    """
    _check_wanted(problem, wanted, 1)
    rounds = (Round(runs[-1], calibrate(problem, runs)),) if runs else ()
    state = Commissioning(problem, wanted, rounds)
    if state.reached:
        return state
    current = rounds[-1].known.update(problem) if rounds else problem
    try:
        design = _design(current, criterion, starts, seed + len(runs))
    except InfeasibleError as error:
        if not rounds:
            raise
        said = ", ".join(f"{name} = {rounds[-1].known.parameters[name]:.6g}" for name in problem.names)
        raise InfeasibleError(f"the runs give {said}; with these values {error}", error.relaxations) from None
    return replace(state, choice=choose(design, seed))


def is_reached(problem: Problem, known: RunsEstimate, wanted: Mapping[str, float]) -> bool:
    """Return whether every wanted standard deviation is reached, and no unmodelled effect matters."""
    std = known.std(problem.names)
    return not known.unmodelled and all(std[name] <= value for name, value in wanted.items())


def simulated_experiment(problem: Problem, truth: Mapping[str, float], rng: np.random.Generator) -> Experiment:
    """Return an experiment on a simulated drive, with stiction and the encoder.

    The encoder starts at a random phase of its lattice. Without a resolution, the noise is normal with the variance of
    the problem.

    Parameters
    ----------
    problem
        Equation, nominal parameters and encoder.
    truth
        True parameters {name: value}; missing ones are nominal.
    rng
        Random generator of the phase and the noise.

    Returns
    -------
    callable
        Function from a `Design` to its `DesignedRun`, for `sequential`.

    Examples
    --------
    >>> import numpy as np
    >>> from pmfid import Drive
    >>> from pmfid.design import Limits, Problem, evaluate, simulated_experiment
    >>> nominal = {"mass": 1.5, "viscous_friction": 6.0, "coulomb_friction": 0.6}
    >>> problem = Problem(Drive(2.0), nominal, ("mass",), 2.0, 10, Limits(input=3.0), resolution=1e-5)
    >>> experiment = simulated_experiment(problem, {"mass": 1.8}, np.random.default_rng(0))
    >>> run = experiment(evaluate(problem, np.full(10, 2.0)))
    >>> run.u.shape == run.y.shape, run.dt
    (True, 0.2)
    """

    def run(design: Design) -> DesignedRun:
        motion = simulate(replace(design.problem, nominal=problem.nominal), design.u, truth)
        if problem.resolution is None:
            y = motion.x + rng.normal(0.0, np.sqrt(problem.variance), motion.x.size)
        else:
            phase = rng.uniform(0.0, problem.resolution)
            y = (np.floor((motion.x + phase) / problem.resolution) + 0.5) * problem.resolution
        return DesignedRun(motion.u, y, problem.dt / problem.samples_per_interval)

    return run


def _advise(finding: Finding) -> str:
    """Return a finding as text. A further term belongs into the configuration of `identify`."""
    if finding.remedy.startswith(SET):
        return f"{finding.sentence}, but a design has no such term: run pmfid identify, and {finding.remedy}"
    return finding.text


def _design(problem: Problem, criterion: str, starts: int, seed: int) -> Design:
    """Return the best input that the search for the drive of a problem finds."""
    if problem.linear:
        return solve(problem, criterion, starts=starts, seed=seed)
    return rank(problem, criterion, seed=seed)["design"]


def _check_wanted(problem: Problem, wanted: Mapping[str, float], rounds: int) -> None:
    strangers = [name for name in wanted if name not in problem.unknown]
    if strangers:
        raise UsageError(f"{strangers[0]} is none of the unknown parameters; give one of {', '.join(problem.unknown)}")
    if not all(np.isfinite(value) and value > 0 for value in wanted.values()):
        raise UsageError(f"wanted standard deviations must be positive and finite, got {dict(wanted)}")
    if rounds < 1:
        raise UsageError(f"rounds must be at least 1, got {rounds}")
