"""The page on designed inputs: how to get one, and what was measured."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

from pmfid.design.trial.appraisal import Appraisal
from pmfid.paper.truth import table
from pmfid.report.design import criteria_table, std_table
from pmfid.session.design_run import appraised, designed
from pmfid.session.design_spec import Spec, load_spec
from studies import design_case, design_runs, design_wrong

SPEC = Path("examples/cart_design.toml")


def how_to(spec: Spec, text: str, appraisal: Appraisal) -> Iterator[str]:
    """Lines of the instructions; text: of the SPEC.toml."""
    yield from _paragraphs(INTRODUCTION)
    yield from ("```toml", *text.rstrip().splitlines(), "```", "")
    yield from _paragraphs(RUN)
    yield from table(*criteria_table(appraisal))
    yield from _paragraphs(DEVIATIONS)
    yield from table(*std_table(appraisal))
    yield from _paragraphs(ENCODER)
    yield from table(*std_table(appraisal, through_encoder=True))
    yield from _paragraphs(AFTER)
    yield from _paragraphs(PYTHON)


def measured(runs: int) -> Iterator[str]:
    """Lines of what was measured."""
    yield from _paragraphs(GAINS)
    header = ["unknown", "criterion", "value", *(name.replace("_", " ") for name in design_case.GAINS), "survives"]
    yield from table(header, list(design_case.gains()))
    yield from _paragraphs(TRAP)
    yield from table(["unknown", "criterion", "value / with least speed", "survives"], list(design_case.trap()))
    yield from _paragraphs(PATTERN)
    header = ["least speed", "counts per sample", "value of D", "std of m, d, F_c through the encoder / predicted"]
    yield from table(header, list(design_case.pattern()))
    yield from _paragraphs(WRONG)
    yield from table(["believed / true mass", *design_wrong.HEADER], list(design_wrong.wrong_masses()))
    yield from _paragraphs(ROBUST)
    yield from table(["true / believed mass", *design_wrong.HEADER, "breaks a limit"], list(design_wrong.robust()))
    yield from _paragraphs(ROUNDS)
    header = ["believed / true mass", "round", *design_wrong.HEADER[:3], "worst error of the mass after it"]
    yield from table(header, list(design_wrong.rounds(seeds=10)))
    yield from _paragraphs(EXPERIMENTS.format(runs=runs, increments=design_runs.INCREMENTS))
    header = ["sampling", "estimate", "input", "std of m, d, F_c [%]", "/ predicted", "/ start unknown", "/ encoder"]
    yield from table([*header, "failed", "gain", "predicted"], list(design_runs.experiments(runs)))
    yield from _paragraphs(EXPLANATION)


def _paragraphs(text: str) -> list[str]:
    return [*text.strip().splitlines(), ""]


INTRODUCTION = """
# From an axis data sheet to a commissioning motion

`pmfid design` finds the input that tells most about an axis and keeps it within its limits. It needs rough values of
what is to be found, as data sheets give them:

| what | from |
|---|---|
| `input_gain` | force per unit of the input: torque constant times 2 pi / lead of a screw, or over a pinion's radius |
| `mass` | everything that moves, with motor and coupling: inertia times (2 pi / lead)^2 |
| `viscous_friction`, `coulomb_friction` | friction torque over speed, of motor, screw and guides; the drag of seals |
| `resolution` | travel per count: lead over counts per turn, all edges counted |
| limits | peak voltage or torque, travel between the end switches, top speed, jerk; `rms`: what the motor bears long |

Write them into a file. This is `examples/cart_design.toml`:
"""
RUN = """
Leave `end` and `end_velocity` out where they are free. `min_speed` keeps the axis away from standstill, see below.
`[prior]` holds standard deviations that are known beforehand, `[robust]` by which part the values above may be wrong.
Then:

    pmfid design examples/cart_design.toml --out design-report

prints this table, tries to prove how near the optimum is, and writes a report, and `t, u, x, v` as CSV, the design's
and those of the standard inputs. Drive with `u`, or let a position controller follow `x` and `v`. `--motions 3` adds a
campaign: several motions that tell more together than the best one repeated.
"""
DEVIATIONS = """
*Gain* is the criterion of the design over that of a standard input within the same limits; *survives* is the part of
the information that is still there in a simulation with stiction. Standard deviations to be expected in percent, if the
error of the position were white and the start known (Cramér-Rao):
"""
ENCODER = """
And those of `pmfid commission` from the counts of this encoder, whose start and error are not white noise. Where the
design is worse than the trapezoid by these, a line recommends another input:
"""
AFTER = """
Run it, record `t, u, counts`, and let the next round use what is known by then:

    pmfid commission examples/cart_design.toml run1.csv --want mass=0.001 --out next

