"""The report of a design."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pmfid.design.appraisal import Appraisal
from pmfid.design.fisher import CRITERIA
from pmfid.design.problem import Design, Problem
from pmfid.design.ranking import find_hidden
from pmfid.design.rounds import Commissioning
from pmfid.pipeline.designs import Comparison
from pmfid.presentation import plain_dict
from pmfid.report.figures import COLOURS, MAGENTA, Style, _legend, _words, open_figure
from pmfid.report.page import ResultPage, Section
from pmfid.types import Floats

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LINE_STYLES = ("-", "--", "-.", ":")

#: Map from the name to input (n,), position (n+1,) and velocity (n+1,).
Inputs = Mapping[str, tuple[Floats, Floats, Floats]]


def motion_figure(problem: Problem, inputs: Inputs) -> Figure:
    """Draw input, velocity and position over time, with dashed lines for their limits."""
    with open_figure(6.2, 3, sharex=True) as (figure, panels):
        for axes, label, limit in zip(
            panels,
            ("input [unit of u]", "velocity [m/s]", "position [m]"),
            ("input", "velocity", "position"),
            strict=True,
        ):
            axes.set_ylabel(label)
            for bound in problem.limits.pair(limit) or ():
                axes.axhline(bound, color=MAGENTA, ls="--", lw=1.0)
        if problem.limits.min_speed > 0:
            panels[1].axhline(problem.limits.min_speed, color=MAGENTA, ls=":", lw=1.0)
        for name, look in _looks(inputs):
            u, x, v = inputs[name]
            panels[0].stairs(u, problem.t, baseline=None, **look)
            panels[1].plot(problem.t, v, **look)
            panels[2].plot(problem.t, x, **look)
        panels[-1].set_xlabel("time [s]")
        panels[-1].margins(x=0.01)
        _legend(figure, panels)
    return figure


def _looks(names: Iterable[str]) -> list[tuple[str, Style]]:
    """Return name and style of each curve.

    The first curve, the design, is broad, so that it stays visible below a curve that covers it.
    """
    styles = cycle([(colour, style) for style in LINE_STYLES for colour in COLOURS])
    looks = []
    for number, (name, (colour, style)) in enumerate(zip(names, styles, strict=False)):
        words = name.replace("_", " ")
        looks.append((name, {"color": colour, "ls": style, "lw": 1.3 if number else 4.0, "label": words}))
    return looks


Rows = tuple[list[str], list[list[str]]]

#: Standard inputs in the figures next to the design. The tables have all standard inputs.
SHOWN = ("trapezoid", "s_curve", "minimum_time", "prbs")


def write_inputs(out: Path, found: Comparison) -> None:
    """Write design.csv and one CSV for each standard input into the folder `out`."""
    out.mkdir(parents=True, exist_ok=True)
    design = found["design"] if isinstance(found, dict) else found.design
    for name, columns in motions_of(found).items():
        _write_csv(out / f"{name.replace(',', '').replace(' ', '_')}.csv", design.t, *columns)


def design_page(found: Comparison) -> ResultPage:
    """Return the page of a design in comparison with the standard inputs."""
    return _ranking_page(found) if isinstance(found, dict) else _appraisal_page(found)


def _ranking_page(designs: dict[str, Design]) -> ResultPage:
    best = designs["design"]
    unseen = ", ".join(_words(name) for name in find_hidden(designs))
    header = ["input", f"criterion {best.criterion}", *(f"{_words(name)} [%]" for name in best.problem.unknown)]
    rows = [[name, f"{one.value:.3g}", *_parts(one)] for name, one in designs.items()]
    motions = dict(list(motions_of(designs).items())[: len(SHOWN)])
    sections = [
        Section("What each input shows: standard deviations after one run", _RANKING_TEXT, (header, rows)),
        Section("Input and motion", "Limits are dashed.", figure=lambda: motion_figure(best.problem, motions)),
    ]
    remarks = [f"warning: no input within these limits shows {unseen}; widen the limits, or give more time"]
    inputs = {name: {"value": one.value, "std": one.predicted_std} for name, one in designs.items()}
    data = plain_dict({"criterion": best.criterion, "inputs": inputs, "hidden": find_hidden(designs)})
    title = f"Input for {', '.join(_words(name) for name in best.problem.unknown)}: criterion {best.criterion}"
    return ResultPage("report", title, data, sections, remarks=remarks if unseen else [], data="design")


def _parts(design: Design) -> list[str]:
    """Return the deviations in percent of the nominal values, and a dash for more than the value itself."""
    nominal = design.problem.nominal
    parts = {name: std / (abs(nominal[name]) or math.inf) for name, std in design.predicted_std.items()}
    return [f"{100 * part:.2g}" if part < 1 else "-" for part in parts.values()]


_RANKING_TEXT = (
    "The input design is the best standard input after exchanges of its values. Deviations are those of least squares "
    "in percent of the nominal values, and a fit that explains each count reaches smaller ones. A dash stands for more "
    "than the value itself. No bound is proved, so another input may be better."
)


def _appraisal_page(appraisal: Appraisal) -> ResultPage:
    design = appraisal.design
    unknown = ", ".join(_words(name) for name in design.problem.unknown)
    title = f"Input for {unknown}: criterion {design.criterion}"
    remarks = [proof(design), recommendation(appraisal), *(f"warning: {text}" for text in appraisal.warnings)]
    return ResultPage("report", title, appraisal.to_dict(), _sections(appraisal), remarks=remarks, data="design")


def rounds_page(state: Commissioning) -> ResultPage:
    """Return the page of the estimates after each round, with the next step."""
    remarks = []
    if state.wanted and state.rounds:
        remarks.append(f"{'every wanted deviation is' if state.reached else 'a wanted deviation is not yet'} reached")
    remarks += [f"doubt: {text}" for text in state.doubts] + [f"note: {text}" for text in state.notes]
    if state.choice is not None:
        stds = state.choice.std.items()
        expected = ", ".join(
            f"{_words(name)} {f'{std:.3g}' if math.isfinite(std) else 'not known'}" for name, std in stds
        )
        remarks.append(f"next input ({state.choice.name}): standard deviations expected of one run: {expected}")
    heading = "After each round: value ± standard deviation"
    sections = [Section(heading, table=rounds_table(state))] if state.rounds else []
    return ResultPage("rounds", "Commissioning", state.to_json(), sections, remarks=remarks)


def _write_csv(path: Path, t: np.ndarray, u: np.ndarray, x: np.ndarray, v: np.ndarray) -> None:
    """Write the columns t, u, x, v at the nodes.

    The input of a row holds until the next row, and the last input is 0.
    """
    rows = zip(t.tolist(), [*u.tolist(), 0.0], x.tolist(), v.tolist(), strict=True)
    lines = ["t,u,x,v", *(",".join(repr(round(value, 12)) for value in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="ascii", newline="\n")


def criteria_table(appraisal: Appraisal) -> Rows:
    """Return a row for each input, with value, gain of the design, part that survives stiction, and change of the
    profile.
    """
    header = ["input", appraisal.design.criterion, "gain of design", "survives stiction", "profile"]
    rows = []
    for name in appraisal.ranking:
        worth = appraisal.worths[name]
        standard = appraisal.standard.get(name)
        bent = "" if standard is None else "bent" if standard.bent else "exact"
        gain = "" if standard is None or not math.isfinite(appraisal.gain[name]) else f"{appraisal.gain[name]:.3g}"
        rows.append([name.replace("_", " "), f"{worth.value:.4g}", gain, f"{worth.surviving:.3f}", bent])
    return header, rows


def std_table(appraisal: Appraisal, *, expected: bool = False) -> Rows:
    """Return the predicted standard deviations of the unknown parameters by input, in percent of the nominal values."""
    problem = appraisal.design.problem
    header = ["input", *(f"{_words(name)} [% of {problem.nominal[name]:.4g}]" for name in problem.unknown)]
    rows = []
    for key in appraisal.ranking:
        std = appraisal.expect_std(key) if expected else appraisal.worths[key].predicted_std
        rows.append([key.replace("_", " "), *(_percent(std[name], problem.nominal[name]) for name in problem.unknown)])
    return header, rows


def _percent(std: float, nominal: float) -> str:
    return f"{100 * std / abs(nominal):.3g}" if np.isfinite(std) and nominal else "-"


def _sections(appraisal: Appraisal) -> list[Section]:
    design = appraisal.design
    motions = {name: columns for name, columns in motions_of(appraisal).items() if name in ("design", *SHOWN)}
    problem = design.problem
    sections = [
        Section("Value of the design", _summary(appraisal), criteria_table(appraisal)),
        Section("Predicted standard deviations", _STD_TEXT, std_table(appraisal)),
        Section("Deviations of the fit of a record", _ENCODER_TEXT, std_table(appraisal, expected=True)),
        Section(
            "Input and motion",
            "Limits are dashed, the least speed is dotted.",
            figure=lambda: motion_figure(problem, motions),
        ),
    ]
    return sections


def recommendation(appraisal: Appraisal) -> str:
    """Return the recommended input, with the standard deviations that decide against the design."""
    best, problem = appraisal.recommended, appraisal.design.problem
    if best == "design":
        return "Recommended: design."
    other, own = appraisal.expect_std("design"), appraisal.expect_std(best)
    worst = max(problem.unknown, key=lambda name: other[name] / own[name] if np.isfinite(other[name]) else np.inf)
    left, right = (_percent(std[worst], problem.nominal[worst]) for std in (own, other))
    against = f"{right} % after the design" if right != "-" else "unknown after the design"
    return (
        f"Recommended: {best.replace('_', ' ')}. As estimated from one run, the standard deviation of {_words(worst)} "
        f"is {left} % after this input, and {against}."
    )


_STD_TEXT = (
    "The Cramér-Rao bound for one run, with what was known before: no unbiased estimate does better where the error of "
    "the position is white with the variance given and the start is known."
)


def rounds_table(state: Commissioning) -> Rows:
    """Return a row for each round, with parameters, standard deviations, travelled distance, and misfit.

    The misfit is the root mean square of the residual, over that of rounding or noise.
    """
    header = ["round", *(_words(name) for name in state.problem.names), "travel [m]", "misfit"]
    rows = []
    for number, each in enumerate(state.rounds, 1):
        std = each.known.std(state.problem.names)
        digits = {name: max(0, 1 - math.floor(math.log10(one))) if one > 0 else 4 for name, one in std.items()}
        cells = [f"{each.known.parameters[name]:.{k}f} ± {std[name]:.{k}f}" for name, k in digits.items()]
        rows.append([str(number), *cells, f"{each.run.y[-1] - each.run.y[0]:.4f}", f"{each.known.misfit:.2f}"])
    return header, rows


_ENCODER_TEXT = (
    "An encoder does not show where within a count the axis starts, and the encoder's error repeats with the motion. "
    "The table gives the deviations that pmfid design SPEC RECORD reaches from the counts."
)


def proof(design: Design) -> str:
    """Return sentences on the distance to the optimum, and on the search for the design."""
    proved = (
        "No bound is proved, so another input may be better."
        if design.gap is None
        else f"Proved: no input within these limits and directions is better by more than {100 * design.gap:.3g} %."
    )
    return (
        f"{proved} Found from {design.starts} starts in {design.solve_seconds:.2g} s; {100 * design.reached:.0f} % of "
        "them end within 0.1 % of the best."
    )


def _summary(appraisal: Appraisal) -> str:
    design = appraisal.design
    meaning = f"Criterion {design.criterion}: {CRITERIA[design.criterion]}; larger is better."
    warnings = [f"Warning: {text}." for text in appraisal.warnings]
    return "\n\n".join([meaning, recommendation(appraisal), proof(design), *warnings])


def motions_of(found: Comparison) -> Inputs:
    """Return input, position and velocity of each input by its name."""
    if isinstance(found, dict):
        return {name: (one.u, one.x, one.v) for name, one in found.items()}
    design = found.design
    return {"design": (design.u, design.x, design.v)} | {
        name: (one.u, one.x, one.v) for name, one in found.standard.items()
    }
