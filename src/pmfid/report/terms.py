"""The page of a search over a drive's terms: lines for AXIS.toml, all compared forces, and the parameters."""

from __future__ import annotations

from pmfid.pipeline.result import findings_lines, parameter_header, parameter_rows
from pmfid.pipeline.terms import TermSearch, term_rows
from pmfid.report.page import ResultPage, Section
from pmfid.report.result import motion_figure

FORCES = (
    "log odds: natural logarithm of the odds that the force is there, in the noise of the residuals. largest change: "
    "the parameter that the force moves most. A model that explains every count takes no further force."
)


def terms_page(found: TermSearch) -> ResultPage:
    """Return the page of a search for terms."""
    result = found.result
    taken, others = ([row for row in found.rows if row.chosen == chosen] for chosen in (True, False))
    sections = [
        Section("For AXIS.toml", code="\n".join(found.lines)),
        Section("Parameters", "", (parameter_header(result), parameter_rows(result))),
        *([Section("Forces of the fit", FORCES, term_rows(taken))] if taken else []),
        *([Section("Forces that this record does not show", FORCES, term_rows(others))] if others else []),
        Section("Input and motion", figure=lambda: motion_figure(result.record, result.estimator.equation)),
    ]
    lines = [line for notes in (False, True) for line in findings_lines(result, notes=notes)]
    sections += [Section("Notes", "\n\n".join(lines), folded=True)] if lines else []
    lead = [found.sentence, *(["Write the lines for AXIS.toml into its section [model]."] if found.added else [])]
    remarks = [f"status: {', '.join(found.status) or 'none'}"]
    remarks += [line for finding in result.findings for line in finding.lines]
    return ResultPage("terms", f"{found.name}: terms of the drive", found.to_dict(), sections, lead, remarks)
