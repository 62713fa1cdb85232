"""The report of a search over a drive's terms: lines for AXIS.toml, all compared forces, and the parameters."""

from __future__ import annotations

from pathlib import Path

from pmfid.pipeline.result import findings_lines, parameter_header, parameter_rows
from pmfid.pipeline.terms import TermSearch, term_rows
from pmfid.report.html import Section, svg, write_pages
from pmfid.report.result import motion_figure

FORCES = (
    "log odds: natural logarithm of the odds that the force is there, in the noise of the residuals. The columns of "
    "the parameters show how far each one moves by the force. A model that explains every count takes no further force."
)


def write_terms(out: Path, found: TermSearch) -> None:
    """Write terms.html and terms.json into the folder `out`."""
    result = found.result
    taken, others = ([row for row in found.rows if row.chosen == chosen] for chosen in (True, False))
    sections = [
        Section("For AXIS.toml", code="\n".join(found.lines)),
        Section("Parameters", "", (parameter_header(result), parameter_rows(result))),
        *([Section("Forces of the fit", FORCES, term_rows(taken))] if taken else []),
        *([Section("Forces that this record does not show", FORCES, term_rows(others))] if others else []),
        Section("Input and motion", svg=svg(motion_figure(result.record, result.estimator.equation))),
    ]
    lines = [line for notes in (False, True) for line in findings_lines(result, notes=notes)]
    sections += [Section("Notes", "\n\n".join(lines), folded=True)] if lines else []
    lead = found.sentence, "Write the lines for AXIS.toml into its section [model]." if found.added else ""
    write_pages(
        out, "terms", found.to_json(), f"{found.name}: terms of the drive", sections, [one for one in lead if one]
    )
