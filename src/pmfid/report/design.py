"""Files of one design: the report, the numbers, the motion."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from pmfid.design.appraisal import Appraisal, gathered
from pmfid.design.criteria import CRITERIA, Criterion
from pmfid.report.design_figures import ellipse_figure, gathering_figure, motion_figure
from pmfid.report.html import Section, Table, svg, write_report

__all__ = ["criteria_table", "std_table", "write_design"]

#: Standard inputs that the figures show beside the design; the tables have all.
SHOWN = ("trapezoid", "s_curve", "minimum_time", "prbs")


def write_design(out: Path, appraisal: Appraisal, criterion: Criterion) -> None:
    """Writes report.html, design.json, design.csv and one CSV for each standard input into the folder `out`."""
    out.mkdir(parents=True, exist_ok=True)
    (out / "design.json").write_text(json.dumps(appraisal.to_json(), indent=2, allow_nan=False) + "\n")
    design = appraisal.design
    for name, columns in _motions(appraisal).items():
        _write_csv(out / f"{name}.csv", design.t, *columns)
    unknown = ", ".join(name.replace("_", " ") for name in design.problem.unknown)
    title = f"Input for {unknown}: criterion {design.criterion}"
    write_report(out / "report.html", title, _sections(appraisal, criterion))


def _write_csv(path: Path, t: np.ndarray, u: np.ndarray, x: np.ndarray, v: np.ndarray) -> None:
    """Columns t, u, x, v at the nodes; the input of a row holds until the next one, that of the last row is 0."""
    rows = zip(t.tolist(), [*u.tolist(), 0.0], x.tolist(), v.tolist(), strict=True)
    lines = ["t,u,x,v", *(",".join(repr(round(value, 12)) for value in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="ascii", newline="\n")


def criteria_table(appraisal: Appraisal) -> Table:
    """One row for each input: value, gain of the design over it, part that survives stiction, what was bent."""
    header = ["input", appraisal.design.criterion, "gain of the design", "surviving stiction", "profile"]
    rows = []
    for name, worth in appraisal.worths.items():
        standard = appraisal.standard.get(name)
        surviving = "-" if worth.surviving is None else f"{worth.surviving:.3f}"
        bent = "" if standard is None else "nearest within the limits" if standard.bent else "as it is"
        gain = "" if standard is None else f"{appraisal.gain[name]:.3g}"
        rows.append([name.replace("_", " "), f"{worth.value:.4g}", gain, surviving, bent])
    return header, rows


def std_table(appraisal: Appraisal) -> Table:
    """Predicted standard deviation of every unknown parameter, by input, in percent of its nominal value."""
    problem = appraisal.design.problem
    header = ["input", *(f"{_words(name)} [% of {problem.nominal[name]:.4g}]" for name in problem.unknown)]
    rows = [
        [
            key.replace("_", " "),
            *(_percent(worth.predicted_std[name], problem.nominal[name]) for name in problem.unknown),
        ]
        for key, worth in appraisal.worths.items()
    ]
    return header, rows


def _percent(std: float, nominal: float) -> str:
    return f"{100 * std / abs(nominal):.3g}" if np.isfinite(std) and nominal else "-"


def _sections(appraisal: Appraisal, criterion: Criterion) -> list[Section]:
    design = appraisal.design
    motions = {name: columns for name, columns in _motions(appraisal).items() if name in ("design", *SHOWN)}
    curves = {name: gathered(design.problem, criterion, columns[0]) for name, columns in motions.items()}
    units = dict(zip(design.problem.drive.equation.names, design.problem.drive.equation.units, strict=True))
    nominal = np.array([design.problem.nominal[name] for name in design.problem.unknown])
    fishers = {name: appraisal.worths[name].fisher for name in motions}
    ellipses = ellipse_figure(
        design.problem.unknown, tuple(units[name] for name in design.problem.unknown), nominal, fishers
    )
    sections = [
        Section("What it is worth", _summary(appraisal), criteria_table(appraisal)),
        Section("Predicted standard deviations", _STD_TEXT, std_table(appraisal)),
        Section(
            "Input and motion",
            "Limits are dashed, the least speed is dotted.",
            svg=svg(motion_figure(design.problem, motions)),
        ),
        Section("Information gathered over time", svg=svg(gathering_figure(curves, f"criterion {design.criterion}"))),
    ]
    if ellipses is not None:
        sections.append(Section("Confidence ellipses, 95 %", "Around the nominal values.", svg=svg(ellipses)))
    return sections


_STD_TEXT = (
    "The Cramér-Rao bound for one run, with what was known before: no unbiased estimate can do better where the "
    "encoder's error is white with the variance given. An encoder of coarse steps is not white, and an estimate may be "
    "better or worse."
)


def _summary(appraisal: Appraisal) -> str:
    design = appraisal.design
    proved = (
        "No bound is proved: another input may be better."
        if design.gap is None
        else f"No input within these limits and directions is better by more than {100 * design.gap:.2g} %."
    )
    found = (
        f"Found from {design.starts} starts in {design.solve_seconds:.2g} s; {100 * design.reached:.0f} % of them end "
        f"within 0.1 % of the best."
    )
    meaning = f"Criterion {design.criterion}: {CRITERIA[design.criterion]}; larger is better."
    return "\n\n".join([meaning, f"{proved} {found}", *(f"Warning: {text}." for text in appraisal.warnings)])


def _motions(appraisal: Appraisal) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    design = appraisal.design
    return {"design": (design.u, design.x, design.v)} | {
        name: (found.u, found.x, found.v) for name, found in appraisal.standard.items()
    }


def _words(name: str) -> str:
    return name.replace("_", " ").replace("coulomb", "Coulomb")