It estimates the unknown parameters from all runs so far: of all values whose motion passes through every count, the
mean, with the scatter as the deviation. It says whether the wanted standard deviation is reached, and if not writes the
next input: the design, one with another least speed, or a standard profile, whichever leaves the least open by these
counts, with no parameter worse than by the trapezoid. Where no motion of the model passes through all counts, the model
is wrong: a line says so, the deviations grow by what is missing, and beyond half a count nothing counts as reached.

Without a record it writes the first one; with `--truth mass=1.8` it plays all rounds on a simulated axis. The limits
cannot be met: exit code 3, and one line says which limit to relax and by how much.
"""
PYTHON = """
The same in Python:

```python
from pathlib import Path

import numpy as np
from pmfid.design import sequential, simulated_experiment, solve, standard_inputs
from pmfid.session.design_spec import load_spec, make_problem

problem = make_problem(load_spec(Path("examples/cart_design.toml")))
design = solve(problem, "D", starts=20, seed=0)  # t, u, x, v, fisher, value, predicted_std
trapezoid = standard_inputs(problem)["trapezoid"]  # u, x, v within the same limits

experiment = simulated_experiment(problem, {"mass": 1.8}, np.random.default_rng(0))  # or your machine: Design -> Run
state = sequential(problem, experiment, {"mass": 0.001}, rounds=5)
mass = state.rounds[-1].known.parameters["mass"]
```
"""
GAINS = """
# What was measured

All on the case above. Parameters are scaled by their nominal values.

## Gain over standard inputs

Pulses, PRBS, multisine and chirp do not end at rest at 0.4 m, nor do they keep the velocity positive; they are replaced
by the nearest input that does, which leaves little of some. `minimum time` is as far ahead as possible at any instant,
then creeps at the least speed.
"""
TRAP = """
## Without a least speed

With `min_speed = 0` the optimum parks at standstill with just the input that friction balances. There the linear
sensitivities promise information that stiction takes away. Part that survives, the least for parameters that are a
little smaller, larger, or both:
"""
PATTERN = """
At a whole number of counts per sample the encoder's error stays the same from sample to sample while the axis creeps.
Over machines that are known to 0.5 %, none of which comes to rest, little of that is left:
"""
WRONG = """
## A wrong mass

The trace criterion for the mass alone; the design is made for a wrong mass and run on the true axis, with stiction.
Where the design believed in too much mass, the axis goes too far, brakes too long and turns back; it breaks the limits,
and tells more than any input that keeps them.
"""
ROBUST = """
With `[robust] mass = 0.2` and `end_tolerance = [0.01, 0.01]` the limits hold for a mass that is wrong by 20 % either
way. Information is relative to the optimum for the true mass:
"""
ROUNDS = """
Two rounds of `pmfid commission` on the simulated axis, over ten start phases of the encoder (information: least and
most of them; end: the worst):
"""
EXPERIMENTS = """
## Are the predicted deviations true?

{runs} simulated experiments for each line, an encoder of {increments} increments (91 micrometres per count) that starts
at a random phase, unknown m, d, F_c, criterion D. `commission` is the estimate of `pmfid commission`, which knows that
the axis starts at rest; `interval` is the general estimator, which does not; `least squares` takes the error of the
counts for white noise; `white noise` is least squares where
the position has white noise of the encoder's variance in place of the encoder. *Gain*: size of the confidence ellipsoid
by its determinant, trapezoid over design, as observed and as predicted.
"""
EXPLANATION = """
The columns after the observed standard deviations divide them by those expected: for white noise and a known start, as
predicted; for white noise and an unknown start; and for the error that the encoder makes along this motion, from all
start phases alike, start unknown (`predicted_std_encoder` of `pmfid design` for `commission`, else that of least
squares).

With white noise the deviations are those of the second column: an encoder does not tell where it starts. On counts
least squares has those of the third: the encoder's error is not white, it repeats with the motion, which makes much of
the difference on the constant velocity of a trapezoid. `interval` takes the counts for the intervals that they are.
"""


def page(runs: int) -> str:
    """The whole page."""
    spec = load_spec(SPEC)
    appraisal = appraised(spec, designed(spec))
    lines = [
        *how_to(spec, SPEC.read_text(encoding="utf-8"), appraisal),
        *measured(runs),
        f"Written by `python -m studies.design --out docs/design.md --runs {runs}`.",
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Writes the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--runs", type=int, default=500)
    arguments = parser.parse_args()
    arguments.out.write_text(page(arguments.runs), encoding="utf-8")


if __name__ == "__main__":
    main()
