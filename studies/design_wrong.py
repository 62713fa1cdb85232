"""A design for the wrong mass (paper, figure 2): its loss, the cost of a robust design, the gain of a second round."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.figure import Figure

from pmfid.design.problem import Design, Problem
from pmfid.design.rounds import sequential, simulated_experiment
from pmfid.design.simulated import simulate, simulated_information
from pmfid.design.solver import solve
from pmfid.report.figures import COLOURS, MAGENTA, figure_style
from pmfid.report.tuning import TUNING
from pmfid.types import Floats
from studies.design_case import NOMINAL, STARTS, case

WRONG = (0.8, 0.9, 1.0, 1.1, 1.2)
#: Allowed errors at the end of a scenario: position [m] and velocity [m/s].
END_TOLERANCE = (0.01, 0.01)
#: Violation of a limit [m, m/s] that rounding explains.
ROUNDING = 1e-9


@dataclass(frozen=True)
class Outcome:
    """A run on an axis.

    `information` is the information on the mass over the optimum. `end` and `highest` are positions [m]. `slowest` is
    the least velocity between the ends, and `end_velocity` the velocity at the end [m/s].
    """

    information: float
    end: float
    highest: float
    slowest: float
    end_velocity: float

    def row(self) -> list[str]:
        """Return the cells: information, end, error of the end in percent of 0.4 m, highest, slowest, end velocity."""
        error = 100 * (self.end / 0.4 - 1)
        numbers = [f"{self.information:.3f}", f"{self.end:.4f}", f"{error:+.2f} %"]
        return [*numbers, f"{self.highest:.4f}", f"{self.slowest:.4f}", f"{self.end_velocity:.4f}"]


HEADER = ("information / optimum", "end [m]", "error", "highest [m]", "slowest [m/s]", "velocity at end [m/s]")


def outcome(problem: Problem, u: Floats, optimum: float) -> Outcome:
    """Simulate the input u (n,) on the axis with the problem's nominal values, with stiction."""
    motion = simulate(problem, u)
    information = float(simulated_information(problem, u)[0, 0]) / optimum
    return Outcome(
        information,
        float(motion.x[-1]),
        float(motion.x.max()),
        float(motion.v[1:-1].min()),
        float(motion.v[-1]),
    )


def for_mass(problem: Problem, mass: float) -> Problem:
    """Return the same problem with another nominal mass [kg]."""
    return replace(problem, nominal={**problem.nominal, "mass": mass})


def optimum(problem: Problem) -> Design:
    """Return the best input for the trace on the mass."""
    return solve(problem, "trace", starts=STARTS)


def wrong_masses() -> Iterator[list[str]]:
    """Yield rows with the ratio of the design's mass to the true mass, and the cells of an outcome."""
    problem = case("m")
    best = float(optimum(problem).fisher[0, 0])
    for factor in WRONG:
        design = optimum(for_mass(problem, factor * NOMINAL["mass"]))
        yield [f"{factor:.1f}", *outcome(problem, design.u, best).row()]


def robust_problem() -> Problem:
    """Return the case with limits that hold for a mass that is wrong by 20 % in either direction."""
    scenarios: tuple[Mapping[str, float], ...] = tuple({"mass": factor * NOMINAL["mass"]} for factor in (0.8, 1.2))
    return replace(case("m"), scenarios=scenarios, end_tolerance=END_TOLERANCE)


def robust() -> Iterator[list[str]]:
    """Yield rows: ratio of the true mass to the design's mass, cells of the robust design's outcome, violation of a
    limit.
    """
    problem = case("m")
    design = optimum(robust_problem())
    for factor in WRONG:
        true = for_mass(problem, factor * NOMINAL["mass"])
        found = outcome(true, design.u, float(optimum(true).fisher[0, 0]))
        yield [f"{factor:.1f}", *found.row(), "yes" if breaks(problem, found) else "no"]


def breaks(problem: Problem, found: Outcome) -> bool:
    """Return whether an outcome violates the limits of the case, with END_TOLERANCE at the end."""
    low, high = problem.limits.pair("position") or (-np.inf, np.inf)
    missed = (
        abs(found.end - high) > END_TOLERANCE[0] + ROUNDING or abs(found.end_velocity) > END_TOLERANCE[1] + ROUNDING
    )
    slow = found.slowest < problem.limits.min_speed - ROUNDING
    return missed or slow or found.highest > high + ROUNDING or found.highest < low - ROUNDING


def rounds(seeds: int, number: int = 2) -> Iterator[list[str]]:
    """Yield rows for the worst seed: believed over true mass, round, mass after the round, cells of the outcome."""
    problem = case("m")
    best = float(optimum(problem).fisher[0, 0])
    for factor in (0.8, 1.2):
        start = for_mass(problem, factor * NOMINAL["mass"])
        histories = [_history(problem, start, seed, number) for seed in range(seeds)]
        for k in range(number):
            outcomes = [outcome(problem, designs[k].u, best) for designs, _ in histories]
            error = max(abs(masses[k] / NOMINAL["mass"] - 1) for _, masses in histories)
            worst = max(outcomes, key=lambda each: abs(each.end - 0.4))
            least, most = (pick(each.information for each in outcomes) for pick in (min, max))
            yield [f"{factor:.1f}", str(k + 1), f"{least:.4f} to {most:.4f}", *worst.row()[1:3], f"{100 * error:.4f} %"]


def _history(problem: Problem, start: Problem, seed: int, number: int) -> tuple[list[Design], list[float]]:
    """Return the designs of the rounds, and the mass after each round."""
    truth = dict(problem.nominal)
    experiment = simulated_experiment(start, truth, np.random.default_rng(seed))
    state = sequential(start, experiment, {"mass": 1e-12}, criterion="trace", rounds=number, seed=seed)
    designs = [each.design for each in state.rounds if each.design is not None]
    return designs, [each.known.parameters["mass"] for each in state.rounds]


def wrong_mass_figure(factor: float = 1.2) -> Figure:
    """Draw paper figure 2: input, velocity and position on the axis, designed for the true mass and for a wrong one."""
    problem = case("m")
    designs = {
        "nominal mass": optimum(problem),
        f"mass wrong by {100 * (factor - 1):+.0f} %": optimum(for_mass(problem, factor * NOMINAL["mass"])),
    }
    with figure_style():
        figure = Figure(figsize=(TUNING.figures_width, 5.4), layout="constrained")
        panels = figure.subplots(3, 1, sharex=True)
        for (name, design), (colour, style) in zip(
            designs.items(), ((COLOURS[0], "-"), (COLOURS[1], "--")), strict=True
        ):
            motion = simulate(replace(problem, samples_per_interval=10), design.u)
            panels[0].stairs(design.u, problem.t, baseline=None, color=colour, ls=style, lw=1.5, label=name)
            panels[1].plot(motion.t, motion.v, color=colour, ls=style)
            panels[2].plot(motion.t, motion.x, color=colour, ls=style)
        panels[2].axhline(0.4, color=MAGENTA, ls=":", lw=1)
        for axes, label in zip(panels, ("input [V]", "velocity [m/s]", "position [m]"), strict=True):
            axes.set_ylabel(label)
        panels[2].set_xlabel("time [s]")
        panels[2].margins(x=0.01)
        figure.legend(loc="outside upper center", ncols=2)
    return figure
