"""The report of a search over a drive's terms, with tables, friction of the models, and numbers."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from pmfid.models.equation import (
    COULOMB_BACKWARD,
    COULOMB_FORWARD,
    MASS,
    VISCOUS_BACKWARD,
    VISCOUS_FORWARD,
    Equation,
)
from pmfid.pipeline.terms import NestedModel, TermSearch
from pmfid.report.figures import COLOURS, open_figure
from pmfid.report.html import Section, svg, write_json, write_report
from pmfid.report.tuning import TUNING
from pmfid.types import Floats

Rows = tuple[list[str], list[list[str]]]

BODY = {
    "inertia": (MASS,),
    "viscous": (VISCOUS_FORWARD, VISCOUS_BACKWARD),
    "Coulomb": (COULOMB_FORWARD, COULOMB_BACKWARD),
}


def write_terms(out: Path, found: TermSearch) -> None:
    """Write terms.html and terms.json into the folder `out`."""
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / "terms.json", found.to_json())
    sections = [Section("Models", "", model_rows(found)), Section("For AXIS.toml", code="\n".join(found.lines))]
    if found.weighed:
        sections.append(Section("Terms", TERMS, term_rows(found)))
    if any(model.balance is not None and model.balance.friction is not None for model in found.models):
        says = "Points: friction from the record, means over bins with standard errors. Lines: friction of each model."
        sections.append(Section("Friction over velocity", says, svg=svg(friction_figure(found))))
    sections.append(Section("Terms that were tried", STEPS, step_rows(found)))
    if found.hidden:
        sections.append(Section("Terms that this record would not show", HIDDEN, hidden_rows(found)))
    if found.notes:
        sections.append(Section("Notes", "\n\n".join(f"{note}." for note in found.notes), folded=True))
    lead = found.sentence, "Write the lines for AXIS.toml into its section [model]." if found.added else ""
    write_report(out / "terms.html", f"{found.name}: terms of the drive", sections, [one for one in lead if one])


TERMS = (
    "Values with standard errors. Held out: error of free runs over data outside the fits, with and without the term."
)
STEPS = (
    "gain: twice the gain of the log-likelihood, relative to chance; a term counts if it reaches the gain needed. held "
    "out: error of free runs over data outside the fit."
)
HIDDEN = "The search would find a missing term from this size on, which is four standard deviations of its score."


def model_rows(found: TermSearch) -> Rows:
    """Return the header and a row of text for each of the nested models."""
    own = found.model.equation.motion
    units = (own.of_inertia, f"{own.force} / ({own.speed})", own.force)
    body = [f"{name} [{unit}]" for name, unit in zip((own.inertia, *list(BODY)[1:]), units, strict=True)]
    header = ["model", "unexplained [%]", "at low speed [%]", "held out [counts]", "log-likelihood", *body]
    return header, [
        [
            model.label,
            *(_number(100 * part, 2) for part in model.unexplained),
            _number(model.error / found.resolution),
            f"{model.trial.log_likelihood:.1f}",
            *(_value(model, roles) for roles in BODY.values()),
        ]
        for model in found.models
    ]


def _value(model: NestedModel, roles: tuple[int, ...]) -> str:
    """Format a parameter with its standard error. A directional parameter has both values."""
    equation: Equation = model.trial.model.equation
    indices = dict.fromkeys(index for index in (equation.roles[role] for role in roles) if index is not None)
    std = None if model.fit is None else model.fit.theta_std
    return ", ".join(f"{model.trial.theta[i]:.4g}" + ("" if std is None else f" ± {std[i]:.2g}") for i in indices)


def term_rows(found: TermSearch) -> Rows:
    """Return the header and a row of text for each fitted term, with the terms of the chosen model first."""
    travel = found.model.equation.motion.travel
    header = ["set", "value", "verdict", f"held out, with / without [{travel}]"]
    return header, [
        [
            one.setting.replace(", ", ",\n"),
            "\n".join(_format_value(*value) for value in one.values) or "–",
            one.verdict,
            f"{_number(one.with_it)} / {_number(one.without)}",
        ]
        for one in found.weighed
    ]


def _format_value(name: str, value: float, std: float, unit: str) -> str:
    return f"{name} {value:.4g}" + (f" ± {std:.2g}" if math.isfinite(std) else "") + f" {unit}"


def step_rows(found: TermSearch) -> Rows:
    """Return the header and a row of text for each fitted term, step by step."""
    header = ["step", "set", "score", "gain", "needed", "held out", "verdict"]
    rows = []
    for number, tried in enumerate(found.terms.steps, 1):
        for step in tried:
            own = ", ".join(f"{key} = {value}" for key, value in step.candidate.change.items())
            numbers = (step.gain, step.needed, step.error)
            rows.append([str(number), own, f"{step.candidate.z:.1f}", *map(_number, numbers), step.verdict])
    return header, rows


def hidden_rows(found: TermSearch) -> Rows:
    """Return the header and a row of text for each term that the model does not have."""
    return ["term", "seen from"], [[one.says, f"{one.size:.2g} {one.unit}"] for one in found.hidden]


def _number(value: float, digits: int = 4) -> str:
    return f"{value:.{digits}g}" if math.isfinite(value) else "–"


def friction_figure(found: TermSearch) -> Figure:
    """Draw the friction over velocity, from the record at the chosen model's mass and from the models."""
    last = found.chosen.balance
    models = [(model.label, model.balance) for model in found.models if model.balance is not None]
    with open_figure(4.2) as (figure, (axes,)):
        speeds = np.zeros(0)
        if last is not None and last.friction is not None:
            left = last.friction.left
            speeds = left.x
            force = last.model_friction(left.x) + left.mean
            axes.errorbar(left.x, force, left.error, fmt="o", ms=3, color="black", label="the record", zorder=3)
        for number, (name, balance) in enumerate(models):
            colour = COLOURS[number % len(COLOURS)]
            for side in _sides(speeds):
                label = name if side[0] > 0 or not np.any(speeds > 0) else None
                axes.plot(side, balance.model_friction(side), color=colour, lw=1.2, label=label)
        axes.axhline(0, color="grey", lw=0.5)
        own = found.model.equation.motion
        axes.set_xlabel(f"velocity [{own.speed}]")
        axes.set_ylabel(f"friction [{own.force}]")
        axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=3, borderaxespad=0.2)
    return figure


def _sides(speeds: Floats) -> list[Floats]:
    """Return the velocities at which a curve is drawn, on either side of rest."""
    ends = float(np.min(speeds, initial=0.0)), float(np.max(speeds, initial=0.0))
    return [np.linspace(end / TUNING.terms_points, end, TUNING.terms_points) for end in ends if end]
