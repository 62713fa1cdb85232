"""The gain of designed inputs, and the truth of their predictions."""

from __future__ import annotations

from collections.abc import Iterator

from studies import design_case, design_runs, design_wrong
from studies.paper.truth import table
from studies.sections import write_page


def measured(runs: int) -> Iterator[str]:
    """Yield the lines of the measured results."""
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


GAINS = """
# Designed inputs, measured

All on the case of `examples/cart_design.toml`. Parameters are scaled by their nominal values.

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
Two rounds of `pmfid design SPEC RECORD` on the simulated axis, over ten start phases of the encoder (information: least
and most of them; end: the worst):
"""
EXPERIMENTS = """
## Are the predicted deviations true?

{runs} simulated experiments for each line, an encoder of {increments} increments (91 micrometres per count) that starts
at a random phase, unknown m, d, F_c, criterion D. `commission` is the estimate of `pmfid design SPEC RECORD`, which
knows that the axis starts at rest; `interval` is the general estimator, which does not; `least squares` takes the error
of the counts for white noise; `white noise` is least squares where
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


def page(runs: int = 500) -> str:
    lines = [
        *measured(runs),
        f"Written by `python -m studies.design --out results/design.md --runs {runs}`.",
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    write_page(page, __doc__)
