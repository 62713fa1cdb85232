"""The report that compares all methods."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pmfid.pipeline.identify import Comparison
from pmfid.pipeline.result import ProcessResult
from pmfid.report.figures import COLOURS, GREY, open_figure
from pmfid.report.page import ResultPage, Section
from pmfid.report.tuning import TUNING

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def comparison_page(comparison: Comparison) -> ResultPage:
    """Return the page that compares all methods."""
    doubts = [f"{name}: {', '.join(one.status)}" for name, one in comparison.results.items() if one.status]
    remarks = [*doubts, *(f"{name} has no answer: {reason}" for name, reason in comparison.refused.items())]
    machine = any(result.model_spread is not None for result in comparison.results.values())
    thin = f"Thin lines: 95 % intervals{', including unmodelled effects' if machine else ''}."
    sections = [
        Section("Methods", "\n\n".join(f"{remark}." for remark in remarks), comparison_rows(comparison)),
        Section("Estimates with two standard deviations", thin, figure=lambda: comparison_dots(comparison)),
    ]
    title = f"{comparison.name}: all methods"
    return ResultPage("compare", title, comparison.to_json(), sections, remarks=remarks)


def comparison_rows(comparison: Comparison) -> tuple[list[str], list[list[str]]]:
    """Return the header and one row of text for each method."""
    first = next(iter(comparison.results.values()))
    names = [f"{name} [{unit}]" if unit else name for name, unit in zip(first.names, first.units, strict=True)]
    fitted = any(isinstance(result, ProcessResult) for result in comparison.results.values())
    header = ["method", *names, *(["fit [%]"] if fitted else [])]
    rows = []
    for method, result in comparison.results.items():
        values = dict(zip(result.names, zip(result.theta, result.theta_std, strict=True), strict=True))
        cells = [f"{values[n][0]:.5g} ± {values[n][1]:.2g}" if n in values else "-" for n in first.names]
        if isinstance(result, ProcessResult):  # an unstable estimate has no fit
            cells.append("–" if result.fit is None else f"{result.fit:.4g}")
        rows.append([method, *cells])
    return header, rows


def comparison_dots(comparison: Comparison) -> Figure:
    """Draw one panel for each parameter, with the estimate of each method and two standard deviations.

    Up to `comparison_panels` panels stand in a row. Thin lines show the model spread if it is known.
    """
    first = next(iter(comparison.results.values()))
    methods = list(comparison.results)
    lines, columns = -(-len(first.names) // TUNING.comparison_panels), min(TUNING.comparison_panels, len(first.names))
    with open_figure(lines * (1.2 + 0.34 * len(methods)), lines, columns, sharey=True) as (figure, panels):
        for panel, name, unit in zip(panels, first.names, first.units, strict=False):
            for row, result in enumerate(comparison.results.values()):
                if name not in result.names:
                    continue
                i = result.names.index(name)
                panel.plot(result.interval_95[i], [row, row], color=GREY, linewidth=1.4, zorder=2)
                panel.errorbar(result.theta[i], row, xerr=2 * result.theta_std[i], fmt="o", color=COLOURS[0], capsize=3)
            panel.set_xlabel(f"{name.replace('_', ' ')} in {unit}" if unit else name.replace("_", " "))
            panel.locator_params(axis="x", nbins=4)
        for panel in panels[len(first.names) :]:
            panel.set_visible(False)
        panels[0].set_yticks(range(len(methods)), methods)
        panels[0].invert_yaxis()
    return figure
