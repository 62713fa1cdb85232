"""Figure 2: the designed input, and inputs that are designed with a mass that is 20 % wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pmfid.design.simulated import simulate
from pmfid.simulation import CART, CART_INCREMENTS
from studies.paper.drawing import Motions, write_motions
from studies.paper.figure import PaperFigure, Results, Task
from studies.paper.inputs import STROKE, designed, information, problem
from studies.paper.merit import Merit

#: Assumption on the mass -> assumed mass over its true value.
GUESSES = {"nominal mass": 1.0, "mass 20 % too large": 1.2, "mass 20 % too small": 0.8}


def tasks(seeds: int) -> list[Task]:
    """Return one task for each guess, because nothing is random."""
    return [(label,) for label in GUESSES]


def work(label: str) -> tuple[float, float, float]:
    """Return the information of the design on the true plant [1/kg^2], and its error at the end [m]."""
    u = designed(GUESSES[label] * CART.mass)
    return *information(u), float(simulate(problem(), u).x[-1]) - STROKE


def rows(results: Results) -> list[Merit]:
    """Return the rows; the loss is relative to the design for the nominal mass, and negative beyond the end."""
    nominal = results["nominal mass",][0]
    return [
        Merit(
            "2",
            "designed input",
            label,
            CART_INCREMENTS,
            1,
            information=known,
            joint=joint,
            loss=100 * (1 - known / nominal),
            terminal=1000 * missed,
        )
        for (label,), (known, joint, missed) in results.items()
    ]


def draw(out: Path) -> list[Path]:
    """Draw the inputs and the motion of the true plant under each."""
    inputs = {label: designed(guess * CART.mass) for label, guess in GUESSES.items()}
    each = problem().samples_per_interval
    held = {label: np.append(np.repeat(u, each), u[-1]) for label, u in inputs.items()}
    motions = {label: simulate(problem(), u) for label, u in inputs.items()}
    t = motions["nominal mass"].t
    return write_motions(Motions("figure2", t, held, {label: m.x for label, m in motions.items()}), out)


FIGURE = PaperFigure(
    "2",
    "Input designed for the nominal mass and for one that is 20 % wrong, and the cart's motion under each.",
    tasks,
    work,
    rows,
    draw,
)
