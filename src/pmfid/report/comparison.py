"""The report that compares all methods."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from pmfid.pipeline.identify import Comparison
from pmfid.pipeline.result import ProcessResult
from pmfid.report.figures import COLOURS, GREY, open_figure
from pmfid.report.html import Section, svg, write_pages
from pmfid.report.tuning import TUNING


def write_comparison(out: Path, comparison: Comparison) -> None:
    """Write compare.html and compare.json into the folder `out`."""
    header, rows = comparison_rows(comparison)
    refused = " ".join(f"{name} has no answer: {reason}." for name, reason in comparison.refused.items())
    sections = [
        Section("Methods", refused, (header, rows)),
        Section("Estimates with two standard deviations", _thin(comparison), svg=svg(comparison_dots(comparison))),
    ]
    write_pages(out, "compare", comparison.to_json(), f"{comparison.name}: all methods", sections)


def _thin(comparison: Comparison) -> str:
    machine = any(result.model_spread is not None for result in comparison.results.values())
    return f"Thin lines: 95 % intervals{', including unmodelled effects' if machine else ''}."


def comparison_rows(comparison: Comparison) -> tuple[list[str], list[list[str]]]:
    """Return the header and one row of text for each method."""
    first = next(iter(comparison.results.values()))
    names = [f"{name} [{unit}]" if unit else name for name, unit in zip(first.names, first.units, strict=True)]
    fitted = any(isinstance(result, ProcessResult) for result in comparison.results.values())
    header = ["method", *names, *(["fit [%]"] if fitted else []), "flags"]
    rows = []
    for method, result in comparison.results.items():
        values = dict(zip(result.names, zip(result.theta, result.theta_std, strict=True), strict=True))
        cells = [f"{values[n][0]:.5g} ± {values[n][1]:.2g}" if n in values else "-" for n in first.names]
        fit = [_fit(result.fit)] if isinstance(result, ProcessResult) else []
        rows.append([method, *cells, *fit, ", ".join(result.status)])
    return header, rows


def _fit(percent: float | None) -> str:
    """Format a fit in percent. An unstable estimate has no fit, and the fit of a useless one may have many digits."""
    if percent is None:
        return "–"
    return f"{percent:.2f}" if abs(percent) < TUNING.comparison_huge else f"{percent:.2g}"


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
